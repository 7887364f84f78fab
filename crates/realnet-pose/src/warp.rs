//! Depth maps moved to another time by rigid motions.

mod kernel;

use kernel::{RowCamera, RowMotion, close_cracks, splat};
use realnet_core::{CameraModel, DepthMap, Distortion, Pose, Stamp};
use thiserror::Error;

/// Why a depth map could not be warped.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum WarpError {
    /// A map is of another size than the camera.
    #[error(
        "the {which} depth map has {}x{} pixels, the camera {}x{}",
        found.0, found.1, expected.0, expected.1
    )]
    Size {
        /// `given` or `output`.
        which: &'static str,
        /// Width and height of the camera.
        expected: (u32, u32),
        /// Width and height of the map.
        found: (u32, u32),
    },
}

/// The pixels of a depth map that move on their own: those of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WarpRegion {
    /// First column and row.
    pub start: (u32, u32),
    /// Column and row behind the last.
    pub end: (u32, u32),
    /// Smallest and largest depth that belongs to it, metres.
    pub depths: (f32, f32),
    /// How it moved, as `now_from_then` in the camera's optical frame; `None`
    /// when that is not known: the pixels it covered become unknown.
    pub motion: Option<Pose>,
}

/// Warps depth maps of one camera.
///
/// Every known pixel is lifted to a point, moved and projected to the nearest
/// pixel; the nearest point wins (z-buffer). Where the picture is stretched,
/// columns or rows of one pixel are left without a point, or show what is
/// behind: they are closed when the depths on both sides agree within 5 %.
/// Everything else without a point is *unknown*: what was hidden before, and
/// what was outside the picture.
///
/// Lenses with distortion are warped as they are, at several times the cost of a
/// picture without.
#[derive(Clone, Debug)]
pub struct DepthWarper {
    camera: CameraModel,
    row_camera: RowCamera,
    /// x / z of each column, or of each pixel when the lens distorts.
    ray_x: Vec<f32>,
    /// y / z of each row, or of each pixel when the lens distorts.
    ray_y: Vec<f32>,
    buffer: Vec<f32>,
    scratch: Vec<f32>,
    row: RowMotion,
}

impl DepthWarper {
    /// A warper for depth maps of this camera, at their resolution (see
    /// [`CameraModel::scaled`]).
    #[must_use]
    pub fn new(camera: &CameraModel) -> Self {
        let (width, height) = (camera.width(), camera.height());
        let pixels = width as usize * height as usize;
        let (mut ray_x, mut ray_y) = (Vec::new(), Vec::new());
        if camera.distortion() == Distortion::None {
            ray_x.extend((0..width).map(|x| ((f64::from(x) - camera.cx()) / camera.fx()) as f32));
            ray_y.extend((0..height).map(|y| ((f64::from(y) - camera.cy()) / camera.fy()) as f32));
        } else {
            ray_x.reserve_exact(pixels);
            ray_y.reserve_exact(pixels);
            for y in 0..height {
                for x in 0..width {
                    let ray = camera.unproject([f64::from(x), f64::from(y)]);
                    let ray = ray.unwrap_or([f64::NAN; 2]);
                    ray_x.push(ray[0] as f32);
                    ray_y.push(ray[1] as f32);
                }
            }
        }
        Self {
            row_camera: RowCamera::new(camera),
            camera: *camera,
            ray_x,
            ray_y,
            buffer: vec![f32::INFINITY; pixels],
            scratch: vec![f32::INFINITY; pixels],
            row: RowMotion::new(width as usize),
        }
    }

