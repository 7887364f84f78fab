//! The range cues on synthetic worlds with known truth.

mod depth_in_box;
mod ground;
mod random;
mod size;
