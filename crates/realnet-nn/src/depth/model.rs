//! Model files: weights or ONNX, told apart by their bytes.

use super::{DepthImportError, DepthMetadata, DepthMetadataError, DepthWeights};
use crate::{
    onnx::{Dim, ExportError, OnnxError, OnnxModel, OnnxOptions, check_size},
    weights::{Checkpoint, WeightsError},
};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Input size for ONNX files that leave it open, (width, height).
const DEFAULT_SIZE: (u32, u32) = (256, 256);

/// Why a file is not a depth network.
#[derive(Debug, Error)]
pub enum DepthModelError {
    /// The file could not be read.
    #[error("cannot read {}: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's own words.
        reason: std::io::Error,
    },
    /// No weights that can be read.
    #[error("{name}: {reason}")]
    Weights {
        /// What was read.
        name: String,
        /// What is wrong.
        reason: WeightsError,
    },
    /// A checkpoint of something else.
    #[error("{name}: {reason}")]
    Import {
        /// What was read.
        name: String,
        /// What is wrong.
        reason: DepthImportError,
    },
    /// Not an ONNX file that can be used.
    #[error("{name}: {reason}")]
    Onnx {
        /// What was read.
        name: String,
        /// What is wrong.
        reason: OnnxError,
    },
    /// An ONNX file whose metadata cannot be used.
    #[error("{name}: {reason}")]
    Metadata {
        /// What was read.
        name: String,
        /// What is wrong.
        reason: DepthMetadataError,
    },
    /// An ONNX file without RealNet's metadata.
    #[error(
        "{name}: no depth network that RealNet wrote: metadata 'realnet_depth' is missing, which tells how its output is metres"
    )]
    NotDepth {
        /// What was read.
        name: String,
    },
    /// An input size that the network cannot have.
    #[error("{name}: {reason}")]
    Size {
        /// What was read.
        name: String,
        /// What is wrong.
        reason: ExportError,
    },
}

/// Which logits are asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Detail {
    /// The coarsest in the file, the fastest. For [`Vnl`](crate::vnl::Vnl) one at every
    /// second pixel, close to what the released network says there.
    #[default]
    Fast,
    /// The finest in the file. For [`Vnl`](crate::vnl::Vnl) one at every pixel, what the
    /// released network says; [`VnlLite`](crate::vnl_lite::VnlLite) has only one, at every
    /// fourth pixel.
    Full,
}

/// A depth network that can be brought to an engine.
#[derive(Clone, Debug)]
pub struct DepthModel {
    name: String,
    source: Source,
}

#[derive(Clone, Debug)]
enum Source {
    Weights { network: DepthWeights, size: (u32, u32) },
    Onnx { model: Box<OnnxModel>, metadata: DepthMetadata, size: (u32, u32) },
}

impl DepthModel {
    /// Reads a `.pt`, `.pth`, `.safetensors` or `.onnx` file; what it is is told by
    /// its bytes, not by its name.
    ///
    /// # Errors
    /// [`DepthModelError`] when the file cannot be read or is no depth network.
    pub fn open(path: &Path) -> Result<Self, DepthModelError> {
        let bytes = std::fs::read(path)
            .map_err(|reason| DepthModelError::Read { path: path.to_owned(), reason })?;
        Self::from_vec(&path.display().to_string(), bytes)
    }

