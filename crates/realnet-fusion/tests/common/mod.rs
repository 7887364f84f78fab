//! Simulated logs of a follower behind a target, for tests, benches and the comparison
//! with other filters: the truth, and the measurements in the order of their arrival.
#![allow(dead_code, missing_docs, clippy::unwrap_used, clippy::panic)]

use realnet_core::nalgebra::Vector2;
use realnet_core::{Pose2, Stamp};
use realnet_fusion::{DirectionSource, RangeSource, Reading, TargetMeasurement};

/// SplitMix64, and normal numbers by Box and Muller.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// From `low` to `high`.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform(1e-300, 1.0).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform(0.0, 1.0)).cos()
    }
}

/// How the sensors of a log err.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    pub seconds: f64,
    pub fps: f64,
    /// Frames from one depth map to the next, and how late a map comes.
    pub map_every: usize,
    pub map_late_s: f64,
    pub map_scale_std: f64,
    /// Logarithm of the scale common to all maps.
    pub network_scale_std: f64,
    pub network_scale: f64,
    /// Noise of ranges moved by flow, and of the range taken from a map itself.
    pub fast_std: f64,
    pub direction_std: f64,
    pub direction_late_s: f64,
    /// With ground ranges of this noise and this shared error per metre.
    pub ground: Option<(f64, f64)>,
    /// With size ranges of this noise and this shared error.
    pub size: Option<(f64, f64)>,
    /// Share of all measurements that never come.
    pub lost: f64,
    /// The target drives, or stands.
    pub moving: bool,
    /// Both brake hard and speed up again and again, and the distance that is kept goes up
    /// and down between 0.6 and 2.5 m.
    pub lively: bool,
    /// Error of the own odometry, as a share of the way: standard deviation and the time
    /// for which it lasts.
    pub odometry: Option<(f64, f64)>,
    /// A further error of the ground ranges: standard deviation of its logarithm and the
    /// time for which it lasts.
    pub ground_wanders: Option<(f64, f64)>,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            seconds: 20.0,
            fps: 30.0,
            map_every: 10,
            map_late_s: 0.27,
            map_scale_std: 0.1,
            network_scale_std: 0.0,
            network_scale: 0.0,
            fast_std: 0.01,
            direction_std: 0.005,
            direction_late_s: 0.0,
            ground: None,
            size: None,
            lost: 0.0,
            moving: true,
            lively: false,
            odometry: None,
            ground_wanders: None,
        }
    }
}

/// An error that lasts for a while: a stationary first-order Gauss-Markov process.
struct Wandering {
    std: f64,
    kept: f64,
    value: f64,
}

impl Wandering {
    fn new(random: &mut Random, (std, time_s): (f64, f64), fps: f64) -> Self {
        Self { std, kept: (-1.0 / (fps * time_s)).exp(), value: std * random.normal() }
    }

    fn step(&mut self, random: &mut Random) -> f64 {
        let gained = self.std * (1.0 - self.kept * self.kept).sqrt();
        self.value = self.kept * self.value + gained * random.normal();
        self.value
    }
}

/// The truth at a frame.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    pub stamp: Stamp,
    pub camera: Pose2,
    /// The camera by its own odometry.
    pub believed: Pose2,
    pub position: Vector2<f64>,
    pub velocity: Vector2<f64>,
    pub acceleration: Vector2<f64>,
}

