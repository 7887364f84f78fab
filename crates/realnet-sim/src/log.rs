//! What is written down during a run.

use crate::VehicleSize;
use realnet_core::nalgebra::Vector2;
use realnet_core::{Pose2, StopReason, TrackStatus};

/// A run, frame by frame: what its figures, its report and comparisons with other
/// systems are made from. Times are seconds since the start of the run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunLog {
    /// Name of the scenario.
    pub scenario: String,
    /// What happens in it, in a sentence.
    pub description: String,
    /// The seed of the run.
    pub seed: u64,
    /// The gap that the follower is asked to keep, metres.
    pub desired_gap_m: f64,
    /// One entry for each camera frame.
    pub frames: Vec<FrameLog>,
    /// Depth maps of the network that arrived, in the order of arrival.
    pub depth_maps: Vec<DepthMapLog>,
    /// Detections that arrived, in the order of arrival.
    pub detections: Vec<DetectionLog>,
    /// When the follower stopped, and when it went on.
    pub stops: Vec<StopLog>,
    /// Footprint of the follower.
    pub follower_size: Option<VehicleSize>,
    /// Footprint of the target; `None` also when there is no target.
    pub target_size: Option<VehicleSize>,
    /// What else stands or drives about: obstacles, other vehicles.
    pub bodies: Vec<BodyLog>,
    /// Corners of the walls around all, in order, in the world; empty in the open.
    pub walls: Vec<Vector2<f64>>,
}

/// One camera frame of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameLog {
    /// Exposure time.
    pub time_s: f64,
    /// Range: the depth that a perfect network would give of a perfect box, metres, that
    /// is, the rule of the depth in a box on the true depths of the target's own pixels;
    /// `None` when not visible.
    pub range_true_m: Option<f64>,
    /// Range of the newest depth map that has arrived, held.
    pub range_network_m: Option<f64>,
    /// From the exposure of that map's frame to this one's, seconds.
    pub network_age_s: Option<f64>,
    /// Range by the fast path alone: the newest map that arrived, moved by flow.
    pub range_fast_m: Option<f64>,
    /// Range by the target's foot on the ground.
    pub range_ground_m: Option<f64>,
    /// Pitch of the camera against the ground as the follower reckons it, radians,
    /// positive: nose down.
    pub pitch_rad: f64,
    /// Fused range at this frame's stamp.
    pub range_fused_m: Option<f64>,
    /// Its standard deviation.
    pub range_fused_std_m: Option<f64>,
    /// State of the track.
    pub status: TrackStatus,
    /// Free space between the follower's front and the target, along the line
    /// between them, metres: what the follower is asked to keep. Not finite when
    /// there is no target.
    pub gap_m: f64,
    /// Least distance between the follower's footprint and any other body, metres;
    /// 0 or less: they touch. Infinite when there is none.
    pub clearance_m: f64,
    /// Distance of the follower's rear axle from the target's path, metres,
    /// positive: the follower is left of it. Not finite when there is no target.
    pub lateral_m: f64,
    /// Speed that is commanded, m/s.
    pub speed_command: f64,
    /// The highest speed that was allowed, m/s: the least of all its bounds.
    pub speed_limit: Option<f64>,
    /// Name of the bound that is that least one, when it held the speed down.
    pub limited_by: Option<&'static str>,
    /// Steering angle that is commanded, radians.
    pub steering_command: f64,
    /// Speed of the follower, m/s.
    pub speed: f64,
    /// Steering angle of the follower's wheels, radians.
    pub steering: f64,
    /// Speed of the target, m/s.
    pub target_speed: f64,
    /// Where the follower is.
    pub follower: Pose2,
    /// Where the target is.
    pub target: Pose2,
    /// Why the follower stands or brakes, if it does.
    pub stop: Option<StopReason>,
}

/// A depth map of the network.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthMapLog {
    /// Exposure time of its frame.
    pub time_s: f64,
    /// When it arrived.
    pub arrived_s: f64,
    /// Depth in the target's box, metres.
    pub range_m: Option<f64>,
}

/// An answer of the detector about one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DetectionLog {
    /// Exposure time of its frame.
    pub time_s: f64,
    /// When it arrived.
    pub arrived_s: f64,
    /// Whether it found the target.
    pub found: bool,
}

/// Something that stands or drives about besides the follower and its target.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BodyLog {
    /// What it is, in a word or two.
    pub name: String,
    /// Corners of its footprint, convex, in its own frame, metres.
    pub outline: Vec<Vector2<f64>>,
    /// Where it is, one pose for each frame of the run; a single one for what
    /// does not move.
    pub poses: Vec<Pose2>,
}

/// A stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopLog {
    /// When the reason first held.
    pub from_s: f64,
    /// When the follower was free to drive again; `None`: until the end.
    pub until_s: Option<f64>,
    /// Why.
    pub reason: StopReason,
}
