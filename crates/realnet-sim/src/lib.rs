//! A world with ground truth: rooms, cars, camera, latency and faults.

mod closed_loop;
pub mod dataset;
pub mod dynamics;
mod log;
mod metrics;
pub mod perception;
pub mod render;
pub mod scenario;
pub mod scene;
pub mod traffic;
mod vehicle;

pub use closed_loop::{
    Moment, Perception, RunError, VEHICLE_CLASS, follower_options, run, run_with,
};
pub use log::{BodyLog, DepthMapLog, DetectionLog, FrameLog, RunLog, StopLog};
pub use metrics::{CueFigures, HELD_S, RunFigures};
pub use vehicle::{VehicleKind, VehicleSize, VehicleState};
