//! The inner loops of warping, row by row in 32-bit floats.

use super::{Depths, Touched};
use realnet_core::nalgebra::Point3;
use realnet_core::{CameraModel, DepthMap, Pose};

/// Depths on both sides of a crack agree when the larger is at most this many
/// times the smaller.
const AGREE: f32 = 1.05;

/// A pinhole camera in 32 bits.
#[derive(Clone, Debug)]
pub(super) struct RowCamera {
    focal: [f32; 2],
    centre: [f32; 2],
}

impl RowCamera {
    pub(super) fn new(camera: &CameraModel) -> Self {
        let focal = [camera.fx() as f32, camera.fy() as f32];
        Self { focal, centre: [camera.cx() as f32, camera.cy() as f32] }
    }
}

/// A row of depths and where they go.
#[derive(Clone, Debug)]
pub(super) struct RowMotion {
    /// Depth before; NaN where nothing is to be moved.
    before: Vec<f32>,
    /// Column and row after, as whole numbers; -1 for outside.
    column: Vec<i32>,
    row: Vec<i32>,
    /// Depth after; not above 0 for what fell behind the camera.
    after: Vec<f32>,
}

impl RowMotion {
    pub(super) fn new(width: usize) -> Self {
        Self {
            before: vec![0.0; width],
            column: vec![0; width],
            row: vec![0; width],
            after: vec![0.0; width],
        }
    }

    /// Takes the depths that move.
    pub(super) fn gate(&mut self, z: &[f32], depths: Depths) {
        for (before, &z) in self.before.iter_mut().zip(z) {
            let moves = match depths {
                Depths::All => true,
                Depths::Inside((near, far)) => z >= near && z <= far,
                Depths::Outside((near, far)) => !(z >= near && z <= far),
            };
            *before = if moves && DepthMap::is_known(z) { z } else { f32::NAN };
        }
    }

    pub(super) fn project(&mut self, camera: &RowCamera, ray_x: &[f32], ray_y: f32, motion: &Pose) {
        let rotation = motion.rotation().to_rotation_matrix();
        let r = rotation.matrix().map(|v| v as f32);
        let t = motion.translation().map(|v| v as f32);
        let [fx, fy] = camera.focal;
        // Half a pixel for rounding.
        let [cx, cy] = [camera.centre[0] + 0.5, camera.centre[1] + 0.5];
        // A point is z (a + x b) + t.
        let constants = Constants {
            a: [0, 1, 2].map(|i| r[(i, 1)] * ray_y + r[(i, 2)]),
            b: [r[(0, 0)], r[(1, 0)], r[(2, 0)]],
            t: [t.x, t.y, t.z],
            focal: [fx, fy],
            centre: [cx, cy],
        };
        let rows = (&mut *self.column, &mut *self.row, &mut *self.after);
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            unsafe { project_avx2(&constants, &self.before, ray_x, rows) };
            return;
        }
        project_row(&constants, &self.before, ray_x, rows);
    }

    pub(super) fn project_distorted(
        &mut self,
        camera: &CameraModel,
        ray_x: &[f32],
        ray_y: &[f32],
        motion: &Pose,
    ) {
        let outputs = self.column.iter_mut().zip(&mut self.row).zip(&mut self.after);
        let inputs = self.before.iter().zip(ray_x.iter().zip(ray_y));
        for (((column, row), after), (&z, (&x, &y))) in outputs.zip(inputs) {
            (*column, *row, *after) = (-1, -1, f32::NAN);
            if !(z > 0.0) {
                continue;
            }
            let [x, y, z] = [x, y, z].map(f64::from);
            let point = *motion * Point3::new(x * z, y * z, z);
            if let Ok([u, v]) = camera.project(&point) {
                *column = (u + 0.5).floor() as i32;
                *row = (v + 0.5).floor() as i32;
                *after = point.z as f32;
            }
        }
    }
}

struct Constants {
    a: [f32; 3],
    b: [f32; 3],
    t: [f32; 3],
    focal: [f32; 2],
    centre: [f32; 2],
}

type Rows<'a> = (&'a mut [i32], &'a mut [i32], &'a mut [f32]);

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn project_avx2(c: &Constants, before: &[f32], ray_x: &[f32], rows: Rows<'_>) {
    project_row(c, before, ray_x, rows);
}

