//! A training from its first to its last epoch, and the files it leaves.

mod curves;
mod table;
mod watch;

use super::{
    console::Console,
    data::Failures,
    folder::{self, Folder},
};
use crate::cli::{
    failure::{Outcome, say},
    interrupt,
};
use anyhow::{Error, Result};
use realnet_data::Failure;
use realnet_train::trainer::{Ended, EpochReport, Task, TrainError, Trainer};
use std::time::Instant;
use table::Table;
use watch::Watch;

/// What is trained, and how it becomes files.
pub(super) trait Learning {
    /// The task.
    type Task: Task;
    /// `detect` or `depth`.
    const NAME: &'static str;

    /// The weights.
    fn safetensors(&self, model: &<Self::Task as Task>::Model) -> Result<Vec<u8>>;

    /// The network for running.
    fn onnx(&self, model: &<Self::Task as Task>::Model) -> Result<Vec<u8>>;

    /// Samples that could not be made so far.
    fn failures(&self, task: &Self::Task) -> Vec<Failure>;
}

/// What a run that goes on says first.
pub(super) fn going_on<T: Task>(trainer: &Trainer<T>) -> String {
    let (done, epochs) = (trainer.history().len(), trainer.options().epochs);
    if done >= epochs {
        return format!("all {epochs} epochs are done; --epochs N goes on to N");
    }
    match trainer.steps_begun() {
        0 => format!("going on after epoch {done} of {epochs}"),
        steps => format!("going on in epoch {} of {epochs}, after step {steps}", done + 1),
    }
}

/// A training that goes on.
pub(super) struct Session<'a, L: Learning> {
    pub(super) learning: L,
    pub(super) trainer: Trainer<L::Task>,
    pub(super) folder: &'a Folder,
    pub(super) console: &'a mut Console,
    /// Samples of a step.
    pub(super) batch: usize,
}

