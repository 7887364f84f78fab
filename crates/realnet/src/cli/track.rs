//! `realnet track`.

mod record;
mod saver;
pub(in crate::cli) mod target;
mod view;

use super::{
    engine_args::EngineArgs,
    failure::{OrBadInput, Outcome, bad_input, is_broken_pipe, report, say},
    interrupt,
    model_args::{
        open_model, parse_box, parse_classes, parse_positive, parse_share, parse_size,
        start_detector,
    },
    output::Output,
    progress,
};
use anyhow::{Error, Result};
use clap::{ArgGroup, Args};
use realnet::{
    BoundingBox, DetectorOptions,
    datasets::TargetBoxes,
    source::{self, SourceFrame, SourceKind, SourceOptions},
};
use realnet_vision::{
    Corner, CornerDetector, CornerMask, CornerOptions, FlowOptions, FlowTracker, Region, Track,
    Window,
};
use record::{Summary, TrackMs, TrackRecord};
use saver::Saver;
use std::{
    path::{Path, PathBuf},
    time::Instant,
};
use target::{Finder, Target};
use view::View;

#[derive(Debug, Args)]
pub(crate) struct TrackArgs {
    /// A folder or glob of pictures, a video, stream (rtsp://…) or camera (/dev/video0).
    #[arg(long, value_name = "WHAT")]
    source: String,
    /// Write frames with corners, flow and box into this directory, and before_after.jpg.
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,
    /// Which frame before_after.jpg shows, with the one before [default: the first that moved].
    #[arg(long, value_name = "N", requires = "save", value_parser = clap::value_parser!(u64).range(1..))]
    pair: Option<u64>,
    /// One JSON object a frame on standard output, and nothing else there.
    #[arg(long)]
    json: bool,
    /// Stop after so many frames.
    #[arg(long, value_name = "N")]
    limit: Option<u64>,

    #[command(flatten)]
    target: TargetArgs,
    #[command(flatten)]
    corners: CornerArgs,
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    engine: EngineArgs,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Target", group = ArgGroup::new("seeds").multiple(true))]
struct TargetArgs {
    /// The target's box in the first frame, to be carried by flow.
    #[arg(long = "box", value_name = "X0,Y0,X1,Y1", value_parser = parse_box, allow_hyphen_values = true, conflicts_with = "boxes")]
    bbox: Option<BoundingBox>,
    /// The target's boxes: a CSV file (frame,x0,y0,x1,y1) or a folder of YOLO labels.
    #[arg(long, value_name = "FILE|DIR", group = "seeds", conflicts_with = "model")]
    boxes: Option<PathBuf>,
    /// A network that finds the target: YOLOv5 weights (.pt, .safetensors) or a YOLO ONNX file.
    #[arg(long, value_name = "FILE", group = "seeds")]
    model: Option<PathBuf>,
    /// Take a new box from --boxes or --model every so many frames.
    #[arg(long, value_name = "K", default_value_t = 15, requires = "seeds", value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
    /// Only these classes of the network, by name or number.
    #[arg(long, value_name = "CLASS,…", value_delimiter = ',', requires = "model")]
    classes: Vec<String>,
    /// Least confidence of a detection, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.25, requires = "model", value_parser = parse_share)]
    conf: f32,
    /// Input size of the network: N or WIDTHxHEIGHT [default: the file's own, or 640].
    #[arg(long, value_name = "N|WxH", requires = "model", value_parser = parse_size)]
    imgsz: Option<(u32, u32)>,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Corners and flow")]
struct CornerArgs {
    /// Most corners of a frame, those of the target's box not counted.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    corners: u32,
    /// Least response of a corner, as a share of the frame's best.
    #[arg(long, value_name = "SHARE", default_value_t = 0.01, value_parser = parse_share)]
    quality: f32,
    /// Least distance of two corners, in pixels.
    #[arg(long, value_name = "PX", default_value_t = 10.0, value_parser = parse_positive)]
    min_distance: f64,
    /// Side of the window compared, in pixels.
    #[arg(long, value_name = "PX", default_value_t = 21, value_parser = clap::value_parser!(u32).range(3..=255))]
    window: u32,
    /// Highest pyramid level: each halves the picture, doubling the steps that are found.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=15))]
    levels: u8,
    /// Corners that come back this far from where they started are lost, in pixels.
    #[arg(long, value_name = "PX", default_value_t = 0.5, value_parser = parse_positive)]
    round_trip: f64,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Input")]
struct InputArgs {
    /// Frames a second: stamps of pictures [default: 30], rate asked of a camera.
    #[arg(long, value_name = "RATE", value_parser = parse_positive)]
    fps: Option<f64>,
    /// Picture size asked of a camera.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<(u32, u32)>,
}

/// Milliseconds since the last call.
struct Lap(Instant);

impl Lap {
    fn ms(&mut self) -> f64 {
        let now = Instant::now();
        let ms = (now - self.0).as_secs_f64() * 1e3;
        self.0 = now;
        ms
    }
}

/// Corners of the frame before and where they are now.
struct Scene {
    detector: CornerDetector,
    tracker: FlowTracker,
    mask: Option<CornerMask>,
    corners: Vec<Corner>,
    points: Vec<[f32; 2]>,
    tracks: Vec<Track>,
}

impl Scene {
    fn new(args: &CornerArgs) -> Result<Self> {
        let detector = CornerDetector::new(CornerOptions {
            max_corners: args.corners as usize,
            quality_level: args.quality,
            min_distance: args.min_distance as f32,
            // Corners all over the picture say more than a crowd on one thing.
            cells: (4, 3),
        });
        let flow = FlowOptions {
            window: Window::new(args.window, args.window).or_bad_input()?,
            max_level: usize::from(args.levels),
            max_round_trip: Some(args.round_trip as f32),
            ..FlowOptions::default()
        };
        Ok(Self {
            detector: detector.or_bad_input()?,
            tracker: FlowTracker::new(flow).or_bad_input()?,
            mask: None,
            corners: Vec::new(),
            points: Vec::new(),
            tracks: Vec::new(),
        })
    }

