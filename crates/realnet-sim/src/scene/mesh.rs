//! Bodies as convex flat faces.

use crate::render::Texture;
use realnet_core::nalgebra::{Point3, Vector3};
use std::f64::consts::TAU;

/// Most edges that a face may have.
pub(crate) const MAX_EDGES: usize = 12;
/// Texels along a texture.
const SIDE: f64 = crate::render::TEXTURE_SIDE as f64;

/// Colours in linear light, red, green, blue, 0 to 1.
pub(crate) type Colour = [f32; 3];

/// What a face looks like: a texture between two colours.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Skin {
    pub(crate) texture: Texture,
    /// Colour where the texture is 0.
    pub(crate) low: Colour,
    /// Colour where the texture is 1.
    pub(crate) high: Colour,
    /// Texels a metre.
    pub(crate) density: f64,
    /// Light of its own, as a multiple of its colour.
    pub(crate) glow: f32,
}

impl Skin {
    pub(crate) const fn new(texture: Texture, low: Colour, high: Colour, density: f64) -> Self {
        Self { texture, low, high, density, glow: 0.0 }
    }

    /// One colour with faint specks.
    pub(crate) fn plain(colour: Colour) -> Self {
        Self::new(Texture::Plain, scaled(colour, 0.6), scaled(colour, 1.4), 300.0)
    }

    pub(crate) fn glowing(self, glow: f32) -> Self {
        Self { glow, ..self }
    }

    /// The same with `share` of the contrast.
    pub(crate) fn flattened(self, share: f32) -> Self {
        let toward = |own: f32, other: f32| {
            let middle = 0.5 * (own + other);
            middle + share * (own - middle)
        };
        let mix = |a: Colour, b: Colour| std::array::from_fn(|i| toward(a[i], b[i]));
        Self { low: mix(self.low, self.high), high: mix(self.high, self.low), ..self }
    }
}

/// A colour made darker or brighter.
pub(crate) fn scaled(colour: Colour, by: f32) -> Colour {
    colour.map(|c| (c * by).clamp(0.0, 1.0))
}

/// Linear light of a colour as it is written in pictures, `0xRRGGBB`.
pub(crate) fn srgb(hex: u32) -> Colour {
    [16, 8, 0].map(|shift| {
        let v = (hex >> shift & 255) as f32 / 255.0;
        v * v
    })
}

/// A convex flat polygon with a texture.
#[derive(Clone, Debug)]
pub(crate) struct Face {
    /// Index of its first corner; corners lie in a row, counter-clockwise as seen
    /// from where the normal points to.
    pub(crate) first: usize,
    pub(crate) count: usize,
    /// Unit normal, to the visible side.
    pub(crate) normal: Vector3<f64>,
    /// Texture coordinate `s` in texels: `s.0 . p + s.1`; then `t`.
    pub(crate) s: (Vector3<f64>, f64),
    pub(crate) t: (Vector3<f64>, f64),
    pub(crate) skin: Skin,
    /// Lies on another face and is drawn over it.
    pub(crate) decal: bool,
    /// Large: the lamp's light is worked out for each pixel.
    pub(crate) large: bool,
    /// Takes shadows: a face of the ground.
    pub(crate) ground: bool,
}

/// Faces of a rigid body, in its own frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mesh {
    pub(crate) points: Vec<Point3<f64>>,
    pub(crate) faces: Vec<Face>,
    /// Corners of convex bodies that throw the shadow: each a list.
    pub(crate) hulls: Vec<Vec<Point3<f64>>>,
}

/// Short for a point.
pub(crate) const fn p(x: f64, y: f64, z: f64) -> Point3<f64> {
    Point3::new(x, y, z)
}

