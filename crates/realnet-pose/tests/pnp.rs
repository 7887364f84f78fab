//! Exact recovery, invariance and refusals.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{FOCAL, Problem, Random, apart};
use proptest::prelude::*;
use realnet_core::nalgebra::{Point3, UnitQuaternion, Vector3, Vector6};
use realnet_core::{CameraModel, Distortion, Intrinsics, Pose};
use realnet_pose::{
    Correspondences, Estimate, Origin, PnpError, PnpSolver, RansacOptions, RefineOptions, dlt,
};

fn solver() -> PnpSolver {
    PnpSolver::new(RansacOptions::default()).unwrap()
}

fn solve(problem: &Problem, seed: u64) -> Result<Estimate, PnpError> {
    solver().solve(&problem.correspondences().unwrap(), seed)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 300,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn without_noise_the_pose_is_exact(seed: u64, count in 12_usize..80) {
        let problem = Problem::good(&mut Random(seed), count, 0.0);
        let all = problem.correspondences().unwrap();
        let found = solve(&problem, seed).unwrap();
        let (rotation, translation) = apart(&found.camera_from_world, &problem.truth);
        prop_assert!(rotation < 1e-9 && translation < 1e-8, "RANSAC {rotation:e} {translation:e}");
        prop_assert_eq!(found.inliers, count);
        let direct = dlt(&all, 1e-6).unwrap();
        let (rotation, translation) = apart(&direct, &problem.truth);
        prop_assert!(rotation < 1e-8 && translation < 1e-7, "DLT {rotation:e} {translation:e}");
    }

    #[test]
    fn outliers_are_named(seed: u64, share in 0.0..0.5f64) {
        let mut random = Random(seed);
        let mut problem = Problem::good(&mut random, 100, 0.0);
        problem.spoil(&mut random, share);
        let mut solver = solver();
        let found = solver.solve(&problem.correspondences().unwrap(), seed).unwrap();
        let (rotation, translation) = apart(&found.camera_from_world, &problem.truth);
        // A spoiled ray may hit the threshold by chance; the pose then leaves the
        // truth by a little.
        prop_assert!(rotation < 0.01 && translation < 0.1, "{rotation:e} {translation:e}");
        for ((point, ray), inlier) in
            problem.points.iter().zip(&problem.rays).zip(solver.inliers())
        {
            let seen = found.camera_from_world * *point;
            let du = FOCAL[0] * (seen.x / seen.z - ray[0]);
            let dv = FOCAL[1] * (seen.y / seen.z - ray[1]);
            prop_assert_eq!(*inlier, seen.z > 0.0 && du.hypot(dv) < 4.0);
        }
        prop_assert_eq!(found.inliers, solver.inliers().iter().filter(|&&i| i).count());
    }

    #[test]
    fn order_and_seed_do_not_matter(seed: u64) {
        let mut random = Random(seed);
        let mut problem = Problem::good(&mut random, 60, 0.5);
        problem.spoil(&mut random, 0.2);
        let first = solve(&problem, 1).unwrap();
        problem.points.reverse();
        problem.rays.reverse();
        let second = solve(&problem, 2).unwrap();
        let (rotation, translation) = apart(&first.camera_from_world, &second.camera_from_world);
        // The same minimum but for a point at the very edge of the threshold.
        let distance = first.mahalanobis_squared(&second.camera_from_world);
        prop_assert!(distance < 1.0, "{distance} {rotation:e} {translation:e}");
    }

    #[test]
    fn another_world_frame_changes_nothing(seed: u64) {
        let mut random = Random(seed);
        let mut problem = Problem::good(&mut random, 50, 0.5);
        let first = solve(&problem, 7).unwrap();
        let new_from_world = random.pose();
        for point in &mut problem.points {
            *point = new_from_world * *point;
        }
        let second = solve(&problem, 7).unwrap();
        let back = second.camera_from_world * new_from_world;
        prop_assert!(first.mahalanobis_squared(&back) < 1e-6);
        // A left perturbation in the camera's frame does not know the world.
        let scale = first.covariance.norm();
        prop_assert!((first.covariance - second.covariance).norm() < 1e-4 * scale);
    }

    #[test]
    fn the_gradient_is_zero_at_the_answer(seed: u64) {
        let problem = Problem::good(&mut Random(seed), 40, 0.7);
        let all = problem.correspondences().unwrap();
        let options = RefineOptions { huber_px: 1.0, max_rms_px: 10.0 };
        let found = solver().refine(&all, &problem.truth, &options).unwrap();
        let cost = |pose: &Pose| -> f64 {
            let each = problem.points.iter().zip(&problem.rays).map(|(point, ray)| {
                let seen = *pose * *point;
                let du = FOCAL[0] * (seen.x / seen.z - ray[0]);
                let dv = FOCAL[1] * (seen.y / seen.z - ray[1]);
                let r = du.hypot(dv);
                if r <= 1.0 { r * r } else { 2.0 * r - 1.0 }
            });
            each.sum()
        };
        let here = cost(&found.camera_from_world);
        for axis in 0..6 {
            // A tenth of a standard deviation either way costs more.
            for sign in [-0.1, 0.1] {
                let mut step = Vector6::zeros();
                step[axis] = sign * found.covariance[(axis, axis)].sqrt();
                let there = cost(&(Pose::exp(&step) * found.camera_from_world));
                prop_assert!(there > here, "axis {axis}: {there} {here}");
            }
        }
    }
}

