//! The layers of a network, batch normalisation already folded.

use crate::layer::Conv;

/// Two convolutions with an optional shortcut.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Bottleneck {
    pub cv1: Conv,
    pub cv2: Conv,
    pub add: bool,
}

/// `out(cat(tail(blocks(cv1(x))), cv2(x)))`: C3 has no `tail`, BottleneckCSP has one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Csp {
    pub cv1: Conv,
    pub blocks: Vec<Bottleneck>,
    pub tail: Option<Conv>,
    pub cv2: Conv,
    pub out: Conv,
}

/// Pyramid pooling: `cv2(cat(x, p1(x), p2(p1(x)), …))` with `x = cv1(input)`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spp {
    pub cv1: Conv,
    /// Kernels of the chained poolings, each of stride 1.
    pub pools: Vec<usize>,
    pub cv2: Conv,
}

/// What a layer does.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Op {
    Conv(Conv),
    Bottlenecks(Vec<Bottleneck>),
    Csp(Box<Csp>),
    Spp(Spp),
    /// Nearest-neighbour upsampling by 2.
    Upsample,
    /// Along the channels.
    Concat,
    /// The 1x1 convolutions of the heads.
    Detect(Vec<Conv>),
}

/// A layer with the indices of the layers it reads; `None` is the image.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layer {
    pub inputs: Vec<Option<usize>>,
    pub op: Op,
}

impl Op {
    /// All convolutions.
    pub(super) fn convs(&self) -> Vec<&Conv> {
        match self {
            Op::Conv(conv) => vec![conv],
            Op::Bottlenecks(blocks) => blocks.iter().flat_map(|b| [&b.cv1, &b.cv2]).collect(),
            Op::Csp(csp) => {
                let blocks = csp.blocks.iter().flat_map(|b| [&b.cv1, &b.cv2]);
                [&csp.cv1, &csp.cv2, &csp.out].into_iter().chain(&csp.tail).chain(blocks).collect()
            }
            Op::Spp(spp) => vec![&spp.cv1, &spp.cv2],
            Op::Upsample | Op::Concat => Vec::new(),
            Op::Detect(heads) => heads.iter().collect(),
        }
    }

    /// Number of weights and biases.
    pub(super) fn parameters(&self) -> usize {
        self.convs().iter().map(|c| c.parameters()).sum()
    }
}
