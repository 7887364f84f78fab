//! `realnet train detect`.

use super::{
    augment,
    console::Console,
    data::{self, first},
    folder,
    given::{Defaults, Given},
    opened::Opened,
    options::{LearnArgs, RunArgs, check},
    recipe,
    session::{Learning, Session, going_on},
    start::{Built, Start, is_name},
};
use crate::cli::{
    failure::{OrBadInput, Outcome, bad_input, say},
    interrupt,
};
use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use realnet::{
    EngineChoice, Frame, Runtime, RuntimeOptions, datasets::YoloDataset, onnx::OnnxOptions,
    picture, weights::Checkpoint,
};
use realnet_data::{
    DetectionAugment, DetectionSamples, DetectionSet, Failure, Loader, SheetOptions,
    detection_sheet,
};
use realnet_train::{
    anchors::{self, AnchorFit, AnchorSearch, Anchors},
    export::{detector_checkpoint, detector_onnx, safetensors},
    loss::{BoxLoss, DetectionLoss, DetectionLossOptions},
    nets::YoloV5,
    tasks::DetectionTask,
    trainer::Trainer,
};
use serde::{Deserialize, Serialize};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

const TASK: &str = "detect";
/// Where it goes when nothing else is said.
const OUT: &str = "runs/detect";
/// Most samples of the picture of the first batch.
const BATCH_SHOWN: usize = 16;
/// The network halves its input five times.
const STEP: u32 = 32;

#[derive(Debug, Args)]
pub(crate) struct DetectArgs {
    #[command(flatten)]
    settings: DetectSettings,
    #[command(flatten)]
    run: RunArgs,
}

/// All that decides the result, but for the augmentation.
#[derive(Clone, Debug, PartialEq, Args, Serialize, Deserialize)]
struct DetectSettings {
    /// A YOLO data.yaml with train and val.
    #[arg(long, value_name = "FILE")]
    data: Option<PathBuf>,
    /// yolov5n, s, m, l or x, with -focus for the form before version 6; or weights (.pt,
    /// .safetensors) to train on from.
    #[arg(long, value_name = "NAME|FILE", default_value = "yolov5n")]
    model: String,
    /// Weights for a --model by name; what does not fit starts at random.
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Side of the network's input, pixels.
    #[arg(long, value_name = "N", default_value_t = 640)]
    imgsz: u32,
    /// Anchors: fitted to the data where those of the network do not fit, or kept.
    #[arg(long, value_enum, default_value_t = AnchorsFlag::Auto)]
    anchors: AnchorsFlag,
    /// Only these classes are learned; what else is labelled is background.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    classes: Option<Vec<String>>,
    /// Everything that is labelled (of --classes) is one class of this name.
    #[arg(long, value_name = "NAME")]
    single_cls: Option<String>,
    /// No mosaics in the last epochs: pictures as they really are.
    #[arg(long, value_name = "EPOCHS", default_value_t = 15)]
    close_mosaic: usize,
    #[command(flatten)]
    #[serde(flatten)]
    loss: LossArgs,
    #[command(flatten)]
    #[serde(flatten)]
    learn: LearnArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum AnchorsFlag {
    Auto,
    Keep,
}

#[derive(Clone, Debug, PartialEq, Args, Serialize, Deserialize)]
#[command(next_help_heading = "Loss")]
struct LossArgs {
    /// The loss of boxes.
    #[arg(long, value_enum, default_value_t = BoxFlag::Giou)]
    box_loss: BoxFlag,
    /// Weight of the boxes.
    #[arg(long, value_name = "GAIN", default_value_t = 0.05)]
    box_gain: f64,
    /// Weight of the objectness, for an input of 640 pixels.
    #[arg(long, value_name = "GAIN", default_value_t = 1.0)]
    obj_gain: f64,
    /// Weight of the classes, for 80 of them.
    #[arg(long, value_name = "GAIN", default_value_t = 0.5)]
    cls_gain: f64,
    /// An anchor is for boxes whose sides differ from its own by less than this factor.
    #[arg(long, value_name = "FACTOR", default_value_t = 4.0)]
    anchor_t: f64,
    /// Share of certainty that is taken from classes.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    label_smoothing: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum BoxFlag {
    Giou,
    Iou,
    Diou,
    Ciou,
    /// The first YOLO's squared error, for comparison.
    Squared,
}

impl Defaults for DetectArgs {
    const DEFAULTS: &'static [(&'static str, &'static str)] = &[];
}

impl LossArgs {
    fn options(&self) -> DetectionLossOptions {
        DetectionLossOptions {
            boxes: match self.box_loss {
                BoxFlag::Giou => BoxLoss::Giou,
                BoxFlag::Iou => BoxLoss::Iou,
                BoxFlag::Diou => BoxLoss::Diou,
                BoxFlag::Ciou => BoxLoss::Ciou,
                BoxFlag::Squared => BoxLoss::SquaredError,
            },
            box_gain: self.box_gain as f32,
            obj_gain: self.obj_gain as f32,
            cls_gain: self.cls_gain as f32,
            anchor_t: self.anchor_t as f32,
            label_smoothing: self.label_smoothing as f32,
            ..DetectionLossOptions::default()
        }
    }

