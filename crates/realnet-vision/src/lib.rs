//! Pixels: the kernels that prepare a picture for a network.
//!
//! Every kernel works on 8-bit pictures in the fixed point of OpenCV, so that a
//! network sees the same numbers it was trained on, and owns its scratch, so
//! that nothing is allocated per frame once it has seen the first one. Vector
//! code is chosen at run time and returns exactly what the portable code does.
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

mod letterbox;
mod resize;
mod triangle;

pub use letterbox::{Letterbox, Letterboxer, Region};
pub use resize::{Filter, resize};

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
