//! Streams of random numbers.

use rand::RngExt;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

/// The generator of the simulator's random numbers: PCG XSL RR 128/64, small, and
/// the same on every machine.
pub type Random = Pcg64;

/// The random numbers of one use of a seed. Other names, other numbers that have
/// nothing to do with these: so a model that draws more does not change what another
/// one draws.
///
/// ```
/// use rand::RngExt;
/// use realnet_sim::perception::random_stream;
///
/// let draw = |seed, name| random_stream(seed, name).random::<u64>();
/// assert_eq!(draw(1, "detector"), draw(1, "detector"));
/// assert_ne!(draw(1, "detector"), draw(2, "detector"));
/// assert_ne!(draw(1, "detector"), draw(1, "depth network"));
/// ```
#[must_use]
pub fn random_stream(seed: u64, name: &str) -> Random {
    item_stream(seed, stream_number(name), 0)
}

/// The number of a stream by its name (FNV-1a).
pub(super) fn stream_number(name: &str) -> u64 {
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// The random numbers of one frame, object or moment in a stream.
pub(super) fn item_stream(seed: u64, stream: u64, item: i64) -> Random {
    // Seeds and items that follow each other start far apart: the finaliser of
    // SplitMix64 over each in turn.
    let mix = |value: u64| {
        let value = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        value ^ (value >> 31)
    };
    let high = mix(mix(seed) ^ stream);
    let low = mix(high ^ item.cast_unsigned());
    Pcg64::new((u128::from(high) << 64) | u128::from(low), u128::from(stream))
}

/// A normal deviate, mean 0 and deviation 1.
pub(super) fn normal(random: &mut Random) -> f64 {
    random.sample(StandardNormal)
}

/// Noise that wanders: normal with mean 0 and deviation 1 at each moment, smooth over
/// its correlation time. A function of time alone, whenever and however often it is
/// asked.
#[derive(Clone, Copy, Debug)]
pub(super) struct SlowNoise {
    seed: u64,
    stream: u64,
    correlation_s: f64,
}

impl SlowNoise {
    pub(super) fn new(seed: u64, name: &str, item: u64, correlation_s: f64) -> Self {
        let stream = stream_number(name).wrapping_add(item.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        Self { seed, stream, correlation_s: correlation_s.max(1e-6) }
    }

    /// Between normal deviates on a lattice of time, weighted by a cosine's squares:
    /// their squares add up to 1, so the deviation is the same everywhere.
    pub(super) fn at(&self, time_s: f64) -> f64 {
        let place = time_s / self.correlation_s;
        let before = place.floor();
        let (sin, cos) = ((place - before) * std::f64::consts::FRAC_PI_2).sin_cos();
        let value = |index: f64| normal(&mut item_stream(self.seed, self.stream, index as i64));
        cos * value(before) + sin * value(before + 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_noise_is_normal_at_any_moment_and_smooth() {
        let noise = SlowNoise::new(7, "test", 0, 0.5);
        // asked between the lattice's points too
        let values: Vec<f64> = (0..40_000).map(|i| noise.at(f64::from(i) * 0.173)).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let square = values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64;
        assert!(mean.abs() < 0.03, "{mean}");
        assert!((square - 1.0).abs() < 0.05, "{square}");
        let steepest = (0..10_000)
            .map(|i| f64::from(i) * 1e-3)
            .map(|t| (noise.at(t + 1e-3) - noise.at(t)).abs())
            .fold(0.0, f64::max);
        // at most pi / 2 of the norm of the two deviates in 0.5 s
        assert!(steepest < 0.02, "{steepest}");
    }

    #[test]
    fn streams_have_nothing_to_do_with_each_other() {
        let draws = |seed, name| {
            let mut random = random_stream(seed, name);
            (0..4000).map(|_| normal(&mut random)).collect::<Vec<_>>()
        };
        let first = draws(1, "a");
        for other in [draws(2, "a"), draws(1, "b")] {
            let product: f64 = first.iter().zip(&other).map(|(a, b)| a * b).sum();
            assert!((product / 4000.0).abs() < 0.06, "{product}");
        }
    }
}
