//! A Gaussian whose covariance cannot lose its positive definiteness.

use realnet_core::nalgebra::{SMatrix, SVector};
use thiserror::Error;

/// No pivot of the covariance ever falls below this, so that none underflows to zero.
const SMALLEST_PIVOT: f64 = 1e-280;

/// Why a Gaussian cannot be made or changed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum GaussianError {
    /// The covariance is not positive definite.
    #[error("covariance is not positive definite: pivot {index} is {pivot}")]
    NotPositiveDefinite {
        /// Row of the covariance.
        index: usize,
        /// What is left of the variance there.
        pivot: f64,
    },
    /// A number that is not finite, or a variance that is not positive.
    #[error("{what} is {value}")]
    Invalid {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
}

/// Mean and covariance of `N` numbers, the covariance kept as its factors
/// `U D Uᵀ`, U upper triangular with ones on the diagonal, D diagonal.
///
/// All operations change the factors directly: measurements by Bierman's update,
/// transitions by Thornton's weighted Gram-Schmidt, single noises by Agee and
/// Turner's rank-one update (Bierman, *Factorization Methods for Discrete Sequential
/// Estimation*, 1977). D stays positive in all of them because it is only multiplied
/// by, and added to, positive numbers: there is no subtraction that rounding could
/// turn negative, whatever the order and the sizes of the measurements.
///
/// ```
/// use realnet_core::nalgebra::{Matrix2, Vector2};
/// use realnet_fusion::Gaussian;
///
/// let mut pair = Gaussian::new(Vector2::new(1.0, 2.0), &Matrix2::identity())?;
/// // Their sum was measured as 4, as exactly as it was known before.
/// let residual = 4.0 - pair.mean().sum();
/// pair.update(residual, &Vector2::new(1.0, 1.0), 2.0)?;
/// assert!((pair.mean() - Vector2::new(1.25, 2.25)).norm() < 1e-12);
/// assert!((pair.covariance()[(0, 1)] + 0.25).abs() < 1e-12);
/// # Ok::<(), realnet_fusion::GaussianError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian<const N: usize> {
    mean: SVector<f64, N>,
    /// U: ones on the diagonal, zeros below.
    upper: SMatrix<f64, N, N>,
    /// D.
    pivots: SVector<f64, N>,
}

impl<const N: usize> Gaussian<N> {
    /// From mean and covariance; of the covariance the upper triangle is read.
    ///
    /// # Errors
    ///
    /// [`GaussianError::Invalid`] for a mean that is not finite,
    /// [`GaussianError::NotPositiveDefinite`] for a covariance that is not.
    pub fn new(
        mean: SVector<f64, N>,
        covariance: &SMatrix<f64, N, N>,
    ) -> Result<Self, GaussianError> {
        if let Some(value) = mean.iter().find(|v| !v.is_finite()) {
            return Err(GaussianError::Invalid { what: "mean", value: *value });
        }
        let mut upper = SMatrix::<f64, N, N>::identity();
        let mut pivots = SVector::<f64, N>::zeros();
        for j in (0..N).rev() {
            let taken = |i: usize, upper: &SMatrix<f64, N, N>, pivots: &SVector<f64, N>| {
                (j + 1..N).map(|k| pivots[k] * upper[(i, k)] * upper[(j, k)]).sum::<f64>()
            };
            let pivot = covariance[(j, j)] - taken(j, &upper, &pivots);
            if !(pivot.is_finite() && pivot > SMALLEST_PIVOT) {
                return Err(GaussianError::NotPositiveDefinite { index: j, pivot });
            }
            pivots[j] = pivot;
            for i in 0..j {
                let value = (covariance[(i, j)] - taken(i, &upper, &pivots)) / pivot;
                if !value.is_finite() {
                    return Err(GaussianError::Invalid { what: "covariance", value });
                }
                upper[(i, j)] = value;
            }
        }
        Ok(Self { mean, upper, pivots })
    }

    /// Independent numbers of mean 0 and variance 1.
    #[must_use]
    pub fn standard() -> Self {
        Self {
            mean: SVector::zeros(),
            upper: SMatrix::identity(),
            pivots: SVector::from_element(1.0),
        }
    }

    /// Independent numbers with these standard deviations.
    ///
    /// # Errors
    ///
    /// Those of [`Gaussian::new`].
    pub fn independent(
        mean: SVector<f64, N>,
        deviations: &SVector<f64, N>,
    ) -> Result<Self, GaussianError> {
        let variances = deviations.component_mul(deviations);
        Self::new(mean, &SMatrix::from_diagonal(&variances))
    }

    /// The mean.
    #[must_use]
    pub const fn mean(&self) -> &SVector<f64, N> {
        &self.mean
    }

    /// The mean, to be moved by a transition that is not linear.
    pub const fn mean_mut(&mut self) -> &mut SVector<f64, N> {
        &mut self.mean
    }

