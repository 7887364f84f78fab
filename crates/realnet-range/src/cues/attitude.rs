//! How the camera looks at the ground.

use realnet_core::OptionError;
use realnet_core::nalgebra::Vector3;
use realnet_core::{CameraError, CameraModel};

/// A number with its standard deviation, in the same unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Uncertain {
    /// The best estimate.
    pub value: f64,
    /// Its standard deviation, at least 0.
    pub std: f64,
}

impl Uncertain {
    /// A value and its standard deviation.
    #[must_use]
    pub const fn new(value: f64, std: f64) -> Self {
        Self { value, std }
    }

    /// A value taken to be exact.
    #[must_use]
    pub const fn exact(value: f64) -> Self {
        Self { value, std: 0.0 }
    }

    /// The value must be greater than 0, the deviation at least 0.
    pub(crate) fn check_positive(&self, name: &'static str) -> Result<(), OptionError> {
        OptionError::check(name, self.value, self.value > 0.0, "greater than 0")?;
        self.check_std(name)
    }

    /// The value must lie within `+-limit`, the deviation be at least 0.
    pub(crate) fn check_within(&self, name: &'static str, limit: f64) -> Result<(), OptionError> {
        let ok = self.value.abs() <= limit;
        OptionError::check(name, self.value, ok, "less than a right angle")?;
        self.check_std(name)
    }

    fn check_std(&self, name: &'static str) -> Result<(), OptionError> {
        OptionError::check(name, self.std, self.std >= 0.0, "at least 0 in its deviation")
    }
}

/// Largest pitch or roll accepted as an attitude, radians (85.9 degrees).
pub(crate) const MAX_ANGLE: f64 = 1.5;

/// The camera's attitude against the ground, in the body frame of REP-103 that
/// looks along the optical axis (x forward, y left, z up).
///
/// `level_from_body = Ry(pitch) Rx(roll)`: pitch is the right-handed rotation
/// about y (left), so **positive pitch is nose down**; roll is the one about x
/// (forward), so positive roll is right side down. In the optical frame (x right,
/// y down, z forward) the unit vector straight down to the ground is
/// `[cos(pitch) sin(roll), cos(pitch) cos(roll), sin(pitch)]`, and the ground is
/// the plane `down . X = camera height`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Attitude {
    /// Rotation about the leftward axis, radians; positive: nose down.
    pub pitch_rad: f64,
    /// Rotation about the forward axis, radians; positive: right side down.
    pub roll_rad: f64,
}

impl Attitude {
    /// From pitch and roll in radians.
    #[must_use]
    pub const fn new(pitch_rad: f64, roll_rad: f64) -> Self {
        Self { pitch_rad, roll_rad }
    }

    /// The unit vector towards the ground, in the optical frame.
    #[must_use]
    pub fn down(&self) -> Vector3<f64> {
        let (sp, cp) = self.pitch_rad.sin_cos();
        let (sr, cr) = self.roll_rad.sin_cos();
        Vector3::new(cp * sr, cp * cr, sp)
    }

    /// The attitude in which a vector of the optical frame points to the ground;
    /// its length does not matter. `None` when it is 0 or not finite.
    #[must_use]
    pub fn from_down(down: &Vector3<f64>) -> Option<Self> {
        let norm = down.norm();
        (norm > 0.0 && norm.is_finite()).then(|| Self {
            pitch_rad: (down.z / norm).clamp(-1.0, 1.0).asin(),
            roll_rad: down.x.atan2(down.y),
        })
    }

    /// Where the horizon meets the rays `[ray_x, y]`: `y`. Rays with a larger
    /// one meet the ground.
    #[must_use]
    pub fn horizon_ray(&self, ray_x: f64) -> f64 {
        let down = self.down();
        -(down.x * ray_x + down.z) / down.y
    }

    /// The pixel of the horizon on the ray `[ray_x, y]`; `ray_x` is 0 in the
    /// middle of the picture.
    ///
    /// # Errors
    /// [`CameraError`] when the lens model does not reach so far.
    pub fn horizon_pixel(&self, camera: &CameraModel, ray_x: f64) -> Result<[f64; 2], CameraError> {
        camera.project_ray([ray_x, self.horizon_ray(ray_x)])
    }
}

/// The derivatives of a pixel's ray by u and by v, from central differences of
/// half a pixel to both sides.
pub(crate) fn ray_derivatives(
    camera: &CameraModel,
    [u, v]: [f64; 2],
) -> Result<[[f64; 2]; 2], CameraError> {
    let difference = |a: [f64; 2], b: [f64; 2]| -> Result<[f64; 2], CameraError> {
        let (a, b) = (camera.unproject(a)?, camera.unproject(b)?);
        Ok([b[0] - a[0], b[1] - a[1]])
    };
    let by_u = difference([u - 0.5, v], [u + 0.5, v])?;
    let by_v = difference([u, v - 0.5], [u, v + 0.5])?;
    Ok([by_u, by_v])
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::nalgebra::{UnitQuaternion, Vector3};
    use realnet_core::{Distortion, Intrinsics, Pose, body_from_optical};

    #[test]
    fn down_is_the_rotation_of_rep_103() {
        for (pitch, roll) in [(0.3, 0.0), (0.0, 0.2), (-0.4, 0.7), (0.9, -1.1)] {
            let level_from_body = Pose::from_rotation(
                UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch)
                    * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), roll),
            );
            let optical_from_level = (level_from_body * body_from_optical()).inverse();
            let expected = optical_from_level.transform_vector(&Vector3::new(0.0, 0.0, -1.0));
            let attitude = Attitude::new(pitch, roll);
            assert!((attitude.down() - expected).norm() < 1e-15);
            let again = Attitude::from_down(&(3.0 * expected)).unwrap();
            assert!((again.pitch_rad - pitch).abs() < 1e-15);
            assert!((again.roll_rad - roll).abs() < 1e-15);
        }
        assert_eq!(Attitude::from_down(&Vector3::zeros()), None);
        assert_eq!(Attitude::from_down(&Vector3::new(f64::NAN, 1.0, 0.0)), None);
    }

    #[test]
    fn nose_down_lifts_the_horizon_and_right_side_down_lifts_it_on_the_right() {
        let intrinsics = Intrinsics { fx: 500.0, fy: 400.0, cx: 320.0, cy: 240.0 };
        let camera = CameraModel::new(640, 480, intrinsics, Distortion::None).unwrap();
        let [u, v] = Attitude::new(0.1, 0.0).horizon_pixel(&camera, 0.0).unwrap();
        assert!((u - 320.0).abs() < 1e-12 && (v - (240.0 - 400.0 * 0.1f64.tan())).abs() < 1e-9);
        let rolled = Attitude::new(0.0, 0.1);
        assert!((rolled.horizon_ray(0.5) + 0.5 * 0.1f64.tan()).abs() < 1e-15);
    }
}
