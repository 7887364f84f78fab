//! The fast path on drawn scenes with known motions.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod scene;

use proptest::prelude::*;
use realnet_core::nalgebra::{Point3, Vector3, Vector6};
use realnet_core::{BoundingBox, DepthMap, Frame, Pose, Stamp, body_from_optical};
use realnet_pose::Origin;
use realnet_range::cues::ForegroundGate;
use realnet_range::motion::{MotionError, MotionFailure, MotionOptions, MotionTracker, Start};
use scene::{Scene, camera};

/// Frames and depths of a scene over time; the target's box and depths at 0.
struct Run {
    scene: Scene,
    world_from_camera: fn(f64) -> Pose,
    world_from_target: fn(f64) -> Pose,
}

impl Run {
    /// The camera goes forward and turns, the target goes to the right and away.
    fn drive() -> Self {
        Self {
            scene: Scene::default(),
            world_from_camera: |t| Pose::exp(&(Vector6::new(0.05, 0.0, 0.4, 0.02, 0.08, 0.0) * t)),
            world_from_target: |t| {
                Pose::from_translation(Vector3::new(-0.1 + 0.3 * t, 0.1, 2.0 + 0.3 * t))
            },
        }
    }

    fn at(&self, t: f64) -> (Frame, DepthMap) {
        let stamp = Stamp::from_secs_f64(t);
        let camera_from_world = (self.world_from_camera)(t).inverse();
        let camera_from_target = camera_from_world * (self.world_from_target)(t);
        self.scene.draw(stamp, &camera_from_world, &camera_from_target)
    }

    fn gate(&self, t: f64) -> ForegroundGate {
        let camera_from_target =
            (self.world_from_camera)(t).inverse() * (self.world_from_target)(t);
        self.scene.gate(&camera_from_target)
    }

    /// `now_from_then` of the background and of the target.
    fn motions(&self, then: f64, now: f64) -> (Pose, Pose) {
        let camera_from_world = |t| (self.world_from_camera)(t).inverse();
        let camera_from_target = |t| camera_from_world(t) * (self.world_from_target)(t);
        (
            camera_from_world(now) * camera_from_world(then).inverse(),
            camera_from_target(now) * camera_from_target(then).inverse(),
        )
    }
}

fn tracker() -> MotionTracker {
    MotionTracker::new(&camera(), MotionOptions::default()).unwrap()
}

/// A tracker that was given the depth of time 0.
fn keyed(run: &Run) -> MotionTracker {
    let mut tracker = tracker();
    let (frame, depth) = run.at(0.0);
    tracker.push(&frame).unwrap();
    tracker.keep();
    let summary = tracker.set_depth(&depth, Some(&run.gate(0.0))).unwrap();
    assert!(summary.background > 40 && summary.target >= 12, "{summary:?}");
    tracker
}

