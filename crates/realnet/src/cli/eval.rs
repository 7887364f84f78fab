//! `realnet eval …`: what the rooms are worth on recorded data.

pub(crate) mod motion;

use super::failure::Outcome;
use anyhow::Result;
use clap::Subcommand;

#[derive(Debug, Subcommand)]
pub(crate) enum EvalCommand {
    /// Depth and camera motion between depth maps, on RGB-D sequences with poses.
    Motion(Box<motion::MotionArgs>),
}

pub(crate) fn run(command: &EvalCommand) -> Result<Outcome> {
    match command {
        EvalCommand::Motion(args) => motion::run(args),
    }
}
