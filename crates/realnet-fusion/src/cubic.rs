//! A cubic in time through positions that are uncertain.

use realnet_core::Stamp;
use realnet_core::nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use std::collections::VecDeque;
use thiserror::Error;

/// Coefficients of both axes, interleaved: x0, y0, x1, y1, ...
const COEFFICIENTS: usize = 8;

type Coefficients = SVector<f64, COEFFICIENTS>;
type Information = SMatrix<f64, COEFFICIENTS, COEFFICIENTS>;

/// Why a position is not taken or a cubic not fitted.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CubicError {
    /// A position or covariance that is not finite, or a covariance that is not
    /// positive definite.
    #[error("position of {stamp} is not finite, or its covariance not positive definite")]
    BadPoint {
        /// Of the position.
        stamp: Stamp,
    },
    /// Nothing to fit.
    #[error("no position to fit")]
    NoPoints,
    /// The equations have no solution in double precision.
    #[error("the equations of {points} positions over {span_s} s cannot be solved")]
    IllConditioned {
        /// Number of positions.
        points: usize,
        /// From the first to the last, seconds.
        span_s: f64,
    },
}

/// Position, velocity and acceleration on a trajectory, with the deviations that
/// follow from those of the positions it was fitted to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryPoint {
    /// Metres.
    pub position: Vector2<f64>,
    /// Metres a second.
    pub velocity: Vector2<f64>,
    /// Metres a second squared.
    pub acceleration: Vector2<f64>,
    /// Covariance of the position, square metres.
    pub position_covariance: Matrix2<f64>,
    /// Covariance of the velocity, square metres per square second.
    pub velocity_covariance: Matrix2<f64>,
}

/// The weighted least-squares cubic in time through the positions of a window, as the
/// paper fits it to the target's path.
///
/// A position is put in by stamp; one with the same stamp replaces the one before, so a
/// late depth that changes the past is followed by [`CubicTrajectory::refill`] and the
/// next fit has it. Fewer than four positions give a polynomial of lower degree. The
/// errors of the positions are taken as independent; an error that they share (the
/// scale of a depth map) is in the fit to its full size and not in its covariance.
///
/// ```
/// use realnet_core::{Stamp, nalgebra::{Matrix2, Vector2}};
/// use realnet_fusion::CubicTrajectory;
///
/// let mut path = CubicTrajectory::new(64, 2.0);
/// for i in 0..20 {
///     let t = 0.05 * f64::from(i);
///     let position = Vector2::new(1.0 + 0.5 * t, t * t);
///     path.insert(Stamp::from_secs_f64(t), position, &(Matrix2::identity() * 1e-4))?;
/// }
/// let end = path.fit()?.at(Stamp::from_secs_f64(1.0));
/// assert!((end.position - Vector2::new(1.5, 1.0)).norm() < 1e-6);
/// assert!((end.velocity - Vector2::new(0.5, 2.0)).norm() < 1e-6);
/// assert!((end.acceleration - Vector2::new(0.0, 2.0)).norm() < 1e-6);
/// # Ok::<(), realnet_fusion::CubicError>(())
/// ```
#[derive(Clone, Debug)]
pub struct CubicTrajectory {
    points: VecDeque<Point>,
    capacity: usize,
    window_s: f64,
}

#[derive(Clone, Copy, Debug)]
struct Point {
    stamp: Stamp,
    position: Vector2<f64>,
    information: Matrix2<f64>,
}

impl CubicTrajectory {
    /// Room for `capacity` positions (at least 1) of the last `window_s` seconds;
    /// allocated here and never again.
    #[must_use]
    pub fn new(capacity: usize, window_s: f64) -> Self {
        let capacity = capacity.max(1);
        Self { points: VecDeque::with_capacity(capacity), capacity, window_s }
    }

