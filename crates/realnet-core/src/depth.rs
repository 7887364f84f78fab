//! Depth maps.

use crate::Stamp;
use thiserror::Error;

/// Why values do not make a depth map.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DepthMapError {
    /// The number of values does not fit the size.
    #[error("a {width}x{height} depth map has {expected} values, found {found}")]
    Length {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Values needed.
        expected: usize,
        /// Values given.
        found: usize,
    },
    /// A side is 0.
    #[error("a depth map of {width}x{height} pixels is empty")]
    Empty {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
    },
}

/// The depth of each pixel: its coordinate along the optical axis (`z` of the
/// camera's optical frame), in metres, with the time of exposure of the frame it
/// belongs to. Rows from top to bottom.
///
/// Only finite values above 0 are depths. Everything else, 0 and NaN first of
/// all, means *unknown*, never far.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    stamp: Stamp,
    width: u32,
    height: u32,
    data: Vec<f32>,
}

impl DepthMap {
    /// What an unknown pixel is written as.
    pub const UNKNOWN: f32 = 0.0;

    /// A map of `height` rows of `width` depths in metres.
    ///
    /// # Errors
    /// [`DepthMapError`] when a side is 0 or there are not `width * height` values.
    pub fn new(
        stamp: Stamp,
        width: u32,
        height: u32,
        data: Vec<f32>,
    ) -> Result<Self, DepthMapError> {
        if width == 0 || height == 0 {
            return Err(DepthMapError::Empty { width, height });
        }
        let expected = (width as usize).saturating_mul(height as usize);
        if data.len() != expected {
            return Err(DepthMapError::Length { width, height, expected, found: data.len() });
        }
        Ok(Self { stamp, width, height, data })
    }

    /// A map in which nothing is known.
    ///
    /// # Errors
    /// [`DepthMapError::Empty`] when a side is 0.
    pub fn unknown(stamp: Stamp, width: u32, height: u32) -> Result<Self, DepthMapError> {
        let pixels = (width as usize).saturating_mul(height as usize);
        Self::new(stamp, width, height, vec![Self::UNKNOWN; pixels])
    }

    /// Becomes a copy of `other`, in the memory it has.
    pub fn copy_from(&mut self, other: &Self) {
        (self.stamp, self.width, self.height) = (other.stamp, other.width, other.height);
        self.data.clone_from(&other.data);
    }

    /// Whether a value is a depth.
    #[must_use]
    pub fn is_known(depth: f32) -> bool {
        depth > 0.0 && depth < f32::INFINITY
    }

    /// Time of exposure of the frame.
    #[must_use]
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// The same depths for another time.
    #[must_use]
    pub fn with_stamp(mut self, stamp: Stamp) -> Self {
        self.stamp = stamp;
        self
    }

    /// Makes these the depths of another time.
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

    /// The values in metres, row by row.
    #[must_use]
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// The values, to be changed in place.
    pub fn data_mut(&mut self) -> &mut [f32] {
        &mut self.data
    }

    /// The values, so that their memory can be used again.
    #[must_use]
    pub fn into_data(self) -> Vec<f32> {
        self.data
    }

    /// The row `y`; empty below the last one.
    #[must_use]
    pub fn row(&self, y: u32) -> &[f32] {
        let width = self.width as usize;
        let start = (y as usize).saturating_mul(width);
        self.data.get(start..start.saturating_add(width)).unwrap_or(&[])
    }

    /// The depth of the pixel in column `x` and row `y`, metres; `None` where it
    /// is unknown or outside.
    #[must_use]
    pub fn at(&self, x: u32, y: u32) -> Option<f32> {
        self.row(y).get(x as usize).copied().filter(|depth| Self::is_known(*depth))
    }

    /// Share of the pixels with a depth, 0 to 1.
    #[must_use]
    pub fn known_share(&self) -> f64 {
        let known = self.data.iter().filter(|depth| Self::is_known(**depth)).count();
        known as f64 / self.data.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_finite_positive_values_are_depths() {
        let data = vec![1.5, 0.0, -1.0, f32::NAN, f32::INFINITY, 2.0];
        let map = DepthMap::new(Stamp::ZERO, 3, 2, data).unwrap();
        assert_eq!(map.at(0, 0), Some(1.5));
        assert_eq!(map.at(2, 1), Some(2.0));
        for (x, y) in [(1, 0), (2, 0), (0, 1), (1, 1), (3, 0), (0, 2), (u32::MAX, u32::MAX)] {
            assert_eq!(map.at(x, y), None, "{x} {y}");
        }
        assert_eq!(map.known_share(), 2.0 / 6.0);
        assert_eq!(map.row(1).len(), 3);
        assert!(map.row(2).is_empty());
    }

    #[test]
    fn wrong_sizes_name_the_numbers() {
        let error = DepthMap::new(Stamp::ZERO, 4, 2, vec![0.0; 7]).unwrap_err();
        assert_eq!(error.to_string(), "a 4x2 depth map has 8 values, found 7");
        let error = DepthMap::unknown(Stamp::ZERO, 0, 2).unwrap_err();
        assert_eq!(error.to_string(), "a depth map of 0x2 pixels is empty");
    }
}
