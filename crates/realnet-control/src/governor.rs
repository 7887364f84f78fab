//! The last word: whether the vehicle may move at all.

use crate::check::usable;
use crate::check::{not_negative, positive};
use crate::limits::command;
use crate::{
    ControlInput, ControlOptions, Drive, Gap, Motion, OptionError, Search, VehicleOptions,
};
use realnet_core::{DriveCommand, Stamp, StopReason, TrackStatus};

/// How the governor stops the vehicle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum StopAction {
    /// Speed 0 at once; the vehicle brakes as hard as it can.
    #[default]
    AtOnce,
    /// The commanded speed falls by the vehicle's greatest deceleration.
    Brake,
}

/// Options of the governor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GovernorOptions {
    /// With a gap below this the robot stands, metres, from the front bumper.
    pub stopping_radius_m: f64,
    /// It goes on when the gap is larger by this, metres.
    pub restart_margin_m: f64,
    /// Without an input for longer than this it stands, seconds.
    pub stale_after_s: f64,
    /// With a standard deviation of the distance above this share of it, it stands.
    pub max_relative_std: f64,
    /// How it is stopped.
    pub stop: StopAction,
}

impl Default for GovernorOptions {
    fn default() -> Self {
        Self {
            stopping_radius_m: 0.35,
            restart_margin_m: 0.05,
            stale_after_s: 0.15,
            max_relative_std: 0.35,
            stop: StopAction::AtOnce,
        }
    }
}

impl GovernorOptions {
    pub(crate) fn check(&self) -> Result<(), OptionError> {
        not_negative("governor.stopping_radius_m", self.stopping_radius_m)?;
        not_negative("governor.restart_margin_m", self.restart_margin_m)?;
        positive("governor.stale_after_s", self.stale_after_s)?;
        positive("governor.max_relative_std", self.max_relative_std)
    }
}

/// Looks at what went into the controller and at what came out of it, knows nothing of
/// what happened in between, and passes the command on or stops the vehicle.
///
/// | stops | when |
/// |---|---|
/// | [`Requested`](StopReason::Requested) | from [`Governor::request_stop`] to [`Governor::release`] |
/// | [`NotFinite`](StopReason::NotFinite) | a number of the input or of the command is not finite, or absurdly large |
/// | [`StaleInput`](StopReason::StaleInput) | the last usable input, or what it was predicted to, is older than the set time, or the clock jumped |
/// | [`MissingInput`](StopReason::MissingInput) | there was no usable input yet |
/// | [`TooClose`](StopReason::TooClose) | the gap is below the stopping radius |
/// | [`TargetLost`](StopReason::TargetLost) | the newest measurement of the target is older than the set coasting time, or the target was given up |
/// | [`NoTarget`](StopReason::NoTarget) | no target was found yet |
/// | [`TooUncertain`](StopReason::TooUncertain) | the distance is known too badly |
///
/// Where several hold, the first of the table is named. The wheels of a car stay where the
/// command has them: on the path, while it brakes.
#[derive(Clone, Debug)]
pub struct Governor {
    options: GovernorOptions,
    vehicle: VehicleOptions,
    lost_after_s: f64,
    may_search: bool,
    requested: bool,
    found: bool,
    stopped_by: Option<StopReason>,
    last: DriveCommand,
}

impl Governor {
    /// A governor for a vehicle.
    ///
    /// # Errors
    ///
    /// An option that cannot be worked with.
    pub fn new(options: &ControlOptions) -> Result<Self, OptionError> {
        options.check()?;
        let turns = options.vehicle.drive.turns_on_the_spot();
        Ok(Self {
            options: options.governor,
            vehicle: options.vehicle,
            lost_after_s: options.lost.stop_after_s,
            may_search: turns && matches!(options.lost.search, Search::Turn { .. }),
            requested: false,
            found: false,
            stopped_by: None,
            last: command(&options.vehicle, Stamp::ZERO, Motion::default()),
        })
    }

    /// Stops the vehicle until [`Governor::release`].
    pub fn request_stop(&mut self) {
        self.requested = true;
    }

    /// Takes back [`Governor::request_stop`]. Other reasons to stop remain.
    pub fn release(&mut self) {
        self.requested = false;
    }

    /// Whether a stop was requested and not released.
    #[must_use]
    pub const fn stop_requested(&self) -> bool {
        self.requested
    }

    /// What is sent at `now` instead of `proposal`: the same, or a stop. `input` is what
    /// the proposal was made from; `None` when a timer asks, which it should do a few
    /// times within [`GovernorOptions::stale_after_s`]. `last_input` is the moment of the
    /// last usable input.
    pub fn check(
        &mut self,
        now: Stamp,
        last_input: Option<Stamp>,
        input: Option<&ControlInput<'_>>,
        proposal: &DriveCommand,
    ) -> DriveCommand {
        let finite = is_usable(proposal);
        let reason = if self.requested {
            Some(StopReason::Requested)
        } else if !finite || input.is_some_and(|input| !input.is_usable()) {
            Some(StopReason::NotFinite)
        } else {
            self.stale(now, last_input, input)
                .or_else(|| input.and_then(|input| self.target(now, input)))
        };
        self.stopped_by = if input.is_some() { reason } else { reason.or(self.stopped_by) };
        let wheels = if finite { proposal } else { &self.last };
        let mut sent = match reason {
            Some(reason) => self.stop(now, reason, wheels),
            None => DriveCommand { stamp: now, ..*proposal },
        };
        self.bound(&mut sent);
        self.last = sent;
        sent
    }

