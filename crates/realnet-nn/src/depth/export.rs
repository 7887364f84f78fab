//! What every depth network's file has: depth made of its logits, and the metadata.

use super::{DepthCoding, DepthMetadata};
use crate::onnx::{
    Dim, ElementType, OnnxOptions, value_info,
    writer::{GraphWriter, int, ints},
};

/// Name of the input of a depth network's file.
pub(crate) const INPUT: &str = "image";
/// Name of its output, metres.
pub(crate) const OUTPUT: &str = "depth";

impl GraphWriter {
    /// Depth of the `logits` of so many bins: with the weights p of the bins after the softmax,
    /// scale · 10^(Σ pᵢ·borderᵢ).
    ///
    /// It is written as exp(Σ eᵢ·ln(10)·borderᵢ / Σ eᵢ + ln(scale)) with
    /// eᵢ = exp(logitᵢ − the largest), both sums by one 1x1 convolution. The operator
    /// Softmax over the channels takes up to as long as all the rest.
    pub(crate) fn depth(&mut self, logits: &str, bins: usize, coding: &DepthCoding, output: &str) {
        let borders = coding.log_borders(bins);
        let borders = borders.into_iter().map(|border| border as f32);
        let rows: Vec<f32> = borders.chain(std::iter::repeat_n(1.0, bins)).collect();
        self.float_constant("sums.weight", &[2, bins, 1, 1], &rows);
        self.float_constant("log_scale", &[1], &[coding.scale.ln() as f32]);
        self.int_constant("sums.split", &[1, 1]);
        let across = || vec![ints("axes", &[1]), int("keepdims", 1)];
        self.node("ReduceMax", &[logits], &["largest"], across());
        self.node("Sub", &[logits, "largest"], &["below"], vec![]);
        self.node("Exp", &["below"], &["shares"], vec![]);
        let kernel = vec![ints("kernel_shape", &[1, 1])];
        self.node("Conv", &["shares", "sums.weight"], &["sums"], kernel);
        let parts = ["weighted", "total"];
        self.node("Split", &["sums", "sums.split"], &parts, vec![int("axis", 1)]);
        self.node("Div", &parts, &["log_units"], vec![]);
        self.node("Add", &["log_units", "log_scale"], &["log_depth"], vec![]);
        self.node("Exp", &["log_depth"], &[output], vec![]);
    }

    /// The finished file: `image` in, `depth` out, both of the size in `options`; inside it the
    /// logits that `metadata` name, of `bins` bins, the n-th smaller than the input by the n-th
    /// of `steps`.
    pub(crate) fn finish_depth(
        mut self,
        options: &OnnxOptions,
        metadata: &DepthMetadata,
        bins: usize,
        steps: &[usize],
    ) -> Vec<u8> {
        let OnnxOptions { width, height, .. } = *options;
        let float = |name: &str, dims: [usize; 4]| {
            value_info(name, ElementType::Float32, &dims.map(Dim::Fixed))
        };
        self.graph.input = vec![float(INPUT, [1, 3, height, width])];
        self.graph.output = vec![float(OUTPUT, [1, 1, height, width])];
        let logits = metadata.logits.iter().zip(steps);
        let logits = logits.map(|(name, step)| float(name, [1, bins, height / step, width / step]));
        self.graph.value_info = logits.collect();
        let mut entries = metadata.entries();
        entries.push(("imgsz", format!("{:?}", [height, width])));
        self.finish(entries)
    }
}
