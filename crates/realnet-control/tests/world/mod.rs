//! A small plane world: a car that is late, a target that drives by a script, a range
//! sensor with noise, and a constant-velocity filter of the target. Only as good as the
//! tests of the control need; nothing of it is shared with the code under test.
#![allow(dead_code, reason = "each test uses its part")]

use realnet_control::{ControlInput, ControlOptions, Controller, Drive};
use realnet_core::nalgebra::{Matrix2, Matrix2x4, Matrix4, Vector2, Vector4};
use realnet_core::{DriveCommand, Pose2, Stamp, TargetEstimate, TargetState, TrackStatus};
use std::collections::VecDeque;

/// Numbers that look random, the same each time.
pub struct Noise(u64);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x1234_5678_9ABC_DEF1)
    }

    /// Even in [0, 1).
    pub fn even(&mut self) -> f64 {
        // xorshift64*
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Nearly normal with deviation 1: the sum of twelve even ones.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.even()).sum::<f64>() - 6.0
    }
}

/// The vehicle that is driven.
pub struct Car {
    pub pose: Pose2,
    pub speed: f64,
    /// Steering angle, or rate of turn of a differential drive.
    pub turn: f64,
    pub drive: Drive,
    pub dead_time_s: f64,
    pub lag_s: f64,
    pub braking: f64,
    pub min_speed: f64,
    /// Speed that is driven for a speed of 1 that is commanded.
    pub scale: f64,
    /// Angle that the wheels have when 0 is commanded.
    pub trim: f64,
    queue: VecDeque<(f64, DriveCommand)>,
    command: DriveCommand,
}

impl Car {
    pub fn new(drive: Drive) -> Self {
        Self {
            pose: Pose2::IDENTITY,
            speed: 0.0,
            turn: 0.0,
            drive,
            dead_time_s: 0.1,
            lag_s: 0.1,
            braking: 4.0,
            min_speed: 0.1,
            scale: 1.0,
            trim: 0.0,
            queue: VecDeque::new(),
            command: DriveCommand::default(),
        }
    }

    pub fn send(&mut self, now: f64, command: DriveCommand) {
        self.queue.push_back((now + self.dead_time_s, command));
    }

    fn advance(&mut self, now: f64, seconds: f64) {
        while self.queue.front().is_some_and(|(at, _)| *at <= now) {
            self.command = self.queue.pop_front().unwrap().1;
        }
        let runs = self.command.speed.abs() > 0.999 * self.min_speed;
        let goal = if runs { self.scale * self.command.speed } else { 0.0 };
        let change = (goal - self.speed) / self.lag_s;
        self.speed += change.clamp(-self.braking, self.braking) * seconds;
        match self.drive {
            Drive::Ackermann { .. } => {
                self.turn +=
                    (self.command.steering_angle + self.trim - self.turn) / self.lag_s * seconds;
            }
            Drive::Differential { .. } => {
                self.turn += (self.command.yaw_rate - self.turn) / self.lag_s * seconds;
            }
        }
        self.pose = self.pose.driven(self.speed, self.yaw_rate(), seconds);
    }

    fn yaw_rate(&self) -> f64 {
        match self.drive {
            Drive::Ackermann { wheelbase_m, .. } => self.speed * self.turn.tan() / wheelbase_m,
            Drive::Differential { .. } => self.turn,
        }
    }
}

/// Constant velocity in a fixed frame, white acceleration.
struct Filter {
    state: Vector4<f64>,
    covariance: Matrix4<f64>,
}

impl Filter {
    const ACCELERATION: f64 = 1.0;

    fn predicted(&self, seconds: f64) -> Self {
        let mut f = Matrix4::identity();
        f[(0, 2)] = seconds;
        f[(1, 3)] = seconds;
        let mut q = Matrix4::zeros();
        let power = Self::ACCELERATION * Self::ACCELERATION;
        for axis in 0..2 {
            q[(axis, axis)] = power * seconds.powi(3) / 3.0;
            q[(axis, axis + 2)] = power * seconds.powi(2) / 2.0;
            q[(axis + 2, axis)] = power * seconds.powi(2) / 2.0;
            q[(axis + 2, axis + 2)] = power * seconds;
        }
        Self { state: f * self.state, covariance: f * self.covariance * f.transpose() + q }
    }

