//! Reads the tensors, checks them and folds them.

use super::{
    VnlError,
    graph::{Fusion, Gate, Graph, Inverted, Transfer},
};
use crate::{
    fold::{BatchNorm, fold},
    layer::{Activation, Conv},
    weights::{Checkpoint, Tensor},
};
use std::collections::BTreeSet;

/// Prefixes that the authors' programs give their tensors.
const PREFIXES: [&str; 2] = ["", "depth_model."];
/// Epsilon of batch normalisation, PyTorch's default.
const BN_EPS: f64 = 1e-5;
/// Epsilon after the decoder's first convolution.
const TOP_BN_EPS: f64 = 0.5;
/// Strides of the blocks and dilation of stages 2 to 5.
const STAGES: [(&[usize], usize); 4] =
    [(&[1, 2, 1], 1), (&[2, 1, 1], 1), (&[1; 7], 2), (&[1; 4], 4)];
/// Dilation in the residual blocks and the prediction.
const DILATION: usize = 2;
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
        first: tensors
            .keys()
            .next()
            .map_or_else(|| "there are none".to_owned(), |n| format!("'{n}'")),
    })?;
    let resnext =
        |name: &&String| name.contains(".aspp_") || name.contains(".bottomup.res1.conv1.");
    if let Some(name) = tensors.keys().find(resnext) {
        return Err(VnlError::Encoder { name: name.clone() });
    }
    let mut reader = Reader { checkpoint, prefix, used: BTreeSet::new() };
    let graph = reader.graph()?;
    reader.check_surplus()?;
    Ok(graph)
}

/// The numbers of a convolution that its weights do not tell.
#[derive(Clone, Copy)]
struct Numbers {
    kernel: usize,
    stride: usize,
    dilation: usize,
    activation: Activation,
}

impl Numbers {
    const POINT: Self =
        Self { kernel: 1, stride: 1, dilation: 1, activation: Activation::Identity };
    const DILATED: Self = Self { kernel: 3, dilation: DILATION, ..Self::POINT };

    const fn then(self, activation: Activation) -> Self {
        Self { activation, ..self }
    }
}

struct Reader<'a> {
    checkpoint: &'a Checkpoint,
    prefix: &'static str,
    used: BTreeSet<String>,
}

impl<'a> Reader<'a> {
    fn graph(&mut self) -> Result<Graph, VnlError> {
        let encoder = "encoder_modules.bottomup";
        let numbers = Numbers { stride: 2, ..Numbers::DILATED };
        let numbers = Numbers { dilation: 1, ..numbers }.then(Activation::Relu6);
        let stem = self.conv(&format!("{encoder}.res1.0.0"), None, 3, numbers)?;
        let stem = self.normalised(stem, &format!("{encoder}.res1.0.1"), BN_EPS)?;
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
        let pooled = self.conv(&format!("{path}_conv1x1"), None, channels, Numbers::POINT)?;
        let pooled = self.normalised(pooled, &format!("{path}_bn"), BN_EPS)?;

        let path = "decoder_modules.top";
        let top = self.conv(&format!("{path}.0"), None, pooled.out(), Numbers::POINT)?;
        let top = self.normalised(top, &format!("{path}.1"), TOP_BN_EPS)?;
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
        let mut predict = self.conv(path, None, last.last.out(), Numbers::DILATED)?;
        predict.bias = self.list(&format!("{path}.bias"), predict.out())?.to_vec();
        Ok(Graph { stem, stages, pooled, top, laterals, fusions, last, predict })
    }

    fn inverted(
        &mut self,
        path: &str,
        input: usize,
        widens: bool,
        stride: usize,
        dilation: usize,
    ) -> Result<Inverted, VnlError> {
        // Places in the authors' sequence, activations counted.
        let mut place = 0;
        let mut expand = None;
        let mut hidden = input;
        if widens {
            let numbers = Numbers::POINT.then(Activation::Relu6);
            let conv = self.conv(&format!("{path}.0"), None, input, numbers)?;
            let conv = self.normalised(conv, &format!("{path}.1"), BN_EPS)?;
            hidden = conv.out();
            expand = Some(conv);
            place = 3;
        }
        let numbers = Numbers { kernel: 3, stride, dilation, activation: Activation::Relu6 };
        let mut depthwise = self.conv(&format!("{path}.{place}"), Some(hidden), 1, numbers)?;
        depthwise.groups = hidden;
        let depthwise = self.normalised(depthwise, &format!("{path}.{}", place + 1), BN_EPS)?;
        let project = self.conv(&format!("{path}.{}", place + 3), None, hidden, Numbers::POINT)?;
        let project = self.normalised(project, &format!("{path}.{}", place + 4), BN_EPS)?;
        let add = stride == 1 && project.out() == input;
        Ok(Inverted { expand, depthwise, project, add })
    }

