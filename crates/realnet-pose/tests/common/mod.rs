//! Random problems with known answers.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use realnet_core::Pose;
use realnet_core::nalgebra::{Point3, Vector3, Vector6};
use realnet_pose::{Correspondences, PnpError};

pub const FOCAL: [f64; 2] = [500.0, 520.0];

/// SplitMix64.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    pub fn below(&mut self, bound: usize) -> usize {
        (self.bits() % bound as u64) as usize
    }

    pub fn gauss(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }

    pub fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.between(-size, size))
    }

    pub fn pose(&mut self) -> Pose {
        let (v, w) = (self.vector(5.0), self.vector(1.8));
        Pose::exp(&Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z))
    }

    /// A ray in the picture.
    pub fn ray(&mut self) -> [f64; 2] {
        [self.between(-0.64, 0.64), self.between(-0.48, 0.48)]
    }

    /// A point in view, in the camera's frame.
    pub fn in_view(&mut self, near: f64, far: f64) -> Vector3<f64> {
        let ([x, y], z) = (self.ray(), self.between(near, far));
        Vector3::new(x * z, y * z, z)
    }
}

/// Points in the world, rays, and the pose that made them.
pub struct Problem {
    pub points: Vec<Point3<f64>>,
    pub rays: Vec<[f64; 2]>,
    pub truth: Pose,
}

impl Problem {
    pub fn new(truth: Pose) -> Self {
        Self { points: Vec::new(), rays: Vec::new(), truth }
    }

    /// Adds a point given in the camera's frame, seen with noise in pixels.
    pub fn see(&mut self, random: &mut Random, seen: Vector3<f64>, noise: f64) {
        self.points.push(self.truth.inverse() * Point3::from(seen));
        self.rays.push([
            seen.x / seen.z + noise * random.gauss() / FOCAL[0],
            seen.y / seen.z + noise * random.gauss() / FOCAL[1],
        ]);
    }

    /// Replaces the rays of a share of the points by others.
    pub fn spoil(&mut self, random: &mut Random, share: f64) {
        for ray in &mut self.rays {
            if random.unit() < share {
                *ray = random.ray();
            }
        }
    }

    /// A well-posed one.
    pub fn good(random: &mut Random, count: usize, noise: f64) -> Self {
        let mut problem = Self::new(random.pose());
        for _ in 0..count {
            let seen = random.in_view(2.0, 10.0);
            problem.see(random, seen, noise);
        }
        problem
    }

    pub fn correspondences(&self) -> Result<Correspondences<'_>, PnpError> {
        Correspondences::new(&self.points, &self.rays, FOCAL)
    }
}

/// Rotation in radians and translation in metres between two poses.
pub fn apart(a: &Pose, b: &Pose) -> (f64, f64) {
    let between = *a * b.inverse();
    (between.rotation_angle(), between.translation_norm())
}