#[test]
fn a_lens_makes_no_difference() {
    let intrinsics = Intrinsics { fx: 500.0, fy: 510.0, cx: 321.0, cy: 236.0 };
    let lens = Distortion::PlumbBob([-0.28, 0.09, 1e-3, -5e-4, 0.0]);
    let camera = CameraModel::new(640, 480, intrinsics, lens).unwrap();
    let mut random = Random(5);
    let truth = random.pose();
    let (mut points, mut pixels) = (Vec::new(), Vec::new());
    for _ in 0..30 {
        let seen = Point3::from(random.in_view(2.0, 8.0) * 0.8);
        points.push(truth.inverse() * seen);
        pixels.push(camera.project(&seen).unwrap());
    }
    let mut solver = solver();
    let found = solver.solve_pixels(&camera, &points, &pixels, 3).unwrap();
    let (rotation, translation) = apart(&found.camera_from_world, &truth);
    assert!(rotation < 1e-9 && translation < 1e-8, "{rotation:e} {translation:e}");
    pixels[4] = [f64::NAN, 0.0];
    let refused = solver.solve_pixels(&camera, &points, &pixels, 3);
    assert!(matches!(refused, Err(PnpError::Camera { index: 4, .. })), "{refused:?}");
}

#[test]
fn a_good_guess_saves_samples() {
    let mut random = Random(11);
    let mut problem = Problem::good(&mut random, 200, 1.0);
    problem.spoil(&mut random, 0.5);
    let all = problem.correspondences().unwrap();
    let mut solver = solver();
    let alone = solver.solve(&all, 1).unwrap();
    let near = solver.solve_near(&all, &problem.truth, 1).unwrap();
    assert_eq!(near.origin, Origin::Guess);
    assert!(matches!(alone.origin, Origin::P3p | Origin::LocalOptimisation));
    assert!(near.mahalanobis_squared(&alone.camera_from_world) < 1e-3);
    let wrong = solver.solve_near(&all, &random.pose(), 1).unwrap();
    assert!(near.mahalanobis_squared(&wrong.camera_from_world) < 1e-3, "a bad guess does no harm");
}

#[test]
fn same_seed_same_bits() {
    let mut random = Random(21);
    let mut problem = Problem::good(&mut random, 150, 1.0);
    problem.spoil(&mut random, 0.4);
    let (a, b) = (solve(&problem, 9).unwrap(), solve(&problem, 9).unwrap());
    assert_eq!(a, b);
    // and a used solver does not remember
    let mut used = solver();
    let other = Problem::good(&mut random, 33, 1.0);
    used.solve(&other.correspondences().unwrap(), 2).unwrap();
    assert_eq!(used.solve(&problem.correspondences().unwrap(), 9).unwrap(), a);
}

