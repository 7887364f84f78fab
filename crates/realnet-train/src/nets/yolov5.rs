//! YOLOv5 as its authors' configuration files describe it.

use super::block::{Activation, ConvBlock, Kernel, Normalisation, convolution, doubled};
use burn::module::{Module, Param};
use burn::nn::conv::Conv2d;
use burn::tensor::module::max_pool2d;
use burn::tensor::ops::MaxPoolOptions;
use burn::tensor::{Device, Tensor, TensorData};
use std::str::FromStr;
use thiserror::Error;

/// Anchors a scale.
pub const ANCHORS: usize = 3;
/// Pixels of the input a cell of each scale.
pub const STRIDES: [usize; 3] = [8, 16, 32];
/// Anchors in pixels of a 640x640 input, by scale: width, height. From COCO.
pub const COCO_ANCHORS: [[[f32; 2]; ANCHORS]; 3] = [
    [[10.0, 13.0], [16.0, 30.0], [33.0, 23.0]],
    [[30.0, 61.0], [62.0, 45.0], [59.0, 119.0]],
    [[116.0, 90.0], [156.0, 198.0], [373.0, 326.0]],
];

/// How deep and wide a YOLOv5 is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum YoloV5Size {
    /// Nano.
    N,
    /// Small.
    S,
    /// Medium.
    M,
    /// Large.
    L,
    /// Extra large.
    X,
}

/// A size that is none.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("'{0}' is no YOLOv5: yolov5n, yolov5s, yolov5m, yolov5l, yolov5x")]
pub struct UnknownSize(String);

impl FromStr for YoloV5Size {
    type Err = UnknownSize;

    fn from_str(text: &str) -> Result<Self, UnknownSize> {
        Ok(match text {
            "yolov5n" => Self::N,
            "yolov5s" => Self::S,
            "yolov5m" => Self::M,
            "yolov5l" => Self::L,
            "yolov5x" => Self::X,
            other => return Err(UnknownSize(other.to_owned())),
        })
    }
}

impl YoloV5Size {
    /// Factors of the numbers of blocks and of the channels.
    #[must_use]
    pub const fn multiples(self) -> (f64, f64) {
        match self {
            Self::N => (0.33, 0.25),
            Self::S => (0.33, 0.50),
            Self::M => (0.67, 0.75),
            Self::L => (1.0, 1.0),
            Self::X => (1.33, 1.25),
        }
    }

    /// Bottlenecks where the large network has `blocks`.
    fn depth(self, blocks: usize) -> usize {
        ((blocks as f64 * self.multiples().0).round_ties_even() as usize).max(1)
    }

    /// Channels where the large network has `channels`.
    fn width(self, channels: usize) -> usize {
        (channels as f64 * self.multiples().1 / 8.0).ceil() as usize * 8
    }
}

/// The form of the first layers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// Version 6 and 7: a convolution of 6x6 pixels, pooling (SPPF) last.
    #[default]
    V6,
    /// Up to version 5: Focus (every second pixel into channels), pooling (SPP) before the
    /// last C3.
    V5,
}

/// What a network is built from.
#[derive(Clone, Debug, PartialEq)]
pub struct YoloV5Config {
    /// Depth and width.
    pub size: YoloV5Size,
    /// The form of the first layers.
    pub form: Form,
    /// Number of classes.
    pub classes: usize,
    /// Width and height of the anchors of each scale, pixels of the network's input.
    pub anchors: [[[f32; 2]; ANCHORS]; 3],
}

impl YoloV5Config {
    /// Version 6 with the anchors of COCO scaled to an input of `input` pixels.
    #[must_use]
    pub fn new(size: YoloV5Size, classes: usize, input: usize) -> Self {
        let scale = input as f32 / 640.0;
        let anchors = COCO_ANCHORS.map(|level| level.map(|anchor| anchor.map(|x| x * scale)));
        Self { size, form: Form::V6, classes, anchors }
    }

    /// Numbers a cell and anchor: box, objectness, classes.
    #[must_use]
    pub const fn outputs(&self) -> usize {
        5 + self.classes
    }
}

fn conv(channels: [usize; 2], kernel: Kernel, device: &Device) -> ConvBlock {
    ConvBlock::new(channels, kernel, Normalisation::YOLOV5, Activation::Silu, device)
}

#[derive(Module, Debug)]
struct Bottleneck {
    cv1: ConvBlock,
    cv2: ConvBlock,
    add: bool,
}

