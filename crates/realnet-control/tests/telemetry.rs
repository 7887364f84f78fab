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
