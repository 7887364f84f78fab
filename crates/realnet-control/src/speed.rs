//! How fast to drive: the gap's PID and what bounds the speed.

use crate::check::{not_negative, positive, share};
use crate::{Gap, OptionError, VehicleOptions};

/// Options of the speed control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedOptions {
    /// The gap to keep at standstill, from the front bumper to the target, metres.
    pub gap_m: f64,
    /// What the gap grows by with the own speed, seconds.
    pub headway_s: f64,
    /// Speed for each metre of gap error, 1/s.
    pub kp: f64,
    /// Its growth with time, 1/s^2: makes up for a speed that is not quite the one
    /// commanded.
    pub ki: f64,
    /// Share of the gap's rate of change that is added: it shortens the lag of the speed
    /// to `1 / (1 + kd)` of what it is.
    pub kd: f64,
    /// Time constant over which the target's speed is averaged for the feed-forward and
    /// the derivative, seconds: a filter that follows a target closely has a noisy
    /// velocity. The bound by the stopping distance takes the speed as it is.
    pub smoothing_s: f64,
    /// The integral adds no more than this to either side, metres a second.
    pub max_integral_m_s: f64,
    /// With a gap error beyond this the integral waits, metres.
    pub integral_band_m: f64,
    /// A robot that stands goes on when the gap is off by more than this, metres, and by
    /// more than [`SpeedOptions::range_sigmas`] deviations, or when the target drives off:
    /// the noise of a standing target's distance must not make the robot creep.
    pub restart_error_m: f64,
    /// The target drives off when it is faster than this, metres a second, and by as many
    /// deviations.
    pub restart_speed_m_s: f64,
    /// Greatest lateral acceleration in curves, metres a second squared.
    pub max_lateral_acceleration_m_s2: f64,
    /// What the target is taken to be able to brake with, metres a second squared.
    pub target_deceleration_m_s2: f64,
    /// Share of the own greatest deceleration that is counted on.
    pub brake_share: f64,
    /// From what the target does to its estimate, seconds. The time to the effect of a
    /// command is added to it.
    pub perception_latency_s: f64,
    /// So many standard deviations are taken off the gap where collisions are at stake.
    pub range_sigmas: f64,
    /// And so many off the target's speed.
    pub speed_sigmas: f64,
}

impl Default for SpeedOptions {
    fn default() -> Self {
        Self {
            gap_m: 1.0,
            headway_s: 0.0,
            kp: 1.4,
            ki: 0.2,
            kd: 0.2,
            smoothing_s: 0.2,
            max_integral_m_s: 0.3,
            integral_band_m: 0.4,
            restart_error_m: 0.08,
            restart_speed_m_s: 0.1,
            max_lateral_acceleration_m_s2: 2.5,
            target_deceleration_m_s2: 4.0,
            brake_share: 0.8,
            perception_latency_s: 0.1,
            range_sigmas: 2.0,
            speed_sigmas: 1.0,
        }
    }
}

impl SpeedOptions {
    pub(crate) fn check(&self, stopping_radius_m: f64) -> Result<(), OptionError> {
        OptionError::check(
            "speed.gap_m",
            self.gap_m,
            self.gap_m > stopping_radius_m && self.gap_m <= 1000.0,
            "above governor.stopping_radius_m, at most 1000 m",
        )?;
        for (name, value) in [
            ("speed.headway_s", self.headway_s),
            ("speed.kp", self.kp),
            ("speed.ki", self.ki),
            ("speed.kd", self.kd),
        ] {
            let ok = (0.0..=100.0).contains(&value);
            OptionError::check(name, value, ok, "at least 0, at most 100")?;
        }
        not_negative("speed.smoothing_s", self.smoothing_s)?;
        not_negative("speed.max_integral_m_s", self.max_integral_m_s)?;
        not_negative("speed.integral_band_m", self.integral_band_m)?;
        not_negative("speed.restart_error_m", self.restart_error_m)?;
        not_negative("speed.restart_speed_m_s", self.restart_speed_m_s)?;
        positive("speed.max_lateral_acceleration_m_s2", self.max_lateral_acceleration_m_s2)?;
        positive("speed.target_deceleration_m_s2", self.target_deceleration_m_s2)?;
        share("speed.brake_share", self.brake_share)?;
        not_negative("speed.perception_latency_s", self.perception_latency_s)?;
        not_negative("speed.range_sigmas", self.range_sigmas)?;
        not_negative("speed.speed_sigmas", self.speed_sigmas)
    }

