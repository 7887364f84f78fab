//! Do the cues agree, and what they say together.

use super::depth_in_box::BoxDepth;
use super::ground::GroundEstimate;
use super::size::SizeEstimate;
use realnet_core::OptionError;
use thiserror::Error;

/// Where a range comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RangeSource {
    /// Depths of the box's pixels.
    DepthInBox,
    /// The ground plane.
    Ground,
    /// The known size of the target.
    Size,
    /// Motion since the last depth map.
    Motion,
    /// The tracker's prediction.
    Prediction,
}

impl RangeSource {
    /// The name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::DepthInBox => "depth in box",
            Self::Ground => "ground",
            Self::Size => "size",
            Self::Motion => "motion",
            Self::Prediction => "prediction",
        }
    }
}

impl std::fmt::Display for RangeSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// One range with its deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeCue {
    /// Where it comes from.
    pub source: RangeSource,
    /// Depth along the optical axis, metres.
    pub depth_m: f64,
    /// Its standard deviation, metres.
    pub std_m: f64,
}

impl RangeCue {
    /// A range and its standard deviation, metres.
    #[must_use]
    pub const fn new(source: RangeSource, depth_m: f64, std_m: f64) -> Self {
        Self { source, depth_m, std_m }
    }

    fn check(&self) -> Result<(), OptionError> {
        OptionError::check("depth_m of a cue", self.depth_m, self.depth_m > 0.0, "greater than 0")?;
        OptionError::check("std_m of a cue", self.std_m, self.std_m > 0.0, "greater than 0")
    }
}

impl From<BoxDepth> for RangeCue {
    fn from(depth: BoxDepth) -> Self {
        Self::new(RangeSource::DepthInBox, depth.depth_m, depth.std_m)
    }
}

impl From<GroundEstimate> for RangeCue {
    fn from(ground: GroundEstimate) -> Self {
        Self::new(RangeSource::Ground, ground.depth_m, ground.std_m)
    }
}

impl From<SizeEstimate> for RangeCue {
    fn from(size: SizeEstimate) -> Self {
        Self::new(RangeSource::Size, size.depth_m, size.std_m)
    }
}

/// Two cues that differ by more than their deviations allow.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error(
    "{} says {:.3} +- {:.3} m, {} says {:.3} +- {:.3} m: {sigmas:.1} deviations apart",
    a.source, a.depth_m, a.std_m, b.source, b.depth_m, b.std_m
)]
pub struct Disagreement {
    /// The one that comes first in the list.
    pub a: RangeCue,
    /// The other one.
    pub b: RangeCue,
    /// `b - a`, metres.
    pub difference_m: f64,
    /// Standard deviation of the difference of independent cues, metres.
    pub std_m: f64,
    /// Size of the difference in those deviations.
    pub sigmas: f64,
}

/// All pairs of cues that differ by more than `sigmas` standard deviations of
/// their difference, in the order of the list. The deviation is that of
/// independent cues, `sqrt(a^2 + b^2)`; cues with a common error differ less, so
/// what is reported here is never explained by a common error.
///
/// A pair that cannot be compared (a number in it is not finite) disagrees by
/// infinitely many deviations.
pub fn disagreements(cues: &[RangeCue], sigmas: f64) -> impl Iterator<Item = Disagreement> + '_ {
    let pairs = cues.iter().enumerate();
    pairs.flat_map(move |(i, &a)| {
        cues.iter().skip(i + 1).filter_map(move |&b| {
            let difference_m = b.depth_m - a.depth_m;
            let std_m = a.std_m.hypot(b.std_m);
            let apart = match difference_m.abs() / std_m {
                apart if apart.is_nan() && difference_m == 0.0 => 0.0,
                apart if apart.is_nan() => f64::INFINITY,
                apart => apart,
            };
            (apart > sigmas).then_some(Disagreement { a, b, difference_m, std_m, sigmas: apart })
        })
    })
}

/// Why cues cannot be combined.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CombineError {
    /// There is no cue.
    #[error("there is no range cue to combine")]
    Empty,
    /// Two of them contradict each other. The combination would be confident and
    /// belong to neither.
    #[error(transparent)]
    Disagreement(#[from] Disagreement),
    /// A number given does not fit.
    #[error(transparent)]
    Option(#[from] OptionError),
}

/// What agreeing cues say together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CombinedRange {
    /// Mean weighted by the inverse variances, metres.
    pub depth_m: f64,
    /// Its standard deviation, metres, at the correlation given.
    pub std_m: f64,
    /// Sum of the squared differences to the mean in deviations: chi-square with
    /// one degree of freedom less than cues when they are independent.
    pub chi_square: f64,
    /// How many cues there were.
    pub cues: usize,
}

