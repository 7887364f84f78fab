//! Layouts with numbers as names.

use super::{Entry, RawFrame, RgbdError, RgbdLayout, entries, insert, poses};
use crate::picture;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Names of the folder with the colour pictures.
const COLOR: [&str; 2] = ["color", "rgb"];
const DEPTH: &str = "depth";
const POSES: &str = "pose.txt";

/// The number that a stem is, digits only.
pub(super) fn number(stem: &str) -> Option<u64> {
    let digits = !stem.is_empty() && stem.bytes().all(|b| b.is_ascii_digit());
    if digits { stem.parse().ok() } else { None }
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn is_depth_file(path: &Path) -> bool {
    matches!(picture::extension(path).as_deref(), Some("png" | "pgm"))
}

/// The first of the colour folders that exists.
fn color_folder(folder: &Path) -> Option<PathBuf> {
    COLOR.iter().map(|name| folder.join(name)).find(|path| path.is_dir())
}

/// True when there are colour and depth folders with numbered pictures.
pub(super) fn has_folders(folder: &Path) -> Result<bool, RgbdError> {
    let Some(color) = color_folder(folder) else { return Ok(false) };
    let is_numbered =
        |e: &Entry| picture::has_picture_extension(&e.path) && number(&stem(&e.path)).is_some();
    Ok(folder.join(DEPTH).is_dir() && entries(&color)?.iter().any(is_numbered))
}

/// True when there is a depth picture beside a numbered one.
pub(super) fn has_pairs(entries: &[Entry]) -> bool {
    entries.iter().any(|e| pair_depth(&e.path).is_some())
}

/// The number of `N_depth.png`.
fn pair_depth(path: &Path) -> Option<u64> {
    if is_depth_file(path) { number(stem(path).strip_suffix("_depth")?) } else { None }
}

/// The frames of `color/` and `depth/`.
pub(super) fn list_folders(folder: &Path) -> Result<Vec<RawFrame>, RgbdError> {
    let mut color = BTreeMap::new();
    let mut depth = BTreeMap::new();
    let colors = color_folder(folder).map_or_else(|| Ok(Vec::new()), |path| entries(&path))?;
    for Entry { path, .. } in colors {
        if let (true, Some(n)) = (picture::has_picture_extension(&path), number(&stem(&path))) {
            insert(&mut color, "colour", n, path)?;
        }
    }
    let depths = folder.join(DEPTH);
    for Entry { path, .. } in if depths.is_dir() { entries(&depths)? } else { Vec::new() } {
        if let (true, Some(n)) = (is_depth_file(&path), number(&stem(&path))) {
            insert(&mut depth, "depth", n, path)?;
        }
    }
    frames(folder, RgbdLayout::Numbered, "color/N.png or rgb/N.png", color, depth)
}

/// The frames of `N.png` and `N_depth.png`.
pub(super) fn list_pairs(folder: &Path) -> Result<Vec<RawFrame>, RgbdError> {
    let mut color = BTreeMap::new();
    let mut depth = BTreeMap::new();
    for Entry { path, .. } in entries(folder)? {
        if let Some(n) = pair_depth(&path) {
            insert(&mut depth, "depth", n, path)?;
        } else if let (true, Some(n)) =
            (picture::has_picture_extension(&path), number(&stem(&path)))
        {
            insert(&mut color, "colour", n, path)?;
        }
    }
    frames(folder, RgbdLayout::Pairs, "N.png", color, depth)
}

/// Joins colour, depth and the poses of `pose.txt`, if there is one.
fn frames(
    folder: &Path,
    layout: RgbdLayout,
    wanted: &'static str,
    color: BTreeMap<u64, PathBuf>,
    mut depth: BTreeMap<u64, PathBuf>,
) -> Result<Vec<RawFrame>, RgbdError> {
    if color.is_empty() {
        return Err(RgbdError::NoFrames { path: folder.to_path_buf(), layout, wanted });
    }
    let path = folder.join(POSES);
    let poses = if path.exists() {
        let poses = poses::read_list(&path)?;
        if poses.len() != color.len() {
            let (found, frames) = (poses.len(), color.len());
            let message = format!("{found} poses for {frames} frames, one a line is needed");
            return Err(RgbdError::Count { path, message });
        }
        poses.into_iter().map(Some).collect()
    } else {
        vec![None; color.len()]
    };
    let frame = |((number, color), pose)| {
        let depth = depth.remove(&number);
        RawFrame { number, color, depth, pose, ..RawFrame::default() }
    };
    Ok(color.into_iter().zip(poses).map(frame).collect())
}
