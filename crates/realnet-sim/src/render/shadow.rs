//! Shadows on the ground: convex shapes with soft edges.

use super::canvas::Span2;
use super::surface::ray_bounds;
use crate::scene::Light;
use crate::scene::mesh::MAX_EDGES;
use realnet_core::Pose;
use realnet_core::nalgebra::{Point3, Vector2, Vector3};

/// Distances from the edges, metres, as linear functions of a ray over inverse depth;
/// positive inside.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shadow {
    pub(super) edges: [[f32; 3]; MAX_EDGES],
    pub(super) edge_count: usize,
    /// One over the width of the soft edge, 1/m.
    pub(super) sharpness: f32,
    /// Darkness in the middle: of the lamp's light, and of light from everywhere.
    pub(super) cast: f32,
    pub(super) contact: f32,
}

/// Outlines of points on the ground; buffers are used again.
#[derive(Clone, Debug, Default)]
pub(super) struct Outline {
    points: Vec<Vector2<f64>>,
    hull: Vec<Vector2<f64>>,
}

impl Outline {
    /// The shadow that the lamp throws from a convex body, world coordinates.
    pub(super) fn cast(
        &mut self,
        light: &Light,
        corners: impl Iterator<Item = Point3<f64>>,
        camera_from_world: &Pose,
    ) -> Option<(Shadow, Span2)> {
        let lamp = light.lamp;
        self.points.clear();
        for corner in corners {
            // What reaches the lamp throws its shadow very far.
            let drop = (lamp.z - corner.z).max(0.05);
            let share = (lamp.z / drop).min(40.0);
            self.points.push(lamp.xy().coords + (corner - lamp).xy() * share);
        }
        self.shadow(camera_from_world, light.softness, 0.92, 0.0)
    }

    /// The darkness under a body that stands on the ground.
    pub(super) fn contact(
        &mut self,
        corners: impl Iterator<Item = Vector2<f64>>,
        camera_from_world: &Pose,
        softness: f64,
    ) -> Option<(Shadow, Span2)> {
        self.points.clear();
        self.points.extend(corners);
        self.shadow(camera_from_world, softness, 0.0, 0.75)
    }

    fn shadow(
        &mut self,
        camera_from_world: &Pose,
        softness: f64,
        cast: f32,
        contact: f32,
    ) -> Option<(Shadow, Span2)> {
        self.convex_hull();
        self.thin_out();
        let hull = &self.hull;
        if hull.len() < 3 {
            return None;
        }
        let up = camera_from_world.transform_vector(&Vector3::z());
        let ground = camera_from_world.transform_point(&Point3::origin());
        // On the ground 1 = plane . point.
        let plane = up / up.dot(&ground.coords);
        let mut edges = [[0.0; 3]; MAX_EDGES];
        for (i, (edge, a)) in edges.iter_mut().zip(hull).enumerate() {
            let along = (hull[(i + 1) % hull.len()] - a).normalize();
            let inward = camera_from_world.transform_vector(&Vector3::new(-along.y, along.x, 0.0));
            let on = camera_from_world.transform_point(&Point3::new(a.x, a.y, 0.0));
            let form = inward - plane * inward.dot(&on.coords);
            *edge = [form.x as f32, form.y as f32, form.z as f32];
        }
        let middle = hull.iter().sum::<Vector2<f64>>() / hull.len() as f64;
        let grown = hull.iter().map(|q| {
            let out = (q - middle).try_normalize(1e-9).unwrap_or_else(Vector2::zeros);
            let q = q + out * (1.5 * softness);
            camera_from_world.transform_point(&Point3::new(q.x, q.y, 0.0))
        });
        let bounds = ray_bounds(grown)?;
        let (edge_count, sharpness) = (hull.len(), (1.0 / softness.max(1e-3)) as f32);
        Some((Shadow { edges, edge_count, sharpness, cast, contact }, bounds))
    }

    /// Andrew's monotone chain, counter-clockwise.
    fn convex_hull(&mut self) {
        let Self { points, hull } = self;
        points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        hull.clear();
        let left_turn = |hull: &[Vector2<f64>], q: &Vector2<f64>| {
            let [.., a, b] = hull else { return true };
            (b - a).perp(&(q - a)) > 1e-9
        };
        for q in points.iter() {
            while hull.len() > 1 && !left_turn(hull, q) {
                hull.pop();
            }
            hull.push(*q);
        }
        let lower = hull.len();
        for q in points.iter().rev().skip(1) {
            while hull.len() > lower && !left_turn(hull, q) {
                hull.pop();
            }
            hull.push(*q);
        }
        hull.pop();
    }

    /// Drops the flattest corners until there are as few as a shape may have.
    fn thin_out(&mut self) {
        let hull = &mut self.hull;
        while hull.len() > MAX_EDGES {
            let n = hull.len();
            let area = |i: usize| {
                let (a, b, c) = (hull[(i + n - 1) % n], hull[i], hull[(i + 1) % n]);
                (b - a).perp(&(c - a))
            };
            let flattest = (0..n).min_by(|&i, &j| area(i).total_cmp(&area(j))).unwrap_or(0);
            hull.remove(flattest);
        }
    }
}
