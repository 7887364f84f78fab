//! Pictures against closed forms, and what optical flow makes of them.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use proptest::prelude::*;
use realnet_core::nalgebra::{Point3, UnitQuaternion, Vector3};
use realnet_core::{BoundingBox, CameraModel, DepthMap, Distortion, Intrinsics, Pose, Pose2};
use realnet_range::cues::ForegroundGate;
use realnet_range::motion::{MotionOptions, MotionTracker};
use realnet_sim::render::{
    Actor, Exposure, MotionBlur, Rendered, Renderer, Sensor, Shot, SimCamera, base_from_mount,
};
use realnet_sim::scene::{LightChange, Scene, SceneKind, SceneSpec, TextureLevel};
use realnet_sim::{VehicleKind, VehicleState};

const LENSES: [Distortion; 4] = [
    Distortion::None,
    Distortion::PlumbBob([-0.25, 0.06, 0.002, -0.001, 0.0]),
    Distortion::RationalPolynomial([0.2, 0.01, 0.0005, 0.0, 0.0, 0.4, 0.05, 0.0]),
    Distortion::Equidistant([0.02, -0.005, 0.001, 0.0]),
];

fn model(lens: Distortion) -> CameraModel {
    // Not a whole number of tiles either way.
    let intrinsics = Intrinsics { fx: 250.0, fy: 247.0, cx: 152.3, cy: 88.1 };
    CameraModel::new(310, 180, intrinsics, lens).unwrap()
}

fn camera(lens: Distortion) -> SimCamera {
    SimCamera { sensor: Sensor::ideal(), ..SimCamera::new(model(lens)) }
}

fn empty(kind: SceneKind, seed: u64) -> Scene {
    Scene::build(&SceneSpec { kind, clutter: 0, ..SceneSpec::default() }, seed)
}

fn standing(x: f64, y: f64, heading: f64) -> VehicleState {
    VehicleState { world_from_base: Pose2::new(x, y, heading), ..VehicleState::default() }
}

fn picture(renderer: &mut Renderer, scene: &Scene, shot: &Shot<'_>) -> Rendered {
    let mut out = renderer.blank();
    renderer.render(scene, shot, &mut out);
    out
}

/// FNV-1a over the bytes of a picture and its truth.
fn hash(out: &Rendered) -> u64 {
    let depths = out.depth.data().iter().flat_map(|depth| depth.to_le_bytes());
    let bytes = out.frame.data().iter().chain(&out.mask).copied().chain(depths);
    bytes.fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3))
}

/// In an empty room the depth is that of the floor and the walls, through any lens and
/// from any mount.
#[test]
fn the_depth_of_a_room_is_that_of_its_planes() {
    let scene = empty(SceneKind::Room, 4);
    let bounds = scene.bounds().unwrap();
    for (index, lens) in LENSES.into_iter().enumerate() {
        let mut camera = camera(lens);
        let turn = 0.9 * index as f64;
        camera.base_from_camera =
            base_from_mount(Vector3::new(0.3, 0.02, 0.18), 0.1, 0.12 * index as f64, 0.07);
        let mut renderer = Renderer::new(camera);
        let own = standing(0.4, -0.2, turn);
        let out = picture(&mut renderer, &scene, &Shot { own, ..Shot::default() });
        let world_from_camera = renderer.world_from_camera(&own.world_from_base, [0.0; 2]);
        let eye = world_from_camera.translation();
        let mut checked = 0;
        for v in 0..180 {
            for u in 0..310 {
                let [x, y] = camera.model.unproject([f64::from(u), f64::from(v)]).unwrap();
                let ray = world_from_camera.transform_vector(&Vector3::new(x, y, 1.0));
                // To the first of the planes around: the ray's third coordinate is the depth.
                let to = |plane: f64, axis: usize| {
                    let depth = (plane - eye[axis]) / ray[axis];
                    if depth > 0.0 { depth } else { f64::INFINITY }
                };
                let walls = [
                    to(bounds.min.x, 0),
                    to(bounds.max.x, 0),
                    to(bounds.min.y, 1),
                    to(bounds.max.y, 1),
                    to(0.0, 2),
                ];
                let truth = walls.into_iter().fold(f64::INFINITY, f64::min);
                let hit = eye + ray * truth;
                // Above 2 m hangs the ceiling with its lamp.
                if hit.z < 2.0 {
                    let found = f64::from(out.depth.at(u, v).unwrap());
                    let error = (found - truth).abs() / truth;
                    assert!(error < 3e-5, "lens {index}, ({u}, {v}): {found} for {truth}");
                    checked += 1;
                }
            }
        }
        assert!(checked > 20_000, "{checked}");
        assert!(out.mask.iter().all(|&id| id == 0));
    }
}

