//! The loop: epochs, steps, validation, checkpoints.

mod checkpoint;

use crate::names::{NamesError, tensors};
use crate::optim::{Ema, Optimizer, Schedule, clip_norm};
use burn::module::Module;
use burn::optim::{GradientsAccumulator, GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Tensor};
pub use checkpoint::CheckpointError;
use realnet_nn::weights;
use serde::{Deserialize, Serialize};
use std::error::Error;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::path::Path;
use std::thread;
use thiserror::Error;

/// What is learned: a loss of batches, and figures that say how good a network is.
pub trait Task: Sync {
    /// The network.
    type Model: Module;
    /// Samples of one step, and what is wanted of them.
    type Batch: Send;
    /// What can go wrong with data.
    type Error: Error + Send + Sync + 'static;

    /// The batches of an epoch from the one of number `first` on, in an order that depends on
    /// `epoch` and the task alone.
    ///
    /// # Errors
    /// When the data cannot be read at all.
    fn batches(
        &self,
        epoch: usize,
        first: usize,
    ) -> Result<impl Iterator<Item = Result<Self::Batch, Self::Error>>, Self::Error>;

    /// Steps in an epoch.
    fn steps(&self) -> usize;

    /// The loss of a batch.
    fn loss(&self, model: &Self::Model, batch: Self::Batch, device: &Device) -> Loss;

    /// Whether the loss is a mean over the samples, not their sum: then the gradients of
    /// batches that are added up to one step are a mean, too.
    const IS_MEAN: bool = false;

    /// Names of the loss's parts.
    const PARTS: &'static [&'static str];

    /// Figures of a network on the validation set. `model` is as [`Module::valid`] gives it.
    ///
    /// # Errors
    /// When the validation data cannot be read.
    fn validate(&self, model: &Self::Model) -> Result<Figures, Self::Error>;
}

/// The loss of a batch.
#[derive(Clone, Debug)]
pub struct Loss {
    /// What is made small, `[1]`: a sum over the samples, or their mean, see
    /// [`Task::IS_MEAN`].
    pub total: Tensor<1>,
    /// Its parts by the names of [`Task::PARTS`], as means over the samples.
    pub parts: Vec<f32>,
    /// Samples in the batch.
    pub samples: usize,
}

/// What a validation found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// By name, in the order of the table.
    pub figures: Vec<(String, f64)>,
    /// The one that counts: the more the better.
    pub fitness: f64,
}

/// How it is learned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainOptions {
    /// Times that all samples are seen.
    pub epochs: usize,
    /// Batches whose gradients are added up to one step.
    pub accumulate: usize,
    /// How gradients become steps.
    pub optimizer: Optimizer,
    /// Decay of the weights of convolutions at a step.
    pub weight_decay: f32,
    /// First learning rate, after the warm-up.
    pub lr: f64,
    /// Share of it that is left at the end.
    pub lr_last: f64,
    /// The way between.
    pub schedule: Schedule,
    /// Epochs in which the learning rate rises from 0.
    pub warmup_epochs: f64,
    /// Largest norm of the gradients; 0 for any.
    pub clip: f64,
    /// Decay of the moving average, and after how many steps it has grown to 63 % of that.
    pub ema: [f64; 2],
    /// Epochs without a better network after which it ends.
    pub patience: usize,
    /// Where all randomness comes from.
    pub seed: u64,
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            epochs: 100,
            accumulate: 1,
            optimizer: Optimizer::Sgd { momentum: 0.937 },
            weight_decay: 5e-4,
            lr: 0.01,
            lr_last: 0.01,
            schedule: Schedule::Cosine,
            warmup_epochs: 3.0,
            clip: 10.0,
            ema: [0.9999, 2000.0],
            patience: 100,
            seed: 0,
        }
    }
}

impl TrainOptions {
    /// Learning rate at a share of an epoch, counted from the start.
    #[must_use]
    pub fn lr_at(&self, epochs: f64) -> f64 {
        let rising = if self.warmup_epochs > 0.0 { epochs / self.warmup_epochs } else { 1.0 };
        let done = epochs / self.epochs.max(1) as f64;
        self.lr * self.schedule.factor(done, self.lr_last) * rising.min(1.0)
    }
}

