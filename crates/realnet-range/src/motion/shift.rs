//! How far a part of the picture went, by trying every shift of a small picture.

use realnet_core::Frame;
use realnet_vision::{Level, PatchSearch, Pyramid, Window};

/// Sides of a patch, pixels of the small picture.
const LEAST_SIDE: u32 = 5;
/// Longer side of the smallest picture searched.
const LEAST_PICTURE: u32 = 60;
/// The largest shift looked for, as a share of the picture's side.
const REACH: f32 = 0.45;
/// Correlation below which two patches are not the same.
const LEAST_SCORE: f32 = 0.7;
/// A body wider than this share of the picture is searched for in parts, since a
/// shift takes a part of it out of the picture.
const WHOLE: f32 = 0.5;
/// The most multiplications of one patch: beyond, as when a flat body is only found on a
/// large picture, nothing is looked for.
const MOST_WORK: u64 = 1 << 25;

/// Finds one shift for a cloud of points.
#[derive(Clone, Debug)]
pub(super) struct ShiftSearch {
    search: PatchSearch,
    patch: Vec<u8>,
    /// Levels above those that flow has, so that the cost does not grow with the
    /// picture: the square of its pixels otherwise.
    small: [Small; 2],
}

/// The top level of a pyramid, halved further.
#[derive(Clone, Debug)]
struct Small {
    pixels: Vec<u8>,
    pyramid: Pyramid,
}

impl Small {
    fn build(&mut self, of: &Pyramid) -> Option<()> {
        let top = of.levels().last()?;
        self.pixels.clear();
        for y in 0..top.height() {
            self.pixels.extend_from_slice(top.row(y)?);
        }
        let pixels = std::mem::take(&mut self.pixels);
        let frame = Frame::grey8(of.stamp(), top.width(), top.height(), pixels).ok()?;
        self.pyramid.build(&frame);
        self.pixels = frame.into_data();
        Some(())
    }
}

impl Default for ShiftSearch {
    fn default() -> Self {
        let pyramid = || Pyramid::new(Pyramid::MAX_LEVEL, Window::default());
        let small = || Small { pixels: Vec::new(), pyramid: pyramid() };
        Self { search: PatchSearch::default(), patch: Vec::new(), small: [small(), small()] }
    }
}

/// First pixel and number of pixels.
type Span = (u32, u32);

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
        let Self { search, patch, small } = self;
        for (small, of) in small.iter_mut().zip([then, now]) {
            small.build(of)?;
        }
        // The smallest level on which the body has pixels enough.
        let top = then.levels().len().saturating_sub(1);
        let [small_then, small_now] = small;
        // The first of the small ones is the top of the others.
        let level = |index: usize| match index.checked_sub(top) {
            None => Some((then.levels().get(index)?, now.levels().get(index)?)),
            Some(i) => {
                Some((small_then.pyramid.levels().get(i)?, small_now.pyramid.levels().get(i)?))
            }
        };
        for index in (0..top + small_then.pyramid.levels().len()).rev() {
            let Some((then, now)) = level(index) else { continue };
            if index > 0 && then.width().max(then.height()) < LEAST_PICTURE {
                continue;
            }
            let scale = 1.0 / (1_u32 << index) as f32;
            let span = |i: usize, size: u32| -> Span {
                let start = (low[i] * scale).max(0.0) as u32;
                let end = ((high[i] * scale).max(0.0) as u32 + 1).min(size);
                (start, end.saturating_sub(start))
            };
            let (columns, rows) = (span(0, then.width()), span(1, then.height()));
            if columns.1 < LEAST_SIDE || rows.1 < LEAST_SIDE {
                continue;
            }
            let mut best: Option<([f32; 2], f32)> = None;
            for rows in parts(rows, then.height()).into_iter().flatten() {
                for columns in parts(columns, then.width()).into_iter().flatten() {
                    let found = part(search, patch, then, now, columns, rows);
                    if let Some((shift, score)) = found
                        && best.is_none_or(|best| score > best.1)
                    {
                        best = Some((shift.map(|s| s / scale), score));
                    }
                }
            }
            return best.filter(|(_, score)| *score >= LEAST_SCORE).map(|(shift, _)| shift);
        }
        None
    }
}

/// The best shift of one patch, in pixels of the level, and its score.
fn part(
    search: &mut PatchSearch,
    patch: &mut Vec<u8>,
    then: &Level,
    now: &Level,
    (x, columns): Span,
    (y, rows): Span,
) -> Option<([f32; 2], f32)> {
    patch.clear();
    for y in y..y + rows {
        patch.extend_from_slice(then.row(y)?.get(x as usize..(x + columns) as usize)?);
    }
    let reach = |size: u32| (size as f32 * REACH) as i32;
    let (reach_x, reach_y) = (reach(then.width()), reach(then.height()));
    // Only where the whole patch is inside the picture.
    let range = |start: u32, length: u32, size: u32, reach: i32| {
        let first = (start as i32 - reach).max(0);
        let last = (start as i32 + reach).min(size as i32 - length as i32);
        (first, u32::try_from(last - first + 1).unwrap_or(0))
    };
    let (first_x, count_x) = range(x, columns, then.width(), reach_x);
    let (first_y, count_y) = range(y, rows, then.height(), reach_y);
    let positions = u64::from(count_x) * u64::from(count_y);
    if positions.saturating_mul(patch.len() as u64) > MOST_WORK {
        return None;
    }
    let origin = (first_x, first_y);
    let scores = search.run(patch, (columns, rows), now, origin, (count_x, count_y)).ok()?;
    let ((best_x, best_y), score) = scores.best();
    Some(([(best_x - x as i32) as f32, (best_y - y as i32) as f32], score))
}

/// The span itself, or three parts of it when it is large.
fn parts((start, length): Span, size: u32) -> [Option<Span>; 3] {
    let part = length * 2 / 5;
    if (length as f32) < WHOLE * size as f32 || part < LEAST_SIDE {
        return [Some((start, length)), None, None];
    }
    [0, (length - part) / 2, length - part].map(|offset| Some((start + offset, part)))
}
