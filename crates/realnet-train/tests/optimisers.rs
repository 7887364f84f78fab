//! Steps, averages and schedules against PyTorch's and the reference trainer's, see
//! data/README.md.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod common;

use burn::module::Module;
use burn::nn::conv::Conv2d;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};
use common::{File, close};
use realnet_nn::weights;
use realnet_train::names::{Tensors, take_all, tensors};
use realnet_train::nets::block::{Activation, ConvBlock, Kernel, Normalisation, convolution};
use realnet_train::optim::{Ema, Optimizer, Schedule, clip_norm};

#[derive(Module, Debug)]
struct Toy {
    first: ConvBlock,
    last: Conv2d,
}

impl Toy {
    fn new(device: &Device) -> Self {
        let (norm, silu) = (Normalisation::YOLOV5, Activation::Silu);
        Self {
            first: ConvBlock::new([3, 4], Kernel::THREE, norm, silu, device),
            last: convolution([4, 2], Kernel::POINT).init(device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.last.forward(self.first.forward(x))
    }
}

/// The reference's names are numbers.
fn theirs(name: &str) -> String {
    name.replace("first.", "0.").replace("last.", "1.")
}

/// All but the running variance, which PyTorch keeps unbiased and burn biased.
fn compare(what: &str, own: &Tensors, file: &File, prefix: &str) {
    for (name, tensor) in own.iter().filter(|(name, _)| !name.ends_with("running_var")) {
        let expected = file.numbers(&format!("{prefix}.{}", theirs(name)));
        let found: Vec<f64> = tensor.data().iter().map(|v| f64::from(*v)).collect();
        close(&format!("{what} {name}"), &found, &expected, 2e-6, 2e-5);
    }
}

#[test]
fn three_steps_are_pytorchs() {
    let file = File::open("optimiser.safetensors");
    let device = Device::flex().autodiff();
    let input = |name: &str, step: usize, channels: usize| {
        let count = 4 * channels * 64;
        let all = file.numbers(name);
        let values = all[step * count..(step + 1) * count].iter().map(|v| *v as f32);
        let data = TensorData::new(values.collect::<Vec<f32>>(), [4, channels, 8, 8]);
        Tensor::<4>::from_data(data, &device)
    };
    for run in ["sgd", "sgd_clip", "adamw"] {
        let settings = file.numbers(&format!("{run}.settings"));
        let [rate, momentum, decay, limit, updates] = settings[..] else { panic!("{settings:?}") };
        let optimizer = match run {
            "adamw" => Optimizer::AdamW { beta_1: momentum as f32, beta_2: 0.999 },
            _ => Optimizer::Sgd { momentum },
        };
        let mut optimizer = optimizer.init(decay as f32);
        let net = Toy::new(&device);
        let initial = tensors(&net).unwrap().into_iter().map(|(name, tensor)| {
            let values = file.numbers(&format!("initial.{}", theirs(&name)));
            let values = values.into_iter().map(|v| v as f32).collect();
            (name, weights::Tensor::new(tensor.shape().to_vec(), values).unwrap())
        });
        let mut net = take_all(net, &initial.collect()).unwrap();
        let mut ema = Ema::new(net.valid(), updates as u64, 0.9999, 2000.0);
        for step in 0..3 {
            let wanted = input("y", step, 2);
            let loss = (net.forward(input("x", step, 3)) - wanted).square().mean();
            let value = f64::from(loss.clone().into_scalar::<f32>());
            close(run, &[value], &file.numbers(&format!("{run}.loss"))[step..=step], 0.0, 1e-5);
            let mut gradients = GradientsParams::from_grads(loss.backward(), &net);
            let norm = clip_norm(&net, &mut gradients, limit);
            let expected = file.numbers(&format!("{run}.grad_norm"));
            close(run, &[norm], &expected[step..=step], 0.0, 1e-5);
            net = optimizer.step(rate, net, gradients);
            ema.update(&net.valid());
            let own = tensors(&net.valid()).unwrap();
            compare(run, &own, &file, &format!("{run}.step_{}", step + 1));
        }
        compare(run, &tensors(ema.model()).unwrap(), &file, &format!("{run}.ema"));
    }
}

#[test]
fn schedules_are_the_reference_trainers() {
    let file = File::open("schedule.safetensors");
    let last = file.numbers("long.settings")[4];
    for (name, schedule) in [("cosine", Schedule::Cosine), ("linear", Schedule::Linear)] {
        let own: Vec<f64> = (0..=20).map(|e| schedule.factor(f64::from(e) / 20.0, last)).collect();
        close(name, &own, &file.numbers(&format!("factor.{name}")), 1e-12, 1e-12);
    }
    assert_eq!(Schedule::Step.factor(0.7, last), 0.1);
}
