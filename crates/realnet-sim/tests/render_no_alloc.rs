//! After the first pictures of a scene nothing is allocated.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;

use counting::count;
use realnet_core::{CameraModel, Distortion, Intrinsics, Pose2};
use realnet_sim::render::{Actor, MotionBlur, Renderer, Sensor, Shot, SimCamera};
use realnet_sim::scene::{Scene, SceneSpec};
use realnet_sim::{VehicleKind, VehicleState};

#[test]
fn pictures_are_free_of_allocation() {
    let intrinsics = Intrinsics { fx: 250.0, fy: 250.0, cx: 159.5, cy: 89.5 };
    let lens = Distortion::PlumbBob([-0.1, 0.0, 0.0, 0.0, 0.0]);
    let mut camera = SimCamera::new(CameraModel::new(320, 180, intrinsics, lens).unwrap());
    let blur = Some(MotionBlur { shutter_s: 0.02, max_samples: 3 });
    camera.sensor = Sensor { blur, ..Sensor::default() };
    let scene = Scene::build(&SceneSpec { moving: 3, ..SceneSpec::default() }, 1);
    let mut renderer = Renderer::new(camera);
    let mut out = renderer.blank();
    let mut drive = || {
        let before = count();
        for step in 0..12u32 {
            let t = f64::from(step) / 30.0;
            let at = |x: f64, turn: f64| VehicleState {
                world_from_base: Pose2::new(x + t, 0.1, turn),
                speed: 1.0,
                ..VehicleState::default()
            };
            let actors = [
                Actor::new(VehicleKind::Truck, 1, at(1.2, t)),
                Actor::new(VehicleKind::Robot, 2, at(2.0, -t)),
            ];
            let shot = Shot {
                time_s: t,
                own: at(0.0, t),
                actors: &actors,
                seed: u64::from(step),
                ..Shot::default()
            };
            renderer.render(&scene, &shot, &mut out);
            assert!(out.truth(0).is_some());
        }
        count() - before
    };
    assert!(drive() > 0, "the first pictures make room");
    assert_eq!(drive(), 0);
}
