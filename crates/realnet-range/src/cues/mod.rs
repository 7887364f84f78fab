//! Range cues: what one box says about the distance, each with its deviation.

mod agreement;
mod attitude;
mod depth_in_box;
mod gate;
mod ground;
mod ground_fit;
mod histogram;
mod noise;
mod pitch;
mod sigma_rule;
mod size;

pub use agreement::{
    CombineError, CombinedRange, Disagreement, RangeCue, RangeSource, combine, disagreements,
};
pub use attitude::{Attitude, Uncertain};
pub use depth_in_box::{BoxDepth, DepthInBox, DepthInBoxError, DepthInBoxOptions, RivalPeak};
pub use gate::{ForegroundGate, Side};
pub use ground::{GroundEstimate, GroundRange, GroundRangeError};
pub use ground_fit::{GroundFit, GroundFitError, GroundFitOptions, GroundPlane, GroundPrior};
pub use histogram::{DepthHistogram, FocusInterval, PeakRule};
pub use noise::{DepthNoise, OptionError};
pub use pitch::{
    HorizonAttitude, PitchError, PitchFilter, PitchFilterOptions, PitchMeasurement, PitchSource,
    PitchUpdate, attitude_from_horizon, pitch_from_translation,
};
pub use sigma_rule::{Foreground, SigmaRule};
pub use size::{Dimension, SizeEstimate, SizeRange, SizeRangeError};
