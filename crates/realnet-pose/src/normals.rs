//! Surface normals of depth maps.

use crate::WarpError;
use realnet_core::nalgebra::{Matrix3, Vector3};
use realnet_core::{CameraModel, DepthMap};

/// How [`SurfaceNormals`] fits planes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalOptions {
    /// A plane is fitted to the `2 radius + 1` columns and rows around a pixel.
    pub radius: u32,
    /// Neighbours whose depth differs by more than this share of the pixel's own belong to
    /// another surface.
    pub step: f32,
    /// Share of the neighbours that has to belong to the same surface, else the normal is
    /// unknown.
    pub least: f64,
}

impl Default for NormalOptions {
    fn default() -> Self {
        Self { radius: 3, step: 0.1, least: 0.5 }
    }
}

/// Unit normals of the surface that each pixel shows, in the camera's optical frame, towards
/// the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct NormalMap {
    width: u32,
    height: u32,
    data: Vec<[f32; 3]>,
}

impl NormalMap {
    /// What an unknown normal is written as.
    pub const UNKNOWN: [f32; 3] = [0.0; 3];

    /// Pixels a row.
    #[must_use]
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    #[must_use]
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// The normals, row by row.
    #[must_use]
    pub fn data(&self) -> &[[f32; 3]] {
        &self.data
    }

    /// The normal of a pixel; `None` where it is unknown and outside the map.
    #[must_use]
    pub fn at(&self, x: u32, y: u32) -> Option<[f32; 3]> {
        let inside = x < self.width && y < self.height;
        let place = y as usize * self.width as usize + x as usize;
        let normal = self.data.get(place).filter(|_| inside)?;
        (*normal != Self::UNKNOWN).then_some(*normal)
    }

    /// Forgets the normals of the pixels `(x, y)` that `keep` says no to.
    pub fn retain(&mut self, keep: impl Fn(u32, u32) -> bool) {
        let pixels = (0..self.height).flat_map(|y| (0..self.width).map(move |x| (x, y)));
        for (normal, (x, y)) in self.data.iter_mut().zip(pixels) {
            if !keep(x, y) {
                *normal = Self::UNKNOWN;
            }
        }
    }

    /// The angles between the normals of two maps, degrees, where both are known. None for
    /// maps of different sizes.
    pub fn angles<'a>(&'a self, other: &'a Self) -> impl Iterator<Item = f64> + 'a {
        let same = (self.width, self.height) == (other.width, other.height);
        let pairs = self.data.iter().zip(&other.data).filter(move |_| same);
        pairs.filter(|(a, b)| **a != Self::UNKNOWN && **b != Self::UNKNOWN).map(|(a, b)| {
            let [a, b] = [a, b].map(|n| Vector3::from(n.map(f64::from)));
            // The arc cosine knows small angles badly.
            2.0 * (a - b).norm().atan2((a + b).norm()).to_degrees()
        })
    }
}

/// Finds the surface normals of depth maps of one camera.
///
/// A plane `n · P = 1` seen at the rays `(x, y, 1)` has the inverse depths `1 / z = n · (x, y,
/// 1)`: linear in the rays. So `n` is the linear least-squares fit of the inverse depths
/// around a pixel, without a point cloud and for any lens.
#[derive(Clone, Debug)]
pub struct SurfaceNormals {
    options: NormalOptions,
    size: (u32, u32),
    /// Rays of the pixels; NaN where the lens has none.
    rays: Vec<[f64; 2]>,
}

impl SurfaceNormals {
    /// For depth maps of this camera, at their resolution (see [`CameraModel::scaled`]).
    #[must_use]
    pub fn new(camera: &CameraModel, options: NormalOptions) -> Self {
        let size = (camera.width(), camera.height());
        let ray = |(x, y)| camera.unproject([f64::from(x), f64::from(y)]);
        let pixels = (0..size.1).flat_map(|y| (0..size.0).map(move |x| (x, y)));
        let rays = pixels.map(|pixel| ray(pixel).unwrap_or([f64::NAN; 2])).collect();
        Self { options, size, rays }
    }

