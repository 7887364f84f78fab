//! Writes a network as ONNX.

use half::f16;
use thiserror::Error;

use super::YoloV5;
use super::graph::{Activation, Bottleneck, Conv, Csp, Op, Spp};
use crate::class_names::write_names;
use crate::onnx::proto::{
    AttributeProto, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, StringStringEntryProto,
    TensorProto, ValueInfoProto, attribute_type, data_type,
};
use crate::onnx::{Dim, ElementType, value_info};
use prost::Message;

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

impl YoloV5 {
    /// Writes the network as an ONNX file, complete in one piece.
    ///
    /// Input `images`: `[1, 3, height, width]`, float32, RGB, 0 to 1.
    /// Output `output0`: `[1, rows, 5 + classes]`, per row the centre, width and
    /// height of a box in pixels, the objectness and the class scores, all
    /// after the sigmoid; rows run over heads, anchors, cell rows, cell columns.
    ///
    /// The tensors `head0`, `head1`, … (`[1, anchors·(5 + classes), height/stride,
    /// width/stride]`) are the heads' convolutions before reshaping and sigmoid.
    /// They are ordinary tensors inside the graph:
    /// [`crate::onnx::OnnxModel::keep_outputs`] makes them the outputs and drops
    /// the decoding after them. Nothing before them depends on the input size.
    ///
    /// # Errors
    /// [`ExportError`] if the size is no multiple of the largest stride, or a
    /// weight does not fit 16 bits.
    pub fn to_onnx(&self, options: &OnnxOptions) -> Result<Vec<u8>, ExportError> {
        check_size(options.width, options.height, self.max_stride())?;
        let mut writer = Writer { graph: GraphProto::default(), half: options.half };
        let heads = self.write_layers(&mut writer)?;
        self.write_decoding(&mut writer, options, &heads);
        let mut graph = writer.graph;
        graph.name = "yolov5".to_owned();
        let size = [options.height, options.width];
        let fixed = |dims: &[usize]| -> Vec<Dim> { dims.iter().map(|&n| Dim::Fixed(n)).collect() };
        let float = |name: &str, dims: &[usize]| -> ValueInfoProto {
            value_info(name, ElementType::Float32, &fixed(dims))
        };
        graph.input = vec![float("images", &[1, 3, options.height, options.width])];
        let rows = self.rows(options.width, options.height);
        graph.output = vec![float("output0", &[1, rows, 5 + self.names.len()])];
        for ((name, &stride), anchors) in heads.iter().zip(&self.strides).zip(&self.anchors) {
            let channels = anchors.len() * (5 + self.names.len());
            let dims = [1, channels, options.height / stride, options.width / stride];
            graph.value_info.push(float(name, &dims));
        }
        let model = ModelProto {
            ir_version: Some(IR_VERSION),
            producer_name: "realnet".to_owned(),
            producer_version: env!("CARGO_PKG_VERSION").to_owned(),
            graph: Some(graph),
            opset_import: vec![OperatorSetIdProto { domain: String::new(), version: Some(OPSET) }],
            metadata_props: self.metadata(size, &heads),
            ..Default::default()
        };
        Ok(model.encode_to_vec())
    }

    fn metadata(&self, size: [usize; 2], heads: &[String]) -> Vec<StringStringEntryProto> {
        let entries = [
            ("names", write_names(&self.names)),
            ("stride", self.max_stride().to_string()),
            ("imgsz", format!("{size:?}")),
            ("anchors", format!("{:?}", self.anchors)),
            ("realnet_heads", heads.join(",")),
            ("realnet_strides", format!("{:?}", self.strides)),
        ];
        let entry =
            |(key, value): (&str, String)| StringStringEntryProto { key: key.to_owned(), value };
        entries.into_iter().map(entry).collect()
    }

    /// Writes all layers; returns the names of the heads.
    fn write_layers(&self, writer: &mut Writer) -> Result<Vec<String>, ExportError> {
        let mut outputs: Vec<String> = Vec::new();
        let mut heads = Vec::new();
        for (index, layer) in self.layers.iter().enumerate() {
            let path = format!("model.{index}");
            let image = "images";
            let inputs: Vec<&str> = layer
                .inputs
                .iter()
                .map(|i| i.and_then(|i| outputs.get(i)).map_or(image, String::as_str))
                .collect();
            let first = inputs.first().copied().unwrap_or(image);
            let output = match &layer.op {
                Op::Conv(conv) => writer.conv(&path, first, conv)?,
                Op::Bottlenecks(blocks) => writer.bottlenecks(&path, first, blocks)?,
                Op::Csp(csp) => writer.csp(&path, first, csp)?,
                Op::Spp(spp) => writer.spp(&path, first, spp)?,
                Op::Upsample => writer.upsample(&path, first),
                Op::Concat => writer.concat(&path, &inputs, 1),
                Op::Detect(convs) => {
                    for (level, (conv, input)) in convs.iter().zip(&inputs).enumerate() {
                        let name = format!("head{level}");
                        writer.conv_to(&format!("{path}.m.{level}"), input, conv, &name)?;
                        heads.push(name);
                    }
                    break;
                }
            };
            outputs.push(output);
        }
        Ok(heads)
    }

