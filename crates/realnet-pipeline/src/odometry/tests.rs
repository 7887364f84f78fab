use super::*;
use crate::step::Steps;
use realnet_core::nalgebra::{Matrix6, Point3};
use realnet_core::{CameraModel, Distortion, Frame, Intrinsics};
use realnet_pose::{Estimate, Origin};
use realnet_range::motion::{
    BodyMotion, Motion, MotionFailure, MotionOptions, MotionTracker, Start,
};

/// A camera that sits aside of the axle and looks down a little.
const MOUNT: CameraMount =
    CameraMount { forward_m: 0.25, left_m: -0.04, height_m: 0.18, pitch_rad: 0.1 };
const FAST: f64 = 3.0;

fn at(frame: u64) -> Stamp {
    Stamp::of_frame(frame, 30.0)
}

/// An odometry that is shown motions as they come.
struct Watch {
    steps: Steps,
    odometry: OwnOdometry,
}

impl Watch {
    fn new(max_speed: f64) -> Self {
        Self { steps: Steps::default(), odometry: OwnOdometry::new(&MOUNT, max_speed) }
    }

    fn seen(&mut self, motion: &Motion) -> Option<(f64, f64)> {
        let step = self.steps.next(motion)?;
        self.odometry.seen(&step)
    }
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
    let mut watch = Watch::new(1e3);
    for frame in 0..60 {
        // a new map every ten frames, of the frame four before
        let key = (frame / 10 * 10_u64).saturating_sub(4);
        let seen = watch.seen(&motion((at(key), place(key)), (at(frame), place(frame)), 1.0));
        assert_eq!(seen.is_some(), frame % 10 != 0, "frame {frame}: both of one map");
        if let Some((v, w)) = seen {
            assert!((v - speed).abs() < 1e-6 && (w - yaw_rate).abs() < 1e-6, "{v} {w}");
        }
        watch.odometry.step(at(frame), seen.unwrap_or((speed, yaw_rate)));
        let found = watch.odometry.pose_at(at(frame)).unwrap();
        let truth = place(frame);
        assert!((found.position() - truth.position()).norm() < 1e-6, "{found:?} {truth:?}");
        assert!((found.heading - truth.heading).abs() < 1e-6, "{found:?} {truth:?}");
    }
}

#[test]
fn a_wrong_scale_is_in_the_speed_and_not_in_the_turn() {
    let place = |frame: u64| Pose2::IDENTITY.driven(0.6, 0.5, frame as f64 / 30.0);
    let mut watch = Watch::new(FAST);
    for frame in 0..2 {
        let seen = watch.seen(&motion((at(0), place(0)), (at(frame), place(frame)), 1.2));
        if let Some((v, w)) = seen {
            // The little that is left: by a wrong scale the lever's own way looks like sliding.
            assert!((w - 0.5).abs() < 0.002, "{w}");
            // The lever to the axle is known: only what the camera moved is scaled. Its
            // offset to the right makes it faster in a left turn.
            let expected = 1.2 * (0.6 + 0.5 * 0.04) - 0.5 * 0.04;
            assert!((v - expected).abs() < 2e-3, "{v} {expected}");
        }
    }
}

#[test]
fn what_no_robot_does_and_what_is_not_seen_is_not_believed() {
    let place = |frame: u64, speed: f64| Pose2::new(speed * frame as f64 / 30.0, 0.0, 0.0);
    let shown =
        |frame: u64, speed| motion((at(0), place(0, speed)), (at(frame), place(frame, speed)), 1.0);
    let mut watch = Watch::new(FAST);
    assert_eq!(watch.seen(&shown(1, 0.5)), None, "there was no frame before");
    assert!(watch.seen(&shown(2, 0.5)).is_some());
    // 0.03 m after 0.5 m/s for two frames: 20 m/s
    assert_eq!(watch.seen(&shown(3, 7.0)), None);
    let mut dark = shown(4, 0.5);
    dark.background = Err(MotionFailure::NotEstimated);
    assert_eq!(watch.seen(&dark), None);
    assert_eq!(watch.seen(&shown(5, 0.5)), None, "nothing to compare with");
    let (speed, _) = watch.seen(&shown(6, 0.5)).unwrap();
    assert!((speed - 0.5).abs() < 1e-6);
}

