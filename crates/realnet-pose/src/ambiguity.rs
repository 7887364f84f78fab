//! Is there a second pose that explains the points about equally well?

use crate::geometry::{Extent, Rt};
use crate::kernel::{Loss, Soa};
use crate::lm::{Minimum, minimise};
use crate::ransac::sample;
use crate::rng::Rng;
use crate::{Correspondences, Estimate, PnpError};
use realnet_core::nalgebra::Matrix3;

/// Sets thinner than this share of their first extent are tried in the mirror.
const THIN: f64 = 0.25;
/// So are sets whose first extent (standard deviation) is below this share of
/// their distance, which the camera sees without much perspective.
const SMALL: f64 = 0.1;
/// Triples of inliers whose other solutions are tried.
const TRIPLES: usize = 8;
/// A rival is rejected when its cost is higher by this many squared deviations:
/// the truth loses so much once in `exp(15)` cases.
const SQUARED_DEVIATIONS: f64 = 30.0;
/// Minima closer than this (squared Mahalanobis distance) are the same.
const SAME: f64 = 9.0;
/// Steps of the two stages of the refinement of a rival.
const STEPS: [usize; 2] = [12, 25];

/// The accepted pose and what it was found on.
pub(crate) struct Best<'a> {
    pub(crate) problem: &'a Correspondences<'a>,
    pub(crate) soa: &'a Soa,
    pub(crate) minimum: &'a Minimum,
    pub(crate) loss: Loss,
    pub(crate) estimate: &'a Estimate,
    pub(crate) extent: &'a Extent,
    /// Places of the inliers in the problem.
    pub(crate) inliers: &'a [usize],
}

impl Best<'_> {
    /// Looks for a rival among the mirror image of a thin set and the other
    /// solutions of triples of inliers.
    pub(crate) fn check(&self, rng: &mut Rng) -> Result<(), PnpError> {
        let distance = (self.minimum.pose.r * self.extent.mean + self.minimum.pose.t).norm();
        let small = self.extent.deviations[0] < SMALL * distance;
        if small || self.extent.plane_ratio() < THIN {
            self.challenge(&self.mirrored())?;
        }
        let count = self.inliers.len();
        if count < 3 {
            return Ok(());
        }
        // Half way from the cost of the best to that of a pose that explains
        // nothing; without a cutoff, a residual that is no longer noise.
        let nothing = if self.loss.cutoff.is_finite() {
            self.soa.len() as f64 * self.loss.cutoff.powi(2)
        } else {
            self.soa.len() as f64 * (30.0 * self.estimate.noise_px).powi(2)
        };
        let bail = 0.5 * (self.minimum.normal.cost + nothing);
        let cutoff = if self.loss.cutoff.is_finite() { self.loss.cutoff } else { 1e150 };
        let mut poses = [Rt::identity(); 4];
        let mut rival: Option<(f64, Rt)> = None;
        for _ in 0..TRIPLES {
            let triple =
                rng.triple(count).map(|i| self.inliers.get(i).copied().unwrap_or_default());
            let solutions = sample(self.problem, triple, &mut poses);
            let Some(poses) = poses.get(..solutions) else { continue };
            // The solution nearest to the best is the same pose with noise.
            let closeness = |pose: &Rt| (pose.r.transpose() * self.minimum.pose.r).trace();
            let Some(nearest) = poses
                .iter()
                .enumerate()
                .max_by(|a, b| closeness(a.1).total_cmp(&closeness(b.1)))
                .map(|(place, _)| place)
            else {
                continue;
            };
            for (_, pose) in poses.iter().enumerate().filter(|(place, _)| *place != nearest) {
                let limit = rival.map_or(bail, |(cost, _)| cost);
                let cost = self.soa.cost(pose, cutoff, limit);
                if cost < limit {
                    rival = Some((cost, *pose));
                }
            }
        }
        rival.map_or(Ok(()), |(_, pose)| self.challenge(&pose))
    }

    /// Under weak perspective the picture of a plane stays the same when the
    /// plane is mirrored in the plane through its middle across the line of
    /// sight: the rotation `(I - 2 v v^T) R (I - 2 n n^T)` with the line of sight
    /// `v` and the normal `n` (Schweighofer and Pinz, "Robust Pose Estimation from
    /// a Planar Target", PAMI 2006).
    fn mirrored(&self) -> Rt {
        let Rt { r, t } = self.minimum.pose;
        let middle = r * self.extent.mean + t;
        let v = middle / middle.norm();
        let n = self.extent.normal;
        let mirror_v = Matrix3::identity() - 2.0 * v * v.transpose();
        let mirror_n = Matrix3::identity() - 2.0 * n * n.transpose();
        let r = mirror_v * r * mirror_n;
        Rt { r, t: middle - r * self.extent.mean }
    }

    /// Refines a rival and compares.
    fn challenge(&self, rival: &Rt) -> Result<(), PnpError> {
        if !rival.r.iter().chain(rival.t.iter()).all(|value| value.is_finite()) {
            return Ok(());
        }
        // First with a wide threshold, to be drawn in from further away.
        let wide = Loss { cutoff: 8.0 * self.loss.cutoff, ..self.loss };
        let [first, second] = STEPS;
        let start = minimise(self.soa, rival, wide, first, 1e-3);
        let other = minimise(self.soa, &start.pose, self.loss, second, 1e-6);
        let variance = self.estimate.noise_px.powi(2);
        let behind = (other.normal.cost - self.minimum.normal.cost) / variance;
        // Written so that a rival without a finite cost loses.
        if !(behind < SQUARED_DEVIATIONS) {
            return Ok(());
        }
        let pose = other.pose.to_pose();
        if self.estimate.mahalanobis_squared(&pose) < SAME {
            return Ok(());
        }
        Err(ambiguous(self.estimate, &other.pose, other.normal.within))
    }
}

/// The refusal for a rival.
pub(crate) fn ambiguous(estimate: &Estimate, other: &Rt, other_inliers: usize) -> PnpError {
    let between = other.to_pose() * estimate.camera_from_world.inverse();
    PnpError::Ambiguous {
        rotation_rad: between.rotation_angle(),
        translation_m: between.translation_norm(),
        inliers: estimate.inliers,
        other_inliers,
    }
}
