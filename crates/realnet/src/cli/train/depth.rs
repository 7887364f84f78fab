//! `realnet train depth`.

mod start;

use super::{
    augment,
    console::Console,
    data::{self, first},
    folder::{self, Folder},
    given::{Defaults, Given},
    opened::Opened,
    options::{LearnArgs, RunArgs, check},
    recipe,
    session::{Learning, Session, going_on},
};
use crate::cli::{
    failure::{OrBadInput, Outcome, bad_input, say},
    interrupt,
    model_args::parse_size,
};
use anyhow::{Context, Result};
use burn::tensor::Device;
use clap::{Args, ValueEnum};
use realnet::{
    DepthMap, Frame, depth::DepthCoding, eval::DepthProtocol, onnx::OnnxOptions, picture,
    weights::Checkpoint,
};
use realnet_data::{
    CanonicalFocal, DepthAugment, DepthPart, DepthSample, DepthSamples, DepthSet, DepthSetOptions,
    Failure, HoldOut, Loader, LoaderOptions, Normalization, Samples, SheetOptions, SourceList,
    depth_sheet,
};
use realnet_train::{
    export::{depth_checkpoint, depth_onnx, safetensors},
    loss::{DepthLoss, DepthLossOptions, depth::NormalRules},
    nets::{DepthNet, Vnl, VnlLite},
    tasks::DepthTask,
    trainer::Trainer,
};
use serde::{Deserialize, Serialize};
use start::{Built, Network, Start};
use std::{
    fmt,
    marker::PhantomData,
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
};

const TASK: &str = "depth";
/// Where it goes when nothing else is said.
const OUT: &str = "runs/depth";
/// Metres of a unit of the network.
const SCALE: f64 = 10.0;
/// Most samples of the picture of the first batch.
const BATCH_SHOWN: usize = 12;

#[derive(Debug, Args)]
pub(crate) struct DepthArgs {
    #[command(flatten)]
    settings: DepthSettings,
    #[command(flatten)]
    run: RunArgs,
}

/// All that decides the result, but for the augmentation.
#[derive(Clone, Debug, PartialEq, Args, Serialize, Deserialize)]
struct DepthSettings {
    /// A list of sources (YAML), or a folder of pictures with depth maps.
    #[arg(long, value_name = "LIST.yaml|DIR")]
    data: Option<PathBuf>,
    /// vnl-lite, vnl-mobilenetv2, vnl-resnext50 or vnl-resnext101; or weights (.safetensors,
    /// .pt) to train on from.
    #[arg(long, value_name = "NAME|FILE", default_value = start::LITE)]
    model: String,
    /// Weights for a --model by name; what does not fit starts at random.
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Size of the network's input, width and height in pixels.
    #[arg(long, value_name = "WxH", default_value_t = Size { width: 256, height: 192 })]
    imgsz: Size,
    /// Depth units a metre of a folder; a list says it for each source [default: by the
    /// layout: 1000, 5000 or 256].
    #[arg(long, value_name = "UNITS")]
    depth_scale: Option<f64>,
    /// Of a folder, one block in N is for validation; a list says it for each source.
    #[arg(long, value_name = "N", default_value_t = 5)]
    hold_out_every: usize,
    /// Frames of such a block: neighbours show the same place.
    #[arg(long, value_name = "FRAMES", default_value_t = 40)]
    hold_out_block: usize,
    /// Frames on both sides of such a block that are used for nothing.
    #[arg(long, value_name = "FRAMES", default_value_t = 5)]
    hold_out_gap: usize,
    #[command(flatten)]
    #[serde(flatten)]
    coding: CodingArgs,
    #[command(flatten)]
    #[serde(flatten)]
    loss: LossArgs,
    #[command(flatten)]
    #[serde(flatten)]
    learn: LearnArgs,
}

