//! Times of the solvers: `cargo bench -p realnet-pose --bench pnp`.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Problem, Random};
use divan::{Bencher, black_box};
use realnet_core::nalgebra::{Unit, Vector3};
use realnet_pose::{PnpSolver, RansacOptions, RefineOptions, dlt, p3p};

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
