//! What the range side tells the controller, and what the controller tells the
//! vehicle.

use crate::Stamp;
use nalgebra::{Matrix2, Vector2};
use std::fmt;

/// What is known about the target as a whole. The limits between these are times
/// in seconds, never numbers of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TrackStatus {
    /// No target has been found yet, or the last one was given up.
    #[default]
    Searching,
    /// Measurements support the estimate.
    Tracking,
    /// The last measurement is a while ago; the estimate is a prediction.
    Coasting,
    /// The prediction is too old to act on. The estimate, if any, says where to
    /// search.
    Lost,
}

impl TrackStatus {
    /// The name in files and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Searching => "searching",
            Self::Tracking => "tracking",
            Self::Coasting => "coasting",
            Self::Lost => "lost",
        }
    }
}

impl fmt::Display for TrackStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Where the target is and how it moves, seen from the robot: in the robot's base
/// frame (x forward, y left, origin at the middle of the rear axle or of the driven
/// wheels) as it stands at the estimate's time. Velocity and acceleration are over
/// ground, along the axes of that frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetEstimate {
    /// Metres.
    pub position: Vector2<f64>,
    /// Metres a second, over ground.
    pub velocity: Vector2<f64>,
    /// Metres a second squared, over ground.
    pub acceleration: Vector2<f64>,
    /// Covariance of the position, square metres.
    pub position_covariance: Matrix2<f64>,
    /// Covariance of the velocity, square metres per square second.
    pub velocity_covariance: Matrix2<f64>,
}

impl TargetEstimate {
    /// Distance from the origin of the base frame, metres.
    #[must_use]
    pub fn distance(&self) -> f64 {
        self.position.norm()
    }

    /// Standard deviation of [`TargetEstimate::distance`], metres: that of the
    /// position along the line of sight.
    #[must_use]
    pub fn distance_std(&self) -> f64 {
        let sight = self.position.try_normalize(1e-9).unwrap_or_else(Vector2::x);
        (sight.transpose() * self.position_covariance * sight).x.max(0.0).sqrt()
    }

    /// Direction to the target, radians, positive to the left.
    #[must_use]
    pub fn bearing(&self) -> f64 {
        self.position.y.atan2(self.position.x)
    }

    /// Whether all numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let vectors = [self.position, self.velocity, self.acceleration];
        let matrices = [self.position_covariance, self.velocity_covariance];
        vectors.iter().flat_map(Vector2::iter).all(|v| v.is_finite())
            && matrices.iter().flat_map(Matrix2::iter).all(|v| v.is_finite())
    }
}

/// The target at a moment, or that nothing is known about it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TargetState {
    /// The moment that this is true for; estimates are predicted to it.
    pub stamp: Stamp,
    /// Exposure time of the newest measurement of the target's range in it.
    pub measured: Option<Stamp>,
    /// Tracked, coasting, lost.
    pub status: TrackStatus,
    /// Where the target is; `None` is an explicit unknown.
    pub estimate: Option<TargetEstimate>,
}

/// Why a robot is stopped, or told to stop. The most urgent one is named.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum StopReason {
    /// A person or a program asked for it; it holds until it is released.
    Requested,
    /// A number that went in, or came out, was not finite.
    NotFinite,
    /// Nothing came in for longer than the set time.
    StaleInput,
    /// Nothing ever came in.
    MissingInput,
    /// The target is nearer than the stopping radius.
    TooClose,
    /// The target was lost for longer than the set coasting time.
    TargetLost,
    /// No target has been found yet.
    NoTarget,
    /// The range is too uncertain to drive by.
    TooUncertain,
}

impl StopReason {
    /// All of them, the most urgent first.
    pub const ALL: [Self; 8] = [
        Self::Requested,
        Self::NotFinite,
        Self::StaleInput,
        Self::MissingInput,
        Self::TooClose,
        Self::TargetLost,
        Self::NoTarget,
        Self::TooUncertain,
    ];

    /// The name in files and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Requested => "requested",
            Self::NotFinite => "not-finite",
            Self::StaleInput => "stale-input",
            Self::MissingInput => "missing-input",
            Self::TooClose => "too-close",
            Self::TargetLost => "target-lost",
            Self::NoTarget => "no-target",
            Self::TooUncertain => "too-uncertain",
        }
    }
}

impl fmt::Display for StopReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What a vehicle is told to do from a moment on. A car reads speed and steering
/// angle, a differential drive speed and yaw rate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DriveCommand {
    /// When it was given.
    pub stamp: Stamp,
    /// Speed of the middle of the rear axle (of the driven wheels), metres a second,
    /// positive forward.
    pub speed: f64,
    /// Angle of the virtual front wheel, radians, positive to the left; 0 for a
    /// differential drive.
    pub steering_angle: f64,
    /// Rate of turn that belongs to it, radians a second, positive to the left.
    pub yaw_rate: f64,
    /// Why it stops, if it does; the speed is then on its way to 0, or 0.
    pub stop: Option<StopReason>,
}

impl DriveCommand {
    /// Standstill, wheels straight.
    #[must_use]
    pub const fn stopped(stamp: Stamp, reason: StopReason) -> Self {
        Self { stamp, speed: 0.0, steering_angle: 0.0, yaw_rate: 0.0, stop: Some(reason) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_deviation_of_the_distance_is_the_one_along_the_line_of_sight() {
        let estimate = TargetEstimate {
            position: Vector2::new(3.0, 4.0),
            velocity: Vector2::zeros(),
            acceleration: Vector2::zeros(),
            // 0.5 m along (3, 4) / 5 and 0.1 m across
            position_covariance: {
                let turn = Matrix2::new(0.6, -0.8, 0.8, 0.6);
                turn * Matrix2::new(0.25, 0.0, 0.0, 0.01) * turn.transpose()
            },
            velocity_covariance: Matrix2::zeros(),
        };
        assert!((estimate.distance() - 5.0).abs() < 1e-12);
        assert!((estimate.distance_std() - 0.5).abs() < 1e-12);
        assert!(estimate.is_finite());
        let broken = TargetEstimate { velocity: Vector2::new(0.0, f64::NAN), ..estimate };
        assert!(!broken.is_finite());
    }

    #[test]
    fn names_are_unique_and_reasons_are_in_order() {
        let mut names: Vec<_> = StopReason::ALL.iter().map(|reason| reason.name()).collect();
        assert!(StopReason::ALL.is_sorted());
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), StopReason::ALL.len());
    }
}