/// Why a training ended without a result.
#[derive(Debug, Error)]
pub enum TrainError {
    /// The data.
    #[error("in epoch {epoch}")]
    Data {
        /// When.
        epoch: usize,
        /// What.
        #[source]
        source: Box<dyn Error + Send + Sync>,
    },
    /// The loss is not a number: the learning rate may be too large.
    #[error("the loss is {loss} in step {step} of epoch {epoch} (learning rate {lr:.3e})")]
    Diverged {
        /// When.
        epoch: usize,
        /// Step of the epoch.
        step: usize,
        /// What it is.
        loss: f32,
        /// The learning rate.
        lr: f64,
    },
    /// The weights are no numbers any more: the learning rate may be too large.
    #[error("after epoch {epoch} '{name}' is not finite")]
    NotFinite {
        /// When.
        epoch: usize,
        /// The first of the weights of which that is so.
        name: String,
    },
    /// The network cannot be read.
    #[error("the network after epoch {epoch}")]
    Weights {
        /// When.
        epoch: usize,
        /// Why.
        #[source]
        source: NamesError,
    },
    /// An epoch without a batch.
    #[error("epoch {epoch} has no batch")]
    Empty {
        /// Which.
        epoch: usize,
    },
    /// A checkpoint.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
}

/// After a step.
#[derive(Clone, Debug)]
pub struct StepReport<'a> {
    /// Epoch, from 0.
    pub epoch: usize,
    /// Step in it, from 0.
    pub step: usize,
    /// Steps in it.
    pub steps: usize,
    /// The loss, mean over the samples.
    pub loss: f32,
    /// Its parts.
    pub parts: &'a [f32],
    /// Learning rate.
    pub lr: f64,
    /// Norm of the gradients before clipping; `None` where they are still added up.
    pub gradient: Option<f64>,
}

/// After an epoch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EpochReport {
    /// From 0.
    pub epoch: usize,
    /// Mean of the samples.
    pub loss: f64,
    /// Means of its parts.
    pub parts: Vec<f64>,
    /// Learning rate at the end.
    pub lr: f64,
    /// Of the moving average.
    pub validation: Figures,
    /// Whether it is the best so far.
    pub best: bool,
}

/// Is told how it goes, and may end it.
pub trait Observer<M: Module> {
    /// After a step. Break ends the training after the step of the optimiser that this one
    /// belongs to.
    fn step(&mut self, report: &StepReport<'_>) -> ControlFlow<()>;

    /// After an epoch and its checkpoint. `model` is the moving average.
    ///
    /// # Errors
    /// What keeps the training from going on.
    fn epoch(&mut self, report: &EpochReport, model: &M) -> Result<ControlFlow<()>, TrainError>;
}

/// How a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// After all epochs.
    Finished,
    /// Nothing became better for long.
    Patience,
    /// By the observer.
    Interrupted,
}

/// A training: everything that changes from step to step.
pub struct Trainer<T: Task> {
    task: T,
    options: TrainOptions,
    device: Device,
    /// Others that compute batches of the same step.
    others: Vec<Device>,
    model: T::Model,
    optimizer: ModuleOptimizer,
    ema: Ema<T::Model>,
    history: Vec<EpochReport>,
    /// The epoch that was begun.
    begun: Option<Begun>,
}

/// An epoch up to a step, with nothing waiting to be added up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Begun {
    steps: usize,
    samples: usize,
    /// Of the loss and its parts over the samples.
    sums: Vec<f64>,
    lr: f64,
}

/// A batch after its backward pass.
struct Computed {
    /// Mean of the samples.
    loss: f32,
    parts: Vec<f32>,
    samples: usize,
    gradients: GradientsParams,
}

impl Computed {
    /// `share` of a step's gradient is this batch's, where the loss is a mean.
    fn new<T: Task>(
        task: &T,
        model: &T::Model,
        batch: T::Batch,
        device: &Device,
        share: f32,
    ) -> Self {
        let Loss { total, parts, samples } = task.loss(model, batch, device);
        let loss: f32 = total.clone().into_scalar();
        let loss = if T::IS_MEAN { loss } else { loss / samples.max(1) as f32 };
        let total = if T::IS_MEAN { total * share } else { total };
        let gradients = GradientsParams::from_grads(total.backward(), model);
        Self { loss, parts, samples, gradients }
    }
}

