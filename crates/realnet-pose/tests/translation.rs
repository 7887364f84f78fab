//! The translation where the rotation is known.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Problem, Random};
use realnet_core::Pose;
use realnet_core::nalgebra::{Vector3, Vector6};
use realnet_pose::{Origin, PnpError, PnpSolver, RansacOptions};

/// A small flat target 3 m away, too flat and small for a rotation of its own.
fn target(random: &mut Random, count: usize, noise: f64) -> (Problem, Pose) {
    let truth = Pose::exp(&Vector6::new(0.2, -0.1, 0.3, 0.05, 0.1, -0.02));
    let mut problem = Problem::new(truth);
    for _ in 0..count {
        let (x, y) = (random.between(-0.1, 0.1), random.between(-0.1, 0.1));
        problem.see(random, Vector3::new(x, y, 3.0), noise);
    }
    (problem, truth)
}

fn solver() -> PnpSolver {
    PnpSolver::new(RansacOptions { threshold_px: 3.0, ..RansacOptions::default() }).unwrap()
}

#[test]
fn exact_points_give_the_exact_translation() {
    let (problem, truth) = target(&mut Random(1), 5, 0.0);
    let found =
        solver().solve_translation(&problem.correspondences().unwrap(), &truth.rotation(), 0.0, 1);
    let found = found.unwrap();
    assert_eq!((found.inliers, found.dof, found.origin), (5, 7, Origin::Translation));
    assert!((found.camera_from_world.translation() - truth.translation()).norm() < 1e-9);
    // The middle of the points, 3 m away.
    assert!((found.center.z - 3.0).abs() < 0.05, "{}", found.center);
}

/// The stated deviation is the one that occurs, with outliers and with an error of
/// the rotation.
#[test]
fn the_covariance_holds() {
    let mut random = Random(7);
    let (mut inside, mut wrong, mut sum, mut cases) = (0, 0, 0.0, 0);
    for _ in 0..600 {
        let (mut problem, truth) = target(&mut random, 25, 0.5);
        problem.spoil(&mut random, 0.2);
        let std = 0.01;
        let turn = Vector3::new(random.gauss(), random.gauss(), random.gauss()) * std;
        let guess = Pose::exp(&Vector6::new(0.0, 0.0, 0.0, turn.x, turn.y, turn.z)) * truth;
        let found = solver().solve_translation(
            &problem.correspondences().unwrap(),
            &guess.rotation(),
            std,
            3,
        );
        let Ok(found) = found else { continue };
        cases += 1;
        let squared = found.mahalanobis_squared(&truth);
        sum += squared;
        inside += usize::from(found.p_value(&truth) >= 0.05);
        let middle = truth.inverse() * found.center;
        let miss = (found.camera_from_world * middle - truth * middle).norm();
        wrong += usize::from(miss > 0.15);
    }
    assert!(cases > 550, "{cases}");
    assert_eq!(wrong, 0);
    let (mean, share) = (sum / cases as f64, inside as f64 / cases as f64);
    assert!((4.5..8.0).contains(&mean), "mean squared distance {mean}, 6 expected");
    assert!(share > 0.92, "{share}");
}

#[test]
fn what_does_not_agree_is_refused() {
    let mut random = Random(3);
    let (problem, truth) = target(&mut random, 3, 0.0);
    let rotation = truth.rotation();
    let refused = |problem: &Problem, std: f64| {
        let all = problem.correspondences().unwrap();
        solver().solve_translation(&all, &rotation, std, 1).unwrap_err()
    };
    assert!(matches!(refused(&problem, 0.0), PnpError::TooFewPoints { found: 3, needed: 4 }));
    assert!(matches!(refused(&problem, f64::NAN), PnpError::Option { .. }));
    // Half the points go their own ways.
    let (mut problem, _) = target(&mut random, 12, 0.2);
    problem.spoil(&mut random, 0.6);
    assert!(matches!(refused(&problem, 0.0), PnpError::TooFewInliers { needed: 8, .. }));
    // One point, twelve times: its distance is not fixed.
    let mut problem = Problem::new(truth);
    for _ in 0..12 {
        problem.see(&mut random, Vector3::new(0.0, 0.0, 3.0), 0.1);
    }
    let error = refused(&problem, 0.0);
    assert!(
        matches!(
            error,
            PnpError::Uncertain { .. }
                | PnpError::TooFewInliers { .. }
                | PnpError::NotConverged { .. }
        ),
        "{error}"
    );
    // Random rays are never a target.
    for seed in 0..300 {
        let mut random = Random(1000 + seed);
        let (mut problem, _) = target(&mut random, 10, 0.2);
        problem.spoil(&mut random, 1.0);
        refused(&problem, 0.0);
    }
}
