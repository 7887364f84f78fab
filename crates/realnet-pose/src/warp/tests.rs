use super::*;
use realnet_core::nalgebra::{UnitQuaternion, Vector3};
use realnet_core::{Distortion, Intrinsics};

fn camera(width: u32, height: u32, distortion: Distortion) -> CameraModel {
    let (cx, cy) = (f64::from(width) / 2.0 - 0.5, f64::from(height) / 2.0 - 0.5);
    let intrinsics = Intrinsics { fx: 100.0, fy: 110.0, cx, cy };
    CameraModel::new(width, height, intrinsics, distortion).unwrap()
}

/// The depths of the plane `normal * p = 1` seen by `camera`, placed by
/// `camera_from_world`.
fn plane(camera: &CameraModel, normal: Vector3<f64>, camera_from_world: &Pose) -> Vec<f64> {
    let normal_here = camera_from_world.rotation() * normal;
    let offset = 1.0 + normal_here.dot(&camera_from_world.translation());
    let mut depths = Vec::new();
    for y in 0..camera.height() {
        for x in 0..camera.width() {
            let [u, v] = camera.unproject([f64::from(x), f64::from(y)]).unwrap();
            depths.push(offset / normal_here.dot(&Vector3::new(u, v, 1.0)));
        }
    }
    depths
}

fn map(camera: &CameraModel, depths: &[f64]) -> DepthMap {
    let data = depths.iter().map(|&z| z as f32).collect();
    DepthMap::new(Stamp::ZERO, camera.width(), camera.height(), data).unwrap()
}

#[test]
fn a_slanted_plane_is_warped_onto_itself() {
    let motion = Pose::new(
        UnitQuaternion::from_euler_angles(0.02, -0.03, 0.05),
        Vector3::new(0.05, -0.02, -0.15), // towards it: the picture is stretched
    );
    let bent = Distortion::PlumbBob([-0.2, 0.05, 0.001, -0.002, 0.0]);
    for distortion in [Distortion::None, bent] {
        let camera = camera(96, 64, distortion);
        let normal = Vector3::new(0.05, 0.1, 0.5);
        let then = map(&camera, &plane(&camera, normal, &Pose::identity()));
        let truth = plane(&camera, normal, &motion);
        let mut now = DepthMap::unknown(Stamp::ZERO, 96, 64).unwrap();
        let stamp = Stamp::from_nanos(7);
        DepthWarper::new(&camera).warp(&then, stamp, Some(&motion), None, &mut now).unwrap();
        assert_eq!(now.stamp(), stamp);
        assert!(now.known_share() > 0.9, "{}", now.known_share());
        // Only the border, and few pixels where cracks run askew, may be unknown.
        let mut holes = 0;
        for y in 8..56 {
            for x in 10..86 {
                let Some(z) = now.at(x, y) else {
                    holes += 1;
                    continue;
                };
                let expected = truth[(y * 96 + x) as usize];
                // A pixel holds the nearest point within half a pixel and a bit.
                assert!((f64::from(z) / expected - 1.0).abs() < 0.004, "{z} {expected}");
            }
        }
        assert!(holes <= 4, "{holes} of {} pixels", 48 * 76);
    }
}

/// A near square before a far wall: the camera moves right, the square uncovers
/// wall that was never seen.
#[test]
fn what_was_hidden_is_unknown_and_the_nearer_point_wins() {
    let camera = camera(100, 60, Distortion::None);
    let square = |x: u32, y: u32| (40..60).contains(&x) && (20..40).contains(&y);
    let data =
        (0..60).flat_map(|y| (0..100).map(move |x| if square(x, y) { 1.0 } else { 4.0 })).collect();
    let then = DepthMap::new(Stamp::ZERO, 100, 60, data).unwrap();
    // 0.1 m to the right: the square goes 10 pixels left, the wall 2.5.
    let motion = Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0));
    let mut now = then.clone();
    let mut warper = DepthWarper::new(&camera);
    warper.warp(&then, Stamp::ZERO, Some(&motion), None, &mut now).unwrap();
    for x in 0..97 {
        let expected = match x {
            30..50 => Some(1.0),
            50..57 => None,
            _ => Some(4.0),
        };
        if ![57, 29, 97].contains(&x) {
            assert_eq!(now.at(x, 30), expected, "{x}");
        }
    }
    // Above the square there is wall only.
    assert_eq!(now.at(50, 10), Some(4.0));
}

