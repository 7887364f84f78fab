//! `realnet follow`: see, range and follow, on recorded frames.

mod record;
mod saver;

use super::camera_args::CameraArgs;
use super::failure::{OrBadInput, Outcome, bad_input, is_broken_pipe, report, say};
use super::model_args::{parse_classes, parse_positive};
use super::network_args::NetworkArgs;
use super::output::Output;
use super::robot_args::RobotArgs;
use super::{interrupt, progress};
use anyhow::{Error, Result};
use clap::Args;
use realnet::pipeline::{DepthEstimator, Follower, FollowerOptions, Serial, Step, StepError};
use realnet::source::{self, Source, SourceFrame, SourceOptions};
use realnet::{CameraModel, Detection, Distortion, Intrinsics};
use record::{Clock, FollowRecord, describe};
use saver::Saver;
use std::path::PathBuf;

/// A target is taken up at its first detection where frames are further apart than this,
/// seconds: three hits would take too long, and flow may not join them.
const SPARSE_S: f64 = 0.25;

#[derive(Debug, Args)]
pub(crate) struct FollowArgs {
    /// A picture, folder or glob of pictures, or a video.
    #[arg(long, value_name = "WHAT")]
    source: String,
    /// Classes of the detector that may be the target, by name or number [default: all].
    #[arg(long, value_name = "CLASS,…", value_delimiter = ',')]
    target: Vec<String>,
    /// Depth maps a second.
    #[arg(long, value_name = "HZ", default_value_t = 3.0, value_parser = parse_positive)]
    depth_rate: f64,
    /// Write annotated pictures, or one annotated video, into this directory.
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,
    /// One JSON object a frame on standard output, and nothing else there.
    #[arg(long)]
    json: bool,
    /// Stop after so many frames.
    #[arg(long, value_name = "N")]
    limit: Option<u64>,
    /// Frames a second of pictures [default: 30].
    #[arg(long, value_name = "RATE", value_parser = parse_positive)]
    fps: Option<f64>,
    /// Horizontal angle of view, degrees, where nothing else tells the camera
    /// [default: 65, with a warning].
    #[arg(long, value_name = "DEGREES", value_parser = parse_fov, conflicts_with_all = ["camera", "fx"])]
    fov: Option<f64>,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    robot: RobotArgs,
    #[command(flatten)]
    networks: NetworkArgs,
}

/// Where nobody tells the camera, degrees: most webcams have 55 to 80.
const USUAL_FOV: f64 = 65.0;

fn parse_fov(text: &str) -> Result<f64, String> {
    text.parse::<f64>()
        .ok()
        .filter(|degrees| (1.0..=170.0).contains(degrees))
        .ok_or_else(|| format!("'{text}' is not an angle of view in degrees from 1 to 170"))
}

pub(crate) fn run(args: &FollowArgs) -> Result<Outcome> {
    let input = SourceOptions { fps: args.fps, ..SourceOptions::default() };
    let mut source = source::open(&args.source, &input).or_bad_input()?;
    if source.is_live() {
        return Err(bad_input(format!("{}: only recorded frames can be followed", args.source)));
    }
    interrupt::stop_on_interrupt(&source);
    let saver = args.save.as_deref().map(|folder| Saver::new(folder, &source)).transpose()?;
    let length = source.len_hint().map(|n| args.limit.map_or(n, |limit| n.min(limit)));
    let bar = progress::bar(length.filter(|n| *n > 1), "follow");
    let mut chase = Chase { args, running: None, saver, output: Output::stdout(), bad: 0 };
    let mut failure = None;
    let mut seen = 0;
    while args.limit.is_none_or(|limit| seen < limit) && !interrupt::interrupted() {
        let Some(item) = source.next() else { break };
        seen += 1;
        let done = match item {
            Ok(shot) => chase.frame(shot, &source, &bar),
            Err(error) => {
                bar.suspend(|| report(&Error::new(error)));
                chase.bad += 1;
                Ok(())
            }
        };
        bar.inc(1);
        if let Err(error) = done {
            failure = Some(error);
            break;
        }
    }
    bar.finish_and_clear();
    // What was written must be closed before a failure is reported.
    let closed = chase.saver.map_or(Ok(()), Saver::finish);
    if let Some(error) = failure {
        if let (Err(second), false) = (&closed, is_broken_pipe(&error)) {
            report(second);
        }
        return Err(error);
    }
    closed?;
    Ok(match (interrupt::interrupted(), chase.bad) {
        (true, _) => Outcome::Interrupted,
        (false, 0) => Outcome::Done,
        (false, _) => Outcome::BadInputs,
    })
}