/// The rear of the truck is a plane across its axis.
#[test]
fn the_depth_of_a_rear_is_that_of_its_plane() {
    let scene = empty(SceneKind::Hall, 1);
    let size = VehicleKind::Truck.size();
    for lens in LENSES {
        let mut renderer = Renderer::new(camera(lens));
        let target = Actor::new(VehicleKind::Truck, 3, standing(1.3, 0.05, 0.0));
        let out = picture(&mut renderer, &scene, &Shot { actors: &[target], ..Shot::default() });
        let truth = out.truth(0).unwrap();
        let plane = 1.3 - size.rear_overhang - 0.30;
        assert!((truth.depth_median_m - plane).abs() < 1e-5, "{truth:?}");
        assert!((truth.depth_min_m - plane).abs() < 1e-5, "{truth:?}");
    }
}

/// Corners of the solid that a vehicle fills, by its size alone, lie in its box; and the
/// box is not larger than they make it.
#[test]
fn boxes_hold_what_the_camera_model_projects() {
    let scene = empty(SceneKind::Hall, 2);
    for lens in LENSES {
        for kind in VehicleKind::ALL {
            for (x, y, heading) in [(1.0, 0.0, 0.0), (1.3, 0.2, 0.7), (2.5, -0.5, 2.6)] {
                let mut renderer = Renderer::new(camera(lens));
                let state = standing(x, y, heading);
                let actors = [Actor::new(kind, 1, state)];
                let shot = Shot { actors: &actors, ..Shot::default() };
                let out = picture(&mut renderer, &scene, &shot);
                let truth = out.truth(0).unwrap();
                let camera_from_world =
                    renderer.world_from_camera(&Pose2::IDENTITY, [0.0; 2]).inverse();
                let mut solid: Option<BoundingBox> = None;
                for corner in kind.size().corners(&state.world_from_base) {
                    for z in [0.0, kind.size().height] {
                        let point = Point3::new(corner.x, corner.y, z);
                        let pixel = renderer.camera().model.project(&(camera_from_world * point));
                        let [u, v] = pixel.unwrap().map(|c| (c + 0.5) as f32);
                        let dot = BoundingBox::new(u, v, u, v);
                        solid = Some(solid.map_or(dot, |all| all.enclosing(&dot)));
                    }
                }
                let (solid, full) = (solid.unwrap(), truth.full_bbox);
                // The shape stays within its size (curved edges: to a pixel) …
                let out_by = [
                    solid.x0 - full.x0,
                    solid.y0 - full.y0,
                    full.x1 - solid.x1,
                    full.y1 - solid.y1,
                ];
                let most = out_by.into_iter().fold(f32::MIN, f32::max);
                assert!(most < 1.0, "{kind:?} at {x}: {full:?} of {solid:?}");
                // … and fills most of it.
                assert!(full.iou(&solid) > 0.55, "{kind:?} at {x}: {full:?} of {solid:?}");
                // Nothing hides it, nothing cuts it: both boxes are one, to a pixel.
                let parts = [
                    full.x0 - truth.bbox.x0,
                    full.y0 - truth.bbox.y0,
                    full.x1 - truth.bbox.x1,
                    full.y1 - truth.bbox.y1,
                ];
                assert!(parts.iter().all(|part| part.abs() <= 1.0), "{truth:?}");
                assert_eq!((truth.visible_share, truth.inside_share), (1.0, 1.0));
            }
        }
    }
}

