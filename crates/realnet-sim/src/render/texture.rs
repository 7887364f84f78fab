//! Procedural textures with mip levels: one channel, periodic in both directions.
//!
//! A surface turns the channel into a colour between its two own, so one texture
//! serves many surfaces. Each stored word holds a texel and its three neighbours to
//! the right and below: a bilinear sample is one load.

use std::sync::OnceLock;

/// Texels along each side of the finest level.
pub(crate) const SIDE: usize = 512;
/// Levels: 512 down to 2 texels.
pub(crate) const LEVELS: usize = 9;
/// Words kept for a texture: its levels, rounded up to a power of two.
pub(crate) const WORDS: usize = 1 << 19;

/// The words of one texture, all levels, the finest first.
pub(crate) type Words = [u32; WORDS];

/// Where a level starts in [`Words`].
pub(crate) const LEVEL_START: [u32; LEVELS] = {
    let mut start = [0u32; LEVELS];
    let mut level = 1;
    while level < LEVELS {
        let side = (SIDE >> (level - 1)) as u32;
        start[level] = start[level - 1] + side * side;
        level += 1;
    }
    start
};

/// The textures there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Texture {
    /// Faint specks on paint or plaster.
    Plain,
    /// Tufts and stains.
    Carpet,
    /// Four by four tiles with joints.
    Tiles,
    /// Planks with grain.
    Planks,
    /// Stones in tar, with cracks.
    Asphalt,
    /// Courses of bricks.
    Brick,
    /// Clouds of many sizes.
    Concrete,
    /// Eight by eight squares.
    Checker,
    /// Shapes of a printed poster.
    Poster,
    /// Paint of a vehicle: dust, seams, stickers.
    Paint,
    /// A rim with five spokes in a tyre; fills the texture.
    Wheel,
    /// A number plate; fills the texture.
    Plate,
    /// Blades of grass.
    Grass,
    /// Rows of windows in a front.
    Front,
    /// Stripes along t.
    Stripes,
    /// Books or goods on boards.
    Shelf,
}

const ALL: [Texture; 16] = [
    Texture::Plain,
    Texture::Carpet,
    Texture::Tiles,
    Texture::Planks,
    Texture::Asphalt,
    Texture::Brick,
    Texture::Concrete,
    Texture::Checker,
    Texture::Poster,
    Texture::Paint,
    Texture::Wheel,
    Texture::Plate,
    Texture::Grass,
    Texture::Front,
    Texture::Stripes,
    Texture::Shelf,
];

/// All textures, made once in a process and the same for every seed.
pub(crate) struct Atlas {
    words: Vec<u32>,
}

impl Atlas {
    /// The textures of this process.
    pub(crate) fn shared() -> &'static Self {
        static ATLAS: OnceLock<Atlas> = OnceLock::new();
        ATLAS.get_or_init(Self::new)
    }

    fn new() -> Self {
        let mut words = vec![0; WORDS * ALL.len()];
        for (texture, words) in ALL.iter().zip(words.chunks_exact_mut(WORDS)) {
            let mut level = finest(*texture);
            for (index, &start) in LEVEL_START.iter().enumerate() {
                let side = SIDE >> index;
                if index > 0 {
                    level = halved(&level, side);
                }
                pack(&level, side, &mut words[start as usize..]);
            }
        }
        Self { words }
    }

    /// The words of one texture.
    #[inline(always)]
    pub(crate) fn words(&self, texture: Texture) -> Option<&Words> {
        let start = texture as usize * WORDS;
        self.words.get(start..start + WORDS)?.first_chunk()
    }
}

fn halved(fine: &[f32], side: usize) -> Vec<f32> {
    let at = |x: usize, y: usize| fine[y * 2 * side + x];
    let mean = |x: usize, y: usize| {
        let (x, y) = (2 * x, 2 * y);
        0.25 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1))
    };
    (0..side * side).map(|i| mean(i % side, i / side)).collect()
}

