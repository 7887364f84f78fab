//! Worlds from their specs.

use super::furniture::{self, Thing, between, colour, one_of};
use super::mesh::{Hexa, Mesh, Skin, block_corners, p, srgb};
use super::mover::{self, Gait, Mover, Path};
use super::{Bounds, Light, Obstacle, Scene, SceneKind, SceneSpec, TextureLevel};
use crate::render::Texture;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use realnet_core::Pose;
use realnet_core::nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};

/// Share of the contrast that is left at [`TextureLevel::Low`].
const LOW_CONTRAST: f32 = 0.1;

pub(super) fn build(spec: &SceneSpec, seed: u64) -> Scene {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let extent = extent(&spec.keep_free, spec.clearance_m);
    let mut builder = Builder {
        spec,
        rng: &mut rng,
        scene: Scene {
            spec: spec.clone(),
            solid: Mesh::default(),
            movers: Vec::new(),
            light: Light {
                lamp: Point3::new(0.0, 0.0, 2.4),
                strength: 1.0,
                reach: 2.4,
                ambient: 0.4,
                tint: [1.0; 3],
                softness: 0.06,
                sky: None,
            },
            obstacles: Vec::new(),
            bounds: None,
        },
        extent,
        ceiling: 2.6,
    };
    match spec.kind {
        SceneKind::Room => builder.room(),
        SceneKind::Hall => builder.hall(),
        SceneKind::Corridor => builder.corridor(),
        SceneKind::Track => builder.track(),
    }
    builder.clutter();
    builder.moving();
    builder.scene
}

/// The rectangle around the way, with its clearance.
fn extent(way: &[[f64; 2]], clearance: f64) -> Bounds {
    let mut min = Vector2::repeat(f64::INFINITY);
    let mut max = Vector2::repeat(f64::NEG_INFINITY);
    for point in way.iter().map(|&point| Vector2::from(point)) {
        (min, max) = (min.inf(&point), max.sup(&point));
    }
    if way.is_empty() {
        (min, max) = (Vector2::zeros(), Vector2::zeros());
    }
    let around = Vector2::repeat(clearance);
    Bounds { min: min - around, max: max + around }
}

/// Distance of a point from a polyline, infinite when that is empty.
pub(super) fn distance_to_way(way: &[[f64; 2]], point: &Vector2<f64>) -> f64 {
    let single = way.first().map(|&only| (Vector2::from(only) - point).norm());
    let along = way.windows(2).map(|pair| {
        let (a, b) = (Vector2::from(pair[0]), Vector2::from(pair[1]));
        let edge = b - a;
        let share = (point - a).dot(&edge) / edge.norm_squared().max(1e-12);
        (a + edge * share.clamp(0.0, 1.0) - point).norm()
    });
    along.chain(single).fold(f64::INFINITY, f64::min)
}

struct Builder<'a> {
    spec: &'a SceneSpec,
    rng: &'a mut Pcg64Mcg,
    scene: Scene,
    /// Around the way.
    extent: Bounds,
    ceiling: f64,
}

