//! The network as its parts, batch normalisation already folded.

use crate::layer::Conv;

/// An inverted residual of MobileNetV2.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Inverted {
    pub expand: Option<Conv>,
    pub depthwise: Conv,
    pub project: Conv,
    /// The input is added to the output.
    pub add: bool,
}

/// A bottleneck of ResNeXt: `relu(last(middle(enter(x))) + around(x))`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Bottleneck {
    pub enter: Conv,
    pub middle: Conv,
    pub last: Conv,
    pub around: Option<Conv>,
}

/// A block of the encoder.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Block {
    Inverted(Inverted),
    Bottleneck(Bottleneck),
}

/// What the decoder starts from, made of the last stage: `joined(branches side by side) +
/// mean(pooled(means))`, the second one value a channel.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Top {
    /// None for MobileNetV2, and then nothing to join.
    pub branches: Vec<Conv>,
    pub joined: Option<Conv>,
    pub pooled: Conv,
    pub mean: Conv,
}

/// A residual block: `relu(last(middle(x)) + x)` with `x = enter(input)`. The
/// authors call it feature transfer block.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Transfer {
    pub enter: Conv,
    pub middle: Conv,
    pub last: Conv,
}

/// Weighs a lateral: `sigmoid(excite(squeeze(means of lateral and top)))`. The
/// authors call it adaptive feature adjustment.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Gate {
    pub squeeze: Conv,
    pub excite: Conv,
}

/// One step of the decoder: `transfer(lateral · gate + top)`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fusion {
    pub gate: Gate,
    pub transfer: Transfer,
    /// The top is half as large as the lateral.
    pub doubles: bool,
}

/// The whole network.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Graph {
    pub stem: Conv,
    /// The largest of 3x3 at every second pixel comes next.
    pub pools: bool,
    /// `res2` to `res5`.
    pub stages: Vec<Vec<Block>>,
    /// Pixels of the input a pixel of the last stage.
    pub stride: usize,
    pub top: Top,
    /// On the stages, the last first.
    pub laterals: Vec<Transfer>,
    /// One for each lateral.
    pub fusions: Vec<Fusion>,
    pub last: Transfer,
    pub predict: Conv,
}

impl Block {
    fn convs(&self) -> Vec<&Conv> {
        match self {
            Self::Inverted(b) => b.expand.iter().chain([&b.depthwise, &b.project]).collect(),
            Self::Bottleneck(b) => {
                [&b.enter, &b.middle, &b.last].into_iter().chain(&b.around).collect()
            }
        }
    }

    /// Channels of its output.
    pub(super) fn out(&self) -> usize {
        match self {
            Self::Inverted(block) => block.project.out(),
            Self::Bottleneck(block) => block.last.out(),
        }
    }
}

impl Top {
    fn convs(&self) -> impl Iterator<Item = &Conv> {
        self.branches.iter().chain(&self.joined).chain([&self.pooled, &self.mean])
    }
}

impl Transfer {
    fn convs(&self) -> [&Conv; 3] {
        [&self.enter, &self.middle, &self.last]
    }
}

impl Graph {
    /// All convolutions.
    pub(super) fn convs(&self) -> Vec<&Conv> {
        let fusions = self.fusions.iter();
        let gates = fusions.clone().flat_map(|f| [&f.gate.squeeze, &f.gate.excite]);
        let transfers =
            self.laterals.iter().chain(fusions.map(|f| &f.transfer)).chain([&self.last]);
        [&self.stem, &self.predict]
            .into_iter()
            .chain(self.stages.iter().flatten().flat_map(Block::convs))
            .chain(self.top.convs())
            .chain(gates)
            .chain(transfers.flat_map(Transfer::convs))
            .collect()
    }
}
