//! The layouts of KITTI's depth benchmark (Uhrig et al., 2017).
//!
//! | layout | pictures | improved truth | raw LiDAR | camera |
//! |---|---|---|---|---|
//! | `val_selection_cropped` | `image/X_image_Y.png` | `groundtruth_depth/X_groundtruth_depth_Y.png` | `velodyne_raw/X_velodyne_raw_Y.png` | `intrinsics/X_image_Y.txt` |
//! | a drive | `image_02/data/N.png` (`image_03`) | `proj_depth/groundtruth/image_02/N.png` | `proj_depth/velodyne_raw/image_02/N.png` | none |
//!
//! Depth is a PNG of 16 bits, 256 units a metre, 0 unknown.

use super::data::{OwnCamera, Sample};
use crate::cli::failure::{OrBadInput, bad_input};
use anyhow::{Context, Result};
use realnet::{CameraModel, Distortion, Intrinsics, picture};
use std::path::{Path, PathBuf};

/// Units a metre.
pub(super) const SCALE: f64 = 256.0;

/// Which of the two truths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Truth {
    /// Eleven scans joined and compared with stereo.
    Improved,
    /// One scan.
    Raw,
}

impl Truth {
    /// By its word; without one, the improved truth.
    pub(super) fn of(word: Option<&str>) -> Result<Self> {
        match word {
            None | Some("improved") => Ok(Self::Improved),
            Some("raw") => Ok(Self::Raw),
            Some(other) => Err(bad_input(format!(
                "--truth {other}: KITTI has 'improved' (its ground truth) and 'raw' (LiDAR)"
            ))),
        }
    }

    /// For the protocol.
    pub(super) fn words(self) -> &'static str {
        match self {
            Self::Improved => "improved ground truth",
            Self::Raw => "raw LiDAR",
        }
    }

    fn folder(self) -> &'static str {
        match self {
            Self::Improved => "groundtruth",
            Self::Raw => "velodyne_raw",
        }
    }

    /// The folder in the selection, a part of its file names too.
    fn selection(self) -> &'static str {
        match self {
            Self::Improved => "groundtruth_depth",
            Self::Raw => "velodyne_raw",
        }
    }
}

/// Whether a folder has one of the layouts.
pub(super) fn is_here(folder: &Path) -> bool {
    let selection = |kind: Truth| folder.join(kind.selection()).is_dir();
    let both = [Truth::Improved, Truth::Raw];
    folder.join("image").is_dir() && both.into_iter().any(selection)
        || folder.join("proj_depth").is_dir()
}

/// The pictures of a folder that have the asked truth.
pub(super) fn list(folder: &Path, truth: Truth, scale: f64) -> Result<Vec<Sample>> {
    let samples = if folder.join("image").is_dir() {
        selection(folder, truth, scale)?
    } else {
        let drive = |camera| drive(folder, camera, truth, scale);
        [drive("image_02")?, drive("image_03")?].concat()
    };
    if samples.is_empty() {
        return Err(bad_input(format!(
            "{}: no KITTI pictures with {}: looked for image/ beside {}/, and image_02/data/ \
             beside proj_depth/{}/image_02/",
            folder.display(),
            truth.words(),
            truth.selection(),
            truth.folder()
        )));
    }
    Ok(samples)
}

fn selection(folder: &Path, truth: Truth, scale: f64) -> Result<Vec<Sample>> {
    let mut samples = Vec::new();
    for (number, color) in (0..).zip(pictures(&folder.join("image"))?) {
        let name = color.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let part = format!("_{}_", truth.selection());
        let depth = folder.join(truth.selection()).join(name.replacen("_image_", &part, 1));
        if !depth.is_file() {
            continue;
        }
        let matrix = folder.join("intrinsics").join(&name).with_extension("txt");
        let camera = if matrix.is_file() { OwnCamera::Matrix(matrix) } else { OwnCamera::Unknown };
        samples.push(Sample { sequence: None, number, color, depth, scale, camera });
    }
    Ok(samples)
}

fn drive(folder: &Path, eye: &str, truth: Truth, scale: f64) -> Result<Vec<Sample>> {
    let (colors, depths) =
        (folder.join(eye).join("data"), folder.join("proj_depth").join(truth.folder()).join(eye));
    if !colors.is_dir() {
        return Ok(Vec::new());
    }
    let mut samples = Vec::new();
    for color in pictures(&colors)? {
        let stem = color.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let depth = depths.join(&stem).with_extension("png");
        let (true, Ok(number)) = (depth.is_file(), stem.parse()) else { continue };
        let (sequence, camera) = (Some(eye.to_owned()), OwnCamera::Unknown);
        samples.push(Sample { sequence, number, color, depth, scale, camera });
    }
    Ok(samples)
}

/// The pictures in a folder, by name.
fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder)
        .with_context(|| format!("cannot list the folder {}", folder.display()))
        .or_bad_input()?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.retain(|path| picture::has_picture_extension(path));
    paths.sort();
    Ok(paths)
}

/// The camera of a file with the nine numbers of its matrix, row by row.
pub(super) fn camera(path: &Path, width: u32, height: u32) -> Result<CameraModel> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read {}", path.display()))
        .or_bad_input()?;
    let numbers: Vec<f64> = text.split_whitespace().map_while(|word| word.parse().ok()).collect();
    let [fx, _, cx, _, fy, cy, ..] = numbers[..] else {
        return Err(bad_input(format!(
            "{}: {} numbers, the nine of a camera matrix are needed",
            path.display(),
            numbers.len()
        )));
    };
    let intrinsics = Intrinsics { fx, fy, cx, cy };
    CameraModel::new(width, height, intrinsics, Distortion::None)
        .with_context(|| path.display().to_string())
        .or_bad_input()
}
