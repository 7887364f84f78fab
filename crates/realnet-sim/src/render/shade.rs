//! The loops over the pixels of a tile: which surface is seen, and its light.
#![allow(
    clippy::needless_range_loop,
    reason = "loops over the lanes of several arrays at once, for the compiler to vectorise"
)]

use super::bins::Entry;
use super::canvas::{Canvas, Lane, Rays, TILE, TILE_H, TILE_W};
use super::shadow::Shadow;
use super::surface::Surface;
use super::texture::{Atlas, LEVELS, SIDE, WORDS, Words};
use crate::scene::mesh::Colour;
use realnet_vision::simd::multiversion;

/// A decal is drawn where its depth is within this share of what is there.
const DECAL: f32 = 1.0 + 2e-3;
/// Adding this to a float below 2^22 leaves its nearest whole number in the low bits.
const MAGIC: f32 = 12_582_912.0;
/// What the shift of the levels' starts is divided by 3 with, exactly.
const THIRD: u32 = 0xAAAA_AAAB;

/// The sky, in the optical frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sky {
    /// Sine of the elevation of a ray is this times the ray over its length.
    pub(super) up: [f32; 3],
    pub(super) horizon: Colour,
    pub(super) top: Colour,
}

/// What the loops need besides buffers.
pub(super) struct Stage<'a> {
    pub(super) rays: &'a Rays,
    pub(super) surfaces: &'a [Surface],
    pub(super) shadows: &'a [Shadow],
    pub(super) atlas: &'a Atlas,
    pub(super) sky: Option<Sky>,
}

multiversion! {
/// Draws one tile: `entries` are its surfaces, solid ones before decals, and `shades`
/// its shadows.
pub(super) fn draw_tile(
    stage: &Stage<'_>,
    tile: usize,
    entries: &[Entry],
    shades: &[Entry],
    canvas: &mut Canvas,
) {
    let mut inverse = [0.0f32; TILE];
    let mut ids = [0u32; TILE];
    let start = stage.rays.tile_start(tile);
    let stride = stage.rays.stride;
    for entry in entries {
        if let Some(surface) = stage.surfaces.get(entry.index as usize) {
            cover(stage.rays, start, surface, entry, &mut inverse, &mut ids);
        }
    }
    for row in 0..TILE_H {
        let at = start + row * stride;
        let step = stage.rays.steps[(at / stride) * stage.rays.tiles_x + tile % stage.rays.tiles_x];
        let (rx, ry) = (lane(&stage.rays.x, at), lane(&stage.rays.y, at));
        let id = lane(&ids, row * TILE_W);
        let mut out = [[0.0f32; TILE_W]; 3];
        let mut done = 0u32;
        while done != 0xFFFF {
            let first = (!done).trailing_zeros() as usize;
            let wanted = id[first.min(TILE_W - 1)];
            let mut here = 0u32;
            for i in 0..TILE_W {
                here |= u32::from(id[i] == wanted) << i;
            }
            done |= here;
            let lit = match stage.surfaces.get((wanted & 0xFFFF) as usize) {
                Some(surface) if wanted != 0 => {
                    shade(stage, surface, shades, rx, ry, step, here)
                }
                _ => background(stage.sky, rx, ry),
            };
            for c in 0..3 {
                for i in 0..TILE_W {
                    out[c][i] = if id[i] == wanted { lit[c][i] } else { out[c][i] };
                }
            }
        }
        store(&mut canvas.inverse, at, lane(&inverse, row * TILE_W));
        store(&mut canvas.id, at, id);
        for c in 0..3 {
            store(&mut canvas.light[c], at, &out[c]);
        }
    }
}
}

multiversion! {
/// Marks the pixels of a tile that a surface covers, whatever is before it.
pub(super) fn mark_tile(
    rays: &Rays,
    tile: usize,
    surface: &Surface,
    entry: &Entry,
    hits: &mut [u8; TILE],
) {
    let start = rays.tile_start(tile);
    for row in 0..TILE_H {
        let at = start + row * rays.stride;
        let (rx, ry) = (lane(&rays.x, at), lane(&rays.y, at));
        let here = linear(surface.inverse, rx, ry);
        let least = least_side(surface, entry, rx, ry);
        for i in 0..TILE_W {
            hits[row * TILE_W + i] |= u8::from((least[i] >= 0.0) & (here[i] > 0.0));
        }
    }
}
}

