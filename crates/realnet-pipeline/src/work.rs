//! What is done with a frame, and what comes of it.

use crate::follower::FrameReport;
use realnet_core::{DepthMap, Detection, DriveCommand, Stamp};

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

/// What came of a frame.
#[derive(Clone, Debug)]
pub struct Step {
    /// What is known of it.
    pub report: FrameReport,
    /// The newest objects that were found, whether or not the target is among them.
    pub detections: Vec<Detection>,
    /// Exposure time of the frame that they were found on; `None` before the first answer.
    pub found_on: Option<Stamp>,
    /// A depth map that was taken up with it, which has the stamp of its own frame.
    pub depth: Option<DepthMap>,
    /// The command.
    pub command: DriveCommand,
}

/// When a network is to be asked that does not look at every frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    period_s: f64,
    due: Option<Stamp>,
}

impl Pace {
    /// Frames may be a microsecond early: their stamps are rounded.
    const EARLY_S: f64 = 1e-6;

    pub(crate) const fn new(period_s: f64) -> Self {
        Self { period_s, due: None }
    }

    /// Whether it is its turn. What is due more than a period ahead was due before the
    /// clock was set.
    pub(crate) fn is_due(&self, stamp: Stamp) -> bool {
        self.due.is_none_or(|due| {
            let left_s = due.seconds_since(stamp);
            left_s <= Self::EARLY_S || left_s > self.period_s + Self::EARLY_S
        })
    }

    /// It was asked of the frame of this stamp.
    pub(crate) fn asked(&mut self, stamp: Stamp) {
        self.due = Some(stamp.seconds_later(self.period_s));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_its_period_and_survives_a_clock_that_is_set() {
        let mut pace = Pace::new(0.2);
        let mut asked = |stamp: Stamp| {
            let due = pace.is_due(stamp);
            if due {
                pace.asked(stamp);
            }
            due
        };
        let frames = (0..15).filter(|index| asked(Stamp::of_frame(*index, 30.0)));
        assert_eq!(frames.collect::<Vec<_>>(), [0, 6, 12]);
        // An hour back: at once, then by its period again.
        let back = Stamp::from_secs_f64(-3600.0);
        assert!(asked(back) && !asked(back.seconds_later(0.1)) && asked(back.seconds_later(0.2)));
    }
}
