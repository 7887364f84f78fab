use crate::random::{Rng, assert_consistent};
use proptest::prelude::*;
use realnet_core::{BoundingBox, DepthMap, Stamp};
use realnet_range::cues::{
    DepthInBox, DepthInBoxError, DepthInBoxOptions, DepthNoise, PeakRule, Side, SigmaRule,
};

const WIDTH: u32 = 160;
const HEIGHT: u32 = 120;
const BOX: BoundingBox = BoundingBox::new(40.0, 30.0, 100.0, 90.0);

fn map(depth: impl FnMut((u32, u32)) -> f64) -> DepthMap {
    let pixels = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y)));
    let data = pixels.map(depth).map(|z| z as f32).collect();
    DepthMap::new(Stamp::ZERO, WIDTH, HEIGHT, data).unwrap()
}

/// Whether the target covers the pixel: an ellipse that touches the box's edges.
fn on_target((x, y): (u32, u32), shrink: f64) -> bool {
    let (cx, cy) = BOX.center();
    let dx = (f64::from(x) + 0.5 - f64::from(cx)) / (0.5 * f64::from(BOX.width()));
    let dy = (f64::from(y) + 0.5 - f64::from(cy)) / (0.5 * f64::from(BOX.height()));
    dx * dx + dy * dy < shrink * shrink
}

fn cue(change: impl FnOnce(&mut DepthInBoxOptions)) -> DepthInBox {
    let mut options = DepthInBoxOptions::default();
    change(&mut options);
    DepthInBox::new(options).unwrap()
}

