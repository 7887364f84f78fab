//! The target's box in every frame, from detections that come late.

use crate::ring::{Ring, Stamped};
use realnet_core::{BoundingBox, Detection, Stamp};
use realnet_range::carry::{BoxCarrier, BoxMotion, CarryError, CarryOptions};
use realnet_vision::Pyramid;

/// Frames that are kept for late detections.
const FRAMES: usize = 12;
/// Boxes that are remembered, for depth maps that come later still.
const BOXES: usize = 64;

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
    /// Hits are in a row when no more than this lies between them, seconds.
    pub hits_within_s: f64,
    /// For so long a box is carried without any word from the detector, seconds.
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

/// Where carrying starts: a box whose frame is still there.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    at: TargetBox,
    /// From the anchor to the last frame it was carried to.
    motion: BoxMotion,
    carried_to: Stamp,
}

/// Holds on to the target's box: takes frames at once and detections when they
/// come, answers with the box in the present frame.
pub struct Sight {
    options: SightOptions,
    carrier: BoxCarrier,
    frames: Ring<Pyramid, FRAMES>,
    boxes: Ring<TargetBox, BOXES>,
    anchor: Option<Anchor>,
    now: Option<Stamp>,
    /// Since when the detector looks and does not find the box.
    unsupported_since: Option<Stamp>,
    /// What was found but is not yet believed.
    candidate: Option<(TargetBox, u32)>,
    last_error: Option<CarryError>,
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
            frames: Ring::new(),
            boxes: Ring::new(),
            anchor: None,
            now: None,
            unsupported_since: None,
            candidate: None,
            last_error: None,
        })
    }

    /// Takes the next frame and carries the box into it.
    pub fn frame(&mut self, picture: &Pyramid) -> Option<TargetBox> {
        let stamp = picture.stamp();
        self.leave_behind();
        self.frames.put(|place| place.copy_from(picture), || picture.clone());
        self.now = Some(stamp);
        let carried = self.carry_to(stamp);
        if let Some(carried) = carried {
            self.remember(carried);
        }
        carried
    }

    /// The anchor's frame is about to be overwritten: the newest carried box becomes
    /// the anchor.
    fn leave_behind(&mut self) {
        let Some(leaving) = self.frames.leaving().map(Pyramid::stamp) else { return };
        if self.anchor.is_some_and(|anchor| anchor.at.stamp <= leaving) {
            self.anchor = self.anchor.and_then(|anchor| {
                let at = self.box_at(anchor.carried_to).filter(|at| at.stamp > leaving)?;
                Some(Anchor { at, motion: BoxMotion::NONE, carried_to: at.stamp })
            });
        }
    }

    fn carry_to(&mut self, now: Stamp) -> Option<TargetBox> {
        self.last_error = None;
        let anchor = self.anchor?;
        if now.seconds_since(anchor.at.detected) > self.options.carry_for_s {
            self.anchor = None;
            return None;
        }
        // Speed is taken to be constant: twice as far after twice the time.
        let seconds = anchor.carried_to.seconds_since(anchor.at.stamp);
        let ahead = now.seconds_since(anchor.at.stamp);
        let prediction =
            if seconds > 0.0 { stretched(anchor.motion, ahead / seconds) } else { BoxMotion::NONE };
        let (from, to) = (self.frames.get(anchor.at.stamp)?, self.frames.get(now)?);
        match self.carrier.carry(from, to, &anchor.at.bbox, prediction) {
            Ok(carried) => {
                let hypot = |a: f32, b: f32| a.hypot(b);
                let [x, y] = anchor.at.center_std;
                let [dx, dy] = carried.center_sd;
                let side = carried.bbox.width().max(carried.bbox.height());
                let at = TargetBox {
                    stamp: now,
                    bbox: carried.bbox,
                    center_std: [hypot(x, dx), hypot(y, dy)],
                    edge_std: hypot(anchor.at.edge_std, 0.5 * carried.size_sd * side),
                    detected: anchor.at.detected,
                };
                self.anchor = Some(Anchor { motion: carried.motion, carried_to: now, ..anchor });
                Some(at)
            }
            Err(error) => {
                self.last_error = Some(error);
                None
            }
        }
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
        let known = self.box_at(stamp).is_some() || self.frames.get(stamp).is_some();
        if !known || self.anchor.is_some_and(|anchor| anchor.at.detected >= stamp) {
            return None; // of no frame that is remembered, or older than what is known
        }
        let at = self.box_at(stamp);
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
        let held = at.is_some() && self.anchor.is_some();
        let chosen = overlap.or_else(|| {
            if held {
                return None;
            }
            let rated = wanted.filter(|d| plausible(d).is_some());
            let found = best(rated, |d| plausible(d).unwrap_or(f64::NEG_INFINITY))?;
            self.believe(stamp, found).then_some(found)
        });
        let Some(chosen) = chosen else {
            let since = *self.unsupported_since.get_or_insert(stamp);
            if stamp.seconds_since(since) >= self.options.unsupported_for_s {
                self.anchor = None;
            }
            return None;
        };
        self.unsupported_since = None;
        let found = TargetBox::of_detection(stamp, chosen.bbox, &self.options);
        // Carried on from here it will be near where it was carried to so far.
        let (motion, carried_to) = match self.anchor {
            Some(anchor) => match (self.box_at(anchor.carried_to), at) {
                (Some(last), Some(at)) if anchor.carried_to > stamp => {
                    (between(&at.bbox, &last.bbox), anchor.carried_to)
                }
                _ => (BoxMotion::NONE, stamp),
            },
            None => (BoxMotion::NONE, stamp),
        };
        if self.frames.get(stamp).is_some() {
            self.anchor = Some(Anchor { at: found, motion, carried_to });
        }
        self.remember(found);
        Some(found)
    }

    /// Counts how often a new target was found in a row, and says whether that is often
    /// enough. Messages that come twice, or behind newer ones, are no hits.
    fn believe(&mut self, stamp: Stamp, found: &Detection) -> bool {
        if self.candidate.is_some_and(|(last, _)| stamp <= last.stamp) {
            return false;
        }
        let at = TargetBox::of_detection(stamp, found.bbox, &self.options);
        let hits = match self.candidate {
            Some((last, hits))
                if stamp.seconds_since(last.stamp) <= self.options.hits_within_s
                    && last.bbox.iou(&found.bbox) >= self.options.min_iou =>
            {
                hits + 1
            }
            _ => 1,
        };
        let enough = hits >= self.options.hits;
        self.candidate = (!enough).then_some((at, hits));
        enough
    }

    /// The target's box on a frame, as far as it was seen or carried there.
    #[must_use]
    pub fn box_at(&self, stamp: Stamp) -> Option<TargetBox> {
        self.boxes.get(stamp).copied()
    }

    /// The target's box in the present frame.
    #[must_use]
    pub fn present(&self) -> Option<TargetBox> {
        self.box_at(self.now?)
    }

    /// Why the box was not carried into the present frame, if that was tried.
    #[must_use]
    pub fn lost_because(&self) -> Option<&CarryError> {
        self.last_error.as_ref()
    }

    /// Whether there is a box to carry.
    #[must_use]
    pub fn is_holding(&self) -> bool {
        self.anchor.is_some()
    }

    /// Lets go of the target.
    pub fn release(&mut self) {
        self.anchor = None;
        self.unsupported_since = None;
        self.candidate = None;
    }

    fn remember(&mut self, at: TargetBox) {
        match self.boxes.get_mut(at.stamp) {
            Some(known) => *known = at,
            None => self.boxes.push(at),
        }
    }
}

impl Stamped for Pyramid {
    fn stamp(&self) -> Stamp {
        Self::stamp(self)
    }
}

impl Stamped for TargetBox {
    fn stamp(&self) -> Stamp {
        self.stamp
    }
}

fn best<'a>(
    detections: impl Iterator<Item = &'a Detection>,
    rate: impl Fn(&&'a Detection) -> f64,
) -> Option<&'a Detection> {
    detections.max_by(|a, b| rate(a).total_cmp(&rate(b)))
}

/// The same motion for `times` as long.
fn stretched(motion: BoxMotion, times: f64) -> BoxMotion {
    let times = times.clamp(0.0, 4.0) as f32;
    BoxMotion { shift: motion.shift.map(|s| s * times), scale: motion.scale.powf(times) }
}

fn between(from: &BoundingBox, to: &BoundingBox) -> BoxMotion {
    let ((x, y), (u, v)) = (from.center(), to.center());
    let scale = (to.area() / from.area()).sqrt();
    let scale = if scale.is_finite() && scale > 0.0 { scale } else { 1.0 };
    BoxMotion { shift: [u - x, v - y], scale }
}