#[test]
fn both_motions_are_found_and_the_depth_follows() {
    let run = Run::drive();
    let mut tracker = keyed(&run);
    let mut produced = DepthMap::unknown(Stamp::ZERO, 320, 240).unwrap();
    for step in 1..=9 {
        let t = f64::from(step) / 30.0;
        let (frame, truth) = run.at(t);
        tracker.push(&frame).unwrap();
        let motion = tracker.estimate().clone();
        let (background, target) = run.motions(0.0, t);
        let found = motion.background.as_ref().unwrap();
        let error = found.now_from_then() * background.inverse();
        assert!(error.rotation_angle().to_degrees() < 0.1, "{step}: {error:?}");
        assert!(error.translation_norm() < 0.006, "{step}: {error:?}");
        let found = motion.target.as_ref().unwrap().as_ref().unwrap();
        // At the target's middle: rotation and translation of a small target are tied.
        let middle = found.estimate.center;
        let then = found.now_from_then().inverse() * middle;
        assert!((target * then - middle).norm() < 0.01, "{step}");
        assert_eq!(found.start, Start::Predicted, "{step}");

        tracker.depth_now(&mut produced).unwrap();
        assert_eq!(produced.stamp(), frame.stamp());
        let (mut errors, mut known) = (Vec::new(), 0);
        for (p, t) in produced.data().iter().zip(truth.data()) {
            if DepthMap::is_known(*p) {
                known += 1;
                errors.push((p - t).abs() / t);
            }
        }
        assert!(known as f64 / truth.data().len() as f64 > 0.85, "{step}: {known}");
        errors.sort_by(f32::total_cmp);
        assert!(errors[errors.len() / 2] < 0.002, "{step}: median {}", errors[errors.len() / 2]);
        let p95 = errors[errors.len() * 95 / 100];
        assert!(p95 < 0.02, "{step}: 95 % {p95}");

        // The cheap way knows the target alone, and the same of it.
        let mut alone = produced.clone();
        tracker.target_depth_now(&mut alone).unwrap();
        let share = alone.known_share();
        assert!(share > 0.01 && share < 0.2, "{step}: {share}");
        let gate = run.gate(t);
        let outside = (0..240)
            .flat_map(|y| (0..320).map(move |x| (x, y)))
            .filter(|&(x, y)| alone.at(x, y).is_some())
            .filter(|&(x, y)| !gate.bbox.contains_with(x, y, 2.0))
            .count();
        assert_eq!(outside, 0, "{step}");
    }
}

trait Around {
    fn contains_with(&self, x: u32, y: u32, margin: f32) -> bool;
}

impl Around for BoundingBox {
    fn contains_with(&self, x: u32, y: u32, margin: f32) -> bool {
        let (x, y) = (x as f32 + 0.5, y as f32 + 0.5);
        let m = margin;
        x > self.x0 - m && x < self.x1 + m && y > self.y0 - m && y < self.y1 + m
    }
}

#[test]
fn speeds_come_with_their_deviations() {
    let run = Run::drive();
    let mut tracker = keyed(&run);
    for step in 1..=9 {
        tracker.push(&run.at(f64::from(step) / 30.0).0).unwrap();
        tracker.estimate();
    }
    let motion = tracker.motion().unwrap();
    assert!((motion.seconds() - 0.3).abs() < 1e-9);
    // The camera's twist is the one that drives it.
    let camera = motion.camera_velocity().unwrap();
    let truth = Vector6::new(0.05, 0.0, 0.4, 0.02, 0.08, 0.0);
    assert!((camera.twist - truth).norm() < 0.02, "{:?}", camera.twist);
    for axis in 0..6 {
        let error = (camera.twist[axis] - truth[axis]).abs();
        assert!(error < 5.0 * camera.std()[axis], "{axis}: {error} {:?}", camera.std());
    }
    // Of a body that carries it: forward is x, left is y.
    let own = motion.own_velocity(&body_from_optical()).unwrap();
    assert!((own.linear() - Vector3::new(0.4, -0.05, 0.0)).norm() < 0.02, "{own:?}");
    assert!((own.angular() - Vector3::new(0.0, -0.02, -0.08)).norm() < 0.01, "{own:?}");
    // The target's over the ground, in the axes of the first camera.
    let target = motion.target_velocity().unwrap();
    let error = target.linear() - Vector3::new(0.3, 0.0, 0.3);
    assert!(error.norm() < 0.06, "{target:?}");
    for axis in 0..3 {
        assert!(error[axis].abs() < 5.0 * target.std()[axis], "{axis}: {error} {:?}", target.std());
    }
    let moved = motion.target_motion().unwrap();
    let then = Point3::from((run.world_from_target)(0.0).translation());
    let now = (run.world_from_target)(0.3).translation();
    assert!((moved * then - Point3::from(now)).norm() < 0.02);
}

