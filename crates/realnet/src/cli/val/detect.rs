//! `realnet val detect`.

use crate::cli::{
    detect::make_directory,
    engine_args::EngineArgs,
    failure::{OrBadInput, Outcome, bad_input, keep_input, report, say},
    interrupt,
    model_args::{FilterFlag, open_model, parse_share, parse_size, start_detector},
    output::Output,
    progress,
};
use anyhow::{Error, Result};
use clap::Args;
use realnet::{
    BoundingBox, Detection, DetectorOptions, Stage,
    datasets::{CocoDataset, YoloDataset, coco::to_box},
    eval::{
        self, CocoOptions, ConfusionOptions, GroundTruth, Prediction, Report, confidence_curves,
        confusion_matrix, plot,
    },
    picture,
    results::{CocoCollector, ImageIds},
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Instant,
};

#[derive(Debug, Args)]
pub(crate) struct ValArgs {
    /// The data: a YOLO data.yaml, or a COCO json with --images.
    #[arg(long, value_name = "FILE")]
    data: PathBuf,
    /// Which part of a data.yaml.
    #[arg(long, value_name = "NAME", default_value = "val")]
    split: String,
    /// The folder of the pictures of a COCO json [default: the json's own].
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// The network: YOLOv5 weights (.pt, .safetensors) or a YOLO ONNX file.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// Input size of the network: N or WIDTHxHEIGHT [default: the file's own, or 640].
    #[arg(long, value_name = "N|WxH", value_parser = parse_size)]
    imgsz: Option<(u32, u32)>,
    /// How a frame is fitted into the network's input.
    #[arg(long, value_enum, default_value_t = FilterFlag::Triangle)]
    resize: FilterFlag,
    /// Least confidence, 0 to 1; low, because the curves need the weak boxes too.
    #[arg(long, value_name = "SHARE", default_value_t = 0.001, value_parser = parse_share)]
    conf: f32,
    /// Boxes of a class that overlap by more than this IoU are doubles.
    #[arg(long, value_name = "SHARE", default_value_t = 0.6, value_parser = parse_share)]
    iou: f32,
    /// Most boxes a picture.
    #[arg(long, value_name = "N", default_value_t = 300)]
    max_det: usize,
    /// All classes of data and network count as one.
    #[arg(long)]
    single_cls: bool,
    /// Write plots, metrics.json, and labels and boxes in COCO form into this directory.
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,
    /// One JSON object on standard output, and nothing else there.
    #[arg(long)]
    json: bool,
    /// Evaluate only the first N pictures.
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    #[command(flatten)]
    engine: EngineArgs,
}

/// Labelled pictures, whatever form they came in.
struct Data {
    pictures: Vec<Picture>,
    names: Vec<String>,
    /// The data's own number of each class.
    category_ids: Vec<u64>,
}

struct Picture {
    path: PathBuf,
    id: u64,
    labels: Labels,
}

enum Labels {
    /// Shares of the picture's size: `(class, cx, cy, w, h)` is turned into pixels later.
    Yolo(Vec<realnet::datasets::Label>),
    /// Pixels.
    Coco(Vec<realnet::datasets::CocoAnnotation>),
}

impl Labels {
    fn ground_truth(&self, image_id: u64, width: u32, height: u32) -> Vec<GroundTruth> {
        match self {
            Self::Yolo(rows) => rows
                .iter()
                .map(|row| GroundTruth::new(image_id, row.class_id, row.to_pixels(width, height)))
                .collect(),
            Self::Coco(annotations) => annotations
                .iter()
                .map(|a| GroundTruth {
                    image_id,
                    category: a.class_id,
                    bbox: to_box(a.bbox),
                    area: a.area,
                    crowd: a.iscrowd,
                })
                .collect(),
        }
    }
}

impl Data {
    fn open(args: &ValArgs) -> Result<Self> {
        if args.data.extension().is_some_and(|extension| extension == "json") {
            Self::open_coco(&args.data, args.images.as_deref())
        } else {
            Self::open_yolo(&args.data, &args.split)
        }
    }