    /// Writes the decoding of boxes after the heads, as YOLOv5 defines it:
    /// with y = sigmoid(head), centre = (2y − 0.5 + cell)·stride,
    /// size = (2y)²·anchor.
    fn write_decoding(&self, writer: &mut Writer, options: &OnnxOptions, heads: &[String]) {
        let columns = 5 + self.names.len();
        writer.int_constant("decode.split", &[2, 2, columns - 4]);
        let mut all = Vec::new();
        let levels = heads.iter().zip(&self.strides).zip(&self.anchors);
        for (level, ((head, &stride), anchors)) in levels.enumerate() {
            let path = format!("decode.{level}");
            let name = |what: &str| format!("{path}.{what}");
            let (count, rows, cols) =
                (anchors.len(), options.height / stride, options.width / stride);
            writer.int_constant(&name("cells"), &[1, count, columns, rows, cols]);
            writer.int_constant(&name("rows"), &[1, count * rows * cols, columns]);
            let pixels = stride as f32;
            let mut offsets = Vec::with_capacity(rows * cols * 2);
            for y in 0..rows {
                for x in 0..cols {
                    offsets.extend([(x as f32 - 0.5) * pixels, (y as f32 - 0.5) * pixels]);
                }
            }
            writer.float_constant(&name("offset"), &[1, 1, rows, cols, 2], &offsets);
            let scales: Vec<f32> = anchors.iter().flatten().map(|a| 4.0 * a).collect();
            writer.float_constant(&name("scale"), &[1, count, 1, 1, 2], &scales);
            writer.float_constant(&name("pitch"), &[1], &[2.0 * pixels]);

            writer.node("Reshape", &[head, &name("cells")], &[&name("split5")], vec![]);
            let order = ints("perm", &[0, 1, 3, 4, 2]);
            writer.node("Transpose", &[&name("split5")], &[&name("last")], vec![order]);
            writer.node("Sigmoid", &[&name("last")], &[&name("y")], vec![]);
            let parts = [name("xy"), name("wh"), name("scores")];
            let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
            writer.node("Split", &[&name("y"), "decode.split"], &parts, vec![int("axis", 4)]);
            writer.node("Mul", &[&name("xy"), &name("pitch")], &[&name("xy_scaled")], vec![]);
            writer.node("Add", &[&name("xy_scaled"), &name("offset")], &[&name("centre")], vec![]);
            writer.node("Mul", &[&name("wh"), &name("wh")], &[&name("wh_squared")], vec![]);
            writer.node("Mul", &[&name("wh_squared"), &name("scale")], &[&name("size")], vec![]);
            let joined =
                writer.concat(&path, &[&name("centre"), &name("size"), &name("scores")], 4);
            writer.node("Reshape", &[&joined, &name("rows")], &[&name("boxes")], vec![]);
            all.push(name("boxes"));
        }
        let all: Vec<&str> = all.iter().map(String::as_str).collect();
        writer.node("Concat", &all, &["output0"], vec![int("axis", 1)]);
    }
}

struct Writer {
    graph: GraphProto,
    half: bool,
}

impl Writer {
    // Layers: each returns the name of its output.

    fn conv(&mut self, path: &str, input: &str, conv: &Conv) -> Result<String, ExportError> {
        let output = format!("{path}.out");
        self.conv_to(path, input, conv, &output)?;
        Ok(output)
    }

