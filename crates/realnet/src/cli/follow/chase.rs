//! Frame after frame: what is said of each, and what is kept.

use super::motors::Motors;
use super::record::{Clock, FollowRecord, describe};
use super::recorder::{Ended, Moment, Recorder};
use super::saver::Saver;
use super::spent::Spent;
use super::{FollowArgs, camera};
use crate::cli::command_line;
use crate::cli::failure::{OrBadInput, bad_input, report};
use crate::cli::model_args::parse_classes;
use crate::cli::output::Output;
use anyhow::{Error, Result};
use indicatif::ProgressBar;
use realnet::pipeline::{
    DepthEstimator, Follower, FollowerOptions, Live, NetworkFailure, Serial, Step,
};
use realnet::recording::RunInfo;
use realnet::source::SourceFrame;
use realnet::{CameraModel, Detection, Frame, Stamp};
use std::sync::Arc;
use std::time::Instant;

/// A target is taken up at its first detection where frames are further apart than this,
/// seconds: three hits would take too long, and flow may not join them.
const SPARSE_S: f64 = 0.25;

/// How the networks are run.
enum Engine {
    /// One after the other.
    Serial(Box<Serial>),
    /// On threads.
    Live(Box<Live>),
}

/// What is there from the first frame on.
struct Running {
    engine: Engine,
    camera: CameraModel,
    names: Vec<String>,
    /// The target's last detection.
    target: Option<Detection>,
}

impl Running {
    fn start(args: &FollowArgs, frame: &Frame, fps: Option<f64>, live: bool) -> Result<Self> {
        let size = (frame.width(), frame.height());
        let camera = camera(args, size)?;
        let (detector, depth) = args.networks.start(&args.networks.runtime(1), camera)?;
        let names = detector.0.names().to_vec();
        let classes = parse_classes(&args.target, &names)?;
        let mut options = FollowerOptions { classes, ..args.robot.follower() };
        options.sight.min_confidence = args.networks.confidence();
        if fps.is_some_and(|fps| fps * SPARSE_S < 1.0) {
            options.sight.hits = 1;
        }
        let follower = Follower::new(&camera, options).or_bad_input()?;
        let detector = Box::new(detector);
        let depth = depth.map(|depth| Box::new(depth) as Box<dyn DepthEstimator>);
        let period_s = 1.0 / args.depth_rate;
        let engine = if live {
            Engine::Live(Box::new(Live::start(follower, detector, depth, period_s)?))
        } else {
            Engine::Serial(Box::new(Serial::new(follower, detector, depth, period_s)))
        };
        Ok(Self { engine, camera, names, target: None })
    }

    fn step(&mut self, frame: &Arc<Frame>, now: Stamp, clock: &mut Clock) -> Result<Step> {
        let size = (frame.width(), frame.height());
        if size != (self.camera.width(), self.camera.height()) {
            let ((width, height), w, h) = (size, self.camera.width(), self.camera.height());
            return Err(bad_input(format!("a frame of {width}x{height} after those of {w}x{h}")));
        }
        let step = match &mut self.engine {
            Engine::Serial(serial) => serial.step(frame, &mut |work| clock.mark(work))?,
            Engine::Live(live) => {
                let step = live.frame(frame, now, &mut |work| clock.mark(work))?;
                live.times().for_each(|time| clock.took(time.work, time.ms));
                step
            }
        };
        if let Some(at) = step.report.target {
            // Of a box that flow carried on, the detection that it overlaps most.
            let overlap = |found: &Detection| found.bbox.iou(&at.bbox);
            let found = step.detections.iter().max_by(|a, b| overlap(a).total_cmp(&overlap(b)));
            self.target = found.filter(|found| overlap(found) > 0.3).copied().or(self.target);
        }
        Ok(step)
    }

    /// Name of the target's class.
    fn class(&self) -> Option<&str> {
        self.names.get(self.target?.class_id as usize).map(String::as_str)
    }
}

/// A run over all frames.
pub(super) struct Chase<'a> {
    args: &'a FollowArgs,
    /// Whether frames come by themselves.
    live: bool,
    /// Frames a second, where that is known.
    fps: Option<f64>,
    running: Option<Running>,
    saver: Option<Saver>,
    motors: Option<Motors>,
    recorder: Option<Recorder>,
    /// Which detections are recorded.
    recorded: Option<Stamp>,
    output: Output,
    bar: ProgressBar,
    spent: Spent,
    frames: u64,
    /// Frames and answers that failed.
    bad: usize,
}

impl<'a> Chase<'a> {
    pub(super) fn new(
        args: &'a FollowArgs,
        (saver, motors): (Option<Saver>, Option<Motors>),
        bar: ProgressBar,
        (live, fps): (bool, Option<f64>),
    ) -> Self {
        let (output, spent) = (Output::stdout(), Spent::new());
        Self {
            args,
            live,
            fps,
            running: None,
            saver,
            motors,
            recorder: None,
            recorded: None,
            output,
            bar,
            spent,
            frames: 0,
            bad: 0,
        }
    }

    /// Frames and answers that failed.
    pub(super) const fn bad(&self) -> usize {
        self.bad
    }

