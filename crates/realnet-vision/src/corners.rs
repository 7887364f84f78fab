//! Corners worth tracking, after Shi and Tomasi.

mod response;

use crate::pyramid::Level;
use crate::simd::Simd;
use crate::{FlowError, Pyramid, Region};
use response::ResponseRows;
use std::cmp::Reverse;

/// A corner of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// x and y in pixels; (0, 0) is the centre of the first pixel.
    pub point: [f32; 2],
    /// The smaller eigenvalue of the gradient's second moments over 3x3 pixels,
    /// in the units of OpenCV's `cornerMinEigenVal` (pixels as 0 to 1).
    pub response: f32,
}

/// What [`CornerDetector`] looks for. The defaults suit 200 corners in a
/// camera picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CornerOptions {
    /// The most corners wanted; 0 for all there are.
    pub max_corners: usize,
    /// Corners must respond more than this share of the picture's best, 0 to 1.
    pub quality_level: f32,
    /// No two corners are closer than this, in pixels; below 1 it is ignored.
    pub min_distance: f32,
    /// Columns and rows of equal cells. The best corners of each cell go first,
    /// up to its fair share `max_corners / cells` (rounded up); what is left is
    /// filled with the best of the rest. (1, 1) is no balancing.
    pub cells: (u32, u32),
}

impl Default for CornerOptions {
    fn default() -> Self {
        Self { max_corners: 200, quality_level: 0.01, min_distance: 10.0, cells: (1, 1) }
    }
}

/// Which pixels may hold corners.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CornerMask {
    width: u32,
    height: u32,
    allowed: Vec<u8>,
}

impl CornerMask {
    /// A mask that allows every pixel, or none.
    #[must_use]
    pub fn new(width: u32, height: u32, allowed: bool) -> Self {
        Self { width, height, allowed: vec![u8::from(allowed); width as usize * height as usize] }
    }

    /// A mask from one byte a pixel, row by row: all but 0 is allowed.
    ///
    /// # Errors
    /// [`FlowError::MaskLength`] when `allowed` is not `width * height` long.
    pub fn from_bytes(width: u32, height: u32, allowed: Vec<u8>) -> Result<Self, FlowError> {
        let (expected, found) = (width as usize * height as usize, allowed.len());
        if expected != found {
            return Err(FlowError::MaskLength { width, height, expected, found });
        }
        Ok(Self { width, height, allowed })
    }

    /// Pixels a row.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Allows or forbids every pixel.
    pub fn fill(&mut self, allowed: bool) {
        self.allowed.fill(u8::from(allowed));
    }

    /// Allows or forbids the part of `region` that lies inside the picture.
    pub fn set(&mut self, region: Region, allowed: bool) {
        let span = |start: u32, length: u32, size: u32| {
            start.min(size) as usize..start.saturating_add(length).min(size) as usize
        };
        let columns = span(region.x, region.width, self.width);
        let rows = span(region.y, region.height, self.height);
        let width = self.width as usize;
        for row in self.allowed.chunks_exact_mut(width.max(1)).take(rows.end).skip(rows.start) {
            row[columns.clone()].fill(u8::from(allowed));
        }
    }

    fn row(&self, y: usize) -> &[u8] {
        &self.allowed[y * self.width as usize..][..self.width as usize]
    }
}

/// A local maximum of the response: its bits (a positive float orders as its
/// bits do) above its position `y * width + x`.
type Candidate = u64;

/// Finds the corners of J. Shi and C. Tomasi, "Good Features to Track", 1994:
/// local maxima (3x3) of the smaller eigenvalue of the gradient's second moments
/// (3x3 Sobel, 3x3 sum), the strongest first, thinned to a minimum distance.
///
/// This is OpenCV's `goodFeaturesToTrack` with `blockSize` 3. Moments are exact
/// integers here and floats there, so responses differ by about 1e-6 of the
/// gradient's energy; the corners are the same but where two responses, or a
/// response and the threshold, are as close as that. Of equal responses the one
/// further down and right goes first, as in OpenCV.
///
/// Keeps its memory: nothing is allocated once it has seen a picture of the same
/// size with as many corners.
#[derive(Clone, Debug)]
pub struct CornerDetector {
    options: CornerOptions,
    rows: ResponseRows,
    candidates: Vec<Candidate>,
    /// Corners a full cell had no room for.
    waiting: Vec<Candidate>,
    /// Corners taken from each balancing cell.
    taken: Vec<usize>,
    thinner: Thinner,
    pub(crate) simd: Simd,
}

