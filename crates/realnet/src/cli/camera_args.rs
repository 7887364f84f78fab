//! Flags about the camera, shared by the commands that need one.

use super::{
    failure::{OrBadInput, bad_input},
    model_args::parse_positive,
};
use anyhow::Result;
use clap::Args;
use realnet::{CameraCalibration, CameraModel, Distortion, Intrinsics};
use std::path::{Path, PathBuf};

#[derive(Clone, Debug, Args)]
#[command(
    next_help_heading = "Camera [default: the data set's own or customary one, where there is one]"
)]
pub(crate) struct CameraArgs {
    /// A ROS calibration file, of the pictures' size or of the same picture at another.
    #[arg(long, value_name = "YAML", conflicts_with_all = ["fx", "fy", "cx", "cy"])]
    camera: Option<PathBuf>,
    /// Focal length along the rows, in pixels of the pictures as they are.
    #[arg(long, value_name = "PX", value_parser = parse_positive)]
    fx: Option<f64>,
    /// Focal length along the columns [default: --fx].
    #[arg(long, value_name = "PX", requires = "fx", value_parser = parse_positive)]
    fy: Option<f64>,
    /// Column of the principal point [default: the middle].
    #[arg(long, value_name = "PX", requires = "fx", allow_hyphen_values = true)]
    cx: Option<f64>,
    /// Row of the principal point [default: the middle].
    #[arg(long, value_name = "PX", requires = "fx", allow_hyphen_values = true)]
    cy: Option<f64>,
}

impl CameraArgs {
    /// Whether a flag tells the camera.
    pub(crate) fn is_given(&self) -> bool {
        self.camera.is_some() || self.fx.is_some()
    }

    /// The camera that the flags tell, for pictures of this size.
    pub(crate) fn given(&self, width: u32, height: u32) -> Result<Option<CameraModel>> {
        if let Some(path) = &self.camera {
            return fit(&read_camera(path)?, path, width, height).map(Some);
        }
        let Some(fx) = self.fx else { return Ok(None) };
        let intrinsics = Intrinsics {
            fx,
            fy: self.fy.unwrap_or(fx),
            cx: self.cx.unwrap_or(f64::from(width - 1) / 2.0),
            cy: self.cy.unwrap_or(f64::from(height - 1) / 2.0),
        };
        CameraModel::new(width, height, intrinsics, Distortion::None).or_bad_input().map(Some)
    }
}

/// How high a camera sits above the ground, metres.
pub(crate) fn parse_camera_height(text: &str) -> Result<f64, String> {
    text.parse::<f64>()
        .ok()
        .filter(|height| (0.01..=100.0).contains(height))
        .ok_or_else(|| format!("'{text}' is not a height in metres from 0.01 to 100"))
}

/// How far a camera sits ahead of the rear axle, metres.
pub(crate) fn parse_camera_forward(text: &str) -> Result<f64, String> {
    text.parse::<f64>()
        .ok()
        .filter(|forward| (-100.0..=100.0).contains(forward))
        .ok_or_else(|| format!("'{text}' is not a length in metres from -100 to 100"))
}

/// How far a camera looks down: degrees are given, radians taken.
pub(crate) fn parse_camera_pitch(text: &str) -> Result<f64, String> {
    text.parse::<f64>()
        .ok()
        .filter(|degrees| (-80.0..=80.0).contains(degrees))
        .map(f64::to_radians)
        .ok_or_else(|| format!("'{text}' is not a pitch in degrees from -80 to 80"))
}

/// The camera of a ROS calibration file.
pub(crate) fn read_camera(path: &Path) -> Result<CameraModel> {
    let text = std::fs::read_to_string(path)
        .map_err(|error| bad_input(format!("cannot read {}: {error}", path.display())))?;
    let calibration = CameraCalibration::from_ros_yaml(&text)
        .map_err(|error| bad_input(format!("{}: {error}", path.display())))?;
    Ok(*calibration.camera())
}

/// A camera, told by `path`, for pictures of this size, if they have its shape.
pub(crate) fn fit(
    camera: &CameraModel,
    path: &Path,
    width: u32,
    height: u32,
) -> Result<CameraModel> {
    if (camera.width(), camera.height()) == (width, height) {
        return Ok(*camera);
    }
    let (own_width, own_height) = (u64::from(camera.width()), u64::from(camera.height()));
    if own_width * u64::from(height) != own_height * u64::from(width) {
        return Err(bad_input(format!(
            "{}: a camera of {own_width}x{own_height} for pictures of {width}x{height}",
            path.display()
        )));
    }
    camera.scaled(width, height).or_bad_input()
}
