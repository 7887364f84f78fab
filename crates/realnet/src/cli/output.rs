//! Standard output, where a reader that goes away is not a failure.

use anyhow::Result;
use serde::Serialize;
use std::{
    fmt::Display,
    io::{self, StdoutLock, Write},
};

/// Standard output, line by line; each line is flushed, so that a program behind
/// a pipe gets it at once.
pub(crate) struct Output {
    stdout: StdoutLock<'static>,
}

impl Output {
    pub(crate) fn stdout() -> Self {
        Self { stdout: io::stdout().lock() }
    }

    /// One line.
    pub(crate) fn line(&mut self, line: impl Display) -> Result<()> {
        writeln!(self.stdout, "{line}")?;
        self.stdout.flush()?;
        Ok(())
    }

    /// One JSON value on a line of its own.
    pub(crate) fn json(&mut self, value: &impl Serialize) -> Result<()> {
        let text = serde_json::to_string(value)?;
        self.line(text)
    }
}
