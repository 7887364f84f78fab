//! Packed YUV of cameras to RGB.

/// BT.601 with full-range chroma scaling of studio-range input, in 8-bit fixed
/// point: `R = 1.164 (Y-16) + 1.596 (V-128)` and so on (ITU-R BT.601), as
/// OpenCV's `COLOR_YUV2RGB_YUY2`.
#[inline]
fn rgb(y: u8, u: u8, v: u8) -> [u8; 3] {
    const SHIFT: i32 = 20;
    const HALF: i32 = 1 << (SHIFT - 1);
    let y = (i32::from(y) - 16).max(0) * 1_220_542;
    let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
    let pixel =
        [y + 1_673_527 * v + HALF, y - 852_492 * v - 409_993 * u + HALF, y + 2_116_026 * u + HALF];
    pixel.map(|c| (c >> SHIFT).clamp(0, 255) as u8)
}

/// Converts `height` rows of YUYV (4:2:2, bytes `Y0 U Y1 V` for two pixels) to
/// RGB, written to `out`, which gets the length `width * height * 3`.
///
/// `stride` is the number of bytes from one row to the next, at least
/// `2 * width`. `width` must be even. False, and `out` empty, when `data` is
/// too short or the sizes do not fit.
pub fn yuyv_to_rgb(
    data: &[u8],
    width: usize,
    height: usize,
    stride: usize,
    out: &mut Vec<u8>,
) -> bool {
    out.clear();
    let row_bytes = width.saturating_mul(2);
    let needed = stride.saturating_mul(height.saturating_sub(1)).saturating_add(row_bytes);
    if width == 0
        || height == 0
        || !width.is_multiple_of(2)
        || stride < row_bytes
        || data.len() < needed
    {
        return false;
    }
    out.resize(width * height * 3, 0);
    for (row, target) in data.chunks(stride).zip(out.chunks_exact_mut(width * 3)) {
        for (pair, pixels) in row.chunks_exact(4).zip(target.chunks_exact_mut(6)) {
            if let (&[y0, u, y1, v], [first @ .., _, _, _]) = (pair, &mut *pixels) {
                first.copy_from_slice(&rgb(y0, u, v));
                if let [_, _, _, second @ ..] = pixels {
                    second.copy_from_slice(&rgb(y1, u, v));
                }
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_colours() {
        // Black, white, and BT.601 red, of which two pixels share one U and V.
        let mut out = Vec::new();
        assert!(yuyv_to_rgb(&[16, 128, 235, 128], 2, 1, 4, &mut out));
        assert_eq!(out, [0, 0, 0, 255, 255, 255]);
        assert!(yuyv_to_rgb(&[81, 90, 81, 240], 2, 1, 4, &mut out));
        assert!(out[0] >= 253 && out[1] <= 2 && out[2] <= 2, "{out:?}");
    }

    #[test]
    fn rows_may_be_padded() {
        let mut out = Vec::new();
        let data = [16, 128, 16, 128, 9, 9, 235, 128, 235, 128];
        assert!(yuyv_to_rgb(&data, 2, 2, 6, &mut out));
        assert_eq!(out, [0, 0, 0, 0, 0, 0, 255, 255, 255, 255, 255, 255]);
    }

    #[test]
    fn short_or_odd_input_is_refused() {
        let mut out = vec![1];
        assert!(!yuyv_to_rgb(&[0; 7], 2, 2, 4, &mut out) && out.is_empty());
        assert!(!yuyv_to_rgb(&[0; 64], 3, 2, 8, &mut out));
        assert!(!yuyv_to_rgb(&[0; 64], 4, 2, 4, &mut out));
        assert!(!yuyv_to_rgb(&[], 0, 0, 0, &mut out));
        assert!(!yuyv_to_rgb(&[0; 4], usize::MAX - 1, usize::MAX, usize::MAX, &mut out));
    }
}
