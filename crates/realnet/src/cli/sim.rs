//! `realnet sim`: the follower in the simulator, and data sets from it.

mod dataset;
mod json;
mod report;
mod table;
mod video;

use super::failure::{OrBadInput, Outcome, bad_input, say};
use super::output::Output;
use super::{command_line, interrupt, progress};
use anyhow::{Context, Result};
use clap::Args;
use json::RunResult;
use realnet_core::Pose2;
use realnet_io::atomic;
use realnet_sim::dataset::DatasetSpec;
use realnet_sim::scenario::Scenario;
use realnet_sim::{RunFigures, RunLog};
use report::PageOptions;
use std::fmt::Write as _;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use table::ScenarioRow;
use video::RunVideo;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  realnet sim --list
  realnet sim --scenario hard-braking --seed 3 --report out/ --video out/hard-braking.mp4
  realnet sim --all --seeds 20 --report out/
  realnet sim --dataset data/sim --frames 2000 --seed 1

Exit codes: 0 all passed, 1 a run did not pass, 2 bad input, 130 interrupted.")]
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
        let spec = DatasetSpec { seed: args.seed, width: args.width, height: args.height };
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
    let runs = run_all(args, &wanted)?;
    let outcome = if runs.len() < wanted.len() { Outcome::Interrupted } else { Outcome::Done };
    if let Some(directory) = &args.report
        && wanted.len() > 1
    {
        let page = report::index(&runs, |_| true, &command_line());
        let path = directory.join(INDEX);
        atomic::write(&path, page.as_bytes())?;
        say(format!("the report is {}", path.display()));
    }
    let mut output = Output::stdout();
    if args.json {
        for run in &runs {
            output.json(&run.record())?;
        }
    } else if let ([run], false) = (runs.as_slice(), args.what.all) {
        output.line(table::run_table(run))?;
    } else if !runs.is_empty() {
        output.line(table::runs_table(&runs))?;
    }
    let failed = runs.iter().filter(|run| !run.passed()).count();
    match outcome {
        Outcome::Done if failed > 0 => Ok(Outcome::Failed),
        outcome => Ok(outcome),
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

/// Runs them all, several at a time; in the order they were asked for, without those
/// that Ctrl-C forestalled.
fn run_all(args: &SimArgs, wanted: &[(&Scenario, u64)]) -> Result<Vec<RunResult>> {
    let jobs = jobs(args).min(wanted.len());
    let bar = progress::bar(Some(wanted.len() as u64), "sim");
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::with_capacity(wanted.len()));
    let work = || -> Result<()> {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(&(scenario, seed)) = wanted.get(index) else { return Ok(()) };
            if interrupt::interrupted() {
                return Ok(());
            }
            bar.set_message(format!("{} {seed}", scenario.name()));
            let run = one(args, scenario, seed, wanted.len() > 1)
                .with_context(|| format!("scenario {} with seed {seed}", scenario.name()));
            match run {
                Ok(Some(run)) => {
                    if let Ok(mut done) = done.lock() {
                        done.push((index, run));
                    }
                }
                Ok(None) => return Ok(()),
                Err(error) => {
                    // The others need not go on.
                    next.store(wanted.len(), Ordering::Relaxed);
                    return Err(error);
                }
            }
            bar.inc(1);
        }
    };
    let outcomes: Vec<Result<()>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..jobs).map(|_| scope.spawn(work)).collect();
        let joined = threads.into_iter().map(|thread| {
            thread.join().unwrap_or_else(|_| Err(anyhow::anyhow!("a run ended in a panic")))
        });
        joined.collect()
    });
    bar.finish_and_clear();
    outcomes.into_iter().collect::<Result<()>>()?;
    let mut done = done.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    done.sort_by_key(|(index, _)| *index);
    Ok(done.into_iter().map(|(_, run)| run).collect())
}

/// One run, with its page and its lines. `None`: interrupted.
fn one(args: &SimArgs, scenario: &Scenario, seed: u64, several: bool) -> Result<Option<RunResult>> {
    let setup = scenario.instantiate(seed)?;
    let mut video = match &args.video {
        Some(path) => {
            let (model, fps) = (setup.camera.model, setup.camera.rate_hz);
            Some(RunVideo::create(path, model.width(), model.height(), fps)?)
        }
        None => None,
    };
    let mut written = Ok(());
    let log = realnet_sim::run(&setup, |moment| {
        if let Some(video) = &mut video {
            let mut frame = moment.rendered.frame.clone();
            let last = moment.run.frames.len().saturating_sub(1);
            written = video.write(&mut frame, moment.run, last, moment.target.map(|at| at.bbox));
        }
        if interrupt::interrupted() || written.is_err() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })?;
    written?;
    // Ctrl-C leaves the frames up to then.
    video.map_or(Ok(()), RunVideo::finish)?;
    if interrupt::interrupted() {
        return Ok(None);
    }
    let figures = RunFigures::from_log(&log, setup.expectations.settle_s);
    let failures = setup.expectations.check(&figures, &log);
    let run = RunResult { scenario: setup.name.to_owned(), seed, figures, failures };
    if let Some(directory) = &args.report {
        let command = command_line();
        let index = several.then_some(INDEX);
        let video = args.video.as_deref().and_then(|path| path.strip_prefix(directory).ok());
        let video = video.and_then(Path::to_str);
        let options = PageOptions { command: &command, video, index };
        let path = directory.join(report::page_name(&run));
        atomic::write(&path, report::page(&run, &log, &options).as_bytes())?;
        if !several {
            say(format!("the report is {}", path.display()));
        }
    }
    if let Some(directory) = &args.log {
        write_log(&directory.join(format!("{}-{seed}.csv", setup.name)), &log)?;
    }
    Ok(Some(run))
}

/// The frames of a run as CSV: SI units, empty where nothing is known.
fn write_log(path: &Path, log: &RunLog) -> Result<()> {
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
    atomic::write(path, text.as_bytes())?;
    Ok(())
}
