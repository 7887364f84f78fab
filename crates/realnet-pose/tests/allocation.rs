//! A solver that has seen the largest problem does not allocate.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Problem, Random};
use realnet_pose::{PnpSolver, RansacOptions, RefineOptions, dlt};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: everything is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn nothing_is_allocated() {
    let mut random = Random(3);
    let mut problem = Problem::good(&mut random, 200, 1.0);
    problem.spoil(&mut random, 0.3);
    let mut worse = Problem::good(&mut random, 150, 1.0);
    worse.spoil(&mut random, 0.6);
    let clean = Problem::good(&mut random, 80, 1.0);
    let mut solver = PnpSolver::with_capacity(RansacOptions::default(), 200).unwrap();
    let before = ALLOCATIONS.with(Cell::get);
    for seed in 0..20 {
        let all = problem.correspondences().unwrap();
        solver.solve(&all, seed).unwrap();
        solver.solve_near(&all, &problem.truth, seed).unwrap();
        solver.solve(&worse.correspondences().unwrap(), seed).unwrap();
        let clean_all = clean.correspondences().unwrap();
        let start = dlt(&clean_all, 10.0).unwrap();
        solver.refine(&clean_all, &start, &RefineOptions::default()).unwrap();
    }
    assert_eq!(ALLOCATIONS.with(Cell::get), before);
}
