//! The networks in training are those at run time.
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
use realnet_core::{Frame, PixelFormat, Stamp};
use realnet_nn::depth::{DepthCoding, DepthModel, Detail};
use realnet_nn::detector::{DetectorModel, DetectorOptions};
use realnet_nn::engine::{EngineChoice, Runtime, RuntimeOptions};
use realnet_nn::onnx::OnnxOptions;
use realnet_nn::weights::Checkpoint;
use realnet_train::export::{
    ExportNetworkError, depth_checkpoint, depth_onnx, detector_checkpoint, detector_onnx,
    safetensors,
};
use realnet_train::loss::{DetectionLoss, DetectionLossOptions, Target};
use realnet_train::names::{NamesError, take, take_all, tensors};
use realnet_train::nets::{Form, VnlLite, VnlLiteConfig, YoloV5, YoloV5Config, YoloV5Size};
use realnet_train::optim::Optimizer;

/// Published numbers of parameters, 80 classes.
#[test]
fn sizes_are_the_published_ones() {
    for (size, millions) in [(YoloV5Size::N, 1.87), (YoloV5Size::S, 7.23)] {
        let net = YoloV5::new(&YoloV5Config::new(size, 80, 640), &device());
        let count = net.num_params() as f64 / 1e6;
        assert!((count - millions).abs() < 0.02 * millions, "{size:?}: {count}");
    }
}

#[test]
fn the_authors_weights_fit_by_name() {
    let Some(checkpoint) = common::weights("yolov5n.pt") else { return };
    let config = YoloV5Config::new(YoloV5Size::N, 80, 640);
    let net = take_all(YoloV5::new(&config, &device()), &checkpoint.tensors).unwrap();
    // And out again.
    let own = tensors(&net).unwrap();
    for (name, tensor) in &own {
        assert_eq!(tensor, &checkpoint.tensors[name], "{name}");
    }
    // For other classes all but the heads.
    let config = YoloV5Config::new(YoloV5Size::N, 1, 640);
    let (_, taken) = take(YoloV5::new(&config, &device()), &checkpoint.tensors).unwrap();
    assert_eq!(taken.reshaped.len(), 6, "{:?}", taken.reshaped);
    assert!(taken.missing.is_empty() && !taken.is_complete());
    // Another size fits nowhere near.
    let config = YoloV5Config::new(YoloV5Size::S, 80, 640);
    let error = take_all(YoloV5::new(&config, &device()), &checkpoint.tensors).unwrap_err();
    assert!(matches!(error, NamesError::Shape { .. } | NamesError::Missing { .. }), "{error}");
}

/// The raw heads of the network in training against the reference output of the whole
/// network, which is these heads decoded.
#[test]
fn outputs_are_the_reference_implementations() {
    let Some(checkpoint) = common::weights("yolov5n.pt") else { return };
    let Some((width, height, pixels)) = common::picture("yolov5n/bus_320_letterbox.png") else {
        return;
    };
    let Some(expected) = common::npy("yolov5n/bus_320_raw.npy") else { return };
    let config = YoloV5Config::new(YoloV5Size::N, 80, 640);
    let net = take_all(YoloV5::new(&config, &device()), &checkpoint.tensors).unwrap();
    let planes: Vec<f32> =
        (0..3).flat_map(|c| pixels.chunks_exact(3).map(move |p| f32::from(p[c]) / 255.0)).collect();
    let image = Tensor::from_data(TensorData::new(planes, [1, 3, height, width]), &device());
    let mut row = 0;
    for (level, head) in net.forward(image).iter().enumerate() {
        let [_, _, rows, columns] = head.dims();
        let values = numbers(&head.clone().reshape([3, 85, rows * columns]).permute([0, 2, 1]));
        let stride = [8.0, 16.0, 32.0][level];
        for (index, cell) in values.chunks_exact(85).enumerate() {
            let anchor = config.anchors[level][index / (rows * columns)].map(f64::from);
            let at = index % (rows * columns);
            let (x, y) = ((at % columns) as f64, (at / columns) as f64);
            let mut out: Vec<f64> = cell.iter().map(|v| 1.0 / (1.0 + (-v).exp())).collect();
            out[0] = (2.0 * out[0] - 0.5 + x) * stride;
            out[1] = (2.0 * out[1] - 0.5 + y) * stride;
            out[2] = (2.0 * out[2]).powi(2) * anchor[0];
            out[3] = (2.0 * out[3]).powi(2) * anchor[1];
            close("output", &out, &expected[row * 85..(row + 1) * 85], 1e-4, 1e-4);
            row += 1;
        }
    }
    assert_eq!(row, 6300);
}

