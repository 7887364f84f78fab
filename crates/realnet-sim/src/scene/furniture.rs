//! Things that stand about.

use super::mesh::{Colour, Hexa, Mesh, Skin, p, scaled, srgb};
use crate::render::Texture;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

/// A thing around its own origin: shape, half size of its footprint, height.
pub(super) struct Thing {
    pub(super) mesh: Mesh,
    pub(super) half: [f64; 2],
    pub(super) height: f64,
}

/// A number between two.
pub(super) fn between(rng: &mut Pcg64Mcg, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// One of several.
pub(super) fn one_of<T: Copy>(rng: &mut Pcg64Mcg, list: &[T]) -> T {
    let index = (rng.random::<f64>() * list.len() as f64) as usize;
    list[index.min(list.len() - 1)]
}

/// A colour of moderate strength.
pub(super) fn colour(rng: &mut Pcg64Mcg) -> Colour {
    const COLOURS: [u32; 12] = [
        0xb03a2e, 0x2e6fb0, 0x3c8c4c, 0xd0a030, 0x7a5aa0, 0x2a9a98, 0xc06a2a, 0xd8d4c8, 0x50545c,
        0xb04a78, 0x8a9a3a, 0x303a58,
    ];
    let base = srgb(one_of(rng, &COLOURS));
    scaled(base, between(rng, 0.7, 1.2) as f32)
}

fn two_tone(texture: Texture, colour: Colour, density: f64) -> Skin {
    Skin::new(texture, scaled(colour, 0.35), scaled(colour, 1.45), density)
}

/// A cardboard box with tape and a label.
pub(super) fn carton(rng: &mut Pcg64Mcg) -> Thing {
    let half = [between(rng, 0.12, 0.30), between(rng, 0.10, 0.25)];
    let height = between(rng, 0.15, 0.5);
    let board = Skin::new(Texture::Concrete, srgb(0x7a5836), srgb(0xd2a878), 420.0);
    let mut mesh = Mesh::default();
    mesh.block([0.0, 0.0], half, [0.0, height], 0.0, &Hexa::all(board));
    let tape = Skin::new(Texture::Plain, srgb(0xb0946a), srgb(0xf0e0b8), 600.0);
    mesh.filled(
        [
            p(-half[0], 0.03, height),
            p(half[0], 0.03, height),
            p(half[0], -0.03, height),
            p(-half[0], -0.03, height),
        ],
        tape,
    )
    .decal = true;
    let label = Skin::new(Texture::Poster, srgb(0x202428), srgb(0xf4f4f0), 1.0);
    let (w, top, low) = (0.6 * half[1], 0.8 * height, 0.3 * height);
    for side in [-1.0, 1.0] {
        let at = |y: f64, z: f64| p(side * half[0], side * y, z);
        mesh.filled([at(-w, top), at(w, top), at(w, low), at(-w, low)], label).decal = true;
        let at = |x: f64, z: f64| p(-side * x, side * half[1], z);
        let w = 0.5 * half[0];
        mesh.filled([at(-w, top), at(w, top), at(w, low), at(-w, low)], label).decal = true;
    }
    Thing { mesh, half, height }
}

/// A bin or barrel.
fn barrel(rng: &mut Pcg64Mcg) -> Thing {
    let (radius, height) = (between(rng, 0.12, 0.25), between(rng, 0.3, 0.7));
    let texture = one_of(rng, &[Texture::Stripes, Texture::Concrete, Texture::Paint]);
    let skin = two_tone(texture, colour(rng), 400.0);
    let lid = Skin::plain(srgb(0x2c2c30));
    let mut mesh = Mesh::default();
    mesh.frustum([0.0, 0.0], [0.9 * radius, radius], [0.0, height], 12, skin, lid);
    Thing { mesh, half: [radius, radius], height }
}

/// A table or stool: a board on four legs.
fn table(rng: &mut Pcg64Mcg) -> Thing {
    let half = [between(rng, 0.25, 0.6), between(rng, 0.22, 0.4)];
    let height = between(rng, 0.42, 0.75);
    let wood = Skin::new(Texture::Planks, srgb(0x4a3018), srgb(0xc8965a), 300.0);
    let leg = Hexa::all(Skin::plain(srgb(0x60616a)));
    let mut mesh = Mesh::default();
    mesh.block([0.0, 0.0], half, [height - 0.03, height], 0.0, &Hexa::all(wood));
    for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
        let middle = [x * (half[0] - 0.04), y * (half[1] - 0.04)];
        mesh.block(middle, [0.022, 0.022], [0.0, height - 0.03], 0.0, &leg);
    }
    Thing { mesh, half, height }
}