#[test]
fn refine_refuses() {
    let mut random = Random(31);
    let problem = Problem::good(&mut random, 20, 0.5);
    let all = problem.correspondences().unwrap();
    let mut solver = solver();
    let options = RefineOptions::default();
    let turn = Pose::from_rotation(UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 3.1));
    let behind = solver.refine(&all, &(turn * problem.truth), &options);
    assert!(matches!(behind, Err(PnpError::Behind { count: 1.., points: 20 })), "{behind:?}");
    let strict = RefineOptions { max_rms_px: 0.1, ..options };
    let large = solver.refine(&all, &problem.truth, &strict);
    assert!(matches!(large, Err(PnpError::ReprojectionTooLarge { .. })), "{large:?}");
    let three = Correspondences::new(&problem.points[..3], &problem.rays[..3], FOCAL).unwrap();
    let few = solver.refine(&three, &problem.truth, &options);
    assert_eq!(few, Err(PnpError::TooFewPoints { found: 3, needed: 4 }));
    let bad = RefineOptions { huber_px: f64::NAN, ..options };
    let option = solver.refine(&all, &problem.truth, &bad);
    assert!(matches!(option, Err(PnpError::Option { name: "huber_px", .. })), "{option:?}");
    let one_step = RansacOptions { max_steps: 1, ..RansacOptions::default() };
    let nudge = Pose::exp(&Vector6::new(0.3, -0.2, 0.4, 0.05, 0.02, 0.1));
    let unfinished = PnpSolver::new(one_step).unwrap().refine(
        &all,
        &(nudge * problem.truth),
        &RefineOptions { max_rms_px: 1e9, ..options },
    );
    assert_eq!(unfinished, Err(PnpError::NotConverged { iterations: 1 }));
}