#[test]
fn a_target_moves_on_its_own() {
    let camera = camera(100, 60, Distortion::None);
    let data = (0..6000).map(|i| if (40..60).contains(&(i % 100)) { 1.0 } else { 4.0 }).collect();
    let then = DepthMap::new(Stamp::ZERO, 100, 60, data).unwrap();
    let region = WarpRegion {
        start: (35, 0),
        end: (65, 60),
        depths: (0.5, 2.0),
        motion: Some(Pose::from_translation(Vector3::new(0.2, 0.0, 0.0))),
    };
    let mut now = then.clone();
    let mut warper = DepthWarper::new(&camera);
    let still = Pose::identity();
    warper.warp(&then, Stamp::ZERO, Some(&still), Some(&region), &mut now).unwrap();
    let row: Vec<_> = (0..100).map(|x| now.at(x, 30)).collect();
    assert!(row[..40].iter().all(|z| *z == Some(4.0)), "{row:?}");
    assert!(row[40..60].iter().all(|z| z.is_none()), "{row:?}");
    assert!(row[60..80].iter().all(|z| *z == Some(1.0)), "{row:?}");
    assert!(row[80..].iter().all(|z| *z == Some(4.0)), "{row:?}");

    // Its motion unknown: neither it nor what it hid is known.
    let lost = WarpRegion { motion: None, ..region };
    warper.warp(&then, Stamp::ZERO, Some(&still), Some(&lost), &mut now).unwrap();
    assert!((0..100).all(|x| now.at(x, 30).is_none() == (40..60).contains(&x)));

    // The cheap way: the target alone; and nothing is left from before.
    warper.warp(&then, Stamp::ZERO, None, Some(&region), &mut now).unwrap();
    assert!((0..100).all(|x| now.at(x, 30).is_some() == (60..80).contains(&x)));
    let rows = WarpRegion { start: (35, 20), end: (900, 30), ..region };
    warper.warp(&then, Stamp::ZERO, None, Some(&rows), &mut now).unwrap();
    assert_eq!(now.data().iter().filter(|z| DepthMap::is_known(**z)).count(), 200);
}

#[test]
fn what_is_behind_outside_or_unknown_is_dropped() {
    let camera = camera(20, 10, Distortion::None);
    let mut data = vec![1.0; 200];
    data[0] = f32::NAN;
    data[1] = f32::INFINITY;
    data[2] = -1.0;
    let then = DepthMap::new(Stamp::ZERO, 20, 10, data).unwrap();
    let mut now = then.clone();
    let mut warper = DepthWarper::new(&camera);
    warper.warp(&then, Stamp::ZERO, Some(&Pose::identity()), None, &mut now).unwrap();
    assert_eq!(now.data().iter().filter(|z| **z == 0.0).count(), 3);
    for z in [-1.0, -1.5, f64::NAN, 1e30] {
        let gone = Pose::from_translation(Vector3::new(if z > 0.0 { z } else { 0.0 }, 0.0, z));
        warper.warp(&then, Stamp::ZERO, Some(&gone), None, &mut now).unwrap();
        assert_eq!(now.known_share(), 0.0, "{z}");
    }
}

#[test]
fn wrong_sizes_are_refused() {
    let camera = camera(20, 10, Distortion::None);
    let mut warper = DepthWarper::new(&camera);
    let good = DepthMap::unknown(Stamp::ZERO, 20, 10).unwrap();
    let mut bad = DepthMap::unknown(Stamp::ZERO, 10, 20).unwrap();
    let error = warper.warp(&good, Stamp::ZERO, None, None, &mut bad).unwrap_err();
    assert_eq!(error.to_string(), "the output depth map has 10x20 pixels, the camera 20x10");
    let mut out = good;
    assert!(warper.warp(&bad, Stamp::ZERO, None, None, &mut out).is_err());
}