/// A set of shelves, full.
pub(super) fn shelves(rng: &mut Pcg64Mcg, length: f64, height: f64) -> Thing {
    let half = [0.5 * length, between(rng, 0.14, 0.22)];
    let side = Skin::new(Texture::Planks, srgb(0x50371f), srgb(0xb98a55), 300.0);
    let goods = Skin::new(Texture::Shelf, srgb(0x201612), colour(rng), 300.0);
    let skins = Hexa { sides: [goods, side, goods, side], top: side, bottom: side };
    let mut mesh = Mesh::default();
    mesh.block([0.0, 0.0], half, [0.0, height], 0.0, &skins);
    Thing { mesh, half, height }
}

/// A sofa: seat, back and arms.
fn sofa(rng: &mut Pcg64Mcg) -> Thing {
    let half = [between(rng, 0.55, 0.9), 0.38];
    let cloth = Hexa::all(two_tone(Texture::Carpet, colour(rng), 320.0));
    let mut mesh = Mesh::default();
    mesh.block([0.0, 0.0], [half[0], half[1]], [0.06, 0.38], 0.0, &cloth);
    mesh.block([0.0, 0.28], [half[0], 0.10], [0.38, 0.75], 0.0, &cloth);
    for side in [-1.0, 1.0] {
        let middle = [side * (half[0] - 0.08), -0.06];
        mesh.block(middle, [0.08, 0.30], [0.38, 0.55], 0.0, &cloth);
    }
    Thing { mesh, half, height: 0.75 }
}

/// A plant in a pot: a pot and two cones of leaves.
fn plant(rng: &mut Pcg64Mcg) -> Thing {
    let (radius, height) = (between(rng, 0.12, 0.2), between(rng, 0.6, 1.1));
    let pot = two_tone(Texture::Concrete, srgb(0x9c5a3c), 500.0);
    let leaves = Skin::new(Texture::Grass, srgb(0x0a2408), srgb(0x68b048), 400.0);
    let mut mesh = Mesh::default();
    mesh.frustum([0.0, 0.0], [0.7 * radius, radius], [0.0, 0.28], 10, pot, pot);
    let wide = 1.3 * radius;
    mesh.frustum([0.0, 0.0], [0.3 * wide, wide], [0.30, 0.30 + 0.4 * height], 9, leaves, leaves);
    mesh.frustum([0.0, 0.0], [wide, 0.2 * wide], [0.30 + 0.4 * height, height], 9, leaves, leaves);
    Thing { mesh, half: [wide, wide], height }
}

/// A traffic cone.
pub(super) fn cone(rng: &mut Pcg64Mcg) -> Thing {
    let scale = between(rng, 0.6, 1.2);
    let (radius, height) = (0.11 * scale, 0.42 * scale);
    let orange = Skin::new(Texture::Plain, srgb(0xb03a08), srgb(0xff7020), 500.0);
    let white = Skin::plain(srgb(0xe8e8e8));
    let foot = Skin::plain(srgb(0x28282a));
    let mut mesh = Mesh::default();
    mesh.block([0.0, 0.0], [1.2 * radius, 1.2 * radius], [0.0, 0.03], 0.0, &Hexa::all(foot));
    let at = |share: f64| radius * (1.0 - 0.85 * share);
    for (low, high, skin) in [(0.0, 0.35, orange), (0.35, 0.6, white), (0.6, 1.0, orange)] {
        let z = [0.03 + low * height, 0.03 + high * height];
        mesh.frustum([0.0, 0.0], [at(low), at(high)], z, 10, skin, skin);
    }
    Thing { mesh, half: [1.2 * radius, 1.2 * radius], height: 0.03 + height }
}

