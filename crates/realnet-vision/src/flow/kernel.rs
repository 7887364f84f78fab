//! The arithmetic of Lucas and Kanade's method on one window, in the fixed point
//! of OpenCV's `calcOpticalFlowPyrLK`.
//!
//! Pixels are interpolated with weights of 14 bits; interpolated intensities
//! keep 5 fractional bits, gradients none. Every sum is an exact integer, so all
//! instruction sets return the same.

use crate::Window;
use crate::pyramid::Level;
use crate::simd::{Simd, multiversion};

/// Fractional bits of interpolation weights.
const WEIGHT_BITS: u32 = 14;
/// Bits cut from weighted intensities; 5 fractional bits are left.
const INTENSITY_SHIFT: u32 = WEIGHT_BITS - 5;
/// Columns that are worked on at once; rows of a patch are multiples of it.
const STRIP: usize = 32;

/// Bilinear weights of a fractional position: upper left, upper right, lower
/// left, lower right.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weights([i16; 4]);

impl Weights {
    /// For fractions `a` of x and `b` of y, in 0 to 1.
    pub(super) fn new(a: f32, b: f32) -> Self {
        let one = (1 << WEIGHT_BITS) as f32;
        let weight = |w: f32| (w * one).round_ties_even() as i16;
        let first = [weight((1.0 - a) * (1.0 - b)), weight(a * (1.0 - b)), weight((1.0 - a) * b)];
        let [w00, w01, w10] = first;
        Self([w00, w01, w10, (1 << WEIGHT_BITS) - w00 - w01 - w10])
    }
}

/// The window around a point of the first picture: interpolated intensity and
/// gradients, rows padded with zeros to whole strips.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    width: usize,
    height: usize,
    stride: usize,
    intensity: Vec<i16>,
    dx: Vec<i16>,
    dy: Vec<i16>,
    /// -1 for the columns of the window, 0 for the padding.
    inside: Vec<i16>,
    /// Gradients at whole pixels, one row and column more than the window.
    pixel_dx: Vec<i16>,
    pixel_dy: Vec<i16>,
    pixel_stride: usize,
}

impl Patch {
    pub(super) fn new(window: Window) -> Self {
        let (width, height) = window.size();
        let stride = width.next_multiple_of(STRIP);
        let pixel_stride = (width + 1).next_multiple_of(STRIP);
        let window = || vec![0; stride * height];
        // The last row is read one strip beyond its end.
        let pixels = || vec![0; pixel_stride * (height + 1) + STRIP];
        Self {
            width,
            height,
            stride,
            intensity: window(),
            dx: window(),
            dy: window(),
            inside: (0..stride).map(|x| if x < width { -1 } else { 0 }).collect(),
            pixel_dx: pixels(),
            pixel_dy: pixels(),
            pixel_stride,
        }
    }

    /// Takes the window whose upper left corner is pixel (x, y) and a fraction,
    /// and returns the sums of dx dx, dx dy and dy dy. The window must lie inside
    /// the level's border with one pixel to spare.
    pub(super) fn take(
        &mut self,
        simd: Simd,
        level: &Level,
        (x, y): (isize, isize),
        weights: Weights,
    ) -> [i64; 3] {
        let stride = level.stride();
        let rows = (self.height + 1) * self.pixel_stride;
        scharr(
            simd,
            level.pixels_from(x - 1, y - 1),
            stride,
            &mut self.pixel_dx[..rows],
            &mut self.pixel_dy[..rows],
            self.pixel_stride,
        );
        self.forget_outside(level, x, y);
        interpolate_window(simd, self, level.pixels_from(x, y), stride, weights.0)
    }

    /// Outside the picture there is no gradient.
    fn forget_outside(&mut self, level: &Level, x: isize, y: isize) {
        let (columns, rows) = (self.width as isize + 1, self.height as isize + 1);
        let (width, height) = (level.width() as isize, level.height() as isize);
        if x >= 0 && y >= 0 && x + columns <= width && y + rows <= height {
            return;
        }
        let inside = (-x).clamp(0, columns) as usize..(width - x).clamp(0, columns) as usize;
        for row in 0..rows as usize {
            let start = row * self.pixel_stride;
            for gradients in [&mut self.pixel_dx, &mut self.pixel_dy] {
                let gradients = &mut gradients[start..start + columns as usize];
                if (0..height).contains(&(y + row as isize)) {
                    gradients[..inside.start].fill(0);
                    gradients[inside.end..].fill(0);
                } else {
                    gradients.fill(0);
                }
            }
        }
    }

