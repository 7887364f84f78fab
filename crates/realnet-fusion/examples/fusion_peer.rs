//! Simulated logs, and our side of the comparison in bench/peers/fusion.
//!
//! `fusion_peer write FILE SEED SECONDS NETWORK_STD GROUND_STD` writes a log as CSV, with
//! these deviations of the errors common to all maps and to all ground ranges (per metre;
//! 0 for no ground ranges). Without arguments it prints `ready`, then answers each line
//! `FILE NETWORK_STD` with one line of JSON: nanoseconds of all pushes and questions of a
//! run, and the range at each frame with its deviation.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Setup, log};
use realnet_core::{Pose2, Stamp};
use realnet_fusion::{
    DirectionSource, RangeSource, Reading, SharedError, TargetFilter, TargetMeasurement,
    TargetOptions,
};
use std::fmt::Write as _;
use std::hint::black_box;
use std::io::BufRead as _;
use std::time::Instant;

fn write(path: &str, seed: u64, seconds: f64, network_scale_std: f64, ground: f64) {
    let ground = (ground > 0.0).then_some((0.05, ground));
    let setup = Setup { seconds, network_scale_std, ground, ..Setup::default() };
    let log = log(seed, &setup);
    // Frame: stamp, camera pose, position and depth of the target.
    // Others: kind, arrival, stamp, camera pose, value, deviation, stamp of the map.
    let mut out = String::new();
    for truth in &log.truth {
        let (camera, target) = (truth.camera, truth.position);
        let pose = format!("{},{},{}", camera.x, camera.y, camera.heading);
        let stamp = truth.stamp.nanos();
        writeln!(out, "frame,{stamp},{pose},{},{},{}", target.x, target.y, truth.seen().0).unwrap();
    }
    for arriving in &log.arriving {
        let m = &arriving.measurement;
        let camera = m.fixed_from_camera;
        let (kind, value, std, map) = match m.reading {
            Reading::Direction { tangent, std, .. } => ("direction", tangent, std, 0),
            Reading::Range { depth_m, relative_std, source } => match source {
                RangeSource::Network { map } => ("network", depth_m, relative_std, map.nanos()),
                RangeSource::Ground => ("ground", depth_m, relative_std, 0),
                RangeSource::Size => ("size", depth_m, relative_std, 0),
            },
        };
        let (arrival, stamp) = (arriving.arrival.nanos(), m.stamp.nanos());
        let pose = format!("{},{},{}", camera.x, camera.y, camera.heading);
        writeln!(out, "{kind},{arrival},{stamp},{pose},{value},{std},{map}").unwrap();
    }
    std::fs::write(path, out).unwrap();
}

struct Loaded {
    frames: Vec<(Stamp, Pose2)>,
    arriving: Vec<(Stamp, TargetMeasurement)>,
}

fn load(path: &str) -> Loaded {
    let mut loaded = Loaded { frames: Vec::new(), arriving: Vec::new() };
    for line in std::fs::read_to_string(path).unwrap().lines() {
        let (kind, rest) = line.split_once(',').unwrap();
        let fields: Vec<&str> = rest.split(',').collect();
        let nanos = |i: usize| Stamp::from_nanos(fields[i].parse().unwrap());
        let number = |i: usize| -> f64 { fields[i].parse().unwrap() };
        if kind == "frame" {
            loaded.frames.push((nanos(0), Pose2::new(number(1), number(2), number(3))));
            continue;
        }
        let (value, std) = (number(5), number(6));
        let range = |source| Reading::Range { depth_m: value, relative_std: std, source };
        let reading = match kind {
            "direction" => {
                Reading::Direction { tangent: value, std, source: DirectionSource::Detection }
            }
            "network" => range(RangeSource::Network { map: nanos(7) }),
            "ground" => range(RangeSource::Ground),
            "size" => range(RangeSource::Size),
            other => panic!("unknown kind {other}"),
        };
        let fixed_from_camera = Pose2::new(number(2), number(3), number(4));
        let stamp = nanos(1);
        loaded.arriving.push((nanos(0), TargetMeasurement { stamp, fixed_from_camera, reading }));
    }
    loaded
}

fn run(loaded: &Loaded, network_std: f64) -> (u128, Vec<Option<(f64, f64)>>) {
    let mut options = TargetOptions::default();
    options.network_error.std = network_std;
    // As the logs are drawn: 4 % a metre that stay.
    options.ground_error = SharedError { std: 0.04, time_s: 30.0 };
    // Nor is any network or ground beyond that; the others are told so.
    options.disagreement_deviations = f64::INFINITY;
    let mut filter = TargetFilter::new(options).unwrap();
    let mut ranges = Vec::with_capacity(loaded.frames.len());
    let mut next = loaded.arriving.iter().peekable();
    let start = Instant::now();
    for (stamp, camera) in &loaded.frames {
        while let Some((_, measurement)) = next.next_if(|(arrival, _)| arrival <= stamp) {
            filter.push(*measurement).unwrap();
        }
        let range = filter.track_at(*stamp).unwrap().range_from(camera);
        ranges.push(range.map(|range| (range.depth_m, range.std_m)));
    }
    black_box(&ranges);
    (start.elapsed().as_nanos(), ranges)
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [command, path, seed, rest @ ..] = arguments.as_slice() {
        let numbers: Vec<f64> = rest.iter().map(|number| number.parse().unwrap()).collect();
        assert!(command == "write" && numbers.len() == 3, "unknown arguments");
        write(path, seed.parse().unwrap(), numbers[0], numbers[1], numbers[2]);
        return;
    }
    assert!(arguments.is_empty(), "too few arguments");
    println!("ready");
    for line in std::io::stdin().lock().lines() {
        let line = line.unwrap();
        let (path, network_std) = line.trim().rsplit_once(' ').unwrap();
        let (ns, ranges) = run(&load(path), network_std.parse().unwrap());
        let list = |pick: fn(&(f64, f64)) -> f64| {
            let values = ranges.iter().map(|range| match range {
                Some(range) => pick(range).to_string(),
                None => "null".to_owned(),
            });
            values.collect::<Vec<_>>().join(",")
        };
        println!(r#"{{"ns":{ns},"depth":[{}],"std":[{}]}}"#, list(|r| r.0), list(|r| r.1));
    }
}
