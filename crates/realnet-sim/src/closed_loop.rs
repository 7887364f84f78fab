//! A run: the follower in the world.

use crate::dynamics::{DynamicsError, Vehicle, clearance, gap_ahead};
use crate::log::{BodyLog, DepthMapLog, DetectionLog, FrameLog, RunLog, StopLog};
use crate::perception::{DepthNetwork, Detector, VisibleObject};
use crate::render::{
    Actor, Exposure, MotionBlur, Rendered, Renderer, Sensor, Shot, SimCamera, Truth,
    base_from_mount,
};
use crate::scenario::Setup;
use crate::scene::{Bounds, Obstacle, Scene};
use realnet_core::nalgebra::{Vector2, Vector3};
use realnet_core::{DepthMap, DepthMapError, DriveCommand, Frame, Pose2, Stamp};
use realnet_pipeline::{
    DepthEstimator, Follower, FollowerError, FollowerOptions, FrameReport, NetworkError,
    ObjectDetector, TargetBox,
};
use realnet_range::cues::{DepthInBox, DepthInBoxOptions, DepthNoise, OptionError};
use realnet_range::motion::MotionError;
use std::ops::ControlFlow;
use thiserror::Error;

/// Class that the detector calls all vehicles.
pub const VEHICLE_CLASS: u32 = 0;

/// Pitch of a small car's body for its acceleration, nose up.
const NOD_RAD_PER_M_S2: f64 = 0.004;
/// Exposures from this on are drawn with their blur, seconds.
const BLURRING_S: f64 = 0.012;
/// What the target's pixels have in the mask: it is the first actor.
const TARGET_MASK: u8 = 1;
/// A target is visible when at least so much of its silhouette in the picture is not
/// hidden, and so much of it lies in the picture.
const VISIBLE: f64 = 0.5;

