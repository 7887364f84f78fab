//! The camera: rays to pixels and back.

mod distortion;
mod ros_yaml;

pub use distortion::Distortion;
pub use ros_yaml::{CalibrationError, CameraCalibration};

use nalgebra::{Matrix3, Point3};
use thiserror::Error;

/// Why a camera cannot be built, or cannot say where a ray goes.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CameraError {
    /// A side of the picture is 0.
    #[error("a camera of {width}x{height} pixels has no picture")]
    Empty {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A focal length is not a positive number.
    #[error("focal length {name} is {value}, it must be finite and greater than 0")]
    FocalLength {
        /// `fx` or `fy`.
        name: &'static str,
        /// What was given, in pixels.
        value: f64,
    },
    /// A coordinate of the principal point is not a number.
    #[error("principal point {name} is {value}, it must be finite")]
    PrincipalPoint {
        /// `cx` or `cy`.
        name: &'static str,
        /// What was given, in pixels.
        value: f64,
    },
    /// A distortion coefficient is not a number, or larger than any lens has.
    #[error("distortion coefficient {index} is {value}, its magnitude must be at most {limit}")]
    Coefficient {
        /// Place in the model's coefficient vector, from 0.
        index: usize,
        /// What was given.
        value: f64,
        /// Largest magnitude accepted.
        limit: f64,
    },
    /// A crop reaches beyond the picture.
    #[error(
        "a crop of {width}x{height} at ({x}, {y}) reaches beyond the picture of \
         {full_width}x{full_height} pixels"
    )]
    Crop {
        /// First column of the crop.
        x: u32,
        /// First row of the crop.
        y: u32,
        /// Columns asked for.
        width: u32,
        /// Rows asked for.
        height: u32,
        /// Columns there are.
        full_width: u32,
        /// Rows there are.
        full_height: u32,
    },
    /// A point does not lie in front of the camera.
    #[error("a point at depth {z} m does not lie in front of the camera")]
    Behind {
        /// Depth along the optical axis, metres.
        z: f64,
    },
    /// A depth to lift a pixel to is not a positive number.
    #[error("depth {depth} m is not a positive number")]
    Depth {
        /// What was given, metres.
        depth: f64,
    },
    /// A coordinate is not a number, or grew beyond 64 bits.
    #[error("coordinates ({x}, {y}) are not finite")]
    NotFinite {
        /// First coordinate.
        x: f64,
        /// Second coordinate.
        y: f64,
    },
    /// The lens model folds back before this ray: its answer there would be a
    /// plausible pixel of some other ray.
    #[error(
        "a ray {radius} from the axis lies outside the lens model, which is one to one up to {limit}"
    )]
    OutsideLens {
        /// Distance from the axis on the plane at unit depth.
        radius: f64,
        /// Largest distance at which the model holds.
        limit: f64,
    },
    /// No ray inside the lens model reaches this place.
    #[error(
        "no ray of the lens model reaches ({x}, {y}) on the unit plane, the nearest misses by {residual}"
    )]
    NoInverse {
        /// Distorted coordinate `(u - cx) / fx`.
        x: f64,
        /// Distorted coordinate `(v - cy) / fy`.
        y: f64,
        /// Distance on the unit plane that is left.
        residual: f64,
    },
}

/// Focal lengths and principal point in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Principal point, x.
    pub cx: f64,
    /// Principal point, y.
    pub cy: f64,
}

/// A camera with a central projection and a lens.
///
/// Points are given in the camera's *optical* frame: x right, y down, z forward,
/// metres. Pixels are `[u, v]`, u to the right and v down, by the convention of
/// OpenCV and ROS: whole numbers are the centres of pixels, so the picture
/// spans `-0.5` to `width - 0.5`. (A [`BoundingBox`](crate::BoundingBox) counts
/// from the edge of the picture instead: its coordinate is larger by 0.5.)
/// Rays are `[x / z, y / z]`, the place where they meet the plane at unit depth.
///
/// ```
/// use realnet_core::{CameraModel, Distortion, Intrinsics, nalgebra::Point3};
///
/// let intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5 };
/// let lens = Distortion::PlumbBob([-0.3, 0.1, 0.0, 0.0, 0.0]);
/// let camera = CameraModel::new(640, 480, intrinsics, lens)?;
/// let pixel = camera.project(&Point3::new(0.4, -0.2, 2.0))?;
/// let point = camera.unproject_at_depth(pixel, 2.0)?;
/// assert!((point - Point3::new(0.4, -0.2, 2.0)).norm() < 1e-12);
/// # Ok::<(), realnet_core::CameraError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraModel {
    width: u32,
    height: u32,
    intrinsics: Intrinsics,
    distortion: Distortion,
    valid_radius: f64,
}

