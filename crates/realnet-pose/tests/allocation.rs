//! A solver that has seen the largest problem does not allocate.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;
#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;

use common::{Problem, Random};
use counting::count;
use realnet_pose::{PnpSolver, RansacOptions, RefineOptions, dlt};

#[test]
fn nothing_is_allocated() {
    let mut random = Random(3);
    let mut problem = Problem::good(&mut random, 200, 1.0);
    problem.spoil(&mut random, 0.3);
    let mut worse = Problem::good(&mut random, 150, 1.0);
    worse.spoil(&mut random, 0.6);
    let clean = Problem::good(&mut random, 80, 1.0);
    let mut solver = PnpSolver::with_capacity(RansacOptions::default(), 200).unwrap();
    let before = count();
    for seed in 0..20 {
        let all = problem.correspondences().unwrap();
        solver.solve(&all, seed).unwrap();
        solver.solve_near(&all, &problem.truth, seed).unwrap();
        solver.solve(&worse.correspondences().unwrap(), seed).unwrap();
        let clean_all = clean.correspondences().unwrap();
        let start = dlt(&clean_all, 10.0).unwrap();
        solver.refine(&clean_all, &start, &RefineOptions::default()).unwrap();
    }
    assert_eq!(count(), before);
}
