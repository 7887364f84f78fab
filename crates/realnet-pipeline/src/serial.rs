//! One stage after the other, for recorded frames.

use crate::follower::{Follower, FrameReport};
use crate::networks::{DepthEstimator, NetworkError, ObjectDetector};
use realnet_core::{DepthMap, Detection, DriveCommand, Frame, Stamp};
use realnet_range::motion::MotionError;
use thiserror::Error;

/// Frames may be a microsecond early: their stamps are rounded.
const EARLY_S: f64 = 1e-6;

/// A part of the work on a frame, for a caller with a clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Work {
    /// Corners, flow, motion, the box carried.
    Motion,
    /// The detector.
    Detect,
    /// The depth network.
    Depth,
    /// Fusion and the command.
    Command,
}

impl Work {
    /// All of them, in their order.
    pub const ALL: [Self; 4] = [Self::Motion, Self::Detect, Self::Depth, Self::Command];

    /// The name in files and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Motion => "motion",
            Self::Detect => "detect",
            Self::Depth => "depth",
            Self::Command => "command",
        }
    }
}

/// Why a frame was not followed.
#[derive(Debug, Error)]
pub enum StepError {
    /// The follower refused it.
    #[error(transparent)]
    Frame(#[from] MotionError),
    /// The detector failed.
    #[error("the detector failed")]
    Detector(#[source] NetworkError),
    /// The depth network failed.
    #[error("the depth network failed")]
    Depth(#[source] NetworkError),
}

/// What came of a frame.
#[derive(Clone, Debug)]
pub struct Step {
    /// What is known of it.
    pub report: FrameReport,
    /// What was found in it, whether or not it is the target.
    pub detections: Vec<Detection>,
    /// Its depth, if it was the network's turn.
    pub depth: Option<DepthMap>,
    /// The command for its stamp.
    pub command: DriveCommand,
}

/// A follower with its networks, for recorded frames: each frame is done with before the
/// next one, as if the networks took no time. The same frames give the same steps.
pub struct Serial {
    follower: Follower,
    detector: Box<dyn ObjectDetector>,
    depth: Option<Box<dyn DepthEstimator>>,
    /// Seconds from one depth map to the next.
    depth_every_s: f64,
    depth_due: Option<Stamp>,
}

impl Serial {
    /// A follower that looks at every frame for objects, and every `depth_every_s` seconds
    /// for depth.
    #[must_use]
    pub fn new(
        follower: Follower,
        detector: Box<dyn ObjectDetector>,
        depth: Option<Box<dyn DepthEstimator>>,
        depth_every_s: f64,
    ) -> Self {
        Self { follower, detector, depth, depth_every_s, depth_due: None }
    }

    /// The follower.
    #[must_use]
    pub const fn follower(&self) -> &Follower {
        &self.follower
    }

    /// The next frame. `mark` is called when a part of its work is done.
    ///
    /// # Errors
    /// [`StepError`]: the frame is left out, or what the network would have said of it.
    pub fn step(&mut self, frame: &Frame, mark: &mut dyn FnMut(Work)) -> Result<Step, StepError> {
        let stamp = frame.stamp();
        let report = self.follower.frame(frame)?;
        mark(Work::Motion);
        let detections = self.detector.detect(frame, None).map_err(StepError::Detector)?;
        self.follower.detections(stamp, &detections);
        mark(Work::Detect);
        let depth = self.range(frame)?;
        mark(Work::Depth);
        let report = self.follower.revised(&report);
        let command = self.follower.command(stamp);
        mark(Work::Command);
        Ok(Step { report, detections, depth, command })
    }

    /// Asks the depth network, if it is its turn.
    fn range(&mut self, frame: &Frame) -> Result<Option<DepthMap>, StepError> {
        let Some(network) = &mut self.depth else { return Ok(None) };
        let stamp = frame.stamp();
        // More than a period ahead it is of a time before the clock was set.
        let waits = |due: Stamp| {
            let left_s = due.seconds_since(stamp);
            left_s > EARLY_S && left_s <= self.depth_every_s
        };
        if self.depth_due.is_some_and(waits) {
            return Ok(None);
        }
        self.depth_due = Some(stamp.seconds_later(self.depth_every_s));
        let map = network.depth(frame).map_err(StepError::Depth)?;
        self.follower.keep_for_depth();
        self.follower.depth(&map)?;
        Ok(Some(map))
    }
}