    /// Puts a position in, in any order of stamps; drops what lies before the window or
    /// exceeds the capacity, the oldest first.
    ///
    /// # Errors
    ///
    /// [`CubicError::BadPoint`]; nothing is changed then.
    pub fn insert(
        &mut self,
        stamp: Stamp,
        position: Vector2<f64>,
        covariance: &Matrix2<f64>,
    ) -> Result<(), CubicError> {
        let bad = CubicError::BadPoint { stamp };
        let information = covariance.cholesky().ok_or(bad)?.inverse();
        let finite = position.iter().chain(information.iter()).all(|v| v.is_finite());
        if !finite {
            return Err(bad);
        }
        let point = Point { stamp, position, information };
        let place = self.points.partition_point(|known| known.stamp < stamp);
        if let Some(known) = self.points.get_mut(place).filter(|known| known.stamp == stamp) {
            *known = point;
            return Ok(());
        }
        if self.points.len() == self.capacity {
            if place == 0 {
                return Ok(());
            }
            self.points.pop_front();
            self.points.insert(place - 1, point);
        } else {
            self.points.insert(place, point);
        }
        let newest = self.points.back().map_or(stamp, |last| last.stamp);
        while self.points.front().is_some_and(|p| newest.seconds_since(p.stamp) > self.window_s) {
            self.points.pop_front();
        }
        Ok(())
    }

    /// Replaces all positions, for instance by those of
    /// [`TargetFilter::trail`](crate::TargetFilter::trail) after a late depth.
    ///
    /// # Errors
    ///
    /// [`CubicError::BadPoint`] for the first bad one; those before it are in.
    pub fn refill(
        &mut self,
        points: impl IntoIterator<Item = crate::TrailPoint>,
    ) -> Result<(), CubicError> {
        self.points.clear();
        for point in points {
            self.insert(point.stamp, point.position, &point.covariance)?;
        }
        Ok(())
    }

    /// Number of positions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are no positions.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The positions, the oldest first: where the target was.
    pub fn points(&self) -> impl Iterator<Item = (Stamp, Vector2<f64>)> {
        self.points.iter().map(|point| (point.stamp, point.position))
    }

    /// Fits the cubic.
    ///
    /// # Errors
    ///
    /// [`CubicError::NoPoints`], [`CubicError::IllConditioned`].
    pub fn fit(&self) -> Result<Cubic, CubicError> {
        let (Some(first), Some(last)) = (self.points.front(), self.points.back()) else {
            return Err(CubicError::NoPoints);
        };
        let span_s = last.stamp.seconds_since(first.stamp);
        // Time from -1 to 0 over the window, so that the equations are well scaled.
        let scale_s = if span_s > 0.0 { span_s } else { 1.0 };
        let degree = (self.points.len() - 1).min(3);
        let used = 2 * (degree + 1);
        let mut information = Information::identity();
        information.view_mut((0, 0), (used, used)).fill(0.0);
        let mut weighted = Coefficients::zeros();
        for point in &self.points {
            let powers = powers(point.stamp.seconds_since(last.stamp) / scale_s);
            let pull = point.information * point.position;
            for i in 0..=degree {
                let mut part = weighted.fixed_rows_mut::<2>(2 * i);
                part += pull * powers[i];
                for j in 0..=degree {
                    let mut block = information.fixed_view_mut::<2, 2>(2 * i, 2 * j);
                    block += point.information * (powers[i] * powers[j]);
                }
            }
        }
        // Solved with unit diagonal: the deviations of the positions may be of any size.
        let balance = information.diagonal().map(|v| 1.0 / v.sqrt());
        let balanced = Information::from_fn(|i, j| information[(i, j)] * balance[i] * balance[j]);
        let failed = CubicError::IllConditioned { points: self.points.len(), span_s };
        let factored = balanced.cholesky().ok_or(failed)?;
        let solved = factored.solve(&weighted.component_mul(&balance)).component_mul(&balance);
        let mut covariance = factored.inverse();
        for i in 0..COEFFICIENTS {
            for j in 0..COEFFICIENTS {
                covariance[(i, j)] *= balance[i] * balance[j];
            }
        }
        // Coefficients that are not used are exactly zero, with certainty.
        for i in used..COEFFICIENTS {
            covariance[(i, i)] = 0.0;
        }
        if !solved.iter().chain(covariance.iter()).all(|v| v.is_finite()) {
            return Err(failed);
        }
        Ok(Cubic { coefficients: solved, covariance, origin: last.stamp, scale_s, degree, span_s })
    }
}

/// A fitted polynomial of at most third degree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cubic {
    coefficients: Coefficients,
    covariance: Information,
    origin: Stamp,
    scale_s: f64,
    degree: usize,
    span_s: f64,
}

