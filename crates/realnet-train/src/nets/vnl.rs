//! The depth network of *Enforcing geometric constraints of virtual normal for depth
//! prediction* (Yin et al., ICCV 2019) as its authors released it: layers, dilations and the
//! names of the parameters. [`realnet_nn::vnl`] is the same network at run time.

mod body;
mod decoder;

use super::block::{Kernel, Normalisation, convolution};
use crate::names::{NamesError, Tensors, take_all};
use body::{MobileNetV2, ResNext};
use burn::module::Module;
use burn::nn::BatchNorm;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::{Device, Tensor};
use decoder::{Decoder, Transfer};
use std::borrow::Cow;
use std::str::FromStr;
use thiserror::Error;

/// The encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VnlBody {
    /// MobileNetV2 at a stride of 8.
    MobileNetV2,
    /// ResNeXt-50 32x4d at a stride of 16.
    ResNext50,
    /// ResNeXt-101 32x4d at a stride of 16.
    ResNext101,
}

/// A network that is none.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("'{0}' is no VNL network: vnl-mobilenetv2, vnl-resnext50, vnl-resnext101")]
pub struct UnknownBody(String);

impl FromStr for VnlBody {
    type Err = UnknownBody;

    fn from_str(text: &str) -> Result<Self, UnknownBody> {
        Ok(match text {
            "vnl-mobilenetv2" => Self::MobileNetV2,
            "vnl-resnext50" => Self::ResNext50,
            "vnl-resnext101" => Self::ResNext101,
            other => return Err(UnknownBody(other.to_owned())),
        })
    }
}

/// What a network is built from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VnlConfig {
    /// The encoder.
    pub body: VnlBody,
    /// Classes of depth.
    pub bins: usize,
}

impl VnlConfig {
    /// With the bins of the authors' configuration for NYU Depth V2: 60 for MobileNetV2, 150
    /// for the ResNeXts. (For KITTI they give ResNeXt-101 100.)
    #[must_use]
    pub const fn new(body: VnlBody) -> Self {
        let bins = match body {
            VnlBody::MobileNetV2 => 60,
            VnlBody::ResNext50 | VnlBody::ResNext101 => 150,
        };
        Self { body, bins }
    }

    /// What weights under the authors' names were built from; `None` if they are others.
    #[must_use]
    pub fn of(weights: &Tensors) -> Option<Self> {
        let prefix = prefix(weights);
        let predict = weights.get(&format!("{prefix}{PREDICT}"))?;
        // As many as there are numbers for, whatever the shape says.
        let bins = predict.shape().first().copied();
        let bins = bins.filter(|bins| (1..=predict.data().len()).contains(bins))?;
        let body = format!("{prefix}encoder_modules.bottomup");
        let has = |name: &str| weights.contains_key(&format!("{body}.{name}"));
        let body = if has("res1.0.0.weight") {
            VnlBody::MobileNetV2
        } else if !has("res1.conv1.weight") {
            return None;
        } else if has("res4.6.conv1.weight") {
            // It has a seventh block.
            VnlBody::ResNext101
        } else {
            VnlBody::ResNext50
        };
        Some(Self { body, bins })
    }

    /// Width and height of an input have to be multiples of this many pixels.
    #[must_use]
    pub const fn stride(&self) -> usize {
        match self.body {
            VnlBody::MobileNetV2 => 8,
            VnlBody::ResNext50 | VnlBody::ResNext101 => 16,
        }
    }
}

/// The name of the prediction's weights.
const PREDICT: &str = "decoder_modules.topdown_predict.conv1.weight";
/// What may stand before all names: the network as a part of the authors' training program.
const PREFIX: &str = "depth_model.";

fn prefix(weights: &Tensors) -> &'static str {
    let prefixed = weights.keys().any(|name| name.starts_with(PREFIX));
    if prefixed { PREFIX } else { "" }
}

/// The weights without what stands before all names.
fn own_names(weights: &Tensors) -> Cow<'_, Tensors> {
    let prefix = prefix(weights);
    if prefix.is_empty() {
        return Cow::Borrowed(weights);
    }
    let own = weights
        .iter()
        .filter_map(|(name, tensor)| Some((name.strip_prefix(prefix)?.to_owned(), tensor.clone())));
    Cow::Owned(own.collect())
}

