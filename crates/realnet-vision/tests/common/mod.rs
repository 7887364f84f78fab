//! The textured picture of `bench/peers/flow/golden.py`.

use realnet_core::{Frame, Stamp};

/// Hashed grey values on grids of 32, 16, 8 and 4 pixels, bilinear between them,
/// at positions moved by `warp` (in 1/16 pixel, from picture to texture).
pub fn warped(width: u32, height: u32, seed: i64, warp: impl Fn(i64, i64) -> (i64, i64)) -> Frame {
    let mut data = Vec::with_capacity(width as usize * height as usize);
    for y in 0..i64::from(height) {
        for x in 0..i64::from(width) {
            let (x, y) = warp(x * 16, y * 16);
            let (x, y) = (x + (1 << 16), y + (1 << 16));
            let mut total = 0;
            for (octave, (cell, weight)) in
                [(512, 5), (256, 5), (128, 4), (64, 2)].iter().enumerate()
            {
                let (cx, cy, fx, fy) = (x / cell, y / cell, x % cell, y % cell);
                let value = |i: i64, j: i64| {
                    let key = (octave as i64 * 31 + seed) * 2_246_822_519;
                    let h = i * 374_761_393 + j * 668_265_263 + key;
                    let h = h & 0xffff_ffff;
                    let h = ((h ^ (h >> 13)) * 1_274_126_177) & 0xffff_ffff;
                    (h ^ (h >> 16)) & 255
                };
                let top = value(cx, cy) * (cell - fx) + value(cx + 1, cy) * fx;
                let bottom = value(cx, cy + 1) * (cell - fx) + value(cx + 1, cy + 1) * fx;
                total += weight * ((top * (cell - fy) + bottom * fy) / (cell * cell));
            }
            data.push((total / 16) as u8);
        }
    }
    Frame::grey8(Stamp::ZERO, width, height, data).unwrap()
}

/// The texture moved by whole sixteenths of a pixel.
pub fn shifted(width: u32, height: u32, (dx, dy): (i64, i64)) -> Frame {
    warped(width, height, 1, |x, y| (x - dx, y - dy))
}
