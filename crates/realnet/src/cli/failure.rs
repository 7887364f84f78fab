//! How a run ends: with which words, and which exit code.

use anyhow::Error;
use std::{fmt, path::Path, process::ExitCode};

/// The user's input was bad: exit code 2 instead of 1.
#[derive(Debug)]
struct BadInput(Error);

impl fmt::Display for BadInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for BadInput {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.0.source()
    }
}

/// Marks an error as the input's fault.
pub(crate) trait OrBadInput<T> {
    /// The same result; an error ends the program with exit code 2.
    fn or_bad_input(self) -> Result<T, Error>;
}

impl<T, E: Into<Error>> OrBadInput<T> for Result<T, E> {
    fn or_bad_input(self) -> Result<T, Error> {
        self.map_err(|error| Error::new(BadInput(error.into())))
    }
}

/// An error that is the input's fault, in these words.
pub(crate) fn bad_input(message: impl fmt::Display) -> Error {
    Error::new(BadInput(anyhow::anyhow!("{message}")))
}

/// How a command that did not fail ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// All was done.
    Done,
    /// Some inputs were bad, and were reported; the rest was done.
    BadInputs,
    /// All was done, and something that was tried did not pass.
    Failed,
    /// Ctrl-C came; what was done is whole.
    Interrupted,
}

/// Prints an error and gives the exit code.
pub(crate) fn exit_code(result: Result<Outcome, Error>) -> ExitCode {
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Failed) => ExitCode::FAILURE,
        Ok(Outcome::BadInputs) => ExitCode::from(2),
        Ok(Outcome::Interrupted) => ExitCode::from(130),
        // Whoever read our output went away: `realnet detect … | head`.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            report(&error);
            ExitCode::from(if error.downcast_ref::<BadInput>().is_some() { 2 } else { 1 })
        }
    }
}

/// Whether whoever read our output went away.
pub(crate) fn is_broken_pipe(error: &Error) -> bool {
    error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<std::io::Error>())
        .any(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
}

/// Refuses to write results over one of the run's inputs.
pub(crate) fn keep_input(output: &Path, input: &Path) -> Result<(), Error> {
    match (output.canonicalize(), input.canonicalize()) {
        (Ok(target), Ok(source)) if target == source => {
            Err(bad_input(format!("the input {} would be overwritten", input.display())))
        }
        _ => Ok(()),
    }
}

/// One line to standard error.
#[allow(clippy::print_stderr, reason = "the program's own messages")]
pub(crate) fn say(message: impl fmt::Display) {
    eprintln!("realnet: {message}");
}

/// An error with its causes, unless a cause is already part of its words.
pub(crate) fn report(error: &Error) {
    // Some decoders end their words with line feeds.
    let mut text = error.to_string().trim_end().to_owned();
    for cause in error.chain().skip(1).map(|cause| cause.to_string().trim_end().to_owned()) {
        if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    say(text);
}
