//! What a follower is given eyes by.

use realnet_core::{BoundingBox, DepthMap, Detection, Frame};

/// What went wrong in a network.
pub type NetworkError = Box<dyn std::error::Error + Send + Sync>;

/// Finds objects in frames.
pub trait ObjectDetector: Send {
    /// The objects in a frame, boxes in its pixels; with `near` it may look only around
    /// that box.
    ///
    /// # Errors
    /// What the network says.
    fn detect(
        &mut self,
        frame: &Frame,
        near: Option<&BoundingBox>,
    ) -> Result<Vec<Detection>, NetworkError>;
}

/// Tells how far things are.
pub trait DepthEstimator: Send {
    /// Depth along the optical axis, metres, with the frame's stamp; the map covers the
    /// whole frame, in any number of pixels.
    ///
    /// # Errors
    /// What the network says.
    fn depth(&mut self, frame: &Frame) -> Result<DepthMap, NetworkError>;
}