impl Cubic {
    /// Its degree: 3, or less with fewer than four positions.
    #[must_use]
    pub const fn degree(&self) -> usize {
        self.degree
    }

    /// The time that the positions span, seconds.
    #[must_use]
    pub const fn span_s(&self) -> f64 {
        self.span_s
    }

    /// Position, velocity and acceleration at a time. Outside the window this is an
    /// extrapolation, and its deviation says what it is worth as far as the motion is a
    /// cubic at all.
    #[must_use]
    pub fn at(&self, stamp: Stamp) -> TrajectoryPoint {
        let t = stamp.seconds_since(self.origin) / self.scale_s;
        let s = self.scale_s;
        let position = powers(t);
        let velocity = [0.0, 1.0 / s, 2.0 * t / s, 3.0 * t * t / s];
        let acceleration = [0.0, 0.0, 2.0 / (s * s), 6.0 * t / (s * s)];
        TrajectoryPoint {
            position: self.value(&position),
            velocity: self.value(&velocity),
            acceleration: self.value(&acceleration),
            position_covariance: self.spread(&position),
            velocity_covariance: self.spread(&velocity),
        }
    }

    fn value(&self, factors: &[f64; 4]) -> Vector2<f64> {
        let mut value = Vector2::zeros();
        for (i, factor) in factors.iter().enumerate() {
            value += self.coefficients.fixed_rows::<2>(2 * i) * *factor;
        }
        value
    }

    fn spread(&self, factors: &[f64; 4]) -> Matrix2<f64> {
        let mut spread = Matrix2::zeros();
        for (i, a) in factors.iter().enumerate() {
            for (j, b) in factors.iter().enumerate() {
                spread += self.covariance.fixed_view::<2, 2>(2 * i, 2 * j) * (a * b);
            }
        }
        0.5 * (spread + spread.transpose())
    }
}

