//! Placeholder until written.
/// Placeholder.
#[derive(Debug)]
pub struct Pose;
/// Placeholder.
#[derive(Debug)]
pub struct PoseError;
/// Placeholder.
pub fn body_from_optical() {}
