//! Times of fusion and control together: `cargo bench -p realnet-pipeline --bench drive`.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../tests/drive/mod.rs"]
mod drive;

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use drive::soak::START;
use drive::world::World;
use drive::{Pilot, Tick};
use realnet_control::ControlOptions;
use realnet_core::Stamp;
use realnet_fusion::{RangeSource, Reading};

fn main() {
    divan::main();
}

/// A drive of so many seconds as it reaches fusion and control: at 30 Hz a fast range of the
/// present depth map, a ground range and a direction by flow of every frame, a direction by
/// the detector 50 ms late, every tenth frame a depth map 0.27 s late.
fn recorded(seconds: u64) -> Vec<Tick> {
    let control = ControlOptions::default();
    let mut world = World::new(1, control.vehicle, START, false);
    let mut pilot = Pilot::new(control);
    let ticks = (0..30 * seconds).map(|_| {
        let tick = world.tick().clone();
        let command = pilot.step(&tick);
        world.command(&command);
        tick
    });
    let ticks: Vec<_> = ticks.collect();
    let first = ticks.iter().filter(|tick| tick.measurements.len() >= 4).count();
    assert!(first * 10 > ticks.len() * 9, "the target is in view of the camera");
    ticks
}

fn brings_a_map(tick: &Tick) -> bool {
    tick.measurements.iter().any(|measurement| {
        let own = |map: Stamp| map == measurement.stamp;
        matches!(measurement.reading, Reading::Range { source: RangeSource::Network { map }, .. } if own(map))
    })
}

/// All frames of ten seconds, maps and all; items a second are frames.
#[divan::bench]
fn frames_of_ten_seconds(bencher: Bencher<'_, '_>) {
    let ticks = recorded(10);
    bencher
        .counter(ItemsCount::new(ticks.len()))
        .with_inputs(|| Pilot::new(ControlOptions::default()))
        .bench_local_refs(|pilot| {
            for tick in &ticks {
                black_box(pilot.step(black_box(tick)));
            }
        });
}

/// One frame after eight seconds: with a detection that is late, and with a depth map
/// besides, which is the worst that happens.
#[divan::bench(args = [false, true])]
fn frame(bencher: Bencher<'_, '_>, with_map: bool) {
    let ticks = recorded(10);
    let wanted = |tick: &Tick| brings_a_map(tick) == with_map;
    let index = ticks.iter().skip(240).position(wanted).unwrap() + 240;
    let (before, rest) = ticks.split_at(index);
    let tick = rest.first().unwrap();
    bencher
        .with_inputs(|| {
            let mut pilot = Pilot::new(ControlOptions::default());
            for tick in before {
                pilot.step(tick);
            }
            pilot
        })
        .bench_local_refs(|pilot| black_box(pilot.step(black_box(tick))));
}