impl Builder<'_> {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        between(self.rng, low, high)
    }

    /// A skin of floor, wall or ceiling.
    fn surface(&self, skin: Skin) -> Skin {
        match self.spec.texture {
            TextureLevel::Rich => skin,
            TextureLevel::Low => skin.flattened(LOW_CONTRAST),
        }
    }

    /// Walls at least `margin` outside of the way, and at least `least` in size; the
    /// way is not in the middle.
    fn around(&mut self, least: [f64; 2], margin: f64) -> Bounds {
        let Bounds { mut min, mut max } = self.extent;
        for axis in 0..2 {
            min[axis] -= margin;
            max[axis] += margin;
            let missing = (least[axis] - (max[axis] - min[axis])).max(0.0);
            let share = self.between(0.25, 0.75);
            min[axis] -= share * missing;
            max[axis] += (1.0 - share) * missing;
        }
        Bounds { min, max }
    }

    fn lamp_over(&mut self, bounds: &Bounds, strength: f64) {
        let middle = 0.5 * (bounds.min + bounds.max);
        let off = [self.between(-0.15, 0.15), self.between(-0.15, 0.15)];
        let size = bounds.size();
        let at = middle + Vector2::new(off[0] * size.x, off[1] * size.y);
        let height = self.ceiling - 0.08;
        let warm = self.between(-0.08, 0.10) as f32;
        let light = &mut self.scene.light;
        light.lamp = Point3::new(at.x, at.y, height);
        light.reach = height.max(0.35 * size.norm());
        light.strength = strength;
        light.tint = [1.0 + warm, 1.0, 1.0 - warm];
        let tile = [0.5 * 0.12 * size.x.min(6.0), 0.5 * 0.12 * size.y.min(6.0)];
        let glow = Skin::plain(srgb(0xfffaf0)).glowing(1.6);
        let frame = Skin::plain(srgb(0xc8c8c8));
        let skins = Hexa { bottom: glow, ..Hexa::all(frame) };
        let z = [self.ceiling - 0.06, self.ceiling];
        self.scene.solid.block([at.x, at.y], tile, z, 0.0, &skins);
        // The lamp itself throws no shadow.
        self.scene.solid.hulls.pop();
    }

    fn floor(&mut self, bounds: &Bounds, skin: Skin) {
        let skin = self.surface(skin);
        let (a, b) = (bounds.min, bounds.max);
        let corners = [p(a.x, a.y, 0.0), p(b.x, a.y, 0.0), p(b.x, b.y, 0.0), p(a.x, b.y, 0.0)];
        let shift = [self.between(0.0, 512.0), self.between(0.0, 512.0)];
        let face = self.scene.solid.polygon(&corners, skin);
        (face.large, face.ground) = (true, true);
        (face.s.1, face.t.1) = (shift[0], shift[1]);
    }

    /// Four walls and a ceiling, their insides seen; skirting along the walls.
    fn shell(&mut self, bounds: &Bounds, walls: [Skin; 4], ceiling: Skin, skirting: Skin) {
        let (a, b, h) = (bounds.min, bounds.max, self.ceiling);
        let corners = [[a.x, a.y], [b.x, a.y], [b.x, b.y], [a.x, b.y]];
        for i in 0..4 {
            let (from, to) = (corners[i], corners[(i + 1) % 4]);
            let skin = self.surface(walls[i]);
            let at = |q: [f64; 2], z: f64| p(q[0], q[1], z);
            // Counter-clockwise as seen from inside.
            let wall = [at(to, 0.0), at(from, 0.0), at(from, h), at(to, h)];
            let shift = self.between(0.0, 512.0);
            let face = self.scene.solid.polygon(&wall, skin);
            face.large = true;
            face.s.1 = shift;
            let low = [at(to, 0.0), at(from, 0.0), at(from, 0.09), at(to, 0.09)];
            let face = self.scene.solid.polygon(&low, skirting);
            (face.large, face.decal) = (true, true);
        }
        let skin = self.surface(ceiling);
        let top = [p(a.x, b.y, h), p(b.x, b.y, h), p(b.x, a.y, h), p(a.x, a.y, h)];
        self.scene.solid.polygon(&top, skin).large = true;
        self.scene.bounds = Some(*bounds);
    }

    /// A picture, door or window on a wall: `along` is the place of its middle from 0
    /// to 1 as seen from inside, from left to right.
    fn on_wall(&mut self, wall: usize, along: f64, half: f64, z: [f64; 2], skin: Skin) {
        let Some(bounds) = self.scene.bounds else { return };
        let (a, b) = (bounds.min, bounds.max);
        let corners = [[a.x, a.y], [b.x, a.y], [b.x, b.y], [a.x, b.y]];
        // From inside, the end of the wall is at the left.
        let (right, left) =
            (Vector2::from(corners[wall % 4]), Vector2::from(corners[(wall + 1) % 4]));
        let length = (right - left).norm();
        let half = half.min(0.45 * length);
        let middle = (along * length).clamp(half + 0.05, length - half - 0.05);
        let at = |s: f64, z: f64| {
            let q = left + (right - left) * ((middle + s) / length);
            p(q.x, q.y, z)
        };
        let corners = [at(-half, z[1]), at(half, z[1]), at(half, z[0]), at(-half, z[0])];
        let face = self.scene.solid.filled(corners, skin);
        (face.decal, face.large) = (true, true);
    }

    fn door(&mut self, wall: usize, along: f64) {
        let frame = Skin::plain(srgb(0xdad6cc));
        self.on_wall(wall, along, 0.52, [0.0, 2.10], frame);
        let leaf = Skin::new(Texture::Planks, srgb(0x5a3a20), srgb(0xb98450), 1.0);
        self.on_wall(wall, along, 0.45, [0.0, 2.04], leaf);
        let knob = Skin::plain(srgb(0x303030));
        self.on_wall(wall, along + 0.001, 0.05, [1.00, 1.04], knob);
    }

    fn window(&mut self, wall: usize, along: f64) {
        let frame = Skin::plain(srgb(0xe8e6e0));
        let (low, high) = (0.85, 2.0_f64.min(self.ceiling - 0.3));
        self.on_wall(wall, along, 0.68, [low, high], frame);
        let sky = Skin::new(Texture::Concrete, srgb(0x8cb4dc), srgb(0xf4faff), 1.0).glowing(0.9);
        let gap = 0.06;
        for side in [-0.32, 0.32] {
            self.on_wall_offset(wall, along, side, 0.28, [low + gap, high - gap], sky);
        }
    }

    fn on_wall_offset(
        &mut self,
        wall: usize,
        along: f64,
        shift: f64,
        half: f64,
        z: [f64; 2],
        skin: Skin,
    ) {
        let Some(bounds) = self.scene.bounds else { return };
        let size = bounds.size();
        let length = if wall.is_multiple_of(2) { size.x } else { size.y };
        self.on_wall(wall, along + shift / length, half, z, skin);
    }

    fn pictures(&mut self, per_wall: usize, low: f64) {
        for wall in 0..4 {
            for i in 0..per_wall {
                let along = (i as f64 + self.between(0.25, 0.75)) / per_wall as f64;
                let half = self.between(0.2, 0.45);
                let z = low + self.between(0.0, 0.3);
                let height = self.between(0.4, 0.9).min(self.ceiling - z - 0.15);
                let colours = [colour(self.rng), srgb(0xf0ece0)];
                let print = Skin::new(Texture::Poster, colours[0], colours[1], 1.0);
                let frame = Skin::plain(srgb(one_of(self.rng, &[0x1c1c1c, 0xb89050, 0xe8e8e8])));
                self.on_wall(wall, along, half + 0.03, [z - 0.03, z + height + 0.03], frame);
                self.on_wall(wall, along, half, [z, z + height], print);
            }
        }
    }

    fn room(&mut self) {
        let bounds = self.around([5.2, 4.4], 0.7);
        self.ceiling = self.between(2.4, 2.9);
        let floor = match (self.rng.random::<f64>() * 4.0) as u32 {
            0 => Skin::new(Texture::Carpet, srgb(0x2a2c38), srgb(0xb0a898), 280.0),
            1 => Skin::new(Texture::Tiles, srgb(0x5a554c), srgb(0xe6e0d2), 320.0),
            2 => Skin::new(Texture::Planks, srgb(0x4a2e16), srgb(0xcf9c60), 420.0),
            _ => Skin::new(Texture::Carpet, srgb(0x4a2018), srgb(0xc08a60), 240.0),
        };
        self.floor(&bounds, floor);
        let paper = colour(self.rng).map(|c| 0.55 + 0.35 * c);
        let plain = Skin::new(Texture::Concrete, paper.map(|c| c * 0.62), paper, 150.0);
        let brick = Skin::new(Texture::Brick, srgb(0x6a2c1c), srgb(0xd8cabb), 250.0);
        let mut walls = [plain; 4];
        if self.rng.random::<f64>() < 0.4 {
            walls[(self.rng.random::<f64>() * 4.0) as usize % 4] = brick;
        }
        let ceiling = Skin::new(Texture::Plain, srgb(0xb8b6b0), srgb(0xfbfaf6), 200.0);
        self.shell(&bounds, walls, ceiling, Skin::plain(srgb(0xd8d0c0)));
        self.lamp_over(&bounds, 1.0);
        let (door, window) = ((self.rng.random::<f64>() * 4.0) as usize, 1);
        self.pictures(2, 0.75);
        let along = self.between(0.2, 0.8);
        self.door(door, along);
        let along = self.between(0.2, 0.8);
        self.window(door + window, along);
        let along = self.between(0.2, 0.8);
        self.window(door + 2, along);
    }

    fn hall(&mut self) {
        let bounds = self.around([16.0, 12.0], 2.5);
        self.ceiling = self.between(4.5, 6.5);
        let floor = match (self.rng.random::<f64>() * 3.0) as u32 {
            0 => Skin::new(Texture::Concrete, srgb(0x50524e), srgb(0xc4c2b8), 256.0),
            1 => Skin::new(Texture::Asphalt, srgb(0x30343a), srgb(0xa8aaa8), 300.0),
            _ => Skin::new(Texture::Tiles, srgb(0x54585c), srgb(0xc8ccd0), 256.0),
        };
        self.floor(&bounds, floor);
        let brick = Skin::new(Texture::Brick, srgb(0x70351f), srgb(0xd0c4b4), 170.0);
        let concrete = Skin::new(Texture::Concrete, srgb(0x6e6c68), srgb(0xdad6ce), 90.0);
        let pick = [brick, concrete];
        let walls = std::array::from_fn(|_| one_of(self.rng, &pick));
        let ceiling = Skin::new(Texture::Stripes, srgb(0x585c60), srgb(0x9a9ea2), 256.0);
        self.shell(&bounds, walls, ceiling, Skin::plain(srgb(0x3a3c40)));
        self.lamp_over(&bounds, 1.1);
        self.scene.light.ambient = 0.5;
        self.pictures(4, 0.9);
        for wall in 0..4 {
            let along = self.between(0.1, 0.9);
            self.door(wall, along);
        }
        self.markings();
    }

    fn corridor(&mut self) {
        let bounds = self.around([2.2, 2.0], 0.45);
        self.ceiling = self.between(2.3, 2.7);
        let floor = match (self.rng.random::<f64>() * 3.0) as u32 {
            0 => Skin::new(Texture::Tiles, srgb(0x46423c), srgb(0xd8d0c0), 380.0),
            1 => Skin::new(Texture::Carpet, srgb(0x1c2c4a), srgb(0x90a0b8), 260.0),
            _ => Skin::new(Texture::Concrete, srgb(0x585c50), srgb(0xc0c4b0), 320.0),
        };
        self.floor(&bounds, floor);
        let wall = Skin::new(Texture::Concrete, srgb(0x98988a), srgb(0xf0efe4), 140.0);
        let ceiling = Skin::new(Texture::Tiles, srgb(0xa8a8a4), srgb(0xf4f4f0), 210.0);
        self.shell(&bounds, [wall; 4], ceiling, Skin::plain(srgb(0x5a5048)));
        self.lamp_over(&bounds, 0.9);
        self.scene.light.ambient = 0.55;
        let size = bounds.size();
        let long = if size.x > size.y { 0 } else { 1 };
        let doors = (size.x.max(size.y) / 3.0).clamp(1.0, 12.0) as usize;
        for i in 0..doors {
            let along = (i as f64 + 0.5) / doors as f64;
            self.door(long, along);
            self.door(long + 2, (along + 0.3 / doors as f64).min(0.95));
        }
        self.pictures(doors.min(6), 0.9);
    }

    /// Yellow lines on both sides of the way.
    fn markings(&mut self) {
        let paint = Skin::new(Texture::Asphalt, srgb(0x7a6a20), srgb(0xf8d840), 220.0);
        let paint = self.surface(paint);
        self.lines(self.spec.clearance_m + 0.25, 0.06, paint);
    }

    /// Flat strips to both sides of the way: distance of their inner edge, width.
    fn lines(&mut self, distance: f64, width: f64, skin: Skin) {
        let way: Vec<Vector2<f64>> =
            self.spec.keep_free.iter().map(|&point| Vector2::from(point)).collect();
        let normal = |i: usize| {
            let (a, b) = (way[i.saturating_sub(1)], way[(i + 1).min(way.len() - 1)]);
            let along = (b - a).try_normalize(1e-9).unwrap_or_else(Vector2::x);
            Vector2::new(-along.y, along.x)
        };
        let mut travelled = 0.0;
        for i in 1..way.len() {
            let length = (way[i] - way[i - 1]).norm();
            for side in [1.0, -1.0] {
                let at = |i: usize, d: f64| {
                    let q = way[i] + normal(i) * (side * d);
                    p(q.x, q.y, 0.0)
                };
                let (near, far) = (distance, distance + width);
                let mut quad = [at(i - 1, near), at(i, near), at(i, far), at(i - 1, far)];
                if side < 0.0 {
                    quad.swap(1, 3);
                }
                let turn = |k: usize| {
                    let (a, b, c) = (quad[k], quad[(k + 1) % 4], quad[(k + 2) % 4]);
                    (b - a).xy().perp(&(c - b).xy())
                };
                // Where the way turns sharply a strip may fold over: leave it out.
                if (0..4).any(|k| turn(k) < 1e-6) {
                    continue;
                }
                let along = (way[i] - way[i - 1]).try_normalize(1e-9).unwrap_or_else(Vector2::x);
                let face = self.scene.solid.polygon(&quad, skin);
                (face.decal, face.large, face.ground) = (true, true, true);
                // The texture runs along the strip.
                let s = Vector3::new(along.x, along.y, 0.0) * skin.density;
                let t = Vector3::new(-along.y, along.x, 0.0) * skin.density;
                face.s = (s, travelled * skin.density - s.x * way[i - 1].x - s.y * way[i - 1].y);
                face.t = (t, 0.0);
            }
            travelled += length;
        }
    }

    fn track(&mut self) {
        self.ceiling = 8.0;
        let far = 150.0;
        let around = Vector2::repeat(far);
        let wide = Bounds { min: self.extent.min - around, max: self.extent.max + around };
        let grass = Skin::new(Texture::Grass, srgb(0x24401a), srgb(0x90a860), 130.0);
        let asphalt = Skin::new(Texture::Asphalt, srgb(0x2a2b2e), srgb(0xa0a09c), 240.0);
        let on_grass = self.rng.random::<f64>() < 0.6;
        self.floor(&wide, if on_grass { grass } else { asphalt });
        if on_grass {
            let (a, b) = (self.extent.min, self.extent.max);
            let m = 0.5;
            let corners = [
                p(a.x - m, a.y - m, 0.0),
                p(b.x + m, a.y - m, 0.0),
                p(b.x + m, b.y + m, 0.0),
                p(a.x - m, b.y + m, 0.0),
            ];
            let skin = self.surface(asphalt);
            let face = self.scene.solid.polygon(&corners, skin);
            (face.decal, face.large, face.ground) = (true, true, true);
        }
        let white = Skin::new(Texture::Asphalt, srgb(0x8a8a88), srgb(0xf4f4f0), 240.0);
        let white = self.surface(white);
        self.lines(self.spec.clearance_m + 0.05, 0.06, white);
        let kerb = Skin::new(Texture::Stripes, srgb(0xa81818), srgb(0xf4f0ec), 512.0);
        self.lines(self.spec.clearance_m + 0.16, 0.16, kerb);
        let height = self.between(0.5, 1.1);
        let turn = self.between(0.0, std::f64::consts::TAU);
        let sun = Vector3::new(turn.cos(), turn.sin(), height).normalize() * 300.0;
        let light = &mut self.scene.light;
        light.lamp = Point3::from(sun);
        light.reach = 300.0;
        light.strength = 0.85;
        light.ambient = 0.42;
        light.tint = [1.04, 1.0, 0.94];
        light.softness = 0.02;
        light.sky = Some([srgb(0xc8dcee), srgb(0x4a86d0)]);
        self.buildings();
    }

    /// Fronts around the track, some of them near.
    fn buildings(&mut self) {
        let middle = 0.5 * (self.extent.min + self.extent.max);
        let reach = 0.5 * self.extent.size().norm();
        let count = 9;
        for i in 0..count {
            let part = (i as f64 + self.between(0.2, 0.8)) / count as f64;
            let (sin, cos) = (std::f64::consts::TAU * part).sin_cos();
            let half = [self.between(3.0, 8.0), self.between(2.5, 5.0)];
            let distance = reach + half[0].hypot(half[1]) + self.between(3.0, 22.0);
            let at = [middle.x + distance * cos, middle.y + distance * sin];
            let height = self.between(3.0, 11.0);
            let wall = colour(self.rng).map(|c| 0.35 + 0.5 * c);
            let front = Skin::new(Texture::Front, srgb(0x1a2430), wall, 512.0 / 11.0);
            let brick = Skin::new(Texture::Brick, srgb(0x70351f), srgb(0xd0c4b4), 120.0);
            let side = if self.rng.random::<f64>() < 0.4 { brick } else { front };
            let roof = Skin::plain(srgb(0x4a4448));
            let yaw = self.between(0.0, std::f64::consts::TAU);
            let skins = Hexa { sides: [front, side, front, side], top: roof, bottom: roof };
            self.scene.solid.block(at, half, [0.0, height], yaw, &skins);
            let corners = block_corners(at, half, yaw).map(Vector2::from).to_vec();
            self.scene.obstacles.push(Obstacle { corners, path: None, height });
        }
    }

    /// Where things may stand.
    fn ground(&self) -> Bounds {
        self.scene.bounds.unwrap_or_else(|| {
            let around = Vector2::repeat(5.0);
            Bounds { min: self.extent.min - around, max: self.extent.max + around }
        })
    }

    /// A free place for a disc, or none after many tries.
    fn place(&mut self, radius: f64, taken: &[(Vector2<f64>, f64)]) -> Option<Vector2<f64>> {
        let ground = self.ground();
        let size = ground.size();
        for _ in 0..60 {
            let (u, v) = (self.rng.random::<f64>(), self.rng.random::<f64>());
            let at = ground.min + Vector2::new(u * size.x, v * size.y);
            let free = distance_to_way(&self.spec.keep_free, &at) > self.spec.clearance_m + radius
                && ground.depth_of(&at) > radius + 0.03
                && taken.iter().all(|(other, r)| (other - at).norm() > r + radius + 0.05);
            if free {
                return Some(at);
            }
        }
        None
    }

    fn clutter(&mut self) {
        let mut taken = Vec::new();
        for _ in 0..self.spec.clutter {
            let Thing { mesh, half, height } = match self.spec.kind {
                SceneKind::Room | SceneKind::Corridor => furniture::indoor(self.rng),
                SceneKind::Hall => furniture::industrial(self.rng, self.ceiling),
                SceneKind::Track => furniture::outdoor(self.rng),
            };
            let radius = half[0].hypot(half[1]);
            let Some(at) = self.place(radius, &taken) else { continue };
            taken.push((at, radius));
            let yaw = if self.spec.kind == SceneKind::Track {
                self.between(0.0, std::f64::consts::TAU)
            } else {
                // Furniture mostly stands along the walls' directions.
                let quarter = std::f64::consts::FRAC_PI_2;
                quarter * (self.between(0.0, 4.0)).floor() + self.between(-0.25, 0.25)
            };
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
            let pose = Pose::new(turn, Vector3::new(at.x, at.y, 0.0));
            self.scene.solid.add(&mesh, &pose);
            let corners = block_corners([at.x, at.y], half, yaw).map(Vector2::from).to_vec();
            self.scene.obstacles.push(Obstacle { corners, path: None, height });
        }
    }

    fn moving(&mut self) {
        for index in 0..self.spec.moving {
            let (gait, parts, radius, height) = match index % 3 {
                0 => {
                    let radius = self.between(0.09, 0.16);
                    let tone = colour(self.rng);
                    let one = Skin::new(Texture::Concrete, tone.map(|c| 0.3 * c), tone, 500.0);
                    let mesh = mover::ball(radius, one, Skin::plain(srgb(0xf0f0ec)));
                    (Gait::Roll { radius }, vec![mesh], radius, 2.0 * radius)
                }
                1 => {
                    let tone = colour(self.rng);
                    let shirt = Skin::new(Texture::Carpet, tone.map(|c| 0.3 * c), tone, 400.0);
                    let jeans = Skin::new(Texture::Carpet, srgb(0x101c38), srgb(0x5070a0), 500.0);
                    (Gait::Walk, mover::person(shirt, jeans), 0.3, 1.72)
                }
                _ => {
                    let carton = furniture::carton(self.rng);
                    let radius = carton.half[0].hypot(carton.half[1]);
                    (Gait::Swing, vec![carton.mesh], radius, carton.height)
                }
            };
            let Some(path) = self.free_path(radius) else { continue };
            let corners = (0..8).map(|i| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 8.0).sin_cos();
                // The octagon around the disc.
                Vector2::new(cos, sin) * (radius / (std::f64::consts::PI / 8.0).cos())
            });
            let corners = corners.collect();
            self.scene.obstacles.push(Obstacle { corners, path: Some(path), height });
            self.scene.movers.push(Mover { path, gait, parts });
        }
    }

    /// A way to and fro on which a disc is clear of the vehicles' way and the walls.
    fn free_path(&mut self, radius: f64) -> Option<Path> {
        for _ in 0..40 {
            let from = self.place(radius, &[])?;
            let (angle, length) =
                (self.between(0.0, std::f64::consts::TAU), self.between(0.8, 3.0));
            let along = Vector2::new(angle.cos(), angle.sin());
            let ground = self.ground();
            let clear = (0..=16).all(|i| {
                let at = from + along * (length * f64::from(i) / 16.0);
                distance_to_way(&self.spec.keep_free, &at)
                    > self.spec.clearance_m + radius + length / 32.0
                    && ground.depth_of(&at) > radius
            });
            if clear {
                let to = from + along * length;
                let period = std::f64::consts::PI * length / self.between(0.4, 1.2);
                let phase = self.between(0.0, 1.0);
                return Some(Path { from: from.into(), to: to.into(), period, phase });
            }
        }
        None
    }
}