#[derive(Clone, Debug, PartialEq, Args, Serialize, Deserialize)]
#[command(next_help_heading = "Depth")]
struct CodingArgs {
    /// Classes of depth [default: the weights', or 80 for vnl-lite, 60 and 150 for the
    /// authors'].
    #[arg(long, value_name = "N")]
    bins: Option<usize>,
    /// Where the classes begin, metres for the canonical focal length [default: the weights',
    /// or 0.2].
    #[arg(long, value_name = "M")]
    min_depth: Option<f64>,
    /// Where they end [default: the weights', or 60].
    #[arg(long, value_name = "M")]
    max_depth: Option<f64>,
    /// The canonical focal length, in widths of the input: depth is learned as if all cameras
    /// had it [default: the weights', or 1].
    #[arg(long, value_name = "WIDTHS")]
    focal: Option<f64>,
    /// True depth at or beyond is left out of the validation, produced depth lowered to it.
    #[arg(long, value_name = "M", default_value_t = 10.0)]
    cap: f64,
}

#[derive(Clone, Debug, PartialEq, Args, Serialize, Deserialize)]
#[command(next_help_heading = "Loss")]
struct LossArgs {
    /// Weight of the virtual normals against the cross entropy; 0 for none.
    #[arg(long, value_name = "GAIN", default_value_t = 5.0)]
    normals_gain: f64,
    /// Which triangles count: by the paper's rules or the released code's.
    #[arg(long, value_enum, default_value_t = RulesFlag::Paper)]
    normals_rules: RulesFlag,
    /// Triangles of known depths that are drawn for each picture.
    #[arg(long, value_name = "N", default_value_t = 4000)]
    normals_triplets: usize,
    /// Share of these, those of the smallest losses, that is left out.
    #[arg(long, value_name = "SHARE", default_value_t = 0.25)]
    normals_dropped: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum RulesFlag {
    Paper,
    Released,
}

/// Width and height, as `256x192`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
struct Size {
    width: u32,
    height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        parse_size(text).map(|(width, height)| Self { width, height })
    }
}

impl TryFrom<String> for Size {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Size> for String {
    fn from(size: Size) -> Self {
        size.to_string()
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl Defaults for DepthArgs {
    const DEFAULTS: &'static [(&'static str, &'static str)] = &[
        ("batch", "8"),
        ("optimizer", "adamw"),
        ("warmup_epochs", "1"),
        ("ema", "0.999"),
        ("ema_ramp", "200"),
    ];
}

impl DepthSettings {
    /// Paths of a file of options stand relative to it.
    fn beside(&mut self, config: &Path, given: &Given<DepthArgs>) {
        if let Some(data) = self.data.as_mut().filter(|_| !given.has("data")) {
            *data = recipe::beside(config, data);
        }
        if let Some(weights) = self.weights.as_mut().filter(|_| !given.has("weights")) {
            *weights = recipe::beside(config, weights);
        }
        if !given.has("model") && Network::named(&self.model).is_none() {
            self.model = recipe::beside(config, Path::new(&self.model)).display().to_string();
        }
    }

    /// Full paths, so that the file of options is good everywhere; and all ranges.
    fn resolve(&mut self) -> Result<()> {
        self.learn.resolve()?;
        let LossArgs { normals_gain, normals_triplets, normals_dropped, .. } = self.loss;
        let gain = (0.0..=1000.0).contains(&normals_gain);
        check("normals_gain", normals_gain, gain, "from 0 to 1000")?;
        let triplets = (1..=1_000_000).contains(&normals_triplets);
        let range = "from 1 to 1000000";
        check("normals_triplets", normals_triplets as f64, triplets, range)?;
        let dropped = (0.0..1.0).contains(&normals_dropped);
        check("normals_dropped", normals_dropped, dropped, "from 0, below 1")?;
        let CodingArgs { bins, focal, cap, .. } = self.coding;
        if let Some(bins) = bins {
            check("bins", bins as f64, (2..=1000).contains(&bins), "from 2 to 1000")?;
        }
        if let Some(focal) = focal {
            check("focal", focal, (0.05..=20.0).contains(&focal), "from 0.05 to 20 widths")?;
        }
        check("cap", cap, cap > 0.001, "above 0.001 m")?;
        if let Some(scale) = self.depth_scale {
            check("depth_scale", scale, (1e-3..=1e6).contains(&scale), "from 0.001 to 1000000")?;
        }
        let (every, block) = (self.hold_out_every, self.hold_out_block);
        check("hold_out_every", every as f64, every >= 2, "2 or more")?;
        check("hold_out_block", block as f64, block >= 1, "1 or more")?;
        if let Some(data) = &mut self.data {
            *data = std::path::absolute(&*data).or_bad_input()?;
        }
        if let Some(weights) = &mut self.weights {
            *weights = std::path::absolute(&*weights).or_bad_input()?;
        }
        if Network::named(&self.model).is_none() && Path::new(&self.model).exists() {
            let full = std::path::absolute(&self.model).or_bad_input()?;
            self.model = full.display().to_string();
        }
        Ok(())
    }

