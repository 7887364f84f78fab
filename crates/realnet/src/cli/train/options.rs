//! How it is learned: options of every training.

use super::device::{self, DeviceFlag};
use crate::cli::failure::bad_input;
use anyhow::Result;
use burn::tensor::Device;
use clap::{Args, ValueEnum};
use realnet_data::{LoaderOptions, SetOptions};
use realnet_train::{
    optim::{Optimizer, Schedule},
    trainer::TrainOptions,
};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Where a run reads and writes. None of it changes the result.
#[derive(Debug, Args)]
#[command(next_help_heading = "Run")]
pub(super) struct RunArgs {
    /// A TOML file with options, such as another run's args.toml; the command line wins.
    #[arg(long, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// The folder of the results [default: runs/detect, runs/depth].
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,
    /// Go on with a run: its folder or its last.ckpt [default: the folder of --out].
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with_all = ["config", "overwrite", "sheet"]
    )]
    pub(super) resume: Option<Option<PathBuf>>,
    /// Replace the run that the folder holds.
    #[arg(long)]
    pub(super) overwrite: bool,
    /// Draw augmented samples with their labels into this picture, and end.
    #[arg(long, value_name = "FILE.png", conflicts_with = "overwrite")]
    pub(super) sheet: Option<PathBuf>,
    /// Samples of that picture.
    #[arg(long, value_name = "N", default_value_t = 16, requires = "sheet")]
    pub(super) sheet_count: usize,
    /// A change of the samples, as mosaic=0.5; may be given more than once. An unknown KEY
    /// lists all.
    #[arg(long, value_name = "KEY=VALUE")]
    pub(super) augment: Vec<String>,
    /// One JSON object an epoch on standard output, and nothing else there.
    #[arg(long)]
    pub(super) json: bool,
}

/// The options of the trainer, by the names of YOLOv5's where it has them.
#[derive(Clone, Debug, PartialEq, Args, Serialize, Deserialize)]
#[command(next_help_heading = "Training")]
pub(super) struct LearnArgs {
    /// Times that all samples are seen.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub(super) epochs: usize,
    /// Samples of a batch.
    #[arg(long, value_name = "N", default_value_t = 16)]
    pub(super) batch: usize,
    /// Batches whose gradients are added up to one step [default: one a device].
    #[arg(long, value_name = "N")]
    pub(super) accumulate: Option<usize>,
    /// How gradients become steps.
    #[arg(long, value_enum, default_value_t = OptimizerFlag::Sgd)]
    pub(super) optimizer: OptimizerFlag,
    /// First learning rate, after the warm-up [default: 0.01 for sgd, 0.001 for adamw].
    #[arg(long, value_name = "RATE")]
    pub(super) lr: Option<f64>,
    /// Share of it that is left at the end.
    #[arg(long, value_name = "SHARE", default_value_t = 0.01)]
    pub(super) lr_last: f64,
    /// The way between; step is a tenth at 2/3 and again at 8/9 of the epochs.
    #[arg(long, value_enum, default_value_t = ScheduleFlag::Cosine)]
    pub(super) schedule: ScheduleFlag,
    /// Epochs in which the learning rate rises.
    #[arg(long, value_name = "EPOCHS", default_value_t = 3.0)]
    pub(super) warmup_epochs: f64,
    /// Momentum of sgd, first beta of adamw [default: 0.937 for sgd, 0.9 for adamw].
    #[arg(long, value_name = "SHARE")]
    pub(super) momentum: Option<f64>,
    /// Decay of the weights of convolutions [default: 0.0005 for sgd, 0.02 for adamw]; for sgd
    /// it is that of steps of 64 samples, and smaller steps decay less, as in YOLOv5.
    #[arg(long, value_name = "DECAY")]
    pub(super) weight_decay: Option<f64>,
    /// Largest norm of the gradients; 0 for any.
    #[arg(long, value_name = "NORM", default_value_t = 10.0)]
    pub(super) clip: f64,
    /// Decay of the moving average of the weights, which is what is kept.
    #[arg(long, value_name = "DECAY", default_value_t = 0.9999)]
    pub(super) ema: f64,
    /// Steps in which that decay grows to 63 % of its value.
    #[arg(long, value_name = "STEPS", default_value_t = 2000.0)]
    pub(super) ema_ramp: f64,
    /// Epochs without a better network after which it ends.
    #[arg(long, value_name = "EPOCHS", default_value_t = 100)]
    pub(super) patience: usize,
    /// Where all randomness comes from.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(super) seed: u32,
    /// What computes: cpu, cuda:N or wgpu:N (programs built for it); several, separated by
    /// commas, divide the batches of a step among them.
    #[arg(long, value_name = "DEVICES", value_delimiter = ',', default_value = "cpu")]
    pub(super) device: Vec<DeviceFlag>,
    /// Threads that make samples; 0 for one a core. The result does not depend on it.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(super) workers: usize,
    /// Pictures of train, and of val, that are kept decoded in memory, GB each; the rest is
    /// decoded each time.
    #[arg(long, value_name = "GB", default_value_t = 2.0)]
    pub(super) cache: f64,
}

/// Samples of a step that the weight decay of sgd is meant for.
const NOMINAL_BATCH: f64 = 64.0;

