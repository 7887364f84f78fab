//! The detector that a training begins with: a size by name, or weights.

use super::weights;
use crate::cli::failure::{OrBadInput, bad_input};
use anyhow::{Context, Result};
use burn::{module::Module, tensor::Device};
use realnet::weights::Checkpoint;
use realnet_train::{
    names::{self, Taken},
    nets::{
        Form, YoloV5, YoloV5Config, YoloV5Size,
        yolov5::{ANCHORS, STRIDES},
    },
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What distinguishes the form of older versions.
const FOCUS: &str = "-focus";
/// Bottlenecks of the second layer and channels of the first, by size.
const SHAPES: [(YoloV5Size, &str, usize, usize); 5] = [
    (YoloV5Size::N, "yolov5n", 1, 16),
    (YoloV5Size::S, "yolov5s", 1, 32),
    (YoloV5Size::M, "yolov5m", 2, 48),
    (YoloV5Size::L, "yolov5l", 3, 64),
    (YoloV5Size::X, "yolov5x", 4, 80),
];

/// What a detector was built from, as `args.toml` has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Built {
    /// Size and form, by name.
    model: String,
    /// Classes in order.
    classes: Vec<String>,
    /// Pixels of the network's input, by stride, width and height each.
    anchors: [[[f32; 2]; ANCHORS]; 3],
}

impl Built {
    fn of(config: &YoloV5Config, classes: &[String]) -> Self {
        let name = SHAPES.iter().find(|(size, ..)| *size == config.size);
        let name = name.map_or("", |(_, name, ..)| name);
        let focus = if config.form == Form::V5 { FOCUS } else { "" };
        let model = format!("{name}{focus}");
        Self { model, classes: classes.to_vec(), anchors: config.anchors }
    }

    /// Refuses to go on with other classes.
    pub(super) fn check_classes(&self, classes: &[String]) -> Result<()> {
        if self.classes == classes {
            return Ok(());
        }
        Err(bad_input(format!(
            "the run is for the classes {}; the data now have {}",
            self.classes.join(", "),
            classes.join(", ")
        )))
    }

    /// The same network with random weights, which a checkpoint replaces.
    pub(super) fn network(&self, imgsz: u32, device: &Device) -> Result<YoloV5> {
        let config = named(&self.model, self.classes.len(), imgsz)?;
        Ok(YoloV5::new(&YoloV5Config { anchors: self.anchors, ..config }, device))
    }
}

/// Whether it is the name of a size, not a file.
pub(super) fn is_name(model: &str) -> bool {
    model.strip_suffix(FOCUS).unwrap_or(model).parse::<YoloV5Size>().is_ok()
}

fn named(model: &str, classes: usize, imgsz: u32) -> Result<YoloV5Config> {
    let size = model.strip_suffix(FOCUS).unwrap_or(model).parse().or_bad_input()?;
    let form = if model.ends_with(FOCUS) { Form::V5 } else { Form::V6 };
    Ok(YoloV5Config { form, ..YoloV5Config::new(size, classes, imgsz as usize) })
}

/// A network to begin with, before its data are known.
pub(super) struct Start {
    /// What it is to be built from; anchors may still change.
    pub(super) config: YoloV5Config,
    weights: Option<(PathBuf, Checkpoint)>,
}

impl Start {
    /// A size by name, with the weights of a file or without; or the network of a file.
    pub(super) fn open(
        model: &str,
        weights: Option<&Path>,
        classes: usize,
        imgsz: u32,
    ) -> Result<Self> {
        let by_name = is_name(model);
        let file = match weights {
            Some(_) if !by_name => {
                return Err(bad_input(
                    "--weights is for a --model by name; weights as --model are enough",
                ));
            }
            Some(path) => Some(path),
            None if by_name => None,
            None => Some(Path::new(model)),
        };
        let Some(path) = file else {
            return Ok(Self { config: named(model, classes, imgsz)?, weights: None });
        };
        let name = || path.display().to_string();
        if !path.exists() && !by_name {
            return Err(bad_input(format!(
                "{model}: no such file, and not one of yolov5n, s, m, l, x, with or without \
                 {FOCUS}"
            )));
        }
        let checkpoint = Checkpoint::read(path).with_context(name).or_bad_input()?;
        let mut config = if by_name {
            named(model, classes, imgsz)?
        } else {
            recognised(&checkpoint, classes, imgsz).with_context(name).or_bad_input()?
        };
        if let Some(anchors) = anchors(&checkpoint) {
            config.anchors = anchors;
        }
        Ok(Self { config, weights: Some((path.to_owned(), checkpoint)) })
    }

