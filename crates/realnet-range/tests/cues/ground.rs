use crate::random::{Rng, assert_consistent, camera};
use proptest::prelude::*;
use realnet_core::nalgebra::{Point3, Vector3};
use realnet_core::{BoundingBox, CameraModel};
use realnet_range::cues::{
    Attitude, GroundRange, GroundRangeError, RangeCue, RangeSource, Uncertain,
};

/// The point of the ground `z` ahead and with `x / z = slope`.
fn foot(attitude: Attitude, height: f64, slope: f64, z: f64) -> Option<Point3<f64>> {
    let down = attitude.down();
    // down . (slope z, y, z) = height
    let y = (height - down.x * slope * z - down.z * z) / down.y;
    (y.is_finite()).then(|| Point3::new(slope * z, y, z))
}

/// A box that ends at a pixel.
fn box_on([u, v]: [f64; 2]) -> BoundingBox {
    let (u, v) = (u + 0.5, v + 0.5);
    BoundingBox::new((u - 20.0) as f32, (v - 30.0) as f32, (u + 20.0) as f32, v as f32)
}

fn seen(camera: &CameraModel, point: &Point3<f64>) -> Option<[f64; 2]> {
    let pixel = camera.project(point).ok()?;
    (pixel[0] > 5.0 && pixel[0] < 634.0 && pixel[1] < 474.0 && pixel[1] > 5.0).then_some(pixel)
}

proptest! {
    #[test]
    fn exact_input_gives_the_exact_range(
        lens in any::<bool>(), height in 0.1..2.0f64, pitch in -0.2..0.5f64,
        roll in -0.2..0.2f64, slope in -0.4..0.4f64, heights_away in 2.0..20.0f64
    ) {
        let camera = camera(lens);
        let attitude = Attitude::new(pitch, roll);
        let point = foot(attitude, height, slope, heights_away * height).unwrap();
        let pixel = seen(&camera, &point);
        prop_assume!(pixel.is_some());
        let cue = GroundRange {
            roll_rad: Uncertain::exact(roll),
            edge_std_px: 0.0,
            ..GroundRange::new(Uncertain::exact(height), Uncertain::exact(pitch))
        };
        let range = cue.measure(&camera, box_on(pixel.unwrap())).unwrap();
        // Boxes are 32-bit: 3e-5 of a pixel, times the range per pixel.
        let tolerance = 1e-4 * point.z * point.z / height / 470.0 + 1e-9;
        prop_assert!((range.foot - point).norm() < 2.0 * tolerance, "{} {}", range.foot, point);
        prop_assert_eq!(range.std_m, 0.0);
        let cue = RangeCue::from(range);
        prop_assert_eq!((cue.source, cue.depth_m), (RangeSource::Ground, range.depth_m));
    }

    #[test]
    fn each_part_of_the_deviation_is_the_change_by_its_cause(
        lens in any::<bool>(), pitch in -0.1..0.4f64, roll in -0.2..0.2f64,
        slope in -0.3..0.3f64, z in 1.0..4.0f64
    ) {
        let camera = camera(lens);
        let point = foot(Attitude::new(pitch, roll), 0.5, slope, z).unwrap();
        let pixel = seen(&camera, &point);
        prop_assume!(pixel.is_some());
        let bbox = box_on(pixel.unwrap());
        let at = |height: f64, pitch: f64, roll: f64, bbox: BoundingBox| {
            let cue = GroundRange {
                roll_rad: Uncertain::new(roll, 1e-3),
                edge_std_px: 0.1,
                ..GroundRange::new(Uncertain::new(height, 1e-3), Uncertain::new(pitch, 1e-3))
            };
            cue.measure(&camera, bbox).unwrap()
        };
        let range = at(0.5, pitch, roll, bbox);
        let close = |part: f64, change: f64| (part - change.abs()).abs() < 0.03 * part + 1e-5;
        let moved = |dh: f64, dp: f64, dr: f64, du: f32, dv: f32| {
            let plus = at(0.5 + dh, pitch + dp, roll + dr, bbox.translated(du, dv));
            let minus = at(0.5 - dh, pitch - dp, roll - dr, bbox.translated(-du, -dv));
            0.5 * (plus.depth_m - minus.depth_m)
        };
        prop_assert!(close(range.height_m, moved(1e-3, 0.0, 0.0, 0.0, 0.0)));
        prop_assert!(close(range.pitch_m, moved(0.0, 1e-3, 0.0, 0.0, 0.0)));
        prop_assert!(close(range.roll_m, moved(0.0, 0.0, 1e-3, 0.0, 0.0)));
        let (by_u, by_v) = (moved(0.0, 0.0, 0.0, 0.1, 0.0), moved(0.0, 0.0, 0.0, 0.0, 0.1));
        prop_assert!(close(range.edge_m, by_u.hypot(by_v)), "{} {by_u} {by_v}", range.edge_m);
    }
}

