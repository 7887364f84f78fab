//! The box of the target: given, found, carried or lost.

use anyhow::Result;
use realnet::{BoundingBox, Detection, Detector, Frame, Stamp, datasets::TargetBoxes};
use realnet_range::carry::{BoxCarrier, BoxMotion, Carried, CarriedPoint, CarryOptions};
use realnet_vision::Pyramid;
use serde::Serialize;

use super::super::failure::OrBadInput;

/// A box that could not be carried is looked for again, from the last frame that
/// had it, for so long.
const RETRY_SECONDS: f64 = 0.5;
/// A detection that overlaps the carried box by less is not taken for its overlap.
const SAME_TARGET: f32 = 0.2;

/// Where boxes come from.
pub(in crate::cli) enum Finder {
    /// Nobody wants one.
    None,
    /// The first frame's, from the command line.
    First,
    /// A file of boxes.
    Boxes(TargetBoxes),
    /// A network.
    Model(Box<Detector>),
}

/// How a frame's box came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(in crate::cli) enum Status {
    /// There was none yet.
    Waiting,
    /// From the command line or a file of boxes.
    Given,
    /// From the network.
    Detected,
    /// By flow from an earlier frame.
    Carried,
    /// Flow could not carry it.
    Lost,
}

/// The box in the present frame.
#[derive(Clone, Debug, Default)]
pub(in crate::cli) struct State {
    pub(in crate::cli) status: Option<Status>,
    pub(in crate::cli) bbox: Option<BoundingBox>,
    /// Why it was lost.
    pub(in crate::cli) reason: Option<String>,
    /// How it was carried, also when another box has replaced it since.
    pub(in crate::cli) carried: Option<Carried>,
    /// Confidence of the detection it is from.
    pub(in crate::cli) confidence: Option<f32>,
    /// Overlap with the box that the file of boxes has for this frame.
    pub(in crate::cli) iou: Option<f32>,
}

/// A box in the last frame that had one.
struct Known {
    bbox: BoundingBox,
    /// Of the last step, which took so many seconds.
    motion: BoxMotion,
    seconds: f64,
    stamp: Stamp,
    /// The picture of that frame, when it is not the previous one.
    picture: Option<Pyramid>,
}

impl Known {
    /// The motion to the time `stamp` at the speed of the last step.
    fn prediction(&self, stamp: Stamp) -> BoxMotion {
        let ratio = (stamp.seconds_since(self.stamp) / self.seconds) as f32;
        // Far beyond the last step nothing is known; the first step has no speed.
        if !(0.0..=8.0).contains(&ratio) {
            return BoxMotion::NONE;
        }
        let BoxMotion { shift, scale } = self.motion;
        BoxMotion { shift: shift.map(|v| v * ratio), scale: scale.powf(ratio).clamp(0.5, 2.0) }
    }
}

/// Follows one target.
pub(in crate::cli) struct Target {
    finder: Finder,
    every: u64,
    first: Option<BoundingBox>,
    carrier: BoxCarrier,
    known: Option<Known>,
    /// Where it was last, for telling it from its likes.
    last: Option<BoundingBox>,
    /// Frames until a new box is wanted.
    wait: u64,
    state: State,
}

impl Target {
    pub(in crate::cli) fn new(
        finder: Finder,
        every: u64,
        first: Option<BoundingBox>,
    ) -> Result<Self> {
        let carrier = BoxCarrier::new(CarryOptions::default()).or_bad_input()?;
        // A box of the command line stands for the first look of a network.
        let wait = if first.is_some() { every } else { 0 };
        let state = State::default();
        Ok(Self { finder, every, first, carrier, known: None, last: None, wait, state })
    }

    /// Whether there is a target at all.
    pub(in crate::cli) fn is_wanted(&self) -> bool {
        !matches!(self.finder, Finder::None)
    }

    /// Whether there ever was a box.
    pub(in crate::cli) fn had_box(&self) -> bool {
        self.last.is_some()
    }

    /// The present frame's box.
    pub(in crate::cli) fn state(&self) -> &State {
        &self.state
    }

    /// The points of the box that were tracked to the present frame.
    pub(in crate::cli) fn points(&self) -> &[CarriedPoint] {
        if self.state.carried.is_some() { self.carrier.points() } else { &[] }
    }

    /// The box in the previous frame, if it is known there.
    pub(in crate::cli) fn previous_box(&self) -> Option<&BoundingBox> {
        self.known.as_ref().filter(|known| known.picture.is_none()).map(|known| &known.bbox)
    }

    /// Carries the box to the present frame.
    pub(in crate::cli) fn carry(&mut self, previous: &Pyramid, present: &Pyramid) {
        let before = std::mem::take(&mut self.state);
        if !self.is_wanted() {
            return;
        }
        let Some(mut known) = self.known.take() else {
            let lost = before.status == Some(Status::Lost);
            self.state.status = Some(if lost { Status::Lost } else { Status::Waiting });
            self.state.reason = before.reason;
            return;
        };
        let from = known.picture.as_ref().unwrap_or(previous);
        let prediction = known.prediction(present.stamp());
        // A target that stopped is not where its speed would have taken it.
        let carried = self.carrier.carry(from, present, &known.bbox, prediction).or_else(|error| {
            match prediction {
                BoxMotion::NONE => Err(error),
                _ => self.carrier.carry(from, present, &known.bbox, BoxMotion::NONE),
            }
        });
        match carried {
            Ok(carried) => {
                self.state = State {
                    status: Some(Status::Carried),
                    bbox: Some(carried.bbox),
                    carried: Some(carried),
                    ..State::default()
                };
                let seconds = present.stamp().seconds_since(known.stamp);
                self.keep(carried.bbox, carried.motion, seconds, present.stamp());
            }
            Err(error) => {
                self.state.status = Some(Status::Lost);
                self.state.reason = Some(error.to_string());
                if present.stamp().seconds_since(known.stamp) <= RETRY_SECONDS {
                    known.picture.get_or_insert_with(|| previous.clone());
                    self.known = Some(known);
                }
            }
        }
    }

