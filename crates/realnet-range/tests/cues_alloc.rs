//! After the first frame no cue allocates.
#![allow(clippy::unwrap_used, reason = "a test")]

#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;

use counting::count;
use realnet_core::nalgebra::{Matrix6, UnitQuaternion, Vector3};
use realnet_core::{BoundingBox, CameraModel, DepthMap, Distortion, Intrinsics, Pose, Stamp};
use realnet_range::cues::{
    DepthInBox, DepthInBoxOptions, DepthNoise, GroundFit, GroundFitOptions, GroundPrior,
    GroundRange, PitchFilter, PitchFilterOptions, RangeCue, SigmaRule, SizeRange, Uncertain,
    attitude_from_horizon, disagreements, pitch_from_translation,
};

#[test]
fn the_steady_state_does_not_allocate() {
    let intrinsics = Intrinsics { fx: 160.0, fy: 160.0, cx: 79.5, cy: 59.5 };
    let camera = CameraModel::new(160, 120, intrinsics, Distortion::None).unwrap();
    // a floor 0.4 m below, a target at 2 m
    let data = (0..160 * 120)
        .map(|index| {
            let (x, y) = (index % 160, index / 160);
            let floor = 0.4 * 160.0 / (f64::from(y) - 59.5).max(1.0);
            let target = (60..100).contains(&x) && (50..92).contains(&y);
            (if target { 2.0 } else { floor.min(6.0) }) as f32
        })
        .collect();
    let map = DepthMap::new(Stamp::ZERO, 160, 120, data).unwrap();
    let bbox = BoundingBox::new(60.0, 50.0, 100.0, 92.0);
    let noise = DepthNoise::new(0.01, 0.02);
    let mut depth = DepthInBox::new(DepthInBoxOptions::default()).unwrap();
    let mut fit = GroundFit::new(GroundFitOptions::default()).unwrap();
    let height = Uncertain::new(0.4, 0.01);
    let mount = Uncertain::new(0.0, 0.02);
    let mut filter = PitchFilter::new(mount, PitchFilterOptions::default()).unwrap();
    let pose = Pose::from_translation(Vector3::new(0.0, 0.0, -0.1));
    let covariance = Matrix6::identity() * 1e-6;
    let mut frame = || {
        let in_box = depth.measure(&map, bbox, noise).unwrap();
        let gate = depth.foreground(&SigmaRule::default()).unwrap().gate;
        assert!(gate.contains(80.0, 70.0, 2.0));
        let prior = GroundPrior { camera_height_m: height, pitch_rad: mount, roll_rad: mount };
        let plane = fit.fit(&map, &camera, &[bbox], &prior, noise).unwrap();
        filter.predict(&UnitQuaternion::identity(), 1e-3, 0.033).unwrap();
        assert!(filter.update(&plane.measurement()).unwrap().accepted);
        let moved = pitch_from_translation(&pose, &covariance, mount, 1e-3).unwrap();
        assert!(filter.update(&moved).unwrap().accepted);
        attitude_from_horizon(&camera, [20.0, 59.5], [140.0, 59.5], 1.0).unwrap();
        let ground = GroundRange::new(height, filter.pitch_rad());
        let ground = ground.measure(&camera, bbox).unwrap();
        let size = SizeRange::from_height(Uncertain::new(0.525, 0.02));
        let size = size.measure(&camera, bbox).unwrap();
        let cues = [RangeCue::from(in_box), ground.into(), size.into()];
        assert_eq!(disagreements(&cues, 3.0).count(), 0, "{cues:?}");
    };
    frame();
    let before = count();
    for _ in 0..5 {
        frame();
    }
    assert_eq!(count() - before, 0);
}