#[test]
fn the_mask_is_what_the_truth_counts() {
    let scene = empty(SceneKind::Room, 3);
    let mut renderer = Renderer::new(camera(LENSES[1]));
    // The second stands half behind the first; the third behind the camera.
    let actors = [
        Actor::new(VehicleKind::Truck, 1, standing(1.2, 0.0, 0.0)),
        Actor::new(VehicleKind::TouringCar, 2, standing(2.0, 0.16, 0.0)),
        Actor::new(VehicleKind::Buggy, 3, standing(-1.0, 0.0, 0.0)),
        Actor::new(VehicleKind::Robot, 4, standing(0.9, 0.42, 0.0)),
    ];
    let out = picture(&mut renderer, &scene, &Shot { actors: &actors, ..Shot::default() });
    for (index, id) in (1u8..=4).enumerate() {
        let pixels: Vec<(usize, usize)> =
            (0..310 * 180).filter(|&i| out.mask[i] == id).map(|i| (i % 310, i / 310)).collect();
        let Some(truth) = out.truth(index) else {
            assert!(pixels.is_empty() && index == 2, "{index}");
            continue;
        };
        assert_eq!(truth.pixels, pixels.len());
        let bound = |pick: fn(&(usize, usize)) -> usize| {
            let all = pixels.iter().map(pick);
            (all.clone().min().unwrap() as f32, (all.max().unwrap() + 1) as f32)
        };
        let ((x0, x1), (y0, y1)) = (bound(|p| p.0), bound(|p| p.1));
        assert_eq!(truth.bbox, BoundingBox::new(x0, y0, x1, y1));
        let mut depths: Vec<f32> =
            pixels.iter().map(|&(x, y)| out.depth.at(x as u32, y as u32).unwrap()).collect();
        depths.sort_by(f32::total_cmp);
        assert_eq!(truth.depth_median_m, f64::from(depths[depths.len() / 2]));
        assert_eq!(truth.depth_min_m, f64::from(depths[0]));
    }
    let [first, second] = [0, 1].map(|i| out.truth(i).unwrap());
    assert_eq!(first.visible_share, 1.0);
    assert!(second.visible_share > 0.1 && second.visible_share < 0.9, "{second:?}");
    assert!(second.full_bbox.x1 - second.bbox.x1 > 5.0, "its right side is hidden: {second:?}");
    let cut = out.truth(3).unwrap();
    assert!(cut.inside_share > 0.2 && cut.inside_share < 0.9, "{cut:?}");
    assert!(cut.full_bbox.x0 < 0.0 && cut.bbox.x0 == 0.0, "{cut:?}");
}

#[test]
fn a_seed_gives_the_same_bytes_and_another_does_not() {
    let spec = SceneSpec { moving: 3, ..SceneSpec::default() };
    let take = |seed: u64, noise: u64| {
        let mut camera = camera(LENSES[1]);
        let blur = Some(MotionBlur { shutter_s: 0.02, max_samples: 5 });
        camera.sensor = Sensor { blur, ..Sensor::default() };
        let mut renderer = Renderer::new(camera);
        let mut out = renderer.blank();
        let scene = Scene::build(&spec, seed);
        let own = VehicleState { speed: 0.8, yaw_rate: 0.5, ..standing(0.0, 0.0, 0.1) };
        let actors = [Actor::new(VehicleKind::Buggy, seed, standing(1.1, 0.0, 0.3))];
        let mut hashes = Vec::new();
        for step in 0..3 {
            let time_s = f64::from(step) / 30.0;
            let shot = Shot { time_s, own, actors: &actors, seed: noise, ..Shot::default() };
            renderer.render(&scene, &shot, &mut out);
            hashes.push(hash(&out));
        }
        hashes
    };
    assert_eq!(take(1, 1), take(1, 1));
    assert_ne!(take(1, 1), take(1, 2));
    assert_ne!(take(1, 1), take(2, 1));
}

#[test]
fn the_sky_has_no_depth_and_the_ground_has() {
    let scene = empty(SceneKind::Track, 5);
    let mut renderer = Renderer::new(camera(LENSES[0]));
    let out = picture(&mut renderer, &scene, &Shot::default());
    let known = out.depth.known_share();
    assert!(known > 0.5 && known < 0.97, "{known}");
    assert!(scene.bounds().is_none());
    assert_eq!(out.depth.data().iter().filter(|d| !d.is_finite()).count(), 0);
    // The lowest row looks at the ground 0.18 m below.
    let [_, y] = model(LENSES[0]).unproject([150.0, 179.0]).unwrap();
    let depth = f64::from(out.depth.at(150, 179).unwrap());
    assert!((depth - 0.18 / y).abs() < 1e-4, "{depth}");
}

fn mean(out: &Rendered) -> f64 {
    let data = out.frame.data();
    data.iter().map(|&v| f64::from(v)).sum::<f64>() / data.len() as f64
}