/// Both forms become files that the run time reads, and give the same heads there.
#[test]
fn exported_networks_give_the_same() {
    let names = ["car".to_owned(), "cone".to_owned()];
    for form in [Form::V6, Form::V5] {
        let config = YoloV5Config { form, ..YoloV5Config::new(YoloV5Size::N, 2, 96) };
        let net = YoloV5::new(&config, &device());
        let checkpoint = detector_checkpoint(&net, &names).unwrap();
        let bytes = safetensors(&checkpoint).unwrap();
        assert_eq!(Checkpoint::from_bytes(&bytes).unwrap(), checkpoint);
        let options = OnnxOptions { width: 96, height: 96, half: false };
        let file = detector_onnx(&net, &names, &options).unwrap();
        let model = DetectorModel::from_vec("trained", file).unwrap();
        assert_eq!(model.names(), names);

        // The most certain box of a picture, by both.
        let pixels: Vec<u8> = (0..96 * 96 * 3).map(|i| ((i * 31) % 251) as u8).collect();
        let frame = Frame::new(Stamp::ZERO, 96, 96, PixelFormat::Rgb8, pixels.clone()).unwrap();
        let runtime = RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() };
        let options = DetectorOptions { confidence: 0.0, max_det: 1, ..Default::default() };
        let runtime = Runtime::start(&runtime);
        let mut detector = realnet_nn::detector::Detector::new(model, &runtime, options).unwrap();
        let found = detector.detect(&frame).unwrap()[0];

        let planes: Vec<f32> = (0..3)
            .flat_map(|c| pixels.chunks_exact(3).map(move |p| f32::from(p[c]) / 255.0))
            .collect();
        let image = Tensor::from_data(TensorData::new(planes, [1, 3, 96, 96]), &device());
        let sigmoid = |v: f64| 1.0 / (1.0 + (-v).exp());
        let best = net
            .forward(image)
            .iter()
            .flat_map(|head| {
                let [_, _, rows, columns] = head.dims();
                let cells =
                    numbers(&head.clone().reshape([3, 7, rows * columns]).permute([0, 2, 1]));
                let cells: Vec<f64> = cells
                    .chunks_exact(7)
                    .map(|cell| sigmoid(cell[4]) * sigmoid(cell[5]).max(sigmoid(cell[6])))
                    .collect();
                cells
            })
            .fold(0.0, f64::max);
        let confidence = f64::from(found.confidence);
        assert!((confidence / best - 1.0).abs() < 1e-4, "{form:?}: {confidence} and {best}");
    }
}

/// What is set by hand at the start is learned like all else.
#[test]
fn every_parameter_is_learned_step_after_step() {
    let device = device().autodiff();
    let config = YoloV5Config::new(YoloV5Size::N, 2, 64);
    let mut net = YoloV5::new(&config, &device);
    let loss = DetectionLoss::new(&config, DetectionLossOptions::default());
    let mut optimizer = Optimizer::Sgd { momentum: 0.9 }.init(0.0);
    let target = |class, side| Target { image: 0, class, bbox: [0.4, 0.6, side, side] };
    let targets = [target(0, 0.2), target(1, 0.5), target(0, 0.9)];
    for _ in 0..2 {
        let before = tensors(&net.valid()).unwrap();
        let image = Tensor::random([1, 3, 64, 64], Distribution::Uniform(0.0, 1.0), &device);
        let total = loss.of(net.forward(image), &targets).total();
        let gradients = GradientsParams::from_grads(total.backward(), &net);
        net = optimizer.step(0.1, net, gradients);
        for (name, tensor) in tensors(&net.valid()).unwrap() {
            assert_ne!(tensor.data(), before[&name].data(), "{name}");
        }
    }
}