/// Target at `z`, wall at `wall`, a post nearer than the target over the left
/// tenth of the box, a tenth of the pixels unknown, mixed depths at the edges.
fn scene(rng: &mut Rng, z: f64, wall: f64, noise: f64) -> DepthMap {
    map(|(x, y)| {
        let value = if x < 46 {
            0.6 * z
        } else if on_target((x, y), 0.97) {
            z
        } else if on_target((x, y), 1.0) {
            rng.uniform(z, wall)
        } else {
            wall
        };
        if rng.uniform(0.0, 1.0) < 0.1 { f64::NAN } else { value * (1.0 + noise * rng.normal()) }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_target_is_found_between_occluder_background_holes_and_mixed_edges(
        z in 0.5..6.0f64, gap in 1.3..10.0f64, noise in 0.001..0.03f64, seed in any::<u64>()
    ) {
        let mut rng = Rng(seed);
        let map = scene(&mut rng, z, gap * z, noise);
        let mut cue = cue(|_| ());
        let depth = cue.measure(&map, BOX, DepthNoise::NONE).unwrap();
        prop_assert!((depth.depth_m - z).abs() < 0.006 * z, "{} for {z}", depth.depth_m);
        prop_assert!(depth.interval.contains(z) && depth.basin.contains(z));
        prop_assert!(depth.interval.near > 0.7 * z && depth.interval.far < gap * z);
        let rival = depth.rival.unwrap();
        prop_assert!(rival.share < 1.0);
        prop_assert_eq!(depth.pixels, 3600);
        prop_assert!((2900..3500).contains(&depth.known));
        // the bins that a report draws
        let overview = cue.overview();
        prop_assert_eq!(overview.bins(), 50);
        let mass: f64 = overview.shares().iter().sum();
        prop_assert!(mass > 0.97 && mass <= 1.0 + 1e-9, "less the clipped ends: {}", mass);
    }

    #[test]
    fn scaling_all_depths_scales_the_range(scale in 0.2..5.0f64, seed in any::<u64>()) {
        let once = scene(&mut Rng(seed), 2.0, 5.0, 0.01);
        let scaled = map(|(x, y)| once.at(x, y).map_or(0.0, |z| scale * f64::from(z)));
        let mut cue = cue(|options| options.min_bin = DepthNoise::new(0.0, 0.005));
        let noise = DepthNoise::new(0.0, 0.02);
        let a = cue.measure(&once, BOX, noise).unwrap();
        let b = cue.measure(&scaled, BOX, noise).unwrap();
        // values on the edge of a bin may change sides in 32 bits
        prop_assert!((b.depth_m / a.depth_m / scale - 1.0).abs() < 1e-3);
        prop_assert!((b.std_m / a.std_m / scale - 1.0).abs() < 0.05);
    }
}

#[test]
fn deviations_of_source_and_noise_are_consistent() {
    let mut rng = Rng(11);
    let noise = DepthNoise::new(0.02, 0.03);
    let mut cue = cue(|options| options.correlation_px = 1.0);
    let squares: Vec<f64> = (0..400)
        .map(|_| {
            let z = rng.uniform(0.8, 5.0);
            let seen = z + 0.02 * rng.normal() + 0.03 * z * rng.normal();
            let wall = 2.5 * seen;
            let map = scene(&mut rng, seen, wall, 0.01);
            let depth = cue.measure(&map, BOX, noise).unwrap();
            ((depth.depth_m - z) / depth.std_m).powi(2)
        })
        .collect();
    assert_consistent(&squares);
}

#[test]
fn without_a_common_error_the_deviation_is_that_of_the_mean_and_not_too_small() {
    let mut rng = Rng(12);
    let mut cue = cue(|options| options.correlation_px = 1.0);
    let squares: Vec<f64> = (0..400)
        .map(|_| {
            let z = rng.uniform(0.8, 5.0);
            let map = map(|_| z + 0.05 * z * rng.normal());
            let depth = cue.measure(&map, BOX, DepthNoise::NONE).unwrap();
            assert!(depth.std_m < 0.012 * z, "{} at {z}", depth.std_m);
            ((depth.depth_m - z) / depth.std_m).powi(2)
        })
        .collect();
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    // The term of the interval's ends is an upper bound.
    assert!(mean > 0.03 && mean < 1.0, "mean square {mean}");
}

#[test]
fn few_wild_pixels_do_not_blunt_the_bins() {
    // 65.535 m is what 16-bit millimetres have as their last value
    for share in [0.005, 0.05] {
        let mut rng = Rng(3);
        let map = map(|(x, y)| {
            let wild = rng.uniform(0.0, 1.0) < share;
            let truth = if on_target((x, y), 1.0) { 2.0 } else { 2.4 };
            if wild { 65.535 } else { truth + 0.01 * rng.normal() }
        });
        let mut cue = cue(|_| ());
        let depth = cue.measure(&map, BOX, DepthNoise::NONE).unwrap();
        assert!((depth.depth_m - 2.0).abs() < 0.003, "{share}: {}", depth.depth_m);
        assert!(cue.histogram().bin_width() < 0.03);
        assert!(depth.interval.width() < 0.2, "{:?}", depth.interval);
    }
}

#[test]
fn which_peak_is_the_target_is_a_choice() {
    // a thin target at 2 m before a wall at 5 m, a branch at 1 m
    let mut rng = Rng(5);
    let map = map(|(x, y)| {
        let z = if y < 34 {
            1.0
        } else if on_target((x, y), 0.5) {
            2.0
        } else {
            5.0
        };
        z + 0.01 * rng.normal()
    });
    let range = |peak, center_sigma| {
        let mut cue = cue(|options| {
            options.peak = peak;
            options.center_sigma = center_sigma;
        });
        cue.measure(&map, BOX, DepthNoise::NONE)
    };
    let close = |depth: f64, expected: f64| (depth - expected).abs() < 0.01;
    let highest = range(PeakRule::Highest, None).unwrap();
    assert!(close(highest.depth_m, 5.0));
    let rival = highest.rival.unwrap();
    assert!((rival.depth_m - 2.0).abs() < 0.1 && (0.2..0.5).contains(&rival.share), "{rival:?}");
    assert!(close(range(PeakRule::Highest, Some(0.2)).unwrap().depth_m, 2.0));
    assert!(close(range(PeakRule::Nearest { min_share: 0.2 }, None).unwrap().depth_m, 2.0));
    assert!(close(range(PeakRule::Nearest { min_share: 0.01 }, None).unwrap().depth_m, 1.0));
    let expected = PeakRule::Expected { depth_m: 2.2, std_m: 0.2 };
    assert!(close(range(expected, None).unwrap().depth_m, 2.0));
    let nowhere = PeakRule::Expected { depth_m: 3.4, std_m: 0.1 };
    let error = range(nowhere, None).unwrap_err();
    assert_eq!(error, DepthInBoxError::NothingExpected { depth_m: 3.4, std_m: 0.1 });
}

#[test]
fn values_in_steps_are_no_comb() {
    // 39 mm steps, as in 8-bit depth
    let mut rng = Rng(8);
    let map = map(|pixel| {
        let z = if on_target(pixel, 1.0) { 2.5 } else { 4.0 };
        (((z + 0.05 * rng.normal()) / 0.039).round()) * 0.039
    });
    let mut cue = cue(|options| options.min_bin = DepthNoise::new(0.039, 0.0));
    let depth = cue.measure(&map, BOX, DepthNoise::NONE).unwrap();
    assert!((depth.depth_m - 2.5).abs() < 0.015, "{}", depth.depth_m);
    assert!(depth.used_share() > 0.5);
}

#[test]
fn boxes_without_a_range_say_why() {
    let unknown = DepthMap::unknown(Stamp::ZERO, WIDTH, HEIGHT).unwrap();
    let flat = map(|_| 2.0);
    let sparse = map(|(x, y)| if y == 40 && x < 50 { 2.0 } else { 0.0 });
    let mut cue = cue(|_| ());
    let mut reason = |map: &DepthMap, bbox| cue.measure(map, bbox, DepthNoise::NONE).unwrap_err();
    let beside = BoundingBox::new(170.0, 0.0, 190.0, 20.0);
    assert!(matches!(reason(&flat, beside), DepthInBoxError::Outside { width: 160, .. }));
    let swapped = BoundingBox::new(50.0, 0.0, 40.0, 20.0);
    assert!(matches!(reason(&flat, swapped), DepthInBoxError::ImproperBox { .. }));
    let hole = BoundingBox::new(f32::NAN, 0.0, 40.0, 20.0);
    assert!(matches!(reason(&flat, hole), DepthInBoxError::ImproperBox { .. }));
    // between two centres
    let thin = BoundingBox::new(50.6, 0.0, 51.4, 20.0);
    assert!(matches!(reason(&flat, thin), DepthInBoxError::Outside { .. }));
    assert_eq!(reason(&unknown, BOX), DepthInBoxError::NothingKnown { pixels: 3600 });
    let few = DepthInBoxError::TooFewKnown { known: 10, pixels: 3600, needed: 12 };
    assert_eq!(reason(&sparse, BOX), few);
    assert!(cue.foreground(&SigmaRule::default()).is_err(), "nothing measured");
    assert_eq!(cue.histogram().bins(), 0);
    let bad = DepthNoise::new(f64::NAN, 0.0);
    assert!(matches!(cue.measure(&flat, BOX, bad), Err(DepthInBoxError::Option(_))));
    let half_outside = BoundingBox::new(140.0, 100.0, 220.0, 180.0);
    assert_eq!(cue.measure(&flat, half_outside, DepthNoise::NONE).unwrap().pixels, 400);
}

#[test]
fn thin_peaks_are_refused() {
    let mut rng = Rng(4);
    let map = map(|_| rng.uniform(1.0, 9.0));
    let small = BoundingBox::new(40.0, 30.0, 44.0, 34.0);
    let error = cue(|_| ()).measure(&map, small, DepthNoise::NONE).unwrap_err();
    assert!(matches!(error, DepthInBoxError::ThinPeak { needed: 12, .. }), "{error}");
}

#[test]
fn options_out_of_range_are_refused_by_name() {
    type Change = fn(&mut DepthInBoxOptions);
    let changes: [(&str, Change); 6] = [
        ("bins", |options| options.bins = 4),
        ("widen_share", |options| options.widen_share = 1.0),
        ("clip_share", |options| options.clip_share = f64::NAN),
        ("min_pixels", |options| options.min_pixels = 0),
        ("min_share", |options| options.peak = PeakRule::Nearest { min_share: 0.0 }),
        ("max_depth_m", |options| options.max_depth_m = 0.0),
    ];
    for (name, change) in changes {
        let mut options = DepthInBoxOptions::default();
        change(&mut options);
        assert_eq!(DepthInBox::new(options).unwrap_err().name, name);
    }
}

#[test]
fn the_sigma_rule_finds_mean_and_deviation_of_the_target() {
    let mut rng = Rng(21);
    let map = map(|pixel| {
        let z = if on_target(pixel, 1.0) { 2.0 } else { 3.0 };
        z + 0.05 * rng.normal()
    });
    let mut cue = cue(|_| ());
    cue.measure(&map, BOX, DepthNoise::NONE).unwrap();
    let foreground = cue.foreground(&SigmaRule::default()).unwrap();
    assert!((foreground.mean_m - 2.0).abs() < 0.005, "{foreground:?}");
    assert!((foreground.sigma_m - 0.05).abs() < 0.004, "{foreground:?}");
    assert!((f64::from(foreground.gate.near) - 1.85).abs() < 0.015);
    assert!((f64::from(foreground.gate.far) - 2.15).abs() < 0.015);
    // pi / 4 of the box
    assert!((foreground.share - 0.785).abs() < 0.02, "{foreground:?}");
    let two = SigmaRule { sigmas: 2.0, ..SigmaRule::default() };
    let two = cue.foreground(&two).unwrap();
    assert!((two.sigma_m - 0.05).abs() < 0.005, "corrected for the cut: {two:?}");
}

#[test]
fn the_sigma_rule_does_not_creep_along_the_floor() {
    // a floor that rises from the target's foot to the wall under it
    let mut rng = Rng(22);
    let map = map(|(x, y)| {
        let z = if on_target((x, y), 0.9) {
            2.0
        } else if y > 60 {
            1.6 + 2.4 * f64::from(90_u32.saturating_sub(y)) / 30.0
        } else {
            4.0
        };
        z + 0.02 * rng.normal()
    });
    let mut cue = cue(|_| ());
    let depth = cue.measure(&map, BOX, DepthNoise::NONE).unwrap();
    assert!((depth.depth_m - 2.0).abs() < 0.01);
    let foreground = cue.foreground(&SigmaRule::default()).unwrap();
    assert!(foreground.gate.near > 1.85 && foreground.gate.far < 2.15, "{foreground:?}");
}

#[test]
fn pixels_are_split_as_the_truth_says() {
    let mut rng = Rng(23);
    let map = scene(&mut rng, 2.0, 4.0, 0.01);
    let mut cue = cue(|_| ());
    cue.measure(&map, BOX, DepthNoise::NONE).unwrap();
    let gate = cue.foreground(&SigmaRule::default()).unwrap().gate;
    let (mut right, mut wrong, mut unclear) = (0, 0, 0);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let mixed = on_target((x, y), 1.0) && !on_target((x, y), 0.97);
            let Some(depth) = map.at(x, y).filter(|_| !mixed && x >= 46) else { continue };
            let truth = if on_target((x, y), 0.97) { Side::Target } else { Side::Background };
            match gate.class_of([x as f32, y as f32], depth) {
                Side::Unclear => unclear += 1,
                side if side == truth => right += 1,
                _ => wrong += 1,
            }
        }
    }
    // 3 deviations leave out 0.3 % of the target
    assert!(wrong * 500 < right && unclear * 20 < right, "{right} {wrong} {unclear}");
}
