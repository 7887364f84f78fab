//! A textured square before a textured wall, as a follower behind it sees them: drawn
//! pictures, their depth, and the square's box.
#![allow(dead_code, clippy::unwrap_used, reason = "each test uses its part")]

#[path = "../../../realnet-range/tests/scene/mod.rs"]
mod scene;

use realnet_core::nalgebra::{Vector3, Vector6};
use realnet_core::{BoundingBox, CameraModel, DepthMap, Detection, Frame, Pose, Stamp};
use realnet_pipeline::CameraMount;
use scene::{Scene, sized};

/// Pictures of a short way ahead and back again, so that they can be repeated.
pub struct Pictures {
    pub camera: CameraModel,
    shots: Vec<(Frame, DepthMap, BoundingBox)>,
}

impl Pictures {
    /// So many pictures at 30 a second in the course of which the camera moves at 0.4 m/s and
    /// turns a little, the square 1.2 m ahead of it and its foot on the ground.
    pub fn new(size: (u32, u32), pictures: usize) -> Self {
        const HALF: f64 = 0.12;
        let camera = sized(size.0, size.1);
        let scene = Scene::new(camera).with_target(HALF);
        let foot = CameraMount::default().height_m;
        let shot = |index: usize| {
            let t = index as f64 / 30.0;
            let camera_from_world =
                Pose::exp(&(Vector6::new(0.0, 0.0, 0.4, 0.0, 0.04, 0.0) * t)).inverse();
            let away = Vector3::new(-0.05 + 0.02 * t, foot - HALF, 1.2 + 0.1 * t + 0.4 * t);
            let camera_from_target = camera_from_world * Pose::from_translation(away);
            let (frame, depth) = scene.draw(Stamp::ZERO, &camera_from_world, &camera_from_target);
            (frame.to_rgb(), depth, scene.gate(&camera_from_target).bbox)
        };
        Self { camera, shots: (0..pictures).map(shot).collect() }
    }

    /// Picture, depth and box at a place in the endless way to and fro.
    pub fn at(&self, index: u64) -> &(Frame, DepthMap, BoundingBox) {
        let last = self.shots.len() as u64 - 1;
        let place = index % (2 * last);
        &self.shots[place.min(2 * last - place) as usize]
    }

    /// What a detector says of the square there, and of something at the picture's edge.
    pub fn detections(&self, index: u64) -> [Detection; 2] {
        let of = |bbox, confidence| Detection { class_id: 0, confidence, bbox };
        [of(BoundingBox::new(2.0, 3.0, 20.0, 14.0), 0.4), of(self.at(index).2, 0.9)]
    }
}
