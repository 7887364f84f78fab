//! Where the vehicle will be, from the commands it was given.

use crate::check::usable;
use crate::{Drive, Motion, VehicleOptions};
use realnet_core::{DriveCommand, Pose2, Stamp};
use std::collections::VecDeque;

/// The vehicle's own motion from the commands it was given: a dead time, then
/// first-order lags of speed and steering with the vehicle's greatest acceleration,
/// deceleration and steering rate, and a motor that stands below its least speed.
///
/// It serves three ends: the pose at the time when the next command takes effect
/// ([`VehiclePredictor::advance`] from now), odometry between measurements (`advance` from
/// the last one), and the speed where none is measured. Measurements correct it
/// ([`VehiclePredictor::correct`]), in any order.
///
/// It remembers the last [`VehiclePredictor::CAPACITY`] commands and corrections, more
/// than two seconds of a camera at 30 frames a second; before the oldest of them the
/// motion is taken to have been the same. Before the first command the vehicle stands.
///
/// ```
/// use realnet_control::{VehicleOptions, VehiclePredictor};
/// use realnet_core::{DriveCommand, Pose2, Stamp};
///
/// let vehicle = VehicleOptions { dead_time_s: 0.1, speed_lag_s: 0.0, ..Default::default() };
/// let mut predictor = VehiclePredictor::new(vehicle)?;
/// let start = Stamp::ZERO;
/// predictor.push(&DriveCommand { stamp: start, speed: 1.0, ..Default::default() });
/// // Nothing for 0.1 s, then 2 m/s^2 up to 1 m/s, which takes 0.5 s and 0.25 m.
/// let end = Stamp::from_secs_f64(1.6);
/// assert!((predictor.speed_at(Stamp::from_secs_f64(0.35)) - 0.5).abs() < 1e-9);
/// assert!((predictor.advance(Pose2::IDENTITY, start, end).x - 1.25).abs() < 1e-3);
/// # Ok::<(), realnet_control::OptionError>(())
/// ```
#[derive(Clone, Debug)]
pub struct VehiclePredictor {
    vehicle: VehicleOptions,
    /// In the order of their stamps.
    knots: VecDeque<Knot>,
    last_push: Option<Stamp>,
}

/// From `stamp` on the vehicle goes from `state` to `goal`.
#[derive(Clone, Copy, Debug)]
struct Knot {
    stamp: Stamp,
    goal: Motion,
    /// Whether a command set `goal` here; otherwise it is that of the knot before.
    commanded: bool,
    state: Motion,
    /// Whether `state` was measured: then it does not follow from the knot before.
    speed_measured: bool,
    turn_measured: bool,
}

impl Knot {
    /// The first one: the motion is taken to be known, and to go on.
    const fn start(stamp: Stamp, state: Motion) -> Self {
        let (speed_measured, turn_measured) = (true, true);
        Self { stamp, goal: state, commanded: false, state, speed_measured, turn_measured }
    }
}

impl VehiclePredictor {
    /// Commands and corrections that are remembered.
    pub const CAPACITY: usize = 128;

    /// Steps of the integration, seconds at most.
    const STEP_S: f64 = 0.01;

    /// No more steps than this in one [`VehiclePredictor::advance`]; they are longer then.
    const MOST_STEPS: f64 = 1000.0;

    /// Below this speed a rate of turn says nothing about a steering angle, m/s.
    const SLOW_M_S: f64 = 0.1;

    /// A predictor for a vehicle that stands.
    ///
    /// # Errors
    ///
    /// An option that cannot be worked with.
    pub fn new(vehicle: VehicleOptions) -> Result<Self, crate::OptionError> {
        vehicle.check()?;
        Ok(Self { vehicle, knots: VecDeque::with_capacity(Self::CAPACITY), last_push: None })
    }

    /// Forgets everything: the vehicle stands.
    pub fn reset(&mut self) {
        self.knots.clear();
        self.last_push = None;
    }

