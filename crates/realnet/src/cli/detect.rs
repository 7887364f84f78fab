//! `realnet detect`.

mod saver;

use super::{
    engine_args::EngineArgs,
    failure::{OrBadInput, Outcome, is_broken_pipe, report},
    interrupt,
    model_args::{
        FilterFlag, open_model, parse_box, parse_classes, parse_positive, parse_share, parse_side,
        parse_size, start_detector,
    },
    output::Output,
    progress,
};
use anyhow::{Context, Error, Result};
use clap::Args;
use realnet::{
    BoundingBox, Detection, DetectorOptions, Stage,
    results::{Record, StageMs},
    source::{self, SourceFrame, SourceOptions},
};
use saver::{SaveArgs, Saver};
use std::{fmt::Write, path::PathBuf, time::Instant};

#[derive(Debug, Args)]
pub(crate) struct DetectArgs {
    /// The network: YOLOv5 weights (.pt, .safetensors) or a YOLO ONNX file.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// A picture, folder, glob, video, stream (rtsp://…) or camera (/dev/video0).
    #[arg(long, value_name = "WHAT")]
    source: String,
    #[command(flatten)]
    save: SaveArgs,
    /// One JSON object a frame on standard output, and nothing else there.
    #[arg(long)]
    json: bool,
    /// Stop after so many frames.
    #[arg(long, value_name = "N")]
    limit: Option<u64>,

    #[command(flatten)]
    look: LookArgs,
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    engine: EngineArgs,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Detection")]
struct LookArgs {
    /// Input size of the network: N or WIDTHxHEIGHT [default: the file's own, or 640].
    #[arg(long, value_name = "N|WxH", value_parser = parse_size)]
    imgsz: Option<(u32, u32)>,
    /// How a frame is fitted into the network's input.
    #[arg(long, value_enum, default_value_t = FilterFlag::Triangle)]
    resize: FilterFlag,
    /// Least confidence, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.25, value_parser = parse_share)]
    conf: f32,
    /// Boxes of a class that overlap by more than this IoU are doubles.
    #[arg(long, value_name = "SHARE", default_value_t = 0.45, value_parser = parse_share)]
    iou: f32,
    /// Most boxes a frame.
    #[arg(long, value_name = "N", default_value_t = 300)]
    max_det: usize,
    /// Least width and height of a box, in pixels of the frame.
    #[arg(long, value_name = "PX", default_value_t = 0.0, value_parser = parse_side, allow_hyphen_values = true)]
    min_size: f32,
    /// Only these classes, by name or number.
    #[arg(long, value_name = "CLASS,…", value_delimiter = ',')]
    classes: Vec<String>,
    /// Look for doubles across classes.
    #[arg(long)]
    agnostic_nms: bool,
    /// Look only around this box (pixels of the frame), on a crop at --near-imgsz.
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = parse_box, allow_hyphen_values = true)]
    near: Option<BoundingBox>,
    /// Input size of the network for --near.
    #[arg(long, value_name = "N|WxH", default_value = "192", value_parser = parse_size)]
    near_imgsz: (u32, u32),
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

/// Stage times of one frame.
struct Clock {
    last: Instant,
    ms: StageMs,
}

impl Clock {
    fn start() -> Self {
        Self { last: Instant::now(), ms: StageMs { pre: 0.0, infer: 0.0, post: 0.0 } }
    }

    fn mark(&mut self, stage: Stage) {
        let now = Instant::now();
        let ms = (now - self.last).as_secs_f64() * 1e3;
        self.last = now;
        match stage {
            Stage::Preprocess => self.ms.pre = ms,
            Stage::Infer => self.ms.infer = ms,
            Stage::Postprocess => self.ms.post = ms,
        }
    }
}

