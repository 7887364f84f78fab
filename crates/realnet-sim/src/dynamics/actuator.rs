//! Motors and steering servos: what stands between a command and the wheels.

use super::lag_share;

/// Below this a wheel counts as standing, m/s.
const STANDING: f64 = 1e-3;

/// A motor with its speed controller, in terms of the speed of the wheels' rims.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    /// The most that it reaches, either way, m/s.
    pub max_speed: f64,
    /// The most that it gains, m/s^2.
    pub max_acceleration: f64,
    /// The most that it loses when it brakes, m/s^2.
    pub max_braking: f64,
    /// Time constant of the speed controller, s; 0: none.
    pub lag_s: f64,
    /// Dead band: a standing motor does not start for a command below this, m/s.
    pub start_speed: f64,
    /// A turning motor stops for a command below this, m/s; at most `start_speed`.
    pub hold_speed: f64,
    /// Deceleration by friction when standstill is asked for, m/s^2: what ends the
    /// endless tail of the lag.
    pub drag: f64,
    /// Speed that is reached over speed that is commanded: 1.1 is 10 % too fast.
    pub gain: f64,
}

impl Motor {
    /// Every parameter by name, for checks.
    pub(super) fn parameters(&self) -> [(&'static str, f64); 8] {
        [
            ("motor max_speed", self.max_speed),
            ("motor max_acceleration", self.max_acceleration),
            ("motor max_braking", self.max_braking),
            ("motor lag_s", self.lag_s),
            ("motor start_speed", self.start_speed),
            ("motor hold_speed", self.hold_speed),
            ("motor drag", self.drag),
            ("motor gain", self.gain),
        ]
    }

    /// The speed that the controller goes for at a command, when it runs at `speed`.
    pub(super) fn goal(&self, command: f64, speed: f64) -> f64 {
        let least = if speed.abs() < STANDING { self.start_speed } else { self.hold_speed };
        if command.abs() < least {
            0.0
        } else {
            (command * self.gain).clamp(-self.max_speed, self.max_speed)
        }
    }

    /// Mean acceleration over the next step, m/s^2, for a speed that is on its way
    /// to `goal`. `grip` is the most that the tyres give.
    pub(super) fn acceleration(&self, speed: f64, goal: f64, grip: f64, step_s: f64) -> f64 {
        let missing = goal - speed;
        let mut change = lag_share(self.lag_s, step_s) * missing;
        if goal == 0.0 {
            let drag = self.drag * step_s;
            change = change.abs().max(drag).min(missing.abs()).copysign(missing);
        }
        let limit = if speed * change < 0.0 { self.max_braking } else { self.max_acceleration };
        let limit = limit.min(grip);
        (change / step_s).clamp(-limit, limit)
    }
}

/// A steering servo and its linkage, at the virtual front wheel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steering {
    /// The most that the wheels turn, either way, radians.
    pub max_angle: f64,
    /// How fast they turn at most, rad/s.
    pub max_rate: f64,
    /// Time constant of the servo, s; 0: none.
    pub lag_s: f64,
    /// Where the wheels stand when 0 is commanded, radians: a servo arm that is a
    /// tooth off.
    pub trim: f64,
    /// Angle that is reached over angle that is commanded.
    pub gain: f64,
}

impl Steering {
    /// Every parameter by name, for checks. The trim may be negative.
    pub(super) fn parameters(&self) -> [(&'static str, f64); 5] {
        [
            ("steering max_angle", self.max_angle),
            ("steering max_rate", self.max_rate),
            ("steering lag_s", self.lag_s),
            ("steering trim", self.trim.abs()),
            ("steering gain", self.gain),
        ]
    }

    /// The angle after a step.
    pub(super) fn stepped(&self, angle: f64, command: f64, step_s: f64) -> f64 {
        let goal = (command * self.gain + self.trim).clamp(-self.max_angle, self.max_angle);
        let most = self.max_rate * step_s;
        let change = (lag_share(self.lag_s, step_s) * (goal - angle)).clamp(-most, most);
        (angle + change).clamp(-self.max_angle, self.max_angle)
    }
}
