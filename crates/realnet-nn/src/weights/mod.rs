//! Reading weights without running anything.
//!
//! [`Checkpoint`] holds named tensors and what the file tells about the
//! network: class names, strides, and, for checkpoints that hold whole
//! modules, the class and the numbers of every module. Three formats are read:
//!
//! * PyTorch archives (`torch.save` since 1.6),
//! * the older PyTorch stream (`torch.save` before 1.6, or with
//!   `_use_new_zipfile_serialization=False`),
//! * safetensors.
//!
//! Files may come from anywhere: nothing in them is executed ([`pickle`]), and
//! memory is bounded by a small multiple of the file's length.

mod legacy;
pub mod pickle;
mod safe;
mod state;
mod storage;
mod torch_zip;

use std::collections::BTreeMap;
use std::path::Path;

use thiserror::Error;

pub use crate::reader::TensorError;
pub use pickle::PickleError;

use crate::depth::{DepthCoding, DepthMetadataError};

/// Largest file read, in bytes. The largest YOLOv5 has 0.6 GB in float32.
const MAX_FILE: u64 = 4 << 30;

/// What is wrong with a file of weights.
#[derive(Debug, Error)]
pub enum WeightsError {
    /// The file cannot be read.
    #[error("cannot read {path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// No bytes at all.
    #[error("the file is empty")]
    Empty,
    /// More bytes than any network here has.
    #[error("the file of weights has {size} bytes; at most {limit} are read")]
    TooLarge {
        /// Length of the file in bytes.
        size: u64,
        /// The limit in bytes.
        limit: u64,
    },
    /// Neither of the formats.
    #[error(
        "not a file of weights ({size} bytes): neither a PyTorch archive, a PyTorch stream nor safetensors ({reason})"
    )]
    UnknownFormat {
        /// Length of the file in bytes.
        size: usize,
        /// What was met instead.
        reason: String,
    },
    /// A damaged PyTorch archive.
    #[error("damaged PyTorch archive: {reason}")]
    Archive {
        /// What is wrong.
        reason: String,
    },
    /// A damaged or unsupported pickle.
    #[error("{part}: {source}")]
    Pickle {
        /// Which pickle of the file.
        part: &'static str,
        /// What is wrong.
        source: PickleError,
    },
    /// A damaged PyTorch stream.
    #[error("damaged PyTorch stream: {reason}")]
    Stream {
        /// What is wrong.
        reason: String,
    },
    /// A damaged safetensors file.
    #[error("damaged safetensors file: {reason}")]
    Safetensors {
        /// What is wrong.
        reason: String,
    },
    /// Metadata that cannot be read.
    #[error("safetensors file: {0}")]
    Metadata(#[from] DepthMetadataError),
    /// A tensor that does not fit its storage, or of an unknown kind.
    #[error("tensor '{name}': {reason}")]
    Tensor {
        /// Name of the tensor.
        name: String,
        /// What is wrong.
        reason: String,
    },
    /// More data than the file can hold honestly.
    #[error(
        "refused: {what} would take more than {limit} bytes, too much for a file of {size} bytes"
    )]
    Bomb {
        /// What was being read.
        what: String,
        /// The limit in bytes.
        limit: u64,
        /// Length of the file in bytes.
        size: u64,
    },
    /// A checkpoint that holds no network.
    #[error("no network in the checkpoint: {reason}")]
    NoNetwork {
        /// What was found instead.
        reason: String,
    },
}

/// A dense tensor of 32-bit floats, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    shape: Vec<usize>,
    data: Vec<f32>,
}

impl Tensor {
    /// Wraps elements in row-major order; `None` if their number is not the
    /// product of `shape`.
    pub fn new(shape: Vec<usize>, data: Vec<f32>) -> Option<Self> {
        let count = shape.iter().try_fold(1usize, |n, &d| n.checked_mul(d))?;
        (count == data.len()).then_some(Tensor { shape, data })
    }

    /// Shape, outermost dimension first; empty for a scalar.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Elements in row-major order.
    pub fn data(&self) -> &[f32] {
        &self.data
    }
}

/// What a whole-module checkpoint tells about one module.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModuleInfo {
    /// Name of the Python class without its module, for example `Conv2d`.
    pub class: String,
    /// Attributes that are numbers, truth values (0 or 1), or tuples, lists and
    /// small tensors of these.
    pub numbers: BTreeMap<String, Vec<f64>>,
}

