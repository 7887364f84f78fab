//! Where the box could be, by its looks alone.

use super::view::{Sampler, View};
use super::{BoxMotion, SearchOptions};
use realnet_core::{BoundingBox, Frame, Stamp};
use realnet_vision::{PatchSearch, Pyramid, Window};

/// Pixels of the patch that is searched for.
const AREA: f32 = 400.0;
/// Positions to each side at most; the patch of a long, thin box has fewer pixels.
const RADIUS: f32 = 80.0;
/// Two places closer than this share of the box's longer side are one.
const APART: f32 = 0.3;
/// Places looked at.
pub(super) const PLACES: usize = 3;

/// A place the box could have gone to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    pub(super) motion: BoxMotion,
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

    /// The best places around the prediction, the best first, at most [`PLACES`].
    pub(super) fn run(
        &mut self,
        (from, to): (&Pyramid, &Pyramid),
        bbox: &BoundingBox,
        prediction: BoxMotion,
        options: &SearchOptions,
    ) -> &[Place] {
        self.found.clear();
        let side = bbox.width().max(bbox.height());
        let sides = [bbox.width(), bbox.height()];
        let unit = (bbox.area() / AREA).sqrt().max(options.radius * side / RADIUS);
        let view = View { unit, ..View::of(bbox, 1.0) };
        let grid = Grid {
            view,
            level: Sampler::level(from, unit),
            radius: (options.radius * side / unit).ceil().clamp(1.0, RADIUS) as u32,
            half: sides.map(|side| (side * options.scales.1 / unit / 2.0).ceil() as u32 + 1),
            sides,
            prediction: prediction.shift,
        };
        let [width, height] = grid.half.map(|half| 2 * (grid.radius + half) + 1);
        self.area.clear();
        self.area.resize((width * height) as usize, 0);
        let there = view.moved(BoxMotion { scale: 1.0, ..prediction });
        self.sampler.fill(to, grid.level, there, (width, height), &mut self.area);
        let area = std::mem::take(&mut self.area);
        let Ok(frame) = Frame::grey8(Stamp::ZERO, width, height, area) else { return &[] };
        self.picture.build(&frame);
        self.area = frame.into_data();

        for scale in options.ladder() {
            self.at_scale(from, &grid, scale);
        }
        self.found.sort_unstable_by(|a, b| b.score.total_cmp(&a.score));
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

    /// Adds the best places at one size to those found.
    fn at_scale(&mut self, from: &Pyramid, grid: &Grid, scale: f32) {
        let unit = grid.view.unit;
        // Odd, so that the patch's pixels lie where the small picture's do.
        let size = grid.sides.map(|side| 2 * (side * scale / unit / 2.0) as u32 + 1);
        self.patch.clear();
        self.patch.resize((size[0] * size[1]) as usize, 0);
        let view = View { unit: unit / scale, ..grid.view };
        self.sampler.fill(from, grid.level, view, (size[0], size[1]), &mut self.patch);
        let Ok(picture) = self.picture.full() else { return };
        let [x, y] = [0, 1].map(|i| grid.half[i] as i32 - size[i] as i32 / 2);
        let count = 2 * grid.radius + 1;
        let searched =
            self.search.run(&self.patch, (size[0], size[1]), picture, (x, y), (count, count));
        let Ok(scores) = searched else { return };

        let apart = APART * grid.sides[0].max(grid.sides[1]) / unit;
        let middle = grid.radius as f32;
        let mut peaks = [(0.0, 0.0); PLACES];
        for count in 0..PLACES {
            let (mut best, mut best_score) = ((0.0, 0.0), 0.0);
            for (y, row) in scores.rows().enumerate() {
                for (x, &score) in row.iter().enumerate() {
                    if score > best_score {
                        let (x, y) = (x as f32, y as f32);
                        let near = |p: &(f32, f32)| (p.0 - x).hypot(p.1 - y) < apart;
                        if !peaks[..count].iter().any(near) {
                            (best, best_score) = ((x, y), score);
                        }
                    }
                }
            }
            if best_score <= 0.0 {
                break;
            }
            peaks[count] = best;
            let [dx, dy] = grid.prediction;
            let shift = [dx + (best.0 - middle) * unit, dy + (best.1 - middle) * unit];
            self.found.push(Place { motion: BoxMotion { shift, scale }, score: best_score });
        }
    }
}

/// Where a patch is looked for.
#[derive(Clone, Copy, Debug)]
struct Grid {
    /// The small picture around the box; its unit is that of all of them.
    view: View,
    level: usize,
    /// Positions of the patch's middle to each side.
    radius: u32,
    /// Pixels around them: half of the largest patch.
    half: [u32; 2],
    /// Width and height of the box.
    sides: [f32; 2],
    /// The predicted shift: the middle of the positions.
    prediction: [f32; 2],
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Scene, TARGET};
    use super::*;

    #[test]
    fn finds_a_target_far_away_and_of_another_size() {
        let (from, bbox) = Scene::default().draw();
        let scene = Scene { center: [230.0, 95.0], scale: 1.3, ..Scene::default() };
        let (to, truth) = scene.draw();
        let mut search = CoarseSearch::new();
        let options = SearchOptions::default();
        let places = search.run((&from, &to), &bbox, BoxMotion::NONE, &options);
        let best = places[0];
        assert!(best.motion.apply(&bbox).iou(&truth) > 0.7, "{best:?}");
        assert!(best.score > 0.7 && places.is_sorted_by(|a, b| a.score >= b.score), "{places:?}");
        for (i, a) in places.iter().enumerate() {
            for b in &places[..i] {
                let [dx, dy] = [0, 1].map(|k| a.motion.shift[k] - b.motion.shift[k]);
                assert!(dx.hypot(dy) >= APART * TARGET[0], "{a:?} {b:?}");
            }
        }
        // Within the radius of a prediction on the other side there is nothing.
        let wrong = BoxMotion { shift: [-100.0, 0.0], scale: 1.0 };
        let near = SearchOptions { radius: 0.5, ..options };
        let places = search.run((&from, &to), &bbox, wrong, &near);
        assert!(places.iter().all(|place| place.score < best.score - 0.1), "{places:?}");
    }

    #[test]
    fn the_same_place_scores_one() {
        let (from, bbox) = Scene::default().draw();
        let mut search = CoarseSearch::new();
        let options = SearchOptions { steps: 1, ..SearchOptions::default() };
        let best = search.run((&from, &from), &bbox, BoxMotion::NONE, &options)[0];
        assert!(best.score > 0.999 && best.motion.scale == 1.0, "{best:?}");
        assert!(best.motion.shift.iter().all(|v| v.abs() < 1.0), "{best:?}");
    }

    #[test]
    fn a_thin_box_stays_affordable() {
        let (from, _) = Scene::default().draw();
        let bbox = BoundingBox::new(10.0, 100.0, 310.0, 108.0);
        let mut search = CoarseSearch::new();
        let options = SearchOptions { radius: 4.0, ..SearchOptions::default() };
        search.run((&from, &from), &bbox, BoxMotion::NONE, &options);
        assert!(search.area.len() < 100_000, "{}", search.area.len());
    }
}
