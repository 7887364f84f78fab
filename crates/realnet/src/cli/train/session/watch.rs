//! A bar for each epoch.

use crate::cli::{failure::say, interrupt, progress};
use burn::module::Module;
use indicatif::{FormattedDuration, ProgressBar, ProgressStyle};
use realnet_train::trainer::{EpochReport, Observer, StepReport, TrainError};
use std::{
    io::IsTerminal,
    ops::ControlFlow,
    time::{Duration, Instant},
};

/// The epoch, its steps and what is left of it; then rate, what is left of all, losses.
const TEMPLATE: &str = "{prefix} {bar:20} {pos}/{len} eta {eta} {wide_msg}";
/// Where there is no terminal, a line comes as often as this.
const LINE_EVERY: Duration = Duration::from_secs(60);

/// Follows the steps, ends the training after each epoch so that its files can be written,
/// and after the step in which Ctrl-C came.
pub(super) struct Watch {
    epochs: usize,
    batch: usize,
    parts: &'static [&'static str],
    bar: ProgressBar,
    /// When the first step of this epoch was done: the one before warms up.
    since: Option<(usize, Instant)>,
    /// Seconds of the whole epochs so far, and how many they were.
    took: (f64, u32),
    /// When the last line was written, where there is no bar.
    line: Option<Instant>,
}

impl Watch {
    /// For a whole of so many epochs, with batches of so many samples.
    pub(super) fn new(epochs: usize, batch: usize, parts: &'static [&'static str]) -> Self {
        let line = (!std::io::stderr().is_terminal()).then(Instant::now);
        Self { epochs, batch, parts, bar: ProgressBar::hidden(), since: None, took: (0.0, 0), line }
    }

    /// A whole epoch with its validation took so long.
    pub(super) fn epoch_took(&mut self, seconds: f64) {
        self.took = (self.took.0 + seconds, self.took.1 + 1);
    }

    /// Takes the bar away.
    pub(super) fn clear(&mut self) {
        self.bar.finish_and_clear();
        self.bar = ProgressBar::hidden();
        self.since = None;
    }

    fn words(&self, report: &StepReport<'_>) -> String {
        let StepReport { epoch, step, steps, parts, .. } = *report;
        let parts = self.parts.iter().zip(parts);
        let losses: String = parts.map(|(name, value)| format!(" {name} {value:.4}")).collect();
        if step + 1 == steps {
            return format!("validation {losses}");
        }
        let Some((first, since)) = self.since.filter(|(first, _)| step > *first) else {
            return losses;
        };
        let a_step = since.elapsed().as_secs_f64() / (step - first) as f64;
        let rate = self.batch as f64 / a_step.max(1e-9);
        let an_epoch = match self.took {
            (_, 0) => a_step * steps as f64,
            (seconds, count) => seconds / f64::from(count),
        };
        let left = self.epochs.saturating_sub(epoch + 1) as f64 * an_epoch
            + a_step * (steps - step) as f64;
        // Beyond what is a time at all nothing is said.
        let all = Duration::try_from_secs_f64(left);
        let all =
            all.map_or_else(|_| String::new(), |left| format!(" all {}", FormattedDuration(left)));
        format!("{rate:.1} pictures/s{all} {losses}")
    }
}

impl<M: Module> Observer<M> for Watch {
    fn step(&mut self, report: &StepReport<'_>) -> ControlFlow<()> {
        if self.since.is_none() {
            let style = ProgressStyle::with_template(TEMPLATE);
            let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
            let bar = progress::bar(Some(report.steps as u64), "epoch").with_style(style);
            self.bar = bar.with_prefix(format!("{}/{}", report.epoch + 1, self.epochs));
            self.since = Some((report.step, Instant::now()));
        }
        self.bar.set_message(self.words(report));
        self.bar.set_position(report.step as u64 + 1);
        if self.line.is_some_and(|last| last.elapsed() >= LINE_EVERY) {
            self.line = Some(Instant::now());
            let StepReport { epoch, step, steps, .. } = *report;
            let (epoch, step, words) = (epoch + 1, step + 1, self.words(report));
            say(format!("epoch {epoch}/{} step {step}/{steps} {words}", self.epochs));
        }
        if interrupt::interrupted() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn epoch(&mut self, _: &EpochReport, _: &M) -> Result<ControlFlow<()>, TrainError> {
        Ok(ControlFlow::Break(()))
    }
}
