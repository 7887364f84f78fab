//! Range cues: what one box says about the distance, each with its deviation.
//!
//! | cue | needs | type |
//! |---|---|---|
//! | depth in the box | a depth map | [`DepthInBox`] |
//! | ground plane | camera height and pitch, the box's foot | [`GroundRange`] |
//! | known size | height or width of the target | [`SizeRange`] |
//!
//! A range is the depth along the optical axis in metres. A cue that has none
//! says why in its error, with the numbers. [`disagreements`] reports cues that
//! contradict each other, [`combine`] averages those that do not.
//!
//! [`SigmaRule`] and [`ForegroundGate`] divide pixels into target and background
//! by the box and by depth.
//!
//! The pitch that the ground plane needs is estimated while driving:
//! [`PitchFilter`] carries it over the camera's rotations and corrects it by the
//! floor in a depth map ([`GroundFit`]), the direction of motion
//! ([`pitch_from_translation`]) and the horizon ([`attitude_from_horizon`]).
//! [`Attitude`] defines the signs: positive pitch is nose down.
//!
//! # Boxes and pixels
//!
//! Edges of a [`BoundingBox`](realnet_core::BoundingBox) lie between pixels and
//! count from the edge of the picture; positions of corners and of a
//! [`CameraModel`](realnet_core::CameraModel) count from the centre of the first
//! pixel and are smaller by 0.5. Boxes are in pixels of the picture or depth map
//! that is given with them; a map of another size than the picture needs a scaled
//! box and a [scaled camera](realnet_core::CameraModel::scaled).
//!
//! # What a deviation covers
//!
//! The deviations given for the inputs, the noise in the data, and for a depth
//! map the error common to its pixels ([`DepthNoise`]), which does not average.
//! It does not cover a wrong choice, of the peak or of the plane: that is what
//! [`BoxDepth::rival`] and the comparison of cues are for.

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
pub use noise::DepthNoise;
pub use pitch::{
    HorizonAttitude, PitchError, PitchFilter, PitchFilterOptions, PitchMeasurement, PitchSource,
    PitchUpdate, attitude_from_horizon, pitch_from_translation,
};
pub use realnet_core::OptionError;
pub use sigma_rule::{Foreground, SigmaRule};
pub use size::{Dimension, SizeEstimate, SizeRange, SizeRangeError};
