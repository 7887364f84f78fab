//! The background's motion from one frame to the next.

use realnet_core::nalgebra::Matrix6;
use realnet_core::{Pose, Stamp};
use realnet_range::motion::Motion;

/// A place seen from a depth map older than this is too rough to reckon another from,
/// seconds: little is left in view of what the map saw.
const OLD_MAP_S: f64 = 2.5;

/// How the background moved in the camera since the last frame.
#[derive(Clone, Copy, Debug)]
pub struct BackgroundStep {
    /// Time between the two frames.
    pub seconds: f64,
    /// Takes a point of the background in the last frame's optical frame to the present
    /// one's.
    pub now_from_before: Pose,
    /// Standard deviation of its rotation, radians.
    pub rotation_std: f64,
    /// Covariance of its left perturbation `[v; w]`, metres and radians: which errors go
    /// together. Errors of the depth map make them larger than it says.
    pub covariance: Matrix6<f64>,
    /// Whether most corners agree with it.
    pub is_sure: bool,
    /// Whether both frames were seen from one depth map. Only then do the errors of its
    /// scale cancel; else the rotation is right, and the translation means nothing.
    pub of_one_map: bool,
}

/// Where the background was in a frame, as seen from a depth map's.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// The map's frame.
    then: Stamp,
    now: Stamp,
    now_from_then: Pose,
    /// It was seen from another map, and reckoned to this one's frame.
    rebased: bool,
}

impl Seen {
    fn of(motion: &Motion) -> Option<Self> {
        let now_from_then = motion.background.as_ref().ok()?.now_from_then();
        Some(Self { then: motion.then, now: motion.now, now_from_then, rebased: false })
    }

    /// Of the map.
    fn age_s(&self) -> f64 {
        self.now.seconds_since(self.then)
    }
}

/// Makes steps of motions that are all from the frame of a depth map.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Steps {
    before: Option<Seen>,
    kept: Option<Seen>,
}

impl Steps {
    /// The step to the frame of `motion`; `None` where the background is unknown in it or
    /// in the one before.
    pub(crate) fn next(&mut self, motion: &Motion) -> Option<BackgroundStep> {
        let now = Seen::of(motion);
        let before = std::mem::replace(&mut self.before, now)?;
        let (now, body) = now.zip(motion.background.as_ref().ok())?;
        let estimate = &body.estimate;
        (before.then == now.then).then(|| BackgroundStep {
            seconds: now.now.seconds_since(before.now),
            now_from_before: now.now_from_then * before.now_from_then.inverse(),
            rotation_std: estimate.rotation_std() * std::f64::consts::SQRT_2,
            covariance: estimate.covariance * 2.0,
            is_sure: 2 * estimate.inliers > body.corners,
            of_one_map: !before.rebased,
        })
    }

    /// The present frame is the one whose depth map is to come.
    pub(crate) fn keep(&mut self, motion: Option<&Motion>) {
        self.kept = motion.and_then(Seen::of);
    }

    /// The map of the kept frame came: the last frame as seen from that one's, so that no
    /// rotation is passed over.
    pub(crate) fn rebase(&mut self) {
        self.before = match (self.before, self.kept.take()) {
            (Some(last), Some(kept)) if last.then == kept.then && kept.age_s() <= OLD_MAP_S => {
                Some(Seen {
                    then: kept.now,
                    now_from_then: last.now_from_then * kept.now_from_then.inverse(),
                    rebased: true,
                    ..last
                })
            }
            _ => None,
        };
    }
}