#[inline(always)]
fn lane<T: Copy>(buffer: &[T], at: usize) -> &Lane<T> {
    match buffer.get(at..).and_then(|rest| rest.first_chunk()) {
        Some(lane) => lane,
        // Buffers are padded to whole tiles.
        None => unreachable!("a row of a tile lies inside of its buffer"),
    }
}

#[inline(always)]
fn store<T: Copy>(buffer: &mut [T], at: usize, values: &Lane<T>) {
    if let Some(lane) = buffer.get_mut(at..).and_then(|rest| rest.first_chunk_mut()) {
        *lane = *values;
    }
}

/// `a x + b y + c` on the rays of a row.
#[inline(always)]
fn linear([a, b, c]: [f32; 3], rx: &Lane, ry: &Lane) -> Lane {
    let mut out = [0.0; TILE_W];
    for i in 0..TILE_W {
        out[i] = a * rx[i] + b * ry[i] + c;
    }
    out
}

/// Not negative inside of all edges that cross the tile.
#[inline(always)]
fn least_side(surface: &Surface, entry: &Entry, rx: &Lane, ry: &Lane) -> Lane {
    let mut least = [0.0f32; TILE_W];
    let mut left = entry.edges;
    while left != 0 {
        let edge = left.trailing_zeros() as usize;
        left &= left - 1;
        let side = linear(surface.edges[edge % surface.edges.len()], rx, ry);
        for i in 0..TILE_W {
            least[i] = if side[i] < least[i] { side[i] } else { least[i] };
        }
    }
    least
}

/// Keeps a surface where it is nearest.
#[inline(always)]
fn cover(
    rays: &Rays,
    start: usize,
    surface: &Surface,
    entry: &Entry,
    inverse: &mut [f32; TILE],
    ids: &mut [u32; TILE],
) {
    let id = u32::from(entry.index) | u32::from(surface.instance) << 16;
    let closer = if surface.decal { DECAL } else { 1.0 };
    for row in 0..TILE_H {
        let at = start + row * rays.stride;
        let (rx, ry) = (lane(&rays.x, at), lane(&rays.y, at));
        let here = linear(surface.inverse, rx, ry);
        let least = least_side(surface, entry, rx, ry);
        for i in 0..TILE_W {
            let k = row * TILE_W + i;
            let seen = (least[i] >= 0.0) & (here[i] * closer > inverse[k]);
            ids[k] = if seen { id } else { ids[k] };
            inverse[k] = if seen & !surface.decal { here[i] } else { inverse[k] };
        }
    }
}

/// Light of the sky, or of nothing.
#[inline(always)]
fn background(sky: Option<Sky>, rx: &Lane, ry: &Lane) -> [Lane; 3] {
    let mut out = [[0.0; TILE_W]; 3];
    let Some(Sky { up, horizon, top }) = sky else { return out };
    let height = linear(up, rx, ry);
    for i in 0..TILE_W {
        let length = (rx[i] * rx[i] + ry[i] * ry[i] + 1.0).sqrt();
        let sine = height[i] / length;
        let sine = if sine > 0.0 { sine } else { 0.0 };
        let share = 1.0 - 1.0 / (1.0 + 5.0 * sine);
        for c in 0..3 {
            out[c][i] = horizon[c] + (top[c] - horizon[c]) * share;
        }
    }
    out
}

/// Light of a surface on a row of pixels; `here` are those it is seen at.
#[inline(always)]
fn shade(
    stage: &Stage<'_>,
    surface: &Surface,
    shades: &[Entry],
    rx: &Lane,
    ry: &Lane,
    step: [f32; 4],
    here: u32,
) -> [Lane; 3] {
    let mut depth = linear(surface.inverse, rx, ry);
    for i in 0..TILE_W {
        depth[i] = 1.0 / depth[i];
    }
    let value = match stage.atlas.words(surface.texture) {
        Some(words) => textured(surface, words, rx, ry, &depth, step, here),
        None => [0.5; TILE_W],
    };
    let mut out = [[0.0; TILE_W]; 3];
    let mut light = [1.0f32; TILE_W];
    if surface.large {
        light = lamp_light(stage, surface, shades, rx, ry, &depth);
    }
    for c in 0..3 {
        for i in 0..TILE_W {
            out[c][i] = (surface.low[c] + surface.span[c] * value[i]) * light[i];
        }
    }
    out
}