/// A map of time 0 that comes at time 0.2 takes over without a jump.
#[test]
fn a_late_depth_map_starts_from_the_motion_so_far() {
    let run = Run::drive();
    let mut tracker = keyed(&run);
    let mut kept = None;
    for step in 1..=12 {
        let t = f64::from(step) / 30.0;
        let (frame, depth) = run.at(t);
        tracker.push(&frame).unwrap();
        if step != 10 {
            assert!(tracker.estimate().background.is_ok());
        }
        if step == 4 {
            tracker.keep();
            kept = Some((t, depth));
            assert_eq!(tracker.kept(), Some(frame.stamp()));
        } else if step == 10 {
            let (then, depth) = kept.take().unwrap();
            tracker.set_depth(&depth, Some(&run.gate(then))).unwrap();
            assert_eq!(tracker.kept(), None);
            let motion = tracker.estimate();
            let found = motion.background.as_ref().unwrap();
            assert_eq!(found.start, Start::Predicted);
            let error = found.now_from_then() * run.motions(then, t).0.inverse();
            assert!(error.translation_norm() < 0.004, "{error:?}");
        }
    }
}

#[test]
fn what_cannot_be_seen_is_unknown_with_the_reason_and_found_again() {
    let run = Run::drive();
    let mut tracker = tracker();
    let mut out = DepthMap::unknown(Stamp::ZERO, 320, 240).unwrap();
    let (frame, depth) = run.at(0.0);
    tracker.push(&frame).unwrap();
    assert_eq!(tracker.estimate().background, Err(MotionFailure::NoDepth));
    assert_eq!(tracker.depth_now(&mut out), Err(MotionError::Unknown(MotionFailure::NoDepth)));
    tracker.keep();
    tracker.set_depth(&depth, Some(&run.gate(0.0))).unwrap();
    assert_eq!(tracker.depth_now(&mut out), Err(MotionError::Unknown(MotionFailure::NotEstimated)));
    // A hand before the lens.
    let dark = Frame::grey8(Stamp::from_secs_f64(0.03), 320, 240, vec![20; 320 * 240]).unwrap();
    tracker.push(&dark).unwrap();
    let motion = tracker.estimate().clone();
    let failure = motion.background.unwrap_err();
    assert!(matches!(failure, MotionFailure::Lost { body: "background", .. }), "{failure}");
    assert!(failure.to_string().starts_with("only 0 of "), "{failure}");
    assert!(matches!(motion.target, Some(Err(MotionFailure::Lost { body: "target", .. }))));
    assert!(matches!(tracker.depth_now(&mut out), Err(MotionError::Unknown(_))));
    assert!(matches!(tracker.target_depth_now(&mut out), Err(MotionError::Unknown(_))));
    assert!(tracker.motion().unwrap().camera_velocity().is_none());
    // Gone again.
    tracker.push(&run.at(0.1).0).unwrap();
    assert!(tracker.estimate().background.is_ok());
    tracker.depth_now(&mut out).unwrap();
}

/// Half the picture at once: no flow from where the corners were finds them.
#[test]
fn a_fast_pan_is_searched_for() {
    let run = Run {
        world_from_camera: |t| Pose::exp(&(Vector6::new(0.0, 0.0, 0.0, 0.0, 0.3, 0.0) * t)),
        ..Run::drive()
    };
    let mut tracker = keyed(&run);
    tracker.push(&run.at(1.0).0).unwrap();
    let motion = tracker.estimate();
    let found = motion.background.as_ref().unwrap();
    assert_eq!(found.start, Start::Search);
    let error = found.now_from_then() * run.motions(0.0, 1.0).0.inverse();
    assert!(error.rotation_angle().to_degrees() < 0.2, "{error:?}");
}

/// Twenty centimetres at two metres: no rotation of its own, but a translation.
#[test]
fn a_small_target_is_followed_under_the_rotation_of_the_ground() {
    let run = Run { scene: Scene::default().with_target(0.1), ..Run::drive() };
    let (frame, depth) = run.at(0.0);
    let mut tracker = tracker();
    tracker.push(&frame).unwrap();
    tracker.keep();
    let summary = tracker.set_depth(&depth, Some(&run.gate(0.0))).unwrap();
    assert!((6..16).contains(&summary.target), "{summary:?}");
    let mut translations = 0;
    for step in 1..=9 {
        let t = f64::from(step) / 30.0;
        tracker.push(&run.at(t).0).unwrap();
        let motion = tracker.estimate();
        let found = motion.target.as_ref().unwrap().as_ref().unwrap();
        translations += usize::from(found.estimate.origin == Origin::Translation);
        let middle = found.estimate.center;
        let then = found.now_from_then().inverse() * middle;
        let truth = run.motions(0.0, t).1 * then;
        assert!((truth - middle).norm() < 0.06, "{step}: {truth} {middle}");
        let velocity = motion.target_velocity().unwrap();
        for axis in 0..3 {
            let error = (velocity.linear() - Vector3::new(0.3, 0.0, 0.3))[axis].abs();
            assert!(error < 5.0 * velocity.std()[axis], "{step} {axis}: {error} {velocity:?}");
        }
    }
    assert!(translations >= 5, "{translations}");
}