/// A convolution without bias; its taps are `dilation` pixels apart.
fn plain(channels: [usize; 2], kernel: Kernel, dilation: usize) -> Conv2dConfig {
    let kernel = Kernel { padding: kernel.padding * dilation, ..kernel };
    convolution(channels, kernel).with_dilation([dilation; 2]).with_bias(false)
}

/// The mean of every channel: `[batch, channels, 1, 1]`.
fn mean(x: Tensor<4>) -> Tensor<4> {
    x.mean_dim(2).mean_dim(3)
}

/// The last stage of MobileNetV2 as one value a channel.
#[derive(Module, Debug)]
struct Pool {
    globalpool_conv1x1: Conv2d,
    globalpool_bn: BatchNorm,
}

impl Pool {
    fn new(channels: [usize; 2], device: &Device) -> Self {
        Self {
            globalpool_conv1x1: plain(channels, Kernel::POINT, 1).init(device),
            globalpool_bn: Normalisation { momentum: 0.9, ..Normalisation::PYTORCH }
                .init(channels[1], device),
        }
    }

    /// `[batch, channels, 1, 1]`: normalised before the mean, so that a batch has statistics.
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        mean(self.globalpool_bn.forward(self.globalpool_conv1x1.forward(x)))
    }
}

/// The last stage of a ResNeXt through convolutions of different reach (atrous spatial pyramid
/// pooling, Chen et al., 2017), five times the channels. There is no activation.
#[derive(Module, Debug)]
struct Pyramid {
    aspp_conv1x1: Conv2d,
    aspp_conv3_1: Conv2d,
    aspp_conv3_2: Conv2d,
    aspp_conv3_3: Conv2d,
    aspp_bn1x1: BatchNorm,
    aspp_bn3_1: BatchNorm,
    aspp_bn3_2: BatchNorm,
    aspp_bn3_3: BatchNorm,
    globalpool_conv1x1: Conv2d,
    globalpool_bn: BatchNorm,
}

impl Pyramid {
    /// Distances of the taps.
    const DILATIONS: [usize; 3] = [2, 4, 6];