pub(crate) fn run(args: &DetectArgs) -> Result<Outcome> {
    let model = open_model(&args.model)?;
    let options = DetectorOptions {
        size: args.look.imgsz,
        region_size: args.look.near.is_some().then_some(args.look.near_imgsz),
        filter: args.look.resize.into(),
        confidence: args.look.conf,
        iou: args.look.iou,
        max_det: args.look.max_det,
        min_size: args.look.min_size,
        classes: parse_classes(&args.look.classes, model.names())?,
        agnostic: args.look.agnostic_nms,
        multi_label: false,
    };
    let input = SourceOptions { fps: args.input.fps, size: args.input.size, ..Default::default() };
    let mut source = source::open(&args.source, &input).or_bad_input()?;
    interrupt::stop_on_interrupt(&source);
    let mut detector = start_detector(&args.model, model, &args.engine.start(), options)?;
    let names = detector.names().to_vec();
    let mut saver = Saver::new(&args.save, &source, &names)?;
    let mut output = Output::stdout();

    let length = source.len_hint().map(|n| args.limit.map_or(n, |limit| n.min(limit)));
    let bar = progress::bar(length.filter(|n| *n > 1), "detect");
    let mut outcome = Outcome::Done;
    let mut failure = None;
    let mut seen = 0;
    while args.limit.is_none_or(|limit| seen < limit) {
        let Some(item) = source.next() else { break };
        if interrupt::interrupted() {
            break;
        }
        seen += 1;
        let shot = match item {
            Ok(shot) => shot,
            Err(error) => {
                bar.suspend(|| report(&Error::new(error)));
                outcome = Outcome::BadInputs;
                continue;
            }
        };
        let mut clock = Clock::start();
        let mut mark = |stage| clock.mark(stage);
        let found = match &args.look.near {
            Some(near) => detector.detect_near_marked(&shot.frame, near, &mut mark),
            None => detector.detect_marked(&shot.frame, &mut mark),
        };
        // What is written so far must be closed before a failure is reported.
        let done = found.map_err(Error::from).and_then(|found| {
            if args.json {
                let SourceFrame { frame, index, name } = &shot;
                output.json(&Record::new(*index, name, frame, found, &names, clock.ms))?;
            } else {
                let line = describe(&shot, found, &names, &clock.ms);
                bar.suspend(|| output.line(line))?;
            }
            let found = found.to_vec();
            saver.save(shot, &found, source.fps())
        });
        bar.inc(1);
        match done {
            Ok(spent) => source.recycle(spent),
            Err(error) => {
                failure = Some(error);
                break;
            }
        }
    }
    bar.finish_and_clear();
    let closed = saver.finish();
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
    if source.dropped() > 0 {
        super::failure::say(format!("{} stale frames were dropped", source.dropped()));
    }
    if interrupt::interrupted() {
        return Ok(Outcome::Interrupted);
    }
    Ok(outcome)
}

/// One line for a person: `bus.jpg #0 810x1080: 3 person, 1 bus (0.4 + 9.1 + 0.1 ms)`.
fn describe(shot: &SourceFrame, found: &[Detection], names: &[String], ms: &StageMs) -> String {
    let mut counts: Vec<(u32, usize)> = Vec::new();
    for detection in found {
        match counts.iter_mut().find(|(class, _)| *class == detection.class_id) {
            Some((_, count)) => *count += 1,
            None => counts.push((detection.class_id, 1)),
        }
    }
    let mut line = shot.name.clone();
    let (frame, nothing) = (&shot.frame, counts.is_empty());
    // Writing to a string cannot fail.
    let _ = write!(line, " #{} {}x{}:", shot.index, frame.width(), frame.height());
    for (at, (class, count)) in counts.into_iter().enumerate() {
        let name = names.get(class as usize).map_or("?", String::as_str);
        let _ = write!(line, "{} {count} {name}", if at == 0 { "" } else { "," });
    }
    if nothing {
        line.push_str(" nothing");
    }
    let StageMs { pre, infer, post } = ms;
    let _ = write!(line, " ({pre:.1} + {infer:.1} + {post:.1} ms)");
    line
}

/// The directory that results go to.
pub(crate) fn make_directory(path: &std::path::Path) -> Result<()> {
    // The system's `File exists` would say less.
    if path.is_file() {
        anyhow::bail!("{} is a file, not a directory for results", path.display());
    }
    std::fs::create_dir_all(path)
        .with_context(|| format!("cannot make the directory {}", path.display()))
}