#[test]
fn exposure_follows_the_light_with_a_lag() {
    let light_changes = vec![LightChange { time_s: 1.0, factor: 0.25 }];
    let scene = Scene::build(&SceneSpec { light_changes, ..SceneSpec::default() }, 1);
    assert_eq!((scene.brightness(0.99), scene.brightness(1.0)), (1.0, 0.25));
    let mut camera = camera(LENSES[0]);
    let exposure = Exposure::Auto { lag_s: 0.3, target: 0.25, max_gain: 20.0 };
    camera.sensor = Sensor { exposure, ..Sensor::ideal() };
    let mut renderer = Renderer::new(camera);
    let mut out = renderer.blank();
    let mut at = |time_s: f64| {
        renderer.render(&scene, &Shot { time_s, ..Shot::default() }, &mut out);
        (mean(&out), out.gain())
    };
    let (before, gain) = at(0.97);
    let (dark, slow) = at(1.0);
    assert!(dark < 0.62 * before, "{before} {dark}");
    assert!(slow > gain && slow < 1.3 * gain, "{gain} {slow}");
    let (after, fast) = at(4.0);
    assert!((after - before).abs() < 0.05 * before, "{before} {after}");
    assert!((fast / gain - 4.0).abs() < 0.2, "{gain} {fast}");
}

#[test]
fn noise_has_the_deviation_of_the_sensor() {
    let scene = empty(SceneKind::Corridor, 2);
    let sensor = Sensor { shot_noise: 0.0, read_noise: 0.01, ..Sensor::ideal() };
    let mut renderer = Renderer::new(SimCamera { sensor, ..camera(LENSES[0]) });
    let [a, b] =
        [1, 2].map(|seed| picture(&mut renderer, &scene, &Shot { seed, ..Shot::default() }));
    renderer.set_sensor(Sensor::ideal());
    let clean = picture(&mut renderer, &scene, &Shot::default());
    let (mut sum, mut count) = (0.0, 0);
    for ((a, b), clean) in a.frame.data().iter().zip(b.frame.data()).zip(clean.frame.data()) {
        // d sqrt(L) = d L / (2 sqrt(L)): noise in grey levels, away from the ends.
        if (80..200).contains(clean) {
            let root = f64::from(*clean) / 255.0;
            let expected = 0.01 * 255.0 / (2.0 * root);
            let difference = (f64::from(*a) - f64::from(*b)) / expected;
            sum += difference * difference;
            count += 1;
        }
    }
    assert!(count > 50_000, "{count}");
    let deviation = (0.5 * sum / f64::from(count)).sqrt();
    assert!((deviation - 1.0).abs() < 0.06, "{deviation}");
}

#[test]
fn motion_blur_smears_along_the_motion_and_keeps_the_truth() {
    let scene = empty(SceneKind::Room, 6);
    let own = VehicleState { yaw_rate: 2.0, ..standing(0.0, 0.0, 0.0) };
    let shot = Shot { own, ..Shot::default() };
    let mut renderer = Renderer::new(camera(LENSES[0]));
    let sharp = picture(&mut renderer, &scene, &shot);
    let blur = Some(MotionBlur { shutter_s: 0.03, max_samples: 9 });
    renderer.set_sensor(Sensor { blur, ..Sensor::ideal() });
    let blurred = picture(&mut renderer, &scene, &shot);
    assert_eq!(sharp.depth, blurred.depth);
    // Sum of the squared steps along and across the motion.
    let steps = |out: &Rendered, dx: usize, dy: usize| -> f64 {
        let data = out.frame.data();
        let at = |x: usize, y: usize| f64::from(data[3 * (y * 310 + x)]);
        (0..179)
            .flat_map(|y| (0..309).map(move |x| (x, y)))
            .map(|(x, y)| (at(x + dx, y + dy) - at(x, y)).powi(2))
            .sum()
    };
    let along = steps(&blurred, 1, 0) / steps(&sharp, 1, 0);
    let across = steps(&blurred, 0, 1) / steps(&sharp, 0, 1);
    assert!(along < 0.35 && across > 1.5 * along, "{along} {across}");
    assert!((mean(&sharp) - mean(&blurred)).abs() < 2.0);
}

