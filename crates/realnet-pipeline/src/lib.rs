//! The stages of RealNet wired together: frames in, commands out.

mod odometry;
mod ranging;
mod sight;

pub use odometry::{CameraMount, OwnOdometry, OwnStep};
pub use ranging::{MapRange, Ranging, RangingError, RangingOptions, SeenRange};
pub use sight::{Sight, SightOptions, TargetBox};
