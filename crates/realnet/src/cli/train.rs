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
mod detect;
#[cfg(feature = "train")]
mod folder;
#[cfg(feature = "train")]
mod given;
#[cfg(feature = "train")]
mod options;
#[cfg(feature = "train")]
mod recipe;
#[cfg(feature = "train")]
mod session;
#[cfg(feature = "train")]
mod start;

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
}

#[cfg(feature = "train")]
pub(crate) fn run(args: &TrainArgs) -> Result<Outcome> {
    match &args.command {
        TrainCommand::Detect(args) => detect::run(args),
    }
}

/// The folder of a run that is to go on. Whatever else decides the result is in it, and must
/// not be given.
#[cfg(feature = "train")]
fn resumed<T>(
    path: &std::path::Path,
    run: &options::RunArgs,
    given: &given::Given<T>,
    task: &str,
) -> Result<folder::Folder> {
    let own = ["resume", "out", "json"];
    let fixed = |name: &&str| !own.contains(name) && !options::MAY_CHANGE.contains(name);
    if let Some(name) = given.names().find(fixed) {
        return Err(super::failure::bad_input(format!(
            "--{} cannot be changed when a run goes on; only {} can",
            name.replace('_', "-"),
            options::MAY_CHANGE.map(|name| format!("--{name}")).join(", ")
        )));
    }
    let path = match (path.as_os_str().is_empty(), &run.out) {
        (false, None) => path,
        (true, Some(out)) => out,
        (false, Some(_)) => {
            return Err(super::failure::bad_input("--resume DIR goes on in DIR: leave out --out"));
        }
        (true, None) => return Err(super::failure::bad_input("--resume: of which folder?")),
    };
    folder::Folder::resume(path, task)
}

/// Whether a run that goes on was given other options.
#[cfg(feature = "train")]
fn changes<T>(given: &given::Given<T>) -> bool {
    given.names().any(|name| options::MAY_CHANGE.contains(&name))
}

/// What a run that goes on says first.
#[cfg(feature = "train")]
fn going_on(done: usize, epochs: usize) -> String {
    if done >= epochs {
        return format!("all {epochs} epochs are done; --epochs N goes on to N");
    }
    format!("going on after epoch {done} of {epochs}")
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
