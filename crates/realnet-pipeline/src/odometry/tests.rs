use super::*;
use realnet_core::nalgebra::{Matrix6, Point3};
use realnet_core::{CameraModel, Distortion, Frame, Intrinsics};
use realnet_pose::{Estimate, Origin};
use realnet_range::motion::{BodyMotion, MotionFailure, MotionOptions, MotionTracker, Start};

/// A camera that sits aside of the axle and looks down a little.
const MOUNT: CameraMount =
    CameraMount { forward_m: 0.25, left_m: -0.04, height_m: 0.18, pitch_rad: 0.1 };
const FAST: f64 = 3.0;

fn at(frame: u64) -> Stamp {
    Stamp::of_frame(frame, 30.0)
}

/// A motion of nothing, to be filled in.
fn nothing() -> Motion {
    let intrinsics = Intrinsics { fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };
    let camera = CameraModel::new(64, 48, intrinsics, Distortion::None).unwrap();
    let mut tracker = MotionTracker::new(&camera, MotionOptions::default()).unwrap();
    let frame = Frame::grey8(Stamp::ZERO, 64, 48, vec![0; 64 * 48]).unwrap();
    tracker.push(&frame).unwrap();
    tracker.estimate().clone()
}

/// What the background shows a camera on the robot that went from `then` to `now`, if its
/// depths are `scale` times the true ones.
fn motion(then: (Stamp, Pose2), now: (Stamp, Pose2), scale: f64) -> Motion {
    let world_from_optical = |base: Pose2| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), base.heading);
        Pose::new(turn, Vector3::new(base.x, base.y, 0.0)) * MOUNT.base_from_optical()
    };
    let moved = world_from_optical(now.1).inverse() * world_from_optical(then.1);
    let camera_from_world = Pose::new(moved.rotation(), moved.translation() * scale);
    let estimate = Estimate {
        camera_from_world,
        covariance: Matrix6::identity() * 1e-8,
        center: Point3::new(0.0, 0.0, 2.0),
        dof: 94,
        rms_px: 0.1,
        noise_px: 0.1,
        inliers: 50,
        iterations: 0,
        steps: 2,
        origin: Origin::Guess,
    };
    let body = BodyMotion { estimate, corners: 50, tracked: 50, start: Start::Predicted };
    let mut motion = nothing();
    (motion.then, motion.now, motion.background) = (then.0, now.0, Ok(body));
    motion
}

#[test]
fn an_arc_is_seen_as_the_speed_and_the_turn_of_the_axle() {
    // The camera's own speed is another one: it sits beside and ahead of the axle.
    let (speed, yaw_rate) = (0.7, -0.9);
    let place = |frame: u64| Pose2::IDENTITY.driven(speed, yaw_rate, frame as f64 / 30.0);
    // Whatever is seen is believed: it must be right.
    let mut odometry = OwnOdometry::new(&MOUNT, 1e3);
    for frame in 0..60 {
        // a new map every ten frames, of the frame four before
        let key = (frame / 10 * 10_u64).saturating_sub(4);
        let seen = odometry
            .seen(at(frame), &motion((at(key), place(key)), (at(frame), place(frame)), 1.0));
        assert_eq!(seen.is_some(), frame % 10 != 0, "frame {frame}: both of one map");
        if let Some((v, w)) = seen {
            assert!((v - speed).abs() < 1e-6 && (w - yaw_rate).abs() < 1e-6, "{v} {w}");
        }
        odometry.step(at(frame), seen.unwrap_or((speed, yaw_rate)));
        let found = odometry.pose_at(at(frame)).unwrap();
        let truth = place(frame);
        assert!((found.position() - truth.position()).norm() < 1e-6, "{found:?} {truth:?}");
        assert!((found.heading - truth.heading).abs() < 1e-6, "{found:?} {truth:?}");
    }
}

#[test]
fn a_wrong_scale_is_in_the_speed_and_not_in_the_turn() {
    let place = |frame: u64| Pose2::IDENTITY.driven(0.6, 0.5, frame as f64 / 30.0);
    let mut odometry = OwnOdometry::new(&MOUNT, FAST);
    for frame in 0..2 {
        let seen =
            odometry.seen(at(frame), &motion((at(0), place(0)), (at(frame), place(frame)), 1.2));
        if let Some((v, w)) = seen {
            assert!((w - 0.5).abs() < 1e-6, "{w}");
            // The lever to the axle is known: only what the camera moved is scaled. Its
            // offset to the right makes it faster in a left turn.
            let expected = 1.2 * (0.6 + 0.5 * 0.04) - 0.5 * 0.04;
            assert!((v - expected).abs() < 1e-3, "{v} {expected}");
        }
        odometry.step(at(frame), (0.6, 0.5));
    }
}

#[test]
fn what_no_robot_does_and_what_is_not_seen_is_not_believed() {
    let place = |frame: u64, speed: f64| Pose2::new(speed * frame as f64 / 30.0, 0.0, 0.0);
    let shown =
        |frame: u64, speed| motion((at(0), place(0, speed)), (at(frame), place(frame, speed)), 1.0);
    let mut odometry = OwnOdometry::new(&MOUNT, FAST);
    assert_eq!(odometry.seen(at(1), &shown(1, 0.5)), None, "there was no frame before");
    odometry.step(at(1), (0.0, 0.0));
    assert!(odometry.seen(at(2), &shown(2, 0.5)).is_some());
    odometry.step(at(2), (0.5, 0.0));
    // 0.03 m after 0.5 m/s for two frames: 20 m/s
    assert_eq!(odometry.seen(at(3), &shown(3, 7.0)), None);
    odometry.step(at(3), (0.5, 0.0));
    let mut dark = shown(4, 0.5);
    dark.background = Err(MotionFailure::NotEstimated);
    assert_eq!(odometry.seen(at(4), &dark), None);
    odometry.step(at(4), (0.5, 0.0));
    assert_eq!(odometry.seen(at(5), &shown(5, 0.5)), None, "nothing to compare with");
    odometry.step(at(5), (0.5, 0.0));
    let (speed, _) = odometry.seen(at(6), &shown(6, 0.5)).unwrap();
    assert!((speed - 0.5).abs() < 1e-6);
}

#[test]
fn the_newest_places_are_remembered() {
    let mut odometry = OwnOdometry::new(&MOUNT, FAST);
    let frames = 3 * POSES as u64;
    for frame in 0..frames {
        odometry.step(at(frame), (0.3, 0.0));
    }
    let kept: Vec<u64> = (0..frames).filter(|i| odometry.pose_at(at(*i)).is_some()).collect();
    assert_eq!(kept, (frames - POSES as u64..frames).collect::<Vec<_>>());
    let (stamp, pose) = odometry.last().unwrap();
    assert_eq!(stamp, at(frames - 1));
    assert!((pose.x - 0.3 * (frames - 1) as f64 / 30.0).abs() < 1e-6);
    // A stamp that goes back moves nothing.
    odometry.step(at(3), (0.3, 1.0));
    assert_eq!(odometry.last().unwrap().1, pose);
}
