//! The vehicle's limits, and its dead band.

use crate::{Drive, VehicleOptions};
use realnet_core::{DriveCommand, Stamp};

/// How a vehicle is to move, before its limits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Metres a second, positive forward.
    pub speed: f64,
    /// Steering angle of a car, without trim, radians; rate of turn of a differential
    /// drive, radians a second. Positive to the left.
    pub turn: f64,
}

/// Turns a motion that is wanted into a command within the vehicle's limits: angle and
/// its rate, speed, acceleration and deceleration, wheel speeds, dead band.
///
/// Rates are counted between the stamps of commands, at most
/// [`Limiter::LONGEST_STEP_S`] at once; a stamp that repeats or jumps back allows no
/// change. Starting from standstill and coming to it, a speed may step over the dead band.
#[derive(Clone, Debug)]
pub struct Limiter {
    vehicle: VehicleOptions,
    last: Motion,
    stamp: Option<Stamp>,
    stopped: Option<Stamp>,
}

impl Limiter {
    /// A pause counts as no more than this, seconds.
    pub const LONGEST_STEP_S: f64 = 0.2;

    pub(crate) const fn new(vehicle: VehicleOptions) -> Self {
        Self { vehicle, last: Motion { speed: 0.0, turn: 0.0 }, stamp: None, stopped: None }
    }

    /// The motion that was commanded last.
    #[must_use]
    pub const fn last(&self) -> Motion {
        self.last
    }

    /// Seconds since the last command that count.
    #[must_use]
    pub fn seconds(&self, now: Stamp) -> f64 {
        let since = self.stamp.map_or(0.0, |stamp| now.seconds_since(stamp));
        since.clamp(0.0, Self::LONGEST_STEP_S)
    }

    /// The command nearest to the motion wanted. `ceiling` is a bound on the speed that
    /// the dead band must not lift it over.
    #[must_use]
    pub fn limit(&self, now: Stamp, wanted: Motion, ceiling: f64) -> DriveCommand {
        let seconds = self.seconds(now);
        let turn = self.turn(wanted.turn, seconds);
        let mut speed = self.speed(now, wanted.speed, ceiling, seconds);
        let vehicle = &self.vehicle;
        if let Drive::Differential { track_m, max_wheel_speed_m_s, .. } = vehicle.drive {
            // The outer wheel is as fast as |v| + |w| track / 2.
            let most = (max_wheel_speed_m_s - 0.5 * track_m * turn.abs()).max(0.0);
            if speed.abs() > most {
                let least = vehicle.dead_band.min_speed_m_s;
                speed = if most < least { 0.0 } else { most.copysign(speed) };
            }
        }
        command(vehicle, now, Motion { speed, turn })
    }

    /// What was really sent. The next command starts from it.
    pub fn sent(&mut self, command: &DriveCommand) {
        let turn = match self.vehicle.drive {
            Drive::Ackermann { .. } => command.steering_angle - self.vehicle.steering_trim_rad,
            Drive::Differential { .. } => command.yaw_rate,
        };
        if command.speed == 0.0 && self.last.speed != 0.0 {
            self.stopped = Some(command.stamp);
        }
        self.last = Motion { speed: command.speed, turn };
        self.stamp = Some(command.stamp);
    }

    fn turn(&self, wanted: f64, seconds: f64) -> f64 {
        let vehicle = &self.vehicle;
        let step = vehicle.drive.max_turn_rate(vehicle.max_deceleration_m_s2) * seconds;
        let most = vehicle.drive.max_turn();
        let trim = vehicle.steering_trim_rad;
        let turn = self.last.turn + (wanted - self.last.turn).clamp(-step, step);
        turn.clamp(-most - trim, most - trim)
    }

    fn speed(&self, now: Stamp, wanted: f64, ceiling: f64, seconds: f64) -> f64 {
        let vehicle = &self.vehicle;
        let last = self.last.speed;
        let ceiling = ceiling.clamp(0.0, vehicle.max_speed_m_s);
        let wanted = wanted.clamp(-vehicle.max_reverse_speed_m_s, ceiling);
        let least = vehicle.dead_band.min_speed_m_s;
        let mut goal = self.over_dead_band(now, wanted, ceiling);
        if goal * last < 0.0 {
            // First to a stop, then the other way.
            goal = 0.0;
        }
        if goal.abs() > last.abs() {
            let most = (last.abs() + vehicle.max_acceleration_m_s2 * seconds).max(least);
            goal.abs().min(most).copysign(goal)
        } else {
            let slower = (last.abs() - vehicle.max_deceleration_m_s2 * seconds).max(goal.abs());
            if slower < least { 0.0 } else { slower.copysign(last) }
        }
    }

    /// 0 or at least the least speed, with hysteresis and a pause after a stop.
    fn over_dead_band(&self, now: Stamp, wanted: f64, ceiling: f64) -> f64 {
        let band = &self.vehicle.dead_band;
        let least = band.min_speed_m_s;
        let room = if wanted < 0.0 { self.vehicle.max_reverse_speed_m_s } else { ceiling };
        if room < least {
            return 0.0;
        }
        if self.last.speed == 0.0 {
            // A clock that jumped back must not hold the vehicle for long.
            let rests = self
                .stopped
                .is_some_and(|stopped| (0.0..band.stand_s).contains(&now.seconds_since(stopped)));
            if rests || wanted.abs() < band.start_share * least {
                return 0.0;
            }
        } else if wanted.abs() < band.stop_share * least {
            return 0.0;
        }
        if wanted == 0.0 { 0.0 } else { wanted.abs().max(least).copysign(wanted) }
    }
}

/// The command of a motion, angle and rate of turn as they belong together.
pub(crate) fn command(vehicle: &VehicleOptions, stamp: Stamp, motion: Motion) -> DriveCommand {
    let steering_angle = match vehicle.drive {
        Drive::Ackermann { .. } => {
            let most = vehicle.drive.max_turn();
            (motion.turn + vehicle.steering_trim_rad).clamp(-most, most)
        }
        Drive::Differential { .. } => 0.0,
    };
    let yaw_rate = vehicle.drive.yaw_rate(motion.speed, motion.turn);
    DriveCommand { stamp, speed: motion.speed, steering_angle, yaw_rate, stop: None }
}
