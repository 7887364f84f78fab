//! From the encoder's stages to logits.

use super::body::{Layer, through};
use super::{mean, plain};
use crate::nets::block::{Kernel, Normalisation, resized};
use burn::module::Module;
use burn::nn::BatchNorm;
use burn::nn::conv::Conv2d;
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::{Device, Tensor};

/// Distance of the taps in the residual blocks and the prediction.
const DILATION: usize = 2;

/// A residual block. The authors call it feature transfer block.
#[derive(Module, Debug)]
pub(super) struct Transfer {
    conv1: Conv2d,
    conv2: Conv2d,
    bn1: BatchNorm,
    conv3: Conv2d,
}

impl Transfer {
    pub(super) fn new([from, to]: [usize; 2], device: &Device) -> Self {
        let three = || plain([to; 2], Kernel::THREE, DILATION);
        Self {
            conv1: plain([from, to], Kernel::POINT, 1).init(device),
            conv2: three().with_bias(true).init(device),
            bn1: Normalisation { momentum: 0.5, ..Normalisation::PYTORCH }.init(to, device),
            conv3: three().init(device),
        }
    }

    pub(super) fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = self.conv1.forward(x);
        let y = relu(self.bn1.forward(self.conv2.forward(x.clone())));
        relu(self.conv3.forward(y) + x)
    }
}

/// Weighs a lateral. The authors call it adaptive feature adjustment.
#[derive(Module, Debug)]
struct Gate {
    conv1: Conv2d,
    conv2: Conv2d,
}

impl Gate {
    fn new(channels: usize, device: &Device) -> Self {
        let inner = channels / 8;
        Self {
            conv1: plain([2 * channels, inner], Kernel::POINT, 1).init(device),
            conv2: plain([inner, channels], Kernel::POINT, 1).init(device),
        }
    }

    fn forward(&self, lateral: Tensor<4>, top: Tensor<4>) -> Tensor<4> {
        let means = Tensor::cat(vec![mean(lateral.clone()), mean(top.clone())], 1);
        let gate = sigmoid(self.conv2.forward(relu(self.conv1.forward(means))));
        lateral * gate + top
    }
}

/// One step: the top is made as large as the lateral and joined with it.
#[derive(Module, Debug)]
struct Fusion {
    afa_block: Gate,
    ftb_block: Transfer,
}

impl Fusion {
    fn new(channels: [usize; 2], device: &Device) -> Self {
        Self {
            afa_block: Gate::new(channels[0], device),
            ftb_block: Transfer::new(channels, device),
        }
    }

    fn forward(&self, lateral: Tensor<4>, top: Tensor<4>) -> Tensor<4> {
        let [.., height, width] = lateral.dims();
        let top = match top.dims() {
            // One value a channel fits any size.
            [.., 1, 1] => top,
            [.., h, w] if (h, w) == (height, width) => top,
            _ => resized(top, [height, width], true),
        };
        self.ftb_block.forward(self.afa_block.forward(lateral, top))
    }
}

#[derive(Module, Debug)]
struct Last {
    ftb: Transfer,
}

#[derive(Module, Debug)]
struct Predict {
    conv1: Conv2d,
}

#[derive(Module, Debug)]
pub(super) struct Decoder {
    top: Vec<Layer>,
    topdown_fcn1: Fusion,
    topdown_fcn2: Fusion,
    topdown_fcn3: Fusion,
    topdown_fcn4: Fusion,
    topdown_fcn5: Last,
    topdown_predict: Predict,
}

impl Decoder {
    /// From `parts` times `first` channels, over `first`, to `rest` in all later steps.
    pub(super) fn new(
        parts: usize,
        first: usize,
        rest: usize,
        bins: usize,
        device: &Device,
    ) -> Self {
        // The released code hands over the momentum in the place of the epsilon.
        let top = Normalisation { epsilon: 0.5, ..Normalisation::PYTORCH };
        let further = || Fusion::new([rest; 2], device);
        let predict = plain([rest, bins], Kernel::THREE, DILATION).with_bias(true);
        Self {
            top: vec![
                Layer::Conv(plain([parts * first, first], Kernel::POINT, 1).init(device)),
                Layer::Norm(top.init(first, device)),
            ],
            topdown_fcn1: Fusion::new([first, rest], device),
            topdown_fcn2: further(),
            topdown_fcn3: further(),
            topdown_fcn4: further(),
            topdown_fcn5: Last { ftb: Transfer::new([rest; 2], device) },
            topdown_predict: Predict { conv1: predict.init(device) },
        }
    }

    /// `laterals`: the last stage's first; `size`: height and width of the picture.
    pub(super) fn forward(
        &self,
        top: Tensor<4>,
        laterals: Vec<Tensor<4>>,
        [height, width]: [usize; 2],
    ) -> Tensor<4> {
        let top = through(&self.top, top);
        let steps =
            [&self.topdown_fcn1, &self.topdown_fcn2, &self.topdown_fcn3, &self.topdown_fcn4];
        let x = steps
            .into_iter()
            .zip(laterals)
            .fold(top, |x, (step, lateral)| step.forward(lateral, x));
        let x = resized(x, [height.div_ceil(2), width.div_ceil(2)], true);
        let x = resized(self.topdown_fcn5.ftb.forward(x), [height, width], true);
        self.topdown_predict.conv1.forward(x)
    }
}
