//! A robot behind a target, without pictures: what the follower measures in them is drawn
//! from the truth, with the errors, delays and faults that it has. For the bench, the
//! tests of memory and the soak.
#![allow(dead_code, missing_docs, clippy::unwrap_used, reason = "each target uses its part")]

pub mod limits;
pub mod soak;
pub mod world;

use realnet_control::{ControlInput, ControlOptions, Controller};
use realnet_core::nalgebra::Vector2;
use realnet_core::{DriveCommand, Pose2, Stamp, TargetState};
use realnet_fusion::{TargetFilter, TargetMeasurement, TargetOptions, Track};
use realnet_pipeline::CameraMount;

/// So much of the target's path is given to the controller, seconds.
const TRAIL_S: f64 = 6.0;

/// All that reaches fusion and control at a moment.
#[derive(Clone, Debug)]
pub struct Tick {
    pub now: Stamp,
    /// `None`: no frame came, a timer asks.
    pub frame: Option<Own>,
    /// What has arrived by now, in the order of arrival.
    pub measurements: Vec<TargetMeasurement>,
    pub stop_requested: bool,
}

/// What a frame tells of the robot itself.
#[derive(Clone, Copy, Debug)]
pub struct Own {
    pub stamp: Stamp,
    pub fixed_from_base: Pose2,
    pub speed: f64,
    pub yaw_rate: f64,
}

/// Fusion and control wired as [`realnet_pipeline::Follower`] wires them.
pub struct Pilot {
    pub filter: TargetFilter,
    pub controller: Controller,
    pub refused: u64,
    /// The target at the last frame.
    pub track: Option<Track>,
    /// The same from the robot.
    pub seen: TargetState,
    /// What the last command was made from.
    pub target: TargetState,
    /// The target's path in the base frame, the oldest point first.
    pub trail: Vec<Vector2<f64>>,
    mount: CameraMount,
    last: (Stamp, Pose2),
}

impl Pilot {
    pub fn new(control: ControlOptions) -> Self {
        let fusion = TargetOptions::default();
        Self {
            filter: TargetFilter::new(fusion).unwrap(),
            controller: Controller::new(control).unwrap(),
            refused: 0,
            track: None,
            seen: TargetState::default(),
            target: TargetState::default(),
            trail: Vec::with_capacity(fusion.trail_capacity + fusion.capacity),
            mount: CameraMount::default(),
            last: (Stamp::ZERO, Pose2::IDENTITY),
        }
    }

    /// All of a frame after the pictures: what has arrived is fused, the range is told, and
    /// a command given.
    pub fn step(&mut self, tick: &Tick) -> DriveCommand {
        if tick.stop_requested {
            self.controller.request_stop();
        } else {
            self.controller.release();
        }
        for measurement in &tick.measurements {
            self.refused += u64::from(self.filter.push(*measurement).is_err());
        }
        let Some(own) = tick.frame else {
            return self.controller.idle(tick.now);
        };
        self.last = (own.stamp, own.fixed_from_base);
        let predictor = self.controller.predictor_mut();
        let mixed = |seen: f64, promised: f64| promised + 0.1 * (seen - promised);
        let speed = mixed(own.speed, predictor.speed_at(own.stamp));
        let yaw_rate = mixed(own.yaw_rate, predictor.yaw_rate_at(own.stamp));
        predictor.correct(own.stamp, Some(speed), Some(yaw_rate));
        self.report(&own);
        self.command(tick.now)
    }

    fn report(&mut self, own: &Own) {
        self.track = self.filter.track_at(own.stamp).ok();
        let fixed_from_camera = own.fixed_from_base * self.mount.base_from_camera();
        let range = self.track.and_then(|track| track.range_from(&fixed_from_camera));
        std::hint::black_box(range);
        self.seen =
            self.track.map(|track| track.seen_from(&own.fixed_from_base)).unwrap_or_default();
    }

    fn command(&mut self, now: Stamp) -> DriveCommand {
        let effect = self.controller.effect_time(now);
        let (from, pose) = self.last;
        let fixed_from_base = self.controller.predictor().advance(pose, from, effect);
        self.target = match self.filter.track_at(effect) {
            Ok(track) => track.seen_from(&fixed_from_base),
            Err(_) => TargetState { stamp: effect, ..TargetState::default() },
        };
        let base_from_fixed = fixed_from_base.inverse();
        let since = Stamp::from_secs_f64(now.secs_f64() - TRAIL_S);
        let points = self.filter.trail(since);
        self.trail.clear();
        self.trail.extend(points.map(|point| base_from_fixed.transform_point(&point.position)));
        let input = ControlInput { now, target: &self.target, trail: &self.trail, own_speed: None };
        self.controller.step(&input)
    }
}
