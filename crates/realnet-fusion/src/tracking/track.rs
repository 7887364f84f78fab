//! What is known about the target at a time.

use realnet_core::nalgebra::{Matrix2, Matrix6, Vector2, Vector6};
use realnet_core::{Pose2, Stamp, TargetEstimate, TargetState, TrackStatus};

/// Where the target is and how it moves, in the fixed frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Metres.
    pub position: Vector2<f64>,
    /// Metres a second.
    pub velocity: Vector2<f64>,
    /// Metres a second squared.
    pub acceleration: Vector2<f64>,
    /// Covariance of position, velocity and acceleration, x and y of each.
    pub covariance: Matrix6<f64>,
}

impl Motion {
    pub(crate) fn new(mean: &Vector6<f64>, covariance: Matrix6<f64>) -> Self {
        Self {
            position: Vector2::new(mean[0], mean[1]),
            velocity: Vector2::new(mean[2], mean[3]),
            acceleration: Vector2::new(mean[4], mean[5]),
            covariance,
        }
    }

    /// Covariance of the position, square metres.
    #[must_use]
    pub fn position_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0).into_owned()
    }

    /// Covariance of the velocity, square metres per square second.
    #[must_use]
    pub fn velocity_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(2, 2).into_owned()
    }
}

/// The depth of the target from a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackRange {
    /// Metres along the optical axis.
    pub depth_m: f64,
    /// Standard deviation, metres.
    pub std_m: f64,
}

/// What is known about the target at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    /// That time.
    pub stamp: Stamp,
    /// Tracked, coasting, lost.
    pub status: TrackStatus,
    /// Stamp of the newest range in it.
    pub measured: Option<Stamp>,
    /// Where it is; `None` while searching.
    pub motion: Option<Motion>,
    /// Above this share of the distance its standard deviation makes it unknown.
    pub unknown_above: f64,
}

impl Track {
    /// The target seen from the robot as it stands (or will stand) at
    /// [`Track::stamp`]. The estimate is `None` if there is none or its distance is too
    /// uncertain.
    #[must_use]
    pub fn seen_from(&self, fixed_from_base: &Pose2) -> TargetState {
        let estimate = self.motion.map(|motion| {
            let base_from_fixed = fixed_from_base.rotation().transpose();
            let turned = |covariance: Matrix2<f64>| {
                let turned = base_from_fixed * covariance * base_from_fixed.transpose();
                0.5 * (turned + turned.transpose())
            };
            TargetEstimate {
                position: base_from_fixed * (motion.position - fixed_from_base.position()),
                velocity: base_from_fixed * motion.velocity,
                acceleration: base_from_fixed * motion.acceleration,
                position_covariance: turned(motion.position_covariance()),
                velocity_covariance: turned(motion.velocity_covariance()),
            }
        });
        let certain = |estimate: &TargetEstimate| {
            estimate.is_finite()
                && estimate.distance_std() <= self.unknown_above * estimate.distance()
        };
        TargetState {
            stamp: self.stamp,
            measured: self.measured,
            status: self.status,
            estimate: estimate.filter(certain),
        }
    }

    /// The depth of the target from a camera that stands there; `None` if it is
    /// searching, behind the camera or too uncertain.
    #[must_use]
    pub fn range_from(&self, fixed_from_camera: &Pose2) -> Option<TrackRange> {
        let motion = self.motion?;
        let axis = fixed_from_camera.direction();
        let depth_m = axis.dot(&(motion.position - fixed_from_camera.position()));
        let variance = (axis.transpose() * motion.position_covariance() * axis).x;
        let std_m = variance.max(0.0).sqrt();
        (depth_m > 0.0 && std_m <= self.unknown_above * depth_m)
            .then_some(TrackRange { depth_m, std_m })
    }
}

/// Where the target was at a measurement, by what was measured up to then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrailPoint {
    /// Of the measurement.
    pub stamp: Stamp,
    /// Metres, fixed frame.
    pub position: Vector2<f64>,
    /// Covariance of the position, square metres.
    pub covariance: Matrix2<f64>,
}
