//! The network as its parts, batch normalisation already folded.

use crate::layer::Conv;

/// A residual block: `relu(c2(c1(x)) + around(x))`; where it `halves`, what goes around is
/// averaged over 2x2 pixels first.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Residual {
    pub c1: Conv,
    pub c2: Conv,
    pub around: Option<Conv>,
    pub halves: bool,
}

/// One step of the decoder: `merge(enlarged(reduce(x)) + level)`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Step {
    pub reduce: Conv,
    pub merge: Conv,
}

/// The whole network.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Graph {
    pub stem: Conv,
    /// At 1/4, 1/8, 1/16 and 1/32 of the input's size.
    pub stages: Vec<Vec<Residual>>,
    /// Back to 1/16, 1/8 and 1/4.
    pub steps: Vec<Step>,
    /// From the first stage to the channels of the last step.
    pub skip: Conv,
    pub head: Conv,
}

impl Graph {
    /// All convolutions.
    pub(super) fn convs(&self) -> Vec<&Conv> {
        let blocks = self.stages.iter().flatten();
        let blocks = blocks.flat_map(|b| [&b.c1, &b.c2].into_iter().chain(&b.around));
        let steps = self.steps.iter().flat_map(|step| [&step.reduce, &step.merge]);
        [&self.stem, &self.skip, &self.head].into_iter().chain(blocks).chain(steps).collect()
    }
}
