//! Pictures with depth, changed anew in each epoch.

use super::{CanonicalFocal, DepthSample, DepthSet};
use crate::color::ColorAugment;
use crate::loader::Samples;
use crate::random::{Dice, Purpose};
use crate::warp::{self, Canvas, Tile};
use crate::{DataError, SampleError};
use realnet_core::nalgebra::Matrix3;
use realnet_core::{Intrinsics, OptionError};
use realnet_vision::simd::Simd;
use realnet_vision::{Letterbox, Region};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

/// How much pictures with depth are changed. 0 switches a change off.
///
/// Every change of geometry is one that a camera could have made by itself: another focal
/// length and principal point ([`zoom`](Self::zoom), [`translate`](Self::translate)), a
/// turn about the optical axis ([`degrees`](Self::degrees)), a mirror. All of them keep the
/// depth of each point, so depths are only moved, never changed; what changes is the
/// camera, and through its focal length the depth to learn, see [`CanonicalFocal`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthAugment {
    /// Share of the pictures that are mirrored.
    pub fliplr: f64,
    /// Turn about the optical axis by up to ± this, degrees.
    pub degrees: f64,
    /// Factor by which the picture is magnified, from the first to the second, evenly on a
    /// logarithmic scale. Below 1 there are bars around it.
    pub zoom: [f64; 2],
    /// Shift by up to ± this share of the input's sides.
    pub translate: f64,
    /// Changes of colour.
    #[serde(flatten)]
    pub color: ColorAugment,
}

impl Default for DepthAugment {
    fn default() -> Self {
        let color = ColorAugment {
            hsv_h: 0.02,
            hsv_s: 0.4,
            brightness: 0.1,
            contrast: 0.2,
            gamma: 0.2,
            exposure: 0.5,
            grey: 0.05,
            blur: 0.1,
            noise: 0.1,
            noise_level: 0.03,
            jpeg: 0.1,
            ..ColorAugment::NONE
        };
        // Around 1, where validation and run time are: else their depths would be the
        // edge of what was learned.
        Self { fliplr: 0.5, degrees: 5.0, zoom: [0.8, 1.25], translate: 0.1, color }
    }
}

impl DepthAugment {
    /// No change.
    pub const NONE: Self = Self {
        fliplr: 0.0,
        degrees: 0.0,
        zoom: [1.0, 1.0],
        translate: 0.0,
        color: ColorAugment::NONE,
    };

    /// Refuses what cannot be.
    ///
    /// # Errors
    /// [`OptionError`] with the first option that is out of its range.
    pub fn check(&self) -> Result<(), OptionError> {
        let upto = |name, value: f64, most: f64, rule| {
            OptionError::check(name, value, (0.0..=most).contains(&value), rule)
        };
        upto("fliplr", self.fliplr, 1.0, "from 0 to 1")?;
        upto("degrees", self.degrees, 180.0, "from 0 to 180")?;
        let [least, most] = self.zoom;
        let in_range = |zoom: f64| (0.25..=4.0).contains(&zoom);
        OptionError::check("zoom[0]", least, in_range(least), "from 0.25 to 4")?;
        let ok = in_range(most) && most >= least;
        OptionError::check("zoom[1]", most, ok, "from zoom[0] to 4")?;
        upto("translate", self.translate, 0.5, "from 0 to 0.5")?;
        self.color.check()
    }
}

/// What bytes become: `(byte / 255 - mean) / std` for red, green and blue.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Normalization {
    /// Taken off values from 0 to 1.
    pub mean: [f32; 3],
    /// What the rest is divided by.
    pub std: [f32; 3],
}

impl Default for Normalization {
    /// Values from 0 to 1 as they are.
    fn default() -> Self {
        Self { mean: [0.0; 3], std: [1.0; 3] }
    }
}

impl Normalization {
    /// The mean and deviation of ImageNet's pictures, as networks trained on it expect.
    pub const IMAGENET: Self = Self { mean: [0.485, 0.456, 0.406], std: [0.229, 0.224, 0.225] };

    fn check(&self) -> Result<(), OptionError> {
        for (mean, std) in self.mean.into_iter().zip(self.std) {
            OptionError::check("mean", f64::from(mean), true, "finite")?;
            OptionError::check("std", f64::from(std), std > 0.0, "above 0")?;
        }
        Ok(())
    }
}

/// The samples of a [`DepthSet`], augmented or as they are.
#[derive(Debug)]
pub struct DepthSamples {
    set: Arc<DepthSet>,
    augment: DepthAugment,
    canonical: CanonicalFocal,
    normalization: Normalization,
    range: [f32; 2],
    seed: u64,
    simd: Simd,
}

impl DepthSamples {
    /// Augmented samples; those of another seed are others.
    ///
    /// # Errors
    /// [`DataError::Option`] for an option out of its range.
    pub fn training(
        set: Arc<DepthSet>,
        augment: DepthAugment,
        canonical: CanonicalFocal,
        normalization: Normalization,
        seed: u64,
    ) -> Result<Self, DataError> {
        augment.check()?;
        normalization.check()?;
        let (range, simd) = ([0.0, f32::INFINITY], Simd::best());
        Ok(Self { set, augment, canonical, normalization, range, seed, simd })
    }

    /// Letterboxed pictures, as a network gets them at run time.
    ///
    /// # Errors
    /// [`DataError::Option`] for a normalisation that is none.
    pub fn validation(
        set: Arc<DepthSet>,
        canonical: CanonicalFocal,
        normalization: Normalization,
    ) -> Result<Self, DataError> {
        Self::training(set, DepthAugment::NONE, canonical, normalization, 0)
    }

