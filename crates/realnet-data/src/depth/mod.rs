//! Pictures with depth maps.

mod augment;
mod set;
mod source;

pub use augment::{DepthAugment, DepthSamples, Normalization};
pub use set::{DepthSet, DepthSetOptions, RgbdPicture};
pub use source::{DepthPart, DepthSource, HoldOut, SourceCamera, SourceList};

use realnet_core::{DepthMap, Intrinsics, OptionError};
use std::path::PathBuf;

/// The focal length for which a network learns depth, in pixels of its input.
///
/// A picture shows a thing of size `S` at depth `d` as `f S / d` pixels: what it shows
/// fixes `d / f`, not `d`. So a network learns `d · canonical / f` with `f = √(fx·fy)` of
/// the camera *on the network's input*, after every resize and crop, and its output is
/// multiplied by `f / canonical` of the camera at hand. (`realnet_nn::depth` does that with
/// `DepthCoding::focal`.)
///
/// ```
/// use realnet_core::Intrinsics;
/// use realnet_data::CanonicalFocal;
///
/// let canonical = CanonicalFocal::new(200.0)?;
/// let camera = Intrinsics { fx: 300.0, fy: 300.0, cx: 127.5, cy: 95.5 };
/// let learned = 6.0 * canonical.from_metres(&camera);
/// assert_eq!(learned, 4.0);
/// assert_eq!(learned * canonical.to_metres(&camera), 6.0);
/// # Ok::<(), realnet_core::OptionError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CanonicalFocal(f64);

impl CanonicalFocal {
    /// A focal length in pixels of the network's input.
    ///
    /// # Errors
    /// [`OptionError`] unless it is finite and above 0.
    pub fn new(pixels: f64) -> Result<Self, OptionError> {
        OptionError::check("canonical_focal", pixels, pixels > 0.0, "above 0 pixels")?;
        Ok(Self(pixels))
    }

    /// The focal length in pixels of the network's input.
    #[must_use]
    pub fn pixels(self) -> f64 {
        self.0
    }

    /// Factor from depth in metres to the depth that is learned, for a camera on the
    /// network's input.
    #[must_use]
    pub fn from_metres(self, camera: &Intrinsics) -> f64 {
        self.0 / (camera.fx * camera.fy).sqrt()
    }

    /// Factor from the network's output to metres, for a camera on the network's input.
    #[must_use]
    pub fn to_metres(self, camera: &Intrinsics) -> f64 {
        (camera.fx * camera.fy).sqrt() / self.0
    }
}

/// What a depth network is shown once.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthSample {
    /// Index of the picture in its set.
    pub index: usize,
    /// The picture's file; empty for one given in memory.
    pub path: PathBuf,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Planes of red, green and blue, each of `height` rows of `width` values, normalised.
    pub image: Vec<f32>,
    /// Depth to learn, `height` rows of `width`; 0 where it is unknown. Times
    /// [`DepthSample::metres_per_unit`] it is metres.
    pub depth: Vec<f32>,
    /// What depth is to be multiplied by to be metres, see [`CanonicalFocal`].
    pub metres_per_unit: f32,
    /// The camera of this sample, after crop, scale, shift, rotation and flip, without its
    /// lens: pixel `(u, v)` (whole numbers are middles of pixels) at `z` metres is the point
    /// `((u - cx) z / fx, (v - cy) z / fy, z)`.
    pub camera: Intrinsics,
}

impl DepthSample {
    /// Share of the pixels with a depth, 0 to 1.
    #[must_use]
    pub fn known_share(&self) -> f64 {
        let known = self.depth.iter().filter(|depth| DepthMap::is_known(**depth)).count();
        known as f64 / self.depth.len().max(1) as f64
    }
}

/// Samples side by side.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthBatch {
    /// Samples.
    pub count: usize,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `count` x 3 x `height` x `width` normalised values.
    pub images: Vec<f32>,
    /// `count` x `height` x `width` depths to learn, 0 where they are unknown.
    pub depths: Vec<f32>,
    /// [`DepthSample::metres_per_unit`] of each.
    pub metres_per_unit: Vec<f32>,
    /// [`DepthSample::camera`] of each.
    pub cameras: Vec<Intrinsics>,
}

impl DepthBatch {
    /// Puts samples (of one size) side by side.
    #[must_use]
    pub fn collate(samples: &[DepthSample]) -> Self {
        let (width, height) = samples.first().map_or((0, 0), |s| (s.width, s.height));
        let mut batch = Self { count: samples.len(), width, height, ..Self::default() };
        batch.images.reserve_exact(samples.iter().map(|s| s.image.len()).sum());
        batch.depths.reserve_exact(samples.iter().map(|s| s.depth.len()).sum());
        for sample in samples {
            batch.images.extend_from_slice(&sample.image);
            batch.depths.extend_from_slice(&sample.depth);
            batch.metres_per_unit.push(sample.metres_per_unit);
            batch.cameras.push(sample.camera);
        }
        batch
    }
}
