//! No step allocates.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;

use counting::count;
use realnet_control::{ControlInput, ControlOptions, Controller, VehiclePredictor};
use realnet_core::nalgebra::{Matrix2, Vector2};
use realnet_core::{Pose2, Stamp, TargetEstimate, TargetState, TrackStatus};

#[test]
fn no_step_allocates() {
    let mut controller = Controller::new(ControlOptions::default()).unwrap();
    let trail: Vec<_> = (0..60).map(|i| Vector2::new(0.05 * f64::from(i) - 1.5, 0.1)).collect();
    let estimate = TargetEstimate {
        position: Vector2::new(1.5, 0.1),
        velocity: Vector2::new(0.5, 0.0),
        acceleration: Vector2::zeros(),
        position_covariance: Matrix2::identity() * 4e-4,
        velocity_covariance: Matrix2::identity() * 1e-2,
    };
    let before = count();
    // more steps than the predictor remembers
    for frame in 0..4 * VehiclePredictor::CAPACITY as u64 {
        let now = Stamp::of_frame(frame, 30.0);
        controller.predictor_mut().correct(now, Some(0.5), Some(0.1));
        let effect = controller.effect_time(now);
        let pose = controller.predictor().advance(Pose2::IDENTITY, now, effect);
        assert!(pose.x.is_finite());
        let seen = frame % 100 < 60;
        let target = TargetState {
            stamp: effect,
            measured: Some(now),
            status: if seen { TrackStatus::Tracking } else { TrackStatus::Lost },
            estimate: seen.then_some(estimate),
        };
        let mut input = ControlInput::new(now, &target);
        input.trail = &trail;
        controller.step(&input);
        controller.idle(now);
    }
    assert_eq!(count() - before, 0);
}
