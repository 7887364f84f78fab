//! `realnet eval motion`.

mod measure;
mod page;

use crate::cli::{
    camera_args::CameraArgs,
    command_line,
    failure::{OrBadInput, Outcome, bad_input, report, say},
    interrupt,
    model_args::parse_positive,
    output::Output,
    progress,
};
use anyhow::{Error, Result};
use clap::Args;
use measure::{Figures, Measurement};
use page::{INDEX, Page};
use realnet::{
    CameraModel, Distortion, Intrinsics,
    datasets::{
        TargetBoxes,
        rgbd::{RgbdError, RgbdOptions, RgbdSequence},
    },
    motion::MotionError,
};
use std::path::PathBuf;

#[derive(Debug, Args)]
pub(crate) struct MotionArgs {
    /// An RGB-D sequence: a folder as in 7-Scenes or TUM RGB-D.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Every K-th frame's depth map is given, those in between are to be produced.
    #[arg(long, value_name = "K", default_value_t = 9, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// A given depth map comes so many frames after its frame, as a network's does.
    #[arg(long, value_name = "N", default_value_t = 0)]
    late: u32,
    /// Use only the first N frames.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// The target's boxes: a CSV file (frame,x0,y0,x1,y1) or a folder of YOLO labels.
    #[arg(long, value_name = "FILE|DIR")]
    boxes: Option<PathBuf>,
    /// Write a page with pictures and curves, metrics.json and frames.csv into this directory.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// One JSON object on standard output, and nothing else there.
    #[arg(long)]
    json: bool,
    /// Seed of the samples drawn.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,

    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    files: FileArgs,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Files")]
struct FileArgs {
    /// Depth units a metre [default: by the layout: 1000 or 5000].
    #[arg(long, value_name = "UNITS", value_parser = parse_positive)]
    depth_scale: Option<f64>,
    /// Frames a second, where the data have no time stamps.
    #[arg(long, value_name = "FPS", default_value_t = 30.0, value_parser = parse_positive)]
    fps: f64,
}

pub(crate) fn run(args: &MotionArgs) -> Result<Outcome> {
    let options = RgbdOptions {
        depth_scale: args.files.depth_scale,
        fps: args.files.fps,
        ..RgbdOptions::default()
    };
    if args.late >= args.every {
        let (late, every) = (args.late, args.every);
        return Err(bad_input(format!("--late {late} must be less than --every {every}")));
    }
    let sequence = RgbdSequence::open(&args.data, &options).or_bad_input()?;
    let boxes =
        args.boxes.as_deref().map(|path| TargetBoxes::read(path).or_bad_input()).transpose()?;
    let limit = args.limit.map_or(usize::MAX, |limit| limit as usize);
    let frames = sequence.frames().get(..limit).unwrap_or(sequence.frames());
    if frames.len() < 2 {
        let data = args.data.display();
        return Err(bad_input(format!("{data}: one frame has no motion, at least 2 are needed")));
    }
    if frames.iter().all(|frame| frame.depth_path.is_none()) {
        return Err(bad_input(format!("{}: no frame has a depth map", args.data.display())));
    }
    if let (Some(boxes), Some(path)) = (&boxes, &args.boxes)
        && !boxes.numbers().any(|number| frames.iter().any(|frame| frame.number == number))
    {
        say(format!("{}: no box for any frame", path.display()));
    }
    let first = frames[0].color().or_bad_input()?;
    let camera = camera(&args.camera, &sequence, first.width(), first.height())?;
    let mut page = match &args.report {
        Some(directory) => {
            Some(Page::create(directory, frames.len() as u64, args.boxes.as_deref())?)
        }
        None => None,
    };

    let mut measurement = Measurement::new(&camera, args.every, args.late, args.seed)?;
    let bar = progress::bar(Some(frames.len() as u64), "eval motion");
    let mut outcome = Outcome::Done;
    for (index, frame) in (0..).zip(frames) {
        if interrupt::interrupted() {
            outcome = Outcome::Interrupted;
            break;
        }
        let done = frame.read().map_err(Error::new).and_then(|(color, depth)| {
            let target =
                boxes.as_ref().and_then(|b| b.get(frame.number, color.width(), color.height()));
            measurement.frame(frame, color, depth, target, |view| match &mut page {
                Some(page) => page.offer(index, view),
                None => Ok(()),
            })
        });
        if let Err(error) = done {
            // A frame that is bad costs only itself.
            let motion = error.downcast_ref();
            let unfit =
                matches!(motion, Some(MotionError::Size { .. } | MotionError::Order { .. }));
            if !(unfit || error.is::<RgbdError>()) {
                return Err(error);
            }
            bar.suspend(|| report(&error));
            outcome = Outcome::BadInputs;
            measurement.skip()?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let figures = measurement.figures();
    let written = page.map_or(Ok(()), |page| {
        let title = args.data.display().to_string();
        page.finish(&title, &command_line(), &figures, &table(&figures), measurement.frames())
    });
    let mut output = Output::stdout();
    let told = if args.json { output.json(&figures) } else { output.line(table(&figures)) };
    // Neither a full disk nor a reader that went away costs the other its figures.
    written?;
    if let Some(directory) = &args.report {
        say(format!("the report is {}", directory.join(INDEX).display()));
    }
    told.map(|()| outcome)
}

/// The camera that the flags tell, or the layout's customary one.
fn camera(
    args: &CameraArgs,
    sequence: &RgbdSequence,
    width: u32,
    height: u32,
) -> Result<CameraModel> {
    if let Some(camera) = args.given(width, height)? {
        return Ok(camera);
    }
    let layout = sequence.layout();
    let intrinsics = layout.customary_intrinsics(width, height).ok_or_else(|| {
        bad_input(format!(
            "{}: no customary camera for {layout} pictures of {width}x{height}: give --fx (and \
             --fy, --cx, --cy), or --camera camera.yaml",
            sequence.folder().display()
        ))
    })?;
    let Intrinsics { fx, fy, cx, cy } = intrinsics;
    say(format!("camera: the customary one of {layout}: {fx} {fy} {cx} {cy}"));
    CameraModel::new(width, height, intrinsics, Distortion::None).or_bad_input()
}

/// The figures for people.
fn table(figures: &Figures) -> String {
    let value = |value: Option<f64>, digits: usize, unit: &str| match value {
        Some(value) => format!("{value:.digits$}{unit}"),
        None => "unknown".to_owned(),
    };
    let share = |share: Option<f64>| value(share.map(|s| 100.0 * s), 1, " %");
    let mut lines = vec![
        format!(
            "{} frames, depth given on {}, produced for {} ({} failed)",
            figures.frames, figures.given, figures.produced, figures.failed
        ),
        "                  produced   last map held".to_owned(),
    ];
    for (name, produced, hold) in [
        ("abs_rel", figures.abs_rel, figures.abs_rel_hold),
        ("sq_rel, m", figures.sq_rel, figures.sq_rel_hold),
        ("rmse, m", figures.rmse, figures.rmse_hold),
        ("rmse_log", figures.rmse_log, figures.rmse_log_hold),
        ("d1", figures.d1, figures.d1_hold),
    ] {
        lines.push(format!("  {name:<14}  {:<9}  {}", value(produced, 4, ""), value(hold, 4, "")));
    }
    lines.push(format!(
        "  {:<14}  {:<9}  {}",
        "pixels known",
        share(figures.known_share),
        share(figures.known_share_hold)
    ));
    if figures.target_frames > 0 {
        lines.push(format!(
            "target: abs_rel {} (held: {}), {} of {} frames failed",
            value(figures.target_abs_rel, 4, ""),
            value(figures.target_abs_rel_hold, 4, ""),
            figures.target_failed,
            figures.target_frames
        ));
    }
    lines.push(format!(
        "camera motion a frame: off by {} and {} (mean of {} pairs)",
        value(figures.rpe_trans_m.map(|m| 1000.0 * m), 2, " mm"),
        value(figures.rpe_rot_deg, 3, " deg"),
        figures.rpe_pairs
    ));
    lines.push(format!(
        "{} a frame (median: corners and motion {}, warping {}); corners of a new depth map {}",
        value(figures.ms_per_frame, 2, " ms"),
        value(figures.ms_motion, 2, " ms"),
        value(figures.ms_warp, 2, " ms"),
        value(figures.ms_key, 2, " ms")
    ));
    for (reason, count) in &figures.failures {
        lines.push(format!("  {count} x {reason}"));
    }
    lines.push(figures.protocol.clone());
    lines.join("\n")
}