    /// The network with the classes asked for, and what they mean.
    fn coding(&self, start: &Start) -> Result<(Network, DepthCoding)> {
        let CodingArgs { bins, min_depth, max_depth, focal, .. } = self.coding;
        if let Some(bins) = bins.filter(|bins| start.is_fixed && *bins != start.network.bins()) {
            return Err(bad_input(format!(
                "--bins {bins}: the weights have {}; another number needs the architecture's \
                 name as --model, and the file as --weights",
                start.network.bins()
            )));
        }
        let network = start.network.with_bins(bins.unwrap_or(start.network.bins()));
        let width = f64::from(self.imgsz.width);
        let default =
            DepthCoding { min: 0.02, max: 6.0, scale: SCALE, focal: width, ..Default::default() };
        let mut coding = start.coding.unwrap_or(default);
        if let Some(least) = min_depth {
            coding.min = least / coding.scale;
        }
        if let Some(most) = max_depth {
            coding.max = most / coding.scale;
        }
        if let Some(widths) = focal {
            coding.focal = widths * width;
        }
        coding.check().or_bad_input()?;
        Ok((network, coding))
    }

    fn check_size(&self, network: &Network) -> Result<()> {
        let step = network.step();
        for (name, side) in [("width", self.imgsz.width), ("height", self.imgsz.height)] {
            let ok = side.is_multiple_of(step) && (step..=4096).contains(&side);
            let range = format!("a multiple of {step} from {step} to 4096");
            check(&format!("imgsz: {name}"), f64::from(side), ok, &range)?;
        }
        Ok(())
    }

    /// Where the data are.
    fn sources(&self) -> Result<SourceList> {
        let data = self.data.as_deref().ok_or_else(|| bad_input("--data is needed"))?;
        let mut list = SourceList::open(data).or_bad_input()?;
        if data.is_dir() {
            let (block, every) = (self.hold_out_block, self.hold_out_every);
            let gap = self.hold_out_gap;
            list.sources.iter_mut().for_each(|source| {
                source.hold_out = Some(HoldOut { block, every, gap });
                source.depth_scale = self.depth_scale;
            });
        } else if self.depth_scale.is_some() {
            return Err(bad_input("--depth-scale is for a folder; a list has depth_scale itself"));
        }
        Ok(list)
    }

    fn set(&self, list: &SourceList, part: DepthPart) -> Result<Arc<DepthSet>> {
        let size = (self.imgsz.width, self.imgsz.height);
        let (name, options) = match part {
            DepthPart::Val => ("val", DepthSetOptions::validation(size)),
            _ => ("train", DepthSetOptions::training(size)),
        };
        let options = DepthSetOptions { set: self.learn.set(), ..options };
        let set = DepthSet::open(list, part, &options);
        let data = self.data.as_deref().unwrap_or(Path::new(""));
        let hint = match part {
            DepthPart::Val => {
                " (frames for validation: hold_out in a list, --hold-out-every and \
                 --hold-out-block for a folder)"
            }
            _ => "",
        };
        let named = || format!("{name} of {}{hint}", data.display());
        Ok(Arc::new(set.with_context(named).or_bad_input()?))
    }

    fn loss(&self, network: &Network, coding: DepthCoding) -> DepthLoss {
        DepthLoss::new(DepthLossOptions {
            coding,
            bins: network.bins(),
            normal_gain: self.loss.normals_gain as f32,
            normal_triplets: self.loss.normals_triplets,
            normal_rules: match self.loss.normals_rules {
                RulesFlag::Paper => NormalRules::PAPER,
                RulesFlag::Released => NormalRules::RELEASED,
            },
            normal_dropped: self.loss.normals_dropped,
            ..DepthLossOptions::default()
        })
    }
}

/// How the network becomes files.
struct Depth<N> {
    coding: DepthCoding,
    size: Size,
    net: PhantomData<fn() -> N>,
}

impl<N: DepthNet> Learning for Depth<N> {
    type Task = DepthTask<N>;
    const NAME: &'static str = TASK;

