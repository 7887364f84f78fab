//! A long drive, and what is asked of it at every frame.

use super::limits::Limits;
use super::world::{Fault, World};
use super::{Pilot, Tick};
use realnet_control::ControlOptions;
use realnet_core::{DriveCommand, Stamp, TrackStatus};

/// The Unix epoch is so far back when a camera's clock is right: a stamp in seconds as a
/// 64-bit float is good to a quarter of a microsecond then.
pub const START: Stamp = Stamp::from_nanos(1_800_000_000_000_000_000);

/// What came of a drive.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    pub frames: u64,
    pub commands_out_of_limits: u64,
    pub first_out_of_limits: Option<&'static str>,
    pub covariances_not_positive: u64,
    pub not_finite: u64,
    pub stamps_going_back: u64,
    pub tracked: u64,
    pub moving: u64,
    /// How often the target was given up, and tracked again after that.
    pub given_up: u64,
    pub found_again: u64,
    /// Position of the target while it is tracked, metres: all the time, and while nothing
    /// was wrong for a second.
    pub largest_error_m: f64,
    pub largest_calm_error_m: f64,
    pub calm: u64,
    sum_of_squares: f64,
    /// Squared error by the filter's covariance, mean of which is 2 if it is right.
    sum_of_distances: f64,
    /// Faults that occurred.
    pub faults: u64,
}

impl Findings {
    /// Root mean square of the position's error while nothing was wrong, metres.
    pub fn calm_rms_m(&self) -> f64 {
        (self.sum_of_squares / self.calm as f64).sqrt()
    }

    /// Mean squared error by covariance while nothing was wrong; 2 is right.
    pub fn calm_distance(&self) -> f64 {
        self.sum_of_distances / self.calm as f64
    }

    /// Whether all that must always hold held.
    pub fn is_sound(&self) -> bool {
        self.commands_out_of_limits == 0
            && self.covariances_not_positive == 0
            && self.not_finite == 0
            && self.stamps_going_back == 0
    }
}

/// World and pilot, frame by frame.
pub struct Soak {
    world: World,
    pilot: Pilot,
    limits: Limits,
    last: Option<DriveCommand>,
    last_target: Stamp,
    given_up: bool,
    calm_since: u64,
    last_fault: Fault,
    pub findings: Findings,
}

impl Soak {
    pub fn new(seed: u64) -> Self {
        let control = ControlOptions::default();
        Self {
            world: World::new(seed, control.vehicle, START, true),
            pilot: Pilot::new(control),
            limits: Limits::new(control.vehicle),
            last: None,
            last_target: START,
            given_up: false,
            calm_since: 0,
            last_fault: Fault::Nothing,
            findings: Findings::default(),
        }
    }

    pub fn refused(&self) -> u64 {
        self.pilot.refused
    }

    /// The next frame; `step` is called with the part that is fusion and control.
    pub fn frame(&mut self, step: impl FnOnce(&mut Pilot, &Tick) -> DriveCommand) {
        let tick = self.world.tick();
        let command = step(&mut self.pilot, tick);
        let (now, seen) = (tick.now, tick.frame.is_some());
        self.world.command(&command);
        self.findings.frames += 1;
        self.look_at(now, &command);
        if seen {
            self.look_at_track();
        }
    }

    fn look_at(&mut self, now: Stamp, command: &DriveCommand) {
        let findings = &mut self.findings;
        if let Err(what) = self.limits.check(now, command) {
            findings.commands_out_of_limits += 1;
            findings.first_out_of_limits.get_or_insert(what);
        }
        findings.moving += u64::from(command.speed != 0.0);
        let back = self.last.is_some_and(|last| command.stamp <= last.stamp);
        let target_back = self.pilot.target.stamp < self.last_target;
        findings.stamps_going_back += u64::from(back) + u64::from(target_back);
        self.last_target = self.last_target.max(self.pilot.target.stamp);
        self.last = Some(*command);
    }

    fn look_at_track(&mut self) {
        let findings = &mut self.findings;
        let fault = self.world.fault();
        findings.faults += u64::from(fault != self.last_fault && fault != Fault::Nothing);
        self.last_fault = fault;
        self.calm_since = if fault == Fault::Nothing { self.calm_since + 1 } else { 0 };
        let Some(track) = self.pilot.track else { return };
        if let Some(motion) = track.motion {
            let covariance = motion.covariance;
            let symmetric =
                (covariance - covariance.transpose()).amax() <= 1e-9 * covariance.amax();
            let positive = symmetric && covariance.cholesky().is_some();
            findings.covariances_not_positive += u64::from(!positive);
            let position = motion.position.iter().chain(motion.velocity.iter());
            let finite = position.chain(motion.acceleration.iter()).all(|v| v.is_finite());
            findings.not_finite += u64::from(!finite);
        }
        let tracked = track.status == TrackStatus::Tracking;
        if matches!(track.status, TrackStatus::Lost | TrackStatus::Searching) {
            findings.given_up += u64::from(!self.given_up && findings.tracked > 0);
            self.given_up = true;
        } else if tracked && self.given_up {
            findings.found_again += u64::from(findings.tracked > 0);
            self.given_up = false;
        }
        let Some(estimate) = self.pilot.seen.estimate.filter(|_| tracked) else { return };
        findings.tracked += 1;
        let error = estimate.position - self.world.truth();
        findings.largest_error_m = findings.largest_error_m.max(error.norm());
        if self.calm_since > 30 && self.world.is_in_view() {
            findings.calm += 1;
            findings.largest_calm_error_m = findings.largest_calm_error_m.max(error.norm());
            findings.sum_of_squares += error.norm_squared();
            let scaled = estimate.position_covariance.cholesky().map(|c| c.solve(&error));
            findings.sum_of_distances += scaled.map_or(f64::INFINITY, |scaled| error.dot(&scaled));
        }
    }
}