fn pack(level: &[f32], side: usize, words: &mut [u32]) {
    let byte = |x: usize, y: usize| {
        let v = level[(y % side) * side + x % side];
        (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u32
    };
    for y in 0..side {
        for x in 0..side {
            words[y * side + x] =
                byte(x, y) | byte(x + 1, y) << 8 | byte(x, y + 1) << 16 | byte(x + 1, y + 1) << 24;
        }
    }
}

/// A number in 0 to 1 for a cell of a grid.
fn hash(x: i32, y: i32, seed: u32) -> f32 {
    let mut h = (x as u32).wrapping_mul(0x9E37_79B1)
        ^ (y as u32).wrapping_mul(0x85EB_CA77)
        ^ seed.wrapping_mul(0xC2B2_AE3D);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    h ^= h >> 15;
    (h >> 8) as f32 / (1 << 24) as f32
}

/// Value noise with a period of so many cells along x and y, smooth.
struct Noise {
    cells: (usize, usize),
    /// One column and row more, as the first.
    values: Vec<f32>,
}

impl Noise {
    fn new(cells: (usize, usize), seed: u32) -> Self {
        let (w, h) = cells;
        let value = |i: usize| hash((i % (w + 1) % w) as i32, (i / (w + 1) % h) as i32, seed);
        Self { cells, values: (0..(w + 1) * (h + 1)).map(value).collect() }
    }

    /// The value at a texel within the finest level.
    fn at(&self, x: f32, y: f32) -> f32 {
        let (w, h) = self.cells;
        let (u, v) = (x / SIDE as f32 * w as f32, y / SIDE as f32 * h as f32);
        let (iu, iv) = (u as usize, v as usize);
        let ease = |t: f32| t * t * (3.0 - 2.0 * t);
        let (a, b) = (ease(u - iu as f32), ease(v - iv as f32));
        let start = iv * (w + 1) + iu;
        let row =
            |start: usize| self.values[start] + (self.values[start + 1] - self.values[start]) * a;
        let (top, bottom) = (row(start), row(start + w + 1));
        top + (bottom - top) * b
    }
}

/// Noises from `cells` cells on, each of twice the cells and `gain` times the weight of
/// the last.
struct Octaves {
    list: Vec<(Noise, f32)>,
}

impl Octaves {
    fn new(cells: usize, count: u32, gain: f32, seed: u32) -> Self {
        let weight = |octave: u32| gain.powi(octave as i32);
        let all: f32 = (0..count).map(weight).sum();
        let noise = |octave: u32| Noise::new((cells << octave, cells << octave), seed + octave);
        Self { list: (0..count).map(|octave| (noise(octave), weight(octave) / all)).collect() }
    }

    fn at(&self, x: f32, y: f32) -> f32 {
        self.list.iter().map(|(noise, weight)| weight * noise.at(x, y)).sum()
    }
}

/// 1 inside, 0 outside, with an edge of `soft` texels around `distance` 0.
fn step(distance: f32, soft: f32) -> f32 {
    (0.5 - distance / soft).clamp(0.0, 1.0)
}

/// Distance from the joints of a grid of `w` x `h` texels, and the cell.
fn grid(x: f32, y: f32, w: f32, h: f32) -> (f32, i32, i32) {
    let (cx, cy) = ((x / w).floor(), (y / h).floor());
    let (dx, dy) = (x - cx * w, y - cy * h);
    (dx.min(w - dx).min(dy).min(h - dy), cx as i32, cy as i32)
}

/// The finest level from a value at each texel: `x`, `y` and a random speck.
fn drawn(value: impl Fn(f32, f32, f32) -> f32) -> Vec<f32> {
    let at = |i: usize| {
        let (x, y) = (i % SIDE, i / SIDE);
        value(x as f32 + 0.5, y as f32 + 0.5, hash(x as i32, y as i32, 7))
    };
    (0..SIDE * SIDE).map(at).collect()
}

fn finest(texture: Texture) -> Vec<f32> {
    match texture {
        Texture::Plain => {
            let specks = Octaves::new(4, 6, 0.8, 11);
            drawn(|x, y, speck| 0.42 + 0.2 * specks.at(x, y) - 0.05 * speck)
        }
        Texture::Carpet => {
            let (tuft, stain) = (Noise::new((170, 170), 21), Octaves::new(5, 4, 0.75, 23));
            drawn(|x, y, speck| {
                let stain = (2.6 * (stain.at(x, y) - 0.5) + 0.5).clamp(0.0, 1.0);
                0.10 + 0.28 * speck + 0.27 * tuft.at(x, y) + 0.35 * stain
            })
        }
        Texture::Tiles => {
            let veins = Octaves::new(8, 5, 0.75, 33);
            drawn(|x, y, speck| {
                let (d, cx, cy) = grid(x, y, 128.0, 128.0);
                let shade = 0.45 + 0.4 * hash(cx % 4, cy % 4, 31);
                let face = shade + 0.45 * (veins.at(x, y) - 0.5) + 0.10 * (speck - 0.5);
                face + (0.08 - face) * step(d - 2.5, 2.0)
            })
        }
        Texture::Planks => {
            let (long, fine) = (Noise::new((8, 180), 45), Noise::new((40, 160), 46));
            let knots = Octaves::new(12, 2, 0.5, 47);
            drawn(|x, y, speck| {
                let row = (y / 64.0).floor();
                let shift = 512.0 * hash(row as i32, 3, 41);
                let (d, cx, cy) = grid((x + shift).rem_euclid(512.0), y, 256.0, 64.0);
                let shade = 0.35 + 0.4 * hash(cx, cy, 43);
                let grain = long.at(x, y) - 0.5 + 0.8 * (fine.at(x, y) - 0.5);
                let knot = (knots.at(x, y) - 0.7).max(0.0) * -1.8;
                let face = shade + 0.30 * grain + knot + 0.10 * (speck - 0.5);
                face + (0.02 - face) * step(d - 1.2, 1.6)
            })
        }
        Texture::Asphalt => {
            let (stones, patches) = (Noise::new((200, 200), 51), Octaves::new(4, 5, 0.7, 53));
            let cracks = Octaves::new(6, 4, 0.5, 55);
            drawn(|x, y, speck| {
                let bright = hash(x as i32 / 2, y as i32 / 2, 52) > 0.965;
                let dark = 0.3 * step((cracks.at(x, y) - 0.5).abs() - 0.006, 0.01);
                let stone = if bright { 0.45 } else { 0.0 };
                let patch = 0.5 * (patches.at(x, y) - 0.3).max(0.0);
                0.12 + 0.3 * stones.at(x, y) + 0.12 * speck + stone + patch - dark
            })
        }
        Texture::Brick => {
            let grain = Octaves::new(32, 3, 0.7, 63);
            drawn(|x, y, speck| {
                let row = (y / 32.0).floor();
                let shift = if row as i32 % 2 == 0 { 0.0 } else { 42.667 };
                let (d, cx, cy) = grid((x + shift).rem_euclid(512.0), y, 85.333, 32.0);
                let shade = 0.15 + 0.5 * hash(cx % 6, cy, 61);
                let face = shade + 0.3 * (grain.at(x, y) - 0.5) + 0.1 * (speck - 0.5);
                face + (0.92 - 0.15 * speck - face) * step(d - 2.0, 2.0)
            })
        }
        Texture::Concrete => {
            let (clouds, grit) = (Octaves::new(3, 7, 0.8, 71), Noise::new((128, 128), 73));
            drawn(|x, y, speck| {
                let pit = if hash(x as i32 / 3, y as i32 / 3, 74) > 0.993 { 0.35 } else { 0.0 };
                let grit = 0.14 * (grit.at(x, y) - 0.5) + 0.10 * (speck - 0.5);
                2.0 * (clouds.at(x, y) - 0.5) + 0.5 + grit - pit
            })
        }
        Texture::Checker => {
            let dirt = Octaves::new(8, 4, 0.7, 75);
            drawn(|x, y, _| {
                let odd = ((x / 64.0) as i32 + (y / 64.0) as i32) % 2 == 1;
                (if odd { 0.88 } else { 0.12 }) + 0.2 * (dirt.at(x, y) - 0.5)
            })
        }
        Texture::Poster => {
            let ground = Noise::new((4, 6), 101);
            drawn(|x, y, _| poster(x, y, ground.at(x, y)))
        }
        Texture::Paint => {
            let dust = Octaves::new(6, 6, 0.8, 111);
            drawn(|x, y, speck| paint(x, y, speck, dust.at(x, y)))
        }
        Texture::Wheel => drawn(|x, y, _| wheel(x, y)),
        Texture::Plate => drawn(|x, y, _| plate(x, y)),
        Texture::Grass => {
            let (blades, patches) = (Noise::new((220, 70), 81), Octaves::new(4, 5, 0.7, 83));
            drawn(|x, y, speck| {
                0.1 + 0.4 * blades.at(x, y) + 0.25 * speck + 0.5 * (patches.at(x, y) - 0.25)
            })
        }
        Texture::Front => {
            let (glass, wall) = (Noise::new((8, 8), 88), Octaves::new(16, 4, 0.7, 89));
            drawn(|x, y, _| {
                let (d, cx, cy) = grid(x, y, 128.0, 128.0);
                let glass = 0.12 + 0.3 * hash(cx, cy, 87) + 0.1 * glass.at(x, y);
                let wall = 0.75 + 0.2 * (wall.at(x, y) - 0.5);
                let frame = step((d - 32.0).abs() - 2.5, 2.0);
                let face = wall + (glass - wall) * step(32.0 - d, 2.0);
                face + (1.0 - face) * frame
            })
        }
        Texture::Stripes => {
            let dirt = Octaves::new(8, 5, 0.75, 91);
            drawn(|x, y, _| {
                let odd = (x / 128.0) as i32 % 2 == 1;
                (if odd { 0.9 } else { 0.1 }) + 0.25 * (dirt.at(x, y) - 0.5)
            })
        }
        Texture::Shelf => drawn(shelf),
    }
}

fn shelf(x: f32, y: f32, speck: f32) -> f32 {
    let row = (y / 128.0) as i32;
    let down = y - 128.0 * row as f32;
    if down < 10.0 {
        return 0.55 + 0.1 * speck;
    }
    let slot = (x / 16.0 + 3.0 * hash((x / 64.0) as i32, row, 93)).floor() as i32 % 32;
    let tall = 20.0 + 50.0 * hash(slot, row, 95);
    if down < tall { 0.03 } else { 0.15 + 0.8 * hash(slot, row, 97) + 0.05 * (speck - 0.5) }
}

fn poster(x: f32, y: f32, ground: f32) -> f32 {
    let mut v = 0.75 + 0.25 * ground;
    for shape in 0..14 {
        let pick = |k: i32| hash(shape, k, 103);
        let (cx, cy, size) = (512.0 * pick(0), 512.0 * pick(1), 25.0 + 90.0 * pick(2));
        let distance = if pick(3) < 0.5 {
            (x - cx).hypot(y - cy) - size
        } else {
            ((x - cx).abs() - size).max((y - cy).abs() - 0.6 * size)
        };
        v += (pick(4) - v) * step(distance, 2.0);
    }
    // Lines of text.
    if y > 330.0 && y < 480.0 && x > 40.0 && x < 470.0 {
        let line = (y / 24.0) as i32;
        let ink = hash((x / 7.0) as i32, line, 107) > 0.35 && y % 24.0 < 13.0;
        v = if ink { 0.05 } else { 0.85 };
    }
    let edge = x.min(y).min(512.0 - x).min(512.0 - y);
    v + (1.0 - v) * step(edge - 12.0, 2.0)
}

fn paint(x: f32, y: f32, speck: f32, dust: f32) -> f32 {
    let mut v = 0.66 + 0.5 * (dust - 0.5) + 0.06 * (speck - 0.5);
    let (seam, ..) = grid(x, y, 170.667, 128.0);
    v -= 0.35 * step(seam - 1.0, 1.5);
    for shape in 0..26 {
        let pick = |k: i32| hash(shape, k, 113);
        let (cx, cy) = (512.0 * pick(0), 512.0 * pick(1));
        let (w, h) = (6.0 + 26.0 * pick(2), 4.0 + 12.0 * pick(3));
        let shade = if pick(4) < 0.55 { 0.05 } else { 1.0 };
        v += (shade - v) * step(((x - cx).abs() - w).max((y - cy).abs() - h), 1.5);
    }
    v
}

fn wheel(x: f32, y: f32) -> f32 {
    let (dx, dy) = (x - 256.0, y - 256.0);
    let r = dx.hypot(dy) / 256.0;
    let angle = dy.atan2(dx).rem_euclid(std::f32::consts::TAU);
    let part = (angle * 5.0 / std::f32::consts::TAU).fract();
    let spoke = (part - 0.5).abs() * r;
    let rim = step((r - 0.62).abs() - 0.06, 0.02);
    let arms = step(spoke - 0.10, 0.02) * step(r - 0.62, 0.02);
    let hub = step(r - 0.16, 0.02);
    let nut = step(r - 0.06, 0.02);
    let tyre = 0.07 + 0.05 * hash((angle * 20.0) as i32, (r * 9.0) as i32, 121);
    // A valve, so that a turn can be seen whole.
    let valve = step((dx - 110.0).hypot(dy - 80.0) - 12.0, 2.0);
    let metal = rim.max(arms).max(hub) * (1.0 - 0.8 * nut);
    (tyre + (0.85 - tyre) * metal).max(0.6 * valve)
}

fn plate(x: f32, y: f32) -> f32 {
    let edge = x.min(y).min(512.0 - x).min(512.0 - y);
    if edge < 18.0 {
        return 0.05;
    }
    // Seven-segment figures: R N 4 8 1 5.
    const LIT: [u8; 6] = [0b111_0111, 0b011_0111, 0b110_0110, 0b111_1111, 0b000_0110, 0b110_1101];
    let slot = ((x - 34.0) / 74.0).floor();
    let (u, v) = ((x - 34.0 - 74.0 * slot) / 60.0, (y - 110.0) / 290.0);
    if !(0.0..6.0).contains(&slot) || !(0.0..=1.0).contains(&u) || !(0.0..=1.0).contains(&v) {
        return 0.95;
    }
    let lit = LIT.get(slot as usize).copied().unwrap_or(0);
    let (left, right) = (u < 0.27, u > 0.73);
    let (top, low, middle) = (v < 0.16, v > 0.84, (v - 0.5).abs() < 0.08);
    let upper = v < 0.5;
    let segments =
        [top, right && upper, right && !upper, low, left && !upper, left && upper, middle];
    let ink = segments.iter().enumerate().any(|(bit, &here)| here && lit >> bit & 1 == 1);
    if ink { 0.05 } else { 0.95 }
}
