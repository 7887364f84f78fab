//! Range from the depths in a box.

use super::gate::ForegroundGate;
use super::histogram::{DepthHistogram, FocusInterval, PeakRule, Sample};
use super::noise::DepthNoise;
use super::sigma_rule::{Foreground, SigmaRule};
use realnet_core::OptionError;
use realnet_core::{BoundingBox, DepthMap};
use thiserror::Error;

/// Intervals of at most this many bins are looked at again with finer bins.
const UNRESOLVED_BINS: usize = 5;
/// Bins kept on both sides of such an interval.
const ZOOM_MARGIN_BINS: usize = 2;
/// Each zoom makes the bins at least five times as fine.
const MAX_ZOOMS: usize = 4;
/// A bin below this share of the peak ends the peak's basin.
const BASIN_SHARE: f64 = 0.02;

/// How [`DepthInBox`] finds the target's depth. The defaults are the paper's
/// where it states a number: 50 bins, the highest peak.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthInBoxOptions {
    /// Bins of the histogram, 8 to 10,000.
    pub bins: usize,
    /// Standard deviation in bins of the normal kernel that smooths the
    /// histogram, 0 (none) to 10.
    pub smoothing_bins: f64,
    /// Which peak is the target.
    pub peak: PeakRule,
    /// The interval widens while the density is at least this share of the
    /// peak's, above 0 and below 1.
    pub widen_share: f64,
    /// Share of the depths at each end of the range that the bins do not span,
    /// 0 to 0.4: a few wild pixels do not stretch 50 bins over 60 m.
    pub clip_share: f64,
    /// No bin is narrower than this. Its parts are not noise but the step of the
    /// source's values: finer bins would be a comb.
    pub min_bin: DepthNoise,
    /// Look again, with finer bins over its neighbourhood, at an interval of at
    /// most 5 bins: 50 bins from a target at 1 m to a wall at 8 m are 0.14 m wide.
    pub zoom: bool,
    /// Depths beyond are ignored, metres; infinite for no limit.
    pub max_depth_m: f64,
    /// Weigh a pixel by a normal density about the centre of the box with this
    /// standard deviation, as a share of the box's sides, when the peak is
    /// looked for: occluders and background come in from the edges. `None`
    /// weighs all pixels alike.
    pub center_sigma: Option<f64>,
    /// Fewer known depths than this in the box, or in the interval, are refused.
    pub min_pixels: usize,
    /// At most about this many pixels are read, on a regular grid.
    pub max_samples: usize,
    /// Distance in pixels over which the random errors of neighbouring depths
    /// are alike: a square of this side counts as one measurement.
    pub correlation_px: f64,
}

impl Default for DepthInBoxOptions {
    fn default() -> Self {
        Self {
            bins: 50,
            smoothing_bins: 1.0,
            peak: PeakRule::Highest,
            widen_share: 0.5,
            clip_share: 0.01,
            min_bin: DepthNoise::new(0.01, 0.005),
            zoom: true,
            max_depth_m: f64::INFINITY,
            center_sigma: None,
            min_pixels: 12,
            max_samples: 4096,
            correlation_px: 4.0,
        }
    }
}

impl DepthInBoxOptions {
    fn check(&self) -> Result<(), OptionError> {
        let check = OptionError::check;
        let bins = self.bins as f64;
        check("bins", bins, (8..=10_000).contains(&self.bins), "8 to 10,000")?;
        let smoothing = self.smoothing_bins;
        check("smoothing_bins", smoothing, (0.0..=10.0).contains(&smoothing), "0 to 10")?;
        let share = self.widen_share;
        check("widen_share", share, share > 0.0 && share < 1.0, "above 0 and below 1")?;
        check("clip_share", self.clip_share, (0.0..=0.4).contains(&self.clip_share), "0 to 0.4")?;
        self.min_bin.check()?;
        if self.max_depth_m != f64::INFINITY {
            check("max_depth_m", self.max_depth_m, self.max_depth_m > 0.0, "above 0")?;
        }
        if let Some(sigma) = self.center_sigma {
            check("center_sigma", sigma, sigma > 0.0, "above 0")?;
        }
        check("min_pixels", self.min_pixels as f64, self.min_pixels > 0, "at least 1")?;
        check("max_samples", self.max_samples as f64, self.max_samples >= 64, "at least 64")?;
        let correlation = self.correlation_px;
        check("correlation_px", correlation, correlation >= 0.0, "at least 0")?;
        check_peak(self.peak)
    }
}

