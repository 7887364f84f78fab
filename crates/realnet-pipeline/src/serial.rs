//! One stage after the other, for recorded frames.

use crate::follower::Follower;
use crate::networks::{DepthEstimator, NetworkError, ObjectDetector};
use crate::work::{Pace, Step, Work};
use realnet_core::{DepthMap, Frame};
use realnet_range::motion::MotionError;
use thiserror::Error;

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

/// A follower with its networks, for recorded frames: each frame is done with before the
/// next one, as if the networks took no time. The same frames give the same steps.
pub struct Serial {
    follower: Follower,
    detector: Box<dyn ObjectDetector>,
    depth: Option<Box<dyn DepthEstimator>>,
    pace: Pace,
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
        Self { follower, detector, depth, pace: Pace::new(depth_every_s) }
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
        Ok(Step { report, detections, found_on: Some(stamp), depth, command })
    }

    /// Asks the depth network, if it is its turn.
    fn range(&mut self, frame: &Frame) -> Result<Option<DepthMap>, StepError> {
        let Some(network) = &mut self.depth else { return Ok(None) };
        if !self.pace.is_due(frame.stamp()) {
            return Ok(None);
        }
        self.pace.asked(frame.stamp());
        let map = network.depth(frame).map_err(StepError::Depth)?;
        self.follower.keep_for_depth();
        self.follower.depth(&map)?;
        Ok(Some(map))
    }
}