    fn keep(&mut self, bbox: BoundingBox, motion: BoxMotion, seconds: f64, stamp: Stamp) {
        self.last = Some(bbox);
        self.known = Some(Known { bbox, motion, seconds, stamp, picture: None });
    }

    /// Takes a new box where one is due: frame `number` of the file of boxes, or
    /// what the network finds in `frame`. A lost box is looked for by the network
    /// in every frame.
    pub(in crate::cli) fn look(&mut self, frame: &Frame, number: u64) -> Result<()> {
        let found = match (self.first.take(), &mut self.finder) {
            (Some(bbox), _) => Some((bbox, Status::Given, None)),
            (None, Finder::None | Finder::First) => None,
            (None, Finder::Boxes(boxes)) => {
                let truth = boxes.get(number, frame.width(), frame.height());
                let due = self.wait == 0;
                if let (Some(truth), false) = (truth, due) {
                    self.state.iou = Some(self.state.bbox.map_or(0.0, |bbox| bbox.iou(&truth)));
                }
                truth.filter(|_| due).map(|bbox| (bbox, Status::Given, None))
            }
            (None, Finder::Model(detector)) => {
                let due = self.wait == 0 || self.state.bbox.is_none();
                let found = if due { detector.detect(frame)? } else { &[] };
                let chosen = choose(found, self.state.bbox.as_ref(), self.last.as_ref());
                if due && self.state.bbox.is_some() {
                    self.wait = self.every;
                }
                chosen.map(|d| (d.bbox, Status::Detected, Some(d.confidence)))
            }
        };
        if let Some((bbox, status, confidence)) = found {
            // Of a box that was somewhere else, speed is not known.
            let speed = self.known.as_ref().map(|known| (known.motion, known.seconds));
            let (motion, seconds) =
                speed.filter(|_| self.state.carried.is_some()).unwrap_or((BoxMotion::NONE, 0.0));
            // A box that was given is not one that was followed.
            self.state.iou = None;
            self.state.status = Some(status);
            self.state.bbox = Some(bbox);
            self.state.confidence = confidence;
            self.state.reason = None;
            self.wait = self.every;
            self.keep(bbox, motion, seconds, frame.stamp());
        }
        self.wait = self.wait.saturating_sub(1);
        Ok(())
    }
}

/// Which of the detections is the target. While it is followed: the one that
/// overlaps its box most, or the nearest within one side of the box, or none. If
/// it was lost: the nearest to where it was last. At the start: the largest.
fn choose<'a>(
    found: &'a [Detection],
    carried: Option<&BoundingBox>,
    last: Option<&BoundingBox>,
) -> Option<&'a Detection> {
    let most = |score: &dyn Fn(&BoundingBox) -> f32| {
        found.iter().max_by(|a, b| score(&a.bbox).total_cmp(&score(&b.bbox)))
    };
    let distance = |a: &BoundingBox, b: &BoundingBox| {
        let ((x, y), (u, v)) = (a.center(), b.center());
        (x - u).hypot(y - v)
    };
    match (carried, last) {
        (Some(carried), _) => {
            let overlapping = most(&|b| b.iou(carried));
            let near = || {
                most(&|b| -distance(b, carried))
                    .filter(|d| distance(&d.bbox, carried) <= carried.width().max(carried.height()))
            };
            overlapping.filter(|d| d.bbox.iou(carried) >= SAME_TARGET).or_else(near)
        }
        (None, Some(last)) => most(&|b| -distance(b, last)),
        (None, None) => most(&BoundingBox::area),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn detection(bbox: [f32; 4]) -> Detection {
        Detection { class_id: 0, confidence: 0.5, bbox: bbox.into() }
    }

    #[test]
    fn the_target_is_chosen_by_what_is_known_of_it() {
        let small = detection([0.0, 0.0, 10.0, 10.0]);
        let large = detection([50.0, 50.0, 90.0, 90.0]);
        let found = [small, large];
        assert_eq!(choose(&found, None, None), Some(&large));
        let last = BoundingBox::new(15.0, 0.0, 25.0, 10.0);
        assert_eq!(choose(&found, None, Some(&last)), Some(&small));
        let carried = BoundingBox::new(1.0, 1.0, 11.0, 11.0);
        assert_eq!(choose(&found, Some(&carried), Some(&last)), Some(&small));
        // No overlap, but near; nothing near: the carried box stays.
        let near = BoundingBox::new(8.0, 8.0, 18.0, 18.0);
        assert_eq!(choose(&[small], Some(&near), None), None);
        let near = BoundingBox::new(6.0, 6.0, 16.0, 16.0);
        assert_eq!(choose(&found, Some(&near), Some(&last)), Some(&small));
        assert_eq!(choose(&[], None, None), None);
    }
}
