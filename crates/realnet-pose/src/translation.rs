//! The translation alone, of points whose rotation is known.

use crate::rng::Rng;
use crate::{Correspondences, Estimate, Origin, PnpError, PnpSolver};
use realnet_core::nalgebra::{Matrix3, Matrix6, Point3, UnitQuaternion, Vector3};
use realnet_core::{Pose, nalgebra::SMatrix};

/// Fewest inliers: four, of which two are the sample.
const LEAST: usize = 4;
/// Share of the points that must be inliers.
const SHARE: f64 = 0.6;
/// Pairs drawn.
const SAMPLES: usize = 200;
/// Steps of the refinement, after how many of them points and scale of the loss
/// stay as they are, and the step that ends it, as a share of the distance.
const STEPS: usize = 30;
const SETTLED: usize = 5;
const REST: f64 = 1e-7;

/// What is seen of the points under a rotation.
struct Turned<'a> {
    problem: &'a Correspondences<'a>,
    rotation: UnitQuaternion<f64>,
}

impl Turned<'_> {
    fn point(&self, index: usize) -> Option<(Vector3<f64>, [f64; 2])> {
        let point = self.problem.points().get(index)?;
        Some((self.rotation * point.coords, *self.problem.rays().get(index)?))
    }

    /// Residual in pixels; `None` behind the camera.
    fn residual(&self, index: usize, translation: &Vector3<f64>) -> Option<[f64; 2]> {
        let (turned, ray) = self.point(index)?;
        let seen = turned + translation;
        let [fx, fy] = self.problem.focal();
        let front = seen.z > 0.0;
        front.then(|| [fx * (seen.x / seen.z - ray[0]), fy * (seen.y / seen.z - ray[1])])
    }

    /// The translation that puts points on their rays, in the least squares of
    /// `z (x / z - u)`: linear. `None` when they do not fix it.
    fn linear(&self, indices: &[usize]) -> Option<Vector3<f64>> {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for &index in indices {
            let (turned, [u, v]) = self.point(index)?;
            for (row, value) in [
                (Vector3::new(1.0, 0.0, -u), u * turned.z - turned.x),
                (Vector3::new(0.0, 1.0, -v), v * turned.z - turned.y),
            ] {
                normal += row * row.transpose();
                right += row * value;
            }
        }
        normal.cholesky().map(|factor| factor.solve(&right))
    }
}

