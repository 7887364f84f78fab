//! The density of the depths in a box.

/// An interval of depths, metres, ends included.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FocusInterval {
    /// Smallest depth.
    pub near: f64,
    /// Largest depth.
    pub far: f64,
}

impl FocusInterval {
    /// True when a depth in metres lies inside, ends included.
    #[must_use]
    pub fn contains(&self, depth_m: f64) -> bool {
        depth_m >= self.near && depth_m <= self.far
    }

    /// Its length, metres.
    #[must_use]
    pub fn width(&self) -> f64 {
        self.far - self.near
    }
}

/// One depth in the box, with its weight in the density.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub depth: f32,
    pub weight: f32,
}

/// Which of the density's peaks is the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PeakRule {
    /// The highest, as in the paper: the target fills most of its box.
    Highest,
    /// The nearest local maximum that reaches a share of the highest one: for
    /// thin targets, which show more background than themselves, where nothing
    /// stands in front of them.
    Nearest {
        /// Share of the highest density, above 0 and at most 1.
        min_share: f64,
    },
    /// The highest after weighting with a normal density about a depth predicted
    /// from elsewhere (the last range and the target's motion): neither an
    /// occluder nor the background takes over because it covers more pixels.
    /// Depths beyond four deviations are never chosen.
    Expected {
        /// Predicted depth, metres.
        depth_m: f64,
        /// Its standard deviation, metres, greater than 0.
        std_m: f64,
    },
}

/// How many deviations from the prediction [`PeakRule::Expected`] looks.
pub(crate) const EXPECTED_SIGMAS: f64 = 4.0;

/// The density of the depths in a box, in bins of equal width.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthHistogram {
    start: f64,
    bin: f64,
    weights: Vec<f64>,
    density: Vec<f64>,
    peak: usize,
    first: usize,
    last: usize,
}

impl DepthHistogram {
    /// Number of bins; 0 before anything was measured.
    #[must_use]
    pub fn bins(&self) -> usize {
        self.density.len()
    }

    /// Width of a bin, metres.
    #[must_use]
    pub fn bin_width(&self) -> f64 {
        self.bin
    }

    /// The depth at which bin `index` begins, metres; `edge(bins())` is the end
    /// of the last one.
    #[must_use]
    pub fn edge(&self, index: usize) -> f64 {
        self.start + self.bin * index as f64
    }

    /// The depth in the middle of a bin, metres.
    #[must_use]
    pub fn center(&self, index: usize) -> f64 {
        self.start + self.bin * (index as f64 + 0.5)
    }

    /// Share of the box's (weighted) known depths in each bin.
    #[must_use]
    pub fn shares(&self) -> &[f64] {
        &self.weights
    }

    /// The smoothed density in each bin, per metre.
    #[must_use]
    pub fn density(&self) -> &[f64] {
        &self.density
    }

    /// The bin of the chosen peak.
    #[must_use]
    pub fn peak(&self) -> usize {
        self.peak
    }

    /// First and last bin of the widened interval.
    #[must_use]
    pub fn interval_bins(&self) -> (usize, usize) {
        (self.first, self.last)
    }

    /// The widened interval in metres.
    #[must_use]
    pub fn interval(&self) -> FocusInterval {
        FocusInterval { near: self.edge(self.first), far: self.edge(self.last + 1) }
    }

