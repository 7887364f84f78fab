//! `realnet follow`: see, range and follow.

mod chase;
mod feed;
mod motors;
mod record;
mod recorder;
mod saver;
mod spent;

use super::camera_args::CameraArgs;
use super::failure::{OrBadInput, Outcome, is_broken_pipe, report, say};
use super::model_args::{parse_positive, parse_size};
use super::network_args::NetworkArgs;
use super::robot_args::RobotArgs;
use super::{interrupt, progress};
use anyhow::{Error, Result};
use chase::Chase;
use clap::Args;
use feed::{Feed, Next, Shot};
use motors::MotorArgs;
use realnet::source::{self, Source, SourceOptions};
use realnet::{CameraModel, Distortion, Intrinsics};
use saver::Saver;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// The robot is looked after at least so often, whether or not a frame comes.
const IDLE: Duration = Duration::from_millis(50);

#[derive(Debug, Args)]
pub(crate) struct FollowArgs {
    /// A picture, folder or glob of pictures, a video, stream (rtsp://…) or camera
    /// (/dev/video0).
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
    /// Record everything into this new MCAP file: frames, detections, depth, state, commands;
    /// Foxglove shows it.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// One JSON object a frame on standard output, and nothing else there.
    #[arg(long)]
    json: bool,
    /// Stop after so many frames.
    #[arg(long, value_name = "N")]
    limit: Option<u64>,
    /// Recorded frames come when their stamps say, as from a camera: what is not taken in
    /// time is dropped.
    #[arg(long)]
    realtime: bool,
    /// Frames a second: stamps of pictures [default: 30], rate asked of a camera.
    #[arg(long, value_name = "RATE", value_parser = parse_positive)]
    fps: Option<f64>,
    /// Picture size asked of a camera.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<(u32, u32)>,
    /// Horizontal angle of view, degrees, where nothing else tells the camera
    /// [default: 65, with a warning].
    #[arg(long, value_name = "DEGREES", value_parser = parse_fov, conflicts_with_all = ["camera", "fx"])]
    fov: Option<f64>,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    robot: RobotArgs,
    #[command(flatten)]
    motors: MotorArgs,
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
    let input = SourceOptions { fps: args.fps, size: args.size, ..SourceOptions::default() };
    let source = source::open(&args.source, &input).or_bad_input()?;
    interrupt::stop_on_interrupt(&source);
    let saver = args.save.as_deref().map(|folder| Saver::new(folder, &source)).transpose()?;
    let length = source.len_hint().map(|n| args.limit.map_or(n, |limit| n.min(limit)));
    let bar = progress::bar(length.filter(|n| *n > 1), "follow");
    let live = args.realtime || source.is_live();
    let motors = args.motors.open(live)?;
    let mut chase = Chase::new(args, (saver, motors), bar, (live, source.fps()));
    let (done, dropped) = if live {
        let feed = Feed::start(source)?;
        (by_itself(args, &feed, &mut chase), feed.dropped())
    } else {
        (recorded(args, source, &mut chase), 0)
    };
    let bad = chase.bad();
    // What was written must be closed before a failure is reported.
    let closed = chase.finish();
    if let Err(error) = done {
        if let (Err(second), false) = (&closed, is_broken_pipe(&error)) {
            report(second);
        }
        return Err(error);
    }
    for said in closed? {
        say(said);
    }
    if dropped > 0 {
        say(format!("{dropped} frames came while another one was in work, and were dropped"));
    }
    Ok(match (interrupt::interrupted(), bad) {
        (true, _) => Outcome::Interrupted,
        (false, 0) => Outcome::Done,
        (false, _) => Outcome::BadInputs,
    })
}

/// All frames, one after the other, however long it takes.
fn recorded(args: &FollowArgs, mut source: Source, chase: &mut Chase<'_>) -> Result<()> {
    let mut seen = 0;
    while args.limit.is_none_or(|limit| seen < limit) && !interrupt::interrupted() {
        let Some(item) = source.next() else { break };
        seen += 1;
        match item {
            Ok(shot) => {
                let stamp = shot.frame.stamp();
                if let Some(frame) = chase.frame(shot, Instant::now(), stamp)? {
                    source.recycle(frame);
                }
            }
            Err(error) => chase.complain(&Error::new(error)),
        }
    }
    Ok(())
}

/// Frames as they come, the newest first.
fn by_itself(args: &FollowArgs, feed: &Feed, chase: &mut Chase<'_>) -> Result<()> {
    let mut seen = 0;
    while args.limit.is_none_or(|limit| seen < limit) && !interrupt::interrupted() {
        match feed.next(IDLE) {
            Next::Shot(Ok(Shot { shot, arrived })) => {
                seen += 1;
                let now = feed.now().unwrap_or(shot.frame.stamp());
                chase.frame(shot, arrived, now)?;
            }
            Next::Shot(Err(error)) => chase.complain(&Error::new(error)),
            Next::Nothing => feed.now().into_iter().for_each(|now| chase.idle(now)),
            Next::End => break,
        }
    }
    Ok(())
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
