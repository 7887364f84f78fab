//! What holds for any labels and detections.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use proptest::prelude::*;
use realnet_core::BoundingBox;
use realnet_eval::{
    CocoOptions, ConfusionOptions, EvalError, GroundTruth, Prediction, confidence_curves,
    confusion_matrix, evaluate,
};

const CATEGORIES: [u32; 3] = [0, 1, 7];

fn boxes() -> impl Strategy<Value = BoundingBox> {
    (0.0f32..80.0, 0.0f32..80.0, 1.0f32..60.0, 1.0f32..60.0)
        .prop_map(|(x, y, w, h)| BoundingBox::from_corner(x, y, w, h))
}

fn category() -> impl Strategy<Value = u32> {
    proptest::sample::select(CATEGORIES.to_vec())
}

fn labels() -> impl Strategy<Value = Vec<GroundTruth>> {
    let label = (0u64..5, category(), boxes(), proptest::bool::weighted(0.1))
        .prop_map(|(i, c, b, crowd)| GroundTruth { crowd, ..GroundTruth::new(i, c, b) });
    proptest::collection::vec(label, 0..30)
}

/// Detections, half of them near labels of the same list; no two confidences
/// are equal.
fn case() -> impl Strategy<Value = (Vec<GroundTruth>, Vec<Prediction>)> {
    let guess = (any::<proptest::sample::Index>(), any::<bool>(), 0u64..5, category(), boxes());
    (labels(), proptest::collection::vec(guess, 0..40)).prop_map(|(truth, guesses)| {
        let count = guesses.len() as f32;
        let found = guesses.into_iter().enumerate().map(|(n, (pick, near, image_id, c, bbox))| {
            let confidence = (n as f32 + 0.5) / count;
            if near && !truth.is_empty() {
                let g = pick.get(&truth);
                let bbox = g.bbox.translated(bbox.x0 / 20.0, bbox.y0 / 20.0);
                Prediction { image_id: g.image_id, category: g.category, bbox, confidence }
            } else {
                Prediction { image_id, category: c, bbox, confidence }
            }
        });
        let found = found.collect();
        (truth, found)
    })
}

fn stats(truth: &[GroundTruth], found: &[Prediction]) -> [Option<f64>; 12] {
    evaluate(truth, found, &CocoOptions::default()).unwrap().stats()
}

fn alike(a: [Option<f64>; 12], b: [Option<f64>; 12]) -> bool {
    a.iter().zip(b).all(|(a, b)| match (a, b) {
        (Some(a), Some(b)) => (a - b).abs() < 1e-9,
        (a, b) => *a == b,
    })
}

