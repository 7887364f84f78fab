//! Reads the tensors of every planned layer, checks them and folds them.

use std::collections::BTreeSet;

use super::graph::{Bottleneck, Csp, Layer, Op, Spp};
use super::plan::{Kind, Step, plan};
use super::{ImportError, YoloV5, coco};
use crate::fold::{BatchNorm, focus_kernel, fold};
use crate::layer::{Activation, Conv};
use crate::weights::{Checkpoint, ModuleInfo, Tensor};

/// Epsilon of batch normalisation in YOLOv5.
const BN_EPS: f64 = 1e-3;
/// Most bottlenecks in a row; YOLOv5x has 12.
const MAX_BLOCKS: usize = 256;
/// Slope of LeakyReLU in YOLOv5.
const LEAKY_SLOPE: f32 = 0.1;

/// Channels of a layer's output, and pixels of the image per cell.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Extent {
    channels: usize,
    stride: usize,
}

pub(super) fn build(checkpoint: &Checkpoint) -> Result<YoloV5, ImportError> {
    let steps = plan(checkpoint)?;
    let mut reader = Reader { checkpoint, used: BTreeSet::new() };
    let mut extents: Vec<Extent> = Vec::with_capacity(steps.len());
    let mut layers = Vec::with_capacity(steps.len());
    let mut detect = None;
    for (index, step) in steps.iter().enumerate() {
        if detect.is_some() {
            let reason = "a layer follows Detect, which has to be the last".to_owned();
            return Err(ImportError::Wiring { index, reason });
        }
        let image = Extent { channels: 3, stride: 1 };
        let inputs: Vec<Extent> = step
            .inputs
            .iter()
            .map(|input| input.map_or(Some(image), |i| extents.get(i).copied()))
            .collect::<Option<_>>()
            .ok_or_else(|| ImportError::Wiring {
                index,
                reason: "reads a layer that does not come before it".to_owned(),
            })?;
        let op = if step.kind == Kind::Detect {
            let head = reader.detect(index, &inputs)?;
            let op = Op::Detect(head.convs.clone());
            detect = Some(head);
            op
        } else {
            let (op, extent) = reader.layer(index, step, &inputs)?;
            extents.push(extent);
            op
        };
        layers.push(Layer { inputs: step.inputs.clone(), op });
    }
    let Some(head) = detect else {
        let reason = "there is no Detect layer".to_owned();
        return Err(ImportError::Wiring { index: steps.len(), reason });
    };
    reader.check_surplus()?;
    let names = class_names(checkpoint, head.classes)?;
    Ok(YoloV5 { layers, names, strides: head.strides, anchors: head.anchors })
}

fn class_names(checkpoint: &Checkpoint, classes: usize) -> Result<Vec<String>, ImportError> {
    match &checkpoint.class_names {
        Some(names) if names.len() == classes => Ok(names.clone()),
        Some(names) => Err(ImportError::Names { names: names.len(), classes }),
        None if classes == coco::NAMES.len() => {
            Ok(coco::NAMES.iter().map(|n| (*n).to_owned()).collect())
        }
        None => Ok((0..classes).map(|i| format!("class{i}")).collect()),
    }
}

/// What the Detect layer tells.
struct Head {
    convs: Vec<Conv>,
    strides: Vec<usize>,
    anchors: Vec<Vec<[f32; 2]>>,
    classes: usize,
}

struct Reader<'a> {
    checkpoint: &'a Checkpoint,
    used: BTreeSet<String>,
}

impl<'a> Reader<'a> {
    // Layers.

