//! Rigid transforms in the plane that a vehicle drives on.

use nalgebra::{Matrix2, Vector2};
use std::ops::Mul;

/// A rigid transform of the ground plane, named `a_from_b`: where a vehicle stands
/// and which way it looks. x forward and y left in metres, heading in radians,
/// positive to the left.
///
/// ```
/// use realnet_core::{Pose2, nalgebra::Vector2};
///
/// // 2 m along x of the world, looking along its y.
/// let world_from_base = Pose2::new(2.0, 0.0, std::f64::consts::FRAC_PI_2);
/// let ahead = world_from_base.transform_point(&Vector2::new(1.0, 0.0));
/// assert!((ahead - Vector2::new(2.0, 1.0)).norm() < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose2 {
    /// Metres along x of `a`.
    pub x: f64,
    /// Metres along y of `a`.
    pub y: f64,
    /// Direction of `b`'s x axis in `a`, radians, positive to the left. Not wrapped:
    /// two turns to the left are 4 pi.
    pub heading: f64,
}

impl Pose2 {
    /// `b` is `a`.
    pub const IDENTITY: Self = Self { x: 0.0, y: 0.0, heading: 0.0 };

    /// Metres, metres, radians.
    #[must_use]
    pub const fn new(x: f64, y: f64, heading: f64) -> Self {
        Self { x, y, heading }
    }

    /// The origin of `b` in `a`.
    #[must_use]
    pub const fn position(&self) -> Vector2<f64> {
        Vector2::new(self.x, self.y)
    }

    /// The unit vector along `b`'s x axis in `a`.
    #[must_use]
    pub fn direction(&self) -> Vector2<f64> {
        let (sin, cos) = self.heading.sin_cos();
        Vector2::new(cos, sin)
    }

    /// The 2x2 rotation matrix.
    #[must_use]
    pub fn rotation(&self) -> Matrix2<f64> {
        let (sin, cos) = self.heading.sin_cos();
        Matrix2::new(cos, -sin, sin, cos)
    }

    /// A point of `b` in coordinates of `a`.
    #[must_use]
    pub fn transform_point(&self, point: &Vector2<f64>) -> Vector2<f64> {
        self.rotation() * point + self.position()
    }

    /// A direction or velocity of `b` in coordinates of `a`: the rotation alone.
    #[must_use]
    pub fn transform_vector(&self, vector: &Vector2<f64>) -> Vector2<f64> {
        self.rotation() * vector
    }

    /// `b_from_a`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let back = -(self.rotation().transpose() * self.position());
        Self::new(back.x, back.y, -self.heading)
    }

    /// Where a vehicle is after it drove from here at a constant `speed` (m/s, along
    /// x) and `yaw_rate` (rad/s, positive to the left) for `seconds`: an arc.
    #[must_use]
    pub fn driven(&self, speed: f64, yaw_rate: f64, seconds: f64) -> Self {
        let turn = yaw_rate * seconds;
        // The chord of an arc is its length times sin(a) / a, a half the turn.
        let half = 0.5 * turn;
        let sinc = if half.abs() < 1e-4 { 1.0 - half * half / 6.0 } else { half.sin() / half };
        let (sin, cos) = (self.heading + half).sin_cos();
        let chord = speed * seconds * sinc;
        Self::new(self.x + chord * cos, self.y + chord * sin, self.heading + turn)
    }
}

/// `a_from_b * b_from_c` is `a_from_c`.
impl Mul for Pose2 {
    type Output = Self;

    #[allow(clippy::suspicious_arithmetic_impl, reason = "headings add up")]
    fn mul(self, other: Self) -> Self {
        let position = self.transform_point(&other.position());
        Self::new(position.x, position.y, self.heading + other.heading)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_pose() -> impl Strategy<Value = Pose2> {
        (-10.0..10.0f64, -10.0..10.0f64, -7.0..7.0f64).prop_map(|(x, y, h)| Pose2::new(x, y, h))
    }

    #[test]
    fn a_quarter_of_a_circle_to_the_left() {
        // 1 m/s and 1 rad/s: a circle of 1 m around (0, 1)
        let quarter = std::f64::consts::FRAC_PI_2;
        let end = Pose2::IDENTITY.driven(1.0, 1.0, quarter);
        assert!((end.position() - Vector2::new(1.0, 1.0)).norm() < 1e-12);
        assert!((end.heading - quarter).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn inverse_undoes(pose in any_pose(), x in -9.0..9.0f64, y in -9.0..9.0f64) {
            let point = Vector2::new(x, y);
            let back = pose.inverse().transform_point(&pose.transform_point(&point));
            prop_assert!((back - point).norm() < 1e-12);
            let same = pose * pose.inverse();
            prop_assert!(same.position().norm() < 1e-12 && same.heading.abs() < 1e-12);
        }

        #[test]
        fn arcs_add_up(
            start in any_pose(), speed in -3.0..3.0f64, yaw_rate in -4.0..4.0f64,
            first in 0.0..1.0f64, second in 0.0..1.0f64,
        ) {
            let once = start.driven(speed, yaw_rate, first + second);
            let twice = start.driven(speed, yaw_rate, first).driven(speed, yaw_rate, second);
            prop_assert!((once.position() - twice.position()).norm() < 1e-9);
            prop_assert!((once.heading - twice.heading).abs() < 1e-12);
        }
    }
}