    /// Something was not as it should be; the run goes on.
    pub(super) fn complain(&mut self, error: &Error) {
        self.bar.suspend(|| report(error));
        self.bad += 1;
    }

    /// A frame that came at `arrived`; it is `now`, by the clock of the stamps.
    pub(super) fn frame(
        &mut self,
        shot: SourceFrame,
        arrived: Instant,
        now: Stamp,
    ) -> Result<Option<Frame>> {
        let SourceFrame { frame, index, name } = shot;
        let running = match &mut self.running {
            Some(running) => running,
            none => {
                let running = Running::start(self.args, &frame, self.fps, self.live)?;
                self.recorder = self
                    .args
                    .record
                    .as_deref()
                    .map(|path| {
                        let (camera, names) = (&running.camera, running.names.clone());
                        Recorder::start(path, camera, names, &info(), self.live)
                    })
                    .transpose()?;
                none.insert(running)
            }
        };
        let (frame, mut clock) = (Arc::new(frame), Clock::start());
        let step = match running.step(&frame, now, &mut clock) {
            Ok(step) => step,
            Err(error) => {
                self.complain(&error.context(format!("{name} #{index}")));
                // A frame that is refused is no command; the motors need one all the same.
                self.idle(now);
                return Ok(None);
            }
        };
        let driven = self.motors.as_mut().map_or(Ok(()), |motors| motors.send(&step.command));
        self.spent.add(&clock, arrived.elapsed().as_secs_f64() * 1e3);
        self.frames += 1;
        let class = running.class();
        let record = FollowRecord::new(index, &name, class, &step, &clock);
        let mut recorded = Ok(());
        if let Some(recorder) = &mut self.recorder {
            let moment = Moment {
                arrival: now,
                frame: Arc::clone(&frame),
                detections: step.detections.clone(),
                found_on: step.found_on.filter(|stamp| self.recorded != Some(*stamp)),
                depth: step.depth.clone(),
                state: serde_json::to_value(&record)?,
                command: step.command,
            };
            self.recorded = step.found_on;
            recorded = recorder.take(moment);
        }
        if self.args.json {
            self.output.json(&record)?;
        } else {
            let line = describe(index, &name, &step, &clock);
            self.bar.suspend(|| self.output.line(line))?;
        }
        let target = running.target;
        let mut frame = Arc::try_unwrap(frame).unwrap_or_else(|shared| (*shared).clone());
        if let Some(saver) = &mut self.saver {
            let label = class.unwrap_or_default();
            let mut shot = SourceFrame { frame, index, name };
            saver.save(&mut shot, &step, target.as_ref(), label, self.fps)?;
            frame = shot.frame;
        }
        if let Err(error) = driven {
            self.complain(&error);
        }
        if let Err(Ended) = recorded {
            self.end_recording();
        }
        self.tell_failures();
        Ok(Some(frame))
    }

    /// No frame came for a while, or none that can be followed.
    pub(super) fn idle(&mut self, now: Stamp) {
        if let Some(Running { engine: Engine::Live(live), .. }) = &mut self.running {
            let command = live.idle(now);
            let driven = self.motors.as_mut().map_or(Ok(()), |motors| motors.send(&command));
            if let Err(error) = driven {
                self.complain(&error);
            }
        }
        self.tell_failures();
    }

    /// The recording goes no further, the robot does.
    fn end_recording(&mut self) {
        if let Some(Err(error)) = self.recorder.take().map(Recorder::finish) {
            self.complain(&error);
        }
    }

    fn tell_failures(&mut self) {
        let Some(Running { engine: Engine::Live(live), .. }) = &mut self.running else { return };
        let failures: Vec<NetworkFailure> = live.failures().collect();
        for NetworkFailure { work, stamp, error } in failures {
            self.complain(&anyhow::anyhow!("{} at {} s: {error}", work.name(), stamp.secs_f64()));
        }
    }

    /// Closes what is open, and says where the time went.
    pub(super) fn finish(self) -> Result<Vec<String>> {
        self.bar.finish_and_clear();
        let mut said = Vec::new();
        if self.frames > 0 {
            said.push(format!("{} frames; {}", self.frames, self.spent));
        }
        if let Some(Running { engine: Engine::Live(live), .. }) = &self.running {
            for (name, counts) in ["detector", "depth network"].into_iter().zip(live.counts()) {
                let (taken, skipped) = (counts.taken, counts.skipped);
                said.push(format!("the {name} took {taken} frames, was busy at {skipped}"));
            }
        }
        let saved = self.saver.map_or(Ok(()), Saver::finish);
        let left_out = self.recorder.map_or(Ok(0), Recorder::finish)?;
        if left_out > 0 {
            said.push(format!("{left_out} frames are not in the recording: the disk was too slow"));
        }
        saved?;
        Ok(said)
    }
}

/// What a recording says of the run.
fn info() -> RunInfo {
    let version = ("realnet".to_owned(), env!("CARGO_PKG_VERSION").to_owned());
    let parameters = format!("command = {:?}\n", command_line());
    RunInfo { parameters, versions: [version].into() }
}