impl CornerDetector {
    /// A detector for corners of this kind.
    ///
    /// # Errors
    /// [`FlowError::Option`] when `quality_level` is not in 0 to 1,
    /// `min_distance` is negative or not a number, or there are no cells.
    pub fn new(options: CornerOptions) -> Result<Self, FlowError> {
        let refuse =
            |option, value: String, allowed| Err(FlowError::Option { option, value, allowed });
        if !(0.0..=1.0).contains(&options.quality_level) {
            return refuse("quality_level", options.quality_level.to_string(), "0 to 1");
        }
        if !(0.0..=1e6).contains(&options.min_distance) {
            return refuse("min_distance", options.min_distance.to_string(), "0 to 1e6 pixels");
        }
        let (columns, rows) = options.cells;
        if columns == 0 || rows == 0 || columns > 1000 || rows > 1000 {
            return refuse("cells", format!("{columns}x{rows}"), "1x1 to 1000x1000");
        }
        Ok(Self {
            options,
            rows: ResponseRows::default(),
            candidates: Vec::new(),
            waiting: Vec::new(),
            taken: Vec::new(),
            thinner: Thinner::default(),
            simd: Simd::best(),
        })
    }

    /// What it looks for.
    #[must_use]
    pub fn options(&self) -> CornerOptions {
        self.options
    }

    /// Replaces the content of `corners` by the corners of the pyramid's
    /// full-size level, the strongest first. With a mask, both the corners and
    /// the best response that `quality_level` refers to are those of the allowed
    /// pixels. The outermost pixels never hold corners.
    ///
    /// # Errors
    /// [`FlowError::NoPicture`] when the pyramid is empty,
    /// [`FlowError::MaskSize`] when the mask is of another size.
    pub fn detect(
        &mut self,
        pyramid: &Pyramid,
        mask: Option<&CornerMask>,
        corners: &mut Vec<Corner>,
    ) -> Result<(), FlowError> {
        let level = pyramid.full()?;
        let (width, height) = (level.width(), level.height());
        if let Some(mask) = mask.filter(|m| (m.width, m.height) != (width, height)) {
            return Err(FlowError::MaskSize { mask: (mask.width, mask.height), width, height });
        }
        corners.clear();
        self.collect(level, mask);
        self.select(level, corners);
        Ok(())
    }

    /// Local maxima above the threshold, in no order.
    fn collect(&mut self, level: &Level, mask: Option<&CornerMask>) {
        let (width, height) = (level.width() as usize, level.height() as usize);
        let quality = f64::from(self.options.quality_level);
        let threshold = |best: u32| (f64::from(f32::from_bits(best)) * quality) as f32;
        self.candidates.clear();
        self.rows.start(width);
        let mut best = 0;
        for y in 0..height {
            let row_best = self.rows.advance(self.simd, level, y, mask.map(|m| m.row(y)));
            best = best.max(row_best);
            if y < 2 {
                continue;
            }
            // The threshold can only rise: what is below it now stays below it.
            let (bits, start) = (threshold(best).to_bits(), (y - 1) * width);
            let candidates = &mut self.candidates;
            self.rows.maxima(self.simd, y - 1, bits, mask.map(|m| m.row(y - 1)), |x, value| {
                candidates.push(u64::from(value) << 32 | (start + x) as u64);
            });
        }
        let least = threshold(best).to_bits();
        self.candidates.retain(|&c| (c >> 32) as u32 > least);
    }