impl<T: Task> Trainer<T> {
    /// Begins with `model`, which lives on `device`, a device with differentiation.
    #[must_use]
    pub fn new(task: T, model: T::Model, options: TrainOptions, device: Device) -> Self {
        let [decay, ramp] = options.ema;
        let ema = Ema::new(model.valid(), 0, decay, ramp);
        let optimizer = options.optimizer.init(options.weight_decay);
        let (others, history) = (Vec::new(), Vec::new());
        Self { task, options, device, others, model, optimizer, ema, history, begun: None }
    }

    /// Divides the batches that are added up to one step (`accumulate` of them) among the
    /// device of the network and these: data parallelism. The network comes to the same
    /// weights as without them, to the rounding of the devices; its running statistics are
    /// those of the batches that its own device has seen.
    #[must_use]
    pub fn with_devices(mut self, others: Vec<Device>) -> Self {
        self.others = others;
        self
    }

    /// Goes on where the checkpoint `path` was written. `model` is one of the same shape.
    ///
    /// # Errors
    /// [`CheckpointError`] when the file is none, or one of another training.
    pub fn resume(
        task: T,
        model: T::Model,
        options: TrainOptions,
        device: Device,
        path: &Path,
    ) -> Result<Self, CheckpointError> {
        let mut trainer = Self::new(task, model, options, device);
        trainer.load(path)?;
        Ok(trainer)
    }

    /// The options.
    #[must_use]
    pub const fn options(&self) -> &TrainOptions {
        &self.options
    }

    /// The task.
    #[must_use]
    pub const fn task(&self) -> &T {
        &self.task
    }

    /// The epochs so far.
    #[must_use]
    pub fn history(&self) -> &[EpochReport] {
        &self.history
    }

    /// Steps of the epoch that was begun and interrupted; 0 at the border of two epochs.
    #[must_use]
    pub fn steps_begun(&self) -> usize {
        self.begun.as_ref().map_or(0, |begun| begun.steps)
    }

    /// The moving average: what is to be used.
    #[must_use]
    pub const fn average(&self) -> &T::Model {
        self.ema.model()
    }

    /// The network in training.
    #[must_use]
    pub const fn model(&self) -> &T::Model {
        &self.model
    }

    /// Trains until the end. Before the first step the network is judged once, so that what
    /// keeps it from being judged is found then. After each epoch, and where the observer ends
    /// it, a checkpoint is written to `checkpoint`, whole or not at all.
    ///
    /// # Errors
    /// [`TrainError`]; the last checkpoint is still there.
    pub fn run(
        &mut self,
        checkpoint: Option<&Path>,
        observer: &mut impl Observer<T::Model>,
    ) -> Result<Ended, TrainError> {
        if self.history.is_empty() && self.begun.is_none() && self.options.epochs > 0 {
            // What keeps it from being judged is to be known before hours of training.
            let found = self.task.validate(self.ema.model());
            found.map_err(|e| TrainError::Data { epoch: 0, source: Box::new(e) })?;
        }
        while self.history.len() < self.options.epochs {
            if self.is_patience_over() {
                return Ok(Ended::Patience);
            }
            let Some(report) = self.epoch(observer)? else {
                if let (Some(path), Some(_)) = (checkpoint, &self.begun) {
                    self.save(path)?;
                }
                return Ok(Ended::Interrupted);
            };
            self.history.push(report.clone());
            if let Some(path) = checkpoint {
                self.save(path)?;
            }
            if observer.epoch(&report, self.ema.model())?.is_break() {
                return Ok(Ended::Interrupted);
            }
        }
        Ok(Ended::Finished)
    }

    fn best(&self) -> Option<(usize, f64)> {
        let best = |best: Option<(usize, f64)>, report: &EpochReport| match best {
            Some((_, fitness)) if fitness >= report.validation.fitness => best,
            _ => Some((report.epoch, report.validation.fitness)),
        };
        self.history.iter().fold(None, best)
    }

    fn is_patience_over(&self) -> bool {
        self.best().is_some_and(|(epoch, _)| self.history.len() > epoch + self.options.patience)
    }

