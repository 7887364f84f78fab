//! What can be learned: [`Task`](crate::trainer::Task)s of data sets.

mod detect;

pub use detect::{DetectionTask, DetectionTaskError, fitness};
