//! RealNet makes a robot follow a moving target with one ordinary camera.
//!
//! This crate is the front door: it gathers the rooms of the house under one
//! name and holds the `realnet` program. What stands today is *see*, YOLOv5 from
//! any YOLOv5 weights on real frames, without Python; *range*: the depth between
//! two depth maps ([`motion`]), a box carried by flow ([`carry`]), and what a box
//! says about the distance ([`cues`]); and *drive*: late measurements fused in time
//! ([`fusion`]), steering, speed and stops ([`control`]), both behind one door for
//! frames ([`pipeline`]), proved in a rendered world ([`sim`]).
//!
//! ```no_run
//! let mut detector = realnet::Detector::open("yolov5n.pt".as_ref())?;
//! let frame = realnet::picture::read("bus.jpg".as_ref())?;
//! println!("{:?}", detector.detect(&frame)?);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The detector above runs on the embedded engine. To use ONNX Runtime where it
//! is installed, start a [`Runtime`] with [`find_ort_libraries`]:
//!
//! ```no_run
//! use realnet::{Detector, DetectorModel, DetectorOptions, Runtime, RuntimeOptions};
//!
//! let ort_libraries = realnet::find_ort_libraries();
//! let runtime = Runtime::start(&RuntimeOptions { ort_libraries, ..Default::default() });
//! let model = DetectorModel::open("yolov5n.pt".as_ref())?;
//! let detector = Detector::new(model, &runtime, DetectorOptions::default())?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod ort_search;
mod perceiving;
pub mod shipped;

pub use ort_search::find_ort_libraries;
pub use perceiving::{DepthEyes, YoloEyes};
pub use realnet_control as control;
pub use realnet_core::{
    BoundingBox, CameraCalibration, CameraModel, DepthMap, Detection, Distortion, Frame,
    Intrinsics, Pose, Stamp,
};
pub use realnet_eval as eval;
pub use realnet_fusion as fusion;
pub use realnet_io::{
    actuator, annotate, atomic, datasets, picture, recording, results, source, video,
};
pub use realnet_nn::detector::{DetectError, Detector, DetectorModel, DetectorOptions, Stage};
pub use realnet_nn::engine::{EngineChoice, Provider, Runtime, RuntimeOptions};
pub use realnet_nn::{depth, onnx, vnl, vnl_lite, weights, yolov5};
pub use realnet_pipeline as pipeline;
pub use realnet_range::{carry, cues, motion};
pub use realnet_sim as sim;
pub use realnet_vision::Filter;
