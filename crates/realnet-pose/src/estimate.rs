//! A pose with its deviation.

use realnet_core::Pose;
use realnet_core::nalgebra::{Matrix6, Point3, Vector3, Vector6};

/// What gave the pose from which the last refinement started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The pose given by the caller.
    Guess,
    /// Three points, as they came from [`p3p`](crate::p3p()).
    P3p,
    /// Three points, improved on their inliers during RANSAC.
    LocalOptimisation,
    /// Two points and a given rotation.
    Translation,
}

/// An accepted pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The pose: points of the world into the camera's optical frame.
    pub camera_from_world: Pose,
    /// Covariance of `xi = [v; w]` (metres, radians) in
    /// `camera_from_world = exp(xi) * self.camera_from_world`, the left
    /// perturbation in the camera's frame.
    ///
    /// It is `s^2 (J^T J)^-1` over the inliers with the variance `s^2` of a
    /// residual coordinate estimated from the residuals, corrected for the loss
    /// (Huber, "Robust Statistics", 1981, section 7.6), for the cut at the inlier
    /// threshold, and for points that occur more than once.
    pub covariance: Matrix6<f64>,
    /// Mean of the inliers in the camera's frame, metres: the pivot about which
    /// [`Estimate::mahalanobis_squared`] measures rotations.
    pub center: Point3<f64>,
    /// Degrees of freedom of the variance of the residuals: twice the number of
    /// different inliers, less 6.
    pub dof: usize,
    /// Root mean square of the residual coordinates of the inliers, pixels.
    pub rms_px: f64,
    /// Standard deviation of the noise of a pixel coordinate that the covariance
    /// is made with: `rms_px` corrected for the degrees of freedom and for the
    /// part cut off at the threshold, and at least the noise floor of the options.
    pub noise_px: f64,
    /// Points within the threshold and in front of the camera; all points for
    /// [`PnpSolver::refine`](crate::PnpSolver::refine).
    pub inliers: usize,
    /// RANSAC samples drawn, 0 without RANSAC.
    pub iterations: usize,
    /// Steps of the last refinement.
    pub steps: usize,
    /// What the last refinement started from.
    pub origin: Origin,
}

impl Estimate {
    /// The perturbation `xi = [v; w]` that leads from the estimate to
    /// `camera_from_world`.
    #[must_use]
    pub fn perturbation_to(&self, camera_from_world: &Pose) -> Vector6<f64> {
        (*camera_from_world * self.camera_from_world.inverse()).log()
    }

    /// The squared Mahalanobis distance of a pose. Infinite when the covariance
    /// cannot be inverted.
    ///
    /// It is measured in `d = [u; w]` with `R' = exp(w) R`, `t' = c + exp(w) (t -
    /// c) + u`: a rotation about the [`center`](Estimate::center) `c` of the
    /// points, then a translation. To first order `u = v + w x c`, by which the
    /// covariance is carried over. For points that are far away compared to their
    /// extent the product of an error in depth and one in rotation would otherwise
    /// exceed the error with which their middle is known.
    #[must_use]
    pub fn mahalanobis_squared(&self, camera_from_world: &Pose) -> f64 {
        let turn = camera_from_world.rotation() * self.camera_from_world.rotation().inverse();
        let w = Pose::from_rotation(turn).log().fixed_rows::<3>(3).into_owned();
        let c = self.center.coords;
        let arm = self.camera_from_world.translation() - c;
        let u = camera_from_world.translation() - c - turn * arm;
        let d = Vector6::new(u.x, u.y, u.z, w.x, w.y, w.z);
        let mut carry = Matrix6::identity();
        for axis in 0..3 {
            let column = Vector3::ith(axis, 1.0).cross(&c);
            carry.fixed_view_mut::<3, 1>(0, 3 + axis).copy_from(&column);
        }
        let covariance = carry * self.covariance * carry.transpose();
        // Scaled to unit diagonal, so that metres and radians mix well.
        let scale = covariance.diagonal().map(|variance| variance.max(0.0).sqrt().recip());
        let correlation = Matrix6::from_fn(|r, c| covariance[(r, c)] * scale[r] * scale[c]);
        let scaled = d.component_mul(&scale);
        match correlation.cholesky() {
            Some(factor) => scaled.dot(&factor.solve(&scaled)),
            None => f64::INFINITY,
        }
    }

