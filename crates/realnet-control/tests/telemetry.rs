//! What the controller says about its last step.
#![allow(missing_docs, clippy::unwrap_used)]

use realnet_control::{ControlInput, ControlOptions, Controller, Phase, SpeedBound, Telemetry};
use realnet_core::nalgebra::{Matrix2, Vector2};
use realnet_core::{Stamp, StopReason, TargetEstimate, TargetState, TrackStatus};

/// After a second of the same target in the base frame, the last step on `trail`.
fn told(
    position: (f64, f64),
    velocity: f64,
    trail: &[Vector2<f64>],
    own_speed: Option<f64>,
    age: f64,
) -> Telemetry {
    let mut controller = Controller::new(ControlOptions::default()).unwrap();
    for frame in 0..30 {
        let now = Stamp::of_frame(frame, 30.0);
        let age = if frame < 25 { 0.0 } else { age };
        let target = TargetState {
            stamp: controller.effect_time(now),
            measured: Some(Stamp::from_secs_f64(now.secs_f64() - age)),
            status: TrackStatus::Tracking,
            estimate: Some(TargetEstimate {
                position: Vector2::new(position.0, position.1),
                velocity: Vector2::new(velocity, 0.0),
                acceleration: Vector2::zeros(),
                position_covariance: Matrix2::identity() * 1e-4,
                velocity_covariance: Matrix2::identity() * 1e-4,
            }),
        };
        let command = controller.step(&ControlInput { now, target: &target, trail, own_speed });
        assert_eq!(controller.telemetry().sent, command);
    }
    *controller.telemetry()
}

#[test]
fn the_bound_that_decided_is_named() {
    let free = told((1.34, 0.0), 0.5, &[], None, 0.0);
    assert_eq!((free.bound, free.phase), (SpeedBound::None, Phase::Tracking));
    assert!((free.sent.speed - 0.5).abs() < 0.05, "{free:?}");
    let vehicle = told((5.0, 0.0), 2.0, &[], None, 0.0);
    assert_eq!((vehicle.bound, vehicle.sent.speed), (SpeedBound::Vehicle, 2.0));
    // 1 m behind a target at 1.9 m/s: too near to stop if it brakes as hard as it can.
    let fast = told((1.34, 0.0), 1.9, &[], Some(1.9), 0.0);
    assert_eq!(fast.bound, SpeedBound::Stopping);
    assert!(fast.sent.speed > 1.5 && fast.sent.speed <= fast.bounds.stopping, "{fast:?}");
    let curve = told((1.4, 1.6), 2.5, &[], None, 0.0);
    assert_eq!(curve.bound, SpeedBound::Curve, "{curve:?}");
    assert!(curve.sent.speed.powi(2) * curve.curvature.abs() <= 2.5 + 1e-9);
    let lost = told((3.0, 0.0), 1.0, &[], None, 0.5);
    assert_eq!((lost.bound, lost.phase), (SpeedBound::Lost, Phase::Coasting));
}

#[test]
fn aim_gap_and_own_speed_are_told() {
    let trail: Vec<_> = (0..30).map(|i| Vector2::new(0.05 * f64::from(i) - 0.2, 0.1)).collect();
    let on_trail = told((1.34, 0.1), 0.5, &trail, Some(0.45), 0.0);
    let aim = on_trail.aim.unwrap();
    assert!(aim.on_trail && (aim.point.y - 0.1).abs() < 1e-12 && aim.point.x < 0.6);
    assert!((aim.curvature - on_trail.curvature).abs() < 1e-12);
    assert_eq!(on_trail.own_speed, 0.45);
    let gap = on_trail.gap.unwrap();
    assert!((gap.error_m - (1.0_f64.hypot(0.1) - 1.0)).abs() < 1e-9);
    assert!((gap.rate_m_s - 0.05).abs() < 0.03, "{gap:?}");
    assert_eq!(on_trail.proposal, on_trail.sent);
    // The governor's stop is not the controller's.
    let stopped = told((0.6, 0.0), 1.0, &[], None, 0.0);
    assert_eq!(stopped.sent.stop, Some(StopReason::TooClose));
    assert!(stopped.proposal.stop.is_none());
}

/// Target and robot stand 0.8 m apart, the target backs up.
fn backing(age: f64, trail: &[Vector2<f64>]) -> Telemetry {
    let mut options = ControlOptions::default();
    options.vehicle.max_reverse_speed_m_s = 0.5;
    let mut controller = Controller::new(options).unwrap();
    for frame in 0..20 {
        let now = Stamp::of_frame(frame, 30.0);
        let target = TargetState {
            stamp: controller.effect_time(now),
            measured: Some(Stamp::from_secs_f64(now.secs_f64() - age)),
            status: TrackStatus::Tracking,
            estimate: Some(TargetEstimate {
                position: Vector2::new(1.14, 0.1),
                velocity: Vector2::new(-0.2, 0.0),
                acceleration: Vector2::zeros(),
                position_covariance: Matrix2::identity() * 1e-4,
                velocity_covariance: Matrix2::identity() * 1e-4,
            }),
        };
        controller.step(&ControlInput { now, target: &target, trail, own_speed: None });
    }
    *controller.telemetry()
}

#[test]
fn backwards_it_faces_the_target_and_only_while_it_sees_it() {
    let trail: Vec<_> = (0..30).map(|i| Vector2::new(0.05 * f64::from(i) - 0.3, 0.1)).collect();
    let seen = backing(0.0, &trail);
    assert!(seen.sent.speed < -0.2, "{seen:?}");
    assert!(!seen.aim.unwrap().on_trail);
    // the target is on the left: backwards that takes wheels to the right
    assert!(seen.curvature > 0.0 && seen.sent.steering_angle < 0.0);
    assert!(seen.sent.yaw_rate > 0.0);
    let coasting = backing(0.4, &trail);
    assert_eq!((coasting.phase, coasting.sent.speed), (Phase::Coasting, 0.0));
}

#[test]
fn the_steering_goes_further_while_its_lag_is_made_up_for() {
    let angles = |lag_compensation: f64| {
        let mut options = ControlOptions::default();
        options.vehicle.lag_compensation = lag_compensation;
        let mut controller = Controller::new(options).unwrap();
        let mut angles = Vec::new();
        for frame in 0..60 {
            let now = Stamp::of_frame(frame, 30.0);
            let target = TargetState {
                stamp: controller.effect_time(now),
                measured: Some(now),
                status: TrackStatus::Tracking,
                estimate: Some(TargetEstimate {
                    position: Vector2::new(2.0, 0.4),
                    velocity: Vector2::new(0.5, 0.0),
                    acceleration: Vector2::zeros(),
                    position_covariance: Matrix2::identity() * 1e-4,
                    velocity_covariance: Matrix2::identity() * 1e-4,
                }),
            };
            angles.push(controller.step(&ControlInput::new(now, &target)).steering_angle);
        }
        angles
    };
    let wanted = (0.26_f64 * 2.0 * 0.4 / (4.0 + 0.16)).atan();
    let greatest = |angles: &[f64]| angles.iter().copied().fold(0.0, f64::max);
    let (without, with) = (angles(0.0), angles(1.0));
    assert!((greatest(&without) - wanted).abs() < 1e-9);
    assert!(greatest(&with) > 1.5 * wanted && greatest(&with) <= 2.0 * wanted + 1e-9);
    assert!((with.last().unwrap() - wanted).abs() < 1e-4);
}
