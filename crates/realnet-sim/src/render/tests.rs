//! What only the inside shows.

use super::texture::{Atlas, LEVEL_START, LEVELS, SIDE, Texture};
use super::{Actor, Rendered, Renderer, Sensor, Shot, SimCamera};
use crate::scene::{Scene, SceneKind, SceneSpec};
use crate::{VehicleKind, VehicleState};
use realnet_core::{CameraModel, Distortion, Intrinsics, Pose2};
use realnet_vision::simd::Simd;

fn renderer(sensor: Sensor) -> Renderer {
    let intrinsics = Intrinsics { fx: 260.0, fy: 260.0, cx: 150.0, cy: 80.0 };
    let lens = Distortion::PlumbBob([-0.2, 0.03, 0.001, 0.0, 0.0]);
    let model = CameraModel::new(300, 164, intrinsics, lens).unwrap();
    Renderer::new(SimCamera { sensor, ..SimCamera::new(model) })
}

fn truck(state: VehicleState) -> Actor {
    let world_from_base = Pose2::new(1.0, 0.0, 0.9);
    Actor::new(VehicleKind::Truck, 4, VehicleState { world_from_base, ..state })
}

fn picture(renderer: &mut Renderer, scene: &Scene, actors: &[Actor]) -> Rendered {
    let mut out = renderer.blank();
    renderer.render(scene, &Shot { actors, ..Shot::default() }, &mut out);
    out
}

#[test]
fn every_instruction_set_gives_the_same_bytes() {
    for kind in SceneKind::ALL {
        let scene = Scene::build(&SceneSpec { kind, moving: 2, ..SceneSpec::default() }, 7);
        let mut pictures = Vec::new();
        for &simd in Simd::found() {
            let mut renderer = renderer(Sensor::default());
            renderer.simd = simd;
            pictures.push(picture(&mut renderer, &scene, &[truck(VehicleState::default())]));
        }
        let portable = &pictures[0];
        assert!(pictures.iter().all(|other| other == portable), "{kind:?}");
    }
}

#[test]
fn wheels_roll_and_steer_and_lights_brake() {
    let scene = Scene::build(&SceneSpec::default(), 1);
    let mut renderer = renderer(Sensor::ideal());
    let still = VehicleState::default();
    let base = picture(&mut renderer, &scene, &[truck(still)]);
    let changed = |state: VehicleState, renderer: &mut Renderer| {
        let other = picture(renderer, &scene, &[truck(state)]);
        let pairs = base.frame.data().iter().zip(other.frame.data());
        let steps: Vec<i32> = pairs.map(|(a, b)| i32::from(*b) - i32::from(*a)).collect();
        (steps.iter().filter(|step| step.abs() > 20).count(), steps.iter().max().copied())
    };
    let (rolled, _) = changed(VehicleState { wheel_angle: 0.6, ..still }, &mut renderer);
    let (steered, _) = changed(VehicleState { steering_angle: 0.4, ..still }, &mut renderer);
    let (braked, brighter) = changed(VehicleState { braking: true, ..still }, &mut renderer);
    for count in [rolled, steered, braked] {
        assert!((20..4000).contains(&count), "{rolled} {steered} {braked}");
    }
    assert!(brighter > Some(60), "{brighter:?}");
    // A turn of 2 pi is none; the truck's driven wheels set the angle.
    let turn = VehicleState { wheel_angle: std::f64::consts::TAU, ..still };
    assert!(changed(turn, &mut renderer).0 < 5);
}

#[test]
fn shadows_darken_the_ground_beside_a_vehicle() {
    let scene = Scene::build(&SceneSpec { clutter: 0, ..SceneSpec::default() }, 1);
    let mut renderer = renderer(Sensor::ideal());
    let without = picture(&mut renderer, &scene, &[]);
    let with = picture(&mut renderer, &scene, &[truck(VehicleState::default())]);
    let pixels = without.frame.data().chunks_exact(3).zip(with.frame.data().chunks_exact(3));
    let ground = pixels.zip(&with.mask).filter(|(_, id)| **id == 0).map(|(pair, _)| pair);
    let (mut darker, mut brighter) = (0, 0);
    for (before, after) in ground {
        let step = i32::from(after[1]) - i32::from(before[1]);
        darker += usize::from(step < -15);
        // Edges blend with the vehicle's colour.
        brighter += usize::from(step > 15);
    }
    assert!(darker > 150 && brighter < darker / 3, "{darker} {brighter}");
}

#[test]
fn texture_levels_have_the_same_mean() {
    for texture in [Texture::Carpet, Texture::Brick, Texture::Paint, Texture::Plate] {
        let words = Atlas::shared().words(texture).unwrap();
        let mean = |level: usize| {
            let side = SIDE >> level;
            let start = LEVEL_START[level] as usize;
            let texels = &words[start..start + side * side];
            let sum: f64 = texels.iter().map(|word| f64::from(word & 255)).sum();
            sum / (side * side) as f64
        };
        for level in 1..LEVELS {
            assert!((mean(level) - mean(0)).abs() < 1.5, "{texture:?} {level}");
        }
        // The neighbours in a word are those of the next words, around the edge too.
        let at = |x: usize, y: usize| words[(y % SIDE) * SIDE + x % SIDE];
        for (x, y) in [(0, 0), (511, 0), (17, 511), (511, 511)] {
            let word = at(x, y);
            assert_eq!(word >> 8 & 255, at(x + 1, y) & 255);
            assert_eq!(word >> 16 & 255, at(x, y + 1) & 255);
            assert_eq!(word >> 24, at(x + 1, y + 1) & 255);
        }
    }
}

/// An edge that moves by a part of a pixel changes the picture by that part.
#[test]
fn edges_move_by_parts_of_a_pixel() {
    let scene = Scene::build(&SceneSpec { clutter: 0, ..SceneSpec::default() }, 1);
    let mut renderer = renderer(Sensor::ideal());
    let (mut window, mut sums) = (None, Vec::new());
    for step in 0..20 {
        // To the left in steps of 0.4 mm at 1.1 m: 0.094 pixels.
        let pose = Pose2::new(1.5, 0.0004 * f64::from(step), 0.0);
        let state = VehicleState { world_from_base: pose, ..VehicleState::default() };
        let out = picture(&mut renderer, &scene, &[Actor::new(VehicleKind::Truck, 5, state)]);
        let truth = out.truth(0).unwrap();
        let &mut (start, row) = window.get_or_insert_with(|| {
            // The dark stripe before the bright wall.
            let down = truth.bbox.y0 + 0.39 * truth.bbox.height();
            (truth.bbox.x0 as usize - 6, down as usize)
        });
        let light = |x: usize| (f64::from(out.frame.data()[3 * (300 * row + x)]) / 255.0).powi(2);
        // In units of the step from the wall to the cargo box.
        let (wall, cargo) = (light(start), light(start + 12));
        let sum: f64 = (start..start + 12).map(|x| (light(x) - wall) / (cargo - wall)).sum();
        sums.push(sum);
    }
    let steps: Vec<f64> = sums.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(steps.iter().all(|step| (0.02..0.25).contains(step)), "{steps:?} {sums:?}");
    let whole = sums[19] - sums[0];
    assert!((whole - 19.0 * 0.094).abs() < 0.5, "{whole}");
}
