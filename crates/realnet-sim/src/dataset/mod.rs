//! Pictures to learn from: random worlds, cameras and vehicles, with boxes and depth.
//!
//! A data set is a row of *clips*. A clip is a drive of [`CLIP_FRAMES`] frames with one
//! camera through one world; another clip is another world, light, camera, lens, mount,
//! sensor and company. Every sample follows from the seed and its index alone, so a data
//! set can be made in parts, in any order, and made longer later.
//!
//! ```
//! use realnet_sim::dataset::{DatasetSpec, Sampler};
//!
//! let spec = DatasetSpec { seed: 1, width: 160, height: 90, mount: None };
//! let mut sampler = Sampler::new(spec);
//! let sample = sampler.sample(3);
//! assert_eq!((sample.clip, sample.step), (0, 3));
//! for label in &sample.labels {
//!     assert!(label.bbox.x1 <= 160.0 && label.class_id < 4);
//! }
//! ```

mod clip;

use crate::VehicleKind;
use crate::render::{Rendered, Renderer, Shot};
use clip::Clip;
use realnet_core::{BoundingBox, CameraModel, DepthMap, Frame, Pose};

/// Frames of a clip.
pub const CLIP_FRAMES: u64 = 8;
/// One clip in so many is for validation.
pub const VALIDATION: u64 = 5;
/// A vehicle is labelled when it shows at least so many pixels …
pub const MIN_PIXELS: usize = 40;
/// … and at least this share of what it would show if nothing hid it.
pub const MIN_VISIBLE: f64 = 0.25;

/// Where the camera of all clips sits, give or take what a mount gives way.
///
/// One picture does not tell how large its world is; how high the camera sits above the
/// ground does. A depth network for one robot learns more of its scale from pictures of
/// that robot's mount than from pictures of all heights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownMount {
    /// Metres above the ground.
    pub height_m: f64,
    /// Pitch, radians, positive: nose down.
    pub pitch_rad: f64,
}

impl KnownMount {
    /// The height of a clip is off by this at most, metres.
    pub const HEIGHT_ERROR_M: f64 = 0.005;
    /// The pitch of a clip, and its yaw and roll, are off by this at most, radians.
    pub const ANGLE_ERROR_RAD: f64 = 0.01;
}

/// What a data set follows from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DatasetSpec {
    /// Seed of everything.
    pub seed: u64,
    /// Pixels a row, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
    /// Where the cameras sit; drawn anew for each clip without it: 0.10 to 0.32 m above
    /// the ground, 0.06 rad nose up to 0.22 nose down.
    pub mount: Option<KnownMount>,
}

/// What a sample is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Split {
    /// To learn from.
    Train,
    /// To measure with; no world is in both.
    Val,
}

impl Split {
    /// Name of its folders.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
        }
    }

    /// The split of a clip.
    #[must_use]
    pub const fn of_clip(clip: u64) -> Self {
        if clip % VALIDATION == VALIDATION - 1 { Self::Val } else { Self::Train }
    }
}

/// A vehicle in a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectLabel {
    /// Index into [`class_names`].
    pub class_id: u32,
    /// Tight box of its visible pixels.
    pub bbox: BoundingBox,
    /// Share of its silhouette in the picture that is not hidden.
    pub visible_share: f64,
    /// Median depth of its visible pixels, metres.
    pub depth_m: f64,
}

/// A picture with everything that is known of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Its index in the data set.
    pub index: u64,
    /// Index of its clip.
    pub clip: u64,
    /// Place in the clip, from 0.
    pub step: u64,
    /// What it is for.
    pub split: Split,
    /// The picture; its stamp is the time since the start of the clip.
    pub frame: Frame,
    /// Exact depth.
    pub depth: DepthMap,
    /// The vehicles that are labelled, see [`MIN_PIXELS`] and [`MIN_VISIBLE`].
    pub labels: Vec<ObjectLabel>,
    /// The camera of the clip.
    pub camera: CameraModel,
    /// Where its optical frame was.
    pub world_from_camera: Pose,
}

/// Names of the classes, by index: the kinds of vehicles.
#[must_use]
pub fn class_names() -> [&'static str; VehicleKind::ALL.len()] {
    VehicleKind::ALL.map(VehicleKind::name)
}

/// Makes samples.
#[derive(Debug)]
pub struct Sampler {
    spec: DatasetSpec,
    clip: Option<(u64, Clip, Renderer)>,
}

impl Sampler {
    /// A sampler; a side of 0 pixels becomes 1.
    #[must_use]
    pub fn new(spec: DatasetSpec) -> Self {
        let (width, height) = (spec.width.max(1), spec.height.max(1));
        Self { spec: DatasetSpec { width, height, ..spec }, clip: None }
    }

    /// The clip of index `clip` and the renderer of its camera.
    fn clip(&mut self, clip: u64) -> &mut (u64, Clip, Renderer) {
        let known = self.clip.take().filter(|(known, ..)| *known == clip);
        let made = || {
            let made = Clip::new(&self.spec, clip);
            let renderer = Renderer::new(made.camera);
            (clip, made, renderer)
        };
        self.clip.insert(known.unwrap_or_else(made))
    }

    /// The camera of a clip.
    #[must_use]
    pub fn camera(&mut self, clip: u64) -> CameraModel {
        self.clip(clip).1.camera.model
    }

    /// Where the camera is at a sample, without making the picture.
    #[must_use]
    pub fn world_from_camera(&mut self, index: u64) -> Pose {
        let (clip, step) = (index / CLIP_FRAMES, index % CLIP_FRAMES);
        let (_, clip, renderer) = self.clip(clip);
        renderer.world_from_camera(&clip.own(step).world_from_base, clip.lean(step))
    }

    /// The sample of an index.
    #[must_use]
    pub fn sample(&mut self, index: u64) -> Sample {
        let (number, step) = (index / CLIP_FRAMES, index % CLIP_FRAMES);
        let seed = clip::mix(self.spec.seed, index, 0x5eed);
        let (_, clip, renderer) = self.clip(number);
        let actors = clip.actors(step);
        let own = clip.own(step);
        let lean = clip.lean(step);
        let shot = Shot { time_s: clip.time(step), own, lean, actors: &actors, seed };
        let mut out = renderer.blank();
        // Each sample stands for itself: exposed as a camera that had time to settle.
        renderer.reset_exposure();
        renderer.render(&clip.scene, &shot, &mut out);
        let labels = (0..actors.len()).filter_map(|i| label(&out, i, actors[i].kind)).collect();
        Sample {
            index,
            clip: number,
            step,
            split: Split::of_clip(number),
            labels,
            camera: clip.camera.model,
            world_from_camera: renderer.world_from_camera(&own.world_from_base, lean),
            frame: out.frame,
            depth: out.depth,
        }
    }
}

fn label(out: &Rendered, index: usize, kind: VehicleKind) -> Option<ObjectLabel> {
    let truth = out.truth(index)?;
    let class = VehicleKind::ALL.iter().position(|other| *other == kind)?;
    (truth.pixels >= MIN_PIXELS && truth.visible_share >= MIN_VISIBLE).then_some(ObjectLabel {
        class_id: class as u32,
        bbox: truth.bbox,
        visible_share: truth.visible_share,
        depth_m: truth.depth_median_m,
    })
}

#[cfg(test)]
mod tests;
