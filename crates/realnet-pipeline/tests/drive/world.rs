//! Robot and target in a plane, the sensors' errors, and what goes wrong.

use super::{Own, Tick};
use realnet_control::{Drive, VehicleOptions};
use realnet_core::nalgebra::Vector2;
use realnet_core::{DriveCommand, Pose2, Stamp};
use realnet_fusion::{DirectionSource, RangeSource, Reading, TargetMeasurement};
use realnet_pipeline::CameraMount;
use std::collections::VecDeque;

/// Frames a second.
pub const RATE_HZ: f64 = 30.0;
/// From exposure to command, seconds.
const CAMERA_LATE_S: f64 = 0.02;
/// From exposure to the arrival of a detection, seconds.
const DETECTION_LATE_S: f64 = 0.05;
/// From exposure to the arrival of a depth map, seconds.
const MAP_LATE_S: f64 = 0.27;
/// Every so many frames one goes to the depth network.
const MAP_EVERY: u64 = 10;
/// Flow holds on to a map's corners for so long, seconds.
const MAP_HELD_S: f64 = 2.0;
/// Half of the picture's width at a depth of 1 m, and how near and far a target is seen.
const WIDTH: f64 = 0.7;
const DEPTH_M: std::ops::Range<f64> = 0.15..6.0;
/// Steps of the motion in a frame.
const STEPS: u32 = 4;

/// SplitMix64, and normal numbers by Box and Muller.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ 0x5bf0_3635)
    }

    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn chance(&mut self, share: f64) -> bool {
        self.uniform(0.0, 1.0) < share
    }

    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform(1e-300, 1.0).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform(0.0, 1.0)).cos()
    }
}

/// What is wrong at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    Nothing,
    /// A third of all messages are lost.
    Losses,
    /// Messages are up to 0.4 s later than they should be, so that they overtake.
    Swaps,
    /// Messages come twice, seconds later again, and with stamps far ahead.
    Repeats,
    /// Readings that are not finite, negative or absurd.
    Nonsense,
    /// A fifth of the readings is of something else.
    Outliers,
    /// Depth maps are 40 % too long.
    WrongScale,
    NoDetections,
    NoDepthMaps,
    /// No frames at all.
    Outage,
    /// The target is behind something.
    Hidden,
    /// The target is gone; another one comes when the robot gave it up.
    Gone,
    StopRequested,
}

impl Fault {
    pub const ALL: [Self; 13] = [
        Self::Nothing,
        Self::Losses,
        Self::Swaps,
        Self::Repeats,
        Self::Nonsense,
        Self::Outliers,
        Self::WrongScale,
        Self::NoDetections,
        Self::NoDepthMaps,
        Self::Outage,
        Self::Hidden,
        Self::Gone,
        Self::StopRequested,
    ];
}

/// An error that wanders.
struct Wander {
    value: f64,
    std: f64,
    time_s: f64,
}

impl Wander {
    fn step(&mut self, random: &mut Random, seconds: f64) -> f64 {
        let keep = (-seconds / self.time_s).exp();
        self.value = self.value * keep + self.std * (1.0 - keep * keep).sqrt() * random.normal();
        self.value
    }
}

/// A depth map: its frame and the error of its scale, in the logarithm.
#[derive(Clone, Copy)]
struct Map {
    stamp: Stamp,
    arrival: Stamp,
    error: f64,
}

/// A target that drives as it likes.
struct Target {
    pose: Pose2,
    speed: f64,
    curvature: f64,
    goal: (f64, f64),
    change_in_s: f64,
}

impl Target {
    fn drive(&mut self, random: &mut Random, seconds: f64) {
        self.change_in_s -= seconds;
        if self.change_in_s < 0.0 {
            self.change_in_s = random.uniform(0.7, 4.0);
            self.goal = (random.uniform(-0.2, 1.2_f64).max(0.0), random.uniform(-0.7, 0.7));
        }
        let faster = (self.goal.0 - self.speed).clamp(-2.5 * seconds, 1.5 * seconds);
        self.speed += faster;
        self.curvature += (self.goal.1 - self.curvature) * seconds / 0.3;
        self.pose = self.pose.driven(self.speed, self.speed * self.curvature, seconds);
    }
}

