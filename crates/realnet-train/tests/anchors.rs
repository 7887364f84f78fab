//! Anchors that fit a data set, against the reference implementation's.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::File;
use realnet_core::{Frame, PixelFormat, Stamp};
use realnet_data::{DetectionSet, Target};
use realnet_train::anchors::{AnchorFit, AnchorSearch, Anchors, box_sizes, fitting};
use realnet_train::nets::{YoloV5Config, YoloV5Size};

fn pairs(numbers: &[f64]) -> Vec<[f64; 2]> {
    numbers.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect()
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
    let flat = |anchors: &Anchors| -> Vec<[f64; 2]> {
        anchors.iter().flatten().map(|a| a.map(f64::from)).collect()
    };
    assert!(fit.fitness > AnchorFit::new(&boxes, &flat(&given), 4.0).fitness);
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

/// Of a wide picture and a high one.
#[test]
fn sizes_are_pixels_of_the_input() {
    let frame = |width: u32, height: u32| {
        let bytes = vec![0; (width * height * 3) as usize];
        Frame::new(Stamp::ZERO, width, height, PixelFormat::Rgb8, bytes).unwrap()
    };
    let target = |w, h| Target { class_id: 0, cx: 0.5, cy: 0.5, w, h };
    let pictures = vec![
        (frame(200, 100), vec![target(0.5, 0.5)]),
        (frame(50, 100), vec![target(1.0, 0.25), target(0.2, 0.1)]),
    ];
    let set = DetectionSet::from_memory(vec!["thing".to_owned()], pictures, 64).unwrap();
    let wanted = [[32.0, 16.0], [32.0, 16.0], [6.4, 6.4]];
    for (found, wanted) in box_sizes(&set).iter().zip(wanted) {
        assert!((0..2).all(|i| (found[i] - wanted[i]).abs() < 1e-5), "{found:?}, not {wanted:?}");
    }
}