    fn update(&mut self, position: Vector2<f64>, noise: Matrix2<f64>) {
        let mut h = Matrix2x4::zeros();
        h[(0, 0)] = 1.0;
        h[(1, 1)] = 1.0;
        let s = h * self.covariance * h.transpose() + noise;
        let gain = self.covariance * h.transpose() * s.try_inverse().unwrap();
        self.state += gain * (position - h * self.state);
        self.covariance -= gain * h * self.covariance;
    }
}

/// What is to be run.
pub struct Setup {
    pub options: ControlOptions,
    pub car: Car,
    /// Where the target's seen surface is at the start.
    pub target: Pose2,
    pub seconds: f64,
    /// Standard deviation of a range, as a share of it.
    pub range_noise: f64,
    /// From exposure to command, seconds.
    pub latency_s: f64,
    pub seed: u64,
    /// No frame is seen from .. to, seconds.
    pub blind: (f64, f64),
}

impl Setup {
    pub fn new(options: ControlOptions) -> Self {
        Self {
            options,
            car: Car::new(options.vehicle.drive),
            target: Pose2::new(options.speed.gap_m + options.vehicle.front_m, 0.0, 0.0),
            seconds: 20.0,
            range_noise: 0.02,
            latency_s: 0.03,
            seed: 1,
            blind: (f64::INFINITY, 0.0),
        }
    }
}

/// One control step of a run, true values.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub time: f64,
    pub gap: f64,
    /// Of the car's rear axle from the target's path, metres, unsigned.
    pub lateral: f64,
    pub speed: f64,
    pub target_speed: f64,
    pub heading: f64,
    /// To the target, from the car.
    pub bearing: f64,
    pub command: DriveCommand,
    pub wanted: f64,
    pub error: f64,
}