    /// The network; and what it is and where its weights come from, for people.
    pub(super) fn network(
        &self,
        classes: &[String],
        device: &Device,
    ) -> Result<(YoloV5, Built, Vec<String>)> {
        let mut network = YoloV5::new(&self.config, device);
        let built = Built::of(&self.config, classes);
        let parameters = network.num_params() as f64 / 1e6;
        let mut words = vec![format!("{}: {parameters:.2} million parameters", built.model)];
        match &self.weights {
            Some((path, checkpoint)) => {
                let name = || path.display().to_string();
                let (loaded, taken) =
                    names::take(network, &checkpoint.tensors).with_context(name).or_bad_input()?;
                network = loaded;
                words.extend(told(path, checkpoint, &taken, classes));
            }
            None => words.push("weights: random".to_owned()),
        }
        Ok((network, built, words))
    }
}

/// What became of the weights of a file, and whose classes are whose.
fn told(path: &Path, checkpoint: &Checkpoint, taken: &Taken, classes: &[String]) -> Vec<String> {
    let mut words = weights::told(path, taken);
    if let Some(names) = &checkpoint.class_names
        && names != classes
    {
        let heads = if names.len() == classes.len() {
            "as many: the heads are kept"
        } else {
            "another number: the heads start at random"
        };
        let (file, data) = (names.len(), classes.len());
        words.push(format!("  classes: the file has {file}, the data {data} ({heads})"));
    }
    words
}

/// The network of a file, by the shapes of its tensors.
fn recognised(checkpoint: &Checkpoint, classes: usize, imgsz: u32) -> Result<YoloV5Config> {
    let shape = |name: &str| checkpoint.tensors.get(name).map(realnet::weights::Tensor::shape);
    let (form, channels) = match (shape("model.0.conv.weight"), shape("model.0.conv.conv.weight")) {
        (Some([channels, 3, 6, 6]), _) => (Form::V6, *channels),
        (_, Some([channels, 12, 3, 3])) => (Form::V5, *channels),
        (Some(other), _) | (None, Some(other)) => {
            return Err(bad_input(format!(
                "the first convolution has shape {other:?}: neither a YOLOv5 of version 6 \
                     ([c, 3, 6, 6]) nor one with Focus ([c, 12, 3, 3])"
            )));
        }
        (None, None) => return Err(bad_input("no YOLOv5: there is no model.0.conv.weight")),
    };
    let blocks =
        (0..).take_while(|i| shape(&format!("model.2.m.{i}.cv1.conv.weight")).is_some()).count();
    let size = SHAPES.iter().find(|(.., b, c)| (*b, *c) == (blocks, channels));
    let Some((size, ..)) = size else {
        return Err(bad_input(format!(
            "{channels} channels and {blocks} bottlenecks at the start are no YOLOv5 n, s, m, l \
             or x"
        )));
    };
    if shape("model.24.m.0.weight").is_none() {
        return Err(bad_input(
            "no detector of three scales: there is no model.24.m.0.weight (networks of four \
             scales, P6, cannot be trained here)",
        ));
    }
    Ok(YoloV5Config { form, ..YoloV5Config::new(*size, classes, imgsz as usize) })
}

/// The anchors of a file in pixels; it has them in cells.
fn anchors(checkpoint: &Checkpoint) -> Option<[[[f32; 2]; ANCHORS]; 3]> {
    let tensor = checkpoint.tensors.get("model.24.anchors")?;
    let good = tensor.shape() == [3, ANCHORS, 2]
        && tensor.data().iter().all(|side| side.is_finite() && *side > 0.0);
    let mut numbers = tensor.data().iter();
    let mut pixels = |stride: usize| Some(numbers.next()? * stride as f32);
    let mut found = [[[0.0; 2]; ANCHORS]; 3];
    for (level, stride) in found.iter_mut().zip(STRIDES) {
        for side in level.iter_mut().flatten() {
            *side = pixels(stride)?;
        }
    }
    good.then_some(found)
}
