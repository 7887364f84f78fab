//! Errors of depth maps.
//!
//! Published depth figures differ by protocol as much as by method, so the
//! protocol is part of every result here: what the truth is, which crop, which
//! range of depths, whether each map was scaled to the truth's median, and
//! whether a figure is the mean of the images' figures or pools all pixels. Both
//! means are always computed.
//!
//! With `g` the true and `p` the produced depth of a pixel, in metres, and the
//! mean over the pixels compared (Eigen, Puhrsch and Fergus, 2014, section 4.2):
//!
//! | figure | definition |
//! |---|---|
//! | `abs_rel` | mean of `abs(g - p) / g` |
//! | `sq_rel` | mean of `(g - p)^2 / g`, metres |
//! | `rmse` | root of the mean of `(g - p)^2`, metres |
//! | `rmse_log` | root of the mean of `(ln g - ln p)^2` |
//! | `log10` | mean of `abs(log10 g - log10 p)` |
//! | `silog` | `100 * sqrt(mean(e^2) - mean(e)^2)` with `e = ln p - ln g`, as KITTI reports it |
//! | `d1`, `d2`, `d3` | share with `max(g / p, p / g)` below 1.25, 1.25^2, 1.25^3 |

use realnet_core::DepthMap;
use serde::{Deserialize, Serialize};
use std::fmt;
use thiserror::Error;

mod sums;
#[cfg(test)]
mod tests;

use sums::Sums;

/// The part of a picture that is evaluated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DepthCrop {
    /// All of it.
    #[default]
    Full,
    /// Garg et al. (2016), for KITTI: rows 0.40810811 to 0.99189189 of the
    /// height, columns 0.03594771 to 0.96405229 of the width.
    Garg,
    /// Eigen et al. (2014), for KITTI: rows 0.3324324 to 0.91351351, columns
    /// 0.03594771 to 0.96405229.
    Eigen,
    /// Eigen et al. (2014), for NYU Depth V2: rows 45 to 470, columns 41 to 600
    /// of 640x480, in proportion for other sizes.
    Nyu,
}

/// A half-open range of pixels.
type Range = std::ops::Range<u32>;

impl DepthCrop {
    /// Rows and columns of a picture of `width` x `height` that are evaluated,
    /// the ends excluded; fractions are cut off, as the published code does.
    #[must_use]
    pub fn window(self, width: u32, height: u32) -> (Range, Range) {
        let share = |side: u32, from: f64, to: f64| {
            let at = |share: f64| (share * f64::from(side)) as u32;
            at(from)..at(to)
        };
        let part = |side: u32, from: u64, to: u64, whole: u64| {
            // At most `side`.
            let at = |n: u64| (n * u64::from(side) / whole) as u32;
            at(from)..at(to)
        };
        let columns = || share(width, 0.035_947_71, 0.964_052_29);
        match self {
            Self::Full => (0..height, 0..width),
            Self::Garg => (share(height, 0.408_108_11, 0.991_891_89), columns()),
            Self::Eigen => (share(height, 0.332_432_4, 0.913_513_51), columns()),
            Self::Nyu => (part(height, 45, 471, 480), part(width, 41, 601, 640)),
        }
    }
}

impl fmt::Display for DepthCrop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Full => "none",
            Self::Garg => "Garg",
            Self::Eigen => "Eigen",
            Self::Nyu => "Eigen for NYU",
        })
    }
}

/// Over what a figure is averaged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pooling {
    /// The figure of each image, then their mean: what most papers report.
    #[default]
    PerImage,
    /// All pixels of all images at once (the code of VNL).
    Pixels,
}

impl fmt::Display for Pooling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PerImage => "mean of images",
            Self::Pixels => "all pixels pooled",
        })
    }
}

/// How depth maps are compared. Part of every [`DepthReport`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DepthProtocol {
    /// What the truth is, in the words of the caller: `raw LiDAR`, `improved
    /// ground truth`, `structured light`.
    pub truth: String,
    /// The part of the picture.
    pub crop: DepthCrop,
    /// True depths at or below are left out, produced ones raised to it; metres.
    pub min_depth: f64,
    /// True depths at or above are left out, produced ones lowered to it;
    /// metres.
    pub max_depth: f64,
    /// Whether each produced map is first multiplied by the ratio of the
    /// medians, truth over produced, of the pixels compared. Figures with and
    /// without it must not be put side by side.
    pub median_scaling: bool,
    /// Which of the two means [`DepthReport::errors`] gives.
    pub pooling: Pooling,
}

