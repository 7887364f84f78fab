//! How far a part of the picture went, by trying every shift of a small picture.

use realnet_vision::{PatchSearch, Pyramid};

/// Sides of a patch, pixels of the small picture.
const LEAST_SIDE: u32 = 5;
/// The largest shift looked for, as a share of the picture's side.
const REACH: f32 = 0.3;
/// Correlation below which two patches are not the same.
const LEAST_SCORE: f32 = 0.6;

/// Finds one shift for a cloud of points.
#[derive(Clone, Debug, Default)]
pub(super) struct ShiftSearch {
    search: PatchSearch,
    patch: Vec<u8>,
}

impl ShiftSearch {
    /// The shift, in pixels, of the surroundings of `points` from `then` to `now`.
    /// `None` when nothing is similar enough.
    pub(super) fn run(
        &mut self,
        then: &Pyramid,
        now: &Pyramid,
        points: &[[f32; 2]],
    ) -> Option<[f32; 2]> {
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for point in points {
            for i in 0..2 {
                low[i] = low[i].min(point[i]);
                high[i] = high[i].max(point[i]);
            }
        }
        // The smallest level on which the patch has pixels enough.
        let levels = then.levels().iter().zip(now.levels()).enumerate().rev();
        for (index, (then, now)) in levels {
            let scale = 1.0 / (1_u32 << index) as f32;
            let (width, height) = (then.width(), then.height());
            // A patch of the whole picture would have nowhere to go: its middle.
            let side = |i: usize, size: u32| {
                let reach = size as f32 * REACH;
                let start = (low[i] * scale).max(reach * 0.5).max(0.0);
                let end = (high[i] * scale + 1.0).min(size as f32 - reach * 0.5);
                (start as u32, (end - start).max(0.0) as u32, reach as u32)
            };
            let ((x, columns, reach_x), (y, rows, reach_y)) = (side(0, width), side(1, height));
            if columns < LEAST_SIDE || rows < LEAST_SIDE {
                continue;
            }
            self.patch.clear();
            for y in y..y + rows {
                let row = then.row(y)?.get(x as usize..(x + columns) as usize)?;
                self.patch.extend_from_slice(row);
            }
            let origin = (x as i32 - reach_x as i32, y as i32 - reach_y as i32);
            let positions = (2 * reach_x + 1, 2 * reach_y + 1);
            let scores =
                self.search.run(&self.patch, (columns, rows), now, origin, positions).ok()?;
            let ((best_x, best_y), score) = scores.best();
            return (score >= LEAST_SCORE)
                .then(|| [(best_x - x as i32) as f32 / scale, (best_y - y as i32) as f32 / scale]);
        }
        None
    }
}
