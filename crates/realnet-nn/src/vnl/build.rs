//! Reads the tensors, checks them and folds them.

use super::{
    VnlError,
    graph::{Block, Bottleneck, Fusion, Gate, Graph, Inverted, Top, Transfer},
};
use crate::{
    layer::{Activation, Conv},
    reader::{Numbers, Reader, TensorError},
    weights::Checkpoint,
};

/// Prefixes that the authors' programs give their tensors.
const PREFIXES: [&str; 2] = ["", "depth_model."];
/// Epsilon of batch normalisation, PyTorch's default.
const BN_EPS: f64 = 1e-5;
/// Epsilon after the decoder's first convolution.
const TOP_BN_EPS: f64 = 0.5;
/// MobileNetV2: strides of the blocks and dilation of stages 2 to 5.
const MOBILE: [(&[usize], usize); 4] =
    [(&[1, 2, 1], 1), (&[2, 1, 1], 1), (&[1; 7], 2), (&[1; 4], 4)];
/// ResNeXt: stride of the first block and dilation of stages 2 to 5.
const RESNEXT: [(usize, usize); 4] = [(1, 1), (2, 1), (2, 1), (1, 2)];
/// Groups of its 3x3 convolutions.
const GROUPS: usize = 32;
/// The branches on its last stage: name, and distance of the taps of those of 3x3.
const BRANCHES: [(&str, Option<usize>); 4] =
    [("1x1", None), ("3_1", Some(2)), ("3_2", Some(4)), ("3_3", Some(6))];
/// Names of the encoder's own layers.
const BODY: &str = "encoder_modules.bottomup";
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
    let prefix = prefix(checkpoint).ok_or_else(|| VnlError::NotVnl {
        tensors: checkpoint.tensors.len(),
        first: checkpoint.first_name(),
    })?;
    let mut parts = Parts { reader: Reader::new(checkpoint, prefix) };
    let graph = parts.graph()?;
    parts.reader.check_surplus()?;
    Ok(graph)
}

/// The parts of the network, read one after the other.
struct Parts<'a> {
    reader: Reader<'a>,
}

/// An encoder's own layers.
struct Body {
    stem: Conv,
    pools: bool,
    /// With the pixels of the input a pixel of each.
    stages: Vec<(Vec<Block>, usize)>,
}