    /// The greatest speed at which the robot can still stop outside of the stopping
    /// radius if the target brakes now with all it has, metres a second.
    ///
    /// Both brake: the target needs `w^2 / (2 a)` from its speed `w` on, the robot first
    /// drives on for the reaction time `T` and then needs `v^2 / (2 b)`:
    ///
    /// `v T + v^2 / (2 b) <= s + w^2 / (2 a)`, so
    /// `v = b (sqrt(T^2 + 2 (s + w^2 / (2 a)) / b) - T)`
    ///
    /// with the room `s` to the stopping radius, [`SpeedOptions::range_sigmas`]
    /// deviations of the gap taken off, and [`SpeedOptions::speed_sigmas`] off `w`. A
    /// target that comes nearer (`w < 0`) is taken to go on doing so until the robot
    /// stands.
    #[must_use]
    pub fn stopping_speed(
        &self,
        gap: &Gap,
        vehicle: &VehicleOptions,
        stopping_radius_m: f64,
    ) -> f64 {
        let braking = self.brake_share * vehicle.max_deceleration_m_s2;
        let reaction = self.perception_latency_s + vehicle.dead_time_s + vehicle.speed_lag_s;
        let room = gap.length_m - self.range_sigmas * gap.std_m - stopping_radius_m;
        let target = gap.target_speed_m_s - self.speed_sigmas * gap.target_speed_std_m_s;
        let (away, nearer) = (target.max(0.0), (-target).max(0.0));
        let room = room + 0.5 * away * away / self.target_deceleration_m_s2 - nearer * reaction;
        let slowness = reaction + nearer / braking;
        braking * ((slowness * slowness + 2.0 * room.max(0.0) / braking).sqrt() - slowness)
    }

    /// Whether a robot that stands has a reason to go on, which noise is not.
    #[must_use]
    pub fn restarts(&self, gap: &Gap, control: &GapControl) -> bool {
        let sigmas = self.range_sigmas;
        let off = self.restart_error_m.max(sigmas * gap.std_m);
        let fast = self.restart_speed_m_s + sigmas * gap.target_speed_std_m_s;
        control.error_m.abs() > off || control.feed_forward_m_s > fast
    }

    /// The greatest speed on a curve, metres a second: from the lateral acceleration
    /// `v^2 |kappa|`.
    #[must_use]
    pub fn curve_speed(&self, curvature: f64) -> f64 {
        (self.max_lateral_acceleration_m_s2 / curvature.abs().max(1e-9)).sqrt()
    }
}

/// Own motion at the moment of the gap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OwnMotion {
    /// Metres a second.
    pub speed: f64,
    /// Radians a second.
    pub yaw_rate: f64,
}

/// What the gap's control did in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GapControl {
    /// The gap to keep, metres.
    pub desired_m: f64,
    /// The gap minus that, metres.
    pub error_m: f64,
    /// Rate of change of the gap, metres a second.
    pub rate_m_s: f64,
    /// Speed at which the gap would stay as it is, metres a second.
    pub feed_forward_m_s: f64,
    /// The integral's part, metres a second.
    pub integral_m_s: f64,
    /// The speed wanted: the sum of all parts, metres a second.
    pub speed_m_s: f64,
}

/// PID control of the gap. Its output is a speed.
///
/// The feed-forward is the speed at which the gap stays as it is. The derivative is the
/// measured relative speed, not the difference of gap errors, so that neither noise nor
/// a new desired gap kicks. The integral stands still while what was sent last was
/// limited on the side that it would push to, and far from the desired gap.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GapController {
    target_speed: Option<f64>,
    integral: f64,
    wanted: f64,
    sent: f64,
}

impl GapController {
    /// One step, `seconds` after the last one.
    pub fn step(
        &mut self,
        options: &SpeedOptions,
        gap: &Gap,
        own: OwnMotion,
        front_m: f64,
        seconds: f64,
    ) -> GapControl {
        let desired_m = options.gap_m + options.headway_s * own.speed.max(0.0);
        let error_m = gap.length_m - desired_m;
        // The front bumper moves with the speed along x and yaw rate times lever along y.
        let sideways = gap.sight.y * own.yaw_rate * front_m;
        let target_speed = match self.target_speed {
            Some(before) => {
                let share = seconds / (seconds + options.smoothing_s).max(1e-9);
                before + share * (gap.target_speed_m_s - before)
            }
            None => gap.target_speed_m_s,
        };
        self.target_speed = Some(target_speed);
        let rate_m_s = target_speed - gap.sight.x * own.speed - sideways;
        // Across the line of sight no speed closes the gap: the cosine is bounded.
        let feed_forward_m_s = (target_speed - sideways) / gap.sight.x.max(0.5);
        let push = options.ki * error_m * seconds;
        // Dead band and rates change a command too; 1 mm/s is not worth waiting for.
        let limited_up = self.sent < self.wanted - 1e-3 && push > 0.0;
        let limited_down = self.sent > self.wanted + 1e-3 && push < 0.0;
        if error_m.abs() <= options.integral_band_m && !limited_up && !limited_down {
            let most = options.max_integral_m_s;
            self.integral = (self.integral + push).clamp(-most, most);
        }
        let speed_m_s =
            feed_forward_m_s + options.kp * error_m + options.kd * rate_m_s + self.integral;
        self.wanted = speed_m_s;
        GapControl {
            desired_m,
            error_m,
            rate_m_s,
            feed_forward_m_s,
            integral_m_s: self.integral,
            speed_m_s,
        }
    }