/// The mean of cues by their inverse variances, refused when two of them are
/// more than `sigmas` deviations apart.
///
/// Errors that cues have in common are not averaged away: ground plane and size
/// share the box's bottom edge, depth in the box and motion share the depth map.
/// `correlation` is the correlation of the errors of every pair, 0 (independent)
/// to 1 (nothing is gained beyond a weighted mean of the deviations); the variance of the
/// mean is `sum_i w_i^2 s_i^2 + correlation sum_(i != j) w_i w_j s_i s_j`.
///
/// # Errors
/// [`CombineError`] for no cues, for the first two that disagree, for a depth or
/// deviation that is not greater than 0, and a correlation that is none.
///
/// ```
/// use realnet_range::cues::{RangeCue, RangeSource, combine};
///
/// let ground = RangeCue::new(RangeSource::Ground, 2.2, 0.2);
/// let size = RangeCue::new(RangeSource::Size, 2.0, 0.1);
/// let both = combine(&[ground, size], 3.0, 0.0)?;
/// assert!((both.depth_m - 2.04).abs() < 1e-12);
/// assert!((both.std_m - 0.1 * 0.8f64.sqrt()).abs() < 1e-12);
///
/// let wrong = RangeCue::new(RangeSource::DepthInBox, 4.0, 0.1);
/// let error = combine(&[ground, size, wrong], 3.0, 0.0).unwrap_err();
/// assert_eq!(
///     error.to_string(),
///     "ground says 2.200 +- 0.200 m, depth in box says 4.000 +- 0.100 m: 8.0 deviations apart"
/// );
/// # Ok::<(), realnet_range::cues::CombineError>(())
/// ```
pub fn combine(
    cues: &[RangeCue],
    sigmas: f64,
    correlation: f64,
) -> Result<CombinedRange, CombineError> {
    if cues.is_empty() {
        return Err(CombineError::Empty);
    }
    let ok = (0.0..=1.0).contains(&correlation);
    OptionError::check("correlation", correlation, ok, "0 to 1")?;
    for cue in cues {
        cue.check()?;
    }
    if let Some(disagreement) = disagreements(cues, sigmas).next() {
        return Err(disagreement.into());
    }
    let weight = |cue: &RangeCue| cue.std_m.powi(-2);
    let total: f64 = cues.iter().map(weight).sum();
    let depth_m = cues.iter().map(|cue| weight(cue) * cue.depth_m).sum::<f64>() / total;
    // With w_i s_i = 1 / (s_i total): the sum of squares, and the square of the sum.
    let squares = 1.0 / total;
    let sum: f64 = cues.iter().map(|cue| 1.0 / (cue.std_m * total)).sum();
    let variance = squares + correlation * (sum * sum - squares);
    let chi_square = cues.iter().map(|cue| ((cue.depth_m - depth_m) / cue.std_m).powi(2)).sum();
    Ok(CombinedRange { depth_m, std_m: variance.sqrt(), chi_square, cues: cues.len() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cue(depth_m: f64, std_m: f64) -> RangeCue {
        RangeCue::new(RangeSource::Ground, depth_m, std_m)
    }

    #[test]
    fn every_pair_beyond_its_deviations_is_reported() {
        let cues = [cue(2.0, 0.03), cue(2.1, 0.04), cue(3.0, 0.04)];
        let found: Vec<Disagreement> = disagreements(&cues, 3.0).collect();
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].a, found[0].b), (cues[0], cues[2]));
        assert!((found[0].sigmas - 20.0).abs() < 1e-9 && (found[0].std_m - 0.05).abs() < 1e-12);
        assert_eq!((found[1].a, found[1].b), (cues[1], cues[2]));
        assert_eq!(disagreements(&cues, 1.9).count(), 3, "2 deviations apart");
        assert_eq!(disagreements(&cues[..1], 0.0).count(), 0);
    }

    #[test]
    fn what_cannot_be_compared_disagrees() {
        let cues = [cue(2.0, 0.1), cue(f64::NAN, 0.1), cue(2.0, f64::NAN)];
        assert_eq!(disagreements(&cues, 1e9).count(), 2);
        let exact = [cue(2.0, 0.0), cue(2.0, 0.0), cue(2.1, 0.0)];
        assert_eq!(disagreements(&exact, 3.0).count(), 2);
    }

    #[test]
    fn correlation_takes_the_gain_away() {
        let cues = [cue(2.0, 0.1), cue(2.1, 0.1), cue(2.2, 0.1), cue(2.1, 0.1)];
        let independent = combine(&cues, 3.0, 0.0).unwrap();
        assert!((independent.depth_m - 2.1).abs() < 1e-12);
        assert!((independent.std_m - 0.05).abs() < 1e-12);
        assert!((independent.chi_square - 2.0).abs() < 1e-9);
        let same = combine(&cues, 3.0, 1.0).unwrap();
        assert!((same.std_m - 0.1).abs() < 1e-12);
        let half = combine(&cues, 3.0, 0.5).unwrap();
        // 0.01 / 4 + 0.5 * 12 * 0.01 / 16
        assert!((half.std_m.powi(2) - 0.00625).abs() < 1e-12);
    }

    #[test]
    fn what_cannot_be_combined_is_refused() {
        assert_eq!(combine(&[], 3.0, 0.0), Err(CombineError::Empty));
        let apart = [cue(2.0, 0.1), cue(2.5, 0.1)];
        assert!(matches!(combine(&apart, 3.0, 0.0), Err(CombineError::Disagreement(_))));
        for (cues, correlation) in [
            ([cue(2.0, 0.0)], 0.0),
            ([cue(-2.0, 0.1)], 0.0),
            ([cue(2.0, f64::NAN)], 0.0),
            ([cue(2.0, 0.1)], 1.5),
            ([cue(2.0, 0.1)], f64::NAN),
        ] {
            assert!(matches!(combine(&cues, 3.0, correlation), Err(CombineError::Option(_))));
        }
    }
}
