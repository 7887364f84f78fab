//! What the tracker is told and what it answers.

use realnet_core::nalgebra::{Matrix6, Vector3, Vector6};
use realnet_core::{Pose, Stamp};
use realnet_pose::{Estimate, PnpError, RansacOptions, WarpError};
use realnet_vision::{CornerOptions, FlowError, FlowOptions, Window};
use thiserror::Error;

/// How [`MotionTracker`](super::MotionTracker) works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionOptions {
    /// Corners of the background. Default: 150, spread over 4 x 3 cells, at least
    /// 8 pixels apart.
    pub background: CornerOptions,
    /// Corners of the target, looked for in its box alone. Default: 50, at least 5
    /// pixels apart.
    pub target: CornerOptions,
    /// How the background's corners are looked for in the present frame.
    pub flow: FlowOptions,
    /// How the target's are. Default: with a window of 11 x 11 pixels, as what it
    /// holds of the background pulls at small targets. The window must not be
    /// larger than that of `flow`.
    pub target_flow: FlowOptions,
    /// How motions are found, and which are accepted. A third of its threshold is
    /// tried first, and taken when four of five points meet it. Default: inliers within 3
    /// pixels.
    pub ransac: RansacOptions,
    /// A corner is lifted when the depths of the 3 x 3 pixels around it are within
    /// this share of each other; at edges of bodies they are not. Default 0.1.
    pub max_depth_step: f32,
    /// Standard deviation of the depth map's scale, as a share: it is common to
    /// the whole map and so to all lengths derived from it. Default 0.
    pub scale_std: f64,
    /// Standard deviation of the speed at which a target turns over the ground,
    /// rad/s: how far the rotation of the ground is wrong for a target whose corners
    /// do not give a rotation of its own. Default 0.5.
    pub target_turn_std: f64,
    /// Seed of the samples drawn.
    pub seed: u64,
}

impl Default for MotionOptions {
    fn default() -> Self {
        let background = CornerOptions {
            max_corners: 150,
            quality_level: 0.005,
            min_distance: 8.0,
            cells: (4, 3),
        };
        let target = CornerOptions {
            max_corners: 50,
            quality_level: 0.01,
            min_distance: 5.0,
            cells: (1, 1),
        };
        Self {
            background,
            target,
            flow: FlowOptions::default(),
            target_flow: FlowOptions { window: Window::SMALL, ..FlowOptions::default() },
            ransac: RansacOptions { threshold_px: 3.0, ..RansacOptions::default() },
            max_depth_step: 0.1,
            scale_std: 0.0,
            target_turn_std: 0.5,
            seed: 0,
        }
    }
}

/// Why a tracker has no answer.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MotionError {
    /// A number among the options that it cannot work with.
    #[error("{name} is {value}, it must be {rule}")]
    Option {
        /// Name of the option.
        name: &'static str,
        /// What was given.
        value: f64,
        /// What is accepted, in words.
        rule: &'static str,
    },
    /// Options of corners or flow.
    #[error(transparent)]
    Flow(#[from] FlowError),
    /// Options of the pose solver.
    #[error(transparent)]
    Pnp(#[from] PnpError),
    /// A frame of another size than the camera.
    #[error("a frame of {}x{} pixels for a camera of {}x{}", found.0, found.1, camera.0, camera.1)]
    Size {
        /// Width and height of the frame.
        found: (u32, u32),
        /// Width and height of the camera.
        camera: (u32, u32),
    },
    /// A frame that is not later than the one before. Where time starts again, as
    /// when a recording is played once more, so does a new tracker.
    #[error("a frame of {} s after one of {} s: frames come in order", .found.secs_f64(), .last.secs_f64())]
    Order {
        /// Stamp of the frame.
        found: Stamp,
        /// Stamp of the one before.
        last: Stamp,
    },
    /// A depth map of a frame that was not kept.
    #[error("a depth map of {} s, but no frame of that time was kept", .0.secs_f64())]
    NotKept(Stamp),
    /// A depth map whose camera cannot be made.
    #[error("a depth map of {width}x{height} pixels does not fit the camera: {source}")]
    DepthSize {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Why not.
        source: realnet_core::CameraError,
    },
    /// What was asked for is not known.
    #[error(transparent)]
    Unknown(#[from] MotionFailure),
    /// An output map of the wrong size.
    #[error(transparent)]
    Warp(#[from] WarpError),
}

/// Why the motion of a body, or what depends on it, is unknown.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MotionFailure {
    /// No depth map yet.
    #[error("there is no depth map yet")]
    NoDepth,
    /// The depth map came without a target.
    #[error("there is no target on the last depth map")]
    NoTarget,
    /// No frame after the depth map's was estimated yet.
    #[error("no motion was estimated since the last depth map")]
    NotEstimated,
    /// Too little texture with depth where the body was.
    #[error("only {found} corners with depth on the {body}, at least {needed} are needed")]
    Corners {
        /// `background` or `target`.
        body: &'static str,
        /// Corners with depth.
        found: usize,
        /// The least.
        needed: usize,
    },
    /// The corners were not found again.
    #[error(
        "only {tracked} of {corners} corners of the {body} were found again \
         ({outside} left the picture, {flat} are blurred away, {lost} are mistaken)"
    )]
    Lost {
        /// `background` or `target`.
        body: &'static str,
        /// Corners found.
        tracked: usize,
        /// Corners looked for.
        corners: usize,
        /// Those that are outside of the picture.
        outside: usize,
        /// Those without texture in the present frame.
        flat: usize,
        /// Those that come back to another place.
        lost: usize,
    },
    /// The corners found do not give a motion.
    #[error("the {tracked} corners found of the {body} give no motion: {reason}")]
    Pose {
        /// `background` or `target`.
        body: &'static str,
        /// Corners found.
        tracked: usize,
        /// The solver's refusal.
        reason: PnpError,
    },
}