    fn check(&self) -> Result<()> {
        let gain = |name, value: f64| {
            check(name, value, (0.0..=1000.0).contains(&value), "from 0 to 1000")
        };
        gain("box_gain", self.box_gain)?;
        gain("obj_gain", self.obj_gain)?;
        gain("cls_gain", self.cls_gain)?;
        let (anchor_t, smoothing) = (self.anchor_t, self.label_smoothing);
        check("anchor_t", anchor_t, anchor_t > 1.0 && anchor_t <= 100.0, "above 1, at most 100")?;
        check("label_smoothing", smoothing, (0.0..1.0).contains(&smoothing), "from 0, below 1")
    }
}

impl DetectSettings {
    /// Paths of a file of options stand relative to it.
    fn beside(&mut self, config: &Path, given: &Given<DetectArgs>) {
        if let Some(data) = self.data.as_mut().filter(|_| !given.has("data")) {
            *data = recipe::beside(config, data);
        }
        if let Some(weights) = self.weights.as_mut().filter(|_| !given.has("weights")) {
            *weights = recipe::beside(config, weights);
        }
        if !given.has("model") && !is_name(&self.model) {
            self.model = recipe::beside(config, Path::new(&self.model)).display().to_string();
        }
    }

    /// Full paths, so that the file of options is good everywhere.
    fn resolve(&mut self) -> Result<()> {
        self.learn.resolve()?;
        self.loss.check()?;
        let side = self.imgsz;
        let ok = side.is_multiple_of(STEP) && (STEP..=4096).contains(&side);
        check("imgsz", f64::from(side), ok, "a multiple of 32 from 32 to 4096")?;
        if let Some(data) = &mut self.data {
            *data = std::path::absolute(&*data).or_bad_input()?;
        }
        if let Some(weights) = &mut self.weights {
            *weights = std::path::absolute(&*weights).or_bad_input()?;
        }
        if !is_name(&self.model) && Path::new(&self.model).exists() {
            let full = std::path::absolute(&self.model).or_bad_input()?;
            self.model = full.display().to_string();
        }
        Ok(())
    }

    fn data(&self) -> Result<&Path> {
        self.data.as_deref().ok_or_else(|| bad_input("--data is needed"))
    }

    fn set(&self, split: &str) -> Result<Arc<DetectionSet>> {
        let data = self.data()?;
        let set = DetectionSet::open(data, split, self.imgsz, &self.learn.set());
        let set = match &self.classes {
            Some(classes) => set.and_then(|set| set.with_classes(classes)),
            None => set,
        };
        let set = set.with_context(|| format!("{split} of {}", data.display())).or_bad_input()?;
        Ok(Arc::new(match &self.single_cls {
            Some(name) => set.with_single_class(name),
            None => set,
        }))
    }

    fn names(&self) -> Result<Vec<String>> {
        Ok(match (&self.single_cls, &self.classes) {
            (Some(name), _) => vec![name.clone()],
            (None, Some(classes)) => classes.clone(),
            (None, None) => YoloDataset::open(self.data()?).or_bad_input()?.names().to_vec(),
        })
    }

    /// Fits the anchors to the boxes of the data, and says how they fit.
    fn fit(&self, anchors: &mut Anchors, train: &DetectionSet) -> String {
        let (boxes, anchor_t) =
            (train.object_sizes().collect::<Vec<_>>(), self.loss.anchor_t as f32);
        let (fit, which) = match self.anchors {
            AnchorsFlag::Auto => {
                let seed = u64::from(self.learn.seed);
                let search = AnchorSearch { anchor_t, seed, ..AnchorSearch::default() };
                let (found, fit) = anchors::fitting(anchors, &boxes, &search);
                let which = if found == *anchors { "kept" } else { "fitted to the data" };
                *anchors = found;
                (fit, which)
            }
            AnchorsFlag::Keep => (AnchorFit::new(&boxes, anchors.as_flattened(), anchor_t), "kept"),
        };
        let (recall, above) = (100.0 * fit.recall, fit.above);
        format!("anchors: {which}; some fits {recall:.1} % of the objects, {above:.1} on average")
    }

    fn samples(
        &self,
        set: Arc<DetectionSet>,
        augment: DetectionAugment,
    ) -> Result<DetectionSamples> {
        let until = self.learn.epochs.saturating_sub(self.close_mosaic);
        let samples = DetectionSamples::training(set, augment, u64::from(self.learn.seed));
        let until = u32::try_from(until).unwrap_or(u32::MAX);
        Ok(samples.or_bad_input()?.with_mosaic_until(until))
    }
}

/// How the network becomes files.
struct Detector {
    classes: Vec<String>,
    imgsz: u32,
}

impl Learning for Detector {
    type Task = DetectionTask;
    const NAME: &'static str = TASK;

