//! What a solver works with and accepts.

use crate::PnpError;

/// How [`PnpSolver::solve`](crate::PnpSolver::solve) works and what it accepts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RansacOptions {
    /// Largest residual of an inlier, pixels. It should be 3 to 5 standard
    /// deviations of the noise of a pixel coordinate. Default 4.
    pub threshold_px: f64,
    /// Probability with which a sample of inliers is drawn, below 1. Default
    /// 0.9999.
    pub confidence: f64,
    /// Most samples drawn. Default 5000.
    pub max_iterations: usize,
    /// Fewest inliers at different places, at least 4. More are asked for when
    /// so few could agree by chance. Default 6.
    pub min_inliers: usize,
    /// Residuals longer than this many standard deviations of the noise count
    /// linearly in the last refinement (Huber loss), infinite for squares.
    /// Default 3.
    pub huber_sigmas: f64,
    /// A second pose that explains at least this share of the number of inliers
    /// among the other points makes the answer ambiguous, 0 to 1. The search for
    /// it is skipped when there are not so many other points. Default 0.7.
    pub rival_share: f64,
    /// Largest standard deviation of the rotation, radians. Default 0.03.
    pub max_rotation_std: f64,
    /// Largest standard deviation of the translation as a share of the distance
    /// to the mean of the inliers. Default 0.05.
    pub max_translation_share: f64,
    /// Smallest noise of a pixel coordinate that is believed, pixels. Default
    /// 0.01.
    pub noise_floor_px: f64,
    /// Most steps of the last refinement. Default 50.
    pub max_steps: usize,
}

impl Default for RansacOptions {
    fn default() -> Self {
        Self {
            threshold_px: 4.0,
            confidence: 0.9999,
            max_iterations: 5000,
            min_inliers: 6,
            huber_sigmas: 3.0,
            rival_share: 0.7,
            max_rotation_std: 0.03,
            max_translation_share: 0.05,
            noise_floor_px: 0.01,
            max_steps: 50,
        }
    }
}

impl RansacOptions {
    pub(crate) fn check(&self) -> Result<(), PnpError> {
        let option = |name, value, good: bool, range| {
            if good { Ok(()) } else { Err(PnpError::Option { name, value, range }) }
        };
        for (name, value) in [
            ("threshold_px", self.threshold_px),
            ("max_rotation_std", self.max_rotation_std),
            ("max_translation_share", self.max_translation_share),
            ("noise_floor_px", self.noise_floor_px),
        ] {
            option(name, value, value > 0.0 && value <= 1e100, "greater than 0, at most 1e100")?;
        }
        let p = self.confidence;
        option("confidence", p, p > 0.0 && p < 1.0, "between 0 and 1, both excluded")?;
        option("huber_sigmas", self.huber_sigmas, self.huber_sigmas >= 1.0, "at least 1")?;
        let share = self.rival_share;
        option("rival_share", share, share > 0.0 && share <= 1.0, "greater than 0, at most 1")?;
        for (name, value, least, range) in [
            ("max_iterations", self.max_iterations, 1, "at least 1"),
            ("min_inliers", self.min_inliers, 4, "at least 4"),
            ("max_steps", self.max_steps, 1, "at least 1"),
        ] {
            option(name, value as f64, value >= least, range)?;
        }
        Ok(())
    }
}

/// How [`PnpSolver::refine`](crate::PnpSolver::refine) works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineOptions {
    /// Residuals longer than this, pixels, count linearly (Huber loss), infinite
    /// for squares. Default 3.
    pub huber_px: f64,
    /// Largest root mean square of the residual coordinates, pixels. Default 4.
    pub max_rms_px: f64,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self { huber_px: 3.0, max_rms_px: 4.0 }
    }
}