impl DepthProtocol {
    /// No crop, depths of 1 mm to 80 m, no scaling, the mean of images.
    #[must_use]
    pub fn new(truth: impl Into<String>) -> Self {
        Self {
            truth: truth.into(),
            crop: DepthCrop::Full,
            min_depth: 1e-3,
            max_depth: 80.0,
            median_scaling: false,
            pooling: Pooling::PerImage,
        }
    }

    /// The protocol of NYU Depth V2: Eigen's crop for it, depths to 10 m.
    #[must_use]
    pub fn nyu(truth: impl Into<String>) -> Self {
        Self { crop: DepthCrop::Nyu, max_depth: 10.0, ..Self::new(truth) }
    }
}

impl fmt::Display for DepthProtocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scaling = if self.median_scaling { "yes" } else { "no" };
        write!(
            f,
            "truth: {}; crop: {}; depths: {} to {} m; median scaling: {scaling}; figures: {}",
            self.truth, self.crop, self.min_depth, self.max_depth, self.pooling
        )
    }
}

/// Why depth maps cannot be compared.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DepthEvalError {
    /// The maps are not of one size.
    #[error(
        "image {image}: the true depth map is {}x{}, the produced one {}x{}",
        truth.0, truth.1, produced.0, produced.1
    )]
    Size {
        /// How many images came before.
        image: usize,
        /// Width and height of the truth.
        truth: (u32, u32),
        /// Width and height of what was produced.
        produced: (u32, u32),
    },
    /// A range of depths that holds nothing.
    #[error("depths from {min} to {max} m: 0 < min < max is needed")]
    Range {
        /// Lower end.
        min: f64,
        /// Upper end.
        max: f64,
    },
}

/// The figures, see the [module](self).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DepthErrors {
    /// Absolute relative error.
    pub abs_rel: f64,
    /// Squared relative error, metres.
    pub sq_rel: f64,
    /// Root mean square error, metres.
    pub rmse: f64,
    /// Root mean square error of the natural logarithm.
    pub rmse_log: f64,
    /// Mean absolute error of the decimal logarithm.
    pub log10: f64,
    /// Scale-invariant logarithmic error, times 100.
    pub silog: f64,
    /// Share within a factor 1.25.
    pub d1: f64,
    /// Share within a factor 1.25^2.
    pub d2: f64,
    /// Share within a factor 1.25^3.
    pub d3: f64,
}

impl DepthErrors {
    /// Names of the figures, in the order of [`DepthErrors::values`].
    pub const NAMES: [&str; 9] =
        ["abs_rel", "sq_rel", "rmse", "rmse_log", "log10", "silog", "d1", "d2", "d3"];

    /// The figures in the order of [`DepthErrors::NAMES`].
    #[must_use]
    pub fn values(&self) -> [f64; 9] {
        [
            self.abs_rel,
            self.sq_rel,
            self.rmse,
            self.rmse_log,
            self.log10,
            self.silog,
            self.d1,
            self.d2,
            self.d3,
        ]
    }

    fn from_values([abs_rel, sq_rel, rmse, rmse_log, log10, silog, d1, d2, d3]: [f64; 9]) -> Self {
        Self { abs_rel, sq_rel, rmse, rmse_log, log10, silog, d1, d2, d3 }
    }
}

/// What one image contributes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageDepth {
    /// Pixels with a true depth inside crop and range.
    pub truth_pixels: u64,
    /// Those of them that have a produced depth too: the ones compared.
    pub pixels: u64,
    /// The figures; `None` when no pixel was compared.
    pub errors: Option<DepthErrors>,
    /// The ratio of the medians that the map was multiplied by.
    pub scale: Option<f64>,
}

