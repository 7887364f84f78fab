//! Pixels: the kernels that prepare a picture for a network, and those that say
//! how it moves.
//!
//! Every kernel works on 8-bit pictures in fixed point, with the numbers of the
//! libraries that networks are trained with (OpenCV; Pillow for the triangle
//! filter, within 1), and owns its scratch, so that nothing is allocated per frame
//! once it has seen the first one. Vector code is chosen at run time and returns
//! exactly what the portable code does.
//!
//! | for | use |
//! |---|---|
//! | a network's input | [`Letterboxer`], [`resize`] |
//! | halved pictures | [`Pyramid`] |
//! | corners worth tracking (Shi-Tomasi) | [`CornerDetector`] |
//! | where they are in the next picture (Lucas-Kanade) | [`FlowTracker`], or [`LucasKanade`] between any two pyramids |
//! | where a patch is, wherever it went (exhaustive correlation) | [`PatchSearch`] |
//!
//! ```
//! use realnet_core::{Frame, Stamp};
//! use realnet_vision::{Filter, Letterboxer};
//!
//! let frame = Frame::rgb8(Stamp::ZERO, 64, 32, vec![200; 64 * 32 * 3])?;
//! let mut letterboxer = Letterboxer::new(32, 32, Filter::default())?;
//! let mut input = vec![0.0; 3 * 32 * 32]; // planar RGB, 0 to 1
//! let letterbox = letterboxer.run(&frame, None, &mut input)?;
//! assert_eq!((letterbox.left(), letterbox.top()), (0, 8)); // grey bars above and below
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod corners;
mod flow;
mod letterbox;
mod pyramid;
mod resize;
mod search;
pub mod simd;
#[cfg(test)]
mod testing;
mod triangle;

pub use corners::{Corner, CornerDetector, CornerMask, CornerOptions};
pub use flow::{FlowOptions, FlowTracker, LucasKanade, Track, TrackStatus, Window};
pub use letterbox::{Letterbox, Letterboxer, Region};
pub use pyramid::{Level, Pyramid};
pub use resize::{Filter, resize};
pub use search::{PatchSearch, Scores, SearchError};

use thiserror::Error;

/// Why a picture could not be processed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum VisionError {
    /// A target side is 0.
    #[error("the target size {width}x{height} is empty")]
    EmptyTarget {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The region is empty or reaches outside the frame.
    #[error("region {region:?} does not lie inside the {width}x{height} frame")]
    Region {
        /// What was asked for.
        region: Region,
        /// Pixels a row of the frame.
        width: u32,
        /// Rows of the frame.
        height: u32,
    },
    /// The output buffer has the wrong length.
    #[error("the output needs {expected} values, found {found}")]
    Output {
        /// Values needed.
        expected: usize,
        /// Values given.
        found: usize,
    },
}

/// Why corners or flow could not be computed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FlowError {
    /// An option is out of its range.
    #[error("{option} is {value}, allowed is {allowed}")]
    Option {
        /// Its name.
        option: &'static str,
        /// What was given.
        value: String,
        /// Its range.
        allowed: &'static str,
    },
    /// A side of the window is out of its range.
    #[error(
        "a window of {width}x{height} pixels; sides are {} to {}",
        Window::SIDES.0,
        Window::SIDES.1
    )]
    Window {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A pyramid was used before a frame was put in.
    #[error("the pyramid has no picture yet")]
    NoPicture,
    /// The two pictures are of different sizes.
    #[error("from a picture of {}x{} to one of {}x{} pixels", from.0, from.1, to.0, to.1)]
    Size {
        /// Width and height of the first.
        from: (u32, u32),
        /// Width and height of the second.
        to: (u32, u32),
    },
    /// A pyramid's borders are for a smaller window.
    #[error(
        "a pyramid for windows of up to {}x{} pixels where the window is {}x{}",
        found.0, found.1, expected.0, expected.1
    )]
    PyramidWindow {
        /// Width and height of the tracker's window.
        expected: (usize, usize),
        /// Width and height of the pyramid's.
        found: (usize, usize),
    },
    /// Not one initial position for each point.
    #[error("{expected} points, but {found} initial positions")]
    InitialLength {
        /// Points.
        expected: usize,
        /// Initial positions.
        found: usize,
    },
    /// The bytes of a mask do not fit its size.
    #[error("a mask of {width}x{height} pixels has {expected} bytes, found {found}")]
    MaskLength {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes needed.
        expected: usize,
        /// Bytes given.
        found: usize,
    },
    /// The mask is of another size than the picture.
    #[error("a mask of {}x{} for a picture of {width}x{height} pixels", mask.0, mask.1)]
    MaskSize {
        /// Width and height of the mask.
        mask: (u32, u32),
        /// Pixels a row of the picture.
        width: u32,
        /// Rows of the picture.
        height: u32,
    },
}
