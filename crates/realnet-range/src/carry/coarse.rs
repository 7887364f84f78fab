//! Where the box could be, by its looks alone.

use super::view::{Sampler, View};
use super::{Motion, SearchOptions};
use realnet_core::{BoundingBox, Frame, Stamp};
use realnet_vision::{PatchSearch, Pyramid, Window};

/// Pixels of the patch that is searched for.
const AREA: f32 = 400.0;
/// The patch is the box enlarged by this share of each side, at each side.
const MARGIN: f32 = 0.1;
/// Two places closer than this share of the box's longer side are one.
const APART: f32 = 0.3;
/// Places looked at.
pub(super) const PLACES: usize = 3;

/// A place the box could have gone to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    pub(super) motion: Motion,
    pub(super) score: f32,
}

/// Exhaustive search over places and sizes, in pictures so small that the box has
/// [`AREA`] pixels: the cost does not depend on the size of box or picture.
#[derive(Clone, Debug)]
pub(super) struct CoarseSearch {
    search: PatchSearch,
    sampler: Sampler,
    patch: Vec<u8>,
    area: Vec<u8>,
    picture: Pyramid,
    found: Vec<Place>,
}

impl CoarseSearch {
    pub(super) fn new() -> Self {
        Self {
            search: PatchSearch::new(),
            sampler: Sampler::default(),
            patch: Vec::new(),
            area: Vec::new(),
            picture: Pyramid::new(0, Window::default()),
            found: Vec::new(),
        }
    }

    /// The best places around `center`, the best first, at most [`PLACES`].
    pub(super) fn run(
        &mut self,
        (from, to): (&Pyramid, &Pyramid),
        bbox: &BoundingBox,
        prediction: Motion,
        options: &SearchOptions,
    ) -> &[Place] {
        self.found.clear();
        let enlarge = 1.0 + 2.0 * MARGIN;
        let unit = (bbox.width() * bbox.height() * enlarge * enlarge / AREA).sqrt();
        let side = bbox.width().max(bbox.height());
        let here = View { unit, ..View::of(bbox, 1.0) };
        let level = Sampler::level(from, unit);
        let there = here.moved(Motion { scale: 1.0, ..prediction });

        // Positions of the patch's middle: `radius` pixels of the small picture to
        // each side; around them half of the largest patch.
        let radius = (options.radius * side / unit).ceil().clamp(1.0, 500.0) as u32;
        let half =
            |length: f32| (length * enlarge * options.scales.1 / unit / 2.0).ceil() as u32 + 1;
        let (half_width, half_height) = (half(bbox.width()), half(bbox.height()));
        let size = (2 * (radius + half_width) + 1, 2 * (radius + half_height) + 1);
        self.area.clear();
        self.area.resize((size.0 * size.1) as usize, 0);
        self.sampler.fill(to, level, there, size, &mut self.area);
        let area = std::mem::take(&mut self.area);
        let Ok(frame) = Frame::grey8(Stamp::ZERO, size.0, size.1, area) else { return &[] };
        self.picture.build(&frame);
        self.area = frame.into_data();

        for scale in options.ladder() {
            self.at_scale(
                from,
                (bbox, here, level),
                scale,
                (radius, half_width, half_height),
                prediction,
            );
        }
        self.found.sort_by(|a, b| b.score.total_cmp(&a.score));
        // Keep the best of places that are close together.
        let mut kept = 0;
        for i in 0..self.found.len() {
            let place = self.found[i];
            let near = |other: &Place| {
                let [dx, dy] = [0, 1].map(|k| other.motion.shift[k] - place.motion.shift[k]);
                dx.hypot(dy) < APART * side
            };
            if kept < PLACES && !self.found[..kept].iter().any(near) {
                self.found[kept] = place;
                kept += 1;
            }
        }
        self.found.truncate(kept);
        &self.found
    }

    fn at_scale(
        &mut self,
        from: &Pyramid,
        (bbox, here, level): (&BoundingBox, View, usize),
        scale: f32,
        (radius, half_width, half_height): (u32, u32, u32),
        prediction: Motion,
    ) {
        let enlarge = 1.0 + 2.0 * MARGIN;
        let length = |length: f32| ((length * enlarge * scale / here.unit).round() as u32).max(2);
        let patch_size = (length(bbox.width()), length(bbox.height()));
        self.patch.clear();
        self.patch.resize((patch_size.0 * patch_size.1) as usize, 0);
        let view = View { unit: here.unit / scale, ..here };
        self.sampler.fill(from, level, view, patch_size, &mut self.patch);
        let Ok(picture) = self.picture.full() else { return };
        // The middle of the small picture is pixel radius + half.
        let origin = (
            half_width as i32 - patch_size.0 as i32 / 2,
            half_height as i32 - patch_size.1 as i32 / 2,
        );
        let positions = (2 * radius + 1, 2 * radius + 1);
        let Ok(scores) = self.search.run(&self.patch, patch_size, picture, origin, positions)
        else {
            return;
        };
        // An even patch has its middle half a pixel before the pixel counted as such.
        let middle = [patch_size.0, patch_size.1].map(|n| if n % 2 == 0 { 0.5 } else { 0.0 });
        let apart = APART * bbox.width().max(bbox.height()) / here.unit;
        let mut peaks: [(f32, f32, f32); PLACES] = [(0.0, 0.0, 0.0); PLACES];
        for count in 0..PLACES {
            let mut best = (0.0, 0.0, 0.0);
            for (y, row) in scores.rows().enumerate() {
                for (x, &score) in row.iter().enumerate() {
                    if score > best.2 {
                        let (x, y) = (x as f32, y as f32);
                        let near = |p: &(f32, f32, f32)| (p.0 - x).hypot(p.1 - y) < apart;
                        if !peaks[..count].iter().any(near) {
                            best = (x, y, score);
                        }
                    }
                }
            }
            if best.2 <= 0.0 {
                break;
            }
            peaks[count] = best;
            let offset =
                [best.0 - middle[0], best.1 - middle[1]].map(|v| (v - radius as f32) * here.unit);
            let shift = [0, 1].map(|i| prediction.shift[i] + offset[i]);
            self.found.push(Place { motion: Motion { shift, scale }, score: best.2 });
        }
    }
}
