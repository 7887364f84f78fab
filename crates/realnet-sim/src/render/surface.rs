//! Faces made ready for one view.

use super::canvas::Span2;
use super::texture::Texture;
use crate::scene::Light;
use crate::scene::Mesh;
use crate::scene::mesh::{Face, MAX_EDGES};
use realnet_core::Pose;
use realnet_core::nalgebra::{Point3, Vector3};

/// Nothing nearer than this is drawn, metres.
const NEAR: f64 = 0.01;
/// Period of the textures in texels.
const PERIOD: f64 = super::texture::SIDE as f64;

/// A visible face as linear functions `[a, b, c]` of a ray, `a x + b y + c`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    /// Inverse depth.
    pub(super) inverse: [f32; 3],
    /// Not negative inside of each edge.
    pub(super) edges: [[f32; 3]; MAX_EDGES],
    pub(super) edge_count: usize,
    /// Texture coordinate: the linear function over the inverse depth, plus the last.
    pub(super) s: [f32; 4],
    pub(super) t: [f32; 4],
    pub(super) texture: Texture,
    /// Colour at texture 0 and what 1 adds; lit already unless `large`.
    pub(super) low: [f32; 3],
    pub(super) span: [f32; 3],
    /// Of a large face: the lamp in the optical frame, and strength times reach squared
    /// times height over the face.
    pub(super) lamp: [f32; 3],
    pub(super) lamp_factor: f32,
    /// Light from everywhere, and light of its own.
    pub(super) ambient: f32,
    pub(super) large: bool,
    pub(super) ground: bool,
    pub(super) decal: bool,
    /// 0 for what belongs to the scene.
    pub(super) instance: u8,
}

impl Surface {
    /// Never seen.
    pub(super) const NOTHING: Self = Self {
        inverse: [0.0; 3],
        edges: [[0.0; 3]; MAX_EDGES],
        edge_count: 0,
        s: [0.0; 4],
        t: [0.0; 4],
        texture: Texture::Plain,
        low: [0.0; 3],
        span: [0.0; 3],
        lamp: [0.0; 3],
        lamp_factor: 0.0,
        ambient: 0.0,
        large: false,
        ground: false,
        decal: false,
        instance: 0,
    };
}

/// What the faces of a body are seen with.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) camera_from_body: Pose,
    pub(super) camera_from_world: &'a Pose,
    pub(super) light: &'a Light,
    /// Lamp in the optical frame.
    pub(super) lamp: Point3<f64>,
    pub(super) brightness: f32,
    pub(super) instance: u8,
}

/// The linear function over a ray whose value is `normal . (x, y, 1)`.
fn linear(normal: &Vector3<f64>) -> [f32; 3] {
    [normal.x as f32, normal.y as f32, normal.z as f32]
}

/// Bounds of a polygon's rays, before the camera only; `None` when all is behind.
pub(super) fn ray_bounds(corners: impl Iterator<Item = Point3<f64>> + Clone) -> Option<Span2> {
    let mut bounds = Span2::EMPTY;
    let mut add = |point: Point3<f64>| {
        bounds.add((point.x / point.z) as f32, (point.y / point.z) as f32);
    };
    let next = corners.clone().skip(1).chain(corners.clone().take(1));
    for (a, b) in corners.zip(next) {
        if a.z >= NEAR {
            add(a);
        }
        if (a.z >= NEAR) != (b.z >= NEAR) {
            let mut crossing = a + (b - a) * ((NEAR - a.z) / (b.z - a.z));
            crossing.z = NEAR;
            add(crossing);
        }
    }
    (bounds.x[0] <= bounds.x[1]).then_some(bounds)
}

/// Corners of a face in the optical frame.
pub(super) struct Corners {
    points: [Point3<f64>; MAX_EDGES],
    count: usize,
}

impl Corners {
    fn iter(&self) -> impl Iterator<Item = Point3<f64>> + Clone + '_ {
        self.points.iter().take(self.count).copied()
    }
}