/// Fields that may change when a run goes on.
pub(super) const MAY_CHANGE: [&str; 5] = ["device", "epochs", "patience", "workers", "cache"];

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum OptimizerFlag {
    /// Stochastic gradient descent with Nesterov's momentum.
    Sgd,
    /// Adam with decoupled weight decay.
    Adamw,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum ScheduleFlag {
    Cosine,
    Linear,
    Step,
}

/// Refuses a number that is outside of its range.
pub(super) fn check(name: &str, value: f64, ok: bool, range: &str) -> Result<()> {
    if ok && value.is_finite() {
        return Ok(());
    }
    Err(bad_input(format!("{name} is {value}, it must be {range}")))
}

impl LearnArgs {
    /// Fills in what depends on other options, and refuses what cannot be.
    pub(super) fn resolve(&mut self) -> Result<()> {
        let sgd = self.optimizer == OptimizerFlag::Sgd;
        self.lr.get_or_insert(if sgd { 0.01 } else { 1e-3 });
        self.momentum.get_or_insert(if sgd { 0.937 } else { 0.9 });
        self.weight_decay.get_or_insert(if sgd { 5e-4 } else { 0.02 });
        let whole = |name, value: usize, most: usize| {
            check(name, value as f64, (1..=most).contains(&value), &format!("from 1 to {most}"))
        };
        whole("epochs", self.epochs, 1_000_000)?;
        whole("batch", self.batch, 4096)?;
        let devices = self.device.len();
        let accumulate = *self.accumulate.get_or_insert(devices);
        let ok = (1..=4096).contains(&accumulate) && accumulate.is_multiple_of(devices.max(1));
        let range = format!("from 1 to 4096, as many for each of the {devices} devices");
        check("accumulate", accumulate as f64, ok, &range)?;
        whole("patience", self.patience, 1_000_000)?;
        check("workers", self.workers as f64, self.workers <= 1024, "from 0 to 1024")?;
        let share = |name, value: f64| {
            check(name, value, (0.0..1.0).contains(&value), "at least 0 and below 1")
        };
        let options = self.options();
        check("lr", options.lr, options.lr > 0.0 && options.lr <= 10.0, "above 0, at most 10")?;
        let last = self.lr_last;
        check("lr_last", last, last > 0.0 && last <= 1.0, "above 0, at most 1")?;
        share("momentum", self.momentum.unwrap_or_default())?;
        share("weight_decay", self.weight_decay.unwrap_or_default())?;
        share("ema", self.ema)?;
        check("ema_ramp", self.ema_ramp, self.ema_ramp > 0.0, "above 0")?;
        check("clip", self.clip, self.clip >= 0.0, "0 or more")?;
        check("cache", self.cache, (0.0..=1e6).contains(&self.cache), "from 0 to 1000000 GB")?;
        let warmup = self.warmup_epochs;
        check("warmup_epochs", warmup, warmup >= 0.0, "0 or more")
    }

    /// For the trainer.
    pub(super) fn options(&self) -> TrainOptions {
        let momentum = self.momentum.unwrap_or(0.9);
        let accumulate = self.accumulate.unwrap_or(1);
        let nominal = match self.optimizer {
            OptimizerFlag::Sgd => (self.batch * accumulate) as f64 / NOMINAL_BATCH,
            OptimizerFlag::Adamw => 1.0,
        };
        TrainOptions {
            epochs: self.epochs,
            accumulate,
            optimizer: match self.optimizer {
                OptimizerFlag::Sgd => Optimizer::Sgd { momentum },
                OptimizerFlag::Adamw => Optimizer::AdamW { beta_1: momentum as f32, beta_2: 0.999 },
            },
            weight_decay: (self.weight_decay.unwrap_or_default() * nominal) as f32,
            lr: self.lr.unwrap_or_default(),
            lr_last: self.lr_last,
            schedule: match self.schedule {
                ScheduleFlag::Cosine => Schedule::Cosine,
                ScheduleFlag::Linear => Schedule::Linear,
                ScheduleFlag::Step => Schedule::Step,
            },
            warmup_epochs: self.warmup_epochs,
            clip: self.clip,
            ema: [self.ema, self.ema_ramp],
            patience: self.patience,
            seed: u64::from(self.seed),
        }
    }

    /// The first device, and the others.
    pub(super) fn devices(&self) -> Result<(Device, Vec<Device>)> {
        device::start(&self.device, self.seed)
    }

    /// What computes, in words.
    pub(super) fn devices_in_words(&self) -> String {
        let names: Vec<_> = self.device.iter().map(ToString::to_string).collect();
        let accumulate = self.accumulate.unwrap_or(1);
        let step = match accumulate {
            1 => String::new(),
            _ => format!(", a step is {accumulate} batches of {}", self.batch),
        };
        format!("{}{step}", names.join(","))
    }

    /// How the data are read.
    pub(super) fn set(&self) -> SetOptions {
        let cache_bytes = (self.cache * 1e9) as usize;
        SetOptions { threads: self.workers, cache_bytes, ..SetOptions::default() }
    }

    /// How they become batches of training.
    pub(super) fn loader(&self) -> LoaderOptions {
        LoaderOptions {
            batch: self.batch,
            threads: self.workers,
            shuffle: Some(u64::from(self.seed)),
            ..LoaderOptions::default()
        }
    }
}