    /// Takes in a command that was sent. One with the stamp of the last one replaces it;
    /// one with an earlier stamp says that the clock jumped: the history is forgotten,
    /// the vehicle's last known motion is kept. Commands that are not finite are ignored.
    pub fn push(&mut self, command: &DriveCommand) {
        let turn = match self.vehicle.drive {
            Drive::Ackermann { .. } => command.steering_angle - self.vehicle.steering_trim_rad,
            Drive::Differential { .. } => command.yaw_rate,
        };
        if !usable(command.speed) || !usable(turn) {
            return;
        }
        let least = self.vehicle.dead_band.min_speed_m_s;
        // a hair less: a command may have been through a float of another size
        let speed = if command.speed.abs() < 0.999 * least { 0.0 } else { command.speed };
        let goal = Motion { speed, turn };
        let stamp = command.stamp.seconds_later(self.vehicle.dead_time_s);
        if let Some(last) = self.last_push.filter(|last| command.stamp < *last) {
            let state = self.motion_at(last);
            self.knots.clear();
            self.knots.push_back(Knot { goal, commanded: true, ..Knot::start(stamp, state) });
        } else if self.knots.back().is_none_or(|last| last.goal != goal || last.stamp > stamp) {
            // (the same again, as timers send it, changes nothing)
            self.insert(stamp, Some(goal), None, None);
        }
        self.last_push = Some(command.stamp);
    }

    /// Takes in measurements of the motion at a moment: speed in m/s, rate of turn in
    /// rad/s. What the model said for that moment is replaced, what it says for later is
    /// computed again. Of a car that hardly moves, a rate of turn is ignored, and so are
    /// numbers that are not finite.
    pub fn correct(&mut self, stamp: Stamp, speed: Option<f64>, yaw_rate: Option<f64>) {
        let speed = speed.filter(|speed| usable(*speed));
        let yaw_rate = yaw_rate.filter(|rate| usable(*rate));
        let turn = yaw_rate.and_then(|rate| match self.vehicle.drive {
            Drive::Ackermann { wheelbase_m, .. } => {
                let speed = speed.unwrap_or_else(|| self.speed_at(stamp));
                let most = self.vehicle.drive.max_turn();
                (speed.abs() >= Self::SLOW_M_S)
                    .then(|| (rate * wheelbase_m / speed).atan().clamp(-most, most))
            }
            Drive::Differential { .. } => Some(rate),
        });
        if speed.is_some() || turn.is_some() {
            self.insert(stamp, None, speed, turn);
        }
    }

    /// Speed at a moment, m/s.
    #[must_use]
    pub fn speed_at(&self, stamp: Stamp) -> f64 {
        self.motion_at(stamp).speed
    }

    /// Rate of turn at a moment, rad/s.
    #[must_use]
    pub fn yaw_rate_at(&self, stamp: Stamp) -> f64 {
        let motion = self.motion_at(stamp);
        self.vehicle.drive.yaw_rate(motion.speed, motion.turn)
    }

    /// Speed at a moment, and the steering angle without trim (of a differential drive the
    /// rate of turn).
    #[must_use]
    pub fn motion_at(&self, stamp: Stamp) -> Motion {
        let before = self.knots.iter().rev().find(|knot| knot.stamp <= stamp);
        match before.or(self.knots.front()) {
            Some(knot) => self.evolve(knot, stamp),
            None => Motion::default(),
        }
    }

    /// The pose at `to` of a vehicle that is at `pose` at `from`. `to` may be earlier.
    #[must_use]
    pub fn advance(&self, pose: Pose2, from: Stamp, to: Stamp) -> Pose2 {
        let seconds = to.seconds_since(from);
        if seconds == 0.0 {
            return pose;
        }
        let steps = (seconds.abs() / Self::STEP_S).ceil().clamp(1.0, Self::MOST_STEPS);
        let step = seconds / steps;
        // Arcs of the motion in the middle of each step: exact where the motion is even,
        // of second order elsewhere; backwards they undo what they did forwards.
        (0..steps as u32).fold(pose, |pose, index| {
            let middle = from.seconds_later(step * (f64::from(index) + 0.5));
            let motion = self.motion_at(middle);
            let yaw_rate = self.vehicle.drive.yaw_rate(motion.speed, motion.turn);
            pose.driven(motion.speed, yaw_rate, step)
        })
    }

