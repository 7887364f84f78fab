//! YOLOv5 detectors: from weights to a network to ONNX.
//!
//! [`YoloV5::from_checkpoint`] rebuilds the network from its tensors: any width
//! and depth (n, s, m, l, x and others), any number of classes, three or four
//! heads, and the generations that the weights of the last years come in:
//!
//! | generation | stem | pooling | blocks | activation |
//! |---|---|---|---|---|
//! | v6, v7 | 6x6 convolution | SPPF | C3 | SiLU |
//! | v4, v5 | Focus | SPP | C3 | SiLU |
//! | v2, v3 | Focus | SPP | BottleneckCSP | LeakyReLU or Hardswish, told by whole-module files only |
//!
//! Batch normalisation is folded into the convolutions in double precision,
//! Focus becomes the equal 6x6 convolution, SPP the equal chain of poolings.
//! [`YoloV5::to_onnx`] writes the result as one self-contained ONNX file.

mod build;
mod coco;
mod export;
mod graph;
mod metadata;
mod plan;

use thiserror::Error;

pub use crate::class_names::{NamesError, parse_names};
pub use crate::onnx::{ExportError, OnnxOptions};
pub use metadata::{DetectorMetadata, MetadataError};

use crate::weights::Checkpoint;
use graph::Layer;

/// Why a checkpoint is not a YOLOv5 detector this crate can run.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum ImportError {
    /// No tensor is named like those of a YOLOv5 network.
    #[error(
        "no YOLOv5 network: none of the {tensors} tensors is named 'model.N.…' (first: {first})"
    )]
    NotYolo {
        /// How many tensors there are.
        tensors: usize,
        /// Name of the first.
        first: String,
    },
    /// A layer of an unknown kind.
    #[error(
        "layer model.{index} is of unknown kind {kind}; known are Conv, Focus, C3, BottleneckCSP, Bottleneck, SPP, SPPF, Upsample, Concat and Detect"
    )]
    UnknownLayer {
        /// Index of the layer.
        index: usize,
        /// Class or tensors of the layer.
        kind: String,
    },
    /// A network of another layout than the known ones, in a file without modules.
    #[error("unknown YOLOv5 layout: {reason}")]
    UnknownLayout {
        /// What does not fit.
        reason: String,
    },
    /// A tensor is missing.
    #[error("tensor '{name}' is missing ({needed_by})")]
    MissingTensor {
        /// Its name.
        name: String,
        /// What needs it.
        needed_by: String,
    },
    /// Tensors that no layer uses.
    #[error("{count} tensors belong to no layer of the network, first '{name}'")]
    SurplusTensors {
        /// Name of the first.
        name: String,
        /// How many.
        count: usize,
    },
    /// A tensor of a wrong shape.
    #[error("tensor '{name}' has shape {found:?}, expected {expected}")]
    Shape {
        /// Its name.
        name: String,
        /// What fits.
        expected: String,
        /// What was found.
        found: Vec<usize>,
    },
    /// A tensor with NaN or infinite elements, or a negative variance.
    #[error("tensor '{name}' holds {what}")]
    Value {
        /// Its name.
        name: String,
        /// What it holds.
        what: &'static str,
    },
    /// Layers that do not fit together.
    #[error("layer model.{index}: {reason}")]
    Wiring {
        /// Index of the layer.
        index: usize,
        /// What does not fit.
        reason: String,
    },
    /// A module whose numbers are not supported.
    #[error("module '{module}': {reason}")]
    Module {
        /// Name of the module.
        module: String,
        /// What is wrong.
        reason: String,
    },
    /// The names do not fit the number of classes.
    #[error("the file names {names} classes, but the heads have {classes}")]
    Names {
        /// How many names.
        names: usize,
        /// How many classes.
        classes: usize,
    },
}

/// A YOLOv5 network with its weights, ready to be written as ONNX.
#[derive(Debug, Clone, PartialEq)]
pub struct YoloV5 {
    layers: Vec<Layer>,
    names: Vec<String>,
    strides: Vec<usize>,
    anchors: Vec<Vec<[f32; 2]>>,
}

impl YoloV5 {
    /// Rebuilds the network from its tensors.
    ///
    /// Class names are those of the file. Without any they are the 80 names of
    /// COCO if there are 80 classes, else `class0`, `class1`, ….
    /// The epsilon of batch normalisation is that of the file, else 1e-3,
    /// which YOLOv5 sets on all its layers.
    ///
    /// # Errors
    /// [`ImportError`] naming the layer or tensor that does not fit.
    pub fn from_checkpoint(checkpoint: &Checkpoint) -> Result<Self, ImportError> {
        build::build(checkpoint)
    }

    /// Names of the classes, in order.
    pub fn class_names(&self) -> &[String] {
        &self.names
    }

    /// Strides of the heads in pixels, finest first.
    pub fn strides(&self) -> &[usize] {
        &self.strides
    }

    /// Anchors of every head: widths and heights in pixels.
    pub fn anchors(&self) -> &[Vec<[f32; 2]>] {
        &self.anchors
    }

    /// Width and height of an input have to be multiples of this many pixels.
    pub fn max_stride(&self) -> usize {
        self.strides.iter().copied().max().unwrap_or(1)
    }

    /// Number of weights and biases after folding.
    pub fn parameters(&self) -> usize {
        self.layers.iter().map(|l| l.op.parameters()).sum()
    }

    /// Boxes per image of `width` x `height` pixels: the rows of the output.
    pub fn rows(&self, width: usize, height: usize) -> usize {
        let cells = |s: &usize| (width / s) * (height / s);
        self.strides.iter().zip(&self.anchors).map(|(s, a)| cells(s) * a.len()).sum()
    }
}
