//! Depth networks from weights, whatever their architecture.

use super::DepthCoding;
use crate::{
    onnx::{ExportError, OnnxOptions},
    vnl::{Vnl, VnlError},
    vnl_lite::{VnlLite, VnlLiteError},
    weights::Checkpoint,
};
use thiserror::Error;

/// Why a checkpoint is not a depth network this crate can run.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum DepthImportError {
    /// No tensor is named like those of a known depth network.
    #[error(
        "no depth network: none of the {tensors} tensors is named as in VNL ('encoder_modules.…') or vnl-lite ('stages.0.0.…') (first: {first})"
    )]
    Unknown {
        /// How many tensors there are.
        tensors: usize,
        /// Name of the first.
        first: String,
    },
    /// A virtual-normal network that does not fit.
    #[error(transparent)]
    Vnl(#[from] VnlError),
    /// A `vnl-lite` network that does not fit.
    #[error(transparent)]
    VnlLite(#[from] VnlLiteError),
}

/// A depth network with its weights, of any architecture that is known.
#[derive(Debug, Clone, PartialEq)]
pub enum DepthWeights {
    /// The authors' virtual-normal network.
    Vnl(Box<Vnl>),
    /// The network for small computers.
    VnlLite(Box<VnlLite>),
}

impl From<Vnl> for DepthWeights {
    fn from(network: Vnl) -> Self {
        Self::Vnl(Box::new(network))
    }
}

impl From<VnlLite> for DepthWeights {
    fn from(network: VnlLite) -> Self {
        Self::VnlLite(Box::new(network))
    }
}

impl DepthWeights {
    /// Rebuilds the network that the tensors are named like.
    ///
    /// # Errors
    /// [`DepthImportError`] naming what does not fit.
    pub fn from_checkpoint(checkpoint: &Checkpoint) -> Result<Self, DepthImportError> {
        if Vnl::recognises(checkpoint) {
            return Ok(Vnl::from_checkpoint(checkpoint)?.into());
        }
        if VnlLite::recognises(checkpoint) {
            return Ok(VnlLite::from_checkpoint(checkpoint)?.into());
        }
        let (tensors, first) = (checkpoint.tensors.len(), checkpoint.first_name());
        Err(DepthImportError::Unknown { tensors, first })
    }

    /// Whether the tensors are named like those of a depth network.
    #[must_use]
    pub fn recognises(checkpoint: &Checkpoint) -> bool {
        Vnl::recognises(checkpoint) || VnlLite::recognises(checkpoint)
    }

    /// Name of the architecture.
    #[must_use]
    pub fn architecture(&self) -> &'static str {
        match self {
            Self::Vnl(_) => "VNL",
            Self::VnlLite(_) => "vnl-lite",
        }
    }

    /// The input size that the architecture is made for, (width, height) in pixels.
    #[must_use]
    pub fn default_size(&self) -> (u32, u32) {
        match self {
            // The authors train the larger ones at 385.
            Self::Vnl(network) if network.max_stride() > 8 => (384, 384),
            Self::Vnl(_) => (256, 256),
            Self::VnlLite(_) => (256, 192),
        }
    }

    /// How the network's numbers are metres.
    #[must_use]
    pub fn coding(&self) -> &DepthCoding {
        match self {
            Self::Vnl(network) => network.coding(),
            Self::VnlLite(network) => network.coding(),
        }
    }

    /// Number of depth bins.
    #[must_use]
    pub fn bins(&self) -> usize {
        match self {
            Self::Vnl(network) => network.bins(),
            Self::VnlLite(network) => network.bins(),
        }
    }

    /// Number of weights and biases after folding.
    #[must_use]
    pub fn parameters(&self) -> usize {
        match self {
            Self::Vnl(network) => network.parameters(),
            Self::VnlLite(network) => network.parameters(),
        }
    }

    /// Writes the network as an ONNX file: [`Vnl::to_onnx`], [`VnlLite::to_onnx`].
    ///
    /// # Errors
    /// [`ExportError`] when the network cannot have the size, or a weight does not fit
    /// 16 bits.
    pub fn to_onnx(&self, options: &OnnxOptions) -> Result<Vec<u8>, ExportError> {
        match self {
            Self::Vnl(network) => network.to_onnx(options),
            Self::VnlLite(network) => network.to_onnx(options),
        }
    }
}
