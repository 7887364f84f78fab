//! The scores of a stored random case against those of pycocotools. The case is
//! written by `bench/peers/coco/compare.py --golden`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::type_complexity)]

use realnet_core::BoundingBox;
use realnet_eval::{CocoOptions, CocoSummary, GroundTruth, Prediction, evaluate};
use serde::Deserialize;

#[derive(Deserialize)]
struct Golden {
    images: usize,
    labels: Vec<(u64, u32, f32, f32, f32, f32, f64, u8)>,
    results: Vec<(u64, u32, f32, f32, f32, f32, f32)>,
    expected: Expected,
}

#[derive(Deserialize)]
struct Expected {
    stats: [Option<f64>; 12],
    per_class: Vec<ExpectedClass>,
}

#[derive(Deserialize)]
struct ExpectedClass {
    category: u32,
    ap: Option<f64>,
    ap50: Option<f64>,
    ar: Option<f64>,
}

const TOLERANCE: f64 = 1e-9;

fn load() -> (Golden, Vec<GroundTruth>, Vec<Prediction>) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/coco_golden.json");
    let golden: Golden = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let truth = golden.labels.iter().map(|&(image_id, category, x, y, w, h, area, crowd)| {
        let bbox = BoundingBox::from_corner(x, y, w, h);
        GroundTruth { image_id, category, bbox, area, crowd: crowd != 0 }
    });
    let found = golden.results.iter().map(|&(image_id, category, x, y, w, h, confidence)| {
        let bbox = BoundingBox::from_corner(x, y, w, h);
        Prediction { image_id, category, bbox, confidence }
    });
    let (truth, found) = (truth.collect(), found.collect());
    (golden, truth, found)
}

fn same(what: &str, found: Option<f64>, expected: Option<f64>) {
    match (found, expected) {
        (None, None) => {}
        (Some(f), Some(e)) => assert!((f - e).abs() < TOLERANCE, "{what}: {f}, expected {e}"),
        _ => panic!("{what}: {found:?}, expected {expected:?}"),
    }
}

fn compare(summary: &CocoSummary, expected: &Expected) {
    for (i, (found, expected)) in summary.stats().into_iter().zip(expected.stats).enumerate() {
        same(&format!("number {i}"), found, expected);
    }
    for e in &expected.per_class {
        let class = summary.per_class.iter().find(|c| c.category == e.category);
        same(&format!("AP of {}", e.category), class.and_then(|c| c.ap), e.ap);
        same(&format!("AP50 of {}", e.category), class.and_then(|c| c.ap50), e.ap50);
        same(&format!("AR of {}", e.category), class.and_then(|c| c.ar), e.ar);
    }
}

#[test]
fn equal_to_pycocotools() {
    let (golden, truth, found) = load();
    assert!(golden.images >= 200 && golden.expected.per_class.len() == 10);
    // The case visits what it is meant to visit.
    assert!(truth.iter().any(|g| g.crowd) && truth.iter().any(|g| g.area < 16.0));
    assert!(found.iter().any(|p| truth.iter().all(|g| g.category != p.category)));
    assert!(truth.iter().any(|g| found.iter().all(|p| p.category != g.category)));
    let crowded = |p: &Prediction| {
        let alike = |q: &&Prediction| (q.image_id, q.category) == (p.image_id, p.category);
        found.iter().filter(alike).count() > 100
    };
    assert!(found.iter().any(crowded));

    compare(&evaluate(&truth, &found, &CocoOptions::default()).unwrap(), &golden.expected);
}

#[test]
fn a_wrong_order_of_ties_would_be_noticed() {
    // The stored case has so many equal confidences that reversing the input,
    // which keeps everything but their order, moves the scores.
    let (golden, truth, mut found) = load();
    found.reverse();
    let summary = evaluate(&truth, &found, &CocoOptions::default()).unwrap();
    let moved = summary.ap.unwrap() - golden.expected.stats[0].unwrap();
    assert!(moved.abs() > 1e-6, "{moved}");
}
