//! `realnet val …`: what a network is worth on labelled data.

mod depth;
mod detect;

use super::failure::Outcome;
use anyhow::Result;
use clap::Subcommand;

#[derive(Debug, Subcommand)]
pub(crate) enum ValCommand {
    /// Precision, recall and mAP of a detector, by the COCO protocol.
    Detect(Box<detect::ValArgs>),
    /// Errors of a depth network, or of depth maps of any other program.
    Depth(Box<depth::DepthArgs>),
}

pub(crate) fn run(command: &ValCommand) -> Result<Outcome> {
    match command {
        ValCommand::Detect(args) => detect::run(args),
        ValCommand::Depth(args) => depth::run(args),
    }
}