    /// The gradients of batches of one step, each on a device of its own, in their order.
    fn gradients(&self, batches: Vec<T::Batch>) -> Vec<Computed> {
        let (task, home) = (&self.task, &self.device);
        let share = 1.0 / self.options.accumulate.max(1) as f32;
        let mut batches = batches.into_iter();
        let first = batches.next();
        thread::scope(|scope| {
            let elsewhere = batches.zip(&self.others).map(|(batch, device)| {
                // Copies with running statistics of their own.
                let model = self.model.valid().train().fork(device);
                scope.spawn(move || {
                    let mut computed = Computed::new(task, &model, batch, device, share);
                    computed.gradients = computed.gradients.to_device(home, &model);
                    computed
                })
            });
            let elsewhere: Vec<_> = elsewhere.collect();
            let here = first.map(|b| Computed::new(task, &self.model, b, home, share));
            let joined = elsewhere.into_iter().map(|thread| match thread.join() {
                Ok(computed) => computed,
                Err(panic) => resume_unwind(panic),
            });
            here.into_iter().chain(joined).collect()
        })
    }

    fn epoch(
        &mut self,
        observer: &mut impl Observer<T::Model>,
    ) -> Result<Option<EpochReport>, TrainError> {
        let epoch = self.history.len();
        let data = |source: T::Error| TrainError::Data { epoch, source: Box::new(source) };
        let steps = self.task.steps();
        let fresh = || Begun {
            steps: 0,
            samples: 0,
            sums: vec![0.0; T::PARTS.len() + 1],
            lr: self.options.lr_at(epoch as f64),
        };
        let Begun { steps: mut seen, mut samples, mut sums, mut lr } =
            self.begun.take().unwrap_or_else(fresh);
        let mut gathered = GradientsAccumulator::new();
        let mut waiting = 0;
        let mut ends = false;
        let accumulate = self.options.accumulate.max(1);
        let mut batches = self.task.batches(epoch, seen).map_err(data)?;
        loop {
            let together = (accumulate - waiting).min(1 + self.others.len());
            let group = batches.by_ref().take(together).collect::<Result<Vec<_>, _>>();
            let computed = self.gradients(group.map_err(data)?);
            if computed.is_empty() {
                break;
            }
            for Computed { loss: value, parts, samples: count, gradients } in computed {
                let step = seen;
                lr = self.options.lr_at(epoch as f64 + (step + 1) as f64 / steps.max(1) as f64);
                if !value.is_finite() {
                    return Err(TrainError::Diverged { epoch, step, loss: value, lr });
                }
                gathered.accumulate(&self.model, gradients);
                waiting += 1;
                seen += 1;
                samples += count;
                let mut gradient = None;
                if waiting == accumulate || seen == steps {
                    let mut gradients = gathered.grads();
                    let norm = clip_norm(&self.model, &mut gradients, self.options.clip);
                    if !norm.is_finite() {
                        return Err(TrainError::Diverged { epoch, step, loss: value, lr });
                    }
                    gradient = Some(norm);
                    self.model = self.optimizer.step(lr, self.model.clone(), gradients);
                    self.ema.update(&self.model.valid());
                    waiting = 0;
                }
                for (sum, part) in sums.iter_mut().zip([value].iter().chain(&parts)) {
                    *sum += f64::from(*part) * count as f64;
                }
                let report =
                    StepReport { epoch, step, steps, loss: value, parts: &parts, lr, gradient };
                ends |= observer.step(&report).is_break();
            }
            if ends && waiting == 0 {
                self.begun = Some(Begun { steps: seen, samples, sums, lr });
                return Ok(None);
            }
        }
        if seen == 0 {
            return Err(TrainError::Empty { epoch });
        }
        // A loss that was still finite may have been the last one.
        let average = tensors(self.ema.model());
        let average = average.map_err(|source| TrainError::Weights { epoch, source })?;
        let broken =
            |tensor: &weights::Tensor| tensor.data().iter().any(|value| !value.is_finite());
        if let Some((name, _)) = average.into_iter().find(|(_, tensor)| broken(tensor)) {
            return Err(TrainError::NotFinite { epoch, name });
        }
        let validation = self.task.validate(self.ema.model()).map_err(data)?;
        let mut means = sums.into_iter().map(|sum| sum / samples.max(1) as f64);
        let best = self.best().is_none_or(|(_, fitness)| validation.fitness > fitness);
        let loss = means.next().unwrap_or_default();
        Ok(Some(EpochReport { epoch, loss, parts: means.collect(), lr, validation, best }))
    }
}
