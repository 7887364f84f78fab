//! Times of the fast path: `cargo bench -p realnet-range --bench motion`.
//!
//! 150 corners of the background and 50 of a target, tracked there and back; the
//! pyramid of the new frame is included.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

#[path = "../tests/scene/mod.rs"]
mod scene;

use divan::Bencher;
use realnet_core::nalgebra::{Vector3, Vector6};
use realnet_core::{CameraModel, DepthMap, Frame, Pose, Stamp};
use realnet_range::cues::ForegroundGate;
use realnet_range::motion::{MotionOptions, MotionTracker};
use scene::Scene;

const SIZES: [(u32, u32); 2] = [(640, 360), (1280, 720)];
/// Frames between two depth maps.
const FRAMES: i64 = 9;

fn main() {
    divan::main();
}

struct Run {
    camera: CameraModel,
    frames: Vec<Frame>,
    depth: DepthMap,
    gate: ForegroundGate,
}

impl Run {
    /// A camera at half a metre a second behind a target that drives away.
    fn new((width, height): (u32, u32)) -> Self {
        let camera = scene::sized(width, height);
        let scene = Scene::new(camera);
        let camera_from_world =
            |t: f64| Pose::exp(&(Vector6::new(0.05, 0.0, 0.5, 0.01, 0.1, 0.0) * t)).inverse();
        let camera_from_target = |t: f64| {
            camera_from_world(t) * Pose::from_translation(Vector3::new(-0.1, 0.1, 2.0 + 0.6 * t))
        };
        let draw = |index: i64| {
            let t = index as f64 / 30.0;
            let stamp = Stamp::from_nanos(index * 33_333_333);
            scene.draw(stamp, &camera_from_world(t), &camera_from_target(t))
        };
        let depth = draw(0).1;
        let frames = (0..=FRAMES).map(|index| draw(index).0.to_rgb()).collect();
        Self { camera, frames, depth, gate: scene.gate(&camera_from_target(0.0)) }
    }

    /// A tracker that was given the depth of the first frame.
    fn keyed(&self) -> MotionTracker {
        let mut tracker = MotionTracker::new(&self.camera, MotionOptions::default()).unwrap();
        tracker.push(&self.frames[0]).unwrap();
        tracker.keep();
        let summary = tracker.set_depth(&self.depth, Some(&self.gate)).unwrap();
        assert!(summary.background + summary.target >= 180, "{summary:?}");
        tracker
    }
}

/// Both motions of a frame in the middle of the way.
#[divan::bench(args = SIZES)]
fn motions(bencher: Bencher<'_, '_>, size: (u32, u32)) {
    let run = Run::new(size);
    frames(bencher, &run, |tracker, _| {
        assert!(tracker.estimate().background.is_ok());
    });
}

/// Both motions and the whole depth map.
#[divan::bench(args = SIZES)]
fn motions_and_map(bencher: Bencher<'_, '_>, size: (u32, u32)) {
    let run = Run::new(size);
    frames(bencher, &run, |tracker, out| {
        tracker.estimate();
        tracker.depth_now(out).unwrap();
    });
}

/// Both motions and the target's depth alone.
#[divan::bench(args = SIZES)]
fn motions_and_target(bencher: Bencher<'_, '_>, size: (u32, u32)) {
    let run = Run::new(size);
    frames(bencher, &run, |tracker, out| {
        tracker.estimate();
        tracker.target_depth_now(out).unwrap();
    });
}

/// The frame of a depth map: corners found and lifted.
#[divan::bench(args = SIZES)]
fn depth_arrives(bencher: Bencher<'_, '_>, size: (u32, u32)) {
    let run = Run::new(size);
    let mut tracker = run.keyed();
    bencher.bench_local(|| {
        tracker.keep();
        let stamp = tracker.kept().unwrap();
        let depth = run.depth.clone().with_stamp(stamp);
        tracker.set_depth(&depth, Some(&run.gate)).unwrap()
    });
}

/// Times `work` on frame after frame; after the last one the run starts again.
fn frames(bencher: Bencher<'_, '_>, run: &Run, work: impl Fn(&mut MotionTracker, &mut DepthMap)) {
    let mut out = run.depth.clone();
    let start = run.keyed();
    let mut tracker = start.clone();
    let mut next = 1;
    bencher.bench_local(|| {
        // One iteration is one frame; going back to the first costs no flow.
        if next > FRAMES as usize {
            tracker.clone_from(&start);
            next = 1;
        }
        tracker.push(&run.frames[next]).unwrap();
        work(&mut tracker, &mut out);
        next += 1;
    });
}