    fn safetensors(&self, model: &YoloV5) -> Result<Vec<u8>> {
        let size = Some((self.imgsz, self.imgsz));
        let checkpoint = detector_checkpoint(model, &self.classes)?;
        Ok(safetensors(&Checkpoint { size, ..checkpoint })?)
    }

    fn onnx(&self, model: &YoloV5) -> Result<Vec<u8>> {
        let side = self.imgsz as usize;
        let options = OnnxOptions { width: side, height: side, half: false };
        Ok(detector_onnx(model, &self.classes, &options)?)
    }

    fn failures(&self, task: &DetectionTask) -> Vec<Failure> {
        task.loader().failures()
    }
}

/// Where the network comes from.
enum Origin {
    /// A new run's.
    New(Start),
    /// That of a run that goes on.
    Run(Built),
}

fn sheet(samples: &DetectionSamples, seed: u32, count: usize) -> Result<Frame> {
    let made = first(samples, seed, count)?;
    Ok(detection_sheet(&made, samples.set().names(), &SheetOptions::default())?)
}

pub(crate) fn run(given: &Given<DetectArgs>) -> Result<Outcome> {
    let DetectArgs { settings, run } = &given.args;
    let opened = Opened::new(run, given, TASK)?;
    let mut settings = settings.clone();
    if let Some(config) = &opened.config {
        settings = opened.recipe.merged(&settings, given, config)?;
        settings.beside(config, given);
    }
    settings.resolve()?;
    let augment: DetectionAugment = augment::changed(opened.recipe.augment(), &run.augment)?;
    augment.check().or_bad_input()?;
    let mut console = Console::new(run.json);

    if let Some(path) = &run.sheet {
        let set = settings.set("train")?;
        data::tell(&mut console, "train", set.report());
        let samples = settings.samples(set, augment)?;
        let frame = sheet(&samples, settings.learn.seed, run.sheet_count)?;
        picture::write(path, &frame).or_bad_input()?;
        say(format!("{}: samples as the network is shown them", path.display()));
        return Ok(Outcome::Done);
    }

    // Before the pictures, which take time: what is wrong with the network is said at once.
    let classes = settings.names()?;
    let mut origin = match opened.network::<Built>()? {
        Some(built) => {
            built.check_classes(&classes)?;
            Origin::Run(built)
        }
        None => {
            let weights = settings.weights.as_deref();
            Origin::New(Start::open(&settings.model, weights, classes.len(), settings.imgsz)?)
        }
    };
    let folder = opened.folder(run, OUT, TASK)?;
    let (train, val) = (settings.set("train")?, settings.set("val")?);
    data::tell(&mut console, "train", train.report());
    data::tell(&mut console, "val", val.report());
    if interrupt::interrupted() {
        say("interrupted before the first step");
        return Ok(Outcome::Interrupted);
    }
    let (device, others) = settings.learn.devices()?;
    let (network, built) = match &mut origin {
        Origin::New(start) => {
            console.line(settings.fit(&mut start.config.anchors, &train));
            let (network, built, words) = start.network(&classes, &device)?;
            words.iter().for_each(|line| console.line(line));
            (network, built)
        }
        Origin::Run(built) => (built.network(settings.imgsz, &device)?, built.clone()),
    };
    let loss = DetectionLoss::new(network.config(), settings.loss.options());
    let samples = Arc::new(settings.samples(train, augment)?);
    let batch = sheet(&samples, settings.learn.seed, settings.learn.batch.min(BATCH_SHOWN))?;
    let loader = Loader::new(samples, settings.learn.loader()).or_bad_input()?;
    // The embedded engine: the same figures wherever it runs.
    let runtime =
        Runtime::start(&RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() });
    let task = DetectionTask::new(loader, loss, val, runtime);
    let options = settings.learn.options();
    let trainer = match &opened.resumed {
        Some(folder) => {
            let path = folder.checkpoint();
            let trainer = Trainer::resume(task, network, options, device, &path).or_bad_input()?;
            console.line(going_on(&trainer));
            trainer
        }
        None => {
            folder.clear()?;
            folder.draw(folder::BATCH, &batch)?;
            Trainer::new(task, network, options, device)
        }
    };
    let trainer = trainer.with_devices(others);
    if opened.is_changed(given) {
        folder.write_args(&recipe::text(TASK, &settings, &augment, &built)?)?;
    }
    let devices = settings.learn.devices_in_words();
    console.line(format!("device: {devices}; results in {}", folder.path().display()));
    let learning = Detector { classes, imgsz: settings.imgsz };
    let batch = settings.learn.batch;
    Session { learning, trainer, folder: &folder, console: &mut console, batch }.run()
}
