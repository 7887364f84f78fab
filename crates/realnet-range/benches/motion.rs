//! Times of the fast path: `cargo bench -p realnet-range --bench motion`.
//!
//! 150 corners of the background and 50 of a target, tracked there and back; the
//! pyramid of the new frame is included.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

#[path = "../tests/scene/mod.rs"]
mod scene;

use divan::Bencher;
use realnet_core::{DepthMap, Frame};
use realnet_range::motion::MotionTracker;
use scene::drive::Drive;

const SIZES: [(u32, u32); 2] = [(640, 360), (1280, 720)];
fn main() {
    divan::main();
}

/// Both motions of a frame in the middle of the way.
#[divan::bench(args = SIZES)]
fn motions(bencher: Bencher<'_, '_>, size: (u32, u32)) {
    let run = Drive::new(size);
    frames(bencher, &run, |tracker, _| {
        assert!(tracker.estimate().background.is_ok());
    });
}

/// Both motions and the whole depth map.
#[divan::bench(args = SIZES)]
fn motions_and_map(bencher: Bencher<'_, '_>, size: (u32, u32)) {
    let run = Drive::new(size);
    frames(bencher, &run, |tracker, out| {
        tracker.estimate();
        tracker.depth_now(out).unwrap();
    });
}

/// Both motions and the target's depth alone.
#[divan::bench(args = SIZES)]
fn motions_and_target(bencher: Bencher<'_, '_>, size: (u32, u32)) {
    let run = Drive::new(size);
    frames(bencher, &run, |tracker, out| {
        tracker.estimate();
        tracker.target_depth_now(out).unwrap();
    });
}

/// The worst frame: nothing is found again, after all ways were tried.
#[divan::bench(args = SIZES)]
fn lost(bencher: Bencher<'_, '_>, size: (u32, u32)) {
    let run = Drive::new(size);
    let mut lap = run.lap();
    lap.push();
    lap.tracker.estimate();
    lap.push();
    lap.tracker.estimate();
    let stamp = run.frames[3].stamp();
    let noise = |i: u32| (i.wrapping_mul(0x9E37_79B9) >> 24) as u8;
    let grey = (0..size.0 * size.1).map(noise).collect();
    lap.tracker.push(&Frame::grey8(stamp, size.0, size.1, grey).unwrap()).unwrap();
    bencher.bench_local(|| assert!(lap.tracker.estimate().background.is_err()));
}

/// The frame of a depth map: corners found and lifted.
#[divan::bench(args = SIZES)]
fn depth_arrives(bencher: Bencher<'_, '_>, size: (u32, u32)) {
    let run = Drive::new(size);
    let mut tracker = run.keyed();
    bencher.bench_local(|| {
        tracker.keep();
        let stamp = tracker.kept().unwrap();
        let depth = run.depth.clone().with_stamp(stamp);
        tracker.set_depth(&depth, Some(&run.gate)).unwrap()
    });
}

/// Times `work` on frame after frame; after the last one the run starts again.
fn frames(bencher: Bencher<'_, '_>, run: &Drive, work: impl Fn(&mut MotionTracker, &mut DepthMap)) {
    let mut out = run.depth.clone();
    let mut lap = run.lap();
    bencher.bench_local(|| {
        lap.push();
        work(&mut lap.tracker, &mut out);
    });
}
