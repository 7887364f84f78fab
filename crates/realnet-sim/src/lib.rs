//! A world with ground truth: rooms, cars, camera, latency and faults.

mod log;
mod vehicle;

pub use log::{DepthMapLog, FrameLog, RunLog, StopLog};
pub use vehicle::{VehicleKind, VehicleSize, VehicleState};