    fn layer(
        &mut self,
        index: usize,
        step: &Step,
        inputs: &[Extent],
    ) -> Result<(Op, Extent), ImportError> {
        let path = format!("model.{index}");
        let error = |reason: String| ImportError::Wiring { index, reason };
        if step.kind == Kind::Concat {
            let first = inputs.first().ok_or_else(|| error("reads nothing".to_owned()))?;
            if let Some(other) = inputs.iter().find(|i| i.stride != first.stride) {
                return Err(error(format!(
                    "joins layers of strides {} and {}",
                    first.stride, other.stride
                )));
            }
            let channels = inputs.iter().map(|i| i.channels).sum();
            return Ok((Op::Concat, Extent { channels, stride: first.stride }));
        }
        let &[input] = inputs else {
            return Err(error(format!("reads {} layers instead of one", inputs.len())));
        };
        let (op, out, stride) = match &step.kind {
            Kind::Conv { stride } => {
                let conv = self.conv(&path, input.channels, *stride)?;
                let (out, stride) = (conv.out(), conv.stride);
                (Op::Conv(conv), out, input.stride * stride)
            }
            Kind::Focus => {
                let conv = self.focus(&path, input.channels)?;
                let out = conv.out();
                (Op::Conv(conv), out, input.stride * 2)
            }
            Kind::Upsample => {
                if !input.stride.is_multiple_of(2) {
                    return Err(error(format!("upsamples a layer of stride {}", input.stride)));
                }
                (Op::Upsample, input.channels, input.stride / 2)
            }
            Kind::C3 { shortcut } => {
                let csp = self.c3(&path, input.channels, *shortcut)?;
                let out = csp.out.out();
                (Op::Csp(Box::new(csp)), out, input.stride)
            }
            Kind::BottleneckCsp { shortcut } => {
                let csp = self.bottleneck_csp(&path, input.channels, *shortcut)?;
                let out = csp.out.out();
                (Op::Csp(Box::new(csp)), out, input.stride)
            }
            Kind::Bottleneck { shortcut } => {
                let block = self.bottleneck(&path, input.channels, *shortcut)?;
                let out = block.cv2.out();
                (Op::Bottlenecks(vec![block]), out, input.stride)
            }
            Kind::Sequence { shortcut } => {
                let (blocks, out) = self.bottlenecks(&path, input.channels, *shortcut)?;
                (Op::Bottlenecks(blocks), out, input.stride)
            }
            Kind::Spp { kernels } => {
                let spp = self.spp(&path, input.channels, kernels)?;
                let out = spp.cv2.out();
                (Op::Spp(spp), out, input.stride)
            }
            Kind::Concat | Kind::Detect => return Err(error("is out of place".to_owned())),
        };
        if stride > 1024 {
            return Err(error(format!(
                "has a stride of {stride} pixels; at most 1024 is supported"
            )));
        }
        Ok((op, Extent { channels: out, stride }))
    }

    fn c3(&mut self, path: &str, input: usize, shortcut: bool) -> Result<Csp, ImportError> {
        let cv1 = self.conv(&format!("{path}.cv1"), input, 1)?;
        let cv2 = self.conv(&format!("{path}.cv2"), input, 1)?;
        let (blocks, inner) = self.bottlenecks(&format!("{path}.m"), cv1.out(), shortcut)?;
        let out = self.conv(&format!("{path}.cv3"), inner + cv2.out(), 1)?;
        Ok(Csp { cv1, blocks, tail: None, cv2, out })
    }

    /// The normalisation over the joined halves is split and folded into the
    /// plain convolutions before it.
    fn bottleneck_csp(
        &mut self,
        path: &str,
        input: usize,
        shortcut: bool,
    ) -> Result<Csp, ImportError> {
        let cv1 = self.conv(&format!("{path}.cv1"), input, 1)?;
        let (blocks, inner) = self.bottlenecks(&format!("{path}.m"), cv1.out(), shortcut)?;
        let activation =
            self.activation(&format!("{path}.act"), Activation::LeakyRelu(LEAKY_SLOPE))?;
        let mut tail = self.plain_conv(&format!("{path}.cv3"), inner, activation)?;
        let mut cv2 = self.plain_conv(&format!("{path}.cv2"), input, activation)?;
        let joined = tail.out() + cv2.out();
        let bn = self.batch_norm(&format!("{path}.bn"), joined)?;
        let split = tail.out();
        for (conv, range) in [(&mut tail, 0..split), (&mut cv2, split..joined)] {
            let part = |all: &'a [f32]| all.get(range.clone()).unwrap_or_default();
            let half = BatchNorm {
                weight: part(bn.weight),
                bias: part(bn.bias),
                mean: part(bn.mean),
                var: part(bn.var),
                eps: bn.eps,
            };
            (conv.weight, conv.bias) = fold(&conv.weight, Some(&conv.bias), &half);
        }
        let out = self.conv(&format!("{path}.cv4"), joined, 1)?;
        Ok(Csp { cv1, blocks, tail: Some(tail), cv2, out })
    }

    fn bottlenecks(
        &mut self,
        path: &str,
        input: usize,
        shortcut: bool,
    ) -> Result<(Vec<Bottleneck>, usize), ImportError> {
        let mut blocks = Vec::new();
        let mut channels = input;
        while self.has(&format!("{path}.{}.cv1.conv.weight", blocks.len())) {
            if blocks.len() >= MAX_BLOCKS {
                return Err(ImportError::Module {
                    module: path.to_owned(),
                    reason: format!("more than {MAX_BLOCKS} blocks"),
                });
            }
            let block = self.bottleneck(&format!("{path}.{}", blocks.len()), channels, shortcut)?;
            channels = block.cv2.out();
            blocks.push(block);
        }
        Ok((blocks, channels))
    }

