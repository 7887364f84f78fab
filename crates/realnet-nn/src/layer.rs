//! Layers that all networks are made of, batch normalisation already folded.

/// What follows a convolution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Activation {
    Identity,
    Silu,
    Hardswish,
    Relu,
    /// `min(max(x, 0), 6)`.
    Relu6,
    LeakyRelu(f32),
}

/// A convolution with square kernel and bias.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Conv {
    /// Output channels, input channels per group, kernel, kernel.
    pub shape: [usize; 4],
    /// Row-major over `shape`.
    pub weight: Vec<f32>,
    /// One per output channel.
    pub bias: Vec<f32>,
    pub stride: usize,
    pub pad: usize,
    /// Distance of the kernel's taps.
    pub dilation: usize,
    pub groups: usize,
    pub activation: Activation,
}

impl Conv {
    pub(crate) fn out(&self) -> usize {
        self.shape[0]
    }

    /// Number of weights and biases.
    pub(crate) fn parameters(&self) -> usize {
        self.weight.len() + self.bias.len()
    }
}
