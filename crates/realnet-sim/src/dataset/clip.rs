//! A drive with one camera through one world.

use super::{CLIP_FRAMES, DatasetSpec, KnownMount};
use crate::render::{Actor, Exposure, MotionBlur, Sensor, SimCamera, base_from_mount};
use crate::scene::{Scene, SceneKind, SceneSpec, TextureLevel};
use crate::{VehicleKind, VehicleState};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use realnet_core::nalgebra::Vector3;
use realnet_core::{CameraModel, Distortion, Intrinsics, Pose2};
use std::f64::consts::{PI, TAU};

/// Least distance between two vehicles' middles, metres: their diagonals do not meet.
const APART: f64 = 0.55;

/// A seed from several numbers (the finaliser of SplitMix64).
pub(super) fn mix(seed: u64, index: u64, purpose: u64) -> u64 {
    let mut z = seed
        .wrapping_mul(0x9E37_79B9_7F4A_7C15)
        .wrapping_add(index)
        .wrapping_mul(0xD1B5_4A32_D192_ED03)
        .wrapping_add(purpose);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[derive(Debug)]
pub(super) struct Clip {
    pub(super) scene: Scene,
    pub(super) camera: SimCamera,
    /// Seconds from frame to frame.
    interval: f64,
    own: VehicleState,
    actors: Vec<Actor>,
    /// Pitch and roll of the body: how far, and where in its rocking it starts.
    lean: [[f64; 2]; 2],
}

/// Random numbers in the shapes that are needed.
struct Dice(Pcg64Mcg);

impl Dice {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Evenly on a logarithmic scale.
    fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    fn chance(&mut self, share: f64) -> bool {
        self.0.random::<f64>() < share
    }

    fn below(&mut self, count: usize) -> usize {
        ((self.0.random::<f64>() * count as f64) as usize).min(count.saturating_sub(1))
    }
}

impl Clip {
    pub(super) fn new(spec: &DatasetSpec, clip: u64) -> Self {
        let mut dice = Dice(Pcg64Mcg::seed_from_u64(mix(spec.seed, clip, 0xc11b)));
        let interval = dice.log_between(1.0 / 30.0, 0.25);
        let camera = camera(&mut dice, spec);
        let own = VehicleState {
            world_from_base: Pose2::new(0.0, 0.0, dice.between(-PI, PI)),
            speed: dice.between(0.0, 1.2),
            yaw_rate: dice.between(-0.8, 0.8),
            ..VehicleState::default()
        };
        let mut made = Self {
            scene: Scene::build(&SceneSpec::default(), 0),
            camera,
            interval,
            own,
            actors: Vec::new(),
            lean: [
                [dice.between(0.0, 0.02), dice.between(0.0, 0.02)],
                [dice.between(0.0, TAU), dice.between(0.0, TAU)],
            ],
        };
        let wanted = if dice.chance(0.06) { 0 } else { 1 + dice.below(4) };
        for number in 0..wanted {
            for _ in 0..20 {
                let actor = made.company(&mut dice, number == 0);
                if made.is_free(&actor) {
                    made.actors.push(actor);
                    break;
                }
            }
        }
        made.scene = Scene::build(&made.scene_spec(&mut dice), dice.0.random());
        made
    }

    /// A vehicle somewhere before the camera; the first one is mostly followed.
    fn company(&self, dice: &mut Dice, followed: bool) -> Actor {
        let kind = VehicleKind::ALL[dice.below(VehicleKind::ALL.len())];
        let distance = dice.log_between(0.75, if followed { 5.0 } else { 8.0 });
        let model = &self.camera.model;
        let view = (0.5 * f64::from(model.width()) / model.fx()).atan();
        let angle = dice.between(-1.1, 1.1) * view * if followed { 0.7 } else { 1.0 };
        let own = self.own.world_from_base;
        let at = own * Pose2::new(distance * angle.cos(), distance * angle.sin(), 0.0);
        let heading = if followed && dice.chance(0.8) {
            own.heading + dice.between(-0.7, 0.7)
        } else {
            dice.between(-PI, PI)
        };
        let steering = dice.between(-0.45, 0.45);
        let speed = if dice.chance(0.2) { 0.0 } else { dice.between(-0.2, 1.2) };
        let state = VehicleState {
            world_from_base: Pose2::new(at.x, at.y, heading),
            speed,
            yaw_rate: speed * steering.tan() / kind.size().wheelbase,
            steering_angle: steering,
            wheel_angle: dice.between(0.0, TAU),
            braking: dice.chance(0.3),
        };
        Actor::new(kind, dice.0.random::<u32>().into(), state)
    }

    /// Whether an actor keeps away from all others and the camera during the clip.
    fn is_free(&self, actor: &Actor) -> bool {
        let middle = |state: &VehicleState, kind: VehicleKind| {
            let size = kind.size();
            let ahead = 0.5 * (size.front() - size.rear_overhang);
            (state.world_from_base * Pose2::new(ahead, 0.0, 0.0)).position()
        };
        (0..CLIP_FRAMES).all(|step| {
            let place = middle(&self.at(&actor.state, actor.kind, step), actor.kind);
            let own = self.own(step).world_from_base.position();
            let others = self
                .actors
                .iter()
                .map(|other| middle(&self.at(&other.state, other.kind, step), other.kind));
            (place - own).norm() > APART && { others }.all(|other| (other - place).norm() > APART)
        })
    }

    /// A world around all ways.
    fn scene_spec(&self, dice: &mut Dice) -> SceneSpec {
        const KINDS: [SceneKind; 6] = [
            SceneKind::Room,
            SceneKind::Room,
            SceneKind::Hall,
            SceneKind::Track,
            SceneKind::Track,
            SceneKind::Corridor,
        ];
        let mut keep_free = Vec::new();
        let origin = self.own.world_from_base.position();
        // There and back for each, so that the way is one line.
        for actor in &self.actors {
            for step in [0, CLIP_FRAMES / 2, CLIP_FRAMES - 1] {
                keep_free.push(self.at(&actor.state, actor.kind, step).world_from_base.position());
            }
            keep_free.push(origin);
        }
        keep_free.extend((0..CLIP_FRAMES).map(|s| self.own(s).world_from_base.position()));
        SceneSpec {
            kind: KINDS[dice.below(KINDS.len())],
            texture: if dice.chance(0.12) { TextureLevel::Low } else { TextureLevel::Rich },
            light: if dice.chance(0.2) {
                dice.log_between(0.03, 0.5)
            } else {
                dice.between(0.6, 1.3)
            },
            light_changes: Vec::new(),
            clutter: 3 + dice.below(22),
            moving: dice.below(4),
            keep_free: keep_free.into_iter().map(Into::into).collect(),
            clearance_m: dice.between(0.35, 0.6),
        }
    }

    pub(super) fn time(&self, step: u64) -> f64 {
        step as f64 * self.interval
    }

    fn at(&self, state: &VehicleState, kind: VehicleKind, step: u64) -> VehicleState {
        let time = self.time(step);
        VehicleState {
            world_from_base: state.world_from_base.driven(state.speed, state.yaw_rate, time),
            wheel_angle: state.wheel_angle + state.speed * time / kind.size().wheel_radius,
            ..*state
        }
    }

    /// The vehicle with the camera.
    pub(super) fn own(&self, step: u64) -> VehicleState {
        self.at(&self.own, VehicleKind::TouringCar, step)
    }

    /// How its body leans.
    pub(super) fn lean(&self, step: u64) -> [f64; 2] {
        let [size, phase] = self.lean;
        std::array::from_fn(|i| size[i] * (phase[i] + 9.0 * self.time(step)).sin())
    }

    /// The others.
    pub(super) fn actors(&self, step: u64) -> Vec<Actor> {
        let moved = |a: &Actor| Actor { state: self.at(&a.state, a.kind, step), ..*a };
        self.actors.iter().map(moved).collect()
    }
}

/// A camera as small vehicles have them.
fn camera(dice: &mut Dice, spec: &DatasetSpec) -> SimCamera {
    let (width, height) = (f64::from(spec.width), f64::from(spec.height));
    let view = dice.between(50.0, 95.0f64).to_radians();
    let focal = 0.5 * width / (0.5 * view).tan();
    let intrinsics = Intrinsics {
        fx: focal,
        fy: focal * dice.between(0.995, 1.005),
        cx: 0.5 * width - 0.5 + 0.015 * width * dice.between(-1.0, 1.0),
        cy: 0.5 * height - 0.5 + 0.015 * height * dice.between(-1.0, 1.0),
    };
    let k1 = dice.between(-0.30, 0.04);
    let tangential = [dice.between(-1e-3, 1e-3), dice.between(-1e-3, 1e-3)];
    let lens = Distortion::PlumbBob([k1, 0.22 * k1 * k1, tangential[0], tangential[1], 0.0]);
    let (place, angles) = mount(dice, spec.mount);
    let blur = dice
        .chance(0.35)
        .then(|| MotionBlur { shutter_s: dice.log_between(0.003, 0.03), max_samples: 7 });
    let target = dice.between(0.14, 0.36);
    let sensor = Sensor {
        shot_noise: dice.log_between(0.004, 0.03),
        read_noise: dice.log_between(0.0005, 0.005),
        vignetting: dice.between(0.0, 0.5),
        exposure: Exposure::Auto { lag_s: 0.2, target, max_gain: dice.between(4.0, 16.0) },
        blur,
    };
    SimCamera {
        model: sees_all(intrinsics, lens, spec),
        base_from_camera: base_from_mount(place, angles[0], angles[1], angles[2]),
        sensor,
    }
}

/// Where a camera sits (metres on the base frame), its yaw, pitch and roll.
fn mount(dice: &mut Dice, known: Option<KnownMount>) -> (Vector3<f64>, [f64; 3]) {
    let (heights, yaws, pitches) = match known {
        None => ([0.10, 0.32], [-0.05, 0.05], [-0.06, 0.22]),
        Some(known) => {
            let around = |middle: f64, most: f64| [middle - most, middle + most];
            (
                around(known.height_m, KnownMount::HEIGHT_ERROR_M),
                around(0.0, KnownMount::ANGLE_ERROR_RAD),
                around(known.pitch_rad, KnownMount::ANGLE_ERROR_RAD),
            )
        }
    };
    let mut within = |[low, high]: [f64; 2]| dice.between(low, high);
    let place = Vector3::new(within([0.0, 0.35]), within([-0.03, 0.03]), within(heights));
    (place, [within(yaws), within(pitches), within(yaws)])
}

/// The camera with this lens, or without where the lens model does not reach the
/// corners of the picture.
#[expect(clippy::expect_used, reason = "all numbers are within what a camera accepts")]
fn sees_all(intrinsics: Intrinsics, lens: Distortion, spec: &DatasetSpec) -> CameraModel {
    let model = CameraModel::new(spec.width, spec.height, intrinsics, lens);
    let model = model.expect("sides and focal lengths above 0, finite coefficients");
    let (right, low) = (f64::from(spec.width), f64::from(spec.height));
    let corners = [[-1.0, -1.0], [right, -1.0], [-1.0, low], [right, low]];
    if corners.iter().all(|corner| model.unproject(*corner).is_ok()) {
        model
    } else {
        model.without_distortion()
    }
}
