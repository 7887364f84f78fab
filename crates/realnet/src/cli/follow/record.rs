//! What is said of a frame.

use realnet::pipeline::{Step, Work};
use realnet_core::TrackStatus;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Instant;

/// Milliseconds of the work on a frame.
#[derive(Clone, Debug)]
pub(super) struct Clock {
    last: Instant,
    /// What was done, and how long it took.
    spent: [Option<f64>; Work::ALL.len()],
}

impl Clock {
    pub(super) fn start() -> Self {
        Self { last: Instant::now(), spent: [None; Work::ALL.len()] }
    }

    /// A part of the work is done.
    pub(super) fn mark(&mut self, done: Work) {
        let now = Instant::now();
        self.took(done, (now - self.last).as_secs_f64() * 1e3);
        self.last = now;
    }

    /// A part of the work took so long, elsewhere.
    pub(super) fn took(&mut self, done: Work, ms: f64) {
        if let Some(spent) = self.spent.get_mut(done as usize) {
            *spent = Some(spent.unwrap_or(0.0) + ms);
        }
    }

    /// What was done, with its milliseconds.
    pub(super) fn spent(&self) -> impl Iterator<Item = (Work, f64)> + '_ {
        Work::ALL.into_iter().zip(self.spent).filter_map(|(work, ms)| Some((work, ms?)))
    }
}

/// Ranges by one cue each, metres along the optical axis; null where it says nothing.
#[derive(Clone, Copy, Debug, Serialize)]
struct Cues {
    /// The newest depth map, held.
    #[serde(serialize_with = "rounded")]
    network: Option<f64>,
    /// The same moved here by flow.
    #[serde(serialize_with = "rounded")]
    motion: Option<f64>,
    /// The target's foot on the ground.
    #[serde(serialize_with = "rounded")]
    ground: Option<f64>,
    /// The target's known height.
    #[serde(serialize_with = "rounded")]
    size: Option<f64>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct CommandRecord {
    #[serde(serialize_with = "rounded_number")]
    steering_rad: f64,
    #[serde(serialize_with = "rounded_number")]
    speed_mps: f64,
    stop: Option<&'static str>,
}

/// One line of JSON, fields in this order.
#[derive(Clone, Debug, Serialize)]
pub(super) struct FollowRecord<'a> {
    frame: u64,
    source: &'a str,
    stamp_ns: i64,
    state: &'static str,
    class: Option<&'a str>,
    /// Left, top, right, bottom in pixels of the source.
    #[serde(rename = "box", serialize_with = "rounded_all")]
    bbox: Option<[f64; 4]>,
    /// Along the optical axis to the target's visible surface.
    #[serde(serialize_with = "rounded")]
    range_m: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_sigma_m: Option<f64>,
    /// In the camera's optical frame: right, down, ahead.
    #[serde(serialize_with = "rounded_all")]
    position_m: Option<[f64; 3]>,
    /// Over ground, along the same axes.
    #[serde(serialize_with = "rounded_all")]
    velocity_mps: Option<[f64; 3]>,
    cues: Cues,
    command: CommandRecord,
    ms: BTreeMap<&'static str, f64>,
}

impl<'a> FollowRecord<'a> {
    /// Of a step that was made of frame `frame` of `source`; `class` is that of the target.
    pub(super) fn new(
        frame: u64,
        source: &'a str,
        class: Option<&'a str>,
        step: &Step,
        clock: &Clock,
    ) -> Self {
        let (report, command) = (&step.report, &step.command);
        let bbox = report.target.map(|at| at.bbox);
        let ms = clock.spent().map(|(work, ms)| (work.name(), (ms * 1e3).round() / 1e3));
        Self {
            frame,
            source,
            stamp_ns: report.stamp.nanos(),
            state: report.status.name(),
            class: bbox.and(class),
            bbox: bbox.map(|b| [b.x0, b.y0, b.x1, b.y1].map(f64::from)),
            range_m: report.fused_m.map(|(range, _)| range),
            range_sigma_m: report.fused_m.map(|(_, std)| std),
            position_m: report.position_m,
            velocity_mps: report.velocity_m_s,
            cues: Cues {
                network: report.network_m,
                motion: report.fast_m,
                ground: report.ground_m,
                size: report.size_m,
            },
            command: CommandRecord {
                steering_rad: command.steering_angle,
                speed_mps: command.speed,
                stop: command.stop.map(|stop| stop.name()),
            },
            ms: ms.collect(),
        }
    }
}

/// `1.42 m +-0.05`, or nothing.
pub(super) fn range_text(step: &Step) -> String {
    step.report.fused_m.map(|(range, std)| format!("{range:.2} m ±{std:.2}")).unwrap_or_default()
}

/// `steering +3.1 deg, 0.42 m/s`, or why it stops.
pub(super) fn command_text(step: &Step) -> String {
    let command = &step.command;
    let steering = command.steering_angle.to_degrees();
    let mut text = format!("steering {steering:+.1}°, {:.2} m/s", command.speed);
    if let Some(stop) = command.stop {
        let _ = write!(text, ", stop: {stop}");
    }
    text
}

/// One line for a person.
pub(super) fn describe(frame: u64, source: &str, step: &Step, clock: &Clock) -> String {
    let status = step.report.status;
    let mut line = format!("{source} #{frame}: {status}");
    if status != TrackStatus::Searching && step.report.fused_m.is_some() {
        let _ = write!(line, ", {}", range_text(step));
    }
    let total: f64 = clock.spent().map(|(_, ms)| ms).sum();
    let _ = write!(line, ", {} ({total:.1} ms)", command_text(step));
    line
}

fn six(value: f64) -> Option<f64> {
    value.is_finite().then(|| (value * 1e6).round() / 1e6)
}

fn rounded_number<S: Serializer>(value: &f64, out: S) -> Result<S::Ok, S::Error> {
    six(*value).serialize(out)
}

fn rounded<S: Serializer>(value: &Option<f64>, out: S) -> Result<S::Ok, S::Error> {
    value.and_then(six).serialize(out)
}

fn rounded_all<const N: usize, S: Serializer>(
    values: &Option<[f64; N]>,
    out: S,
) -> Result<S::Ok, S::Error> {
    values.map(|values| values.map(six).to_vec()).serialize(out)
}
