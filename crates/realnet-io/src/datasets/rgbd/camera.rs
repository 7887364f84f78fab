//! Camera files beside pictures.

use super::{RgbdError, read_text};
use realnet_core::{CameraCalibration, CameraModel, Distortion, Intrinsics};
use std::path::{Path, PathBuf};

/// Names that a camera file of a whole sequence may have.
const NAMES: [&str; 3] = ["camera.yaml", "camera.yml", "intrinsics.txt"];

/// The camera file of a sequence, if there is one.
pub(super) fn beside(folder: &Path) -> Option<PathBuf> {
    NAMES.iter().map(|name| folder.join(name)).find(|path| path.is_file())
}

/// The camera of a file for pictures of `width` x `height`.
///
/// - `.yaml`: the calibration of ROS, scaled to the size of the picture;
/// - `calib_cam_to_cam.txt` of KITTI: the rectified camera 2 (or 3, if `picture` is of it);
/// - other `.txt`: `fx fy cx cy`, or the nine numbers of the camera matrix row by row, in
///   pixels of the picture.
pub(super) fn read(
    path: &Path,
    picture: &Path,
    (width, height): (u32, u32),
) -> Result<CameraModel, RgbdError> {
    let bad = |message: String| RgbdError::Camera { path: path.to_path_buf(), message };
    let text = read_text(path)?;
    let is_yaml = path.extension().is_some_and(|e| e == "yaml" || e == "yml");
    if is_yaml {
        let calibration =
            CameraCalibration::from_ros_yaml(&text).map_err(|e| bad(e.to_string()))?;
        let camera = *calibration.camera();
        if (camera.width(), camera.height()) == (width, height) {
            return Ok(camera);
        }
        let aspect = |w: u32, h: u32| f64::from(w) / f64::from(h);
        if (aspect(camera.width(), camera.height()) / aspect(width, height) - 1.0).abs() > 0.01 {
            return Err(bad(format!(
                "it is for pictures of {}x{} pixels, {} has {width}x{height}: another shape",
                camera.width(),
                camera.height(),
                picture.display()
            )));
        }
        return camera.scaled(width, height).map_err(|e| bad(e.to_string()));
    }
    let is_kitti = path.file_name().is_some_and(|name| name == "calib_cam_to_cam.txt");
    let numbers = if is_kitti {
        let is_third = picture.components().any(|part| part.as_os_str() == "image_03");
        let key = if is_third { "P_rect_03:" } else { "P_rect_02:" };
        let line = text.lines().find_map(|line| line.strip_prefix(key));
        numbers(line.ok_or_else(|| bad(format!("no line {key}")))?).map_err(&bad)?
    } else {
        numbers(&text).map_err(&bad)?
    };
    let (fx, fy, cx, cy) = match (is_kitti, &numbers[..]) {
        (true, &[fx, _, cx, _, _, fy, cy, _, _, _, _, _]) => (fx, fy, cx, cy),
        (false, &[fx, fy, cx, cy]) => (fx, fy, cx, cy),
        (false, &[fx, _, cx, _, fy, cy, _, _, _]) => (fx, fy, cx, cy),
        _ => {
            let wanted = if is_kitti { "12" } else { "4 (fx fy cx cy) or 9 (the camera matrix)" };
            return Err(bad(format!("{} numbers, expected {wanted}", numbers.len())));
        }
    };
    CameraModel::new(width, height, Intrinsics { fx, fy, cx, cy }, Distortion::None)
        .map_err(|e| bad(e.to_string()))
}

fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let words = text.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty());
    words.map(|word| word.parse().map_err(|_| format!("{word:?} is no number"))).collect()
}
