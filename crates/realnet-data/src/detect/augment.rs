//! Pictures with boxes, changed anew in each epoch.

use super::{DetectionSample, DetectionSet, Target};
use crate::color::ColorAugment;
use crate::loader::Samples;
use crate::random::{Dice, Purpose};
use crate::warp::{self, Canvas, Tile};
use crate::{DataError, SampleError};
use realnet_core::nalgebra::Matrix3;
use realnet_core::{BoundingBox, Frame, OptionError};
use realnet_vision::simd::Simd;
use realnet_vision::{Letterbox, Region};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How much the pictures of a detector are changed: YOLOv5's hyper-parameters by their
/// names, with the values of its `hyp.scratch-low.yaml`, and changes of colour. 0 switches
/// a change off.
///
/// A mosaic lays four pictures around a random point of a canvas twice as wide and high
/// as the network's input; the input is cut from its middle after rotation, scale, shear,
/// perspective and shift. Without a mosaic the letterboxed picture takes the same way.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DetectionAugment {
    /// Share of the samples that are mosaics of four pictures.
    pub mosaic: f64,
    /// Share of the mosaics that are mixed with a second one.
    pub mixup: f64,
    /// Rotation by up to ± this, degrees.
    pub degrees: f64,
    /// Shift by up to ± this share of the side.
    pub translate: f64,
    /// Scale by up to `1 ± scale`.
    pub scale: f64,
    /// Shear by up to ± this, degrees, along each axis.
    pub shear: f64,
    /// Perspective by up to ± this, 1 / pixels; 0.001 is much.
    pub perspective: f64,
    /// Share of the pictures that are turned upside down.
    pub flipud: f64,
    /// Share of the pictures that are mirrored.
    pub fliplr: f64,
    /// Changes of colour.
    #[serde(flatten)]
    pub color: ColorAugment,
}

impl Default for DetectionAugment {
    fn default() -> Self {
        let color = ColorAugment {
            hsv_h: 0.015,
            hsv_s: 0.7,
            hsv_v: 0.4,
            grey: 0.01,
            blur: 0.02,
            ..ColorAugment::NONE
        };
        Self { mosaic: 1.0, translate: 0.1, scale: 0.5, fliplr: 0.5, color, ..Self::NONE }
    }
}

impl DetectionAugment {
    /// No change.
    pub const NONE: Self = Self {
        mosaic: 0.0,
        mixup: 0.0,
        degrees: 0.0,
        translate: 0.0,
        scale: 0.0,
        shear: 0.0,
        perspective: 0.0,
        flipud: 0.0,
        fliplr: 0.0,
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
        upto("mosaic", self.mosaic, 1.0, "from 0 to 1")?;
        upto("mixup", self.mixup, 1.0, "from 0 to 1")?;
        upto("degrees", self.degrees, 180.0, "from 0 to 180")?;
        upto("translate", self.translate, 0.9, "from 0 to 0.9")?;
        upto("scale", self.scale, 0.9, "from 0 to 0.9")?;
        upto("shear", self.shear, 45.0, "from 0 to 45 degrees")?;
        upto("perspective", self.perspective, 0.001, "from 0 to 0.001")?;
        upto("flipud", self.flipud, 1.0, "from 0 to 1")?;
        upto("fliplr", self.fliplr, 1.0, "from 0 to 1")?;
        self.color.check()
    }
}

/// The samples of a [`DetectionSet`], augmented or as they are.
#[derive(Debug)]
pub struct DetectionSamples {
    set: Arc<DetectionSet>,
    augment: Option<DetectionAugment>,
    seed: u64,
    mosaic_until: u32,
    simd: Simd,
}

impl DetectionSamples {
    /// Augmented samples; those of another seed are others.
    ///
    /// # Errors
    /// [`DataError::Option`] for an option out of its range.
    pub fn training(
        set: Arc<DetectionSet>,
        augment: DetectionAugment,
        seed: u64,
    ) -> Result<Self, DataError> {
        augment.check()?;
        let simd = Simd::best();
        Ok(Self { set, augment: Some(augment), seed, mosaic_until: u32::MAX, simd })
    }

    /// Letterboxed pictures, as a detector gets them at run time: the same bytes as those
    /// of [`realnet_vision::Letterboxer`].
    #[must_use]
    pub fn validation(set: Arc<DetectionSet>) -> Self {
        Self { set, augment: None, seed: 0, mosaic_until: 0, simd: Simd::best() }
    }

    /// Without mosaic and mixup from this epoch on: the last epochs are for pictures as
    /// they really are.
    #[must_use]
    pub fn with_mosaic_until(self, epoch: u32) -> Self {
        Self { mosaic_until: epoch, ..self }
    }

    /// The pictures behind the samples.
    #[must_use]
    pub fn set(&self) -> &Arc<DetectionSet> {
        &self.set
    }

