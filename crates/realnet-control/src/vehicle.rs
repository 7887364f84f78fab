//! What a vehicle can do, and how late it does it.

use crate::OptionError;
use crate::check::{not_negative, positive, share};

/// How a vehicle turns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// A car. Its base frame is at the middle of the rear axle.
    Ackermann {
        /// From axle to axle, metres.
        wheelbase_m: f64,
        /// Greatest angle of the virtual front wheel to either side, radians.
        max_steering_rad: f64,
        /// Greatest rate of that angle, radians a second.
        max_steering_rate_rad_s: f64,
    },
    /// Two driven wheels. The base frame is in the middle between them.
    Differential {
        /// Between the two wheels, metres.
        track_m: f64,
        /// Greatest speed of a wheel over ground, metres a second.
        max_wheel_speed_m_s: f64,
        /// Greatest rate of turn, radians a second.
        max_yaw_rate_rad_s: f64,
        /// Greatest change of the rate of turn, radians a second squared. A wheel
        /// must not change its speed faster than the vehicle brakes: where this asks
        /// for more, it is that which limits.
        max_yaw_acceleration_rad_s2: f64,
    },
}

impl Drive {
    /// A 1:10 car: wheelbase 0.26 m, 0.42 rad to either side at 4 rad/s.
    pub const CAR: Self =
        Self::Ackermann { wheelbase_m: 0.26, max_steering_rad: 0.42, max_steering_rate_rad_s: 4.0 };

    /// A small robot on two wheels: track 0.2 m, wheels up to 1 m/s, 3 rad/s.
    pub const ROBOT: Self = Self::Differential {
        track_m: 0.2,
        max_wheel_speed_m_s: 1.0,
        max_yaw_rate_rad_s: 3.0,
        max_yaw_acceleration_rad_s2: 12.0,
    };

    /// The greatest curvature it can drive while it moves, 1/m: `tan(angle) /
    /// wheelbase` of a car; infinite for a differential drive, which turns on the spot.
    #[must_use]
    pub fn max_curvature(&self) -> f64 {
        match *self {
            Self::Ackermann { wheelbase_m, max_steering_rad, .. } => {
                max_steering_rad.tan() / wheelbase_m
            }
            Self::Differential { .. } => f64::INFINITY,
        }
    }

    /// Whether it can turn without moving on.
    #[must_use]
    pub const fn turns_on_the_spot(&self) -> bool {
        matches!(self, Self::Differential { .. })
    }

    /// Rate of turn at a speed: for a car from its steering angle, `v tan(angle) /
    /// wheelbase`; for a differential drive `turn` itself.
    pub(crate) fn yaw_rate(&self, speed: f64, turn: f64) -> f64 {
        match *self {
            Self::Ackermann { wheelbase_m, .. } => speed * turn.tan() / wheelbase_m,
            Self::Differential { .. } => turn,
        }
    }

    /// The greatest `turn` to either side: steering angle or rate of turn.
    pub(crate) fn max_turn(&self) -> f64 {
        match *self {
            Self::Ackermann { max_steering_rad, .. } => max_steering_rad,
            Self::Differential { track_m, max_wheel_speed_m_s, max_yaw_rate_rad_s, .. } => {
                max_yaw_rate_rad_s.min(2.0 * max_wheel_speed_m_s / track_m)
            }
        }
    }

    /// The greatest change of `turn` in a second.
    pub(crate) fn max_turn_rate(&self, max_deceleration: f64) -> f64 {
        match *self {
            Self::Ackermann { max_steering_rate_rad_s, .. } => max_steering_rate_rad_s,
            Self::Differential { track_m, max_yaw_acceleration_rad_s2, .. } => {
                max_yaw_acceleration_rad_s2.min(2.0 * max_deceleration / track_m)
            }
        }
    }

    fn check(&self) -> Result<(), OptionError> {
        match *self {
            Self::Ackermann { wheelbase_m, max_steering_rad, max_steering_rate_rad_s } => {
                positive("vehicle.drive.wheelbase_m", wheelbase_m)?;
                OptionError::check(
                    "vehicle.drive.max_steering_rad",
                    max_steering_rad,
                    max_steering_rad > 0.0 && max_steering_rad <= 1.4,
                    "above 0, at most 1.4",
                )?;
                positive("vehicle.drive.max_steering_rate_rad_s", max_steering_rate_rad_s)
            }
            Self::Differential {
                track_m,
                max_wheel_speed_m_s,
                max_yaw_rate_rad_s,
                max_yaw_acceleration_rad_s2,
            } => {
                positive("vehicle.drive.track_m", track_m)?;
                positive("vehicle.drive.max_wheel_speed_m_s", max_wheel_speed_m_s)?;
                positive("vehicle.drive.max_yaw_rate_rad_s", max_yaw_rate_rad_s)?;
                positive("vehicle.drive.max_yaw_acceleration_rad_s2", max_yaw_acceleration_rad_s2)
            }
        }
    }
}

/// Motors that do not turn below some speed: a speed command is 0 or at least
/// [`DeadBand::min_speed_m_s`], and the two do not alternate from step to step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadBand {
    /// The least speed that the motor runs at, metres a second; 0: it has no dead band.
    pub min_speed_m_s: f64,
    /// A standing vehicle starts when the speed wanted is at least this share of the
    /// least speed.
    pub start_share: f64,
    /// A moving vehicle stops when the speed wanted is below this share of the least
    /// speed; in between it runs at the least speed.
    pub stop_share: f64,
    /// After a stop it stands at least this long, seconds.
    pub stand_s: f64,
}

