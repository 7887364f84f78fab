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
use burn::tensor::{Distribution, Tensor, TensorData};
use common::{close, device, noise, numbers, run, spread, worn};
use realnet_nn::depth::{DepthCoding, DepthModel, DepthWeights, Detail};
use realnet_nn::onnx::OnnxOptions;
use realnet_nn::weights::{self, Checkpoint};
use realnet_train::export::{depth_checkpoint, depth_onnx, safetensors};
use realnet_train::names::{NamesError, Tensors, take_all, tensors};
use realnet_train::nets::{Vnl, VnlBody, VnlConfig};
use realnet_train::optim::Optimizer;

/// A checkpoint of the shared reference values.
fn golden(name: &str) -> Option<Tensors> {
    Some(Checkpoint::from_bytes(&common::golden(&format!("vnl/{name}"))?.0).unwrap().tensors)
}

#[test]
fn logits_are_those_of_the_released_network() {
    let Some(weights) = golden("mobilenetv2_random.safetensors") else { return };
    let Some(values) = golden("mobilenetv2_random_io.safetensors") else { return };
    assert_eq!(VnlConfig::of(&weights), Some(VnlConfig::new(VnlBody::MobileNetV2)));
    let device = device();
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
    close("logits", &some, &expected, 1e-4, 1e-4);
    // All pixels, as depth.
    let borders = DepthCoding::default().log_borders(60);
    let pixels = 256 * 256;
    let depth: Vec<f64> = (0..pixels)
        .map(|pixel| {
            let at = |bin: usize| found[bin * pixels + pixel].exp();
            let total: f64 = (0..60).map(at).sum();
            (borders.iter().enumerate().map(|(bin, b)| at(bin) / total * b).sum::<f64>()).exp()
        })
        .collect();
    let expected: Vec<f64> = values["depth"].data().iter().map(|x| (*x).into()).collect();
    close("depth", &depth, &expected, 1e-5, 1e-4);
}

/// Numbers from 0 to 1 by the formula of `data/README.md`.
fn units(name: &str, count: usize) -> impl Iterator<Item = f64> {
    let seed = name.bytes().fold(7u32, |h, b| h.wrapping_mul(31) ^ u32::from(b));
    (0..count as u32).map(move |i| {
        let x = i.wrapping_mul(2_654_435_761).wrapping_add(seed);
        let x = (x ^ (x >> 16)).wrapping_mul(0x85EB_CA6B);
        let x = (x ^ (x >> 13)).wrapping_mul(0xC2B2_AE35);
        f64::from(x ^ (x >> 16)) / 2f64.powi(32)
    })
}

/// Weights by the same formula for all the network has.
fn formula(net: &Vnl) -> Tensors {
    let weights = tensors(net).unwrap().into_iter().map(|(name, old)| {
        let shape = old.shape().to_vec();
        let [least, width] = match name.rsplit('.').next().unwrap() {
            "running_var" => [0.5, 1.0],
            "running_mean" | "bias" => [-0.2, 0.4],
            _ if shape.len() == 1 => [0.8, 0.6],
            _ => {
                let most = (2.0 / shape[1..].iter().product::<usize>() as f64).sqrt();
                [-most, 2.0 * most]
            }
        };
        let units = units(&name, old.data().len());
        let values = units.map(|unit| (least + width * unit) as f32).collect();
        (name, weights::Tensor::new(shape, values).unwrap())
    });
    weights.collect()
}

/// The released code on weights of a formula, which has a value for every name it knows:
/// layers, dilations, epsilons and names are the same.
#[test]
fn resnext_networks_are_the_released_ones() {
    let file = common::File::open("vnl_network.safetensors");
    let (width, height, every) = (80, 64, 11);
    for (body, name, bins) in
        [(VnlBody::ResNext50, "resnext50", 150), (VnlBody::ResNext101, "resnext101", 100)]
    {
        let net = Vnl::new(&VnlConfig { body, bins }, &device());
        let net = take_all(net.clone(), &formula(&net)).unwrap();
        let pixels = units("image", 3 * width * height).map(|unit| (4.0 * unit - 2.0) as f32);
        let image = TensorData::new(pixels.collect::<Vec<f32>>(), [1, 3, height, width]);
        let found = numbers(&net.forward(Tensor::from_data(image, &device())));
        let some = found.iter().enumerate().filter(|(index, _)| {
            (index / width % height).is_multiple_of(every) && (index % width).is_multiple_of(every)
        });
        let some: Vec<f64> = some.map(|(_, value)| *value).collect();
        let expected = file.numbers(name);
        assert!(spread(&expected, 48) > 0.5);
        close(name, &some, &expected, 1e-4, 1e-4);
    }
}

