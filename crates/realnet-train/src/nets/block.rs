//! Layers that the networks are made of.

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, PaddingConfig2d};
use burn::tensor::activation::{relu, silu};
use burn::tensor::module::interpolate;
use burn::tensor::ops::{InterpolateMode, InterpolateOptions};
use burn::tensor::{Device, Tensor};

/// What follows a convolution and its normalisation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    Identity,
    /// `max(x, 0)`.
    Relu,
    /// `x · sigmoid(x)`.
    Silu,
}

/// Batch normalisation's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normalisation {
    /// Added to the variance.
    pub epsilon: f64,
    /// Share of a batch in the running statistics.
    pub momentum: f64,
}

impl Normalisation {
    /// YOLOv5's.
    pub const YOLOV5: Self = Self { epsilon: 1e-3, momentum: 0.03 };
    /// PyTorch's.
    pub const PYTORCH: Self = Self { epsilon: 1e-5, momentum: 0.1 };

    /// Batch normalisation of so many channels.
    #[must_use]
    pub fn init(self, channels: usize, device: &Device) -> BatchNorm {
        let Self { epsilon, momentum } = self;
        let config = BatchNormConfig::new(channels).with_epsilon(epsilon);
        config.with_momentum(momentum).init(device)
    }
}

/// Size and step of a square kernel; the padding keeps `size / step` pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernel {
    /// Pixels a side.
    pub size: usize,
    /// Pixels from one position to the next.
    pub stride: usize,
    /// Zeros around the input.
    pub padding: usize,
}

impl Kernel {
    /// One pixel.
    pub const POINT: Self = Self { size: 1, stride: 1, padding: 0 };
    /// Three by three.
    pub const THREE: Self = Self { size: 3, stride: 1, padding: 1 };
    /// Three by three at every second pixel.
    pub const HALVE: Self = Self { size: 3, stride: 2, padding: 1 };
}

/// A convolution without bias, batch normalisation and an activation.
///
/// Input `[batch, channels, height, width]`; parameters `conv.weight` and those of `bn`.
#[derive(Module, Debug)]
pub struct ConvBlock {
    conv: Conv2d,
    bn: BatchNorm,
    #[module(skip)]
    activation: Activation,
}

impl ConvBlock {
    /// From `channels[0]` to `channels[1]`.
    #[must_use]
    pub fn new(
        channels: [usize; 2],
        kernel: Kernel,
        normalisation: Normalisation,
        activation: Activation,
        device: &Device,
    ) -> Self {
        Self {
            conv: convolution(channels, kernel).with_bias(false).init(device),
            bn: normalisation.init(channels[1], device),
            activation,
        }
    }

    /// The layer's output.
    #[must_use]
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = self.bn.forward(self.conv.forward(x));
        match self.activation {
            Activation::Identity => x,
            Activation::Relu => relu(x),
            Activation::Silu => silu(x),
        }
    }
}

/// A convolution with a square kernel.
#[must_use]
pub fn convolution(channels: [usize; 2], kernel: Kernel) -> Conv2dConfig {
    let Kernel { size, stride, padding: p } = kernel;
    // Explicit: `Same` is lopsided for a stride of 2.
    Conv2dConfig::new(channels, [size, size])
        .with_stride([stride, stride])
        .with_padding(PaddingConfig2d::Explicit(p, p, p, p))
}

/// Twice as high and wide: every pixel four times.
#[must_use]
pub fn doubled(x: Tensor<4>) -> Tensor<4> {
    let nearest = InterpolateOptions::new(InterpolateMode::Nearest);
    interpolate(x, nearest.with_align_corners(false).with_scale_factor([2.0, 2.0]))
}

/// Made as large as `like`, between the centres of the pixels linearly.
#[must_use]
pub fn enlarged(x: Tensor<4>, like: &Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = like.dims();
    resized(x, [height, width], false)
}

/// Made of `size` (height, width), between the pixels linearly, from their centres or, with
/// `corners`, from the outer ones on the outer ones.
#[must_use]
pub fn resized(x: Tensor<4>, size: [usize; 2], corners: bool) -> Tensor<4> {
    let bilinear = InterpolateOptions::new(InterpolateMode::Bilinear);
    interpolate(x, bilinear.with_align_corners(corners).with_output_size(size))
}
