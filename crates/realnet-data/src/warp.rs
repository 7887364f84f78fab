//! Pictures and depth maps through a projective map.
//!
//! Positions count from the edge of the picture, as those of boxes do: the middle of the
//! first pixel is at (0.5, 0.5).

use realnet_core::nalgebra::Matrix3;
use realnet_core::{DepthMap, Frame};

/// The grey around pictures, that of the letterbox.
pub(crate) const GREY: u8 = realnet_vision::Letterbox::GREY;

/// An RGB picture that lies on a canvas.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tile<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    /// Where its left and top edge lie on the canvas.
    offset: [f32; 2],
}

impl<'a> Tile<'a> {
    /// A frame (RGB) with its left and top edge at `offset`.
    pub(crate) fn new(frame: &'a Frame, offset: [f32; 2]) -> Self {
        let (width, height) = (frame.width() as usize, frame.height() as usize);
        Self { pixels: frame.data(), width, height, offset }
    }
}

/// Up to four pictures around a point, on grey. Tile 0 counts left of and above the
/// point, 1 right above, 2 left below, 3 right below.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Canvas<'a> {
    pub(crate) tiles: [Option<Tile<'a>>; 4],
    pub(crate) point: [f32; 2],
    /// Width and height; beyond it everything is grey.
    pub(crate) size: [f32; 2],
}

impl<'a> Canvas<'a> {
    /// A canvas with one picture.
    pub(crate) fn of(tile: Tile<'a>, size: [f32; 2]) -> Self {
        Self { tiles: [None, None, None, Some(tile)], point: [f32::NEG_INFINITY; 2], size }
    }

    /// The colour at a place, 0 to 255, between the middles of four pixels; a picture goes
    /// on beyond its outermost middles as they are.
    #[inline(always)]
    fn at(&self, x: f32, y: f32) -> [f32; 3] {
        const OUTSIDE: [f32; 3] = [GREY as f32; 3];
        if !(x >= 0.0 && y >= 0.0 && x < self.size[0] && y < self.size[1]) {
            return OUTSIDE;
        }
        let index = usize::from(x >= self.point[0]) + 2 * usize::from(y >= self.point[1]);
        let Some(tile) = &self.tiles[index] else { return OUTSIDE };
        let (u, v) = (x - tile.offset[0], y - tile.offset[1]);
        if !(u >= 0.0 && v >= 0.0 && u < tile.width as f32 && v < tile.height as f32) {
            return OUTSIDE;
        }
        let ([x0, x1], fx) = neighbours(u, tile.width);
        let ([y0, y1], fy) = neighbours(v, tile.height);
        let pixel = |x: usize, y: usize| -> [f32; 3] {
            let at = 3 * (y * tile.width + x);
            match tile.pixels.get(at..at + 3) {
                Some(&[r, g, b]) => [f32::from(r), f32::from(g), f32::from(b)],
                _ => OUTSIDE,
            }
        };
        let (a, b, c, d) = (pixel(x0, y0), pixel(x1, y0), pixel(x0, y1), pixel(x1, y1));
        let mut out = [0.0; 3];
        for i in 0..3 {
            let upper = a[i] + (b[i] - a[i]) * fx;
            let lower = c[i] + (d[i] - c[i]) * fx;
            out[i] = upper + (lower - upper) * fy;
        }
        out
    }
}

/// The two pixels around a place inside `0..length`, and the share of the second.
#[inline(always)]
fn neighbours(place: f32, length: usize) -> ([usize; 2], f32) {
    let last = length.saturating_sub(1);
    let centered = place - 0.5;
    if centered <= 0.0 {
        return ([0, 0], 0.0);
    }
    // Above 0: the cast is the floor.
    let first = (centered as usize).min(last);
    ([first, (first + 1).min(last)], centered - first as f32)
}

/// How many samples a side of an output pixel takes: as many as input pixels fall on it,
/// so that a reduction does not alias, up to 4. `source_from_out` maps a place of the
/// output, about whose middle `size` says where it is.
fn samples(source_from_out: &Matrix3<f64>, size: (u32, u32)) -> usize {
    let middle = [f64::from(size.0) / 2.0, f64::from(size.1) / 2.0];
    let step = |dx: f64, dy: f64| {
        let a = apply(source_from_out, middle);
        let b = apply(source_from_out, [middle[0] + dx, middle[1] + dy]);
        (b[0] - a[0]).hypot(b[1] - a[1])
    };
    // 1.5 input pixels a step are still taken one by one.
    let longest = step(1.0, 0.0).max(step(0.0, 1.0));
    ((longest - 1e-6).round() as usize).clamp(1, 4)
}

