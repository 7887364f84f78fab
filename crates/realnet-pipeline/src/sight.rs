//! The target's box in every frame, from detections that come late.

use crate::hold::Hold;
use crate::pictures::Pictures;
use realnet_core::{BoundingBox, Detection, Stamp};
use realnet_range::carry::{BoxCarrier, CarryError, CarryOptions};
use realnet_vision::Pyramid;

/// How a target is held on to between detections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SightOptions {
    /// How boxes are carried from a detection's frame to the present one.
    pub carry: CarryOptions,
    /// Standard deviation of an edge of a detection, as a share of the box's side.
    pub edge_std_share: f32,
    /// The same, in pixels, for small boxes.
    pub edge_std_px: f32,
    /// A detection is the box's that overlaps with it by at least this.
    pub min_iou: f32,
    /// Detections below this confidence are not regarded.
    pub min_confidence: f32,
    /// A target is taken up when it was found so many times in a row: networks see
    /// phantoms.
    pub hits: u32,
    /// Hits are in a row when no more than this lies between them, seconds, whether or not
    /// the detector looked between them; of a slower detector those of two looks one after
    /// the other are, if flow carried the box from one to the other.
    pub hits_within_s: f64,
    /// For so long a box is carried after the detector's last word of it came, seconds:
    /// longer than the slowest detector takes from one to the next.
    pub carry_for_s: f64,
    /// For so long it is carried although the detector looked and did not find it,
    /// seconds.
    pub unsupported_for_s: f64,
}

impl Default for SightOptions {
    fn default() -> Self {
        Self {
            carry: CarryOptions::default(),
            edge_std_share: 0.02,
            edge_std_px: 1.0,
            min_iou: 0.3,
            min_confidence: 0.25,
            hits: 3,
            hits_within_s: 0.25,
            carry_for_s: 3.0,
            unsupported_for_s: 0.25,
        }
    }
}

impl SightOptions {
    fn check(&self) -> Result<(), CarryError> {
        let share = |value: f32| (0.0..=1.0).contains(&value);
        let positive = |value: f64| value > 0.0;
        for (option, value, fits, allowed) in [
            (
                "edge_std_share",
                f64::from(self.edge_std_share),
                share(self.edge_std_share),
                "0 to 1 sides of the box",
            ),
            (
                "edge_std_px",
                f64::from(self.edge_std_px),
                self.edge_std_px > 0.0 && self.edge_std_px.is_finite(),
                "above 0 pixels",
            ),
            ("min_iou", f64::from(self.min_iou), share(self.min_iou), "0 to 1"),
            (
                "min_confidence",
                f64::from(self.min_confidence),
                share(self.min_confidence),
                "0 to 1",
            ),
            ("hits_within_s", self.hits_within_s, positive(self.hits_within_s), "above 0 s"),
            ("carry_for_s", self.carry_for_s, positive(self.carry_for_s), "above 0 s"),
            (
                "unsupported_for_s",
                self.unsupported_for_s,
                self.unsupported_for_s >= 0.0,
                "at least 0 s",
            ),
        ] {
            if !fits {
                return Err(CarryError::Option { option, value: value.to_string(), allowed });
            }
        }
        Ok(())
    }
}

/// The target's box in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetBox {
    /// Exposure time of the frame.
    pub stamp: Stamp,
    /// The box, in pixels of the frame.
    pub bbox: BoundingBox,
    /// Standard deviation of its centre, right and down, pixels.
    pub center_std: [f32; 2],
    /// Standard deviation of its edges, pixels.
    pub edge_std: f32,
    /// Exposure time of the detection that it was carried from.
    pub detected: Stamp,
}

impl TargetBox {
    /// Of a detection.
    #[must_use]
    pub fn of_detection(stamp: Stamp, bbox: BoundingBox, options: &SightOptions) -> Self {
        let side = bbox.width().max(bbox.height());
        let edge_std = options.edge_std_px.hypot(options.edge_std_share * side);
        // The middle of two edges.
        let center_std = edge_std * std::f32::consts::FRAC_1_SQRT_2;
        Self { stamp, bbox, center_std: [center_std; 2], edge_std, detected: stamp }
    }
}

/// What was found but is not yet believed.
#[derive(Clone, Debug)]
struct Candidate {
    hold: Hold,
    last: Option<TargetBox>,
    hits: u32,
    /// The detector looked since and did not find it.
    missed: bool,
}

impl Candidate {
    fn clear(&mut self) {
        self.hold.clear();
        (self.last, self.hits, self.missed) = (None, 0, false);
    }
}

/// Holds on to the target's box: takes frames at once and detections when they
/// come, answers with the box in the present frame.
///
/// The detector may be of any rate, and its answers may be late. Pictures are kept for
/// 1.5 s (at up to 60 a second), or, where [`Sight::keep_for_detector`] says which ones the
/// detector is given, only those, for up to 4 s until it has answered. On a frame whose
/// picture is not kept a detection can only confirm a box that flow carried there.
pub struct Sight {
    options: SightOptions,
    carrier: BoxCarrier,
    pictures: Pictures,
    target: Hold,
    candidate: Candidate,
    now: Option<Stamp>,
    /// Since when the detector looks and does not find the box.
    unsupported_since: Option<Stamp>,
}

impl Sight {
    /// Without a target.
    ///
    /// # Errors
    /// [`CarryError::Option`] for options out of range.
    pub fn new(options: SightOptions) -> Result<Self, CarryError> {
        options.check()?;
        Ok(Self {
            options,
            carrier: BoxCarrier::new(options.carry)?,
            pictures: Pictures::default(),
            target: Hold::new(),
            candidate: Candidate { hold: Hold::new(), last: None, hits: 0, missed: false },
            now: None,
            unsupported_since: None,
        })
    }

