//! Writes the network as ONNX.

use super::{
    STRIDE, Vnl,
    graph::{Fusion, Inverted, Transfer},
};
use crate::{
    depth::{Alignment, DepthMetadata},
    layer::Conv,
    onnx::{
        Dim, ElementType, ExportError, OnnxOptions, check_size, value_info,
        writer::{GraphWriter, int, ints, text},
    },
};

/// Logits at every pixel.
const LOGITS: &str = "logits";
/// Logits at every second pixel.
const LOGITS_HALF: &str = "logits_half";
/// Where the weights of the prediction are.
const PREDICT: &str = "decoder.predict";

impl Vnl {
    /// Writes the network as an ONNX file, complete in one piece.
    ///
    /// Input `image`: `[1, 3, height, width]`, float32, RGB, from 0 to 1 and then
    /// normalised by the mean and deviation of [`Vnl::coding`].
    /// Output `depth`: `[1, 1, height, width]`, metres for a camera with the focal
    /// length of [`Vnl::coding`] in pixels of the input: for another one multiply
    /// by the ratio of the focal lengths.
    ///
    /// Inside the graph are two tensors that
    /// [`crate::onnx::OnnxModel::keep_outputs`] makes the output instead, for
    /// [`crate::depth::SoftSum`] to be read by:
    ///
    /// * `logits`: `[1, bins, height, width]`, what `depth` is made of.
    /// * `logits_half`: `[1, bins, height/2, width/2]`, by a branch that nothing
    ///   else reads and that engines therefore drop. The released network enlarges
    ///   its last features from half to full size, corner on corner, and predicts
    ///   from them by taps 2 pixels apart; here the same weights predict at half
    ///   size by taps 1 pixel apart, which on the features is 255/127 instead of 2
    ///   pixels for an input of 256. On random weights, which make many edges, and
    ///   away from the outer 4 pixels, depth from these logits made larger differs
    ///   from the released depth by 0.02 % on average and 0.8 % at most; depth from
    ///   them made larger as depth, which is much cheaper, by 0.2 % and 21 %, at the
    ///   edges. (Every second pixel of the released depth itself, made larger, does
    ///   by 0.4 % and 93 %.) On the outer 2 pixels the released network sees zeros
    ///   beyond the border and jumps; there nothing smaller can follow.
    ///
    /// Nothing in the graph depends on the input size.
    ///
    /// # Errors
    /// [`ExportError`] if the size is no multiple of 8, or a weight does not fit
    /// 16 bits.
    pub fn to_onnx(&self, options: &OnnxOptions) -> Result<Vec<u8>, ExportError> {
        let OnnxOptions { width, height, half } = *options;
        check_size(width, height, STRIDE)?;
        let mut writer = GraphWriter::new("vnl", half);
        let features = self.write_features(&mut writer)?;
        self.write_prediction(&mut writer, &features)?;
        let float = |name: &str, dims: [usize; 4]| {
            value_info(name, ElementType::Float32, &dims.map(Dim::Fixed))
        };
        let graph = &mut writer.graph;
        graph.input = vec![float("image", [1, 3, height, width])];
        graph.output = vec![float("depth", [1, 1, height, width])];
        graph.value_info = vec![
            float(LOGITS, [1, self.bins(), height, width]),
            float(LOGITS_HALF, [1, self.bins(), height / 2, width / 2]),
        ];
        let metadata = DepthMetadata {
            coding: self.coding,
            logits: vec![LOGITS.to_owned(), LOGITS_HALF.to_owned()],
            alignment: Alignment::Corners,
            stride: STRIDE,
        };
        let mut entries = metadata.entries();
        entries.push(("imgsz", format!("{:?}", [height, width])));
        Ok(writer.finish(entries))
    }

    /// Encoder and decoder; returns the last features, at half size.
    fn write_features(&self, writer: &mut GraphWriter) -> Result<String, ExportError> {
        let graph = &self.graph;
        let mut x = writer.conv("encoder.res1", "image", &graph.stem)?;
        let mut stages = Vec::new();
        for (stage, blocks) in graph.stages.iter().enumerate() {
            for (block, inverted) in blocks.iter().enumerate() {
                x = writer.inverted(&format!("encoder.res{}.{block}", stage + 2), &x, inverted)?;
            }
            stages.push(x.clone());
        }
        let mean = writer.mean("encoder.pooled", &x);
        let pooled = writer.conv("encoder.pooled", &mean, &graph.pooled)?;
        let mut top = writer.conv("decoder.top", &pooled, &graph.top)?;
        // The pooled top is one value a channel: its mean is itself, and it fits
        // any size. The laterals are at H/8 but for the last, at H/4.
        let mut means = top.clone();
        let steps = graph.laterals.iter().zip(&graph.fusions).zip(stages.iter().rev());
        for (index, ((lateral, fusion), stage)) in steps.enumerate() {
            let side = writer.transfer(&format!("encoder.lateral{index}"), stage, lateral)?;
            let path = format!("decoder.fcn{}", index + 1);
            if index + 1 == graph.laterals.len() {
                top = writer.double(&path, &top);
            }
            if index > 0 {
                means = writer.mean(&format!("{path}.top"), &top);
            }
            top = writer.fusion(&path, &side, &top, &means, fusion)?;
        }
        let path = "decoder.fcn5";
        let doubled = writer.double(path, &top);
        writer.transfer(path, &doubled, &graph.last)
    }

