//! From logits to metres in one pass: softmax over the bins, weighted sum of
//! their logarithms, exponential.
//!
//! The pixels of a block lie side by side in every plane, so the compiler puts
//! them side by side into vector registers. There are no fused operations in it:
//! every instruction set returns the same bits.

use super::DepthCoding;
use realnet_core::DepthMap;

/// Pixels a block.
const BLOCK: usize = 64;

/// Reads the logits of a classifying depth network.
///
/// ```
/// use realnet_nn::depth::{DepthCoding, SoftSum};
///
/// let coding = DepthCoding::default();
/// let mut sum = SoftSum::new(&coding, 60);
/// let mut logits = vec![0.0; 60]; // one pixel,
/// logits[20] = 100.0; // surely in bin 20
/// let mut depth = [0.0];
/// sum.run(&logits, 1.0, &mut depth);
/// let border = coding.log_borders(60)[20].exp() * coding.scale;
/// assert!((f64::from(depth[0]) - border).abs() < 1e-5);
/// ```
#[derive(Clone, Debug)]
pub struct SoftSum {
    bins: usize,
    /// ln(depth) of bin 0 and from one to the next.
    first: f64,
    step: f64,
    /// The logits of one block, plane by plane. The planes of a picture are a
    /// power of two apart and would push each other out of the caches.
    block: Vec<f32>,
}

impl SoftSum {
    /// For a network of `bins` bins.
    #[must_use]
    pub fn new(coding: &DepthCoding, bins: usize) -> Self {
        let step = coding.log_step(bins);
        let first = (coding.min * coding.scale).ln() + 0.5 * step;
        Self { bins, first, step, block: vec![0.0; bins * BLOCK] }
    }

    /// Number of bins.
    #[must_use]
    pub fn bins(&self) -> usize {
        self.bins
    }

    /// Depths in metres times `factor` from `logits`: `bins` planes, each as long
    /// as `depths`. Pixels whose logits are not all finite become
    /// [`DepthMap::UNKNOWN`]; the relative error to exact arithmetic is below
    /// 2e-5 for up to 256 bins.
    ///
    /// Does nothing when the lengths do not fit: `logits` must be `bins` times as
    /// long as `depths`.
    pub fn run(&mut self, logits: &[f32], factor: f64, depths: &mut [f32]) {
        if self.bins == 0 || logits.len() != self.bins * depths.len() {
            return;
        }
        let line = [(self.first + factor.ln()) as f32, self.step as f32];
        let block = &mut self.block;
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f") {
                // SAFETY: AVX-512 F was found.
                return unsafe { x86::avx512(logits, line, block, depths) };
            }
            if is_x86_feature_detected!("avx2") {
                // SAFETY: AVX2 was found.
                return unsafe { x86::avx2(logits, line, block, depths) };
            }
        }
        portable(logits, line, block, depths);
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    /// The portable code, compiled for wider registers.
    #[target_feature(enable = "avx512f")]
    pub(super) fn avx512(logits: &[f32], line: [f32; 2], block: &mut [f32], depths: &mut [f32]) {
        super::portable(logits, line, block, depths);
    }

    /// The portable code, compiled for wider registers.
    #[target_feature(enable = "avx2")]
    pub(super) fn avx2(logits: &[f32], line: [f32; 2], block: &mut [f32], depths: &mut [f32]) {
        super::portable(logits, line, block, depths);
    }
}

#[inline(always)]
fn portable(logits: &[f32], line: [f32; 2], block: &mut [f32], depths: &mut [f32]) {
    let plane = depths.len();
    let mut out = [0.0; BLOCK];
    for (index, depths) in depths.chunks_mut(BLOCK).enumerate() {
        let start = index * BLOCK;
        let mut finite = [0.0f32; BLOCK];
        let mut most = [f32::NEG_INFINITY; BLOCK];
        for (row, source) in block.chunks_exact_mut(BLOCK).zip(logits.chunks_exact(plane)) {
            let Some(source) = source.get(start..start + depths.len()) else { return };
            if let Some(source) = source.first_chunk::<BLOCK>() {
                row.copy_from_slice(source);
            } else {
                row[..source.len()].copy_from_slice(source);
            }
            for ((&x, most), finite) in row.iter().zip(&mut most).zip(&mut finite) {
                *most = if x > *most { x } else { *most };
                // NaN for NaN and infinities.
                *finite += x * 0.0;
            }
        }
        let mut total = [0.0f32; BLOCK];
        let mut weighted = [0.0f32; BLOCK];
        for (bin, row) in block.chunks_exact(BLOCK).enumerate() {
            let bin = bin as f32;
            let sums = total.iter_mut().zip(&mut weighted);
            for ((&x, &most), (total, weighted)) in row.iter().zip(&most).zip(sums) {
                let share = exp(x - most);
                *total += share;
                *weighted += share * bin;
            }
        }
        let [first, step] = line;
        for i in 0..BLOCK {
            let depth = exp(first + step * (weighted[i] / total[i]));
            out[i] = if finite[i] == 0.0 { depth } else { DepthMap::UNKNOWN };
        }
        depths.copy_from_slice(&out[..depths.len()]);
    }
}