fn check_peak(peak: PeakRule) -> Result<(), OptionError> {
    match peak {
        PeakRule::Highest => Ok(()),
        PeakRule::Nearest { min_share } => {
            let ok = min_share > 0.0 && min_share <= 1.0;
            OptionError::check("min_share", min_share, ok, "above 0 and at most 1")
        }
        PeakRule::Expected { depth_m, std_m } => {
            OptionError::check("expected depth_m", depth_m, depth_m > 0.0, "above 0")?;
            OptionError::check("expected std_m", std_m, std_m > 0.0, "above 0")
        }
    }
}

/// Why a box gives no range.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum DepthInBoxError {
    /// The edges are swapped, equal or not finite.
    #[error("the box {x0} {y0} {x1} {y1} has no area")]
    ImproperBox {
        /// Left edge.
        x0: f32,
        /// Top edge.
        y0: f32,
        /// Right edge.
        x1: f32,
        /// Bottom edge.
        y1: f32,
    },
    /// No pixel of the map has its centre in the box.
    #[error("the box {x0} {y0} {x1} {y1} holds no pixel of a depth map of {width}x{height}")]
    Outside {
        /// Left edge.
        x0: f32,
        /// Top edge.
        y0: f32,
        /// Right edge.
        x1: f32,
        /// Bottom edge.
        y1: f32,
        /// Pixels a row of the map.
        width: u32,
        /// Rows of the map.
        height: u32,
    },
    /// None of the pixels read has a depth.
    #[error("none of the {pixels} pixels in the box has a depth")]
    NothingKnown {
        /// Pixels read.
        pixels: usize,
    },
    /// Not enough pixels have a depth.
    #[error("{known} of {pixels} pixels in the box have a depth, {needed} are needed")]
    TooFewKnown {
        /// Pixels with a depth.
        known: usize,
        /// Pixels read.
        pixels: usize,
        /// Least number accepted.
        needed: usize,
    },
    /// Not enough depths near the peak.
    #[error("the peak at {peak_m:.3} m has {found} depths about it, {needed} are needed")]
    ThinPeak {
        /// Depth of the peak, metres.
        peak_m: f64,
        /// Depths in the widened interval.
        found: usize,
        /// Least number accepted.
        needed: usize,
    },
    /// [`PeakRule::Expected`] found nothing within four deviations.
    #[error("no depth in the box is within 4 deviations of the expected {depth_m} +- {std_m} m")]
    NothingExpected {
        /// Depth expected, metres.
        depth_m: f64,
        /// Its standard deviation, metres.
        std_m: f64,
    },
    /// A number given does not fit.
    #[error(transparent)]
    Option(#[from] OptionError),
    /// A foreground was asked for before a measurement succeeded.
    #[error("no box has been measured")]
    NotMeasured,
}

/// Another body in the box that could be the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RivalPeak {
    /// Where its density is highest, metres.
    pub depth_m: f64,
    /// Its density as a share of the chosen peak's. Near 1 and above, the choice
    /// was a close one, and no deviation below covers the wrong choice.
    pub share: f64,
}

/// The range of the target in a box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxDepth {
    /// Mean of the depths in the interval: the range, metres along the optical
    /// axis.
    pub depth_m: f64,
    /// Its standard deviation, metres: the root of the squares of
    /// [`BoxDepth::random_m`], [`BoxDepth::interval_m`] and
    /// [`BoxDepth::source_m`].
    pub std_m: f64,
    /// Standard error of the mean: [`BoxDepth::spread_m`] over the root of the
    /// number of independent depths.
    pub random_m: f64,
    /// How far the mean moves when an end of the interval moves by one bin: what
    /// the choice of the share and of the bins is worth.
    pub interval_m: f64,
    /// The depth source's common error at this depth, which does not average.
    pub source_m: f64,
    /// Standard deviation of the depths in the interval, metres: noise and the
    /// target's own extent along the axis.
    pub spread_m: f64,
    /// The widened interval.
    pub interval: FocusInterval,
    /// The interval with its flanks: up to where the density rises again or is
    /// less than 2 % of the peak's.
    pub basin: FocusInterval,
    /// Pixels read.
    pub pixels: usize,
    /// Those of them with a depth.
    pub known: usize,
    /// Depths in the interval.
    pub used: usize,
    /// The strongest other peak in the box, over all its depths.
    pub rival: Option<RivalPeak>,
}

