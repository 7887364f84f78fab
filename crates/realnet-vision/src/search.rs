//! Where a patch lies in a picture, by trying every position.

use crate::pyramid::Level;
use crate::simd::{Simd, multiversion};
use thiserror::Error;

/// Why a patch could not be searched for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum SearchError {
    /// The patch has no pixel, more than [`PatchSearch::MAX_AREA`], or a number of
    /// bytes that does not fit its size.
    #[error(
        "a patch of {width}x{height} pixels from {found} bytes, at most {} pixels",
        PatchSearch::MAX_AREA
    )]
    Patch {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes given.
        found: usize,
    },
    /// There is no position to try, or more than [`PatchSearch::MAX_POSITIONS`] in
    /// one direction.
    #[error(
        "{columns}x{rows} positions to try, 1 to {} in each direction",
        PatchSearch::MAX_POSITIONS
    )]
    Positions {
        /// Positions in x.
        columns: u32,
        /// Positions in y.
        rows: u32,
    },
    /// The picture has no pixel.
    #[error("the picture is empty")]
    NoPicture,
}

/// The similarity of a patch to a picture at every position of a rectangle.
#[derive(Clone, Copy, Debug)]
pub struct Scores<'a> {
    scores: &'a [f32],
    columns: usize,
    origin: (i32, i32),
}

impl Scores<'_> {
    /// Positions in x and y.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        (self.columns as u32, (self.scores.len() / self.columns.max(1)) as u32)
    }

    /// The rows of scores, the uppermost first.
    pub fn rows(&self) -> impl Iterator<Item = &[f32]> {
        self.scores.chunks_exact(self.columns.max(1))
    }

    /// The score with the patch's upper left pixel at (x, y) of the picture;
    /// `None` where it was not tried.
    #[must_use]
    pub fn at(&self, x: i32, y: i32) -> Option<f32> {
        let column = usize::try_from(x.checked_sub(self.origin.0)?).ok()?;
        let row = usize::try_from(y.checked_sub(self.origin.1)?).ok()?;
        let inside = column < self.columns;
        inside.then(|| self.scores.get(row * self.columns + column).copied()).flatten()
    }

    /// The best score and the position of the patch's upper left pixel there; of
    /// equal ones the uppermost, then the leftmost.
    #[must_use]
    pub fn best(&self) -> ((i32, i32), f32) {
        let mut best = (0, f32::NEG_INFINITY);
        for (i, &score) in self.scores.iter().enumerate() {
            if score > best.1 {
                best = (i, score);
            }
        }
        let (row, column) = (best.0 / self.columns.max(1), best.0 % self.columns.max(1));
        (
            (self.origin.0.saturating_add(column as i32), self.origin.1.saturating_add(row as i32)),
            best.1,
        )
    }
}

/// Exhaustive search by zero-mean normalised cross-correlation (J. P. Lewis, "Fast
/// normalized cross-correlation", 1995): invariant to brightness and contrast, with
/// the sums over each window of the picture from integral images.
///
/// The cost is positions x patch pixels: meant for the small levels of a
/// [`Pyramid`](crate::Pyramid). Keeps its memory from search to search.
#[derive(Clone, Debug)]
pub struct PatchSearch {
    /// The picture under all positions, its edge pixels repeated outwards.
    area: Vec<f32>,
    /// The patch less its mean.
    patch: Vec<f32>,
    scores: Vec<f32>,
    /// Sums of the pixels, and of their squares, above and left of each.
    integral: Vec<[u32; 2]>,
    pub(crate) simd: Simd,
}

impl Default for PatchSearch {
    fn default() -> Self {
        Self::new()
    }
}

impl PatchSearch {
    /// Pixels of the largest patch: sums of squares over it fit 32 bits.
    pub const MAX_AREA: u32 = 1 << 16;

    /// Positions in one direction.
    pub const MAX_POSITIONS: u32 = 1 << 12;

    /// A search without memory yet.
    #[must_use]
    pub fn new() -> Self {
        let (area, patch, scores, integral) = Default::default();
        Self { area, patch, scores, integral, simd: Simd::best() }
    }

