//! The command line: what the user can say, and what comes back.

mod convert;
mod detect;
mod engine_args;
mod engines;
mod eval;
mod failure;
mod frame_files;
mod interrupt;
mod model_args;
mod output;
mod progress;
mod sim;
mod ticks;
mod track;
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
    /// Show corners and their flow, and carry a target's box by flow alone.
    Track(Box<track::TrackArgs>),
    /// Write YOLOv5 weights as a self-contained ONNX file.
    Convert(convert::ConvertArgs),
    /// Measure a network against labelled data.
    #[command(subcommand)]
    Val(ValCommand),
    /// Measure ranging and following on recorded data.
    #[command(subcommand)]
    Eval(eval::EvalCommand),
    /// Say which inference engines were found, where, and what they can do.
    Engines(engines::EnginesArgs),
}

#[derive(Debug, Subcommand)]
enum ValCommand {
    /// Precision, recall and mAP of a detector, by the COCO protocol.
    Detect(val::ValArgs),
}

/// Runs the program and says how it ended.
pub(crate) fn run() -> ExitCode {
    let cli = Cli::parse();
    interrupt::install();
    let result = match cli.command {
        Command::Detect(args) => detect::run(&args),
        Command::Track(args) => track::run(&args),
        Command::Convert(args) => convert::run(&args),
        Command::Val(ValCommand::Detect(args)) => val::run(&args),
        Command::Eval(command) => eval::run(&command),
        Command::Engines(args) => engines::run(&args),
    };
    failure::exit_code(result)
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
