//! Placeholder until written.
/// Placeholder.
#[derive(Debug)]
pub struct CameraModel;
/// Placeholder.
#[derive(Debug)]
pub struct CameraError;
/// Placeholder.
#[derive(Debug)]
pub struct Distortion;
