//! `realnet sim`: the follower in the simulator, and data sets from it.

mod dataset;
mod json;
mod report;
mod runs;
mod table;
mod video;

use super::camera_args::{parse_camera_height, parse_camera_pitch};
use super::failure::{OrBadInput, Outcome, bad_input, report as report_error, say};
use super::network_args::NetworkArgs;
use super::output::Output;
use super::{command_line, interrupt};
use anyhow::{Context, Result};
use clap::Args;
use json::RunResult;
use realnet::Runtime;
use realnet_core::Pose2;
use realnet_io::atomic;
use realnet_pipeline::DepthEstimator;
use realnet_sim::dataset::{DatasetSpec, KnownMount};
use realnet_sim::scenario::Scenario;
use realnet_sim::{Perception, RunFigures, RunLog};
use report::PageOptions;
use runs::Ended;
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use table::ScenarioRow;
use video::RunVideo;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  realnet sim --list
  realnet sim --scenario hard-braking --seed 3 --report out/ --video out/hard-braking.mp4
  realnet sim --all --seeds 20 --report out/
  realnet sim --dataset data/sim --frames 2000 --seed 1
  realnet sim --dataset data/mine --frames 2000 --camera-height 0.18

Exit codes: 0 all passed, 1 a run did not pass or ended in an error, 2 bad input, 130
interrupted. With --json each run is printed once it and all before it are done.")]
pub(crate) struct SimArgs {
    #[command(flatten)]
    what: WhatArgs,
    /// Seed of a run: rooms, light, vehicles, latencies and noise are drawn from it.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Runs of each scenario, with the seeds from --seed on.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with_all = ["list", "dataset"],
        value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// Who sees for the follower: the truth with a network's errors, or networks.
    #[arg(long, value_enum, default_value_t = PerceptionFlag::Truth, conflicts_with_all = ["list", "dataset"])]
    perception: PerceptionFlag,
    #[command(flatten)]
    networks: NetworkArgs,
    /// Write a page for each run, and one over all, into this folder.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["list", "dataset"])]
    report: Option<PathBuf>,
    /// Write each frame of the runs as lines of numbers (CSV) into this folder.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["list", "dataset"])]
    log: Option<PathBuf>,
    /// Write what the camera saw, with what was made of it, as a video; of one run.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["list", "dataset"])]
    video: Option<PathBuf>,
    /// Runs at a time [default: the number of processors].
    #[arg(long, value_name = "N")]
    jobs: Option<NonZeroUsize>,
    /// JSON: an object a line for each run, or for each scenario of --list.
    #[arg(long, conflicts_with = "dataset")]
    json: bool,
    /// Frames of a data set.
    #[arg(long, value_name = "N", default_value_t = 1000, conflicts_with_all = ["list", "scenario", "all"],
        value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    frames: u64,
    /// Width of the pictures of a data set, pixels.
    #[arg(long, value_name = "PIXELS", default_value_t = 640, conflicts_with_all = ["list", "scenario", "all"],
        value_parser = clap::value_parser!(u32).range(16..=4096))]
    width: u32,
    /// Their height, pixels.
    #[arg(long, value_name = "PIXELS", default_value_t = 360, conflicts_with_all = ["list", "scenario", "all"],
        value_parser = clap::value_parser!(u32).range(16..=4096))]
    height: u32,
    /// Metres of the cameras of a data set above the ground, as your robot has it: a depth
    /// network learns its scale from it [default: 0.10 to 0.32, another for each world].
    #[arg(long, value_name = "M", conflicts_with_all = ["list", "scenario", "all"],
        value_parser = parse_camera_height)]
    camera_height: Option<f64>,
    /// How far they look down, degrees [default: 0 with --camera-height].
    #[arg(long, value_name = "DEGREES", requires = "camera_height", allow_hyphen_values = true,
        value_parser = parse_camera_pitch)]
    camera_pitch: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum PerceptionFlag {
    /// The truth, with the errors of a detector and a depth network.
    Truth,
    /// A detector and a depth network that see what the camera sees.
    Networks,
}

#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
struct WhatArgs {
    /// Say which scenarios there are.
    #[arg(long)]
    list: bool,
    /// Run one scenario.
    #[arg(long, value_name = "NAME")]
    scenario: Option<String>,
    /// Run all scenarios.
    #[arg(long)]
    all: bool,
    /// Write a data set of random worlds into this folder: pictures with boxes (YOLO),
    /// with depth, cameras and poses (RGB-D). One that was interrupted is gone on with.
    #[arg(long, value_name = "DIR")]
    dataset: Option<PathBuf>,
}

