//! The depth network of *Enforcing geometric constraints of virtual normal for
//! depth prediction* (Yin et al., ICCV 2019), from weights to a network to ONNX.
//!
//! [`Vnl::from_checkpoint`] reads the weights under the names of the authors' own
//! program, with their encoders MobileNetV2 at stride 8 and ResNeXt-50 or -101 32x4d at
//! stride 16, which the names tell.
//!
//! For an input of `H` x `W` pixels:
//!
//! | part | MobileNetV2 | ResNeXt |
//! |---|---|---|
//! | encoder: stages 2 to 5 | 24 channels at H/4, 32, 96 and 320 at H/8; stages 4 and 5 dilate by 2 and 4 | 256 channels at H/4, 512 at H/8, 1024 and 2048 at H/16; stage 5 dilates by 2 |
//! | top, of the last stage | its mean over the picture through two 1x1 convolutions: 128 channels, one value each | 1x1, 3x3 of dilation 2, 4 and 6, and the mean, side by side, then 1x1: 512 channels at H/16 |
//! | laterals: a residual block of dilated convolutions (dilation 2) on each stage, the last first | 128, 64, 64, 64 channels | 512, 256, 256, 256 channels |
//! | decoder: four times `lateral · gate + top`, the gate from the means of both, then a residual block; bilinear doubling where the sizes differ | 64 channels at H/4 | 256 channels at H/4 |
//! | last: doubling, a residual block, doubling | 64 channels at H | 256 channels at H |
//! | prediction: a 3x3 convolution of dilation 2, softmax over log-spaced bins, weighted sum | 60 bins, depth at H | 150 or 100 bins, depth at H |
//!
//! All doublings map corners to corners (`align_corners`). Batch normalisation
//! uses an epsilon of 1e-5, but 0.5 after the decoder's first convolution, where
//! the released code passes its momentum in the place of the epsilon.
//!
//! The authors' files tell neither the range of the bins nor the camera of the training
//! set. Unless the checkpoint ([`Checkpoint::depth`]) or [`Vnl::with_coding`] says
//! otherwise, they are those of the authors' configurations: for 100 bins
//! [`DepthCoding::KITTI`], else the one for NYU Depth V2, [`DepthCoding::default`].
//!
//! # Rewritten without changing the function
//!
//! Batch normalisation is folded into the convolutions in double precision. A mean
//! over the picture and a 1x1 convolution commute, so the mean comes first. What
//! the authors' code expands to a map of equal values stays one value a channel; where it is
//! joined to other maps, its part of the next convolution is added to theirs.

mod build;
mod export;
mod graph;

use crate::{
    depth::{CodingError, DepthCoding},
    weights::{Checkpoint, TensorError},
};
use graph::Graph;
use thiserror::Error;

/// Bins of the authors' networks for KITTI.
const KITTI_BINS: usize = 100;

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
    /// tells, or else the one that the authors trained it with.
    ///
    /// # Errors
    /// [`VnlError`] naming the tensor or the number that does not fit.
    pub fn from_checkpoint(checkpoint: &Checkpoint) -> Result<Self, VnlError> {
        let graph = build::build(checkpoint)?;
        let kitti = graph.predict.out() == KITTI_BINS;
        let authors = if kitti { DepthCoding::KITTI } else { DepthCoding::default() };
        let coding = checkpoint.depth.unwrap_or(authors);
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
        self.graph.stride
    }

    /// Number of weights and biases after folding.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.graph.convs().iter().map(|conv| conv.parameters()).sum()
    }
}
