//! What a detector found.

use crate::BoundingBox;

/// One object found in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Index into the network's class names.
    pub class_id: u32,
    /// Objectness times class probability, 0 to 1.
    pub confidence: f32,
    /// Where, in pixels of the full source frame.
    pub bbox: BoundingBox,
}