    /// The sums of (J - I) dx and (J - I) dy, J the window of `level` whose upper
    /// left corner is pixel (x, y) and a fraction, inside the level's border.
    pub(super) fn compare(
        &self,
        simd: Simd,
        level: &Level,
        (x, y): (isize, isize),
        weights: Weights,
    ) -> [i64; 2] {
        let (source, stride) = (level.pixels_from(x, y), level.stride());
        #[cfg(target_arch = "x86_64")]
        {
            // What the vector code reads lies within the level's border and slop.
            let reach = (self.height + 1) * stride;
            let enough = source.len() >= reach && stride > self.stride;
            // SAFETY: a `Simd` other than `Portable` comes from `Simd::found`;
            // `enough` rows are there, each of more than `self.stride` bytes.
            match simd {
                Simd::Avx512 if enough => {
                    return unsafe { x86::compare_avx512(self, source, stride, weights) };
                }
                Simd::Avx2 if enough => {
                    return unsafe { x86::compare_avx2(self, source, stride, weights) };
                }
                _ => {}
            }
        }
        compare(simd, self, source, stride, weights.0)
    }

    /// The mean of |J - I| over the window, in grey values.
    pub(super) fn mean_difference(
        &self,
        simd: Simd,
        level: &Level,
        (x, y): (isize, isize),
        weights: Weights,
    ) -> f32 {
        let (source, stride) = (level.pixels_from(x, y), level.stride());
        let sum = difference(simd, self, source, stride, weights.0);
        sum as f32 / (32 * self.width * self.height) as f32
    }
}

/// The first `N` values from `at` on; all zero where there are not as many, which
/// the layout of levels and patches rules out.
#[inline(always)]
fn chunk<T, const N: usize>(values: &[T], at: usize) -> &[T; N]
where
    [T; N]: Zero,
{
    values.get(at..).and_then(<[T]>::first_chunk).unwrap_or(<[T; N]>::ZERO)
}

/// An array of zeros.
trait Zero: 'static {
    const ZERO: &'static Self;
}

impl<const N: usize> Zero for [u8; N] {
    const ZERO: &'static Self = &[0; N];
}

impl<const N: usize> Zero for [i16; N] {
    const ZERO: &'static Self = &[0; N];
}

multiversion! {
    /// Scharr gradients (3-10-3) of whole strips; `source` begins one row and one
    /// column before the first.
    fn scharr(source: &[u8], stride: usize, dx: &mut [i16], dy: &mut [i16], out_stride: usize) {
        let rows = dx.chunks_exact_mut(out_stride).zip(dy.chunks_exact_mut(out_stride));
        for (y, (dx, dy)) in rows.enumerate() {
            let strips = dx.as_chunks_mut::<STRIP>().0.iter_mut().zip(dy.as_chunks_mut::<STRIP>().0);
            for (strip, (dx, dy)) in strips.enumerate() {
                let at = y * stride + strip * STRIP;
                let up: &[u8; STRIP + 2] = chunk(source, at);
                let middle: &[u8; STRIP + 2] = chunk(source, at + stride);
                let down: &[u8; STRIP + 2] = chunk(source, at + 2 * stride);
                for x in 0..STRIP {
                    let (ul, uc, ur) =
                        (i16::from(up[x]), i16::from(up[x + 1]), i16::from(up[x + 2]));
                    let (l, r) = (i16::from(middle[x]), i16::from(middle[x + 2]));
                    let (dl, dc) = (i16::from(down[x]), i16::from(down[x + 1]));
                    let dr = i16::from(down[x + 2]);
                    dx[x] = 3 * ((ur - ul) + (dr - dl)) + 10 * (r - l);
                    dy[x] = 3 * ((dl - ul) + (dr - ur)) + 10 * (dc - uc);
                }
            }
        }
    }
}