impl PnpSolver {
    /// The translation of `camera_from_world` where its rotation is known: three
    /// unknowns instead of six, for small or flat targets that do not fix a
    /// rotation of their own. At least 4 points and 60 % of all must agree.
    ///
    /// `rotation_std` is the standard deviation of the given rotation about any
    /// axis, radians; the covariance holds what it does to the translation, which
    /// is that the middle of the points stays where it is seen.
    ///
    /// # Errors
    /// [`PnpError::TooFewPoints`], [`PnpError::TooFewInliers`],
    /// [`PnpError::ReprojectionTooLarge`] when the noise comes near the threshold,
    /// [`PnpError::NotConverged`], [`PnpError::Uncertain`] by
    /// [`max_translation_share`](crate::RansacOptions::max_translation_share), and
    /// [`PnpError::Option`] for a deviation that is negative or not a number.
    pub fn solve_translation(
        &mut self,
        problem: &Correspondences<'_>,
        rotation: &UnitQuaternion<f64>,
        rotation_std: f64,
        seed: u64,
    ) -> Result<Estimate, PnpError> {
        if !(rotation_std >= 0.0 && rotation_std.is_finite()) {
            let (name, value, range) = ("rotation_std", rotation_std, "at least 0");
            return Err(PnpError::Option { name, value, range });
        }
        self.mask.clear();
        self.mask.resize(problem.len(), false);
        problem.at_least(LEAST)?;
        let turned = Turned { problem, rotation: *rotation };
        let options = self.options;
        let limit = options.threshold_px * options.threshold_px;
        let squared = |index: usize, t: &Vector3<f64>| {
            turned.residual(index, t).map_or(f64::INFINITY, |[x, y]| x * x + y * y)
        };

        let (mut best, mut cost) = (None, f64::INFINITY);
        let mut rng = Rng::new(seed);
        for _ in 0..SAMPLES {
            let [a, b, _] = rng.triple(problem.len());
            let Some(translation) = turned.linear(&[a, b]) else { continue };
            let sum: f64 =
                (0..problem.len()).map(|index| squared(index, &translation).min(limit)).sum();
            if sum < cost {
                (best, cost) = (Some(translation), sum);
            }
        }
        let needed = LEAST.max((SHARE * problem.len() as f64).ceil() as usize);
        let few = |found| PnpError::TooFewInliers { found, needed, points: problem.len() };
        let Some(mut translation) = best else { return Err(few(0)) };

        // Gauss-Newton with the Huber loss on the points within the threshold.
        let (mut steps, mut converged) = (0, false);
        let mut normal = Matrix3::zeros();
        let mut huber = f64::INFINITY;
        while steps < STEPS && !converged {
            steps += 1;
            if steps <= SETTLED {
                huber = options.huber_sigmas * self.spread(&turned, &translation, limit);
                for (index, inlier) in self.mask.iter_mut().enumerate() {
                    *inlier = squared(index, &translation) < limit;
                }
            }
            normal = Matrix3::zeros();
            let mut gradient = Vector3::zeros();
            for (index, _) in self.mask.iter().enumerate().filter(|(_, inlier)| **inlier) {
                let Some([x, y]) = turned.residual(index, &translation) else { continue };
                let square = x * x + y * y;
                let weight = (huber / square.sqrt()).min(1.0);
                for (row, value) in turned.rows(index, &translation).into_iter().zip([x, y]) {
                    normal += row * row.transpose() * weight;
                    gradient += row * (value * weight);
                }
            }
            let Some(factor) = normal.cholesky() else { return Err(few(0)) };
            let step = factor.solve(&gradient);
            translation -= step;
            converged = steps > SETTLED && step.norm() <= REST * (1.0 + translation.norm());
        }
        if !converged {
            return Err(PnpError::NotConverged { iterations: steps });
        }

        let (mut inliers, mut sum, mut middle) = (0, 0.0, Vector3::zeros());
        for (index, inlier) in self.mask.iter_mut().enumerate() {
            let square = squared(index, &translation);
            *inlier = square < limit;
            if let (true, Some((point, _))) = (*inlier, turned.point(index)) {
                inliers += 1;
                sum += square;
                middle += point + translation;
            }
        }
        if inliers < needed {
            return Err(few(inliers));
        }
        middle /= inliers as f64;
        let rms_px = (0.5 * sum / inliers as f64).sqrt();
        let dof = 2 * inliers - 3;
        let noise_px = (sum / dof as f64).sqrt().max(options.noise_floor_px);
        // The cut at the threshold would hide noise of this size.
        if noise_px * 2.7 > options.threshold_px {
            let limit_px = options.threshold_px / 2.7;
            return Err(PnpError::ReprojectionTooLarge { rms_px, limit_px });
        }
        let Some(inverse) = normal.try_inverse() else { return Err(few(inliers)) };
        let own = inverse * (noise_px * noise_px);
        let covariance = with_rotation(&own, &middle, rotation_std);
        let share = own.symmetric_eigenvalues().max().max(0.0).sqrt() / middle.norm();
        if !(share <= options.max_translation_share) {
            return Err(PnpError::Uncertain {
                rotation_rad: rotation_std,
                rotation_limit: f64::INFINITY,
                translation_share: share,
                translation_limit: options.max_translation_share,
            });
        }
        Ok(Estimate {
            camera_from_world: Pose::new(*rotation, translation),
            covariance,
            center: Point3::from(middle),
            dof,
            rms_px,
            noise_px,
            inliers,
            iterations: SAMPLES,
            steps,
            origin: Origin::Translation,
        })
    }

    /// Standard deviation of a residual coordinate over the points within the
    /// threshold.
    fn spread(&self, turned: &Turned<'_>, translation: &Vector3<f64>, limit: f64) -> f64 {
        let squares = (0..turned.problem.len())
            .filter_map(|index| turned.residual(index, translation))
            .map(|[x, y]| x * x + y * y)
            .filter(|square| *square < limit);
        let (sum, count) = squares.fold((0.0, 0_usize), |(sum, n), square| (sum + square, n + 1));
        (sum / (2 * count.max(1)) as f64).sqrt().max(self.options.noise_floor_px)
    }
}

impl Turned<'_> {
    /// Derivatives of the residual by the translation.
    fn rows(&self, index: usize, translation: &Vector3<f64>) -> [Vector3<f64>; 2] {
        let Some((turned, _)) = self.point(index) else { return [Vector3::zeros(); 2] };
        let seen = turned + translation;
        let [fx, fy] = self.problem.focal();
        let inverse = 1.0 / seen.z;
        [
            Vector3::new(fx, 0.0, -fx * seen.x * inverse) * inverse,
            Vector3::new(0.0, fy, -fy * seen.y * inverse) * inverse,
        ]
    }
}

/// The covariance of `[v; w]` of a left perturbation, when a rotation `w` turns
/// about `middle`: `v = middle x w` keeps it in place.
fn with_rotation(own: &Matrix3<f64>, middle: &Vector3<f64>, rotation_std: f64) -> Matrix6<f64> {
    let mut carry = SMatrix::<f64, 6, 3>::zeros();
    carry.fixed_view_mut::<3, 3>(0, 0).copy_from(&middle.cross_matrix());
    carry.fixed_view_mut::<3, 3>(3, 0).copy_from(&Matrix3::identity());
    let mut covariance = carry * carry.transpose() * (rotation_std * rotation_std);
    let mut block = covariance.fixed_view_mut::<3, 3>(0, 0);
    block += own;
    covariance
}