pub(crate) fn run(args: &SimArgs) -> Result<Outcome> {
    if args.what.list {
        return list(args.json);
    }
    if let Some(folder) = &args.what.dataset {
        let mount = args
            .camera_height
            .map(|height_m| KnownMount { height_m, pitch_rad: args.camera_pitch.unwrap_or(0.0) });
        let spec = DatasetSpec { seed: args.seed, width: args.width, height: args.height, mount };
        return dataset::write(folder, spec, args.frames, jobs(args), &command_line());
    }
    let scenarios = match &args.what.scenario {
        Some(name) => std::slice::from_ref(scenario(name)?),
        None => Scenario::list(),
    };
    for directory in args.report.iter().chain(&args.log) {
        std::fs::create_dir_all(directory)
            .with_context(|| format!("cannot make the folder {}", directory.display()))
            .or_bad_input()?;
    }
    // After the largest seed comes 0.
    let seeds = (0..args.seeds).map(|index| args.seed.wrapping_add(index));
    let wanted: Vec<(&Scenario, u64)> =
        scenarios.iter().flat_map(|s| seeds.clone().map(move |seed| (s, seed))).collect();
    if args.video.is_some() && wanted.len() > 1 {
        return Err(bad_input(format!("--video is for one run, not for {}", wanted.len())));
    }
    let several = wanted.len() > 1;
    let runtime = match args.perception {
        PerceptionFlag::Truth if args.networks.is_given() => {
            return Err(bad_input("--detector and --depth are for --perception networks"));
        }
        PerceptionFlag::Truth => None,
        PerceptionFlag::Networks => Some(args.networks.runtime(jobs(args).min(wanted.len()))),
    };
    let mut output = Output::stdout();
    let mut done = Done::default();
    let outcome = runs::run_all(
        &wanted,
        jobs(args),
        |scenario, seed, ends_early| {
            one(args, runtime.as_ref(), scenario, seed, several, ends_early)
        },
        |ended| {
            if let (Some(run), true) = (&ended.result, args.json) {
                output.json(&run.record())?;
            }
            done.ended += usize::from(ended.result.is_some() || ended.error.is_some());
            if let (Some(run), true) = (&ended.result, ended.has_page) {
                done.pages.insert(report::page_name(run));
            }
            done.runs.extend(ended.result);
            match ended.error {
                // What is wrong with the only run is the outcome of all.
                Some(error) if !several => return Err(error),
                Some(error) => {
                    report_error(&error);
                    done.errors.push(format!("{error:#}"));
                }
                None => {}
            }
            Ok(())
        },
    );
    // A report is written whatever happened: it says what is done.
    if let Some(directory) = &args.report
        && several
    {
        let has_page = |run: &RunResult| done.pages.contains(&report::page_name(run));
        let page = report::index(&done.runs, has_page, &done.errors, &command_line());
        let path = directory.join(INDEX);
        atomic::write(&path, page.as_bytes())?;
        if !runs::reader_is_gone(&outcome) {
            say(format!("the report is {}", path.display()));
        }
    }
    outcome?;
    if args.json {
        // Each was printed once it could be.
    } else if let ([run], false) = (done.runs.as_slice(), args.what.all) {
        output.line(table::run_table(run))?;
    } else if !done.runs.is_empty() {
        output.line(table::runs_table(&done.runs))?;
    }
    let failed = !done.errors.is_empty() || done.runs.iter().any(|run| !run.passed());
    if interrupt::interrupted() && done.ended < wanted.len() {
        Ok(Outcome::Interrupted)
    } else {
        Ok(if failed { Outcome::Failed } else { Outcome::Done })
    }
}

const INDEX: &str = "index.html";

/// How many threads work.
fn jobs(args: &SimArgs) -> usize {
    let processors = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    args.jobs.map_or(processors, NonZeroUsize::get)
}

fn list(json: bool) -> Result<Outcome> {
    let rows: Vec<ScenarioRow<'_>> = Scenario::list()
        .iter()
        .map(|scenario| ScenarioRow {
            scenario: scenario.name(),
            seconds: scenario.duration_s(),
            description: scenario.description(),
        })
        .collect();
    let mut output = Output::stdout();
    if json {
        rows.iter().try_for_each(|row| output.json(row))?;
    } else {
        output.line(table::list_table(&rows))?;
    }
    Ok(Outcome::Done)
}

fn scenario(name: &str) -> Result<&'static Scenario> {
    Scenario::named(name).ok_or_else(|| {
        let names: Vec<&str> = Scenario::list().iter().map(Scenario::name).collect();
        bad_input(format!("there is no scenario '{name}'; there are {}", names.join(", ")))
    })
}

/// What is known of the runs so far.
#[derive(Debug, Default)]
struct Done {
    runs: Vec<RunResult>,
    /// What went wrong, a sentence each with scenario and seed.
    errors: Vec<String>,
    /// Names of the pages that are there.
    pages: BTreeSet<String>,
    /// Runs that were not interrupted.
    ended: usize,
}

/// One run, with its page and its lines.
fn one(
    args: &SimArgs,
    runtime: Option<&Runtime>,
    scenario: &Scenario,
    seed: u64,
    several: bool,
    ends_early: &dyn Fn() -> bool,
) -> Ended {
    match drive(args, runtime, scenario, seed, ends_early) {
        Ok(Some((run, log))) => {
            // Each whether or not the other could be written.
            let page = write_page(args, &run, &log, several);
            let lines = write_log(args, &log);
            let has_page = args.report.is_some() && page.is_ok();
            Ended { result: Some(run), error: page.and(lines).err(), has_page }
        }
        Ok(None) => Ended::default(),
        Err(error) => Ended { error: Some(error), ..Ended::default() },
    }
}