#[test]
fn solve_refuses() {
    let mut random = Random(41);
    let truth = random.pose();
    let mut line = Problem::new(truth);
    for i in 0..30 {
        let seen = Vector3::new(-1.0 + 0.07 * f64::from(i), 0.3, 4.0 + 0.1 * f64::from(i));
        line.see(&mut random, seen, 0.3);
    }
    let refused = solve(&line, 1);
    assert!(matches!(refused, Err(PnpError::Collinear { .. })), "{refused:?}");

    let mut noise = Problem::good(&mut random, 100, 0.0);
    noise.spoil(&mut random, 1.1);
    let refused = solve(&noise, 1);
    assert!(matches!(refused, Err(PnpError::TooFewInliers { points: 100, .. })), "{refused:?}");

    let mut two = Problem::good(&mut random, 60, 0.5);
    let nudge = Pose::exp(&Vector6::new(0.8, 0.1, 0.2, 0.1, -0.2, 0.1));
    for (point, ray) in two.points.iter().zip(&mut two.rays).skip(32) {
        let seen = nudge * two.truth * *point;
        *ray = [seen.x / seen.z, seen.y / seen.z];
    }
    let refused = solve(&two, 1);
    assert!(matches!(refused, Err(PnpError::Ambiguous { .. })), "{refused:?}");

    // A small plane far away, tilted: two poses by weak perspective.
    let mut plane = Problem::new(truth);
    for _ in 0..40 {
        let (a, b) = (random.between(-0.5, 0.5), random.between(-0.5, 0.5));
        plane.see(&mut random, Vector3::new(a, b, 20.0 + 0.5 * a), 0.7);
    }
    let options = RansacOptions {
        max_rotation_std: 1.0,
        max_translation_share: 1.0,
        ..RansacOptions::default()
    };
    let refused = PnpSolver::new(options).unwrap().solve(&plane.correspondences().unwrap(), 1);
    assert!(matches!(refused, Err(PnpError::Ambiguous { .. })), "{refused:?}");
    // The same plane near the camera is well-posed.
    let mut near = Problem::new(truth);
    for _ in 0..40 {
        let (a, b) = (random.between(-0.5, 0.5), random.between(-0.5, 0.5));
        near.see(&mut random, Vector3::new(a, b, 1.5 + 0.7 * a), 0.7);
    }
    let found = solve(&near, 1).unwrap();
    assert!(found.p_value(&truth) > 1e-4);

    let mut wide = Problem::new(truth);
    let center = Vector3::new(0.1, 0.1, 14.0);
    for _ in 0..30 {
        let seen = center + random.vector(0.4);
        wide.see(&mut random, seen, 1.0);
    }
    let strict = RansacOptions { max_translation_share: 0.005, ..RansacOptions::default() };
    let refused = PnpSolver::new(strict).unwrap().solve(&wide.correspondences().unwrap(), 1);
    assert!(matches!(refused, Err(PnpError::Uncertain { .. })), "{refused:?}");
    assert!(solve(&wide, 1).unwrap().p_value(&truth) > 1e-4);
    let loud = Problem::good(&mut random, 400, 3.0);
    let refused = solve(&loud, 1);
    assert!(matches!(refused, Err(PnpError::ReprojectionTooLarge { .. })), "{refused:?}");
    // Noise well within the threshold, and half of the points a little beside it.
    let mut beside = Problem::good(&mut random, 200, 0.3);
    for ray in beside.rays.iter_mut().step_by(2) {
        let angle = random.between(0.0, std::f64::consts::TAU);
        ray[0] += 5.0 * angle.cos() / FOCAL[0];
        ray[1] += 5.0 * angle.sin() / FOCAL[1];
    }
    let refused = solve(&beside, 1);
    assert!(matches!(refused, Err(PnpError::ThresholdTooSmall { .. })), "{refused:?}");
}

#[test]
fn dlt_refuses() {
    let mut random = Random(51);
    let problem = Problem::good(&mut random, 20, 0.5);
    let part = |count: usize| {
        Correspondences::new(&problem.points[..count], &problem.rays[..count], FOCAL).unwrap()
    };
    assert_eq!(dlt(&part(5), 4.0), Err(PnpError::TooFewPoints { found: 5, needed: 6 }));
    assert!(dlt(&part(20), 4.0).is_ok());
    let large = dlt(&part(20), 0.01);
    assert!(matches!(large, Err(PnpError::ReprojectionTooLarge { .. })), "{large:?}");

    let mut plane = Problem::new(problem.truth);
    let mut line = Problem::new(problem.truth);
    for _ in 0..20 {
        let (a, b) = (random.between(-1.0, 1.0), random.between(-1.0, 1.0));
        plane.see(&mut random, Vector3::new(a, b, 4.0 + 0.5 * a - 0.3 * b), 0.2);
        line.see(&mut random, Vector3::new(a, 0.3 * a, 4.0 + 0.5 * a), 0.2);
    }
    let refused = dlt(&plane.correspondences().unwrap(), 4.0);
    assert!(matches!(refused, Err(PnpError::Planar { .. })), "{refused:?}");
    let refused = dlt(&line.correspondences().unwrap(), 4.0);
    assert!(matches!(refused, Err(PnpError::Collinear { .. })), "{refused:?}");

    // Half of the points on the far side of the camera, seen through it.
    let mut through = Problem::new(problem.truth);
    for i in 0..20 {
        let seen = random.in_view(2.0, 6.0);
        through.see(&mut random, if i % 2 == 0 { seen } else { -seen }, 0.0);
    }
    let refused = dlt(&through.correspondences().unwrap(), 4.0);
    assert!(matches!(refused, Err(PnpError::Behind { .. })), "{refused:?}");
}

