//! Writes a network as ONNX.

use super::YoloV5;
use super::graph::{Bottleneck, Csp, Op, Spp};
use crate::class_names::write_names;
use crate::onnx::proto::ValueInfoProto;
use crate::onnx::writer::{GraphWriter, int, ints, text};
use crate::onnx::{Dim, ElementType, ExportError, OnnxOptions, check_size, value_info};

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
        let mut writer = GraphWriter::new("yolov5", options.half);
        let heads = self.write_layers(&mut writer)?;
        self.write_decoding(&mut writer, options, &heads);
        let graph = &mut writer.graph;
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
        Ok(writer.finish(self.metadata(size, &heads)))
    }

    fn metadata(&self, size: [usize; 2], heads: &[String]) -> Vec<(&'static str, String)> {
        vec![
            ("names", write_names(&self.names)),
            ("stride", self.max_stride().to_string()),
            ("imgsz", format!("{size:?}")),
            ("anchors", format!("{:?}", self.anchors)),
            ("realnet_heads", heads.join(",")),
            ("realnet_strides", format!("{:?}", self.strides)),
        ]
    }

    /// Writes all layers; returns the names of the heads.
    fn write_layers(&self, writer: &mut GraphWriter) -> Result<Vec<String>, ExportError> {
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
    fn write_decoding(&self, writer: &mut GraphWriter, options: &OnnxOptions, heads: &[String]) {
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

impl GraphWriter {
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
            let before = levels.last().cloned().unwrap_or_default();
            self.max_pool(&before, kernel, 1, &output);
            levels.push(output);
        }
        let levels: Vec<&str> = levels.iter().map(String::as_str).collect();
        let joined = self.concat(path, &levels, 1);
        self.conv(&format!("{path}.cv2"), &joined, &spp.cv2)
    }

    fn upsample(&mut self, path: &str, input: &str) -> String {
        let (output, scales) = (format!("{path}.up"), "upsample.scales");
        self.shared_float_constant(scales, &[4], &[1.0, 1.0, 2.0, 2.0]);
        let attributes = vec![
            text("coordinate_transformation_mode", "asymmetric"),
            text("mode", "nearest"),
            text("nearest_mode", "floor"),
        ];
        self.node("Resize", &[input, "", scales], &[&output], attributes);
        output
    }
}
