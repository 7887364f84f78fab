//! Losses against the values of the reference implementations, see data/README.md.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod common;

use burn::tensor::{Device, Tensor, TensorData};
use common::{File, close, golden};
use realnet_nn::depth::DepthCoding;
use realnet_train::loss::BoxLoss;
use realnet_train::loss::boxes::iou;
use realnet_train::loss::depth::{DepthLoss, DepthLossOptions, DepthTruth, Labels, NormalRules};
use realnet_train::loss::detection::{DetectionLoss, DetectionLossOptions, Match, Target, matches};
use realnet_train::nets::{YoloV5Config, YoloV5Size};

fn device() -> Device {
    Device::flex().autodiff()
}

fn tensor<const D: usize>(values: &[f64], shape: [usize; D]) -> Tensor<D> {
    let values: Vec<f32> = values.iter().map(|v| *v as f32).collect();
    Tensor::from_data(TensorData::new(values, shape), &device())
}

fn numbers<const D: usize>(tensor: &Tensor<D>) -> Vec<f64> {
    tensor.clone().into_data().try_to_vec::<f32>().unwrap().into_iter().map(f64::from).collect()
}

#[test]
fn overlaps_and_their_gradients() {
    let file = File::open("iou.safetensors");
    let smooth = file.numbers("smooth");
    let wanted = tensor(&file.numbers("box2"), [64, 4]);
    for (name, kind) in [
        ("iou", BoxLoss::Iou),
        ("giou", BoxLoss::Giou),
        ("diou", BoxLoss::Diou),
        ("ciou", BoxLoss::Ciou),
    ] {
        let found = tensor::<2>(&file.numbers("box1"), [64, 4]).require_grad();
        let overlap = iou(&found, &wanted, kind);
        close(name, &numbers(&overlap), &file.numbers(name), 1e-5, 1e-5);
        let gradients = overlap.sum().backward();
        let gradient = numbers(&found.grad(&gradients).unwrap());
        let expected = file.numbers(&format!("{name}.grad"));
        for (pair, smooth) in smooth.iter().enumerate().filter(|(_, smooth)| **smooth == 1.0) {
            assert_eq!(*smooth, 1.0);
            let at = 4 * pair..4 * pair + 4;
            close(name, &gradient[at.clone()], &expected[at], 2e-5, 1e-4);
        }
    }
}

fn targets(file: &File, one_class: bool) -> Vec<Target> {
    let rows = file.numbers("targets");
    let rows = rows.chunks_exact(6).map(|row| Target {
        image: row[0] as usize,
        class: if one_class { 0 } else { row[1] as usize },
        bbox: [row[2] as f32, row[3] as f32, row[4] as f32, row[5] as f32],
    });
    rows.collect()
}

#[test]
fn matches_are_the_reference_implementations() {
    let file = File::open("detect_loss.safetensors");
    let targets = targets(&file, false);
    let anchors = file.numbers("anchors");
    for (scale, cells) in [40, 20, 10].into_iter().enumerate() {
        let stride = 320 / cells;
        let mut own = [[0.0; 2]; 3];
        for (slot, value) in own.iter_mut().flatten().zip(&anchors[6 * scale..]) {
            *slot = *value as f32 / stride as f32;
        }
        let found = matches(&targets, &own, [cells, cells], 4.0);
        // Back in the reference's own order.
        let rows = file.numbers(&format!("match_{scale}"));
        let boxes = file.numbers(&format!("match_box_{scale}"));
        let mut expected: Vec<(&[f64], &[f64])> =
            rows.chunks_exact(6).zip(boxes.chunks_exact(4)).collect();
        expected.sort_by_key(|(row, _)| row[5] as usize);
        assert_eq!(found.len(), expected.len(), "scale {scale}");
        for (m, (row, bbox)) in found.iter().zip(expected) {
            let Match { image, anchor, row: gj, column, class, bbox: own } = *m;
            let indices = [image, anchor, gj, column, class].map(|i| i as f64);
            assert_eq!(indices, row[..5], "scale {scale}");
            close("box", &own.map(f64::from), bbox, 1e-5, 1e-6);
        }
    }
}

