//! What all scenarios have in common, and the tools to change it.

use super::{CameraSetup, Expectations, FollowerSetup, Scenario, Setup};
use crate::dynamics::{DriveTrain, VehicleDynamics};
use crate::perception::{DepthNetworkModel, DetectorModel, Random, random_stream};
use crate::scene::{SceneKind, SceneSpec};
use crate::traffic::{Route, ScriptedVehicle, SpeedProfile};
use crate::{VehicleKind, VehicleState};
use rand::RngExt;
use realnet_control::{ControlOptions, DeadBand, Drive, SpeedOptions, VehicleOptions};
use realnet_core::nalgebra::Vector2;
use realnet_core::{CameraError, CameraModel, Distortion, Intrinsics, Pose2};
use realnet_pipeline::CameraMount;

/// From pose to pose of what is kept free, metres.
const FREE_SPACING: f64 = 0.3;

/// A setup that is being made.
pub(super) struct Draft {
    pub(super) setup: Setup,
    random: Random,
    /// See [`Draft::wide_camera`].
    wide: CameraModel,
    /// The gap at the start over the one to be kept.
    pub(super) start_gap: f64,
    /// Where the follower starts beside the target's path, metres, and its heading
    /// against it, radians.
    start_offset: [f64; 2],
}

impl Draft {
    /// The common draft: a car follows in a world by chance. All common draws come
    /// first and in one order, so that a scenario's own change nothing in them.
    ///
    /// # Errors
    /// [`CameraError`] if a camera cannot be built.
    pub(super) fn new(scenario: &Scenario, seed: u64) -> Result<Self, CameraError> {
        let mut random = random_stream(seed, scenario.name());
        let mut between = |low: f64, high: f64| low + (high - low) * random.random::<f64>();

        let kinds = [SceneKind::Room, SceneKind::Hall, SceneKind::Track];
        let kind = kinds[((between(0.0, 3.0)) as usize).min(2)];
        let scene = SceneSpec {
            kind,
            light: between(0.75, 1.2),
            clutter: between(8.0, 16.0) as usize,
            keep_free: Vec::new(),
            ..SceneSpec::default()
        };

        let mut dynamics = VehicleDynamics::of(VehicleKind::TouringCar);
        dynamics.friction = between(0.7, 1.0);
        dynamics.dead_time_s *= between(0.8, 1.3);
        let motor = dynamics.motor_mut();
        motor.gain = between(0.95, 1.05);
        motor.lag_s *= between(0.8, 1.3);
        let (trim, gain) = (between(-0.02, 0.02), between(0.96, 1.04));
        if let DriveTrain::Ackermann(car) = &mut dynamics.drive {
            (car.steering.trim, car.steering.gain) = (trim, gain);
        }

        let mut detector = DetectorModel::default();
        detector.channel.latency.mean_s *= between(0.9, 1.1);
        detector.edge_noise *= between(0.8, 1.25);
        let mut depth = DepthNetworkModel::default();
        depth.channel.latency.mean_s *= between(0.95, 1.05);
        depth.patch_noise *= between(0.8, 1.25);

        let start_gap = between(-0.15, 0.2);
        let start_offset = [between(-0.06, 0.06), between(-0.05, 0.05)];
        let mut camera = camera(between(0.4, 1.0), between(0.004, 0.009))?;
        // No mount is what its drawing says.
        camera.pitch_error_rad = between(-0.008, 0.008);
        camera.height_error_m = between(-0.005, 0.005);

        let setup = Setup {
            name: scenario.name(),
            description: scenario.description(),
            seed,
            duration_s: scenario.duration_s(),
            scene,
            camera,
            follower: FollowerSetup {
                kind: VehicleKind::TouringCar,
                dynamics,
                start: VehicleState::default(),
            },
            target: None,
            others: Vec::new(),
            detector,
            depth,
            control: control(VehicleKind::TouringCar),
            stop_requests: Vec::new(),
            expectations: Expectations {
                settle_s: 5.0,
                tracks_at_end: true,
                min_way_m: 1.0,
                ..Expectations::default()
            },
        };
        let bent = Distortion::PlumbBob([-0.06, 0.008, 0.0, 0.0, 0.0]);
        Ok(Self { setup, random, wide: lens(320.0, bent)?, start_gap, start_offset })
    }

