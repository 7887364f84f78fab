//! `vnl-lite`, a depth network for small computers, from weights to a network to ONNX.
//!
//! It has the head of the authors of virtual normals ([`crate::vnl`]), classes of log depth,
//! on a residual encoder and decoder of dense convolutions. `realnet-train` trains it.
//! [`VnlLite::from_checkpoint`] reads all its numbers from the shapes of the weights. For an
//! input of `H` x `W` pixels:
//!
//! | part | names | layers | output |
//! |---|---|---|---|
//! | stem | `stem` | a 3x3 convolution of stride 2 | H/2 |
//! | encoder | `stages.I.J` | four stages of residual blocks of two 3x3 convolutions (`c1`, `c2`); the first of each halves the size, and what goes around it is averaged over 2x2 pixels before a 1x1 convolution (`around`) | H/4, H/8, H/16, H/32 |
//! | decoder | `reduce.I`, `merge.I`, `skip` | three times `merge(enlarged(reduce(x)) + level)`, by 1x1 and 3x3; the level at H/4 goes through the 1x1 convolution `skip` | H/4 |
//! | head | `head` | a 3x3 convolution with bias | logits of the bins at H/4 |
//!
//! All but the head are a convolution without bias (`conv`), batch normalisation (`bn`, folded
//! in double precision) and ReLU, which in a residual block comes after the sum. Enlarging is
//! bilinear, between the centres of the pixels.
//!
//! How the logits are metres is no matter of shapes: a checkpoint has to say it
//! ([`Checkpoint::depth`]).

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
const STRIDE: usize = 32;

/// Why a checkpoint is not a `vnl-lite` network this crate can run.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum VnlLiteError {
    /// No tensor is named like those of the network.
    #[error(
        "no vnl-lite depth network: among the {tensors} tensors are no 'stem.conv.weight' and 'stages.0.0.c1.conv.weight' (first: {first})"
    )]
    NotVnlLite {
        /// How many tensors there are.
        tensors: usize,
        /// Name of the first.
        first: String,
    },
    /// A tensor that does not fit.
    #[error(transparent)]
    Tensor(#[from] TensorError),
    /// The file does not say how the network's numbers are metres.
    #[error(
        "the weights of a vnl-lite depth network have no metadata 'realnet_depth', which tell its range of depth, focal length and normalisation"
    )]
    NoCoding,
    /// What it says cannot be.
    #[error(transparent)]
    Coding(#[from] CodingError),
}

/// A `vnl-lite` depth network with its weights, ready to be written as ONNX.
#[derive(Debug, Clone, PartialEq)]
pub struct VnlLite {
    graph: Graph,
    coding: DepthCoding,
}

impl VnlLite {
    /// Rebuilds the network from its tensors and its coding of depth.
    ///
    /// # Errors
    /// [`VnlLiteError`] naming the tensor that does not fit, or what is missing.
    pub fn from_checkpoint(checkpoint: &Checkpoint) -> Result<Self, VnlLiteError> {
        let graph = build::build(checkpoint)?;
        let coding = checkpoint.depth.ok_or(VnlLiteError::NoCoding)?;
        coding.check()?;
        Ok(Self { graph, coding })
    }

    /// Whether the tensors are named like those of a `vnl-lite` network.
    #[must_use]
    pub fn recognises(checkpoint: &Checkpoint) -> bool {
        build::recognises(checkpoint)
    }

    /// How the network's numbers are metres.
    #[must_use]
    pub fn coding(&self) -> &DepthCoding {
        &self.coding
    }

    /// Number of depth bins.
    #[must_use]
    pub fn bins(&self) -> usize {
        self.graph.head.out()
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
