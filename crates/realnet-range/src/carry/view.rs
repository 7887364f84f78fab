//! A box at a standard size, whatever its size in the picture.

use super::BoxMotion;
use realnet_core::{BoundingBox, Frame};
use realnet_vision::Pyramid;

/// Pixels of the longer side of the box in a view.
pub(super) const BOX: f32 = 96.0;
/// Pixels of the side of a view.
pub(super) const SIDE: u32 = 120;
/// The middle of a view, where pixel centres are whole numbers.
pub(super) const MIDDLE: f32 = (SIDE - 1) as f32 / 2.0;

/// A square part of a picture: where it is, and how large its pixels are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct View {
    /// Its middle in the picture; pixel centres are whole numbers.
    pub(super) center: [f32; 2],
    /// Pixels of the picture a pixel of the view.
    pub(super) unit: f32,
}

impl View {
    /// The view in which the longer side of `bbox` has `side` pixels.
    pub(super) fn of(bbox: &BoundingBox, side: f32) -> Self {
        let (x, y) = bbox.center();
        Self { center: [x - 0.5, y - 0.5], unit: bbox.width().max(bbox.height()) / side }
    }

    /// The view of the same content in the next picture.
    pub(super) fn moved(&self, motion: BoxMotion) -> Self {
        let [x, y] = self.center;
        let [dx, dy] = motion.shift;
        Self { center: [x + dx, y + dy], unit: self.unit * motion.scale }
    }

    /// A point, relative to the middle of the view, in the picture.
    pub(super) fn to_picture(self, point: [f32; 2]) -> [f32; 2] {
        [0, 1].map(|i| self.center[i] + point[i] * self.unit)
    }
}

/// Resamples parts of pyramids bilinearly.
#[derive(Clone, Debug, Default)]
pub(super) struct Sampler {
    /// The two columns and the weight of the second, 0 to 256, for each pixel of a row.
    columns: Vec<(u32, u32, u32)>,
}

impl Sampler {
    /// The level of `pyramid` whose pixels are closest to `unit` pixels of the
    /// full size without being more than 1.4 times larger.
    pub(super) fn level(pyramid: &Pyramid, unit: f32) -> usize {
        let finest = (unit.max(1.0) * std::f32::consts::SQRT_2).log2() as usize;
        finest.min(pyramid.levels().len().saturating_sub(1))
    }

    /// Fills `out`, `size` pixels, from level `index` of the pyramid. Pixels
    /// outside repeat the picture's edge.
    pub(super) fn fill(
        &mut self,
        pyramid: &Pyramid,
        index: usize,
        view: View,
        size: (u32, u32),
        out: &mut [u8],
    ) {
        let Some(level) = pyramid.levels().get(index) else { return };
        let scale = 1.0 / (1_u32 << index) as f32;
        let (step, [cx, cy]) = (view.unit * scale, view.center.map(|v| v * scale));
        let at = |i: u32, center: f32, size: u32, limit: u32| {
            let position = center + (i as f32 - (size - 1) as f32 / 2.0) * step;
            let position = position.clamp(0.0, (limit - 1) as f32);
            let first = position as u32;
            let weight = ((position - first as f32) * 256.0 + 0.5) as u32;
            (first, (first + 1).min(limit - 1), weight)
        };
        self.columns.clear();
        self.columns.extend((0..size.0).map(|x| at(x, cx, size.0, level.width())));
        for (y, out) in out.chunks_exact_mut(size.0.max(1) as usize).enumerate() {
            let (upper, lower, weight) = at(y as u32, cy, size.1, level.height());
            let (Some(upper), Some(lower)) = (level.row(upper), level.row(lower)) else { continue };
            for (out, &(left, right, across)) in out.iter_mut().zip(&self.columns) {
                let pixel = |row: &[u8], x: u32| row.get(x as usize).copied().map_or(0, u32::from);
                let mix =
                    |row: &[u8]| pixel(row, left) * (256 - across) + pixel(row, right) * across;
                *out =
                    ((mix(upper) * (256 - weight) + mix(lower) * weight + (1 << 15)) >> 16) as u8;
            }
        }
    }

    /// Fills a frame of [`SIDE`] pixels a side.
    pub(super) fn fill_view(
        &mut self,
        pyramid: &Pyramid,
        index: usize,
        view: View,
        out: &mut Frame,
    ) {
        self.fill(pyramid, index, view, (SIDE, SIDE), out.data_mut());
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Scene;
    use super::*;

    #[test]
    fn samples_pixels_and_repeats_the_edge() {
        let (pyramid, _) = Scene::default().draw();
        let full = pyramid.full().unwrap();
        let row = |y: u32| full.row(y).unwrap();
        let mut sampler = Sampler::default();
        let mut out = [0; 15];
        let mut fill = |center, unit| {
            sampler.fill(&pyramid, 0, View { center, unit }, (5, 3), &mut out);
            out
        };
        let same = fill([10.0, 20.0], 1.0);
        for (y, out) in same.chunks_exact(5).enumerate() {
            assert_eq!(out, &row(19 + y as u32)[8..13]);
        }
        let between = fill([10.5, 20.0], 1.0);
        let mean = u32::from(row(20)[10]) + u32::from(row(20)[11]);
        assert!((u32::from(between[7]) * 2).abs_diff(mean) <= 1);
        assert_eq!(fill([-50.0, -50.0], 1.0), [row(0)[0]; 15]);
        assert_eq!(fill([1e9, 1e9], 3.0), [row(full.height() - 1)[full.width() as usize - 1]; 15]);
    }

    #[test]
    fn the_level_goes_with_the_unit() {
        let (pyramid, _) = Scene::default().draw();
        let levels = [0.1, 1.0, 1.4, 1.5, 2.0, 2.9, 1e6].map(|unit| Sampler::level(&pyramid, unit));
        assert_eq!(levels, [0, 0, 0, 1, 1, 2, pyramid.levels().len() - 1]);
    }

    #[test]
    fn a_moved_view_shows_the_moved_box() {
        let bbox = BoundingBox::new(10.0, 20.0, 50.0, 40.0);
        let motion = BoxMotion { shift: [5.0, -2.0], scale: 1.5 };
        let (moved, of_moved) =
            (View::of(&bbox, BOX).moved(motion), View::of(&motion.apply(&bbox), BOX));
        assert_eq!(moved.center, of_moved.center);
        assert!((moved.unit - of_moved.unit).abs() < 1e-6);
        let corner = View::of(&bbox, BOX).to_picture([-BOX / 2.0, -BOX / 4.0]);
        // An edge lies half a pixel before the pixel's centre.
        assert!((corner[0] - 9.5).abs() < 1e-4 && (corner[1] - 19.5).abs() < 1e-4, "{corner:?}");
    }
}
