//! A depth network for small computers: the head of the authors of virtual normals
//! (classes of log depth) on a residual encoder and decoder of dense convolutions.

use super::block::{Activation, ConvBlock, Kernel, Normalisation, convolution, enlarged};
use burn::module::Module;
use burn::nn::conv::Conv2d;
use burn::tensor::activation::relu;
use burn::tensor::module::avg_pool2d;
use burn::tensor::ops::AvgPoolOptions;
use burn::tensor::{Device, Tensor};

/// What a network is built from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VnlLiteConfig {
    /// Channels of the first layer and at 1/4, 1/8, 1/16 and 1/32 of the input's size.
    pub widths: [usize; 5],
    /// Residual blocks at 1/4, 1/8, 1/16 and 1/32.
    pub blocks: [usize; 4],
    /// Channels of the decoder at 1/4; those below are the encoder's.
    pub decoder: usize,
    /// Classes of depth.
    pub bins: usize,
}

impl Default for VnlLiteConfig {
    fn default() -> Self {
        Self { widths: [32, 48, 96, 160, 256], blocks: [2, 2, 2, 1], decoder: 64, bins: 80 }
    }
}

fn conv(channels: [usize; 2], kernel: Kernel, activation: Activation, d: &Device) -> ConvBlock {
    ConvBlock::new(channels, kernel, Normalisation::PYTORCH, activation, d)
}

/// Two convolutions and a way around them (He et al., 2016); where the size is halved the
/// way around averages (He et al., "Bag of tricks", 2019).
#[derive(Module, Debug)]
struct Residual {
    c1: ConvBlock,
    c2: ConvBlock,
    around: Option<ConvBlock>,
    halves: bool,
}

impl Residual {
    fn new([from, to]: [usize; 2], halves: bool, device: &Device) -> Self {
        let first = if halves { Kernel::HALVE } else { Kernel::THREE };
        let changes = halves || from != to;
        Self {
            c1: conv([from, to], first, Activation::Relu, device),
            c2: conv([to, to], Kernel::THREE, Activation::Identity, device),
            around: changes.then(|| conv([from, to], Kernel::POINT, Activation::Identity, device)),
            halves,
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = self.c2.forward(self.c1.forward(x.clone()));
        let x = if self.halves {
            avg_pool2d(x, AvgPoolOptions::new([2, 2]).with_stride([2, 2]))
        } else {
            x
        };
        let x = match &self.around {
            Some(around) => around.forward(x),
            None => x,
        };
        relu(y + x)
    }
}

/// The network. Parameters are named by the fields: `stem`, `stages.I.J.c1`, `reduce.I`,
/// `merge.I`, `skip`, `head`.
#[derive(Module, Debug)]
pub struct VnlLite {
    stem: ConvBlock,
    stages: Vec<Vec<Residual>>,
    /// To the channels of the stage before, the last stage first.
    reduce: Vec<ConvBlock>,
    /// After the sum with that stage.
    merge: Vec<ConvBlock>,
    /// The first stage to the channels of the decoder.
    skip: ConvBlock,
    head: Conv2d,
    #[module(skip)]
    config: VnlLiteConfig,
}

impl VnlLite {
    /// Random weights.
    #[must_use]
    pub fn new(config: &VnlLiteConfig, device: &Device) -> Self {
        let relu = |channels, kernel| conv(channels, kernel, Activation::Relu, device);
        let [first, quarter, eighth, sixteenth, last] = config.widths;
        let mut from = first;
        let stages = [quarter, eighth, sixteenth, last].into_iter().zip(config.blocks);
        let stages = stages.map(|(to, blocks)| {
            let blocks = (0..blocks.max(1)).map(|index| {
                Residual::new([std::mem::replace(&mut from, to), to], index == 0, device)
            });
            blocks.collect()
        });
        let stages = stages.collect();
        let steps = [[last, sixteenth], [sixteenth, eighth], [eighth, config.decoder]];
        Self {
            stem: relu([3, first], Kernel::HALVE),
            stages,
            reduce: steps.iter().map(|step| relu(*step, Kernel::POINT)).collect(),
            merge: steps.iter().map(|[_, to]| relu([*to, *to], Kernel::THREE)).collect(),
            skip: relu([quarter, config.decoder], Kernel::POINT),
            head: convolution([config.decoder, config.bins], Kernel::THREE).init(device),
            config: *config,
        }
    }

    /// What it was built from.
    #[must_use]
    pub const fn config(&self) -> &VnlLiteConfig {
        &self.config
    }

    /// Logits of the classes of depth: `[batch, bins, height / 4, width / 4]`.
    /// `image`: `[batch, 3, height, width]`, normalised, sides multiples of 32.
    #[must_use]
    pub fn forward(&self, image: Tensor<4>) -> Tensor<4> {
        let mut x = self.stem.forward(image);
        let mut levels = Vec::with_capacity(self.stages.len());
        for stage in &self.stages {
            x = stage.iter().fold(x, |x, block| block.forward(x));
            levels.push(x.clone());
        }
        // The last one is `x` itself.
        levels.pop();
        for (reduce, merge) in self.reduce.iter().zip(&self.merge) {
            let Some(level) = levels.pop() else { break };
            let level = if levels.is_empty() { self.skip.forward(level) } else { level };
            x = merge.forward(enlarged(reduce.forward(x), &level) + level);
        }
        self.head.forward(x)
    }
}