impl CameraModel {
    /// A camera of `width` x `height` pixels.
    ///
    /// # Errors
    /// [`CameraError`] when a side is 0, a focal length is not finite and
    /// positive, the principal point is not finite, or a distortion coefficient
    /// is not finite or its magnitude exceeds 1e6.
    pub fn new(
        width: u32,
        height: u32,
        intrinsics: Intrinsics,
        distortion: Distortion,
    ) -> Result<Self, CameraError> {
        if width == 0 || height == 0 {
            return Err(CameraError::Empty { width, height });
        }
        let Intrinsics { fx, fy, cx, cy } = intrinsics;
        for (name, value) in [("fx", fx), ("fy", fy)] {
            if !value.is_finite() || value <= 0.0 {
                return Err(CameraError::FocalLength { name, value });
            }
        }
        for (name, value) in [("cx", cx), ("cy", cy)] {
            if !value.is_finite() {
                return Err(CameraError::PrincipalPoint { name, value });
            }
        }
        let valid_radius = distortion.valid_radius()?;
        Ok(Self { width, height, intrinsics, distortion, valid_radius })
    }

    /// Pixels a row.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Focal lengths and principal point.
    #[must_use]
    pub fn intrinsics(&self) -> Intrinsics {
        self.intrinsics
    }

    /// Focal length along x, pixels.
    #[must_use]
    pub fn fx(&self) -> f64 {
        self.intrinsics.fx
    }

    /// Focal length along y, pixels.
    #[must_use]
    pub fn fy(&self) -> f64 {
        self.intrinsics.fy
    }

    /// Principal point, x, pixels.
    #[must_use]
    pub fn cx(&self) -> f64 {
        self.intrinsics.cx
    }

    /// Principal point, y, pixels.
    #[must_use]
    pub fn cy(&self) -> f64 {
        self.intrinsics.cy
    }

    /// The lens.
    #[must_use]
    pub fn distortion(&self) -> Distortion {
        self.distortion
    }

    /// The largest distance from the axis, on the plane at unit depth, at which
    /// the lens model is one to one. Rays further out are refused; it is
    /// infinite for a pinhole and at most 1000 (89.94 degrees) for a lens.
    #[must_use]
    pub fn valid_radius(&self) -> f64 {
        self.valid_radius
    }

    /// The camera matrix `K`, without the lens.
    #[must_use]
    pub fn matrix(&self) -> Matrix3<f64> {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    }

    /// The same picture through a perfect pinhole: the lens left out.
    #[must_use]
    pub fn without_distortion(&self) -> Self {
        Self { distortion: Distortion::None, valid_radius: f64::INFINITY, ..*self }
    }

    /// True when a pixel position lies on the picture, edges included.
    #[must_use]
    pub fn contains(&self, [u, v]: [f64; 2]) -> bool {
        (-0.5..=f64::from(self.width) - 0.5).contains(&u)
            && (-0.5..=f64::from(self.height) - 0.5).contains(&v)
    }

    /// The pixel of a point in the optical frame. It may lie beside the picture;
    /// ask [`CameraModel::contains`].
    ///
    /// # Errors
    /// [`CameraError::Behind`] when the depth is not greater than 0,
    /// [`CameraError::OutsideLens`] when the lens model does not hold so far
    /// out, [`CameraError::NotFinite`] for coordinates that are not finite.
    pub fn project(&self, point: &Point3<f64>) -> Result<[f64; 2], CameraError> {
        // Written so that a depth that is not a number is refused too.
        if !point.z.is_finite() || point.z <= 0.0 {
            return Err(CameraError::Behind { z: point.z });
        }
        self.project_ray([point.x / point.z, point.y / point.z])
    }

    /// The pixel of a ray `[x / z, y / z]`.
    ///
    /// # Errors
    /// As [`CameraModel::project`], without the depth.
    pub fn project_ray(&self, ray: [f64; 2]) -> Result<[f64; 2], CameraError> {
        let bent = self.distortion.distort(ray, self.valid_radius)?;
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        finite([fx * bent[0] + cx, fy * bent[1] + cy])
    }

    /// The ray `[x / z, y / z]` that a pixel sees, the lens taken out.
    ///
    /// # Errors
    /// [`CameraError::NoInverse`] when no ray inside the lens model reaches the
    /// pixel, [`CameraError::NotFinite`] for coordinates that are not finite.
    pub fn unproject(&self, pixel: [f64; 2]) -> Result<[f64; 2], CameraError> {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let bent = [(pixel[0] - cx) / fx, (pixel[1] - cy) / fy];
        finite(self.distortion.undistort(bent, self.valid_radius)?)
    }