    fn transfer(&mut self, path: &str, input: usize) -> Result<Transfer, VnlError> {
        let enter = self.conv(&format!("{path}.conv1"), None, input, Numbers::POINT)?;
        let out = enter.out();
        let name = format!("{path}.conv2");
        let numbers = Numbers::DILATED.then(Activation::Relu);
        let mut middle = self.conv(&name, Some(out), out, numbers)?;
        middle.bias = self.list(&format!("{name}.bias"), out)?.to_vec();
        let middle = self.normalised(middle, &format!("{path}.bn1"), BN_EPS)?;
        let last = self.conv(&format!("{path}.conv3"), Some(out), out, Numbers::DILATED)?;
        Ok(Transfer { enter, middle, last })
    }

    /// `channels` of the top; the lateral must have as many.
    fn fusion(
        &mut self,
        path: &str,
        channels: usize,
        lateral: &Transfer,
    ) -> Result<Fusion, VnlError> {
        let gate = format!("{path}.afa_block");
        let joined = channels + lateral.last.out();
        let numbers = Numbers::POINT.then(Activation::Relu);
        let squeezed = Some(channels / SQUEEZE);
        let squeeze = self.conv(&format!("{gate}.conv1"), squeezed, joined, numbers)?;
        let out = Some(lateral.last.out());
        let excite = self.conv(&format!("{gate}.conv2"), out, squeeze.out(), Numbers::POINT)?;
        if excite.out() != channels {
            return Err(VnlError::Shape {
                name: format!("{}{gate}.conv2.weight", self.prefix),
                expected: format!("[{channels}, {}, 1, 1]", squeeze.out()),
                found: excite.shape.to_vec(),
            });
        }
        let transfer = self.transfer(&format!("{path}.ftb_block"), channels)?;
        Ok(Fusion { gate: Gate { squeeze, excite }, transfer })
    }

    /// The weights at `path`, of `out` channels where that is known, from
    /// `input` channels a group. Without bias, padded to keep the size.
    fn conv(
        &mut self,
        path: &str,
        out: Option<usize>,
        input: usize,
        numbers: Numbers,
    ) -> Result<Conv, VnlError> {
        let Numbers { kernel, stride, dilation, activation } = numbers;
        let name = format!("{path}.weight");
        let tensor = self.tensor(&name)?;
        let channels = match tensor.shape() {
            &[o, i, h, w] if (i, h, w) == (input, kernel, kernel) && o > 0 => Some(o),
            _ => None,
        };
        let Some(channels) = channels.filter(|&o| out.is_none_or(|out| out == o)) else {
            let out = out.map_or_else(|| "out".to_owned(), |out| out.to_string());
            let expected = format!("[{out}, {input}, {kernel}, {kernel}]");
            return Err(self.shape_error(&name, expected, tensor));
        };
        Ok(Conv {
            shape: [channels, input, kernel, kernel],
            weight: tensor.data().to_vec(),
            bias: vec![0.0; channels],
            stride,
            pad: dilation * (kernel / 2),
            dilation,
            groups: 1,
            activation,
        })
    }

    /// `conv` with the normalisation at `path` folded in.
    fn normalised(&mut self, conv: Conv, path: &str, eps: f64) -> Result<Conv, VnlError> {
        let channels = conv.out();
        let mut part = |part: &str| self.list(&format!("{path}.{part}"), channels);
        let (weight, bias) = (part("weight")?, part("bias")?);
        let (mean, var) = (part("running_mean")?, part("running_var")?);
        if var.iter().any(|&v| v < 0.0) {
            let name = format!("{}{path}.running_var", self.prefix);
            return Err(VnlError::Value { name, what: "a negative variance" });
        }
        let bn = BatchNorm { weight, bias, mean, var, eps };
        let (weight, bias) = fold(&conv.weight, Some(&conv.bias), &bn);
        if !weight.iter().chain(&bias).all(|x| x.is_finite()) {
            let name = format!("{}{path}.weight", self.prefix);
            return Err(VnlError::Value { name, what: "NaN or infinity after folding" });
        }
        Ok(Conv { weight, bias, ..conv })
    }

    /// A tensor of one axis.
    fn list(&mut self, name: &str, length: usize) -> Result<&'a [f32], VnlError> {
        let tensor = self.tensor(name)?;
        if tensor.shape() != [length] {
            return Err(self.shape_error(name, format!("[{length}]"), tensor));
        }
        Ok(tensor.data())
    }

    fn tensor(&mut self, name: &str) -> Result<&'a Tensor, VnlError> {
        let name = format!("{}{name}", self.prefix);
        let Some(tensor) = self.checkpoint.tensors.get(&name) else {
            return Err(VnlError::MissingTensor { name });
        };
        if !tensor.data().iter().all(|x| x.is_finite()) {
            return Err(VnlError::Value { name, what: "NaN or infinity" });
        }
        self.used.insert(name);
        Ok(tensor)
    }

    fn shape_error(&self, name: &str, expected: String, tensor: &Tensor) -> VnlError {
        let name = format!("{}{name}", self.prefix);
        VnlError::Shape { name, expected, found: tensor.shape().to_vec() }
    }

    fn check_surplus(&self) -> Result<(), VnlError> {
        let mut surplus = self.checkpoint.tensors.keys().filter(|n| !self.used.contains(*n));
        match surplus.next() {
            None => Ok(()),
            Some(first) => {
                Err(VnlError::SurplusTensors { name: first.clone(), count: surplus.count() + 1 })
            }
        }
    }
}
