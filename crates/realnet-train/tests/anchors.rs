//! Anchors that fit a data set, against the reference implementation's.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::File;
use realnet_train::anchors::{AnchorFit, AnchorSearch, fitting};
use realnet_train::nets::{YoloV5Config, YoloV5Size};

fn pairs(numbers: &[f64]) -> Vec<[f32; 2]> {
    numbers.chunks_exact(2).map(|pair| [pair[0] as f32, pair[1] as f32]).collect()
}

#[test]
fn fits_are_the_reference_implementations() {
    let file = File::open("anchors.safetensors");
    let boxes = pairs(&file.numbers("wh"));
    let kept: Vec<_> = boxes.iter().filter(|b| b[0] >= 2.0 || b[1] >= 2.0).copied().collect();
    for name in ["default", "kmeans"] {
        let anchors = pairs(&file.numbers(name));
        for (boxes, figures) in [(&boxes, "fit"), (&kept, "fit_kept")] {
            let AnchorFit { recall, above, fitness } = AnchorFit::new(boxes, &anchors, 4.0);
            let wanted = file.numbers(&format!("{name}.{figures}"));
            for (value, wanted) in [recall, above, fitness].into_iter().zip(wanted) {
                assert!((value - wanted).abs() < 1e-6, "{name}.{figures}: {value}, not {wanted}");
            }
        }
    }
}

/// As good as the reference's: in the range of its ten seeds or above, for every seed.
#[test]
fn searches_find_what_the_reference_finds() {
    let file = File::open("anchors.safetensors");
    let boxes = pairs(&file.numbers("wh"));
    let kept: Vec<_> = boxes.iter().filter(|b| b[0] >= 2.0 || b[1] >= 2.0).copied().collect();
    let theirs = file.numbers("kmeans.fitness_10_seeds");
    let worst = theirs.iter().copied().fold(f64::INFINITY, f64::min);
    for seed in 0..10 {
        let search = AnchorSearch { seed, ..AnchorSearch::default() };
        let anchors = search.run(&boxes, 9);
        assert_eq!(anchors.len(), 9);
        assert!(anchors.is_sorted_by_key(|[w, h]| w * h));
        let fitness = AnchorFit::new(&kept, &anchors, 4.0).fitness;
        assert!(fitness >= worst, "seed {seed}: {fitness}, not {worst}");
        assert_eq!(anchors, search.run(&boxes, 9), "seed {seed} twice");
    }
}

/// As the reference's check did: other anchors where the given ones do not fit.
#[test]
fn anchors_stay_where_they_fit() {
    let file = File::open("anchors.safetensors");
    let boxes = pairs(&file.numbers("wh"));
    let given = YoloV5Config::new(YoloV5Size::N, 1, 640).anchors;
    let (found, fit) = fitting(&given, &boxes, &AnchorSearch::default());
    assert_ne!(found, given);
    assert!(fit.fitness > AnchorFit::new(&boxes, given.as_flattened(), 4.0).fitness);
    // Found ones fit, so they stay.
    assert!(fit.recall > 0.98, "{fit:?}");
    let (again, _) = fitting(&found, &boxes, &AnchorSearch::default());
    assert_eq!(again, found);
    // Too few boxes to learn nine sizes from.
    let (few, fit) = fitting(&given, &[[1000.0, 3.0]; 8], &AnchorSearch::default());
    assert_eq!((few, fit.recall), (given, 0.0));
    // Boxes of one size.
    let (one, fit) = fitting(&given, &[[300.0, 11.0]; 20], &AnchorSearch::default());
    assert!(fit.recall == 1.0 && one.iter().flatten().all(|a| a[0] > 1.0), "{one:?} {fit:?}");
}
