//! Reads the tensors, checks them and folds them.

use super::{
    VnlError,
    graph::{Fusion, Gate, Graph, Inverted, Transfer},
};
use crate::{
    layer::Activation,
    reader::{Numbers, Reader, TensorError},
    weights::Checkpoint,
};

/// Prefixes that the authors' programs give their tensors.
const PREFIXES: [&str; 2] = ["", "depth_model."];
/// Epsilon of batch normalisation, PyTorch's default.
const BN_EPS: f64 = 1e-5;
/// Epsilon after the decoder's first convolution.
const TOP_BN_EPS: f64 = 0.5;
/// Strides of the blocks and dilation of stages 2 to 5.
const STAGES: [(&[usize], usize); 4] =
    [(&[1, 2, 1], 1), (&[2, 1, 1], 1), (&[1; 7], 2), (&[1; 4], 4)];
/// The convolutions in the residual blocks and the prediction.
const DILATED: Numbers = Numbers::THREE.dilated(2);
/// By how much the gates squeeze.
const SQUEEZE: usize = 8;

/// What stands before `encoder_modules` in the names; `None` when nothing is
/// named like that.
pub(super) fn prefix(checkpoint: &Checkpoint) -> Option<&'static str> {
    let starts = |prefix: &str| {
        let start = format!("{prefix}encoder_modules.");
        checkpoint.tensors.range(start.clone()..).next().is_some_and(|(k, _)| k.starts_with(&start))
    };
    PREFIXES.into_iter().find(|prefix| starts(prefix))
}

pub(super) fn build(checkpoint: &Checkpoint) -> Result<Graph, VnlError> {
    let tensors = &checkpoint.tensors;
    let prefix = prefix(checkpoint).ok_or_else(|| VnlError::NotVnl {
        tensors: tensors.len(),
        first: checkpoint.first_name(),
    })?;
    let resnext =
        |name: &&String| name.contains(".aspp_") || name.contains(".bottomup.res1.conv1.");
    if let Some(name) = tensors.keys().find(resnext) {
        return Err(VnlError::Encoder { name: name.clone() });
    }
    let mut parts = Parts { reader: Reader::new(checkpoint, prefix) };
    let graph = parts.graph()?;
    parts.reader.check_surplus()?;
    Ok(graph)
}

/// The parts of the network, read one after the other.
struct Parts<'a> {
    reader: Reader<'a>,
}