    fn bottleneck(
        &mut self,
        path: &str,
        input: usize,
        shortcut: bool,
    ) -> Result<Bottleneck, ImportError> {
        let cv1 = self.conv(&format!("{path}.cv1"), input, 1)?;
        let cv2 = self.conv(&format!("{path}.cv2"), cv1.out(), 1)?;
        let told = self.number(path, "add");
        let add = told.map_or(shortcut && cv2.out() == input, |add| add != 0.0);
        if add && cv2.out() != input {
            return Err(ImportError::Module {
                module: path.to_owned(),
                reason: format!("adds {input} channels to {}", cv2.out()),
            });
        }
        Ok(Bottleneck { cv1, cv2, add })
    }

    /// Poolings of odd kernels a < b < … on one input equal a chain with
    /// kernels a, b − a + 1, …: a maximum over windows of windows.
    fn spp(&mut self, path: &str, input: usize, kernels: &[usize]) -> Result<Spp, ImportError> {
        let cv1 = self.conv(&format!("{path}.cv1"), input, 1)?;
        let joined = cv1.out() * (kernels.len() + 1);
        let cv2 = self.conv(&format!("{path}.cv2"), joined, 1)?;
        let mut before = 1;
        let pools = kernels
            .iter()
            .map(|&kernel| {
                let step = kernel + 1 - before;
                before = kernel;
                step
            })
            .collect();
        Ok(Spp { cv1, pools, cv2 })
    }

    fn detect(&mut self, index: usize, inputs: &[Extent]) -> Result<Head, ImportError> {
        let path = format!("model.{index}");
        let name = format!("{path}.anchors");
        let cells = self.tensor(&name, "anchors of the Detect layer")?;
        let &[levels, per_cell, 2] = cells.shape() else {
            return Err(shape_error(&name, format!("[{}, anchors, 2]", inputs.len()), cells));
        };
        if levels != inputs.len() || per_cell == 0 || levels == 0 {
            return Err(shape_error(&name, format!("[{}, anchors, 2]", inputs.len()), cells));
        }
        finite(&name, cells)?;
        // Old files hold the anchors in pixels too.
        self.used.insert(format!("{path}.anchor_grid"));
        let strides: Vec<usize> = inputs.iter().map(|i| i.stride).collect();
        self.check_strides(index, &strides)?;
        let mut convs = Vec::new();
        let mut outputs = None;
        for (level, input) in inputs.iter().enumerate() {
            let head = format!("{path}.m.{level}");
            let conv = self.biased_conv(&head, input.channels)?;
            let expected = *outputs.get_or_insert(conv.out());
            let fits = conv.out() == expected
                && expected.is_multiple_of(per_cell)
                && expected / per_cell > 5;
            if !fits || conv.shape[2] != 1 {
                let expected = format!(
                    "[{per_cell}·(5 + classes), {}, 1, 1] with the same classes in all heads",
                    input.channels
                );
                return Err(ImportError::Shape {
                    name: format!("{head}.weight"),
                    expected,
                    found: conv.shape.to_vec(),
                });
            }
            convs.push(conv);
        }
        let classes = outputs.unwrap_or(0) / per_cell - 5;
        let pixels = cells.data().chunks_exact(2 * per_cell).zip(&strides);
        let anchors = pixels
            .map(|(level, &stride)| {
                let pairs = level.chunks_exact(2);
                pairs
                    .map(|wh| [0, 1].map(|i| wh.get(i).map_or(0.0, |v| v * stride as f32)))
                    .collect()
            })
            .collect();
        Ok(Head { convs, strides, anchors, classes })
    }

    fn check_strides(&self, index: usize, strides: &[usize]) -> Result<(), ImportError> {
        let Some(told) = &self.checkpoint.strides else { return Ok(()) };
        let same =
            told.len() == strides.len() && told.iter().zip(strides).all(|(a, &b)| *a == b as f64);
        if same {
            return Ok(());
        }
        let reason = format!("the file tells strides {told:?}, its layers have {strides:?}");
        Err(ImportError::Wiring { index, reason })
    }

    // Convolutions.

