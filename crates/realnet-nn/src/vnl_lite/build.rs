//! Reads the tensors, checks them and folds them.

use super::{
    VnlLiteError,
    graph::{Graph, Residual, Step},
};
use crate::{
    layer::{Activation, Conv},
    reader::{Numbers, Reader, TensorError},
    weights::Checkpoint,
};

/// A tensor that every such network has, and few others.
const FIRST: &str = "stages.0.0.c1.conv.weight";
/// Epsilon of batch normalisation, PyTorch's default, where the file does not tell.
const BN_EPS: f64 = 1e-5;
/// Stages of the encoder.
const STAGES: usize = 4;

pub(super) fn recognises(checkpoint: &Checkpoint) -> bool {
    ["stem.conv.weight", FIRST].iter().all(|name| checkpoint.tensors.contains_key(*name))
}

pub(super) fn build(checkpoint: &Checkpoint) -> Result<Graph, VnlLiteError> {
    if !recognises(checkpoint) {
        let first = checkpoint.first_name();
        return Err(VnlLiteError::NotVnlLite { tensors: checkpoint.tensors.len(), first });
    }
    let eps = checkpoint.bn_eps.unwrap_or(BN_EPS);
    let mut parts = Parts { reader: Reader::new(checkpoint, ""), eps };
    let graph = parts.graph()?;
    parts.reader.check_surplus()?;
    Ok(graph)
}

/// The parts of the network, read one after the other.
struct Parts<'a> {
    reader: Reader<'a>,
    eps: f64,
}

impl Parts<'_> {
    fn graph(&mut self) -> Result<Graph, TensorError> {
        let point = Numbers::POINT.then(Activation::Relu);
        let three = Numbers::THREE.then(Activation::Relu);
        let stem = self.block("stem", None, 3, Numbers::HALVE.then(Activation::Relu))?;
        let mut channels = stem.out();
        let mut stages = Vec::with_capacity(STAGES);
        let mut widths = Vec::with_capacity(STAGES);
        for stage in 0..STAGES {
            let mut blocks = Vec::new();
            while blocks.is_empty() || self.reader.has(&first_of(stage, blocks.len())) {
                let path = format!("stages.{stage}.{}", blocks.len());
                let block = self.residual(&path, channels, blocks.is_empty())?;
                channels = block.c2.out();
                blocks.push(block);
            }
            widths.push(channels);
            stages.push(blocks);
        }
        let quarter = widths.first().copied().unwrap_or_default();
        // The last stage is what the decoder starts from.
        widths.pop();
        let mut steps = Vec::with_capacity(widths.len());
        while let Some(width) = widths.pop() {
            // To the channels of the stage before; at the first one they are its own choice.
            let out = (!widths.is_empty()).then_some(width);
            let index = steps.len();
            let reduce = self.block(&format!("reduce.{index}"), out, channels, point)?;
            channels = reduce.out();
            let merge = self.block(&format!("merge.{index}"), Some(channels), channels, three)?;
            steps.push(Step { reduce, merge });
        }
        let skip = self.block("skip", Some(channels), quarter, point)?;
        let head = self.reader.conv("head", None, channels, Numbers::THREE)?;
        let head = self.reader.biased(head, "head")?;
        Ok(Graph { stem, stages, steps, skip, head })
    }

    fn residual(
        &mut self,
        path: &str,
        input: usize,
        halves: bool,
    ) -> Result<Residual, TensorError> {
        let first = if halves { Numbers::HALVE } else { Numbers::THREE };
        let first = first.then(Activation::Relu);
        let c1 = self.block(&format!("{path}.c1"), None, input, first)?;
        let out = c1.out();
        let c2 = self.block(&format!("{path}.c2"), Some(out), out, Numbers::THREE)?;
        let changes = halves || input != out;
        let around = || self.block(&format!("{path}.around"), Some(out), input, Numbers::POINT);
        let around = changes.then(around).transpose()?;
        Ok(Residual { c1, c2, around, halves })
    }

    /// A convolution without bias and its normalisation.
    fn block(
        &mut self,
        path: &str,
        out: Option<usize>,
        input: usize,
        numbers: Numbers,
    ) -> Result<Conv, TensorError> {
        let conv = self.reader.conv(&format!("{path}.conv"), out, input, numbers)?;
        self.reader.normalised(conv, &format!("{path}.bn"), self.eps)
    }
}

/// The tensor that tells that a block is there.
fn first_of(stage: usize, block: usize) -> String {
    format!("stages.{stage}.{block}.c1.conv.weight")
}
