//! The depth network at run time: a frame in, metres out.
//!
//! A [`DepthNet`] letterboxes a frame into the network's input, normalises it, runs
//! the network up to its logits, and does the rest itself: softmax, weighted sum
//! over the bins and exponential in one pass ([`SoftSum`]), then one bilinear
//! resize of the depths (not of the logits, of which there are as many as bins).
//! Engines take several times as long for these steps.
//!
//! # Which depth is right for which camera
//!
//! A picture alone does not tell a near small thing from a far large one: a network
//! learns depth for one focal length ([`DepthCoding::focal`], in pixels of its
//! input). With a [`CameraModel`] the depths are multiplied by the camera's focal
//! length, in pixels of the input after the resize, over the network's. Without
//! one they are left as they are, and are metres only for a camera whose focal
//! length happens to be the network's.
//!
//! # Where this differs from the authors' program
//!
//! Frames are scaled without aliasing ([`Filter::Triangle`]; `Linear` is what they
//! use) and centred between grey bars; they pad 640x480 to a square on top only.
//! Depths of the bars are not part of the map.

mod coding;
pub(crate) mod export;
mod model;
mod resample;
mod soft_sum;
mod weights;

pub use coding::{Alignment, CodingError, DepthCoding, DepthMetadata, DepthMetadataError};
pub use model::{DepthModel, DepthModelError, Detail};
pub use soft_sum::SoftSum;
pub use weights::{DepthImportError, DepthWeights};

use crate::{
    detector::Stage,
    engine::{Engine, EngineChoice, EngineError, Runtime, RuntimeOptions, TensorView},
};
use realnet_core::{CameraModel, DepthMap, DepthMapError, Frame};
use realnet_vision::{Filter, Letterbox, Letterboxer, VisionError};
use resample::{Axis, Resampler};
use std::path::Path;
use thiserror::Error;

/// Size of the depth maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DepthSize {
    /// That of the picture on the network's input, without the bars.
    #[default]
    Network,
    /// That of the frame: a depth for every pixel.
    Frame,
    /// (width, height).
    Fixed(u32, u32),
}

/// How depth is to be computed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DepthOptions {
    /// Input size of the network, (width, height) in pixels; `None` takes the
    /// file's own, or for weights that tell none [`DepthWeights::default_size`].
    pub size: Option<(u32, u32)>,
    /// Which logits of the network.
    pub detail: Detail,
    /// Size of the depth maps. Whatever it is, a map covers the whole frame: its
    /// pixel (x, y) has the centre `(x + 0.5)·W/w − 0.5` of a frame W wide.
    pub output: DepthSize,
    /// How a frame is fitted into the input.
    pub filter: Filter,
}

/// Why a depth network could not be made or failed.
#[derive(Debug, Error)]
pub enum DepthError {
    /// The model file.
    #[error(transparent)]
    Model(#[from] DepthModelError),
    /// The engine.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The picture.
    #[error(transparent)]
    Vision(#[from] VisionError),
    /// The size of the depth map.
    #[error(transparent)]
    Map(#[from] DepthMapError),
    /// The camera is for other pictures.
    #[error(
        "the camera is for pictures of {}x{} pixels, the frame has {}x{}",
        camera.0, camera.1, frame.0, frame.1
    )]
    CameraSize {
        /// Width and height of the camera's pictures.
        camera: (u32, u32),
        /// Width and height of the frame.
        frame: (u32, u32),
    },
    /// The network's output.
    #[error("the depth network returned {found}, expected one tensor [1, bins, h, w] not larger than its input of {}x{}", input.0, input.1)]
    Output {
        /// Names and shapes found.
        found: String,
        /// Width and height of the input.
        input: (u32, u32),
    },
}

/// Predicts depth for frames.
///
/// ```no_run
/// # fn demo(frame: realnet_core::Frame, camera: realnet_core::CameraModel) -> Result<(), Box<dyn std::error::Error>> {
/// use realnet_nn::depth::DepthNet;
///
/// let mut net = DepthNet::open("vnl.safetensors".as_ref())?;
/// let map = net.depth(&frame, Some(&camera))?;
/// println!("{:?} m in the middle", map.at(map.width() / 2, map.height() / 2));
/// # Ok(())
/// # }
/// ```
pub struct DepthNet {
    engine: Box<dyn Engine>,
    letterboxer: Letterboxer,
    metadata: DepthMetadata,
    output: DepthSize,
    sum: SoftSum,
    /// Depths where the network predicts them, for its own focal length or the
    /// camera's.
    samples: Vec<f32>,
    resampler: Resampler,
}

impl DepthNet {
    /// The network in a file, on the embedded engine, with default options.
    ///
    /// # Errors
    /// [`DepthError`] when the file cannot be read or is no depth network.
    pub fn open(path: &Path) -> Result<Self, DepthError> {
        let runtime =
            Runtime::start(&RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() });
        Self::new(&DepthModel::open(path)?, &runtime, &DepthOptions::default())
    }

