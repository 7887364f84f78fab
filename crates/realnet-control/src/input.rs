//! What the controller is told in a step.

use crate::check::{usable, usable_point};
use realnet_core::nalgebra::{Matrix2, Vector2};
use realnet_core::{Stamp, TargetEstimate, TargetState};

/// Everything a step goes by.
#[derive(Clone, Copy, Debug)]
pub struct ControlInput<'a> {
    /// The moment of the step: when the command is given.
    pub now: Stamp,
    /// The target in the robot's base frame, both predicted to
    /// [`Controller::effect_time`](crate::Controller::effect_time) of `now`. The position
    /// is that of the target's seen surface.
    pub target: &'a TargetState,
    /// Where the target drove, in the same base frame, the oldest point first; may be
    /// empty.
    pub trail: &'a [Vector2<f64>],
    /// Own speed at the moment of `target`, metres a second; `None`: what the vehicle
    /// model says.
    pub own_speed: Option<f64>,
}

impl<'a> ControlInput<'a> {
    /// Without trail and measured speed.
    #[must_use]
    pub const fn new(now: Stamp, target: &'a TargetState) -> Self {
        Self { now, target, trail: &[], own_speed: None }
    }

    /// Whether every number in it is finite and of a size that occurs on Earth (below
    /// 10^6 in its unit): one that is not stops the vehicle, even one that the present
    /// rule does not use, because it says that something before is broken.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        self.target.estimate.as_ref().is_none_or(estimate_is_usable)
            && self.own_speed.is_none_or(usable)
            && self.trail.iter().all(usable_point)
    }
}

fn estimate_is_usable(estimate: &TargetEstimate) -> bool {
    [estimate.position, estimate.velocity, estimate.acceleration].iter().all(usable_point)
        && [estimate.position_covariance, estimate.velocity_covariance]
            .iter()
            .all(|covariance| covariance.iter().copied().all(usable))
}

/// The gap to the target: from the middle of the front bumper to the target's seen
/// surface, along the line between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// Length, metres.
    pub length_m: f64,
    /// Its standard deviation, metres.
    pub std_m: f64,
    /// Unit vector from the bumper to the target, in the base frame.
    pub sight: Vector2<f64>,
    /// Speed of the target over ground along that line, metres a second, positive: away.
    pub target_speed_m_s: f64,
    /// Its standard deviation, metres a second.
    pub target_speed_std_m_s: f64,
}

impl Gap {
    /// From the estimate and the distance from the base frame's origin to the bumper.
    #[must_use]
    pub fn new(estimate: &TargetEstimate, front_m: f64) -> Self {
        let line = estimate.position - Vector2::new(front_m, 0.0);
        let sight = line.try_normalize(1e-9).unwrap_or_else(Vector2::x);
        let along = |covariance: &Matrix2<f64>| (sight.transpose() * covariance * sight).x;
        let std = |covariance| along(covariance).max(0.0).sqrt();
        Self {
            length_m: line.norm(),
            std_m: std(&estimate.position_covariance),
            sight,
            target_speed_m_s: sight.dot(&estimate.velocity),
            target_speed_std_m_s: std(&estimate.velocity_covariance),
        }
    }
}
