//! The networks.

pub mod block;
pub mod vnl_lite;
pub mod yolov5;

pub use vnl_lite::{VnlLite, VnlLiteConfig};
pub use yolov5::{Form, YoloV5, YoloV5Config, YoloV5Size};