#[test]
fn detection_losses_and_their_gradients() {
    let file = File::open("detect_loss.safetensors");
    for case in ["ciou", "giou", "diou", "iou", "one_class", "empty"] {
        let one_class = case == "one_class";
        let classes = if one_class { 1 } else { 3 };
        let mut config = YoloV5Config::new(YoloV5Size::N, classes, 320);
        for (slot, value) in
            config.anchors.iter_mut().flatten().flatten().zip(file.numbers("anchors"))
        {
            *slot = value as f32;
        }
        let boxes = match case {
            "giou" => BoxLoss::Giou,
            "diou" => BoxLoss::Diou,
            "iou" => BoxLoss::Iou,
            _ => BoxLoss::Ciou,
        };
        let loss =
            DetectionLoss::new(&config, DetectionLossOptions { boxes, ..Default::default() });
        let targets = if case == "empty" { Vec::new() } else { targets(&file, one_class) };
        let outputs = 5 + classes;
        let raw: Vec<Tensor<4>> = [40, 20, 10]
            .into_iter()
            .enumerate()
            .map(|(scale, cells)| {
                let values: Vec<f64> =
                    file.numbers(&format!("raw_{scale}")).iter().map(|v| v / 16.0).collect();
                // Outputs behind the anchors, as a head gives them.
                let by_cell = tensor::<5>(&values, [2, 3, cells, cells, 8]);
                let by_channel = by_cell.narrow(4, 0, outputs).permute([0, 1, 4, 2, 3]);
                by_channel.reshape([2, 3 * outputs, cells, cells]).detach().require_grad()
            })
            .collect();
        let heads = [raw[0].clone(), raw[1].clone(), raw[2].clone()];
        let parts = loss.of(heads, &targets);
        let items = file.numbers(&format!("{case}.items"));
        let total = parts.total();
        let batch = 2.0;
        let own: Vec<f64> = [&parts.boxes, &parts.objectness, &parts.classes]
            .iter()
            .map(|part| numbers(part)[0] / batch)
            .chain([numbers(&total)[0]])
            .collect();
        close(case, &own, &items, 1e-5, 1e-5);
        let gradients = total.backward();
        for (scale, cells) in [40, 20, 10].into_iter().enumerate() {
            let gradient = raw[scale].grad(&gradients).unwrap();
            let by_cell = gradient.reshape([2, 3, outputs, cells, cells]).permute([0, 1, 3, 4, 2]);
            let own = numbers(&by_cell);
            let expected = file.numbers(&format!("{case}.grad_{scale}"));
            for (cell, expected) in file
                .numbers(&format!("cells_{scale}"))
                .chunks_exact(4)
                .zip(expected.chunks_exact(outputs))
            {
                let [image, anchor, row, column] = [0, 1, 2, 3].map(|i| cell[i] as usize);
                let at = ((image * 3 + anchor) * cells + row) * cells + column;
                close(case, &own[at * outputs..][..outputs], expected, 1e-5, 2e-4);
            }
        }
    }
}

#[test]
fn depth_losses_are_the_released_codes() {
    let Some(file) = golden("vnl/losses.safetensors") else { return };
    let coding = DepthCoding::default();
    let focal = file.numbers("focal")[0];
    let rays = (0..48 * 64).map(|place| {
        let (v, u) = (place / 64, place % 64);
        [((u as f64 - 32.0) / focal) as f32, ((v as f64 - 24.0) / focal) as f32]
    });
    let truth = DepthTruth {
        images: 1,
        size: [48, 64],
        depths: file.numbers("gt").iter().map(|d| *d as f32).collect(),
        rays: rays.collect(),
        metres_per_unit: vec![1.0],
    };
    let options = DepthLossOptions {
        coding,
        bins: 60,
        labels: Labels::Nearest,
        normal_rules: NormalRules::RELEASED,
        ..Default::default()
    };
    let loss = DepthLoss::new(options);
    let bins: Vec<f64> =
        truth.depths.iter().map(|d| loss.label(*d).map_or(61.0, |bin| bin as f64)).collect();
    assert_eq!(bins, file.numbers("bins"));

    let logits = tensor(&file.numbers("logits"), [1, 60, 48, 64]);
    let entropy = numbers(&loss.cross_entropy(logits, &truth));
    close("wce", &entropy, &file.numbers("wce"), 0.0, 1e-5);

    let [xs, ys]: [Vec<Vec<f64>>; 2] =
        ["x", "y"].map(|axis| (1..=3).map(|k| file.numbers(&format!("p{k}_{axis}"))).collect());
    let triplets: Vec<[usize; 3]> = (0..xs[0].len())
        .map(|i| std::array::from_fn(|k| ys[k][i] as usize * 64 + xs[k][i] as usize))
        .collect();
    let depth = tensor(&file.numbers("pred"), [1, 1, 48, 64]);
    let selected = loss.virtual_normals(depth.clone(), &truth, &triplets);
    close("vnl", &numbers(&selected), &file.numbers("vnl"), 0.0, 1e-5);
    let all = DepthLoss::new(DepthLossOptions { normal_dropped: 0.0, ..options });
    let all = all.virtual_normals(depth, &truth, &triplets);
    close("vnl", &numbers(&all), &file.numbers("vnl_unselected"), 0.0, 1e-5);
}

#[test]
fn rules_of_virtual_normals() {
    let triangle = [[0.0, 0.0, 2.0], [1.0, 0.1, 2.1], [0.2, 1.0, 2.5]];
    assert!(NormalRules::PAPER.allow(&triangle) && NormalRules::RELEASED.allow(&triangle));
    let small = triangle.map(|point| point.map(|part| 0.1 * part));
    assert!(!NormalRules::PAPER.allow(&small) && NormalRules::RELEASED.allow(&small));
    let flat = [[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [2.0, 0.05, 2.0]];
    assert!(!NormalRules::PAPER.allow(&flat) && !NormalRules::RELEASED.allow(&flat));
    // No two sides in line, but along every axis some side is short.
    let near = [[0.0, 0.0, 1.0], [0.004, 0.006, 1.0], [-0.006, 0.004, 1.004]];
    assert!(!NormalRules::RELEASED.allow(&near));
    let far = near.map(|point| point.map(|part| 10.0 * part));
    assert!(NormalRules::RELEASED.allow(&far));
}

/// A bin's depth is read as itself, and labels agree with what is read.
#[test]
fn bins_are_read_as_they_are_labelled() {
    let loss = DepthLoss::new(DepthLossOptions::default());
    let bins = loss.options().bins;
    for bin in [0, 17, bins - 1] {
        let mut logits = vec![0.0; bins];
        logits[bin] = 60.0;
        let depth = numbers(&loss.depth(tensor::<4>(&logits, [1, bins, 1, 1])))[0];
        assert_eq!(loss.label(depth as f32), Some(bin), "{depth}");
    }
    assert_eq!(loss.label(0.0), None);
    assert_eq!(loss.label(f32::NAN), None);
    assert_eq!(loss.label(1e9), None);
}
