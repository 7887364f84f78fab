//! `realnet train …`: learning from data.
//!
//! The framework that it needs compiles longer than everything else together, so all this is
//! behind the feature `train`; without it `train_missing.rs` stands in its place.

mod augment;
mod console;
mod data;
mod depth;
mod detect;
mod device;
mod folder;
mod given;
mod opened;
mod options;
mod recipe;
mod session;
mod start;
mod weights;

use super::failure::Outcome;
use anyhow::Result;
use clap::Args;

#[derive(Debug, Args)]
pub(crate) struct TrainArgs {
    #[command(subcommand)]
    command: TrainCommand,
}

#[derive(Debug, clap::Subcommand)]
enum TrainCommand {
    /// A YOLOv5 detector, from a YOLO data set.
    Detect(Box<given::Given<detect::DetectArgs>>),
    /// A depth network, from pictures with depth maps.
    Depth(Box<given::Given<depth::DepthArgs>>),
}

pub(crate) fn run(args: &TrainArgs) -> Result<Outcome> {
    match &args.command {
        TrainCommand::Detect(args) => detect::run(args),
        TrainCommand::Depth(args) => depth::run(args),
    }
}