    /// A random number.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random.random::<f64>()
    }

    /// A value give or take 15 %.
    pub(super) fn about(&mut self, value: f64) -> f64 {
        value * self.between(0.85, 1.15)
    }

    /// 1 or -1.
    pub(super) fn side(&mut self) -> f64 {
        if self.random.random::<bool>() { 1.0 } else { -1.0 }
    }

    /// A car of any kind.
    pub(super) fn any_car(&mut self) -> VehicleKind {
        match (self.between(0.0, 3.0)) as u32 {
            0 => VehicleKind::TouringCar,
            1 => VehicleKind::Truck,
            _ => VehicleKind::Buggy,
        }
    }

    /// A route that wanders about ahead.
    pub(super) fn wander(&mut self, length: f64, peak: f64, radius: f64) -> Route {
        let middle = Vector2::new(0.7 * radius, 0.0);
        let route = Route::new(Pose2::IDENTITY).straight(0.6);
        route.wander(&mut self.random, length, peak, middle, radius)
    }

    /// Sets the gap to keep, metres.
    pub(super) fn gap(&mut self, gap_m: f64) {
        self.setup.control.speed.gap_m = gap_m;
    }

    /// Puts the target at the start of a route, and the follower behind it.
    pub(super) fn target(&mut self, kind: VehicleKind, route: Route, profile: SpeedProfile) {
        let target = ScriptedVehicle { kind, route, profile, start: 0.0 };
        let behind = kind.size().rear_overhang
            + self.setup.desired_gap_m()
            + self.start_gap
            + self.setup.follower.kind.size().front();
        let [left, heading] = self.start_offset;
        let on_path = target.route.pose(-behind);
        let start = &mut self.setup.follower.start;
        start.world_from_base = on_path * Pose2::new(0.0, left, heading);
        self.setup.target = Some(target);
    }

    /// A camera that sees 90 degrees across, bent by its lens.
    pub(super) fn wide_camera(&mut self) {
        self.setup.camera.model = self.wide;
    }

    /// The vehicle that follows is another one.
    pub(super) fn follower(&mut self, kind: VehicleKind) {
        let drawn = self.setup.follower.dynamics;
        let mut dynamics = VehicleDynamics::of(kind);
        dynamics.friction = drawn.friction;
        dynamics.motor_mut().gain = drawn.motor().gain;
        self.setup.follower = FollowerSetup { kind, dynamics, ..self.setup.follower };
        let gap = self.setup.desired_gap_m();
        self.setup.control = control(kind);
        self.setup.camera.mount.forward_m = kind.size().front() - 0.06;
        self.gap(gap);
    }

    /// Where the target is at a time, and nothing at the origin without one.
    pub(super) fn target_at(&self, time_s: f64) -> Pose2 {
        let target = self.setup.target.as_ref();
        target.map(|target| target.state(time_s).world_from_base).unwrap_or_default()
    }

    /// Puts another vehicle that drives straight: at `time_s` its base frame's origin
    /// is at `place`, looking along the place's x axis.
    pub(super) fn passing(&mut self, kind: VehicleKind, place: Pose2, time_s: f64, speed: f64) {
        let profile = SpeedProfile::constant(speed);
        let start = -profile.way(time_s);
        let route = Route::new(place);
        self.setup.others.push(ScriptedVehicle { kind, route, profile, start });
    }

    /// The setup, with the ways of all vehicles kept free.
    pub(super) fn finish(self) -> Setup {
        let mut setup = self.setup;
        let until = setup.duration_s;
        let mut free = Vec::new();
        let mut along = |route: &Route, from: f64, to: f64| {
            let steps = ((to - from) / FREE_SPACING).ceil().max(1.0);
            free.extend((0..=steps as u32).map(|index| {
                let at = from + (to - from) * f64::from(index) / steps;
                let place = route.pose(at).position();
                [place.x, place.y]
            }));
        };
        // The target first, from behind the follower on.
        if let Some(target) = &setup.target {
            let (least, most) = target.profile.reach(until);
            let start = setup.follower.start.world_from_base.position();
            let behind = (start - target.route.pose(0.0).position()).norm() + 0.5;
            along(&target.route, least.min(0.0) - behind, most + 1.0);
        } else {
            along(&Route::new(setup.follower.start.world_from_base), -0.5, 3.0);
        }
        for other in &setup.others {
            let (least, most) = other.profile.reach(until);
            along(
                &other.route,
                other.start + least,
                other.start + most + other.kind.size().front(),
            );
        }
        setup.scene.keep_free = free;
        setup
    }
}

/// 640 x 360 pixels, 70 degrees across, 30 frames a second.
fn camera(noise: f64, exposure_s: f64) -> Result<CameraSetup, CameraError> {
    Ok(CameraSetup {
        model: lens(457.0, Distortion::None)?,
        mount: CameraMount::default(),
        pitch_error_rad: 0.0,
        height_error_m: 0.0,
        rate_hz: 30.0,
        latency_s: 0.02,
        exposure_s,
        noise,
        knocks: Vec::new(),
        outages: Vec::new(),
    })
}

/// A camera of 640 x 360 pixels.
fn lens(focal: f64, distortion: Distortion) -> Result<CameraModel, CameraError> {
    let intrinsics = Intrinsics { fx: focal, fy: focal, cx: 319.5, cy: 179.5 };
    CameraModel::new(640, 360, intrinsics, distortion)
}

/// What the follower is told about its vehicle.
fn control(kind: VehicleKind) -> ControlOptions {
    let dynamics = VehicleDynamics::of(kind);
    let motor = dynamics.motor();
    let (drive, steering_lag_s, max_speed_m_s) = match &dynamics.drive {
        DriveTrain::Ackermann(car) => (
            Drive::Ackermann {
                wheelbase_m: car.wheelbase,
                max_steering_rad: car.steering.max_angle - 0.03,
                max_steering_rate_rad_s: 0.8 * car.steering.max_rate,
            },
            car.steering.lag_s,
            2.0,
        ),
        DriveTrain::Differential(robot) => (
            Drive::Differential {
                track_m: robot.track,
                max_wheel_speed_m_s: 0.8 * robot.motor.max_speed,
                max_yaw_rate_rad_s: 3.0,
                max_yaw_acceleration_rad_s2: 12.0,
            },
            robot.motor.lag_s,
            1.0,
        ),
    };
    ControlOptions {
        vehicle: VehicleOptions {
            drive,
            front_m: kind.size().front(),
            max_speed_m_s,
            max_acceleration_m_s2: 0.8 * motor.max_acceleration,
            max_deceleration_m_s2: 0.9 * motor.max_braking,
            dead_band: DeadBand { min_speed_m_s: 1.1 * motor.start_speed, ..DeadBand::default() },
            dead_time_s: dynamics.dead_time_s,
            speed_lag_s: motor.lag_s,
            steering_lag_s,
            ..VehicleOptions::default()
        },
        speed: SpeedOptions { gap_m: 1.0, ..SpeedOptions::default() },
        ..ControlOptions::default()
    }
}
