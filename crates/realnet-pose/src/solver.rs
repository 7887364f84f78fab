//! RANSAC and refinement, and what makes their answer acceptable.

use crate::ambiguity::{Best, ambiguous};
use crate::geometry::{Extent, LINE_LIMIT, Rt};
use crate::kernel::{Loss, Soa};
use crate::lm::{Minimum, minimise};
use crate::problem::unproject_into;
use crate::ransac::{Bounds, Found, search};
use crate::rng::Rng;
use crate::statistics::{
    CONDITION, Chance, Squares, WIDEST, different, invert, picture_area, table_size,
};
use crate::{Correspondences, Estimate, Origin, PnpError, RansacOptions, RefineOptions};
use realnet_core::nalgebra::Point3;
use realnet_core::{CameraModel, Pose};

/// Share of the cost that a full step of the final refinement may still gain.
const TOLERANCE: f64 = 1e-9;

/// Finds poses, with scratch that is kept from one problem to the next.
#[derive(Clone, Debug)]
pub struct PnpSolver {
    pub(crate) options: RansacOptions,
    soa: Soa,
    rest: Soa,
    /// Places of the points searched.
    indices: Vec<usize>,
    pub(crate) mask: Vec<bool>,
    /// Table of places, by hash of the point.
    seen: Vec<usize>,
    rays: Vec<[f64; 2]>,
}

impl PnpSolver {
    /// A solver whose scratch grows with the problems.
    ///
    /// # Errors
    /// [`PnpError::Option`].
    pub fn new(options: RansacOptions) -> Result<Self, PnpError> {
        Self::with_capacity(options, 0)
    }

    /// A solver that never allocates for problems of up to `points`.
    ///
    /// # Errors
    /// [`PnpError::Option`].
    pub fn with_capacity(options: RansacOptions, points: usize) -> Result<Self, PnpError> {
        options.check()?;
        Ok(Self {
            options,
            soa: Soa::with_capacity(points),
            rest: Soa::with_capacity(points),
            indices: Vec::with_capacity(points),
            mask: Vec::with_capacity(points),
            seen: Vec::with_capacity(table_size(points)),
            rays: Vec::with_capacity(points),
        })
    }

    /// The options it was built with.
    #[must_use]
    pub fn options(&self) -> &RansacOptions {
        &self.options
    }

    /// For each point of the last problem, whether it lies within the threshold
    /// of the pose that was found, and in front of it. It is also there when the
    /// pose was refused, and all false when there was none.
    #[must_use]
    pub fn inliers(&self) -> &[bool] {
        &self.mask
    }

    /// The pose from points with outliers: RANSAC on samples of three, refined on
    /// the inliers with the Huber loss.
    ///
    /// # Errors
    /// Every [`PnpError`] about points and poses; see there.
    pub fn solve(
        &mut self,
        problem: &Correspondences<'_>,
        seed: u64,
    ) -> Result<Estimate, PnpError> {
        self.solve_from(problem, None, seed)
    }

    /// As [`PnpSolver::solve`], with a pose to try first: a prediction saves most
    /// of the samples when it is good and costs little when it is not.
    ///
    /// # Errors
    /// As [`PnpSolver::solve`].
    pub fn solve_near(
        &mut self,
        problem: &Correspondences<'_>,
        camera_from_world: &Pose,
        seed: u64,
    ) -> Result<Estimate, PnpError> {
        self.solve_from(problem, Some(camera_from_world), seed)
    }

    /// As [`PnpSolver::solve`], for pixels of a camera with any lens.
    ///
    /// # Errors
    /// As [`PnpSolver::solve`], and [`PnpError::Camera`] for a pixel without a
    /// ray.
    pub fn solve_pixels(
        &mut self,
        camera: &CameraModel,
        points: &[Point3<f64>],
        pixels: &[[f64; 2]],
        seed: u64,
    ) -> Result<Estimate, PnpError> {
        self.mask.clear();
        let mut rays = std::mem::take(&mut self.rays);
        let answer = unproject_into(camera, pixels, &mut rays).and_then(|()| {
            let problem = Correspondences::new(points, &rays, [camera.fx(), camera.fy()])?;
            self.solve(&problem, seed)
        });
        self.rays = rays;
        answer
    }