/// Motions by optical flow on pictures are the camera's and the target's own: textures and
/// edges move as those of a real picture do.
#[test]
fn flow_finds_the_motions_on_pictures() {
    let intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 319.5, cy: 179.5 };
    let lens = Distortion::PlumbBob([-0.12, 0.02, 0.0, 0.0, 0.0]);
    let camera = SimCamera::new(CameraModel::new(640, 360, intrinsics, lens).unwrap());
    let (mut lengths, mut turns, mut ranges) = (Vec::new(), Vec::new(), Vec::new());
    for kind in SceneKind::ALL {
        for seed in 1..=3u64 {
            let keep_free = vec![[0.0, 0.0], [4.0, 0.0]];
            let scene = Scene::build(&SceneSpec { kind, keep_free, ..SceneSpec::default() }, seed);
            let vehicle = VehicleKind::ALL[(seed as usize + kind as usize) % 4];
            let run = flow_run(&scene, camera, vehicle, seed);
            let (length, turn, range) = run.unwrap_or_else(|e| panic!("{kind:?} {seed}: {e}"));
            println!("{kind:?} {seed} {vehicle:?}: {length:.4} m, {turn:.5} rad, {range:.4} m");
            lengths.push(length);
            turns.push(turn);
            ranges.push(range);
        }
    }
    // Of 150 mm and 5.2 degrees in 0.3 s; the target goes 60 mm away at 1.2 m.
    for (mut errors, median, worst) in
        [(lengths, LENGTH[0], LENGTH[1]), (turns, TURN[0], TURN[1]), (ranges, RANGE[0], RANGE[1])]
    {
        errors.sort_by(f64::total_cmp);
        let (middle, last) = (errors[errors.len() / 2], errors[errors.len() - 1]);
        assert!(middle < median && last < worst, "{middle} {last}: {errors:?}");
    }
}

/// Median and worst error that is accepted: metres, radians, metres.
const LENGTH: [f64; 2] = [0.004, 0.010];
const TURN: [f64; 2] = [0.0006, 0.0015];
const RANGE: [f64; 2] = [0.006, 0.015];

/// Nine frames after a depth map: errors of the camera's translation and rotation, and of
/// the target's place along the optical axis.
fn flow_run(
    scene: &Scene,
    camera: SimCamera,
    vehicle: VehicleKind,
    seed: u64,
) -> Result<(f64, f64, f64), String> {
    let mut renderer = Renderer::new(camera);
    let mut out = renderer.blank();
    let mut tracker = MotionTracker::new(&camera.model, MotionOptions::default()).unwrap();
    let target = |t: f64| Pose2::new(1.3, 0.05, 0.1).driven(0.7, 0.3, t);
    let own = |t: f64| Pose2::IDENTITY.driven(0.5, 0.3, t);
    let state = |world_from_base: Pose2| VehicleState { world_from_base, ..Default::default() };
    for step in 0..=9u32 {
        let t = f64::from(step) / 30.0;
        let actors = [Actor::new(vehicle, seed, state(target(t)))];
        let own = state(own(t));
        let seed = u64::from(step);
        let shot = Shot { time_s: t, own, actors: &actors, seed, ..Shot::default() };
        renderer.render(scene, &shot, &mut out);
        tracker.push(&out.frame).unwrap();
        if step == 0 {
            let truth = out.truth(0).unwrap();
            let near = truth.depth_min_m as f32;
            let gate = ForegroundGate::new(truth.bbox, near - 0.02, near + 0.5);
            tracker.keep();
            tracker.set_depth(&out.depth, Some(&gate)).unwrap();
        } else {
            tracker.estimate();
        }
    }
    let motion = tracker.motion().unwrap();
    let world_from = |t: f64| renderer.world_from_camera(&own(t), [0.0; 2]);
    let truth = world_from(0.0).inverse() * world_from(0.3);
    let found = motion.then_from_now().ok_or_else(|| format!("{:?}", motion.background))?;
    let error = truth.inverse() * found;
    let body = motion.target.as_ref().unwrap().as_ref().map_err(ToString::to_string)?;
    let now_from_then = body.now_from_then();
    let middle = body.estimate.center;
    let then = now_from_then.inverse() * middle;
    // The true motion of that point of the target.
    let lift = |pose: Pose2| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pose.heading);
        Pose::new(turn, Vector3::new(pose.x, pose.y, 0.0))
    };
    let target_from_then = lift(target(0.0)).inverse() * world_from(0.0);
    let now = world_from(0.3).inverse() * lift(target(0.3)) * (target_from_then * then);
    Ok((error.translation_norm(), error.rotation_angle(), (now.z - middle.z).abs()))
}

/// Little is left to track where textures are low, and more where they are rich.
#[test]
fn low_texture_is_low() {
    let contrast = |texture: TextureLevel| {
        let scene = Scene::build(&SceneSpec { texture, clutter: 0, ..SceneSpec::default() }, 1);
        let mut renderer = Renderer::new(camera(LENSES[0]));
        let out = picture(&mut renderer, &scene, &Shot::default());
        // The floor: the lower third.
        let floor = &out.frame.data()[3 * 310 * 120..];
        let steps = floor.chunks_exact(3).zip(floor.chunks_exact(3).skip(1));
        steps.map(|(a, b)| (f64::from(a[0]) - f64::from(b[0])).powi(2)).sum::<f64>()
    };
    assert!(contrast(TextureLevel::Low) < 0.1 * contrast(TextureLevel::Rich));
}