/// A body that moves by itself and is nobody's target must not pass for ground.
#[test]
fn a_stranger_in_the_scene_is_no_ground() {
    let run = Run::drive();
    let mut tracker = tracker();
    let (frame, depth) = run.at(0.0);
    tracker.push(&frame).unwrap();
    tracker.keep();
    tracker.set_depth(&depth, None).unwrap();
    for step in 1..=9 {
        let t = f64::from(step) / 30.0;
        tracker.push(&run.at(t).0).unwrap();
        let motion = tracker.estimate();
        let found = motion.background.as_ref().unwrap().now_from_then();
        let error = found * run.motions(0.0, t).0.inverse();
        // As long as it moved by less than a pixel, it cannot be told from noise.
        let (metres, degrees) = if step < 3 { (0.04, 0.5) } else { (0.004, 0.05) };
        assert!(error.translation_norm() < metres, "{step}: {error:?}");
        assert!(error.rotation_angle().to_degrees() < degrees, "{step}: {error:?}");
    }
}

/// Without the target's motion its pixels, and those behind, are unknown.
#[test]
fn a_lost_target_leaves_a_hole() {
    let run = Run::drive();
    let mut tracker = tracker();
    let (frame, depth) = run.at(0.0);
    tracker.push(&frame).unwrap();
    tracker.keep();
    // A box on the bare wall's depth: no corner of it is the target's.
    let bbox = run.gate(0.0).bbox;
    tracker.set_depth(&depth, Some(&ForegroundGate::new(bbox, 0.1, 0.2))).unwrap();
    tracker.push(&run.at(0.03).0).unwrap();
    let motion = tracker.estimate();
    assert!(matches!(
        motion.target,
        Some(Err(MotionFailure::Corners { body: "target", found: 0, .. }))
    ));
    assert!(motion.background.is_ok());
    assert!(motion.target_velocity().is_none());
    // A box whose inside is all the target's.
    let mut tracker = self::tracker();
    tracker.push(&frame).unwrap();
    tracker.keep();
    let small = BoundingBox::new(bbox.x0 + 10.0, bbox.y0 + 10.0, bbox.x0 + 14.0, bbox.y0 + 14.0);
    tracker.set_depth(&depth, Some(&ForegroundGate::new(small, 0.5, 9.0))).unwrap();
    tracker.push(&run.at(0.03).0).unwrap();
    assert!(tracker.estimate().target.as_ref().unwrap().is_err());
    let mut out = DepthMap::unknown(Stamp::ZERO, 320, 240).unwrap();
    tracker.depth_now(&mut out).unwrap();
    let (x, y) = (bbox.x0 as u32 + 12, bbox.y0 as u32 + 12);
    assert_eq!(out.at(x, y), None);
    assert!(out.known_share() > 0.9);
}