    /// The Huber estimate from a pose nearby, over all points: no outliers are
    /// left out.
    ///
    /// # Errors
    /// [`PnpError::TooFewPoints`] below 4, [`PnpError::Behind`] when points lie
    /// behind `camera_from_world`, [`PnpError::ReprojectionTooLarge`] by
    /// `max_rms_px`, and the refusals of [`PnpSolver::solve`] about the answer.
    pub fn refine(
        &mut self,
        problem: &Correspondences<'_>,
        camera_from_world: &Pose,
        options: &RefineOptions,
    ) -> Result<Estimate, PnpError> {
        self.mask.clear();
        for (name, value) in [("huber_px", options.huber_px), ("max_rms_px", options.max_rms_px)] {
            if !(value > 0.0) {
                return Err(PnpError::Option { name, value, range: "greater than 0" });
            }
        }
        problem.at_least(4)?;
        self.soa.fill(problem, |_| true);
        self.mask.resize(problem.len(), true);
        self.indices.clear();
        self.indices.extend(0..problem.len());
        let start = Rt::from_pose(camera_from_world);
        let behind = self.soa.residuals(&start).filter(|point| !(point.depth > 0.0)).count();
        if behind > 0 {
            return Err(PnpError::Behind { count: behind, points: problem.len() });
        }
        let loss = Loss { huber: options.huber_px, cutoff: f64::INFINITY };
        let minimum = minimise(&self.soa, &start, loss, self.options.max_steps, TOLERANCE);
        let found = Accept { origin: Origin::Guess, iterations: 0, max_rms_px: options.max_rms_px };
        self.accept(problem, &minimum, loss, &found, &mut Rng::new(0))
    }

    fn solve_from(
        &mut self,
        problem: &Correspondences<'_>,
        guess: Option<&Pose>,
        seed: u64,
    ) -> Result<Estimate, PnpError> {
        self.mask.clear();
        self.mask.resize(problem.len(), false);
        problem.at_least(4)?;
        self.soa.fill(problem, |_| true);
        self.indices.clear();
        self.indices.extend(0..problem.len());
        let RansacOptions { threshold_px, confidence, max_iterations, .. } = self.options;
        let bounds = Bounds { threshold_px, confidence, max_iterations };
        let mut rng = Rng::new(seed);
        let guess = guess.map(Rt::from_pose);
        let found = search(problem, &self.indices, &self.soa, &bounds, guess.as_ref(), &mut rng);
        let Some(found) = found else {
            let ratio = Extent::of(problem.points().iter()).line_ratio();
            if ratio < LINE_LIMIT {
                return Err(PnpError::Collinear { ratio, limit: LINE_LIMIT });
            }
            let needed = self.options.min_inliers;
            return Err(PnpError::TooFewInliers { found: 0, needed, points: problem.len() });
        };

        let squares = Squares::of(&self.soa, &found.pose, f64::INFINITY, threshold_px);
        let noise = squares.noise(threshold_px).unwrap_or(threshold_px);
        let huber = self.options.huber_sigmas * noise.max(self.options.noise_floor_px);
        let loss = Loss { huber, cutoff: threshold_px };
        let minimum = minimise(&self.soa, &found.pose, loss, self.options.max_steps, TOLERANCE);
        self.indices.clear();
        let limit = threshold_px * threshold_px;
        let residuals = self.soa.residuals(&minimum.pose);
        for (index, (inlier, residual)) in self.mask.iter_mut().zip(residuals).enumerate() {
            *inlier = residual.depth > 0.0 && residual.squared < limit;
            if *inlier {
                self.indices.push(index);
            }
        }
        let accept = Accept {
            origin: found.origin,
            iterations: found.iterations,
            max_rms_px: f64::INFINITY,
        };
        let estimate = self.accept(problem, &minimum, loss, &accept, &mut rng)?;
        self.search_rest(problem, &estimate, &bounds, &mut rng)?;
        Ok(estimate)
    }

    /// A second motion among the points that the first does not explain.
    fn search_rest(
        &mut self,
        problem: &Correspondences<'_>,
        estimate: &Estimate,
        bounds: &Bounds,
        rng: &mut Rng,
    ) -> Result<(), PnpError> {
        let rest = problem.len() - estimate.inliers;
        let wanted = (self.options.rival_share * estimate.inliers as f64).ceil() as usize;
        if rest < wanted || rest < 3 {
            return Ok(());
        }
        let mask = &self.mask;
        let outlier = |index: &usize| mask.get(*index).is_some_and(|inlier| !inlier);
        self.indices.clear();
        self.indices.extend((0..problem.len()).filter(outlier));
        self.rest.fill(problem, |index| outlier(&index));
        // As many samples as a rival of that size needs.
        let share = (wanted as f64 / rest as f64).powi(3);
        let samples = (1.0 - bounds.confidence).ln() / (-share).ln_1p();
        let max_iterations = (samples.ceil() as usize).clamp(1, bounds.max_iterations);
        let bounds = Bounds { max_iterations, ..*bounds };
        match search(problem, &self.indices, &self.rest, &bounds, None, rng) {
            Some(Found { pose, inliers, .. }) if inliers >= wanted => {
                Err(ambiguous(estimate, &pose, inliers))
            }
            _ => Ok(()),
        }
    }

