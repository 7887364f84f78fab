//! Pictures for tests.

use realnet_core::{Frame, PixelFormat, Stamp};

/// Bytes of a xorshift generator as a grey (1) or RGB (3 channels) picture.
pub(crate) fn noise(width: u32, height: u32, channels: usize, seed: u32) -> Frame {
    let mut state = seed | 1;
    let data = (0..width as usize * height as usize * channels)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (state >> 8) as u8
        })
        .collect();
    let format = if channels == 3 { PixelFormat::Rgb8 } else { PixelFormat::Grey8 };
    Frame::new(Stamp::ZERO, width, height, format, data).unwrap()
}