/// Light that falls on a large surface.
#[inline(always)]
fn lamp_light(
    stage: &Stage<'_>,
    surface: &Surface,
    shades: &[Entry],
    rx: &Lane,
    ry: &Lane,
    depth: &Lane,
) -> Lane {
    let [lx, ly, lz] = surface.lamp;
    let mut lamp = [0.0; TILE_W];
    for i in 0..TILE_W {
        let (dx, dy, dz) = (rx[i] * depth[i] - lx, ry[i] * depth[i] - ly, depth[i] - lz);
        let squared = dx * dx + dy * dy + dz * dz;
        lamp[i] = surface.lamp_factor / (squared * squared.sqrt());
    }
    let mut ambient = [surface.ambient; TILE_W];
    if surface.ground {
        let (mut cast, mut contact) = ([0.0f32; TILE_W], [0.0f32; TILE_W]);
        for entry in shades {
            let Some(shadow) = stage.shadows.get(entry.index as usize) else { continue };
            let mut inside = [f32::INFINITY; TILE_W];
            for edge in &shadow.edges[..shadow.edge_count] {
                let side = linear(*edge, rx, ry);
                for i in 0..TILE_W {
                    let distance = side[i] * depth[i];
                    inside[i] = if distance < inside[i] { distance } else { inside[i] };
                }
            }
            for i in 0..TILE_W {
                let t = (0.5 + inside[i] * shadow.sharpness).clamp(0.0, 1.0);
                let dark = t * t * (3.0 - 2.0 * t);
                cast[i] = cast[i].max(dark * shadow.cast);
                contact[i] = contact[i].max(dark * shadow.contact);
            }
        }
        for i in 0..TILE_W {
            let open = 1.0 - contact[i];
            lamp[i] *= (1.0 - cast[i]) * open;
            ambient[i] *= open * (1.0 - 0.25 * cast[i]);
        }
    }
    for i in 0..TILE_W {
        lamp[i] = ambient[i] + if lamp[i] < 2.5 { lamp[i] } else { 2.5 };
    }
    lamp
}

