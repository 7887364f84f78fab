//! Worlds to drive in: rooms, halls, corridors and tracks, furnished by seed.

mod build;
mod furniture;
pub(crate) mod mesh;
mod mover;
mod obstacle;
mod spec;
pub(crate) mod vehicle;

pub use obstacle::{Bounds, Obstacle};
pub use spec::{LightChange, SceneKind, SceneSpec, TextureLevel};

pub(crate) use mesh::Mesh;
pub(crate) use mover::{Mover, pose3};

use realnet_core::nalgebra::Point3;

/// A world that stands: its surfaces, its light and what moves in it by itself.
/// Vehicles are not part of it.
#[derive(Clone, Debug)]
pub struct Scene {
    pub(crate) spec: SceneSpec,
    /// Everything that stands, in the world frame.
    pub(crate) solid: Mesh,
    pub(crate) movers: Vec<Mover>,
    pub(crate) light: Light,
    pub(crate) obstacles: Vec<Obstacle>,
    pub(crate) bounds: Option<Bounds>,
}

/// Where light comes from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Light {
    /// The lamp, or the sun far away.
    pub(crate) lamp: Point3<f64>,
    /// Light of the lamp on a surface that faces it at `reach` metres.
    pub(crate) strength: f64,
    /// Where the lamp has its strength, metres.
    pub(crate) reach: f64,
    /// Light from everywhere.
    pub(crate) ambient: f64,
    /// Colour of the light.
    pub(crate) tint: [f32; 3],
    /// How soft shadows are, metres.
    pub(crate) softness: f64,
    /// Colours of the sky at the horizon and at the top, if there is a sky.
    pub(crate) sky: Option<[mesh::Colour; 2]>,
}

impl Scene {
    /// Builds the world of `spec`; the same spec and seed give the same world.
    #[must_use]
    pub fn build(spec: &SceneSpec, seed: u64) -> Self {
        build::build(spec, seed)
    }

    /// What it was built from.
    #[must_use]
    pub fn spec(&self) -> &SceneSpec {
        &self.spec
    }

    /// What stands or moves on the floor, for tests of collision: walls are not
    /// among them, see [`Scene::bounds`].
    #[must_use]
    pub fn obstacles(&self) -> &[Obstacle] {
        &self.obstacles
    }

    /// The rectangle inside the walls; `None` in the open.
    #[must_use]
    pub fn bounds(&self) -> Option<Bounds> {
        self.bounds
    }

    /// Brightness of all light at a time, 1 is a well-lit room or a bright day.
    #[must_use]
    pub fn brightness(&self, time_s: f64) -> f64 {
        let changes = self.spec.light_changes.iter().filter(|change| change.time_s <= time_s);
        let factor = changes.max_by(|a, b| a.time_s.total_cmp(&b.time_s)).map_or(1.0, |c| c.factor);
        (self.spec.light * factor).max(0.0)
    }
}

#[cfg(test)]
mod tests;