    /// The normals of a depth map.
    ///
    /// # Errors
    /// [`WarpError::Size`] when the map is of another size than the camera.
    pub fn of(&self, depth: &DepthMap) -> Result<NormalMap, WarpError> {
        let (width, height) = self.size;
        let found = (depth.width(), depth.height());
        if found != self.size {
            return Err(WarpError::Size { which: "given", expected: self.size, found });
        }
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let data =
            pixels.map(|(x, y)| self.normal(depth, x, y).unwrap_or(NormalMap::UNKNOWN)).collect();
        Ok(NormalMap { width, height, data })
    }

    fn ray(&self, x: u32, y: u32) -> Option<[f64; 2]> {
        let ray = self.rays.get(y as usize * self.size.0 as usize + x as usize)?;
        ray[0].is_finite().then_some(*ray)
    }

    fn normal(&self, depth: &DepthMap, x: u32, y: u32) -> Option<[f32; 3]> {
        let NormalOptions { radius, step, least } = self.options;
        let own = *depth.row(y).get(x as usize)?;
        if !DepthMap::is_known(own) {
            return None;
        }
        let middle = self.ray(x, y)?;
        let (width, height) = self.size;
        let columns = x.saturating_sub(radius)..(x + radius + 1).min(width);
        // Rays from the pixel's own, inverse depths as multiples of its own: all near 1.
        let (mut squares, mut products) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
        let mut count = 0_u32;
        for v in y.saturating_sub(radius)..(y + radius + 1).min(height) {
            let row = depth.row(v);
            for u in columns.clone() {
                let Some(&z) = row.get(u as usize) else { continue };
                let Some(ray) = self.ray(u, v) else { continue };
                if !DepthMap::is_known(z) || (z - own).abs() > step * own {
                    continue;
                }
                let at = Vector3::new(ray[0] - middle[0], ray[1] - middle[1], 1.0);
                squares += at * at.transpose();
                products += at * (f64::from(own) / f64::from(z));
                count += 1;
            }
        }
        let all = f64::from(2 * radius + 1).powi(2);
        if count < 3 || f64::from(count) < least * all {
            return None;
        }
        let slope = squares.cholesky()?.solve(&products);
        // From rays around the pixel's own to rays around the optical axis; the plane's
        // normal points away from the camera, as `n · P = 1`.
        let away = Vector3::new(
            slope[0],
            slope[1],
            slope[2] - slope[0] * middle[0] - slope[1] * middle[1],
        );
        let normal = -away.try_normalize(1e-12)?;
        normal.iter().all(|part| part.is_finite()).then(|| normal.map(|part| part as f32).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::{Distortion, Intrinsics, Stamp};

    fn camera(distortion: Distortion) -> CameraModel {
        let intrinsics = Intrinsics { fx: 60.0, fy: 55.0, cx: 31.0, cy: 22.5 };
        CameraModel::new(64, 48, intrinsics, distortion).unwrap()
    }

    /// The depth of planes `n · P = 1`; the nearest one is seen.
    fn seen(camera: &CameraModel, planes: &[[f64; 3]]) -> DepthMap {
        let depth = |x: u32, y: u32| {
            let [a, b] = camera.unproject([f64::from(x), f64::from(y)]).unwrap();
            let inverse = planes.iter().map(|n| n[0] * a + n[1] * b + n[2]).fold(0.0, f64::max);
            if inverse > 0.0 { (1.0 / inverse) as f32 } else { 0.0 }
        };
        let (width, height) = (camera.width(), camera.height());
        let data = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let data = data.map(|(x, y)| depth(x, y)).collect();
        DepthMap::new(Stamp::ZERO, width, height, data).unwrap()
    }

    fn degrees(a: [f32; 3], away: [f64; 3]) -> f64 {
        let towards = -Vector3::from(away).normalize();
        Vector3::from(a.map(f64::from)).angle(&towards).to_degrees()
    }

    #[test]
    fn planes_have_one_normal_everywhere() {
        let radial = Distortion::PlumbBob([-0.2, 0.05, 0.001, 0.0, 0.0]);
        for distortion in [Distortion::None, radial] {
            let camera = camera(distortion);
            let normals = SurfaceNormals::new(&camera, NormalOptions::default());
            for plane in [[0.0, 0.0, 0.5], [0.2, 0.1, 0.4], [-0.05, 0.9, 0.6]] {
                let map = seen(&camera, &[plane]);
                let found = normals.of(&map).unwrap();
                let mut known = 0;
                for (normal, depth) in found.data().iter().zip(map.data()) {
                    if *normal != NormalMap::UNKNOWN {
                        assert!(degrees(*normal, plane) < 0.1, "{normal:?} of {plane:?}");
                        assert!(*depth > 0.0);
                        known += 1;
                    }
                }
                assert!(known > 1000, "{known} of {plane:?}");
            }
        }
    }

    /// Two walls: no normal in between.
    #[test]
    fn edges_do_not_bend_normals() {
        let camera = camera(Distortion::None);
        let (near, far) = ([0.4, 0.0, 0.3], [-0.1, 0.0, 0.15]);
        let map = seen(&camera, &[near, far]);
        let found = SurfaceNormals::new(&camera, NormalOptions::default()).of(&map).unwrap();
        assert!(degrees(found.at(60, 20).unwrap(), near) < 0.1);
        assert!(degrees(found.at(2, 20).unwrap(), far) < 0.1);
        assert_eq!(found.at(64, 20), None);
        let mut left = found.clone();
        left.retain(|x, y| x < 10 && y > 5);
        assert!(left.at(9, 20).is_some() && left.at(9, 5).is_none() && left.at(10, 20).is_none());
        let between = |x: u32| {
            let own = |normal| degrees(normal, near).min(degrees(normal, far));
            found.at(x, 20).map_or(0.0, own)
        };
        // A corner without a step in depth is rounded, by less than what it turns.
        let turn = Vector3::from(near).angle(&Vector3::from(far)).to_degrees();
        assert!((0..64).all(|x| between(x) < 0.55 * turn), "{turn}");
    }

    #[test]
    fn what_is_unknown_stays_so() {
        let camera = camera(Distortion::None);
        let normals = SurfaceNormals::new(&camera, NormalOptions::default());
        let mut data = seen(&camera, &[[0.0, 0.0, 0.5]]).data().to_vec();
        for row in data.chunks_exact_mut(64) {
            row[20..].fill(0.0);
        }
        data[10 * 64 + 40] = 2.0; // alone
        data[5 * 64 + 5] = f32::NAN;
        let map = DepthMap::new(Stamp::ZERO, 64, 48, data).unwrap();
        let found = normals.of(&map).unwrap();
        assert_eq!((found.at(40, 10), found.at(5, 5), found.at(30, 30)), (None, None, None));
        assert!(found.at(10, 20).is_some());
        let small = DepthMap::unknown(Stamp::ZERO, 32, 48).unwrap();
        assert!(normals.of(&small).is_err());
    }

    #[test]
    fn angles_are_between_known_normals() {
        let map = |data: Vec<[f32; 3]>| NormalMap { width: data.len() as u32, height: 1, data };
        let [x, y, z] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let a = map(vec![x, x, NormalMap::UNKNOWN, z, z]);
        let b = map(vec![x, y, z, [0.0, 0.0, -1.0], NormalMap::UNKNOWN]);
        let found: Vec<f64> = a.angles(&b).collect();
        assert_eq!(found.len(), 3);
        for (angle, wanted) in found.iter().zip([0.0, 90.0, 180.0]) {
            assert!((angle - wanted).abs() < 1e-9);
        }
        assert_eq!(a.angles(&map(vec![x])).count(), 0);
    }
}
