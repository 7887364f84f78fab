//! The stages of RealNet wired together: frames in, commands out.
//!
//! [`Follower`] is the whole: it takes frames at once, detections and depth maps whenever
//! they are ready (each with the stamp of the frame that it is about), and gives a command
//! at any time. It has no thread, no clock, no hidden randomness: a live robot, a replay
//! and the simulator run the same code.
//!
//! | stage | what |
//! |---|---|
//! | [`Sight`] | the target's box in the present frame, from late detections, by flow |
//! | [`Ranging`] | metres: the map's depth in the box, moved by the target's motion; the target's foot on the ground; the camera's pitch |
//! | [`OwnOdometry`] | the robot's own place: turns by flow, speed by commands and flow |
//! | [`realnet_fusion::TargetFilter`] | where the target is and how it moves, by stamp |
//! | [`realnet_control::Controller`] | steering and speed, and stops with their reasons |
//!
//! [`Serial`] goes through recorded frames with it, one after the other, with an
//! [`ObjectDetector`] and a [`DepthEstimator`].
//!
//! [`Live`] does the same with frames that come by themselves, the networks on threads.
//!
//! Who calls it: [`Follower::frame`] for each frame, [`Follower::keep_for_depth`] when the
//! depth network takes that frame, [`Follower::keep_for_detector`] when the detector does
//! (where it does not take every one), [`Follower::detections`] and [`Follower::depth`] when
//! an answer is there, [`Follower::command`] once a frame, [`Follower::idle`] by a timer
//! of 50 ms or less when no frame came.

mod choice;
mod follower;
mod hold;
mod live;
mod networks;
mod odometry;
mod pictures;
mod ranging;
mod ring;
mod serial;
mod sight;
mod step;
mod work;
mod worker;

pub use follower::{Follower, FollowerError, FollowerOptions, FrameReport};
pub use live::{Live, NetworkCounts, NetworkFailure, NetworkTime};
pub use networks::{DepthEstimator, NetworkError, ObjectDetector};
pub use odometry::{CameraMount, OwnOdometry};
pub use ranging::{Ranging, RangingError, RangingOptions, SeenRange};
pub use serial::{Serial, StepError};
pub use sight::{Sight, SightOptions, TargetBox};
pub use step::BackgroundStep;
pub use work::{Step, Work};
