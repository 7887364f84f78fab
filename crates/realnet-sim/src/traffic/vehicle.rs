//! A vehicle on a route.

use super::{Route, SpeedProfile};
use crate::{VehicleKind, VehicleState};

/// Deceleration from which brake lights shine, m/s^2.
const BRAKE_LIGHTS: f64 = 0.3;

/// A vehicle that drives a route at a profile: its rear axle is on the path, its
/// wheels stand and roll as that needs.
#[derive(Clone, Debug, PartialEq)]
pub struct ScriptedVehicle {
    /// What it is.
    pub kind: VehicleKind,
    /// Where it drives along.
    pub route: Route,
    /// How fast.
    pub profile: SpeedProfile,
    /// Where on the route it is at time 0, metres.
    pub start: f64,
}

impl ScriptedVehicle {
    /// How far along the route it is, metres, at a time in seconds.
    #[must_use]
    pub fn place(&self, time_s: f64) -> f64 {
        self.start + self.profile.way(time_s)
    }

    /// Where it is and what it does at a time in seconds.
    #[must_use]
    pub fn state(&self, time_s: f64) -> VehicleState {
        let size = self.kind.size();
        let (place, speed) = (self.place(time_s), self.profile.speed(time_s));
        let curvature = self.route.curvature(place);
        let steering_angle = match self.kind {
            VehicleKind::Robot => 0.0,
            VehicleKind::TouringCar | VehicleKind::Truck | VehicleKind::Buggy => {
                (curvature * size.wheelbase).atan()
            }
        };
        VehicleState {
            world_from_base: self.route.pose(place),
            speed,
            yaw_rate: curvature * speed,
            steering_angle,
            wheel_angle: place / size.wheel_radius,
            braking: speed * self.profile.acceleration(time_s) < -BRAKE_LIGHTS * speed.abs(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::Pose2;

    #[test]
    fn the_state_is_the_motion() {
        let car = ScriptedVehicle {
            kind: VehicleKind::TouringCar,
            route: Route::new(Pose2::IDENTITY).turn(1.0, 3.0, 0.5).turn(-1.0, 3.0, 0.5),
            profile: SpeedProfile::constant(0.0).change(0.8, 1.0).hold(3.0).change(-0.4, 2.0),
            start: 0.2,
        };
        let step = 1e-4;
        for time in [0.3, 1.0, 2.5, 3.9, 4.3, 6.0] {
            let (state, next) = (car.state(time), car.state(time + step));
            let moved = state.world_from_base.inverse() * next.world_from_base;
            assert!((moved.x / step - state.speed).abs() < 1e-3, "{time}");
            assert!(moved.y.abs() / step < 1e-3, "{time}");
            assert!((moved.heading / step - state.yaw_rate).abs() < 0.02, "{time}");
            let rolled = (next.wheel_angle - state.wheel_angle) * car.kind.size().wheel_radius;
            assert!((rolled / step - state.speed).abs() < 1e-3, "{time}");
            let turned = state.steering_angle.tan() / car.kind.size().wheelbase * state.speed;
            assert!((turned - state.yaw_rate).abs() < 1e-12, "{time}");
        }
        assert!(!car.state(2.0).braking && car.state(3.9).braking && !car.state(5.0).braking);
        let robot = ScriptedVehicle { kind: VehicleKind::Robot, ..car };
        assert_eq!(robot.state(2.0).steering_angle, 0.0);
    }
}
