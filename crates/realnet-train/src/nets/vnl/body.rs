//! The encoders' own networks: stages 2 to 5 of what they were published as, with dilation
//! in the place of the last strides.

use super::plain;
use crate::nets::block::{Kernel, Normalisation};
use burn::module::Module;
use burn::nn::BatchNorm;
use burn::nn::conv::Conv2d;
use burn::tensor::activation::relu;
use burn::tensor::module::max_pool2d;
use burn::tensor::ops::MaxPoolOptions;
use burn::tensor::{Device, Tensor};

/// A layer in one of the authors' sequences, in which activations have numbers too.
#[derive(Module, Debug)]
pub(super) enum Layer {
    Conv(Conv2d),
    Norm(BatchNorm),
    Relu6(Relu6),
}

/// `min(max(x, 0), 6)`.
#[derive(Module, Debug)]
pub(super) struct Relu6 {
    #[module(skip)]
    most: f32,
}

impl Layer {
    fn norm(channels: usize, device: &Device) -> Self {
        Self::Norm(Normalisation::PYTORCH.init(channels, device))
    }

    const fn relu6() -> Self {
        Self::Relu6(Relu6 { most: 6.0 })
    }
}

/// The output of the layers one after the other.
pub(super) fn through(layers: &[Layer], x: Tensor<4>) -> Tensor<4> {
    layers.iter().fold(x, |x, layer| match layer {
        Layer::Conv(conv) => conv.forward(x),
        Layer::Norm(norm) => norm.forward(x),
        Layer::Relu6(Relu6 { most }) => x.clamp(0.0, *most),
    })
}

/// Widens, convolves each channel by itself, narrows (Sandler et al., 2018).
#[derive(Module, Debug)]
struct Inverted {
    conv: Vec<Layer>,
    add: bool,
}

impl Inverted {
    fn new(
        [from, to]: [usize; 2],
        widening: usize,
        stride: usize,
        dilation: usize,
        device: &Device,
    ) -> Self {
        let hidden = from * widening;
        let mut conv = Vec::with_capacity(8);
        if widening > 1 {
            conv.push(Layer::Conv(plain([from, hidden], Kernel::POINT, 1).init(device)));
            conv.push(Layer::norm(hidden, device));
            conv.push(Layer::relu6());
        }
        let each = plain([hidden; 2], Kernel { stride, ..Kernel::THREE }, dilation);
        conv.push(Layer::Conv(each.with_groups(hidden).init(device)));
        conv.push(Layer::norm(hidden, device));
        conv.push(Layer::relu6());
        conv.push(Layer::Conv(plain([hidden, to], Kernel::POINT, 1).init(device)));
        conv.push(Layer::norm(to, device));
        Self { conv, add: stride == 1 && from == to }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = through(&self.conv, x.clone());
        if self.add { y + x } else { y }
    }
}

/// MobileNetV2 whose stages 4 and 5 keep the stride of 8.
#[derive(Module, Debug)]
pub(super) struct MobileNetV2 {
    res1: Vec<Vec<Layer>>,
    res2: Vec<Inverted>,
    res3: Vec<Inverted>,
    res4: Vec<Inverted>,
    res5: Vec<Inverted>,
}

impl MobileNetV2 {
    pub(super) fn new(device: &Device) -> Self {
        let mut from = 32;
        let stem = vec![
            Layer::Conv(plain([3, from], Kernel::HALVE, 1).init(device)),
            Layer::norm(from, device),
            Layer::relu6(),
        ];
        // Widening, channels, blocks and the first one's stride.
        let mut stage = |groups: &[(usize, usize, usize, usize)], dilation| {
            let mut blocks = Vec::new();
            for &(widening, to, count, first) in groups {
                for index in 0..count {
                    let stride = if index == 0 { first } else { 1 };
                    let channels = [std::mem::replace(&mut from, to), to];
                    blocks.push(Inverted::new(channels, widening, stride, dilation, device));
                }
            }
            blocks
        };
        Self {
            res1: vec![stem],
            res2: stage(&[(1, 16, 1, 1), (6, 24, 2, 2)], 1),
            res3: stage(&[(6, 32, 3, 2)], 1),
            res4: stage(&[(6, 64, 4, 1), (6, 96, 3, 1)], 2),
            res5: stage(&[(6, 160, 3, 1), (6, 320, 1, 1)], 4),
        }
    }