/// One run, with its video. `None`: ended early.
fn drive(
    args: &SimArgs,
    runtime: Option<&Runtime>,
    scenario: &Scenario,
    seed: u64,
    ends_early: &dyn Fn() -> bool,
) -> Result<Option<(RunResult, RunLog)>> {
    let setup = scenario.instantiate(seed)?;
    let mut video = match &args.video {
        Some(path) => {
            let (model, fps) = (setup.camera.model, setup.camera.rate_hz);
            Some(RunVideo::create(path, model.width(), model.height(), fps)?)
        }
        None => None,
    };
    let (mut written, mut early) = (Ok(()), false);
    let mut options = realnet_sim::follower_options(&setup);
    let mut networks = match runtime {
        Some(runtime) => Some(args.networks.start(runtime, setup.camera.model)?),
        None => None,
    };
    let perception = match &mut networks {
        Some((detector, depth)) => {
            // Whatever kind of vehicle the detector takes it for.
            options.classes.clear();
            options.sight.min_confidence = args.networks.confidence();
            let depth = depth.as_mut().map(|depth| depth as &mut dyn DepthEstimator);
            Perception::Networks { detector, depth }
        }
        None => Perception::Truth,
    };
    let log = realnet_sim::run_with(&setup, options, perception, |moment| {
        if let Some(video) = &mut video {
            let mut frame = moment.rendered.frame.clone();
            let last = moment.run.frames.len().saturating_sub(1);
            written = video.write(&mut frame, moment.run, last, moment.target.map(|at| at.bbox));
        }
        early = ends_early();
        if early || written.is_err() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    written?;
    // Ctrl-C leaves the frames up to then.
    video.map_or(Ok(()), RunVideo::finish)?;
    if early {
        return Ok(None);
    }
    let figures = RunFigures::from_log(&log, setup.expectations.settle_s);
    let failures = setup.expectations.check(&figures, &log);
    let run = RunResult { scenario: setup.name.to_owned(), seed, figures, failures };
    Ok(Some((run, log)))
}

/// The page of a run, if it is wanted.
fn write_page(args: &SimArgs, run: &RunResult, log: &RunLog, several: bool) -> Result<()> {
    let Some(directory) = &args.report else { return Ok(()) };
    let command = command_line();
    let index = several.then_some(INDEX);
    let video = args.video.as_deref().and_then(|path| path.strip_prefix(directory).ok());
    let video = video.and_then(Path::to_str);
    let options = PageOptions { command: &command, video, index };
    let path = directory.join(report::page_name(run));
    atomic::write(&path, report::page(run, log, &options).as_bytes())?;
    if !several {
        say(format!("the report is {}", path.display()));
    }
    Ok(())
}

/// The frames of a run as CSV, if it is wanted: SI units, empty where nothing is known.
fn write_log(args: &SimArgs, log: &RunLog) -> Result<()> {
    let Some(directory) = &args.log else { return Ok(()) };
    let mut text = String::from(
        "time_s,range_true_m,range_network_m,network_age_s,range_fast_m,range_ground_m,range_fused_m,range_fused_std_m,pitch_rad,\
         status,\
         gap_m,clearance_m,lateral_m,speed_command,steering_command,speed,steering,target_speed,\
         x,y,heading,target_x,target_y,target_heading,stop\n",
    );
    for frame in &log.frames {
        let known = |value: Option<f64>| value.map(|v| format!("{v:.6}")).unwrap_or_default();
        let finite = |value: f64| known(Some(value).filter(|v| v.is_finite()));
        let ranges = [
            frame.range_true_m,
            frame.range_network_m,
            frame.network_age_s,
            frame.range_fast_m,
            frame.range_ground_m,
            frame.range_fused_m,
            frame.range_fused_std_m,
            Some(frame.pitch_rad),
        ];
        // Nowhere, when there is none.
        let target = log.target_size.map(|_| frame.target);
        let target = |value: fn(&Pose2) -> f64| target.as_ref().map_or(f64::NAN, value);
        let numbers = [
            frame.gap_m,
            frame.clearance_m,
            frame.lateral_m,
            frame.speed_command,
            frame.steering_command,
            frame.speed,
            frame.steering,
            if log.target_size.is_some() { frame.target_speed } else { f64::NAN },
            frame.follower.x,
            frame.follower.y,
            frame.follower.heading,
            target(|pose| pose.x),
            target(|pose| pose.y),
            target(|pose| pose.heading),
        ];
        let _ = writeln!(
            text,
            "{:.6},{},{},{},{}",
            frame.time_s,
            ranges.map(known).join(","),
            frame.status,
            numbers.map(finite).join(","),
            frame.stop.map(|stop| stop.name()).unwrap_or_default(),
        );
    }
    let path = directory.join(format!("{}-{}.csv", log.scenario, log.seed));
    atomic::write(&path, text.as_bytes())?;
    Ok(())
}