impl Parts<'_> {
    fn graph(&mut self) -> Result<Graph, TensorError> {
        let resnext = self.reader.has(&format!("{BODY}.res1.conv1.weight"));
        let Body { stem, pools, stages } = if resnext { self.resnext()? } else { self.mobile()? };
        let channels = |blocks: &[Block]| blocks.last().map_or(0, Block::out);
        let mut laterals = Vec::with_capacity(stages.len());
        for (index, (blocks, _)) in stages.iter().rev().enumerate() {
            let path = format!("encoder_modules.topdown_lateral_modules.{index}.lateral");
            laterals.push(self.transfer(&path, channels(blocks))?);
        }
        let (last, stride) =
            stages.last().map_or((0, 0), |(blocks, step)| (channels(blocks), *step));
        let top = if resnext { self.pyramid(last)? } else { self.pooled(last)? };
        let mut channels = top.mean.out();
        let mut step = stride;
        let mut fusions = Vec::with_capacity(laterals.len());
        for (index, (lateral, (_, side))) in laterals.iter().zip(stages.iter().rev()).enumerate() {
            let path = format!("decoder_modules.topdown_fcn{}", index + 1);
            let fusion = self.fusion(&path, channels, lateral, *side < step)?;
            step = *side;
            channels = fusion.transfer.last.out();
            fusions.push(fusion);
        }
        let last = self.transfer("decoder_modules.topdown_fcn5.ftb", channels)?;
        let path = "decoder_modules.topdown_predict.conv1";
        let predict = self.reader.conv(path, None, last.last.out(), DILATED)?;
        let predict = self.reader.biased(predict, path)?;
        let stages = stages.into_iter().map(|(blocks, _)| blocks).collect();
        Ok(Graph { stem, pools, stages, stride, top, laterals, fusions, last, predict })
    }

    /// MobileNetV2.
    fn mobile(&mut self) -> Result<Body, TensorError> {
        let numbers = Numbers::HALVE.then(Activation::Relu6);
        let [conv, norm] = [0, 1].map(|place| format!("{BODY}.res1.0.{place}"));
        let stem = self.normalised(&conv, &norm, None, 3, numbers)?;
        let mut channels = stem.out();
        let mut step = 2;
        let mut stages = Vec::with_capacity(MOBILE.len());
        for (index, (strides, dilation)) in MOBILE.into_iter().enumerate() {
            let mut blocks = Vec::with_capacity(strides.len());
            for (block, &stride) in strides.iter().enumerate() {
                let path = format!("{BODY}.res{}.{block}.conv", index + 2);
                // Only the very first block does not widen its input.
                let widens = index + block > 0;
                let inverted = self.inverted(&path, channels, widens, stride, dilation)?;
                channels = inverted.project.out();
                step *= stride;
                blocks.push(Block::Inverted(inverted));
            }
            stages.push((blocks, step));
        }
        Ok(Body { stem, pools: false, stages })
    }

    /// ResNeXt with as many blocks as there are.
    fn resnext(&mut self) -> Result<Body, TensorError> {
        let numbers = Numbers { kernel: 7, ..Numbers::HALVE.then(Activation::Relu) };
        let [conv, norm] = ["conv1", "bn1"].map(|part| format!("{BODY}.res1.{part}"));
        let stem = self.normalised(&conv, &norm, None, 3, numbers)?;
        let mut channels = stem.out();
        let mut step = 4;
        let mut stages = Vec::with_capacity(RESNEXT.len());
        for (index, (first, dilation)) in RESNEXT.into_iter().enumerate() {
            let path = |block: usize| format!("{BODY}.res{}.{block}", index + 2);
            let mut blocks = Vec::new();
            while blocks.is_empty()
                || self.reader.has(&format!("{}.conv1.weight", path(blocks.len())))
            {
                let stride = if blocks.is_empty() { first } else { 1 };
                let block = self.bottleneck(&path(blocks.len()), channels, stride, dilation)?;
                channels = block.last.out();
                blocks.push(Block::Bottleneck(block));
            }
            step *= first;
            stages.push((blocks, step));
        }
        Ok(Body { stem, pools: true, stages })
    }

    fn bottleneck(
        &mut self,
        path: &str,
        input: usize,
        stride: usize,
        dilation: usize,
    ) -> Result<Bottleneck, TensorError> {
        let part = |part: &str| format!("{path}.{part}");
        let relu = Numbers::POINT.then(Activation::Relu);
        let enter = self.normalised(&part("conv1"), &part("bn1"), None, input, relu)?;
        let inner = enter.out();
        if !inner.is_multiple_of(GROUPS) {
            let expected = format!("[a multiple of {GROUPS}, {input}, 1, 1]");
            return Err(self.reader.shape_error(&part("conv1.weight"), expected, &enter.shape));
        }
        let numbers = Numbers { kernel: 3, stride, dilation, activation: Activation::Relu };
        let (out, group) = (Some(inner), inner / GROUPS);
        let middle = self.normalised(&part("conv2"), &part("bn2"), out, group, numbers)?;
        let middle = Conv { groups: GROUPS, ..middle };
        let last = self.normalised(&part("conv3"), &part("bn3"), None, inner, Numbers::POINT)?;
        let out = Some(last.out());
        let numbers = Numbers { stride, ..Numbers::POINT };
        let changes = stride > 1 || out != Some(input);
        let [conv, norm] = ["conv", "bn"].map(|name| part(&format!("shortcut.{name}")));
        let around = changes.then(|| self.normalised(&conv, &norm, out, input, numbers));
        Ok(Bottleneck { enter, middle, last, around: around.transpose()? })
    }

    /// The last stage of MobileNetV2, of so many channels, as one value a channel.
    fn pooled(&mut self, channels: usize) -> Result<Top, TensorError> {
        let pooled = self.pool(None, channels)?;
        let mean = self.top(pooled.out())?;
        Ok(Top { branches: Vec::new(), joined: None, pooled, mean })
    }

    /// The last stage of ResNeXt through the branches. The means join them as a map of equal
    /// values, which is one value a channel added to the others' sum.
    fn pyramid(&mut self, channels: usize) -> Result<Top, TensorError> {
        let mut branches: Vec<Conv> = Vec::with_capacity(BRANCHES.len());
        for (name, dilation) in BRANCHES {
            let path = |part: &str| format!("encoder_modules.bottomup_top.aspp_{part}{name}");
            let numbers = dilation.map_or(Numbers::POINT, |d| Numbers::THREE.dilated(d));
            let out = branches.first().map(Conv::out);
            let branch = self.normalised(&path("conv"), &path("bn"), out, channels, numbers)?;
            branches.push(branch);
        }
        let each = branches.first().map_or(0, Conv::out);
        let pooled = self.pool(Some(each), channels)?;
        let side = branches.len() * each;
        let top = self.top(side + each)?;
        // Rows of weights: those of the branches, then those of the means.
        let rows = || top.weight.chunks_exact(side + each);
        let part = |weight: Vec<f32>, input, bias| Conv {
            weight,
            shape: [top.out(), input, 1, 1],
            bias,
            ..top
        };
        let joined = rows().flat_map(|row| row.iter().take(side).copied()).collect();
        let mean = rows().flat_map(|row| row.iter().skip(side).copied()).collect();
        let joined = part(joined, side, top.bias.clone());
        let mean = part(mean, each, vec![0.0; top.out()]);
        Ok(Top { branches, joined: Some(joined), pooled, mean })
    }

    fn pool(&mut self, out: Option<usize>, input: usize) -> Result<Conv, TensorError> {
        let path = |part: &str| format!("encoder_modules.bottomup_top.globalpool_{part}");
        self.normalised(&path("conv1x1"), &path("bn"), out, input, Numbers::POINT)
    }

    fn top(&mut self, input: usize) -> Result<Conv, TensorError> {
        let [conv, norm] = [0, 1].map(|place| format!("decoder_modules.top.{place}"));
        let top = self.reader.conv(&conv, None, input, Numbers::POINT)?;
        self.reader.normalised(top, &norm, TOP_BN_EPS)
    }

    /// The convolution at `conv` with the normalisation at `norm`.
    fn normalised(
        &mut self,
        conv: &str,
        norm: &str,
        out: Option<usize>,
        input: usize,
        numbers: Numbers,
    ) -> Result<Conv, TensorError> {
        let conv = self.reader.conv(conv, out, input, numbers)?;
        self.reader.normalised(conv, norm, BN_EPS)
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
        let place = |place: usize| format!("{path}.{place}");
        let mut at = 0;
        let mut expand = None;
        let mut hidden = input;
        if widens {
            let numbers = Numbers::POINT.then(Activation::Relu6);
            let conv = self.normalised(&place(0), &place(1), None, input, numbers)?;
            hidden = conv.out();
            expand = Some(conv);
            at = 3;
        }
        let numbers = Numbers { kernel: 3, stride, dilation, activation: Activation::Relu6 };
        let depthwise = self.normalised(&place(at), &place(at + 1), Some(hidden), 1, numbers)?;
        let depthwise = Conv { groups: hidden, ..depthwise };
        let (conv, norm) = (place(at + 3), place(at + 4));
        let project = self.normalised(&conv, &norm, None, hidden, Numbers::POINT)?;
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

    /// `channels` of the top, the lateral must have as many; `doubles`: it is twice as large.
    fn fusion(
        &mut self,
        path: &str,
        channels: usize,
        lateral: &Transfer,
        doubles: bool,
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
        Ok(Fusion { gate: Gate { squeeze, excite }, transfer, doubles })
    }
}
