//! What is made small.

pub mod boxes;
pub mod depth;
pub mod detection;

pub use boxes::BoxLoss;
pub use depth::{DepthLoss, DepthLossOptions, NormalRules};
pub use detection::{DetectionLoss, DetectionLossOptions, Target};