proptest! {
    #[test]
    fn perfect_detections_score_one(truth in labels()) {
        let found: Vec<_> = truth
            .iter()
            .map(|g| Prediction {
                image_id: g.image_id,
                category: g.category,
                bbox: g.bbox,
                confidence: 0.9,
            })
            .collect();
        // A detection on a crowd is ignored, but could take a label that lies
        // within; without crowds everything fits.
        let single: Vec<_> = truth.iter().filter(|g| !g.crowd).copied().collect();
        let kept: Vec<_> =
            found.iter().zip(&truth).filter(|(_, g)| !g.crowd).map(|(p, _)| *p).collect();
        let summary = evaluate(&single, &kept, &CocoOptions::default()).unwrap();
        let present = [summary.ap, summary.ap50, summary.ap75, summary.ar[2]];
        for value in present {
            prop_assert_eq!(value.is_some(), !single.is_empty());
            prop_assert!(value.is_none_or(|v| (v - 1.0).abs() < 1e-9), "{:?}", summary.stats());
        }
        let curves = confidence_curves(&single, &kept, 0.5).unwrap();
        prop_assert_eq!(curves.overall().map(|p| p.f1), (!single.is_empty()).then_some(1.0));
        let options = ConfusionOptions::default();
        let matrix = confusion_matrix(&single, &kept, &CATEGORIES, options).unwrap();
        let nothing = matrix.background();
        for k in 0..nothing {
            prop_assert_eq!(matrix.count(nothing, k) + matrix.count(k, nothing), 0);
        }
    }

    #[test]
    fn numbers_are_shares((truth, found) in case()) {
        let summary = evaluate(&truth, &found, &CocoOptions::default()).unwrap();
        for value in summary.stats().into_iter().flatten() {
            prop_assert!((0.0..=1.0).contains(&value));
        }
        prop_assert!(summary.ap.unwrap_or(0.0) <= summary.ap50.unwrap_or(0.0) + 1e-12);
        prop_assert!(summary.ar[0] <= summary.ar[1] && summary.ar[1] <= summary.ar[2]);
        for (k, class) in summary.per_class.iter().enumerate() {
            for t in 0..10 {
                let curve = summary.precision(k, realnet_eval::AreaRange::All, 2, t);
                prop_assert_eq!(curve.is_some(), class.instances > 0);
                let curve = curve.unwrap_or_default();
                prop_assert!(curve.windows(2).all(|w| w[0] >= w[1]));
            }
        }
    }

    #[test]
    fn the_order_of_the_input_is_irrelevant(
        ((truth, found), (mut shuffled_truth, mut shuffled)) in case().prop_flat_map(|c| {
            let (truth, found) = c.clone();
            (Just(c), (Just(truth).prop_shuffle(), Just(found).prop_shuffle()))
        })
    ) {
        prop_assert!(alike(stats(&truth, &found), stats(&shuffled_truth, &shuffled)));
        // Nor do the names of images matter, as long as no confidences are equal.
        for g in &mut shuffled_truth {
            g.image_id = 1000 - g.image_id;
        }
        for p in &mut shuffled {
            p.image_id = 1000 - p.image_id;
        }
        prop_assert!(alike(stats(&truth, &found), stats(&shuffled_truth, &shuffled)));
        let curves = confidence_curves(&truth, &found, 0.5).unwrap();
        prop_assert_eq!(curves, confidence_curves(&shuffled_truth, &shuffled, 0.5).unwrap());
    }

    #[test]
    fn a_less_sure_copy_never_helps(
        (truth, found) in case(),
        pick in any::<proptest::sample::Index>(),
    ) {
        // Without overlapping labels a copy has nothing left to match.
        let mut apart: Vec<GroundTruth> = Vec::new();
        for g in truth {
            if apart.iter().all(|o| o.image_id != g.image_id || o.bbox.intersection(&g.bbox) <= 0.0) {
                apart.push(g);
            }
        }
        prop_assume!(!found.is_empty());
        let mut more = found.clone();
        let original = *pick.get(&found);
        more.push(Prediction { confidence: original.confidence * 0.5 - 0.001, ..original });
        let before = evaluate(&apart, &found, &CocoOptions::default()).unwrap();
        let after = evaluate(&apart, &more, &CocoOptions::default()).unwrap();
        prop_assert!(after.ap50.unwrap_or(0.0) <= before.ap50.unwrap_or(0.0) + 1e-12);
        prop_assert!(after.ap.unwrap_or(0.0) <= before.ap.unwrap_or(0.0) + 1e-12);
    }

    #[test]
    fn every_box_is_counted_once((truth, found) in case()) {
        let truth: Vec<_> = truth.into_iter().filter(|g| !g.crowd).collect();
        let options = ConfusionOptions::default();
        let matrix = confusion_matrix(&truth, &found, &CATEGORIES, options).unwrap();
        let side = 0..=matrix.background();
        for (k, &category) in CATEGORIES.iter().enumerate() {
            let column: u64 = side.clone().map(|row| matrix.count(row, k)).sum();
            let labels = truth.iter().filter(|g| g.category == category).count();
            prop_assert_eq!(column, labels as u64);
            let row: u64 = side.clone().map(|column| matrix.count(k, column)).sum();
            let sure = |p: &&Prediction| p.category == category && p.confidence >= 0.25;
            prop_assert_eq!(row, found.iter().filter(sure).count() as u64);
        }
    }

    #[test]
    fn a_confidence_that_is_no_number_is_named((truth, found) in case(), at in 0usize..40) {
        prop_assume!(!found.is_empty());
        let mut found = found;
        let at = at % found.len();
        found[at].confidence = f32::NAN;
        let named = |e: EvalError| matches!(e, EvalError::Confidence { index, .. } if index == at);
        prop_assert!(named(evaluate(&truth, &found, &CocoOptions::default()).unwrap_err()));
        prop_assert!(named(confidence_curves(&truth, &found, 0.5).unwrap_err()));
        let options = ConfusionOptions::default();
        prop_assert!(named(confusion_matrix(&truth, &found, &CATEGORIES, options).unwrap_err()));
    }
}
