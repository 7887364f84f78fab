//! Resizing with a triangle filter as wide as the reduction: bilinear
//! interpolation that first takes away what the smaller picture cannot show.
//!
//! The weights are those of Pillow's `BILINEAR`: output sample `i` lies at
//! `c = (i + 0.5) s` with `s` the ratio of the sizes, and input sample `j` counts
//! with `max(0, 1 - |j + 0.5 - c| / max(1, s))`, normalised to sum 1. The vertical
//! pass comes first, because it runs along the rows of memory; values between the
//! passes keep 7 bits after the point, so the result is within 1 of Pillow's.

use crate::Region;
use realnet_core::{Frame, PixelFormat};

/// The input samples behind each output sample of one axis.
#[derive(Debug, Default)]
struct Taps {
    /// First input sample and number of samples.
    spans: Vec<(usize, usize)>,
    /// Weights of all spans, one after the other, `per_span` each, 0 at the end.
    weights: Vec<u16>,
    per_span: usize,
    /// One more than the last sample that any weight, also one of 0, falls on.
    reach: usize,
}

impl Taps {
    /// Weights sum to exactly `one`; `per_span` is even.
    fn fill(&mut self, source: u32, target: u32, one: u16) {
        let scale = f64::from(source) / f64::from(target);
        let width = scale.max(1.0);
        let center = |i: usize| (i as f64 + 0.5) * scale;
        self.spans.clear();
        self.spans.extend((0..target as usize).map(|i| {
            let first = (center(i) - width + 0.5).max(0.0) as usize;
            let end = ((center(i) + width + 0.5) as usize).min(source as usize);
            (first, end - first)
        }));
        let longest = self.spans.iter().map(|(_, count)| *count).max().unwrap_or(0);
        self.per_span = longest.next_multiple_of(2).max(2);
        self.reach = self.spans.last().map_or(0, |(first, _)| first + self.per_span);
        self.weights.clear();
        let mut shares = Vec::with_capacity(self.per_span);
        for (i, &(first, count)) in self.spans.iter().enumerate() {
            let share = |j: usize| (1.0 - (j as f64 + 0.5 - center(i)).abs() / width).max(0.0);
            shares.clear();
            shares.extend((first..first + count).map(share));
            let sum: f64 = shares.iter().sum();
            // Rounding the running sum instead of each weight keeps the total exact.
            let (mut running, mut given) = (0.0, 0);
            for share in &shares {
                running += share / sum;
                let upto = (running * f64::from(one)).round() as u16;
                self.weights.push(upto - given);
                given = upto;
            }
            self.weights.resize((i + 1) * self.per_span, 0);
        }
    }

    fn iter(&self) -> impl Iterator<Item = (usize, usize, &[u16])> {
        let weights = self.weights.chunks_exact(self.per_span.max(1));
        self.spans.iter().zip(weights).map(|(&(first, count), weights)| (first, count, weights))
    }
}

/// Sum of the vertical weights: products are cut to their upper 16 bits.
const VERTICAL_ONE: u16 = u16::MAX;
/// Sum of the horizontal weights.
const HORIZONTAL_ONE: u16 = 1 << 14;
/// Values between the passes have this many bits after the point.
const MIDDLE_BITS: u32 = 7;
/// Vector loads read up to this many values beyond the end of a middle row.
const SLACK: usize = 8;

/// Resizes rows of 8-bit pictures; keeps its tables and row buffers.
#[derive(Debug, Default)]
pub(crate) struct TriangleResizer {
    key: Option<(u32, u32, u32, u32, usize)>,
    columns: Taps,
    rows: Taps,
    sums: Vec<u16>,
    /// The vertically finished row, as interleaved as the picture.
    middle: Vec<i16>,
    /// The finished row, planar.
    line: Vec<u8>,
}