/// Named tensors, and what the file tells about the network they belong to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Checkpoint {
    /// Tensors by name, as `model.N.…` for YOLOv5 networks. All are float32,
    /// converted from what the file holds. Batch counters of batch
    /// normalisation (`num_batches_tracked`) are left out.
    pub tensors: BTreeMap<String, Tensor>,
    /// Modules by the same names without the tensor; empty unless the file
    /// holds whole modules. The root has the empty name.
    pub modules: BTreeMap<String, ModuleInfo>,
    /// Names of the classes in order, if the file tells.
    pub class_names: Option<Vec<String>>,
    /// Strides of the heads in pixels, if the file tells.
    pub strides: Option<Vec<f64>>,
    /// Epsilon of all batch normalisations, if the file tells it in one number.
    pub bn_eps: Option<f64>,
    /// How the numbers of a depth network are metres, if the file tells. Only safetensors
    /// files do, in the metadata [`DepthCoding::KEY`].
    pub depth: Option<DepthCoding>,
    /// Input size that the network was trained at, (width, height) in pixels, if the file
    /// tells: a safetensors file in the metadata `imgsz`, as `[height, width]`.
    pub size: Option<(u32, u32)>,
}

impl Checkpoint {
    /// Reads a file.
    ///
    /// # Errors
    /// [`WeightsError`] if it cannot be read or decoded.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, WeightsError> {
        let path = path.as_ref();
        let io = |source| WeightsError::Io { path: path.display().to_string(), source };
        let size = std::fs::metadata(path).map_err(io)?.len();
        if size > MAX_FILE {
            return Err(WeightsError::TooLarge { size, limit: MAX_FILE });
        }
        Self::from_bytes(&std::fs::read(path).map_err(io)?)
    }

    /// Decodes the bytes of a file; the format is told from the bytes.
    ///
    /// # Errors
    /// [`WeightsError`] if no format fits or the file is damaged or hostile.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WeightsError> {
        if bytes.is_empty() {
            return Err(WeightsError::Empty);
        }
        if bytes.starts_with(b"PK\x03\x04") || bytes.starts_with(b"PK\x05\x06") {
            return torch_zip::read(bytes);
        }
        if bytes.starts_with(legacy::MAGIC_START) {
            return legacy::read(bytes);
        }
        if safe::looks_like(bytes) {
            return safe::read(bytes);
        }
        let reason = if bytes.starts_with(b"\x80") {
            "a bare Python pickle"
        } else if bytes.starts_with(b"\x08") {
            "it looks like ONNX, which is loaded directly"
        } else if bytes.len() < 16 {
            "too short"
        } else {
            "unknown first bytes"
        };
        Err(WeightsError::UnknownFormat { size: bytes.len(), reason: reason.to_owned() })
    }

    /// The name of the first tensor between quotes, for messages.
    pub(crate) fn first_name(&self) -> String {
        let name = self.tensors.keys().next();
        name.map_or_else(|| "there are none".to_owned(), |name| format!("'{name}'"))
    }
}

/// The name of a tensor or module as `model.N.…`: wrappers' prefixes (`module.`
/// of data-parallel training, repeated `model.`) are removed and the one
/// `model.` of YOLOv5 put back.
fn normalise_name(name: &str) -> String {
    let mut rest = name;
    let strip = |name: &'_ str| -> Option<usize> {
        let inner = ["module.", "model."].iter().find_map(|p| name.strip_prefix(p))?;
        Some(name.len() - inner.len())
    };
    while let Some(inner) = strip(rest).and_then(|n| rest.get(n..)) {
        rest = inner;
    }
    let first = rest.split('.').next().unwrap_or_default();
    if !first.is_empty() && first.bytes().all(|b| b.is_ascii_digit()) {
        format!("model.{rest}")
    } else {
        rest.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_normalised() {
        for name in ["model.0.conv.weight", "0.conv.weight", "module.model.0.conv.weight"] {
            assert_eq!(normalise_name(name), "model.0.conv.weight");
        }
        assert_eq!(normalise_name("model.model.24.m.0.bias"), "model.24.m.0.bias");
        assert_eq!(normalise_name("module.encoder.bias"), "encoder.bias");
        assert_eq!(normalise_name("modeling.bias"), "modeling.bias");
        assert_eq!(normalise_name("model"), "model");
    }

    #[test]
    fn a_tensor_needs_as_many_elements_as_its_shape() {
        assert!(Tensor::new(vec![2, 3], vec![0.0; 6]).is_some());
        assert!(Tensor::new(vec![2, 3], vec![0.0; 5]).is_none());
        assert!(Tensor::new(vec![usize::MAX, 2], vec![]).is_none());
        assert_eq!(Tensor::new(vec![], vec![1.0]).unwrap().shape(), &[] as &[usize]);
    }

    #[test]
    fn files_of_other_formats_are_named() {
        assert!(matches!(Checkpoint::from_bytes(b""), Err(WeightsError::Empty)));
        let text = Checkpoint::from_bytes(b"\x80\x02}.").unwrap_err().to_string();
        assert!(text.contains("bare Python pickle"), "{text}");
    }
}
