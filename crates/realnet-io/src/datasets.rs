//! Data sets: YOLO `data.yaml` with text labels, COCO json, RGB-D sequences and
//! the boxes of a target.

pub mod boxes;
pub mod coco;
pub mod labels;
pub mod rgbd;
pub mod yolo;

use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

pub use boxes::TargetBoxes;
pub use coco::{CocoAnnotation, CocoDataset, CocoImage, CocoResult};
pub use labels::{Label, LabelError, Labels};
pub use rgbd::{RgbdError, RgbdFrame, RgbdLayout, RgbdOptions, RgbdSequence};
pub use yolo::{Sample, YoloDataset};

/// Why a data set cannot be used; always with the file and the place in it.
#[derive(Debug, Error)]
pub enum DatasetError {
    /// A file that cannot be read.
    #[error("cannot read {}: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        reason: io::Error,
    },
    /// A `data.yaml` that is no valid YAML or lacks something.
    #[error("{}: {message}", path.display())]
    Yaml {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line and column where the parser knows them.
        message: String,
    },
    /// A part of the data set that its `data.yaml` does not name.
    #[error("{}: no `{split}` entry; there are: {present}", path.display())]
    NoSplit {
        /// The `data.yaml`.
        path: PathBuf,
        /// The part asked for.
        split: String,
        /// The parts that exist.
        present: String,
    },
    /// A folder, list or picture that does not exist.
    #[error("{} names {}, which does not exist", origin, missing.display())]
    Missing {
        /// Where it is named: a file, with its entry or line.
        origin: String,
        /// What does not exist.
        missing: PathBuf,
    },
    /// A part of the data set without any picture.
    #[error("{}: `{split}` has no .jpg, .jpeg or .png pictures", path.display())]
    NoPictures {
        /// The `data.yaml`.
        path: PathBuf,
        /// The part.
        split: String,
    },
    /// A bad line of a label file.
    #[error("{}:{}: {}", path.display(), error.line, error.kind)]
    Label {
        /// The label file.
        path: PathBuf,
        /// The line and what is wrong in it.
        error: LabelError,
    },
    /// Bad boxes of a target.
    #[error("{}{}: {message}", path.display(), line_of(*line))]
    Boxes {
        /// The file or folder.
        path: PathBuf,
        /// The line, from 1; 0 for the whole.
        line: usize,
        /// What is wrong.
        message: String,
    },
    /// A bad COCO file.
    #[error("{}: {message}", path.display())]
    Coco {
        /// The file.
        path: PathBuf,
        /// The place in it (`annotations[3].bbox`, or line and column), and what
        /// is wrong.
        message: String,
    },
}

/// `:12` after the name of a file, nothing for the whole of it.
fn line_of(line: usize) -> String {
    if line > 0 { format!(":{line}") } else { String::new() }
}

/// Reads a text file; bytes that are not UTF-8 are an error.
fn read_text(path: &Path) -> Result<String, DatasetError> {
    std::fs::read_to_string(path)
        .map_err(|reason| DatasetError::Read { path: path.to_path_buf(), reason })
}
