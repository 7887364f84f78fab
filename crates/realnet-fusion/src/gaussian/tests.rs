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

/// The covariance after a measurement along `row`, by Joseph's form, which holds for any gain.
fn joseph(
    covariance: &Matrix4<f64>,
    gain: &Vector4<f64>,
    row: &Vector4<f64>,
    variance: f64,
) -> Matrix4<f64> {
    let left = Matrix4::identity() - gain * row.transpose();
    left * covariance * left.transpose() + gain * variance * gain.transpose()
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
        prop_assert!(close(&gaussian.covariance(), &joseph(&covariance, &gain, &row, variance)));
        prop_assert!((gaussian.mean() - (mean + gain * residual)).norm() < 1e-9);
    }

    #[test]
    fn a_part_is_considered_and_not_corrected(
        root in any_matrix(3.0), mean in any_vector(5.0), row in any_vector(2.0),
        residual in -4.0..4.0f64, variance in 0.01..10.0f64, count in 0..5usize,
    ) {
        let covariance = covariance_of(&root);
        let mut gaussian = Gaussian::new(mean, &covariance).unwrap();
        gaussian.update_only(residual, &row, variance, |i| i < count).unwrap();
        let mut gain = covariance * row / ((row.transpose() * covariance * row).x + variance);
        gain.rows_range_mut(count..).fill(0.0);
        prop_assert!(close(&gaussian.covariance(), &joseph(&covariance, &gain, &row, variance)));
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