/// One interpolated value of two rows of any integers.
#[inline(always)]
fn interpolate<T: Copy + Into<i32>>(
    upper: &[T; STRIP + 1],
    lower: &[T; STRIP + 1],
    x: usize,
    [w00, w01, w10, w11]: [i16; 4],
    shift: u32,
) -> i32 {
    let above = upper[x].into() * i32::from(w00) + upper[x + 1].into() * i32::from(w01);
    let below = lower[x].into() * i32::from(w10) + lower[x + 1].into() * i32::from(w11);
    (above + below + (1 << (shift - 1))) >> shift
}

multiversion! {
    /// Fills the patch from its gradients at whole pixels and from the pixels of
    /// `source`; returns the sums of the gradients' products.
    fn interpolate_window(
        patch: &mut Patch,
        source: &[u8],
        stride: usize,
        weights: [i16; 4],
    ) -> [i64; 3] {
        let mut sums = [0; 3];
        for start in (0..patch.stride).step_by(STRIP) {
            let inside: &[i16; STRIP] = chunk(&patch.inside, start);
            for row in 0..patch.height {
                let at = row * patch.stride + start;
                let pixel = row * stride + start;
                let (upper, lower) = (chunk(source, pixel), chunk(source, pixel + stride));
                let pixel = row * patch.pixel_stride + start;
                let below = pixel + patch.pixel_stride;
                let (x0, x1) = (chunk(&patch.pixel_dx, pixel), chunk(&patch.pixel_dx, below));
                let (y0, y1) = (chunk(&patch.pixel_dy, pixel), chunk(&patch.pixel_dy, below));
                let (mut out, mut dx, mut dy) = ([0; STRIP], [0; STRIP], [0; STRIP]);
                let (mut xx, mut xy, mut yy) = (0, 0, 0);
                for x in 0..STRIP {
                    out[x] = interpolate::<u8>(upper, lower, x, weights, INTENSITY_SHIFT) as i16;
                    let gx = interpolate::<i16>(x0, x1, x, weights, WEIGHT_BITS) as i16 & inside[x];
                    let gy = interpolate::<i16>(y0, y1, x, weights, WEIGHT_BITS) as i16 & inside[x];
                    (dx[x], dy[x]) = (gx, gy);
                    xx += i32::from(gx) * i32::from(gx);
                    xy += i32::from(gx) * i32::from(gy);
                    yy += i32::from(gy) * i32::from(gy);
                }
                patch.intensity[at..at + STRIP].copy_from_slice(&out);
                patch.dx[at..at + STRIP].copy_from_slice(&dx);
                patch.dy[at..at + STRIP].copy_from_slice(&dy);
                sums[0] += i64::from(xx);
                sums[1] += i64::from(xy);
                sums[2] += i64::from(yy);
            }
        }
        sums
    }
}

multiversion! {
    /// [`Patch::compare`] in portable code.
    fn compare(patch: &Patch, source: &[u8], stride: usize, weights: [i16; 4]) -> [i64; 2] {
        let mut sums = [0; 2];
        for start in (0..patch.stride).step_by(STRIP) {
            for row in 0..patch.height {
                let (pixel, at) = (row * stride + start, row * patch.stride + start);
                let (upper, lower) = (chunk(source, pixel), chunk(source, pixel + stride));
                let first: &[i16; STRIP] = chunk(&patch.intensity, at);
                let dx: &[i16; STRIP] = chunk(&patch.dx, at);
                let dy: &[i16; STRIP] = chunk(&patch.dy, at);
                let (mut sum_x, mut sum_y) = (0, 0);
                for x in 0..STRIP {
                    let value = interpolate::<u8>(upper, lower, x, weights, INTENSITY_SHIFT);
                    let difference = value - i32::from(first[x]);
                    sum_x += difference * i32::from(dx[x]);
                    sum_y += difference * i32::from(dy[x]);
                }
                sums[0] += i64::from(sum_x);
                sums[1] += i64::from(sum_y);
            }
        }
        sums
    }
}