impl BoxDepth {
    /// Share of the known depths that lie in the interval, 0 to 1.
    #[must_use]
    pub fn used_share(&self) -> f64 {
        self.used as f64 / self.known as f64
    }
}

/// The paper's depth in a box: a histogram over the known depths of the pixels
/// whose centres lie in the box, the peak of its density, widened to both sides
/// while the density is at least a share of the peak's; the range is the mean of
/// the depths in that interval.
///
/// A box also shows background, and may show part of something nearer. The
/// highest peak is right while the target covers more pixels at one depth than
/// anything else; [`PeakRule`] and [`DepthInBoxOptions::center_sigma`] are for
/// when it does not, and [`BoxDepth::rival`] says how close the choice was.
///
/// Owns its scratch: after the first boxes of the largest size nothing is
/// allocated.
///
/// ```
/// use realnet_core::{BoundingBox, DepthMap, Stamp};
/// use realnet_range::cues::{DepthInBox, DepthInBoxOptions, DepthNoise};
///
/// // a target at 2 m before a wall at 5 m
/// let data = (0..64 * 48)
///     .map(|i| if (20..44).contains(&(i % 64)) && i / 64 > 10 { 2.0 } else { 5.0 })
///     .collect();
/// let map = DepthMap::new(Stamp::ZERO, 64, 48, data)?;
/// let mut cue = DepthInBox::new(DepthInBoxOptions::default())?;
/// let noise = DepthNoise::new(0.01, 0.02);
/// let range = cue.measure(&map, BoundingBox::new(18.0, 9.0, 46.0, 48.0), noise)?;
/// assert!((range.depth_m - 2.0).abs() < 1e-6);
/// assert!((range.std_m - noise.std_at(2.0)).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct DepthInBox {
    options: DepthInBoxOptions,
    samples: Vec<Sample>,
    overview: DepthHistogram,
    histogram: DepthHistogram,
    last: Option<(BoundingBox, BoxDepth)>,
}

impl DepthInBox {
    /// # Errors
    /// [`OptionError`] when an option is out of its range.
    pub fn new(options: DepthInBoxOptions) -> Result<Self, OptionError> {
        options.check()?;
        Ok(Self {
            options,
            samples: Vec::new(),
            overview: DepthHistogram::default(),
            histogram: DepthHistogram::default(),
            last: None,
        })
    }

    /// The options in use.
    #[must_use]
    pub fn options(&self) -> &DepthInBoxOptions {
        &self.options
    }

    /// Chooses another peak from now on: a new prediction for
    /// [`PeakRule::Expected`].
    ///
    /// # Errors
    /// [`OptionError`] when a number of the rule is out of its range; the old
    /// rule then stays.
    pub fn set_peak(&mut self, peak: PeakRule) -> Result<(), OptionError> {
        check_peak(peak)?;
        self.options.peak = peak;
        Ok(())
    }

    /// The range in `bbox`, whose edges lie between the pixels of `map`: a pixel
    /// belongs to it when its centre (column + 0.5, row + 0.5) does. The part of
    /// the box outside the map is not regarded.
    ///
    /// # Errors
    /// [`DepthInBoxError`] with the reason why there is no range.
    pub fn measure(
        &mut self,
        map: &DepthMap,
        bbox: BoundingBox,
        noise: DepthNoise,
    ) -> Result<BoxDepth, DepthInBoxError> {
        self.last = None;
        self.overview.clear();
        self.histogram.clear();
        noise.check()?;
        let (pixels, step) = self.read(map, bbox)?;
        let known = self.samples.len();
        let needed = self.options.min_pixels;
        if known == 0 {
            return Err(DepthInBoxError::NothingKnown { pixels });
        }
        if known < needed {
            return Err(DepthInBoxError::TooFewKnown { known, pixels, needed });
        }
        self.find_interval()?;

        let interval = self.histogram.interval();
        let used = within(&self.samples, interval);
        let count = used.len();
        if count < needed {
            let peak_m = self.histogram.center(self.histogram.peak());
            return Err(DepthInBoxError::ThinPeak { peak_m, found: count, needed });
        }
        let (mean, spread) = mean_and_std(used);
        let per_patch = (step as f64 / self.options.correlation_px).powi(2).min(1.0);
        let random_m = spread / (count as f64 * per_patch).max(1.0).sqrt();
        let interval_m = self.edge_error(used, mean);
        let source_m = noise.std_at(mean);
        let (first, last) = self.histogram.basin(BASIN_SHARE);
        let basin =
            FocusInterval { near: self.histogram.edge(first), far: self.histogram.edge(last + 1) };
        let rival = self
            .overview
            .rival(self.overview.basin(BASIN_SHARE))
            .map(|(bin, share)| RivalPeak { depth_m: self.overview.center(bin), share });
        let depth = BoxDepth {
            depth_m: mean,
            std_m: random_m.hypot(interval_m).hypot(source_m),
            random_m,
            interval_m,
            source_m,
            spread_m: spread,
            interval,
            basin,
            pixels,
            known,
            used: count,
            rival,
        };
        self.last = Some((bbox, depth));
        Ok(depth)
    }

