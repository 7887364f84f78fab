//! A box that flow carries from frame to frame.

use crate::pictures::Pictures;
use crate::ring::{KEPT, Ring, Stamped};
use crate::sight::TargetBox;
use realnet_core::{BoundingBox, Stamp};
use realnet_range::carry::{BoxCarrier, BoxMotion};
use realnet_vision::Pyramid;

/// So long after its frame the anchor is replaced by a box carried from it, seconds: over
/// longer steps a target looks too different, over shorter ones errors add up.
const STEP_S: f64 = 0.4;

/// Where carrying starts.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    at: TargetBox,
    /// From the anchor to the last frame it was carried to.
    motion: BoxMotion,
    carried_to: Stamp,
    /// Whether that was from this anchor, not from the one before.
    carried: bool,
    /// When the detector's last word of it came.
    heard: Stamp,
}

/// A box, carried from the frame in which it was found to each later one in one step.
#[derive(Clone, Debug)]
pub(crate) struct Hold {
    anchor: Option<Anchor>,
    boxes: Ring<TargetBox, KEPT>,
}

impl Stamped for TargetBox {
    fn stamp(&self) -> Stamp {
        self.stamp
    }
}

impl TargetBox {
    /// Carried to another picture, and how.
    fn carried(
        &self,
        carrier: &mut BoxCarrier,
        from: &Pyramid,
        to: &Pyramid,
        prediction: BoxMotion,
    ) -> Option<(Self, BoxMotion)> {
        let carried = carrier.carry(from, to, &self.bbox, prediction).ok()?;
        let side = carried.bbox.width().max(carried.bbox.height());
        let ([x, y], [dx, dy]) = (self.center_std, carried.center_sd);
        let found = Self {
            stamp: to.stamp(),
            bbox: carried.bbox,
            center_std: [x.hypot(dx), y.hypot(dy)],
            edge_std: self.edge_std.hypot(0.5 * carried.size_sd * side),
            detected: self.detected,
        };
        Some((found, carried.motion))
    }
}

impl Hold {
    pub(crate) fn new() -> Self {
        Self { anchor: None, boxes: Ring::new() }
    }

    /// Whether there is a box to carry.
    pub(crate) fn is_holding(&self) -> bool {
        self.anchor.is_some()
    }

    /// Exposure time of the detection that the box was carried from.
    pub(crate) fn detected(&self) -> Option<Stamp> {
        self.anchor.map(|anchor| anchor.at.detected)
    }

    /// The box on a frame, as far as it was seen or carried there.
    pub(crate) fn box_at(&self, stamp: Stamp) -> Option<TargetBox> {
        self.boxes.get(stamp).copied()
    }

    /// Whether the picture of `stamp` is needed to carry on.
    pub(crate) fn needs(&self, stamp: Stamp) -> bool {
        self.anchor.is_some_and(|anchor| anchor.at.stamp == stamp || anchor.carried_to == stamp)
    }

    /// Carries no more; where the box was is still known.
    pub(crate) fn release(&mut self) {
        self.anchor = None;
    }

    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        self.anchor = None;
        self.boxes.clear();
    }

    /// Carries the box into the present picture, for `for_s` seconds after the detector's
    /// last word.
    pub(crate) fn carry(
        &mut self,
        carrier: &mut BoxCarrier,
        pictures: &Pictures,
        now: Stamp,
        for_s: f64,
    ) -> Option<TargetBox> {
        let mut anchor = self.anchor.take()?;
        if now.seconds_since(anchor.heard) > for_s {
            return None;
        }
        let is_old = anchor.carried && now.seconds_since(anchor.at.stamp) >= STEP_S;
        if let Some(at) = self.box_at(anchor.carried_to).filter(|_| is_old) {
            anchor = Anchor { at, motion: BoxMotion::NONE, carried: false, ..anchor };
        }
        let (from, to) = (pictures.get(anchor.at.stamp)?, pictures.get(now)?);
        // Speed is taken to be constant: twice as far after twice the time.
        let seconds = anchor.carried_to.seconds_since(anchor.at.stamp);
        let ahead = now.seconds_since(anchor.at.stamp);
        let prediction =
            if seconds > 0.0 { stretched(anchor.motion, ahead / seconds) } else { BoxMotion::NONE };
        // A frame that it cannot be carried to, of a blurred picture say, is passed over.
        let found = anchor.at.carried(carrier, from, to, prediction);
        if let Some((at, motion)) = found {
            (anchor.motion, anchor.carried_to, anchor.carried) = (motion, now, true);
            self.remember(at);
        }
        self.anchor = Some(anchor);
        found.map(|(at, _)| at)
    }

    /// The box on a frame that may be one between the anchor's and the first it was carried
    /// to: those had gone by when a late detection came.
    pub(crate) fn trace(
        &mut self,
        carrier: &mut BoxCarrier,
        pictures: &Pictures,
        stamp: Stamp,
    ) -> Option<TargetBox> {
        self.box_at(stamp).or_else(|| {
            let at = self.anchor?.at;
            let (from, to) = (pictures.get(at.stamp)?, pictures.get(stamp)?);
            let (found, _) = at.carried(carrier, from, to, BoxMotion::NONE)?;
            self.remember(found);
            Some(found)
        })
    }

    /// The detector found the box, and said so at `heard`: it is carried on from there if
    /// the picture `is_kept`.
    pub(crate) fn found(&mut self, found: TargetBox, is_kept: bool, heard: Stamp) {
        let stamp = found.stamp;
        if is_kept {
            // Carried on from here it will be near where it was carried to so far.
            let so_far =
                self.anchor.filter(|anchor| anchor.carried_to > stamp).and_then(|anchor| {
                    let (at, last) = (self.box_at(stamp)?, self.box_at(anchor.carried_to)?);
                    Some((between(&at.bbox, &last.bbox), anchor.carried_to))
                });
            let (motion, carried_to) = so_far.unwrap_or((BoxMotion::NONE, stamp));
            self.anchor = Some(Anchor { at: found, motion, carried_to, carried: false, heard });
        } else if let Some(anchor) = &mut self.anchor {
            anchor.heard = heard;
        }
        self.remember(found);
    }

    fn remember(&mut self, at: TargetBox) {
        match self.boxes.get_mut(at.stamp) {
            Some(known) => *known = at,
            None => self.boxes.push(at),
        }
    }
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
