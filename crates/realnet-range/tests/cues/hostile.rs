//! Whatever the input: a range with finite numbers, or a reason.

use crate::random::camera;
use proptest::prelude::*;
use realnet_core::{BoundingBox, DepthMap, Stamp};
use realnet_range::cues::{
    DepthInBox, DepthInBoxOptions, DepthNoise, GroundFit, GroundFitOptions, GroundPrior,
    GroundRange, PeakRule, SigmaRule, SizeRange, Uncertain,
};

/// proptest's own ranges of `f32` trip over their rounding, in a debug assertion, about once
/// in ten million draws.
fn span(low: f64, high: f64) -> impl Strategy<Value = f32> {
    (low..high).prop_map(|value| value as f32)
}

fn edge() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => span(-20.0, 80.0),
        1 => any::<f32>(),
        1 => prop::sample::select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, 1e30]),
    ]
}

fn depth() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => span(0.3, 9.0),
        2 => Just(2.0),
        1 => any::<f32>(),
        1 => prop::sample::select(vec![f32::NAN, f32::INFINITY, 0.0, -1.0, f32::MIN_POSITIVE, f32::MAX, 1e-45]),
    ]
}

fn boxes() -> impl Strategy<Value = BoundingBox> {
    [edge(), edge(), edge(), edge()].prop_map(BoundingBox::from)
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![8 => -0.5..2.0f64, 1 => any::<f64>(), 1 => Just(0.0)]
}

fn uncertain() -> impl Strategy<Value = Uncertain> {
    (number(), number()).prop_map(|(value, std)| Uncertain::new(value, std))
}

proptest! {
    #[test]
    fn depths_in_boxes(
        data in prop::collection::vec(depth(), 48 * 36), bbox in boxes(),
        rule in prop::sample::select(vec![
            PeakRule::Highest,
            PeakRule::Nearest { min_share: 0.3 },
            PeakRule::Expected { depth_m: 2.0, std_m: 0.3 },
        ]),
        center_sigma in prop::option::of(0.05..1.0f64), zoom in any::<bool>(),
        min_bin in prop::sample::select(vec![0.0, 0.01]), smoothing_bins in 0.0..3.0f64
    ) {
        let map = DepthMap::new(Stamp::ZERO, 48, 36, data).unwrap();
        let min_bin = DepthNoise::new(min_bin, 0.0);
        let options = DepthInBoxOptions {
            peak: rule, center_sigma, zoom, min_bin, smoothing_bins, ..DepthInBoxOptions::default()
        };
        let mut cue = DepthInBox::new(options).unwrap();
        match cue.measure(&map, bbox, DepthNoise::new(0.01, 0.01)) {
            Ok(range) => {
                prop_assert!(range.depth_m > 0.0 && range.depth_m.is_finite());
                prop_assert!(range.std_m > 0.0 && range.std_m.is_finite());
                let tolerance = 1e-9 * range.depth_m;
                prop_assert!(range.depth_m >= range.interval.near - tolerance);
                prop_assert!(range.depth_m <= range.interval.far + tolerance);
                prop_assert!(range.used >= 12 && range.used <= range.known);
                let foreground = cue.foreground(&SigmaRule::default()).unwrap();
                prop_assert!(foreground.gate.covers_depth(foreground.mean_m as f32));
                prop_assert!(foreground.sigma_m.is_finite() && foreground.share <= 1.0);
            }
            Err(error) => {
                prop_assert!(!error.to_string().is_empty());
                prop_assert!(cue.foreground(&SigmaRule::default()).is_err());
            }
        }
    }

    #[test]
    fn ground_and_size(
        bbox in boxes(), height in uncertain(), pitch in uncertain(), roll in uncertain(),
        lens in any::<bool>()
    ) {
        let camera = camera(lens).scaled(64, 48).unwrap();
        let ground = GroundRange { roll_rad: roll, ..GroundRange::new(height, pitch) };
        if let Ok(range) = ground.measure(&camera, bbox) {
            prop_assert!(range.depth_m > 0.0 && range.depth_m.is_finite());
            prop_assert!(range.std_m >= 0.0 && range.std_m <= 0.25 * range.depth_m);
        }
        let size = SizeRange {
            width_m: Some(pitch), pitch_rad: roll.value, ..SizeRange::from_height(height)
        };
        if let Ok(range) = size.measure(&camera, bbox) {
            prop_assert!(range.depth_m > 0.0 && range.depth_m.is_finite());
            prop_assert!(range.std_m >= 0.0 && range.std_m <= 0.25 * range.depth_m);
        }
    }

    #[test]
    fn floors(
        data in prop::collection::vec(depth(), 64 * 48), bbox in boxes(),
        height in uncertain(), pitch in uncertain(), roll in uncertain()
    ) {
        let camera = camera(false).scaled(64, 48).unwrap();
        let map = DepthMap::new(Stamp::ZERO, 64, 48, data).unwrap();
        let mut fit = GroundFit::new(GroundFitOptions::default()).unwrap();
        let prior = GroundPrior { camera_height_m: height, pitch_rad: pitch, roll_rad: roll };
        if let Ok(plane) = fit.fit(&map, &camera, &[bbox], &prior, DepthNoise::new(0.01, 0.01)) {
            for found in [plane.pitch_rad, plane.roll_rad, plane.camera_height_m] {
                prop_assert!(found.value.is_finite() && found.std.is_finite() && found.std > 0.0);
            }
        }
    }
}
