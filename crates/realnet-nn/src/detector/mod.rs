//! The detector: a frame in, boxes out.
//!
//! A [`Detector`] letterboxes a frame into the network's input, runs it, decodes
//! what comes out and suppresses doubles. For YOLOv5 it asks the engine for the
//! raw head tensors and decodes only the cells whose objectness passes, so the
//! decoding tail of the graph never runs.

mod decode;
mod model;
mod nms;

pub use decode::OutputShapeError;
pub use model::{DetectorModel, ModelError};

use crate::engine::{Engine, EngineChoice, EngineError, Runtime, RuntimeOptions};
use decode::{Candidate, Decoder};
use realnet_core::{BoundingBox, Detection, Frame};
use realnet_vision::{Filter, Letterbox, Letterboxer, Region, VisionError};
use std::path::Path;
use thiserror::Error;

/// What to look for and how strictly.
#[derive(Clone, Debug, PartialEq)]
pub struct DetectorOptions {
    /// Input size of the network, (width, height) in pixels; `None` takes the
    /// file's own, or 640x640 for weights that have none.
    pub size: Option<(u32, u32)>,
    /// Input size of a second network for [`Detector::detect_near`]; `None` looks
    /// at crops with the first one.
    pub region_size: Option<(u32, u32)>,
    /// How a frame is fitted into the input.
    pub filter: Filter,
    /// Least confidence, 0 to 1.
    pub confidence: f32,
    /// Boxes of one class that overlap by more than this are doubles, 0 to 1.
    pub iou: f32,
    /// Most boxes a frame.
    pub max_det: usize,
    /// Least width and height of a box, in pixels of the frame.
    pub min_size: f32,
    /// Only these classes; empty means all.
    pub classes: Vec<u32>,
    /// Doubles are looked for across classes.
    pub agnostic: bool,
    /// A box may have several classes (for evaluation).
    pub multi_label: bool,
}

impl Default for DetectorOptions {
    fn default() -> Self {
        Self {
            size: None,
            region_size: None,
            filter: Filter::default(),
            confidence: 0.25,
            iou: 0.45,
            max_det: 300,
            min_size: 0.0,
            classes: Vec::new(),
            agnostic: false,
            multi_label: false,
        }
    }
}

/// An option outside its range.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("{name} must be {range}, found {value}")]
pub struct OptionError {
    /// Name of the option.
    pub name: &'static str,
    /// What is allowed.
    pub range: &'static str,
    /// What was given.
    pub value: f32,
}