    /// `path.conv` with `path.bn`, or already fused with `path.conv.bias`.
    fn conv(&mut self, path: &str, input: usize, stride: usize) -> Result<Conv, ImportError> {
        let activation = self.activation(&format!("{path}.act"), Activation::Silu)?;
        let inner = format!("{path}.conv");
        let name = format!("{inner}.weight");
        let weight = self.tensor(&name, "weights of a convolution")?;
        let &[out, per_group, k, k2] = weight.shape() else {
            return Err(shape_error(&name, format!("[out, {input}, k, k]"), weight));
        };
        let numbers = self.conv_numbers(&inner, k, stride)?;
        let fits =
            k == k2 && out > 0 && k > 0 && per_group.checked_mul(numbers.groups) == Some(input);
        if !fits || !out.is_multiple_of(numbers.groups) {
            let per_group = input / numbers.groups;
            return Err(shape_error(&name, format!("[out, {per_group}, k, k]"), weight));
        }
        let bias_name = format!("{inner}.bias");
        let bias = self.optional(&bias_name, &[out])?;
        let bn = format!("{path}.bn");
        let (weight, bias) = match bias {
            Some(bias) if !self.has(&format!("{bn}.weight")) => {
                (weight.data().to_vec(), bias.data().to_vec())
            }
            bias => {
                let bn = self.batch_norm(&bn, out)?;
                fold(weight.data(), bias.map(Tensor::data), &bn)
            }
        };
        if !weight.iter().chain(&bias).all(|x| x.is_finite()) {
            return Err(ImportError::Value { name, what: "NaN or infinity after folding" });
        }
        Ok(Conv {
            shape: [out, per_group, k, k],
            weight,
            bias,
            stride: numbers.stride,
            pad: numbers.pad,
            dilation: 1,
            groups: numbers.groups,
            activation,
        })
    }

    fn focus(&mut self, path: &str, input: usize) -> Result<Conv, ImportError> {
        let conv = self.conv(&format!("{path}.conv"), 4 * input, 1)?;
        let [out, _, k, _] = conv.shape;
        if conv.groups != 1 || conv.stride != 1 {
            return Err(ImportError::Module {
                module: path.to_owned(),
                reason: "Focus with groups or strides is not supported".to_owned(),
            });
        }
        let weight = focus_kernel(&conv.weight, out, input, k);
        let shape = [out, input, 2 * k, 2 * k];
        Ok(Conv { shape, weight, stride: 2, pad: 2 * conv.pad, ..conv })
    }

    /// A 1x1 convolution without bias whose normalisation comes later.
    fn plain_conv(
        &mut self,
        path: &str,
        input: usize,
        activation: Activation,
    ) -> Result<Conv, ImportError> {
        let name = format!("{path}.weight");
        let weight = self.tensor(&name, "weights of a convolution")?;
        let &[out, channels, 1, 1] = weight.shape() else {
            return Err(shape_error(&name, format!("[out, {input}, 1, 1]"), weight));
        };
        if channels != input || out == 0 {
            return Err(shape_error(&name, format!("[out, {input}, 1, 1]"), weight));
        }
        finite(&name, weight)?;
        let shape = [out, channels, 1, 1];
        let (weight, bias) = (weight.data().to_vec(), vec![0.0; out]);
        Ok(Conv { shape, weight, bias, stride: 1, pad: 0, dilation: 1, groups: 1, activation })
    }

    fn biased_conv(&mut self, path: &str, input: usize) -> Result<Conv, ImportError> {
        let mut conv = self.plain_conv(path, input, Activation::Identity)?;
        let name = format!("{path}.bias");
        let bias = self.tensor(&name, "bias of a head")?;
        if bias.shape() != [conv.out()] {
            return Err(shape_error(&name, format!("[{}]", conv.out()), bias));
        }
        finite(&name, bias)?;
        conv.bias = bias.data().to_vec();
        Ok(conv)
    }

