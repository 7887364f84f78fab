//! Residuals, chance and condition: the figures by which a pose is judged.

use crate::Correspondences;
use crate::geometry::Rt;
use crate::kernel::Soa;
use realnet_core::nalgebra::{Matrix2, Matrix6, Point3, Vector2};

/// Largest variance of a coordinate within the threshold as a share of its
/// square: that of noise of 1 / 2.7 of the threshold. (Even filling has 0.25.)
pub(crate) const WIDEST: f64 = 0.124;
/// Largest share of the number of inliers that may lie in a ring around the
/// threshold, for each time that its area holds that of the circle. Noise of 1 /
/// 2.7 of the threshold puts 0.027 into the first.
const RING: f64 = 0.05;
/// Outer radius of the wide ring in thresholds, squared.
const WIDE: f64 = 10.0;
/// Natural logarithm of the number of matches by chance that are accepted.
const LN_FALSE_ALARMS: f64 = -13.8;
/// Smallest reciprocal condition of the scaled normal equations.
pub(crate) const CONDITION: f64 = 1e-12;

/// Sums over the residuals within a threshold.
pub(crate) struct Squares {
    pub(crate) count: usize,
    /// Points from the threshold to 1.41 of it: a ring of the circle's area.
    narrow: usize,
    /// Points from the threshold to 3.16 of it: nine times that area.
    pub(crate) ring: usize,
    /// Of the squared lengths.
    pub(crate) plain: f64,
    /// Of the squared lengths, those beyond the Huber knee cut to it.
    cut: f64,
    /// Of the mean derivative of the influence function: 1 up to the knee and,
    /// beyond it, half of `huber / r` (the tangential one of the two directions).
    slope: f64,
    /// Of the mean squared derivative.
    slope_squares: f64,
}

impl Squares {
    pub(crate) fn of(soa: &Soa, pose: &Rt, huber: f64, cutoff: f64) -> Self {
        let mut sums = Self {
            count: 0,
            narrow: 0,
            ring: 0,
            plain: 0.0,
            cut: 0.0,
            slope: 0.0,
            slope_squares: 0.0,
        };
        let (knee, limit) = (huber * huber, cutoff * cutoff);
        for residual in soa.residuals(pose) {
            if !(residual.depth > 0.0 && residual.squared < WIDE * limit) {
                continue;
            }
            if residual.squared >= limit {
                sums.ring += 1;
                sums.narrow += usize::from(residual.squared < 2.0 * limit);
                continue;
            }
            sums.count += 1;
            sums.plain += residual.squared;
            if residual.squared <= knee {
                sums.cut += residual.squared;
                sums.slope += 1.0;
                sums.slope_squares += 1.0;
            } else {
                sums.cut += knee;
                sums.slope += 0.5 * huber / residual.squared.sqrt();
                sums.slope_squares += 0.5 * knee / residual.squared;
            }
        }
        sums
    }

    /// Whether the residuals of `points` points go on beyond the threshold, so
    /// that the points within are not those of one pose but a choice of the
    /// convenient ones. Where the inliers are most of the points there is no such
    /// choice, and others near them are a second motion.
    pub(crate) fn continues(&self, points: usize) -> bool {
        let too_many = |found: usize, times: f64| {
            let limit = RING * times * self.count as f64;
            found as f64 > limit + 2.0 * limit.sqrt()
        };
        5 * self.count < 3 * points
            && (too_many(self.narrow, 1.0) || too_many(self.ring, WIDE - 1.0))
    }

    /// The variance of a coordinate as Huber's covariance takes it: the mean
    /// square of the influence over the square of its mean slope, times `K^2`
    /// with `K = 1 + (p / n) var(slope) / mean(slope)^2` for `p = 6` unknowns and
    /// `n` coordinates.
    pub(crate) fn mean_square(&self) -> f64 {
        let count = self.count as f64;
        let dof = 2.0 * count - 6.0;
        if dof <= 0.0 {
            return f64::INFINITY;
        }
        let slope = self.slope / count;
        let variance = (self.slope_squares / count - slope * slope).max(0.0);
        let finite = 1.0 + 3.0 / count * variance / (slope * slope);
        self.cut / dof * (finite / slope).powi(2)
    }