    /// Width and height of the previous and the present frame, where there are.
    fn sizes(&self) -> [Option<(u32, u32)>; 2] {
        [self.tracker.previous(), self.tracker.present()]
            .map(|pyramid| pyramid.full().ok().map(|level| (level.width(), level.height())))
    }

    /// Finds corners in the previous frame, outside `target`, and tracks them.
    fn track(&mut self, target: Option<&BoundingBox>) -> Result<()> {
        let full = self.tracker.previous().full()?;
        let (width, height) = (full.width(), full.height());
        let mask = target.map(|bbox| {
            let inside = bbox.clipped(width as f32, height as f32);
            let (x, y) = (inside.x0.floor() as u32, inside.y0.floor() as u32);
            let (x1, y1) = (inside.x1.ceil() as u32, inside.y1.ceil() as u32);
            let fits = |m: &CornerMask| (m.width(), m.height()) == (width, height);
            let mut mask = self
                .mask
                .take()
                .filter(fits)
                .unwrap_or_else(|| CornerMask::new(width, height, true));
            mask.fill(true);
            let region = Region { x, y, width: x1.saturating_sub(x), height: y1.saturating_sub(y) };
            mask.set(region, false);
            mask
        });
        self.detector.detect(self.tracker.previous(), mask.as_ref(), &mut self.corners)?;
        self.mask = mask.or(self.mask.take());
        self.points.clear();
        self.points.extend(self.corners.iter().map(|corner| corner.point));
        Ok(self.tracker.track(&self.points, None, &mut self.tracks)?)
    }