    /// A knot at its place; a goal or state that is not given is the present one.
    fn insert(
        &mut self,
        stamp: Stamp,
        goal: Option<Motion>,
        speed: Option<f64>,
        turn: Option<f64>,
    ) {
        let mut place =
            self.knots.iter().rposition(|knot| knot.stamp <= stamp).map_or(0, |i| i + 1);
        let before = place.checked_sub(1).and_then(|index| self.knots.get(index)).copied();
        let mut knot = match before {
            Some(before) if before.stamp == stamp => {
                place -= 1;
                before
            }
            Some(before) => Knot {
                stamp,
                commanded: false,
                state: self.evolve(&before, stamp),
                speed_measured: false,
                turn_measured: false,
                ..before
            },
            None => {
                let state = self.knots.front().map_or(Motion::default(), |knot| knot.state);
                Knot::start(stamp, state)
            }
        };
        if let Some(goal) = goal {
            knot.goal = goal;
            knot.commanded = true;
        }
        if let Some(speed) = speed {
            knot.state.speed = speed;
            knot.speed_measured = true;
        }
        if let Some(turn) = turn {
            knot.state.turn = turn;
            knot.turn_measured = true;
        }
        if before.is_some_and(|before| before.stamp == stamp) {
            if let Some(old) = self.knots.get_mut(place) {
                *old = knot;
            }
        } else {
            if self.knots.len() == Self::CAPACITY {
                if place == 0 {
                    return; // older than all that is remembered
                }
                self.knots.pop_front();
                place -= 1;
            }
            self.knots.insert(place, knot);
        }
        self.replay(place + 1, knot);
    }

    /// The states from `first` on, anew, and the goals up to the next command.
    fn replay(&mut self, first: usize, mut before: Knot) {
        for index in first..self.knots.len() {
            let Some(mut knot) = self.knots.get(index).copied() else { return };
            let state = self.evolve(&before, knot.stamp);
            if !knot.commanded {
                knot.goal = before.goal;
            }
            if !knot.speed_measured {
                knot.state.speed = state.speed;
            }
            if !knot.turn_measured {
                knot.state.turn = state.turn;
            }
            if let Some(old) = self.knots.get_mut(index) {
                *old = knot;
            }
            before = knot;
        }
    }

    /// The motion at `stamp` if nothing happens between the knot and then.
    fn evolve(&self, knot: &Knot, stamp: Stamp) -> Motion {
        let seconds = stamp.seconds_since(knot.stamp).max(0.0);
        let vehicle = &self.vehicle;
        let (state, goal) = (knot.state, knot.goal);
        let slows = goal.speed.abs() < state.speed.abs() || goal.speed * state.speed < 0.0;
        let rate =
            if slows { vehicle.max_deceleration_m_s2 } else { vehicle.max_acceleration_m_s2 };
        let turn_rate = vehicle.drive.max_turn_rate(vehicle.max_deceleration_m_s2);
        Motion {
            speed: lagged(state.speed, goal.speed, vehicle.speed_lag_s, rate, seconds),
            turn: lagged(state.turn, goal.turn, vehicle.steering_lag_s, turn_rate, seconds),
        }
    }
}