    fn open_yolo(path: &Path, split: &str) -> Result<Self> {
        let data = YoloDataset::open(path).or_bad_input()?;
        let mut ids = ImageIds::default();
        let mut duplicates = 0;
        let mut pictures = Vec::new();
        for sample in data.split(split).or_bad_input()? {
            let labels = data.labels(&sample).or_bad_input()?;
            duplicates += labels.duplicates;
            let id = ids.assign(&sample.image);
            pictures.push(Picture { path: sample.image, id, labels: Labels::Yolo(labels.rows) });
        }
        if duplicates > 0 {
            say(format!("{duplicates} labels stood twice and count once"));
        }
        let names = data.names().to_vec();
        let category_ids = (0..names.len() as u64).collect();
        Ok(Self { pictures, names, category_ids })
    }

    fn open_coco(path: &Path, images: Option<&Path>) -> Result<Self> {
        let data = CocoDataset::read(path).or_bad_input()?;
        let folder = images.or(path.parent()).unwrap_or(Path::new("."));
        let mut labels: BTreeMap<u64, Vec<_>> = BTreeMap::new();
        for annotation in data.annotations {
            labels.entry(annotation.image_id).or_default().push(annotation);
        }
        let pictures = data
            .images
            .into_iter()
            .map(|image| Picture {
                path: folder.join(&image.file_name),
                id: image.id,
                labels: Labels::Coco(labels.remove(&image.id).unwrap_or_default()),
            })
            .collect();
        Ok(Self { pictures, names: data.names, category_ids: data.category_ids })
    }
}

/// The data's class for each of the network's; `None` for one the data lack.
fn class_map(network: &[String], data: &[String], single: bool) -> Result<Vec<Option<u32>>> {
    if single {
        return Ok(vec![Some(0); network.len()]);
    }
    let map: Vec<Option<u32>> = network
        .iter()
        .map(|name| data.iter().position(|known| known == name).map(|class| class as u32))
        .collect();
    let missing: Vec<&str> =
        data.iter().map(String::as_str).filter(|name| !network.iter().any(|n| n == name)).collect();
    if missing.is_empty() {
        return Ok(map);
    }
    if network.len() == data.len() {
        say("the class names of network and data differ; their numbers are taken as equal");
        return Ok((0..network.len() as u32).map(Some).collect());
    }
    Err(bad_input(format!(
        "the network does not know {} of the data's {} classes ({}); --single-cls compares boxes only",
        missing.len(),
        data.len(),
        missing.join(", ")
    )))
}

/// What a run over the pictures gathers.
#[derive(Default)]
struct Gathered {
    truth: Vec<GroundTruth>,
    predictions: Vec<Prediction>,
    images: Vec<realnet::datasets::CocoImage>,
    /// Milliseconds of reading, letterbox, network and suppression, summed.
    ms: [f64; 4],
}

pub(crate) fn run(args: &ValArgs) -> Result<Outcome> {
    let mut data = Data::open(args)?;
    if let Some(limit) = args.limit {
        data.pictures.truncate(limit);
    }
    let model = open_model(&args.model)?;
    let classes = class_map(model.names(), &data.names, args.single_cls)?;
    let options = DetectorOptions {
        size: args.imgsz,
        filter: args.resize.into(),
        confidence: args.conf,
        iou: args.iou,
        max_det: args.max_det,
        multi_label: !args.single_cls,
        agnostic: args.single_cls,
        ..Default::default()
    };
    if let Some(directory) = &args.save {
        make_directory(directory)?;
        for name in ["labels.json", "predictions.json", "metrics.json"] {
            keep_input(&directory.join(name), &args.data)?;
        }
    }
    let mut detector = start_detector(&args.model, model, &args.engine.start(), options)?;
    if args.single_cls {
        data.names = vec!["object".to_owned()];
        data.category_ids = vec![0];
    }

    let bar = progress::bar(Some(data.pictures.len() as u64), "val");
    let mut gathered = Gathered::default();
    let mut outcome = Outcome::Done;
    for shown in &data.pictures {
        if interrupt::interrupted() {
            bar.finish_and_clear();
            return Ok(Outcome::Interrupted);
        }
        bar.inc(1);
        let start = Instant::now();
        let frame = match picture::read(&shown.path) {
            Ok(frame) => frame,
            Err(error) => {
                bar.suspend(|| report(&Error::new(error)));
                outcome = Outcome::BadInputs;
                continue;
            }
        };
        let mut last = Instant::now();
        gathered.ms[0] += (last - start).as_secs_f64() * 1e3;
        let ms = &mut gathered.ms;
        let found = detector.detect_marked(&frame, &mut |stage| {
            let now = Instant::now();
            let slot = match stage {
                Stage::Preprocess => 1,
                Stage::Infer => 2,
                Stage::Postprocess => 3,
            };
            ms[slot] += (now - last).as_secs_f64() * 1e3;
            last = now;
        })?;
        let (width, height) = (frame.width(), frame.height());
        let mut truth = shown.labels.ground_truth(shown.id, width, height);
        if args.single_cls {
            truth.iter_mut().for_each(|label| label.category = 0);
        }
        gathered.truth.extend(truth);
        gathered.predictions.extend(found.iter().filter_map(|detection| {
            let category = (*classes.get(detection.class_id as usize)?)?;
            let Detection { confidence, bbox, .. } = *detection;
            Some(Prediction { image_id: shown.id, category, bbox, confidence })
        }));
        gathered.images.push(realnet::datasets::CocoImage {
            id: shown.id,
            file_name: file_name(&shown.path),
            width,
            height,
        });
    }
    bar.finish_and_clear();
    finish(args, &data, &gathered, &detector.engine())?;
    Ok(outcome)
}