    /// The covariance, symmetric to the bit.
    #[must_use]
    pub fn covariance(&self) -> SMatrix<f64, N, N> {
        self.covariance_of_first::<N>()
    }

    /// The covariance of the first `K` numbers.
    #[must_use]
    pub fn covariance_of_first<const K: usize>(&self) -> SMatrix<f64, K, K> {
        let mut covariance = SMatrix::<f64, K, K>::zeros();
        for k in 0..N {
            let pivot = self.pivots[k];
            for j in 0..K.min(k + 1) {
                let scaled = pivot * self.upper[(j, k)];
                for i in 0..=j {
                    covariance[(i, j)] += scaled * self.upper[(i, k)];
                }
            }
        }
        for j in 0..K {
            for i in 0..j {
                covariance[(j, i)] = covariance[(i, j)];
            }
        }
        covariance
    }

    /// The smallest pivot of the factored covariance: always positive.
    #[must_use]
    pub fn smallest_pivot(&self) -> f64 {
        self.pivots.min()
    }

    /// Whether all numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let finite = |values: &[f64]| values.iter().all(|v| v.is_finite());
        finite(self.mean.as_slice())
            && finite(self.pivots.as_slice())
            && finite(self.upper.as_slice())
    }

    /// Variance of what `row` times the numbers is predicted to be, without the noise
    /// of a measurement.
    #[must_use]
    pub fn variance_along(&self, row: &SVector<f64, N>) -> f64 {
        let mut sum = 0.0;
        for j in 0..N {
            let mut part = row[j];
            for i in 0..j {
                part += self.upper[(i, j)] * row[i];
            }
            sum += part * part * self.pivots[j];
        }
        sum
    }

    /// One measured number: `residual` is measured minus predicted, `row` the derivative
    /// of the prediction by the state, `variance` that of the measurement's noise.
    /// Returns the variance of the residual. Measurements of several numbers are given
    /// one after the other (made independent first, if they are not).
    ///
    /// # Errors
    ///
    /// [`GaussianError::Invalid`] if an argument is not finite, the variance is not
    /// positive, or the result would not be finite; nothing is changed then.
    pub fn update(
        &mut self,
        residual: f64,
        row: &SVector<f64, N>,
        variance: f64,
    ) -> Result<f64, GaussianError> {
        self.update_only(residual, row, variance, |_| true)
    }

    /// [`Gaussian::update`] that corrects only the numbers that `corrects` says by their
    /// index. The others are considered with their deviations and correlations, but not
    /// corrected (Schmidt's consider filter): for numbers that the measurement must not
    /// tell anything about.
    ///
    /// # Errors
    ///
    /// Those of [`Gaussian::update`].
    pub fn update_only(
        &mut self,
        residual: f64,
        row: &SVector<f64, N>,
        variance: f64,
        corrects: impl Fn(usize) -> bool,
    ) -> Result<f64, GaussianError> {
        let invalid = |what, value| Err(GaussianError::Invalid { what, value });
        if !residual.is_finite() {
            return invalid("residual", residual);
        }
        if let Some(value) = row.iter().find(|v| !v.is_finite()) {
            return invalid("derivative of the measurement", *value);
        }
        if !(variance.is_finite() && variance > 0.0) {
            return invalid("variance of the measurement", variance);
        }
        let before = *self;
        let mut gain = SVector::<f64, N>::zeros();
        let mut sum = variance;
        for j in 0..N {
            let mut part = row[j];
            for i in 0..j {
                part += self.upper[(i, j)] * row[i];
            }
            let weighted = self.pivots[j] * part;
            let before = sum;
            sum += weighted * part;
            let step = -part / before;
            for i in 0..j {
                let old = self.upper[(i, j)];
                self.upper[(i, j)] = old + gain[i] * step;
                gain[i] += old * weighted;
            }
            gain[j] = weighted;
            self.pivots[j] = (self.pivots[j] * (before / sum)).max(SMALLEST_PIVOT);
        }
        gain /= sum;
        // A gain that differs from the best one costs the variance of the residual along
        // the difference.
        let mut missed = SVector::<f64, N>::zeros();
        for i in (0..N).filter(|i| !corrects(*i)) {
            missed[i] = gain[i];
            gain[i] = 0.0;
        }
        self.add_noise(&missed, sum);
        self.mean += gain * residual;
        if self.is_finite() && sum.is_finite() {
            Ok(sum)
        } else {
            *self = before;
            invalid("variance of the residual", sum)
        }
    }

    /// A linear transition with `M` independent noises: the numbers become
    /// `transition * numbers + noise * w`, w of the given `variances`.
    pub fn predict<const M: usize>(
        &mut self,
        transition: &SMatrix<f64, N, N>,
        noise: &SMatrix<f64, N, M>,
        variances: &SVector<f64, M>,
    ) {
        self.mean = transition * self.mean;
        self.transform_first(transition, noise, variances);
    }

    /// The covariance part of [`Gaussian::predict`], for a transition that changes only
    /// the first `K` numbers by themselves (the others stay as they are, and cost next
    /// to nothing) or whose mean is moved by other means. `K` is at most `N`.
    pub fn transform_first<const K: usize, const M: usize>(
        &mut self,
        transition: &SMatrix<f64, K, K>,
        noise: &SMatrix<f64, K, M>,
        variances: &SVector<f64, M>,
    ) {
        // Columns of the others: their first K rows are transformed.
        for k in K..N {
            let old: SVector<f64, K> = SVector::from_fn(|i, _| self.upper[(i, k)]);
            let new = transition * old;
            for i in 0..K {
                self.upper[(i, k)] = new[i];
            }
        }
        // The first K: rows of [transition * U | noise], made orthogonal again under
        // the weights [D | variances], from the last row up. Rows are kept as columns.
        let head: SMatrix<f64, K, K> = SMatrix::from_fn(|i, j| self.upper[(i, j)]);
        let mut rows = (transition * head).transpose();
        let mut noises = noise.transpose();
        let weights: SVector<f64, K> = SVector::from_fn(|i, _| self.pivots[i]);
        for j in (0..K).rev() {
            let weighted = rows.column(j).component_mul(&weights);
            let weighted_noise = noises.column(j).component_mul(variances);
            let length = weighted.dot(&rows.column(j)) + weighted_noise.dot(&noises.column(j));
            let length = length.max(SMALLEST_PIVOT);
            self.pivots[j] = length;
            for i in 0..j {
                let product = weighted.dot(&rows.column(i)) + weighted_noise.dot(&noises.column(i));
                let share = product / length;
                self.upper[(i, j)] = share;
                for k in 0..K {
                    rows[(k, i)] -= share * rows[(k, j)];
                }
                for k in 0..M {
                    noises[(k, i)] -= share * noises[(k, j)];
                }
            }
        }
    }

    /// Adds an independent noise along `direction`: the covariance grows by
    /// `variance * direction * directionᵀ`. A variance that is not positive and finite adds
    /// none.
    pub fn add_noise(&mut self, direction: &SVector<f64, N>, variance: f64) {
        let mut direction = *direction;
        let mut left = if variance.is_finite() { variance } else { 0.0 };
        for j in (0..N).rev() {
            let along = direction[j];
            if left <= 0.0 {
                return;
            }
            if along == 0.0 {
                continue;
            }
            let pivot = self.pivots[j] + left * along * along;
            let share = left * along / pivot;
            left *= self.pivots[j] / pivot;
            self.pivots[j] = pivot;
            for i in 0..j {
                direction[i] -= along * self.upper[(i, j)];
                self.upper[(i, j)] += share * direction[i];
            }
        }
    }

    /// Adds an independent noise to one number. Out of range adds none.
    pub fn add_noise_to(&mut self, index: usize, variance: f64) {
        if index < N {
            let mut direction = SVector::<f64, N>::zeros();
            direction[index] = 1.0;
            self.add_noise(&direction, variance);
        }
    }

    /// One number, mean and deviation, becomes `factor` times what it was. `factor` is
    /// positive.
    pub(crate) fn scale(&mut self, index: usize, factor: f64) {
        self.mean[index] *= factor;
        self.pivots[index] = (self.pivots[index] * factor * factor).max(SMALLEST_PIVOT);
        for k in index + 1..N {
            self.upper[(index, k)] *= factor;
        }
        for i in 0..index {
            self.upper[(i, index)] /= factor;
        }
    }

    /// Forgets number `index` and puts another in its place: the number `like` (which
    /// has a higher index) plus an independent one of mean 0 and this variance.
    pub(crate) fn renew(&mut self, index: usize, like: usize, variance: f64) {
        debug_assert!(index < like && like < N && variance > 0.0);
        self.forget(index);
        self.mean[index] = self.mean[like];
        self.pivots[index] = variance;
        for k in index + 1..N {
            self.upper[(index, k)] = if k < like { 0.0 } else { self.upper[(like, k)] };
        }
    }

    /// Forgets number `index` and makes it independent of all, with this mean and
    /// variance.
    pub(crate) fn restart(&mut self, index: usize, mean: f64, variance: f64) {
        self.forget(index);
        self.mean[index] = mean;
        self.pivots[index] = variance;
        for k in index + 1..N {
            self.upper[(index, k)] = 0.0;
        }
    }

    /// What the pivot of `index` told about earlier numbers becomes noise of theirs; its
    /// column above the diagonal is empty afterwards.
    fn forget(&mut self, index: usize) {
        let mut direction = SVector::<f64, N>::zeros();
        for i in 0..index {
            direction[i] = self.upper[(i, index)];
            self.upper[(i, index)] = 0.0;
        }
        self.add_noise(&direction, self.pivots[index]);
    }
}

#[cfg(test)]
mod tests;
