//! Reading, changing and writing ONNX files.
//!
//! [`OnnxModel`] wraps the messages in [`proto`] with what a runtime needs
//! before it loads a network: what goes in and out, the metadata, another
//! input size, other outputs.
//!
//! ```
//! use realnet_nn::onnx::{OnnxError, OnnxModel};
//!
//! assert!(matches!(OnnxModel::from_bytes(b""), Err(OnnxError::Empty)));
//! ```

mod edit;
pub mod proto;
pub(crate) mod writer;

use std::collections::{BTreeMap, HashSet};

pub(crate) use edit::value_info;
use prost::{Message, bytes::Bytes};
use thiserror::Error;
pub(crate) use writer::check_size;
pub use writer::{ExportError, OnnxOptions};

use proto::{
    DimensionValue, GraphProto, ModelProto, StringStringEntryProto, TypeValue, ValueInfoProto,
    data_type,
};

/// What is wrong with an ONNX file or with a change asked for.
#[derive(Debug, Error)]
pub enum OnnxError {
    /// No bytes at all.
    #[error("the ONNX file is empty")]
    Empty,
    /// The bytes are not an ONNX model.
    #[error("not an ONNX file ({size} bytes): {reason}")]
    NotOnnx {
        /// Length of the file in bytes.
        size: usize,
        /// What the decoder met.
        reason: String,
    },
    /// A model without a graph.
    #[error("the ONNX model holds no graph")]
    NoGraph,
    /// A graph without nodes or outputs.
    #[error("the ONNX graph '{graph}' has no {what}")]
    EmptyGraph {
        /// Name of the graph.
        graph: String,
        /// `nodes`, `inputs` or `outputs`.
        what: &'static str,
    },
    /// Weights in a second file.
    #[error(
        "tensor '{tensor}' keeps its data in another file ('{location}'); only models in a single file are supported"
    )]
    ExternalData {
        /// Name of the tensor.
        tensor: String,
        /// Where the file says the data is.
        location: String,
    },
    /// No tensor of this name.
    #[error("the ONNX graph has no tensor '{name}'; its outputs are {outputs}")]
    UnknownTensor {
        /// The name asked for.
        name: String,
        /// Names of the outputs.
        outputs: String,
    },
    /// No output asked for.
    #[error("no output was named to keep")]
    NoOutputsKept,
    /// A change that needs exactly one input.
    #[error("the ONNX graph has {count} inputs ({names}); exactly one is needed to set its shape")]
    NotOneInput {
        /// How many.
        count: usize,
        /// Their names.
        names: String,
    },
    /// A shape of another rank than the file says, or a dimension that does not fit.
    #[error("shape {wanted:?} does not fit input '{input}' of shape {found}")]
    BadInputDims {
        /// Name of the input.
        input: String,
        /// The shape asked for.
        wanted: Vec<usize>,
        /// The shape in the file.
        found: String,
    },
}

/// One dimension of a tensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Dim {
    /// A number.
    Fixed(usize),
    /// A symbol decided at run time; empty when the file does not name it.
    Symbolic(String),
}

impl std::fmt::Display for Dim {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Dim::Fixed(n) => write!(f, "{n}"),
            Dim::Symbolic(s) if s.is_empty() => write!(f, "?"),
            Dim::Symbolic(s) => write!(f, "{s}"),
        }
    }
}

/// Element type of a tensor, as far as networks here use it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ElementType {
    /// 32-bit float.
    Float32,
    /// 16-bit float.
    Float16,
    /// 64-bit signed integer.
    Int64,
    /// Another one, by the number of the ONNX schema; 0 is 'not told'.
    Other(i32),
}

/// An input or output of a graph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TensorInfo {
    /// Name.
    pub name: String,
    /// Shape; `None` when the file does not tell the rank.
    pub dims: Option<Vec<Dim>>,
    /// Element type.
    pub element: ElementType,
}

impl TensorInfo {
    fn from_proto(info: &ValueInfoProto) -> Self {
        let tensor = match info.r#type.as_ref().and_then(|t| t.value.as_ref()) {
            Some(TypeValue::Tensor(t)) => Some(t),
            _ => None,
        };
        let element = match tensor.and_then(|t| t.elem_type).unwrap_or(0) {
            data_type::FLOAT => ElementType::Float32,
            data_type::FLOAT16 => ElementType::Float16,
            data_type::INT64 => ElementType::Int64,
            other => ElementType::Other(other),
        };
        let dims = tensor.and_then(|t| t.shape.as_ref()).map(|shape| {
            let dim = |value: &Option<DimensionValue>| match value {
                Some(DimensionValue::Value(n)) => {
                    usize::try_from(*n).map_or(Dim::Symbolic(String::new()), Dim::Fixed)
                }
                Some(DimensionValue::Param(name)) => Dim::Symbolic(name.clone()),
                None => Dim::Symbolic(String::new()),
            };
            shape.dim.iter().map(|d| dim(&d.value)).collect()
        });
        TensorInfo { name: info.name.clone(), dims, element }
    }

    /// All dimensions, if the shape is fully known.
    pub fn fixed_dims(&self) -> Option<Vec<usize>> {
        self.dims
            .as_ref()?
            .iter()
            .map(|d| if let Dim::Fixed(n) = d { Some(*n) } else { None })
            .collect()
    }

    fn shape_text(&self) -> String {
        match &self.dims {
            None => "unknown".to_owned(),
            Some(dims) => {
                let dims: Vec<String> = dims.iter().map(ToString::to_string).collect();
                format!("[{}]", dims.join(", "))
            }
        }
    }
}

