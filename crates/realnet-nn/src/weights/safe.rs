//! safetensors files.

use std::collections::BTreeMap;

use safetensors::tensor::{Dtype as SafeDtype, SafeTensors};
use serde_json::Value;

use super::storage::Dtype;
use super::{Checkpoint, Tensor, WeightsError, normalise_name};
use crate::depth::DepthCoding;

/// Whether the bytes start like a safetensors file: the length of the header,
/// then its opening brace.
pub(super) fn looks_like(bytes: &[u8]) -> bool {
    bytes.get(8) == Some(&b'{')
}

/// Reads a checkpoint from the bytes of a file.
pub(super) fn read(bytes: &[u8]) -> Result<Checkpoint, WeightsError> {
    let error = |reason: String| WeightsError::Safetensors { reason };
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| error(e.to_string()))?;
    let file = SafeTensors::deserialize(bytes).map_err(|e| error(e.to_string()))?;
    let mut tensors = BTreeMap::new();
    for (name, view) in file.iter() {
        if name.ends_with("num_batches_tracked") {
            continue;
        }
        let dtype = element_type(view.dtype()).ok_or_else(|| WeightsError::Tensor {
            name: name.to_owned(),
            reason: format!("elements of type {:?} are not supported", view.dtype()),
        })?;
        let tensor = Tensor::new(view.shape().to_vec(), dtype.decode_all(view.data(), false));
        let tensor = tensor.ok_or_else(|| WeightsError::Tensor {
            name: name.to_owned(),
            reason: format!("shape {:?} does not fit its data", view.shape()),
        })?;
        if tensors.insert(normalise_name(name), tensor).is_some() {
            return Err(WeightsError::Tensor {
                name: name.to_owned(),
                reason: "two tensors of the file have this name".to_owned(),
            });
        }
    }
    let metadata = header.metadata().clone().unwrap_or_default();
    let json = |key: &str| -> Option<Value> { serde_json::from_str(metadata.get(key)?).ok() };
    Ok(Checkpoint {
        tensors,
        modules: BTreeMap::new(),
        class_names: metadata
            .get("names")
            .and_then(|text| crate::class_names::parse_names(text).ok()),
        strides: json("stride")
            .and_then(|v| v.as_array()?.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>()),
        bn_eps: json("bn_eps").as_ref().and_then(Value::as_f64),
        depth: metadata
            .get(DepthCoding::KEY)
            .map(|text| DepthCoding::from_json(text))
            .transpose()?,
        size: json("imgsz").and_then(|v| {
            let sides = v.as_array()?.iter().map(|side| u32::try_from(side.as_u64()?).ok());
            let &[height, width] = sides.collect::<Option<Vec<u32>>>()?.as_slice() else {
                return None;
            };
            Some((width, height))
        }),
    })
}

fn element_type(dtype: SafeDtype) -> Option<Dtype> {
    Some(match dtype {
        SafeDtype::F64 => Dtype::F64,
        SafeDtype::F32 => Dtype::F32,
        SafeDtype::F16 => Dtype::F16,
        SafeDtype::BF16 => Dtype::Bf16,
        SafeDtype::I64 => Dtype::I64,
        SafeDtype::I32 => Dtype::I32,
        SafeDtype::I16 => Dtype::I16,
        SafeDtype::I8 => Dtype::I8,
        SafeDtype::U8 | SafeDtype::BOOL => Dtype::U8,
        _ => return None,
    })
}
