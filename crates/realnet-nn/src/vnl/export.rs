//! Writes the network as ONNX.

use super::{
    Vnl,
    graph::{Block, Bottleneck, Fusion, Inverted, Top, Transfer},
};
use crate::{
    depth::{Alignment, DepthMetadata, export},
    layer::Conv,
    onnx::{ExportError, OnnxOptions, check_size, writer::GraphWriter},
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
    /// [`ExportError`] if the size is no multiple of [`Vnl::max_stride`], or a weight does
    /// not fit 16 bits.
    pub fn to_onnx(&self, options: &OnnxOptions) -> Result<Vec<u8>, ExportError> {
        check_size(options.width, options.height, self.max_stride())?;
        let mut writer = GraphWriter::new("vnl", options.half);
        let features = self.write_features(&mut writer)?;
        self.write_prediction(&mut writer, &features)?;
        let metadata = DepthMetadata {
            coding: self.coding,
            logits: vec![LOGITS.to_owned(), LOGITS_HALF.to_owned()],
            alignment: Alignment::Corners,
            stride: self.max_stride(),
        };
        Ok(writer.finish_depth(options, &metadata, self.bins(), &[1, 2]))
    }

    /// Encoder and decoder; returns the last features, at half size.
    fn write_features(&self, writer: &mut GraphWriter) -> Result<String, ExportError> {
        let graph = &self.graph;
        let mut x = writer.conv("encoder.res1", export::INPUT, &graph.stem)?;
        if graph.pools {
            writer.max_pool(&x, 3, 2, "encoder.res1.largest");
            x = "encoder.res1.largest".to_owned();
        }
        let mut stages = Vec::new();
        for (stage, blocks) in graph.stages.iter().enumerate() {
            for (index, block) in blocks.iter().enumerate() {
                let path = format!("encoder.res{}.{index}", stage + 2);
                x = match block {
                    Block::Inverted(block) => writer.inverted(&path, &x, block)?,
                    Block::Bottleneck(block) => writer.bottleneck(&path, &x, block)?,
                };
            }
            stages.push(x.clone());
        }
        // One value a channel is its own mean, and fits any size.
        let mut top = writer.top(&x, &graph.top)?;
        let mut means = top.clone();
        let steps = graph.laterals.iter().zip(&graph.fusions).zip(stages.iter().rev());
        for (index, ((lateral, fusion), stage)) in steps.enumerate() {
            let side = writer.transfer(&format!("encoder.lateral{index}"), stage, lateral)?;
            let path = format!("decoder.fcn{}", index + 1);
            if fusion.doubles {
                top = writer.double(&path, &top);
            }
            if index > 0 || graph.top.joined.is_some() {
                means = writer.mean(&format!("{path}.top"), &top);
            }
            top = writer.fusion(&path, &side, &top, &means, fusion)?;
        }
        let path = "decoder.fcn5";
        let doubled = writer.double(path, &top);
        writer.transfer(path, &doubled, &graph.last)
    }

    /// From the last features to logits and `depth`.
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
        writer.depth(LOGITS, self.bins(), &self.coding, export::OUTPUT);
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
        let output = format!("{path}.double");
        self.resize(input, 2, Alignment::Corners, &output);
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

    fn bottleneck(
        &mut self,
        path: &str,
        input: &str,
        block: &Bottleneck,
    ) -> Result<String, ExportError> {
        let x = self.conv(&format!("{path}.enter"), input, &block.enter)?;
        let x = self.conv(&format!("{path}.middle"), &x, &block.middle)?;
        let x = self.conv(&format!("{path}.last"), &x, &block.last)?;
        let around = match &block.around {
            Some(around) => self.conv(&format!("{path}.around"), input, around)?,
            None => input.to_owned(),
        };
        Ok(self.add_relu(path, &x, &around))
    }

    /// What the decoder starts from: a map, or one value a channel where there are no branches.
    fn top(&mut self, input: &str, top: &Top) -> Result<String, ExportError> {
        let means = self.mean("encoder.pooled", input);
        let pooled = self.conv("encoder.pooled", &means, &top.pooled)?;
        let mean = self.conv("decoder.top", &pooled, &top.mean)?;
        let Some(joined) = &top.joined else { return Ok(mean) };
        let mut branches = Vec::with_capacity(top.branches.len());
        for (index, branch) in top.branches.iter().enumerate() {
            branches.push(self.conv(&format!("encoder.branch{index}"), input, branch)?);
        }
        let branches: Vec<&str> = branches.iter().map(String::as_str).collect();
        let path = "decoder.top.joined";
        let side_by_side = self.concat(path, &branches, 1);
        let map = self.conv(path, &side_by_side, joined)?;
        let sum = format!("{path}.sum");
        self.node("Add", &[&map, &mean], &[&sum], vec![]);
        Ok(sum)
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
        Ok(self.add_relu(path, &last, &enter))
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
