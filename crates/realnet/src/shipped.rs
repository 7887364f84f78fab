//! Networks that are part of the program.
//!
//! They were trained by this program's own commands; `models/` has a card for each: data,
//! commands, figures, limits, licence.

/// The detector: YOLOv5n at 320x320 with the classes `rc_car`, `truck`, `buggy`, `robot`.
pub const DETECTOR: &[u8] = include_bytes!("../../../models/vehicles-yolov5n-320.onnx");

/// Its name.
pub const DETECTOR_NAME: &str = "vehicles-yolov5n-320.onnx";

/// The depth network: `vnl-lite` at 256x192.
pub const DEPTH: &[u8] = include_bytes!("../../../models/vnl-lite-256x192.onnx");

/// Its name.
pub const DEPTH_NAME: &str = "vnl-lite-256x192.onnx";
