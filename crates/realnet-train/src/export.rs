//! Trained networks as files that are read everywhere.

use crate::names::{NamesError, Tensors, tensors};
use crate::nets::block::Normalisation;
use crate::nets::yolov5::STRIDES;
use crate::nets::{DepthNet, YoloV5};
use realnet_nn::depth::{CodingError, DepthCoding, DepthImportError, DepthWeights};
use realnet_nn::onnx::{ExportError, OnnxOptions};
use realnet_nn::weights::{self, Checkpoint};
use realnet_nn::yolov5::ImportError;
use safetensors::tensor::{Dtype, TensorView};
use std::collections::HashMap;
use thiserror::Error;

/// Why a network does not become a file.
#[derive(Debug, Error)]
pub enum ExportNetworkError {
    /// Its tensors.
    #[error(transparent)]
    Names(#[from] NamesError),
    /// As a detector at run time.
    #[error(transparent)]
    Import(#[from] ImportError),
    /// As a depth network at run time.
    #[error(transparent)]
    Depth(#[from] DepthImportError),
    /// A coding of depth that cannot be.
    #[error(transparent)]
    Coding(#[from] CodingError),
    /// As ONNX.
    #[error(transparent)]
    Onnx(#[from] ExportError),
    /// As safetensors.
    #[error("safetensors: {0}")]
    Safetensors(String),
    /// Another number of names than classes.
    #[error("{names} names for {classes} classes")]
    ClassNames {
        /// Names given.
        names: usize,
        /// Classes of the network.
        classes: usize,
    },
}

/// The weights of a detector by the names of its authors' files, with the names of its
/// classes, as `realnet-nn` reads them. `model` is as [`valid`](burn::module::Module::valid) gives it.
///
/// # Errors
/// [`ExportNetworkError`] when the weights cannot be read, or names are missing.
pub fn detector_checkpoint(
    model: &YoloV5,
    class_names: &[String],
) -> Result<Checkpoint, ExportNetworkError> {
    let config = model.config();
    if class_names.len() != config.classes {
        let (names, classes) = (class_names.len(), config.classes);
        return Err(ExportNetworkError::ClassNames { names, classes });
    }
    let mut tensors: Tensors = tensors(model)?;
    // In cells, as the authors' files have them.
    let anchors = config.anchors.iter().zip(STRIDES);
    let anchors =
        anchors.flat_map(|(level, stride)| level.iter().flatten().map(move |x| x / stride as f32));
    if let Some(anchors) = weights::Tensor::new(vec![3, 3, 2], anchors.collect()) {
        tensors.insert("model.24.anchors".to_owned(), anchors);
    }
    Ok(Checkpoint {
        tensors,
        class_names: Some(class_names.to_vec()),
        strides: Some(STRIDES.map(|stride| stride as f64).to_vec()),
        bn_eps: Some(Normalisation::YOLOV5.epsilon),
        ..Checkpoint::default()
    })
}

/// A detector as an ONNX file, complete in one piece.
///
/// # Errors
/// [`ExportNetworkError`] when it cannot be written.
pub fn detector_onnx(
    model: &YoloV5,
    class_names: &[String],
    options: &OnnxOptions,
) -> Result<Vec<u8>, ExportNetworkError> {
    let checkpoint = detector_checkpoint(model, class_names)?;
    Ok(realnet_nn::yolov5::YoloV5::from_checkpoint(&checkpoint)?.to_onnx(options)?)
}

/// The weights of a depth network with its coding of depth, as `realnet-nn` reads them.
/// `model` is as [`valid`](burn::module::Module::valid) gives it.
///
/// # Errors
/// [`ExportNetworkError`] when the weights cannot be read, or the coding cannot be.
pub fn depth_checkpoint(
    model: &impl DepthNet,
    coding: &DepthCoding,
) -> Result<Checkpoint, ExportNetworkError> {
    coding.check()?;
    // The epsilons of batch normalisation are those that the run time knows.
    Ok(Checkpoint { tensors: tensors(model)?, depth: Some(*coding), ..Checkpoint::default() })
}

/// A depth network as an ONNX file, complete in one piece.
///
/// # Errors
/// [`ExportNetworkError`] when it cannot be written.
pub fn depth_onnx(
    model: &impl DepthNet,
    coding: &DepthCoding,
    options: &OnnxOptions,
) -> Result<Vec<u8>, ExportNetworkError> {
    let checkpoint = depth_checkpoint(model, coding)?;
    Ok(DepthWeights::from_checkpoint(&checkpoint)?.to_onnx(options)?)
}

/// A checkpoint as a safetensors file: tensors as 32-bit floats; names of classes, strides,
/// the epsilon of batch normalisation, the coding of depth and the input size as metadata.
///
/// # Errors
/// [`ExportNetworkError::Safetensors`].
pub fn safetensors(checkpoint: &Checkpoint) -> Result<Vec<u8>, ExportNetworkError> {
    let wrong = |error: &dyn std::fmt::Display| ExportNetworkError::Safetensors(error.to_string());
    let bytes: Vec<(&String, &weights::Tensor, Vec<u8>)> = checkpoint
        .tensors
        .iter()
        .map(|(name, tensor)| {
            let bytes = tensor.data().iter().flat_map(|value| value.to_le_bytes()).collect();
            (name, tensor, bytes)
        })
        .collect();
    let views = bytes
        .iter()
        .map(|(name, tensor, bytes)| {
            let view = TensorView::new(Dtype::F32, tensor.shape().to_vec(), bytes);
            view.map(|view| (name.as_str(), view)).map_err(|error| wrong(&error))
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut metadata = HashMap::new();
    let mut put = |key: &str, value: serde_json::Value| {
        metadata.insert(key.to_owned(), value.to_string());
    };
    if let Some(names) = &checkpoint.class_names {
        put("names", names.clone().into());
    }
    if let Some(strides) = &checkpoint.strides {
        put("stride", strides.clone().into());
    }
    if let Some(epsilon) = checkpoint.bn_eps {
        put("bn_eps", epsilon.into());
    }
    if let Some((width, height)) = checkpoint.size {
        put("imgsz", vec![height, width].into());
    }
    if let Some(coding) = &checkpoint.depth {
        metadata.insert(DepthCoding::KEY.to_owned(), coding.to_json());
    }
    let file = safetensors::serialize(views, Some(metadata)).map_err(|error| wrong(&error))?;
    sorted(file).ok_or_else(|| wrong(&"its header is none"))
}

/// The same file with its metadata in the order of their keys: the library's is another one in
/// each run, and equal networks are to be equal files.
fn sorted(mut file: Vec<u8>) -> Option<Vec<u8>> {
    const METADATA: &str = "__metadata__";
    let (length, rest) = file.split_first_chunk_mut::<8>()?;
    let header = rest.get_mut(..usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    let mut parsed: serde_json::Map<String, serde_json::Value> =
        serde_json::from_slice(header).ok()?;
    parsed.get_mut(METADATA)?.as_object_mut()?.sort_keys();
    let mut text = serde_json::to_vec(&parsed).ok()?;
    // As long as it was, but for the spaces behind it.
    if text.len() > header.len() {
        return None;
    }
    text.resize(header.len(), b' ');
    header.copy_from_slice(&text);
    Some(file)
}