/// Collects the errors of depth maps, image by image.
///
/// ```
/// use realnet_core::{DepthMap, Stamp};
/// use realnet_eval::{DepthMetrics, DepthProtocol};
///
/// let truth = DepthMap::new(Stamp::ZERO, 2, 2, vec![1.0, 2.0, 4.0, 0.0])?;
/// let produced = DepthMap::new(Stamp::ZERO, 2, 2, vec![1.1, 2.0, 0.0, 3.0])?;
/// let mut metrics = DepthMetrics::new(DepthProtocol::new("by hand"))?;
/// metrics.add(&truth, &produced)?;
/// let report = metrics.report();
/// // 10 % off in one of two pixels; two of three true depths have an answer
/// assert!((report.errors().map_or(0.0, |e| e.abs_rel) - 0.05).abs() < 1e-6);
/// assert_eq!(report.known_share, Some(2.0 / 3.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct DepthMetrics {
    protocol: DepthProtocol,
    images: usize,
    compared_images: usize,
    truth_pixels: u64,
    pooled: Sums,
    /// Sums of the images' figures.
    means: [f64; 9],
    scales: Vec<f64>,
    /// Pairs of one image, kept for their memory.
    pairs: Vec<(f64, f64)>,
    sorted: Vec<f64>,
}

impl DepthMetrics {
    /// An empty collection.
    ///
    /// # Errors
    /// [`DepthEvalError::Range`] unless `0 < min_depth < max_depth`.
    pub fn new(protocol: DepthProtocol) -> Result<Self, DepthEvalError> {
        let (min, max) = (protocol.min_depth, protocol.max_depth);
        if !(min > 0.0 && min < max && max.is_finite()) {
            return Err(DepthEvalError::Range { min, max });
        }
        Ok(Self {
            protocol,
            images: 0,
            compared_images: 0,
            truth_pixels: 0,
            pooled: Sums::default(),
            means: [0.0; 9],
            scales: Vec::new(),
            pairs: Vec::new(),
            sorted: Vec::new(),
        })
    }

    /// How maps are compared.
    #[must_use]
    pub const fn protocol(&self) -> &DepthProtocol {
        &self.protocol
    }

    /// Adds one image: the pixels whose true depth lies in crop and range. A
    /// pixel without a produced depth is not compared, it lowers
    /// [`DepthReport::known_share`].
    ///
    /// # Errors
    /// [`DepthEvalError::Size`] when the maps are not of one size; nothing is
    /// added then.
    pub fn add(
        &mut self,
        truth: &DepthMap,
        produced: &DepthMap,
    ) -> Result<ImageDepth, DepthEvalError> {
        self.add_where(truth, produced, |_, _| true)
    }

    /// As [`DepthMetrics::add`], for the pixels `(x, y)` alone that `keep` says
    /// yes to: a region, or those that a rival method knows too.
    ///
    /// # Errors
    /// As [`DepthMetrics::add`].
    pub fn add_where(
        &mut self,
        truth: &DepthMap,
        produced: &DepthMap,
        keep: impl Fn(u32, u32) -> bool,
    ) -> Result<ImageDepth, DepthEvalError> {
        let size = |map: &DepthMap| (map.width(), map.height());
        if size(truth) != size(produced) {
            let (truth, produced) = (size(truth), size(produced));
            return Err(DepthEvalError::Size { image: self.images, truth, produced });
        }
        let (min, max) = (self.protocol.min_depth, self.protocol.max_depth);
        let (rows, columns) = self.protocol.crop.window(truth.width(), truth.height());
        let part = columns.start as usize..columns.end as usize;
        let mut truth_pixels = 0;
        self.pairs.clear();
        for y in rows {
            let row = |map| DepthMap::row(map, y).get(part.clone()).unwrap_or(&[]);
            for ((x, &g), &p) in columns.clone().zip(row(truth)).zip(row(produced)) {
                let depth = f64::from(g);
                if DepthMap::is_known(g) && depth > min && depth < max && keep(x, y) {
                    truth_pixels += 1;
                    if DepthMap::is_known(p) {
                        self.pairs.push((depth, f64::from(p)));
                    }
                }
            }
        }
        let scale = if self.protocol.median_scaling { self.median_ratio() } else { None };
        let mut sums = Sums::default();
        for &(g, p) in &self.pairs {
            sums.add(g, (p * scale.unwrap_or(1.0)).clamp(min, max));
        }
        let errors = sums.errors();
        self.images += 1;
        self.truth_pixels += truth_pixels;
        self.pooled.join(&sums);
        self.scales.extend(scale);
        if let Some(errors) = &errors {
            self.compared_images += 1;
            for (sum, value) in self.means.iter_mut().zip(errors.values()) {
                *sum += value;
            }
        }
        Ok(ImageDepth { truth_pixels, pixels: sums.count(), errors, scale })
    }

