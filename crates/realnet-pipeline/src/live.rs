//! Stages side by side, for frames that come by themselves.

use crate::follower::Follower;
use crate::networks::{DepthEstimator, NetworkError, ObjectDetector};
use crate::work::{Pace, Step, Work};
use crate::worker::Worker;
use realnet_core::{DepthMap, Detection, DriveCommand, Frame, Stamp};
use realnet_range::motion::MotionError;
use std::io;
use std::sync::Arc;

/// What a network was asked and how it answered.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NetworkCounts {
    /// Frames that it took.
    pub taken: u64,
    /// Frames that it was offered while it had one.
    pub skipped: u64,
    /// Answers that were errors.
    pub failures: u64,
}

/// A network that failed on a frame.
#[derive(Debug)]
pub struct NetworkFailure {
    /// Which.
    pub work: Work,
    /// On the frame of this stamp.
    pub stamp: Stamp,
    /// What it said.
    pub error: NetworkError,
}

/// An answer of a network, as it comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NetworkTime {
    /// Which network.
    pub work: Work,
    /// How long it took, milliseconds.
    pub ms: f64,
}

/// A follower with its networks, for a live camera: the detector and the depth network work
/// on threads of their own, each on the newest frame when it is free, and their answers are
/// taken up at the next frame. Between frames [`Live::idle`] keeps the robot safe.
///
/// Neither a slow network nor one that fails, panics or never answers holds up a command;
/// a target that nobody confirms is lost after the time that is set for it, and the robot
/// stops.
pub struct Live {
    follower: Follower,
    detector: Worker<Vec<Detection>>,
    depth: Option<Worker<DepthMap>>,
    pace: Pace,
    counts: [NetworkCounts; 2],
    detections: Vec<Detection>,
    found_on: Option<Stamp>,
    /// The newest map, until a frame's step has it.
    map: Option<DepthMap>,
    failures: Vec<NetworkFailure>,
    times: Vec<NetworkTime>,
}

impl Live {
    /// Starts the networks' threads; a depth map is asked for every `depth_every_s` seconds
    /// at most.
    ///
    /// # Errors
    /// The system's, when there can be no threads.
    pub fn start(
        follower: Follower,
        mut detector: Box<dyn ObjectDetector>,
        depth: Option<Box<dyn DepthEstimator>>,
        depth_every_s: f64,
    ) -> io::Result<Self> {
        let detector = Worker::start("detector", move |frame| detector.detect(frame, None))?;
        let depth = match depth {
            Some(mut depth) => Some(Worker::start("depth", move |frame| depth.depth(frame))?),
            None => None,
        };
        Ok(Self {
            follower,
            detector,
            depth,
            pace: Pace::new(depth_every_s),
            counts: [NetworkCounts::default(); 2],
            detections: Vec::new(),
            found_on: None,
            map: None,
            failures: Vec::new(),
            times: Vec::new(),
        })
    }

    /// The follower.
    #[must_use]
    pub const fn follower(&self) -> &Follower {
        &self.follower
    }

    /// The follower, to stop it or to let it go on.
    pub const fn follower_mut(&mut self) -> &mut Follower {
        &mut self.follower
    }

    /// What the detector and the depth network were asked.
    #[must_use]
    pub const fn counts(&self) -> [NetworkCounts; 2] {
        self.counts
    }

    /// Failures of the networks since the last call.
    pub fn failures(&mut self) -> std::vec::Drain<'_, NetworkFailure> {
        self.failures.drain(..)
    }

    /// How long the answers took that came since the last call.
    pub fn times(&mut self) -> std::vec::Drain<'_, NetworkTime> {
        self.times.drain(..)
    }

    /// A frame came; it is `now`, by the clock of the frames' stamps. `mark` is called when
    /// a part of the work is done. [`Step::detections`] are the newest there are, of an
    /// earlier frame.
    ///
    /// # Errors
    /// [`MotionError`]: the frame is left out; [`Live::idle`] has a command all the same.
    pub fn frame(
        &mut self,
        frame: &Arc<Frame>,
        now: Stamp,
        mark: &mut dyn FnMut(Work),
    ) -> Result<Step, MotionError> {
        self.hear();
        let report = self.follower.frame(frame)?;
        mark(Work::Motion);
        self.ask(frame);
        let command = self.follower.command(now);
        mark(Work::Command);
        let (detections, found_on) = (self.detections.clone(), self.found_on);
        Ok(Step { report, detections, found_on, depth: self.map.take(), command })
    }

    /// The command when no frame came: by a timer of 50 ms or less.
    pub fn idle(&mut self, now: Stamp) -> DriveCommand {
        self.hear();
        self.follower.idle(now)
    }

    /// Takes up what the networks said.
    fn hear(&mut self) {
        if let Some(answer) = self.detector.answer() {
            self.times.push(NetworkTime { work: Work::Detect, ms: answer.ms });
            match answer.value {
                Ok(found) => {
                    self.follower.detections(answer.stamp, &found);
                    (self.detections, self.found_on) = (found, Some(answer.stamp));
                }
                Err(error) => self.failed(Work::Detect, answer.stamp, error),
            }
        }
        if let Some(answer) = self.depth.as_mut().and_then(Worker::answer) {
            self.times.push(NetworkTime { work: Work::Depth, ms: answer.ms });
            match answer.value {
                Ok(map) => {
                    // One of a frame that is no longer kept gives a range all the same.
                    let _ = self.follower.depth(&map);
                    self.map = Some(map);
                }
                Err(error) => self.failed(Work::Depth, answer.stamp, error),
            }
        }
    }

    fn failed(&mut self, work: Work, stamp: Stamp, error: NetworkError) {
        let [detector, depth] = &mut self.counts;
        (if work == Work::Detect { detector } else { depth }).failures += 1;
        self.failures.push(NetworkFailure { work, stamp, error });
    }

    /// Shows the networks the frame.
    fn ask(&mut self, frame: &Arc<Frame>) {
        let stamp = frame.stamp();
        let [detector, depth] = &mut self.counts;
        if self.detector.offer(frame) {
            self.follower.keep_for_detector();
            detector.taken += 1;
        } else {
            detector.skipped += 1;
        }
        let Some(network) = &mut self.depth else { return };
        if !self.pace.is_due(stamp) {
            return;
        }
        if network.offer(frame) {
            self.follower.keep_for_depth();
            self.pace.asked(stamp);
            depth.taken += 1;
        } else {
            depth.skipped += 1;
        }
    }
}
