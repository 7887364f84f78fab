//! `realnet train …` in a program that was built without training: it says how to get it.

use super::failure::{Outcome, bad_input};
use anyhow::Result;
use clap::Args;

/// What there is instead of a command.
const MISSING: &str = "this program was built without training. With it:\n  \
     cargo install --path crates/realnet --features train\nor, in the repository,\n  \
     cargo run --release -p realnet --features train -- train …";

#[derive(Debug, Args)]
#[command(after_help = MISSING)]
pub(crate) struct TrainArgs {
    /// detect or depth, and options.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    _words: Vec<std::ffi::OsString>,
}

pub(crate) fn run(_args: &TrainArgs) -> Result<Outcome> {
    Err(bad_input(MISSING))
}
