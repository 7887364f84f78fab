//! A made-up room, seen by a camera that moves: a wall, a board before it and a
//! square that rests or moves, with true depth, poses and boxes.

use image::{ImageBuffer, Luma};
use realnet::{Frame, Stamp, picture};
use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};
use tempfile::{TempDir, tempdir};

pub const WIDTH: u32 = 160;
pub const HEIGHT: u32 = 120;
/// Focal length, pixels.
const F: f64 = 140.0;
/// Frames of the room, and the number of the first.
pub const FRAMES: u64 = 25;
pub const FIRST: u64 = 100;
/// Half the side of the square, metres.
const HALF: f64 = 0.28;

/// A texture: random values on a lattice of one unit, smooth in between.
fn texture(seed: i64, x: f64, y: f64) -> f64 {
    let value = |x: i64, y: i64| {
        let mut h = (x.wrapping_mul(374_761_393) ^ y.wrapping_mul(668_265_263)) + seed * 97;
        h = (h ^ (h >> 13)).wrapping_mul(1_274_126_177);
        ((h ^ (h >> 16)) & 0xff) as f64
    };
    let (u, v) = (x.floor(), y.floor());
    let (s, t) = (x - u, y - v);
    let (u, v) = (u as i64, v as i64);
    let row = |v| value(u, v) * (1.0 - s) + value(u + 1, v) * s;
    30.0 + 0.75 * (row(v) * (1.0 - t) + row(v + 1) * t)
}

/// Where the camera is at frame `k`: its place, and its turn to the right.
pub fn camera(k: f64) -> ([f64; 3], f64) {
    ([0.008 * k - 0.1, 0.004 * k, 0.025 * k], (0.15 * k - 1.8).to_radians())
}

/// Whether the square moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Square {
    Resting,
    Moving,
}

impl Square {
    /// Its centre at frame `k`.
    pub fn center(self, k: f64) -> [f64; 3] {
        match self {
            Self::Resting => [-0.05, 0.05, 1.6],
            Self::Moving => [0.016 * k - 0.1, 0.05, 1.5 + 0.01 * k],
        }
    }
}

/// A pixel of the camera's picture at `k`, and its depth in millimetres: a wall, a
/// board before it, and the square.
pub fn look(square: Square, k: f64, u: f64, v: f64) -> (f64, u16) {
    let (place, turn) = camera(k);
    let (x, y) = ((u - 79.5) / F, (v - 59.5) / F);
    let (sin, cos) = turn.sin_cos();
    let ray = [x * cos + sin, y, cos - x * sin];
    let meet = |z: f64| {
        let depth = (z - place[2]) / ray[2];
        (place[0] + depth * ray[0], place[1] + depth * ray[1], depth)
    };
    let mm = |depth: f64| (depth * 1000.0).round() as u16;
    let center = square.center(k);
    let (x, y, depth) = meet(center[2]);
    let (x, y) = (x - center[0], y - center[1]);
    if x.abs() < HALF && y.abs() < HALF {
        return (texture(1, x / 0.06, y / 0.06), mm(depth));
    }
    let (x, y, depth) = meet(2.3);
    if (-1.1..-0.45).contains(&x) && (-0.5..0.6).contains(&y) {
        return (texture(2, x / 0.1, y / 0.1), mm(depth));
    }
    let (x, y, depth) = meet(3.2);
    (texture(3, x / 0.14, y / 0.14), mm(depth))
}

/// The pixels of frame `k`, row by row, see [`look`].
pub fn pixels(square: Square, k: u64) -> impl Iterator<Item = (f64, u16)> {
    let places = (0..HEIGHT).flat_map(|v| (0..WIDTH).map(move |u| (f64::from(u), f64::from(v))));
    places.map(move |(u, v)| look(square, k as f64, u, v))
}

/// Writes colour and depth of frame `k`; depths in units of `1 / scale` metres.
pub fn write_frame(square: Square, k: u64, color: &Path, depth: &Path, scale: u16) {
    let grey = pixels(square, k).map(|(grey, _)| grey as u8).collect();
    let grey = Frame::grey8(Stamp::ZERO, WIDTH, HEIGHT, grey).unwrap();
    picture::write(color, &grey.to_rgb()).unwrap();
    let units = pixels(square, k).map(|(_, mm)| mm * (scale / 1000)).collect();
    ImageBuffer::<Luma<u16>, Vec<u16>>::from_raw(WIDTH, HEIGHT, units)
        .unwrap()
        .save(depth)
        .unwrap();
}

/// A picture without any texture.
pub fn blank(path: &Path) {
    crate::common::tiny::picture(path, WIDTH, HEIGHT, 90);
}

/// The room in the layout of 7-Scenes, in a folder of its own.
pub struct Room {
    folder: TempDir,
}

impl Room {
    pub fn new(square: Square, frames: u64) -> Self {
        let room = Self { folder: tempdir().unwrap() };
        std::fs::create_dir(room.path("seq")).unwrap();
        for k in 0..frames {
            write_frame(square, k, &room.color(k), &room.depth(k), 1000);
            let ([x, y, z], turn) = camera(k as f64);
            let (sin, cos) = turn.sin_cos();
            let pose = format!("{cos} 0 {sin} {x}\n0 1 0 {y}\n{} 0 {cos} {z}\n0 0 0 1\n", -sin);
            std::fs::write(room.part(k, "pose.txt"), pose).unwrap();
        }
        room
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn part(&self, k: u64, part: &str) -> PathBuf {
        self.path(&format!("seq/frame-{:06}.{part}", FIRST + k))
    }

    pub fn color(&self, k: u64) -> PathBuf {
        self.part(k, "color.png")
    }

    pub fn depth(&self, k: u64) -> PathBuf {
        self.part(k, "depth.png")
    }

    /// The square's boxes as CSV.
    pub fn boxes(&self) -> PathBuf {
        let mut text = "frame,x0,y0,x1,y1\n".to_owned();
        for k in 0..FRAMES {
            let ((place, turn), center) = (camera(k as f64), Square::Moving.center(k as f64));
            let (sin, cos) = turn.sin_cos();
            let corner = |dx: f64, dy: f64| {
                let [x, y, z] = [0, 1, 2].map(|i| center[i] - place[i]);
                let (x, y) = (x + dx * HALF, y + dy * HALF);
                let (x, z) = (x * cos - z * sin, x * sin + z * cos);
                // Edges of pixels: the middle of the first is at 0.5.
                [F * x / z + 80.0, F * y / z + 60.0]
            };
            let corners =
                [corner(-1.0, -1.0), corner(1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0)];
            let ends = |i: usize| {
                let values = corners.map(|c| c[i]);
                (
                    values.iter().copied().fold(f64::INFINITY, f64::min),
                    values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
                )
            };
            let ((x0, x1), (y0, y1)) = (ends(0), ends(1));
            writeln!(text, "{},{x0},{y0},{x1},{y1}", FIRST + k).unwrap();
        }
        let path = self.path("boxes.csv");
        std::fs::write(&path, text).unwrap();
        path
    }
}