    /// Takes the next frame and carries the box into it.
    pub fn frame(&mut self, picture: &Pyramid) -> Option<TargetBox> {
        let Self { carrier, pictures, target, candidate, .. } = self;
        let (now, for_s) = (picture.stamp(), self.options.carry_for_s);
        pictures.put(picture, |stamp| target.needs(stamp) || candidate.hold.needs(stamp));
        self.now = Some(now);
        let carried = target.carry(carrier, pictures, now, for_s);
        if carried.is_some() {
            candidate.clear();
        } else {
            candidate.hold.carry(carrier, pictures, now, for_s);
        }
        carried
    }

    /// The detector is given the present frame. From the first call on only frames of which
    /// this is said are kept for detections, which takes less memory and allows for later
    /// ones.
    pub fn keep_for_detector(&mut self) {
        self.pictures.await_newest();
    }

    /// Takes what the detector found on the frame of `stamp`, whenever it comes. What is
    /// not `allowed` cannot be the target.
    /// `plausible` says how well a detection suits what is known about the target
    /// (the higher the better, `None`: not at all); it is asked when there is no box to
    /// compare with. Returns the target's box on that frame.
    pub fn detections(
        &mut self,
        stamp: Stamp,
        detections: &[Detection],
        allowed: impl Fn(&Detection) -> bool,
        plausible: impl Fn(&Detection) -> Option<f64>,
    ) -> Option<TargetBox> {
        self.pictures.answered(stamp);
        if self.target.detected().is_some_and(|last| last >= stamp) {
            return None; // older than what is known
        }
        let is_kept = self.pictures.get(stamp).is_some();
        let at = self.target.trace(&mut self.carrier, &self.pictures, stamp);
        if at.is_none() && !is_kept {
            return None; // of no frame that is remembered
        }
        let least = self.options.min_confidence;
        let wanted = detections
            .iter()
            .filter(|d| (least..=1.0).contains(&d.confidence) && d.bbox.is_proper())
            .filter(|d| allowed(d));
        let overlap = at.and_then(|at| {
            let by_overlap = |d: &&Detection| f64::from(d.bbox.iou(&at.bbox));
            best(wanted.clone(), by_overlap)
                .filter(|d| d.bbox.iou(&at.bbox) >= self.options.min_iou)
        });
        // While flow holds the box, what lies elsewhere is another one.
        let held = at.is_some() && self.target.is_holding();
        let chosen = overlap.or_else(|| {
            if held {
                return None;
            }
            let rated = wanted.filter(|d| plausible(d).is_some());
            let Some(found) = best(rated, |d| plausible(d).unwrap_or(f64::NEG_INFINITY)) else {
                self.candidate.missed |= self.candidate.last.is_some_and(|at| at.stamp < stamp);
                return None;
            };
            self.believe(stamp, found, is_kept).then_some(found)
        });
        let Some(chosen) = chosen else {
            let since = *self.unsupported_since.get_or_insert(stamp);
            if stamp.seconds_since(since) >= self.options.unsupported_for_s {
                self.target.release();
            }
            return None;
        };
        self.unsupported_since = None;
        self.candidate.clear();
        let found = TargetBox::of_detection(stamp, chosen.bbox, &self.options);
        self.target.found(found, is_kept, self.now.unwrap_or(stamp));
        Some(found)
    }

    /// Counts how often a new target was found in a row, and says whether that is often
    /// enough. Messages that come twice, or behind newer ones, are no hits.
    fn believe(&mut self, stamp: Stamp, found: &Detection, is_kept: bool) -> bool {
        if self.candidate.last.is_some_and(|last| stamp <= last.stamp) {
            return false;
        }
        let at = TargetBox::of_detection(stamp, found.bbox, &self.options);
        let hits = if self.is_candidate(&at) { self.candidate.hits + 1 } else { 1 };
        if hits >= self.options.hits {
            return true;
        }
        let candidate = &mut self.candidate;
        candidate.clear();
        (candidate.last, candidate.hits) = (Some(at), hits);
        candidate.hold.found(at, is_kept, self.now.unwrap_or(stamp));
        false
    }

    /// Whether this is the candidate once more.
    fn is_candidate(&mut self, at: &TargetBox) -> bool {
        let Self { candidate, carrier, pictures, options, .. } = self;
        let Some(last) = candidate.last else { return false };
        let is_there = |bbox: &BoundingBox| bbox.iou(&at.bbox) >= options.min_iou;
        let seconds = at.stamp.seconds_since(last.stamp);
        if seconds <= options.hits_within_s && is_there(&last.bbox) {
            return true;
        }
        if candidate.missed || seconds > options.carry_for_s {
            return false;
        }
        let carried = candidate.hold.trace(carrier, pictures, at.stamp);
        carried.is_some_and(|carried| is_there(&carried.bbox))
    }

    /// The target's box on a frame, as far as it was seen or carried there.
    #[must_use]
    pub fn box_at(&self, stamp: Stamp) -> Option<TargetBox> {
        self.target.box_at(stamp)
    }

    /// Forgets all frames, for those of another time.
    pub fn restart(&mut self) {
        self.target.clear();
        self.candidate.clear();
        self.unsupported_since = None;
        self.pictures.restart();
        self.now = None;
    }
}

fn best<'a>(
    detections: impl Iterator<Item = &'a Detection>,
    rate: impl Fn(&&'a Detection) -> f64,
) -> Option<&'a Detection> {
    detections.max_by(|a, b| rate(a).total_cmp(&rate(b)))
}
