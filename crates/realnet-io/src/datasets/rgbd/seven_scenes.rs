//! The layout of Microsoft's 7-Scenes.

use super::{RawFrame, RgbdError, RgbdLayout, entries, insert, poses};
use std::collections::BTreeMap;
use std::path::Path;

/// Number and rest of `frame-NNNNNN.rest`.
fn parts(name: &str) -> Option<(u64, &str)> {
    let (number, rest) = name.strip_prefix("frame-")?.split_once('.')?;
    let digits = !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit());
    if digits { Some((number.parse().ok()?, rest)) } else { None }
}

fn is_color_rest(rest: &str) -> bool {
    matches!(rest, "color.png" | "color.jpg" | "color.jpeg")
}

/// True for the name of a colour picture.
pub(super) fn is_color(name: &str) -> bool {
    parts(name).is_some_and(|(_, rest)| is_color_rest(rest))
}

/// The frames by number.
pub(super) fn list(folder: &Path) -> Result<Vec<RawFrame>, RgbdError> {
    let mut color = BTreeMap::new();
    let mut depth = BTreeMap::new();
    let mut pose = BTreeMap::new();
    for entry in entries(folder)? {
        match parts(&entry.name) {
            Some((number, rest)) if is_color_rest(rest) => {
                insert(&mut color, "colour", number, entry.path)?;
            }
            Some((number, "depth.png" | "depth.pgm")) => {
                insert(&mut depth, "depth", number, entry.path)?;
            }
            Some((number, "pose.txt")) => insert(&mut pose, "pose", number, entry.path)?,
            _ => {}
        }
    }
    if color.is_empty() {
        return Err(RgbdError::NoFrames {
            path: folder.to_path_buf(),
            layout: RgbdLayout::SevenScenes,
            wanted: "frame-NNNNNN.color.png",
        });
    }
    let frame = |(number, color)| {
        let pose = pose.get(&number).map(|p| poses::read_matrix(p)).transpose()?;
        let depth = depth.remove(&number);
        Ok(RawFrame { number, color, depth, pose, ..RawFrame::default() })
    };
    color.into_iter().map(frame).collect()
}