    /// No pair, no corners.
    fn clear(&mut self) {
        self.points.clear();
        self.tracks.clear();
    }
}

/// Where the target's boxes come from.
fn open_finder(args: &TargetArgs, engine: &EngineArgs) -> Result<Finder> {
    if let Some(path) = &args.boxes {
        return Ok(Finder::Boxes(TargetBoxes::read(path).or_bad_input()?));
    }
    let Some(path) = &args.model else {
        return Ok(args.bbox.map_or(Finder::None, |_| Finder::First));
    };
    let model = open_model(path)?;
    let options = DetectorOptions {
        size: args.imgsz,
        confidence: args.conf,
        classes: parse_classes(&args.classes, model.names())?,
        ..DetectorOptions::default()
    };
    let detector = start_detector(path, model, &engine.start(), options)?;
    Ok(Finder::Model(Box::new(detector)))
}

/// The number of a frame in a file of boxes: that in the picture's name, or its
/// place in the source.
pub(in crate::cli) fn number_of(shot: &SourceFrame, kind: SourceKind) -> u64 {
    let stem = Path::new(&shot.name).file_stem().unwrap_or_default().to_string_lossy();
    let is_number = !stem.is_empty() && stem.bytes().all(|b| b.is_ascii_digit());
    match kind {
        SourceKind::Picture | SourceKind::Pictures if is_number => {
            stem.parse().unwrap_or(shot.index)
        }
        _ => shot.index,
    }
}

pub(crate) fn run(args: &TrackArgs) -> Result<Outcome> {
    let mut scene = Scene::new(&args.corners)?;
    let finder = open_finder(&args.target, &args.engine)?;
    let mut target = Target::new(finder, args.target.every, args.target.bbox)?;
    let input = SourceOptions { fps: args.input.fps, size: args.input.size, ..Default::default() };
    let mut source = source::open(&args.source, &input).or_bad_input()?;
    if source.kind() == SourceKind::Picture {
        return Err(bad_input(format!("{}: one picture has no motion", args.source)));
    }
    interrupt::stop_on_interrupt(&source);
    let mut saver = args.save.as_deref().map(|folder| Saver::new(folder, &source)).transpose()?;
    let mut view = View::new(args.pair, target.is_wanted())?;
    let mut output = Output::stdout();
    let mut summary = Summary::default();

    let length = source.len_hint().map(|n| args.limit.map_or(n, |limit| n.min(limit)));
    let bar = progress::bar(length.filter(|n| *n > 1), "track");
    let mut outcome = Outcome::Done;
    let mut failure = None;
    let mut seen = 0;
    while args.limit.is_none_or(|limit| seen < limit) {
        let Some(item) = source.next() else { break };
        if interrupt::interrupted() {
            break;
        }
        seen += 1;
        let mut shot = match item {
            Ok(shot) => shot,
            Err(error) => {
                bar.suspend(|| report(&Error::new(error)));
                outcome = Outcome::BadInputs;
                continue;
            }
        };
        let number = number_of(&shot, source.kind());
        // What is written so far must be closed before a failure is reported.
        let done = follow(&mut scene, &mut target, &shot, number).and_then(|record| {
            summary.add(&record);
            if let [Some((w, h)), Some((u, v))] = scene.sizes()
                && (w, h) != (u, v)
            {
                let index = shot.index;
                let note = format!("frame {index}: no flow from {w}x{h} to {u}x{v} pixels");
                bar.suspend(|| say(note));
            }
            if args.json {
                output.json(&record)?;
            } else {
                bar.suspend(|| output.line(record.line()))?;
            }
            let Some(saver) = &mut saver else { return Ok(()) };
            view.marks(&scene.points, &scene.tracks, &target);
            if let Some(picture) = view.before_after(&shot, &record)? {
                saver.before_after(&picture)?;
            }
            view.draw(&mut shot.frame, &record);
            saver.write(&shot, source.fps())
        });
        bar.inc(1);
        if let Err(error) = done {
            failure = Some(error);
            break;
        }
        source.recycle(shot.frame);
    }
    bar.finish_and_clear();
    let closed = match saver {
        Some(saver) => saver.finish(view.best_pair()),
        None => Ok(()),
    };
    match (failure, closed) {
        (None, closed) => closed?,
        (Some(error), Ok(())) => return Err(error),
        // Both are told; a reader that went away is no news.
        (Some(first), Err(second)) if is_broken_pipe(&first) => return Err(second),
        (Some(first), Err(second)) => {
            report(&second);
            return Err(first);
        }
    }
    if !args.json {
        output.line(summary.line())?;
    }
    if source.dropped() > 0 {
        say(format!("{} stale frames were dropped", source.dropped()));
    }
    if interrupt::interrupted() {
        return Ok(Outcome::Interrupted);
    }
    if let Some(path) = args.target.boxes.as_ref().filter(|_| !target.had_box()) {
        say(format!(
            "{}: no box for any frame; a frame's number is that of its picture's name, or its \
             place in the source from 0",
            path.display()
        ));
    }
    if let Some(pair) = args.pair.filter(|_| view.lacks_pair()) {
        say(format!("--pair {pair}: no frame {pair} with one of its size before it came"));
        outcome = Outcome::BadInputs;
    }
    Ok(outcome)
}

/// Corners, flow and box of one frame.
fn follow(
    scene: &mut Scene,
    target: &mut Target,
    shot: &SourceFrame,
    number: u64,
) -> Result<TrackRecord> {
    let mut lap = Lap(Instant::now());
    let mut ms = TrackMs::default();
    scene.tracker.push(&shot.frame);
    ms.pyramid = lap.ms();
    match scene.sizes() {
        [Some(before), Some(now)] if before == now => scene.track(target.previous_box())?,
        _ => scene.clear(),
    }
    ms.flow = lap.ms();
    target.carry(scene.tracker.previous(), scene.tracker.present());
    ms.carry = lap.ms();
    target.look(&shot.frame, number)?;
    ms.detect = lap.ms();
    Ok(TrackRecord::new(shot, &scene.points, &scene.tracks, target.state(), ms))
}
