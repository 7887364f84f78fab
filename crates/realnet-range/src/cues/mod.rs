//! Range cues: what one box says about the distance, each with its deviation.

mod gate;

pub use gate::{ForegroundGate, Side};