    /// One picture on its letterbox, or a mosaic that begins with it, warped.
    fn scene(&self, dice: &mut Dice, scene: &Scene, index: usize) -> Result<Shown, SampleError> {
        let size = self.set.size();
        let side = f64::from(size);
        let mut parts = Vec::with_capacity(4);
        let (canvas_side, point) = if scene.mosaic {
            let mut picked = [index, 0, 0, 0];
            for other in &mut picked[1..] {
                *other = dice.below(self.set.images().len());
            }
            dice.shuffle(&mut picked);
            let point = [0.0; 2].map(|_: f64| dice.between(0.5 * side, 1.5 * side).floor());
            for (place, picture) in picked.into_iter().enumerate() {
                let frame = self.set.frame(picture)?;
                let (width, height) = (f64::from(frame.width()), f64::from(frame.height()));
                let x = if place % 2 == 0 { point[0] - width } else { point[0] };
                let y = if place < 2 { point[1] - height } else { point[1] };
                parts.push(Part { picture, frame, offset: [x as f32, y as f32] });
            }
            (2.0 * side, point)
        } else {
            let frame = self.set.frame(index)?;
            let letterbox = Letterbox::fit(Region::whole(&frame), (size, size));
            let offset = [letterbox.left() as f32, letterbox.top() as f32];
            parts.push(Part { picture: index, frame, offset });
            (side, [f64::NEG_INFINITY; 2])
        };
        let out_from_canvas = match &self.augment {
            None => Matrix3::identity(),
            Some(augment) => scene.flips(side) * geometry(augment, dice, canvas_side, side),
        };
        let scale = column_scale(&out_from_canvas, canvas_side);
        let targets = self.targets(&parts, &out_from_canvas, canvas_side, scale);
        // A perspective that cannot be undone does not come from options in their range.
        let canvas_from_out = out_from_canvas.try_inverse().unwrap_or_else(Matrix3::identity);
        let mut tiles = [None; 4];
        let first = if scene.mosaic { 0 } else { 3 };
        for (slot, part) in tiles[first..].iter_mut().zip(&parts) {
            *slot = Some(Tile::new(&part.frame, part.offset));
        }
        let canvas =
            Canvas { tiles, point: point.map(|value| value as f32), size: [canvas_side as f32; 2] };
        let mut image = vec![0; 3 * size as usize * size as usize];
        warp::render(&canvas, &canvas_from_out, (size, size), &mut image);
        Ok(Shown { image, targets })
    }

    /// The boxes of all pictures of a canvas after the warp.
    fn targets(
        &self,
        parts: &[Part],
        out_from_canvas: &Matrix3<f64>,
        canvas_side: f64,
        scale: f64,
    ) -> Vec<Target> {
        let side = self.set.size() as f32;
        let mut all = Vec::new();
        for part in parts {
            let Some(image) = self.set.images().get(part.picture) else { continue };
            let (width, height) = (part.frame.width() as f32, part.frame.height() as f32);
            for target in &image.targets {
                let [x, y] = part.offset;
                let before = target.to_pixels(width, height).translated(x, y);
                let before = before.clipped(canvas_side as f32, canvas_side as f32);
                if !before.is_proper() {
                    continue;
                }
                let Some(around) = around_corners(out_from_canvas, &before) else { continue };
                let after = around.clipped(side, side);
                if self.augment.is_none() || is_candidate(&before, &after, scale as f32) {
                    all.push(Target::from_pixels(target.class_id, &after, side, side));
                }
            }
        }
        all
    }
}

impl Samples for DetectionSamples {
    type Sample = DetectionSample;

    fn len(&self) -> usize {
        self.set.images().len()
    }

    fn sample(&self, epoch: u32, index: usize) -> Result<DetectionSample, SampleError> {
        let size = self.set.size();
        let path = self.set.images().get(index).map(|i| i.path.clone()).unwrap_or_default();
        let mut dice = Dice::new(self.seed, Purpose::Detection, epoch, index);
        let Some(augment) = &self.augment else {
            let Shown { image, targets } = self.scene(&mut dice, &Scene::default(), index)?;
            return Ok(DetectionSample { index, path, size, image, targets });
        };
        let scene = Scene {
            mosaic: dice.chance(augment.mosaic) && epoch < self.mosaic_until,
            flipud: dice.chance(augment.flipud),
            fliplr: dice.chance(augment.fliplr),
        };
        let mixed = dice.chance(augment.mixup) && scene.mosaic;
        let Shown { mut image, mut targets } = self.scene(&mut dice, &scene, index)?;
        if mixed {
            let share = dice.beta(32.0) as f32;
            let other = dice.below(self.set.images().len());
            let second = self.scene(&mut dice, &scene, other)?;
            for (value, other) in image.iter_mut().zip(&second.image) {
                let mixed = f32::from(*value) * share + f32::from(*other) * (1.0 - share);
                *value = (mixed + 0.5) as u8;
            }
            targets.extend(second.targets);
        }
        augment.color.apply(&mut dice, self.simd, (size, size), &mut image);
        Ok(DetectionSample { index, path, size, image, targets })
    }
}

