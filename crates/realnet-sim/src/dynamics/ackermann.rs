//! A car: one driven speed, steered front wheels.

use super::{Motor, Steering, friction_left};
use crate::VehicleState;
use realnet_core::DriveCommand;

/// A car with front-wheel steering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ackermann {
    /// From axle to axle, metres.
    pub wheelbase: f64,
    /// What drives it.
    pub motor: Motor,
    /// What steers it.
    pub steering: Steering,
    /// Understeer `k` of linear tyres, s^2/m: the steady curvature is
    /// `tan(steering) / (wheelbase + k v^2)`. With cornering stiffnesses `c_f`, `c_r`
    /// (N/rad), mass `m` and distances `l_f`, `l_r` of the centre of mass from the
    /// axles, `k = m / wheelbase * (l_r / c_f - l_f / c_r)`.
    pub understeer: f64,
    /// Way over which tyres build up their side force, metres.
    pub relaxation: f64,
}

impl Ackermann {
    /// One step of `step_s` seconds. `curvature` is that of the path now driven.
    pub(super) fn step(
        &self,
        state: &mut VehicleState,
        curvature: &mut f64,
        command: &DriveCommand,
        grip: f64,
        step_s: f64,
    ) {
        state.steering_angle =
            self.steering.stepped(state.steering_angle, command.steering_angle, step_s);
        let goal = self.motor.goal(command.speed, state.speed);
        let acceleration = self.motor.acceleration(state.speed, goal, grip, step_s);
        let mean_speed = state.speed + 0.5 * acceleration * step_s;
        let way = mean_speed * step_s;

        let squared = mean_speed * mean_speed;
        let wanted = state.steering_angle.tan() / (self.wheelbase + self.understeer * squared);
        let share =
            if self.relaxation > 0.0 { 1.0 - (-way.abs() / self.relaxation).exp() } else { 1.0 };
        *curvature += share * (wanted - *curvature);
        let across = friction_left(grip, acceleration);
        // What tyres give bounds the curvature; at standstill it bounds nothing.
        if squared * curvature.abs() > across {
            *curvature = (across / squared).copysign(*curvature);
        }

        let yaw_rate = *curvature * mean_speed;
        state.world_from_base = state.world_from_base.driven(mean_speed, yaw_rate, step_s);
        state.speed += acceleration * step_s;
        state.yaw_rate = *curvature * state.speed;
    }
}
