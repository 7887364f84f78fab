//! Bilinear resizing in the fixed point of OpenCV's `INTER_LINEAR`.
//!
//! Sample positions are `(i + 0.5) * scale - 0.5`, weights have 11 bits, and the
//! two passes round as `cv::resize` does for 8-bit pictures: the horizontal sum
//! is cut to 15 bits, each vertical product to its upper 16 bits, and the sum is
//! rounded by 2 bits. There is no low-pass filter; this is what detectors of the
//! YOLO family are trained with.

use crate::{Region, VisionError, triangle::TriangleResizer};
use realnet_core::{Frame, PixelFormat};

/// One weight step: OpenCV's `INTER_RESIZE_COEF_SCALE`.
const WEIGHT_ONE: f32 = 2048.0;

/// Where one output sample lies between two input samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Tap {
    /// Index of the first input sample.
    first: usize,
    /// Index of the second input sample: the next one, or the same at a border.
    second: usize,
    /// Weights of the two, in units of 1/2048.
    weights: [i16; 2],
}

/// Sample positions along one axis. Beyond the border both samples are the outer
/// one; OpenCV rounds its two shares one by one in the vertical pass (`split`),
/// and takes it whole in the horizontal one.
fn taps(source: u32, target: u32, split: bool, out: &mut Vec<Tap>) {
    out.clear();
    let scale = f64::from(source) / f64::from(target);
    let last = i64::from(source) - 1;
    let weight = |w: f32| (w * WEIGHT_ONE).round_ties_even() as i16;
    out.extend((0..target).map(|i| {
        let position = ((f64::from(i) + 0.5) * scale - 0.5) as f32;
        let floor = position.floor();
        let index = floor as i64;
        let inner = index >= 0 && index < last;
        let fraction = if inner || split { position - floor } else { 0.0 };
        Tap {
            first: index.clamp(0, last) as usize,
            second: (index + 1).clamp(0, last) as usize,
            weights: [weight(1.0 - fraction), weight(fraction)],
        }
    }));
}

/// Resizes rows of 8-bit pictures; keeps its tables and row buffers.
#[derive(Debug, Default)]
pub(crate) struct RowResizer {
    key: Option<(u32, u32, u32, u32, usize)>,
    columns: Vec<Tap>,
    rows: Vec<Tap>,
    /// Two horizontally resized rows, planar, 15 bits a value.
    cache: [Vec<i16>; 2],
    /// Which input row each of them holds.
    cached: [Option<usize>; 2],
    /// The finished row, planar.
    line: Vec<u8>,
}

impl RowResizer {
    /// Resizes the `region` of `frame` to `width` x `height` and hands each
    /// output row to `sink` as planes of `width` bytes, one a channel.
    ///
    /// `region` must lie inside the frame and no side may be 0; callers check.
    pub(crate) fn run(
        &mut self,
        frame: &Frame,
        region: Region,
        (width, height): (u32, u32),
        mut sink: impl FnMut(usize, &[u8]),
    ) {
        let channels = frame.format().channels();
        let key = (region.width, region.height, width, height, channels);
        if self.key != Some(key) {
            taps(region.width, width, false, &mut self.columns);
            taps(region.height, height, true, &mut self.rows);
            let values = width as usize * channels;
            self.cache.iter_mut().for_each(|row| row.resize(values, 0));
            self.line.resize(values, 0);
            self.key = Some(key);
        }
        self.cached = [None; 2];
        for (y, &Tap { first, second, weights }) in self.rows.iter().enumerate() {
            let wanted = [first, second];
            // A row that both neighbours need moves from the second slot to the first.
            if self.cached[0] != Some(wanted[0]) && self.cached[1] == Some(wanted[0]) {
                self.cache.swap(0, 1);
                self.cached.swap(0, 1);
            }
            for slot in 0..2 {
                // A weight of 0 makes the row's content irrelevant.
                if weights[slot] != 0 && self.cached[slot] != Some(wanted[slot]) {
                    let offset = (region.y as usize + wanted[slot]) * frame.stride()
                        + region.x as usize * channels;
                    let row = &frame.data()[offset..];
                    resize_row(frame.format(), row, &self.columns, &mut self.cache[slot]);
                    self.cached[slot] = Some(wanted[slot]);
                }
            }
            blend(&self.cache[0], &self.cache[1], weights, &mut self.line);
            sink(y, &self.line);
        }
    }
}

