//! Pixels that an edge crosses: blended by the share that each side covers.
//!
//! A pixel beside one of another surface asks where, on the line between the two
//! centres, the edge of the nearer surface lies; what of the pixel is beyond it takes
//! the neighbour's light (geometric anti-aliasing after Persson, 2011).

use super::canvas::{Canvas, Rays};
use super::surface::Surface;

/// Pixels that are looked at together.
const CHUNK: usize = 16;

/// Changed pixels, kept until all are known.
#[derive(Clone, Debug, Default)]
pub(super) struct Blends {
    list: Vec<(u32, [f32; 3])>,
}

impl Blends {
    /// Blends all edges of the picture.
    pub(super) fn run(&mut self, rays: &Rays, surfaces: &[Surface], canvas: &mut Canvas) {
        self.list.clear();
        let (width, height, stride) = (rays.width, rays.height, rays.stride);
        for y in 0..height {
            let row = y * stride..y * stride + width;
            let ids = &canvas.id[row.clone()];
            let above = if y > 0 { &canvas.id[row.start - stride..row.end - stride] } else { ids };
            let below =
                if y + 1 < height { &canvas.id[row.start + stride..row.end + stride] } else { ids };
            for x in (0..width).step_by(CHUNK) {
                let end = (x + CHUNK).min(width);
                // Most chunks show one surface, and so do those around.
                let (first, around) = (ids[x], x.saturating_sub(1)..(end + 1).min(width));
                let beside = ids[around].iter().fold(0, |all, id| all | (id ^ first));
                let above_it = above[x..end].iter().fold(0, |all, id| all | (id ^ first));
                let below_it = below[x..end].iter().fold(0, |all, id| all | (id ^ first));
                if beside | above_it | below_it != 0 {
                    self.chunk(rays, surfaces, canvas, row.start, x..end, [ids, above, below]);
                }
            }
        }
        for &(at, colour) in &self.list {
            for (plane, value) in canvas.light.iter_mut().zip(colour) {
                plane[at as usize] = value;
            }
        }
    }

    /// Blends what is on some pixels of a row; `rows` are the ids of the row, the one
    /// above and the one below.
    fn chunk(
        &mut self,
        rays: &Rays,
        surfaces: &[Surface],
        canvas: &Canvas,
        start: usize,
        pixels: std::ops::Range<usize>,
        [ids, above, below]: [&[u32]; 3],
    ) {
        let (width, stride) = (rays.width, rays.stride);
        for x in pixels {
            let id = ids[x];
            let left = ids[x.saturating_sub(1)];
            let right = ids[(x + 1).min(width - 1)];
            if id == left && id == right && id == above[x] && id == below[x] {
                continue;
            }
            let at = start + x;
            let neighbours = [
                (left, at.wrapping_sub(1)),
                (right, at + 1),
                (above[x], at.wrapping_sub(stride)),
                (below[x], at + stride),
            ];
            let mut best = (0.5f32, at);
            for (other, there) in neighbours {
                if other != id {
                    let share = own_share(rays, surfaces, canvas, at, there);
                    if share < best.0 {
                        best = (share, there);
                    }
                }
            }
            let (share, there) = best;
            if there != at {
                let keep = 0.5 + share;
                let mix = |plane: &Vec<f32>| plane[at] * keep + plane[there] * (1.0 - keep);
                let [r, g, b] = &canvas.light;
                self.list.push((at as u32, [mix(r), mix(g), mix(b)]));
            }
        }
    }
}

fn value([a, b, c]: [f32; 3], (x, y): (f32, f32)) -> f32 {
    a * x + b * y + c
}

/// Where on the way from pixel `at` to its neighbour `there` the seen surface changes,
/// in pixels from `at`.
fn own_share(rays: &Rays, surfaces: &[Surface], canvas: &Canvas, at: usize, there: usize) -> f32 {
    let ray = |i: usize| (rays.x[i], rays.y[i]);
    let (here, beyond) = (ray(at), ray(there));
    let surface = |i: usize| {
        let index = (canvas.id[i] & 0xFFFF) as usize;
        if index == 0 { None } else { surfaces.get(index) }
    };
    let (own, other) = (surface(at), surface(there));
    // The nearer one's edge is seen; a decal's lies on its ground.
    let leave = own.and_then(|surface| crossing(surface, here, beyond));
    let enter = other.and_then(|surface| crossing(surface, beyond, here)).map(|t| 1.0 - t);
    let own_first = match (own, other) {
        (Some(a), Some(b)) if a.decal != b.decal => a.decal,
        _ => canvas.inverse[at] >= canvas.inverse[there],
    };
    let edge = if own_first { leave.or(enter) } else { enter.or(leave) };
    edge.unwrap_or_else(|| match (own, other) {
        // Two bodies cut each other: where they are equally far.
        (Some(a), Some(b)) => {
            let ahead = |p| value(a.inverse, p) - value(b.inverse, p);
            let (first, last) = (ahead(here), ahead(beyond));
            if first > 0.0 && last < 0.0 { first / (first - last) } else { 0.5 }
        }
        _ => 0.5,
    })
}

/// Where a surface that covers `from` ends on the way to `to`, if it does: 0 to 1.
fn crossing(surface: &Surface, from: (f32, f32), to: (f32, f32)) -> Option<f32> {
    let mut first: Option<f32> = None;
    for &edge in &surface.edges[..surface.edge_count] {
        let (inside, outside) = (value(edge, from), value(edge, to));
        if inside >= 0.0 && outside < 0.0 {
            let t = inside / (inside - outside);
            first = Some(first.map_or(t, |other| other.min(t)));
        }
    }
    first
}
