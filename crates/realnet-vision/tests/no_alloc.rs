//! Once the first frames are seen, corners and flow allocate nothing.
#![allow(missing_docs, clippy::unwrap_used)]

mod common;
#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;

use common::shifted;
use counting::count;
use realnet_core::Frame;
use realnet_vision::{
    Corner, CornerDetector, CornerMask, CornerOptions, FlowOptions, FlowTracker, Region, Track,
};

#[test]
fn the_allocator_counts() {
    let before = count();
    std::hint::black_box(vec![1_u8; 100]);
    assert_eq!(count(), before + 1);
}

#[test]
fn frames_are_free_of_allocation() {
    let grey: Vec<Frame> = (0..4).map(|i| shifted(320, 200, (i * 21, -i * 13))).collect();
    let colour: Vec<Frame> = grey.iter().map(Frame::to_rgb).collect();
    let mut tracker = FlowTracker::new(FlowOptions::default()).unwrap();
    let options = CornerOptions { max_corners: 100, cells: (4, 3), ..Default::default() };
    let mut detector = CornerDetector::new(options).unwrap();
    let mut mask = CornerMask::new(320, 200, true);
    let (mut corners, mut tracks) = (Vec::<Corner>::new(), Vec::<Track>::new());
    let mut points: Vec<[f32; 2]> = Vec::new();
    tracker.push(&grey[0]);
    let mut pass = || {
        let mut found = 0;
        for frame in grey.iter().chain(&colour) {
            tracker.push(frame);
            mask.fill(true);
            mask.set(Region { x: 40, y: 40, width: 30, height: 50 }, false);
            detector.detect(tracker.previous(), Some(&mask), &mut corners).unwrap();
            points.clear();
            points.extend(corners.iter().map(|c| c.point));
            tracker.track(&points, None, &mut tracks).unwrap();
            tracker.track(&points, Some(&points), &mut tracks).unwrap();
            found += tracks.iter().filter(|t| t.is_tracked()).count();
        }
        found
    };
    let first = pass();
    let before = count();
    let second = pass();
    assert_eq!(count(), before);
    // The second pass starts from the last frame of the first.
    assert!(first > 400 && second > 400, "{first}, {second}");
}