impl<L: Learning> Session<'_, L> {
    /// Trains to the end, or until Ctrl-C.
    pub(super) fn run(mut self) -> Result<Outcome> {
        let checkpoint = self.folder.checkpoint();
        let table = Table::new(L::Task::PARTS, self.trainer.options().epochs);
        // Its files may be those of an epoch before: it may have ended between them and the
        // checkpoint.
        if let Some(last) = self.trainer.history().last().cloned() {
            self.keep(&last, &table)?;
        }
        let mut failures = Failures::default();
        let mut watch = Watch::new(self.trainer.options().epochs, self.batch, L::Task::PARTS);
        let mut is_head_due = true;
        loop {
            let whole = self.trainer.history().len();
            let is_whole = self.trainer.steps_begun() == 0;
            let start = Instant::now();
            // The observer ends it after each epoch.
            let ended = self.trainer.run(Some(&checkpoint), &mut watch);
            watch.clear();
            failures.tell(&self.learning.failures(self.trainer.task()));
            let ended = ended.map_err(|error| self.failed(error, whole))?;
            let Some(report) = self.trainer.history().get(whole).cloned() else {
                return Ok(self.end(ended));
            };
            let seconds = start.elapsed().as_secs_f64();
            if is_whole {
                watch.epoch_took(seconds);
            }
            if std::mem::take(&mut is_head_due) {
                self.console.row(table.head(&report));
            }
            self.console.row(table.row(&report, seconds));
            self.console.object(&table.object(&report, seconds));
            if let Err(error) = self.keep(&report, &table) {
                let epochs = self.trainer.history().len();
                return Err(self.with_advice(error, "", epochs));
            }
            if interrupt::interrupted() && self.trainer.history().len() < table.epochs() {
                return Ok(self.end(Ended::Interrupted));
            }
        }
    }

    /// Writes the files of an epoch, whose checkpoint is there already.
    fn keep(&self, report: &EpochReport, table: &Table) -> Result<()> {
        let Self { folder, learning, trainer, .. } = self;
        let weights = learning.safetensors(trainer.average())?;
        folder.write(folder::LAST, &weights)?;
        if report.best {
            folder.write(folder::BEST, &weights)?;
            folder.write(folder::BEST_ONNX, &learning.onnx(trainer.average())?)?;
        }
        folder.write(folder::RESULTS, table.csv(trainer.history()).as_bytes())?;
        folder.draw(folder::CURVES, &curves::draw(table, trainer.history())?)
    }

    /// Says how it ended.
    fn end(&mut self, ended: Ended) -> Outcome {
        let history = self.trainer.history();
        let folder = self.folder.path().display();
        if ended == Ended::Interrupted {
            say(format!("interrupted; {}", self.advice(history.len())));
            return Outcome::Interrupted;
        }
        let best = history.iter().rfind(|report| report.best);
        if let Some(best) = best {
            let reason = match ended {
                Ended::Patience => {
                    format!(
                        ": nothing became better for {} epochs",
                        self.trainer.options().patience
                    )
                }
                _ => String::new(),
            };
            let figures = best.validation.figures.iter();
            let figures: Vec<_> =
                figures.map(|(name, value)| format!("{name} {value:.4}")).collect();
            let line = format!(
                "done after {} epochs{reason}. The best was epoch {}: {}
It is {folder}/{} (to \
                 run) and {folder}/{} (to train on)",
                history.len(),
                best.epoch + 1,
                figures.join(", "),
                folder::BEST_ONNX,
                folder::BEST,
            );
            self.console.line(line);
        }
        Outcome::Done
    }

    /// What is safe after `whole` epochs, and how to go on.
    fn advice(&self, whole: usize) -> String {
        let (checkpoint, folder) = (self.folder.checkpoint(), self.folder.path().display());
        // Only a checkpoint that was written says where it stands.
        let steps =
            if whole == self.trainer.history().len() { self.trainer.steps_begun() } else { 0 };
        let until = match (whole, steps) {
            (0, 0) if !checkpoint.exists() => {
                return "nothing was learned yet that could be gone on with".to_owned();
            }
            (0, 0) => "where this run began".to_owned(),
            (_, 0) => format!("the end of epoch {whole}"),
            _ => format!("step {steps} of epoch {}", whole + 1),
        };
        format!(
            "{} holds everything up to {until}; go on: realnet train {} --resume {folder}",
            checkpoint.display(),
            L::NAME
        )
    }

    /// An error, and what to do about it.
    fn with_advice(&self, error: Error, hint: &str, whole: usize) -> Error {
        Error::msg(format!("{}{hint}\n{}", words(&error), self.advice(whole)))
    }

    /// The words for a training that has nothing to go on with: from the checkpoint it would
    /// come to the same again.
    fn diverged(&self, what: &str, whole: usize) -> Error {
        let hint = if whole == 0 {
            "start again with a smaller --lr or a longer --warmup-epochs".to_owned()
        } else {
            let folder = self.folder.path().display();
            format!(
                "start again with a smaller --lr, or train on from {folder}/{} with one; the \
                 weights of epoch {whole} and the best ones are as they were",
                folder::LAST
            )
        };
        Error::msg(format!("the training diverged: {what}\n{hint}"))
    }

    /// The words for a training that failed when `whole` epochs were in the checkpoint.
    fn failed(&self, error: TrainError, whole: usize) -> Error {
        let lost = |epoch: usize| format!("; epoch {} is lost", epoch + 1);
        match error {
            TrainError::Diverged { epoch, step, loss, lr } => {
                let (step, epoch) = (step + 1, epoch + 1);
                let what = format!("the loss is {loss} in step {step} of epoch {epoch}");
                self.diverged(&format!("{what} (learning rate {lr:.3e})"), whole)
            }
            TrainError::NotFinite { epoch, name } => {
                self.diverged(&format!("{name} is not finite after epoch {}", epoch + 1), whole)
            }
            error @ TrainError::Weights { .. } => self.with_advice(Error::new(error), "", whole),
            TrainError::Empty { epoch } => Error::msg(format!("epoch {} has no batch", epoch + 1)),
            TrainError::Data { epoch, source } => {
                let error = Error::from_boxed(source).context(format!("in epoch {}", epoch + 1));
                self.with_advice(error, "", whole)
            }
            TrainError::Checkpoint(error) => {
                self.with_advice(Error::new(error), &lost(whole), whole)
            }
        }
    }
}

/// An error with its causes, unless a cause is already part of its words.
fn words(error: &Error) -> String {
    error.chain().map(ToString::to_string).fold(String::new(), |text, cause| {
        if text.is_empty() {
            cause
        } else if text.contains(&cause) {
            text
        } else {
            format!("{text}: {cause}")
        }
    })
}
