//! Random samples of three, with local optimisation.

use crate::geometry::Rt;
use crate::kernel::{Loss, Soa};
use crate::lm::{Minimum, minimise};
use crate::p3p;
use crate::rng::Rng;
use crate::{Correspondences, Origin};
use realnet_core::nalgebra::Vector3;

/// Steps of a local optimisation, and its tolerance: it only has to beat the
/// noise of three points.
const LOCAL_STEPS: usize = 4;
const LOCAL_TOLERANCE: f64 = 1e-3;
/// Thresholds at which the best pose is looked at once more.
const WIDE: f64 = 2.0;

/// The bounds of a search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub(crate) threshold_px: f64,
    pub(crate) confidence: f64,
    pub(crate) max_iterations: usize,
}

/// The best pose of a search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    pub(crate) pose: Rt,
    /// Sum of the truncated squares, pixels.
    pub(crate) cost: f64,
    pub(crate) inliers: usize,
    pub(crate) iterations: usize,
    pub(crate) origin: Origin,
}

/// The poses of three of the correspondences.
pub(crate) fn sample(
    problem: &Correspondences<'_>,
    triple: [usize; 3],
    out: &mut [Rt; 4],
) -> usize {
    let get = |index: usize| {
        let (point, ray) = (problem.points().get(index)?, problem.rays().get(index)?);
        Some((*point, Vector3::new(ray[0], ray[1], 1.0).normalize()))
    };
    let [Some(a), Some(b), Some(c)] = triple.map(get) else { return 0 };
    p3p::solve(&[a.0, b.0, c.0], &[a.1, b.1, c.1], out)
}

/// Looks for the pose with the lowest truncated cost (MSAC: Torr and Zisserman,
/// 2000) over the correspondences `indices`, which are those in `soa` in the same
/// order. A new best is improved at once on its inliers (LO-RANSAC: Chum, Matas
/// and Kittler, 2003), and the search ends when a sample of inliers of the best
/// has been drawn with the confidence asked for. The best is then looked at once more
/// with a wider threshold, [`widened`].
///
/// Scoring a pose ends as soon as it is certain to be worse than the best.
pub(crate) fn search(
    problem: &Correspondences<'_>,
    indices: &[usize],
    soa: &Soa,
    bounds: &Bounds,
    guess: Option<&Rt>,
    rng: &mut Rng,
) -> Option<Found> {
    let count = indices.len();
    if count < 3 {
        return None;
    }
    let cutoff = bounds.threshold_px;
    let loss = Loss { huber: f64::INFINITY, cutoff };
    let mut best: Option<Found> = None;
    let mut best_raw = count as f64 * cutoff * cutoff;
    let mut needed = bounds.max_iterations;
    let mut iterations = 0;
    let mut consider = |pose: &Rt, origin: Origin, iterations: usize, best: &mut Option<Found>| {
        let cost = soa.cost(pose, cutoff, best_raw);
        if cost >= best_raw {
            return;
        }
        best_raw = cost;
        let minimum = minimise(soa, pose, loss, LOCAL_STEPS, LOCAL_TOLERANCE);
        if best.is_none_or(|best| minimum.normal.cost < best.cost) {
            let moved = minimum.normal.cost < cost && origin == Origin::P3p;
            let origin = if moved { Origin::LocalOptimisation } else { origin };
            *best = Some(Found {
                pose: minimum.pose,
                cost: minimum.normal.cost,
                inliers: minimum.normal.within,
                iterations,
                origin,
            });
        }
    };
    if let Some(guess) = guess {
        consider(guess, Origin::Guess, 0, &mut best);
        needed = needed.min(enough(&best, count, bounds));
    }
    let mut poses = [Rt::identity(); 4];
    while iterations < needed {
        iterations += 1;
        let triple = rng.triple(count).map(|i| indices.get(i).copied().unwrap_or_default());
        let solutions = sample(problem, triple, &mut poses);
        let before = best.map(|best| best.inliers);
        for pose in poses.iter().take(solutions) {
            consider(pose, Origin::P3p, iterations, &mut best);
        }
        if best.map(|best| best.inliers) != before {
            needed = enough(&best, count, bounds);
        }
    }
    best.map(|best| Found { iterations, ..widened(soa, best, cutoff) })
}

/// The best pose, or a better one beyond the next: where the minimum at
/// [`WIDE`] thresholds leads to.
///
/// The truncated cost has many minima when the noise fills the threshold or has long
/// tails, and three points lead to a convenient one. The wider cost has fewer
/// (graduated optimisation: Blake and Zisserman, "Visual Reconstruction", 1987).
fn widened(soa: &Soa, best: Found, cutoff: f64) -> Found {
    let loss = |cutoff| Loss { huber: f64::INFINITY, cutoff };
    let minimum = |pose, loss| minimise(soa, pose, loss, LOCAL_STEPS, LOCAL_TOLERANCE);
    let wide = minimum(&best.pose, loss(WIDE * cutoff));
    let Minimum { pose, normal, .. } = minimum(&wide.pose, loss(cutoff));
    if normal.cost < best.cost {
        let origin = match best.origin {
            Origin::Guess => Origin::Guess,
            _ => Origin::LocalOptimisation,
        };
        Found { pose, cost: normal.cost, inliers: normal.within, origin, ..best }
    } else {
        best
    }
}

/// Samples after which one of inliers only has been drawn with the confidence
/// asked for: `ln(1 - p) / ln(1 - w^3)` (Fischler and Bolles, 1981).
fn enough(best: &Option<Found>, count: usize, bounds: &Bounds) -> usize {
    let Some(best) = best else { return bounds.max_iterations };
    let k = best.inliers as f64;
    let n = count as f64;
    // Drawn without replacement.
    let good = k * (k - 1.0) * (k - 2.0) / (n * (n - 1.0) * (n - 2.0));
    let samples = (1.0 - bounds.confidence).ln() / (-good.clamp(0.0, 1.0)).ln_1p();
    // A float to integer conversion saturates, and not-a-number gives 0.
    if good <= 0.0 {
        bounds.max_iterations
    } else {
        (samples.ceil() as usize).min(bounds.max_iterations)
    }
}