/// What [`MotionTracker::set_depth`](super::MotionTracker::set_depth) found on the
/// frame of the depth map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeySummary {
    /// Corners of the background with depth.
    pub background: usize,
    /// Corners of the target with depth.
    pub target: usize,
    /// Corners left out: without depth, at an edge of a body, or of unclear side.
    pub dropped: usize,
}

/// Where the flow that gave a motion started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Start {
    /// From where the motion so far, carried on, predicts the corners.
    Predicted,
    /// From where they were at the last motion.
    Last,
    /// From where a search of a small picture found their surroundings.
    Search,
}

/// How a body moved since the depth map.
///
/// A target too small, too flat or with too few corners for a rotation of its own
/// gets a translation under the rotation of the ground; its
/// [`Estimate::origin`] is then [`Origin::Translation`](realnet_pose::Origin), and
/// its covariance holds [`MotionOptions::target_turn_std`].
#[derive(Clone, Debug, PartialEq)]
pub struct BodyMotion {
    /// The motion: [`Estimate::camera_from_world`] is `now_from_then`, which takes
    /// a point of the body in then's optical frame to where it is in now's.
    pub estimate: Estimate,
    /// Corners looked for.
    pub corners: usize,
    /// Corners found, of which `estimate.inliers` agree with the motion.
    pub tracked: usize,
    /// Where the flow started.
    pub start: Start,
}

impl BodyMotion {
    /// Takes points of the body from then to now, both in the camera's optical
    /// frame of that time.
    #[must_use]
    pub fn now_from_then(&self) -> Pose {
        self.estimate.camera_from_world
    }
}

/// The motions from the frame of the depth map (*then*) to the present frame
/// (*now*).
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Exposure of the depth map's frame.
    pub then: Stamp,
    /// Exposure of the present frame.
    pub now: Stamp,
    /// How the background moved as the camera sees it.
    pub background: Result<BodyMotion, MotionFailure>,
    /// How the target moved as the camera sees it; `None` when the depth map came
    /// without a target.
    pub target: Option<Result<BodyMotion, MotionFailure>>,
    /// [`MotionOptions::scale_std`].
    pub(super) scale_std: f64,
}