/// What is there from the first frame on.
struct Running {
    serial: Serial,
    size: (u32, u32),
    names: Vec<String>,
    /// The target's last detection.
    target: Option<Detection>,
}

impl Running {
    fn start(args: &FollowArgs, shot: &SourceFrame, fps: Option<f64>) -> Result<Self> {
        let size = (shot.frame.width(), shot.frame.height());
        let camera = camera(args, size)?;
        let (detector, depth) = args.networks.start(&args.networks.runtime(1), camera)?;
        let names = detector.0.names().to_vec();
        let mut options = FollowerOptions {
            classes: parse_classes(&args.target, &names)?,
            ..args.robot.follower()
        };
        options.sight.min_confidence = args.networks.confidence();
        if fps.is_some_and(|fps| fps * SPARSE_S < 1.0) {
            options.sight.hits = 1;
        }
        let follower = Follower::new(&camera, options).or_bad_input()?;
        let depth = depth.map(|depth| Box::new(depth) as Box<dyn DepthEstimator>);
        let serial = Serial::new(follower, Box::new(detector), depth, 1.0 / args.depth_rate);
        Ok(Self { serial, size, names, target: None })
    }

    fn step(&mut self, shot: &SourceFrame, clock: &mut Clock) -> Result<Step, StepError> {
        let step = self.serial.step(&shot.frame, &mut |work| clock.mark(work))?;
        let target = step.report.target.map(|at| at.bbox);
        if let Some(bbox) = target {
            let own = |found: &&Detection| found.bbox == bbox;
            self.target = step.detections.iter().find(own).copied().or(self.target);
        }
        Ok(step)
    }

    /// Name of the target's class.
    fn class(&self) -> Option<&str> {
        self.names.get(self.target?.class_id as usize).map(String::as_str)
    }
}

/// A run over all frames.
struct Chase<'a> {
    args: &'a FollowArgs,
    running: Option<Running>,
    saver: Option<Saver>,
    output: Output,
    /// Frames that could not be followed.
    bad: usize,
}

impl Chase<'_> {
    fn frame(
        &mut self,
        mut shot: SourceFrame,
        source: &Source,
        bar: &indicatif::ProgressBar,
    ) -> Result<()> {
        let running = match &mut self.running {
            Some(running) => running,
            none => none.insert(Running::start(self.args, &shot, source.fps())?),
        };
        let mut clock = Clock::start();
        let size = (shot.frame.width(), shot.frame.height());
        let step = if size == running.size {
            running.step(&shot, &mut clock).map_err(Error::from)
        } else {
            let ((width, height), (w, h)) = (size, running.size);
            Err(bad_input(format!("a frame of {width}x{height} after those of {w}x{h}")))
        };
        let step = match step {
            Ok(step) => step,
            Err(error) => {
                let error = error.context(format!("{} #{}", shot.name, shot.index));
                bar.suspend(|| report(&error));
                self.bad += 1;
                return Ok(());
            }
        };
        let class = running.class();
        if self.args.json {
            let record = FollowRecord::new(shot.index, &shot.name, class, &step, &clock);
            self.output.json(&record)?;
        } else {
            let line = describe(shot.index, &shot.name, &step, &clock);
            bar.suspend(|| self.output.line(line))?;
        }
        if let Some(saver) = &mut self.saver {
            let name = class.unwrap_or_default();
            saver.save(&mut shot, &step, running.target.as_ref(), name, source.fps())?;
        }
        source.recycle(shot.frame);
        Ok(())
    }
}

/// The camera of frames of this size.
fn camera(args: &FollowArgs, (width, height): (u32, u32)) -> Result<CameraModel> {
    if let Some(camera) = args.camera.given(width, height)? {
        return Ok(camera);
    }
    let fov = args.fov.unwrap_or_else(|| {
        say(format!(
            "no --camera: taken to see {USUAL_FOV} degrees across; metres are as wrong as that is"
        ));
        USUAL_FOV
    });
    let focal = 0.5 * f64::from(width) / (0.5 * fov.to_radians()).tan();
    let middle = |side: u32| f64::from(side - 1) / 2.0;
    let intrinsics = Intrinsics { fx: focal, fy: focal, cx: middle(width), cy: middle(height) };
    CameraModel::new(width, height, intrinsics, Distortion::None).or_bad_input()
}