    /// The camera whose maps are warped.
    #[must_use]
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }

    /// Writes `depth`, as it is at `stamp`, into `out`.
    ///
    /// `background` is `now_from_then` of all that does not belong to `target`,
    /// in the camera's optical frame: for a camera that moves through a still
    /// scene, the pose of then's camera in now's. With `None` only the target is
    /// warped, which costs in proportion to its size, and one pass over the map.
    ///
    /// # Errors
    /// [`WarpError::Size`].
    pub fn warp(
        &mut self,
        depth: &DepthMap,
        stamp: Stamp,
        background: Option<&Pose>,
        target: Option<&WarpRegion>,
        out: &mut DepthMap,
    ) -> Result<(), WarpError> {
        let expected = (self.camera.width(), self.camera.height());
        for (which, map) in [("given", depth), ("output", &*out)] {
            let found = (map.width(), map.height());
            if found != expected {
                return Err(WarpError::Size { which, expected, found });
            }
        }
        out.set_stamp(stamp);
        self.buffer.fill(f32::INFINITY);
        let (width, height) = (expected.0 as usize, expected.1 as usize);
        let span = |start: u32, end: u32, size: usize| {
            let end = (end as usize).min(size);
            (start as usize).min(end)..end
        };
        let columns = |r: &WarpRegion| span(r.start.0, r.end.0, width);
        let rows = |r: &WarpRegion| span(r.start.1, r.end.1, height);
        let mut touched = Touched::NONE;
        for y in 0..height {
            let target = target.filter(|r| rows(r).contains(&y));
            if let Some(background) = background {
                let span = target.map_or(0..0, columns);
                for part in [0..span.start, span.end..width] {
                    self.segment(depth, y, part, background, Depths::All, &mut touched);
                }
                if let Some(region) = target {
                    let depths = Depths::Outside(region.depths);
                    self.segment(depth, y, span, background, depths, &mut touched);
                }
            }
            if let Some((region, motion)) = target.and_then(|r| Some((r, r.motion.as_ref()?))) {
                let depths = Depths::Inside(region.depths);
                self.segment(depth, y, columns(region), motion, depths, &mut touched);
            }
        }
        let rows = touched.rows(height);
        close_cracks(&mut self.buffer, &mut self.scratch, width, rows, out.data_mut());
        Ok(())
    }

    /// Warps the columns `part` of the row `y`.
    fn segment(
        &mut self,
        depth: &DepthMap,
        y: usize,
        part: std::ops::Range<usize>,
        motion: &Pose,
        depths: Depths,
        touched: &mut Touched,
    ) {
        let length = part.len();
        let width = self.camera.width() as usize;
        let plain = self.camera.distortion() == Distortion::None;
        let ray_x = if plain { 0 } else { y * width };
        let (Some(z), Some(ray_x)) = (
            depth.row(y as u32).get(part.clone()),
            self.ray_x.get(ray_x + part.start..ray_x + part.end),
        ) else {
            return;
        };
        if length == 0 {
            return;
        }
        self.row.gate(z, depths);
        if plain {
            let ray_y = self.ray_y.get(y).copied().unwrap_or(f32::NAN);
            self.row.project(&self.row_camera, ray_x, ray_y, motion);
        } else {
            let start = y * width + part.start;
            let Some(ray_y) = self.ray_y.get(start..start + length) else { return };
            self.row.project_distorted(&self.camera, ray_x, ray_y, motion);
        }
        let size = (width, self.camera.height() as usize);
        splat(&self.row, length, size, &mut self.buffer, touched);
    }
}

/// Which depths of a segment move.
#[derive(Clone, Copy)]
enum Depths {
    All,
    Inside((f32, f32)),
    Outside((f32, f32)),
}

/// The rows that points fell on.
struct Touched {
    first: i32,
    last: i32,
}

impl Touched {
    const NONE: Self = Self { first: i32::MAX, last: i32::MIN };

    /// They and their neighbours.
    fn rows(&self, height: usize) -> std::ops::Range<usize> {
        if self.first > self.last {
            return 0..0;
        }
        let first = usize::try_from(self.first).unwrap_or(0).saturating_sub(1);
        first..(usize::try_from(self.last).unwrap_or(0) + 2).min(height)
    }
}

#[cfg(test)]
mod tests;
