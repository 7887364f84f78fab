use super::build::distance_to_way;
use super::{Scene, SceneKind, SceneSpec};
use proptest::prelude::*;
use realnet_core::nalgebra::Vector2;

fn any_spec() -> impl Strategy<Value = SceneSpec> {
    let way = prop::collection::vec(prop::array::uniform2(-4.0..4.0f64), 1..6);
    (0..4usize, way, 0.3..1.2f64, 0..25usize, 0..6usize).prop_map(
        |(kind, keep_free, clearance_m, clutter, moving)| SceneSpec {
            kind: SceneKind::ALL[kind],
            clutter,
            moving,
            keep_free,
            clearance_m,
            ..SceneSpec::default()
        },
    )
}

proptest! {
    /// Nothing stands or comes nearer to the way than was asked, and walls are around it.
    #[test]
    fn the_way_is_free(spec in any_spec(), seed: u64, time in 0.0..100.0f64) {
        let scene = Scene::build(&spec, seed);
        for obstacle in scene.obstacles() {
            let corners: Vec<Vector2<f64>> = obstacle.footprint(time).collect();
            prop_assert!(obstacle.height() > 0.0);
            for (i, a) in corners.iter().enumerate() {
                let b = corners[(i + 1) % corners.len()];
                for step in 0..=8 {
                    let point = a.lerp(&b, f64::from(step) / 8.0);
                    // The octagon around a disc reaches a little further.
                    let distance = distance_to_way(&spec.keep_free, &point);
                    prop_assert!(distance > spec.clearance_m - 0.03, "{distance}");
                }
            }
        }
        if let Some(bounds) = scene.bounds() {
            for point in &spec.keep_free {
                prop_assert!(bounds.depth_of(&Vector2::from(*point)) >= spec.clearance_m);
            }
        }
    }

    /// Footprints are convex and counter-clockwise.
    #[test]
    fn footprints_are_convex(spec in any_spec(), seed: u64) {
        let scene = Scene::build(&spec, seed);
        for obstacle in scene.obstacles() {
            let c: Vec<Vector2<f64>> = obstacle.footprint(0.0).collect();
            for i in 0..c.len() {
                let (a, b, d) = (c[i], c[(i + 1) % c.len()], c[(i + 2) % c.len()]);
                prop_assert!((b - a).perp(&(d - b)) > 0.0);
            }
        }
    }

    /// All corners of a face lie in its plane, on the inner side of none of its edges.
    #[test]
    fn faces_are_flat_and_convex(spec in any_spec(), seed: u64) {
        let scene = Scene::build(&spec, seed);
        let parts = scene.movers.iter().flat_map(|mover| &mover.parts);
        for mesh in parts.chain([&scene.solid]) {
            for face in &mesh.faces {
                let corners = &mesh.points[face.first..face.first + face.count];
                prop_assert!((face.normal.norm() - 1.0).abs() < 1e-9);
                for (i, a) in corners.iter().enumerate() {
                    prop_assert!(face.normal.dot(&(a - corners[0])).abs() < 1e-6);
                    let b = corners[(i + 1) % corners.len()];
                    let next = corners[(i + 2) % corners.len()];
                    let turn = (b - a).cross(&(next - b)).dot(&face.normal);
                    prop_assert!(turn > -1e-9, "{corners:?}");
                }
            }
        }
    }
}

#[test]
fn a_scene_is_made_again_by_its_seed() {
    let spec = SceneSpec { moving: 4, ..SceneSpec::default() };
    let text = |seed: u64| format!("{:?}", Scene::build(&spec, seed));
    assert_eq!(text(5), text(5));
    assert_ne!(text(5), text(6));
}

#[test]
fn what_moves_goes_to_and_fro() {
    let spec = SceneSpec { kind: SceneKind::Hall, moving: 3, ..SceneSpec::default() };
    let scene = Scene::build(&spec, 3);
    let movers: Vec<_> = scene.obstacles().iter().filter(|o| o.moves()).collect();
    assert_eq!(movers.len(), 3);
    for (obstacle, mover) in movers.iter().zip(&scene.movers) {
        let at = |time: f64| obstacle.footprint(time).next().unwrap();
        let period = mover.path.period;
        assert!((at(0.0) - at(period)).norm() < 1e-9);
        assert!((at(0.0) - at(0.4 * period)).norm() > 0.05);
    }
}