    /// The strongest candidates that keep their distance.
    fn select(&mut self, level: &Level, corners: &mut Vec<Corner>) {
        let (width, height) = (level.width() as usize, level.height() as usize);
        let Self { options, candidates, waiting, taken, thinner, .. } = self;
        let wanted = if options.max_corners == 0 { usize::MAX } else { options.max_corners };
        let (columns, rows) = (options.cells.0 as usize, options.cells.1 as usize);
        let share = if columns * rows == 1 { wanted } else { wanted.div_ceil(columns * rows) };
        thinner.start(width, height, options.min_distance);
        taken.clear();
        taken.resize(columns * rows, 0);
        waiting.clear();
        let mut take = |candidate: Candidate, corners: &mut Vec<Corner>| {
            let at = candidate as u32 as usize;
            let (x, y) = (at % width, at / width);
            if thinner.admit(x as i32, y as i32) {
                let response = f32::from_bits((candidate >> 32) as u32) * response::UNIT;
                corners.push(Corner { point: [x as f32, y as f32], response });
                return true;
            }
            false
        };

        let mut rest = candidates.as_mut_slice();
        let mut chunk = wanted.saturating_mul(2).clamp(64, 4096);
        'all: while !rest.is_empty() {
            // Only as many as are needed are put in order.
            let (head, tail) = split_strongest(rest, chunk);
            for &mut candidate in head {
                if corners.len() >= wanted {
                    break 'all;
                }
                let at = candidate as u32 as usize;
                let cell = (at / width * rows / height) * columns + at % width * columns / width;
                if taken[cell] >= share {
                    waiting.push(candidate);
                } else if take(candidate, corners) {
                    taken[cell] += 1;
                }
            }
            rest = tail;
            chunk = chunk.saturating_mul(2);
        }
        if share < wanted {
            for &candidate in &*waiting {
                if corners.len() >= wanted {
                    break;
                }
                take(candidate, corners);
            }
            corners.sort_unstable_by_key(|c| {
                Reverse((c.response.to_bits(), c.point[1] as u32, c.point[0] as u32))
            });
        }
    }
}

/// Splits off the `count` greatest, in descending order.
fn split_strongest(
    candidates: &mut [Candidate],
    count: usize,
) -> (&mut [Candidate], &mut [Candidate]) {
    if count < candidates.len() {
        candidates.select_nth_unstable_by(count, |a, b| b.cmp(a));
    }
    let (head, tail) = candidates.split_at_mut(count.min(candidates.len()));
    head.sort_unstable_by(|a, b| b.cmp(a));
    (head, tail)
}

/// Keeps points a distance apart, by a grid of cells with lists of points.
#[derive(Clone, Debug, Default)]
struct Thinner {
    /// Smallest squared distance; 0 admits everything.
    square: f32,
    cell: usize,
    columns: usize,
    rows: usize,
    /// First point of each cell, by index + 1; 0 is none.
    first: Vec<u32>,
    /// x, y and the next point of the same cell.
    points: Vec<(i32, i32, u32)>,
}

impl Thinner {
    fn start(&mut self, width: usize, height: usize, distance: f32) {
        self.points.clear();
        self.square = if distance >= 1.0 { distance * distance } else { 0.0 };
        self.cell = (distance.round_ties_even() as usize).max(1);
        if self.square > 0.0 {
            self.columns = width.div_ceil(self.cell);
            self.rows = height.div_ceil(self.cell);
            self.first.clear();
            self.first.resize(self.columns * self.rows, 0);
        }
    }

    /// Whether no admitted point is too close; then it is admitted.
    fn admit(&mut self, x: i32, y: i32) -> bool {
        if self.square == 0.0 {
            return true;
        }
        let (column, row) = (x as usize / self.cell, y as usize / self.cell);
        // A cell may be up to half a pixel smaller than the distance, as in OpenCV:
        // whole pixels that far apart are still seen.
        for row in row.saturating_sub(1)..=(row + 1).min(self.rows - 1) {
            for column in column.saturating_sub(1)..=(column + 1).min(self.columns - 1) {
                let mut next = self.first[row * self.columns + column];
                while let Some(&(px, py, after)) = self.points.get((next as usize).wrapping_sub(1))
                {
                    let (dx, dy) = ((px - x) as f32, (py - y) as f32);
                    if dx * dx + dy * dy < self.square {
                        return false;
                    }
                    next = after;
                }
            }
        }
        let cell = &mut self.first[row * self.columns + column];
        self.points.push((x, y, *cell));
        *cell = self.points.len() as u32;
        true
    }
}

#[cfg(test)]
mod tests;
