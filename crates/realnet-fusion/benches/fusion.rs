//! Times of the filters: `cargo bench -p realnet-fusion --bench fusion`.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Setup, log};
use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use realnet_core::nalgebra::{SMatrix, SVector};
use realnet_core::{Pose2, Stamp};
use realnet_fusion::{
    CubicTrajectory, Gaussian, RangeSource, Reading, TargetFilter, TargetMeasurement, TargetOptions,
};

fn main() {
    divan::main();
}

/// Direction, fast range and ground range of each frame at 30 Hz, a depth map 3 times a
/// second that is 0.27 s late.
fn setup(seconds: f64) -> Setup {
    Setup { seconds, ground: Some((0.05, 0.04)), ..Setup::default() }
}

/// All of a frame: its measurements, the track at the time of the next command, seen
/// from the robot. Late maps included: the mean over a drive of ten seconds, as items
/// a second.
#[divan::bench]
fn frame_with_late_maps(bencher: Bencher<'_, '_>) {
    let log = log(1, &setup(10.0));
    bencher
        .counter(ItemsCount::new(log.truth.len()))
        .with_inputs(|| TargetFilter::new(TargetOptions::default()).unwrap())
        .bench_local_refs(|filter| {
            let mut next = log.arriving.iter().peekable();
            for truth in &log.truth {
                while let Some(arriving) = next.next_if(|a| a.arrival <= truth.stamp) {
                    let _ = black_box(filter.push(arriving.measurement));
                }
                let effect = Stamp::from_nanos(truth.stamp.nanos() + 100_000_000);
                let track = filter.track_at(effect).unwrap();
                black_box(track.seen_from(&truth.camera));
            }
        });
}

fn filled(until_s: f64) -> TargetFilter {
    let mut filter = TargetFilter::new(TargetOptions::default()).unwrap();
    for arriving in log(1, &setup(until_s)).arriving {
        filter.push(arriving.measurement).unwrap();
    }
    let newest = filter.newest().unwrap();
    filter.track_at(newest).unwrap();
    filter
}

/// One late depth map alone: so many measurements to replay.
#[divan::bench(args = [0.27, 0.5])]
fn late_map(bencher: Bencher<'_, '_>, late_s: f64) {
    bencher.with_inputs(|| filled(5.0)).bench_local_refs(|filter| {
        let newest = filter.newest().unwrap();
        // Beside the stamps of the frames, so that it is no duplicate.
        let stamp = Stamp::from_nanos(newest.nanos() - (late_s * 1e9) as i64 + 1);
        let source = RangeSource::Network { map: stamp };
        let reading = Reading::Range { depth_m: 1.0, relative_std: 0.02, source };
        let fixed_from_camera = Pose2::IDENTITY;
        filter.push(TargetMeasurement { stamp, fixed_from_camera, reading }).unwrap();
        filter.track_at(newest).unwrap()
    });
}

#[divan::bench]
fn scalar_update_of_13(bencher: Bencher<'_, '_>) {
    let start = Gaussian::<13>::standard();
    let row = SVector::from_fn(|i, _| [0.5, -0.2, 0.0, 1.0][i % 4]);
    bencher.with_inputs(|| start).bench_local_refs(|g| g.update(black_box(0.3), &row, 0.1));
}

#[divan::bench]
fn transition_of_6_in_13(bencher: Bencher<'_, '_>) {
    let start = Gaussian::<13>::standard();
    let transition = SMatrix::<f64, 6, 6>::identity() * 1.1;
    let noise = SMatrix::<f64, 6, 6>::identity();
    let variances = SVector::<f64, 6>::from_element(0.01);
    bencher
        .with_inputs(|| start)
        .bench_local_refs(|g| g.transform_first(black_box(&transition), &noise, &variances));
}

#[divan::bench]
fn cubic_of_30_points(bencher: Bencher<'_, '_>) {
    let mut filter = filled(5.0);
    let newest = filter.newest().unwrap();
    let since = Stamp::from_nanos(newest.nanos() - 1_000_000_000);
    let mut cubic = CubicTrajectory::new(64, 1.0);
    bencher.bench_local(|| {
        cubic.refill(filter.trail(since)).unwrap();
        cubic.fit().unwrap().at(newest)
    });
}