    /// Becomes a copy of another one in the memory it has; the derived
    /// `clone_from` would take new memory.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        let Self { start, bin, peak, first, last, .. } = *other;
        self.weights.clone_from(&other.weights);
        self.density.clone_from(&other.density);
        (self.start, self.bin) = (start, bin);
        (self.peak, self.first, self.last) = (peak, first, last);
    }

    pub(crate) fn clear(&mut self) {
        self.weights.clear();
        self.density.clear();
        (self.peak, self.first, self.last) = (0, 0, 0);
    }

    /// Counts the samples of `[start, start + bins * bin]` (its end included) and
    /// smooths them with a normal kernel of `sigma` bins. Shares are of
    /// `total_weight`.
    pub(crate) fn fill(
        &mut self,
        samples: &[Sample],
        total_weight: f64,
        (start, bin, bins): (f64, f64, usize),
        sigma: f64,
    ) {
        self.clear();
        self.start = start;
        self.bin = bin;
        self.weights.resize(bins, 0.0);
        self.density.resize(bins, 0.0);
        let end = start + bin * bins as f64;
        for sample in samples {
            let depth = f64::from(sample.depth);
            if depth >= start && depth <= end {
                let index = (((depth - start) / bin) as usize).min(bins - 1);
                if let Some(weight) = self.weights.get_mut(index) {
                    *weight += f64::from(sample.weight) / total_weight;
                }
            }
        }
        // Beyond three deviations the kernel has 0.3 % of its mass.
        let reach = (3.0 * sigma).ceil() as usize;
        let kernel = |offset: usize| match sigma > 0.0 {
            true => (-0.5 * (offset as f64 / sigma).powi(2)).exp(),
            false => 1.0,
        };
        let mass = kernel(0) + 2.0 * (1..=reach).map(kernel).sum::<f64>();
        for (index, density) in self.density.iter_mut().enumerate() {
            let first = index.saturating_sub(reach);
            let near = self.weights.iter().enumerate().skip(first).take(index + reach + 1 - first);
            let sum: f64 = near.map(|(at, weight)| weight * kernel(at.abs_diff(index))).sum();
            *density = sum / (mass * bin);
        }
    }

    fn at(&self, index: usize) -> f64 {
        self.density.get(index).copied().unwrap_or(0.0)
    }

    /// Chooses the peak; false when the rule finds none.
    pub(crate) fn find_peak(&mut self, rule: PeakRule) -> bool {
        let bins = self.bins();
        // `>` keeps the nearer of equals.
        let best = |score: &dyn Fn(usize) -> f64| {
            let mut best = (0.0, None);
            for index in 0..bins {
                let value = score(index);
                if value > best.0 {
                    best = (value, Some(index));
                }
            }
            best.1
        };
        let highest = best(&|index| self.at(index));
        let found = match rule {
            PeakRule::Highest => highest,
            PeakRule::Nearest { min_share } => {
                let least = min_share * highest.map_or(0.0, |index| self.at(index));
                (0..bins).find(|&index| {
                    let density = self.at(index);
                    let before = index.checked_sub(1).map_or(0.0, |before| self.at(before));
                    density > 0.0
                        && density >= least
                        && density >= before
                        && density >= self.at(index + 1)
                })
            }
            PeakRule::Expected { depth_m, std_m } => {
                let start = best(&|index| {
                    let miss = (self.center(index) - depth_m).abs();
                    // half a bin: its samples may lie that much nearer
                    let sigmas = (miss - 0.5 * self.bin).max(0.0) / std_m;
                    let inside = sigmas <= EXPECTED_SIGMAS;
                    if inside { self.at(index) * (-0.5 * sigmas * sigmas).exp() } else { 0.0 }
                });
                start.map(|start| self.climb(start))
            }
        };
        self.peak = found.unwrap_or(0);
        (self.first, self.last) = (self.peak, self.peak);
        found.is_some()
    }

    /// The local maximum uphill from `index`.
    fn climb(&self, mut index: usize) -> usize {
        loop {
            let here = self.at(index);
            let before = index.checked_sub(1).map_or(0.0, |before| self.at(before));
            let after = self.at(index + 1);
            if before > here && before >= after {
                index -= 1;
            } else if after > here {
                index += 1;
            } else {
                return index;
            }
        }
    }

    /// Widens from the peak to both sides while the density is at least `share`
    /// of the peak's. Where it rises above the peak's, another body has begun:
    /// the interval then ends at the lowest density on the way there.
    pub(crate) fn widen(&mut self, share: f64) {
        self.first = self.reach(share, |index| index.checked_sub(1));
        self.last = self.reach(share, |index| Some(index + 1).filter(|&next| next < self.bins()));
    }

    fn reach(&self, share: f64, next: impl Fn(usize) -> Option<usize>) -> usize {
        let top = self.at(self.peak);
        let (mut end, mut valley) = (self.peak, self.peak);
        while let Some(index) = next(end) {
            let density = self.at(index);
            if density < share * top {
                return end;
            }
            if density > top {
                return valley;
            }
            if density < self.at(valley) {
                valley = index;
            }
            end = index;
        }
        end
    }

    /// The interval and what belongs to it on both sides: up to where the
    /// density begins to rise again, or falls below `least` of the peak's.
    pub(crate) fn basin(&self, least: f64) -> (usize, usize) {
        let least = least * self.at(self.peak);
        let mut first = self.first;
        while let Some(next) = first.checked_sub(1) {
            if self.at(next) > self.at(first) || self.at(next) < least {
                break;
            }
            first = next;
        }
        let mut last = self.last;
        while last + 1 < self.bins() {
            let next = last + 1;
            if self.at(next) > self.at(last) || self.at(next) < least {
                break;
            }
            last = next;
        }
        (first, last)
    }

    /// The bin with the highest density outside the basin and its density as a
    /// share of the peak's.
    pub(crate) fn rival(&self, (first, last): (usize, usize)) -> Option<(usize, f64)> {
        let top = self.at(self.peak);
        let mut best: Option<(usize, f64)> = None;
        for index in (0..first).chain(last + 1..self.bins()) {
            let share = self.at(index) / top;
            if share > best.map_or(0.0, |(_, share)| share) {
                best = Some((index, share));
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn histogram(weights: &[f64]) -> DepthHistogram {
        let samples: Vec<Sample> = weights
            .iter()
            .enumerate()
            .map(|(i, &weight)| Sample { depth: i as f32 + 0.5, weight: weight as f32 })
            .collect();
        let mut histogram = DepthHistogram::default();
        histogram.fill(&samples, weights.iter().sum(), (0.0, 1.0, weights.len()), 0.0);
        histogram
    }

    #[test]
    fn densities_are_shares_per_metre() {
        let samples = [0.0, 0.1, 0.6, 1.0, 1.01].map(|depth| Sample { depth, weight: 1.0 });
        let mut histogram = DepthHistogram::default();
        histogram.fill(&samples, 5.0, (0.0, 0.5, 2), 0.0);
        // the end of the range belongs to the last bin, 1.01 to none
        assert_eq!(histogram.shares(), [0.4, 0.4]);
        assert_eq!(histogram.density(), [0.8, 0.8]);
        assert_eq!((histogram.edge(0), histogram.edge(2), histogram.center(1)), (0.0, 1.0, 0.75));
    }

    #[test]
    fn smoothing_keeps_the_mass_away_from_the_ends() {
        let samples = [Sample { depth: 10.5, weight: 3.0 }];
        let mut histogram = DepthHistogram::default();
        histogram.fill(&samples, 3.0, (0.0, 1.0, 21), 1.5);
        assert!((histogram.density().iter().sum::<f64>() - 1.0).abs() < 1e-12);
        let ratio = histogram.density()[12] / histogram.density()[10];
        assert!((ratio - (-0.5f64 * (2.0 / 1.5f64).powi(2)).exp()).abs() < 1e-12);
    }

    #[test]
    fn each_rule_has_its_peak() {
        let mut h = histogram(&[0.0, 3.0, 0.0, 6.0, 7.0, 1.0, 0.0, 10.0, 2.0]);
        assert!(h.find_peak(PeakRule::Highest));
        assert_eq!(h.peak(), 7);
        assert!(h.find_peak(PeakRule::Nearest { min_share: 0.5 }));
        assert_eq!(h.peak(), 4);
        assert!(h.find_peak(PeakRule::Nearest { min_share: 0.2 }));
        assert_eq!(h.peak(), 1);
        // begins at bin 3 and climbs to 4
        assert!(h.find_peak(PeakRule::Expected { depth_m: 3.4, std_m: 0.3 }));
        assert_eq!(h.peak(), 4);
        assert!(!h.find_peak(PeakRule::Expected { depth_m: 0.2, std_m: 0.05 }));
        assert!(!histogram(&[0.0, 0.0]).find_peak(PeakRule::Highest));
    }

    #[test]
    fn the_interval_widens_to_the_share_and_the_basin_to_the_valley() {
        let mut h = histogram(&[1.0, 0.0, 2.0, 5.0, 10.0, 6.0, 4.0, 1.0, 3.0, 0.0]);
        h.find_peak(PeakRule::Highest);
        h.widen(0.5);
        assert_eq!(h.interval_bins(), (3, 5));
        assert_eq!(h.interval(), FocusInterval { near: 3.0, far: 6.0 });
        assert_eq!(h.basin(0.0), (1, 7));
        assert_eq!(h.basin(0.15), (2, 6));
        assert_eq!(h.rival((1, 7)), Some((8, 0.3)));
        h.widen(0.05);
        assert_eq!(h.interval_bins(), (2, 8));
    }

    #[test]
    fn a_low_peak_does_not_widen_into_a_higher_one() {
        let mut h = histogram(&[0.0, 4.0, 3.0, 2.5, 3.0, 9.0, 9.0]);
        h.find_peak(PeakRule::Nearest { min_share: 0.3 });
        h.widen(0.5);
        assert_eq!((h.peak(), h.interval_bins()), (1, (1, 3)));
    }
}