/// A first-order lag with a limited rate: `x' = clamp((goal - x) / lag, -rate, rate)`,
/// solved: first at the greatest rate, and from `lag * rate` off the goal on as an
/// exponential.
fn lagged(from: f64, goal: f64, lag: f64, rate: f64, seconds: f64) -> f64 {
    let missing = goal - from;
    let fast = (missing.abs() - lag * rate).max(0.0) / rate;
    if seconds <= fast {
        return from + rate.copysign(missing) * seconds;
    }
    let rest = missing.abs().min(lag * rate).copysign(missing);
    if lag > 0.0 { goal - rest * (-(seconds - fast) / lag).exp() } else { goal }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_secs_f64(seconds)
    }

    fn say(seconds: f64, speed: f64, steering_angle: f64) -> DriveCommand {
        DriveCommand { stamp: at(seconds), speed, steering_angle, ..DriveCommand::default() }
    }

    /// The model as an equation, by small steps.
    fn slowly(vehicle: &VehicleOptions, commands: &[DriveCommand], until: f64) -> (Pose2, Motion) {
        let tick = 1e-4;
        let mut pose = Pose2::IDENTITY;
        let mut state = Motion::default();
        for index in 0..(until / tick).round() as usize {
            let time = index as f64 * tick;
            let heard = |c: &&DriveCommand| c.stamp.secs_f64() + vehicle.dead_time_s <= time + 1e-9;
            if let Some(command) = commands.iter().rev().find(heard) {
                let runs = command.speed.abs() >= vehicle.dead_band.min_speed_m_s;
                let goal = if runs { command.speed } else { 0.0 };
                let rate = (goal - state.speed) / vehicle.speed_lag_s;
                state.speed += rate.clamp(-4.0, 2.0) * tick;
                let turn = command.steering_angle - vehicle.steering_trim_rad - state.turn;
                state.turn += (turn / vehicle.steering_lag_s).clamp(-4.0, 4.0) * tick;
            }
            let yaw_rate = vehicle.drive.yaw_rate(state.speed, state.turn);
            pose = pose.driven(state.speed, yaw_rate, tick);
        }
        (pose, state)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(50))]

        #[test]
        fn it_is_the_solution_of_the_model(
            commands in prop::collection::vec((0.0..2.0f64, -0.4..0.4f64), 1..20),
            trim in -0.1..0.1f64, until in 0.1..2.5f64,
        ) {
            let vehicle = VehicleOptions { steering_trim_rad: trim, ..VehicleOptions::default() };
            let mut predictor = VehiclePredictor::new(vehicle).unwrap();
            let commands: Vec<_> = commands
                .iter()
                .enumerate()
                .map(|(i, (speed, angle))| say(0.1 * i as f64, *speed, *angle))
                .collect();
            commands.iter().for_each(|command| predictor.push(command));
            let (pose, state) = slowly(&vehicle, &commands, until);
            let motion = predictor.motion_at(at(until));
            prop_assert!((motion.speed - state.speed).abs() < 2e-3, "{motion:?} {state:?}");
            prop_assert!((motion.turn - state.turn).abs() < 2e-3, "{motion:?} {state:?}");
            let predicted = predictor.advance(Pose2::IDENTITY, Stamp::ZERO, at(until));
            prop_assert!((predicted.position() - pose.position()).norm() < 5e-3);
            prop_assert!((predicted.heading - pose.heading).abs() < 1e-2);
            // and back
            let back = predictor.advance(predicted, at(until), Stamp::ZERO);
            // stamps are whole nanoseconds
            prop_assert!(back.position().norm() < 1e-6 && back.heading.abs() < 1e-6);
        }

        /// Corrections may come in any order, and after commands that are later.
        #[test]
        fn late_corrections_are_as_good_as_early_ones(
            speeds in prop::array::uniform6(0.0..2.0f64), seed in any::<u64>(),
        ) {
            let vehicle = VehicleOptions::default();
            let mut in_order = VehiclePredictor::new(vehicle).unwrap();
            let mut late = in_order.clone();
            let times: Vec<_> = (0..6).map(|i| 0.15 + 0.1 * f64::from(i)).collect();
            for i in 0..8 {
                let command = say(0.1 * f64::from(i), 0.5 + 0.1 * f64::from(i), 0.1);
                late.push(&command);
                in_order.push(&command);
                for (time, speed) in times.iter().zip(speeds) {
                    // as soon as its moment has passed
                    if *time > 0.1 * f64::from(i) - 0.1 && *time <= 0.1 * f64::from(i) {
                        in_order.correct(at(*time), Some(speed), Some(0.2));
                    }
                }
            }
            let mut order: Vec<_> = (0..6).collect();
            order.sort_by_key(|i| seed.wrapping_mul(2 * i + 1) % 101);
            for i in order {
                late.correct(at(times[i as usize]), Some(speeds[i as usize]), Some(0.2));
            }
            for time in [0.2, 0.4, 0.66, 0.9] {
                let (a, b) = (in_order.motion_at(at(time)), late.motion_at(at(time)));
                prop_assert!((a.speed - b.speed).abs() < 1e-9, "{a:?} {b:?} at {time}");
            }
        }
    }

    #[test]
    fn a_correction_replaces_the_model_and_fades_into_it() {
        let mut predictor = VehiclePredictor::new(VehicleOptions::default()).unwrap();
        predictor.push(&say(0.0, 1.0, 0.0));
        assert!((predictor.speed_at(at(5.0)) - 1.0).abs() < 1e-6);
        predictor.correct(at(5.0), Some(0.8), Some(0.1));
        assert_eq!(predictor.speed_at(at(5.0)), 0.8);
        assert!((predictor.yaw_rate_at(at(5.0)) - 0.1).abs() < 1e-9);
        assert!((predictor.speed_at(at(6.0)) - 1.0).abs() < 1e-3);
        // numbers that are none, a rate of turn without speed
        predictor.correct(at(5.0), Some(f64::NAN), Some(f64::INFINITY));
        assert_eq!(predictor.speed_at(at(5.0)), 0.8);
        predictor.correct(at(7.0), Some(0.01), Some(3.0));
        assert!(predictor.motion_at(at(7.0)).turn.abs() < 1e-6);
    }

    #[test]
    fn a_command_acts_on_corrections_that_came_before_it() {
        let vehicle = VehicleOptions { dead_time_s: 0.0, ..VehicleOptions::default() };
        let mut predictor = VehiclePredictor::new(vehicle).unwrap();
        predictor.push(&say(0.0, 1.0, 0.0));
        predictor.correct(at(2.1), Some(0.9), None);
        predictor.push(&say(2.0, 0.5, 0.0));
        assert_eq!(predictor.speed_at(at(2.1)), 0.9);
        assert!((predictor.speed_at(at(4.0)) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn the_same_command_again_takes_no_room() {
        let mut predictor = VehiclePredictor::new(VehicleOptions::default()).unwrap();
        for i in 0..100 {
            predictor.push(&say(0.01 * f64::from(i), 1.0, 0.0));
        }
        assert_eq!(predictor.knots.len(), 1);
        assert!((predictor.speed_at(at(5.0)) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn commands_in_the_dead_band_do_not_move_it() {
        let mut predictor = VehiclePredictor::new(VehicleOptions::default()).unwrap();
        predictor.push(&say(0.0, 0.09, 0.0));
        assert_eq!(predictor.speed_at(at(3.0)), 0.0);
        predictor.push(&say(3.0, 0.1, 0.0));
        assert!((predictor.speed_at(at(6.0)) - 0.1).abs() < 1e-6);
    }

    #[test]
    fn its_memory_is_bounded_and_the_oldest_goes_first() {
        let mut predictor = VehiclePredictor::new(VehicleOptions::default()).unwrap();
        for i in 0..1000 {
            predictor.push(&say(0.03 * f64::from(i), 1.0 + f64::from(i % 2), 0.1));
            predictor.correct(at(0.03 * f64::from(i)), Some(1.1), None);
            assert!(predictor.knots.len() <= VehiclePredictor::CAPACITY);
        }
        assert!(predictor.knots.iter().is_sorted_by_key(|knot| knot.stamp));
        let oldest = predictor.knots[0].stamp;
        predictor.correct(at(0.5), Some(0.0), None);
        assert_eq!(predictor.knots[0].stamp, oldest, "too old to be remembered");
        assert!(predictor.knots.len() <= VehiclePredictor::CAPACITY);
    }

    #[test]
    fn a_clock_that_jumps_back_starts_it_anew_at_the_same_speed() {
        let mut predictor = VehiclePredictor::new(VehicleOptions::default()).unwrap();
        predictor.push(&say(1000.0, 1.0, 0.0));
        predictor.push(&say(1003.0, 1.0, 0.0));
        predictor.push(&say(5.0, 0.0, 0.0));
        assert!((predictor.speed_at(at(5.1)) - 1.0).abs() < 1e-3);
        assert!(predictor.speed_at(at(6.0)) < 1e-3);
        predictor.reset();
        assert_eq!(predictor.motion_at(at(9.0)), Motion::default());
    }

    #[test]
    fn a_command_with_the_same_stamp_replaces_the_last() {
        let mut predictor = VehiclePredictor::new(VehicleOptions::default()).unwrap();
        predictor.push(&say(0.0, 1.0, 0.0));
        predictor.push(&say(0.0, 0.5, 0.0));
        assert!((predictor.speed_at(at(5.0)) - 0.5).abs() < 1e-6);
        assert_eq!(predictor.knots.len(), 1);
        let vehicle = VehicleOptions { dead_time_s: -1.0, ..VehicleOptions::default() };
        assert!(VehiclePredictor::new(vehicle).is_err());
    }
}
