//! Time of the pixel kernels, one thread.
#![allow(missing_docs, clippy::unwrap_used)]

use divan::{Bencher, black_box};
use realnet_core::{Frame, Stamp};
use realnet_vision::{
    Corner, CornerDetector, CornerOptions, Filter, FlowOptions, FlowTracker, Letterboxer,
    PatchSearch, Track,
};

fn main() {
    divan::main();
}

const SIZES: [(u32, u32); 2] = [(640, 360), (1280, 720)];

/// Smooth texture of many sizes, moved by (dx, dy).
fn picture((width, height): (u32, u32), (dx, dy): (f32, f32), channels: usize) -> Frame {
    let mut data = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let (x, y) = (x as f32 - dx, y as f32 - dy);
            let waves = (x * 0.31 + y * 0.17).sin() * (y * 0.23 - x * 0.11).cos()
                + (x * 0.071).sin() * (y * 0.053).sin()
                + ((x * 0.013).sin() * 9.0 + (y * 0.017).cos() * 7.0).sin();
            data.extend(std::iter::repeat_n((127.0 + 40.0 * waves) as u8, channels));
        }
    }
    match channels {
        1 => Frame::grey8(Stamp::ZERO, width, height, data).unwrap(),
        _ => Frame::rgb8(Stamp::ZERO, width, height, data).unwrap(),
    }
}

/// A tracker that has seen two frames, and the corners of the first.
fn tracker(size: (u32, u32), round_trip: bool) -> (FlowTracker, Vec<[f32; 2]>) {
    let max_round_trip = round_trip.then_some(0.5);
    let mut tracker =
        FlowTracker::new(FlowOptions { max_round_trip, ..Default::default() }).unwrap();
    tracker.push(&picture(size, (0.0, 0.0), 1));
    let mut corners: Vec<Corner> = Vec::new();
    let mut detector = CornerDetector::new(CornerOptions::default()).unwrap();
    detector.detect(tracker.present(), None, &mut corners).unwrap();
    tracker.push(&picture(size, (2.3, -1.6), 1));
    (tracker, corners.iter().map(|c| c.point).collect())
}

#[divan::bench(args = SIZES, consts = [1, 3])]
fn pyramid<const CHANNELS: usize>(bencher: Bencher, size: (u32, u32)) {
    let frame = picture(size, (0.0, 0.0), CHANNELS);
    let (mut tracker, _) = tracker(size, false);
    bencher.bench_local(|| tracker.push(black_box(&frame)));
}

#[divan::bench(args = SIZES)]
fn corners_200(bencher: Bencher, size: (u32, u32)) {
    let (tracker, _) = tracker(size, false);
    let mut detector = CornerDetector::new(CornerOptions::default()).unwrap();
    let mut corners: Vec<Corner> = Vec::new();
    bencher.bench_local(|| detector.detect(black_box(tracker.present()), None, &mut corners));
}

#[divan::bench(args = SIZES, consts = [false, true])]
fn flow_200<const ROUND_TRIP: bool>(bencher: Bencher, size: (u32, u32)) {
    let (mut tracker, points) = tracker(size, ROUND_TRIP);
    let mut tracks: Vec<Track> = Vec::new();
    bencher.bench_local(|| tracker.track(black_box(&points), None, &mut tracks));
}

/// All of it: pyramid, corners and flow with the way back.
#[divan::bench(args = SIZES)]
fn frame_200(bencher: Bencher, size: (u32, u32)) {
    let frames = [(0.0, 0.0), (2.3, -1.6)].map(|shift| picture(size, shift, 1));
    let (mut tracker, _) = tracker(size, true);
    let mut detector = CornerDetector::new(CornerOptions::default()).unwrap();
    let (mut corners, mut points) = (Vec::<Corner>::new(), Vec::<[f32; 2]>::new());
    let (mut tracks, mut count) = (Vec::<Track>::new(), 0);
    bencher.bench_local(|| {
        tracker.push(&frames[count % 2]);
        count += 1;
        detector.detect(tracker.previous(), None, &mut corners).unwrap();
        points.clear();
        points.extend(corners.iter().map(|c| c.point));
        tracker.track(&points, None, &mut tracks).unwrap();
    });
}

/// A patch of 24x24 pixels at 73x73 positions.
#[divan::bench]
fn patch_search(bencher: Bencher) {
    let (tracker, _) = tracker((160, 120), false);
    let level = tracker.present().full().unwrap();
    let rows = (40..64).flat_map(|y| &level.row(y).unwrap()[60..84]);
    let patch: Vec<u8> = rows.copied().collect();
    let mut search = PatchSearch::new();
    bencher.bench_local(|| {
        search.run(black_box(&patch), (24, 24), level, (24, 4), (73, 73)).map(|s| s.best())
    });
}

#[divan::bench(args = [320, 640])]
fn letterbox_1280x720(bencher: Bencher, side: u32) {
    let frame = picture((1280, 720), (0.0, 0.0), 3);
    let mut letterboxer = Letterboxer::new(side, side, Filter::default()).unwrap();
    let mut input = vec![0.0; 3 * side as usize * side as usize];
    bencher.bench_local(|| letterboxer.run(black_box(&frame), None, &mut input).map(|_| ()));
}
