//! The command line: what the user can say, and what comes back.

mod camera_args;
mod convert;
mod detect;
mod engine_args;
mod engines;
mod eval;
mod failure;
mod follow;
mod frame_files;
mod frames;
mod html;
mod interrupt;
mod model_args;
mod network_args;
mod output;
mod progress;
mod robot_args;
mod sim;
mod ticks;
mod track;
#[cfg(feature = "train")]
mod train;
#[cfg(not(feature = "train"))]
#[path = "train_missing.rs"]
mod train;
mod val;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// See, range and follow a moving target with one camera.
#[derive(Debug, Parser)]
#[command(name = "realnet", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Find objects in pictures, a video, a stream or a camera.
    Detect(detect::DetectArgs),
    /// See, range and follow a target: on real frames, or in a simulated chase.
    Follow(Box<follow::FollowArgs>),
    /// Show corners and their flow, and carry a target's box by flow alone.
    Track(Box<track::TrackArgs>),
    /// Write the frames of a video as a YOLO data set, with a box carried through it.
    Frames(Box<frames::FramesArgs>),
    /// Write YOLOv5, VNL or vnl-lite weights as a self-contained ONNX file.
    Convert(convert::ConvertArgs),
    /// Train a detector or a depth network on your own data.
    Train(train::TrainArgs),
    /// Measure a network against labelled data.
    #[command(subcommand)]
    Val(val::ValCommand),
    /// Measure ranging and following on recorded data.
    #[command(subcommand)]
    Eval(eval::EvalCommand),
    /// Follow a target in a simulated world, scenario by scenario.
    Sim(sim::SimArgs),
    /// Say which inference engines were found, where, and what they can do.
    Engines(engines::EnginesArgs),
}

/// Runs the program and says how it ended.
pub(crate) fn run() -> ExitCode {
    let cli = Cli::parse();
    interrupt::install();
    let result = match cli.command {
        Command::Detect(args) => detect::run(&args),
        Command::Follow(args) => follow::run(&args),
        Command::Track(args) => track::run(&args),
        Command::Frames(args) => frames::run(&args),
        Command::Convert(args) => convert::run(&args),
        Command::Train(args) => train::run(&args),
        Command::Val(command) => val::run(&command),
        Command::Eval(command) => eval::run(&command),
        Command::Sim(args) => sim::run(&args),
        Command::Engines(args) => engines::run(&args),
    };
    failure::exit_code(result)
}

/// How the program was called, for reports.
pub(crate) fn command_line() -> String {
    let mut line = "realnet".to_owned();
    for word in std::env::args_os().skip(1) {
        let word = word.to_string_lossy();
        let plain = |c: char| c.is_alphanumeric() || "-_=./:,+@%".contains(c);
        if !word.is_empty() && word.chars().all(plain) {
            line = format!("{line} {word}");
        } else {
            line = format!("{line} '{}'", word.replace('\'', r"'\''"));
        }
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