multiversion! {
    /// The sum of |J - I| over the window, in 1/32 grey values.
    fn difference(patch: &Patch, source: &[u8], stride: usize, weights: [i16; 4]) -> i64 {
        let mut sum = 0;
        for start in (0..patch.stride).step_by(STRIP) {
            let inside: &[i16; STRIP] = chunk(&patch.inside, start);
            for row in 0..patch.height {
                let (pixel, at) = (row * stride + start, row * patch.stride + start);
                let (upper, lower) = (chunk(source, pixel), chunk(source, pixel + stride));
                let first: &[i16; STRIP] = chunk(&patch.intensity, at);
                let mut row_sum = 0;
                for x in 0..STRIP {
                    let value = interpolate::<u8>(upper, lower, x, weights, INTENSITY_SHIFT);
                    row_sum += (value - i32::from(first[x])).abs() & i32::from(inside[x]);
                }
                sum += i64::from(row_sum);
            }
        }
        sum
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{INTENSITY_SHIFT, Patch, STRIP, Weights};
    use std::arch::x86_64::*;

    /// Rows after which 32-bit sums could overflow: two products of at most
    /// 8160 * 4080 a lane and row.
    const ROWS: usize = 32;

    const ROUND: i32 = 1 << (INTENSITY_SHIFT - 1);
    const SHIFT: i32 = INTENSITY_SHIFT as i32;

    /// Two weights for neighbouring 16-bit lanes.
    fn pair(left: i16, right: i16) -> i32 {
        (i32::from(right) << 16) | (i32::from(left) & 0xffff)
    }

    /// # Safety
    /// Needs AVX2; `source` holds `height + 1` rows of `stride` bytes and
    /// `stride` is greater than `patch.stride`.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn compare_avx2(
        patch: &Patch,
        source: &[u8],
        stride: usize,
        Weights(w): Weights,
    ) -> [i64; 2] {
        const LANES: usize = 16;
        let upper = _mm256_set1_epi32(pair(w[0], w[1]));
        let lower = _mm256_set1_epi32(pair(w[2], w[3]));
        let round = _mm256_set1_epi32(ROUND);
        // Pixels x and x + 1 side by side: of columns 0-3 and 8-11, 4-7 and 12-15.
        let pairs = |row: usize, x: usize| {
            // SAFETY: `x + 17 <= patch.stride + 1 <= stride`.
            let (left, right) = unsafe {
                let at = source.as_ptr().add(row * stride + x);
                (_mm_loadu_si128(at.cast()), _mm_loadu_si128(at.add(1).cast()))
            };
            let (left, right) = (_mm256_cvtepu8_epi16(left), _mm256_cvtepu8_epi16(right));
            (_mm256_unpacklo_epi16(left, right), _mm256_unpackhi_epi16(left, right))
        };
        let load = |values: &[i16], at: usize| {
            // SAFETY: rows of a patch are whole strips.
            unsafe { _mm256_loadu_si256(values.as_ptr().add(at).cast()) }
        };
        let mut sums = [0; 2];
        for x in (0..patch.width).step_by(LANES) {
            let mut above = pairs(0, x);
            for first_row in (0..patch.height).step_by(ROWS) {
                let mut sum_x = _mm256_setzero_si256();
                let mut sum_y = _mm256_setzero_si256();
                for row in first_row..patch.height.min(first_row + ROWS) {
                    let below = pairs(row + 1, x);
                    let blend = |a, b| {
                        let products = _mm256_add_epi32(
                            _mm256_madd_epi16(a, upper),
                            _mm256_madd_epi16(b, lower),
                        );
                        _mm256_srai_epi32::<SHIFT>(_mm256_add_epi32(products, round))
                    };
                    let value =
                        _mm256_packs_epi32(blend(above.0, below.0), blend(above.1, below.1));
                    let at = row * patch.stride + x;
                    let difference = _mm256_sub_epi16(value, load(&patch.intensity, at));
                    let (dx, dy) = (load(&patch.dx, at), load(&patch.dy, at));
                    sum_x = _mm256_add_epi32(sum_x, _mm256_madd_epi16(difference, dx));
                    sum_y = _mm256_add_epi32(sum_y, _mm256_madd_epi16(difference, dy));
                    above = below;
                }
                sums[0] += sum_avx2(sum_x);
                sums[1] += sum_avx2(sum_y);
            }
        }
        sums
    }

    /// The sum of eight lanes, which may be more than one lane can hold.
    #[target_feature(enable = "avx2")]
    fn sum_avx2(lanes: __m256i) -> i64 {
        let low = _mm256_cvtepi32_epi64(_mm256_castsi256_si128(lanes));
        let high = _mm256_cvtepi32_epi64(_mm256_extracti128_si256(lanes, 1));
        let four = _mm256_add_epi64(low, high);
        let two = _mm_add_epi64(_mm256_castsi256_si128(four), _mm256_extracti128_si256(four, 1));
        _mm_cvtsi128_si64(two) + _mm_extract_epi64(two, 1)
    }

    /// # Safety
    /// Needs AVX-512 F, BW and VNNI; `source` holds `height + 1` rows of `stride`
    /// bytes and `stride` is greater than `patch.stride`.
    #[target_feature(enable = "avx512f,avx512bw,avx512vnni")]
    pub(super) unsafe fn compare_avx512(
        patch: &Patch,
        source: &[u8],
        stride: usize,
        Weights(w): Weights,
    ) -> [i64; 2] {
        let upper = _mm512_set1_epi32(pair(w[0], w[1]));
        let lower = _mm512_set1_epi32(pair(w[2], w[3]));
        let round = _mm512_set1_epi32(ROUND);
        let pairs = |row: usize, x: usize| {
            // SAFETY: `x + 33 <= patch.stride + 1 <= stride`.
            let (left, right) = unsafe {
                let at = source.as_ptr().add(row * stride + x);
                (_mm256_loadu_si256(at.cast()), _mm256_loadu_si256(at.add(1).cast()))
            };
            let (left, right) = (_mm512_cvtepu8_epi16(left), _mm512_cvtepu8_epi16(right));
            (_mm512_unpacklo_epi16(left, right), _mm512_unpackhi_epi16(left, right))
        };
        let load = |values: &[i16], at: usize| {
            // SAFETY: rows of a patch are whole strips.
            unsafe { _mm512_loadu_si512(values.as_ptr().add(at).cast()) }
        };
        let mut sums = [0; 2];
        for x in (0..patch.width).step_by(STRIP) {
            let mut above = pairs(0, x);
            for first_row in (0..patch.height).step_by(ROWS) {
                let mut sum_x = _mm512_setzero_si512();
                let mut sum_y = _mm512_setzero_si512();
                for row in first_row..patch.height.min(first_row + ROWS) {
                    let below = pairs(row + 1, x);
                    let blend = |a, b| {
                        let products = _mm512_dpwssd_epi32(round, a, upper);
                        _mm512_srai_epi32::<{ SHIFT as u32 }>(_mm512_dpwssd_epi32(
                            products, b, lower,
                        ))
                    };
                    let value =
                        _mm512_packs_epi32(blend(above.0, below.0), blend(above.1, below.1));
                    let at = row * patch.stride + x;
                    let difference = _mm512_sub_epi16(value, load(&patch.intensity, at));
                    sum_x = _mm512_dpwssd_epi32(sum_x, difference, load(&patch.dx, at));
                    sum_y = _mm512_dpwssd_epi32(sum_y, difference, load(&patch.dy, at));
                    above = below;
                }
                sums[0] += sum_avx512(sum_x);
                sums[1] += sum_avx512(sum_y);
            }
        }
        sums
    }

    /// The sum of sixteen lanes, which may be more than one lane can hold.
    #[target_feature(enable = "avx512f")]
    fn sum_avx512(lanes: __m512i) -> i64 {
        let low = _mm512_cvtepi32_epi64(_mm512_castsi512_si256(lanes));
        let high = _mm512_cvtepi32_epi64(_mm512_extracti64x4_epi64(lanes, 1));
        _mm512_reduce_add_epi64(_mm512_add_epi64(low, high))
    }
}

#[cfg(test)]
mod tests;