/// The robot: a car with dead time and lags.
struct Robot {
    pose: Pose2,
    speed: f64,
    angle: f64,
    vehicle: VehicleOptions,
    commands: VecDeque<DriveCommand>,
    command: DriveCommand,
}

impl Robot {
    fn drive(&mut self, now: Stamp, seconds: f64) {
        let due = |c: &DriveCommand| now.seconds_since(c.stamp) >= self.vehicle.dead_time_s;
        while self.commands.front().is_some_and(due) {
            self.command = self.commands.pop_front().unwrap_or_default();
        }
        let rate = (self.command.speed - self.speed) / self.vehicle.speed_lag_s;
        self.speed += rate.clamp(-4.0, 2.0) * seconds;
        let rate = (self.command.steering_angle - self.angle) / self.vehicle.steering_lag_s;
        self.angle += rate.clamp(-4.0, 4.0) * seconds;
        self.pose = self.pose.driven(self.speed, self.yaw_rate(), seconds);
    }

    fn yaw_rate(&self) -> f64 {
        match self.vehicle.drive {
            Drive::Ackermann { wheelbase_m, .. } => self.speed * self.angle.tan() / wheelbase_m,
            Drive::Differential { .. } => self.angle,
        }
    }
}

/// The world; the same seed gives the same.
pub struct World {
    random: Random,
    with_faults: bool,
    start: Stamp,
    index: u64,
    robot: Robot,
    target: Target,
    mount: CameraMount,
    last_frame: Stamp,
    odometry: Pose2,
    network_error: Wander,
    ground_error: Wander,
    fault: Fault,
    change_in_s: f64,
    map: Option<Map>,
    coming: Option<Map>,
    on_the_way: Vec<(Stamp, TargetMeasurement)>,
    tick: Tick,
}

impl World {
    pub fn new(seed: u64, vehicle: VehicleOptions, start: Stamp, with_faults: bool) -> Self {
        let pose = Pose2::new(1.4, 0.0, 0.0);
        let goal = (0.5, 0.0);
        Self {
            random: Random::new(seed),
            with_faults,
            start,
            index: 0,
            robot: Robot {
                pose: Pose2::IDENTITY,
                speed: 0.0,
                angle: 0.0,
                vehicle,
                commands: VecDeque::with_capacity(64),
                command: DriveCommand::default(),
            },
            target: Target { pose, speed: 0.0, curvature: 0.0, goal, change_in_s: 2.0 },
            mount: CameraMount::default(),
            last_frame: start,
            odometry: Pose2::IDENTITY,
            network_error: Wander { value: 0.0, std: 0.05, time_s: 60.0 },
            ground_error: Wander { value: 0.0, std: 0.03, time_s: 30.0 },
            fault: Fault::Nothing,
            change_in_s: 5.0,
            map: None,
            coming: None,
            on_the_way: Vec::with_capacity(256),
            tick: Tick {
                now: start,
                frame: None,
                measurements: Vec::with_capacity(256),
                stop_requested: false,
            },
        }
    }

    pub fn fault(&self) -> Fault {
        self.fault
    }

    /// Where the target is, in the robot's base frame.
    pub fn truth(&self) -> Vector2<f64> {
        self.robot.pose.inverse().transform_point(&self.target.pose.position())
    }

    pub fn is_in_view(&self) -> bool {
        self.seen().is_some() && !matches!(self.fault, Fault::Hidden | Fault::Gone)
    }

    pub fn command(&mut self, command: &DriveCommand) {
        self.robot.commands.push_back(*command);
    }

    /// Drives on to the next frame; answers with what has arrived by then.
    pub fn tick(&mut self) -> &Tick {
        let before = self.exposure();
        self.index += 1;
        let exposed = self.exposure();
        let seconds = exposed.seconds_since(before);
        let from = self.robot.pose;
        for step in 0..STEPS {
            let share = f64::from(step) / f64::from(STEPS);
            self.robot.drive(later(before, share * seconds), seconds / f64::from(STEPS));
            self.target.drive(&mut self.random, seconds / f64::from(STEPS));
        }
        self.change_fault(seconds);
        let (speed, yaw_rate) = self.reckon(&from, seconds);
        self.network_error.step(&mut self.random, seconds);
        self.ground_error.step(&mut self.random, seconds);
        self.tick.now = later(exposed, CAMERA_LATE_S);
        self.tick.stop_requested = self.fault == Fault::StopRequested;
        self.tick.frame = (self.fault != Fault::Outage).then_some(Own {
            stamp: exposed,
            fixed_from_base: self.odometry,
            speed,
            yaw_rate,
        });
        if self.tick.frame.is_some() {
            self.look(exposed);
        }
        self.deliver();
        &self.tick
    }