/// A picture on the canvas.
#[derive(Debug)]
struct Part {
    picture: usize,
    frame: Arc<Frame>,
    offset: [f32; 2],
}

/// What a canvas became.
#[derive(Debug)]
struct Shown {
    image: Vec<u8>,
    targets: Vec<Target>,
}

/// What is decided before the pictures are taken; both halves of a mixup share it.
#[derive(Clone, Copy, Debug, Default)]
struct Scene {
    mosaic: bool,
    flipud: bool,
    fliplr: bool,
}

impl Scene {
    /// The flips of an output of `side` pixels.
    fn flips(&self, side: f64) -> Matrix3<f64> {
        let [x, y] = [self.fliplr, self.flipud].map(|flip| if flip { -1.0 } else { 1.0 });
        let shift = |sign: f64| if sign < 0.0 { side } else { 0.0 };
        Matrix3::new(x, 0.0, shift(x), 0.0, y, shift(y), 0.0, 0.0, 1.0)
    }
}

/// YOLOv5's geometry, output from canvas: the canvas's middle to the origin, perspective,
/// rotation and scale, shear, and the origin to the output's middle with a shift. Always
/// takes the same number of random numbers.
fn geometry(augment: &DetectionAugment, dice: &mut Dice, canvas: f64, side: f64) -> Matrix3<f64> {
    let mut center = Matrix3::identity();
    (center[(0, 2)], center[(1, 2)]) = (-canvas / 2.0, -canvas / 2.0);
    let mut perspective = Matrix3::identity();
    perspective[(2, 0)] = dice.around_zero(augment.perspective);
    perspective[(2, 1)] = dice.around_zero(augment.perspective);
    let (sin, cos) = dice.around_zero(augment.degrees).to_radians().sin_cos();
    let scale = 1.0 + dice.around_zero(augment.scale);
    let rotation = Matrix3::new(
        scale * cos,
        scale * sin,
        0.0, //
        -scale * sin,
        scale * cos,
        0.0, //
        0.0,
        0.0,
        1.0,
    );
    let mut shear = Matrix3::identity();
    shear[(0, 1)] = dice.around_zero(augment.shear).to_radians().tan();
    shear[(1, 0)] = dice.around_zero(augment.shear).to_radians().tan();
    let mut shift = Matrix3::identity();
    shift[(0, 2)] = (0.5 + dice.around_zero(augment.translate)) * side;
    shift[(1, 2)] = (0.5 + dice.around_zero(augment.translate)) * side;
    shift * shear * rotation * perspective * center
}

/// How much longer things in the middle of the canvas become.
fn column_scale(map: &Matrix3<f64>, canvas: f64) -> f64 {
    let middle = [canvas / 2.0; 2];
    let [a, b, c] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
        .map(|[dx, dy]: [f64; 2]| warp::apply(map, [middle[0] + dx, middle[1] + dy]));
    let (x, y) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
    (x[0] * y[1] - x[1] * y[0]).abs().sqrt()
}

/// The box around the corners of a box after a projective map; `None` where a corner lies
/// behind the horizon.
fn around_corners(map: &Matrix3<f64>, before: &BoundingBox) -> Option<BoundingBox> {
    let [x0, y0, x1, y1] = <[f32; 4]>::from(*before).map(f64::from);
    let corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]];
    if corners.iter().any(|[x, y]| map[(2, 0)] * x + map[(2, 1)] * y + map[(2, 2)] <= 1e-6) {
        return None;
    }
    let [first, rest @ ..] = corners.map(|corner| warp::apply(map, corner).map(|v| v as f32));
    let point = |[x, y]: [f32; 2]| BoundingBox::new(x, y, x, y);
    Some(rest.into_iter().fold(point(first), |all, corner| all.enclosing(&point(corner))))
}

/// YOLOv5's rule for boxes that are still worth learning: `after` (clipped) is more than 2
/// pixels wide and high, has more than a tenth of the area that `before` has when scaled,
/// and is less than 100 times as long as wide.
fn is_candidate(before: &BoundingBox, after: &BoundingBox, scale: f32) -> bool {
    const EPSILON: f32 = 1e-16;
    let (w, h) = (after.width(), after.height());
    let aspect = (w / (h + EPSILON)).max(h / (w + EPSILON));
    let area = before.area() * scale * scale;
    w > 2.0 && h > 2.0 && w * h > 0.1 * (area + EPSILON) && aspect < 100.0
}

#[cfg(test)]
mod tests;