    /// Loads `model` into an engine of `runtime`.
    ///
    /// # Errors
    /// [`DepthError`] when the model cannot have the asked size, the size of the
    /// output is empty, or the engine refuses the network.
    pub fn new(
        model: &DepthModel,
        runtime: &Runtime,
        options: &DepthOptions,
    ) -> Result<Self, DepthError> {
        if let DepthSize::Fixed(width, height) = options.output
            && (width == 0 || height == 0)
        {
            return Err(DepthMapError::Empty { width, height }.into());
        }
        let (network, metadata) = model.network(options.size, options.detail)?;
        let engine = runtime.load(network)?;
        let (width, height) = engine.input_size();
        Ok(Self {
            letterboxer: Letterboxer::new(width, height, options.filter)?,
            engine,
            sum: SoftSum::new(&metadata.coding, 0),
            metadata,
            output: options.output,
            samples: Vec::new(),
            resampler: Resampler::default(),
        })
    }

    /// The network's input size, (width, height).
    #[must_use]
    pub fn input_size(&self) -> (u32, u32) {
        self.engine.input_size()
    }

    /// What runs the network.
    #[must_use]
    pub fn engine(&self) -> String {
        self.engine.describe()
    }

    /// How the network's numbers are metres.
    #[must_use]
    pub fn coding(&self) -> &DepthCoding {
        &self.metadata.coding
    }

    /// The depth of `frame` in metres, with its stamp; `camera` is the one that
    /// took it, its lens left out of account.
    ///
    /// # Errors
    /// [`DepthError`] when the camera is for other pictures, or the engine fails or
    /// returns what it should not.
    pub fn depth(
        &mut self,
        frame: &Frame,
        camera: Option<&CameraModel>,
    ) -> Result<DepthMap, DepthError> {
        self.depth_marked(frame, camera, Vec::new(), &mut |_| {})
    }

    /// As [`DepthNet::depth`], in the memory of an earlier map
    /// ([`DepthMap::into_data`]), and calls `mark` at the end of each stage, so that
    /// a caller with a clock can time them. Nothing but the engine allocates then,
    /// after the first frame of a size.
    ///
    /// # Errors
    /// As [`DepthNet::depth`].
    pub fn depth_marked(
        &mut self,
        frame: &Frame,
        camera: Option<&CameraModel>,
        memory: Vec<f32>,
        mark: &mut dyn FnMut(Stage),
    ) -> Result<DepthMap, DepthError> {
        let size = (frame.width(), frame.height());
        if let Some(camera) = camera
            && (camera.width(), camera.height()) != size
        {
            let camera = (camera.width(), camera.height());
            return Err(DepthError::CameraSize { camera, frame: size });
        }
        let DepthCoding { mean, std, focal, .. } = self.metadata.coding;
        let input = self.engine.input();
        let letterbox = self.letterboxer.run(frame, None, input)?;
        normalise(input, mean, std);
        mark(Stage::Preprocess);
        let factor = camera.map_or(1.0, |camera| focal_on_input(camera, &letterbox) / focal);
        let grid = self.predict(factor, mark)?;
        let (scaled, input) = (letterbox.scaled_size(), self.engine.input_size());
        let (width, height) = match self.output {
            DepthSize::Network => scaled,
            DepthSize::Frame => size,
            DepthSize::Fixed(width, height) => (width, height),
        };
        let across = Axis {
            samples: grid.0,
            input: input.0,
            start: letterbox.left(),
            length: scaled.0,
            target: width,
        };
        let down = Axis {
            samples: grid.1,
            input: input.1,
            start: letterbox.top(),
            length: scaled.1,
            target: height,
        };
        let mut data = memory;
        data.resize(width as usize * height as usize, DepthMap::UNKNOWN);
        self.resampler.run(self.metadata.alignment, (across, down), &self.samples, &mut data);
        let map = DepthMap::new(frame.stamp(), width, height, data)?;
        mark(Stage::Postprocess);
        Ok(map)
    }