impl Bottleneck {
    fn new(channels: usize, add: bool, device: &Device) -> Self {
        Self {
            cv1: conv([channels, channels], Kernel::POINT, device),
            cv2: conv([channels, channels], Kernel::THREE, device),
            add,
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = self.cv2.forward(self.cv1.forward(x.clone()));
        if self.add { x + y } else { y }
    }
}

/// Two branches, one through bottlenecks, joined (cross stage partial, Wang et al., 2020).
#[derive(Module, Debug)]
struct C3 {
    cv1: ConvBlock,
    cv2: ConvBlock,
    cv3: ConvBlock,
    m: Vec<Bottleneck>,
}

impl C3 {
    fn new([from, to]: [usize; 2], blocks: usize, add: bool, device: &Device) -> Self {
        let half = to / 2;
        Self {
            cv1: conv([from, half], Kernel::POINT, device),
            cv2: conv([from, half], Kernel::POINT, device),
            cv3: conv([2 * half, to], Kernel::POINT, device),
            m: (0..blocks).map(|_| Bottleneck::new(half, add, device)).collect(),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let deep = self.m.iter().fold(self.cv1.forward(x.clone()), |y, block| block.forward(y));
        self.cv3.forward(Tensor::cat(vec![deep, self.cv2.forward(x)], 1))
    }
}

/// Pooling over 5, 9 and 13 pixels: SPPF does it one after the other, SPP side by side; the
/// numbers are the same.
#[derive(Module, Debug)]
struct Spp {
    cv1: ConvBlock,
    cv2: ConvBlock,
}

impl Spp {
    fn new([from, to]: [usize; 2], device: &Device) -> Self {
        let half = from / 2;
        Self {
            cv1: conv([from, half], Kernel::POINT, device),
            cv2: conv([4 * half, to], Kernel::POINT, device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let pool = |x: Tensor<4>| {
            let options = MaxPoolOptions::new([5, 5]);
            max_pool2d(x, options.with_stride([1, 1]).with_padding([2, 2]))
        };
        let x = self.cv1.forward(x);
        let a = pool(x.clone());
        let b = pool(a.clone());
        let c = pool(b.clone());
        self.cv2.forward(Tensor::cat(vec![x, a, b, c], 1))
    }
}

/// Every second pixel of both directions into channels, and a convolution.
#[derive(Module, Debug)]
struct Focus {
    conv: ConvBlock,
}

impl Focus {
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let [batch, channels, height, width] = x.dims();
        let (h, w) = (height / 2, width / 2);
        // Channels in the order (0, 0), (1, 0), (0, 1), (1, 1) of (row, column).
        let x = x.reshape([batch, channels, h, 2, w, 2]).permute([0, 5, 3, 1, 2, 4]);
        self.conv.forward(x.reshape([batch, 4 * channels, h, w]))
    }
}

/// YOLOv5. Layers are numbered as in its configuration files, so that
/// [`named`](crate::names) gives its parameters the names of its authors' files.
#[derive(Module, Debug)]
pub struct YoloV5 {
    l0: Option<ConvBlock>,
    l0f: Option<Focus>,
    l1: ConvBlock,
    l2: C3,
    l3: ConvBlock,
    l4: C3,
    l5: ConvBlock,
    l6: C3,
    l7: ConvBlock,
    l8c: Option<C3>,
    l8s: Option<Spp>,
    l9c: Option<C3>,
    l9s: Option<Spp>,
    l10: ConvBlock,
    l13: C3,
    l14: ConvBlock,
    l17: C3,
    l18: ConvBlock,
    l20: C3,
    l21: ConvBlock,
    l23: C3,
    l24: Detect,
    #[module(skip)]
    config: YoloV5Config,
}

/// The three heads: 1x1 convolutions.
#[derive(Module, Debug)]
struct Detect {
    m: Vec<Conv2d>,
}

impl YoloV5 {
    /// Random weights: PyTorch's initialisation, and biases of the heads that expect 8 objects
    /// a 640x640 picture and classes seldom (as in the reference implementation, after
    /// section 3.3 of Lin et al., "Focal Loss", 2017).
    #[must_use]
    pub fn new(config: &YoloV5Config, device: &Device) -> Self {
        let size = config.size;
        let [c64, c128, c256, c512, c1024] = [64, 128, 256, 512, 1024].map(|c| size.width(c));
        let one = |from, to| conv([from, to], Kernel::POINT, device);
        let halve = |from, to| conv([from, to], Kernel::HALVE, device);
        let c3 = |from, to, n, add| C3::new([from, to], size.depth(n), add, device);
        let v6 = config.form == Form::V6;
        let spp = |from, to| Spp::new([from, to], device);
        let heads = [c256, c512, c1024].into_iter().zip(STRIDES).map(|(channels, stride)| {
            let outputs = config.outputs();
            let mut head: Conv2d =
                convolution([channels, ANCHORS * outputs], Kernel::POINT).init(device);
            head.bias = head.bias.take().map(|bias| expect_little(bias, outputs, stride));
            head
        });
        Self {
            l0: v6.then(|| conv([3, c64], Kernel { size: 6, stride: 2, padding: 2 }, device)),
            l0f: (!v6).then(|| Focus { conv: conv([12, c64], Kernel::THREE, device) }),
            l1: halve(c64, c128),
            l2: c3(c128, c128, 3, true),
            l3: halve(c128, c256),
            l4: c3(c256, c256, if v6 { 6 } else { 9 }, true),
            l5: halve(c256, c512),
            l6: c3(c512, c512, 9, true),
            l7: halve(c512, c1024),
            l8c: v6.then(|| c3(c1024, c1024, 3, true)),
            l8s: (!v6).then(|| spp(c1024, c1024)),
            l9c: (!v6).then(|| c3(c1024, c1024, 3, false)),
            l9s: v6.then(|| spp(c1024, c1024)),
            l10: one(c1024, c512),
            l13: c3(c1024, c512, 3, false),
            l14: one(c512, c256),
            l17: c3(c512, c256, 3, false),
            l18: halve(c256, c256),
            l20: c3(c512, c512, 3, false),
            l21: halve(c512, c512),
            l23: c3(c1024, c1024, 3, false),
            l24: Detect { m: heads.collect() },
            config: config.clone(),
        }
    }