/// Where a projective map takes a place.
pub(crate) fn apply(map: &Matrix3<f64>, [x, y]: [f64; 2]) -> [f64; 2] {
    let w = map[(2, 0)] * x + map[(2, 1)] * y + map[(2, 2)];
    [
        (map[(0, 0)] * x + map[(0, 1)] * y + map[(0, 2)]) / w,
        (map[(1, 0)] * x + map[(1, 1)] * y + map[(1, 2)]) / w,
    ]
}

/// Draws what a canvas shows through `canvas_from_out` into `out`: planes of red, green
/// and blue, each of `height` rows of `width` bytes.
pub(crate) fn render(
    canvas: &Canvas<'_>,
    canvas_from_out: &Matrix3<f64>,
    (width, height): (u32, u32),
    out: &mut [u8],
) {
    let (columns, plane) = (width as usize, width as usize * height as usize);
    let count = samples(canvas_from_out, (width, height));
    let share = 1.0 / (count * count) as f32;
    let (red, rest) = out.split_at_mut(plane.min(out.len()));
    let (green, blue) = rest.split_at_mut(plane.min(rest.len()));
    let map = canvas_from_out;
    let places: Vec<f64> = (0..count).map(|k| (k as f64 + 0.5) / count as f64).collect();
    let rows = red.chunks_exact_mut(columns).zip(green.chunks_exact_mut(columns));
    for (y, ((red, green), blue)) in rows.zip(blue.chunks_exact_mut(columns)).enumerate() {
        for (x, ((red, green), blue)) in red.iter_mut().zip(green).zip(blue).enumerate() {
            let mut sum = [0.0f32; 3];
            for &dy in &places {
                for &dx in &places {
                    let (u, v) = (x as f64 + dx, y as f64 + dy);
                    let mut place = [
                        map[(0, 0)] * u + map[(0, 1)] * v + map[(0, 2)],
                        map[(1, 0)] * u + map[(1, 1)] * v + map[(1, 2)],
                    ];
                    let w = map[(2, 0)] * u + map[(2, 1)] * v + map[(2, 2)];
                    if w != 1.0 {
                        place = [place[0] / w, place[1] / w];
                    }
                    // Behind the horizon there is nothing.
                    let place = if w > 0.0 { place } else { [f64::NAN; 2] };
                    let color = canvas.at(place[0] as f32, place[1] as f32);
                    for i in 0..3 {
                        sum[i] += color[i];
                    }
                }
            }
            *red = (sum[0] * share + 0.5) as u8;
            *green = (sum[1] * share + 0.5) as u8;
            *blue = (sum[2] * share + 0.5) as u8;
        }
    }
}

/// The depth at a place counted from the edge, 0 where it is unknown: that of the pixel
/// there, averaged with those of the three next ones that are known and differ from it
/// by less than [`SAME_SURFACE`], by the weights of bilinear interpolation. So edges are
/// not mixed, smooth surfaces have no steps, and unknown stays unknown.
pub(crate) fn depth_at(map: &DepthMap, [x, y]: [f64; 2]) -> f32 {
    let (width, height) = (map.width() as usize, map.height() as usize);
    if !(x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64) {
        return DepthMap::UNKNOWN;
    }
    let ([x0, x1], fx) = neighbours(x as f32, width);
    let ([y0, y1], fy) = neighbours(y as f32, height);
    let at = |x: usize, y: usize| map.data().get(y * width + x).copied().unwrap_or(0.0);
    let nearest = at(if fx < 0.5 { x0 } else { x1 }, if fy < 0.5 { y0 } else { y1 });
    if !DepthMap::is_known(nearest) {
        return DepthMap::UNKNOWN;
    }
    let (mut sum, mut weights) = (0.0, 0.0);
    for (depth, weight) in [
        (at(x0, y0), (1.0 - fx) * (1.0 - fy)),
        (at(x1, y0), fx * (1.0 - fy)),
        (at(x0, y1), (1.0 - fx) * fy),
        (at(x1, y1), fx * fy),
    ] {
        if DepthMap::is_known(depth) && (depth - nearest).abs() < SAME_SURFACE * nearest {
            sum += depth * weight;
            weights += weight;
        }
    }
    // The nearest has at least a quarter of the weight.
    sum / weights
}

