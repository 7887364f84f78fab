//! Pyramids, corners and flow against stored results of OpenCV, see
//! `bench/peers/flow/golden.py`.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::shifted;
use realnet_vision::{
    Corner, CornerDetector, CornerMask, CornerOptions, FlowOptions, FlowTracker, Region, Track,
    Window,
};
use serde_json::Value;

fn cases() -> Vec<Value> {
    let golden: Value = serde_json::from_str(include_str!("golden/flow.json")).unwrap();
    golden["cases"].as_array().unwrap().clone()
}

fn points(value: &Value) -> Vec<[f32; 2]> {
    serde_json::from_value(value.clone()).unwrap()
}

fn size(case: &Value) -> (u32, u32) {
    serde_json::from_value(case["size"].clone()).unwrap()
}

/// A tracker that has seen both pictures of the case.
fn tracker(case: &Value) -> FlowTracker {
    let (width, height) = size(case);
    let [window_width, window_height]: [u32; 2] =
        serde_json::from_value(case["window"].clone()).unwrap();
    let mut tracker = FlowTracker::new(FlowOptions {
        window: Window::new(window_width, window_height).unwrap(),
        max_level: case["max_level"].as_u64().unwrap() as usize,
        max_round_trip: None,
        ..Default::default()
    })
    .unwrap();
    let shift: (i64, i64) = serde_json::from_value(case["shift_16ths"].clone()).unwrap();
    tracker.push(&shifted(width, height, (0, 0)));
    tracker.push(&shifted(width, height, shift));
    tracker
}

#[test]
fn pyramids_equal_opencv_bit_by_bit() {
    for case in cases() {
        let tracker = tracker(&case);
        let levels = tracker.previous().levels();
        let expected = case["pyramid_fnv1a"].as_array().unwrap();
        assert!(!levels.is_empty() && levels.len() <= expected.len());
        for (level, expected) in levels.iter().zip(expected) {
            let mut hash = 0xcbf2_9ce4_8422_2325_u64;
            for y in 0..level.height() {
                for &byte in level.row(y).unwrap() {
                    hash = (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
                }
            }
            assert_eq!(format!("{hash:016x}"), expected.as_str().unwrap());
        }
    }
}

#[test]
fn corners_equal_opencv() {
    for case in cases() {
        let (width, height) = size(&case);
        let tracker = tracker(&case);
        let find = |max_corners: usize, mask: Option<&CornerMask>| {
            let mut detector = CornerDetector::new(CornerOptions {
                max_corners,
                quality_level: 0.02,
                min_distance: 8.0,
                cells: (1, 1),
            })
            .unwrap();
            let mut corners: Vec<Corner> = Vec::new();
            detector.detect(tracker.previous(), mask, &mut corners).unwrap();
            corners
        };
        let corners = find(60, None);
        let found: Vec<_> = corners.iter().map(|c| c.point).collect();
        assert_eq!(found, points(&case["corners"]));
        let responses: Vec<f32> = serde_json::from_value(case["responses"].clone()).unwrap();
        for (corner, expected) in corners.iter().zip(responses) {
            assert!((corner.response / expected - 1.0).abs() < 1e-4, "{corner:?}, {expected}");
        }
        let mut mask = CornerMask::new(width, height, false);
        mask.set(Region { x: 30, y: 20, width: 80, height: 70 }, true);
        let found: Vec<_> = find(20, Some(&mask)).iter().map(|c| c.point).collect();
        assert_eq!(found, points(&case["masked_corners"]));
    }
}

#[test]
fn tracks_equal_opencv() {
    for case in cases() {
        let mut tracker = tracker(&case);
        let mut tracks: Vec<Track> = Vec::new();
        tracker.track(&points(&case["queries"]), None, &mut tracks).unwrap();
        let status = case["status"].as_array().unwrap();
        let error = case["error"].as_array().unwrap();
        for (i, (track, expected)) in tracks.iter().zip(points(&case["moved"])).enumerate() {
            assert_eq!(track.is_tracked(), status[i] == 1, "{i} of {case}");
            if track.is_tracked() {
                let [dx, dy] = [0, 1].map(|k| track.point[k] - expected[k]);
                assert!(dx.hypot(dy) < 0.01, "{i}: {track:?}, expected {expected:?}");
                let error = error[i].as_f64().unwrap() as f32;
                assert!((track.error - error).abs() < 0.02, "{i}: {track:?}, expected {error}");
            }
        }
    }
}
