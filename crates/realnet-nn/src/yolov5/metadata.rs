//! What a detector's ONNX file tells about itself.

use serde_json::Value;
use thiserror::Error;

use crate::class_names::{NamesError, parse_names};
use crate::onnx::OnnxModel;

/// Metadata that cannot be read.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum MetadataError {
    /// The class names.
    #[error("metadata 'names': {0}")]
    Names(#[from] NamesError),
    /// Another entry.
    #[error("metadata '{key}' is not {expected}: {found}")]
    Entry {
        /// Key of the entry.
        key: &'static str,
        /// What it should be.
        expected: &'static str,
        /// Its text, shortened.
        found: String,
    },
}

/// The metadata of a YOLOv5 ONNX file, as Ultralytics writes it (`names`,
/// `stride`, `imgsz`) and with what this crate adds (`anchors`,
/// `realnet_heads`, `realnet_strides`). What a file does not tell is empty or
/// `None`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DetectorMetadata {
    /// Names of the classes in order.
    pub names: Vec<String>,
    /// Strides of the heads in pixels, finest first.
    pub strides: Vec<usize>,
    /// Anchors of every head: widths and heights in pixels.
    pub anchors: Vec<Vec<[f32; 2]>>,
    /// Names of the tensors of the heads before reshaping and sigmoid.
    pub heads: Vec<String>,
    /// Height and width of the input in pixels.
    pub imgsz: Option<[usize; 2]>,
    /// Input sizes have to be multiples of this.
    pub max_stride: Option<usize>,
}

impl DetectorMetadata {
    /// Reads the metadata of a model.
    ///
    /// # Errors
    /// [`MetadataError`] if an entry is there but cannot be read, or the
    /// numbers of heads, strides and anchors differ.
    pub fn from_onnx(model: &OnnxModel) -> Result<Self, MetadataError> {
        let metadata = model.metadata();
        let get = |key: &str| metadata.get(key).map(String::as_str);
        let names = get("names").map(parse_names).transpose()?.unwrap_or_default();
        let max_stride = entry(get("stride"), "stride", "a number", positive)?;
        let imgsz = entry(get("imgsz"), "imgsz", "a list of two numbers", |v| {
            let sizes: Vec<usize> = v.as_array()?.iter().map(positive).collect::<Option<_>>()?;
            <[usize; 2]>::try_from(sizes).ok()
        })?;
        let strides = entry(get("realnet_strides"), "realnet_strides", "a list of numbers", |v| {
            v.as_array()?.iter().map(positive).collect::<Option<Vec<_>>>()
        })?
        .unwrap_or_default();
        let anchors = entry(get("anchors"), "anchors", "a list of lists of pairs", |v| {
            v.as_array()?.iter().map(level).collect::<Option<Vec<_>>>()
        })?
        .unwrap_or_default();
        let heads: Vec<String> = get("realnet_heads")
            .map(|text| text.split(',').map(|n| n.trim().to_owned()).collect())
            .unwrap_or_default();
        for (key, count) in [("realnet_strides", strides.len()), ("anchors", anchors.len())] {
            if !heads.is_empty() && count != heads.len() {
                return Err(MetadataError::Entry {
                    key,
                    expected: "of the same length as realnet_heads",
                    found: format!("{count} and {}", heads.len()),
                });
            }
        }
        Ok(DetectorMetadata { names, strides, anchors, heads, imgsz, max_stride })
    }
}

fn entry<T>(
    text: Option<&str>,
    key: &'static str,
    expected: &'static str,
    read: impl FnOnce(&Value) -> Option<T>,
) -> Result<Option<T>, MetadataError> {
    let Some(text) = text else { return Ok(None) };
    let value: Option<Value> = serde_json::from_str(text).ok();
    match value.as_ref().and_then(read) {
        Some(found) => Ok(Some(found)),
        None => {
            let found = text.chars().take(60).collect();
            Err(MetadataError::Entry { key, expected, found })
        }
    }
}

/// A positive whole number; Python may write it as `32.0`.
fn positive(value: &Value) -> Option<usize> {
    let n = value.as_f64()?;
    (n.fract() == 0.0 && (1.0..=65_536.0).contains(&n)).then_some(n as usize)
}

fn level(value: &Value) -> Option<Vec<[f32; 2]>> {
    let pair = |v: &Value| -> Option<[f32; 2]> {
        match v.as_array()?.as_slice() {
            [w, h] => Some([w.as_f64()? as f32, h.as_f64()? as f32]),
            _ => None,
        }
    };
    value.as_array()?.iter().map(pair).collect()
}