fn powers(t: f64) -> [f64; 4] {
    [1.0, t, t * t, t * t * t]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_secs_f64(seconds)
    }

    fn isotropic(std: f64) -> Matrix2<f64> {
        Matrix2::from_diagonal_element(std * std)
    }

    /// Deviates by the sine of its index: no random numbers needed.
    fn noise(index: usize) -> Vector2<f64> {
        Vector2::new((7.1 * index as f64).sin(), (3.3 * index as f64 + 1.0).sin())
    }

    proptest! {
        /// A cubic is found again wherever in time it lies, whatever the order.
        #[test]
        fn a_cubic_is_itself(
            c in proptest::collection::vec(-2.0..2.0f64, 8), start in -1e5..1e5f64,
            span in 0.1..5.0f64, count in 4..40_usize, rotate in 0..40_usize,
        ) {
            let value = |t: f64| {
                let p = powers(t);
                let axis = |k: usize| (0..4).map(|i| c[2 * i + k] * p[i]).sum();
                Vector2::new(axis(0), axis(1))
            };
            let mut path = CubicTrajectory::new(64, 10.0);
            for i in 0..count {
                let t = span * ((i + rotate) % count) as f64 / (count - 1) as f64;
                path.insert(at(start + t), value(t), &isotropic(0.02)).unwrap();
            }
            let cubic = path.fit().unwrap();
            prop_assert_eq!(cubic.degree(), 3);
            prop_assert!((cubic.span_s() - span).abs() < 1e-8);
            for t in [0.0, 0.3 * span, span, 1.2 * span] {
                let found = cubic.at(at(start + t));
                // stamps are whole nanoseconds
                let error = (found.position - value(t)).norm();
                prop_assert!(error < 1e-5, "{error} at {t}");
                let step = 1e-4;
                let velocity = (value(t + step) - value(t - step)) / (2.0 * step);
                prop_assert!((found.velocity - velocity).norm() < 1e-4 / span.min(1.0));
            }
        }
    }

    #[test]
    fn few_positions_lower_the_degree() {
        let mut path = CubicTrajectory::new(8, 10.0);
        assert_eq!(path.fit().unwrap_err(), CubicError::NoPoints);
        for (count, degree) in [(1, 0), (2, 1), (3, 2), (4, 3), (5, 3)] {
            let t = f64::from(count) * 0.1;
            path.insert(at(t), Vector2::new(t * t, 1.0), &isotropic(0.01)).unwrap();
            let cubic = path.fit().unwrap();
            assert_eq!(cubic.degree(), degree);
            let end = cubic.at(at(t));
            assert!((end.position - Vector2::new(t * t, 1.0)).norm() < 1e-9);
            assert!((end.position_covariance - isotropic(0.01)).norm() < 1e-9 || count > 4);
        }
    }

    #[test]
    fn weights_follow_the_deviations_and_their_directions() {
        let mut path = CubicTrajectory::new(64, 10.0);
        let ray = |along: f64, across: f64| {
            let turn = Matrix2::new(0.6, -0.8, 0.8, 0.6);
            let stds = Matrix2::new(along * along, 0.0, 0.0, across * across);
            turn * stds * turn.transpose()
        };
        // Two kinds at alternate stamps: each sure where the other one is not.
        for i in 0..40 {
            let along = Vector2::new(0.6, 0.8) * 0.5;
            let across = Vector2::new(-0.8, 0.6) * 0.5;
            let t = at(f64::from(i) * 0.05);
            if i % 2 == 0 {
                path.insert(t, along, &ray(10.0, 0.01)).unwrap();
            } else {
                path.insert(t, across, &ray(0.01, 10.0)).unwrap();
            }
        }
        let middle = path.fit().unwrap().at(at(1.0));
        assert!(middle.position.norm() < 1e-3, "{}", middle.position);
    }

    #[test]
    fn the_covariance_is_that_of_the_errors() {
        // The covariance of a linear estimate is the sum over the positions of the square
        // of what each one alone moves.
        let fill = |moved: Option<usize>| {
            let mut path = CubicTrajectory::new(64, 10.0);
            for i in 0..25 {
                let std = if i % 3 == 0 { 0.02 } else { 0.05 };
                let push = if moved == Some(i) { std } else { 0.0 };
                let position = noise(i) + Vector2::new(push, 0.0);
                path.insert(at(i as f64 * 0.04), position, &isotropic(std)).unwrap();
            }
            path.fit().unwrap().at(at(1.1))
        };
        let base = fill(None);
        let (mut position, mut velocity) = (0.0, 0.0);
        for i in 0..25 {
            let moved = fill(Some(i));
            position += (moved.position.x - base.position.x).powi(2);
            velocity += (moved.velocity.x - base.velocity.x).powi(2);
        }
        assert!((base.position_covariance[(0, 0)] / position - 1.0).abs() < 1e-6);
        assert!((base.velocity_covariance[(0, 0)] / velocity - 1.0).abs() < 1e-6);
    }

    #[test]
    fn the_buffer_is_by_stamp_and_bounded() {
        let mut path = CubicTrajectory::new(5, 1.0);
        let mut insert = |t: f64, x: f64| path.insert(at(t), Vector2::new(x, 0.0), &isotropic(0.1));
        for t in [0.3, 0.1, 0.2, 0.1] {
            insert(t, t).unwrap();
        }
        insert(0.2, 9.0).unwrap();
        let bad = insert(0.25, f64::NAN).unwrap_err();
        assert_eq!(bad, CubicError::BadPoint { stamp: at(0.25) });
        let singular = path.insert(at(0.25), Vector2::zeros(), &Matrix2::zeros());
        assert!(singular.is_err());
        let xs = |path: &CubicTrajectory| path.points().map(|(_, p)| p.x).collect::<Vec<_>>();
        assert_eq!(xs(&path), [0.1, 9.0, 0.3]);
        for t in [0.4, 0.5, 0.6, 0.0] {
            path.insert(at(t), Vector2::new(t, 0.0), &isotropic(0.1)).unwrap();
        }
        assert_eq!(xs(&path), [9.0, 0.3, 0.4, 0.5, 0.6], "full: the oldest went");
        path.insert(at(1.45), Vector2::new(1.45, 0.0), &isotropic(0.1)).unwrap();
        assert_eq!(xs(&path), [0.5, 0.6, 1.45], "the window is 1 s");
        assert_eq!((path.len(), path.is_empty()), (3, false));
    }
}
