//! The robot's own place, frame by frame.

use crate::ring::{KEPT, Ring, Stamped};
use crate::step::BackgroundStep;
use realnet_core::nalgebra::{UnitQuaternion, Vector3, Vector6};
use realnet_core::{Pose, Pose2, Stamp};

/// Faster turns are no robot's, rad/s: one wild motion would turn the fixed frame for good.
const MAX_YAW_RATE: f64 = 8.0;

/// Where a camera sits on a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraMount {
    /// Metres ahead of the base frame's origin.
    pub forward_m: f64,
    /// Metres to its left.
    pub left_m: f64,
    /// Metres above the ground.
    pub height_m: f64,
    /// Pitch, radians, positive: nose down.
    pub pitch_rad: f64,
}

impl Default for CameraMount {
    /// 0.25 m ahead of the rear axle, 0.18 m above the ground, level.
    fn default() -> Self {
        Self { forward_m: 0.25, left_m: 0.0, height_m: 0.18, pitch_rad: 0.0 }
    }
}

impl CameraMount {
    /// The camera's optical frame on the base frame.
    #[must_use]
    pub fn base_from_optical(&self) -> Pose {
        let place = Vector3::new(self.forward_m, self.left_m, self.height_m);
        // Nose down is a positive turn about y, which points left.
        let nod = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), self.pitch_rad);
        Pose::new(nod, place) * realnet_core::body_from_optical()
    }

    /// The camera's place in the ground plane.
    #[must_use]
    pub const fn base_from_camera(&self) -> Pose2 {
        Pose2::new(self.forward_m, self.left_m, 0.0)
    }
}

/// How fast the rear axle slides sideways at most times, m/s.
const SLIP_M_S: f64 = 0.05;
/// By how much the errors of a depth map widen the covariance of a motion from it.
const DEPTH_INFLATION: f64 = 25.0;

impl Stamped for (Stamp, Pose2) {
    fn stamp(&self) -> Stamp {
        self.0
    }
}

/// The robot's own place in a plane that stands still, from the motion of the
/// background, or from its commands while that is unknown. It drifts, slowly: what
/// it is for is the seconds between two measurements of the target.
#[derive(Clone, Debug)]
pub struct OwnOdometry {
    mount: CameraMount,
    base_from_optical: Pose,
    max_speed: f64,
    poses: Ring<(Stamp, Pose2), KEPT>,
    last: Option<(Stamp, Pose2)>,
}

impl OwnOdometry {
    /// At the origin, looking along x. Steps of more than `max_speed` (m/s) are not
    /// believed.
    #[must_use]
    pub fn new(mount: &CameraMount, max_speed: f64) -> Self {
        Self {
            mount: *mount,
            base_from_optical: mount.base_from_optical(),
            max_speed,
            poses: Ring::new(),
            last: None,
        }
    }

    /// The robot's mean speed (m/s, along the base frame's x axis) and rate of turn (rad/s,
    /// positive to the left) since the last frame, as the background shows them; `None` if
    /// it does not, or shows what no robot does. The speed has the depth map's scale error
    /// in it.
    #[must_use]
    pub fn seen(&self, step: &BackgroundStep) -> Option<(f64, f64)> {
        if !(step.of_one_map && step.seconds > 0.0) {
            return None;
        }
        let before_from_now = step.now_from_before.inverse();
        let moved = self.base_from_optical * before_from_now * self.base_from_optical.inverse();
        let twist = self.without_sliding(moved.log(), step) / step.seconds;
        let (speed, yaw_rate) = (twist[0], twist[5]);
        let believed = speed.abs() <= self.max_speed && yaw_rate.abs() <= MAX_YAW_RATE;
        believed.then_some((speed, yaw_rate))
    }

    /// Wheels roll where they point: the axle does not move sideways. In a picture whose
    /// corners all lie about as far away, a turn looks like a step aside; with this it does
    /// not, because the estimate's covariance knows which turn goes with which step.
    fn without_sliding(&self, twist: Vector6<f64>, step: &BackgroundStep) -> Vector6<f64> {
        // The perturbation of the optical frame, in the base frame.
        let adjoint = self.base_from_optical.adjoint();
        let covariance = adjoint * step.covariance * adjoint.transpose() * DEPTH_INFLATION;
        let together = covariance.column(1);
        let slip = SLIP_M_S * step.seconds;
        let gain = together / (together[1] + slip * slip);
        if gain.iter().all(|g| g.is_finite()) { twist - gain * twist[1] } else { twist }
    }

    /// Goes on to the next frame at a mean speed and rate of turn.
    pub fn step(&mut self, stamp: Stamp, (speed, yaw_rate): (f64, f64)) {
        let pose = match self.last {
            Some((last, pose)) => pose.driven(speed, yaw_rate, stamp.seconds_since(last).max(0.0)),
            None => Pose2::IDENTITY,
        };
        self.last = Some((stamp, pose));
        self.poses.push((stamp, pose));
    }

    /// Forgets all frames: the next one is at the origin.
    pub fn restart(&mut self) {
        self.poses.clear();
        self.last = None;
    }

    /// Where the robot was at a frame.
    #[must_use]
    pub fn pose_at(&self, stamp: Stamp) -> Option<Pose2> {
        self.poses.get(stamp).map(|(_, pose)| *pose)
    }

    /// Where its camera was at a frame.
    #[must_use]
    pub fn camera_at(&self, stamp: Stamp) -> Option<Pose2> {
        Some(self.pose_at(stamp)? * self.mount.base_from_camera())
    }

    /// Where it was at the last frame.
    #[must_use]
    pub fn last(&self) -> Option<(Stamp, Pose2)> {
        self.last
    }
}

#[cfg(test)]
mod tests;
