//! Points and where they are seen.

use crate::PnpError;
use realnet_core::CameraModel;
use realnet_core::nalgebra::Point3;

/// Largest magnitude of an input, so that no square or product overflows.
const LARGEST: f64 = 1e100;

/// Points in the world and the rays on which the camera sees them.
///
/// Built only from finite values and lists of equal length.
#[derive(Clone, Copy, Debug)]
pub struct Correspondences<'a> {
    points: &'a [Point3<f64>],
    rays: &'a [[f64; 2]],
    focal: [f64; 2],
}

impl<'a> Correspondences<'a> {
    /// `points` in metres in the world, `rays` as `[x / z, y / z]` in the
    /// camera's optical frame, one for each point. `focal` is `[fx, fy]` in
    /// pixels and makes pixels of differences of rays; with `[1.0, 1.0]` all
    /// figures in pixels are in units of rays.
    ///
    /// # Errors
    /// [`PnpError::LengthMismatch`], [`PnpError::NotFinite`] (also for values
    /// beyond 1e100), [`PnpError::FocalLength`].
    pub fn new(
        points: &'a [Point3<f64>],
        rays: &'a [[f64; 2]],
        focal: [f64; 2],
    ) -> Result<Self, PnpError> {
        if points.len() != rays.len() {
            let (points, observations) = (points.len(), rays.len());
            return Err(PnpError::LengthMismatch { points, observations });
        }
        for (axis, value) in ['x', 'y'].into_iter().zip(focal) {
            if !(value > 0.0 && value <= LARGEST) {
                return Err(PnpError::FocalLength { axis, value });
            }
        }
        let good = |value: f64| value.abs() <= LARGEST;
        let bad = points
            .iter()
            .zip(rays)
            .position(|(point, ray)| !(point.coords.iter().chain(ray).all(|&value| good(value))));
        match bad {
            Some(index) => Err(PnpError::NotFinite { index }),
            None => Ok(Self { points, rays, focal }),
        }
    }

    /// Points in the world, metres.
    #[must_use]
    pub fn points(&self) -> &'a [Point3<f64>] {
        self.points
    }

    /// Rays `[x / z, y / z]` in the camera's optical frame.
    #[must_use]
    pub fn rays(&self) -> &'a [[f64; 2]] {
        self.rays
    }

    /// Pixels per unit of a ray, along x and y.
    #[must_use]
    pub fn focal(&self) -> [f64; 2] {
        self.focal
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// True without points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    pub(crate) fn at_least(&self, needed: usize) -> Result<(), PnpError> {
        let found = self.len();
        if found < needed { Err(PnpError::TooFewPoints { found, needed }) } else { Ok(()) }
    }
}

/// The rays of `pixels` into `rays`, which is emptied first.
pub(crate) fn unproject_into(
    camera: &CameraModel,
    pixels: &[[f64; 2]],
    rays: &mut Vec<[f64; 2]>,
) -> Result<(), PnpError> {
    rays.clear();
    for (index, ray) in camera.undistort_points(pixels).enumerate() {
        rays.push(ray.map_err(|source| PnpError::Camera { index, source })?);
    }
    Ok(())
}
