//! A vehicle that is driven by commands.

use super::{Ackermann, Differential, GRAVITY, Motor, Steering};
use crate::{VehicleKind, VehicleSize, VehicleState};
use realnet_core::{DriveCommand, Stamp};
use std::collections::VecDeque;
use thiserror::Error;

/// The grid of time that vehicles are integrated on, ns.
const STEP_NANOS: i64 = 1_000_000;

/// Deceleration from which brake lights shine, m/s^2.
const BRAKE_LIGHTS: f64 = 0.3;

/// Why parameters do not make a vehicle.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DynamicsError {
    /// A parameter is negative or not finite, or must be above 0 and is not.
    #[error("vehicle dynamics: {name} is {value}")]
    Parameter {
        /// Which.
        name: &'static str,
        /// What it is.
        value: f64,
    },
    /// The vehicle does not start from finite numbers.
    #[error("vehicle dynamics: the start is not finite")]
    Start,
}

/// How the wheels are driven and turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DriveTrain {
    /// A car.
    Ackermann(Ackermann),
    /// Two driven wheels.
    Differential(Differential),
}

/// How a vehicle answers to commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VehicleDynamics {
    /// Motors and steering.
    pub drive: DriveTrain,
    /// From a command's stamp to the first change at the wheels, s.
    pub dead_time_s: f64,
    /// Friction of the tyres on the ground, 1: they hold with the vehicle's weight.
    pub friction: f64,
}

impl VehicleDynamics {
    /// Usual values for a kind of vehicle: a brushed 1:10 car with a hobby servo, a
    /// robot with geared motors.
    #[must_use]
    pub fn of(kind: VehicleKind) -> Self {
        let VehicleSize { wheelbase, width, .. } = kind.size();
        let motor = Motor {
            max_speed: 3.0,
            max_acceleration: 3.0,
            max_braking: 4.5,
            lag_s: 0.08,
            start_speed: 0.10,
            hold_speed: 0.06,
            drag: 0.4,
            gain: 1.0,
        };
        let car = |max_angle, max_rate| {
            DriveTrain::Ackermann(Ackermann {
                wheelbase,
                motor,
                steering: Steering { max_angle, max_rate, lag_s: 0.03, trim: 0.0, gain: 1.0 },
                understeer: 0.01,
                relaxation: 0.05,
            })
        };
        let drive = match kind {
            VehicleKind::TouringCar => car(0.45, 6.0),
            VehicleKind::Truck => car(0.42, 5.0),
            VehicleKind::Buggy => car(0.50, 6.0),
            VehicleKind::Robot => DriveTrain::Differential(Differential {
                track: width - 0.03,
                motor: Motor {
                    max_speed: 1.6,
                    max_acceleration: 2.5,
                    max_braking: 3.0,
                    lag_s: 0.06,
                    start_speed: 0.04,
                    hold_speed: 0.02,
                    drag: 1.0,
                    gain: 1.0,
                },
                mismatch: 0.0,
            }),
        };
        Self { drive, dead_time_s: 0.04, friction: 0.9 }
    }

    /// The motor, or one of the two.
    #[must_use]
    pub fn motor(&self) -> &Motor {
        match &self.drive {
            DriveTrain::Ackermann(car) => &car.motor,
            DriveTrain::Differential(robot) => &robot.motor,
        }
    }

    /// The same, to be changed.
    pub fn motor_mut(&mut self) -> &mut Motor {
        match &mut self.drive {
            DriveTrain::Ackermann(car) => &mut car.motor,
            DriveTrain::Differential(robot) => &mut robot.motor,
        }
    }

    /// Whether all parameters can be driven with.
    ///
    /// # Errors
    /// [`DynamicsError::Parameter`] names the first that cannot.
    pub fn check(&self) -> Result<(), DynamicsError> {
        let (above_0, from_0) = match &self.drive {
            DriveTrain::Ackermann(car) => (
                ("wheelbase", car.wheelbase),
                [("understeer", car.understeer), ("relaxation", car.relaxation)],
            ),
            DriveTrain::Differential(robot) => {
                (("track", robot.track), [("mismatch", robot.mismatch.abs()); 2])
            }
        };
        let steering = match &self.drive {
            DriveTrain::Ackermann(car) => Some(car.steering.parameters()),
            DriveTrain::Differential(_) => None,
        };
        let own = [("dead_time_s", self.dead_time_s), ("friction", self.friction)];
        let all = own.into_iter().chain(from_0).chain(self.motor().parameters());
        for (name, value) in all.chain(steering.into_iter().flatten()).chain([above_0]) {
            let least = if name == above_0.0 { f64::MIN_POSITIVE } else { 0.0 };
            if !(least..=1e6).contains(&value) {
                return Err(DynamicsError::Parameter { name, value });
            }
        }
        Ok(())
    }
}

/// What of a vehicle changes from step to step.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Moving {
    state: VehicleState,
    /// Of the path that it drives, 1/m; of cars only.
    curvature: f64,
}

