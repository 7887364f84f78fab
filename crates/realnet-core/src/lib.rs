//! The words every RealNet crate speaks.
//!
//! This crate holds the types that cross crate borders and nothing else: no
//! input or output, no clock, no thread, no environment. A value here is plain
//! data with units in its documentation.
//!
//! | word | what |
//! |---|---|
//! | [`Stamp`] | exposure time of a frame, `i64` nanoseconds |
//! | [`Frame`] | an 8-bit picture, RGB or grey, with its stamp |
//! | [`DepthMap`] | the depth of each pixel in metres, `f32`, with its stamp |
//! | [`BoundingBox`] | an axis-aligned box in pixels, `f32` |
//! | [`Detection`] | a box with class and confidence |
//! | [`CameraModel`] | pinhole camera with lens distortion, `f64` |
//! | [`CameraCalibration`] | a named camera, read from and written to ROS YAML |
//! | [`Pose`] | a rigid transform, named `a_from_b` |
//! | [`Pose2`] | a rigid transform of the ground plane |
//! | [`TargetState`] | where the target is, seen from the robot, or that it is unknown |
//! | [`OptionError`] | an option that does not fit, with its rule |
//! | [`DriveCommand`] | speed and steering, or a stop with its [`StopReason`] |
//!
//! Frames of reference follow REP-103 and REP-105: a body has x forward, y
//! left, z up; a camera's *optical* frame has z forward, x right, y down.
//!
//! ```
//! use realnet_core::{BoundingBox, Detection};
//!
//! let a = BoundingBox::new(0.0, 0.0, 10.0, 10.0);
//! let b = BoundingBox::new(5.0, 0.0, 15.0, 10.0);
//! assert!((a.iou(&b) - 1.0 / 3.0).abs() < 1e-6);
//! let car = Detection { class_id: 2, confidence: 0.9, bbox: a };
//! assert_eq!(car.bbox.center(), (5.0, 5.0));
//! ```

mod bbox;
mod camera;
mod depth;
mod detection;
mod drive;
mod frame;
mod option;
mod plane;
mod pose;
mod stamp;

pub use bbox::BoundingBox;
pub use camera::{
    CalibrationError, CameraCalibration, CameraError, CameraModel, Distortion, Intrinsics,
};
pub use depth::{DepthMap, DepthMapError};
pub use detection::Detection;
pub use drive::{DriveCommand, StopReason, TargetEstimate, TargetState, TrackStatus};
pub use frame::{Frame, FrameError, PixelFormat};
pub use option::OptionError;
pub use plane::Pose2;
pub use pose::{Pose, PoseError, body_from_optical};
pub use stamp::Stamp;

/// The linear algebra of [`CameraModel`] and [`Pose`], so that their users have
/// the same version of it.
pub use nalgebra;