    /// Runs the network on its input and reads its logits into `samples`; returns
    /// the number of samples across and down.
    fn predict(
        &mut self,
        factor: f64,
        mark: &mut dyn FnMut(Stage),
    ) -> Result<(u32, u32), DepthError> {
        let input = self.engine.input_size();
        let (coding, sum, samples) = (&self.metadata.coding, &mut self.sum, &mut self.samples);
        let mut grid = None;
        let mut found = String::new();
        self.engine.run(&mut |outputs| {
            mark(Stage::Infer);
            let Some((bins, width, height, logits)) = as_logits(outputs, input) else {
                let tell = |o: &TensorView<'_>| format!("'{}' {:?}", o.name, o.shape);
                found = outputs.iter().map(tell).collect::<Vec<_>>().join(", ");
                return;
            };
            if sum.bins() != bins {
                *sum = SoftSum::new(coding, bins);
            }
            samples.resize(width as usize * height as usize, DepthMap::UNKNOWN);
            sum.run(logits, factor, samples);
            grid = Some((width, height));
        })?;
        grid.ok_or(DepthError::Output { found, input })
    }
}

/// Bins, width, height and values of an output of logits.
fn as_logits<'a>(
    outputs: &[TensorView<'a>],
    input: (u32, u32),
) -> Option<(usize, u32, u32, &'a [f32])> {
    let &[TensorView { shape: &[1, bins, height, width], data, .. }] = outputs else { return None };
    let (width, height) = (u32::try_from(width).ok()?, u32::try_from(height).ok()?);
    let sides = (1..=input.0).contains(&width) && (1..=input.1).contains(&height);
    let values = bins.checked_mul(width as usize)?.checked_mul(height as usize)?;
    (bins > 0 && sides && values == data.len()).then_some((bins, width, height, data))
}

/// Shares of 255 as the network was trained with them, channel by channel.
fn normalise(input: &mut [f32], mean: [f32; 3], std: [f32; 3]) {
    let plane = input.len() / 3;
    let channels = input.chunks_exact_mut(plane.max(1)).zip(mean.into_iter().zip(std));
    for (plane, (mean, std)) in channels {
        let (scale, shift) = (1.0 / std, -mean / std);
        for value in plane {
            *value = *value * scale + shift;
        }
    }
}

/// The camera's focal length in pixels of the network's input, the geometric mean
/// of both axes.
fn focal_on_input(camera: &CameraModel, letterbox: &Letterbox) -> f64 {
    let (width, height) = letterbox.scaled_size();
    let fx = camera.fx() * f64::from(width) / f64::from(camera.width());
    let fy = camera.fy() * f64::from(height) / f64::from(camera.height());
    (fx * fy).sqrt()
}

