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
}

/// The whole network.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Graph {
    pub stem: Conv,
    /// `res2` to `res5`.
    pub stages: Vec<Vec<Inverted>>,
    /// From the means of the last stage.
    pub pooled: Conv,
    pub top: Conv,
    /// On the stages, the last first.
    pub laterals: Vec<Transfer>,
    /// One for each lateral.
    pub fusions: Vec<Fusion>,
    pub last: Transfer,
    pub predict: Conv,
}

impl Transfer {
    fn convs(&self) -> [&Conv; 3] {
        [&self.enter, &self.middle, &self.last]
    }
}

impl Graph {
    /// All convolutions.
    pub(super) fn convs(&self) -> Vec<&Conv> {
        let inverted = self.stages.iter().flatten();
        let inverted = inverted.flat_map(|b| b.expand.iter().chain([&b.depthwise, &b.project]));
        let fusions = self.fusions.iter();
        let gates = fusions.clone().flat_map(|f| [&f.gate.squeeze, &f.gate.excite]);
        let transfers =
            self.laterals.iter().chain(fusions.map(|f| &f.transfer)).chain([&self.last]);
        [&self.stem, &self.pooled, &self.top, &self.predict]
            .into_iter()
            .chain(inverted)
            .chain(gates)
            .chain(transfers.flat_map(Transfer::convs))
            .collect()
    }
}
