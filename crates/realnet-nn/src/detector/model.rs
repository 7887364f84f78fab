//! Model files: weights or ONNX, told apart by their bytes.

use super::decode::{Layout, Level};
use crate::{
    onnx::{Dim, OnnxError, OnnxModel, check_size},
    weights::{Checkpoint, WeightsError},
    yolov5::{DetectorMetadata, ExportError, ImportError, OnnxOptions, YoloV5},
};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Input size for weights that do not name one.
const DEFAULT_SIZE: (u32, u32) = (640, 640);

/// Why a file is not a detector.
#[derive(Debug, Error)]
pub enum ModelError {
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
        reason: ImportError,
    },
    /// An input size that the network cannot have.
    #[error("{name}: {reason}")]
    Size {
        /// What was read.
        name: String,
        /// What is wrong.
        reason: ExportError,
    },
    /// Not an ONNX file that can be used.
    #[error("{name}: {reason}")]
    Onnx {
        /// What was read.
        name: String,
        /// What is wrong.
        reason: OnnxError,
    },
    /// An ONNX file that is no YOLO detector.
    #[error("{name}: {reason}")]
    NotADetector {
        /// What was read.
        name: String,
        /// What was found.
        reason: String,
    },
    /// A size the file cannot have.
    #[error("{name}: the network has a fixed input of {}x{}, {}x{} was asked for", found.0, found.1, asked.0, asked.1)]
    FixedSize {
        /// What was read.
        name: String,
        /// (width, height) in the file.
        found: (u32, u32),
        /// (width, height) asked for.
        asked: (u32, u32),
    },
}

/// A detection network that can be brought to an engine.
#[derive(Clone, Debug)]
pub struct DetectorModel {
    name: String,
    classes: Vec<String>,
    source: Source,
}

#[derive(Clone, Debug)]
enum Source {
    /// YOLOv5 weights: any input size.
    Weights { network: Box<YoloV5>, size: (u32, u32) },
    /// An ONNX file written by RealNet: any input size, by its raw heads.
    Heads { model: Box<OnnxModel>, heads: Heads, size: (u32, u32) },
    /// An ONNX file written by somebody else.
    Foreign { model: Box<OnnxModel>, layout: Layout, size: Option<(u32, u32)> },
}

/// The raw head tensors of a YOLOv5 graph.
#[derive(Clone, Debug)]
struct Heads {
    tensors: Vec<String>,
    levels: Vec<Level>,
    stride: usize,
}

impl Heads {
    /// The heads that the metadata name, if the graph has them.
    fn find(model: &OnnxModel, metadata: &DetectorMetadata) -> Option<Self> {
        let DetectorMetadata { heads, anchors, strides, .. } = metadata;
        let complete = !heads.is_empty()
            && heads.len() == anchors.len()
            && heads.len() == strides.len()
            && anchors.iter().all(|level| !level.is_empty())
            && heads.iter().all(|head| model.has_tensor(head));
        let level = |(anchors, &stride): (&Vec<_>, &usize)| Level {
            stride: stride as f32,
            anchors: anchors.clone(),
        };
        complete.then(|| Self {
            tensors: heads.clone(),
            levels: anchors.iter().zip(strides).map(level).collect(),
            stride: strides.iter().copied().max().unwrap_or(1),
        })
    }

    /// Makes the heads the outputs of `model`, for an input of (width, height).
    fn cut(&self, model: &mut OnnxModel, (width, height): (u32, u32)) -> Result<(), OnnxError> {
        let tensors: Vec<&str> = self.tensors.iter().map(String::as_str).collect();
        model.keep_outputs(&tensors)?;
        model.set_input_dims(&[1, 3, height as usize, width as usize])
    }
}

impl DetectorModel {
    /// Reads a `.pt`, `.safetensors` or `.onnx` file; what it is is told by its
    /// bytes, not by its name.
    ///
    /// # Errors
    /// [`ModelError`] when the file cannot be read or is no detector.
    pub fn open(path: &Path) -> Result<Self, ModelError> {
        let bytes = std::fs::read(path)
            .map_err(|reason| ModelError::Read { path: path.to_owned(), reason })?;
        Self::from_vec(&path.display().to_string(), bytes)
    }

