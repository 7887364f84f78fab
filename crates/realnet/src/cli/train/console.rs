//! What a training says while it goes on.

use crate::cli::{failure::say, output::Output};
use serde::Serialize;
use std::fmt::Display;

/// Standard output: lines for people, or an object an epoch for programs.
pub(super) struct Console {
    output: Option<Output>,
    json: bool,
}

impl Console {
    pub(super) fn new(json: bool) -> Self {
        Self { output: Some(Output::stdout()), json }
    }

    /// A line for people; beside the objects it goes to standard error.
    pub(super) fn line(&mut self, line: impl Display) {
        if self.json {
            say(line);
        } else {
            self.write(|output| output.line(line));
        }
    }

    /// A line of the table, which programs have as objects.
    pub(super) fn row(&mut self, line: impl Display) {
        if !self.json {
            self.write(|output| output.line(line));
        }
    }

    /// An object for programs.
    pub(super) fn object(&mut self, value: &impl Serialize) {
        if self.json {
            self.write(|output| output.json(value));
        }
    }

    /// Whoever read and went away does not end hours of training.
    fn write(&mut self, line: impl FnOnce(&mut Output) -> anyhow::Result<()>) {
        if let Some(output) = &mut self.output
            && line(output).is_err()
        {
            self.output = None;
        }
    }
}
