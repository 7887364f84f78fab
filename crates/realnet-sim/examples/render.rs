//! Pictures of the simulator's worlds, for the eye:
//!
//! ```text
//! cargo run --release -p realnet-sim --example render -- DIR
//! ```
//!
//! writes a picture of each world, of each vehicle from near and far, with depth and
//! mask beside it.
#![allow(missing_docs, clippy::print_stdout)]

use image::{Rgb, RgbImage};
use realnet_core::nalgebra::Vector3;
use realnet_core::{CameraModel, Distortion, Intrinsics, Pose2};
use realnet_sim::render::{
    Actor, MotionBlur, Rendered, Renderer, Sensor, Shot, SimCamera, base_from_mount,
};
use realnet_sim::scene::{Scene, SceneKind, SceneSpec};
use realnet_sim::{VehicleKind, VehicleState};
use std::error::Error;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("."), PathBuf::from);
    std::fs::create_dir_all(&folder)?;
    let intrinsics = Intrinsics { fx: 520.0, fy: 520.0, cx: 319.5, cy: 179.5 };
    let lens = Distortion::PlumbBob([-0.12, 0.02, 0.0, 0.0, 0.0]);
    let mut renderer = Renderer::new(SimCamera::new(CameraModel::new(640, 360, intrinsics, lens)?));
    let mut picture = renderer.blank();
    for kind in SceneKind::ALL {
        for seed in 1..=2 {
            let keep_free = vec![[0.0, 0.0], [2.0, 0.0], [4.0, 0.5]];
            let spec = SceneSpec { kind, keep_free, moving: 3, ..SceneSpec::default() };
            let scene = Scene::build(&spec, seed);
            let target = at(2.0, 0.15, 0.25, seed == 2);
            let other = at(3.2, -0.35, -0.4, false);
            let kinds = VehicleKind::ALL;
            let actors = [
                Actor::new(kinds[(seed as usize + kind as usize) % 4], seed + kind as u64, target),
                Actor::new(kinds[(seed as usize + kind as usize + 1) % 4], seed + 5, other),
            ];
            renderer.reset_exposure();
            let shot = Shot { actors: &actors, time_s: 1.0, seed, ..Shot::default() };
            renderer.render(&scene, &shot, &mut picture);
            save(&folder, &format!("{}-{seed}", kind.name()), &picture)?;
        }
    }
    large(&folder)?;
    let scene = Scene::build(&SceneSpec::default(), 3);
    for kind in VehicleKind::ALL {
        for (name, x, heading) in
            [("near", 0.85, 0.0), ("turned", 1.05, 0.8), ("far", 2.2, 0.3), ("front", 1.2, 2.7)]
        {
            let actors = [Actor::new(kind, 1, at(x, 0.0, heading, name == "near"))];
            renderer.reset_exposure();
            renderer.render(&scene, &Shot { actors: &actors, ..Shot::default() }, &mut picture);
            save(&folder, &format!("{}-{name}", kind.name()), &picture)?;
        }
    }
    let blur = Some(MotionBlur { shutter_s: 0.03, max_samples: 9 });
    renderer.set_sensor(Sensor { blur, ..Sensor::default() });
    let own = VehicleState { speed: 0.5, yaw_rate: 1.0, ..VehicleState::default() };
    let actors = [Actor::new(VehicleKind::TouringCar, 1, at(1.2, 0.0, 0.2, false))];
    renderer.render(&scene, &Shot { actors: &actors, own, ..Shot::default() }, &mut picture);
    save(&folder, "blurred", &picture)?;
    let dark = SceneSpec { light: 0.02, ..SceneSpec::default() };
    renderer.set_sensor(Sensor::default());
    renderer.reset_exposure();
    let shot = Shot { actors: &actors, ..Shot::default() };
    renderer.render(&Scene::build(&dark, 3), &shot, &mut picture);
    save(&folder, "dark", &picture)?;
    Ok(())
}

/// Rooms at twice the size, two vehicles close by.
fn large(folder: &Path) -> Result<(), Box<dyn Error>> {
    let intrinsics = Intrinsics { fx: 900.0, fy: 900.0, cx: 639.5, cy: 359.5 };
    let lens = Distortion::PlumbBob([-0.08, 0.01, 0.0, 0.0, 0.0]);
    let mut camera = SimCamera::new(CameraModel::new(1280, 720, intrinsics, lens)?);
    camera.base_from_camera = base_from_mount(Vector3::new(0.3, 0.0, 0.26), 0.0, 0.10, 0.0);
    let mut renderer = Renderer::new(camera);
    let mut picture = renderer.blank();
    for (kind, seed) in
        [(SceneKind::Room, 1), (SceneKind::Room, 12), (SceneKind::Hall, 2), (SceneKind::Track, 1)]
    {
        let keep_free = vec![[0.0, 0.0], [1.5, 0.1], [3.0, 0.4]];
        let spec = SceneSpec { kind, keep_free, clutter: 16, moving: 2, ..SceneSpec::default() };
        let scene = Scene::build(&spec, seed);
        let actors = [
            Actor::new(VehicleKind::TouringCar, 0, at(1.45, 0.10, 0.30, true)),
            Actor::new(VehicleKind::Truck, 3, at(2.35, -0.42, -0.35, false)),
        ];
        renderer.reset_exposure();
        let shot = Shot { actors: &actors, time_s: 1.0, seed, ..Shot::default() };
        renderer.render(&scene, &shot, &mut picture);
        save(folder, &format!("large-{}-{seed}", kind.name()), &picture)?;
    }
    Ok(())
}

fn at(x: f64, y: f64, heading: f64, braking: bool) -> VehicleState {
    VehicleState {
        world_from_base: Pose2::new(x, y, heading),
        steering_angle: 0.3 * heading.signum() * f64::from(heading != 0.0),
        wheel_angle: 0.4,
        braking,
        ..VehicleState::default()
    }
}

/// The picture, and beside it depth (near is bright) and mask.
fn save(folder: &Path, name: &str, picture: &Rendered) -> Result<(), Box<dyn Error>> {
    let (width, height) = (picture.frame.width(), picture.frame.height());
    let raw = picture.frame.data().to_vec();
    let image = RgbImage::from_raw(width, height, raw).ok_or("the frame has its size")?;
    image.save(folder.join(format!("{name}.png")))?;
    let side = RgbImage::from_fn(2 * width, height, |x, y| {
        let at = x % width;
        if x < width {
            let near = picture.depth.at(at, y).map_or(0.0, |depth| 0.5 / depth);
            Rgb([(255.0 * near.min(1.0)) as u8; 3])
        } else {
            let id = picture.mask.get((y * width + at) as usize).copied().unwrap_or(0);
            Rgb([id.wrapping_mul(90), id.wrapping_mul(160), id.wrapping_mul(210)])
        }
    });
    side.save(folder.join(format!("{name}-truth.png")))?;
    for index in 0..2 {
        if let Some(truth) = picture.truth(index) {
            println!("{name} {index}: {truth:?}");
        }
    }
    Ok(())
}