    /// As [`DetectorModel::open`] for bytes in memory; `name` is for messages.
    ///
    /// # Errors
    /// As [`DetectorModel::open`].
    pub fn from_vec(name: &str, bytes: Vec<u8>) -> Result<Self, ModelError> {
        let not_weights = match Checkpoint::from_bytes(&bytes) {
            Ok(checkpoint) => return Self::from_checkpoint(name, &checkpoint),
            Err(reason @ WeightsError::UnknownFormat { .. }) => reason,
            Err(reason) => return Err(ModelError::Weights { name: name.to_owned(), reason }),
        };
        // The first field of an ONNX file is its version.
        let claims_onnx = bytes.starts_with(b"\x08") || name.ends_with(".onnx");
        match OnnxModel::from_vec(bytes) {
            Ok(model) => Self::from_onnx(name, model),
            Err(reason) if claims_onnx => Err(ModelError::Onnx { name: name.to_owned(), reason }),
            Err(_) => Err(ModelError::Weights { name: name.to_owned(), reason: not_weights }),
        }
    }

    fn from_checkpoint(name: &str, checkpoint: &Checkpoint) -> Result<Self, ModelError> {
        let weights = YoloV5::from_checkpoint(checkpoint)
            .map_err(|reason| ModelError::Import { name: name.to_owned(), reason })?;
        let classes = weights.class_names().to_vec();
        let size = checkpoint.size.unwrap_or(DEFAULT_SIZE);
        let source = Source::Weights { network: Box::new(weights), size };
        Ok(Self { name: name.to_owned(), classes, source })
    }

    fn from_onnx(name: &str, model: OnnxModel) -> Result<Self, ModelError> {
        let not = |reason: String| ModelError::NotADetector { name: name.to_owned(), reason };
        let metadata = DetectorMetadata::from_onnx(&model).map_err(|e| not(e.to_string()))?;
        let inputs = model.inputs();
        let size = inputs.first().and_then(|input| match input.dims.as_deref() {
            Some([_, _, Dim::Fixed(height), Dim::Fixed(width)]) => {
                Some((u32::try_from(*width).ok()?, u32::try_from(*height).ok()?))
            }
            _ => None,
        });
        if let Some(heads) = Heads::find(&model, &metadata)
            && !metadata.names.is_empty()
        {
            let size = size.unwrap_or(DEFAULT_SIZE);
            let source = Source::Heads { model: Box::new(model), heads, size };
            return Ok(Self { name: name.to_owned(), classes: metadata.names, source });
        }
        let (layout, classes) = foreign_layout(&model, metadata.names.len()).map_err(not)?;
        let classes = if metadata.names.is_empty() {
            (0..classes).map(|class| format!("class{class}")).collect()
        } else {
            metadata.names
        };
        let source = Source::Foreign { model: Box::new(model), layout, size };
        Ok(Self { name: name.to_owned(), classes, source })
    }

