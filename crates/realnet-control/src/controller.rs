//! All parts together.

use crate::limits::command;
use crate::lost::LostTarget;
use crate::pursuit::{Aim, aim};
use crate::speed::{GapControl, GapController, OwnMotion, SpeedBound, SpeedBounds};
use crate::{
    ControlInput, Drive, Gap, Governor, GovernorOptions, Limiter, LostOptions, Motion, OptionError,
    Phase, PursuitOptions, SpeedOptions, VehicleOptions, VehiclePredictor,
};
use realnet_core::{DriveCommand, Stamp, StopReason, TargetEstimate};

/// All options of the control; the default is a 1:10 car that keeps a gap of 1 m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ControlOptions {
    /// What the vehicle can do.
    pub vehicle: VehicleOptions,
    /// Which way to turn.
    pub pursuit: PursuitOptions,
    /// How fast to drive.
    pub speed: SpeedOptions,
    /// What to do while the target is not seen.
    pub lost: LostOptions,
    /// When to stop.
    pub governor: GovernorOptions,
}

impl ControlOptions {
    /// # Errors
    ///
    /// The first option that cannot be worked with.
    pub fn check(&self) -> Result<(), OptionError> {
        self.vehicle.check()?;
        self.pursuit.check()?;
        self.governor.check()?;
        self.speed.check(self.governor.stopping_radius_m)?;
        self.lost.check()
    }
}

/// What the controller did in its last step, for plots and reports.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Telemetry {
    /// What it did about the target.
    pub phase: Phase,
    /// The gap and its control; `None` without an estimate of the target.
    pub gap: Option<GapControl>,
    /// The point that was pursued, and the curvature that leads there.
    pub aim: Option<Aim>,
    /// That curvature, limited to what the vehicle can do, 1/m.
    pub curvature: f64,
    /// Bounds of the speed, m/s.
    pub bounds: SpeedBounds,
    /// Which bound decided the speed.
    pub bound: SpeedBound,
    /// Own speed that was reckoned with, m/s.
    pub own_speed: f64,
    /// What the controller proposed.
    pub proposal: DriveCommand,
    /// What the governor let through.
    pub sent: DriveCommand,
}

/// Follows the target: pure pursuit, speed control, limits, lost-target behaviour, and a
/// [`Governor`] behind them. See the [crate's page](crate).
#[derive(Clone, Debug)]
pub struct Controller {
    options: ControlOptions,
    predictor: VehiclePredictor,
    limiter: Limiter,
    gap: GapController,
    lost: LostTarget,
    governor: Governor,
    last_input: Option<Stamp>,
    telemetry: Telemetry,
}

impl Controller {
    /// Below this speed a vehicle counts as standing, m/s.
    const STANDING_M_S: f64 = 0.02;

    /// A controller that has seen nothing yet.
    ///
    /// # Errors
    ///
    /// The first option that cannot be worked with.
    pub fn new(options: ControlOptions) -> Result<Self, OptionError> {
        options.check()?;
        Ok(Self {
            options,
            predictor: VehiclePredictor::new(options.vehicle)?,
            limiter: Limiter::new(options.vehicle),
            gap: GapController::default(),
            lost: LostTarget::default(),
            governor: Governor::new(&options)?,
            last_input: None,
            telemetry: Telemetry {
                sent: command(&options.vehicle, Stamp::ZERO, Motion::default()),
                ..Telemetry::default()
            },
        })
    }

    /// The options it works with.
    #[must_use]
    pub const fn options(&self) -> &ControlOptions {
        &self.options
    }

    /// When a command given at `now` takes effect: the time for which the input's target
    /// is to be predicted.
    #[must_use]
    pub fn effect_time(&self, now: Stamp) -> Stamp {
        now.seconds_later(self.options.vehicle.effect_delay_s())
    }

    /// The vehicle's motion by the commands sent so far.
    #[must_use]
    pub const fn predictor(&self) -> &VehiclePredictor {
        &self.predictor
    }

    /// The same, for corrections by measurements.
    pub const fn predictor_mut(&mut self) -> &mut VehiclePredictor {
        &mut self.predictor
    }

    /// What it did in the last step.
    #[must_use]
    pub const fn telemetry(&self) -> &Telemetry {
        &self.telemetry
    }

    /// Stops the vehicle until [`Controller::release`]; the next command says so.
    pub fn request_stop(&mut self) {
        self.governor.request_stop();
    }

    /// Takes back [`Controller::request_stop`].
    pub fn release(&mut self) {
        self.governor.release();
    }

    /// The command for a new input.
    pub fn step(&mut self, input: &ControlInput<'_>) -> DriveCommand {
        let now = input.now;
        let proposal = if input.is_usable() {
            self.last_input = Some(now);
            self.propose(input)
        } else {
            self.hold(now)
        };
        let sent = self.governor.check(now, self.last_input, Some(input), &proposal);
        self.sent(proposal, sent)
    }

    /// The command when there is no new input: the last one as long as the last input is
    /// fresh, then a stop. To be called by a timer.
    pub fn idle(&mut self, now: Stamp) -> DriveCommand {
        let mut proposal = DriveCommand { stamp: now, ..self.telemetry.sent };
        // a request that was released is no reason any more
        proposal.stop = proposal.stop.filter(|reason| *reason != StopReason::Requested);
        let sent = self.governor.check(now, self.last_input, None, &proposal);
        self.sent(proposal, sent)
    }

