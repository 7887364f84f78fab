//! A textured wall and a textured square before it, drawn by casting rays.
#![allow(dead_code, reason = "not every test uses all of it")]

pub mod drive;

use realnet_core::nalgebra::{Point3, Vector3};
use realnet_core::{
    BoundingBox, CameraModel, DepthMap, Distortion, Frame, Intrinsics, Pose, Stamp,
};
use realnet_range::cues::ForegroundGate;

pub fn camera() -> CameraModel {
    sized(320, 240)
}

pub fn sized(width: u32, height: u32) -> CameraModel {
    let focal = 0.9 * f64::from(width);
    let (cx, cy) = (f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0);
    let intrinsics = Intrinsics { fx: focal, fy: focal, cx, cy };
    CameraModel::new(width, height, intrinsics, Distortion::None).unwrap()
}

/// The wall is the plane `z = 4 + 0.1 x - 0.2 y` of the world, the square has
/// sides of 0.6 m in the plane `z = 0` of the target.
pub struct Scene {
    camera: CameraModel,
    half: f64,
}

impl Default for Scene {
    fn default() -> Self {
        Self::new(camera())
    }
}

impl Scene {
    pub fn new(camera: CameraModel) -> Self {
        Self { camera, half: 0.3 }
    }

    /// With a square of another size, half its side in metres.
    pub fn with_target(self, half: f64) -> Self {
        Self { half, ..self }
    }

    /// Picture and depth.
    pub fn draw(
        &self,
        stamp: Stamp,
        camera_from_world: &Pose,
        camera_from_target: &Pose,
    ) -> (Frame, DepthMap) {
        let (width, height) = (self.camera.width(), self.camera.height());
        let (mut grey, mut depth) = (Vec::new(), Vec::new());
        let world_from_camera = camera_from_world.inverse();
        let target_from_camera = camera_from_target.inverse();
        // Detail that grows with the picture.
        let detail = f64::from(width) / 320.0;
        for y in 0..height {
            for x in 0..width {
                let ray = self.camera.unproject([f64::from(x), f64::from(y)]).unwrap();
                let ray = Vector3::new(ray[0], ray[1], 1.0);
                let normal = Vector3::new(-0.1, 0.2, 1.0);
                let (wall, z) = meet(&world_from_camera, &ray, &normal, 4.0);
                let mut pixel = (texture(wall.x * detail, wall.y * detail, 11), z);
                let (at, near) = meet(&target_from_camera, &ray, &Vector3::z(), 0.0);
                let inside = at.x.abs() < self.half && at.y.abs() < self.half;
                if inside && near > 0.0 && !(near > z && z > 0.0) {
                    pixel = (texture(at.x * 2.0 * detail, at.y * 2.0 * detail, 77), near);
                }
                let (value, z) = pixel;
                grey.push(if z > 0.0 { value } else { 0 });
                depth.push(if z > 0.0 { z as f32 } else { 0.0 });
            }
        }
        let frame = Frame::grey8(stamp, width, height, grey).unwrap();
        (frame, DepthMap::new(stamp, width, height, depth).unwrap())
    }

    /// Where the square is.
    pub fn gate(&self, camera_from_target: &Pose) -> ForegroundGate {
        let h = self.half;
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for (x, y) in [(-h, -h), (h, -h), (-h, h), (h, h)] {
            let corner = *camera_from_target * Point3::new(x, y, 0.0);
            let pixel = self.camera.project(&corner).unwrap();
            for i in 0..2 {
                // Box edges count from the edge of the picture.
                low[i] = low[i].min(pixel[i] as f32 + 0.5);
                high[i] = high[i].max(pixel[i] as f32 + 0.5);
            }
        }
        let z = camera_from_target.translation().z as f32;
        let bbox = BoundingBox::new(low[0], low[1], high[0], high[1]);
        ForegroundGate::new(bbox, z - 0.15, z + 0.15)
    }
}

/// Where a ray of the camera meets the plane `normal * p = offset` of a body, in
/// the body's coordinates, and its depth.
fn meet(
    body_from_camera: &Pose,
    ray: &Vector3<f64>,
    normal: &Vector3<f64>,
    offset: f64,
) -> (Point3<f64>, f64) {
    let origin = body_from_camera.translation();
    let direction = body_from_camera.rotation() * ray;
    let z = (offset - normal.dot(&origin)) / normal.dot(&direction);
    (Point3::from(origin + direction * z), z)
}

/// Smooth noise on three scales, 20 to 235.
fn texture(x: f64, y: f64, seed: u32) -> u8 {
    let octaves = [(3.0, 0.35), (9.0, 0.35), (23.0, 0.3)];
    let sum: f64 = octaves.iter().map(|(f, a)| a * noise(x * f, y * f, seed)).sum();
    (20.0 + 215.0 * sum) as u8
}

/// Values of a grid, 0 to 1, joined smoothly.
fn noise(x: f64, y: f64, seed: u32) -> f64 {
    let (column, row) = (x.floor(), y.floor());
    let ease = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (ease(x - column), ease(y - row));
    let value = |dx: f64, dy: f64| {
        let (i, j) = ((column + dx) as i64 as u32, (row + dy) as i64 as u32);
        let mut h = i.wrapping_mul(0x9E37_79B1) ^ j.wrapping_mul(0x85EB_CA77) ^ seed;
        h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
        h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
        f64::from(h ^ (h >> 15)) / f64::from(u32::MAX)
    };
    let upper = value(0.0, 0.0) * (1.0 - u) + value(1.0, 0.0) * u;
    let lower = value(0.0, 1.0) * (1.0 - u) + value(1.0, 1.0) * u;
    upper * (1.0 - v) + lower * v
}