impl TriangleResizer {
    /// As [`crate::resize::RowResizer::run`].
    pub(crate) fn run(
        &mut self,
        frame: &Frame,
        region: Region,
        (width, height): (u32, u32),
        mut sink: impl FnMut(usize, &[u8]),
    ) {
        let channels = frame.format().channels();
        let key = (region.width, region.height, width, height, channels);
        let values = region.width as usize * channels;
        if self.key != Some(key) {
            self.columns.fill(region.width, width, HORIZONTAL_ONE);
            self.rows.fill(region.height, height, VERTICAL_ONE);
            self.sums.resize(values, 0);
            self.middle.clear();
            // Also the taps of weight 0 behind the last sample are read.
            self.middle.resize(values + self.columns.per_span * channels + SLACK, 0);
            self.line.resize(width as usize * channels, 0);
            self.key = Some(key);
        }
        for (y, (first, count, weights)) in self.rows.iter().enumerate() {
            self.sums.fill(0);
            let row = |index: usize| {
                let offset =
                    (region.y as usize + index) * frame.stride() + region.x as usize * channels;
                &frame.data()[offset..][..values]
            };
            for start in (0..count).step_by(4) {
                // Rows beyond the span have the weight 0; any row will do for them.
                let rows = std::array::from_fn(|k| row(first + (start + k).min(count - 1)));
                let weight = |k: usize| if start + k < count { weights[start + k] } else { 0 };
                accumulate(rows, std::array::from_fn(weight), &mut self.sums);
            }
            for (middle, &sum) in self.middle.iter_mut().zip(&self.sums) {
                *middle = (sum >> (8 - MIDDLE_BITS)) as i16;
            }
            resize_row(frame.format(), &self.middle, &self.columns, &mut self.line);
            sink(y, &self.line);
        }
    }
}

/// Adds four rows of bytes, times their `weights` of 65535, with 8 bits after the
/// point.
fn accumulate(rows: [&[u8]; 4], weights: [u16; 4], sums: &mut [u16]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was found.
        return unsafe { x86::accumulate(rows, weights, sums) };
    }
    accumulate_portable(rows, weights, sums);
}

#[inline(always)]
fn accumulate_portable(rows: [&[u8]; 4], weights: [u16; 4], sums: &mut [u16]) {
    let [a, b, c, d] = rows;
    let part = |byte: u8, weight: u16| {
        ((u32::from(u16::from(byte) << 8) * u32::from(weight)) >> 16) as u16
    };
    for ((((sum, &a), &b), &c), &d) in sums.iter_mut().zip(a).zip(b).zip(c).zip(d) {
        // The weights of a sum are 65535 together, so it cannot overflow.
        *sum = sum
            .wrapping_add(part(a, weights[0]))
            .wrapping_add(part(b, weights[1]))
            .wrapping_add(part(c, weights[2]))
            .wrapping_add(part(d, weights[3]));
    }
}

/// Horizontal pass over one middle row; the output is planar.
fn resize_row(format: PixelFormat, row: &[i16], columns: &Taps, out: &mut [u8]) {
    match format {
        PixelFormat::Grey8 => resize_row_portable::<1>(row, columns, out),
        PixelFormat::Rgb8 => {
            #[cfg(target_arch = "x86_64")]
            if x86::resize_row_rgb(row, columns, out) {
                return;
            }
            resize_row_portable::<3>(row, columns, out);
        }
    }
}

/// Bits after the point once both passes are done.
const SHIFT: u32 = 14 + MIDDLE_BITS;

