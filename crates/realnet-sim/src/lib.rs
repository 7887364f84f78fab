//! A world with ground truth: rooms, cars, camera, latency and faults.

pub mod dynamics;
mod log;
mod metrics;
pub mod perception;
pub mod render;
pub mod scenario;
pub mod scene;
pub mod traffic;
mod vehicle;

pub use log::{BodyLog, DepthMapLog, DetectionLog, FrameLog, RunLog, StopLog};
pub use metrics::{CueFigures, RunFigures};
pub use vehicle::{VehicleKind, VehicleSize, VehicleState};