    /// Not quite regular, and without rounding errors that add up.
    fn exposure(&self) -> Stamp {
        let nanos = (self.index as f64 / RATE_HZ * 1e9).round() as i64;
        let jitter = (self.index.wrapping_mul(0x9e37_79b9) >> 8) % 1_000_000;
        Stamp::from_nanos(self.start.nanos() + nanos + jitter as i64)
    }

    /// Own motion as it is seen in the pictures.
    fn reckon(&mut self, from: &Pose2, seconds: f64) -> (f64, f64) {
        let step = from.inverse() * self.robot.pose;
        let noise = 1.0 + 0.02 * self.random.normal();
        let speed = step.x.hypot(step.y).copysign(step.x) / seconds * noise;
        let yaw_rate = step.heading / seconds + 0.01 * self.random.normal();
        self.odometry = self.odometry.driven(speed, yaw_rate, seconds);
        (speed, yaw_rate)
    }

    fn change_fault(&mut self, seconds: f64) {
        self.change_in_s -= seconds;
        if self.change_in_s > 0.0 {
            return;
        }
        let random = &mut self.random;
        if self.fault == Fault::Gone {
            self.target.pose = self.robot.pose
                * Pose2::new(
                    random.uniform(1.0, 2.5),
                    random.uniform(-0.3, 0.3),
                    random.uniform(-0.5, 0.5),
                );
        }
        let choice = (random.uniform(0.0, 1.0) * Fault::ALL.len() as f64) as usize;
        let next = Fault::ALL.get(choice).copied().filter(|_| self.with_faults);
        let calm = self.fault != Fault::Nothing;
        self.fault = if calm { Fault::Nothing } else { next.unwrap_or(Fault::Nothing) };
        let view = self.seen().is_some();
        let random = &mut self.random;
        if !view && self.fault == Fault::Nothing {
            // Who lost it for good gets another one.
            self.fault = Fault::Gone;
        }
        self.change_in_s = match self.fault {
            Fault::Nothing => random.uniform(4.0, 15.0),
            Fault::Gone => random.uniform(6.0, 10.0),
            Fault::Hidden | Fault::Outage => random.uniform(0.2, 3.0),
            _ => random.uniform(1.0, 5.0),
        };
    }

    /// Depth and tangent of the target in the camera's picture.
    fn seen(&self) -> Option<(f64, f64)> {
        let camera = self.robot.pose * self.mount.base_from_camera();
        let there = camera.inverse().transform_point(&self.target.pose.position());
        let tangent = there.y / there.x;
        (DEPTH_M.contains(&there.x) && tangent.abs() < WIDTH).then_some((there.x, tangent))
    }

