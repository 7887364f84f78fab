//! The depth data of KITTI (Uhrig et al., 2017): depth maps of 256 units a metre.
//!
//! Two forms are read. The selections for validation and test have one folder:
//! `image/DRIVE_image_NNNNNNNNNN_image_02.png`, `groundtruth_depth/DRIVE_groundtruth_depth_…`
//! and `intrinsics/DRIVE_image_….txt`. A drive has `image_02/data/N.png` (or `image_03`) of
//! the raw recordings and `proj_depth/groundtruth/image_02/N.png` of the depth data put
//! together; its calibration is `calib_cam_to_cam.txt`, in its folder or the one above.

use super::{RawFrame, RgbdError, RgbdLayout, entries, numbered::number};
use crate::picture;
use std::path::{Path, PathBuf};

const CAMERAS: [&str; 2] = ["image_02", "image_03"];
const CALIBRATION: &str = "calib_cam_to_cam.txt";

/// True when one of the two forms is there.
pub(super) fn is_here(folder: &Path) -> bool {
    is_selection(folder) || drive(folder).is_some()
}

fn is_selection(folder: &Path) -> bool {
    folder.join("image").is_dir() && folder.join("groundtruth_depth").is_dir()
}

/// The camera that has both pictures and depth.
fn drive(folder: &Path) -> Option<&'static str> {
    CAMERAS.into_iter().find(|camera| {
        folder.join(camera).join("data").is_dir() && folder.join(GROUND_TRUTH).join(camera).is_dir()
    })
}

const GROUND_TRUTH: &str = "proj_depth/groundtruth";

/// The pictures with their depth maps, by name.
pub(super) fn list(folder: &Path) -> Result<Vec<RawFrame>, RgbdError> {
    let (images, depths, camera) = match drive(folder) {
        Some(camera) => {
            (folder.join(camera).join("data"), folder.join(GROUND_TRUTH).join(camera), Some(camera))
        }
        None if is_selection(folder) => {
            (folder.join("image"), folder.join("groundtruth_depth"), None)
        }
        None => return Err(no_frames(folder)),
    };
    let calibration = camera.and_then(|_| {
        let beside = folder.join(CALIBRATION);
        let above = folder.parent().map(|above| above.join(CALIBRATION));
        [Some(beside), above].into_iter().flatten().find(|path| path.is_file())
    });
    let mut frames = Vec::new();
    let pictures =
        entries(&images)?.into_iter().filter(|e| picture::has_picture_extension(&e.path));
    for (place, entry) in (0..).zip(pictures) {
        let stem = entry.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let depth = match camera {
            Some(_) => depths.join(format!("{stem}.png")),
            None => {
                depths.join(format!("{}.png", stem.replacen("_image_", "_groundtruth_depth_", 1)))
            }
        };
        let camera_file = match camera {
            Some(_) => calibration.clone(),
            None => Some(folder.join("intrinsics").join(format!("{stem}.txt"))),
        };
        frames.push(RawFrame {
            number: if camera.is_some() { number(&stem).unwrap_or(place) } else { place },
            color: entry.path,
            depth: Some(depth).filter(|path| path.is_file()),
            camera_file: camera_file.filter(|path: &PathBuf| path.is_file()),
            ..RawFrame::default()
        });
    }
    if frames.is_empty() { Err(no_frames(folder)) } else { Ok(frames) }
}

fn no_frames(folder: &Path) -> RgbdError {
    let wanted =
        "image/ beside groundtruth_depth/, or image_02/data/ beside proj_depth/groundtruth/";
    RgbdError::NoFrames { path: folder.to_path_buf(), layout: RgbdLayout::Kitti, wanted }
}
