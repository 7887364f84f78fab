//! Depth as it is learned and judged.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use realnet_core::{CameraModel, DepthMap, Distortion, Frame, Intrinsics, PixelFormat, Stamp};
use realnet_data::{
    CanonicalFocal, DepthAugment, DepthBatch, DepthSamples, DepthSet, DepthSetOptions, Loader,
    LoaderOptions, Normalization, RgbdPicture,
};
use realnet_eval::DepthProtocol;
use realnet_nn::depth::DepthCoding;
use realnet_train::loss::depth::DepthTruth;
use realnet_train::loss::{DepthLoss, DepthLossOptions};
use realnet_train::nets::DepthNet;
use realnet_train::tasks::{DepthTask, truth};
use realnet_train::trainer::{Loss, Task};
use std::sync::Arc;

/// A network that sees nothing: logits of one number a bin.
#[derive(Module, Debug)]
struct Blind {
    bias: Param<Tensor<1>>,
}

impl DepthNet for Blind {
    fn logits(&self, image: Tensor<4>) -> Tensor<4> {
        let [batch, _, height, width] = image.dims();
        let bins = self.bias.val().dims()[0];
        self.bias.val().reshape([1, bins, 1, 1]).expand([batch, bins, height / 4, width / 4])
    }
}

const BINS: usize = 12;

fn coding() -> DepthCoding {
    DepthCoding { min: 0.05, max: 0.8, scale: 10.0, focal: 64.0, ..DepthCoding::default() }
}

/// Pictures of walls, each at its own distance, of a camera with twice the canonical focal
/// length.
fn task(distances: &[f32], seed: u64) -> DepthTask<Blind> {
    let (width, height) = (64, 32);
    let pixels = width as usize * height as usize;
    let camera = Intrinsics { fx: 128.0, fy: 128.0, cx: 31.5, cy: 15.5 };
    let pictures = distances.iter().map(|metres| RgbdPicture {
        frame: Frame::new(
            Stamp::ZERO,
            width,
            height,
            PixelFormat::Rgb8,
            (0..3 * pixels).map(|i| (i % 251) as u8).collect(),
        )
        .unwrap(),
        depth: DepthMap::new(Stamp::ZERO, width, height, vec![*metres; pixels]).unwrap(),
        camera: CameraModel::new(width, height, camera, Distortion::None).unwrap(),
    });
    let options = DepthSetOptions::validation((width, height));
    let set = Arc::new(DepthSet::from_memory(pictures.collect(), &options).unwrap());
    let canonical = CanonicalFocal::new(coding().focal).unwrap();
    let loader = |augment, shuffle| {
        let samples =
            DepthSamples::training(set.clone(), augment, canonical, Normalization::IMAGENET, seed);
        let options = LoaderOptions { batch: 2, shuffle, threads: 1, ..Default::default() };
        Loader::new(Arc::new(samples.unwrap()), options).unwrap()
    };
    let loss =
        DepthLoss::new(DepthLossOptions { coding: coding(), bins: BINS, ..Default::default() });
    let protocol = DepthProtocol { max_depth: 20.0, ..DepthProtocol::new("walls") };
    let (train, val) =
        (loader(DepthAugment::default(), Some(seed)), loader(DepthAugment::NONE, None));
    DepthTask::new(train, loss, val, protocol, seed).unwrap()
}

/// Sure of one bin.
fn sure_of(bin: usize, device: &Device) -> Blind {
    let bias: Vec<f32> = (0..BINS).map(|i| if i == bin { 50.0 } else { 0.0 }).collect();
    Blind { bias: Param::from_tensor(Tensor::from_floats(bias.as_slice(), device)) }
}

/// What a validation says follows from the depth of the bin and the camera alone.
#[test]
fn figures_are_in_metres_of_the_camera() {
    let distances = [2.0_f32, 3.0, 4.0];
    let found = task(&distances, 0).validate(&sure_of(7, &Device::flex())).unwrap();
    // In the middle of the bin, and things look twice as near as they are through a lens that
    // is twice as long.
    let step = (0.8_f64 / 0.05).ln() / BINS as f64;
    let depth = 10.0 * 0.05 * (7.5 * step).exp() * 2.0;
    let mean = |of: &dyn Fn(f64) -> f64| {
        distances.iter().map(|d| of(f64::from(*d))).sum::<f64>() / distances.len() as f64
    };
    let wanted = [
        ("abs_rel", mean(&|d| (d - depth).abs() / d)),
        ("rmse", mean(&|d| (d - depth).abs())),
        ("d1", mean(&|d| f64::from(u8::from((d / depth).max(depth / d) < 1.25)))),
    ];
    for ((name, value), (wanted_name, wanted)) in found.figures.iter().zip(wanted) {
        assert_eq!(name, wanted_name);
        assert!((value - wanted).abs() < 1e-5, "{name}: {value}, not {wanted}");
    }
    assert_eq!(found.fitness, -found.figures[0].1);
}

