//! Samples for learning: data sets checked, augmented and batched. There is no
//! training framework in here; samples are plain slices of numbers.
//!
//! | step | type |
//! |---|---|
//! | read and check all files *before* the first training step | [`DetectionSet`], [`DepthSet`], their [`CheckReport`] |
//! | one sample of an epoch, augmented | [`DetectionSamples`], [`DepthSamples`] (both are [`Samples`]) |
//! | batches, made by several threads, in order | [`Loader`] |
//! | numbers of a batch side by side, as a network takes them | [`DetectionBatch`], [`DepthBatch`] |
//! | a picture of what the network is shown | [`detection_sheet`], [`depth_sheet`] |
//!
//! **Deterministic.** Sample `i` of epoch `e` follows from the seed, `e` and `i` alone:
//! neither the number of threads, nor the size of the cache, nor what was loaded before
//! changes a bit of it. The order of an epoch follows from the seed and `e`, and keeps
//! consecutive frames apart ([`epoch_order`]).
//!
//! **Metres stay metres.** A network cannot tell a small near thing from a large far one
//! unless it knows the focal length, so it learns depth for one *canonical* focal length:
//!
//! ```text
//! depth to learn = depth in metres * canonical_f / f      f = sqrt(fx fy), in pixels of
//! depth in metres = network's output * f / canonical_f    the network's input
//! ```
//!
//! A crop that is blown up to the input has a larger `f`; its depth in metres is what it
//! was, and the depth to learn becomes smaller, just as the things look nearer. See
//! [`CanonicalFocal`].
//!
//! **Bad data cost nothing later.** Missing and broken pictures, pictures without depth,
//! rows that are not numbers: counted, named and left out before training starts; a class
//! that does not exist is an error with file and line. A file that breaks *during*
//! training is replaced by the next sample and counted ([`Loader::failures`]).
//!
//! Pictures are kept in memory at about the size the network sees, as far as the cache
//! allows ([`SetOptions::cache_bytes`]), so that an epoch does not decode them again.
//!
//! ```no_run
//! use realnet_data::{
//!     DetectionAugment, DetectionBatch, DetectionSamples, DetectionSet, Loader, LoaderOptions,
//!     SetOptions,
//! };
//! use std::sync::Arc;
//!
//! let options = SetOptions::default();
//! let set = Arc::new(DetectionSet::open("data.yaml".as_ref(), "train", 320, &options)?);
//! println!("{}", set.report());
//! let samples = DetectionSamples::training(set, DetectionAugment::default(), 7)?
//!     .with_mosaic_until(285); // off for the last 15 of 300 epochs
//! let loader = Loader::new(Arc::new(samples), LoaderOptions { batch: 16, ..Default::default() })?;
//! for epoch in 0..300 {
//!     for batch in loader.epoch(epoch) {
//!         let batch = DetectionBatch::collate(&batch?);
//!         drop((batch.images, batch.targets)); // a training step
//!     }
//! }
//! # Ok::<(), realnet_data::DataError>(())
//! ```

mod cache;
mod check;
mod color;
mod depth;
mod detect;
mod loader;
mod order;
mod random;
mod sheet;
mod warp;

pub use check::{CheckReport, Finding, Problem};
pub use color::ColorAugment;
pub use depth::{
    CanonicalFocal, DepthAugment, DepthBatch, DepthPart, DepthSample, DepthSamples, DepthSet,
    DepthSetOptions, DepthSource, HoldOut, Normalization, RgbdPicture, SourceCamera, SourceList,
};
pub use detect::{
    DetectionAugment, DetectionBatch, DetectionImage, DetectionSample, DetectionSamples,
    DetectionSet, Target,
};
pub use loader::{Epoch, Failure, Loader, LoaderOptions, Samples};
pub use order::epoch_order;
pub use sheet::{SheetOptions, depth_sheet, detection_sheet};

use realnet_core::{CameraError, FrameError, OptionError};
use realnet_io::datasets::{DatasetError, RgbdError};
use realnet_io::picture::Limits;
use std::path::PathBuf;
use thiserror::Error;

/// How a data set is read and checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SetOptions {
    /// Threads that read; 0 takes as many as there are processors.
    pub threads: usize,
    /// Most bytes of decoded pictures that are kept in memory; default 2 GiB. What does
    /// not fit is decoded each time it is needed.
    pub cache_bytes: usize,
    /// Size limits of the files.
    pub limits: Limits,
}

impl Default for SetOptions {
    fn default() -> Self {
        Self { threads: 0, cache_bytes: 2 << 30, limits: Limits::default() }
    }
}

/// Why a data set cannot be learned from.
#[derive(Debug, Error)]
pub enum DataError {
    /// A `data.yaml`, list or label file; with the line where there is one.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// An RGB-D sequence.
    #[error(transparent)]
    Rgbd(#[from] RgbdError),
    /// A list of depth sources.
    #[error("{}: {message}", path.display())]
    List {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// A source of depth whose camera is not known.
    #[error(
        "{}: the camera is not known. Give fx, fy, cx, cy and the size they are for, or put \
         camera.yaml (ROS) or intrinsics.txt (fx fy cx cy) beside the pictures",
        path.display()
    )]
    NoCamera {
        /// The folder.
        path: PathBuf,
    },
    /// A camera that does not fit its pictures.
    #[error("{}: {message}", path.display())]
    Camera {
        /// The folder or file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// A camera that is none.
    #[error(transparent)]
    CameraModel(#[from] CameraError),
    /// A class that a set does not name.
    #[error("class {name:?} is not one of {}", known.join(", "))]
    UnknownClass {
        /// The class that was asked for.
        name: String,
        /// The set's own.
        known: Vec<String>,
    },
    /// A class that was asked for twice.
    #[error("class {name:?} is given twice")]
    ClassTwice {
        /// The class.
        name: String,
    },
    /// Nothing is left after the check.
    #[error("nothing to learn from is left: {report}")]
    NothingLeft {
        /// What was found.
        report: Box<CheckReport>,
    },
    /// An option out of its range.
    #[error(transparent)]
    Option(#[from] OptionError),
    /// A sample that cannot be made.
    #[error(transparent)]
    Sample(#[from] SampleError),
    /// No sample of an epoch could be made.
    #[error("{tried} samples in a row could not be made, the last one: {last}")]
    TooManyFailures {
        /// Samples that were tried.
        tried: usize,
        /// The last error.
        last: SampleError,
    },
    /// A contact sheet that makes no picture.
    #[error(transparent)]
    Frame(#[from] FrameError),
}

/// Why one sample could not be made.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("sample {index}, {}: {reason}", path.display())]
pub struct SampleError {
    /// Index of the picture in its set.
    pub index: usize,
    /// The picture; empty for one that was given in memory.
    pub path: PathBuf,
    /// What is wrong.
    pub reason: String,
}

/// `count` or, for 0, the number of processors.
pub(crate) fn threads(count: usize) -> usize {
    match count {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        count => count,
    }
}