impl Default for DeadBand {
    fn default() -> Self {
        Self { min_speed_m_s: 0.1, start_share: 1.0, stop_share: 0.4, stand_s: 0.3 }
    }
}

/// What the vehicle can do, and how late it does it. The default is a 1:10 car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VehicleOptions {
    /// How it turns.
    pub drive: Drive,
    /// From the origin of the base frame to the front bumper, metres. Gaps are measured
    /// from there.
    pub front_m: f64,
    /// Greatest speed forward, metres a second.
    pub max_speed_m_s: f64,
    /// Greatest speed backward, metres a second, not negative. 0: it never reverses.
    pub max_reverse_speed_m_s: f64,
    /// Greatest growth of the commanded speed, metres a second squared.
    pub max_acceleration_m_s2: f64,
    /// Greatest fall of the commanded speed, metres a second squared; also what the
    /// vehicle is taken to be able to do.
    pub max_deceleration_m_s2: f64,
    /// The motor's dead band.
    pub dead_band: DeadBand,
    /// From a command to the first effect of it, seconds.
    pub dead_time_s: f64,
    /// Time constant of the speed's first-order lag behind its command, seconds.
    pub speed_lag_s: f64,
    /// Time constant of the steering's (of the rate of turn's) lag, seconds.
    pub steering_lag_s: f64,
    /// Steering angle to command for driving straight, radians; for cars.
    pub steering_trim_rad: f64,
    /// How much of the steering's lag is made up for: the command goes further than the
    /// angle wanted by this times what is still missing, so that the lag becomes
    /// `steering_lag_s / (1 + lag_compensation)`.
    pub lag_compensation: f64,
}

impl Default for VehicleOptions {
    fn default() -> Self {
        Self {
            drive: Drive::CAR,
            front_m: 0.34,
            max_speed_m_s: 2.0,
            max_reverse_speed_m_s: 0.0,
            max_acceleration_m_s2: 2.0,
            max_deceleration_m_s2: 4.0,
            dead_band: DeadBand::default(),
            dead_time_s: 0.1,
            speed_lag_s: 0.1,
            steering_lag_s: 0.1,
            steering_trim_rad: 0.0,
            lag_compensation: 0.5,
        }
    }
}

impl VehicleOptions {
    /// A small differential drive instead of a car.
    #[must_use]
    pub fn robot() -> Self {
        Self { drive: Drive::ROBOT, front_m: 0.22, max_speed_m_s: 0.8, ..Self::default() }
    }

    /// From a command to the time when it takes effect, seconds: the dead time and half of
    /// the slower lag. The share of the lag hardly matters: with none of it a robot at
    /// 1.9 m/s ends 3 to 6 cm nearer to a target that brakes hard, with all of it it is
    /// 1 cm further off the path in a slalom at 1 m/s.
    #[must_use]
    pub fn effect_delay_s(&self) -> f64 {
        self.dead_time_s + 0.5 * self.speed_lag_s.max(self.steering_lag_s)
    }

    pub(crate) fn check(&self) -> Result<(), OptionError> {
        self.drive.check()?;
        not_negative("vehicle.front_m", self.front_m)?;
        positive("vehicle.max_speed_m_s", self.max_speed_m_s)?;
        let reverse = self.max_reverse_speed_m_s;
        not_negative("vehicle.max_reverse_speed_m_s", reverse)?;
        positive("vehicle.max_acceleration_m_s2", self.max_acceleration_m_s2)?;
        positive("vehicle.max_deceleration_m_s2", self.max_deceleration_m_s2)?;
        let band = self.dead_band;
        OptionError::check(
            "vehicle.dead_band.min_speed_m_s",
            band.min_speed_m_s,
            band.min_speed_m_s >= 0.0 && band.min_speed_m_s < self.max_speed_m_s,
            "at least 0 and below the greatest speed",
        )?;
        if let Drive::Differential { max_wheel_speed_m_s, .. } = self.drive {
            OptionError::check(
                "vehicle.drive.max_wheel_speed_m_s",
                max_wheel_speed_m_s,
                max_wheel_speed_m_s > band.min_speed_m_s,
                "above dead_band.min_speed_m_s",
            )?;
        }
        share("vehicle.dead_band.start_share", band.start_share)?;
        OptionError::check(
            "vehicle.dead_band.stop_share",
            band.stop_share,
            band.stop_share >= 0.0 && band.stop_share <= band.start_share,
            "at least 0 and at most start_share",
        )?;
        not_negative("vehicle.dead_band.stand_s", band.stand_s)?;
        for (name, value) in [
            ("vehicle.dead_time_s", self.dead_time_s),
            ("vehicle.speed_lag_s", self.speed_lag_s),
            ("vehicle.steering_lag_s", self.steering_lag_s),
        ] {
            let ok = (0.0..=2.0).contains(&value);
            OptionError::check(name, value, ok, "at least 0, at most 2 s")?;
        }
        OptionError::check(
            "vehicle.steering_trim_rad",
            self.steering_trim_rad,
            match self.drive {
                Drive::Ackermann { max_steering_rad, .. } => {
                    self.steering_trim_rad.abs() <= 0.5 * max_steering_rad
                }
                Drive::Differential { .. } => self.steering_trim_rad == 0.0,
            },
            "at most half the greatest angle to either side, 0 for a differential drive",
        )?;
        let compensation = self.lag_compensation;
        let ok = (0.0..=3.0).contains(&compensation);
        OptionError::check("vehicle.lag_compensation", compensation, ok, "at least 0, at most 3")
    }
}