impl Truth {
    /// Depth and tangent of the target.
    pub fn seen(&self) -> (f64, f64) {
        let local = self.camera.rotation().transpose() * (self.position - self.camera.position());
        (local.x, local.y / local.x)
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Arriving {
    pub arrival: Stamp,
    pub measurement: TargetMeasurement,
}

pub struct Log {
    pub truth: Vec<Truth>,
    /// Sorted by arrival.
    pub arriving: Vec<Arriving>,
}

/// Seconds of one step of the simulated cars.
const STEP: f64 = 1e-3;

fn drive(random: &mut Random, setup: &Setup) -> Vec<Truth> {
    let frames = (setup.seconds * setup.fps) as usize;
    let mut target = Pose2::new(1.2, 0.0, 0.0);
    let mut camera = Pose2::IDENTITY;
    let (mut speed, mut acceleration, mut curvature) = (0.5, 0.0, 0.0_f64);
    let (mut wanted, mut wanted_curvature, mut change_at) = (0.5, 0.0, 1.0);
    let mut own_speed = 0.5;
    let mut gap = 1.0;
    let mut believed = camera;
    let mut odometry = setup.odometry.map(|error| Wandering::new(random, error, setup.fps));
    let (mut brake, mut t) = (1.0, 0.0);
    let mut truth = Vec::with_capacity(frames);
    if !setup.moving {
        (speed, wanted, change_at, own_speed) = (0.0, 0.0, f64::INFINITY, 0.0);
    }
    for frame in 0..frames {
        let stamp = Stamp::of_frame(frame as u64, setup.fps);
        let odometry = odometry.as_mut().map_or(1.0, |error| 1.0 + error.step(random));
        while t < stamp.secs_f64() {
            if t > change_at {
                change_at = t + random.uniform(0.7, 2.5);
                wanted = random.uniform(-0.2, 1.2_f64).max(0.0);
                brake = random.uniform(0.6, 3.0);
                wanted_curvature = random.uniform(-0.7, 0.7);
                if setup.lively {
                    change_at = t + random.uniform(0.7, 1.5);
                    wanted = random.uniform(0.0, 1.8);
                    brake = 3.0;
                    gap = random.uniform(0.6, 2.5);
                }
            }
            let asked = ((wanted - speed) * 8.0).clamp(-brake, brake.min(2.0));
            acceleration += (asked - acceleration) * STEP / 0.08;
            speed = (speed + acceleration * STEP).max(0.0);
            curvature += (wanted_curvature - curvature) * STEP / 0.3;
            target = target.driven(speed, speed * curvature, STEP);
            // The follower keeps about 1 m and turns towards the target.
            let local = camera.rotation().transpose() * (target.position() - camera.position());
            let gap_speed = speed + 1.5 * (local.x - gap);
            let asked = if setup.moving { gap_speed.clamp(0.0, 2.0) } else { 0.0 };
            own_speed += (asked - own_speed).clamp(-4.0 * STEP, 2.5 * STEP);
            let turn = (4.0 * local.y.atan2(local.x)).clamp(-2.5, 2.5);
            camera = camera.driven(own_speed, turn, STEP);
            believed = believed.driven(own_speed * odometry, turn, STEP);
            t += STEP;
        }
        let forward = target.direction();
        let left = Vector2::new(-forward.y, forward.x);
        truth.push(Truth {
            stamp,
            camera,
            believed,
            position: target.position(),
            velocity: forward * speed,
            acceleration: forward * acceleration + left * (speed * speed * curvature),
        });
    }
    truth
}

/// A log; the same seed and setup give the same.
pub fn log(seed: u64, setup: &Setup) -> Log {
    let random = &mut Random(seed.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ 0x5bf0_3635);
    let truth = drive(random, setup);
    let late = |stamp: Stamp, seconds: f64| Stamp::from_secs_f64(stamp.secs_f64() + seconds);
    let common = setup.network_scale + setup.network_scale_std * random.normal();
    let pitch = setup.ground.map_or(0.0, |(_, shared)| shared * random.normal());
    let size = setup.size.map_or(0.0, |(_, shared)| shared * random.normal());
    let mut ground_wanders = setup.ground_wanders.map(|e| Wandering::new(random, e, setup.fps));
    // Stamp, arrival and scale of the maps so far.
    let mut maps: Vec<(Stamp, Stamp, f64)> = Vec::new();
    let mut arriving = Vec::new();
    for (index, now) in truth.iter().enumerate() {
        let (depth, tangent) = now.seen();
        let mut add = |random: &mut Random, arrival: Stamp, reading: Reading| {
            if depth > 0.05 && tangent.abs() < 0.7 && random.uniform(0.0, 1.0) >= setup.lost {
                let (stamp, fixed_from_camera) = (now.stamp, now.believed);
                let measurement = TargetMeasurement { stamp, fixed_from_camera, reading };
                arriving.push(Arriving { arrival, measurement });
            }
        };
        let direction = Reading::Direction {
            tangent: tangent + setup.direction_std * random.normal(),
            std: setup.direction_std,
            source: DirectionSource::Detection,
        };
        add(random, late(now.stamp, setup.direction_late_s), direction);
        let range = |random: &mut Random, error: f64, relative_std: f64, source| {
            let depth_m = depth * (error + relative_std * random.normal()).exp();
            Reading::Range { depth_m, relative_std, source }
        };
        if let Some((map, _, scale)) = maps.iter().rev().find(|(_, ready, _)| *ready <= now.stamp) {
            let source = RangeSource::Network { map: *map };
            let reading = range(random, *scale, setup.fast_std, source);
            add(random, now.stamp, reading);
        }
        if index % setup.map_every == 0 {
            let (map, ready) = (now.stamp, late(now.stamp, setup.map_late_s));
            let scale = common + setup.map_scale_std * random.normal();
            maps.push((map, ready, scale));
            let reading = range(random, scale, setup.fast_std, RangeSource::Network { map });
            add(random, ready, reading);
        }
        if let Some((noise, _)) = setup.ground {
            let wanders = ground_wanders.as_mut().map_or(0.0, |error| error.step(random));
            let error = pitch * depth + wanders;
            let reading = range(random, error, noise, RangeSource::Ground);
            add(random, now.stamp, reading);
        }
        if let Some((noise, _)) = setup.size {
            let reading = range(random, size, noise, RangeSource::Size);
            add(random, now.stamp, reading);
        }
    }
    arriving.sort_by_key(|arriving| arriving.arrival);
    Log { truth, arriving }
}
