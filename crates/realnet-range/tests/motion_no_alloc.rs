//! Once it has seen a depth map and a frame, the fast path allocates nothing: found,
//! searched or lost, and when the next depth map comes.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;
mod scene;

use counting::count;
use realnet_core::nalgebra::{Vector3, Vector6};
use realnet_core::{DepthMap, Frame, Pose, Stamp};
use realnet_range::motion::{MotionOptions, MotionTracker};
use scene::{Scene, camera};
use std::cell::Cell;

#[test]
fn the_fast_path_is_free_of_allocation() {
    let scene = Scene::default();
    let camera_from_world = |t: f64| Pose::exp(&(Vector6::new(0.05, 0.0, 0.4, 0.0, 0.1, 0.0) * -t));
    let target = Pose::from_translation(Vector3::new(-0.1, 0.1, 2.0));
    let draw = |index: i64| {
        let t = index as f64 / 30.0;
        let from_world = camera_from_world(t);
        let stamp = Stamp::from_nanos(index * 33_333_333);
        (scene.draw(stamp, &from_world, &(from_world * target)), scene.gate(&(from_world * target)))
    };
    let run: Vec<_> = (0..12).map(draw).collect();
    let dark = Frame::grey8(Stamp::from_secs_f64(0.39), 320, 240, vec![9; 320 * 240]).unwrap();

    let mut tracker = MotionTracker::new(&camera(), MotionOptions::default()).unwrap();
    let mut out = DepthMap::unknown(Stamp::ZERO, 320, 240).unwrap();
    let mut alone = out.clone();
    let mut failed = 0;
    let mut pass = |tracker: &mut MotionTracker, later: i64| {
        let later = |stamp: Stamp| Stamp::from_nanos(stamp.nanos() + later * 1_000_000_000);
        for (index, ((frame, depth), gate)) in run.iter().enumerate() {
            // Stamps are changed in place: frames go on in time from pass to pass.
            let frame = frame.clone().with_stamp(later(frame.stamp()));
            let depth = depth.clone().with_stamp(later(depth.stamp()));
            let before = count();
            tracker.push(&frame).unwrap();
            if index % 5 == 0 {
                tracker.keep();
                tracker.set_depth(&depth, Some(gate)).unwrap();
            }
            assert!(tracker.estimate().background.is_ok());
            tracker.depth_now(&mut out).unwrap();
            tracker.target_depth_now(&mut alone).unwrap();
            COUNTED.with(|counted| counted.set(counted.get() + count() - before));
        }
        let dark = dark.clone().with_stamp(later(dark.stamp()));
        let before = count();
        tracker.push(&dark).unwrap();
        failed += usize::from(tracker.estimate().background.is_err());
        COUNTED.with(|counted| counted.set(counted.get() + count() - before));
    };
    pass(&mut tracker, 0);
    let warm = COUNTED.with(Cell::take);
    assert!(warm > 0, "the first pass makes room");
    pass(&mut tracker, 1);
    assert_eq!(COUNTED.with(Cell::take), 0);
    assert_eq!(failed, 2);
}

thread_local! {
    static COUNTED: Cell<usize> = const { Cell::new(0) };
}
