//! What can be learned: [`Task`](crate::trainer::Task)s of data sets.

mod depth;
mod detect;

pub use depth::{DepthStep, DepthTask, DepthTaskError, truth};
pub use detect::{DetectionTask, DetectionTaskError, fitness};