    /// The class names, by class id.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.classes
    }

    /// As [`DetectorModel::names`], when the rest is not needed any more.
    #[must_use]
    pub fn into_names(self) -> Vec<String> {
        self.classes
    }

    /// True when the network can have any input size that its stride divides.
    #[must_use]
    pub fn is_resizable(&self) -> bool {
        !matches!(self.source, Source::Foreign { size: Some(_), .. })
    }

    /// The graph for an input of (width, height), and how to read its outputs.
    pub(super) fn network(
        &self,
        size: Option<(u32, u32)>,
    ) -> Result<(OnnxModel, Layout), ModelError> {
        let name = || self.name.clone();
        let onnx = |reason| ModelError::Onnx { name: name(), reason };
        let bad_size = |reason| ModelError::Size { name: name(), reason };
        match &self.source {
            Source::Weights { network, size: own } => {
                let (width, height) = size.unwrap_or(*own);
                let options =
                    OnnxOptions { width: width as usize, height: height as usize, half: false };
                let bytes = network.to_onnx(&options).map_err(bad_size)?;
                let mut model = OnnxModel::from_vec(bytes).map_err(onnx)?;
                let not = |reason: String| ModelError::NotADetector { name: name(), reason };
                let metadata =
                    DetectorMetadata::from_onnx(&model).map_err(|error| not(error.to_string()))?;
                let heads = Heads::find(&model, &metadata)
                    .ok_or_else(|| not("the graph has lost its heads".to_owned()))?;
                heads.cut(&mut model, (width, height)).map_err(onnx)?;
                Ok((model, Layout::Heads(heads.levels)))
            }
            Source::Heads { model, heads, size: own } => {
                let (width, height) = size.unwrap_or(*own);
                check_size(width as usize, height as usize, heads.stride).map_err(bad_size)?;
                let mut model = (**model).clone();
                heads.cut(&mut model, (width, height)).map_err(onnx)?;
                Ok((model, Layout::Heads(heads.levels.clone())))
            }
            Source::Foreign { model, layout, size: own } => {
                let mut model = (**model).clone();
                if let Some(output) = model.outputs().first() {
                    model.keep_outputs(&[&output.name]).map_err(onnx)?;
                }
                match (*own, size) {
                    (Some(found), Some(asked)) if found != asked => {
                        return Err(ModelError::FixedSize { name: name(), found, asked });
                    }
                    (own, asked) => {
                        // Also a batch that the file leaves open becomes 1.
                        let (width, height) = own.or(asked).unwrap_or(DEFAULT_SIZE);
                        let dims = [1, 3, height as usize, width as usize];
                        let open = model.inputs().iter().any(|i| i.fixed_dims().is_none());
                        if open {
                            model.set_input_dims(&dims).map_err(onnx)?;
                        }
                    }
                }
                Ok((model, layout.clone()))
            }
        }
    }
}

/// Layout and number of classes of an ONNX file without RealNet's metadata, by
/// the shape of its first output: YOLOv5 has few values behind many boxes, YOLOv8
/// and 11 the other way round.
fn foreign_layout(model: &OnnxModel, names: usize) -> Result<(Layout, usize), String> {
    let outputs = model.outputs();
    let output = outputs.first().ok_or("the graph has no output")?;
    let dims = output.dims.as_deref().unwrap_or_default();
    let fixed = |dim: &Dim| match dim {
        Dim::Fixed(n) => Some(*n),
        Dim::Symbolic(_) => None,
    };
    let [_, middle, last] = dims else {
        return Err(format!(
            "output {output} is not that of YOLOv5 (1xNx(5+C)) or YOLOv8/11 (1x(4+C)xN)"
        ));
    };
    let (middle, last) = (fixed(middle), fixed(last));
    // The names decide where they can; the longer axis counts the boxes otherwise.
    let rows = match (middle, last) {
        _ if names > 0 && last == Some(5 + names) => true,
        _ if names > 0 && middle == Some(4 + names) => false,
        (Some(middle), Some(last)) => last < middle,
        (None, Some(_)) => true,
        (Some(_), None) => false,
        (None, None) => return Err(format!("output {output} does not tell its shape")),
    };
    let (layout, values, fixed_part) =
        if rows { (Layout::Rows, last, 5) } else { (Layout::Columns, middle, 4) };
    let values = values.unwrap_or(0);
    let wrong = |expected: String| {
        format!(
            "output {output} has {values} values a box, {expected} (boxes, masks and key points of other tasks are not supported)"
        )
    };
    if values <= fixed_part {
        return Err(wrong(format!("more than {fixed_part} are needed")));
    }
    if names > 0 && values != fixed_part + names {
        return Err(wrong(format!("{} are needed for {names} classes", fixed_part + names)));
    }
    Ok((layout, values - fixed_part))
}