    fn new(channels: [usize; 2], device: &Device) -> Self {
        let [near, middle, far] =
            Self::DILATIONS.map(|d| plain(channels, Kernel::THREE, d).init(device));
        let point = || plain(channels, Kernel::POINT, 1).init(device);
        let bn =
            || Normalisation { momentum: 0.5, ..Normalisation::PYTORCH }.init(channels[1], device);
        Self {
            aspp_conv1x1: point(),
            aspp_conv3_1: near,
            aspp_conv3_2: middle,
            aspp_conv3_3: far,
            aspp_bn1x1: bn(),
            aspp_bn3_1: bn(),
            aspp_bn3_2: bn(),
            aspp_bn3_3: bn(),
            globalpool_conv1x1: point(),
            globalpool_bn: bn(),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let branches = [
            (&self.aspp_conv1x1, &self.aspp_bn1x1),
            (&self.aspp_conv3_1, &self.aspp_bn3_1),
            (&self.aspp_conv3_2, &self.aspp_bn3_2),
            (&self.aspp_conv3_3, &self.aspp_bn3_3),
        ];
        let mut parts: Vec<Tensor<4>> =
            branches.into_iter().map(|(conv, bn)| bn.forward(conv.forward(x.clone()))).collect();
        let [_, _, height, width] = x.dims();
        let pooled = self.globalpool_bn.forward(self.globalpool_conv1x1.forward(mean(x)));
        let [batch, channels, _, _] = pooled.dims();
        parts.push(pooled.expand([batch, channels, height, width]));
        Tensor::cat(parts, 1)
    }
}

/// The encoder's own network.
#[allow(clippy::large_enum_variant, reason = "one a network, and modules have no boxes")]
#[derive(Module, Debug)]
enum Body {
    Mobile(MobileNetV2),
    ResNext(ResNext),
}

/// What the decoder starts from.
#[allow(clippy::large_enum_variant, reason = "one a network, and modules have no boxes")]
#[derive(Module, Debug)]
enum Top {
    Pool(Pool),
    Pyramid(Pyramid),
}

/// Under this name a lateral block is stored.
#[derive(Module, Debug)]
struct Lateral {
    lateral: Transfer,
}

#[derive(Module, Debug)]
struct Encoder {
    bottomup: Body,
    bottomup_top: Top,
    /// On the stages, the last first.
    topdown_lateral_modules: Vec<Lateral>,
}

impl Encoder {
    /// The top, and the laterals, the last stage's first.
    fn forward(&self, image: Tensor<4>) -> (Tensor<4>, Vec<Tensor<4>>) {
        let stages = match &self.bottomup {
            Body::Mobile(body) => body.forward(image),
            Body::ResNext(body) => body.forward(image),
        };
        let [_, _, _, last] = &stages;
        let top = match &self.bottomup_top {
            Top::Pool(pool) => pool.forward(last.clone()),
            Top::Pyramid(pyramid) => pyramid.forward(last.clone()),
        };
        let laterals = self.topdown_lateral_modules.iter().zip(stages.into_iter().rev());
        (top, laterals.map(|(block, stage)| block.lateral.forward(stage)).collect())
    }
}

/// The network. The fields have the authors' names, so that [`crate::names`] gives the
/// parameters theirs; in their checkpoints `depth_model.` may stand before them.
#[derive(Module, Debug)]
pub struct Vnl {
    encoder_modules: Encoder,
    decoder_modules: Decoder,
    #[module(skip)]
    config: VnlConfig,
}

impl Vnl {
    /// Random weights, PyTorch's initialisation.
    #[must_use]
    pub fn new(config: &VnlConfig, device: &Device) -> Self {
        // Channels of the stages, the last first, of the laterals on them, and of the rest; blocks
        // of a ResNeXt's stage 4.
        let resnext = ([2048, 1024, 512, 256], [512, 256, 256, 256], 256);
        let ((stages, laterals, rest), blocks) = match config.body {
            VnlBody::MobileNetV2 => (([320, 96, 32, 24], [128, 64, 64, 64], 64), None),
            VnlBody::ResNext50 => (resnext, Some(6)),
            VnlBody::ResNext101 => (resnext, Some(23)),
        };
        let top = [stages[0], laterals[0]];
        let (bottomup, bottomup_top, parts) = if let Some(blocks) = blocks {
            let body = ResNext::new([3, 4, blocks, 3], device);
            (Body::ResNext(body), Top::Pyramid(Pyramid::new(top, device)), 5)
        } else {
            (Body::Mobile(MobileNetV2::new(device)), Top::Pool(Pool::new(top, device)), 1)
        };
        let sides = stages.into_iter().zip(laterals);
        let sides = sides.map(|(from, to)| Lateral { lateral: Transfer::new([from, to], device) });
        Self {
            encoder_modules: Encoder {
                bottomup,
                bottomup_top,
                topdown_lateral_modules: sides.collect(),
            },
            decoder_modules: Decoder::new(parts, laterals[0], rest, config.bins, device),
            config: *config,
        }
    }

    /// With the weights of a checkpoint, under the authors' names.
    ///
    /// # Errors
    /// [`NamesError`] names the first that is missing or of another shape.
    pub fn with_weights(weights: &Tensors, device: &Device) -> Result<Self, NamesError> {
        let config = VnlConfig::of(weights).ok_or_else(|| NamesError::Nothing {
            given: weights.len(),
            wanted: PREDICT.to_owned(),
        })?;
        take_all(Self::new(&config, device), &own_names(weights))
    }

    /// What it was built from.
    #[must_use]
    pub const fn config(&self) -> &VnlConfig {
        &self.config
    }

    /// Logits of the classes of depth: `[batch, bins, height, width]`.
    /// `image`: `[batch, 3, height, width]`, normalised, sides multiples of
    /// [`VnlConfig::stride`].
    #[must_use]
    pub fn forward(&self, image: Tensor<4>) -> Tensor<4> {
        let [_, _, height, width] = image.dims();
        let (top, laterals) = self.encoder_modules.forward(image);
        self.decoder_modules.forward(top, laterals, [height, width])
    }
}