    /// As [`DepthModel::open`] for bytes in memory; `name` is for messages.
    ///
    /// # Errors
    /// As [`DepthModel::open`].
    pub fn from_vec(name: &str, bytes: Vec<u8>) -> Result<Self, DepthModelError> {
        let owned = || name.to_owned();
        let not_weights = match Checkpoint::from_bytes(&bytes) {
            Ok(checkpoint) => {
                let network = DepthWeights::from_checkpoint(&checkpoint)
                    .map_err(|reason| DepthModelError::Import { name: owned(), reason })?;
                let size = checkpoint.size.unwrap_or(network.default_size());
                return Ok(Self { name: owned(), source: Source::Weights { network, size } });
            }
            Err(reason @ WeightsError::UnknownFormat { .. }) => reason,
            Err(reason) => return Err(DepthModelError::Weights { name: owned(), reason }),
        };
        // The first field of an ONNX file is its version.
        let claims_onnx = bytes.starts_with(b"\x08") || name.ends_with(".onnx");
        match OnnxModel::from_vec(bytes) {
            Ok(model) => Self::from_onnx(name, model),
            Err(reason) if claims_onnx => Err(DepthModelError::Onnx { name: owned(), reason }),
            Err(_) => Err(DepthModelError::Weights { name: owned(), reason: not_weights }),
        }
    }

    /// A network in memory; `name` is for messages.
    #[must_use]
    pub fn from_weights(name: &str, network: impl Into<DepthWeights>) -> Self {
        let network = network.into();
        let size = network.default_size();
        Self { name: name.to_owned(), source: Source::Weights { network, size } }
    }

    fn from_onnx(name: &str, model: OnnxModel) -> Result<Self, DepthModelError> {
        let name = name.to_owned();
        let metadata = match DepthMetadata::from_onnx(&model) {
            Ok(Some(metadata)) => metadata,
            Ok(None) => return Err(DepthModelError::NotDepth { name }),
            Err(reason) => return Err(DepthModelError::Metadata { name, reason }),
        };
        let inputs = model.inputs();
        let size = inputs.first().and_then(|input| match input.dims.as_deref() {
            Some([_, _, Dim::Fixed(height), Dim::Fixed(width)]) => {
                Some((u32::try_from(*width).ok()?, u32::try_from(*height).ok()?))
            }
            _ => None,
        });
        let size = size.unwrap_or(DEFAULT_SIZE);
        let source = Source::Onnx { model: Box::new(model), metadata, size };
        Ok(Self { name, source })
    }

    /// The graph for an input of (width, height), cut to the logits asked for, and
    /// what its file says. Without a size it is the file's own, or for weights that tell none
    /// [`DepthWeights::default_size`].
    ///
    /// # Errors
    /// [`DepthModelError::Size`] when the network cannot have the size.
    pub fn network(
        &self,
        size: Option<(u32, u32)>,
        detail: Detail,
    ) -> Result<(OnnxModel, DepthMetadata), DepthModelError> {
        let name = || self.name.clone();
        let onnx = |reason| DepthModelError::Onnx { name: name(), reason };
        let bad_size = |reason| DepthModelError::Size { name: name(), reason };
        let (mut model, metadata) = match &self.source {
            Source::Weights { network, size: own } => {
                let (width, height) = size.unwrap_or(*own);
                let options =
                    OnnxOptions { width: width as usize, height: height as usize, half: false };
                let bytes = network.to_onnx(&options).map_err(bad_size)?;
                let model = OnnxModel::from_vec(bytes).map_err(onnx)?;
                let metadata = DepthMetadata::from_onnx(&model)
                    .map_err(|reason| DepthModelError::Metadata { name: name(), reason })?
                    .ok_or_else(|| DepthModelError::NotDepth { name: name() })?;
                (model, metadata)
            }
            Source::Onnx { model, metadata, size: own } => {
                let (width, height) = size.unwrap_or(*own);
                let (width, height) = (width as usize, height as usize);
                check_size(width, height, metadata.stride).map_err(bad_size)?;
                let mut model = (**model).clone();
                model.set_input_dims(&[1, 3, height, width]).map_err(onnx)?;
                (model, metadata.clone())
            }
        };
        let logits = match detail {
            Detail::Full => metadata.logits.first(),
            Detail::Fast => metadata.logits.last(),
        };
        let logits: Vec<&str> = logits.into_iter().map(String::as_str).collect();
        model.keep_outputs(&logits).map_err(onnx)?;
        Ok((model, metadata))
    }
}
