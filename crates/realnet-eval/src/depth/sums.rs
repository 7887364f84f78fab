//! Sums over pixels.

use super::DepthErrors;

/// Sums of the terms of all figures.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    count: u64,
    relative: f64,
    square_relative: f64,
    square: f64,
    log: f64,
    log_magnitude: f64,
    log_square: f64,
    within: [u64; 3],
}

impl Sums {
    /// Adds a pixel of true depth `g` and produced depth `p`, both above 0.
    pub(super) fn add(&mut self, g: f64, p: f64) {
        let difference = p - g;
        let log = (p / g).ln();
        let ratio = (p / g).max(g / p);
        self.count += 1;
        self.relative += difference.abs() / g;
        self.square_relative += difference * difference / g;
        self.square += difference * difference;
        self.log += log;
        self.log_magnitude += log.abs();
        self.log_square += log * log;
        for (count, limit) in self.within.iter_mut().zip([1.25, 1.5625, 1.953_125]) {
            *count += u64::from(ratio < limit);
        }
    }

    /// Adds the pixels of another image.
    pub(super) fn join(&mut self, other: &Self) {
        self.count += other.count;
        self.relative += other.relative;
        self.square_relative += other.square_relative;
        self.square += other.square;
        self.log += other.log;
        self.log_magnitude += other.log_magnitude;
        self.log_square += other.log_square;
        for (count, more) in self.within.iter_mut().zip(other.within) {
            *count += more;
        }
    }

    /// Pixels added.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// The figures; `None` without pixels.
    pub(super) fn errors(&self) -> Option<DepthErrors> {
        if self.count == 0 {
            return None;
        }
        let n = self.count as f64;
        let mean_log = self.log / n;
        // Rounding may bring a variance of 0 below it.
        let variance = (self.log_square / n - mean_log * mean_log).max(0.0);
        let [d1, d2, d3] = self.within.map(|count| count as f64 / n);
        Some(DepthErrors {
            abs_rel: self.relative / n,
            sq_rel: self.square_relative / n,
            rmse: (self.square / n).sqrt(),
            rmse_log: (self.log_square / n).sqrt(),
            log10: self.log_magnitude / n / std::f64::consts::LN_10,
            silog: 100.0 * variance.sqrt(),
            d1,
            d2,
            d3,
        })
    }
}