/// Logits in training and at run time, of random weights, at a size that is not square.
fn exports_the_same(body: VnlBody, bins: usize, (width, height): (usize, usize)) {
    let config = VnlConfig { body, bins };
    let net = worn(Vnl::new(&config, &device()));
    let coding = DepthCoding { max: 1.2, ..DepthCoding::default() };
    let checkpoint = depth_checkpoint(&net, &coding).unwrap();
    assert_eq!(VnlConfig::of(&checkpoint.tensors), Some(config));
    let bytes = safetensors(&checkpoint).unwrap();
    let weights = DepthWeights::from_checkpoint(&Checkpoint::from_bytes(&bytes).unwrap()).unwrap();
    assert_eq!((weights.architecture(), weights.coding()), ("VNL", &coding));
    let (pixels, image) = noise(width, height);
    let logits = net.forward(image);
    assert_eq!(logits.dims(), [1, bins, height, width]);
    let expected = numbers(&logits);
    let largest = expected.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    let options = OnnxOptions { width, height, half: false };
    let file = depth_onnx(&net, &coding, &options).unwrap();
    let model = DepthModel::from_vec("file", file).unwrap();
    let (network, _) = model.network(None, Detail::Full).unwrap();
    let spread = spread(&expected, width * height);
    println!("{body:?}: logits up to {largest}, planes that span up to {spread}");
    assert!(spread > 0.05, "{spread}");
    close("logits", &run(network, &pixels), &expected, 1e-4 * largest.max(1.0), 0.0);
    // Without a word about it the coding is the authors'.
    let bare = Checkpoint { depth: None, ..checkpoint };
    let authors = if bins == 100 { DepthCoding::KITTI } else { DepthCoding::default() };
    assert_eq!(DepthWeights::from_checkpoint(&bare).unwrap().coding(), &authors);
}

#[test]
fn mobile_networks_are_exported() {
    exports_the_same(VnlBody::MobileNetV2, 60, (96, 64));
}

#[test]
fn resnext_networks_are_exported() {
    exports_the_same(VnlBody::ResNext50, 150, (96, 64));
    exports_the_same(VnlBody::ResNext101, 100, (64, 80));
}

/// Parameters without those of the classifiers: 25.03 and 44.18 million less a layer of
/// 2048 x 1000 and its biases, as published with the weights.
#[test]
fn bodies_have_the_published_size() {
    for (body, parameters) in [(VnlBody::ResNext50, 22_979_904), (VnlBody::ResNext101, 42_128_704)]
    {
        let net = Vnl::new(&VnlConfig::new(body), &device());
        let own = |name: &str| name.starts_with("encoder_modules.bottomup.");
        let learned = |name: &str| !name.contains(".running_");
        let tensors = tensors(&net).unwrap();
        let own = tensors.iter().filter(|(name, _)| own(name) && learned(name));
        assert_eq!(own.map(|(_, tensor)| tensor.data().len()).sum::<usize>(), parameters);
    }
}

#[test]
fn names_with_and_without_the_training_program_fit() {
    let config = VnlConfig { body: VnlBody::MobileNetV2, bins: 7 };
    let own = tensors(&Vnl::new(&config, &device())).unwrap();
    let theirs: Tensors =
        own.iter().map(|(name, t)| (format!("depth_model.{name}"), t.clone())).collect();
    for weights in [&own, &theirs] {
        assert_eq!(VnlConfig::of(weights), Some(config));
        let net = Vnl::with_weights(weights, &device()).unwrap();
        assert_eq!((net.config(), tensors(&net).unwrap()), (&config, own.clone()));
    }
    let mut lacking = theirs.clone();
    lacking.remove("depth_model.decoder_modules.top.1.running_var");
    let error = Vnl::with_weights(&lacking, &device()).unwrap_err();
    assert!(matches!(error, NamesError::Missing { missing: 1, .. }), "{error}");
    // A shape that promises more than there is.
    let mut bad = own;
    let empty = weights::Tensor::new(vec![usize::MAX / 2, 0, 3, 3], Vec::new()).unwrap();
    bad.insert("decoder_modules.topdown_predict.conv1.weight".to_owned(), empty);
    let error = Vnl::with_weights(&bad, &device()).unwrap_err();
    assert!(matches!(error, NamesError::Nothing { .. }), "{error}");
}

#[test]
fn names_of_networks_are_read() {
    for (text, body) in [
        ("vnl-mobilenetv2", VnlBody::MobileNetV2),
        ("vnl-resnext50", VnlBody::ResNext50),
        ("vnl-resnext101", VnlBody::ResNext101),
    ] {
        assert_eq!(text.parse(), Ok(body));
    }
    let error = "vnl".parse::<VnlBody>().unwrap_err().to_string();
    assert!(error.contains("'vnl'") && error.contains("vnl-resnext50"), "{error}");
}

/// All but the biases that batch normalisation takes away again.
fn learns(body: VnlBody) {
    let device = device().autodiff();
    let mut net = Vnl::new(&VnlConfig { body, bins: 8 }, &device);
    let mut optimizer = Optimizer::Sgd { momentum: 0.9 }.init(0.0);
    for _ in 0..2 {
        let before = tensors(&net.valid()).unwrap();
        let image = Tensor::random([4, 3, 32, 32], Distribution::Normal(0.0, 1.0), &device);
        let truth = Tensor::random([4, 8, 32, 32], Distribution::Normal(0.0, 1.0), &device);
        let loss = (net.forward(image) - truth).powf_scalar(2.0).sum();
        let gradients = GradientsParams::from_grads(loss.backward(), &net);
        net = optimizer.step(1e-4, net, gradients);
        for (name, tensor) in tensors(&net.valid()).unwrap() {
            assert!(tensor.data().iter().all(|x| x.is_finite()), "{body:?}: {name}");
            let same = tensor.data() == before[&name].data();
            assert!(!same || name.ends_with(".conv2.bias"), "{body:?}: {name}");
        }
    }
}

#[test]
fn every_parameter_is_learned_step_after_step() {
    learns(VnlBody::MobileNetV2);
    learns(VnlBody::ResNext50);
}