    /// The standard deviation of Gaussian noise of a coordinate whose residuals
    /// within the cutoff are these, none when they are spread too evenly.
    ///
    /// For residuals in two dimensions, `q = cutoff^2 / (2 s^2)`, the mean square
    /// within the cutoff is `s^2 (1 - e^-q (1 + q)) / (1 - e^-q)`.
    pub(crate) fn noise(&self, cutoff: f64) -> Option<f64> {
        let within = self.mean_square();
        if cutoff.is_infinite() {
            return within.is_finite().then(|| within.sqrt());
        }
        if !(within < WIDEST * cutoff * cutoff) {
            return None;
        }
        let mut variance = within;
        for _ in 0..60 {
            let q = 0.5 * cutoff * cutoff / variance;
            let e = (-q).exp();
            let next = within * (1.0 - e) / (1.0 - e * (1.0 + q));
            let done = (next - variance).abs() <= 1e-9 * next;
            variance = next;
            if done || variance == 0.0 {
                break;
            }
        }
        Some(variance.sqrt())
    }
}

/// How many points must agree so that it is not by chance.
///
/// A wrong pose has a point within the threshold with probability `p = pi T^2 /
/// area`, or as the points in the ring around the threshold tell, if that is
/// more; of `trials` poses through 3 points each, `trials C(n - 3, k - 3) p^(k -
/// 3)` are expected to have `k` (the number of false alarms of Moisan and Stival,
/// "A Probabilistic Criterion to Detect Rigid Point Matches", IJCV 2004).
pub(crate) struct Chance {
    pub(crate) points: usize,
    pub(crate) least: usize,
    pub(crate) area: f64,
    pub(crate) threshold_px: f64,
    pub(crate) trials: usize,
    /// Points in the wide ring around the threshold.
    pub(crate) ring: usize,
}

impl Chance {
    pub(crate) fn needed(&self) -> usize {
        let threshold = std::f64::consts::PI * self.threshold_px * self.threshold_px;
        let near = self.ring as f64 / (WIDE - 1.0) / self.points.max(1) as f64;
        let p = (threshold / self.area).max(near).min(1.0);
        // Up to four poses a sample, and as many that local optimisation makes.
        let mut alarms = (8.0 * self.trials.max(100) as f64).ln();
        let mut needed = 3;
        while needed <= self.points && (alarms > LN_FALSE_ALARMS || needed < self.least) {
            let (chosen, left) = ((needed - 2) as f64, (self.points - needed) as f64);
            alarms += (left.max(1.0) / chosen).ln() + p.ln();
            needed += 1;
        }
        needed.max(self.least)
    }
}

/// The area, square pixels, of the ellipse over which the rays of `indices` are
/// spread: `4 pi` times the root of the determinant of their covariance, which is
/// exact for an ellipse filled evenly.
pub(crate) fn picture_area(problem: &Correspondences<'_>, indices: &[usize]) -> f64 {
    let [fx, fy] = problem.focal();
    let seen = || {
        let rays = indices.iter().filter_map(|&index| problem.rays().get(index));
        rays.map(|ray| Vector2::new(fx * ray[0], fy * ray[1]))
    };
    let count = indices.len().max(1) as f64;
    let mean = seen().sum::<Vector2<f64>>() / count;
    let mut scatter = Matrix2::zeros();
    for pixel in seen() {
        scatter += (pixel - mean) * (pixel - mean).transpose();
    }
    let area = (scatter / count).determinant().max(0.0).sqrt();
    4.0 * std::f64::consts::PI * area
}

/// Places in the table for so many points: a power of two, at most half full.
pub(crate) fn table_size(points: usize) -> usize {
    (2 * points).next_power_of_two()
}