/// Runs it: the target's speed and rate of turn are `script(time)`.
pub fn run(mut setup: Setup, script: impl Fn(f64) -> (f64, f64)) -> Vec<Sample> {
    const TICK: f64 = 0.001;
    const FRAME: usize = 33;
    let mut controller = Controller::new(setup.options).unwrap();
    let mut noise = Noise::new(setup.seed);
    let mut target = setup.target;
    let car = &mut setup.car;
    let mut filter: Option<(f64, Filter)> = None;
    // own pose by dead reckoning, at the time of the last frame
    let mut odometry = Pose2::IDENTITY;
    let mut reckoned = 0.0;
    let mut measured = None;
    let mut trail: Vec<Vector2<f64>> = Vec::new();
    let mut seen_trail = Vec::new();
    let mut path = vec![target.position()];
    let mut samples = Vec::new();
    let mut pending = None;
    for tick in 0..(setup.seconds / TICK) as usize {
        let time = tick as f64 * TICK;
        let (target_speed, target_turn) = script(time);
        if tick % FRAME == 0 {
            let blind = time >= setup.blind.0 && time < setup.blind.1;
            let line = car.pose.inverse().transform_point(&target.position());
            let seen = Vector2::new(
                line.norm() * (1.0 + setup.range_noise * noise.normal()),
                line.y.atan2(line.x) + 0.003 * noise.normal(),
            );
            let yaw_rate = car.yaw_rate() + 0.01 * noise.normal();
            let own = (car.speed * (1.0 + 0.02 * noise.normal()), yaw_rate);
            pending = Some((time, time + setup.latency_s, (!blind).then_some(seen), own));
        }
        if let Some((exposure, _, seen, own)) = pending.filter(|(_, due, _, _)| time >= *due) {
            pending = None;
            let (frame, now) = (Stamp::from_secs_f64(exposure), Stamp::from_secs_f64(time));
            let before = Stamp::from_secs_f64(reckoned);
            controller.predictor_mut().correct(frame, Some(own.0), Some(own.1));
            odometry = controller.predictor().advance(odometry, before, frame);
            reckoned = exposure;
            if let Some(seen) = seen {
                let (sin, cos) = seen.y.sin_cos();
                let turn = odometry.rotation() * Matrix2::new(cos, -sin, sin, cos);
                let (along, across) = (0.02 * seen.x, 0.005 * seen.x);
                let spread = Matrix2::new(along * along, 0.0, 0.0, across * across);
                let covariance = turn * spread * turn.transpose();
                let position = odometry.transform_point(&(seen.x * Vector2::new(cos, sin)));
                let next = match filter.take() {
                    None => Filter {
                        state: Vector4::new(position.x, position.y, 0.0, 0.0),
                        covariance: Matrix4::from_diagonal(&Vector4::new(0.01, 0.01, 1.0, 1.0)),
                    },
                    Some((at, filter)) => {
                        let mut next = filter.predicted(exposure - at);
                        next.update(position, covariance);
                        next
                    }
                };
                let smooth = next.state.xy();
                if trail.last().is_none_or(|last| (smooth - last).norm() > 0.05) {
                    trail.push(smooth);
                    if trail.len() > 80 {
                        trail.remove(0);
                    }
                }
                filter = Some((exposure, next));
                measured = Some(frame);
            }
            let effect = controller.effect_time(now);
            let base = controller.predictor().advance(odometry, frame, effect).inverse();
            seen_trail.clear();
            seen_trail.extend(trail.iter().map(|point| base.transform_point(point)));
            let estimate = filter.as_ref().map(|(at, filter)| {
                let then = filter.predicted(effect.secs_f64() - at);
                let turn = base.rotation();
                let turned =
                    |row| turn * then.covariance.fixed_view::<2, 2>(row, row) * turn.transpose();
                TargetEstimate {
                    position: base.transform_point(&then.state.xy()),
                    velocity: base.transform_vector(&Vector2::new(then.state.z, then.state.w)),
                    acceleration: Vector2::zeros(),
                    position_covariance: turned(0),
                    velocity_covariance: turned(2),
                }
            });
            let status =
                if estimate.is_some() { TrackStatus::Tracking } else { TrackStatus::Searching };
            let state = TargetState { stamp: effect, measured, status, estimate };
            let input = ControlInput { now, target: &state, trail: &seen_trail, own_speed: None };
            let command = controller.step(&input);
            car.send(time, command);
            let bumper =
                car.pose.transform_point(&Vector2::new(setup.options.vehicle.front_m, 0.0));
            let line = car.pose.inverse().transform_point(&target.position());
            samples.push(Sample {
                time,
                gap: (target.position() - bumper).norm(),
                lateral: distance_to(&path, &car.pose.position()),
                speed: car.speed,
                target_speed,
                heading: car.pose.heading,
                bearing: line.y.atan2(line.x),
                command,
                wanted: controller.telemetry().gap.map_or(0.0, |gap| gap.speed_m_s),
                error: controller.telemetry().gap.map_or(0.0, |gap| gap.error_m),
            });
        }
        car.advance(time, TICK);
        target = target.driven(target_speed, target_turn, TICK);
        if (target.position() - path.last().unwrap()).norm() > 0.01 {
            path.push(target.position());
        }
    }
    samples
}

fn distance_to(path: &[Vector2<f64>], point: &Vector2<f64>) -> f64 {
    let segments = path.iter().zip(path.iter().skip(1)).map(|(from, to)| {
        let along = to - from;
        let t = ((point - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        (from + along * t - point).norm()
    });
    segments.fold(f64::INFINITY, f64::min)
}

/// Root mean square of something over a run, from a time on.
pub fn rms(samples: &[Sample], from: f64, value: impl Fn(&Sample) -> f64) -> f64 {
    let values = || samples.iter().filter(|sample| sample.time >= from).map(&value);
    (values().map(|v| v * v).sum::<f64>() / values().count() as f64).sqrt()
}