/// Horizontal pass: `row` starts at the region's first pixel and may run on
/// beyond its last one. The output is planar and cut to 15 bits.
fn resize_row(format: PixelFormat, row: &[u8], columns: &[Tap], out: &mut [i16]) {
    match format {
        PixelFormat::Grey8 => resize_row_portable::<1>(row, columns, out, 0),
        PixelFormat::Rgb8 => {
            #[cfg(target_arch = "x86_64")]
            let done = x86::resize_row_rgb(row, columns, out);
            #[cfg(not(target_arch = "x86_64"))]
            let done = 0;
            resize_row_portable::<3>(row, columns, out, done);
        }
    }
}

/// The horizontal pass from output column `start` on.
fn resize_row_portable<const CHANNELS: usize>(
    row: &[u8],
    columns: &[Tap],
    out: &mut [i16],
    start: usize,
) {
    let width = columns.len();
    for (x, tap) in columns.iter().enumerate().skip(start) {
        let [a, b] = tap.weights.map(i32::from);
        for channel in 0..CHANNELS {
            let at =
                |pixel: usize| row.get(pixel * CHANNELS + channel).copied().map_or(0, i32::from);
            out[channel * width + x] = ((at(tap.first) * a + at(tap.second) * b) >> 4) as i16;
        }
    }
}

/// Vertical pass: two 15-bit rows to one of bytes.
fn blend(upper: &[i16], lower: &[i16], weights: [i16; 2], out: &mut [u8]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was found.
        return unsafe { x86::blend(upper, lower, weights, out) };
    }
    blend_portable(upper, lower, weights, out);
}

#[inline(always)]
fn blend_portable(upper: &[i16], lower: &[i16], [a, b]: [i16; 2], out: &mut [u8]) {
    // All in 16 bits, so that compilers find the instruction for the upper half
    // of a product. A row of weight 0 may hold stale values, but 0 times them is 0.
    let high = |value: i16, weight: i16| ((i32::from(value) * i32::from(weight)) >> 16) as i16;
    for ((out, &u), &l) in out.iter_mut().zip(upper).zip(lower) {
        *out = ((high(u, a) + high(l, b) + 2) >> 2).clamp(0, 255) as u8;
    }
}

/// Bytes as shares of 255.
pub(crate) fn shares(bytes: &[u8], out: &mut [f32]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was found.
        return unsafe { x86::shares(bytes, out) };
    }
    shares_portable(bytes, out);
}

