//! Seconds a training step of YOLOv5n takes: in the trainer, with mosaics made meanwhile, or
//! in a bare loop over one batch that is there. `bench/peers/train/speed.py` runs both, and
//! PyTorch, by turns.
//!
//! ```text
//! training_speed bare|trainer [BATCH] [SIZE] [STEPS]
//! ```
#![allow(clippy::print_stdout)]

use burn::optim::GradientsParams;
use burn::tensor::{Device, Distribution, Tensor};
use realnet_core::{Frame, Stamp};
use realnet_data::{
    DetectionAugment, DetectionSamples, DetectionSet, Loader, LoaderOptions, Target,
};
use realnet_nn::engine::{EngineChoice, Runtime, RuntimeOptions};
use realnet_train::loss::{self, DetectionLoss, DetectionLossOptions};
use realnet_train::nets::{YoloV5, YoloV5Config, YoloV5Size};
use realnet_train::optim::Optimizer;
use realnet_train::tasks::DetectionTask;
use realnet_train::trainer::{
    EpochReport, Observer, StepReport, TrainError, TrainOptions, Trainer,
};
use std::error::Error;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

/// Steps that are not counted: memory is not there yet.
const WARM_UP: usize = 2;

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let mode = words.next().unwrap_or_default();
    let mut number = |default: usize| words.next().map_or(Ok(default), |word| word.parse());
    let (batch, size, steps) = (number(8)?, number(320)?, number(20)?);
    let config = YoloV5Config::new(YoloV5Size::N, 1, size);
    let device = Device::flex().autodiff();
    device.seed(0);
    let net = YoloV5::new(&config, &device);
    let loss = DetectionLoss::new(&config, DetectionLossOptions::default());
    let times = match mode.as_str() {
        "bare" => bare(net, &loss, &device, [batch, size, steps]),
        "trainer" => trainer(net, loss, device, [batch, size, steps])?,
        other => return Err(format!("'{other}' is neither bare nor trainer").into()),
    };
    println!("{}", times.iter().sum::<f64>() / times.len().max(1) as f64);
    Ok(())
}

/// Forward, loss, backward and step, and nothing else.
fn bare(
    mut net: YoloV5,
    loss: &DetectionLoss,
    device: &Device,
    [batch, size, steps]: [usize; 3],
) -> Vec<f64> {
    let mut optimizer = Optimizer::Sgd { momentum: 0.937 }.init(5e-4);
    let image: Tensor<4> =
        Tensor::random([batch, 3, size, size], Distribution::Uniform(0.0, 1.0), device);
    // As many as a mosaic of pictures with one object has.
    let targets: Vec<loss::Target> = (0..4 * batch)
        .map(|i| loss::Target {
            image: i / 4,
            class: 0,
            bbox: [0.2 + 0.2 * (i % 4) as f32, 0.5, 0.15, 0.15],
        })
        .collect();
    let mut times = Vec::new();
    for step in 0..WARM_UP + steps {
        let start = Instant::now();
        let total = loss.of(net.forward(image.clone()), &targets).total();
        let gradients = GradientsParams::from_grads(total.backward(), &net);
        net = optimizer.step(1e-4, net, gradients);
        if step >= WARM_UP {
            times.push(start.elapsed().as_secs_f64());
        }
    }
    times
}

/// As a user's training: mosaics, finite losses, clipping, moving average.
fn trainer(
    net: YoloV5,
    loss: DetectionLoss,
    device: Device,
    [batch, size, steps]: [usize; 3],
) -> Result<Vec<f64>, Box<dyn Error>> {
    let count = (WARM_UP + steps) * batch;
    let side = u32::try_from(size)?;
    let train = Arc::new(drawn(count, side)?);
    let samples = DetectionSamples::training(train, DetectionAugment::default(), 0)?;
    let options = LoaderOptions { batch, shuffle: Some(0), ..Default::default() };
    let loader = Loader::new(Arc::new(samples), options)?;
    let runtime =
        Runtime::start(&RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() });
    let task = DetectionTask::new(loader, loss, Arc::new(drawn(1, side)?), runtime);
    let options = TrainOptions { epochs: 1, lr: 1e-4, warmup_epochs: 0.0, ..Default::default() };
    let mut watch = Watch { last: Instant::now(), times: Vec::new() };
    Trainer::new(task, net, options, device).run(None, &mut watch)?;
    Ok(watch.times.split_off(WARM_UP.min(watch.times.len())))
}

struct Watch {
    last: Instant,
    times: Vec<f64>,
}

impl Observer<YoloV5> for Watch {
    fn step(&mut self, _: &StepReport<'_>) -> ControlFlow<()> {
        self.times.push(self.last.elapsed().as_secs_f64());
        self.last = Instant::now();
        ControlFlow::Continue(())
    }

    fn epoch(&mut self, _: &EpochReport, _: &YoloV5) -> Result<ControlFlow<()>, TrainError> {
        Ok(ControlFlow::Continue(()))
    }
}

/// Pictures as a camera gives them, of noise.
fn drawn(count: usize, size: u32) -> Result<DetectionSet, Box<dyn Error>> {
    let picture = |i: usize| {
        let value = |at: usize| ((at / 3 % 1280 * (i % 16 + 1) + at / 3840 * 3) % 251) as u8;
        let frame = Frame::rgb8(Stamp::ZERO, 1280, 720, (0..1280 * 720 * 3).map(value).collect())?;
        let target = Target { class_id: 0, cx: 0.5, cy: 0.5, w: 0.3, h: 0.3 };
        Ok((frame, vec![target]))
    };
    let pictures = (0..count).map(picture).collect::<Result<Vec<_>, Box<dyn Error>>>()?;
    Ok(DetectionSet::from_memory(vec!["box".to_owned()], pictures, size)?)
}