    fn batch_norm(&mut self, path: &str, channels: usize) -> Result<BatchNorm<'a>, ImportError> {
        let mut part = |part: &str| -> Result<&'a [f32], ImportError> {
            let name = format!("{path}.{part}");
            let tensor = self.tensor(&name, "batch normalisation")?;
            if tensor.shape() != [channels] {
                return Err(shape_error(&name, format!("[{channels}]"), tensor));
            }
            finite(&name, tensor)?;
            Ok(tensor.data())
        };
        let (weight, bias) = (part("weight")?, part("bias")?);
        let (mean, var) = (part("running_mean")?, part("running_var")?);
        if var.iter().any(|&v| v < 0.0) {
            let name = format!("{path}.running_var");
            return Err(ImportError::Value { name, what: "a negative variance" });
        }
        let eps = self.number(path, "eps").or(self.checkpoint.bn_eps).unwrap_or(BN_EPS);
        if !(eps > 0.0 && eps < 1.0) {
            let reason = format!("epsilon is {eps}, not between 0 and 1");
            return Err(ImportError::Module { module: path.to_owned(), reason });
        }
        Ok(BatchNorm { weight, bias, mean, var, eps })
    }

    // What modules tell.

    fn module(&self, path: &str) -> Option<&'a ModuleInfo> {
        self.checkpoint.modules.get(path)
    }

    fn number(&self, path: &str, name: &str) -> Option<f64> {
        self.module(path)?.numbers.get(name)?.first().copied()
    }

    fn conv_numbers(
        &self,
        path: &str,
        k: usize,
        stride: usize,
    ) -> Result<ConvNumbers, ImportError> {
        let error = |reason: String| ImportError::Module { module: path.to_owned(), reason };
        let square = |name: &str, default: usize| -> Result<usize, ImportError> {
            let Some(told) = self.module(path).and_then(|m| m.numbers.get(name)) else {
                return Ok(default);
            };
            let first = told.first().copied().unwrap_or(-1.0);
            let fits = first.fract() == 0.0 && (0.0..=65_536.0).contains(&first);
            if !fits || told.iter().any(|&n| n != first) {
                return Err(error(format!("{name} {told:?} is not supported")));
            }
            Ok(first as usize)
        };
        // The stem of v6 is a 6x6 kernel with padding 2; all others are odd.
        let pad = if k.is_multiple_of(2) { (k / 2).saturating_sub(1) } else { k / 2 };
        let numbers = ConvNumbers {
            stride: square("stride", stride)?,
            pad: square("padding", pad)?,
            groups: square("groups", 1)?,
        };
        let dilation = square("dilation", 1)?;
        let supported = matches!(numbers.stride, 1 | 2) && numbers.groups > 0 && dilation == 1;
        // The size must be halved or kept, whatever the input: 2p = k − s, or k − 1 for odd kernels.
        let double = 2 * numbers.pad;
        let keeps = double + 1 == k || (numbers.stride == 2 && double + 2 == k);
        if !supported || !keeps {
            return Err(error(format!(
                "a convolution of kernel {k}, stride {}, padding {}, groups {} and dilation {dilation} \
                 is not supported",
                numbers.stride, numbers.pad, numbers.groups
            )));
        }
        Ok(numbers)
    }

    fn activation(&self, path: &str, default: Activation) -> Result<Activation, ImportError> {
        let Some(module) = self.module(path) else { return Ok(default) };
        Ok(match module.class.as_str() {
            "SiLU" | "Swish" => Activation::Silu,
            "Hardswish" => Activation::Hardswish,
            "ReLU" => Activation::Relu,
            "LeakyReLU" => {
                let slope = self.number(path, "negative_slope");
                Activation::LeakyRelu(slope.map_or(LEAKY_SLOPE, |s| s as f32))
            }
            "Identity" => Activation::Identity,
            other => {
                let reason = format!("activation {other} is not supported");
                return Err(ImportError::Module { module: path.to_owned(), reason });
            }
        })
    }

    // Tensors.

    fn has(&self, name: &str) -> bool {
        self.checkpoint.tensors.contains_key(name)
    }

    fn tensor(&mut self, name: &str, needed_by: &str) -> Result<&'a Tensor, ImportError> {
        let tensor = self.checkpoint.tensors.get(name).ok_or_else(|| {
            ImportError::MissingTensor { name: name.to_owned(), needed_by: needed_by.to_owned() }
        })?;
        self.used.insert(name.to_owned());
        Ok(tensor)
    }

    fn optional(&mut self, name: &str, shape: &[usize]) -> Result<Option<&'a Tensor>, ImportError> {
        if !self.has(name) {
            return Ok(None);
        }
        let tensor = self.tensor(name, "")?;
        if tensor.shape() != shape {
            return Err(shape_error(name, format!("{shape:?}"), tensor));
        }
        finite(name, tensor)?;
        Ok(Some(tensor))
    }

    fn check_surplus(&self) -> Result<(), ImportError> {
        let mut surplus = self.checkpoint.tensors.keys().filter(|n| !self.used.contains(*n));
        match surplus.next() {
            None => Ok(()),
            Some(first) => {
                Err(ImportError::SurplusTensors { name: first.clone(), count: surplus.count() + 1 })
            }
        }
    }
}

struct ConvNumbers {
    stride: usize,
    pad: usize,
    groups: usize,
}

fn finite(name: &str, tensor: &Tensor) -> Result<(), ImportError> {
    if tensor.data().iter().all(|x| x.is_finite()) {
        return Ok(());
    }
    Err(ImportError::Value { name: name.to_owned(), what: "NaN or infinity" })
}

fn shape_error(name: &str, expected: String, tensor: &Tensor) -> ImportError {
    ImportError::Shape { name: name.to_owned(), expected, found: tensor.shape().to_vec() }
}