    fn sent(&mut self, proposal: DriveCommand, sent: DriveCommand) -> DriveCommand {
        self.limiter.sent(&sent);
        self.predictor.push(&sent);
        self.gap.sent(sent.speed);
        if sent.stop.is_some() && sent.speed == 0.0 {
            self.gap.reset();
        }
        self.telemetry.proposal = proposal;
        self.telemetry.sent = sent;
        sent
    }

    /// The wheels as they are, and no speed.
    fn hold(&mut self, now: Stamp) -> DriveCommand {
        self.telemetry = Telemetry { phase: self.telemetry.phase, ..Telemetry::default() };
        self.limiter.limit(now, Motion { speed: 0.0, turn: self.limiter.last().turn }, 0.0)
    }

    fn propose(&mut self, input: &ControlInput<'_>) -> DriveCommand {
        let now = input.now;
        let last = self.limiter.last();
        let (phase, bound) = self.lost.step(&self.options.lost, now, input.target, last.speed);
        let effect = self.effect_time(now);
        let model = self.predictor.motion_at(effect);
        let own = OwnMotion {
            speed: input.own_speed.unwrap_or(model.speed),
            yaw_rate: self.predictor.yaw_rate_at(effect),
        };
        self.telemetry = Telemetry { phase, own_speed: own.speed, ..Telemetry::default() };
        let follows = matches!(phase, Phase::Tracking | Phase::Coasting | Phase::Slowing);
        let mut proposal = match input.target.estimate.filter(|_| follows) {
            Some(estimate) => self.follow(input, &estimate, own, model.turn, bound),
            None => self.stand(now, own.speed),
        };
        if phase == Phase::Slowing {
            proposal.stop = Some(StopReason::TargetLost);
        }
        proposal
    }

    /// Brakes on the path, then stands with the wheels straight, or searches.
    fn stand(&mut self, now: Stamp, speed: f64) -> DriveCommand {
        let turns = self.options.vehicle.drive.turns_on_the_spot();
        let turn = if turns {
            self.lost.search(&self.options.lost)
        } else if speed.abs() > Self::STANDING_M_S {
            self.limiter.last().turn
        } else {
            0.0
        };
        self.limiter.limit(now, Motion { speed: 0.0, turn }, 0.0)
    }

    fn follow(
        &mut self,
        input: &ControlInput<'_>,
        estimate: &TargetEstimate,
        own: OwnMotion,
        turn: f64,
        lost: f64,
    ) -> DriveCommand {
        let options = &self.options;
        let vehicle = &options.vehicle;
        let position = &estimate.position;
        let gap = Gap::new(estimate, vehicle.front_m);
        let seconds = self.limiter.seconds(input.now);
        let control = self.gap.step(&options.speed, &gap, own, vehicle.front_m, seconds);
        let distance = control.desired_m + vehicle.front_m;
        // Backwards there is no path to follow: it keeps facing the target.
        let reverses = self.limiter.last().speed < 0.0;
        let trail = if reverses { &[] } else { input.trail };
        let aim = aim(&options.pursuit, position, trail, own.speed, distance);
        let most = vehicle.drive.max_curvature();
        let curvature = aim.curvature.clamp(-most, most);
        let bounds = SpeedBounds {
            vehicle: vehicle.max_speed_m_s,
            stopping: options.speed.stopping_speed(
                &gap,
                vehicle,
                options.governor.stopping_radius_m,
            ),
            curve: self.curve_speed(curvature, turn),
            lost,
        };
        let (ceiling, which) = bounds.least();
        let mut speed = control.speed_m_s.min(ceiling);
        if self.telemetry.phase != Phase::Tracking {
            speed = speed.max(0.0);
        }
        if self.limiter.last().speed == 0.0 && !options.speed.restarts(&gap, &control) {
            speed = 0.0;
        }
        let turn = match vehicle.drive {
            Drive::Ackermann { wheelbase_m, .. } => {
                // backwards the same wheels turn the nose the other way
                let side = if reverses { -1.0 } else { 1.0 };
                let angle = side * (wheelbase_m * curvature).atan();
                angle + vehicle.lag_compensation * (angle - turn)
            }
            Drive::Differential { .. } => {
                let facing = 1.0 - own.speed.abs() / options.pursuit.facing_until_m_s;
                let bearing = position.y.atan2(position.x);
                let spot = options.pursuit.facing_gain * bearing * facing.max(0.0);
                speed.abs() * curvature + spot
            }
        };
        let proposal = self.limiter.limit(input.now, Motion { speed, turn }, ceiling);
        self.telemetry = Telemetry {
            gap: Some(control),
            aim: Some(aim),
            curvature,
            bounds,
            bound: if control.speed_m_s > ceiling { which } else { SpeedBound::None },
            ..self.telemetry
        };
        proposal
    }

    /// The greatest speed on a curve: by lateral acceleration, and for a differential
    /// drive by its rate of turn and by its outer wheel, `v (1 + |kappa| track / 2)`. The
    /// wheels of a car still stand for the curve before: `turn` is their angle.
    fn curve_speed(&self, curvature: f64, turn: f64) -> f64 {
        let curvature = curvature.abs();
        let speed = &self.options.speed;
        match self.options.vehicle.drive {
            Drive::Ackermann { wheelbase_m, .. } => {
                speed.curve_speed(curvature.max(turn.tan().abs() / wheelbase_m))
            }
            Drive::Differential { track_m, max_wheel_speed_m_s, max_yaw_rate_rad_s, .. } => speed
                .curve_speed(curvature)
                .min(max_yaw_rate_rad_s / curvature.max(1e-9))
                .min(max_wheel_speed_m_s / (1.0 + 0.5 * track_m * curvature)),
        }
    }
}
