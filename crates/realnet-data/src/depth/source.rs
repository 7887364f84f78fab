//! Where pictures with depth come from.

use crate::DataError;
use realnet_core::{CameraModel, Distortion, Intrinsics};
use realnet_io::datasets::rgbd::{RgbdError, RgbdFrame, RgbdOptions, RgbdSequence};
use realnet_io::picture::Limits;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The part of a data set that samples are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthPart {
    /// To learn from.
    Train,
    /// To measure with.
    Val,
    /// Everything.
    All,
}

/// Which frames of a sequence are for validation. Frames beside each other show the same
/// place, so whole blocks of them are held out, never single ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HoldOut {
    /// Frames of a block, at least 1.
    pub block: usize,
    /// One block in so many is for validation (the last of them), at least 2.
    pub every: usize,
    /// So many frames for training beside a block for validation are used for nothing: in a
    /// video they are nearly the same pictures.
    #[serde(default)]
    pub gap: usize,
}

impl HoldOut {
    /// What the frame at a place of its sequence is for; `None` for nothing.
    #[must_use]
    pub fn part(&self, place: usize) -> Option<DepthPart> {
        let every = self.every.max(2);
        let is_val = |place: usize| (place / self.block.max(1)) % every == every - 1;
        if is_val(place) {
            return Some(DepthPart::Val);
        }
        let near = (1..=self.gap).any(|step| {
            is_val(place.saturating_add(step)) || place.checked_sub(step).is_some_and(is_val)
        });
        (!near).then_some(DepthPart::Train)
    }
}

/// A camera as it is given by hand.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceCamera {
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point, x, pixels.
    pub cx: f64,
    /// Principal point, y, pixels.
    pub cy: f64,
    /// Pixels a row of the pictures that these numbers are for; `None`: of the pictures
    /// that there are.
    #[serde(default)]
    pub width: Option<u32>,
    /// Rows of the pictures that these numbers are for.
    #[serde(default)]
    pub height: Option<u32>,
}

impl SourceCamera {
    /// The camera for pictures of `width` x `height` pixels.
    ///
    /// # Errors
    /// What is wrong: numbers that make no camera, or a picture of another shape.
    pub fn at(&self, width: u32, height: u32) -> Result<CameraModel, String> {
        let Self { fx, fy, cx, cy, .. } = *self;
        let own = (self.width.unwrap_or(width), self.height.unwrap_or(height));
        let camera =
            CameraModel::new(own.0, own.1, Intrinsics { fx, fy, cx, cy }, Distortion::None)
                .map_err(|e| e.to_string())?;
        if own == (width, height) {
            return Ok(camera);
        }
        let stretch =
            (f64::from(width) / f64::from(own.0)) / (f64::from(height) / f64::from(own.1));
        if (stretch - 1.0).abs() > 0.01 {
            return Err(format!(
                "the camera is for pictures of {}x{} pixels, this one has {width}x{height}: \
                 another shape",
                own.0, own.1
            ));
        }
        camera.scaled(width, height).map_err(|e| e.to_string())
    }
}

/// A folder of pictures with depth.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthSource {
    /// An RGB-D sequence in a layout of [`realnet_io::datasets::rgbd`]; a folder of such
    /// sequences; or a set written by `realnet sim --dataset`.
    pub path: PathBuf,
    /// Depth units a metre; `None` takes the layout's. PNG files in millimetres need 1000.
    #[serde(default)]
    pub depth_scale: Option<f64>,
    /// The camera; `None` takes that of a file beside the pictures.
    #[serde(default)]
    pub camera: Option<SourceCamera>,
    /// Frames for validation. `None`: all are for training, except in sets of the
    /// simulator, which are divided already.
    #[serde(default)]
    pub hold_out: Option<HoldOut>,
    /// Depths beyond this are unknown, metres.
    #[serde(default)]
    pub max_depth: Option<f32>,
}

impl DepthSource {
    /// A folder, with everything else taken from its files.
    #[must_use]
    pub fn new(path: impl Into<PathBuf>) -> Self {
        let path = path.into();
        Self { path, depth_scale: None, camera: None, hold_out: None, max_depth: None }
    }