/// e^x with a relative error below 2e-7 for x from -87 to 88, and at the next of
/// these for others. x = n·ln 2 + r with whole n and |r| ≤ ln(2)/2: a polynomial
/// for e^r (Cephes' `expf`), and n is added to the exponent's bits.
#[inline(always)]
fn exp(x: f32) -> f32 {
    /// Adding it leaves whole numbers in the low bits of the mantissa.
    const ROUND: f32 = 12_582_912.0;
    /// ln 2 as the sum of two numbers, the first of few bits.
    const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    let x = if x < -87.0 { -87.0 } else { x };
    let x = if x > 88.0 { 88.0 } else { x };
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * LN_2[0]) - n * LN_2[1];
    let mut p = 1.987_569_1e-4;
    for c in [1.398_199_9e-3, 8.333_452e-3, 4.166_579_6e-2, 0.166_666_65, 0.5] {
        p = p * r + c;
    }
    let p = p * (r * r) + r + 1.0;
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The formula, in double precision.
    fn reference(logits: &[f64], coding: &DepthCoding) -> f64 {
        let most = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let shares: Vec<f64> = logits.iter().map(|x| (x - most).exp()).collect();
        let total: f64 = shares.iter().sum();
        let borders = coding.log_borders(logits.len());
        let log: f64 = shares.iter().zip(&borders).map(|(s, b)| s / total * b).sum();
        coding.scale * log.exp()
    }

    #[test]
    fn exponentials_are_exact_to_the_last_bits() {
        let mut worst = 0f64;
        for i in 0..=1_750_000 {
            let x = -87.0 + i as f32 * 1e-4;
            let exact = f64::from(x).exp();
            worst = worst.max((f64::from(exp(x)) - exact).abs() / exact);
        }
        assert!(worst < 2e-7, "{worst:e}");
        assert_eq!(exp(-1000.0), exp(-87.0));
        assert_eq!(exp(0.0), 1.0);
    }

    proptest! {
        #[test]
        fn sums_are_those_of_the_formula(
            bins in 1usize..150,
            pixels in 1usize..200,
            spread in 0.01f32..200.0,
            shift in -500.0f32..500.0,
            factor in 0.01f64..10.0,
            seed in any::<u32>(),
        ) {
            let mut state = seed;
            let mut noise = || {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                ((state >> 8) as f32 / (1 << 24) as f32 - 0.5) * spread + shift
            };
            let logits: Vec<f32> = (0..bins * pixels).map(|_| noise()).collect();
            let coding = DepthCoding { min: 0.01, max: 8.0, ..Default::default() };
            let mut depths = vec![-1.0; pixels];
            SoftSum::new(&coding, bins).run(&logits, factor, &mut depths);
            for (pixel, &depth) in depths.iter().enumerate() {
                let one: Vec<f64> =
                    logits.iter().skip(pixel).step_by(pixels).map(|&x| f64::from(x)).collect();
                let exact = reference(&one, &coding) * factor;
                let error = (f64::from(depth) - exact).abs() / exact;
                prop_assert!(error < 2e-5, "{bins} bins, pixel {pixel}: {depth} {exact}");
            }
        }
    }

    #[test]
    fn all_instruction_sets_return_the_same_bits() {
        let logits: Vec<f32> =
            (0..60 * 203).map(|i| ((i * 7919 % 1009) as f32 - 500.0) / 50.0).collect();
        let mut sum = SoftSum::new(&DepthCoding::default(), 60);
        let (mut best, mut plain) = (vec![0.0; 203], vec![0.0; 203]);
        sum.run(&logits, 1.0, &mut best);
        let line = [sum.first as f32, sum.step as f32];
        portable(&logits, line, &mut sum.block, &mut plain);
        assert_eq!(best, plain);
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            let mut avx2 = vec![0.0; 203];
            // SAFETY: AVX2 was found.
            unsafe { x86::avx2(&logits, line, &mut sum.block, &mut avx2) };
            assert_eq!(best, avx2);
        }
    }

    #[test]
    fn what_is_not_finite_is_unknown() {
        let mut sum = SoftSum::new(&DepthCoding::default(), 3);
        // A NaN whose payload reaches the lowest bit, too.
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::from_bits(0x7fc0_0001)] {
            let mut logits = vec![0.5; 3 * 70];
            logits[70 + 66] = bad;
            let mut depths = vec![-1.0; 70];
            sum.run(&logits, 1.0, &mut depths);
            for (i, depth) in depths.iter().enumerate() {
                assert_eq!(*depth == DepthMap::UNKNOWN, i == 66, "{bad} {i}");
            }
        }
        let mut untouched = [-1.0; 2];
        sum.run(&[0.0; 5], 1.0, &mut untouched);
        assert_eq!(untouched, [-1.0; 2]);
    }
}