    /// The similarity, -1 to 1, of `patch` (`size` pixels, row by row) to the
    /// window of `picture` of the same size whose upper left pixel is `origin`, and
    /// at the `positions` (columns and rows) to the right of it and below. Windows
    /// may reach outside: the picture's edge pixels are repeated. A flat window, or
    /// any window if the patch is flat, scores 0.
    ///
    /// # Errors
    /// [`SearchError`] when the patch, the positions or the picture are empty, too
    /// large or contradictory.
    pub fn run(
        &mut self,
        patch: &[u8],
        size: (u32, u32),
        picture: &Level,
        origin: (i32, i32),
        positions: (u32, u32),
    ) -> Result<Scores<'_>, SearchError> {
        let (width, height) = size;
        let pixels = width.checked_mul(height).filter(|n| (1..=Self::MAX_AREA).contains(n));
        if pixels.is_none_or(|n| n as usize != patch.len()) {
            return Err(SearchError::Patch { width, height, found: patch.len() });
        }
        let (columns, rows) = positions;
        if [columns, rows].iter().any(|n| !(1..=Self::MAX_POSITIONS).contains(n)) {
            return Err(SearchError::Positions { columns, rows });
        }
        if picture.width() == 0 || picture.height() == 0 {
            return Err(SearchError::NoPicture);
        }
        let (width, height) = (width as usize, height as usize);
        let (columns, rows) = (columns as usize, rows as usize);
        let (area_width, area_height) = (columns + width - 1, rows + height - 1);
        self.copy_area(picture, origin, area_width, area_height);
        let variance = self.centre_patch(patch);

        self.scores.clear();
        self.scores.resize(columns * rows, 0.0);
        for (y, sums) in self.scores.chunks_exact_mut(columns).enumerate() {
            let lines = self.area[y * area_width..].chunks(area_width);
            for (line, taps) in lines.zip(self.patch.chunks_exact(width)) {
                correlate_row(self.simd, line, taps, sums);
            }
        }

        let (stride, n) = (area_width + 1, (width * height) as f64);
        for (y, scores) in self.scores.chunks_exact_mut(columns).enumerate() {
            let upper = &self.integral[y * stride..][..stride];
            let lower = &self.integral[(y + height) * stride..][..stride];
            for (x, score) in scores.iter_mut().enumerate() {
                // Sums wrap around, their differences do not.
                let [sum, squares] = [0, 1].map(|i| {
                    let below = lower[x + width][i].wrapping_sub(lower[x][i]);
                    f64::from(below.wrapping_sub(upper[x + width][i].wrapping_sub(upper[x][i])))
                });
                let spread = (squares - sum * sum / n) * variance;
                // Pixels are whole numbers: a window that is not flat has a spread
                // of at least 1/2.
                *score =
                    if spread > 0.2 { (f64::from(*score) / spread.sqrt()) as f32 } else { 0.0 };
                *score = score.clamp(-1.0, 1.0);
            }
        }
        Ok(Scores { scores: &self.scores, columns, origin })
    }

    fn copy_area(&mut self, picture: &Level, origin: (i32, i32), width: usize, height: usize) {
        let last = (i64::from(picture.width()) - 1, i64::from(picture.height()) - 1);
        let Self { area, integral, .. } = self;
        area.clear();
        integral.clear();
        integral.resize(width + 1, [0; 2]);
        for y in 0..height as i64 {
            let y = (i64::from(origin.1) + y).clamp(0, last.1);
            let row = picture.row(y as u32).unwrap_or_default();
            let mut sums = [0_u32; 2];
            integral.push(sums);
            for x in 0..width as i64 {
                let x = (i64::from(origin.0) + x).clamp(0, last.0);
                let pixel = u32::from(row[x as usize]);
                area.push(pixel as f32);
                sums[0] = sums[0].wrapping_add(pixel);
                sums[1] = sums[1].wrapping_add(pixel * pixel);
                let above = integral[integral.len() - width - 1];
                integral.push([above[0].wrapping_add(sums[0]), above[1].wrapping_add(sums[1])]);
            }
        }
    }

    /// Takes the patch less its mean; returns the sum of its squares then.
    fn centre_patch(&mut self, patch: &[u8]) -> f64 {
        let sum: u32 = patch.iter().map(|&p| u32::from(p)).sum();
        let mean = f64::from(sum) / patch.len() as f64;
        self.patch.clear();
        self.patch.extend(patch.iter().map(|&p| (f64::from(p) - mean) as f32));
        patch.iter().map(|&p| (f64::from(p) - mean).powi(2)).sum()
    }
}