#[inline(always)]
fn shares_portable(bytes: &[u8], out: &mut [f32]) {
    for (value, &byte) in out.iter_mut().zip(bytes) {
        *value = f32::from(byte) / 255.0;
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Tap;
    use std::arch::x86_64::*;

    /// Horizontal RGB pass by AVX2, as many columns as can be read safely;
    /// returns how many are done (0 on a processor without AVX2).
    pub(super) fn resize_row_rgb(row: &[u8], columns: &[Tap], out: &mut [i16]) -> usize {
        if !is_x86_feature_detected!("avx2") || out.len() < columns.len() * 3 {
            return 0;
        }
        // SAFETY: AVX2 was found above, and `out` holds three planes.
        unsafe { resize_row_rgb_avx2(row, columns, out) }
    }

    /// The portable code, compiled for wider registers.
    #[target_feature(enable = "avx2")]
    pub(super) fn blend(upper: &[i16], lower: &[i16], weights: [i16; 2], out: &mut [u8]) {
        super::blend_portable(upper, lower, weights, out);
    }

    /// The portable code, compiled for wider registers.
    #[target_feature(enable = "avx2")]
    pub(super) fn shares(bytes: &[u8], out: &mut [f32]) {
        super::shares_portable(bytes, out);
    }

    /// # Safety
    /// Needs AVX2 and `out.len() >= 3 * columns.len()`.
    #[target_feature(enable = "avx2")]
    unsafe fn resize_row_rgb_avx2(row: &[u8], columns: &[Tap], out: &mut [i16]) -> usize {
        const Z: i8 = -1;
        // Two neighbouring pixels r g b r g b -> (r r) (g g) (b b) (0 0), 16 bits each.
        let pairs = _mm256_broadcastsi128_si256(_mm_setr_epi8(
            0, Z, 3, Z, 1, Z, 4, Z, 2, Z, 5, Z, Z, Z, Z, Z,
        ));
        // r g b 0 r g b 0 -> r r g g b b 0 0
        let planes = _mm256_broadcastsi128_si256(_mm_setr_epi8(
            0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15,
        ));
        let across = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
        let width = columns.len();
        let mut x = 0;
        while let Some(&[p0, p1, p2, p3]) = columns.get(x..x + 4).and_then(|c| c.first_chunk::<4>())
        {
            // Eight bytes are read for each pixel pair of six.
            if p3.first * 3 + 8 > row.len() {
                break;
            }
            let load = |tap: Tap| {
                // SAFETY: taps ascend, so `first * 3 + 8` lies inside for all four.
                unsafe { _mm_loadl_epi64(row.as_ptr().add(tap.first * 3).cast()) }
            };
            let weights = |tap: Tap| {
                let [a, b] = tap.weights;
                _mm_set1_epi32(i32::from(a) | (i32::from(b) << 16))
            };
            let sums = |low: Tap, high: Tap| {
                let pixels = _mm256_set_m128i(load(high), load(low));
                let weights = _mm256_set_m128i(weights(high), weights(low));
                _mm256_srai_epi32(_mm256_madd_epi16(_mm256_shuffle_epi8(pixels, pairs), weights), 4)
            };
            // Lane 0 holds pixels 0 and 1, lane 1 pixels 2 and 3.
            let packed = _mm256_packs_epi32(sums(p0, p2), sums(p1, p3));
            let planar = _mm256_permutevar8x32_epi32(_mm256_shuffle_epi8(packed, planes), across);
            let low = _mm256_castsi256_si128(planar);
            let high = _mm256_extracti128_si256(planar, 1);
            // SAFETY: `x + 4 <= width` and `out` holds three planes of `width`.
            unsafe {
                let base = out.as_mut_ptr();
                _mm_storel_epi64(base.add(x).cast(), low);
                _mm_storel_epi64(base.add(width + x).cast(), _mm_srli_si128(low, 8));
                _mm_storel_epi64(base.add(2 * width + x).cast(), high);
            }
            x += 4;
        }
        x
    }
}

/// How a picture is made smaller or larger.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// A triangle as wide as the reduction (Pillow's `BILINEAR`): no aliasing.
    #[default]
    Triangle,
    /// Two neighbours, whatever the reduction (OpenCV's `INTER_LINEAR`, bit by
    /// bit): what Ultralytics' own programs do.
    Linear,
}

/// One of the two resizers.
#[derive(Debug)]
pub(crate) enum Resizer {
    Triangle(TriangleResizer),
    Linear(RowResizer),
}

impl Resizer {
    pub(crate) fn new(filter: Filter) -> Self {
        match filter {
            Filter::Triangle => Self::Triangle(TriangleResizer::default()),
            Filter::Linear => Self::Linear(RowResizer::default()),
        }
    }

    /// See [`RowResizer::run`].
    pub(crate) fn run(
        &mut self,
        frame: &Frame,
        region: Region,
        size: (u32, u32),
        sink: impl FnMut(usize, &[u8]),
    ) {
        match self {
            Self::Triangle(resizer) => resizer.run(frame, region, size, sink),
            Self::Linear(resizer) => resizer.run(frame, region, size, sink),
        }
    }
}

