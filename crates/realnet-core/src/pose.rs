//! Rigid transforms.

use nalgebra::{
    Matrix3, Matrix4, Matrix6, Point3, Quaternion, Unit, UnitQuaternion, Vector3, Vector6,
};
use std::ops::Mul;
use thiserror::Error;

/// How far a matrix may be from a rotation: the largest entry of `R^T R - I`.
/// Poses written with four digits pass, scales and shears do not.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// How far the norm of a given quaternion may be from 1.
const QUATERNION_TOLERANCE: f64 = 1e-3;

/// Why numbers are not a rigid transform.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PoseError {
    /// An entry is not a number.
    #[error("entry {index} of a pose is {value}, it must be finite")]
    NotFinite {
        /// Place of the entry: row by row in a matrix, in order in a list.
        index: usize,
        /// What was given.
        value: f64,
    },
    /// The upper left 3x3 part of a matrix is not orthonormal.
    #[error(
        "the rotation part is not orthonormal: R^T R differs from the identity by {deviation}, \
         at most {limit} is accepted"
    )]
    NotOrthonormal {
        /// Largest magnitude in `R^T R - I`.
        deviation: f64,
        /// Largest deviation accepted.
        limit: f64,
    },
    /// The rotation part of a matrix is a mirror image.
    #[error("the rotation part has determinant {determinant}, a rotation has 1")]
    Mirrored {
        /// Its determinant.
        determinant: f64,
    },
    /// The last row of a matrix is not `0 0 0 1`.
    #[error("the last row of a rigid transform is 0 0 0 1, here it differs by {deviation}")]
    LastRow {
        /// Largest magnitude of the difference.
        deviation: f64,
    },
    /// A quaternion does not have unit length.
    #[error("a rotation is a unit quaternion, here the norm is {norm} (accepted: 1 +- {limit})")]
    NotUnit {
        /// Its norm.
        norm: f64,
        /// Largest deviation from 1 accepted.
        limit: f64,
    },
}

/// A rigid transform in three dimensions, metres.
///
/// Name a pose `a_from_b`: it takes coordinates in frame `b` to coordinates of
/// the same point in frame `a`, and is at once the placement of frame `b` in
/// frame `a`. Names then chain by their inner words:
///
/// ```
/// use realnet_core::{Pose, body_from_optical, nalgebra::{Point3, Vector3}};
///
/// let world_from_body = Pose::from_translation(Vector3::new(10.0, 0.0, 0.0));
/// let world_from_optical = world_from_body * body_from_optical();
/// // two metres ahead of the camera
/// let point_in_world = world_from_optical.transform_point(&Point3::new(0.0, 0.0, 2.0));
/// assert!((point_in_world - Point3::new(12.0, 0.0, 0.0)).norm() < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    rotation: UnitQuaternion<f64>,
    translation: Vector3<f64>,
}

impl Default for Pose {
    fn default() -> Self {
        Self::identity()
    }
}

