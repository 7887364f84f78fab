//! In steady state no frame allocates: not in fusion and control, and not in the whole
//! follower with its pictures.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;
mod drive;
mod pictures;

use counting::count;
use drive::Pilot;
use drive::soak::START;
use drive::world::World;
use pictures::Pictures;
use realnet_control::ControlOptions;
use realnet_core::{Stamp, TrackStatus};
use realnet_pipeline::{Follower, FollowerOptions};

#[test]
fn fusion_and_control_allocate_nothing() {
    let control = ControlOptions::default();
    let mut world = World::new(3, control.vehicle, START, false);
    let mut pilot = Pilot::new(control);
    let (mut allocations, mut moving) = (0, 0);
    for _ in 0..30 * 60 {
        let tick = world.tick();
        let before = count();
        let command = pilot.step(tick);
        allocations += count() - before;
        moving += usize::from(command.speed != 0.0);
        world.command(&command);
    }
    assert_eq!(allocations, 0);
    assert!(moving > 30 * 30, "{moving} frames in motion");
}

/// Frames from exposure to the detector's and to the depth network's answer, and from one
/// frame for the depth network to the next.
const DETECTION_LATE: u64 = 2;
const MAP_LATE: u64 = 8;
const MAP_EVERY: u64 = 10;
/// After so many frames the same pictures come with and without maps again: they repeat
/// after 78, maps after 10.
const ROUND: u64 = 390;

#[test]
fn a_warm_follower_allocates_nothing() {
    let pictures = Pictures::new((240, 180), 40);
    let mut follower = Follower::new(&pictures.camera, FollowerOptions::default()).unwrap();
    let stamp =
        |index: u64| Stamp::from_nanos(START.nanos() + Stamp::of_frame(index, 30.0).nanos());
    // While it warms up it sees what it sees afterwards.
    let (warm, last) = (ROUND + 12, 2 * ROUND);
    let (mut allocations, mut before) = ([0; 5], [0; 5]);
    let (mut tracked, mut ranges, mut maps, mut moving) = (0, 0, 0, 0);
    for index in 0..last {
        let frame = pictures.at(index).0.clone().with_stamp(stamp(index));
        let map = index.checked_sub(MAP_LATE).filter(|kept| kept % MAP_EVERY == 0);
        let map = map.map(|kept| pictures.at(kept).1.clone().with_stamp(stamp(kept)));
        let detected = index.checked_sub(DETECTION_LATE);
        let detected = detected.map(|of| (stamp(of), pictures.detections(of)));
        // For a second the target is behind something, for the detector.
        let hidden = (150..180).contains(&(index % ROUND));
        let mut counts = [count(); 6];
        let report = follower.frame(&frame).unwrap();
        counts[1] = count();
        if index % MAP_EVERY == 0 {
            follower.keep_for_depth();
        }
        counts[2] = count();
        if let Some((stamp, detections)) = detected {
            follower.detections(stamp, if hidden { &[] } else { &detections });
        }
        counts[3] = count();
        if let Some(map) = &map {
            maps += usize::from(follower.depth(map).is_ok());
        }
        counts[4] = count();
        let now = Stamp::from_nanos(stamp(index).nanos() + 20_000_000);
        let command = follower.command(now);
        counts[5] = count();
        let sums = if index < warm { &mut before } else { &mut allocations };
        for (sum, pair) in sums.iter_mut().zip(counts.windows(2)) {
            *sum += pair[1] - pair[0];
        }
        tracked += u64::from(report.status == TrackStatus::Tracking);
        ranges += u64::from(report.fast_m.is_some() && report.ground_m.is_some());
        moving += u64::from(command.speed != 0.0);
    }
    let worked = format!("{tracked} tracked, {ranges} ranges, {maps} maps, {moving} moving");
    assert!(tracked > last / 2 && ranges > last / 2 && maps > 25 && moving > last / 2, "{worked}");
    let of = ["frame", "keep_for_depth", "detections", "depth", "command"];
    assert!(before[0] > 0 && before[3] > 0, "the first ones make room: {before:?} {of:?}");
    assert_eq!(allocations, [0; 5], "{of:?}");
}
