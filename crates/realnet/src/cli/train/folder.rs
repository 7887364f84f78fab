//! The folder of a run.

use crate::cli::failure::bad_input;
use anyhow::{Context, Result};
use realnet::{Frame, atomic, picture};
use std::{
    io::ErrorKind,
    path::{Path, PathBuf},
};

/// What decides the result.
const ARGS: &str = "args.toml";
/// Everything that the training needs to go on.
const CHECKPOINT: &str = "last.ckpt";
/// Figures of the epochs.
pub(super) const RESULTS: &str = "results.csv";
/// The same as a picture.
pub(super) const CURVES: &str = "curves.png";
/// The first samples.
pub(super) const BATCH: &str = "batch.png";
/// The pictures that it was judged by, and did not learn from.
pub(super) const HELD_OUT: &str = "val.txt";
/// The network after the last epoch.
pub(super) const LAST: &str = "last.safetensors";
/// The best one.
pub(super) const BEST: &str = "best.safetensors";
/// The best one, for running.
pub(super) const BEST_ONNX: &str = "best.onnx";

/// All that a run writes; with any of the first ones a folder holds a run.
const FILES: [&str; 9] =
    [CHECKPOINT, BEST, LAST, BEST_ONNX, RESULTS, CURVES, BATCH, HELD_OUT, ARGS];
const RUN: usize = 5;

/// Where a run writes.
#[derive(Clone, Debug)]
pub(super) struct Folder {
    path: PathBuf,
}

impl Folder {
    /// A folder for a new run. One with a run in it is refused, unless that is to be replaced;
    /// so is one that cannot be written to, before anything long begins.
    pub(super) fn create(path: &Path, task: &str, overwrite: bool) -> Result<Self> {
        let folder = Self { path: path.to_owned() };
        if let Some(found) = FILES.iter().take(RUN).find(|name| path.join(name).exists())
            && !overwrite
        {
            let path = path.display();
            return Err(bad_input(format!(
                "{path} holds a run ({found}): go on with it by `realnet train {task} --resume \
                 {path}`, replace it by --overwrite, or choose another --out"
            )));
        }
        std::fs::create_dir_all(path)
            .with_context(|| format!("cannot create {}", path.display()))?;
        folder.probe()?;
        Ok(folder)
    }

    /// The folder of a run that is to go on: itself, or its checkpoint.
    pub(super) fn resume(given: &Path, task: &str) -> Result<Self> {
        let folder = match given.file_name() {
            Some(name) if name == CHECKPOINT => given.parent().unwrap_or(Path::new("")),
            _ if given.is_file() => {
                return Err(bad_input(format!(
                    "{}: a run goes on from its folder or its {CHECKPOINT}; to train on from \
                     weights, give them as --model",
                    given.display()
                )));
            }
            _ => given,
        };
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        let folder = Self { path: folder.to_owned() };
        let shown = folder.path.display();
        if !folder.args().exists() {
            return Err(bad_input(format!("{shown} holds no run: there is no {ARGS}")));
        }
        if !folder.checkpoint().exists() {
            return Err(bad_input(format!(
                "the run in {shown} has no {CHECKPOINT}: there is nothing to go on with. \
                 Start again: realnet train {task} --config {shown}/{ARGS} --out {shown}"
            )));
        }
        folder.probe()?;
        Ok(folder)
    }

    /// Removes the run that is there.
    pub(super) fn clear(&self) -> Result<()> {
        for name in FILES {
            let path = self.path.join(name);
            match std::fs::remove_file(&path) {
                Err(error) if error.kind() != ErrorKind::NotFound => {
                    let words = format!("cannot remove {}", path.display());
                    return Err(anyhow::Error::new(error).context(words));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Refuses a folder that cannot be written to.
    fn probe(&self) -> Result<()> {
        Ok(atomic::Pending::new(&self.args()).map(drop)?)
    }

    /// The folder.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The options of the run.
    pub(super) fn args(&self) -> PathBuf {
        self.path.join(ARGS)
    }

    /// The state of the training.
    pub(super) fn checkpoint(&self) -> PathBuf {
        self.path.join(CHECKPOINT)
    }

    /// Writes a file, whole or not at all.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        Ok(atomic::write(&self.path.join(name), bytes)?)
    }

    /// Writes a picture, whole or not at all.
    pub(super) fn draw(&self, name: &str, frame: &Frame) -> Result<()> {
        Ok(picture::write(&self.path.join(name), frame)?)
    }

    /// Writes the options.
    pub(super) fn write_args(&self, text: &str) -> Result<()> {
        self.write(ARGS, text.as_bytes())
    }
}