/// Why a run could not be made.
#[derive(Debug, Error)]
pub enum RunError {
    /// The follower's options.
    #[error(transparent)]
    Follower(#[from] FollowerError),
    /// The follower's vehicle.
    #[error(transparent)]
    Dynamics(#[from] DynamicsError),
    /// The rule of the depth in a box.
    #[error(transparent)]
    DepthInBox(#[from] OptionError),
    /// A depth map's size.
    #[error(transparent)]
    DepthMap(#[from] DepthMapError),
    /// A frame that the follower refused.
    #[error(transparent)]
    Frame(#[from] MotionError),
    /// A network that was to see.
    #[error("the {network} failed")]
    Network {
        /// Which.
        network: &'static str,
        /// What it says.
        source: NetworkError,
    },
}

/// Who sees for the follower.
#[derive(Default)]
pub enum Perception<'a> {
    /// The truth, with the errors of a setup's models.
    #[default]
    Truth,
    /// Networks that are shown what the camera sees, at the rates, latencies and losses of a
    /// setup's models, which add no errors of their own; faults hold.
    Networks {
        /// Finds the target.
        detector: &'a mut dyn ObjectDetector,
        /// Says how far it is, if anybody does.
        depth: Option<&'a mut dyn DepthEstimator>,
    },
}

/// What an onlooker is shown at each frame.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// The camera's picture and its truth.
    pub rendered: &'a Rendered,
    /// Where the follower sees the target in it.
    pub target: Option<TargetBox>,
    /// What was written down so far; the last frame is this one.
    pub run: &'a RunLog,
}

/// What the follower is told about itself in a setup.
#[must_use]
pub fn follower_options(setup: &Setup) -> FollowerOptions {
    FollowerOptions {
        mount: setup.camera.mount,
        classes: vec![VEHICLE_CLASS],
        control: setup.control,
        ..FollowerOptions::default()
    }
}

/// Runs a setup with the follower of [`follower_options`], seen by the truth. `onlooker`
/// is shown each frame and may end the run.
///
/// # Errors
/// [`RunError`] for a setup that cannot be run.
pub fn run(
    setup: &Setup,
    onlooker: impl FnMut(&Moment<'_>) -> ControlFlow<()>,
) -> Result<RunLog, RunError> {
    run_with(setup, follower_options(setup), Perception::Truth, onlooker)
}

/// Runs a setup with another follower, or with networks that see for it, see [`run`].
///
/// # Errors
/// [`RunError`] for a setup or options that cannot be run, and when a network fails.
pub fn run_with<'a>(
    setup: &'a Setup,
    options: FollowerOptions,
    perception: Perception<'a>,
    mut onlooker: impl FnMut(&Moment<'_>) -> ControlFlow<()>,
) -> Result<RunLog, RunError> {
    let mut world = World::new(setup, options, perception)?;
    for index in 0..setup.frames() {
        let exposed = Stamp::of_frame(index, setup.camera.rate_hz);
        world.look(exposed)?;
        let now = exposed.seconds_later(setup.camera.latency_s);
        world.deliver(now);
        let (report, command) = world.decide(exposed, now)?;
        world.write_down(exposed, report.as_ref(), &command);
        let target = report.and_then(|report| report.target);
        let moment = Moment { rendered: &world.picture, target, run: &world.log };
        if onlooker(&moment).is_break() {
            break;
        }
    }
    Ok(world.log)
}

/// Everything that is in motion during a run.
struct World<'a> {
    setup: &'a Setup,
    scene: Scene,
    renderer: Renderer,
    picture: Rendered,
    vehicle: Vehicle,
    actors: Vec<Actor>,
    detector: Detector,
    network: DepthNetwork,
    perception: Perception<'a>,
    follower: Follower,
    stop_requested: bool,
    /// Speed at the last frame, and when that was.
    before: Option<(f64, Stamp)>,
    /// The present frame goes to the depth network.
    kept: bool,
    last: Option<FrameReport>,
    log: RunLog,
    /// Depths of the target alone, and the rule that makes a range of them.
    target_depth: DepthMap,
    depth_in_box: DepthInBox,
    outline: Vec<Vector2<f64>>,
    objects: Vec<VisibleObject>,
}

impl<'a> World<'a> {
    fn new(
        setup: &'a Setup,
        options: FollowerOptions,
        perception: Perception<'a>,
    ) -> Result<Self, RunError> {
        let scene = Scene::build(&setup.scene, setup.seed);
        let renderer = Renderer::new(camera(setup));
        let picture = renderer.blank();
        let size = setup.follower.kind.size();
        let start = setup.follower.start;
        let vehicle = Vehicle::new(setup.follower.dynamics, size.wheel_radius, start, Stamp::ZERO)?;
        let log = RunLog {
            scenario: setup.name.to_owned(),
            description: setup.description.to_owned(),
            seed: setup.seed,
            desired_gap_m: setup.desired_gap_m(),
            follower_size: Some(size),
            target_size: setup.target.as_ref().map(|target| target.kind.size()),
            bodies: bodies(setup, &scene),
            walls: scene.bounds().as_ref().map(walls).unwrap_or_default(),
            ..RunLog::default()
        };
        Ok(Self {
            detector: Detector::new(setup.detector.clone(), setup.seed),
            network: DepthNetwork::new(setup.depth.clone(), setup.seed),
            perception,
            follower: Follower::new(&setup.camera.model, options)?,
            stop_requested: false,
            before: None,
            kept: false,
            last: None,
            log,
            target_depth: picture.depth.clone(),
            depth_in_box: DepthInBox::new(DepthInBoxOptions::default())?,
            outline: Vec::new(),
            objects: Vec::new(),
            actors: Vec::new(),
            setup,
            scene,
            renderer,
            picture,
            vehicle,
        })
    }

    /// The camera takes a picture, the networks are shown it.
    fn look(&mut self, exposed: Stamp) -> Result<(), RunError> {
        let (setup, time_s) = (self.setup, exposed.secs_f64());
        self.vehicle.advance_to(exposed);
        self.actors.clear();
        let vehicles = setup.target.iter().chain(&setup.others);
        for (index, vehicle) in (0..).zip(vehicles) {
            let paint = setup.seed.wrapping_mul(31).wrapping_add(7 * index);
            self.actors.push(Actor::new(vehicle.kind, paint, vehicle.state(time_s)));
        }
        self.renderer.set_mount(mount(setup, time_s));
        let own = self.vehicle.state();
        let shot = Shot {
            time_s,
            own,
            lean: self.lean(own.speed, exposed),
            actors: &self.actors,
            seed: setup.seed.wrapping_mul(0x9e37_79b9).wrapping_add(exposed.nanos() as u64),
        };
        self.renderer.render(&self.scene, &shot, &mut self.picture);
        // The stamp that the camera gives its frame, to the nanosecond.
        self.picture.frame.set_stamp(exposed);
        self.picture.depth.set_stamp(exposed);
        self.kept = false;
        if !setup.frame_arrives(time_s) {
            return Ok(());
        }
        let blur_px = shot.own.yaw_rate.abs() * setup.camera.model.fx() * setup.camera.exposure_s;
        self.show(exposed, blur_px)
    }

    /// The networks are shown the picture, or the truth plays them.
    fn show(&mut self, exposed: Stamp, blur_px: f64) -> Result<(), RunError> {
        let frame = &self.picture.frame;
        if let Perception::Networks { detector, depth } = &mut self.perception {
            let failed = |network| move |source| RunError::Network { network, source };
            if self.detector.take(exposed) {
                let found = detector.detect(frame, None).map_err(failed("detector"))?;
                self.detector.answer(exposed, found);
            }
            if let Some(depth) = depth
                && self.network.take(exposed)
            {
                let map = depth.depth(frame).map_err(failed("depth network"))?;
                self.network.answer(&map)?;
                self.kept = true;
            }
            return Ok(());
        }
        self.objects.clear();
        for (index, id) in (0..self.actors.len()).zip(0..) {
            if let Some(truth) = self.picture.truth(index) {
                self.objects.push(VisibleObject {
                    id,
                    class_id: VEHICLE_CLASS,
                    bbox: truth.bbox,
                    visible_share: truth.visible_share * truth.inside_share,
                    blur_px,
                });
            }
        }
        let size = (frame.width(), frame.height());
        // Bytes are a square root of light; the gain amplifies the noise as well.
        let light = brightness(frame).powi(2) / self.picture.gain().max(1e-9);
        self.detector.show(exposed, size, light, &self.objects);
        self.kept = self.network.show(&self.picture.depth)?;
        Ok(())
    }

    /// How the body leans on its springs: nose down while it brakes.
    fn lean(&mut self, speed: f64, now: Stamp) -> [f64; 2] {
        let (before, then) = self.before.replace((speed, now)).unwrap_or((speed, now));
        let seconds = now.seconds_since(then);
        let acceleration = if seconds > 0.0 { (speed - before) / seconds } else { 0.0 };
        [-NOD_RAD_PER_M_S2 * acceleration.clamp(-5.0, 5.0), 0.0]
    }

    /// The follower gets what has arrived by now.
    fn deliver(&mut self, now: Stamp) {
        for delivered in self.detector.receive(now) {
            let found = self.follower.detections(delivered.stamp, &delivered.value).is_some();
            self.log.detections.push(DetectionLog {
                time_s: delivered.stamp.secs_f64(),
                arrived_s: delivered.arrived.secs_f64(),
                found,
            });
        }
        for delivered in self.network.receive(now) {
            let known = self.follower.network_range();
            // A map of a frame that is no longer kept gives a range all the same.
            let _ = self.follower.depth(&delivered.value);
            let range = self.follower.network_range().filter(|range| known != Some(*range));
            self.log.depth_maps.push(DepthMapLog {
                time_s: delivered.stamp.secs_f64(),
                arrived_s: delivered.arrived.secs_f64(),
                range_m: range.map(|range| range.depth_m),
            });
        }
    }

    /// The follower gets the frame, if it arrives, and gives a command.
    fn decide(
        &mut self,
        exposed: Stamp,
        now: Stamp,
    ) -> Result<(Option<FrameReport>, DriveCommand), RunError> {
        let requested = self.setup.stop_is_requested(now.secs_f64());
        match (requested, self.stop_requested) {
            (true, false) => self.follower.request_stop(),
            (false, true) => self.follower.release(),
            _ => {}
        }
        self.stop_requested = requested;
        let (report, command) = if self.setup.frame_arrives(exposed.secs_f64()) {
            let report = self.follower.frame(&self.picture.frame)?;
            if self.kept {
                self.follower.keep_for_depth();
            }
            (Some(report), self.follower.command(now))
        } else {
            (None, self.follower.idle(now))
        };
        self.vehicle.command(&command);
        self.last = report.or(self.last);
        Ok((report, command))
    }

    fn write_down(&mut self, exposed: Stamp, report: Option<&FrameReport>, command: &DriveCommand) {
        let (setup, time_s) = (self.setup, exposed.secs_f64());
        let own = self.vehicle.state();
        let has_target = setup.target.is_some();
        let target = self.actors.first().copied().filter(|_| has_target);
        let truth = has_target.then(|| self.picture.truth(0)).flatten();
        let size = setup.follower.kind.size();
        let outline = |actor: &Actor| actor.kind.size().corners(&actor.state.world_from_base);
        let gap_m = target
            .map_or(f64::NAN, |target| gap_ahead(&own.world_from_base, &size, &outline(&target)));
        let range_true_m = truth.filter(is_visible).and_then(|truth| self.true_range(&truth));
        let clearance_m = self.clearance(time_s, &own.world_from_base);
        let telemetry = self.follower.controller().telemetry();
        let (limit, bound) = telemetry.bounds.least();
        let limited = telemetry.aim.is_some() && telemetry.bound == bound;
        let fused = report.and_then(|report| report.fused_m);
        let network = report.and(self.follower.network_range());
        let status = self.last.map(|report| report.status).unwrap_or_default();
        let log = FrameLog {
            time_s,
            range_true_m,
            range_network_m: report.and_then(|report| report.network_m),
            network_age_s: network.map(|seen| exposed.seconds_since(seen.stamp)),
            range_fast_m: report.and_then(|report| report.fast_m),
            range_ground_m: report.and_then(|report| report.ground_m),
            pitch_rad: self.last.map_or(0.0, |report| report.pitch_rad),
            range_fused_m: fused.map(|(range, _)| range),
            range_fused_std_m: fused.map(|(_, std)| std),
            status,
            gap_m,
            clearance_m,
            lateral_m: setup.lateral_m(time_s, &own.world_from_base),
            speed_command: command.speed,
            speed_limit: telemetry.aim.is_some().then_some(limit),
            limited_by: limited.then(|| bound.name()),
            steering_command: command.steering_angle,
            speed: own.speed,
            steering: own.steering_angle,
            target_speed: target.map_or(0.0, |target| target.state.speed),
            follower: own.world_from_base,
            target: target.map(|target| target.state.world_from_base).unwrap_or_default(),
            stop: command.stop,
        };
        let time = command.stamp.secs_f64();
        let open = self.log.stops.last_mut().filter(|stop| stop.until_s.is_none());
        let reason = open.as_ref().map(|stop| stop.reason);
        if reason != command.stop {
            if let Some(open) = open {
                open.until_s = Some(time);
            }
            if let Some(reason) = command.stop {
                self.log.stops.push(StopLog { from_s: time, until_s: None, reason });
            }
        }
        for (body, actor) in
            self.log.bodies.iter_mut().zip(self.actors.iter().skip(usize::from(has_target)))
        {
            body.poses.push(actor.state.world_from_base);
        }
        self.log.frames.push(log);
    }

    /// The depth that a perfect network gives of a perfect box: the rule that the
    /// follower uses, on the true depths of the target's own pixels.
    fn true_range(&mut self, truth: &Truth) -> Option<f64> {
        let picture = &self.picture;
        self.target_depth.set_stamp(picture.depth.stamp());
        let own = picture.mask.iter().zip(picture.depth.data());
        for (out, (mask, depth)) in self.target_depth.data_mut().iter_mut().zip(own) {
            *out = if *mask == TARGET_MASK { *depth } else { DepthMap::UNKNOWN };
        }
        let found = self.depth_in_box.measure(&self.target_depth, truth.bbox, DepthNoise::NONE);
        found.ok().map(|found| found.depth_m)
    }

    /// Distance to whatever is nearest.
    fn clearance(&mut self, time_s: f64, own: &Pose2) -> f64 {
        let corners = self.setup.follower.kind.size().corners(own);
        let vehicles = self.actors.iter().map(|actor| {
            clearance(&corners, &actor.kind.size().corners(&actor.state.world_from_base))
        });
        let mut least = vehicles.fold(f64::INFINITY, f64::min);
        for obstacle in self.scene.obstacles() {
            self.outline.clear();
            self.outline.extend(obstacle.footprint(time_s));
            least = least.min(clearance(&corners, &self.outline));
        }
        let walls = self.scene.bounds().map(|bounds| {
            corners.iter().map(|corner| bounds.depth_of(corner)).fold(f64::INFINITY, f64::min)
        });
        least.min(walls.unwrap_or(f64::INFINITY))
    }
}

fn is_visible(truth: &Truth) -> bool {
    truth.visible_share >= VISIBLE && truth.inside_share >= VISIBLE
}

/// Mean of a picture over white, 0 to 1, by some of its pixels.
fn brightness(frame: &Frame) -> f64 {
    let (sum, count) = frame
        .data()
        .iter()
        .step_by(97)
        .fold((0u64, 0u64), |(sum, count), value| (sum + u64::from(*value), count + 1));
    sum as f64 / (255 * count.max(1)) as f64
}

fn camera(setup: &Setup) -> SimCamera {
    let camera = &setup.camera;
    let sensor = Sensor::default();
    SimCamera {
        model: camera.model,
        base_from_camera: mount(setup, 0.0),
        sensor: Sensor {
            read_noise: camera.noise / 255.0 * 0.2,
            // A short exposure blurs by a pixel or two, and costs three pictures.
            blur: (camera.exposure_s >= BLURRING_S)
                .then_some(MotionBlur { shutter_s: camera.exposure_s, max_samples: 9 }),
            exposure: Exposure::Auto { lag_s: 0.25, target: 0.22, max_gain: 12.0 },
            ..sensor
        },
    }
}

/// Where the camera really sits at a time.
fn mount(setup: &Setup, time_s: f64) -> realnet_core::Pose {
    let mount = &setup.camera.mount;
    let [roll, pitch, yaw] = setup.camera_turn(time_s);
    let height = mount.height_m + setup.camera.height_error_m;
    let place = Vector3::new(mount.forward_m, mount.left_m, height);
    base_from_mount(place, yaw, mount.pitch_rad + setup.camera.pitch_error_rad + pitch, roll)
}

fn walls(bounds: &Bounds) -> Vec<Vector2<f64>> {
    let (low, high) = (bounds.min, bounds.max);
    [[low.x, low.y], [high.x, low.y], [high.x, high.y], [low.x, high.y]]
        .map(|[x, y]| Vector2::new(x, y))
        .to_vec()
}

/// What stands and drives about: the other vehicles first, then what is in the scene.
fn bodies(setup: &Setup, scene: &Scene) -> Vec<BodyLog> {
    let vehicles = setup.others.iter().map(|other| BodyLog {
        name: other.kind.name().to_owned(),
        outline: other.kind.size().corners(&Pose2::IDENTITY).to_vec(),
        poses: Vec::new(),
    });
    let standing = scene.obstacles().iter().filter(|obstacle| !obstacle.moves());
    let obstacles = standing.map(|obstacle: &Obstacle| BodyLog {
        name: "obstacle".to_owned(),
        outline: obstacle.footprint(0.0).collect(),
        poses: vec![Pose2::IDENTITY],
    });
    vehicles.chain(obstacles).collect()
}
