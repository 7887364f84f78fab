//! The robot's own place, frame by frame.

use realnet_core::nalgebra::{UnitQuaternion, Vector3};
use realnet_core::{Pose, Pose2, Stamp};
use realnet_range::motion::Motion;

/// Poses that are remembered, for measurements that come late.
const POSES: usize = 128;

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

/// A step from one frame to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OwnStep {
    /// Mean speed along the base frame's x axis, m/s.
    pub speed: f64,
    /// Mean rate of turn, rad/s, positive to the left.
    pub yaw_rate: f64,
    /// Whether it was seen in the picture, or else is what the commands promise.
    pub seen: bool,
}

/// The robot's own place in a plane that stands still, from the motion of the
/// background, or from its commands while that is unknown. It drifts, slowly: what
/// it is for is the seconds between two measurements of the target.
#[derive(Clone, Debug)]
pub struct OwnOdometry {
    base_from_optical: Pose,
    max_speed: f64,
    poses: Vec<(Stamp, Pose2)>,
    oldest: usize,
    last: Option<(Stamp, Pose2)>,
    /// The depth map's frame that the last motion was from, and the camera's place
    /// in it at the last frame.
    then: Option<(Stamp, Pose)>,
}

impl OwnOdometry {
    /// At the origin, looking along x. Steps of more than `max_speed` (m/s) are not
    /// believed.
    #[must_use]
    pub fn new(mount: &CameraMount, max_speed: f64) -> Self {
        Self {
            base_from_optical: mount.base_from_optical(),
            max_speed,
            poses: Vec::with_capacity(POSES),
            oldest: 0,
            last: None,
            then: None,
        }
    }

    /// Takes the next frame's motion, whose lengths are to be multiplied by `scale`;
    /// `promised` is the speed and rate of turn that
    /// the commands promise for the time since the last frame.
    pub fn step(
        &mut self,
        stamp: Stamp,
        motion: &Motion,
        scale: f64,
        promised: (f64, f64),
    ) -> OwnStep {
        let then_from_now = motion.then_from_now();
        let Some((last_stamp, last)) = self.last else {
            self.remember(stamp, Pose2::IDENTITY);
            self.then = then_from_now.map(|now| (motion.then, now));
            return OwnStep { speed: promised.0, yaw_rate: promised.1, seen: false };
        };
        let seconds = stamp.seconds_since(last_stamp);
        // Both frames must have been seen from the same depth map: only then do its
        // errors cancel.
        let seen = match (then_from_now, self.then) {
            (Some(now), Some((then, before))) if then == motion.then && seconds > 0.0 => {
                self.seen_step(&(before.inverse() * now), scale, seconds)
            }
            _ => None,
        };
        self.then = then_from_now.map(|now| (motion.then, now));
        let (speed, yaw_rate) = promised;
        let step = seen.unwrap_or(OwnStep { speed, yaw_rate, seen: false });
        let pose = last.driven(step.speed, step.yaw_rate, seconds.max(0.0));
        self.remember(stamp, pose);
        step
    }

    fn seen_step(&self, before_from_now: &Pose, scale: f64, seconds: f64) -> Option<OwnStep> {
        let step = Pose::new(before_from_now.rotation(), before_from_now.translation() * scale);
        let moved = self.base_from_optical * step * self.base_from_optical.inverse();
        let twist = moved.log() / seconds;
        let (speed, yaw_rate) = (twist[0], twist[5]);
        let believed = speed.abs() <= self.max_speed && yaw_rate.is_finite();
        believed.then_some(OwnStep { speed, yaw_rate, seen: true })
    }

    fn remember(&mut self, stamp: Stamp, pose: Pose2) {
        self.last = Some((stamp, pose));
        if self.poses.len() < POSES {
            self.poses.push((stamp, pose));
        } else if let Some(slot) = self.poses.get_mut(self.oldest) {
            *slot = (stamp, pose);
            self.oldest = (self.oldest + 1) % POSES;
        }
    }

    /// Where the robot was at a frame.
    #[must_use]
    pub fn pose_at(&self, stamp: Stamp) -> Option<Pose2> {
        self.poses.iter().find(|(at, _)| *at == stamp).map(|(_, pose)| *pose)
    }

    /// Where it was at the last frame.
    #[must_use]
    pub fn last(&self) -> Option<(Stamp, Pose2)> {
        self.last
    }
}