/// Depths that differ by less than this share are of one surface.
pub(crate) const SAME_SURFACE: f32 = 0.05;

/// Depths through `source_from_out`, see [`depth_at`]; `height` rows of `width`.
pub(crate) fn render_depth(
    map: &DepthMap,
    source_from_out: &Matrix3<f64>,
    (width, height): (u32, u32),
    mut out: impl FnMut(f32),
) {
    for y in 0..height {
        for x in 0..width {
            let place = [f64::from(x) + 0.5, f64::from(y) + 0.5];
            out(depth_at(map, apply(source_from_out, place)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realnet_core::Stamp;

    fn picture(width: u32, height: u32) -> Frame {
        let data = (0..width * height * 3).map(|i| (i * 37 % 251) as u8).collect();
        Frame::rgb8(Stamp::ZERO, width, height, data).unwrap()
    }

    #[test]
    fn identity_copies_and_the_outside_is_grey() {
        let frame = picture(7, 5);
        let canvas = Canvas::of(Tile::new(&frame, [2.0, 1.0]), [10.0, 8.0]);
        let mut out = vec![0; 3 * 80];
        render(&canvas, &Matrix3::identity(), (10, 8), &mut out);
        for y in 0..8usize {
            for x in 0..10usize {
                for c in 0..3 {
                    let inside = (2..9).contains(&x) && (1..6).contains(&y);
                    let wanted = match inside {
                        true => frame.data()[((y - 1) * 7 + x - 2) * 3 + c],
                        false => GREY,
                    };
                    assert_eq!(out[c * 80 + y * 10 + x], wanted, "{x} {y} {c}");
                }
            }
        }
    }

    #[test]
    fn halving_averages_four_pixels() {
        let frame = picture(8, 6);
        let canvas = Canvas::of(Tile::new(&frame, [0.0; 2]), [8.0, 6.0]);
        let mut out = vec![0; 3 * 12];
        let twice = Matrix3::new(2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0);
        render(&canvas, &twice, (4, 3), &mut out);
        for (y, x, c) in [(0, 0, 0), (2, 3, 1), (1, 2, 2)] {
            let at = |dx, dy| u32::from(frame.data()[((2 * y + dy) * 8 + 2 * x + dx) * 3 + c]);
            let mean = (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1) + 2) / 4;
            assert_eq!(u32::from(out[c * 12 + y * 4 + x]), mean);
        }
    }

    #[test]
    fn depth_edges_are_not_mixed_and_unknown_stays_unknown() {
        let data = vec![1.0, 1.02, 4.0, 0.0, 1.0, 1.02, 4.0, f32::NAN];
        let map = DepthMap::new(Stamp::ZERO, 4, 2, data).unwrap();
        assert!((depth_at(&map, [1.0, 1.0]) - 1.01).abs() < 1e-6); // one surface
        assert!((depth_at(&map, [1.9, 1.0]) - 1.02).abs() < 1e-6); // not 2.2 before the edge
        assert!((depth_at(&map, [2.1, 1.0]) - 4.0).abs() < 1e-6);
        assert_eq!(depth_at(&map, [3.2, 0.3]), 0.0);
        assert_eq!(depth_at(&map, [3.2, 1.6]), 0.0);
        assert_eq!(depth_at(&map, [-0.1, 0.5]), 0.0);
        assert_eq!(depth_at(&map, [f64::NAN, 0.5]), 0.0);
    }

    proptest! {
        #[test]
        fn any_map_stays_in_the_picture(
            m in proptest::array::uniform9(-3.0f64..3.0), (w, h) in (1u32..20, 1u32..20),
        ) {
            let frame = picture(w, h);
            let canvas = Canvas::of(Tile::new(&frame, [0.0; 2]), [w as f32, h as f32]);
            let mut out = vec![0; 3 * 16];
            render(&canvas, &Matrix3::from_row_slice(&m), (4, 4), &mut out);
            let depth = DepthMap::new(Stamp::ZERO, w, h, vec![2.0; (w * h) as usize]).unwrap();
            render_depth(&depth, &Matrix3::from_row_slice(&m), (4, 4), |d| {
                assert!(d == 0.0 || (d - 2.0).abs() < 1e-5);
            });
        }
    }
}