impl View<'_> {
    /// Corners of a face that looks at the camera.
    fn corners(&self, mesh: &Mesh, face: &Face, normal: &Vector3<f64>) -> Option<Corners> {
        let points = mesh.points.get(face.first..face.first + face.count)?;
        let first = self.camera_from_body.transform_point(points.first()?);
        if normal.dot(&first.coords) > -1e-9 {
            return None;
        }
        let mut corners = Corners { points: [first; MAX_EDGES], count: points.len() };
        for (corner, point) in corners.points.iter_mut().zip(points).skip(1) {
            *corner = self.camera_from_body.transform_point(point);
        }
        Some(corners)
    }

    /// The face as seen, and the bounds of its rays; `None` when it looks away or lies
    /// behind. `glow` is added to the face's own.
    pub(super) fn surface(
        &self,
        mesh: &Mesh,
        face: &Face,
        picture: &Span2,
        glow: f32,
    ) -> Option<(Surface, Span2)> {
        let normal = self.camera_from_body.transform_vector(&face.normal);
        let corners = self.corners(mesh, face, &normal)?;
        let bounds = ray_bounds(corners.iter()).filter(|bounds| bounds.meets(picture))?;
        let points = &corners.points[..corners.count];
        let first = points.first()?;
        let middle = points.iter().fold(Vector3::zeros(), |sum, q| sum + q.coords);
        let mut edges = [[0.0; 3]; MAX_EDGES];
        for (i, (edge, a)) in edges.iter_mut().zip(points).enumerate() {
            let b = points[(i + 1) % points.len()];
            let side = a.coords.cross(&b.coords);
            // A neighbour with the same edge gets the exact negative: no gaps.
            let side = if side.dot(&middle) < 0.0 { -side } else { side };
            *edge = linear(&side);
        }
        let plane = normal / normal.dot(&first.coords);
        let rotation = self.camera_from_body.rotation();
        let shift = self.camera_from_body.translation();
        let map = |(map, at): (Vector3<f64>, f64)| {
            let map = rotation * map;
            let [a, b, c] = linear(&map);
            [a, b, c, (at - map.dot(&shift)).rem_euclid(PERIOD) as f32]
        };
        let mean = middle / points.len() as f64;
        let (low, high) = (face.skin.low, face.skin.high);
        let mut surface = Surface {
            inverse: linear(&plane),
            edges,
            edge_count: points.len(),
            s: map(face.s),
            t: map(face.t),
            texture: face.skin.texture,
            low,
            span: std::array::from_fn(|i| high[i] - low[i]),
            lamp: [0.0; 3],
            lamp_factor: 0.0,
            ambient: 0.0,
            large: face.large,
            ground: face.ground,
            decal: face.decal,
            instance: self.instance,
        };
        self.lit(&mut surface, &normal, first, &mean, face.skin.glow, glow);
        Some((surface, bounds))
    }

    fn lit(
        &self,
        surface: &mut Surface,
        normal: &Vector3<f64>,
        first: &Point3<f64>,
        mean: &Vector3<f64>,
        own_glow: f32,
        glow: f32,
    ) {
        let light = self.light;
        let up = self.camera_from_world.transform_vector(&Vector3::z()).dot(normal);
        // More comes from above; a ceiling is lit by the floor.
        let sky = 0.82 + 0.18 * up.abs().max(up);
        let ambient = (light.ambient * sky) as f32;
        let height = normal.dot(&(self.lamp - first)).max(0.0);
        let factor = light.strength * light.reach * light.reach * height;
        let own = if self.instance == 0 { own_glow * self.brightness } else { own_glow } + glow;
        if surface.large {
            surface.lamp = [self.lamp.x as f32, self.lamp.y as f32, self.lamp.z as f32];
            surface.lamp_factor = factor as f32 * self.brightness;
            surface.ambient = ambient * self.brightness + own;
        } else {
            let distance = (self.lamp.coords - mean).norm().max(0.2);
            let lamp = (factor / distance.powi(3)).min(1.6) as f32;
            surface.ambient = (ambient + lamp) * self.brightness + own;
        }
        let scale = if surface.large { 1.0 } else { surface.ambient };
        for i in 0..3 {
            surface.low[i] *= scale * light.tint[i];
            surface.span[i] *= scale * light.tint[i];
        }
    }
}
