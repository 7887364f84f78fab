//! Writes the network as ONNX.

use super::{STRIDE, VnlLite, graph::Residual};
use crate::{
    depth::{Alignment, DepthMetadata, export},
    onnx::{
        ExportError, OnnxOptions, check_size,
        writer::{GraphWriter, ints},
    },
};

/// Logits at every fourth pixel.
const LOGITS: &str = "logits";
/// Pixels of the input a sample of the logits.
const STEP: usize = 4;

impl VnlLite {
    /// Writes the network as an ONNX file, complete in one piece.
    ///
    /// Input `image`: `[1, 3, height, width]`, float32, RGB, from 0 to 1 and then
    /// normalised by the mean and deviation of [`VnlLite::coding`].
    /// Output `depth`: `[1, 1, height, width]`, metres for a camera with the focal
    /// length of [`VnlLite::coding`] in pixels of the input: for another one multiply
    /// by the ratio of the focal lengths.
    ///
    /// Inside the graph is the tensor `logits`, `[1, bins, height/4, width/4]`, that
    /// [`crate::onnx::OnnxModel::keep_outputs`] makes the output instead, for
    /// [`crate::depth::SoftSum`] to be read by. Of it `depth` is made: depth at every fourth
    /// pixel, and between them linearly.
    ///
    /// Nothing in the graph depends on the input size.
    ///
    /// # Errors
    /// [`ExportError`] if the size is no multiple of 32, or a weight does not fit
    /// 16 bits.
    pub fn to_onnx(&self, options: &OnnxOptions) -> Result<Vec<u8>, ExportError> {
        check_size(options.width, options.height, STRIDE)?;
        let mut writer = GraphWriter::new("vnl-lite", options.half);
        let features = self.write_features(&mut writer)?;
        writer.conv_to("head", &features, &self.graph.head, LOGITS)?;
        let small = "depth_small";
        writer.depth(LOGITS, self.bins(), &self.coding, small);
        writer.resize(small, STEP, Alignment::Centres, export::OUTPUT);
        let metadata = DepthMetadata {
            coding: self.coding,
            logits: vec![LOGITS.to_owned()],
            alignment: Alignment::Centres,
            stride: STRIDE,
        };
        Ok(writer.finish_depth(options, &metadata, self.bins(), &[STEP]))
    }

    /// Encoder and decoder; returns the last features, at a quarter of the size.
    fn write_features(&self, writer: &mut GraphWriter) -> Result<String, ExportError> {
        let graph = &self.graph;
        let mut x = writer.conv("stem", export::INPUT, &graph.stem)?;
        let mut levels = Vec::with_capacity(graph.stages.len());
        for (stage, blocks) in graph.stages.iter().enumerate() {
            for (index, block) in blocks.iter().enumerate() {
                x = writer.residual(&format!("stages.{stage}.{index}"), &x, block)?;
            }
            levels.push(x.clone());
        }
        // The last one is `x` itself.
        levels.pop();
        for (index, step) in graph.steps.iter().enumerate() {
            let Some(mut level) = levels.pop() else { break };
            if levels.is_empty() {
                level = writer.conv("skip", &level, &graph.skip)?;
            }
            let reduced = writer.conv(&format!("reduce.{index}"), &x, &step.reduce)?;
            let path = format!("merge.{index}");
            let (large, sum) = (format!("{path}.large"), format!("{path}.sum"));
            writer.resize(&reduced, 2, Alignment::Centres, &large);
            writer.node("Add", &[&large, &level], &[&sum], vec![]);
            x = writer.conv(&path, &sum, &step.merge)?;
        }
        Ok(x)
    }
}

impl GraphWriter {
    fn residual(
        &mut self,
        path: &str,
        input: &str,
        block: &Residual,
    ) -> Result<String, ExportError> {
        let inner = self.conv(&format!("{path}.c1"), input, &block.c1)?;
        let inner = self.conv(&format!("{path}.c2"), &inner, &block.c2)?;
        let mut around = input.to_owned();
        if block.halves {
            let averaged = format!("{path}.averaged");
            let attributes = vec![ints("kernel_shape", &[2, 2]), ints("strides", &[2, 2])];
            self.node("AveragePool", &[&around], &[&averaged], attributes);
            around = averaged;
        }
        if let Some(conv) = &block.around {
            around = self.conv(&format!("{path}.around"), &around, conv)?;
        }
        Ok(self.add_relu(path, &inner, &around))
    }
}
