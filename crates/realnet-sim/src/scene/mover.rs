//! Things that move by themselves, by a formula of time.

use super::Mesh;
use super::mesh::{Hexa, Skin, p, srgb};
use crate::render::Texture;
use realnet_core::nalgebra::{UnitQuaternion, Vector2, Vector3};
use realnet_core::{Pose, Pose2};
use std::f64::consts::TAU;

/// To and fro between two places, softly: a cosine of time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Path {
    pub(crate) from: [f64; 2],
    pub(crate) to: [f64; 2],
    /// Seconds there and back.
    pub(crate) period: f64,
    /// Part of the period at time 0, 0 to 1.
    pub(crate) phase: f64,
}

impl Path {
    /// Metres from `from`, and whether it is on the way to `to`.
    fn travelled(&self, time: f64) -> (f64, bool) {
        let part = (time / self.period + self.phase).rem_euclid(1.0);
        let length = Vector2::from(self.to) - Vector2::from(self.from);
        (length.norm() * 0.5 * (1.0 - (TAU * part).cos()), part < 0.5)
    }

    fn direction(&self) -> Vector2<f64> {
        (Vector2::from(self.to) - Vector2::from(self.from)).normalize()
    }

    /// Where it is; its x axis looks from `from` to `to` all the time.
    pub(crate) fn ground_pose(&self, time: f64) -> Pose2 {
        let at = Vector2::from(self.from) + self.direction() * self.travelled(time).0;
        let direction = self.direction();
        Pose2::new(at.x, at.y, direction.y.atan2(direction.x))
    }
}

/// What a moving thing is.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Gait {
    /// Rolls on the floor about its middle.
    Roll {
        /// Metres.
        radius: f64,
    },
    /// Walks on two legs, the parts 1 and 2 of the mesh list.
    Walk,
    /// A box that turns to and fro as it goes.
    Swing,
}

/// A thing that moves: parts, each with a pose in the thing's frame.
#[derive(Clone, Debug)]
pub(crate) struct Mover {
    pub(crate) path: Path,
    pub(crate) gait: Gait,
    pub(crate) parts: Vec<Mesh>,
}

impl Mover {
    /// The world pose of part `index` at a time.
    pub(crate) fn pose(&self, index: usize, time: f64) -> Pose {
        let ground = self.path.ground_pose(time);
        let world_from_thing = pose3(&ground);
        let (travelled, _) = self.path.travelled(time);
        let own = match self.gait {
            Gait::Roll { radius } => {
                let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), travelled / radius);
                Pose::new(turn, Vector3::new(0.0, 0.0, radius))
            }
            Gait::Walk if index == 0 => Pose::identity(),
            Gait::Walk => {
                let side = if index == 1 { 1.0 } else { -1.0 };
                let swing = side * 0.45 * (travelled * TAU / 1.3).sin();
                let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), swing);
                Pose::new(turn, Vector3::new(0.0, 0.09 * side, HIP))
            }
            Gait::Swing => {
                let turn = 0.6 * (TAU * time / self.path.period).sin();
                Pose::from_rotation(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn))
            }
        };
        world_from_thing * own
    }
}

/// Height of the hips, metres.
const HIP: f64 = 0.85;

/// A pose of the plane in three dimensions.
pub(crate) fn pose3(pose: &Pose2) -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pose.heading);
    Pose::new(turn, Vector3::new(pose.x, pose.y, 0.0))
}

/// A ball with flat facets, around the origin.
pub(crate) fn ball(radius: f64, skin: Skin, other: Skin) -> Mesh {
    const AROUND: usize = 12;
    const UP: usize = 6;
    let at = |i: usize, j: usize| {
        let (a, b) = (TAU * i as f64 / AROUND as f64, 0.5 * TAU * (j as f64 / UP as f64 - 0.5));
        p(radius * a.cos() * b.cos(), radius * b.sin(), radius * a.sin() * b.cos())
    };
    let mut mesh = Mesh::default();
    for j in 0..UP {
        for i in 0..AROUND {
            let skin = if (i / 2 + j / 2) % 2 == 0 { skin } else { other };
            let quad = [at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)];
            if j == 0 {
                mesh.polygon(&[quad[0], quad[1], quad[2]], skin);
            } else if j == UP - 1 {
                mesh.polygon(&[quad[0], quad[1], quad[3]], skin);
            } else {
                mesh.polygon(&quad, skin);
            }
        }
    }
    mesh.hulls.push((0..AROUND).flat_map(|i| [at(i, 2), at(i, 4)]).collect());
    mesh
}

/// A person: body, then two legs that hang from the hips.
pub(crate) fn person(shirt: Skin, trousers: Skin) -> Vec<Mesh> {
    let face = Skin::new(Texture::Concrete, srgb(0x8a5a44), srgb(0xe0b090), 500.0);
    let mut body = Mesh::default();
    body.block([0.0, 0.0], [0.11, 0.19], [HIP - 0.03, 1.45], 0.0, &Hexa::all(shirt));
    body.block([0.0, 0.24], [0.05, 0.05], [0.85, 1.40], 0.0, &Hexa::all(shirt));
    body.block([0.0, -0.24], [0.05, 0.05], [0.85, 1.40], 0.0, &Hexa::all(shirt));
    body.frustum([0.0, 0.0], [0.09, 0.10], [1.48, 1.72], 10, face, face);
    let mut leg = Mesh::default();
    leg.block([0.0, 0.0], [0.07, 0.065], [-HIP + 0.06, 0.0], 0.0, &Hexa::all(trousers));
    let shoe = Skin::plain(srgb(0x202020));
    leg.block([0.04, 0.0], [0.13, 0.05], [-HIP, -HIP + 0.07], 0.0, &Hexa::all(shoe));
    vec![body, leg.clone(), leg]
}
