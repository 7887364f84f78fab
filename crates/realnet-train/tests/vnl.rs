//! The authors' depth networks in training: the released outputs, the file's, and learning.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod common;

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Distribution, Tensor, TensorData};
use realnet_nn::weights::Checkpoint;
use realnet_train::names::{NamesError, Tensors, tensors};
use realnet_train::nets::{Vnl, VnlBody, VnlConfig};
use realnet_train::optim::Optimizer;

/// A checkpoint of the shared reference values.
fn golden(name: &str) -> Option<Tensors> {
    Some(Checkpoint::from_bytes(&common::golden(&format!("vnl/{name}"))?.0).unwrap().tensors)
}

fn numbers<const D: usize>(tensor: &Tensor<D>) -> Vec<f64> {
    tensor.clone().into_data().try_to_vec::<f32>().unwrap().into_iter().map(f64::from).collect()
}

#[test]
fn logits_are_those_of_the_released_network() {
    let Some(weights) = golden("mobilenetv2_random.safetensors") else { return };
    let Some(values) = golden("mobilenetv2_random_io.safetensors") else { return };
    assert_eq!(VnlConfig::of(&weights), Some(VnlConfig::new(VnlBody::MobileNetV2)));
    let device = Device::flex();
    let net = Vnl::with_weights(&weights, &device).unwrap();
    // All of them, and under these names out again.
    assert_eq!(tensors(&net).unwrap(), weights);

    let input = TensorData::new(values["input"].data().to_vec(), [1, 3, 256, 256]);
    let logits = net.forward(Tensor::from_data(input, &device));
    assert_eq!(logits.dims(), [1, 60, 256, 256]);
    let found = numbers(&logits);
    let expected: Vec<f64> = values["logits_stride32"].data().iter().map(|x| (*x).into()).collect();
    let some: Vec<f64> = (0..expected.len())
        .map(|i| found[((i / 64) * 256 + i / 8 % 8 * 32) * 256 + i % 8 * 32])
        .collect();
    common::close("logits", &some, &expected, 1e-4, 1e-4);
    // All pixels, as depth.
    let borders = realnet_nn::depth::DepthCoding::default().log_borders(60);
    let pixels = 256 * 256;
    let depth: Vec<f64> = (0..pixels)
        .map(|pixel| {
            let at = |bin: usize| found[bin * pixels + pixel].exp();
            let total: f64 = (0..60).map(at).sum();
            (borders.iter().enumerate().map(|(bin, b)| at(bin) / total * b).sum::<f64>()).exp()
        })
        .collect();
    let expected: Vec<f64> = values["depth"].data().iter().map(|x| (*x).into()).collect();
    common::close("depth", &depth, &expected, 1e-5, 1e-4);
}