    fn look(&mut self, exposed: Stamp) {
        self.last_frame = exposed;
        let in_view = self.is_in_view();
        let Some((depth, tangent)) = self.seen().filter(|_| in_view) else {
            self.map = None;
            self.coming = None;
            return;
        };
        let range = |random: &mut Random, error: f64, relative_std: f64, source| Reading::Range {
            depth_m: depth * (error + relative_std * random.normal()).exp(),
            relative_std,
            source,
        };
        let direction = |random: &mut Random, std: f64, source| Reading::Direction {
            tangent: tangent + std * random.normal(),
            std,
            source,
        };
        if let Some(map) = self.coming.filter(|map| map.arrival <= self.tick.now) {
            self.map = Some(map);
            self.coming = None;
        }
        let reading = direction(&mut self.random, 0.005, DirectionSource::Flow);
        self.send(exposed, 0.0, reading);
        if let Some(map) = self.map.filter(|map| exposed.seconds_since(map.stamp) < MAP_HELD_S) {
            let source = RangeSource::Network { map: map.stamp };
            let reading = range(&mut self.random, map.error, 0.01, source);
            self.send(exposed, 0.0, reading);
        }
        let error = self.ground_error.value * depth;
        let reading = range(&mut self.random, error, 0.03, RangeSource::Ground);
        self.send(exposed, 0.0, reading);
        if self.fault != Fault::NoDetections {
            let reading = direction(&mut self.random, 0.01, DirectionSource::Detection);
            self.send(exposed, DETECTION_LATE_S, reading);
        }
        if self.index.is_multiple_of(MAP_EVERY) && self.fault != Fault::NoDepthMaps {
            let wrong = if self.fault == Fault::WrongScale { 0.34 } else { 0.0 };
            let error = self.network_error.value + wrong + 0.1 * self.random.normal();
            let source = RangeSource::Network { map: exposed };
            let reading = range(&mut self.random, error, 0.01, source);
            self.send(exposed, MAP_LATE_S, reading);
            // One at a time, as the camera's frames are kept.
            let arrival = later(exposed, MAP_LATE_S);
            self.coming = self.coming.or(Some(Map { stamp: exposed, arrival, error }));
        }
    }

    /// A reading is on its way, through whatever is wrong.
    fn send(&mut self, stamp: Stamp, late_s: f64, mut reading: Reading) {
        let random = &mut self.random;
        let mut late_s = late_s;
        match self.fault {
            Fault::Losses if random.chance(0.33) => return,
            Fault::Swaps => late_s += random.uniform(0.0, 0.4),
            Fault::Nonsense if random.chance(0.3) => spoil(random, &mut reading),
            Fault::Outliers if random.chance(0.2) => mistake(random, &mut reading),
            _ => {}
        }
        let fixed_from_camera = self.odometry * self.mount.base_from_camera();
        let measurement = TargetMeasurement { stamp, fixed_from_camera, reading };
        let mut post = |measurement: TargetMeasurement, late_s: f64| {
            // More than this is never on the way.
            if self.on_the_way.len() < self.on_the_way.capacity() {
                self.on_the_way.push((later(stamp, late_s), measurement));
            }
        };
        post(measurement, late_s);
        if self.fault == Fault::Repeats {
            post(measurement, late_s);
            if random.chance(0.1) {
                post(measurement, late_s + random.uniform(0.1, 3.0));
            }
            if random.chance(0.02) {
                let stamp = later(stamp, random.uniform(20.0, 1e9));
                post(TargetMeasurement { stamp, ..measurement }, late_s);
            }
        }
    }

    fn deliver(&mut self) {
        let now = self.tick.now;
        self.tick.measurements.clear();
        for (arrival, measurement) in &self.on_the_way {
            if *arrival <= now {
                self.tick.measurements.push(*measurement);
            }
        }
        self.on_the_way.retain(|(arrival, _)| *arrival > now);
    }
}

/// A number that no sensor gives.
fn spoil(random: &mut Random, reading: &mut Reading) {
    let all = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0, 0.0, 1e300, f64::MIN_POSITIVE];
    let bad = all[(random.uniform(0.0, 1.0) * all.len() as f64) as usize % all.len()];
    let of_value = random.chance(0.5);
    match reading {
        Reading::Range { depth_m, .. } if of_value => *depth_m = bad,
        Reading::Range { relative_std, .. } => *relative_std = bad,
        // 0, -1 and the least number are directions.
        Reading::Direction { tangent, .. } if of_value && bad.abs() != 1.0 => {
            *tangent = if bad.abs() < 1.0 { f64::NAN } else { bad };
        }
        Reading::Direction { std, .. } => *std = bad,
    }
}

/// A number of something else.
fn mistake(random: &mut Random, reading: &mut Reading) {
    match reading {
        Reading::Range { depth_m, .. } => *depth_m *= random.uniform(0.3, 3.0),
        Reading::Direction { tangent, .. } => *tangent = random.uniform(-WIDTH, WIDTH),
    }
}

fn later(stamp: Stamp, seconds: f64) -> Stamp {
    Stamp::from_nanos(stamp.nanos() + (seconds * 1e9).round() as i64)
}
