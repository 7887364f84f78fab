//! Times of pictures: `cargo bench -p realnet-sim --bench render`.
//!
//! Whole pictures of 640 x 360 pixels, RGB with noise, depth, mask and truth of two
//! vehicles, on one core; `frames` is how many a second.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use realnet_core::{CameraModel, Distortion, Intrinsics, Pose2};
use realnet_sim::render::{Actor, MotionBlur, Renderer, Sensor, Shot, SimCamera};
use realnet_sim::scene::{Scene, SceneKind, SceneSpec};
use realnet_sim::{VehicleKind, VehicleState};

fn main() {
    divan::main();
}

fn camera(width: u32, height: u32) -> SimCamera {
    let focal = 0.8 * f64::from(width);
    let (cx, cy) = (0.5 * f64::from(width) - 0.5, 0.5 * f64::from(height) - 0.5);
    let intrinsics = Intrinsics { fx: focal, fy: focal, cx, cy };
    let lens = Distortion::PlumbBob([-0.12, 0.02, 0.0, 0.0, 0.0]);
    SimCamera::new(CameraModel::new(width, height, intrinsics, lens).unwrap())
}

fn scene(kind: SceneKind) -> Scene {
    let keep_free = vec![[0.0, 0.0], [2.0, 0.0], [4.0, 0.5]];
    Scene::build(&SceneSpec { kind, keep_free, moving: 2, ..SceneSpec::default() }, 1)
}

/// The camera drives ahead behind two vehicles; frame after frame at 30 Hz.
fn frames(bencher: Bencher<'_, '_>, scene: &Scene, camera: SimCamera) {
    let mut renderer = Renderer::new(camera);
    let mut picture = renderer.blank();
    let mut index: u32 = 0;
    bencher.counter(ItemsCount::new(1usize)).bench_local(|| {
        index += 1;
        let t = f64::from(index % 60) / 30.0;
        let at = |x: f64, y: f64, heading: f64| VehicleState {
            world_from_base: Pose2::new(x + 0.5 * t, y, heading),
            speed: 0.5,
            wheel_angle: 10.0 * t,
            ..VehicleState::default()
        };
        let actors = [
            Actor::new(VehicleKind::TouringCar, 1, at(1.5, 0.1, 0.2)),
            Actor::new(VehicleKind::Truck, 4, at(2.6, -0.4, -0.3)),
        ];
        let own = VehicleState { yaw_rate: 0.4, ..at(0.0, 0.0, 0.05 * t) };
        let shot =
            Shot { time_s: t, own, actors: &actors, seed: u64::from(index), ..Shot::default() };
        renderer.render(scene, &shot, &mut picture);
        black_box(picture.truth(0))
    });
}

#[divan::bench(args = ["room", "hall", "track", "corridor"])]
fn whole(bencher: Bencher<'_, '_>, name: &str) {
    let kind = SceneKind::ALL.into_iter().find(|kind| kind.name() == name).unwrap();
    frames(bencher, &scene(kind), camera(640, 360));
}

/// With up to five moments an exposure of 20 ms.
#[divan::bench]
fn blurred(bencher: Bencher<'_, '_>) {
    let mut camera = camera(640, 360);
    let blur = Some(MotionBlur { shutter_s: 0.02, max_samples: 5 });
    camera.sensor = Sensor { blur, ..Sensor::default() };
    frames(bencher, &scene(SceneKind::Room), camera);
}

#[divan::bench]
fn large(bencher: Bencher<'_, '_>) {
    frames(bencher, &scene(SceneKind::Room), camera(1280, 720));
}

/// A world of a new seed.
#[divan::bench]
fn build(bencher: Bencher<'_, '_>) {
    let mut seed = 0;
    bencher.bench_local(|| {
        seed += 1;
        Scene::build(&SceneSpec::default(), seed)
    });
}