    fn safetensors(&self, model: &N) -> Result<Vec<u8>> {
        let checkpoint = depth_checkpoint(model, &self.coding)?;
        let size = Some((self.size.width, self.size.height));
        Ok(safetensors(&Checkpoint { size, ..checkpoint })?)
    }

    fn onnx(&self, model: &N) -> Result<Vec<u8>> {
        let (width, height) = (self.size.width as usize, self.size.height as usize);
        Ok(depth_onnx(model, &self.coding, &OnnxOptions { width, height, half: false })?)
    }

    fn failures(&self, task: &DepthTask<N>) -> Vec<Failure> {
        [task.loader().failures(), task.validation().failures()].concat()
    }
}

fn sheet(samples: &[DepthSample], coding: &DepthCoding) -> Result<Frame> {
    let options = SheetOptions { columns: 3, ..SheetOptions::default() };
    Ok(depth_sheet(samples, &normalization(coding), &options)?)
}

/// What the classes of depth are, and whether they are those of the data. A wrong number of
/// units a metre is seen by the median.
fn range_words(loss: &DepthLoss, samples: &[DepthSample]) -> String {
    let DepthCoding { min, max, scale, focal, .. } = loss.options().coding;
    let (mut metres, mut outside) = (Vec::new(), 0_usize);
    for sample in samples {
        for depth in sample.depth.iter().filter(|depth| DepthMap::is_known(**depth)) {
            metres.push(depth * sample.metres_per_unit);
            outside += usize::from(loss.label(*depth).is_none());
        }
    }
    metres.sort_unstable_by(f32::total_cmp);
    format!(
        "depth: {} classes from {:.3} to {:.1} m for a focal length of {focal:.0} px; of the first \
         {} samples the median is {:.2} m, and {:.1} % lie outside of the classes",
        loss.options().bins,
        min * scale,
        max * scale,
        samples.len(),
        metres.get(metres.len() / 2).copied().unwrap_or_default(),
        100.0 * outside as f64 / metres.len().max(1) as f64
    )
}

fn normalization(coding: &DepthCoding) -> Normalization {
    Normalization { mean: coding.mean, std: coding.std }
}

pub(crate) fn run(given: &Given<DepthArgs>) -> Result<Outcome> {
    let DepthArgs { settings, run } = &given.args;
    let opened = Opened::new(run, given, TASK)?;
    let mut settings = settings.clone();
    if let Some(config) = &opened.config {
        settings = opened.recipe.merged(&settings, given, config)?;
        settings.beside(config, given);
    }
    settings.resolve()?;
    let augment: DepthAugment = augment::changed(opened.recipe.augment(), &run.augment)?;
    augment.check().or_bad_input()?;
    let mut console = Console::new(run.json);

    let (start, (network, coding)) = match opened.network::<Built>()? {
        Some(built) => (None, built.read()?),
        None => {
            let start = Start::open(&settings.model, settings.weights.as_deref())?;
            let coding = settings.coding(&start)?;
            (Some(start), coding)
        }
    };
    settings.check_size(&network)?;
    let canonical = CanonicalFocal::new(coding.focal).or_bad_input()?;
    let seed = settings.learn.seed;
    let training = |set| {
        let normalization = normalization(&coding);
        DepthSamples::training(set, augment, canonical, normalization, u64::from(seed))
            .or_bad_input()
    };
    let sources = settings.sources()?;

    if let Some(path) = &run.sheet {
        let set = settings.set(&sources, DepthPart::Train)?;
        data::tell(&mut console, "train", set.report());
        let frame = sheet(&first(&training(set)?, seed, run.sheet_count)?, &coding)?;
        picture::write(path, &frame).or_bad_input()?;
        say(format!("{}: samples as the network is shown them", path.display()));
        return Ok(Outcome::Done);
    }

    let folder = opened.folder(run, OUT, TASK)?;
    let train = settings.set(&sources, DepthPart::Train)?;
    let val = settings.set(&sources, DepthPart::Val)?;
    data::tell(&mut console, "train", train.report());
    data::tell(&mut console, "val", val.report());
    if interrupt::interrupted() {
        say("interrupted before the first step");
        return Ok(Outcome::Interrupted);
    }
    let batch = settings.learn.batch;
    let samples = Arc::new(training(train)?);
    let held_out = held_out(&val)?;
    let loss = settings.loss(&network, coding);
    let made = first(&*samples, seed, batch.min(BATCH_SHOWN))?;
    console.line(range_words(&loss, &made));
    let shown = sheet(&made, &coding)?;
    // The loss is a mean: the few samples of a last batch would weigh more than the others.
    let drop_last = samples.len() >= batch;
    let options = LoaderOptions { drop_last, ..settings.learn.loader() };
    let loader = Loader::new(samples, options).or_bad_input()?;
    let samples =
        DepthSamples::validation(val, canonical, normalization(&coding)).or_bad_input()?;
    let options = LoaderOptions { shuffle: None, replacements: 0, ..settings.learn.loader() };
    let validation = Loader::new(Arc::new(samples), options).or_bad_input()?;
    let parts = Parts {
        start,
        opened: &opened,
        folder: &folder,
        console: &mut console,
        coding,
        settings: &settings,
        loss,
        loader,
        validation,
        shown,
        held_out,
        args: recipe::text(TASK, &settings, &augment, &Built::new(&network, &coding))?,
        is_changed: opened.is_changed(given),
    };
    let devices = settings.learn.devices()?;
    let device = &devices.0;
    match network {
        Network::Lite(config) => parts.train(VnlLite::new(&config, device), devices),
        Network::Vnl(config) => parts.train(Vnl::new(&config, device), devices),
    }
}

/// The pictures of the validation, a path a line.
fn held_out(val: &DepthSet) -> Result<String> {
    let mut text = "# Not learned from: realnet val depth --data … --split THIS_FILE\n".to_owned();
    for path in (0..val.len()).filter_map(|index| val.path(index)) {
        let path = std::path::absolute(path).or_bad_input()?;
        text.push_str(&path.display().to_string());
        text.push('\n');
    }
    Ok(text)
}

/// All that a training of any network takes.
struct Parts<'a> {
    start: Option<Start>,
    opened: &'a Opened,
    folder: &'a Folder,
    console: &'a mut Console,
    coding: DepthCoding,
    settings: &'a DepthSettings,
    loss: DepthLoss,
    loader: Loader<DepthSamples>,
    validation: Loader<DepthSamples>,
    shown: Frame,
    held_out: String,
    args: String,
    is_changed: bool,
}

impl Parts<'_> {
    fn train<N: DepthNet>(
        self,
        network: N,
        (device, others): (Device, Vec<Device>),
    ) -> Result<Outcome> {
        let Self { settings, folder, console, .. } = self;
        let network = match &self.start {
            Some(start) => {
                let (network, words) = start.fill(network)?;
                words.iter().for_each(|line| console.line(line));
                network
            }
            None => network,
        };
        let learn = &settings.learn;
        let protocol = DepthProtocol {
            max_depth: settings.coding.cap,
            ..DepthProtocol::new("as in the files")
        };
        console.line(format!("validation: compared at {}; {protocol}", settings.imgsz));
        let (loader, validation, seed) = (self.loader, self.validation, u64::from(learn.seed));
        let task = DepthTask::<N>::new(loader, self.loss, validation, protocol, seed);
        let task = task.or_bad_input()?;
        let options = learn.options();
        let trainer = match &self.opened.resumed {
            Some(folder) => {
                let path = folder.checkpoint();
                let trainer = Trainer::resume(task, network, options, device, &path);
                let trainer = trainer.or_bad_input()?;
                console.line(going_on(&trainer));
                trainer
            }
            None => {
                folder.clear()?;
                folder.draw(folder::BATCH, &self.shown)?;
                folder.write(folder::HELD_OUT, self.held_out.as_bytes())?;
                Trainer::new(task, network, options, device)
            }
        };
        let trainer = trainer.with_devices(others);
        if self.is_changed {
            folder.write_args(&self.args)?;
        }
        let devices = learn.devices_in_words();
        console.line(format!("device: {devices}; results in {}", folder.path().display()));
        let learning = Depth { coding: self.coding, size: settings.imgsz, net: PhantomData };
        Session { learning, trainer, folder, console, batch: learn.batch }.run()
    }
}
