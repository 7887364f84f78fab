//! Errors of surface normals: how far the shape of produced depth is from the true one, which
//! errors of single depths do not say.

use serde::{Deserialize, Serialize};

/// Figures of angles between true and produced normals, as the field reports them since
/// Fouhey et al. (2013).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NormalErrors {
    /// Mean angle, degrees.
    pub mean_deg: f64,
    /// Median angle, degrees.
    pub median_deg: f64,
    /// Share within 11.25 degrees.
    pub within_11: f64,
    /// Share within 22.5 degrees.
    pub within_22: f64,
    /// Share within 30 degrees.
    pub within_30: f64,
}

impl NormalErrors {
    fn values(&self) -> [f64; 5] {
        [self.mean_deg, self.median_deg, self.within_11, self.within_22, self.within_30]
    }

    fn from_values([mean_deg, median_deg, within_11, within_22, within_30]: [f64; 5]) -> Self {
        Self { mean_deg, median_deg, within_11, within_22, within_30 }
    }
}

/// Collects the errors of normals, image by image; the figures are means of the images'.
///
/// ```
/// use realnet_eval::NormalMetrics;
///
/// let mut metrics = NormalMetrics::default();
/// metrics.add([5.0, 10.0, 25.0, 40.0]);
/// let errors = metrics.errors().unwrap_or_default();
/// assert_eq!((errors.mean_deg, errors.median_deg), (20.0, 17.5));
/// assert_eq!((metrics.images(), metrics.pixels()), (1, 4));
/// assert_eq!((errors.within_11, errors.within_30), (0.5, 0.75));
/// ```
#[derive(Clone, Debug, Default)]
pub struct NormalMetrics {
    images: usize,
    pixels: u64,
    sums: [f64; 5],
    sorted: Vec<f64>,
}

impl NormalMetrics {
    /// Adds the angles of one image's pixels, degrees. One without any is not counted.
    pub fn add(&mut self, angles: impl IntoIterator<Item = f64>) {
        self.sorted.clear();
        self.sorted.extend(angles);
        self.sorted.sort_unstable_by(f64::total_cmp);
        let angles = &self.sorted;
        let count = angles.len();
        let middle = [angles.get(count.saturating_sub(1) / 2), angles.get(count / 2)];
        let [Some(low), Some(high)] = middle else { return };
        let within = |most: f64| angles.partition_point(|a| *a < most) as f64 / count as f64;
        let values = [
            angles.iter().sum::<f64>() / count as f64,
            (low + high) / 2.0,
            within(11.25),
            within(22.5),
            within(30.0),
        ];
        for (sum, value) in self.sums.iter_mut().zip(values) {
            *sum += value;
        }
        self.images += 1;
        self.pixels += count as u64;
    }

    /// Images that the figures are of.
    #[must_use]
    pub const fn images(&self) -> usize {
        self.images
    }

    /// Pixels that were compared.
    #[must_use]
    pub const fn pixels(&self) -> u64 {
        self.pixels
    }

    /// The figures so far; `None` before the first image.
    #[must_use]
    pub fn errors(&self) -> Option<NormalErrors> {
        let count = self.images as f64;
        (self.images > 0).then(|| NormalErrors::from_values(self.sums.map(|sum| sum / count)))
    }
}

impl std::fmt::Display for NormalErrors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [mean, median, shares @ ..] = self.values();
        let [a, b, c] = shares.map(|share| 100.0 * share);
        write!(
            f,
            "surface normals: mean {mean:.2} deg, median {median:.2} deg; {a:.1} % within 11.25, \
             {b:.1} % within 22.5, {c:.1} % within 30 deg"
        )
    }
}