    /// From the last features to `depth`: doubling, logits, and with the weights p of
    /// the bins after the softmax, depth = scale · 10^(Σ pᵢ·borderᵢ).
    ///
    /// It is written as exp(Σ eᵢ·ln(10)·borderᵢ / Σ eᵢ + ln(scale)) with
    /// eᵢ = exp(logitᵢ − the largest), both sums by one 1x1 convolution. The operator
    /// Softmax over the channels takes up to as long as all the rest.
    fn write_prediction(
        &self,
        writer: &mut GraphWriter,
        features: &str,
    ) -> Result<(), ExportError> {
        let predict = &self.graph.predict;
        let doubled = writer.double(PREDICT, features);
        writer.conv_to(PREDICT, &doubled, predict, LOGITS)?;
        let near = Conv { pad: 1, dilation: 1, weight: Vec::new(), bias: Vec::new(), ..*predict };
        writer.conv_again(PREDICT, features, &near, LOGITS_HALF);

        let bins = self.bins();
        let borders = self.coding.log_borders(bins);
        let borders = borders.into_iter().map(|border| border as f32);
        let rows: Vec<f32> = borders.chain(std::iter::repeat_n(1.0, bins)).collect();
        writer.float_constant("sums.weight", &[2, bins, 1, 1], &rows);
        writer.float_constant("log_scale", &[1], &[self.coding.scale.ln() as f32]);
        writer.int_constant("sums.split", &[1, 1]);
        let across = || vec![ints("axes", &[1]), int("keepdims", 1)];
        writer.node("ReduceMax", &[LOGITS], &["largest"], across());
        writer.node("Sub", &[LOGITS, "largest"], &["below"], vec![]);
        writer.node("Exp", &["below"], &["shares"], vec![]);
        let kernel = vec![ints("kernel_shape", &[1, 1])];
        writer.node("Conv", &["shares", "sums.weight"], &["sums"], kernel);
        let parts = ["weighted", "total"];
        writer.node("Split", &["sums", "sums.split"], &parts, vec![int("axis", 1)]);
        writer.node("Div", &parts, &["log_units"], vec![]);
        writer.node("Add", &["log_units", "log_scale"], &["log_depth"], vec![]);
        writer.node("Exp", &["log_depth"], &["depth"], vec![]);
        Ok(())
    }
}

impl GraphWriter {
    /// The mean of every channel over the picture.
    fn mean(&mut self, path: &str, input: &str) -> String {
        let output = format!("{path}.mean");
        self.node("GlobalAveragePool", &[input], &[&output], vec![]);
        output
    }

    /// Twice the width and height, corners on corners.
    fn double(&mut self, path: &str, input: &str) -> String {
        let (output, scales) = (format!("{path}.double"), "double.scales");
        self.shared_float_constant(scales, &[4], &[1.0, 1.0, 2.0, 2.0]);
        let attributes =
            vec![text("coordinate_transformation_mode", "align_corners"), text("mode", "linear")];
        self.node("Resize", &[input, "", scales], &[&output], attributes);
        output
    }

    fn inverted(
        &mut self,
        path: &str,
        input: &str,
        block: &Inverted,
    ) -> Result<String, ExportError> {
        let mut x = input.to_owned();
        if let Some(expand) = &block.expand {
            x = self.conv(&format!("{path}.expand"), &x, expand)?;
        }
        x = self.conv(&format!("{path}.depthwise"), &x, &block.depthwise)?;
        x = self.conv(&format!("{path}.project"), &x, &block.project)?;
        if block.add {
            let sum = format!("{path}.sum");
            self.node("Add", &[&x, input], &[&sum], vec![]);
            x = sum;
        }
        Ok(x)
    }

    fn transfer(
        &mut self,
        path: &str,
        input: &str,
        block: &Transfer,
    ) -> Result<String, ExportError> {
        let enter = self.conv(&format!("{path}.enter"), input, &block.enter)?;
        let middle = self.conv(&format!("{path}.middle"), &enter, &block.middle)?;
        let last = self.conv(&format!("{path}.last"), &middle, &block.last)?;
        let (sum, output) = (format!("{path}.sum"), format!("{path}.relu"));
        self.node("Add", &[&last, &enter], &[&sum], vec![]);
        self.node("Relu", &[&sum], &[&output], vec![]);
        Ok(output)
    }

    /// `means`: those of the top.
    fn fusion(
        &mut self,
        path: &str,
        lateral: &str,
        top: &str,
        means: &str,
        fusion: &Fusion,
    ) -> Result<String, ExportError> {
        let side = self.mean(&format!("{path}.side"), lateral);
        let joined = self.concat(path, &[&side, means], 1);
        let squeezed = self.conv(&format!("{path}.squeeze"), &joined, &fusion.gate.squeeze)?;
        let excited = self.conv(&format!("{path}.excite"), &squeezed, &fusion.gate.excite)?;
        let name = |what: &str| format!("{path}.{what}");
        let (gate, weighed, merged) = (name("gate"), name("weighed"), name("merged"));
        self.node("Sigmoid", &[&excited], &[&gate], vec![]);
        self.node("Mul", &[lateral, &gate], &[&weighed], vec![]);
        self.node("Add", &[&weighed, top], &[&merged], vec![]);
        self.transfer(path, &merged, &fusion.transfer)
    }
}
