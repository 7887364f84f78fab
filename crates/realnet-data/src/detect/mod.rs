//! Pictures with boxes.

mod augment;
mod set;

pub use augment::{DetectionAugment, DetectionSamples};
pub(crate) use set::reason;
pub use set::{DetectionImage, DetectionSet};

use realnet_core::BoundingBox;
use std::path::PathBuf;

/// An object: its class, and the middle and size of its box as shares of the picture's
/// width and height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Index of the class.
    pub class_id: u32,
    /// Middle, x.
    pub cx: f32,
    /// Middle, y.
    pub cy: f32,
    /// Width.
    pub w: f32,
    /// Height.
    pub h: f32,
}

impl Target {
    /// The box in pixels of a picture of `width` x `height`.
    #[must_use]
    pub fn to_pixels(&self, width: f32, height: f32) -> BoundingBox {
        BoundingBox::from_center(self.cx * width, self.cy * height, self.w * width, self.h * height)
    }

    /// The target of a box in pixels of a picture of `width` x `height`.
    #[must_use]
    pub fn from_pixels(class_id: u32, bbox: &BoundingBox, width: f32, height: f32) -> Self {
        let (cx, cy) = bbox.center();
        let (w, h) = (bbox.width() / width, bbox.height() / height);
        Self { class_id, cx: cx / width, cy: cy / height, w, h }
    }
}

/// What a detector is shown once.
#[derive(Clone, Debug, PartialEq)]
pub struct DetectionSample {
    /// Index of the (first) picture in its set.
    pub index: usize,
    /// The picture's file; empty for one given in memory.
    pub path: PathBuf,
    /// Pixels a row and rows.
    pub size: u32,
    /// Planes of red, green and blue, each of `size` rows of `size` bytes.
    pub image: Vec<u8>,
    /// The objects in it.
    pub targets: Vec<Target>,
}

/// Samples side by side.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DetectionBatch {
    /// Samples.
    pub count: usize,
    /// Pixels a row and rows.
    pub size: u32,
    /// `count` x 3 x `size` x `size` values from 0 to 1: bytes divided by 255.
    pub images: Vec<f32>,
    /// `[place in the batch, class, cx, cy, w, h]` of each object, the boxes as shares of
    /// the picture's side.
    pub targets: Vec<[f32; 6]>,
}

impl DetectionBatch {
    /// Puts samples (of one size) side by side.
    #[must_use]
    pub fn collate(samples: &[DetectionSample]) -> Self {
        let size = samples.first().map_or(0, |sample| sample.size);
        let values = samples.iter().map(|sample| sample.image.len()).sum();
        let mut batch = Self { count: samples.len(), size, ..Self::default() };
        batch.images.reserve_exact(values);
        for (place, sample) in samples.iter().enumerate() {
            batch.images.extend(sample.image.iter().map(|&byte| f32::from(byte) * (1.0 / 255.0)));
            batch.targets.extend(
                sample
                    .targets
                    .iter()
                    .map(|t| [place as f32, t.class_id as f32, t.cx, t.cy, t.w, t.h]),
            );
        }
        batch
    }
}