/// Why a detector could not be made or failed.
#[derive(Debug, Error)]
pub enum DetectError {
    /// The model file.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The engine.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The picture.
    #[error(transparent)]
    Vision(#[from] VisionError),
    /// The network's output.
    #[error(transparent)]
    Output(#[from] OutputShapeError),
    /// The options.
    #[error(transparent)]
    Option(#[from] OptionError),
}

/// A stage of one detection, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The frame is in the network's input.
    Preprocess,
    /// The network has run.
    Infer,
    /// Boxes are decoded and doubles gone.
    Postprocess,
}

/// A network at one input size with its letterboxer.
struct Looker {
    engine: Box<dyn Engine>,
    letterboxer: Letterboxer,
    decoder: Decoder,
}

impl Looker {
    fn new(
        model: &DetectorModel,
        runtime: &Runtime,
        size: Option<(u32, u32)>,
        options: &DetectorOptions,
    ) -> Result<Self, DetectError> {
        let (network, layout) = model.network(size)?;
        let engine = runtime.load(network)?;
        let (width, height) = engine.input_size();
        Ok(Self {
            letterboxer: Letterboxer::new(width, height, options.filter)?,
            engine,
            decoder: Decoder {
                layout,
                classes: model.names().len(),
                threshold: options.confidence,
                multi_label: options.multi_label,
            },
        })
    }

    fn look(
        &mut self,
        frame: &Frame,
        region: Option<Region>,
        candidates: &mut Vec<Candidate>,
        mark: &mut dyn FnMut(Stage),
    ) -> Result<Letterbox, DetectError> {
        let letterbox = self.letterboxer.run(frame, region, self.engine.input())?;
        mark(Stage::Preprocess);
        candidates.clear();
        let (decoder, mut decoded) = (&self.decoder, Ok(()));
        self.engine.run(&mut |outputs| {
            mark(Stage::Infer);
            decoded = decoder.decode(outputs, candidates);
        })?;
        decoded?;
        Ok(letterbox)
    }
}

/// Finds objects in frames.
///
/// ```no_run
/// # fn demo(frame: realnet_core::Frame) -> Result<(), Box<dyn std::error::Error>> {
/// use realnet_nn::detector::{Detector, DetectorModel, DetectorOptions};
/// use realnet_nn::engine::{Runtime, RuntimeOptions};
///
/// let model = DetectorModel::open("yolov5n.pt".as_ref())?;
/// let runtime = Runtime::start(&RuntimeOptions::default());
/// let mut detector = Detector::new(model, &runtime, DetectorOptions::default())?;
/// for found in detector.detect(&frame)? {
///     println!("{:?}", found);
/// }
/// # Ok(())
/// # }
/// ```
pub struct Detector {
    names: Vec<String>,
    options: DetectorOptions,
    whole: Looker,
    /// The same network at a smaller size, for crops.
    near: Option<Looker>,
    candidates: Vec<Candidate>,
    detections: Vec<Detection>,
}

impl Detector {
    /// The detector in a file, on the embedded engine, with default options.
    ///
    /// # Errors
    /// [`DetectError`] when the file cannot be read or is no detector.
    pub fn open(path: &Path) -> Result<Self, DetectError> {
        let runtime =
            Runtime::start(&RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() });
        Self::new(DetectorModel::open(path)?, &runtime, DetectorOptions::default())
    }

    /// Loads `model` into an engine of `runtime`.
    ///
    /// # Errors
    /// [`DetectError`] when an option is out of range, the model cannot have the
    /// asked size, or the engine refuses it.
    pub fn new(
        model: DetectorModel,
        runtime: &Runtime,
        options: DetectorOptions,
    ) -> Result<Self, DetectError> {
        for (name, value) in [("confidence", options.confidence), ("iou", options.iou)] {
            if !(0.0..=1.0).contains(&value) {
                return Err(OptionError { name, range: "from 0 to 1", value }.into());
            }
        }
        if options.min_size.is_nan() || options.min_size < 0.0 {
            let value = options.min_size;
            return Err(OptionError { name: "min_size", range: "0 or more", value }.into());
        }
        if let Some(class) = options.classes.iter().find(|c| **c as usize >= model.names().len()) {
            let value = *class as f32;
            return Err(OptionError { name: "class", range: "one of the model's", value }.into());
        }
        let near = match options.region_size {
            Some(size) if model.is_resizable() => {
                Some(Looker::new(&model, runtime, Some(size), &options)?)
            }
            _ => None,
        };
        let whole = Looker::new(&model, runtime, options.size, &options)?;
        let (candidates, detections) = (Vec::new(), Vec::new());
        Ok(Self { names: model.into_names(), options, whole, near, candidates, detections })
    }

    /// The class names, by class id.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Name of a class; empty for an id that the model does not have.
    #[must_use]
    pub fn name(&self, class_id: u32) -> &str {
        self.names().get(class_id as usize).map_or("", String::as_str)
    }

    /// The network's input size, (width, height).
    #[must_use]
    pub fn input_size(&self) -> (u32, u32) {
        self.whole.engine.input_size()
    }

    /// What runs the network.
    #[must_use]
    pub fn engine(&self) -> String {
        self.whole.engine.describe()
    }

    /// All objects in `frame`, most confident first, in pixels of the frame.
    ///
    /// # Errors
    /// [`DetectError`] when the engine fails or returns what it should not.
    pub fn detect(&mut self, frame: &Frame) -> Result<&[Detection], DetectError> {
        self.detect_marked(frame, &mut |_| {})
    }

    /// As [`Detector::detect`], and calls `mark` at the end of each stage, so that
    /// a caller with a clock can time them.
    ///
    /// # Errors
    /// As [`Detector::detect`].
    pub fn detect_marked(
        &mut self,
        frame: &Frame,
        mark: &mut dyn FnMut(Stage),
    ) -> Result<&[Detection], DetectError> {
        let letterbox = self.whole.look(frame, None, &mut self.candidates, mark)?;
        self.finish(&letterbox, mark);
        Ok(&self.detections)
    }

    /// Objects near `around` only: the network looks at a square crop, twice the
    /// longer side of the box and centred on it, at the smaller
    /// `region_size`. Much faster than the whole frame, and
    /// sharper for small targets. Boxes are in pixels of the whole frame.
    ///
    /// An ONNX file of fixed size and without RealNet's metadata keeps its own
    /// size, as does a detector without a [`DetectorOptions::region_size`].
    ///
    /// # Errors
    /// As [`Detector::detect`].
    pub fn detect_near(
        &mut self,
        frame: &Frame,
        around: &BoundingBox,
    ) -> Result<&[Detection], DetectError> {
        self.detect_near_marked(frame, around, &mut |_| {})
    }

    /// As [`Detector::detect_near`], with marks as in [`Detector::detect_marked`].
    ///
    /// # Errors
    /// As [`Detector::detect_near`].
    pub fn detect_near_marked(
        &mut self,
        frame: &Frame,
        around: &BoundingBox,
        mark: &mut dyn FnMut(Stage),
    ) -> Result<&[Detection], DetectError> {
        let near = self.near.as_mut().unwrap_or(&mut self.whole);
        let region = crop_around(frame, around, near.engine.input_size());
        let letterbox = near.look(frame, Some(region), &mut self.candidates, mark)?;
        self.finish(&letterbox, mark);
        Ok(&self.detections)
    }

    /// From candidates to detections.
    fn finish(&mut self, letterbox: &Letterbox, mark: &mut dyn FnMut(Stage)) {
        let options = &self.options;
        if !options.classes.is_empty() {
            self.candidates.retain(|c| options.classes.contains(&c.class_id));
        }
        // Before the doubles are looked for: what is too small must not take a place.
        self.candidates.retain(|candidate| {
            let bbox = letterbox.frame_from_input(&candidate.bbox);
            bbox.is_proper() && bbox.width().min(bbox.height()) >= options.min_size
        });
        nms::suppress(&mut self.candidates, options.iou, options.agnostic, options.max_det);
        self.detections.clear();
        self.detections.extend(self.candidates.iter().map(|candidate| {
            let Candidate { bbox, confidence, class_id } = *candidate;
            Detection { class_id, confidence, bbox: letterbox.frame_from_input(&bbox) }
        }));
        mark(Stage::Postprocess);
    }
}

impl std::fmt::Debug for Detector {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Detector")
            .field("engine", &self.engine())
            .field("input_size", &self.input_size())
            .field("classes", &self.names().len())
            .field("options", &self.options)
            .finish_non_exhaustive()
    }
}