impl std::fmt::Debug for DepthNet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DepthNet")
            .field("engine", &self.engine())
            .field("input_size", &self.input_size())
            .field("metadata", &self.metadata)
            .field("output", &self.output)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::{Distortion, Intrinsics, Stamp};

    /// Predicts at every pixel, or at every second, the bin that the red channel
    /// of the pixel says: bin 0 for red 0, the last for red 255.
    struct RedIsFar {
        size: (u32, u32),
        input: Vec<f32>,
        step: usize,
        axes: usize,
    }

    const BINS: usize = 11;

    impl Engine for RedIsFar {
        fn describe(&self) -> String {
            "a test".to_owned()
        }
        fn input_size(&self) -> (u32, u32) {
            self.size
        }
        fn input(&mut self) -> &mut [f32] {
            &mut self.input
        }
        fn run(&mut self, read: &mut dyn FnMut(&[TensorView<'_>])) -> Result<(), EngineError> {
            let (width, height) = (self.size.0 as usize, self.size.1 as usize);
            let coding = DepthCoding::default();
            let mut shape = vec![1, BINS, height.div_ceil(self.step), width.div_ceil(self.step)];
            let mut data = Vec::new();
            for bin in 0..BINS {
                for y in (0..height).step_by(self.step) {
                    for x in (0..width).step_by(self.step) {
                        let red = self.input[y * width + x] * coding.std[0] + coding.mean[0];
                        data.push(-500.0 * (red * (BINS - 1) as f32 - bin as f32).abs());
                    }
                }
            }
            shape.truncate(self.axes);
            read(&[TensorView { name: "logits", shape: &shape, data: &data }]);
            Ok(())
        }
    }

    fn net(size: (u32, u32), step: usize, output: DepthSize) -> DepthNet {
        let input = vec![0.0; 3 * size.0 as usize * size.1 as usize];
        let metadata = DepthMetadata {
            coding: DepthCoding::default(),
            logits: vec!["logits".to_owned()],
            alignment: if step == 1 { Alignment::Corners } else { Alignment::Centres },
            stride: 1,
        };
        DepthNet {
            engine: Box::new(RedIsFar { size, input, step, axes: 4 }),
            letterboxer: Letterboxer::new(size.0, size.1, Filter::default()).unwrap(),
            sum: SoftSum::new(&metadata.coding, 0),
            metadata,
            output,
            samples: Vec::new(),
            resampler: Resampler::default(),
        }
    }

    /// Left of the middle red is 0, right of it 255.
    fn two_halves(width: u32, height: u32) -> Frame {
        let pixel = |x: u32| if x < width / 2 { [0, 90, 30] } else { [255, 90, 30] };
        let row: Vec<u8> = (0..width).flat_map(pixel).collect();
        Frame::rgb8(Stamp::ZERO, width, height, row.repeat(height as usize)).unwrap()
    }

    /// Depths of the first and last bin.
    fn ends() -> [f32; 2] {
        let borders = DepthCoding::default().log_borders(BINS);
        [borders[0], borders[BINS - 1]].map(|border| (border.exp() * 10.0) as f32)
    }

    #[test]
    fn every_depth_is_where_its_pixel_is() {
        let [near, far] = ends();
        // Wide and high frames, with bars above and below or on the sides.
        for (width, height) in [(80, 40), (40, 80), (64, 64)] {
            for (step, input) in [(1, (32, 32)), (2, (32, 32)), (4, (64, 32)), (4, (96, 160))] {
                let mut net = net(input, step, DepthSize::Frame);
                let map = net.depth(&two_halves(width, height), None).unwrap();
                assert_eq!((map.width(), map.height()), (width, height));
                // The edge is two samples wide at most.
                let scale = (f64::from(width) / f64::from(input.0))
                    .max(f64::from(height) / f64::from(input.1));
                let blur = (step as f64 * 2.0 * scale) as u32;
                for y in 0..height {
                    for x in 0..width {
                        let depth = map.at(x, y).unwrap();
                        let expected = if x < width / 2 { near } else { far };
                        let clear = x.abs_diff(width / 2) > blur;
                        let same = (depth / expected - 1.0).abs() < 1e-4;
                        assert!(
                            same || !clear,
                            "{width}x{height} {input:?}/{step} at {x} {y}: {depth}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn the_focal_length_is_that_on_the_input() {
        let frame = two_halves(80, 40);
        let [near, _] = ends();
        let camera = |fx: f64, fy: f64| {
            let intrinsics = Intrinsics { fx, fy, cx: 40.0, cy: 20.0 };
            CameraModel::new(80, 40, intrinsics, Distortion::None).unwrap()
        };
        // 80 pixels become 32.
        for (camera, factor) in [
            (camera(519.0, 519.0), 0.4),
            (camera(519.0 * 2.5, 519.0 * 2.5), 1.0),
            (camera(519.0 * 4.0, 519.0), 0.8),
        ] {
            let mut net = net((32, 32), 1, DepthSize::Network);
            let map = net.depth(&frame, Some(&camera)).unwrap();
            assert_eq!((map.width(), map.height()), (32, 16));
            assert!((map.at(0, 0).unwrap() / near - factor).abs() < 1e-4, "{factor}");
        }
    }

    #[test]
    fn outputs_of_another_shape_are_named() {
        let mut net = net((32, 32), 1, DepthSize::Network);
        let input = vec![0.0; 3 * 32 * 32];
        net.engine = Box::new(RedIsFar { size: (32, 32), input, step: 1, axes: 3 });
        let error = net.depth(&two_halves(32, 32), None).unwrap_err();
        assert!(matches!(error, DepthError::Output { .. }));
        assert!(error.to_string().contains("'logits' [1, 11, 32]"), "{error}");
    }
}