impl Mesh {
    /// A convex polygon, corners counter-clockwise as seen from outside. The texture
    /// lies level: `s` is horizontal, `t` goes down walls.
    pub(crate) fn polygon(&mut self, corners: &[Point3<f64>], skin: Skin) -> &mut Face {
        let normal = normal_of(corners);
        let (s, t) = if normal.z.abs() > 0.7 {
            (Vector3::x(), -Vector3::y())
        } else {
            let s = Vector3::z().cross(&normal).normalize();
            (s, s.cross(&normal).normalize())
        };
        let s = (s * skin.density, 0.0);
        let t = (t * skin.density, 0.0);
        self.push(corners, normal, s, t, skin)
    }

    /// A four-sided polygon that the texture fills, level with its middle lines: corners
    /// clockwise as seen from outside, top left, top right, bottom right, bottom left.
    pub(crate) fn filled(&mut self, corners: [Point3<f64>; 4], skin: Skin) -> &mut Face {
        let [a, b, c, d] = corners;
        let counter_clockwise = [a, d, c, b];
        let normal = normal_of(&counter_clockwise);
        let middle = Point3::from(0.25 * (a.coords + b.coords + c.coords + d.coords));
        let (right, down) = (0.5 * ((b - a) + (c - d)), 0.5 * ((d - a) + (c - b)));
        let along = |edge: Vector3<f64>| {
            let map = edge * (SIDE / edge.norm_squared());
            (map, 0.5 * SIDE - map.dot(&middle.coords))
        };
        self.push(&counter_clockwise, normal, along(right), along(down), skin)
    }

    fn push(
        &mut self,
        corners: &[Point3<f64>],
        normal: Vector3<f64>,
        s: (Vector3<f64>, f64),
        t: (Vector3<f64>, f64),
        skin: Skin,
    ) -> &mut Face {
        let first = self.points.len();
        let count = corners.len().min(MAX_EDGES);
        self.points.extend_from_slice(&corners[..count]);
        let (decal, large, ground) = (false, false, false);
        let at = self.faces.len();
        self.faces.push(Face { first, count, normal, s, t, skin, decal, large, ground });
        &mut self.faces[at]
    }

    /// A six-sided convex body: the four lower corners counter-clockwise from
    /// above, then the four upper ones. Skins for sides, top and bottom; side `i`
    /// starts at corner `i`. Its corners throw a shadow.
    pub(crate) fn hexahedron(&mut self, c: [Point3<f64>; 8], skins: &Hexa) {
        for i in 0..4 {
            let j = (i + 1) % 4;
            self.polygon(&[c[i], c[j], c[4 + j], c[4 + i]], skins.sides[i]);
        }
        self.polygon(&[c[4], c[5], c[6], c[7]], skins.top);
        self.polygon(&[c[3], c[2], c[1], c[0]], skins.bottom);
        self.hulls.push(c.to_vec());
    }

    /// An upright box turned by `yaw` about its middle: half length, half width,
    /// and from `z0` to `z1`.
    pub(crate) fn block(
        &mut self,
        middle: [f64; 2],
        half: [f64; 2],
        z: [f64; 2],
        yaw: f64,
        skins: &Hexa,
    ) {
        let corners = block_corners(middle, half, yaw);
        let at = |i: usize, z: f64| p(corners[i][0], corners[i][1], z);
        let c = std::array::from_fn(|i| at(i % 4, z[i / 4]));
        self.hexahedron(c, skins);
    }

    /// A round body on the axis through `middle`: `sides` flat sides between the
    /// two radii. `r1` 0 makes a cone's tip flat and tiny.
    pub(crate) fn frustum(
        &mut self,
        middle: [f64; 2],
        r: [f64; 2],
        z: [f64; 2],
        sides: usize,
        skin: Skin,
        top: Skin,
    ) {
        let sides = sides.clamp(3, MAX_EDGES);
        let ring = |level: usize, i: usize| {
            let (sin, cos) = (TAU * i as f64 / sides as f64).sin_cos();
            p(middle[0] + r[level] * cos, middle[1] + r[level] * sin, z[level])
        };
        for i in 0..sides {
            let quad = [ring(0, i), ring(0, i + 1), ring(1, i + 1), ring(1, i)];
            let mean = r[0].max(r[1]);
            let face = self.polygon(&quad, skin);
            // The texture goes on around.
            face.s.1 = i as f64 * TAU / sides as f64 * mean * skin.density;
        }
        let upper: Vec<_> = (0..sides).map(|i| ring(1, i)).collect();
        self.polygon(&upper, top);
        let mut hull: Vec<_> = (0..sides).map(|i| ring(0, i)).collect();
        hull.extend(&upper);
        self.hulls.push(hull);
    }