    fn conv_to(
        &mut self,
        path: &str,
        input: &str,
        conv: &Conv,
        output: &str,
    ) -> Result<(), ExportError> {
        let weight = self.weight(&format!("{path}.weight"), &conv.shape, &conv.weight)?;
        let bias = self.weight(&format!("{path}.bias"), &[conv.out()], &conv.bias)?;
        let kernel = conv.shape[2];
        let attributes = vec![
            ints("dilations", &[1, 1]),
            int("group", conv.groups),
            ints("kernel_shape", &[kernel, kernel]),
            ints("pads", &[conv.pad; 4]),
            ints("strides", &[conv.stride; 2]),
        ];
        let linear = format!("{path}.linear");
        let after = if conv.activation == Activation::Identity { output } else { &linear };
        self.node("Conv", &[input, &weight, &bias], &[after], attributes);
        self.activation(path, &linear, conv.activation, output);
        Ok(())
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
            Activation::Relu => self.node("Relu", &[input], &[output], vec![]),
            Activation::LeakyRelu(slope) => {
                self.node("LeakyRelu", &[input], &[output], vec![float("alpha", slope)]);
            }
        }
    }

    fn bottlenecks(
        &mut self,
        path: &str,
        input: &str,
        blocks: &[Bottleneck],
    ) -> Result<String, ExportError> {
        let mut x = input.to_owned();
        for (index, block) in blocks.iter().enumerate() {
            let path = format!("{path}.m.{index}");
            let inner = self.conv(&format!("{path}.cv1"), &x, &block.cv1)?;
            let mut y = self.conv(&format!("{path}.cv2"), &inner, &block.cv2)?;
            if block.add {
                let sum = format!("{path}.sum");
                self.node("Add", &[&x, &y], &[&sum], vec![]);
                y = sum;
            }
            x = y;
        }
        Ok(x)
    }

    fn csp(&mut self, path: &str, input: &str, csp: &Csp) -> Result<String, ExportError> {
        let first = self.conv(&format!("{path}.cv1"), input, &csp.cv1)?;
        let mut deep = self.bottlenecks(path, &first, &csp.blocks)?;
        if let Some(tail) = &csp.tail {
            deep = self.conv(&format!("{path}.tail"), &deep, tail)?;
        }
        let shallow = self.conv(&format!("{path}.cv2"), input, &csp.cv2)?;
        let joined = self.concat(path, &[&deep, &shallow], 1);
        self.conv(&format!("{path}.last"), &joined, &csp.out)
    }

    fn spp(&mut self, path: &str, input: &str, spp: &Spp) -> Result<String, ExportError> {
        let mut levels = vec![self.conv(&format!("{path}.cv1"), input, &spp.cv1)?];
        for (index, &kernel) in spp.pools.iter().enumerate() {
            let output = format!("{path}.pool{index}");
            let attributes = vec![
                ints("kernel_shape", &[kernel, kernel]),
                ints("pads", &[kernel / 2; 4]),
                ints("strides", &[1, 1]),
            ];
            let before = levels.last().cloned().unwrap_or_default();
            self.node("MaxPool", &[&before], &[&output], attributes);
            levels.push(output);
        }
        let levels: Vec<&str> = levels.iter().map(String::as_str).collect();
        let joined = self.concat(path, &levels, 1);
        self.conv(&format!("{path}.cv2"), &joined, &spp.cv2)
    }

    fn upsample(&mut self, path: &str, input: &str) -> String {
        let (output, scales) = (format!("{path}.up"), "upsample.scales");
        if !self.graph.initializer.iter().any(|t| t.name == scales) {
            self.float_constant(scales, &[4], &[1.0, 1.0, 2.0, 2.0]);
        }
        let attributes = vec![
            text("coordinate_transformation_mode", "asymmetric"),
            text("mode", "nearest"),
            text("nearest_mode", "floor"),
        ];
        self.node("Resize", &[input, "", scales], &[&output], attributes);
        output
    }

    fn concat(&mut self, path: &str, inputs: &[&str], axis: usize) -> String {
        let output = format!("{path}.cat");
        self.node("Concat", inputs, &[&output], vec![int("axis", axis)]);
        output
    }

    // Nodes and constants.

    fn node(
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

    /// A weight in the precision asked for; returns the name to read it by.
    fn weight(&mut self, name: &str, shape: &[usize], data: &[f32]) -> Result<String, ExportError> {
        if !self.half {
            self.float_constant(name, shape, data);
            return Ok(name.to_owned());
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
        Ok(name.to_owned())
    }

    fn float_constant(&mut self, name: &str, shape: &[usize], data: &[f32]) {
        let bytes = data.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.constant(name, shape, data_type::FLOAT, bytes);
    }

    fn int_constant(&mut self, name: &str, data: &[usize]) {
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

fn int(name: &str, value: usize) -> AttributeProto {
    AttributeProto { i: Some(to_i64(value)), ..attribute(name, attribute_type::INT) }
}

fn ints(name: &str, values: &[usize]) -> AttributeProto {
    let ints = values.iter().map(|&n| to_i64(n)).collect();
    AttributeProto { ints, ..attribute(name, attribute_type::INTS) }
}

fn float(name: &str, value: f32) -> AttributeProto {
    AttributeProto { f: Some(value), ..attribute(name, attribute_type::FLOAT) }
}

fn text(name: &str, value: &str) -> AttributeProto {
    let s = Some(value.as_bytes().to_vec());
    AttributeProto { s, ..attribute(name, attribute_type::STRING) }
}