    /// Depths to learn (after [`CanonicalFocal`]) outside of `least` to `most` become
    /// unknown: those that the network's bins cannot say.
    #[must_use]
    pub fn with_range(self, least: f32, most: f32) -> Self {
        Self { range: [least, most], ..self }
    }

    /// The pictures behind the samples.
    #[must_use]
    pub fn set(&self) -> &Arc<DepthSet> {
        &self.set
    }

    /// The canonical focal length.
    #[must_use]
    pub fn canonical(&self) -> CanonicalFocal {
        self.canonical
    }
}

impl Samples for DepthSamples {
    type Sample = DepthSample;

    fn len(&self) -> usize {
        self.set.len()
    }

    fn sample(&self, epoch: u32, index: usize) -> Result<DepthSample, SampleError> {
        let kept = self.set.kept(index)?;
        let (width, height) = self.set.size();
        let mut dice = Dice::new(self.seed, Purpose::Depth, epoch, index);
        let view = View::new(&self.augment, &mut dice, &kept, (width, height));
        let plane = width as usize * height as usize;
        let tile = Tile::new(&kept.frame, [0.0; 2]);
        let canvas = Canvas::of(tile, [kept.frame.width() as f32, kept.frame.height() as f32]);
        let mut bytes = vec![0; 3 * plane];
        warp::render(&canvas, &view.source_from_out, (width, height), &mut bytes);
        self.augment.color.apply(&mut dice, self.simd, (width, height), &mut bytes);
        let mut image = Vec::with_capacity(3 * plane);
        let Normalization { mean, std } = self.normalization;
        for ((bytes, mean), std) in bytes.chunks_exact(plane).zip(mean).zip(std) {
            let (scale, offset) = (1.0 / (255.0 * std), -mean / std);
            image.extend(bytes.iter().map(|&byte| f32::from(byte) * scale + offset));
        }
        let to_units = self.canonical.from_metres(&view.camera) as f32;
        let [least, most] = self.range;
        let mut depth = Vec::with_capacity(plane);
        warp::render_depth(&kept.depth, &view.source_from_out, (width, height), |metres| {
            let units = metres * to_units;
            depth.push(if units >= least && units <= most { units } else { 0.0 });
        });
        Ok(DepthSample {
            index,
            path: self.set.path(index).map(Path::to_path_buf).unwrap_or_default(),
            width,
            height,
            image,
            depth,
            metres_per_unit: self.canonical.to_metres(&view.camera) as f32,
            camera: view.camera,
        })
    }
}

/// A camera at the same place that sees the picture otherwise.
#[derive(Debug)]
struct View {
    /// Places in the kept picture from places in the output, both counted from the edge.
    source_from_out: Matrix3<f64>,
    /// The camera of the output.
    camera: Intrinsics,
}

impl View {
    /// Draws a view for a network with an input of `size`. Always takes the same number of
    /// random numbers.
    ///
    /// With the rays of both cameras at unit depth, `source = Q out` with `Q` a turn about
    /// the optical axis and a mirror, places are related by `K_source Q K_out⁻¹`, and `Q`
    /// leaves depth alone.
    fn new(
        augment: &DepthAugment,
        dice: &mut Dice,
        kept: &super::set::Kept,
        size: (u32, u32),
    ) -> Self {
        let [least, most] = augment.zoom;
        let zoom = dice.between(least.ln(), most.ln()).exp();
        let zoom = if least == most { least } else { zoom };
        let (sin, cos) = dice.around_zero(augment.degrees).to_radians().sin_cos();
        let mirror = if dice.chance(augment.fliplr) { -1.0 } else { 1.0 };
        let shift = [0.0; 2].map(|_: f64| dice.around_zero(augment.translate));

        let letterbox = Letterbox::fit(Region::whole(&kept.frame), size);
        let (width, height) = letterbox.scaled_size();
        let sx = f64::from(width) / f64::from(kept.frame.width());
        let sy = f64::from(height) / f64::from(kept.frame.height());
        let Intrinsics { fx, fy, cx, cy } = kept.camera;
        let (cx, cy) = (cx + 0.5, cy + 0.5); // counted from the edge
        let side = [f64::from(size.0), f64::from(size.1)];
        let boxed = [cx * sx + f64::from(letterbox.left()), cy * sy + f64::from(letterbox.top())];
        // The mirror turns the principal point about the middle, too, so that the picture
        // stays where it is.
        let boxed = [if mirror < 0.0 { side[0] - boxed[0] } else { boxed[0] }, boxed[1]];
        let place = |axis: usize| {
            (boxed[axis] - side[axis] / 2.0) * zoom + side[axis] * (0.5 + shift[axis])
        };
        let (out_fx, out_fy) = (fx * sx * zoom, fy * sy * zoom);
        let (out_cx, out_cy) = (place(0), place(1));
        let source = Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0);
        let turn = Matrix3::new(mirror * cos, -sin, 0.0, mirror * sin, cos, 0.0, 0.0, 0.0, 1.0);
        let out_inverse = Matrix3::new(
            1.0 / out_fx,
            0.0,
            -out_cx / out_fx, //
            0.0,
            1.0 / out_fy,
            -out_cy / out_fy, //
            0.0,
            0.0,
            1.0,
        );
        Self {
            source_from_out: source * turn * out_inverse,
            camera: Intrinsics { fx: out_fx, fy: out_fy, cx: out_cx - 0.5, cy: out_cy - 0.5 },
        }
    }
}

#[cfg(test)]
mod tests;