/// A vehicle that is driven by commands, see [the module](crate::dynamics).
///
/// ```
/// use realnet_core::{DriveCommand, Stamp};
/// use realnet_sim::dynamics::{Vehicle, VehicleDynamics};
/// use realnet_sim::{VehicleKind, VehicleState};
///
/// # fn main() -> Result<(), realnet_sim::dynamics::DynamicsError> {
/// let kind = VehicleKind::TouringCar;
/// let (dynamics, start) = (VehicleDynamics::of(kind), VehicleState::default());
/// let mut car = Vehicle::new(dynamics, kind.size().wheel_radius, start, Stamp::ZERO)?;
/// car.command(&DriveCommand { speed: 0.5, ..DriveCommand::default() });
/// car.advance_to(Stamp::from_secs_f64(2.0));
/// assert!((car.state().speed - 0.5).abs() < 0.01);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Vehicle {
    dynamics: VehicleDynamics,
    wheel_radius: f64,
    moving: Moving,
    /// Time of `moving`: on the grid.
    reached: Stamp,
    /// Time that was asked for last: less than a step later.
    asked: Stamp,
    active: DriveCommand,
    /// Commands that do not act yet, by the time from which they do.
    waiting: VecDeque<(Stamp, DriveCommand)>,
    newest: Option<Stamp>,
}

impl Vehicle {
    /// A vehicle in a state, told to stand. `wheel_radius` in metres is for the
    /// angle of the wheels alone.
    ///
    /// # Errors
    /// [`DynamicsError`] for what cannot be driven with.
    pub fn new(
        dynamics: VehicleDynamics,
        wheel_radius: f64,
        start: VehicleState,
        now: Stamp,
    ) -> Result<Self, DynamicsError> {
        dynamics.check()?;
        if !(f64::MIN_POSITIVE..=1e6).contains(&wheel_radius) {
            return Err(DynamicsError::Parameter { name: "wheel_radius", value: wheel_radius });
        }
        let pose = start.world_from_base;
        let numbers = [pose.x, pose.y, pose.heading, start.speed, start.yaw_rate];
        let angles = [start.steering_angle, start.wheel_angle];
        if !numbers.iter().chain(&angles).all(|number| number.is_finite()) {
            return Err(DynamicsError::Start);
        }
        let curvature = if start.speed == 0.0 { 0.0 } else { start.yaw_rate / start.speed };
        Ok(Self {
            dynamics,
            wheel_radius,
            moving: Moving { state: start, curvature },
            reached: now,
            asked: now,
            active: DriveCommand { stamp: now, ..DriveCommand::default() },
            waiting: VecDeque::new(),
            newest: None,
        })
    }

    /// How it answers to commands.
    #[must_use]
    pub fn dynamics(&self) -> &VehicleDynamics {
        &self.dynamics
    }

    /// Gives a command. It acts from its stamp plus the dead time on, or from now
    /// on if that is past. A command older than one given before is ignored, as by
    /// any receiver that looks at stamps; one with a number that is not finite is
    /// taken as standstill with the wheels as they are.
    pub fn command(&mut self, command: &DriveCommand) {
        if self.newest.is_some_and(|newest| command.stamp < newest) {
            return;
        }
        self.newest = Some(command.stamp);
        let numbers = [command.speed, command.steering_angle, command.yaw_rate];
        let command = if numbers.iter().all(|number| number.is_finite()) {
            *command
        } else {
            let before = self.waiting.back().map_or(self.active, |(_, command)| *command);
            DriveCommand { stamp: command.stamp, speed: 0.0, yaw_rate: 0.0, ..before }
        };
        let acts = command.stamp.nanos().saturating_add(dead_nanos(&self.dynamics));
        self.waiting.push_back((Stamp::from_nanos(acts), command));
    }

    /// Drives on until `time`; a time before the last one changes nothing.
    pub fn advance_to(&mut self, time: Stamp) {
        self.asked = self.asked.max(time);
        while self.asked.nanos().saturating_sub(self.reached.nanos()) >= STEP_NANOS {
            self.take_due();
            step(&self.dynamics, self.wheel_radius, &mut self.moving, &self.active, STEP_NANOS);
            self.reached = Stamp::from_nanos(self.reached.nanos().saturating_add(STEP_NANOS));
        }
    }

    /// Takes the commands over that act by now.
    fn take_due(&mut self) {
        while let Some((_, command)) = self.waiting.pop_front_if(|(acts, _)| *acts <= self.reached)
        {
            self.active = command;
        }
    }

    /// The time that it was driven to.
    #[must_use]
    pub fn time(&self) -> Stamp {
        self.asked
    }

    /// Where it is and what it does at that time.
    #[must_use]
    pub fn state(&self) -> VehicleState {
        let mut moving = self.moving;
        let rest = self.asked.nanos().saturating_sub(self.reached.nanos());
        if rest > 0 {
            step(&self.dynamics, self.wheel_radius, &mut moving, &self.active, rest);
        }
        moving.state
    }
}

fn dead_nanos(dynamics: &VehicleDynamics) -> i64 {
    Stamp::from_secs_f64(dynamics.dead_time_s).nanos()
}

fn step(
    dynamics: &VehicleDynamics,
    wheel_radius: f64,
    moving: &mut Moving,
    command: &DriveCommand,
    nanos: i64,
) {
    let step_s = nanos as f64 * 1e-9;
    let grip = dynamics.friction * GRAVITY;
    let before = moving.state.speed;
    let state = &mut moving.state;
    match &dynamics.drive {
        DriveTrain::Ackermann(car) => {
            car.step(state, &mut moving.curvature, command, grip, step_s);
        }
        DriveTrain::Differential(robot) => robot.step(state, command, grip, step_s),
    }
    state.wheel_angle += 0.5 * (before + state.speed) * step_s / wheel_radius;
    state.braking = (before.abs() - state.speed.abs()) / step_s > BRAKE_LIGHTS;
}
