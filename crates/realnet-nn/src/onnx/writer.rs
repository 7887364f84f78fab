//! Writes networks as ONNX: what all of them need.

use super::proto::{
    AttributeProto, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, StringStringEntryProto,
    TensorProto, attribute_type, data_type,
};
use crate::depth::Alignment;
use crate::layer::{Activation, Conv};
use half::f16;
use prost::Message;
use thiserror::Error;

/// Operator set written: all operators used are unchanged since, and every
/// ONNX Runtime of the last years, TensorRT 8 and rten know it.
const OPSET: i64 = 13;
/// The version of the file format that came with it.
const IR_VERSION: i64 = 7;

/// How a network is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OnnxOptions {
    /// Width of the input in pixels.
    pub width: usize,
    /// Height of the input in pixels.
    pub height: usize,
    /// Weights as 16-bit floats: half the size, computed in 32 bits all the same.
    pub half: bool,
}

/// Why a network cannot be written.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum ExportError {
    /// An input size that the strides do not divide.
    #[error("input {what} {value} is not a positive multiple of {stride}; the next one is {next}")]
    InputSize {
        /// `width` or `height`.
        what: &'static str,
        /// The size asked for in pixels.
        value: usize,
        /// The largest stride in pixels.
        stride: usize,
        /// The next size in pixels that fits.
        next: usize,
    },
    /// An input size beyond what the output can count.
    #[error("input {what} {value} is more than {limit} pixels")]
    TooLarge {
        /// `width` or `height`.
        what: &'static str,
        /// The size asked for in pixels.
        value: usize,
        /// The limit in pixels.
        limit: usize,
    },
    /// A weight too large for a 16-bit float.
    #[error("tensor '{name}' holds {value}, too large for a 16-bit float")]
    HalfRange {
        /// Name of the tensor in the file.
        name: String,
        /// The weight.
        value: String,
    },
}

/// Largest width or height, in pixels.
const MAX_SIZE: usize = crate::engine::MAX_SIDE as usize;

/// Whether a network whose largest stride is `stride` can have this input size.
pub(crate) fn check_size(width: usize, height: usize, stride: usize) -> Result<(), ExportError> {
    for (what, value) in [("width", width), ("height", height)] {
        if value > MAX_SIZE {
            return Err(ExportError::TooLarge { what, value, limit: MAX_SIZE });
        }
        if value == 0 || !value.is_multiple_of(stride) {
            let next = value.max(1).next_multiple_of(stride);
            return Err(ExportError::InputSize { what, value, stride, next });
        }
    }
    Ok(())
}

/// A graph that is being written.
pub(crate) struct GraphWriter {
    pub(crate) graph: GraphProto,
    half: bool,
}

impl GraphWriter {
    /// An empty graph; with `half`, weights are stored in 16 bits.
    pub(crate) fn new(name: &str, half: bool) -> Self {
        let graph = GraphProto { name: name.to_owned(), ..Default::default() };
        Self { graph, half }
    }

    /// The finished file.
    pub(crate) fn finish(self, metadata: Vec<(&str, String)>) -> Vec<u8> {
        let entry =
            |(key, value): (&str, String)| StringStringEntryProto { key: key.to_owned(), value };
        let model = ModelProto {
            ir_version: Some(IR_VERSION),
            producer_name: "realnet".to_owned(),
            producer_version: env!("CARGO_PKG_VERSION").to_owned(),
            graph: Some(self.graph),
            opset_import: vec![OperatorSetIdProto { domain: String::new(), version: Some(OPSET) }],
            metadata_props: metadata.into_iter().map(entry).collect(),
            ..Default::default()
        };
        model.encode_to_vec()
    }

    // Layers.

    /// Writes a convolution with its activation; returns the name of its output.
    ///
    /// # Errors
    /// [`ExportError::HalfRange`] when a weight does not fit 16 bits.
    pub(crate) fn conv(
        &mut self,
        path: &str,
        input: &str,
        conv: &Conv,
    ) -> Result<String, ExportError> {
        let output = format!("{path}.out");
        self.conv_to(path, input, conv, &output)?;
        Ok(output)
    }

