use super::*;
use crate::{Pyramid, Window};
use proptest::prelude::*;
use realnet_core::{Frame, Stamp};

fn noise(width: u32, height: u32, seed: u32) -> Frame {
    let mut state = seed | 1;
    let data = (0..width * height)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            // Saturated black and white often, for the extremes of the sums.
            [0, 255, (state >> 8) as u8, (state >> 16) as u8][(state >> 28) as usize % 4]
        })
        .collect();
    Frame::grey8(Stamp::ZERO, width, height, data).unwrap()
}

#[test]
fn weights_sum_to_one() {
    for i in 0..=64 {
        for j in 0..=64 {
            let Weights(w) = Weights::new(i as f32 / 64.0, j as f32 / 64.0);
            assert_eq!(w.map(i32::from).iter().sum::<i32>(), 1 << WEIGHT_BITS);
        }
    }
}

/// The definition, with all positions and sums spelled out.
fn compare_by_definition(
    patch: &Patch,
    level: &Level,
    (x, y): (isize, isize),
    weights: Weights,
) -> [i64; 2] {
    let mut sums = [0; 2];
    for row in 0..patch.height {
        for column in 0..patch.width {
            let at = |dx: usize, dy: usize| {
                let (x, y) = (x + (column + dx) as isize, y + (row + dy) as isize);
                i64::from(level.pixels_from(x, y)[0])
            };
            let w = weights.0.map(i64::from);
            let sum = at(0, 0) * w[0] + at(1, 0) * w[1] + at(0, 1) * w[2] + at(1, 1) * w[3];
            let value = (sum + 256) >> 9;
            let i = row * patch.stride + column;
            let difference = value - i64::from(patch.intensity[i]);
            sums[0] += difference * i64::from(patch.dx[i]);
            sums[1] += difference * i64::from(patch.dy[i]);
        }
    }
    sums
}

proptest! {
    /// Every instruction set returns the same bits, windows of every size and at
    /// every place in and beyond the picture.
    #[test]
    fn all_paths_agree(
        (width, height) in (1u32..80, 1u32..60),
        (window_width, window_height) in (3u32..80, 3u32..80),
        (fx, fy, gx, gy) in (0.0f64..1.0, 0.0f64..1.0, 0.0f64..1.0, 0.0f64..1.0),
        (a, b) in (0.0f32..1.0, 0.0f32..1.0),
        seed in any::<u32>(),
    ) {
        let window = Window::new(window_width, window_height).unwrap();
        let mut pyramid = Pyramid::new(0, window);
        pyramid.build(&noise(width, height, seed));
        let level = pyramid.full().unwrap();
        // All places the tracker may ask for: from one window outside to the last pixel.
        let place = |fx: f64, fy: f64| {
            let along = |f: f64, size: u32, window: u32| {
                (f * f64::from(size + window)).floor() as isize - window as isize
            };
            (along(fx, width, window_width), along(fy, height, window_height))
        };
        let (first, second) = (place(fx, fy), place(gx, gy));
        let (here, there) = (Weights::new(a, b), Weights::new(b, a));
        let mut expected = None;
        for &simd in Simd::found() {
            let mut patch = Patch::new(window);
            let matrix = patch.take(simd, level, first, here);
            let sums = patch.compare(simd, level, second, there);
            prop_assert_eq!(sums, compare_by_definition(&patch, level, second, there));
            let mean = patch.mean_difference(simd, level, second, there);
            let result = (matrix, sums, mean.to_bits(), patch.intensity, patch.dx, patch.dy);
            match &expected {
                None => expected = Some(result),
                Some(expected) => prop_assert_eq!(expected, &result, "{:?}", simd),
            }
        }
    }
}

/// The largest sums there can be do not overflow: black against white with the
/// steepest gradients.
#[test]
fn extremes_do_not_overflow() {
    let window = Window::new(255, 255).unwrap();
    let mut patch = Patch::new(window);
    patch.intensity.fill(8160);
    patch.dx.fill(4080);
    patch.dy.fill(-4080);
    for row in
        patch.dx.chunks_exact_mut(patch.stride).chain(patch.dy.chunks_exact_mut(patch.stride))
    {
        row[255..].fill(0);
    }
    let mut pyramid = Pyramid::new(0, window);
    pyramid.build(&Frame::grey8(Stamp::ZERO, 300, 300, vec![0; 90_000]).unwrap());
    let level = pyramid.full().unwrap();
    for &simd in Simd::found() {
        let sums = patch.compare(simd, level, (3, 3), Weights::new(0.25, 0.5));
        let expected = 255 * 255 * 8160 * 4080;
        assert_eq!(sums, [-expected, expected], "{simd:?}");
    }
}