#[test]
fn depth_maps_of_a_network_are_smaller_than_the_frame() {
    let run = Run::drive();
    let (frame, depth) = run.at(0.0);
    let small: Vec<f32> = (0..60)
        .flat_map(|y| (0..80).map(move |x| (x, y)))
        .map(|(x, y)| depth.at(4 * x + 2, 4 * y + 2).unwrap())
        .collect();
    let small = DepthMap::new(Stamp::ZERO, 80, 60, small).unwrap();
    let gate = run.gate(0.0).scaled(0.25, 0.25);
    let mut tracker = tracker();
    tracker.push(&frame).unwrap();
    tracker.keep();
    let summary = tracker.set_depth(&small, Some(&gate)).unwrap();
    assert!(summary.background > 40 && summary.target > 4, "{summary:?}");
    tracker.push(&run.at(0.1).0).unwrap();
    let motion = tracker.estimate();
    let error =
        motion.background.as_ref().unwrap().now_from_then() * run.motions(0.0, 0.1).0.inverse();
    assert!(error.translation_norm() < 0.005, "{error:?}");
    let mut out = DepthMap::unknown(Stamp::ZERO, 80, 60).unwrap();
    tracker.depth_now(&mut out).unwrap();
    assert!(out.known_share() > 0.85);
    let mut wrong = DepthMap::unknown(Stamp::ZERO, 320, 240).unwrap();
    assert!(matches!(tracker.depth_now(&mut wrong), Err(MotionError::Warp(_))));
}

#[test]
fn wrong_use_is_refused_and_costs_nothing() {
    let run = Run::drive();
    let mut tracker = tracker();
    let (frame, depth) = run.at(0.0);
    tracker.keep(); // nothing to keep
    assert_eq!(tracker.kept(), None);
    assert_eq!(tracker.set_depth(&depth, None), Err(MotionError::NotKept(Stamp::ZERO)));
    tracker.push(&frame).unwrap();
    let error = tracker.push(&frame).unwrap_err();
    assert_eq!(error.to_string(), "a frame of 0 s after one of 0 s: frames come in order");
    let small = Frame::grey8(Stamp::from_nanos(1), 32, 24, vec![0; 32 * 24]).unwrap();
    let error = tracker.push(&small).unwrap_err();
    assert_eq!(error.to_string(), "a frame of 32x24 pixels for a camera of 320x240");
    tracker.keep();
    let other = depth.clone().with_stamp(Stamp::from_nanos(5));
    assert!(matches!(tracker.set_depth(&other, None), Err(MotionError::NotKept(_))));
    tracker.set_depth(&depth, None).unwrap();
    assert!(matches!(tracker.set_depth(&depth, None), Err(MotionError::NotKept(_))), "twice");
    for options in [
        MotionOptions { max_depth_step: 0.0, ..MotionOptions::default() },
        MotionOptions { scale_std: f64::NAN, ..MotionOptions::default() },
    ] {
        let error = MotionTracker::new(&camera(), options).unwrap_err();
        assert!(matches!(error, MotionError::Option { .. }), "{error}");
    }
    tracker.push(&run.at(0.03).0).unwrap();
    assert!(tracker.estimate().target.is_none());
    let mut out = depth.clone();
    assert_eq!(
        tracker.target_depth_now(&mut out),
        Err(MotionError::Unknown(MotionFailure::NoTarget))
    );
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let run = Run::drive();
    let maps = || {
        let mut tracker = keyed(&run);
        let mut out = DepthMap::unknown(Stamp::ZERO, 320, 240).unwrap();
        let mut all = Vec::new();
        for step in 1..4 {
            tracker.push(&run.at(f64::from(step) / 30.0).0).unwrap();
            all.push(format!("{:?}", tracker.estimate()));
            tracker.depth_now(&mut out).unwrap();
            all.push(format!("{:?}", out.data().iter().map(|z| z.to_bits()).collect::<Vec<_>>()));
        }
        all
    };
    assert!(maps() == maps());
}