/// Scores, plots and files.
fn finish(args: &ValArgs, data: &Data, gathered: &Gathered, engine: &str) -> Result<()> {
    let Gathered { truth, predictions, images, ms } = gathered;
    let summary = eval::evaluate(truth, predictions, &CocoOptions::default())?;
    let curves = confidence_curves(truth, predictions, 0.5)?;
    let names: BTreeMap<u32, String> = (0..).zip(data.names.iter().cloned()).collect();
    let report = Report::new(&summary, &curves, images.len(), &names);
    if let Some(directory) = &args.save {
        let categories: Vec<u32> = names.keys().copied().collect();
        let matrix =
            confusion_matrix(truth, predictions, &categories, ConfusionOptions::default())?;
        let pictures = [
            ("pr_curve.png", plot::pr_curve(&summary, &names)?),
            ("precision_curve.png", plot::precision_curve(&curves, &names)?),
            ("recall_curve.png", plot::recall_curve(&curves, &names)?),
            ("f1_curve.png", plot::f1_curve(&curves, &names)?),
            ("confusion_matrix.png", plot::confusion_plot(&matrix, &names)?),
        ];
        for (name, plot) in pictures {
            picture::write(&directory.join(name), &plot)?;
        }
        let text = serde_json::to_vec_pretty(&report)?;
        realnet_io::atomic::write(&directory.join("metrics.json"), &text)?;
        write_coco(directory, data, gathered)?;
    }
    let mut output = Output::stdout();
    if args.json {
        return output.json(&report);
    }
    output.line(report.table().trim_end())?;
    let count = images.len().max(1) as f64;
    let [read, pre, infer, post] = ms.map(|ms| ms / count);
    output.line(format_args!(
        "ms a picture: {read:.1} read, {pre:.1} letterbox, {infer:.1} network, {post:.1} suppression ({engine})"
    ))?;
    if let Some(directory) = &args.save {
        say(format!("plots and files are in {}", directory.display()));
    }
    Ok(())
}

/// Labels and boxes in COCO form, so that other tools can repeat the evaluation.
fn write_coco(directory: &Path, data: &Data, gathered: &Gathered) -> Result<()> {
    let annotations = (1..).zip(&gathered.truth).map(|(id, label)| {
        let BoundingBox { x0, y0, .. } = label.bbox;
        let sides = [x0, y0, label.bbox.width(), label.bbox.height()];
        realnet::datasets::CocoAnnotation {
            id,
            image_id: label.image_id,
            class_id: label.category,
            bbox: sides.map(f64::from),
            area: label.area,
            iscrowd: label.crowd,
        }
    });
    CocoDataset {
        images: gathered.images.clone(),
        annotations: annotations.collect(),
        names: data.names.clone(),
        category_ids: data.category_ids.clone(),
    }
    .write(&directory.join("labels.json"))?;
    let mut collector = CocoCollector::new(Some(data.category_ids.clone()));
    for prediction in &gathered.predictions {
        let Prediction { category, bbox, confidence, .. } = *prediction;
        let detection = Detection { class_id: category, confidence, bbox };
        collector.add(prediction.image_id, &[detection]);
    }
    collector.write(&directory.join("predictions.json"))?;
    Ok(())
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