fn resize_row_portable<const CHANNELS: usize>(row: &[i16], columns: &Taps, out: &mut [u8]) {
    let width = columns.spans.len();
    for (x, (first, count, weights)) in columns.iter().enumerate() {
        for channel in 0..CHANNELS {
            let samples = row[first * CHANNELS + channel..].iter().step_by(CHANNELS).take(count);
            let sum: i32 = samples.zip(weights).map(|(&v, &w)| i32::from(v) * i32::from(w)).sum();
            out[channel * width + x] = ((sum + (1 << (SHIFT - 1))) >> SHIFT).clamp(0, 255) as u8;
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{SHIFT, SLACK, Taps};
    use std::arch::x86_64::*;

    /// [`super::accumulate`] by AVX2: written out, because compilers turn the
    /// portable code into slower products of 32 bits.
    #[target_feature(enable = "avx2")]
    pub(super) fn accumulate(rows: [&[u8]; 4], weights: [u16; 4], sums: &mut [u16]) {
        // No closures here: they are compiled without AVX2 and called one by one.
        let [a, b, c, d] = weights;
        let factors = [
            _mm256_set1_epi16(a.cast_signed()),
            _mm256_set1_epi16(b.cast_signed()),
            _mm256_set1_epi16(c.cast_signed()),
            _mm256_set1_epi16(d.cast_signed()),
        ];
        let shortest = rows.iter().map(|row| row.len()).min().unwrap_or(0);
        let done = shortest.min(sums.len()) / 16 * 16;
        for x in (0..done).step_by(16) {
            let mut part = _mm256_setzero_si256();
            for (row, factor) in rows.iter().zip(factors) {
                // SAFETY: `x + 16 <= done`, and no row nor `sums` is shorter.
                let bytes = unsafe { _mm_loadu_si128(row.as_ptr().add(x).cast()) };
                let values = _mm256_slli_epi16(_mm256_cvtepu8_epi16(bytes), 8);
                part = _mm256_add_epi16(part, _mm256_mulhi_epu16(values, factor));
            }
            // SAFETY: as above.
            unsafe {
                let sum = sums.as_mut_ptr().add(x).cast();
                _mm256_storeu_si256(sum, _mm256_add_epi16(_mm256_loadu_si256(sum), part));
            }
        }
        let tails = rows.map(|row| row.get(done..).unwrap_or_default());
        super::accumulate_portable(tails, weights, sums.get_mut(done..).unwrap_or_default());
    }

    /// The horizontal RGB pass by AVX2; false on a processor without it.
    pub(super) fn resize_row_rgb(row: &[i16], columns: &Taps, out: &mut [u8]) -> bool {
        let fits = columns.reach * 3 + SLACK <= row.len() + 6;
        if !is_x86_feature_detected!("avx2") || out.len() < 3 * columns.spans.len() || !fits {
            return false;
        }
        // SAFETY: AVX2 was found; every load below ends inside `row`, as the
        // last one starts two samples (6 values) before `reach`.
        unsafe { resize_row_rgb_avx2(row, columns, out) };
        true
    }

    /// # Safety
    /// Needs AVX2, `out.len() >= 3 * columns.spans.len()`, and 8 readable values
    /// from each even tap on.
    #[target_feature(enable = "avx2")]
    unsafe fn resize_row_rgb_avx2(row: &[i16], columns: &Taps, out: &mut [u8]) {
        const Z: i8 = -1;
        // r g b r g b . . -> (r r) (g g) (b b) (0 0)
        let pairs = _mm256_broadcastsi128_si256(_mm_setr_epi8(
            0, 1, 6, 7, 2, 3, 8, 9, 4, 5, 10, 11, Z, Z, Z, Z,
        ));
        let half = _mm256_set1_epi32(1 << (SHIFT - 1));
        let (width, per_span) = (columns.spans.len(), columns.per_span);
        let (red, rest) = out.split_at_mut(width);
        let (green, blue) = rest.split_at_mut(width);
        // Two output samples at a time; an odd last one is done twice.
        for x in (0..width).step_by(2) {
            let at = [x, (x + 1).min(width - 1)];
            let firsts = [columns.spans[at[0]].0 * 3, columns.spans[at[1]].0 * 3];
            let low = &columns.weights[at[0] * per_span..][..per_span];
            let high = &columns.weights[at[1] * per_span..][..per_span];
            let mut sum = half;
            for (pair, (low, high)) in low.chunks_exact(2).zip(high.chunks_exact(2)).enumerate() {
                // SAFETY: promised by the caller.
                let pixels = unsafe {
                    let start = row.as_ptr().add(6 * pair);
                    _mm256_set_m128i(
                        _mm_loadu_si128(start.add(firsts[1]).cast()),
                        _mm_loadu_si128(start.add(firsts[0]).cast()),
                    )
                };
                let weights = _mm256_set_m128i(
                    _mm_set1_epi32(i32::from(high[0]) | (i32::from(high[1]) << 16)),
                    _mm_set1_epi32(i32::from(low[0]) | (i32::from(low[1]) << 16)),
                );
                let products = _mm256_madd_epi16(_mm256_shuffle_epi8(pixels, pairs), weights);
                sum = _mm256_add_epi32(sum, products);
            }
            let bytes = _mm256_srai_epi32(sum, SHIFT as i32);
            let bytes = _mm256_packus_epi16(_mm256_packs_epi32(bytes, bytes), bytes);
            let lanes = [_mm256_castsi256_si128(bytes), _mm256_extracti128_si256(bytes, 1)];
            for (x, lane) in at.into_iter().zip(lanes) {
                let [r, g, b, _] = _mm_cvtsi128_si32(lane).to_le_bytes();
                (red[x], green[x], blue[x]) = (r, g, b);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Filter, resize, testing::noise};
    use proptest::prelude::*;
    use realnet_core::Stamp;

    /// `Image.resize((5, 3), Image.BILINEAR)` by Pillow 13.0 of `(7 x + 31 y) % 256` on
    /// 12x8 grey pixels.
    #[test]
    fn within_one_of_pillow() {
        let data = (0..8u32).flat_map(|y| (0..12u32).map(move |x| ((7 * x + 31 * y) % 256) as u8));
        let frame = Frame::grey8(Stamp::ZERO, 12, 8, data.collect()).unwrap();
        let small = resize(&frame, 5, 3, Filter::Triangle).unwrap();
        for (a, b) in small.data().iter().zip(PILLOW) {
            assert!(a.abs_diff(b) <= 1, "{:?}", small.data());
        }
    }

    const PILLOW: [u8; 15] =
        [40, 56, 73, 89, 105, 115, 131, 148, 163, 175, 189, 205, 185, 158, 103];

    #[test]
    fn flat_pictures_stay_flat() {
        for value in [0, 1, 127, 254, 255] {
            let frame = Frame::rgb8(Stamp::ZERO, 97, 61, vec![value; 97 * 61 * 3]).unwrap();
            for (w, h) in [(32, 20), (97, 61), (200, 150), (1, 1)] {
                let other = resize(&frame, w, h, Filter::Triangle).unwrap();
                assert!(other.data().iter().all(|v| v.abs_diff(value) <= 1), "{value} {w}x{h}");
            }
        }
    }

    #[test]
    fn weights_sum_to_one() {
        let mut taps = Taps::default();
        for (source, target) in [(1280, 320), (720, 180), (1280, 640), (100, 333), (7, 7), (1, 5)] {
            taps.fill(source, target, HORIZONTAL_ONE);
            for (first, count, weights) in taps.iter() {
                assert!(first + count <= source as usize && count <= taps.per_span);
                assert_eq!(weights.iter().sum::<u16>(), HORIZONTAL_ONE);
                assert!(weights[count..].iter().all(|w| *w == 0));
            }
        }
    }

    proptest! {
        /// Each channel of an RGB picture (vector code) equals the same plane as a
        /// grey picture (portable code).
        #[test]
        fn vector_equals_portable(
            (w, h) in (1u32..90, 1u32..20), (tw, th) in (1u32..70, 1u32..20), seed in any::<u32>()
        ) {
            let frame = noise(w, h, 3, seed);
            let rgb = resize(&frame, tw, th, Filter::Triangle).unwrap();
            for channel in 0..3 {
                let plane = |f: &Frame| -> Vec<u8> {
                    f.data().iter().skip(channel).step_by(3).copied().collect()
                };
                let grey = Frame::grey8(Stamp::ZERO, w, h, plane(&frame)).unwrap();
                let small = resize(&grey, tw, th, Filter::Triangle).unwrap();
                prop_assert_eq!(small.data(), &plane(&rgb)[..]);
            }
        }
    }
}
