//! The stages of RealNet wired together: frames in, commands out.

mod follower;
mod odometry;
mod ranging;
mod sight;

pub use follower::{Follower, FollowerError, FollowerOptions, FrameReport};
pub use odometry::{CameraMount, OwnOdometry};
pub use ranging::{Ranging, RangingError, RangingOptions, SeenRange};
pub use sight::{Sight, SightOptions, TargetBox};