    /// The histogram in which the interval of the last measurement was found:
    /// the finest one. Empty after a measurement that failed early.
    #[must_use]
    pub fn histogram(&self) -> &DepthHistogram {
        &self.histogram
    }

    /// The histogram over all depths of the last box, less the clipped ends: the
    /// one to plot. The same as [`DepthInBox::histogram`] without a zoom.
    #[must_use]
    pub fn overview(&self) -> &DepthHistogram {
        &self.overview
    }

    /// Divides the last box into target and background.
    ///
    /// # Errors
    /// [`DepthInBoxError::NotMeasured`] when the last measurement failed or none
    /// was made, [`DepthInBoxError::Option`] when the rule's numbers do not fit.
    pub fn foreground(&self, rule: &SigmaRule) -> Result<Foreground, DepthInBoxError> {
        let (bbox, depth) = self.last.ok_or(DepthInBoxError::NotMeasured)?;
        rule.check()?;
        let (window, mean_m, sigma_m, used) = rule.fit(&self.samples, &depth);
        let gate = ForegroundGate {
            bbox,
            near: window.near as f32,
            far: window.far as f32,
            margin_px: rule.margin_px,
        };
        let share = used as f64 / depth.known as f64;
        Ok(Foreground { gate, mean_m, sigma_m, share })
    }

    /// Reads the known depths in the box, sorted; the number of pixels read and
    /// the step of the grid.
    fn read(
        &mut self,
        map: &DepthMap,
        bbox: BoundingBox,
    ) -> Result<(usize, usize), DepthInBoxError> {
        self.samples.clear();
        let BoundingBox { x0, y0, x1, y1 } = bbox;
        if !bbox.is_proper() {
            return Err(DepthInBoxError::ImproperBox { x0, y0, x1, y1 });
        }
        let (width, height) = (map.width(), map.height());
        // The first pixel whose centre is at or beyond an edge.
        let pixel = |edge: f32, size: u32| (edge - 0.5).ceil().clamp(0.0, size as f32) as usize;
        let (left, right) = (pixel(x0, width), pixel(x1, width));
        let (top, bottom) = (pixel(y0, height), pixel(y1, height));
        let area = right.saturating_sub(left) * bottom.saturating_sub(top);
        if area == 0 {
            return Err(DepthInBoxError::Outside { x0, y0, x1, y1, width, height });
        }
        let step = ((area as f64 / self.options.max_samples as f64).sqrt().ceil() as usize).max(1);
        // The grid is centred in its cells.
        let start = (step - 1) / 2;
        let (cx, cy) = bbox.center();
        let limit = self.options.max_depth_m;
        let mut pixels = 0;
        for y in (top..bottom).skip(start).step_by(step) {
            let row = map.row(y as u32).get(left..right).unwrap_or(&[]);
            for (offset, &depth) in row.iter().enumerate().skip(start).step_by(step) {
                pixels += 1;
                if !DepthMap::is_known(depth) || f64::from(depth) > limit {
                    continue;
                }
                let weight = self.options.center_sigma.map_or(1.0, |sigma| {
                    let dx = ((left + offset) as f32 + 0.5 - cx) / bbox.width();
                    let dy = (y as f32 + 0.5 - cy) / bbox.height();
                    (-0.5 * (dx * dx + dy * dy) / (sigma * sigma) as f32).exp()
                });
                self.samples.push(Sample { depth, weight });
            }
        }
        self.samples.sort_unstable_by(|a, b| a.depth.total_cmp(&b.depth));
        Ok((pixels, step))
    }