/// A stack of tyres.
fn tyres(rng: &mut Pcg64Mcg) -> Thing {
    let radius = between(rng, 0.22, 0.32);
    let count = 1 + (between(rng, 0.0, 3.0) as usize);
    let mut mesh = Mesh::default();
    let dark = Skin::new(Texture::Asphalt, srgb(0x0c0c0c), srgb(0x585858), 450.0);
    let paint = two_tone(Texture::Concrete, colour(rng), 450.0);
    for i in 0..count {
        let z = 0.19 * i as f64;
        let skin = if i % 2 == 0 { dark } else { paint };
        mesh.frustum([0.0, 0.0], [0.93 * radius, radius], [z, z + 0.09], 12, skin, skin);
        mesh.frustum([0.0, 0.0], [radius, 0.93 * radius], [z + 0.09, z + 0.18], 12, skin, skin);
    }
    Thing { mesh, half: [radius, radius], height: 0.19 * count as f64 }
}

/// A board with an advertisement on two posts.
fn board(rng: &mut Pcg64Mcg) -> Thing {
    let half = [between(rng, 0.5, 1.0), 0.04];
    let height = between(rng, 0.7, 1.0);
    let colours = [colour(rng), srgb(0xf0f0f0)];
    let print = Skin::new(Texture::Poster, colours[0], colours[1], 1.0);
    let back = Skin::plain(srgb(0x808488));
    let mut mesh = Mesh::default();
    mesh.block([0.0, 0.0], half, [0.15, height], 0.0, &Hexa::all(back));
    for side in [-1.0, 1.0] {
        let at = |x: f64, z: f64| p(-side * x, side * half[1], z);
        let (w, top) = (half[0] - 0.03, height - 0.03);
        mesh.filled([at(-w, top), at(w, top), at(w, 0.18), at(-w, 0.18)], print).decal = true;
        let middle = [side * 0.8 * half[0], 0.0];
        mesh.block(middle, [0.03, 0.03], [0.0, 0.15], 0.0, &Hexa::all(back));
    }
    Thing { mesh, half, height }
}

/// A pillar from floor to ceiling.
pub(super) fn pillar(rng: &mut Pcg64Mcg, height: f64) -> Thing {
    let half = between(rng, 0.15, 0.3);
    let body = Skin::new(Texture::Concrete, srgb(0x6a6864), srgb(0xd6d2ca), 260.0);
    let foot = Skin::new(Texture::Stripes, srgb(0x181818), srgb(0xe8c020), 800.0);
    let mut mesh = Mesh::default();
    mesh.block([0.0, 0.0], [half; 2], [0.9, height], 0.0, &Hexa::all(body));
    mesh.block([0.0, 0.0], [half + 0.01; 2], [0.0, 0.9], 0.0, &Hexa::all(foot));
    Thing { mesh, half: [half + 0.01; 2], height }
}

/// Something for a living room or corridor.
pub(super) fn indoor(rng: &mut Pcg64Mcg) -> Thing {
    match (rng.random::<f64>() * 10.0) as u32 {
        0..=3 => carton(rng),
        4 => barrel(rng),
        5 => table(rng),
        6 => sofa(rng),
        7 => plant(rng),
        8 => cone(rng),
        _ => {
            let (length, height) = (between(rng, 0.6, 1.2), between(rng, 0.8, 1.9));
            shelves(rng, length, height)
        }
    }
}

/// Something for a hall.
pub(super) fn industrial(rng: &mut Pcg64Mcg, ceiling: f64) -> Thing {
    match (rng.random::<f64>() * 8.0) as u32 {
        0..=2 => carton(rng),
        3 => barrel(rng),
        4 => pillar(rng, ceiling),
        5 => cone(rng),
        6 => board(rng),
        _ => {
            let (length, height) = (between(rng, 1.2, 3.0), between(rng, 1.8, 3.0));
            shelves(rng, length, height)
        }
    }
}

/// Something beside a track.
pub(super) fn outdoor(rng: &mut Pcg64Mcg) -> Thing {
    match (rng.random::<f64>() * 8.0) as u32 {
        0..=2 => cone(rng),
        3..=4 => tyres(rng),
        5 => board(rng),
        6 => plant(rng),
        _ => barrel(rng),
    }
}