    /// The vehicle's bounds once more; the rates are the controller's.
    fn bound(&self, sent: &mut DriveCommand) {
        let vehicle = &self.vehicle;
        let most = vehicle.drive.max_turn();
        sent.speed = sent.speed.clamp(-vehicle.max_reverse_speed_m_s, vehicle.max_speed_m_s);
        match vehicle.drive {
            Drive::Ackermann { .. } => {
                sent.steering_angle = sent.steering_angle.clamp(-most, most);
                let angle = sent.steering_angle - vehicle.steering_trim_rad;
                sent.yaw_rate = vehicle.drive.yaw_rate(sent.speed, angle);
            }
            Drive::Differential { track_m, max_wheel_speed_m_s, .. } => {
                sent.steering_angle = 0.0;
                sent.speed = sent.speed.clamp(-max_wheel_speed_m_s, max_wheel_speed_m_s);
                let wheel = 2.0 * (max_wheel_speed_m_s - sent.speed.abs()) / track_m;
                sent.yaw_rate = sent.yaw_rate.clamp(-most.min(wheel), most.min(wheel));
            }
        }
    }

    /// Whether what is known is too old, or from the future, as after a clock that jumped.
    fn stale(
        &self,
        now: Stamp,
        last_input: Option<Stamp>,
        input: Option<&ControlInput<'_>>,
    ) -> Option<StopReason> {
        let Some(last) = last_input else {
            return Some(StopReason::MissingInput);
        };
        let limit = self.options.stale_after_s;
        let mut stale = now.seconds_since(last).abs() > limit;
        if let Some(input) = input {
            stale |= now.seconds_since(input.target.stamp) > limit;
            let measured = input.target.measured;
            stale |= measured.is_some_and(|measured| measured.seconds_since(now) > limit);
        }
        stale.then_some(StopReason::StaleInput)
    }

    /// Whether there is a target to follow at a distance to follow it.
    fn target(&mut self, now: Stamp, input: &ControlInput<'_>) -> Option<StopReason> {
        let target = input.target;
        let followed = matches!(target.status, TrackStatus::Tracking | TrackStatus::Coasting);
        let (Some(estimate), Some(measured), true) = (target.estimate, target.measured, followed)
        else {
            let reason = if self.found { StopReason::TargetLost } else { StopReason::NoTarget };
            return Some(reason);
        };
        self.found = true;
        let was = |reason| self.stopped_by == Some(reason);
        let gap = Gap::new(&estimate, self.vehicle.front_m);
        let margin = if was(StopReason::TooClose) { self.options.restart_margin_m } else { 0.0 };
        if gap.length_m < self.options.stopping_radius_m + margin {
            return Some(StopReason::TooClose);
        }
        if now.seconds_since(measured) > self.lost_after_s {
            return Some(StopReason::TargetLost);
        }
        // once stopped for that, a little more certainty is asked for
        let share = if was(StopReason::TooUncertain) { 0.8 } else { 1.0 };
        let most = share * self.options.max_relative_std * estimate.distance();
        (estimate.distance_std() > most).then_some(StopReason::TooUncertain)
    }

    /// The stop, with the wheels of `wheels`.
    fn stop(&self, now: Stamp, reason: StopReason, wheels: &DriveCommand) -> DriveCommand {
        let mut sent = DriveCommand {
            steering_angle: wheels.steering_angle,
            ..DriveCommand::stopped(now, reason)
        };
        if self.options.stop == StopAction::Brake {
            let seconds = now.seconds_since(self.last.stamp);
            let less = self.vehicle.max_deceleration_m_s2 * seconds;
            let speed = (self.last.speed.abs() - less).max(0.0);
            // Without a clock to go by there is no ramp.
            if seconds >= 0.0 && speed >= self.vehicle.dead_band.min_speed_m_s {
                sent.speed = speed.copysign(self.last.speed);
                // the same curvature
                let slower = if wheels.speed == 0.0 { 0.0 } else { sent.speed / wheels.speed };
                sent.yaw_rate = wheels.yaw_rate * slower.clamp(0.0, 1.0);
            }
        }
        let lost = matches!(reason, StopReason::TargetLost | StopReason::NoTarget);
        if lost && self.may_search {
            sent.yaw_rate = wheels.yaw_rate;
        }
        sent
    }
}

fn is_usable(command: &DriveCommand) -> bool {
    [command.speed, command.steering_angle, command.yaw_rate].into_iter().all(usable)
}
