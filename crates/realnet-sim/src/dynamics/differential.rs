//! A robot on two driven wheels.

use super::{Motor, friction_left};
use crate::VehicleState;
use realnet_core::DriveCommand;

/// A differential drive: two driven wheels and a castor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Differential {
    /// From driven wheel to driven wheel, metres.
    pub track: f64,
    /// What drives each wheel.
    pub motor: Motor,
    /// By how much the right motor is stronger than the left one: the right one's
    /// gain is `1 + mismatch / 2` of the motor's, the left one's `1 - mismatch / 2`.
    pub mismatch: f64,
}

impl Differential {
    /// One step of `step_s` seconds.
    pub(super) fn step(
        &self,
        state: &mut VehicleState,
        command: &DriveCommand,
        grip: f64,
        step_s: f64,
    ) {
        let half = 0.5 * self.track;
        let turned = half * command.yaw_rate;
        // Wheels that are asked for more than they reach keep the curvature.
        let fastest = (command.speed.abs() + turned.abs()) * self.motor.gain;
        let slower =
            if fastest > self.motor.max_speed { self.motor.max_speed / fastest } else { 1.0 };
        let [left, right] = [-1.0, 1.0].map(|side| {
            let speed = state.speed + side * half * state.yaw_rate;
            let asked = slower * (command.speed + side * turned);
            let goal = self.motor.goal(asked * (1.0 + 0.5 * side * self.mismatch), speed);
            self.motor.acceleration(speed, goal, grip, step_s)
        });
        let along = 0.5 * (left + right);
        let turn = (right - left) / self.track;
        let mean_speed = state.speed + 0.5 * along * step_s;
        // Wheels that slip sideways do not turn the robot any further.
        let across = friction_left(grip, along);
        let bounded = |yaw_rate: f64, speed: f64| {
            if (yaw_rate * speed).abs() > across {
                (across / speed.abs()).copysign(yaw_rate)
            } else {
                yaw_rate
            }
        };
        let mean_yaw_rate = bounded(state.yaw_rate + 0.5 * turn * step_s, mean_speed);
        state.world_from_base = state.world_from_base.driven(mean_speed, mean_yaw_rate, step_s);
        state.speed += along * step_s;
        state.yaw_rate = bounded(state.yaw_rate + turn * step_s, state.speed);
        state.steering_angle = 0.0;
    }
}