#[inline(always)]
fn project_row(c: &Constants, before: &[f32], ray_x: &[f32], (column, row, after): Rows<'_>) {
    /// Rounds down what is at least -1, and makes -1 of the rest.
    #[inline(always)]
    fn whole(value: f32) -> i32 {
        // Truncation rounds down what is above 0. Not-a-number becomes -1.
        let shifted = if value > -1.0 { value } else { -1.0 };
        let shifted = if shifted < 1e6 { shifted + 1.0 } else { 0.0 };
        // SAFETY: 0 to 1e6 + 1 fits.
        unsafe { shifted.to_int_unchecked::<i32>() - 1 }
    }
    let length = ray_x.len();
    let (before, column) = (&before[..length], &mut column[..length]);
    let (row, after) = (&mut row[..length], &mut after[..length]);
    for i in 0..length {
        let (z, x) = (before[i], ray_x[i]);
        let px = z * (c.a[0] + x * c.b[0]) + c.t[0];
        let py = z * (c.a[1] + x * c.b[1]) + c.t[1];
        let pz = z * (c.a[2] + x * c.b[2]) + c.t[2];
        let inverse = 1.0 / pz;
        column[i] = whole(c.focal[0] * px * inverse + c.centre[0]);
        row[i] = whole(c.focal[1] * py * inverse + c.centre[1]);
        after[i] = pz;
    }
}

/// Puts the first `length` points of a row into the z-buffer.
pub(super) fn splat(
    points: &RowMotion,
    length: usize,
    (width, height): (usize, usize),
    buffer: &mut [f32],
    touched: &mut Touched,
) {
    let (width, height) = (width as u32, height as u32);
    let places = points.column.iter().zip(&points.row).zip(&points.after);
    for ((&column, &row), &after) in places.take(length) {
        // A negative number is a large one.
        if column as u32 >= width || row as u32 >= height || !(after > 0.0) {
            continue;
        }
        touched.first = touched.first.min(row);
        touched.last = touched.last.max(row);
        let index = row as usize * width as usize + column as usize;
        if let Some(place) = buffer.get_mut(index) {
            *place = place.min(after);
        }
    }
}

/// Writes the z-buffer, infinite where empty, as a depth map: cracks closed, the
/// rest of the empty pixels unknown. Only `rows` hold points.
///
/// Across, down and across again, for cracks cross and step. The buffer is used
/// up; `scratch` is as large.
pub(super) fn close_cracks(
    buffer: &mut [f32],
    scratch: &mut [f32],
    width: usize,
    rows: std::ops::Range<usize>,
    out: &mut [f32],
) {
    let places = |rows: std::ops::Range<usize>| rows.start * width..rows.end * width;
    let height = buffer.len() / width;
    for outside in [0..rows.start, rows.end..height] {
        if let Some(part) = out.get_mut(places(outside)) {
            part.fill(DepthMap::UNKNOWN);
        }
    }
    let Some(out) = out.get_mut(places(rows.clone())) else { return };
    let near = rows.start.saturating_sub(1)..(rows.end + 1).min(height);
    if let (Some(from), Some(to)) =
        (buffer.get(places(near.clone())), scratch.get_mut(places(near)))
    {
        for (from, to) in from.chunks_exact(width).zip(to.chunks_exact_mut(width)) {
            close_across(from, to);
        }
    }
    for (y, out) in rows.zip(out.chunks_exact_mut(width)) {
        let row = |y: usize| scratch.get(y * width..(y + 1) * width).unwrap_or(&[]);
        // At the border a row is its own neighbour: no crack there.
        let (above, below) = (row(y.saturating_sub(1)), row((y + 1).min(height - 1)));
        if let Some(down) = buffer.get_mut(y * width..(y + 1) * width) {
            close_down(row(y), above, below, down);
            close_across(down, out);
            for depth in out {
                *depth = if *depth < f32::INFINITY { *depth } else { DepthMap::UNKNOWN };
            }
        }
    }
}

fn close_across(row: &[f32], out: &mut [f32]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { across_avx2(row, out) };
    }
    across(row, out);
}

fn close_down(row: &[f32], above: &[f32], below: &[f32], out: &mut [f32]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { down_avx2(row, above, below, out) };
    }
    down(row, above, below, out);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn across_avx2(row: &[f32], out: &mut [f32]) {
    across(row, out);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn down_avx2(row: &[f32], above: &[f32], below: &[f32], out: &mut [f32]) {
    down(row, above, below, out);
}

#[inline(always)]
fn across(row: &[f32], out: &mut [f32]) {
    let width = row.len();
    let out = &mut out[..width];
    if let (Some(first), Some(last)) = (row.first(), row.last()) {
        (out[0], out[width - 1]) = (*first, *last);
    }
    for x in 1..width.saturating_sub(1) {
        out[x] = closed(row[x], row[x - 1], row[x + 1]);
    }
}

#[inline(always)]
fn down(row: &[f32], above: &[f32], below: &[f32], out: &mut [f32]) {
    let width = row.len();
    let (above, below, out) = (&above[..width], &below[..width], &mut out[..width]);
    for x in 0..width {
        out[x] = closed(row[x], above[x], below[x]);
    }
}

/// The depth between `a` and `b` if `depth` is a crack between them.
#[inline(always)]
fn closed(depth: f32, a: f32, b: f32) -> f32 {
    let (near, far) = (if a < b { a } else { b }, if a < b { b } else { a });
    // Infinite `far` fails the second test, for nothing is beyond it.
    let crack = (far <= near * AGREE) & (depth > far * AGREE);
    if crack { 0.5 * (a + b) } else { depth }
}
