//! Pictures at halved sizes.

use crate::simd::{Simd, multiversion};
use crate::{FlowError, Window};
use realnet_core::{Frame, PixelFormat, Stamp};

/// Bytes to the right of the border that vector code may read.
const SLOP: usize = 64;

/// One picture of a [`Pyramid`], in grey, with a mirrored border around it.
#[derive(Clone, Debug, Default)]
pub struct Level {
    width: usize,
    height: usize,
    border: usize,
    stride: usize,
    data: Vec<u8>,
}

impl Level {
    /// Pixels a row.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width as u32
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height as u32
    }

    /// The pixels of row `y`, without the border; `None` outside the picture.
    #[must_use]
    pub fn row(&self, y: u32) -> Option<&[u8]> {
        let y = y as usize;
        (y < self.height).then(|| &self.padded_row(y as isize)[self.border..][..self.width])
    }

    /// Pixels of mirrored picture around it.
    pub(crate) fn border(&self) -> usize {
        self.border
    }

    /// Bytes from one row to the next.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// The bytes from pixel (x, y) on, row by row; both may reach into the
    /// border, not beyond.
    pub(crate) fn pixels_from(&self, x: isize, y: isize) -> &[u8] {
        let border = self.border as isize;
        let start = (y + border) * self.stride as isize + x + border;
        self.data.get(start as usize..).unwrap_or_default()
    }

    /// Row `y` with its border and slop.
    pub(crate) fn padded_row(&self, y: isize) -> &[u8] {
        let row = (y + self.border as isize) as usize;
        &self.data[row * self.stride..][..self.stride]
    }

    fn resize(&mut self, width: usize, height: usize, border: usize) {
        if (self.width, self.height, self.border) == (width, height, border) {
            return;
        }
        let stride = (width + 2 * border + SLOP).next_multiple_of(64);
        self.data.clear();
        self.data.resize(stride * (height + 2 * border), 0);
        (self.width, self.height, self.border, self.stride) = (width, height, border, stride);
    }

    /// Fills the border from the picture: OpenCV's `BORDER_REFLECT_101`.
    fn mirror(&mut self) {
        let (width, height, border, stride) = (self.width, self.height, self.border, self.stride);
        for row in self.data.chunks_exact_mut(stride).skip(border).take(height) {
            if border < width {
                for i in 1..=border {
                    row[border - i] = row[border + i];
                    row[border + width - 1 + i] = row[border + width - 1 - i];
                }
            } else {
                for x in 0..border as isize {
                    row[x as usize] = row[border + reflect(x - border as isize, width)];
                    let right = width + x as usize;
                    row[border + right] = row[border + reflect(right as isize, width)];
                }
            }
        }
        let mut copy = |from: usize, to: usize| {
            self.data.copy_within(from * stride..(from + 1) * stride, to * stride);
        };
        for i in 0..border {
            copy(border + reflect(i as isize - border as isize, height), i);
            copy(border + reflect((height + i) as isize, height), border + height + i);
        }
    }
}

/// The index inside `0..length` that position `i` mirrors to, the outermost
/// sample not repeated.
pub(crate) fn reflect(i: isize, length: usize) -> usize {
    let period = 2 * (length as isize - 1);
    if period <= 0 {
        return 0;
    }
    let i = i.rem_euclid(period);
    i.min(period - i) as usize
}

/// A grey picture and its halved, quartered, … versions.
///
/// Each level is the one before it under the 5-tap kernel 1-4-6-4-1 in both
/// directions, every second pixel of every second row, rounded as
/// `(sum + 128) >> 8` with mirrored borders: bit by bit OpenCV's `pyrDown`. A
/// level of size `n` is followed by one of `(n + 1) / 2`; the last level is the
/// last one that is larger than the window in both directions, or number
/// `max_level`. A first level that is not larger than the window stands alone.
///
/// Memory is kept: building from a frame of the same size allocates nothing.
#[derive(Clone, Debug)]
pub struct Pyramid {
    window: Window,
    max_level: usize,
    levels: Vec<Level>,
    built: usize,
    stamp: Stamp,
    /// One row summed vertically.
    sums: Vec<u16>,
    pub(crate) simd: Simd,
}

impl Pyramid {
    /// Levels no pyramid goes beyond.
    pub const MAX_LEVEL: usize = 15;

