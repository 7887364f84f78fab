//! Seeded randomness, and what is expected of squared normalised errors.

use realnet_core::{CameraModel, Distortion, Intrinsics};

/// SplitMix64.
pub struct Rng(pub u64);

impl Rng {
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        low + (high - low) * ((z >> 11) as f64 / (1_u64 << 53) as f64)
    }

    /// A standard normal number (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform(f64::EPSILON, 1.0).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform(0.0, 1.0)).cos()
    }
}

/// Fails unless the mean of squared normalised errors of one dimension lies in
/// its 99.9 % interval: chi-square with n degrees of freedom over n, which for
/// these n is normal with mean 1 and variance 2 / n.
#[track_caller]
pub fn assert_consistent(squares: &[f64]) {
    let n = squares.len() as f64;
    let mean = squares.iter().sum::<f64>() / n;
    let half = 3.3 * (2.0 / n).sqrt();
    assert!((mean - 1.0).abs() <= half, "mean square {mean} of {n}, 1 +- {half} expected");
}

/// A 640x480 camera with or without a lens.
pub fn camera(lens: bool) -> CameraModel {
    let intrinsics = Intrinsics { fx: 480.0, fy: 470.0, cx: 322.0, cy: 236.0 };
    let lens = match lens {
        true => Distortion::PlumbBob([-0.28, 0.09, 0.001, -0.0005, 0.0]),
        false => Distortion::None,
    };
    CameraModel::new(640, 480, intrinsics, lens).unwrap()
}
