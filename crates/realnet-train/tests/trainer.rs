//! A small training: it learns, and goes on to the same result after a stop.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use realnet_train::names::tensors;
use realnet_train::nets::block::{Activation, ConvBlock, Kernel, Normalisation};
use realnet_train::optim::{Optimizer, Schedule};
use realnet_train::trainer::{
    CheckpointError, Ended, EpochReport, Figures, Loss, Observer, StepReport, Task, TrainError,
    TrainOptions, Trainer,
};
use std::convert::Infallible;
use std::ops::ControlFlow;

/// Brightness of a picture of 8x8 pixels.
#[derive(Module, Debug)]
struct Net {
    first: ConvBlock,
    last: ConvBlock,
}

impl Net {
    fn new(device: &Device) -> Self {
        let block = |channels, kernel, activation| {
            ConvBlock::new(channels, kernel, Normalisation::PYTORCH, activation, device)
        };
        Self {
            first: block([1, 4], Kernel::HALVE, Activation::Silu),
            last: block([4, 1], Kernel::POINT, Activation::Identity),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<1> {
        let [batch, ..] = x.dims();
        self.last.forward(self.first.forward(x)).reshape([batch, 16]).mean_dim(1).reshape([batch])
    }
}

#[derive(Default)]
struct Brightness {
    diverges: bool,
    never_better: bool,
    /// All batches are the first one.
    same: bool,
}

/// Pictures and how bright they are.
fn batch(epoch: usize, step: usize) -> (Vec<f32>, Vec<f32>) {
    let wanted: Vec<f32> = (0..4).map(|i| ((epoch * 7 + step * 3 + i) % 5) as f32 - 2.0).collect();
    let pictures =
        wanted.iter().flat_map(|bright| (0..64).map(move |p| bright + 0.1 * (p % 3) as f32));
    (pictures.collect(), wanted)
}

impl Task for Brightness {
    type Model = Net;
    type Batch = (Vec<f32>, Vec<f32>);
    type Error = Infallible;

    const IS_MEAN: bool = true;
    const PARTS: &'static [&'static str] = &["square"];

    fn batches(
        &self,
        epoch: usize,
        first: usize,
    ) -> Result<impl Iterator<Item = Result<Self::Batch, Infallible>>, Infallible> {
        let same = self.same;
        Ok((first..5).map(move |step| Ok(if same { batch(0, 0) } else { batch(epoch, step) })))
    }

    fn steps(&self) -> usize {
        5
    }

    fn loss(&self, model: &Net, (x, y): Self::Batch, device: &Device) -> Loss {
        let x = Tensor::from_data(TensorData::new(x, [4, 1, 8, 8]), device);
        let y = Tensor::<1>::from_data(TensorData::new(y, [4]), device);
        let scale = if self.diverges { f32::NAN } else { 1.0 };
        let total = (model.forward(x) - y).square().mean() * scale;
        let parts = vec![total.clone().into_scalar()];
        Loss { total, parts, samples: 4 }
    }

    fn validate(&self, model: &Net) -> Result<Figures, Infallible> {
        let (x, y) = batch(100, 0);
        let device = Device::flex();
        let x = Tensor::from_data(TensorData::new(x, [4, 1, 8, 8]), &device);
        let y = Tensor::<1>::from_data(TensorData::new(y, [4]), &device);
        let error: f32 = (model.forward(x) - y).square().mean().into_scalar();
        let figures = vec![("error".to_owned(), f64::from(error))];
        let fitness = if self.never_better { 0.5 } else { -f64::from(error) };
        Ok(Figures { figures, fitness })
    }
}

/// Ends after so many epochs or steps.
struct Until {
    epochs: usize,
    steps: usize,
    reports: Vec<EpochReport>,
}

const fn never() -> Until {
    Until { epochs: usize::MAX, steps: usize::MAX, reports: Vec::new() }
}

impl Observer<Net> for Until {
    fn step(&mut self, report: &StepReport<'_>) -> ControlFlow<()> {
        assert!(report.loss.is_finite() && report.steps == 5 && report.parts.len() == 1);
        let steps = report.epoch * report.steps + report.step + 1;
        if steps >= self.steps { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn epoch(&mut self, report: &EpochReport, _: &Net) -> Result<ControlFlow<()>, TrainError> {
        self.reports.push(report.clone());
        let over = report.epoch + 1 >= self.epochs;
        Ok(if over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    }
}

fn device() -> Device {
    Device::flex().autodiff()
}

/// The same weights each time, whatever other tests draw.
fn net() -> Net {
    let net = Net::new(&device());
    let mut weights = tensors(&net).unwrap();
    for (name, tensor) in &mut weights {
        let values: Vec<f32> = (0..tensor.data().len())
            .map(|i| match name.as_str() {
                n if n.ends_with("conv.weight") => ((i * 37 % 11) as f32 - 5.0) / 10.0,
                n if n.ends_with("bn.weight") || n.ends_with("var") => 1.0,
                _ => 0.0,
            })
            .collect();
        *tensor = realnet_nn::weights::Tensor::new(tensor.shape().to_vec(), values).unwrap();
    }
    realnet_train::names::take_all(net, &weights).unwrap()
}

fn options(optimizer: Optimizer) -> TrainOptions {
    TrainOptions {
        epochs: 6,
        optimizer,
        lr: 0.05,
        warmup_epochs: 1.0,
        schedule: Schedule::Cosine,
        accumulate: 2,
        ema: [0.9, 2.0],
        clip: 0.0,
        ..TrainOptions::default()
    }
}

fn trainer(optimizer: Optimizer) -> Trainer<Brightness> {
    Trainer::new(Brightness::default(), net(), options(optimizer), device())
}

#[test]
fn a_stopped_training_goes_on_to_the_same_result() {
    let folder = tempfile::tempdir().unwrap();
    for optimizer in
        [Optimizer::Sgd { momentum: 0.9 }, Optimizer::AdamW { beta_1: 0.9, beta_2: 0.999 }]
    {
        let mut whole = trainer(optimizer);
        assert_eq!(whole.run(None, &mut never()).unwrap(), Ended::Finished);
        let losses: Vec<f64> = whole.history().iter().map(|report| report.loss).collect();
        assert!(losses[5] < 0.5 * losses[0], "{losses:?}");

        let path = folder.path().join("last.ckpt");
        let mut half = trainer(optimizer);
        let mut observer = Until { epochs: 3, ..never() };
        assert_eq!(half.run(Some(&path), &mut observer).unwrap(), Ended::Interrupted);
        // Inside the next epoch, between two batches that are one step: the second one is
        // still made.
        let mut observer = Until { steps: 18, ..never() };
        assert_eq!(half.run(Some(&path), &mut observer).unwrap(), Ended::Interrupted);
        assert_eq!((half.history().len(), half.steps_begun()), (3, 4));
        let task = Brightness::default();
        let mut resumed =
            Trainer::resume(task, Net::new(&device()), options(optimizer), device(), &path)
                .unwrap();
        assert_eq!((resumed.history().len(), resumed.steps_begun()), (3, 4));
        assert_eq!(resumed.run(Some(&path), &mut never()).unwrap(), Ended::Finished);
        assert_eq!(resumed.history(), whole.history());
        let weights = |trainer: &Trainer<Brightness>| {
            (tensors(&trainer.model().valid()).unwrap(), tensors(trainer.average()).unwrap())
        };
        assert_eq!(weights(&resumed), weights(&whole));
    }
}

/// Of a mean the gradients of batches that are added up are a mean: the same steps as of
/// single batches of the same samples.
#[test]
fn added_up_batches_are_one_large_one() {
    let gradients = |accumulate: usize| {
        let options =
            TrainOptions { accumulate, epochs: 1, ..options(Optimizer::Sgd { momentum: 0.9 }) };
        let task = Brightness { same: true, ..Brightness::default() };
        let mut norms = Norms::default();
        // No step moves anything, so that the gradients stay comparable.
        let options = TrainOptions { lr: 1e-12, weight_decay: 0.0, ..options };
        Trainer::new(task, net(), options, device()).run(None, &mut norms).unwrap();
        norms.0
    };
    let (single, double) = (gradients(1), gradients(2));
    assert_eq!((single.len(), double.len()), (5, 3));
    for norm in &double[..2] {
        assert!((norm - single[0]).abs() < 1e-5 * single[0], "{double:?}, {single:?}");
    }
    // What is left over at the end of an epoch counts as what it is.
    assert!((double[2] - single[0] / 2.0).abs() < 1e-5 * single[0], "{double:?}, {single:?}");
}

/// The batches of a step on three devices at once: the same sums in the same order.
#[test]
fn several_devices_come_to_the_same_weights() {
    for (accumulate, others) in [(4, 2), (3, 2), (2, 1), (1, 3)] {
        let options = TrainOptions { accumulate, ..options(Optimizer::Sgd { momentum: 0.9 }) };
        let trained = |others: Vec<Device>| {
            let task = Brightness::default();
            let trainer = Trainer::new(task, net(), options.clone(), device());
            let mut trainer = trainer.with_devices(others);
            assert_eq!(trainer.run(None, &mut never()).unwrap(), Ended::Finished);
            let losses: Vec<f64> = trainer.history().iter().map(|report| report.loss).collect();
            let weights = tensors(&trainer.model().valid()).unwrap();
            let (running, learned): (Vec<_>, Vec<_>) =
                weights.into_iter().partition(|(name, _)| name.contains("running"));
            (losses, learned, running)
        };
        let alone = trained(Vec::new());
        let together = trained((0..others).map(|_| device()).collect());
        assert_eq!((&alone.0, &alone.1), (&together.0, &together.1), "{accumulate} on {others}");
        // Those of the first device's batches; all of them where a step is one batch.
        assert_eq!(alone.2 == together.2, accumulate == 1);
    }
}

/// Keeps the norms of the gradients.
#[derive(Default)]
struct Norms(Vec<f64>);

impl Observer<Net> for Norms {
    fn step(&mut self, report: &StepReport<'_>) -> ControlFlow<()> {
        self.0.extend(report.gradient);
        ControlFlow::Continue(())
    }

    fn epoch(&mut self, _: &EpochReport, _: &Net) -> Result<ControlFlow<()>, TrainError> {
        Ok(ControlFlow::Continue(()))
    }
}

#[test]
fn patience_ends_and_a_loss_that_is_no_number_is_an_error() {
    let patient = TrainOptions { patience: 2, ..options(Optimizer::Sgd { momentum: 0.0 }) };
    let task = Brightness { never_better: true, ..Brightness::default() };
    let mut trainer = Trainer::new(task, net(), patient, device());
    assert_eq!(trainer.run(None, &mut never()).unwrap(), Ended::Patience);
    let best: Vec<bool> = trainer.history().iter().map(|report| report.best).collect();
    assert_eq!(best, [true, false, false]);

    let options = options(Optimizer::Sgd { momentum: 0.0 });
    let mut trainer = Trainer::new(
        Brightness { diverges: true, ..Brightness::default() },
        net(),
        options.clone(),
        device(),
    );
    match trainer.run(None, &mut never()) {
        Err(TrainError::Diverged { epoch: 0, step: 0, loss, .. }) => assert!(loss.is_nan()),
        other => panic!("{other:?}"),
    }
    // The only update comes after the last loss of the epoch.
    let options = TrainOptions { lr: 1e39, warmup_epochs: 0.0, accumulate: 5, ..options };
    let mut trainer = Trainer::new(Brightness::default(), net(), options, device());
    match trainer.run(None, &mut never()) {
        Err(TrainError::NotFinite { epoch: 0, name }) => assert!(name.contains("first"), "{name}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn files_that_are_no_checkpoint_of_this_training() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("last.ckpt");
    let sgd = Optimizer::Sgd { momentum: 0.9 };
    let resume = |options| {
        let task = Brightness::default();
        Trainer::resume(task, Net::new(&device()), options, device(), &path).map(|_| ())
    };
    assert!(matches!(resume(options(sgd)), Err(CheckpointError::Read { .. })));
    trainer(sgd).save(&path).unwrap();
    resume(options(sgd)).unwrap();
    let other = TrainOptions { lr: 0.2, ..options(sgd) };
    let error = resume(other).unwrap_err().to_string();
    assert!(error.contains("lr 0.05, now it is 0.2"), "{error}");
    let whole = std::fs::read(&path).unwrap();
    for cut in [0, 7, 12, 40, whole.len() / 2, whole.len() - 1] {
        std::fs::write(&path, &whole[..cut]).unwrap();
        let error = resume(options(sgd)).unwrap_err();
        assert!(matches!(error, CheckpointError::Format { .. }), "{cut}: {error}");
    }
}
