//! Speed of the evaluation. `cargo bench -p realnet-eval` measures 5000 images
//! with 100 detections each in 80 categories; as a test a small set
//! runs once.

#![allow(missing_docs)]

use divan::{Bencher, counter::ItemsCount};
use realnet_core::BoundingBox;
use realnet_eval::{
    CocoOptions, ConfusionOptions, GroundTruth, Prediction, confidence_curves, confusion_matrix,
    evaluate,
};
use std::sync::LazyLock;

fn main() {
    divan::main();
}

/// Numbers in 0..1 from the splitmix64 sequence.
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u32 << 24) as f32
    }

    fn category(&mut self) -> u32 {
        (self.roll() * 80.0) as u32
    }

    fn bbox(&mut self) -> BoundingBox {
        let (x, y) = (self.roll() * 640.0, self.roll() * 480.0);
        BoundingBox::from_corner(x, y, 8.0 + self.roll() * 292.0, 8.0 + self.roll() * 292.0)
    }
}

type Case = (Vec<GroundTruth>, Vec<Prediction>);

static CASE: LazyLock<Case> = LazyLock::new(|| {
    let has = |flag: &str| std::env::args().any(|a| a == flag);
    let images = if has("--bench") && !has("--test") { 5000 } else { 50 };
    let mut dice = Dice(1);
    let (mut truth, mut found) = (Vec::new(), Vec::new());
    for image_id in 0..images {
        for _ in 0..7 {
            let label = GroundTruth::new(image_id, dice.category(), dice.bbox());
            truth.push(label);
            for _ in 0..3 {
                let shift = 0.2 * label.bbox.width();
                let bbox = label.bbox.translated(dice.roll() * shift, dice.roll() * shift);
                let category = label.category;
                found.push(Prediction { image_id, category, bbox, confidence: dice.roll() });
            }
        }
        for _ in 21..100 {
            let (category, bbox) = (dice.category(), dice.bbox());
            let confidence = dice.roll() * dice.roll();
            found.push(Prediction { image_id, category, bbox, confidence });
        }
    }
    (truth, found)
});

#[divan::bench(sample_count = 10, sample_size = 1)]
fn coco(bencher: Bencher<'_, '_>) {
    let (truth, found) = &*CASE;
    let options = CocoOptions::default();
    bencher.counter(ItemsCount::new(found.len())).bench(|| evaluate(truth, found, &options));
}

#[divan::bench(sample_count = 10, sample_size = 1)]
fn curves(bencher: Bencher<'_, '_>) {
    let (truth, found) = &*CASE;
    bencher.counter(ItemsCount::new(found.len())).bench(|| confidence_curves(truth, found, 0.5));
}

#[divan::bench(sample_count = 10, sample_size = 1)]
fn confusion(bencher: Bencher<'_, '_>) {
    let (truth, found) = &*CASE;
    let categories: Vec<u32> = (0..80).collect();
    let options = ConfusionOptions::default();
    bencher
        .counter(ItemsCount::new(found.len()))
        .bench(|| confusion_matrix(truth, found, &categories, options));
}
