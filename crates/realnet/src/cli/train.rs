//! `realnet train …`: learning from data.
//!
//! The framework that it needs compiles longer than everything else together, so it is
//! behind the feature `train`. Without it the command is there and says how to get it.

#[cfg(feature = "train")]
mod augment;
#[cfg(feature = "train")]
mod console;
#[cfg(feature = "train")]
mod data;
#[cfg(feature = "train")]
mod depth;
#[cfg(feature = "train")]
mod detect;
#[cfg(feature = "train")]
mod folder;
#[cfg(feature = "train")]
mod given;
#[cfg(feature = "train")]
mod opened;
#[cfg(feature = "train")]
mod options;
#[cfg(feature = "train")]
mod recipe;
#[cfg(feature = "train")]
mod session;
#[cfg(feature = "train")]
mod start;
#[cfg(feature = "train")]
mod weights;

use super::failure::Outcome;
use anyhow::Result;
use clap::Args;

#[cfg(feature = "train")]
#[derive(Debug, Args)]
pub(crate) struct TrainArgs {
    #[command(subcommand)]
    command: TrainCommand,
}

#[cfg(feature = "train")]
#[derive(Debug, clap::Subcommand)]
enum TrainCommand {
    /// A YOLOv5 detector, from a YOLO data set.
    Detect(Box<given::Given<detect::DetectArgs>>),
    /// A depth network, from pictures with depth maps.
    Depth(Box<given::Given<depth::DepthArgs>>),
}

#[cfg(feature = "train")]
pub(crate) fn run(args: &TrainArgs) -> Result<Outcome> {
    match &args.command {
        TrainCommand::Detect(args) => detect::run(args),
        TrainCommand::Depth(args) => depth::run(args),
    }
}

/// What there is instead of a command.
#[cfg(not(feature = "train"))]
const MISSING: &str = "this program was built without training. With it:\n  \
     cargo install --path crates/realnet --features train\nor, in the repository,\n  \
     cargo run --release -p realnet --features train -- train …";

#[cfg(not(feature = "train"))]
#[derive(Debug, Args)]
#[command(after_help = MISSING)]
pub(crate) struct TrainArgs {
    /// detect or depth, and options.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    _words: Vec<std::ffi::OsString>,
}

#[cfg(not(feature = "train"))]
pub(crate) fn run(_args: &TrainArgs) -> Result<Outcome> {
    Err(super::failure::bad_input(MISSING))
}
