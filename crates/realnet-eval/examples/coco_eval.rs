//! COCO's twelve numbers and the scores of each category for two JSON files:
//! labels (an object with `images`, `categories`, `annotations`) and results (a
//! list of boxes), as one JSON object on standard output.
//!
//! `cargo run --release -p realnet-eval --example coco_eval -- gt.json pred.json`

#![allow(clippy::print_stdout)]

use realnet_core::BoundingBox;
use realnet_eval::{CocoOptions, GroundTruth, Prediction, evaluate};
use serde::Deserialize;
use std::error::Error;
use std::time::Instant;

#[derive(Deserialize)]
struct Labels {
    annotations: Vec<Annotation>,
}

#[derive(Deserialize)]
struct Annotation {
    image_id: u64,
    category_id: u32,
    bbox: [f64; 4],
    area: f64,
    #[serde(default)]
    iscrowd: u8,
}

#[derive(Deserialize)]
struct Guess {
    image_id: u64,
    category_id: u32,
    bbox: [f64; 4],
    score: f64,
}

fn edges([x, y, width, height]: [f64; 4]) -> BoundingBox {
    BoundingBox::new(x as f32, y as f32, (x + width) as f32, (y + height) as f32)
}

fn main() -> Result<(), Box<dyn Error>> {
    let paths: Vec<_> = std::env::args_os().skip(1).collect();
    let [labels, guesses] = paths.as_slice() else {
        return Err("usage: coco_eval LABELS.json RESULTS.json".into());
    };
    let labels: Labels = serde_json::from_slice(&std::fs::read(labels)?)?;
    let guesses: Vec<Guess> = serde_json::from_slice(&std::fs::read(guesses)?)?;
    let truth: Vec<_> = labels
        .annotations
        .iter()
        .map(|a| GroundTruth {
            image_id: a.image_id,
            category: a.category_id,
            bbox: edges(a.bbox),
            area: a.area,
            crowd: a.iscrowd != 0,
        })
        .collect();
    let predictions: Vec<_> = guesses
        .iter()
        .map(|g| Prediction {
            image_id: g.image_id,
            category: g.category_id,
            bbox: edges(g.bbox),
            confidence: g.score as f32,
        })
        .collect();
    let start = Instant::now();
    let summary = evaluate(&truth, &predictions, &CocoOptions::default())?;
    let seconds = start.elapsed().as_secs_f64();
    let per_class: Vec<_> = summary
        .per_class
        .iter()
        .map(
            |c| serde_json::json!({"category": c.category, "ap": c.ap, "ap50": c.ap50, "ar": c.ar}),
        )
        .collect();
    println!(
        "{}",
        serde_json::json!({
            "stats": summary.stats(),
            "per_class": per_class,
            "seconds": seconds,
        })
    );
    Ok(())
}