    /// The probability that the truth is at least as far from the estimate as
    /// `camera_from_world`: a pose lies in the 95 % ellipsoid when this is at
    /// least 0.05.
    ///
    /// The squared distance over 6 follows the F distribution with 6 and
    /// [`Estimate::dof`] degrees of freedom, because the variance is itself
    /// estimated.
    #[must_use]
    pub fn p_value(&self, camera_from_world: &Pose) -> f64 {
        f_survival_6(self.mahalanobis_squared(camera_from_world), self.dof as f64)
    }

    /// Largest standard deviation of the rotation over all axes, radians.
    #[must_use]
    pub fn rotation_std(&self) -> f64 {
        let block = self.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        block.symmetric_eigenvalues().max().max(0.0).sqrt()
    }

    /// Largest standard deviation of the translation over all directions,
    /// metres: how well the camera's place is known relative to the points.
    #[must_use]
    pub fn translation_std(&self) -> f64 {
        let block = self.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        block.symmetric_eigenvalues().max().max(0.0).sqrt()
    }
}

/// `P(6 F >= m)` for the F distribution with 6 and `dof` degrees of freedom: the
/// regularised incomplete beta function `I_z(dof / 2, 3)` with `z = dof / (dof +
/// m)`, a finite sum since 6 is even (Abramowitz and Stegun 26.6.4).
fn f_survival_6(m: f64, dof: f64) -> f64 {
    if m.is_nan() || dof <= 0.0 {
        return 0.0;
    }
    let half = 0.5 * dof;
    let tail = m / (dof + m);
    if tail.is_nan() {
        return 0.0; // m is infinite
    }
    (half * (-tail).ln_1p()).exp() * (1.0 + half * tail * (1.0 + 0.5 * (half + 1.0) * tail))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Origin;

    /// For small perturbations the distance is that of the twist.
    #[test]
    fn distances_agree_to_first_order() {
        let covariance = Matrix6::from_fn(|r, c| if r == c { 2.0 } else { 0.1 * (r + c) as f64 });
        let estimate = Estimate {
            camera_from_world: Pose::exp(&Vector6::new(1.0, -2.0, 3.0, 0.3, 0.5, -0.4)),
            covariance: covariance * covariance.transpose(),
            center: Point3::new(0.4, -0.3, 5.0),
            dof: 100,
            rms_px: 1.0,
            noise_px: 1.0,
            inliers: 53,
            iterations: 0,
            steps: 0,
            origin: Origin::Guess,
        };
        for axis in 0..6 {
            let xi = Vector6::from_fn(|row, _| if row == axis { 1e-6 } else { 2e-7 });
            let there = Pose::exp(&xi) * estimate.camera_from_world;
            assert!((estimate.perturbation_to(&there) - xi).norm() < 1e-13);
            let expected = xi.dot(&(estimate.covariance.try_inverse().unwrap() * xi));
            let found = estimate.mahalanobis_squared(&there);
            assert!((found - expected).abs() < 1e-5 * expected, "{axis}: {found} {expected}");
        }
        assert!(estimate.mahalanobis_squared(&estimate.camera_from_world) < 1e-25);
    }

    /// Against tables of the F distribution, upper 5 % and 1 % points.
    #[test]
    fn quantiles() {
        for (dof, f95, f99) in
            [(4.0, 6.163, 15.207), (10.0, 3.217, 5.386), (60.0, 2.254, 3.119), (1e9, 2.0986, 2.802)]
        {
            assert!((f_survival_6(6.0 * f95, dof) - 0.05).abs() < 2e-4, "{dof}");
            assert!((f_survival_6(6.0 * f99, dof) - 0.01).abs() < 1e-4, "{dof}");
        }
        assert_eq!(f_survival_6(0.0, 12.0), 1.0);
        assert_eq!(f_survival_6(f64::INFINITY, 12.0), 0.0);
    }
}
