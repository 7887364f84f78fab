//! The depth network of *Enforcing geometric constraints of virtual normal for
//! depth prediction* (Yin et al., ICCV 2019), from weights to a network to ONNX.
//!
//! [`Vnl::from_checkpoint`] reads the weights under the names of the authors' own
//! program, for the encoder MobileNetV2 at stride 8. Weights with the ResNeXt
//! encoders are refused by name.
//!
//! For an input of `H` x `W` pixels:
//!
//! | part | layers | output |
//! |---|---|---|
//! | encoder | MobileNetV2; stages 4 and 5 keep the stride of 8 and dilate by 2 and 4 | 24 channels at H/4, 32, 96 and 320 at H/8 |
//! | top | the mean of the last stage over the picture, through two 1x1 convolutions | 128 channels, one value each |
//! | laterals | a residual block of dilated convolutions (dilation 2) on each of the four | 128, 64, 64, 64 channels |
//! | decoder | four times `lateral · gate + top`, the gate from the means of both, then a residual block; bilinear doubling where the sizes differ | 64 channels at H/4 |
//! | last | doubling, a residual block, doubling | 64 channels at H |
//! | prediction | a 3x3 convolution of dilation 2, softmax over log-spaced bins, weighted sum | depth at H |
//!
//! All doublings map corners to corners (`align_corners`). Batch normalisation
//! uses an epsilon of 1e-5, but 0.5 after the decoder's first convolution, where
//! the released code passes its momentum in the place of the epsilon.
//!
//! The authors' files tell neither the range of the bins nor the camera of the training
//! set: they are those of the authors' configuration for this encoder (NYU Depth V2)
//! unless the checkpoint ([`Checkpoint::depth`]) or [`Vnl::with_coding`] says otherwise.
//!
//! # Rewritten without changing the function
//!
//! Batch normalisation is folded into the convolutions in double precision. A mean
//! over the picture and a 1x1 convolution commute, so the mean comes first. What
//! the authors' code expands to a map of equal values stays one value a channel.

mod build;
mod export;
mod graph;

use crate::{
    depth::{CodingError, DepthCoding},
    weights::{Checkpoint, TensorError},
};
use graph::Graph;
use thiserror::Error;

/// Width and height of an input have to be multiples of this many pixels.
pub(crate) const STRIDE: usize = 8;

/// Why a checkpoint is not a virtual-normal network this crate can run.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum VnlError {
    /// No tensor is named like those of the network.
    #[error(
        "no VNL depth network: none of the {tensors} tensors is named 'encoder_modules.…' (first: {first})"
    )]
    NotVnl {
        /// How many tensors there are.
        tensors: usize,
        /// Name of the first.
        first: String,
    },
    /// Another encoder.
    #[error(
        "a VNL depth network with a ResNeXt encoder (tensor '{name}'); only MobileNetV2 is supported"
    )]
    Encoder {
        /// The tensor that tells.
        name: String,
    },
    /// A tensor that does not fit.
    #[error(transparent)]
    Tensor(#[from] TensorError),
    /// A coding of depth that cannot be.
    #[error(transparent)]
    Coding(#[from] CodingError),
}

/// A virtual-normal depth network with its weights, ready to be written as ONNX.
#[derive(Debug, Clone, PartialEq)]
pub struct Vnl {
    graph: Graph,
    coding: DepthCoding,
}

impl Vnl {
    /// Rebuilds the network from its tensors, with the coding of depth that the file
    /// tells, or else the one that the authors trained this encoder with
    /// ([`DepthCoding::default`]).
    ///
    /// # Errors
    /// [`VnlError`] naming the tensor or the number that does not fit.
    pub fn from_checkpoint(checkpoint: &Checkpoint) -> Result<Self, VnlError> {
        let graph = build::build(checkpoint)?;
        let coding = checkpoint.depth.unwrap_or_default();
        coding.check()?;
        Ok(Self { graph, coding })
    }

    /// Whether the tensors are named like those of a virtual-normal network, of
    /// any encoder.
    #[must_use]
    pub fn recognises(checkpoint: &Checkpoint) -> bool {
        build::prefix(checkpoint).is_some()
    }

    /// The same network, trained for another range, scale, focal length or
    /// normalisation.
    ///
    /// # Errors
    /// [`CodingError`] when a number is out of its range.
    pub fn with_coding(mut self, coding: DepthCoding) -> Result<Self, CodingError> {
        coding.check()?;
        self.coding = coding;
        Ok(self)
    }

    /// How the network's numbers are metres.
    #[must_use]
    pub fn coding(&self) -> &DepthCoding {
        &self.coding
    }

    /// Number of depth bins.
    #[must_use]
    pub fn bins(&self) -> usize {
        self.graph.predict.out()
    }

    /// Width and height of an input have to be multiples of this many pixels.
    #[must_use]
    pub fn max_stride(&self) -> usize {
        STRIDE
    }

    /// Number of weights and biases after folding.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.graph.convs().iter().map(|conv| conv.parameters()).sum()
    }
}