/// What is drawn depends on seed, epoch and step, and on nothing else.
#[test]
fn steps_are_the_same_each_time() {
    let device = Device::flex().autodiff();
    let net = sure_of(3, &device);
    let losses = |seed: u64, epoch: usize| -> Vec<(f32, Vec<f32>)> {
        let task = task(&[1.0, 2.0, 3.0, 4.0], seed);
        assert_eq!(task.steps(), 2);
        let steps = task.batches(epoch, 0).unwrap();
        let losses = steps.map(|step| {
            let Loss { total, parts, samples } = task.loss(&net, step.unwrap(), &device);
            assert_eq!(samples, 2);
            (total.into_scalar::<f32>(), parts)
        });
        losses.collect()
    };
    assert_eq!(losses(1, 0), losses(1, 0));
    assert_ne!(losses(1, 0), losses(1, 1));
    assert_ne!(losses(1, 0), losses(2, 0));
    let seeds = |epoch| -> Vec<u64> {
        let task = task(&[1.0, 2.0, 3.0, 4.0], 1);
        let steps = task.batches(epoch, 0).unwrap();
        let seeds: Vec<u64> = steps.map(|step| step.unwrap().seed).collect();
        // From the second one on they are the same.
        let rest = task.batches(epoch, 1).unwrap().map(|step| step.unwrap().seed);
        assert!(rest.eq(seeds[1..].iter().copied()));
        seeds
    };
    let mut all = [seeds(0), seeds(1)].concat();
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), 4);
}

/// Triangles stand on depths that are known and that the bins can say.
#[test]
fn triangles_stand_on_known_depths() {
    let options = DepthLossOptions {
        coding: coding(),
        bins: BINS,
        normal_triplets: 50,
        ..Default::default()
    };
    let loss = DepthLoss::new(options);
    let truth = DepthTruth {
        images: 3,
        size: [2, 4],
        // Beyond the bins; with two known depths; with four.
        depths: [
            [100.0; 8],
            [1.0, 2.0, 0.0, 0.0, 0.01, 0.0, f32::NAN, 100.0],
            [0.0, 1.0, 2.0, 0.0, 3.0, 0.0, 0.0, 4.0],
        ]
        .concat(),
        ..DepthTruth::default()
    };
    let mut drawn = 0;
    let triplets = loss.draw(&truth, |count| {
        drawn += 1;
        drawn % count
    });
    assert_eq!(triplets.len(), 50);
    assert!(triplets.iter().flatten().all(|place| [17, 18, 20, 23].contains(place)));
}

/// A block has the median of what is known in it, and the ray of its middle.
#[test]
fn blocks_have_medians_and_rays() {
    let (width, height) = (8, 4);
    let mut depths = vec![0.0_f32; 2 * width * height];
    // First picture, left block: one known pixel; right block: a step of 3 and 5 metres.
    depths[width + 1] = 7.0;
    for row in 0..height {
        for column in 4..width {
            depths[row * width + column] = if column == 4 { 3.0 } else { 5.0 };
        }
    }
    let camera = Intrinsics { fx: 10.0, fy: 20.0, cx: 3.0, cy: 1.0 };
    let batch = DepthBatch {
        count: 2,
        width: width as u32,
        height: height as u32,
        images: Vec::new(),
        depths,
        metres_per_unit: vec![1.0, 0.5],
        cameras: vec![camera; 2],
    };
    let found = truth(&batch, [1, 2]);
    assert_eq!((found.images, found.size), (2, [1, 2]));
    assert_eq!(found.depths, [7.0, 5.0, 0.0, 0.0]);
    assert_eq!(found.metres_per_unit, [1.0, 0.5]);
    // Middles at 1.5 and 5.5, 1.5.
    let near = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-6;
    assert!(near(found.rays[0], [-0.15, 0.025]), "{:?}", found.rays[0]);
    assert!(near(found.rays[3], [0.25, 0.025]), "{:?}", found.rays[3]);
}