    /// The estimate at a minimum over the points `self.indices`, if it can be
    /// stood by.
    fn accept(
        &mut self,
        problem: &Correspondences<'_>,
        minimum: &Minimum,
        loss: Loss,
        found: &Accept,
        rng: &mut Rng,
    ) -> Result<Estimate, PnpError> {
        let options = &self.options;
        let squares = Squares::of(&self.soa, &minimum.pose, loss.huber, loss.cutoff);
        let inliers = self.indices.len();
        let different = different(problem.points(), &self.indices, &mut self.seen);
        let ransac = loss.cutoff.is_finite();
        let needed = if ransac {
            let alone = Chance {
                points: problem.len(),
                least: options.min_inliers,
                area: picture_area(problem, &self.indices),
                threshold_px: loss.cutoff,
                trials: found.iterations,
                ring: squares.ring,
            };
            alone.needed()
        } else {
            4
        };
        let extent = Extent::of(self.indices.iter().filter_map(|&i| problem.points().get(i)));
        let ratio = extent.line_ratio();
        if ratio < LINE_LIMIT && inliers >= 2 {
            return Err(PnpError::Collinear { ratio, limit: LINE_LIMIT });
        }
        if different < needed {
            return Err(PnpError::TooFewInliers {
                found: different,
                needed,
                points: problem.len(),
            });
        }
        let rms_px = (0.5 * squares.plain / inliers as f64).sqrt();
        if !(rms_px <= found.max_rms_px) {
            let limit_px = found.max_rms_px;
            return Err(PnpError::ReprojectionTooLarge { rms_px, limit_px });
        }
        if !minimum.converged {
            return Err(PnpError::NotConverged { iterations: minimum.steps });
        }
        let Some(noise) = squares.noise(loss.cutoff) else {
            let limit_px = WIDEST.sqrt() * loss.cutoff;
            return Err(PnpError::ReprojectionTooLarge { rms_px, limit_px });
        };
        if ransac && squares.continues(problem.len()) {
            let (found, within, threshold_px) = (squares.ring, inliers, loss.cutoff);
            return Err(PnpError::ThresholdTooSmall { found, within, threshold_px });
        }
        let noise_px = noise.max(options.noise_floor_px);
        // What cutting at the threshold adds to the variance of the estimate: the
        // slope of the cut influence is the mean square within over the variance.
        let within = squares.mean_square();
        let lost = if within > 0.0 { noise * noise / within } else { 1.0 };
        let repeated = inliers as f64 / different as f64;
        let factor = noise_px * noise_px * lost * repeated;
        let flat = Loss { huber: f64::INFINITY, cutoff: loss.cutoff };
        let hessian = self.soa.normal(&minimum.pose, flat).hessian;
        let inverse =
            invert(&hessian).map_err(|ratio| PnpError::Degenerate { ratio, limit: CONDITION })?;
        let middle = minimum.pose.r * extent.mean + minimum.pose.t;
        let estimate = Estimate {
            camera_from_world: minimum.pose.to_pose(),
            covariance: inverse * factor,
            center: Point3::from(middle),
            dof: 2 * different - 6,
            rms_px,
            noise_px,
            inliers,
            iterations: found.iterations,
            steps: minimum.steps,
            origin: found.origin,
        };
        let distance = middle.norm();
        let rotation_rad = estimate.rotation_std();
        let translation_share = estimate.translation_std() / distance;
        let (rotation_limit, translation_limit) =
            (options.max_rotation_std, options.max_translation_share);
        if !(rotation_rad <= rotation_limit && translation_share <= translation_limit) {
            return Err(PnpError::Uncertain {
                rotation_rad,
                rotation_limit,
                translation_share,
                translation_limit,
            });
        }
        let best = Best {
            problem,
            soa: &self.soa,
            minimum,
            loss,
            estimate: &estimate,
            extent: &extent,
            inliers: &self.indices,
        };
        best.check(rng)?;
        Ok(estimate)
    }
}

/// Where a minimum came from and how large its residuals may be.
struct Accept {
    origin: Origin,
    iterations: usize,
    max_rms_px: f64,
}