    /// What it was built from.
    #[must_use]
    pub const fn config(&self) -> &YoloV5Config {
        &self.config
    }

    /// The heads before any decoding, of strides 8, 16 and 32:
    /// `[batch, anchors · (5 + classes), height / stride, width / stride]`.
    /// `image`: `[batch, 3, height, width]`, RGB from 0 to 1, sides multiples of 32.
    #[must_use]
    pub fn forward(&self, image: Tensor<4>) -> [Tensor<4>; 3] {
        let x = match (&self.l0, &self.l0f) {
            (Some(conv), _) => conv.forward(image),
            (None, Some(focus)) => focus.forward(image),
            (None, None) => image,
        };
        let x = self.l2.forward(self.l1.forward(x));
        let p3 = self.l4.forward(self.l3.forward(x));
        let p4 = self.l6.forward(self.l5.forward(p3.clone()));
        let mut p5 = self.l7.forward(p4.clone());
        if let (Some(c3), Some(spp)) = (&self.l8c, &self.l9s) {
            p5 = spp.forward(c3.forward(p5));
        } else if let (Some(spp), Some(c3)) = (&self.l8s, &self.l9c) {
            p5 = c3.forward(spp.forward(p5));
        }
        let join = |a, b| Tensor::cat(vec![a, b], 1);
        let n10 = self.l10.forward(p5);
        let x = self.l13.forward(join(doubled(n10.clone()), p4));
        let n14 = self.l14.forward(x);
        let n17 = self.l17.forward(join(doubled(n14.clone()), p3));
        let n20 = self.l20.forward(join(self.l18.forward(n17.clone()), n14));
        let n23 = self.l23.forward(join(self.l21.forward(n20.clone()), n10));
        let mut heads = self.l24.m.iter();
        [n17, n20, n23].map(|x| match heads.next() {
            Some(head) => head.forward(x),
            None => x,
        })
    }
}

/// Adds to a head's bias what objectness and classes are before anything is learned.
fn expect_little(bias: Param<Tensor<1>>, outputs: usize, stride: usize) -> Param<Tensor<1>> {
    let cells = (640.0 / stride as f32).powi(2);
    let objectness = (8.0 / cells).ln();
    let class = (0.6 / ((outputs - 5) as f32 - 0.99999)).ln();
    let offsets: Vec<f32> = (0..ANCHORS * outputs)
        .map(|i| match i % outputs {
            0..4 => 0.0,
            4 => objectness,
            _ => class,
        })
        .collect();
    let bias = bias.val();
    let offsets = TensorData::new(offsets, [ANCHORS * outputs]);
    let offsets = Tensor::<1>::from_data(offsets, &bias.device());
    // A parameter of its own: a mapped one would be the result of a sum, not what is learned.
    Param::from_tensor((bias + offsets).detach())
}