/// Where the lens model ends nothing is seen: black, and no depth.
#[test]
fn beyond_the_lens_nothing_is_seen() {
    let lens = Distortion::PlumbBob([-0.55, 0.0, 0.0, 0.0, 0.0]);
    let scene = empty(SceneKind::Room, 1);
    let mut renderer = Renderer::new(camera(lens));
    let actors = [Actor::new(VehicleKind::Truck, 1, standing(0.9, 0.3, 0.2))];
    let out = picture(&mut renderer, &scene, &Shot { actors: &actors, ..Shot::default() });
    let mut beyond = 0;
    for v in 0..180u32 {
        for u in 0..310u32 {
            let seen = model(lens).unproject([f64::from(u), f64::from(v)]).is_ok();
            let at = (v * 310 + u) as usize;
            assert_eq!(out.depth.at(u, v).is_some(), seen, "({u}, {v})");
            if !seen {
                beyond += 1;
                assert_eq!((&out.frame.data()[3 * at..3 * at + 3], out.mask[at]), (&[0; 3][..], 0));
            }
        }
    }
    assert!(beyond > 100, "{beyond}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever stands wherever, in the camera too: depths are depths, boxes lie in the
    /// picture and shares are shares.
    #[test]
    fn any_shot_is_a_picture(
        places in prop::collection::vec((-3.0..3.0f64, -3.0..3.0f64, -7.0..7.0f64), 0..6),
        own in (-2.0..2.0f64, -2.0..2.0f64, -7.0..7.0f64),
        lean in prop::array::uniform2(-0.6..0.6f64),
        (kind, seed, time_s) in (0..4usize, any::<u64>(), 0.0..1e4f64),
    ) {
        let kind = SceneKind::ALL[kind];
        let scene = Scene::build(&SceneSpec { kind, moving: 2, ..SceneSpec::default() }, seed);
        let intrinsics = Intrinsics { fx: 60.0, fy: 60.0, cx: 40.0, cy: 22.0 };
        let model = CameraModel::new(80, 45, intrinsics, LENSES[1]).unwrap();
        let mut renderer = Renderer::new(SimCamera::new(model));
        let actors: Vec<Actor> = places
            .iter()
            .enumerate()
            .map(|(i, &(x, y, h))| Actor::new(VehicleKind::ALL[i % 4], seed, standing(x, y, h)))
            .collect();
        let own = standing(own.0, own.1, own.2);
        let shot = Shot { time_s, own, lean, actors: &actors, seed };
        let out = picture(&mut renderer, &scene, &shot);
        prop_assert!(out.depth.data().iter().all(|d| d.is_finite() && *d >= 0.0));
        for index in 0..actors.len() {
            let Some(truth) = out.truth(index) else { continue };
            let b = truth.bbox;
            prop_assert!(b.is_proper() && b == b.clipped(80.0, 45.0), "{truth:?}");
            prop_assert!(truth.full_bbox.enclosing(&b) == truth.full_bbox, "{truth:?}");
            for share in [truth.visible_share, truth.inside_share] {
                prop_assert!(share > 0.0 && share <= 1.0, "{truth:?}");
            }
            prop_assert!(truth.depth_min_m > 0.0 && truth.depth_min_m <= truth.depth_median_m);
        }
    }
}

/// Every pixel of a closed room is covered: no gaps between faces.
#[test]
fn rooms_have_no_gaps() {
    for kind in [SceneKind::Room, SceneKind::Hall, SceneKind::Corridor] {
        for seed in 0..4 {
            let spec = SceneSpec { kind, moving: 2, ..SceneSpec::default() };
            let scene = Scene::build(&spec, seed);
            let mut renderer = Renderer::new(camera(LENSES[(seed % 4) as usize]));
            for quarter in 0..4 {
                let own = standing(1.0, 0.0, 1.6 * f64::from(quarter));
                let out = picture(&mut renderer, &scene, &Shot { own, ..Shot::default() });
                let holes = out.depth.data().iter().filter(|d| !DepthMap::is_known(**d)).count();
                assert_eq!(holes, 0, "{kind:?} {seed} {quarter}");
            }
        }
    }
}
