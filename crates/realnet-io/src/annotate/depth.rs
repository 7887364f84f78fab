//! Depth maps as pictures.

use realnet_core::{DepthMap, Frame, FrameError};

/// The colour of a pixel without depth: a dark grey that no depth has.
const UNKNOWN: [u8; 3] = [40; 3];

/// A depth map in colours, near ones red and far ones blue (the Turbo colour map,
/// A. Mikhailov 2019, in its polynomial form), the same for equal shares of the
/// logarithm of depth. Depths outside of `near` to `far` (metres) have the colours
/// of the ends, unknown ones are dark grey.
///
/// # Errors
/// [`FrameError`] never comes from a depth map, which is not empty.
pub fn depth_colors(map: &DepthMap, near: f32, far: f32) -> Result<Frame, FrameError> {
    let (low, high) = (near.max(1e-6).ln(), far.max(1e-6).ln());
    let scale = 1.0 / (high - low).max(1e-6);
    let mut data = Vec::with_capacity(map.data().len() * 3);
    for &depth in map.data() {
        let known = DepthMap::is_known(depth);
        let share = 1.0 - (depth.ln() - low) * scale;
        data.extend(if known { turbo(share) } else { UNKNOWN });
    }
    Frame::rgb8(map.stamp(), map.width(), map.height(), data)
}

/// The relative difference of two depth maps in colours: black where they agree,
/// yellow to white at `most` (a share of the true depth) and beyond; dark blue
/// where only one knows a depth, dark grey where neither does.
///
/// # Errors
/// [`FrameError::Length`] when the maps are not of one size.
pub fn depth_error_colors(
    truth: &DepthMap,
    other: &DepthMap,
    most: f32,
) -> Result<Frame, FrameError> {
    let mut data = Vec::with_capacity(truth.data().len() * 3);
    for (&t, &o) in truth.data().iter().zip(other.data()) {
        data.extend(match (DepthMap::is_known(t), DepthMap::is_known(o)) {
            (true, true) => heat((o - t).abs() / (t * most)),
            (false, false) => UNKNOWN,
            _ => [30, 40, 90],
        });
    }
    if truth.data().len() != other.data().len() {
        data.clear(); // refused below
    }
    Frame::rgb8(truth.stamp(), truth.width(), truth.height(), data)
}

/// Turbo, 0 blue to 1 red, without its nearly black end.
fn turbo(share: f32) -> [u8; 3] {
    let x = 0.06 + 0.94 * share.clamp(0.0, 1.0);
    let polynomial = |c: [f32; 6]| c.iter().rev().fold(0.0, |sum, c| sum * x + c);
    let red = [0.135_721, 4.615_393, -42.660_32, 132.131_08, -152.942_4, 59.286_38];
    let green = [0.091_403, 2.194_188, 4.842_967, -14.185_033, 4.277_299, 2.829_566];
    let blue = [0.106_673, 12.641_946, -60.582_05, 110.362_77, -89.903_11, 27.348_25];
    [red, green, blue].map(|c| (255.0 * polynomial(c).clamp(0.0, 1.0)).round() as u8)
}

/// Black, red, yellow, white.
fn heat(share: f32) -> [u8; 3] {
    let x = share.clamp(0.0, 1.0) * 3.0;
    [x, x - 1.0, x - 2.0].map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::Stamp;

    #[test]
    fn near_is_red_far_is_blue_unknown_is_grey() {
        let map = DepthMap::new(Stamp::ZERO, 4, 1, vec![0.5, 8.0, 0.0, 2.0]).unwrap();
        let frame = depth_colors(&map, 0.5, 8.0).unwrap();
        let pixel = |i: usize| -> [u8; 3] { frame.data()[3 * i..3 * i + 3].try_into().unwrap() };
        assert!(pixel(0)[0] > 2 * pixel(0)[2].max(pixel(0)[1]), "{:?}", pixel(0));
        assert!(pixel(1)[2] > pixel(1)[0] && pixel(1)[0] < 80, "{:?}", pixel(1));
        assert_eq!(pixel(2), UNKNOWN);
        // 2 m is the middle of the logarithm: green.
        assert!(pixel(3)[1] > pixel(3)[0] && pixel(3)[1] > pixel(3)[2], "{:?}", pixel(3));
    }

    #[test]
    fn errors_go_from_black_to_white() {
        let truth = DepthMap::new(Stamp::ZERO, 5, 1, vec![2.0, 2.0, 2.0, 0.0, 2.0]).unwrap();
        let other = DepthMap::new(Stamp::ZERO, 5, 1, vec![2.0, 2.1, 3.0, 0.0, 0.0]).unwrap();
        let frame = depth_error_colors(&truth, &other, 0.1).unwrap();
        assert_eq!(frame.data()[..3], [0; 3]);
        assert_eq!(frame.data()[3..6], [255, 127, 0]);
        assert_eq!(frame.data()[6..9], [255; 3]);
        assert_eq!(frame.data()[9..12], UNKNOWN);
        assert_eq!(frame.data()[12..], [30, 40, 90]);
        let small = DepthMap::new(Stamp::ZERO, 1, 1, vec![2.0]).unwrap();
        assert!(depth_error_colors(&truth, &small, 0.1).is_err());
    }
}