/// The square to look at for a target that was last seen at `around`: twice its
/// longer side, at least the network's input (a smaller crop would only be blown
/// up), moved and cut to lie inside the frame.
fn crop_around(frame: &Frame, around: &BoundingBox, input: (u32, u32)) -> Region {
    let least = input.0.min(input.1) as f32;
    let side = (2.0 * around.width().max(around.height())).max(least);
    let (cx, cy) = around.center();
    let axis = |center: f32, limit: u32| {
        let length = (side.round() as u32).clamp(1, limit);
        let start = (center - length as f32 / 2.0).round().max(0.0) as u32;
        (start.min(limit - length), length)
    };
    let ((x, width), (y, height)) = (axis(cx, frame.width()), axis(cy, frame.height()));
    Region { x, y, width, height }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realnet_core::Stamp;

    proptest! {
        /// Whatever the box, the crop lies inside the frame; a box that does, and
        /// is small enough, lies inside the crop.
        #[test]
        fn crops_stay_inside(
            (w, h) in (1u32..800, 1u32..800),
            (x, y) in (-2000.0f32..2000.0, -2000.0f32..2000.0),
            (bw, bh) in (0.0f32..900.0, 0.0f32..900.0),
        ) {
            let frame =
                Frame::grey8(Stamp::ZERO, w, h, vec![0; w as usize * h as usize]).unwrap();
            let b = BoundingBox::from_corner(x, y, bw, bh);
            let r = crop_around(&frame, &b, (192, 192));
            prop_assert!(r.width > 0 && r.height > 0);
            prop_assert!(r.x + r.width <= w && r.y + r.height <= h);
            let inside = x >= 0.0 && y >= 0.0 && b.x1 <= w as f32 && b.y1 <= h as f32;
            if inside {
                prop_assert!(r.x as f32 <= b.x0 + 1.0 && (r.x + r.width) as f32 >= b.x1 - 1.0);
                prop_assert!(r.y as f32 <= b.y0 + 1.0 && (r.y + r.height) as f32 >= b.y1 - 1.0);
            }
        }
    }

    #[test]
    fn not_a_number_does_not_panic() {
        let frame = Frame::grey8(Stamp::ZERO, 8, 8, vec![0; 64]).unwrap();
        let nan = BoundingBox::new(f32::NAN, 0.0, f32::INFINITY, 1.0);
        let r = crop_around(&frame, &nan, (4, 4));
        assert!(r.x + r.width <= 8 && r.y + r.height <= 8);
    }
}