    /// Fills the histograms and finds the interval.
    fn find_interval(&mut self) -> Result<(), DepthInBoxError> {
        let options = self.options;
        let clipped = (options.clip_share * self.samples.len() as f64) as usize;
        let at = |index: usize| self.samples.get(index).map_or(0.0, |s| f64::from(s.depth));
        let mut range =
            FocusInterval { near: at(clipped), far: at(self.samples.len() - 1 - clipped) };
        let total: f64 = self.samples.iter().map(|sample| f64::from(sample.weight)).sum();
        for zoom in 0..=MAX_ZOOMS {
            let (start, bin, finest) = self.bins_over(range);
            self.histogram.fill(
                &self.samples,
                total,
                (start, bin, options.bins),
                options.smoothing_bins,
            );
            // The neighbourhood of the chosen peak was chosen already.
            let rule = if zoom == 0 { options.peak } else { PeakRule::Highest };
            if !self.histogram.find_peak(rule) {
                return Err(match options.peak {
                    PeakRule::Expected { depth_m, std_m } => {
                        DepthInBoxError::NothingExpected { depth_m, std_m }
                    }
                    _ => DepthInBoxError::NothingKnown { pixels: self.samples.len() },
                });
            }
            self.histogram.widen(options.widen_share);
            if zoom == 0 {
                self.overview.copy_from(&self.histogram);
            }
            let (first, last) = self.histogram.interval_bins();
            if finest || !options.zoom || last - first >= UNRESOLVED_BINS {
                break;
            }
            let margin = ZOOM_MARGIN_BINS as f64 * self.histogram.bin_width();
            let interval = self.histogram.interval();
            range = FocusInterval { near: interval.near - margin, far: interval.far + margin };
        }
        Ok(())
    }

    /// Start and width of the bins over a range, and whether they are as narrow
    /// as is allowed (the range is then in their middle).
    fn bins_over(&self, range: FocusInterval) -> (f64, f64, bool) {
        let bins = self.options.bins as f64;
        let middle = 0.5 * (range.near + range.far);
        // Also never below what 32-bit depths resolve.
        let least = self.options.min_bin.std_at(middle).max(1e-6 * middle);
        let bin = range.width() / bins;
        if bin > least {
            (range.near, bin, false)
        } else {
            (middle - 0.5 * bins * least, least, true)
        }
    }

    /// The move of the mean when either end of the interval loses its bin.
    fn edge_error(&self, used: &[Sample], mean: f64) -> f64 {
        let interval = self.histogram.interval();
        let bin = self.histogram.bin_width();
        let move_by = |edge: FocusInterval| {
            let lost = within(used, edge);
            if lost.is_empty() || lost.len() == used.len() {
                return 0.0;
            }
            let (lost_mean, _) = mean_and_std(lost);
            // (n mean - k lost) / (n - k) - mean
            let share = lost.len() as f64 / (used.len() - lost.len()) as f64;
            share * (mean - lost_mean)
        };
        let near = move_by(FocusInterval { near: interval.near, far: interval.near + bin });
        let far = move_by(FocusInterval { near: interval.far - bin, far: interval.far });
        near.hypot(far)
    }
}

/// The samples, sorted by depth, that lie in an interval.
pub(crate) fn within(samples: &[Sample], interval: FocusInterval) -> &[Sample] {
    let start = samples.partition_point(|s| f64::from(s.depth) < interval.near);
    let end = samples.partition_point(|s| f64::from(s.depth) <= interval.far);
    samples.get(start..end).unwrap_or(&[])
}

/// Mean and standard deviation (with one degree of freedom taken off).
pub(crate) fn mean_and_std(samples: &[Sample]) -> (f64, f64) {
    let count = samples.len().max(1) as f64;
    let mean = samples.iter().map(|s| f64::from(s.depth)).sum::<f64>() / count;
    let squares: f64 = samples.iter().map(|s| (f64::from(s.depth) - mean).powi(2)).sum();
    (mean, (squares / (count - 1.0).max(1.0)).sqrt())
}