/// A camera that shakes: from a map's frame to its arrival the rate has turned around.
/// Only the motion measured since then predicts the corners, whether a frame is kept
/// before or after its motion is estimated.
#[test]
fn a_late_depth_map_keeps_the_motion_since_its_frame() {
    let run = Run {
        world_from_camera: |t| {
            let yaw = 0.1 * (4.0 * std::f64::consts::PI * t).sin();
            Pose::exp(&Vector6::new(0.0, 0.0, 0.2 * t, 0.0, yaw, 0.0))
        },
        ..Run::drive()
    };
    for keep_first in [true, false] {
        let mut tracker = keyed(&run);
        let mut kept = None;
        for step in 1..=40 {
            let t = f64::from(step) / 30.0;
            let (frame, depth) = run.at(t);
            tracker.push(&frame).unwrap();
            let due = step % 9 == 0;
            if due && keep_first {
                tracker.keep();
            }
            let start = tracker.estimate().background.as_ref().unwrap().start;
            assert_eq!(start, Start::Predicted, "{keep_first} {step}");
            if due {
                if !keep_first {
                    tracker.keep();
                }
                kept = Some((step, depth));
            }
            if let Some((_, depth)) = kept.take_if(|(then, _)| *then + 6 == step) {
                tracker.set_depth(&depth, None).unwrap();
            }
        }
    }
}

/// The same tile again and again: after a second without sight the camera has stopped,
/// and where its old speed would have taken it, the next tile lies.
#[test]
fn an_old_speed_does_not_lead_to_the_next_tile() {
    let camera = camera();
    let wall = |stamp: Stamp, x: f64| {
        let wave = std::f64::consts::TAU / 0.25;
        let grey = |i: u32| {
            let pixel = [f64::from(i % 320), f64::from(i / 320)];
            let [u, v] = camera.unproject(pixel).unwrap().map(|ray| 2.0 * ray * wave);
            let u = u + x * wave;
            let tile = u.sin() * v.cos()
                + 0.6 * (2.0 * u + 1.0).sin() * (2.0 * v).sin()
                + 0.4 * (3.0 * v).cos();
            (128.0 + 50.0 * tile) as u8
        };
        Frame::grey8(stamp, 320, 240, (0..320 * 240).map(grey).collect()).unwrap()
    };
    let at = |step: i64| Stamp::from_nanos(step * 33_333_333);
    let mut tracker = tracker();
    tracker.push(&wall(at(0), 0.0)).unwrap();
    tracker.keep();
    let depth = DepthMap::new(at(0), 320, 240, vec![2.0; 320 * 240]).unwrap();
    tracker.set_depth(&depth, None).unwrap();
    for step in 1..=10 {
        tracker.push(&wall(at(step), 0.01 * step as f64)).unwrap();
        assert!(tracker.estimate().background.is_ok());
    }
    for step in 11..=35 {
        let dark = Frame::grey8(at(step), 320, 240, vec![9; 320 * 240]).unwrap();
        tracker.push(&dark).unwrap();
        assert!(tracker.estimate().background.is_err());
    }
    tracker.push(&wall(at(36), 0.1)).unwrap();
    let motion = tracker.estimate();
    let place = motion.then_from_now().unwrap().translation();
    assert!((place.x - 0.1).abs() < 0.01, "{place}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Whatever the motion: an answer is near the truth, or there is none.
    #[test]
    fn never_a_plausible_wrong_motion(
        v in prop::array::uniform3(-0.4..0.4_f64),
        w in prop::array::uniform3(-0.5..0.5_f64),
    ) {
        let run = Run::drive();
        let now_from_then = Pose::exp(&Vector6::new(v[0], v[1], v[2], w[0], w[1], w[2]));
        let camera_from_target = now_from_then * (run.world_from_target)(0.0);
        let (frame, _) =
            run.scene.draw(Stamp::from_secs_f64(1.0), &now_from_then, &camera_from_target);
        let mut tracker = keyed(&run);
        tracker.push(&frame).unwrap();
        let small = v.iter().chain(&w).all(|v| v.abs() < 0.05);
        let found = &tracker.estimate().background;
        prop_assert!(found.is_ok() || !small, "{found:?}");
        if let Ok(found) = found {
            let error = found.now_from_then() * now_from_then.inverse();
            let bound = 6.0 * found.estimate.rotation_std() + 2e-3;
            prop_assert!(error.rotation_angle() < bound, "{error:?} {found:?}");
            let bound = 6.0 * found.estimate.translation_std() + 0.01;
            prop_assert!(error.translation_norm() < bound, "{error:?} {found:?}");
        }
    }
}