    /// An empty pyramid of levels 0 to `max_level` (at most
    /// [`Pyramid::MAX_LEVEL`]) whose borders suit a window of this size.
    #[must_use]
    pub fn new(max_level: usize, window: Window) -> Self {
        let max_level = max_level.min(Self::MAX_LEVEL);
        let levels = (0..=max_level).map(|_| Level::default()).collect();
        let (sums, simd) = (Vec::new(), Simd::best());
        Self { window, max_level, levels, built: 0, stamp: Stamp::ZERO, sums, simd }
    }

    /// Builds all levels from `frame`; colour becomes grey as by
    /// [`Frame::to_grey`].
    pub fn build(&mut self, frame: &Frame) {
        let (mut width, mut height) = (frame.width() as usize, frame.height() as usize);
        let (window_width, window_height) = self.window.size();
        // The window reaches its size beyond the picture, its gradients one
        // pixel more.
        let border = window_width.max(window_height) + 2;
        self.stamp = frame.stamp();
        self.built = 0;
        for index in 0..=self.max_level {
            if index > 0 {
                (width, height) = (width.div_ceil(2), height.div_ceil(2));
                if width <= window_width || height <= window_height {
                    break;
                }
            }
            let (upper, lower) = self.levels.split_at_mut(index);
            let Some(level) = lower.first_mut() else { break };
            level.resize(width, height, border);
            match upper.last() {
                None => copy_grey(self.simd, frame, level),
                Some(upper) => halve(self.simd, upper, level, &mut self.sums),
            }
            level.mirror();
            self.built += 1;
        }
    }

    /// Becomes a copy of `other`, in the memory it has: copying pyramids of one size
    /// allocates nothing.
    pub fn copy_from(&mut self, other: &Self) {
        let Self { window, max_level, levels, built, stamp, sums: _, simd } = self;
        (*window, *max_level) = (other.window, other.max_level);
        (*built, *stamp, *simd) = (other.built, other.stamp, other.simd);
        levels.resize_with(other.levels.len(), Level::default);
        for (level, other) in levels.iter_mut().zip(&other.levels) {
            (level.width, level.height) = (other.width, other.height);
            (level.border, level.stride) = (other.border, other.stride);
            level.data.clone_from(&other.data);
        }
    }

    /// The levels, the full size first; empty before the first
    /// [`Pyramid::build`].
    #[must_use]
    pub fn levels(&self) -> &[Level] {
        self.levels.get(..self.built).unwrap_or_default()
    }

    /// The full-size level.
    ///
    /// # Errors
    /// [`FlowError::NoPicture`] before the first [`Pyramid::build`].
    pub fn full(&self) -> Result<&Level, FlowError> {
        self.levels().first().ok_or(FlowError::NoPicture)
    }

    /// Exposure time of the frame it was built from.
    #[must_use]
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// The window it has borders for.
    #[must_use]
    pub fn window(&self) -> Window {
        self.window
    }
}

fn copy_grey(simd: Simd, frame: &Frame, level: &mut Level) {
    let (border, width, stride) = (level.border, level.width, level.stride);
    let rows = level.data.chunks_exact_mut(stride).skip(border);
    for (out, row) in rows.zip(frame.data().chunks_exact(frame.stride())) {
        let out = &mut out[border..][..width];
        match frame.format() {
            PixelFormat::Grey8 => out.copy_from_slice(row),
            PixelFormat::Rgb8 => grey_row(simd, row, out),
        }
    }
}

multiversion! {
    /// The fixed point of `Frame::to_grey`.
    fn grey_row(row: &[u8], out: &mut [u8]) {
        for (out, p) in out.iter_mut().zip(row.as_chunks::<3>().0) {
            let sum = u32::from(p[0]) * 4899 + u32::from(p[1]) * 9617 + u32::from(p[2]) * 1868;
            *out = ((sum + (1 << 13)) >> 14) as u8;
        }
    }
}

fn halve(simd: Simd, upper: &Level, level: &mut Level, sums: &mut Vec<u16>) {
    // Columns -2 to 2 * width + 1 of the upper level.
    let length = 2 * level.width + 4;
    sums.resize(sums.len().max(length), 0);
    let sums = &mut sums[..length];
    let (border, width, stride) = (level.border, level.width, level.stride);
    for (y, out) in level.data.chunks_exact_mut(stride).skip(border).take(level.height).enumerate()
    {
        let rows: [&[u8]; 5] = std::array::from_fn(|i| {
            &upper.padded_row(2 * y as isize + i as isize - 2)[upper.border - 2..][..length]
        });
        sum_rows(simd, rows, sums);
        halve_row(simd, sums, &mut out[border..][..width]);
    }
}