/// The texture's value, filtered over each pixel's footprint: as many samples along
/// the footprint's longer side as needed, up to 4, each from the two levels that fit.
#[inline(always)]
fn textured(
    surface: &Surface,
    words: &Words,
    rx: &Lane,
    ry: &Lane,
    depth: &Lane,
    [ux, uy, vx, vy]: [f32; 4],
    here: u32,
) -> Lane {
    let [ax, ay, ac, a0] = surface.s;
    let [bx, by, bc, b0] = surface.t;
    let [wx, wy, _] = surface.inverse;
    let s = linear([ax, ay, ac], rx, ry);
    let t = linear([bx, by, bc], rx, ry);
    // The longer side of the footprint, and the squares of both lengths.
    let (mut s_long, mut t_long) = ([0.0f32; TILE_W], [0.0f32; TILE_W]);
    let (mut long2, mut short2) = ([0.0f32; TILE_W], [0.0f32; TILE_W]);
    let (mut s_at, mut t_at) = ([0.0f32; TILE_W], [0.0f32; TILE_W]);
    for i in 0..TILE_W {
        let (s, t) = (s[i] * depth[i], t[i] * depth[i]);
        let (sx, sy) = ((ax - s * wx) * depth[i], (ay - s * wy) * depth[i]);
        let (tx, ty) = ((bx - t * wx) * depth[i], (by - t * wy) * depth[i]);
        let (su, tu) = (sx * ux + sy * uy, tx * ux + ty * uy);
        let (sv, tv) = (sx * vx + sy * vy, tx * vx + ty * vy);
        let (u2, v2) = (su * su + tu * tu, sv * sv + tv * tv);
        let across = u2 > v2;
        s_long[i] = if across { su } else { sv };
        t_long[i] = if across { tu } else { tv };
        long2[i] = if across { u2 } else { v2 };
        short2[i] = if across { v2 } else { u2 };
        s_at[i] = s + a0;
        t_at[i] = t + b0;
    }
    let middle = (here.trailing_zeros() + here.count_ones() / 2).min(TILE_W as u32 - 1) as usize;
    let ratio = long2[middle] / short2[middle].max(1e-12);
    let taps: i32 = if ratio > 6.0 {
        4
    } else if ratio > 1.8 {
        2
    } else {
        1
    };
    let share = 1.0 / taps as f32;
    let mut level = [0i32; TILE_W];
    let mut part = [0.0f32; TILE_W];
    for i in 0..TILE_W {
        let long = long2[i] * (share * share);
        let size = if long > short2[i] { long } else { short2[i] };
        // Half the logarithm to base 2 of the square, by its bits: within 0.05.
        let log = (size.to_bits() as i32 - 0x3F80_0000) as f32 * (0.5 / (1 << 23) as f32);
        let log = log.clamp(0.0, (LEVELS - 1) as f32);
        let whole = ((log - 0.5 + MAGIC).to_bits() & 15) as i32;
        let whole = whole.min(LEVELS as i32 - 2);
        level[i] = whole;
        part[i] = log - whole as f32;
    }
    let mut sum = [0.0; TILE_W];
    for tap in 0..taps {
        let shift = (tap as f32 + 0.5) * share - 0.5;
        let (mut s, mut t) = ([0.0; TILE_W], [0.0; TILE_W]);
        for i in 0..TILE_W {
            s[i] = s_at[i] + shift * s_long[i];
            t[i] = t_at[i] + shift * t_long[i];
        }
        if taps == 4 {
            // Each sample from one of the two levels, as many from each as is its part.
            let mut one = level;
            for i in 0..TILE_W {
                one[i] += i32::from(part[i] > (tap as f32 + 0.5) * share);
            }
            let value = sample(words, &s, &t, &one);
            for i in 0..TILE_W {
                sum[i] += value[i];
            }
            continue;
        }
        let mut next = level;
        for level in &mut next {
            *level += 1;
        }
        let fine = sample(words, &s, &t, &level);
        let coarse = sample(words, &s, &t, &next);
        for i in 0..TILE_W {
            sum[i] += fine[i] + (coarse[i] - fine[i]) * part[i];
        }
    }
    for value in &mut sum {
        *value *= share * (1.0 / 255.0);
    }
    sum
}

/// Bilinear samples at texture coordinates of the finest level, from each lane's level.
#[inline(always)]
fn sample(words: &Words, s: &Lane, t: &Lane, level: &Lane<i32>) -> Lane {
    let mut index = [0u32; TILE_W];
    let (mut fs, mut ft) = ([0.0f32; TILE_W], [0.0f32; TILE_W]);
    for i in 0..TILE_W {
        let level = level[i] as u32;
        let side = (SIDE as u32) >> (level & 15);
        let scale = f32::from_bits((127 - (level & 15)) << 23);
        let (s, t) = (s[i] * scale - 0.5, t[i] * scale - 0.5);
        let (ms, mt) = (s - 0.5 + MAGIC, t - 0.5 + MAGIC);
        fs[i] = s - (ms - MAGIC);
        ft[i] = t - (mt - MAGIC);
        let mask = side.wrapping_sub(1);
        let (is, it) = (ms.to_bits() & mask, mt.to_bits() & mask);
        // All finer levels have (side0^2 - side^2) 4 / 3 texels.
        let start = ((SIDE * SIDE) as u32 - side * side).wrapping_mul(THIRD).wrapping_mul(4);
        index[i] = start.wrapping_add(it * side).wrapping_add(is) & (WORDS as u32 - 1);
    }
    let mut word = [0u32; TILE_W];
    for i in 0..TILE_W {
        word[i] = words[index[i] as usize];
    }
    let mut out = [0.0; TILE_W];
    for i in 0..TILE_W {
        let byte = |shift: u32| (word[i] >> shift & 255) as i32 as f32;
        let (a, b, c, d) = (byte(0), byte(8), byte(16), byte(24));
        let top = a + (b - a) * fs[i];
        let low = c + (d - c) * fs[i];
        out[i] = top + (low - top) * ft[i];
    }
    out
}