    /// A wheel about the y axis: radius, width, its outer side at `+y` or `-y`.
    pub(crate) fn wheel(&mut self, radius: f64, width: f64, outer: f64, tyre: Skin, rim: Skin) {
        let ring = |i: usize, y: f64| {
            let (sin, cos) = (TAU * i as f64 / MAX_EDGES as f64).sin_cos();
            p(radius * cos, y, -radius * sin)
        };
        let half = 0.5 * width;
        for i in 0..MAX_EDGES {
            let quad = [ring(i, -half), ring(i + 1, -half), ring(i + 1, half), ring(i, half)];
            let normal = normal_of(&quad);
            let along = (ring(i + 1, half) - ring(i, half)).normalize();
            let t = (along * tyre.density, (i * 23) as f64);
            self.push(&quad, normal, (Vector3::y() * tyre.density, 0.0), t, tyre);
        }
        for side in [-1.0, 1.0] {
            let skin = if side == outer { rim } else { tyre };
            // Counter-clockwise seen from -y is with i, as z goes down with it.
            let disc: [_; MAX_EDGES] = std::array::from_fn(|i| {
                ring(if side > 0.0 { i } else { MAX_EDGES - i }, side * half)
            });
            let map = 0.5 * SIDE / radius;
            let normal = Vector3::y() * side;
            let s = (Vector3::x() * map, 0.5 * SIDE);
            self.push(&disc, normal, s, (Vector3::z() * map, 0.5 * SIDE), skin);
        }
    }

    /// All of another mesh, moved.
    pub(crate) fn add(&mut self, other: &Self, pose: &realnet_core::Pose) {
        let shift = self.points.len();
        self.points.extend(other.points.iter().map(|point| pose.transform_point(point)));
        let turn = |(map, at): (Vector3<f64>, f64)| {
            let map = pose.transform_vector(&map);
            (map, at - map.dot(&pose.translation()))
        };
        self.faces.extend(other.faces.iter().map(|face| Face {
            first: face.first + shift,
            normal: pose.transform_vector(&face.normal),
            s: turn(face.s),
            t: turn(face.t),
            ..face.clone()
        }));
        let moved = |hull: &Vec<_>| hull.iter().map(|point| pose.transform_point(point)).collect();
        self.hulls.extend(other.hulls.iter().map(moved));
    }
}

/// Skins of a [`Mesh::hexahedron`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hexa {
    pub(crate) sides: [Skin; 4],
    pub(crate) top: Skin,
    pub(crate) bottom: Skin,
}

impl Hexa {
    pub(crate) const fn all(skin: Skin) -> Self {
        Self { sides: [skin; 4], top: skin, bottom: skin }
    }

    pub(crate) const fn topped(self, top: Skin) -> Self {
        Self { top, ..self }
    }
}

/// Corners of a rectangle, counter-clockwise.
pub(crate) fn block_corners(middle: [f64; 2], half: [f64; 2], yaw: f64) -> [[f64; 2]; 4] {
    let (sin, cos) = yaw.sin_cos();
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[a, b]| {
        let (x, y) = (a * half[0], b * half[1]);
        [middle[0] + x * cos - y * sin, middle[1] + x * sin + y * cos]
    })
}

/// Unit normal by Newell's sum, exact for axis-aligned faces.
fn normal_of(corners: &[Point3<f64>]) -> Vector3<f64> {
    let mut normal = Vector3::zeros();
    for (i, a) in corners.iter().enumerate() {
        let b = &corners[(i + 1) % corners.len()];
        normal += (a - corners[0]).cross(&(b - corners[0]));
    }
    normal.normalize()
}