impl std::fmt::Display for TensorInfo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "'{}' {:?} {}", self.name, self.element, self.shape_text())
    }
}

/// An ONNX model held in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct OnnxModel {
    model: ModelProto,
}

impl OnnxModel {
    /// Decodes a model that is complete in one file.
    ///
    /// # Errors
    /// [`OnnxError`] if the bytes are no ONNX model, hold no graph, or keep
    /// tensors in another file.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, OnnxError> {
        Self::from_vec(bytes.to_vec())
    }

    /// As [`OnnxModel::from_bytes`] without copying: the weights stay where they
    /// are, and copies of the model share them.
    ///
    /// # Errors
    /// As [`OnnxModel::from_bytes`].
    pub fn from_vec(bytes: Vec<u8>) -> Result<Self, OnnxError> {
        let size = bytes.len();
        if size == 0 {
            return Err(OnnxError::Empty);
        }
        let model = ModelProto::decode(Bytes::from(bytes))
            .map_err(|e| OnnxError::NotOnnx { size, reason: e.to_string() })?;
        Self::from_proto(model)
    }

    /// Wraps messages built elsewhere, with the same checks as [`OnnxModel::from_bytes`].
    ///
    /// # Errors
    /// As [`OnnxModel::from_bytes`].
    pub fn from_proto(model: ModelProto) -> Result<Self, OnnxError> {
        let graph = model.graph.as_ref().ok_or(OnnxError::NoGraph)?;
        for (empty, what) in
            [(graph.node.is_empty(), "nodes"), (graph.output.is_empty(), "outputs")]
        {
            if empty {
                return Err(OnnxError::EmptyGraph { graph: graph.name.clone(), what });
            }
        }
        edit::check_self_contained(graph)?;
        Ok(OnnxModel { model })
    }

    /// Encodes the model.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.model.encode_to_vec()
    }

    /// The messages.
    pub fn proto(&self) -> &ModelProto {
        &self.model
    }

    /// Tool that wrote the file, with its version.
    pub fn producer(&self) -> String {
        format!("{} {}", self.model.producer_name, self.model.producer_version).trim().to_owned()
    }

    /// Version of the standard operator set, if the file tells.
    pub fn opset(&self) -> Option<i64> {
        self.model
            .opset_import
            .iter()
            .find(|o| o.domain.is_empty() || o.domain == "ai.onnx")
            .and_then(|o| o.version)
    }

    /// The metadata of the model; of a key given twice the last counts.
    pub fn metadata(&self) -> BTreeMap<String, String> {
        self.model.metadata_props.iter().map(|p| (p.key.clone(), p.value.clone())).collect()
    }

    /// Sets one entry of the metadata, replacing an older one.
    pub fn set_metadata(&mut self, key: &str, value: &str) {
        self.model.metadata_props.retain(|p| p.key != key);
        self.model
            .metadata_props
            .push(StringStringEntryProto { key: key.to_owned(), value: value.to_owned() });
    }

    /// Inputs that a caller has to give, in the order of the file.
    ///
    /// Initialisers that older files list among the inputs are left out.
    pub fn inputs(&self) -> Vec<TensorInfo> {
        let Some(graph) = &self.model.graph else { return Vec::new() };
        let constants = initializer_names(graph);
        graph
            .input
            .iter()
            .filter(|i| !constants.contains(i.name.as_str()))
            .map(TensorInfo::from_proto)
            .collect()
    }

    /// Outputs in the order of the file.
    pub fn outputs(&self) -> Vec<TensorInfo> {
        let Some(graph) = &self.model.graph else { return Vec::new() };
        graph.output.iter().map(TensorInfo::from_proto).collect()
    }

    /// Whether a tensor of this name exists: an input, initialiser or result of a node.
    pub fn has_tensor(&self, name: &str) -> bool {
        let Some(graph) = &self.model.graph else { return false };
        !name.is_empty()
            && (graph.node.iter().any(|n| n.output.iter().any(|o| o == name))
                || graph.input.iter().any(|i| i.name == name)
                || initializer_names(graph).contains(name))
    }
}

fn initializer_names(graph: &GraphProto) -> HashSet<&str> {
    let sparse = graph.sparse_initializer.iter().filter_map(|s| s.values.as_ref());
    graph.initializer.iter().chain(sparse).map(|t| t.name.as_str()).collect()
}
