//! Times of the solvers: `cargo bench -p realnet-pose --bench pnp`.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Problem, Random};
use divan::{Bencher, black_box};
use realnet_core::nalgebra::{Unit, Vector3, Vector6};
use realnet_core::{CameraModel, DepthMap, Distortion, Intrinsics, Pose, Stamp};
use realnet_pose::{DepthWarper, PnpSolver, RansacOptions, RefineOptions, WarpRegion, dlt, p3p};

fn main() {
    divan::main();
}

#[divan::bench]
fn p3p_one(bencher: Bencher<'_, '_>) {
    let problem = Problem::good(&mut Random(1), 3, 0.0);
    let points = [problem.points[0], problem.points[1], problem.points[2]];
    let bearing =
        |i: usize| Unit::new_normalize(Vector3::new(problem.rays[i][0], problem.rays[i][1], 1.0));
    let bearings = [bearing(0), bearing(1), bearing(2)];
    bencher.bench_local(|| p3p(black_box(&points), black_box(&bearings)));
}

#[divan::bench(args = [6, 50, 200])]
fn dlt_points(bencher: Bencher<'_, '_>, count: usize) {
    let problem = Problem::good(&mut Random(2), count, 0.1);
    let all = problem.correspondences().unwrap();
    bencher.bench_local(|| dlt(black_box(&all), 1e9));
}

#[divan::bench(args = [50, 200])]
fn refine(bencher: Bencher<'_, '_>, count: usize) {
    let problem = Problem::good(&mut Random(3), count, 1.0);
    let all = problem.correspondences().unwrap();
    let mut solver = PnpSolver::with_capacity(RansacOptions::default(), count).unwrap();
    let options = RefineOptions::default();
    bencher.bench_local(|| solver.refine(black_box(&all), &problem.truth, &options).unwrap());
}

#[divan::bench(args = [0, 30, 60])]
fn ransac_200(bencher: Bencher<'_, '_>, percent: u32) {
    let mut random = Random(4);
    let mut problem = Problem::good(&mut random, 200, 1.0);
    problem.spoil(&mut random, f64::from(percent) / 100.0);
    let all = problem.correspondences().unwrap();
    let mut solver = PnpSolver::with_capacity(RansacOptions::default(), 200).unwrap();
    let mut seed = 0;
    bencher.bench_local(|| {
        seed += 1;
        solver.solve(black_box(&all), seed).unwrap()
    });
}

/// A wall whose depths fill the picture, and a target of a twentieth of it.
#[divan::bench(args = [(640, 360), (1280, 720)])]
fn warp_map(bencher: Bencher<'_, '_>, (width, height): (u32, u32)) {
    let (mut warper, then, mut now, target) = warp_problem(width, height);
    let background = Pose::exp(&Vector6::new(0.02, 0.0, -0.1, 0.005, 0.01, 0.002));
    bencher.bench_local(|| {
        let (background, target) = (Some(&background), Some(&target));
        warper.warp(black_box(&then), Stamp::ZERO, background, target, &mut now)
    });
}

#[divan::bench(args = [(640, 360), (1280, 720)])]
fn warp_target(bencher: Bencher<'_, '_>, (width, height): (u32, u32)) {
    let (mut warper, then, mut now, target) = warp_problem(width, height);
    bencher
        .bench_local(|| warper.warp(black_box(&then), Stamp::ZERO, None, Some(&target), &mut now));
}

fn warp_problem(width: u32, height: u32) -> (DepthWarper, DepthMap, DepthMap, WarpRegion) {
    let focal = f64::from(width) * 0.8;
    let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
    let intrinsics = Intrinsics { fx: focal, fy: focal, cx, cy };
    let camera = CameraModel::new(width, height, intrinsics, Distortion::None).unwrap();
    let wave = |i: u32| 4.0 + ((i % width) as f32 * 0.01).sin() + (i / width) as f32 * 0.002;
    let data = (0..width * height).map(wave).collect();
    let then = DepthMap::new(Stamp::ZERO, width, height, data).unwrap();
    let now = DepthMap::unknown(Stamp::ZERO, width, height).unwrap();
    let target = WarpRegion {
        start: (width * 2 / 5, height * 2 / 5),
        end: (width * 3 / 5, height * 13 / 20),
        depths: (0.0, 100.0),
        motion: Some(Pose::exp(&Vector6::new(0.05, 0.0, -0.1, 0.0, 0.02, 0.0))),
    };
    (DepthWarper::new(&camera), then, now, target)
}
