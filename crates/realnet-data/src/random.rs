//! Random numbers that follow from a seed, an epoch and an index.

use rand::{RngExt, SeedableRng};
use rand_distr::{Beta, Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

/// What a stream of random numbers is for; each has its own.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Purpose {
    Order = 1,
    Detection = 2,
    Depth = 3,
}

/// A seed from several numbers (the finaliser of SplitMix64 after each).
fn mix(numbers: [u64; 4]) -> u64 {
    numbers.into_iter().fold(0, |state: u64, number| {
        let mut z = (state ^ number).wrapping_add(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    })
}

/// Random numbers in the shapes that are needed.
#[derive(Debug)]
pub(crate) struct Dice(Pcg64Mcg);

impl Dice {
    pub(crate) fn new(seed: u64, purpose: Purpose, epoch: u32, index: usize) -> Self {
        let seed = mix([seed, purpose as u64, u64::from(epoch), index as u64]);
        Self(Pcg64Mcg::seed_from_u64(seed))
    }

    /// Evenly from `low` to `high`.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Evenly from `-most` to `most`.
    pub(crate) fn around_zero(&mut self, most: f64) -> f64 {
        self.between(-most, most)
    }

    /// True in a share of the cases. Always takes one number.
    pub(crate) fn chance(&mut self, share: f64) -> bool {
        self.0.random::<f64>() < share
    }

    /// A whole number below `count`; 0 for a count of 0.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        ((self.0.random::<f64>() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Normal deviate, mean 0, deviation 1.
    pub(crate) fn normal(&mut self) -> f32 {
        StandardNormal.sample(&mut self.0)
    }

    /// Beta-distributed share with both shapes `shape`; one half if there is no such
    /// distribution.
    pub(crate) fn beta(&mut self, shape: f64) -> f64 {
        Beta::new(shape, shape).map_or(0.5, |beta| beta.sample(&mut self.0))
    }

    /// Shuffles in place (Fisher and Yates).
    pub(crate) fn shuffle<T>(&mut self, values: &mut [T]) {
        for last in (1..values.len()).rev() {
            values.swap(last, self.below(last + 1));
        }
    }
}