    /// The point in the optical frame that a pixel sees at `depth`, metres along
    /// the optical axis (not along the ray).
    ///
    /// # Errors
    /// As [`CameraModel::unproject`], and [`CameraError::Depth`] when the depth
    /// is not finite and positive.
    pub fn unproject_at_depth(
        &self,
        pixel: [f64; 2],
        depth: f64,
    ) -> Result<Point3<f64>, CameraError> {
        if !depth.is_finite() || depth <= 0.0 {
            return Err(CameraError::Depth { depth });
        }
        let [x, y] = self.unproject(pixel)?;
        let [x, y] = finite([x * depth, y * depth])?;
        Ok(Point3::new(x, y, depth))
    }

    /// The rays of many pixels: [`CameraModel::unproject`] one by one, without
    /// allocating. Collect into a `Result` to stop at the first that fails.
    pub fn undistort_points<'a>(
        &'a self,
        pixels: &'a [[f64; 2]],
    ) -> impl ExactSizeIterator<Item = Result<[f64; 2], CameraError>> + 'a {
        pixels.iter().map(|&pixel| self.unproject(pixel))
    }

    /// Where another camera at the same place with the same axes sees the
    /// pixels of this one: undistorted pixels when `other` has no lens.
    pub fn reproject_points<'a>(
        &'a self,
        pixels: &'a [[f64; 2]],
        other: &'a Self,
    ) -> impl ExactSizeIterator<Item = Result<[f64; 2], CameraError>> + 'a {
        pixels.iter().map(|&pixel| other.project_ray(self.unproject(pixel)?))
    }

    /// The camera of the picture resized to `width` x `height`. The edges of
    /// the picture stay edges, so a pixel moves to `(u + 0.5) * s - 0.5` with
    /// `s` the scale of its axis.
    ///
    /// # Errors
    /// [`CameraError::Empty`] when a side is 0.
    pub fn scaled(&self, width: u32, height: u32) -> Result<Self, CameraError> {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let intrinsics = Intrinsics {
            fx: fx * sx,
            fy: fy * sy,
            cx: (cx + 0.5) * sx - 0.5,
            cy: (cy + 0.5) * sy - 0.5,
        };
        Self::new(width, height, intrinsics, self.distortion)
    }

    /// The camera of the part of the picture that starts at pixel `(x, y)` and
    /// has `width` x `height` pixels.
    ///
    /// # Errors
    /// [`CameraError::Crop`] when it reaches beyond the picture,
    /// [`CameraError::Empty`] when a side is 0.
    pub fn cropped(&self, x: u32, y: u32, width: u32, height: u32) -> Result<Self, CameraError> {
        let inside = |start: u32, size: u32, full: u32| {
            start.checked_add(size).is_some_and(|end| end <= full)
        };
        if !inside(x, width, self.width) || !inside(y, height, self.height) {
            let (full_width, full_height) = (self.width, self.height);
            return Err(CameraError::Crop { x, y, width, height, full_width, full_height });
        }
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        let intrinsics = Intrinsics { fx, fy, cx: cx - f64::from(x), cy: cy - f64::from(y) };
        Self::new(width, height, intrinsics, self.distortion)
    }

    /// Angle in radians between the rays of the left and the right edge of the
    /// picture, at the height of the principal point.
    ///
    /// # Errors
    /// As [`CameraModel::unproject`], when the lens model does not reach an edge.
    pub fn horizontal_fov(&self) -> Result<f64, CameraError> {
        let cy = self.intrinsics.cy;
        self.angle_between([-0.5, cy], [f64::from(self.width) - 0.5, cy])
    }

    /// Angle in radians between the rays of the top and the bottom edge of the
    /// picture, at the column of the principal point.
    ///
    /// # Errors
    /// As [`CameraModel::horizontal_fov`].
    pub fn vertical_fov(&self) -> Result<f64, CameraError> {
        let cx = self.intrinsics.cx;
        self.angle_between([cx, -0.5], [cx, f64::from(self.height) - 0.5])
    }

    fn angle_between(&self, first: [f64; 2], second: [f64; 2]) -> Result<f64, CameraError> {
        let a = self.unproject(first)?;
        let b = self.unproject(second)?;
        let a = nalgebra::Vector3::new(a[0], a[1], 1.0);
        let b = nalgebra::Vector3::new(b[0], b[1], 1.0);
        Ok(a.cross(&b).norm().atan2(a.dot(&b)))
    }
}

fn finite([x, y]: [f64; 2]) -> Result<[f64; 2], CameraError> {
    if x.is_finite() && y.is_finite() { Ok([x, y]) } else { Err(CameraError::NotFinite { x, y }) }
}

#[cfg(test)]
mod tests;
