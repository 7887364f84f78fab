//! The sigma rule: which depths in a box are the target's.

use super::depth_in_box::{BoxDepth, mean_and_std, within};
use super::gate::ForegroundGate;
use super::histogram::{FocusInterval, Sample};
use super::noise::DepthNoise;
use realnet_core::OptionError;

/// Rounds of cutting and estimating; it settles in three to six.
const MAX_ROUNDS: usize = 20;

/// The sigma rule: foreground is what lies inside the box and within `sigmas`
/// standard deviations of the target's mean depth, background what lies outside
/// the box, or inside and further away.
///
/// Mean and deviation start from the widened interval about the peak and are
/// estimated again from the depths within `sigmas` deviations until the cut no
/// longer changes. The deviation is corrected for the tails that the cut takes
/// away (those of a normal density). The cut never leaves the peak's
/// [basin](BoxDepth::basin), so it cannot creep along the floor into the wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SigmaRule {
    /// Half the width of the cut in standard deviations, 1 to 10.
    pub sigmas: f64,
    /// The deviation is at least this (`absolute` and a share of the depth): the
    /// present frame's target is not exactly where the last map's was.
    pub min_sigma: DepthNoise,
    /// [`ForegroundGate::margin_px`] of the result, pixels.
    pub margin_px: f32,
}

impl Default for SigmaRule {
    fn default() -> Self {
        Self {
            sigmas: 3.0,
            min_sigma: DepthNoise::new(0.01, 0.01),
            margin_px: ForegroundGate::DEFAULT_MARGIN_PX,
        }
    }
}

/// The target's pixels in a box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foreground {
    /// The cut: box and interval of depths.
    pub gate: ForegroundGate,
    /// Mean depth of the target's pixels, metres.
    pub mean_m: f64,
    /// Their standard deviation, metres, corrected for the cut.
    pub sigma_m: f64,
    /// Share of the box's known depths that are foreground, 0 to 1.
    pub share: f64,
}

impl SigmaRule {
    pub(crate) fn check(&self) -> Result<(), OptionError> {
        let ok = (1.0..=10.0).contains(&self.sigmas);
        OptionError::check("sigmas", self.sigmas, ok, "1 to 10")?;
        let margin = f64::from(self.margin_px);
        OptionError::check("margin_px", margin, margin >= 0.0, "at least 0")?;
        self.min_sigma.check()
    }

    /// The cut, mean, deviation and number of depths inside, from samples sorted
    /// by depth.
    pub(crate) fn fit(
        &self,
        samples: &[Sample],
        depth: &BoxDepth,
    ) -> (FocusInterval, f64, f64, usize) {
        let shrink = cut_deviation(self.sigmas);
        let (mut mean, mut sigma) = (depth.depth_m, depth.spread_m);
        let mut used = within(samples, depth.interval);
        let mut window = depth.interval;
        for _ in 0..MAX_ROUNDS {
            sigma = sigma.max(self.min_sigma.std_at(mean));
            let half = self.sigmas * sigma;
            // The floor of the deviation holds even in a narrow basin.
            let least = self.sigmas * self.min_sigma.std_at(mean);
            window = FocusInterval {
                near: (mean - half).max(depth.basin.near.min(mean - least)),
                far: (mean + half).min(depth.basin.far.max(mean + least)),
            };
            let next = within(samples, window);
            if next.is_empty() || (next.len() == used.len() && next.as_ptr() == used.as_ptr()) {
                break;
            }
            used = next;
            let (next_mean, next_std) = mean_and_std(used);
            (mean, sigma) = (next_mean, next_std / shrink);
        }
        (window, mean, sigma, used.len())
    }
}

/// Standard deviation of a standard normal variable that is cut at `+-k`:
/// `sqrt(1 - 2 k phi(k) / (2 Phi(k) - 1))`, the integrals by Simpson's rule.
fn cut_deviation(k: f64) -> f64 {
    let steps = 64;
    let h = k / f64::from(steps);
    let (mut mass, mut square) = (0.0, 0.0);
    for i in 0..=steps {
        let weight = match i {
            0 => 1.0,
            _ if i == steps => 1.0,
            _ if i % 2 == 1 => 4.0,
            _ => 2.0,
        };
        let x = h * f64::from(i);
        let density = weight * (-0.5 * x * x).exp();
        mass += density;
        square += x * x * density;
    }
    (square / mass).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviation_of_a_cut_normal_variable() {
        // 1 - 2 k phi(k) / (2 Phi(k) - 1) with tables of Phi
        for (k, expected) in [(1.0, 0.539_56), (2.0, 0.879_63), (3.0, 0.986_58)] {
            assert!((cut_deviation(k) - expected).abs() < 1e-4, "{k} {}", cut_deviation(k));
        }
    }
}
