//! Pictures.

use crate::Stamp;
use thiserror::Error;

/// How the bytes of a [`Frame`] are to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// Three bytes a pixel: red, green, blue.
    Rgb8,
    /// One byte a pixel.
    Grey8,
}

impl PixelFormat {
    /// Bytes a pixel.
    #[must_use]
    pub const fn channels(self) -> usize {
        match self {
            Self::Rgb8 => 3,
            Self::Grey8 => 1,
        }
    }
}

/// Why bytes do not make a frame.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FrameError {
    /// The number of bytes does not fit the size.
    #[error(
        "a {width}x{height} frame of {channels} bytes a pixel has {expected} bytes, found {found}"
    )]
    Length {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes a pixel.
        channels: usize,
        /// Bytes needed.
        expected: usize,
        /// Bytes given.
        found: usize,
    },
    /// A side is 0.
    #[error("a frame of {width}x{height} pixels is empty")]
    Empty {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
    },
}

/// An 8-bit picture with the time of its exposure. Rows from top to bottom,
/// without padding; the channels of a pixel side by side.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    stamp: Stamp,
    width: u32,
    height: u32,
    format: PixelFormat,
    data: Vec<u8>,
}

impl Frame {
    /// A frame of `height` rows of `width` pixels.
    ///
    /// # Errors
    /// [`FrameError`] when a side is 0 or `data` is not
    /// `width * height * format.channels()` bytes long.
    pub fn new(
        stamp: Stamp,
        width: u32,
        height: u32,
        format: PixelFormat,
        data: Vec<u8>,
    ) -> Result<Self, FrameError> {
        if width == 0 || height == 0 {
            return Err(FrameError::Empty { width, height });
        }
        let channels = format.channels();
        let expected = (width as usize).saturating_mul(height as usize).saturating_mul(channels);
        if data.len() != expected {
            let found = data.len();
            return Err(FrameError::Length { width, height, channels, expected, found });
        }
        Ok(Self { stamp, width, height, format, data })
    }

    /// An RGB frame, see [`Frame::new`].
    ///
    /// # Errors
    /// As [`Frame::new`].
    pub fn rgb8(stamp: Stamp, width: u32, height: u32, data: Vec<u8>) -> Result<Self, FrameError> {
        Self::new(stamp, width, height, PixelFormat::Rgb8, data)
    }

    /// A grey frame, see [`Frame::new`].
    ///
    /// # Errors
    /// As [`Frame::new`].
    pub fn grey8(stamp: Stamp, width: u32, height: u32, data: Vec<u8>) -> Result<Self, FrameError> {
        Self::new(stamp, width, height, PixelFormat::Grey8, data)
    }

    /// Time of exposure.
    #[must_use]
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// The same picture with another time of exposure.
    #[must_use]
    pub fn with_stamp(mut self, stamp: Stamp) -> Self {
        self.stamp = stamp;
        self
    }

    /// Makes this the picture of another time.
    pub fn set_stamp(&mut self, stamp: Stamp) {
        self.stamp = stamp;
    }

    /// Pixels a row.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// How to read [`Frame::data`].
    #[must_use]
    pub fn format(&self) -> PixelFormat {
        self.format
    }

    /// The bytes, row by row.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// The bytes, to be changed in place.
    pub fn data_mut(&mut self) -> &mut [u8] {
        &mut self.data
    }

    /// The bytes, so that their memory can be used again.
    #[must_use]
    pub fn into_data(self) -> Vec<u8> {
        self.data
    }

    /// Bytes from one row to the next.
    #[must_use]
    pub fn stride(&self) -> usize {
        self.width as usize * self.format.channels()
    }

    /// The same picture in grey, by the luma weights of ITU-R BT.601 in the
    /// fixed point of OpenCV's `COLOR_RGB2GRAY` (14 bits, rounded).
    #[must_use]
    pub fn to_grey(&self) -> Self {
        let data = match self.format {
            PixelFormat::Grey8 => self.data.clone(),
            PixelFormat::Rgb8 => self
                .data
                .chunks_exact(3)
                .map(|p| {
                    let sum =
                        u32::from(p[0]) * 4899 + u32::from(p[1]) * 9617 + u32::from(p[2]) * 1868;
                    ((sum + (1 << 13)) >> 14) as u8
                })
                .collect(),
        };
        Self { data, format: PixelFormat::Grey8, ..*self }
    }

    /// The same picture in RGB; a grey value becomes three equal ones.
    #[must_use]
    pub fn to_rgb(&self) -> Self {
        let data = match self.format {
            PixelFormat::Rgb8 => self.data.clone(),
            PixelFormat::Grey8 => self.data.iter().flat_map(|&v| [v, v, v]).collect(),
        };
        Self { data, format: PixelFormat::Rgb8, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_length_names_the_numbers() {
        let error = Frame::rgb8(Stamp::ZERO, 4, 2, vec![0; 23]).unwrap_err();
        assert_eq!(error.to_string(), "a 4x2 frame of 3 bytes a pixel has 24 bytes, found 23");
        assert!(matches!(Frame::grey8(Stamp::ZERO, 0, 2, vec![]), Err(FrameError::Empty { .. })));
        assert!(Frame::rgb8(Stamp::ZERO, u32::MAX, u32::MAX, vec![]).is_err());
    }

    #[test]
    fn grey_keeps_white_and_black() {
        let frame =
            Frame::rgb8(Stamp::ZERO, 3, 1, vec![255, 255, 255, 0, 0, 0, 255, 0, 0]).unwrap();
        assert_eq!(frame.to_grey().data(), [255, 0, 76]);
        assert_eq!(frame.to_grey().to_rgb().data()[6..], [76, 76, 76]);
    }
}
