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

#[cfg(test)]
mod tests {
    use super::*;

    /// Commands at 50 Hz for a while, each what is wanted at its time.
    fn run(
        limiter: &mut Limiter,
        from: f64,
        steps: u32,
        wanted: impl Fn(f64) -> Motion,
    ) -> Vec<DriveCommand> {
        (0..steps)
            .map(|step| {
                let time = from + 0.02 * f64::from(step);
                let command = limiter.limit(Stamp::from_secs_f64(time), wanted(time), 9.0);
                limiter.sent(&command);
                command
            })
            .collect()
    }

    const fn motion(speed: f64, turn: f64) -> Motion {
        Motion { speed, turn }
    }

    #[test]
    fn full_speed_and_lock_take_their_time() {
        let mut limiter = Limiter::new(VehicleOptions::default());
        let commands = run(&mut limiter, 0.0, 60, |_| motion(9.0, -9.0));
        let when = |done: &dyn Fn(&DriveCommand) -> bool| {
            commands.iter().find(|command| done(command)).unwrap().stamp.secs_f64()
        };
        // the first 0.1 m/s are in the dead band
        assert!((when(&|c| c.speed >= 2.0) - 1.9 / 2.0).abs() < 0.03);
        assert!((when(&|c| c.steering_angle <= -0.42) - 0.105).abs() < 0.03);
        let commands = run(&mut limiter, 1.2, 60, |_| motion(0.0, 0.0));
        let stopped = commands.iter().find(|command| command.speed == 0.0).unwrap();
        // the last 0.1 m/s are in the dead band
        assert!((stopped.stamp.secs_f64() - 1.2 - 1.9 / 4.0).abs() < 0.03);
    }

    #[test]
    fn the_dead_band_has_hysteresis_and_a_pause() {
        let mut limiter = Limiter::new(VehicleOptions::default());
        let speeds = |commands: &[DriveCommand]| -> Vec<f64> {
            commands.iter().map(|command| command.speed).collect()
        };
        let none = speeds(&run(&mut limiter, 0.0, 10, |_| motion(0.099, 0.0)));
        assert!(none.iter().all(|speed| *speed == 0.0), "{none:?}");
        let starts = speeds(&run(&mut limiter, 0.2, 10, |_| motion(0.1, 0.0)));
        assert!(starts.iter().all(|speed| *speed == 0.1), "{starts:?}");
        let stays = speeds(&run(&mut limiter, 0.4, 10, |_| motion(0.05, 0.0)));
        assert!(stays.iter().all(|speed| *speed == 0.1), "{stays:?}");
        let stops = speeds(&run(&mut limiter, 0.6, 1, |_| motion(0.03, 0.0)));
        assert_eq!(stops, [0.0]);
        let again = run(&mut limiter, 0.62, 40, |_| motion(0.2, 0.0));
        let start = again.iter().find(|command| command.speed > 0.0).unwrap();
        assert!((start.stamp.secs_f64() - 0.6 - 0.3).abs() < 0.021, "{start:?}");
    }

    #[test]
    fn the_dead_band_lifts_nothing_over_the_ceiling() {
        let mut limiter = Limiter::new(VehicleOptions::default());
        run(&mut limiter, 0.0, 20, |_| motion(0.1, 0.0));
        let command = limiter.limit(Stamp::from_secs_f64(0.5), motion(0.1, 0.0), 0.08);
        assert_eq!(command.speed, 0.0);
    }

    #[test]
    fn backwards_only_where_it_is_allowed_and_after_a_stop() {
        let mut limiter = Limiter::new(VehicleOptions::default());
        let commands = run(&mut limiter, 0.0, 50, |_| motion(-1.0, 0.0));
        assert!(commands.iter().all(|command| command.speed == 0.0));
        let vehicle = VehicleOptions { max_reverse_speed_m_s: 0.4, ..VehicleOptions::default() };
        let mut limiter = Limiter::new(vehicle);
        run(&mut limiter, 0.0, 50, |_| motion(1.0, 0.0));
        let commands = run(&mut limiter, 1.0, 100, |_| motion(-1.0, 0.0));
        let still = commands.iter().filter(|command| command.speed == 0.0).count();
        assert!(still >= 14, "0.3 s are {still} steps");
        assert_eq!(commands.last().unwrap().speed, -0.4);
    }

    #[test]
    fn stamps_that_repeat_or_jump_back_change_nothing() {
        let mut limiter = Limiter::new(VehicleOptions::default());
        let last = *run(&mut limiter, 5.0, 20, |_| motion(1.0, 0.3)).last().unwrap();
        for time in [last.stamp.secs_f64(), 1.0, -1e9] {
            let command = limiter.limit(Stamp::from_secs_f64(time), motion(2.0, -0.4), 9.0);
            assert_eq!(command.speed, last.speed);
            assert_eq!(command.steering_angle, last.steering_angle);
        }
        // A long pause counts as a short one.
        let command = limiter.limit(Stamp::from_secs_f64(1e6), motion(2.0, 0.3), 9.0);
        assert!((command.speed - last.speed - 0.4).abs() < 1e-9);
    }

    #[test]
    fn the_outer_wheel_of_a_robot_limits_its_speed() {
        let mut limiter =
            Limiter::new(VehicleOptions { max_speed_m_s: 1.0, ..VehicleOptions::robot() });
        let last = *run(&mut limiter, 0.0, 80, |_| motion(1.0, 2.0)).last().unwrap();
        assert!((last.speed - 0.8).abs() < 1e-9 && (last.yaw_rate - 2.0).abs() < 1e-9, "{last:?}");
        assert_eq!(last.steering_angle, 0.0);
    }

    #[test]
    fn trim_is_in_the_angle_and_not_in_the_rate_of_turn() {
        let vehicle = VehicleOptions { steering_trim_rad: 0.05, ..VehicleOptions::default() };
        let mut limiter = Limiter::new(vehicle);
        let last = *run(&mut limiter, 0.0, 50, |_| motion(1.0, 0.1)).last().unwrap();
        assert!((last.steering_angle - 0.15).abs() < 1e-12);
        assert!((last.yaw_rate - 0.1_f64.tan() / 0.26).abs() < 1e-12);
    }
}