    /// Stages 2 to 5.
    pub(super) fn forward(&self, image: Tensor<4>) -> [Tensor<4>; 4] {
        let mut x = self.res1.iter().fold(image, |x, layers| through(layers, x));
        [&self.res2, &self.res3, &self.res4, &self.res5].map(|blocks| {
            x = blocks.iter().fold(x.clone(), |x, block| block.forward(x));
            x.clone()
        })
    }
}

/// The way around a block that changes the channels.
#[derive(Module, Debug)]
struct Shortcut {
    conv: Conv2d,
    bn: BatchNorm,
}

/// A bottleneck of grouped convolutions (Xie et al., 2017).
#[derive(Module, Debug)]
struct Bottleneck {
    conv1: Conv2d,
    bn1: BatchNorm,
    conv2: Conv2d,
    bn2: BatchNorm,
    conv3: Conv2d,
    bn3: BatchNorm,
    shortcut: Option<Shortcut>,
}

impl Bottleneck {
    /// Groups of a 3x3 convolution; each has 4 channels where a block has 256.
    const GROUPS: usize = 32;

    fn new([from, to]: [usize; 2], stride: usize, dilation: usize, device: &Device) -> Self {
        let inner = to / 2;
        let three = plain([inner; 2], Kernel { stride, ..Kernel::THREE }, dilation);
        let norm = |channels| Normalisation::PYTORCH.init(channels, device);
        let around = || Shortcut {
            conv: plain([from, to], Kernel { stride, ..Kernel::POINT }, 1).init(device),
            bn: norm(to),
        };
        Self {
            conv1: plain([from, inner], Kernel::POINT, 1).init(device),
            bn1: norm(inner),
            conv2: three.with_groups(Self::GROUPS).init(device),
            bn2: norm(inner),
            conv3: plain([inner, to], Kernel::POINT, 1).init(device),
            bn3: norm(to),
            shortcut: (from != to).then(around),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = relu(self.bn1.forward(self.conv1.forward(x.clone())));
        let y = relu(self.bn2.forward(self.conv2.forward(y)));
        let y = self.bn3.forward(self.conv3.forward(y));
        let x = match &self.shortcut {
            Some(Shortcut { conv, bn }) => bn.forward(conv.forward(x)),
            None => x,
        };
        relu(y + x)
    }
}

#[derive(Module, Debug)]
struct Stem {
    conv1: Conv2d,
    bn1: BatchNorm,
}

/// ResNeXt 32x4d whose stage 5 keeps the stride of 16.
#[derive(Module, Debug)]
pub(super) struct ResNext {
    res1: Stem,
    res2: Vec<Bottleneck>,
    res3: Vec<Bottleneck>,
    res4: Vec<Bottleneck>,
    res5: Vec<Bottleneck>,
}

impl ResNext {
    /// With so many blocks in stages 2 to 5.
    pub(super) fn new(blocks: [usize; 4], device: &Device) -> Self {
        let mut from = 64;
        let seven = Kernel { size: 7, stride: 2, padding: 3 };
        let stem = Stem {
            conv1: plain([3, from], seven, 1).init(device),
            bn1: Normalisation::PYTORCH.init(from, device),
        };
        // Channels, stride and dilation.
        let numbers = [(256, 1, 1), (512, 2, 1), (1024, 2, 1), (2048, 1, 2)];
        let mut stages = numbers.into_iter().zip(blocks).map(|((to, first, dilation), count)| {
            let block = |index| {
                let stride = if index == 0 { first } else { 1 };
                Bottleneck::new([std::mem::replace(&mut from, to), to], stride, dilation, device)
            };
            (0..count).map(block).collect()
        });
        let mut next = || stages.next().unwrap_or_default();
        Self { res1: stem, res2: next(), res3: next(), res4: next(), res5: next() }
    }

    /// Stages 2 to 5.
    pub(super) fn forward(&self, image: Tensor<4>) -> [Tensor<4>; 4] {
        let x = relu(self.res1.bn1.forward(self.res1.conv1.forward(image)));
        let pool = MaxPoolOptions::new([3, 3]).with_stride([2, 2]).with_padding([1, 1]);
        let mut x = max_pool2d(x, pool);
        [&self.res2, &self.res3, &self.res4, &self.res5].map(|blocks| {
            x = blocks.iter().fold(x.clone(), |x, block| block.forward(x));
            x.clone()
        })
    }
}