    /// What became of the last speed wanted, metres a second.
    pub fn sent(&mut self, speed: f64) {
        self.sent = speed;
    }

    /// After a stop: what was learnt is forgotten.
    pub fn reset(&mut self) {
        *self = Self::default();
    }
}

/// What bounded the speed in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SpeedBound {
    /// Nothing: the gap's control decided.
    #[default]
    None,
    /// The vehicle's greatest speed.
    Vehicle,
    /// The stopping distance.
    Stopping,
    /// The lateral acceleration, the rate of turn or a wheel's speed in a curve.
    Curve,
    /// The target is lost: not faster than before, or slower and slower.
    Lost,
}

impl SpeedBound {
    /// The name in files and plots.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Vehicle => "vehicle",
            Self::Stopping => "stopping",
            Self::Curve => "curve",
            Self::Lost => "lost",
        }
    }
}

/// The bounds of the speed in a step, metres a second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpeedBounds {
    /// [`SpeedBound::Vehicle`].
    pub vehicle: f64,
    /// [`SpeedBound::Stopping`].
    pub stopping: f64,
    /// [`SpeedBound::Curve`].
    pub curve: f64,
    /// [`SpeedBound::Lost`]; infinite while the target is tracked.
    pub lost: f64,
}

impl SpeedBounds {
    /// The least of them and which it is.
    #[must_use]
    pub fn least(&self) -> (f64, SpeedBound) {
        [
            (self.vehicle, SpeedBound::Vehicle),
            (self.stopping, SpeedBound::Stopping),
            (self.curve, SpeedBound::Curve),
            (self.lost, SpeedBound::Lost),
        ]
        .into_iter()
        .fold(
            (f64::INFINITY, SpeedBound::None),
            |best, next| if next.0 < best.0 { next } else { best },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realnet_core::nalgebra::Vector2;

    fn gap(length_m: f64, target_speed_m_s: f64) -> Gap {
        Gap {
            length_m,
            std_m: 0.0,
            sight: Vector2::x(),
            target_speed_m_s,
            target_speed_std_m_s: 0.0,
        }
    }

    const STILL: OwnMotion = OwnMotion { speed: 0.0, yaw_rate: 0.0 };

    /// The gap when both have braked to a stand, the robot after its reaction time. A
    /// target that comes nearer goes on until the robot stands.
    fn left_over(options: &SpeedOptions, gap: &Gap, vehicle: &VehicleOptions, speed: f64) -> f64 {
        let braking = options.brake_share * vehicle.max_deceleration_m_s2;
        let reaction = options.perception_latency_s + vehicle.dead_time_s + vehicle.speed_lag_s;
        let (mut own, mut target, mut left) = (speed, gap.target_speed_m_s, gap.length_m);
        let tick = 1e-4;
        let mut time = 0.0;
        while own > 0.0 {
            left += (target - own) * tick;
            time += tick;
            if time > reaction {
                own -= braking * tick;
            }
            if target > 0.0 {
                target = (target - options.target_deceleration_m_s2 * tick).max(0.0);
            }
        }
        left + if target > 0.0 {
            target * target / (2.0 * options.target_deceleration_m_s2)
        } else {
            0.0
        }
    }

    proptest! {
        #[test]
        fn at_the_stopping_speed_it_comes_to_a_stand_at_the_radius(
            length in 0.4..6.0f64, target in -1.0..2.0f64,
        ) {
            let (options, vehicle) = (SpeedOptions::default(), VehicleOptions::default());
            let gap = gap(length, target);
            let speed = options.stopping_speed(&gap, &vehicle, 0.35);
            prop_assert!(speed.is_finite() && speed >= 0.0);
            if speed > 0.0 {
                let left = left_over(&options, &gap, &vehicle, speed);
                prop_assert!((left - 0.35).abs() < 2e-3, "{speed} m/s leave {left} m");
            }
        }
    }

    #[test]
    fn doubt_makes_slow() {
        let (options, vehicle) = (SpeedOptions::default(), VehicleOptions::default());
        let sure = gap(1.2, 0.5);
        let speed = |gap: &Gap| options.stopping_speed(gap, &vehicle, 0.35);
        let range = Gap { std_m: 0.1, ..sure };
        assert!((speed(&range) - speed(&gap(1.0, 0.5))).abs() < 1e-12);
        let target = Gap { target_speed_std_m_s: 0.2, ..sure };
        assert!((speed(&target) - speed(&gap(1.2, 0.3))).abs() < 1e-12);
        assert_eq!(speed(&gap(0.3, 0.0)), 0.0);
        assert_eq!(options.curve_speed(0.4), 2.5);
        assert!(options.curve_speed(0.0).is_finite());
    }

    #[test]
    fn at_the_desired_gap_it_drives_as_fast_as_the_target() {
        let options = SpeedOptions::default();
        let own = OwnMotion { speed: 0.6, yaw_rate: 0.0 };
        let control = GapController::default().step(&options, &gap(1.0, 0.6), own, 0.34, 0.03);
        assert!((control.speed_m_s - 0.6).abs() < 1e-12);
        let headway = SpeedOptions { headway_s: 0.5, ..options };
        let control = GapController::default().step(&headway, &gap(1.0, 0.6), own, 0.34, 0.03);
        assert!((control.desired_m - 1.3).abs() < 1e-12 && control.speed_m_s < 0.6);
    }

    /// Both on one circle: the line of sight is a chord of it, the gap stays.
    #[test]
    fn on_a_circle_the_feed_forward_is_the_speed_of_both() {
        let (radius, front, speed) = (1.5_f64, 0.34, 0.5);
        let ahead = 0.9_f64;
        let target = radius * Vector2::new(ahead.sin(), 1.0 - ahead.cos());
        let velocity = speed * Vector2::new(ahead.cos(), ahead.sin());
        let line = target - Vector2::new(front, 0.0);
        let sight = line.normalize();
        let target_speed_m_s = sight.dot(&velocity);
        let gap = Gap { length_m: line.norm(), sight, target_speed_m_s, ..gap(1.0, 0.0) };
        let own = OwnMotion { speed, yaw_rate: speed / radius };
        let control =
            GapController::default().step(&SpeedOptions::default(), &gap, own, front, 0.03);
        assert!((control.feed_forward_m_s - speed).abs() < 1e-9, "{control:?}");
        assert!(control.rate_m_s.abs() < 1e-9, "{control:?}");
    }

    #[test]
    fn the_integral_waits_while_the_command_is_limited() {
        let options = SpeedOptions::default();
        let mut controller = GapController::default();
        let mut step = |length, sent: Option<f64>| {
            let control = controller.step(&options, &gap(length, 0.0), STILL, 0.34, 0.1);
            controller.sent(sent.unwrap_or(control.speed_m_s));
            control.integral_m_s
        };
        // 0.3 m too far for 10 s, and it cannot go faster: nothing but the first step.
        for _ in 0..100 {
            assert!(step(1.3, Some(0.1)) <= 0.2 * 0.3 * 0.1 + 1e-12);
        }
        // It can go slower.
        assert!(step(0.9, None) < 0.2 * 0.3 * 0.1);
        // Far from the desired gap it waits, near it grows up to its bound.
        let before = step(1.3, None);
        assert_eq!(step(2.0, None), before);
        for _ in 0..200 {
            step(1.3, None);
        }
        assert!((step(1.3, None) - 0.3).abs() < 1e-12);
        controller.reset();
        assert_eq!(controller, GapController::default());
    }

    #[test]
    fn noise_is_no_reason_to_go_on() {
        let options = SpeedOptions::default();
        let restarts = |length, speed, std_m, target_speed_std_m_s| {
            let gap = Gap { std_m, target_speed_std_m_s, ..gap(length, speed) };
            let control = GapController::default().step(&options, &gap, STILL, 0.34, 0.03);
            options.restarts(&gap, &control)
        };
        assert!(!restarts(1.07, 0.05, 0.02, 0.05));
        assert!(restarts(1.09, 0.05, 0.02, 0.05));
        assert!(!restarts(1.09, 0.05, 0.05, 0.05));
        // the target drives off
        assert!(restarts(1.02, 0.25, 0.05, 0.05) && !restarts(1.02, 0.25, 0.05, 0.1));
    }

    #[test]
    fn the_least_bound_is_named() {
        let bounds = SpeedBounds { vehicle: 2.0, stopping: 1.0, curve: 1.5, lost: f64::INFINITY };
        assert_eq!(bounds.least(), (1.0, SpeedBound::Stopping));
        let bounds = SpeedBounds { lost: 0.2, ..bounds };
        assert_eq!(bounds.least(), (0.2, SpeedBound::Lost));
    }
}