#[test]
fn input_is_checked() {
    let points = [Point3::new(0.0, 0.0, 1.0); 2];
    let rays = [[0.0, 0.0]; 2];
    let new = |points: &[Point3<f64>], rays: &[[f64; 2]], focal| {
        Correspondences::new(points, rays, focal).map(|problem| problem.len())
    };
    assert_eq!(new(&points, &rays, FOCAL), Ok(2));
    let mismatch = PnpError::LengthMismatch { points: 2, observations: 1 };
    assert_eq!(new(&points, &rays[..1], FOCAL), Err(mismatch));
    let nan = [[0.0, 0.0], [f64::NAN, 0.0]];
    assert_eq!(new(&points, &nan, FOCAL), Err(PnpError::NotFinite { index: 1 }));
    let far = [Point3::new(0.0, f64::INFINITY, 1.0), points[1]];
    assert_eq!(new(&far, &rays, FOCAL), Err(PnpError::NotFinite { index: 0 }));
    let focal = new(&points, &rays, [500.0, 0.0]);
    assert_eq!(focal, Err(PnpError::FocalLength { axis: 'y', value: 0.0 }));
    for options in [
        RansacOptions { threshold_px: 0.0, ..RansacOptions::default() },
        RansacOptions { confidence: 1.0, ..RansacOptions::default() },
        RansacOptions { min_inliers: 3, ..RansacOptions::default() },
        RansacOptions { max_iterations: 0, ..RansacOptions::default() },
        RansacOptions { huber_sigmas: f64::NAN, ..RansacOptions::default() },
        RansacOptions { rival_share: 1.5, ..RansacOptions::default() },
    ] {
        assert!(matches!(PnpSolver::new(options), Err(PnpError::Option { .. })), "{options:?}");
    }
    let few = solver().solve(&Correspondences::new(&points, &rays, FOCAL).unwrap(), 1);
    assert_eq!(few, Err(PnpError::TooFewPoints { found: 2, needed: 4 }));
}

/// Where half of the points are seen worse than the threshold foresees, the truncated
/// cost has many minima, and three points lead to any of them: without the look at a
/// wider threshold, 6.9 % of these answers are not at the lowest minimum known.
#[test]
fn the_lowest_minimum_is_found_under_long_tails() {
    let options = RansacOptions { threshold_px: 3.0, ..RansacOptions::default() };
    let mut solver = PnpSolver::new(options).unwrap();
    let (mut answers, mut higher) = (0, 0);
    for seed in 0..300 {
        let mut random = Random(seed);
        let mut problem = Problem::new(random.pose());
        for _ in 0..30 {
            let seen = random.in_view(1.0, 5.0);
            let noise = if random.unit() < 0.5 { 1.0 } else { 4.0 };
            problem.see(&mut random, seen, noise);
        }
        let all = problem.correspondences().unwrap();
        let costs: Vec<f64> = (0..8)
            .filter_map(|seed| solver.solve(&all, seed).ok())
            .map(|found| truncated_cost(&problem, &found.camera_from_world, 3.0))
            .collect();
        let lowest = costs.iter().copied().fold(f64::INFINITY, f64::min);
        answers += costs.len();
        higher += costs.iter().filter(|&&cost| cost > lowest + 1.0).count();
    }
    assert!(answers > 600, "most are refused: {answers} of 2400 answers");
    assert!(50 * higher < answers, "{higher} of {answers} are not at the lowest minimum");
}

/// The sum of squared residuals, pixels, each cut at the threshold.
fn truncated_cost(problem: &Problem, camera_from_world: &Pose, threshold_px: f64) -> f64 {
    let residual = |(point, ray): (&Point3<f64>, &[f64; 2])| {
        let seen = *camera_from_world * *point;
        let du = FOCAL[0] * (seen.x / seen.z - ray[0]);
        let dv = FOCAL[1] * (seen.y / seen.z - ray[1]);
        if seen.z > 0.0 { du.hypot(dv).min(threshold_px) } else { threshold_px }
    };
    problem.points.iter().zip(&problem.rays).map(residual).map(|r| r * r).sum()
}
