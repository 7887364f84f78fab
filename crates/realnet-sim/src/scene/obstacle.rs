//! Footprints of what stands on the floor.

use super::mover::Path;
use realnet_core::nalgebra::Vector2;

/// A rectangle along the world's axes, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least x and y.
    pub min: Vector2<f64>,
    /// Greatest x and y.
    pub max: Vector2<f64>,
}

impl Bounds {
    /// Distance of a point from the nearest side, positive inside.
    #[must_use]
    pub fn depth_of(&self, point: &Vector2<f64>) -> f64 {
        let (low, high) = (point - self.min, self.max - point);
        low.x.min(low.y).min(high.x).min(high.y)
    }

    /// Its size along x and y.
    #[must_use]
    pub fn size(&self) -> Vector2<f64> {
        self.max - self.min
    }
}

/// A thing on the floor: its footprint, convex, and whether it moves.
#[derive(Clone, Debug)]
pub struct Obstacle {
    /// Corners around its own origin, counter-clockwise.
    pub(super) corners: Vec<Vector2<f64>>,
    /// How it moves; a thing that stands has its corners in the world.
    pub(super) path: Option<Path>,
    pub(super) height: f64,
}

impl Obstacle {
    /// Height above the floor, metres.
    #[must_use]
    pub fn height(&self) -> f64 {
        self.height
    }

    /// Whether it moves.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.path.is_some()
    }

    /// Corners of the footprint in the world at a time, counter-clockwise.
    pub fn footprint(&self, time_s: f64) -> impl ExactSizeIterator<Item = Vector2<f64>> + '_ {
        let pose = self.path.as_ref().map(|path| path.ground_pose(time_s)).unwrap_or_default();
        self.corners.iter().map(move |corner| pose.transform_point(corner))
    }
}
