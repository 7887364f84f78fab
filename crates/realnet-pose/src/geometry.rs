//! Rotation matrices with translations, and the shape of point sets.

use realnet_core::Pose;
use realnet_core::nalgebra::{Matrix3, Point3, Rotation3, SymmetricEigen, UnitQuaternion, Vector3};

/// Below this share of the first extent the second makes a set a line.
pub(crate) const LINE_LIMIT: f64 = 1e-4;
/// Below this share of the first extent the third makes a set a plane.
pub(crate) const PLANE_LIMIT: f64 = 1e-3;

/// `camera_from_world` as the solvers use it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rt {
    pub(crate) r: Matrix3<f64>,
    pub(crate) t: Vector3<f64>,
}

impl Rt {
    pub(crate) fn identity() -> Self {
        Self { r: Matrix3::identity(), t: Vector3::zeros() }
    }

    pub(crate) fn from_pose(pose: &Pose) -> Self {
        Self { r: *pose.rotation().to_rotation_matrix().matrix(), t: pose.translation() }
    }

    pub(crate) fn to_pose(self) -> Pose {
        let rotation = Rotation3::from_matrix_unchecked(self.r);
        Pose::new(UnitQuaternion::from_rotation_matrix(&rotation), self.t)
    }
}

/// The extents of a point set: its mean, and the standard deviations along its
/// principal axes from the largest to the smallest.
pub(crate) struct Extent {
    pub(crate) mean: Vector3<f64>,
    pub(crate) deviations: [f64; 3],
    /// Direction of the smallest deviation: the normal of a plane.
    pub(crate) normal: Vector3<f64>,
}

impl Extent {
    /// Of the points for which `keep` holds. Zero extents without points.
    pub(crate) fn of<'a>(points: impl Iterator<Item = &'a Point3<f64>> + Clone) -> Self {
        let mut sum = Vector3::zeros();
        let mut count = 0.0;
        for point in points.clone() {
            sum += point.coords;
            count += 1.0;
        }
        let count: f64 = f64::max(count, 1.0);
        let mean = sum / count;
        let mut scatter = Matrix3::zeros();
        for point in points {
            let d = point.coords - mean;
            scatter += d * d.transpose();
        }
        let eigen = SymmetricEigen::new(scatter / count);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let deviations = order.map(|axis| eigen.eigenvalues[axis].max(0.0).sqrt());
        let normal = eigen.eigenvectors.column(order[2]).into_owned();
        Self { mean, deviations, normal }
    }

    /// Second over first deviation, 0 for a single place.
    pub(crate) fn line_ratio(&self) -> f64 {
        ratio(self.deviations[1], self.deviations[0])
    }

    /// Third over first deviation, 0 for a single place.
    pub(crate) fn plane_ratio(&self) -> f64 {
        ratio(self.deviations[2], self.deviations[0])
    }
}

fn ratio(small: f64, large: f64) -> f64 {
    if large > 0.0 { small / large } else { 0.0 }
}