    /// Median of the true over median of the produced depths of the pairs.
    fn median_ratio(&mut self) -> Option<f64> {
        let mut median = |value: fn(&(f64, f64)) -> f64| {
            self.sorted.clear();
            self.sorted.extend(self.pairs.iter().map(value));
            median(&mut self.sorted)
        };
        Some(median(|pair| pair.0)? / median(|pair| pair.1)?)
    }

    /// The figures so far.
    #[must_use]
    pub fn report(&self) -> DepthReport {
        let count = self.compared_images;
        let mean = |sum: f64| sum / count as f64;
        let per_image = (count > 0).then(|| DepthErrors::from_values(self.means.map(mean)));
        let pixels = self.pooled.count();
        let known = pixels as f64 / self.truth_pixels as f64;
        DepthReport {
            protocol: self.protocol.clone(),
            images: self.images,
            images_compared: count,
            truth_pixels: self.truth_pixels,
            pixels,
            known_share: (self.truth_pixels > 0).then_some(known),
            per_image,
            pooled: self.pooled.errors(),
            scale: ScaleSpread::of(&self.scales),
        }
    }
}

/// How the ratios of the medians spread over the images.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScaleSpread {
    /// Their median.
    pub median: f64,
    /// Their standard deviation, divided by the median.
    pub relative_std: f64,
}

impl ScaleSpread {
    fn of(scales: &[f64]) -> Option<Self> {
        let median = median(&mut scales.to_vec())?;
        let n = scales.len() as f64;
        let mean = scales.iter().sum::<f64>() / n;
        let variance = scales.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / n;
        Some(Self { median, relative_std: variance.sqrt() / median })
    }
}

/// The median; of an even number the mean of the middle two.
pub(crate) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let even = values.len().is_multiple_of(2);
    let (below, upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let upper = *upper;
    match below.iter().copied().max_by(f64::total_cmp) {
        Some(lower) if even => Some((lower + upper) / 2.0),
        _ => Some(upper),
    }
}

/// Errors of depth maps with the protocol that they were measured by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DepthReport {
    /// How it was measured.
    pub protocol: DepthProtocol,
    /// Images added.
    pub images: usize,
    /// Those with at least one pixel compared.
    pub images_compared: usize,
    /// Pixels with a true depth inside crop and range, over all images.
    pub truth_pixels: u64,
    /// Those of them that have a produced depth too.
    pub pixels: u64,
    /// `pixels / truth_pixels`; `None` without any truth.
    pub known_share: Option<f64>,
    /// Means of the images' figures.
    pub per_image: Option<DepthErrors>,
    /// Figures of all pixels pooled.
    pub pooled: Option<DepthErrors>,
    /// The ratios of the medians, with median scaling.
    pub scale: Option<ScaleSpread>,
}

impl DepthReport {
    /// The figures by the mean of the protocol; `None` when nothing was
    /// compared.
    #[must_use]
    pub fn errors(&self) -> Option<DepthErrors> {
        match self.protocol.pooling {
            Pooling::PerImage => self.per_image,
            Pooling::Pixels => self.pooled,
        }
    }

    /// A plain text table with the protocol above it. Every line ends with a
    /// line feed.
    #[must_use]
    pub fn table(&self) -> String {
        let known = self.known_share.map_or("-".into(), |s| format!("{:.1} %", 100.0 * s));
        let mut text = format!(
            "{}\nimages: {} ({} compared); pixels compared: {} of {} with truth ({known})\n",
            self.protocol, self.images, self.images_compared, self.pixels, self.truth_pixels
        );
        if let Some(ScaleSpread { median, relative_std }) = self.scale {
            let spread = 100.0 * relative_std;
            text.push_str(&format!("scale: median {median:.4}, spread {spread:.1} %\n"));
        }
        text.push_str(&format!("{:<17}", "figures"));
        for name in DepthErrors::NAMES {
            text.push_str(&format!(" {name:>8}"));
        }
        text.push('\n');
        for (pooling, errors) in
            [(Pooling::PerImage, self.per_image), (Pooling::Pixels, self.pooled)]
        {
            text.push_str(&format!("{:<17}", pooling.to_string()));
            for i in 0..DepthErrors::NAMES.len() {
                let value = errors.and_then(|e| e.values().get(i).copied());
                let value = value.map_or("-".into(), |v| format!("{v:.4}"));
                text.push_str(&format!(" {value:>8}"));
            }
            text.push('\n');
        }
        text
    }
}