    /// As [`GraphWriter::conv`] with the name of the output given.
    ///
    /// # Errors
    /// As [`GraphWriter::conv`].
    pub(crate) fn conv_to(
        &mut self,
        path: &str,
        input: &str,
        conv: &Conv,
        output: &str,
    ) -> Result<(), ExportError> {
        self.weight(&format!("{path}.weight"), &conv.shape, &conv.weight)?;
        self.weight(&format!("{path}.bias"), &[conv.out()], &conv.bias)?;
        self.conv_again(path, input, conv, output);
        Ok(())
    }

    /// A second convolution with the weights that [`GraphWriter::conv_to`] wrote
    /// under `path`; of `conv` only the numbers are read.
    pub(crate) fn conv_again(&mut self, path: &str, input: &str, conv: &Conv, output: &str) {
        let kernel = conv.shape[2];
        let attributes = vec![
            ints("dilations", &[conv.dilation; 2]),
            int("group", conv.groups),
            ints("kernel_shape", &[kernel, kernel]),
            ints("pads", &[conv.pad; 4]),
            ints("strides", &[conv.stride; 2]),
        ];
        let [weight, bias] = ["weight", "bias"].map(|part| format!("{path}.{part}"));
        let linear = format!("{path}.linear");
        let after = if conv.activation == Activation::Identity { output } else { &linear };
        self.node("Conv", &[input, &weight, &bias], &[after], attributes);
        self.activation(path, &linear, conv.activation, output);
    }

    fn activation(&mut self, path: &str, input: &str, activation: Activation, output: &str) {
        match activation {
            Activation::Identity => {}
            Activation::Silu => {
                // The pair that engines know and fuse.
                let gate = format!("{path}.gate");
                self.node("Sigmoid", &[input], &[&gate], vec![]);
                self.node("Mul", &[input, &gate], &[output], vec![]);
            }
            Activation::Hardswish => {
                // x·max(0, min(1, x/6 + 1/2)); the operator HardSwish is newer than the opset.
                let gate = format!("{path}.gate");
                let attributes = vec![float("alpha", 1.0 / 6.0), float("beta", 0.5)];
                self.node("HardSigmoid", &[input], &[&gate], attributes);
                self.node("Mul", &[input, &gate], &[output], vec![]);
            }
            Activation::Relu6 => {
                for (name, value) in [("relu6.min", 0.0), ("relu6.max", 6.0)] {
                    self.shared_float_constant(name, &[], &[value]);
                }
                self.node("Clip", &[input, "relu6.min", "relu6.max"], &[output], vec![]);
            }
            Activation::Relu => self.node("Relu", &[input], &[output], vec![]),
            Activation::LeakyRelu(slope) => {
                self.node("LeakyRelu", &[input], &[output], vec![float("alpha", slope)]);
            }
        }
    }

    /// Joins tensors along `axis`; returns the name of the output.
    pub(crate) fn concat(&mut self, path: &str, inputs: &[&str], axis: usize) -> String {
        let output = format!("{path}.cat");
        self.node("Concat", inputs, &[&output], vec![int("axis", axis)]);
        output
    }

    /// Adds two tensors and cuts off what is negative; returns the name of the output.
    pub(crate) fn add_relu(&mut self, path: &str, a: &str, b: &str) -> String {
        let (sum, output) = (format!("{path}.sum"), format!("{path}.relu"));
        self.node("Add", &[a, b], &[&sum], vec![]);
        self.node("Relu", &[&sum], &[&output], vec![]);
        output
    }

    /// The largest of `kernel` x `kernel` pixels at every `stride`-th, padded by half a kernel.
    pub(crate) fn max_pool(&mut self, input: &str, kernel: usize, stride: usize, output: &str) {
        let attributes = vec![
            ints("kernel_shape", &[kernel; 2]),
            ints("pads", &[kernel / 2; 4]),
            ints("strides", &[stride; 2]),
        ];
        self.node("MaxPool", &[input], &[output], attributes);
    }

    /// `factor` times as wide and high, between the pixels linearly.
    pub(crate) fn resize(
        &mut self,
        input: &str,
        factor: usize,
        alignment: Alignment,
        output: &str,
    ) {
        let scales = format!("resize{factor}.scales");
        let factor = factor as f32;
        self.shared_float_constant(&scales, &[4], &[1.0, 1.0, factor, factor]);
        let mode = match alignment {
            Alignment::Corners => "align_corners",
            Alignment::Centres => "half_pixel",
        };
        let attributes = vec![text("coordinate_transformation_mode", mode), text("mode", "linear")];
        self.node("Resize", &[input, "", &scales], &[output], attributes);
    }

