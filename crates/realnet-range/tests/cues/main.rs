//! The range cues on synthetic worlds with known truth.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests are not marked as tests")]

mod depth_in_box;
mod ground;
mod ground_fit;
mod hostile;
mod pitch;
mod random;
mod size;