impl Motion {
    /// Seconds from then to now.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.now.seconds_since(self.then)
    }

    /// The camera's own motion: the place of now's optical frame in then's.
    #[must_use]
    pub fn then_from_now(&self) -> Option<Pose> {
        Some(self.background.as_ref().ok()?.now_from_then().inverse())
    }

    /// The target's own motion over the ground: takes a point of the target at
    /// then to where it is now, both in *then's* optical frame, which stands still
    /// as the background does.
    #[must_use]
    pub fn target_motion(&self) -> Option<Pose> {
        let target = self.target.as_ref()?.as_ref().ok()?;
        Some(self.then_from_now()? * target.now_from_then())
    }

    /// The camera's mean velocity from then to now, in the axes of its optical
    /// frame. `None` without motion or without time.
    #[must_use]
    pub fn camera_velocity(&self) -> Option<Velocity> {
        self.own_velocity(&Pose::identity())
    }

    /// The mean velocity, from then to now, of a body that carries the camera:
    /// the robot's own. In the axes of the body (REP-103: x forward, y left, z up),
    /// at its origin. `body_from_optical` says where the camera sits on it, see
    /// [`realnet_core::body_from_optical`].
    #[must_use]
    pub fn own_velocity(&self, body_from_optical: &Pose) -> Option<Velocity> {
        let background = self.background.as_ref().ok()?;
        // A perturbation exp(xi) of now_from_then is one of exp(-Ad xi) of
        // now's body in then's, from the right.
        let then_from_now = background.now_from_then().inverse();
        let motion = *body_from_optical * then_from_now * body_from_optical.inverse();
        let carry = body_from_optical.adjoint();
        let covariance = carry * background.estimate.covariance * carry.transpose();
        // The map's scale is in what the camera moved, not in the lever to the body's origin.
        let moved = then_from_now.log().fixed_rows::<3>(0).into_owned();
        let scaled = body_from_optical.rotation() * moved;
        self.velocity(motion.log(), &scaled, covariance)
    }

    /// The target's mean velocity over the ground from then to now, in the axes of
    /// then's optical frame, at the target's middle.
    #[must_use]
    pub fn target_velocity(&self) -> Option<Velocity> {
        let background = self.background.as_ref().ok()?;
        let target = self.target.as_ref()?.as_ref().ok()?;
        let then_from_now = background.now_from_then().inverse();
        let middle = target.estimate.center.coords;
        // Both motions err in now's frame. Taken at the target's middle, where its
        // translation is known best.
        let to_middle = Pose::from_translation(-middle).adjoint();
        let of = |body: &BodyMotion| to_middle * body.estimate.covariance * to_middle.transpose();
        let turn = Pose::from_rotation(then_from_now.rotation()).adjoint();
        let covariance = turn * (of(background) + of(target)) * turn.transpose();
        let motion = then_from_now * target.now_from_then();
        let then = target.now_from_then().inverse() * realnet_core::nalgebra::Point3::from(middle);
        // What the middle moved by, whose error does not depend on the rotation's: the
        // linear part of the logarithm holds half of rotation x displacement.
        let mut twist = Pose::from_rotation(motion.rotation()).log();
        let moved = motion * then - then;
        twist.fixed_rows_mut::<3>(0).copy_from(&moved);
        self.velocity(twist, &moved, covariance)
    }

    /// Of a motion over all the seconds; `scaled` is the part of its translation that
    /// the depth map's scale is in.
    fn velocity(
        &self,
        twist: Vector6<f64>,
        scaled: &Vector3<f64>,
        covariance: Matrix6<f64>,
    ) -> Option<Velocity> {
        let seconds = self.seconds();
        if seconds <= 0.0 {
            return None;
        }
        let mut covariance = covariance;
        let mut block = covariance.fixed_view_mut::<3, 3>(0, 0);
        block += scaled * scaled.transpose() * (self.scale_std * self.scale_std);
        Some(Velocity { twist: twist / seconds, covariance: covariance / (seconds * seconds) })
    }
}

/// A velocity with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Velocity {
    /// Linear velocity in m/s, then angular in rad/s.
    pub twist: Vector6<f64>,
    /// Covariance of `twist`, for small angles turned between the two frames: the
    /// Jacobian of the logarithm is taken as 1.
    pub covariance: Matrix6<f64>,
}

impl Velocity {
    /// Linear velocity, m/s.
    #[must_use]
    pub fn linear(&self) -> Vector3<f64> {
        self.twist.fixed_rows::<3>(0).into_owned()
    }

    /// Angular velocity, rad/s.
    #[must_use]
    pub fn angular(&self) -> Vector3<f64> {
        self.twist.fixed_rows::<3>(3).into_owned()
    }

    /// Standard deviations of `twist`, entry by entry.
    #[must_use]
    pub fn std(&self) -> Vector6<f64> {
        self.covariance.diagonal().map(|variance| variance.max(0.0).sqrt())
    }
}