/// How many different points `indices` name. `table` is scratch.
pub(crate) fn different(
    points: &[Point3<f64>],
    indices: &[usize],
    table: &mut Vec<usize>,
) -> usize {
    let size = table_size(indices.len().max(1));
    table.clear();
    table.resize(size, usize::MAX);
    let mut count = 0;
    for &index in indices {
        let Some(point) = points.get(index) else { continue };
        // 0.0 + x makes one of the two zeros.
        let mix = |hash: u64, value: f64| {
            (hash ^ (0.0 + value).to_bits()).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29)
        };
        let hash = point.coords.iter().fold(0, |hash, &value| mix(hash, value));
        let mut place = hash as usize & (size - 1);
        while let Some(slot) = table.get_mut(place) {
            match points.get(*slot) {
                None => {
                    *slot = index;
                    count += 1;
                    break;
                }
                Some(other) if other == point => break,
                Some(_) => place = (place + 1) & (size - 1),
            }
        }
    }
    count
}

/// The inverse of the normal equations, or their reciprocal condition after
/// scaling to a unit diagonal.
pub(crate) fn invert(hessian: &Matrix6<f64>) -> Result<Matrix6<f64>, f64> {
    let scale = hessian.diagonal().map(|value| value.sqrt().recip());
    let scaled = Matrix6::from_fn(|r, c| hessian[(r, c)] * scale[r] * scale[c]);
    if scaled.iter().any(|value| !value.is_finite()) {
        return Err(0.0);
    }
    let Some(factor) = scaled.cholesky() else { return Err(0.0) };
    let inverse = factor.inverse();
    // The norm of the scaled matrix is between 1 and 6.
    let condition = 1.0 / (scaled.norm() * inverse.norm());
    if !(condition > CONDITION) {
        return Err(condition);
    }
    Ok(Matrix6::from_fn(|r, c| inverse[(r, c)] * scale[r] * scale[c]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_seen_through_the_threshold() {
        // The mean square within a threshold of 3 for noise of 1, from the formula
        // by numeric integration of r^3 exp(-r^2 / 2).
        let (mut weight, mut square) = (0.0, 0.0);
        for i in 0..300_000 {
            let r = (f64::from(i) + 0.5) * 1e-5;
            let density = r * (-0.5 * r * r).exp();
            weight += density;
            square += r * r * density;
        }
        let count = 1_000_000;
        let plain = square / weight * count as f64;
        let slope = count as f64;
        let sums =
            Squares { count, narrow: 0, ring: 0, plain, cut: plain, slope, slope_squares: slope };
        let noise = sums.noise(3.0).unwrap();
        assert!((noise - 1.0).abs() < 1e-4, "{noise}");
        assert!(sums.noise(f64::INFINITY).unwrap() < 0.98, "without the correction");
        assert!(sums.noise(2.0).is_none(), "evenly filled");
    }

    #[test]
    fn points_are_counted_once() {
        let mut points: Vec<_> = (0..50).map(|i| Point3::new(f64::from(i % 7), 0.0, 1.0)).collect();
        points.push(Point3::new(-0.0, 0.0, 1.0));
        let mut table = Vec::new();
        let all: Vec<usize> = (0..points.len()).collect();
        assert_eq!(different(&points, &all, &mut table), 7);
        assert_eq!(different(&points, &[3, 10, 50], &mut table), 2);
        assert_eq!(different(&points, &[], &mut table), 0);
    }

    #[test]
    fn more_is_asked_for_where_chance_is_likely() {
        let chance = |points, area, trials| {
            Chance { points, least: 6, area, threshold_px: 4.0, trials, ring: 0 }.needed()
        };
        // ln(800 C(17, 4)) + 4 ln(50.3 / 300000) = -20.3, with 3 it is -12.9
        assert_eq!(chance(20, 300_000.0, 100), 7);
        assert!(chance(200, 300_000.0, 5000) > chance(20, 300_000.0, 100));
        assert!(chance(200, 300.0, 100) > chance(200, 3000.0, 100));
        assert_eq!(chance(50, 10.0, 100), 51, "inside of the threshold nothing is enough");
    }
}