impl Parts<'_> {
    fn graph(&mut self) -> Result<Graph, TensorError> {
        let encoder = "encoder_modules.bottomup";
        let numbers = Numbers::HALVE.then(Activation::Relu6);
        let stem = self.reader.conv(&format!("{encoder}.res1.0.0"), None, 3, numbers)?;
        let stem = self.reader.normalised(stem, &format!("{encoder}.res1.0.1"), BN_EPS)?;
        let mut channels = stem.out();
        let mut stages = Vec::new();
        let mut laterals = Vec::new();
        for (index, (strides, dilation)) in STAGES.into_iter().enumerate() {
            let mut blocks = Vec::new();
            for (block, &stride) in strides.iter().enumerate() {
                let path = format!("{encoder}.res{}.{block}.conv", index + 2);
                // Only the very first block does not widen its input.
                let widens = index + block > 0;
                let inverted = self.inverted(&path, channels, widens, stride, dilation)?;
                channels = inverted.project.out();
                blocks.push(inverted);
            }
            stages.push(blocks);
            let path = format!(
                "encoder_modules.topdown_lateral_modules.{}.lateral",
                STAGES.len() - 1 - index
            );
            laterals.insert(0, self.transfer(&path, channels)?);
        }
        let path = "encoder_modules.bottomup_top.globalpool";
        let pooled =
            self.reader.conv(&format!("{path}_conv1x1"), None, channels, Numbers::POINT)?;
        let pooled = self.reader.normalised(pooled, &format!("{path}_bn"), BN_EPS)?;

        let path = "decoder_modules.top";
        let top = self.reader.conv(&format!("{path}.0"), None, pooled.out(), Numbers::POINT)?;
        let top = self.reader.normalised(top, &format!("{path}.1"), TOP_BN_EPS)?;
        let mut channels = top.out();
        let mut fusions = Vec::new();
        for (index, lateral) in laterals.iter().enumerate() {
            let path = format!("decoder_modules.topdown_fcn{}", index + 1);
            let fusion = self.fusion(&path, channels, lateral)?;
            channels = fusion.transfer.last.out();
            fusions.push(fusion);
        }
        let last = self.transfer("decoder_modules.topdown_fcn5.ftb", channels)?;
        let path = "decoder_modules.topdown_predict.conv1";
        let predict = self.reader.conv(path, None, last.last.out(), DILATED)?;
        let predict = self.reader.biased(predict, path)?;
        Ok(Graph { stem, stages, pooled, top, laterals, fusions, last, predict })
    }

    fn inverted(
        &mut self,
        path: &str,
        input: usize,
        widens: bool,
        stride: usize,
        dilation: usize,
    ) -> Result<Inverted, TensorError> {
        // Places in the authors' sequence, activations counted.
        let mut place = 0;
        let mut expand = None;
        let mut hidden = input;
        if widens {
            let numbers = Numbers::POINT.then(Activation::Relu6);
            let conv = self.reader.conv(&format!("{path}.0"), None, input, numbers)?;
            let conv = self.reader.normalised(conv, &format!("{path}.1"), BN_EPS)?;
            hidden = conv.out();
            expand = Some(conv);
            place = 3;
        }
        let numbers = Numbers { kernel: 3, stride, dilation, activation: Activation::Relu6 };
        let mut depthwise =
            self.reader.conv(&format!("{path}.{place}"), Some(hidden), 1, numbers)?;
        depthwise.groups = hidden;
        let depthwise =
            self.reader.normalised(depthwise, &format!("{path}.{}", place + 1), BN_EPS)?;
        let project =
            self.reader.conv(&format!("{path}.{}", place + 3), None, hidden, Numbers::POINT)?;
        let project = self.reader.normalised(project, &format!("{path}.{}", place + 4), BN_EPS)?;
        let add = stride == 1 && project.out() == input;
        Ok(Inverted { expand, depthwise, project, add })
    }

    fn transfer(&mut self, path: &str, input: usize) -> Result<Transfer, TensorError> {
        let enter = self.reader.conv(&format!("{path}.conv1"), None, input, Numbers::POINT)?;
        let out = enter.out();
        let name = format!("{path}.conv2");
        let numbers = DILATED.then(Activation::Relu);
        let middle = self.reader.conv(&name, Some(out), out, numbers)?;
        let middle = self.reader.biased(middle, &name)?;
        let middle = self.reader.normalised(middle, &format!("{path}.bn1"), BN_EPS)?;
        let last = self.reader.conv(&format!("{path}.conv3"), Some(out), out, DILATED)?;
        Ok(Transfer { enter, middle, last })
    }

    /// `channels` of the top; the lateral must have as many.
    fn fusion(
        &mut self,
        path: &str,
        channels: usize,
        lateral: &Transfer,
    ) -> Result<Fusion, TensorError> {
        let gate = format!("{path}.afa_block");
        let joined = channels + lateral.last.out();
        let numbers = Numbers::POINT.then(Activation::Relu);
        let squeezed = Some(channels / SQUEEZE);
        let squeeze = self.reader.conv(&format!("{gate}.conv1"), squeezed, joined, numbers)?;
        let out = Some(lateral.last.out());
        let excite =
            self.reader.conv(&format!("{gate}.conv2"), out, squeeze.out(), Numbers::POINT)?;
        if excite.out() != channels {
            let expected = format!("[{channels}, {}, 1, 1]", squeeze.out());
            let name = format!("{gate}.conv2.weight");
            return Err(self.reader.shape_error(&name, expected, &excite.shape));
        }
        let transfer = self.transfer(&format!("{path}.ftb_block"), channels)?;
        Ok(Fusion { gate: Gate { squeeze, excite }, transfer })
    }
}