#[test]
fn depth_logits_have_the_size_they_say() {
    let net = VnlLite::new(&VnlLiteConfig::default(), &device());
    let logits = net.forward(Tensor::zeros([2, 3, 96, 128], &device()));
    assert_eq!(logits.dims(), [2, 80, 24, 32]);
    assert!(numbers(&logits).iter().all(|v| v.is_finite()));
    let millions = net.num_params() as f64 / 1e6;
    assert!((2.0..3.5).contains(&millions), "{millions}");
}

const CODING: DepthCoding = DepthCoding {
    min: 0.05,
    max: 1.21,
    scale: 10.0,
    focal: 207.55,
    mean: [0.485, 0.456, 0.406],
    std: [0.229, 0.224, 0.225],
};

/// Logits of the network in training and of its files, at the size it is made for and at
/// another one; for the usual layout and one of other numbers everywhere.
#[test]
fn exported_depth_networks_give_the_same() {
    let other =
        VnlLiteConfig { widths: [8, 8, 16, 12, 20], blocks: [1, 3, 1, 2], decoder: 8, bins: 33 };
    for (config, sizes) in
        [(VnlLiteConfig::default(), vec![(256, 192)]), (other, vec![(256, 192), (160, 96)])]
    {
        let net = worn(VnlLite::new(&config, &device()));
        let checkpoint = depth_checkpoint(&net, &CODING).unwrap();
        assert_eq!(checkpoint.depth, Some(CODING));
        let bytes = safetensors(&checkpoint).unwrap();
        assert_eq!(Checkpoint::from_bytes(&bytes).unwrap(), checkpoint);
        for (width, height) in sizes {
            let (pixels, image) = noise(width, height);
            let expected = numbers(&net.forward(image));
            assert_eq!(expected.len(), config.bins * width * height / 16);
            let largest = expected.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
            let spread = spread(&expected, width * height / 16);
            assert!(spread > 0.5, "{spread} of {largest}");
            let options = OnnxOptions { width, height, half: false };
            let file = depth_onnx(&net, &CODING, &options).unwrap();
            let size = Some((width as u32, height as u32));
            for (name, bytes) in [("safetensors", bytes.clone()), ("onnx", file.clone())] {
                let model = DepthModel::from_vec(name, bytes).unwrap();
                let (network, metadata) = model.network(size, Detail::Fast).unwrap();
                assert_eq!(metadata.coding, CODING);
                close(name, &run(network, &pixels), &expected, 1e-4, 1e-4);
            }
            // Weights in 16 bits have 11 bits of precision.
            let half = depth_onnx(&net, &CODING, &OnnxOptions { half: true, ..options }).unwrap();
            assert!(half.len() < file.len() * 7 / 10, "{} of {}", half.len(), file.len());
            let half = DepthModel::from_vec("half", half).unwrap();
            let (network, _) = half.network(None, Detail::Fast).unwrap();
            close("half", &run(network, &pixels), &expected, 0.01 * largest, 0.0);
        }
    }
}

#[test]
fn codings_that_cannot_be_are_refused() {
    let config = VnlLiteConfig { widths: [4; 5], blocks: [1; 4], decoder: 4, bins: 5 };
    let net = VnlLite::new(&config, &device());
    let coding = DepthCoding { min: 2.0, ..CODING };
    let error = depth_checkpoint(&net, &coding).unwrap_err();
    assert!(matches!(error, ExportNetworkError::Coding(_)), "{error}");
    let options = OnnxOptions { width: 100, height: 96, half: false };
    let error = depth_onnx(&net, &CODING, &options).unwrap_err();
    assert!(matches!(error, ExportNetworkError::Onnx(_)), "{error}");
}