multiversion! {
    /// 1-4-6-4-1 over five rows.
    fn sum_rows(rows: [&[u8]; 5], sums: &mut [u16]) {
        let n = sums.len();
        let [a, b, c, d, e] = rows;
        let (a, b, c, d, e) = (&a[..n], &b[..n], &c[..n], &d[..n], &e[..n]);
        for x in 0..n {
            let outer = u16::from(a[x]) + u16::from(e[x]);
            sums[x] = outer + 4 * (u16::from(b[x]) + u16::from(d[x])) + 6 * u16::from(c[x]);
        }
    }
}

multiversion! {
    /// 1-4-6-4-1 over five columns, two columns a step. Sums stay below 2^16.
    fn halve_row(sums: &[u16], out: &mut [u8]) {
        let n = out.len();
        let pairs = sums.as_chunks::<2>().0;
        let (left, middle, right) = (&pairs[..n], &pairs[1..][..n], &pairs[2..][..n]);
        for x in 0..n {
            let sum = left[x][0] + right[x][0] + 4 * (left[x][1] + middle[x][1]) + 6 * middle[x][0];
            out[x] = ((sum + 128) >> 8) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn noise(width: u32, height: u32, seed: u32) -> Frame {
        let mut state = seed | 1;
        let data = (0..width * height * 3)
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 17;
                state ^= state << 5;
                (state >> 8) as u8
            })
            .collect();
        Frame::rgb8(Stamp::ZERO, width, height, data).unwrap()
    }

    #[test]
    fn reflects_as_opencv_does() {
        let around = |length: usize| (-5..8).map(|i| reflect(i, length)).collect::<Vec<_>>();
        assert_eq!(around(1), [0; 13]);
        assert_eq!(around(2), [1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1]);
        assert_eq!(around(4), [1, 2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1]);
    }

    #[test]
    fn stops_where_the_window_no_longer_fits() {
        let mut pyramid = Pyramid::new(9, Window::new(21, 21).unwrap());
        assert!(pyramid.levels().is_empty());
        pyramid.build(&noise(100, 90, 1));
        let sizes: Vec<_> = pyramid.levels().iter().map(|l| (l.width(), l.height())).collect();
        assert_eq!(sizes, [(100, 90), (50, 45), (25, 23)]);
        pyramid.build(&noise(5, 90, 1));
        assert_eq!(pyramid.levels().len(), 1);
        assert!(pyramid.full().unwrap().row(90).is_none());
    }

    proptest! {
        /// Each level against the definition, the border against mirrored pixels,
        /// for every instruction set and with memory of another size.
        #[test]
        fn levels_follow_the_definition(
            (width, height) in (1u32..70, 1u32..50), side in 3u32..30, seed in any::<u32>(),
        ) {
            let frame = noise(width, height, seed);
            let grey = frame.to_grey();
            for &simd in Simd::found() {
                let mut pyramid = Pyramid::new(4, Window::new(side, 3).unwrap());
                pyramid.simd = simd;
                pyramid.build(&noise(height, width, seed));
                pyramid.build(&frame);
                let full = pyramid.full().unwrap();
                for (y, row) in grey.data().chunks_exact(width as usize).enumerate() {
                    prop_assert_eq!(full.row(y as u32).unwrap(), row);
                }
                for pair in pyramid.levels().windows(2) {
                    let (upper, lower) = (&pair[0], &pair[1]);
                    prop_assert_eq!(lower.width, upper.width.div_ceil(2));
                    for y in 0..lower.height {
                        for x in 0..lower.width {
                            let mut sum = 128;
                            for (j, wy) in [1, 4, 6, 4, 1].into_iter().enumerate() {
                                for (i, wx) in [1, 4, 6, 4, 1].into_iter().enumerate() {
                                    let at = |p: usize, d: usize, n| {
                                        reflect(2 * p as isize + d as isize - 2, n)
                                    };
                                    let row = upper.row(at(y, j, upper.height) as u32).unwrap();
                                    sum += wx * wy * u32::from(row[at(x, i, upper.width)]);
                                }
                            }
                            prop_assert_eq!(u32::from(lower.row(y as u32).unwrap()[x]), sum >> 8);
                        }
                    }
                }
                for level in pyramid.levels() {
                    let border = level.border as isize;
                    for y in -border..level.height as isize + border {
                        let row = level.row(reflect(y, level.height) as u32).unwrap();
                        let padded = level.padded_row(y);
                        for x in -border..level.width as isize + border {
                            let expected = row[reflect(x, level.width)];
                            prop_assert_eq!(padded[(x + border) as usize], expected);
                        }
                    }
                }
            }
        }
    }
}
