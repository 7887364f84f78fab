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
        self.mean += gain * (residual / sum);
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
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realnet_core::nalgebra::{Matrix4, SMatrix, Vector4};

    fn any_matrix(scale: f64) -> impl Strategy<Value = Matrix4<f64>> {
        proptest::collection::vec(-scale..scale, 16).prop_map(Matrix4::from_vec)
    }

    fn any_vector(scale: f64) -> impl Strategy<Value = Vector4<f64>> {
        proptest::collection::vec(-scale..scale, 4).prop_map(Vector4::from_vec)
    }

    fn covariance_of(root: &Matrix4<f64>) -> Matrix4<f64> {
        root * root.transpose() + Matrix4::identity() * 0.1
    }

    fn close(a: &Matrix4<f64>, b: &Matrix4<f64>) -> bool {
        (a - b).norm() <= 1e-9 * (1.0 + a.norm())
    }

    proptest! {
        #[test]
        fn factors_multiply_back(root in any_matrix(3.0)) {
            let covariance = covariance_of(&root);
            let gaussian = Gaussian::new(Vector4::zeros(), &covariance).unwrap();
            prop_assert!(close(&gaussian.covariance(), &covariance));
        }

        #[test]
        fn an_update_is_the_textbook_one(
            root in any_matrix(3.0), mean in any_vector(5.0), row in any_vector(2.0),
            residual in -4.0..4.0f64, variance in 0.01..10.0f64,
        ) {
            let covariance = covariance_of(&root);
            let mut gaussian = Gaussian::new(mean, &covariance).unwrap();
            let along = (row.transpose() * covariance * row).x;
            prop_assert!((gaussian.variance_along(&row) - along).abs() < 1e-9 * (1.0 + along));
            let spread = gaussian.update(residual, &row, variance).unwrap();
            prop_assert!((spread - along - variance).abs() < 1e-9 * spread);
            let gain = covariance * row / spread;
            let joseph = Matrix4::identity() - gain * row.transpose();
            let expected = joseph * covariance * joseph.transpose()
                + gain * variance * gain.transpose();
            prop_assert!(close(&gaussian.covariance(), &expected));
            prop_assert!((gaussian.mean() - (mean + gain * residual)).norm() < 1e-9);
        }

        #[test]
        fn a_prediction_is_the_textbook_one(
            root in any_matrix(3.0), transition in any_matrix(2.0), noise in any_matrix(1.0),
            mean in any_vector(5.0), q in any_vector(2.0),
        ) {
            let covariance = covariance_of(&root);
            let mut gaussian = Gaussian::new(mean, &covariance).unwrap();
            let (noise, q) = (noise.fixed_columns::<2>(0).into_owned(), q.xy().map(f64::abs));
            gaussian.predict(&transition, &noise, &q);
            let expected = transition * covariance * transition.transpose()
                + noise * SMatrix::from_diagonal(&q) * noise.transpose();
            prop_assert!(close(&gaussian.covariance(), &expected));
            prop_assert!((gaussian.mean() - transition * mean).norm() < 1e-9);
        }

        #[test]
        fn a_transition_of_the_first_leaves_the_rest(
            root in any_matrix(3.0), part in any_matrix(2.0), noise in any_vector(1.0),
        ) {
            let covariance = covariance_of(&root);
            let mut gaussian = Gaussian::new(Vector4::zeros(), &covariance).unwrap();
            let part = part.fixed_view::<2, 2>(0, 0).into_owned();
            let noise = noise.xy();
            gaussian.transform_first(&part, &noise, &SVector::<f64, 1>::new(0.5));
            let mut whole = Matrix4::identity();
            whole.fixed_view_mut::<2, 2>(0, 0).copy_from(&part);
            let mut expected = whole * covariance * whole.transpose();
            let mut corner = expected.fixed_view_mut::<2, 2>(0, 0);
            corner += noise * 0.5 * noise.transpose();
            prop_assert!(close(&gaussian.covariance(), &expected));
        }

        #[test]
        fn noise_scale_renew_and_restart(
            root in any_matrix(3.0), direction in any_vector(2.0), variance in 0.01..5.0f64,
            factor in 0.1..2.0f64,
        ) {
            let covariance = covariance_of(&root);
            let start = Gaussian::new(Vector4::new(1.0, 2.0, 3.0, 4.0), &covariance).unwrap();
            let mut noisy = start;
            noisy.add_noise(&direction, variance);
            let expected = covariance + direction * variance * direction.transpose();
            prop_assert!(close(&noisy.covariance(), &expected));

            let mut scaled = start;
            scaled.scale(2, factor);
            let scaling = Matrix4::from_diagonal(&Vector4::new(1.0, 1.0, factor, 1.0));
            prop_assert!(close(&scaled.covariance(), &(scaling * covariance * scaling)));
            prop_assert!((scaled.mean()[2] - 3.0 * factor).abs() < 1e-12);

            let mut renewed = start;
            renewed.renew(1, 3, variance);
            let mut copy = Matrix4::identity();
            copy[(1, 1)] = 0.0;
            copy[(1, 3)] = 1.0;
            let mut expected = copy * covariance * copy.transpose();
            expected[(1, 1)] += variance;
            prop_assert!(close(&renewed.covariance(), &expected));
            prop_assert_eq!(renewed.mean()[1], 4.0);

            let mut restarted = start;
            restarted.restart(2, -1.0, variance);
            let mut expected = covariance;
            for k in 0..4 {
                expected[(2, k)] = 0.0;
                expected[(k, 2)] = 0.0;
            }
            expected[(2, 2)] = variance;
            prop_assert!(close(&restarted.covariance(), &expected));
        }

        /// Twelve decades between prior, noises and measurements, in any order.
        #[test]
        fn extreme_numbers_keep_it_positive_definite(
            steps in proptest::collection::vec(
                (0..3u8, any_vector(1.0), -6.0..6.0f64, -1e6..1e6f64), 1..60),
        ) {
            let mut gaussian = Gaussian::independent(
                Vector4::zeros(), &Vector4::new(1e3, 1e-3, 1.0, 1e2)).unwrap();
            for (kind, vector, decade, residual) in steps {
                match kind {
                    0 => { gaussian.update(residual, &vector, 10f64.powf(decade)).unwrap(); }
                    1 => gaussian.add_noise(&vector, 10f64.powf(decade)),
                    _ => {
                        let shear = Matrix4::identity() + Matrix4::from_diagonal(&vector) * 0.5;
                        let noise = SVector::<f64, 4>::zeros();
                        gaussian.predict(&shear, &noise, &SVector::<f64, 1>::zeros());
                    }
                }
                prop_assert!(gaussian.is_finite() && gaussian.smallest_pivot() > 0.0);
                // As correlations, so that the test is of the matrix and not of its units.
                let covariance = gaussian.covariance();
                let scale = covariance.diagonal().map(|v| 1.0 / v.sqrt());
                let correlation =
                    Matrix4::from_diagonal(&scale) * covariance * Matrix4::from_diagonal(&scale);
                let lifted = correlation + Matrix4::identity() * 1e-14;
                prop_assert!(lifted.cholesky().is_some(), "{correlation}");
            }
        }
    }

    #[test]
    fn what_is_not_finite_is_refused_and_changes_nothing() {
        let start = Gaussian::independent(Vector4::zeros(), &Vector4::repeat(1.0)).unwrap();
        let row = Vector4::new(1.0, 0.0, 0.0, 0.0);
        let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        for value in bad {
            let mut gaussian = start;
            assert!(gaussian.update(value, &row, 1.0).is_err());
            assert!(gaussian.update(1.0, &(row * value), 1.0).is_err());
            assert!(gaussian.update(1.0, &row, value).is_err());
            assert_eq!(gaussian, start);
        }
        let mut gaussian = start;
        for variance in [0.0, -1.0] {
            assert!(gaussian.update(1.0, &row, variance).is_err());
        }
        // finite, but the product is not
        assert!(gaussian.update(1.0, &(row * 1e200), 1.0).is_err());
        assert_eq!(gaussian, start);
        let error = Gaussian::independent(Vector4::zeros(), &Vector4::zeros()).unwrap_err();
        assert_eq!(error, GaussianError::NotPositiveDefinite { index: 3, pivot: 0.0 });
        assert!(Gaussian::new(Vector4::repeat(f64::NAN), &Matrix4::identity()).is_err());
        let lopsided = Matrix4::from_diagonal(&Vector4::new(1.0, f64::NAN, 1.0, 1.0));
        assert!(Gaussian::new(Vector4::zeros(), &lopsided).is_err());
    }
}