impl Pose {
    /// The transform `p -> rotation * p + translation`.
    #[must_use]
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation }
    }

    /// The transform that changes nothing.
    #[must_use]
    pub fn identity() -> Self {
        Self::new(UnitQuaternion::identity(), Vector3::zeros())
    }

    /// A pure rotation.
    #[must_use]
    pub fn from_rotation(rotation: UnitQuaternion<f64>) -> Self {
        Self::new(rotation, Vector3::zeros())
    }

    /// A pure translation, metres.
    #[must_use]
    pub fn from_translation(translation: Vector3<f64>) -> Self {
        Self::new(UnitQuaternion::identity(), translation)
    }

    /// The rotation of `a_from_b`: axes of `b` in coordinates of `a`.
    #[must_use]
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        self.rotation
    }

    /// The translation of `a_from_b`: the origin of `b` in coordinates of `a`,
    /// metres.
    #[must_use]
    pub fn translation(&self) -> Vector3<f64> {
        self.translation
    }

    /// Angle of the rotation, radians, 0 to pi.
    #[must_use]
    pub fn rotation_angle(&self) -> f64 {
        2.0 * self.rotation.imag().norm().atan2(self.rotation.w.abs())
    }

    /// Length of the translation, metres.
    #[must_use]
    pub fn translation_norm(&self) -> f64 {
        self.translation.norm()
    }

    /// `b_from_a` of `a_from_b`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self::new(rotation, -(rotation * self.translation))
    }

    /// The adjoint: `a_from_b * exp(xi) = exp(adjoint * xi) * a_from_b`, twists as
    /// in [`Pose::exp`], translation first. It carries a twist, or by
    /// `A covariance A^T` its covariance, from frame `b` to frame `a`.
    #[must_use]
    pub fn adjoint(&self) -> Matrix6<f64> {
        let rotation = self.rotation.to_rotation_matrix();
        let mut adjoint = Matrix6::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation.matrix());
        adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation.matrix());
        let lever = self.translation.cross_matrix() * rotation.matrix();
        adjoint.fixed_view_mut::<3, 3>(0, 3).copy_from(&lever);
        adjoint
    }

    /// A point of frame `b` in coordinates of frame `a`.
    #[must_use]
    pub fn transform_point(&self, point: &Point3<f64>) -> Point3<f64> {
        self.rotation * point + self.translation
    }

    /// A direction or velocity of frame `b` in coordinates of frame `a`: the
    /// rotation alone.
    #[must_use]
    pub fn transform_vector(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * vector
    }

    /// The homogeneous 4x4 matrix.
    #[must_use]
    pub fn to_matrix(&self) -> Matrix4<f64> {
        let mut matrix = self.rotation.to_homogeneous();
        matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.translation);
        matrix
    }

    /// The pose of a homogeneous 4x4 matrix. A rotation part that is off by the
    /// rounding of a text file is replaced by the nearest rotation.
    ///
    /// # Errors
    /// [`PoseError`] when an entry is not finite, the last row is not `0 0 0 1`
    /// (to 1e-6), an entry of `R^T R - I` exceeds 1e-3, or `R` is mirrored.
    pub fn from_matrix(matrix: &Matrix4<f64>) -> Result<Self, PoseError> {
        let by_rows = matrix.transpose();
        check_finite(by_rows.as_slice())?;
        let deviation = (matrix.row(3) - nalgebra::RowVector4::new(0.0, 0.0, 0.0, 1.0)).abs().max();
        if deviation > 1e-6 {
            return Err(PoseError::LastRow { deviation });
        }
        let r: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into_owned();
        let deviation = (r.transpose() * r - Matrix3::identity()).abs().max();
        // Also refuses a product that overflowed to not-a-number.
        if deviation.is_nan() || deviation > ROTATION_TOLERANCE {
            return Err(PoseError::NotOrthonormal { deviation, limit: ROTATION_TOLERANCE });
        }
        let determinant = r.determinant();
        if determinant <= 0.0 {
            return Err(PoseError::Mirrored { determinant });
        }
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(nearest_rotation(r));
        let translation = matrix.fixed_view::<3, 1>(0, 3).into_owned();
        Ok(Self::new(UnitQuaternion::from_rotation_matrix(&rotation), translation))
    }

    /// The pose of `tx ty tz qx qy qz qw`, the order of the TUM trajectory
    /// format and of ROS messages. The quaternion is normalised.
    ///
    /// # Errors
    /// [`PoseError`] when a value is not finite or the norm of the quaternion
    /// differs from 1 by more than 1e-3.
    pub fn from_tum(values: [f64; 7]) -> Result<Self, PoseError> {
        check_finite(&values)?;
        let [tx, ty, tz, qx, qy, qz, qw] = values;
        let quaternion = Quaternion::new(qw, qx, qy, qz);
        let norm = quaternion.norm();
        // Squares that overflow make the norm infinite, which is refused too.
        if (norm - 1.0).abs() > QUATERNION_TOLERANCE {
            return Err(PoseError::NotUnit { norm, limit: QUATERNION_TOLERANCE });
        }
        Ok(Self::new(Unit::new_normalize(quaternion), Vector3::new(tx, ty, tz)))
    }

    /// The pose as `tx ty tz qx qy qz qw`, with `qw >= 0`.
    #[must_use]
    pub fn to_tum(&self) -> [f64; 7] {
        let t = self.translation;
        let q = self.rotation;
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        [t.x, t.y, t.z, sign * q.i, sign * q.j, sign * q.k, sign * q.w]
    }

    /// The exponential of a twist `[v; w]` of se(3): translation part first, in
    /// metres, rotation vector second, in radians.
    ///
    /// `R = exp(w^)`, `t = V v` with
    /// `V = I + (1 - cos q) / q^2 w^ + (q - sin q) / q^3 (w^)^2`, `q = |w|`
    /// (Barfoot, State Estimation for Robotics, 2017, chapter 7).
    #[must_use]
    pub fn exp(twist: &Vector6<f64>) -> Self {
        let v: Vector3<f64> = twist.fixed_rows::<3>(0).into_owned();
        let w: Vector3<f64> = twist.fixed_rows::<3>(3).into_owned();
        let q = w.norm();
        let half = half_sinc(q);
        // (1 - cos q) / q^2 without cancellation
        let a = 2.0 * half * half;
        let b = if q < 0.3 {
            let q2 = q * q;
            1.0 / 6.0
                - q2 * (1.0 / 120.0
                    - q2 * (1.0 / 5040.0 - q2 * (1.0 / 362_880.0 - q2 / 39_916_800.0)))
        } else {
            (q - q.sin()) / (q * q * q)
        };
        let wv = w.cross(&v);
        let translation = v + a * wv + b * w.cross(&wv);
        let imaginary = w * half;
        let quaternion = Quaternion::from_parts((0.5 * q).cos(), imaginary);
        Self::new(Unit::new_normalize(quaternion), translation)
    }

    /// The twist `[v; w]` whose [`Pose::exp`] this is, with `|w|` at most pi.
    ///
    /// `v = V^-1 t`, `V^-1 = I - w^ / 2 + (1 - (q / 2) cot(q / 2)) / q^2 (w^)^2`.
    #[must_use]
    pub fn log(&self) -> Vector6<f64> {
        let sign = if self.rotation.w < 0.0 { -1.0 } else { 1.0 };
        let imaginary = self.rotation.imag() * sign;
        let q = self.rotation_angle();
        // sin(q / 2) = |imaginary|, so this is q / sin(q / 2) along the axis.
        let w = imaginary / half_sinc(q);
        let t = self.translation;
        let c = if q < 0.1 {
            let q2 = q * q;
            1.0 / 12.0 + q2 * (1.0 / 720.0 + q2 * (1.0 / 30_240.0 + q2 / 1_209_600.0))
        } else {
            (1.0 - 0.5 * q / (0.5 * q).tan()) / (q * q)
        };
        let wt = w.cross(&t);
        let v = t - 0.5 * wt + c * w.cross(&wt);
        Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
    }
}