multiversion! {
    /// Adds the correlation of `row` with `taps` to `sums`, one for each position.
    /// Each sum adds its products in the same order for every instruction set.
    fn correlate_row(row: &[f32], taps: &[f32], sums: &mut [f32]) {
        let n = sums.len();
        let (blocks, rest) = taps.as_chunks::<8>();
        let mut start = 0;
        for taps in blocks {
            let row = &row[start..][..n + 7];
            for x in 0..n {
                let mut sum = sums[x];
                for k in 0..8 {
                    sum += taps[k] * row[x + k];
                }
                sums[x] = sum;
            }
            start += 8;
        }
        for &tap in rest {
            let row = &row[start..][..n];
            for x in 0..n {
                sums[x] += tap * row[x];
            }
            start += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::noise;
    use crate::{Pyramid, Window};
    use proptest::prelude::*;

    fn pyramid(width: u32, height: u32, seed: u32) -> Pyramid {
        let mut pyramid = Pyramid::new(0, Window::default());
        pyramid.build(&noise(width, height, 1, seed));
        pyramid
    }

    fn cut(level: &Level, (x0, y0): (i32, i32), (w, h): (u32, u32)) -> Vec<u8> {
        let (right, bottom) = (level.width() as i32 - 1, level.height() as i32 - 1);
        let pixel = |x: i32, y: i32| {
            level.row(y.clamp(0, bottom) as u32).unwrap()[x.clamp(0, right) as usize]
        };
        (0..h as i32)
            .flat_map(|y| (0..w as i32).map(move |x| (x, y)))
            .map(|(x, y)| pixel(x0 + x, y0 + y))
            .collect()
    }

    /// The definition, in f64.
    fn similarity(a: &[u8], b: &[u8]) -> f64 {
        let mean = |v: &[u8]| v.iter().map(|&p| f64::from(p)).sum::<f64>() / v.len() as f64;
        let (ma, mb) = (mean(a), mean(b));
        let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
            a.iter().zip(b).map(|(&a, &b)| f(f64::from(a) - ma, f64::from(b) - mb)).sum()
        };
        let spread = sum(&|a, _| a * a) * sum(&|_, b| b * b);
        if spread > 1e-6 { sum(&|a, b| a * b) / spread.sqrt() } else { 0.0 }
    }

    #[test]
    fn finds_a_patch_in_spite_of_brightness_and_contrast() {
        let pyramid = pyramid(60, 50, 7);
        let level = pyramid.full().unwrap();
        let patch: Vec<u8> = cut(level, (31, 12), (9, 14)).iter().map(|p| 20 + p / 2).collect();
        let mut search = PatchSearch::new();
        let scores = search.run(&patch, (9, 14), level, (-3, -2), (55, 45)).unwrap();
        let (at, score) = scores.best();
        assert_eq!(at, (31, 12));
        assert!(score > 0.999, "{score}");
        assert_eq!(scores.at(31, 12), Some(score));
        assert_eq!((scores.at(-4, 0), scores.at(52, 0), scores.at(0, 43)), (None, None, None));
        assert_eq!((scores.size(), scores.rows().count()), ((55, 45), 45));
    }

    #[test]
    fn flat_windows_score_nothing() {
        let pyramid = pyramid(20, 20, 3);
        let level = pyramid.full().unwrap();
        let mut search = PatchSearch::new();
        let scores = search.run(&[7; 25], (5, 5), level, (0, 0), (3, 3)).unwrap();
        assert_eq!(scores.best(), ((0, 0), 0.0));
        // Far outside every window is one repeated pixel.
        let patch = cut(level, (0, 0), (5, 5));
        let scores = search.run(&patch, (5, 5), level, (-90, -90), (2, 2)).unwrap();
        assert_eq!(scores.best(), ((-90, -90), 0.0));
    }

    #[test]
    fn refuses_contradictions() {
        let pyramid = pyramid(20, 20, 3);
        let level = pyramid.full().unwrap();
        let mut search = PatchSearch::new();
        let mut error = |patch: &[u8], size, positions| {
            search.run(patch, size, level, (0, 0), positions).unwrap_err().to_string()
        };
        assert!(error(&[], (0, 5), (1, 1)).contains("0x5 pixels from 0 bytes"));
        assert!(error(&[1; 24], (5, 5), (1, 1)).contains("5x5 pixels from 24 bytes"));
        assert!(error(&[1; 25], (5, 5), (0, 1)).contains("0x1 positions"));
        assert!(error(&[], (1 << 16, 1 << 16), (1, 1)).contains("at most 65536"));
        let none = search.run(&[1], (1, 1), &Level::default(), (0, 0), (1, 1));
        assert_eq!(none.unwrap_err(), SearchError::NoPicture);
    }

    proptest! {
        /// Every score against the definition, the same for every instruction set.
        #[test]
        fn scores_follow_the_definition(
            (w, h) in (1u32..20, 1u32..9), (x, y) in (-12i32..30, -12i32..30),
            (columns, rows) in (1u32..24, 1u32..6), seed in any::<u32>(),
        ) {
            let pyramid = pyramid(33, 26, seed);
            let level = pyramid.full().unwrap();
            let patch = cut(level, (4, 5), (w, h));
            let mut first: Option<Vec<f32>> = None;
            for &simd in Simd::found() {
                let mut search = PatchSearch { simd, ..PatchSearch::new() };
                let scores = search.run(&patch, (w, h), level, (x, y), (columns, rows)).unwrap();
                for j in 0..rows as i32 {
                    for i in 0..columns as i32 {
                        let expected = similarity(&patch, &cut(level, (x + i, y + j), (w, h)));
                        let found = f64::from(scores.at(x + i, y + j).unwrap());
                        prop_assert!((found - expected).abs() < 1e-4, "{found} {expected}");
                    }
                }
                let all = scores.scores.to_vec();
                prop_assert_eq!(first.get_or_insert_with(|| all.clone()), &all);
            }
        }
    }
}