/// The whole of `frame` resized to `width` x `height`. Keeps stamp and pixel
/// format.
///
/// # Errors
/// [`VisionError::EmptyTarget`] when a target side is 0.
pub fn resize(
    frame: &Frame,
    width: u32,
    height: u32,
    filter: Filter,
) -> Result<Frame, VisionError> {
    if width == 0 || height == 0 {
        return Err(VisionError::EmptyTarget { width, height });
    }
    let channels = frame.format().channels();
    let width_px = width as usize;
    let mut data = vec![0; width_px * height as usize * channels];
    Resizer::new(filter).run(frame, Region::whole(frame), (width, height), |y, planes| {
        let row = &mut data[y * width_px * channels..][..width_px * channels];
        for (channel, plane) in planes.chunks_exact(width_px).enumerate() {
            row.iter_mut().skip(channel).step_by(channels).zip(plane).for_each(|(o, v)| *o = *v);
        }
    });
    Frame::new(frame.stamp(), width, height, frame.format(), data)
        .map_err(|_| VisionError::EmptyTarget { width, height })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::noise;
    use proptest::prelude::*;
    use realnet_core::Stamp;

    /// Fingerprints (64-bit FNV-1a) of `cv2.resize` by OpenCV 5.0 of the same
    /// noise, 321x243 RGB.
    #[test]
    fn equals_opencv_bit_by_bit() {
        let frame = noise(321, 243, 3, 7);
        for (width, height, expected) in OPENCV {
            let resized = resize(&frame, width, height, Filter::Linear).unwrap();
            let fingerprint =
                resized.data().iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, &byte| {
                    (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3)
                });
            assert_eq!(fingerprint, expected, "{width}x{height}");
        }
    }

    const OPENCV: [(u32, u32, u64); 3] = [
        (100, 75, 0xa91d_5300_0c42_c883),
        (320, 242, 0xcd55_22b8_f5b4_1d68),
        (400, 500, 0x1602_08da_3cd8_b5bf),
    ];

    #[test]
    fn halving_is_the_mean_of_four() {
        let frame = noise(64, 48, 3, 7);
        let half = resize(&frame, 32, 24, Filter::Linear).unwrap();
        for y in 0..24usize {
            for x in 0..32usize {
                for c in 0..3 {
                    let at = |dx: usize, dy: usize| {
                        u32::from(frame.data()[((2 * y + dy) * 64 + 2 * x + dx) * 3 + c])
                    };
                    let mean = (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1) + 2) >> 2;
                    assert_eq!(u32::from(half.data()[(y * 32 + x) * 3 + c]), mean);
                }
            }
        }
    }

    #[test]
    fn same_size_changes_nothing() {
        for channels in [1, 3] {
            let frame = noise(37, 11, channels, 3);
            assert_eq!(resize(&frame, 37, 11, Filter::Linear).unwrap(), frame);
        }
    }

    #[test]
    fn empty_target_is_refused() {
        assert!(matches!(
            resize(&noise(4, 4, 1, 1), 0, 3, Filter::Linear),
            Err(VisionError::EmptyTarget { width: 0, height: 3 })
        ));
    }

    proptest! {
        /// The vector code returns what the portable code returns: each channel
        /// of an RGB picture (vector) equals the same plane as a grey picture
        /// (portable).
        #[test]
        fn vector_equals_portable(
            (w, h) in (1u32..90, 1u32..20), (tw, th) in (1u32..70, 1u32..20), seed in any::<u32>()
        ) {
            let frame = noise(w, h, 3, seed);
            let rgb = resize(&frame, tw, th, Filter::Linear).unwrap();
            for channel in 0..3 {
                let plane = |f: &Frame| -> Vec<u8> {
                    f.data().iter().skip(channel).step_by(3).copied().collect()
                };
                let grey = Frame::grey8(Stamp::ZERO, w, h, plane(&frame)).unwrap();
                let small = resize(&grey, tw, th, Filter::Linear).unwrap();
                prop_assert_eq!(small.data(), &plane(&rgb)[..]);
            }
        }
    }
}