/// `a_from_b * b_from_c` is `a_from_c`. The quaternion is brought back to unit
/// length, so long chains stay rigid.
impl Mul for Pose {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let rotation = Unit::new_normalize((self.rotation * other.rotation).into_inner());
        Self::new(rotation, self.rotation * other.translation + self.translation)
    }
}

impl Mul<Point3<f64>> for Pose {
    type Output = Point3<f64>;

    fn mul(self, point: Point3<f64>) -> Point3<f64> {
        self.transform_point(&point)
    }
}

/// The rotation from a camera's optical frame (x right, y down, z forward) to a
/// body frame (x forward, y left, z up) at the same place that looks the same
/// way, by REP-103.
#[must_use]
pub fn body_from_optical() -> Pose {
    // x_body = z, y_body = -x, z_body = -y
    Pose::from_rotation(Unit::new_unchecked(Quaternion::new(0.5, -0.5, 0.5, -0.5)))
}

/// `sin(q / 2) / q`.
fn half_sinc(q: f64) -> f64 {
    if q < 1e-4 { 0.5 - q * q / 48.0 } else { (0.5 * q).sin() / q }
}

/// The orthogonal factor of the polar decomposition by Newton's iteration
/// `R <- (R + R^-T) / 2`, which converges quadratically: from the tolerance
/// above to the last bit in three steps.
fn nearest_rotation(mut r: Matrix3<f64>) -> Matrix3<f64> {
    for _ in 0..4 {
        let Some(inverse) = r.try_inverse() else { break };
        r = 0.5 * (r + inverse.transpose());
    }
    r
}

