//! The state of the target, from ranges and directions that come late.

mod filter;
mod measurement;
mod model;
mod motion;
mod options;
mod seen;
mod track;

pub use filter::TargetFilter;
pub use measurement::{DirectionSource, Outcome, RangeSource, Reading, Source, TargetMeasurement};
pub use options::{SharedError, StatusTimes, TargetOptions};
pub use track::{Motion, Track, TrackRange, TrailPoint};