#[test]
fn the_newest_places_are_remembered() {
    let mut odometry = OwnOdometry::new(&MOUNT, FAST);
    let frames = 3 * KEPT as u64;
    for frame in 0..frames {
        odometry.step(at(frame), (0.3, 0.0));
    }
    let kept: Vec<u64> = (0..frames).filter(|i| odometry.pose_at(at(*i)).is_some()).collect();
    assert_eq!(kept, (frames - KEPT as u64..frames).collect::<Vec<_>>());
    let (stamp, pose) = odometry.last().unwrap();
    assert_eq!(stamp, at(frames - 1));
    assert!((pose.x - 0.3 * (frames - 1) as f64 / 30.0).abs() < 1e-6);
    // A stamp that goes back moves nothing.
    odometry.step(at(3), (0.3, 1.0));
    assert_eq!(odometry.last().unwrap().1, pose);
}

#[test]
fn a_new_map_passes_no_rotation_over_but_its_lengths_are_not_compared() {
    let place = |frame: u64| Pose2::IDENTITY.driven(0.6, 0.5, frame as f64 / 30.0);
    let shown = |key: u64, frame: u64, scale| {
        motion((at(key), place(key)), (at(frame), place(frame)), scale)
    };
    let mut steps = Steps::default();
    for frame in 0..6 {
        let step = steps.next(&shown(0, frame, 1.0));
        assert!(step.is_none_or(|step| step.of_one_map));
        if frame == 2 {
            steps.keep(Some(&shown(0, 2, 1.0)));
        }
    }
    steps.rebase();
    // The new map errs by a tenth.
    let step = steps.next(&shown(2, 6, 1.1)).unwrap();
    assert!(!step.of_one_map);
    assert!((step.now_from_before.rotation().angle() - 0.5 / 30.0).abs() < 1e-6, "{step:?}");
    assert_eq!(OwnOdometry::new(&MOUNT, FAST).seen(&step), None);
    assert!(steps.next(&shown(2, 7, 1.1)).unwrap().of_one_map);
    // Without a frame that was kept nothing is known of the next step.
    steps.rebase();
    assert!(steps.next(&shown(5, 8, 1.0)).is_none());
}

#[test]
fn a_turn_that_could_be_a_step_aside_is_not_taken_for_one() {
    // All corners two metres ahead: turning left and stepping right cancel in the picture,
    // so that such an error is likely, and the covariance says so.
    let (speed, yaw_rate, seconds) = (0.6, 0.4, 1.0 / 30.0);
    let place = |frame: u64| Pose2::IDENTITY.driven(speed, yaw_rate, frame as f64 * seconds);
    let along = Vector6::new(2.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let wrong = 0.02;
    let seen = |covariance: Matrix6<f64>, frame: u64, error: f64| {
        let mut motion = motion((at(0), place(0)), (at(frame), place(frame)), 1.0);
        if let Ok(body) = &mut motion.background {
            let moved = body.estimate.camera_from_world;
            body.estimate.camera_from_world = Pose::exp(&(along * error)) * moved;
            body.estimate.covariance = covariance;
        }
        motion
    };
    let turn = |covariance: Matrix6<f64>| {
        let mut watch = Watch::new(FAST);
        watch.seen(&seen(covariance, 1, 0.0));
        watch.seen(&seen(covariance, 2, wrong)).unwrap()
    };
    let round = Matrix6::identity() * 1e-10;
    let (_, believed) = turn(round);
    assert!((believed - yaw_rate).abs() > 0.3, "{believed}: nothing tells of the error");
    let (v, w) = turn(round + along * along.transpose() * 1e-4);
    assert!((w - yaw_rate).abs() < 0.05 && (v - speed).abs() < 0.05, "{v} {w}");
}