fn check_finite(values: &[f64]) -> Result<(), PoseError> {
    match values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
        Some((index, &value)) => Err(PoseError::NotFinite { index, value }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn any_twist(max_angle: f64) -> impl Strategy<Value = Vector6<f64>> {
        let axis = prop::array::uniform3(-1.0..1.0f64)
            .prop_filter("an axis", |a| Vector3::from(*a).norm() > 1e-3);
        (prop::array::uniform3(-10.0..10.0f64), axis, 0.0..max_angle).prop_map(|(v, axis, q)| {
            let w = Vector3::from(axis).normalize() * q;
            Vector6::new(v[0], v[1], v[2], w.x, w.y, w.z)
        })
    }

    fn any_pose() -> impl Strategy<Value = Pose> {
        any_twist(PI).prop_map(|twist| Pose::exp(&twist))
    }

    fn any_point() -> impl Strategy<Value = Point3<f64>> {
        prop::array::uniform3(-100.0..100.0f64).prop_map(Point3::from)
    }

    #[test]
    fn optical_axes_become_body_axes() {
        let pose = body_from_optical();
        let close = |a: Point3<f64>, b: [f64; 3]| (a - Point3::from(b)).norm() < 1e-15;
        assert!(close(pose * Point3::new(0.0, 0.0, 1.0), [1.0, 0.0, 0.0]), "forward");
        assert!(close(pose * Point3::new(1.0, 0.0, 0.0), [0.0, -1.0, 0.0]), "right");
        assert!(close(pose * Point3::new(0.0, 1.0, 0.0), [0.0, 0.0, -1.0]), "down");
    }

    #[test]
    fn the_adjoint_carries_twists() {
        let a_from_b = Pose::exp(&Vector6::new(1.0, -2.0, 0.5, 0.4, -0.9, 0.3));
        let twist = Vector6::new(0.3, 0.1, -0.2, 0.2, -0.1, 0.5);
        let there = a_from_b * Pose::exp(&twist) * a_from_b.inverse();
        assert!((there.log() - a_from_b.adjoint() * twist).norm() < 1e-12);
    }

    #[test]
    fn exp_matches_the_matrix_exponential() {
        // 30 terms of the power series of the 4x4 matrix [w^ v; 0 0] in exact
        // rational arithmetic (Python's fractions), rounded at the end.
        #[rustfmt::skip]
        let expected = Matrix4::new(
0.9357548032779189, -0.28316496056507373, 0.21019170595074282, 1.3202825730501595,
0.3029327134026371, 0.9505806179060915, -0.06803131640494002, -1.8350755744310348,
-0.18054007669439773, 0.12733457491763026, 0.9752903089530457, 0.28328952527063667,
0.0, 0.0, 0.0, 1.0
        );
        let pose = Pose::exp(&Vector6::new(1.0, -2.0, 0.5, 0.1, 0.2, 0.3));
        assert!((pose.to_matrix() - expected).abs().max() < 1e-14);
    }

    #[test]
    fn quarter_turn_about_z() {
        let pose = Pose::from_tum([1.0, 2.0, 3.0, 0.0, 0.0, 0.5f64.sqrt(), 0.5f64.sqrt()]).unwrap();
        let moved = pose * Point3::new(1.0, 0.0, 0.0);
        assert!((moved - Point3::new(1.0, 3.0, 3.0)).norm() < 1e-14);
        assert!((pose.rotation_angle() - PI / 2.0).abs() < 1e-14);
        assert!((pose.translation_norm() - 14f64.sqrt()).abs() < 1e-14);
    }

    #[test]
    fn matrices_that_are_not_rigid_are_refused_with_the_deviation() {
        let mut scaled = Matrix4::identity();
        scaled[(0, 0)] = 1.1;
        match Pose::from_matrix(&scaled) {
            Err(PoseError::NotOrthonormal { deviation, .. }) => {
                assert!((deviation - 0.21).abs() < 1e-12);
            }
            other => panic!("{other:?}"),
        }
        let mut mirrored = Matrix4::identity();
        mirrored[(1, 1)] = -1.0;
        let error = Pose::from_matrix(&mirrored).unwrap_err();
        assert_eq!(error, PoseError::Mirrored { determinant: -1.0 });
        let mut projective = Matrix4::identity();
        projective[(3, 2)] = 0.5;
        let error = Pose::from_matrix(&projective).unwrap_err();
        assert_eq!(error, PoseError::LastRow { deviation: 0.5 });
        let mut hole = Matrix4::identity();
        hole[(1, 3)] = f64::NAN;
        let error = Pose::from_matrix(&hole).unwrap_err();
        assert!(matches!(error, PoseError::NotFinite { index: 7, .. }), "{error}");
        let mut huge = Matrix4::identity();
        huge[(0, 1)] = 1e300;
        assert!(matches!(Pose::from_matrix(&huge), Err(PoseError::NotOrthonormal { .. })));
    }

    #[test]
    fn quaternions_that_are_not_unit_are_refused() {
        let error = Pose::from_tum([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]).unwrap_err();
        assert_eq!(error, PoseError::NotUnit { norm: 2.0, limit: 1e-3 });
        assert!(Pose::from_tum([0.0, 0.0, 0.0, 1e300, 0.0, 0.0, 0.0]).is_err());
        assert!(Pose::from_tum([0.0, f64::INFINITY, 0.0, 0.0, 0.0, 0.0, 1.0]).is_err());
    }

    #[test]
    fn log_of_half_a_turn() {
        let twist = Vector6::new(0.3, -1.0, 2.0, 0.0, PI, 0.0);
        assert!((Pose::exp(&twist).log() - twist).norm() < 1e-12);
    }

    proptest! {
        #[test]
        fn inverse_undoes(pose in any_pose(), point in any_point()) {
            let back = pose.inverse() * (pose * point);
            prop_assert!((back - point).norm() < 1e-11);
            let nothing = pose * pose.inverse();
            prop_assert!(nothing.rotation_angle() < 1e-14);
            prop_assert!(nothing.translation_norm() < 1e-12);
        }

        #[test]
        fn composition_is_one_after_the_other(
            a in any_pose(), b in any_pose(), point in any_point()
        ) {
            let at_once = (a * b) * point;
            prop_assert!((at_once - a * (b * point)).norm() < 1e-11);
            let by_matrix = Point3::from_homogeneous(
                a.to_matrix() * b.to_matrix() * point.to_homogeneous()
            ).unwrap();
            prop_assert!((at_once - by_matrix).norm() < 1e-11);
        }

        #[test]
        fn distances_are_kept(pose in any_pose(), p in any_point(), q in any_point()) {
            let before = (p - q).norm();
            let after = (pose * p - pose * q).norm();
            prop_assert!((before - after).abs() < 1e-11);
            let turned = pose.transform_vector(&(p - q));
            prop_assert!((turned - (pose * p - pose * q)).norm() < 1e-11);
        }

        #[test]
        fn log_undoes_exp(twist in any_twist(PI - 1e-6)) {
            let back = Pose::exp(&twist).log();
            prop_assert!((back - twist).norm() < 1e-11, "{}", back - twist);
        }

        #[test]
        fn log_undoes_exp_of_small_turns(twist in any_twist(1e-3), shrink in 0.0..1.0f64) {
            let mut twist = twist;
            twist.fixed_rows_mut::<3>(3).scale_mut(shrink.powi(8));
            let back = Pose::exp(&twist).log();
            prop_assert!((back - twist).norm() < 1e-14);
        }

        #[test]
        fn exp_undoes_log_for_either_sign_of_the_quaternion(pose in any_pose()) {
            let negated = Pose::new(Unit::new_unchecked(-pose.rotation().into_inner()), pose.translation());
            let again = Pose::exp(&negated.log());
            prop_assert!((again.to_matrix() - pose.to_matrix()).norm() < 1e-12);
        }

        #[test]
        fn matrix_and_tum_round_trip(pose in any_pose()) {
            let matrix = pose.to_matrix();
            let again = Pose::from_matrix(&matrix).unwrap();
            prop_assert!((again.to_matrix() - matrix).norm() < 1e-14);
            let again = Pose::from_tum(pose.to_tum()).unwrap();
            prop_assert!((again.to_matrix() - matrix).norm() < 1e-14);
            // four digits, as text files have them
            let rounded = matrix.map(|v| (v * 1e4).round() / 1e4);
            let again = Pose::from_matrix(&rounded).unwrap();
            prop_assert!((again.to_matrix() - matrix).abs().max() < 2e-4);
            let r = again.rotation().to_rotation_matrix();
            let deviation = r.matrix().transpose() * r.matrix() - Matrix3::identity();
            prop_assert!(deviation.abs().max() < 1e-14);
        }
    }
}
