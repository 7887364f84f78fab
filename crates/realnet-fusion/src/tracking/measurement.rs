//! What is measured of the target.

use crate::late::BadMeasurement;
use realnet_core::{Pose2, Stamp};

/// Where a range comes from; each kind has an error of its own that does not average
/// away from frame to frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum RangeSource {
    /// From the network's depth map of the frame `map`: measured in that map, or moved
    /// from it to a later frame by flow. All ranges of one map share its scale error.
    Network {
        /// Stamp of the frame that the map was computed from.
        map: Stamp,
    },
    /// From the line where the target stands on the ground. Shares the error of the
    /// camera's pitch, whose effect on the logarithm of the range grows with the range.
    Ground,
    /// From the known size of the target. Shares the error of that size.
    Size,
}

/// Where a direction comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DirectionSource {
    /// The detector's box.
    Detection,
    /// The box carried from an earlier frame by flow.
    Flow,
}

/// A number that was measured of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// The target's depth: its distance along the camera's optical axis.
    Range {
        /// Metres.
        depth_m: f64,
        /// Standard deviation of the measurement's own noise, as a share of the depth:
        /// without the error that it shares with other ranges of its source (see
        /// [`TargetOptions`](crate::TargetOptions)).
        relative_std: f64,
        /// Where it comes from.
        source: RangeSource,
    },
    /// The target's direction in the plane.
    Direction {
        /// Lateral over forward distance, positive to the **left** of the optical axis:
        /// `(cx - u) / fx` of an undistorted pixel.
        tangent: f64,
        /// Standard deviation of the tangent.
        std: f64,
        /// Where it comes from.
        source: DirectionSource,
    },
}

/// A reading, when, and from where.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetMeasurement {
    /// Exposure time of the frame.
    pub stamp: Stamp,
    /// Where the camera was then: x along the horizontal part of its optical axis, y to
    /// the left; `fixed` is any frame that stands still over the horizon, usually that
    /// of the robot's odometry.
    pub fixed_from_camera: Pose2,
    /// What was measured.
    pub reading: Reading,
}

/// Who measured: measurements of one stamp are used in this order, and a second one
/// of the same stamp and source is a duplicate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Source {
    /// A direction.
    Direction(DirectionSource),
    /// A range.
    Range(RangeSource),
}

impl TargetMeasurement {
    /// Who measured.
    #[must_use]
    pub const fn source(&self) -> Source {
        match self.reading {
            Reading::Range { source, .. } => Source::Range(source),
            Reading::Direction { source, .. } => Source::Direction(source),
        }
    }

    /// Refuses what no camera measures.
    pub(crate) fn check(&self) -> Result<(), BadMeasurement> {
        let within = BadMeasurement::unless_within;
        let pose = &self.fixed_from_camera;
        within("camera x in metres", pose.x, -1e7, 1e7)?;
        within("camera y in metres", pose.y, -1e7, 1e7)?;
        within("camera heading in radians", pose.heading, -1e6, 1e6)?;
        match self.reading {
            Reading::Range { depth_m, relative_std, .. } => {
                within("depth in metres", depth_m, 0.01, 1e4)?;
                within("relative std of the depth", relative_std, 1e-4, 10.0)
            }
            Reading::Direction { tangent, std, .. } => {
                within("tangent of the direction", tangent, -100.0, 100.0)?;
                within("std of the direction", std, 1e-5, 10.0)
            }
        }
    }
}

/// What became of a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// It waits for a first range or a first direction to begin a track with.
    Waits,
    /// A track began with it.
    Began,
    /// It is in the estimate. The residual was so many standard deviations long.
    Used {
        /// Residual over its deviation.
        deviations: f64,
    },
    /// The residual was too long; it is not in the estimate.
    Gated {
        /// Residual over its deviation.
        deviations: f64,
    },
    /// The source disagreed for too long while another one agreed: its shared error was
    /// opened again, and it is in the estimate.
    Reopened,
    /// The estimate lies beside or behind the camera; no residual can be formed.
    OutOfView,
    /// The map is older than all that are followed.
    OldMap,
}
