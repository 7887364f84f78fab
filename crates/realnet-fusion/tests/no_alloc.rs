//! After construction nothing is allocated, however long it runs: the memory is flat.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;
#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;

use common::{Setup, log};
use counting::count;
use realnet_core::Stamp;
use realnet_fusion::{
    CubicTrajectory, RangeSource, Reading, TargetFilter, TargetMeasurement, TargetOptions,
};
use std::hint::black_box;

#[test]
fn the_steady_state_is_free_of_allocation() {
    let setup = Setup { seconds: 60.0, ground: Some((0.05, 0.04)), lost: 0.1, ..Setup::default() };
    let log = log(1, &setup);
    let mut cubic = CubicTrajectory::new(128, 1.0);
    let mut filter = TargetFilter::new(TargetOptions::default()).unwrap();
    let before = count();
    let mut next = log.arriving.iter().peekable();
    let mut points = 0;
    for truth in &log.truth {
        while let Some(arriving) = next.next_if(|a| a.arrival <= truth.stamp) {
            filter.push(arriving.measurement).unwrap();
        }
        let track = filter.track_at(truth.stamp).unwrap();
        black_box((track.seen_from(&truth.camera), track.range_from(&truth.camera)));
        let since = Stamp::from_nanos(truth.stamp.nanos() - 1_000_000_000);
        cubic.refill(filter.trail(since)).unwrap();
        if !cubic.is_empty() {
            black_box(cubic.fit().unwrap());
        }
        points = filter.trail(Stamp::ZERO).count();
        // what is refused costs nothing either
        if let Some(arriving) = log.arriving.first().filter(|_| truth.stamp.secs_f64() > 2.0) {
            assert!(filter.push(arriving.measurement).is_err());
        }
    }
    assert_eq!(count() - before, 0, "allocations");
    // 1.5 s to be replayed and 512 points before
    assert!((512..512 + 50).contains(&points), "{points}");
}

/// 24 hours at 30 Hz, minute after minute of the same drive: the target is somewhere else
/// at the start of each. `cargo test --release -p realnet-fusion --test no_alloc -- --ignored`
#[test]
#[ignore = "half a minute in release"]
fn a_day_allocates_nothing() {
    let setup = Setup { seconds: 60.0, ground: Some((0.05, 0.04)), lost: 0.1, ..Setup::default() };
    let log = log(2, &setup);
    let mut filter = TargetFilter::new(TargetOptions::default()).unwrap();
    let before = count();
    let (mut frames, mut tracked, mut near) = (0, 0, 0);
    for minute in 0..24 * 60_i64 {
        let later = |stamp: Stamp| Stamp::from_nanos(stamp.nanos() + minute * 60_000_000_000);
        let mut next = log.arriving.iter().peekable();
        for truth in &log.truth {
            while let Some(arriving) = next.next_if(|a| a.arrival <= truth.stamp) {
                let measurement = arriving.measurement;
                let moved = later(measurement.stamp);
                let reading = match measurement.reading {
                    Reading::Range { depth_m, relative_std, source } => {
                        let source = match source {
                            RangeSource::Network { map } => {
                                RangeSource::Network { map: later(map) }
                            }
                            other => other,
                        };
                        Reading::Range { depth_m, relative_std, source }
                    }
                    direction => direction,
                };
                filter.push(TargetMeasurement { stamp: moved, reading, ..measurement }).unwrap();
            }
            let track = filter.track_at(later(truth.stamp)).unwrap();
            frames += 1;
            if let Some(range) = track.range_from(&truth.camera) {
                tracked += 1;
                near += usize::from((range.depth_m - truth.seen().0).abs() < 3.0 * range.std_m);
            }
        }
    }
    assert_eq!(count() - before, 0, "allocations");
    assert!(tracked > frames * 95 / 100 && near > frames * 90 / 100, "{tracked} {near} {frames}");
}