    // Nodes and constants.

    /// Any node.
    pub(crate) fn node(
        &mut self,
        op: &str,
        inputs: &[&str],
        outputs: &[&str],
        attribute: Vec<AttributeProto>,
    ) {
        self.graph.node.push(NodeProto {
            input: inputs.iter().map(|s| (*s).to_owned()).collect(),
            output: outputs.iter().map(|s| (*s).to_owned()).collect(),
            name: format!("{op}:{}", outputs.first().copied().unwrap_or_default()),
            op_type: op.to_owned(),
            attribute,
            ..Default::default()
        });
    }

    /// A weight in the precision asked for, to be read by `name`.
    fn weight(&mut self, name: &str, shape: &[usize], data: &[f32]) -> Result<(), ExportError> {
        if !self.half {
            self.float_constant(name, shape, data);
            return Ok(());
        }
        if let Some(large) = data.iter().find(|x| f16::from_f32(**x).is_infinite()) {
            let value = large.to_string();
            return Err(ExportError::HalfRange { name: name.to_owned(), value });
        }
        let stored = format!("{name}.half");
        let bytes = data.iter().flat_map(|&x| f16::from_f32(x).to_le_bytes()).collect();
        self.constant(&stored, shape, data_type::FLOAT16, bytes);
        let to = AttributeProto {
            i: Some(i64::from(data_type::FLOAT)),
            ..attribute("to", attribute_type::INT)
        };
        self.node("Cast", &[&stored], &[name], vec![to]);
        Ok(())
    }

    /// A constant that several nodes read: written the first time it is asked for.
    pub(crate) fn shared_float_constant(&mut self, name: &str, shape: &[usize], data: &[f32]) {
        if !self.graph.initializer.iter().any(|t| t.name == name) {
            self.float_constant(name, shape, data);
        }
    }

    /// A constant of 32-bit floats, row-major.
    pub(crate) fn float_constant(&mut self, name: &str, shape: &[usize], data: &[f32]) {
        let bytes = data.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.constant(name, shape, data_type::FLOAT, bytes);
    }

    /// A constant list of 64-bit integers.
    pub(crate) fn int_constant(&mut self, name: &str, data: &[usize]) {
        let bytes = data.iter().flat_map(|&x| to_i64(x).to_le_bytes()).collect();
        self.constant(name, &[data.len()], data_type::INT64, bytes);
    }

    fn constant(&mut self, name: &str, shape: &[usize], data_type: i32, bytes: Vec<u8>) {
        self.graph.initializer.push(TensorProto {
            dims: shape.iter().map(|&n| to_i64(n)).collect(),
            data_type: Some(data_type),
            name: name.to_owned(),
            raw_data: Some(bytes.into()),
            ..Default::default()
        });
    }
}

fn to_i64(n: usize) -> i64 {
    i64::try_from(n).unwrap_or(i64::MAX)
}

fn attribute(name: &str, kind: i32) -> AttributeProto {
    AttributeProto { name: name.to_owned(), r#type: Some(kind), ..Default::default() }
}

/// An attribute.
pub(crate) fn int(name: &str, value: usize) -> AttributeProto {
    AttributeProto { i: Some(to_i64(value)), ..attribute(name, attribute_type::INT) }
}

/// An attribute.
pub(crate) fn ints(name: &str, values: &[usize]) -> AttributeProto {
    let ints = values.iter().map(|&n| to_i64(n)).collect();
    AttributeProto { ints, ..attribute(name, attribute_type::INTS) }
}

/// An attribute.
pub(crate) fn float(name: &str, value: f32) -> AttributeProto {
    AttributeProto { f: Some(value), ..attribute(name, attribute_type::FLOAT) }
}

/// An attribute.
pub(crate) fn text(name: &str, value: &str) -> AttributeProto {
    let s = Some(value.as_bytes().to_vec());
    AttributeProto { s, ..attribute(name, attribute_type::STRING) }
}