#[test]
fn deviations_are_consistent() {
    let mut rng = Rng(31);
    let mut squares = Vec::new();
    let mut shares = Vec::new();
    while squares.len() < 2000 {
        let camera = camera(squares.len() % 2 == 0);
        let (height, pitch) = (rng.uniform(0.15, 1.2), rng.uniform(-0.1, 0.4));
        let (roll, slope) = (rng.uniform(-0.1, 0.1), rng.uniform(-0.3, 0.3));
        let z = height * rng.uniform(2.0, 10.0);
        let point = foot(Attitude::new(pitch, roll), height, slope, z).unwrap();
        let Some([u, v]) = seen(&camera, &point) else { continue };
        let (height_std, angle_std, edge_std) = (0.02 * height, 0.006, 1.2);
        let cue = GroundRange {
            roll_rad: Uncertain::new(roll + angle_std * rng.normal(), angle_std),
            edge_std_px: edge_std,
            ..GroundRange::new(
                Uncertain::new(height + height_std * rng.normal(), height_std),
                Uncertain::new(pitch + angle_std * rng.normal(), angle_std),
            )
        };
        let pixel = [u + edge_std * rng.normal(), v + edge_std * rng.normal()];
        let Ok(range) = cue.measure(&camera, box_on(pixel)) else { continue };
        shares.push(range.std_m / range.depth_m);
        squares.push(((range.depth_m - z) / range.std_m).powi(2));
    }
    let mean_share = shares.iter().sum::<f64>() / shares.len() as f64;
    assert!(mean_share > 0.02, "the noise is worth testing: {mean_share}");
    assert_consistent(&squares);
}

#[test]
fn what_cannot_be_ranged_is_refused_with_its_numbers() {
    let camera = camera(false);
    let cue = GroundRange::new(Uncertain::new(0.2, 0.005), Uncertain::new(0.0, 0.005));
    let reason = |bottom: f32| {
        cue.measure(&camera, BoundingBox::new(300.0, 100.0, 340.0, bottom)).unwrap_err()
    };
    // the horizon is at pixel row 236, box coordinate 236.5
    match reason(230.0) {
        GroundRangeError::AboveHorizon { above_rad, .. } => {
            assert!((above_rad - (6.5f64 / 470.0).atan()).abs() < 1e-4, "{above_rad}");
        }
        other => panic!("{other}"),
    }
    assert!(matches!(reason(236.5), GroundRangeError::AboveHorizon { .. }), "on the horizon");
    assert!(matches!(reason(240.0), GroundRangeError::TooUncertain { limit: 0.25, .. }));
    assert!(matches!(reason(478.5), GroundRangeError::Cut { rows: 480, .. }));
    assert!(matches!(reason(90.0), GroundRangeError::ImproperBox { .. }));
    assert!(matches!(reason(f32::NAN), GroundRangeError::ImproperBox { .. }));
    let beside = BoundingBox::new(-300.0, 100.0, -200.0, 300.0);
    let error = cue.measure(&camera, beside).unwrap_err();
    assert!(matches!(error, GroundRangeError::Outside { .. }), "{error}");
    let on_ceiling = GroundRange { camera_height_m: Uncertain::new(-0.2, 0.005), ..cue };
    let bbox = BoundingBox::new(300.0, 100.0, 340.0, 300.0);
    assert!(matches!(on_ceiling.measure(&camera, bbox), Err(GroundRangeError::Option(_))));
    let unsure = GroundRange { pitch_rad: Uncertain::new(0.0, f64::NAN), ..cue };
    assert!(matches!(unsure.measure(&camera, bbox), Err(GroundRangeError::Option(_))));
}

#[test]
fn nose_down_means_nearer() {
    let camera = camera(false);
    let bbox = BoundingBox::new(302.5, 200.0, 342.5, 330.5);
    let at = |pitch: f64| {
        let cue = GroundRange::new(Uncertain::new(0.5, 0.0), Uncertain::new(pitch, 0.0));
        cue.measure(&camera, bbox).unwrap().depth_m
    };
    // row 330 is 94 below the axis: 0.5 * 470 / 94 = 2.5 m when level
    assert!((at(0.0) - 2.5).abs() < 1e-9);
    let angle = (94.0f64 / 470.0).atan() + 0.1;
    let along_ground = Vector3::new(0.0, 0.5, 0.5 / angle.tan());
    // the depth along the optical axis, which is 0.1 rad nose down
    let axis = Vector3::new(0.0, 0.1f64.sin(), 0.1f64.cos());
    assert!((at(0.1) - along_ground.dot(&axis)).abs() < 1e-9);
}
