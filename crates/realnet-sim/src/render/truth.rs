//! Finding what is really in a picture.

use super::canvas::{TILE_H, TILE_W};
use super::rendered::{Rendered, Truth};
use super::renderer::{Renderer, Shot};
use super::shade::mark_tile;
use realnet_core::nalgebra::Point3;
use realnet_core::{BoundingBox, DepthMap};

/// What is known of an actor while its pixels are counted.
#[derive(Clone, Copy)]
struct Count {
    pixels: usize,
    x: [usize; 2],
    y: [usize; 2],
}

impl Renderer {
    /// Writes depth, mask and truths from the canvas, whose surfaces are those of the
    /// middle of the exposure.
    pub(super) fn write_truth(&mut self, shot: &Shot<'_>, out: &mut Rendered) {
        let (width, stride) = (self.rays.width, self.rays.stride);
        let depth = out.depth.data_mut().chunks_exact_mut(width);
        let rows = depth.zip(out.mask.chunks_exact_mut(width));
        let from =
            self.canvas.inverse.chunks_exact(stride).zip(self.canvas.id.chunks_exact(stride));
        for ((depth, mask), (inverse, ids)) in rows.zip(from) {
            for (depth, inverse) in depth.iter_mut().zip(inverse) {
                *depth = if *inverse > 0.0 { 1.0 / inverse } else { DepthMap::UNKNOWN };
            }
            for (mask, id) in mask.iter_mut().zip(ids) {
                *mask = (id >> 16) as u8;
            }
        }
        out.truths.clear();
        for index in 0..shot.actors.len() {
            let truth = self.truth_of(shot, index, out);
            out.truths.push(truth);
        }
    }

    fn truth_of(&mut self, shot: &Shot<'_>, index: usize, out: &Rendered) -> Option<Truth> {
        let instance = u8::try_from(index + 1).ok().filter(|&i| i != u8::MAX)?;
        let (width, height) = (self.rays.width, self.rays.height);
        let silhouette = self.silhouette(instance);
        let mut count = Count { pixels: 0, x: [width, 0], y: [height, 0] };
        self.scratch.clear();
        if silhouette.pixels == 0 {
            return None;
        }
        for y in silhouette.y[0]..=silhouette.y[1] {
            let row = y * width + silhouette.x[0]..y * width + silhouette.x[1] + 1;
            let (mask, depth) = (out.mask.get(row.clone())?, out.depth.data().get(row)?);
            for (i, (mask, depth)) in mask.iter().zip(depth).enumerate() {
                if *mask == instance {
                    count.add(silhouette.x[0] + i, y);
                    self.scratch.push(*depth);
                }
            }
        }
        if count.pixels == 0 {
            return None;
        }
        let middle = self.scratch.len() / 2;
        let (_, median, _) = self.scratch.select_nth_unstable_by(middle, f32::total_cmp);
        let depth_median_m = f64::from(*median);
        let depth_min_m = f64::from(self.scratch.iter().copied().fold(f32::INFINITY, f32::min));
        let bbox = count.bbox();
        let full_bbox = self.full_box(shot, index, bbox);
        let inside = full_bbox.clipped(width as f32, height as f32).area();
        Some(Truth {
            bbox,
            full_bbox,
            pixels: count.pixels,
            visible_share: count.pixels as f64 / silhouette.pixels.max(count.pixels) as f64,
            inside_share: f64::from(inside / full_bbox.area().max(1e-6)).min(1.0),
            depth_median_m,
            depth_min_m,
        })
    }

    /// The pixels within the picture that an actor would show if nothing hid it.
    fn silhouette(&mut self, instance: u8) -> Count {
        let Self { rays, surfaces, bins, hits, .. } = self;
        let mut count = Count { pixels: 0, x: [rays.width, 0], y: [rays.height, 0] };
        for tile in 0..rays.tiles.len() {
            let mut any = false;
            for entry in bins.of(tile) {
                let Some(surface) = surfaces.get(entry.index as usize) else { continue };
                if surface.instance == instance && !surface.decal {
                    if !any {
                        hits.fill(0);
                        any = true;
                    }
                    mark_tile(self.simd, rays, tile, surface, entry, hits);
                }
            }
            if !any {
                continue;
            }
            let (x0, y0) = ((tile % rays.tiles_x) * TILE_W, (tile / rays.tiles_x) * TILE_H);
            for (k, _) in hits.iter().enumerate().filter(|(_, hit)| **hit != 0) {
                let (x, y) = (x0 + k % TILE_W, y0 + k / TILE_W);
                if x < rays.width && y < rays.height {
                    count.add(x, y);
                }
            }
        }
        count
    }

    /// The box of all corners of an actor.
    fn full_box(&mut self, shot: &Shot<'_>, index: usize, visible: BoundingBox) -> BoundingBox {
        let Some(actor) = shot.actors.get(index) else { return visible };
        let shape = self.shape(actor);
        let Some((_, _, shape)) = self.shapes.get(shape) else { return visible };
        let camera_from_world =
            self.world_from_camera(&shot.own.world_from_base, shot.lean).inverse();
        let camera_from_base =
            camera_from_world * crate::scene::pose3(&actor.state.world_from_base);
        let mut bounds = visible;
        let model = &self.camera.model;
        let mut add = |point: Point3<f64>| {
            if point.z > 0.02
                && let Ok([u, v]) = model.project(&point)
            {
                // Boxes count from the edge of the picture, pixels from their middles.
                let (x, y) = ((u + 0.5) as f32, (v + 0.5) as f32);
                bounds = bounds.enclosing(&BoundingBox::new(x, y, x, y));
            }
        };
        for point in &shape.body.points {
            add(camera_from_base.transform_point(point));
        }
        for wheel in 0..shape.wheels() {
            let Some((mesh, base_from_wheel)) = shape.wheel(wheel, &actor.state) else { continue };
            let pose = camera_from_base * base_from_wheel;
            mesh.points.iter().for_each(|point| add(pose.transform_point(point)));
        }
        bounds
    }
}

impl Count {
    fn add(&mut self, x: usize, y: usize) {
        self.pixels += 1;
        self.x = [self.x[0].min(x), self.x[1].max(x)];
        self.y = [self.y[0].min(y), self.y[1].max(y)];
    }

    fn bbox(&self) -> BoundingBox {
        let [x0, y0] = [self.x[0], self.y[0]].map(|v| v as f32);
        let [x1, y1] = [self.x[1], self.y[1]].map(|v| (v + 1) as f32);
        BoundingBox::new(x0, y0, x1, y1)
    }
}
