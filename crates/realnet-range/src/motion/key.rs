//! Corners on the frame of a depth map, lifted to points.

use crate::cues::{ForegroundGate, Side};
use crate::motion::body::Body;
use crate::motion::{KeySummary, MotionError, MotionOptions};
use realnet_core::{CameraModel, DepthMap};
use realnet_vision::{Corner, CornerDetector, CornerMask, Pyramid, Region};

/// Corners of the background that make those behind the target dispensable.
const ENOUGH: usize = 30;
/// Depths known among the 3 x 3 pixels around a corner, at least.
const LEAST_KNOWN: usize = 5;

/// Finds corners and their depths.
#[derive(Clone, Debug)]
pub(super) struct KeyFinder {
    background: CornerDetector,
    target: CornerDetector,
    mask: CornerMask,
    corners: Vec<Corner>,
    max_depth_step: f32,
    /// Half the sides of the window that flow compares: as far as a body disturbs
    /// the flow of another.
    reach: (u32, u32),
}

impl KeyFinder {
    pub(super) fn new(camera: &CameraModel, options: &MotionOptions) -> Result<Self, MotionError> {
        let (width, height) = options.flow.window.size();
        Ok(Self {
            background: CornerDetector::new(options.background)?,
            target: CornerDetector::new(options.target)?,
            mask: CornerMask::new(camera.width(), camera.height(), true),
            corners: Vec::new(),
            max_depth_step: options.max_depth_step,
            reach: (width as u32 / 2, height as u32 / 2),
        })
    }

    /// Fills the two bodies with the corners of `picture`.
    pub(super) fn find(
        &mut self,
        picture: &Pyramid,
        camera: &CameraModel,
        depth: &DepthMap,
        gate: Option<&ForegroundGate>,
        background: &mut Body,
        target: &mut Body,
    ) -> Result<KeySummary, MotionError> {
        background.clear();
        target.clear();
        let scale = [
            f64::from(depth.width()) / f64::from(camera.width()),
            f64::from(depth.height()) / f64::from(camera.height()),
        ];
        let mut dropped = 0;
        let max_depth_step = self.max_depth_step;
        let mut corners = std::mem::take(&mut self.corners);
        let region = gate.map(|gate| box_region(gate, scale));
        self.mask.fill(true);
        if let Some(region) = region {
            // Near the target the flow of the background is disturbed.
            self.mask.set(grown(region, self.reach), false);
        }
        let found = self.background.detect(picture, Some(&self.mask), &mut corners);
        let mut lift =
            |corners: &[Corner], inside: bool, background: &mut Body, target: &mut Body| {
                let scarce = background.len() < ENOUGH;
                for corner in corners {
                    let place = depth_place(corner.point, scale);
                    let Some(z) = depth_at(depth, place, max_depth_step) else {
                        dropped += 1;
                        continue;
                    };
                    let side = gate.map_or(Side::Background, |gate| gate.class_of(place, z));
                    let body = match side {
                        Side::Target => &mut *target,
                        Side::Background if !inside || scarce => &mut *background,
                        _ => {
                            dropped += 1;
                            continue;
                        }
                    };
                    let pixel = corner.point.map(f64::from);
                    match camera.unproject_at_depth(pixel, f64::from(z)) {
                        Ok(point) => body.add(corner.point, point),
                        Err(_) => dropped += 1,
                    }
                }
            };
        let mut answer = found.map(|()| lift(&corners, false, background, target));
        if let (Ok(()), Some(region)) = (&answer, region) {
            self.mask.fill(false);
            self.mask.set(region, true);
            answer = self.target.detect(picture, Some(&self.mask), &mut corners);
            if answer.is_ok() {
                lift(&corners, true, background, target);
            }
        }
        self.corners = corners;
        answer?;
        Ok(KeySummary { background: background.len(), target: target.len(), dropped })
    }
}

/// Depths that a camera can see, metres; what networks say beyond is no depth.
const PLAUSIBLE_M: std::ops::Range<f32> = 0.01..1e4;

/// Mean depth of the 3 x 3 pixels around `place`, if they lie on one surface: if
/// their depths are within the share `max_step` of each other.
fn depth_at(depth: &DepthMap, [x, y]: [f32; 2], max_step: f32) -> Option<f32> {
    let (column, row) = (x.round(), y.round());
    if !(column >= 0.0 && row >= 0.0) {
        return None;
    }
    let (column, row) = (column as usize, row as u32);
    let (mut sum, mut count) = (0.0, 0_usize);
    let (mut near, mut far) = (f32::INFINITY, 0.0_f32);
    for y in row.saturating_sub(1)..=row.saturating_add(1) {
        let line = depth.row(y);
        let end = (column + 2).min(line.len());
        for &z in line.get(column.saturating_sub(1).min(end)..end).unwrap_or(&[]) {
            if DepthMap::is_known(z) {
                (sum, count) = (sum + z, count + 1);
                (near, far) = (near.min(z), far.max(z));
            }
        }
    }
    let even = far <= near * (1.0 + max_step);
    let mean = (count >= LEAST_KNOWN && even).then(|| sum / count as f32);
    mean.filter(|z| PLAUSIBLE_M.contains(z))
}

/// The place of a pixel of the picture in the depth map, both from the centre of
/// the first pixel.
fn depth_place(point: [f32; 2], scale: [f64; 2]) -> [f32; 2] {
    [0, 1].map(|i| ((f64::from(point[i]) + 0.5) * scale[i] - 0.5) as f32)
}

/// The box of a gate in pixels of the picture.
fn box_region(gate: &ForegroundGate, scale: [f64; 2]) -> Region {
    let b = gate.bbox;
    let start = |v: f32, scale: f64| (f64::from(v) / scale).floor().max(0.0) as u32;
    let end = |v: f32, scale: f64| (f64::from(v) / scale).ceil().max(0.0) as u32;
    let (x, y) = (start(b.x0, scale[0]), start(b.y0, scale[1]));
    let (width, height) =
        (end(b.x1, scale[0]).saturating_sub(x), end(b.y1, scale[1]).saturating_sub(y));
    Region { x, y, width, height }
}

/// A region with a margin all around.
fn grown(region: Region, (x, y): (u32, u32)) -> Region {
    let (left, top) = (region.x.min(x), region.y.min(y));
    Region {
        x: region.x - left,
        y: region.y - top,
        width: region.width.saturating_add(left).saturating_add(x),
        height: region.height.saturating_add(top).saturating_add(y),
    }
}
