//! Draws all plots of made-up data as PNG files into a directory.
//!
//! `cargo run -p realnet-eval --example plots -- out 80`: 80 classes.

use realnet_core::{BoundingBox, Frame};
use realnet_eval::{
    CocoOptions, ConfusionOptions, GroundTruth, Prediction, confidence_curves, confusion_matrix,
    evaluate, plot,
};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(folder), Some(classes)) = (arguments.next(), arguments.next()) else {
        return Err("usage: plots DIRECTORY CLASSES".into());
    };
    let classes: u32 = classes.parse()?;
    let mut state = 7u64;
    let mut roll = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u32 << 24) as f32
    };
    let (mut truth, mut found) = (Vec::new(), Vec::new());
    for image_id in 0..400 {
        for _ in 0..6 {
            let category = (roll() * classes as f32) as u32;
            let hard = (category % 7) as f32 / 7.0;
            let bbox = BoundingBox::from_corner(
                roll() * 1000.0,
                roll() * 600.0,
                20.0 + roll() * 200.0,
                20.0 + roll() * 200.0,
            );
            truth.push(GroundTruth::new(image_id, category, bbox));
            let sure = 1.0 - roll() * (0.2 + 0.8 * hard);
            if roll() > hard * 0.5 {
                let taken = if roll() < 0.12 * hard + 0.02 { category + 1 } else { category };
                let shift = 0.25 * bbox.width() * roll() * (0.4 + hard);
                found.push(Prediction {
                    image_id,
                    category: taken % classes,
                    bbox: bbox.translated(shift, shift / 2.0),
                    confidence: sure,
                });
            }
            if roll() < 0.4 {
                let category = (roll() * classes as f32) as u32;
                let bbox = BoundingBox::from_corner(roll() * 1000.0, roll() * 600.0, 90.0, 90.0);
                found.push(Prediction { image_id, category, bbox, confidence: roll() * roll() });
            }
        }
    }
    let words =
        ["car", "person", "traffic light", "dog", "a remarkably long class name, cut", "bus"];
    let names: BTreeMap<u32, String> = (0..classes)
        .map(|c| {
            let word = words[c as usize % words.len()];
            (c, if c < 6 { word.to_owned() } else { format!("{word} {c}") })
        })
        .collect();
    let summary = evaluate(&truth, &found, &CocoOptions::default())?;
    let curves = confidence_curves(&truth, &found, 0.5)?;
    let categories: Vec<u32> = (0..classes).collect();
    let matrix = confusion_matrix(&truth, &found, &categories, ConfusionOptions::default())?;
    std::fs::create_dir_all(&folder)?;
    let save = |name: &str, frame: &Frame| {
        let path = Path::new(&folder).join(format!("{name}_{classes}.png"));
        image::save_buffer(
            path,
            frame.data(),
            frame.width(),
            frame.height(),
            image::ExtendedColorType::Rgb8,
        )
    };
    save("precision", &plot::precision_curve(&curves, &names)?)?;
    save("recall", &plot::recall_curve(&curves, &names)?)?;
    save("f1", &plot::f1_curve(&curves, &names)?)?;
    save("pr", &plot::pr_curve(&summary, &names)?)?;
    save("confusion", &plot::confusion_plot(&matrix, &names)?)?;
    Ok(())
}