    /// The frames of a part.
    pub(crate) fn frames(
        &self,
        part: DepthPart,
        limits: &Limits,
    ) -> Result<Vec<RgbdFrame>, DataError> {
        let message = |message: String| DataError::List { path: self.path.clone(), message };
        if let Some(HoldOut { block, every, .. }) = self.hold_out
            && (block == 0 || every < 2)
        {
            let text =
                format!("hold_out: block is {block} and every is {every}, the least is 1 and 2");
            return Err(message(text));
        }
        if self.max_depth.is_some_and(|most| !(most > 0.0 && most.is_finite())) {
            return Err(message("max_depth must be above 0 m".to_owned()));
        }
        let options = RgbdOptions {
            depth_scale: self.depth_scale,
            limits: *limits,
            ..RgbdOptions::default()
        };
        let drawn = self.path.join("rgbd");
        let mut frames = Vec::new();
        if self.path.join("dataset.json").is_file() && drawn.is_dir() {
            // A set of the simulator: its clips are divided already.
            for (name, of) in [("train", DepthPart::Train), ("val", DepthPart::Val)] {
                let folder = drawn.join(name);
                if (part == of || part == DepthPart::All) && folder.is_dir() {
                    for clip in subfolders(&folder)? {
                        // A clip that was interrupted before its first frame has none.
                        match RgbdSequence::open(&clip, &options) {
                            Ok(sequence) => frames.extend_from_slice(sequence.frames()),
                            Err(RgbdError::Unrecognised { .. }) => {}
                            Err(error) => return Err(error.into()),
                        }
                    }
                }
            }
            return Ok(frames);
        }
        let sequences = match RgbdSequence::open(&self.path, &options) {
            Ok(sequence) => vec![sequence],
            Err(RgbdError::Several { path, names }) => names
                .iter()
                .map(|name| RgbdSequence::open(&path.join(name), &options))
                .collect::<Result<_, _>>()?,
            Err(error @ RgbdError::Unrecognised { .. }) => {
                let found: Vec<_> = subfolders(&self.path)?
                    .iter()
                    .filter_map(|folder| RgbdSequence::open(folder, &options).ok())
                    .collect();
                if found.is_empty() {
                    return Err(error.into());
                }
                found
            }
            Err(error) => return Err(error.into()),
        };
        for sequence in &sequences {
            frames.extend(sequence.frames().iter().enumerate().filter_map(|(place, frame)| {
                let of = match self.hold_out {
                    Some(hold_out) => hold_out.part(place),
                    None => Some(DepthPart::Train),
                };
                (part == DepthPart::All || Some(part) == of).then(|| frame.clone())
            }));
        }
        Ok(frames)
    }
}

/// The folders in a folder, by name.
fn subfolders(folder: &Path) -> Result<Vec<PathBuf>, DataError> {
    let failed = |error: std::io::Error| DataError::List {
        path: folder.to_path_buf(),
        message: error.to_string(),
    };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Several sources, as a YAML file has them:
///
/// ```yaml
/// sources:
///   - path: nyu/train            # relative to this file
///     depth_scale: 1000          # PNG in millimetres
///     camera: { fx: 518.9, fy: 519.5, cx: 325.6, cy: 253.7, width: 640, height: 480 }
///     hold_out: { block: 40, every: 5, gap: 5 }
///   - path: simulated
/// ```
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceList {
    /// The sources, in this order.
    pub sources: Vec<DepthSource>,
}

impl SourceList {
    /// Reads a YAML file; for a folder, a list of that folder alone.
    ///
    /// # Errors
    /// [`DataError::List`] with the file and what is wrong, with line and column where the
    /// parser knows them.
    pub fn open(path: &Path) -> Result<Self, DataError> {
        if path.is_dir() {
            return Ok(Self { sources: vec![DepthSource::new(path)] });
        }
        let failed = |message: String| DataError::List { path: path.to_path_buf(), message };
        let text = std::fs::read_to_string(path).map_err(|e| failed(e.to_string()))?;
        let mut list: Self = serde_saphyr::from_str(&text).map_err(|e| failed(e.to_string()))?;
        if list.sources.is_empty() {
            return Err(failed("`sources` is empty".to_owned()));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        for source in &mut list.sources {
            source.path = folder.join(&source.path);
        }
        Ok(list)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_held_out_with_a_gap() {
        let parts = |gap| -> String {
            let hold_out = HoldOut { block: 3, every: 3, gap };
            let letter = |place| match hold_out.part(place) {
                Some(DepthPart::Val) => 'v',
                Some(_) => 't',
                None => '-',
            };
            (0..20).map(letter).collect()
        };
        assert_eq!(parts(0), "ttttttvvvttttttvvvtt");
        assert_eq!(parts(2), "tttt--vvv--tt--vvv--");
        assert_eq!(parts(9), "------vvv------vvv--");
    }
}
