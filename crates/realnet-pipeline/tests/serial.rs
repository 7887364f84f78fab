//! Recorded frames, one after the other: both networks on their frame before its command.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod pictures;

use pictures::Pictures;
use realnet_core::{BoundingBox, DepthMap, Detection, Frame, Stamp, TrackStatus};
use realnet_pipeline::{
    DepthEstimator, Follower, FollowerOptions, NetworkError, ObjectDetector, Serial, Step,
    StepError, Work,
};
use realnet_range::cues::Uncertain;
use std::sync::LazyLock;
use std::sync::{Arc, Mutex};

static PICTURES: LazyLock<Pictures> = LazyLock::new(|| Pictures::new((240, 180), 31));
const RATE_HZ: f64 = 30.0;

/// The picture that a frame is.
fn index(stamp: Stamp) -> u64 {
    (stamp.secs_f64() * RATE_HZ).round() as u64
}

/// The truth as a detector, which fails on one frame.
struct Truth {
    fails_at: Option<u64>,
}

impl ObjectDetector for Truth {
    fn detect(
        &mut self,
        frame: &Frame,
        _: Option<&BoundingBox>,
    ) -> Result<Vec<Detection>, NetworkError> {
        if Some(index(frame.stamp())) == self.fails_at {
            return Err("out of memory".into());
        }
        Ok(PICTURES.detections(index(frame.stamp())).to_vec())
    }
}

/// True depth, and which frames it was asked for.
struct TrueDepth(Arc<Mutex<Vec<u64>>>);

impl DepthEstimator for TrueDepth {
    fn depth(&mut self, frame: &Frame) -> Result<DepthMap, NetworkError> {
        let index = index(frame.stamp());
        self.0.lock().unwrap().push(index);
        let mut map = PICTURES.at(index).1.clone();
        map.set_stamp(frame.stamp());
        Ok(map)
    }
}

fn frame(index: u64) -> Frame {
    PICTURES.at(index).0.clone().with_stamp(Stamp::of_frame(index, RATE_HZ))
}

/// A target is taken up at once; ranges by depth maps alone.
fn options() -> FollowerOptions {
    let mut options = FollowerOptions::default();
    options.sight.hits = 1;
    options.ranging.ground_range = false;
    options
}

fn quiet(serial: &mut Serial, index: u64) -> Result<Step, StepError> {
    serial.step(&frame(index), &mut |_| {})
}

#[test]
fn a_frame_knows_what_was_found_on_it() {
    let asked = Arc::new(Mutex::new(Vec::new()));
    let follower = Follower::new(&PICTURES.camera, options()).unwrap();
    let depth: Box<dyn DepthEstimator> = Box::new(TrueDepth(Arc::clone(&asked)));
    let mut serial = Serial::new(follower, Box::new(Truth { fails_at: None }), Some(depth), 0.2);
    for index in 0..30 {
        let mut marks = Vec::new();
        let step = serial.step(&frame(index), &mut |work| marks.push(work)).unwrap();
        assert_eq!(marks, Work::ALL);
        let (_, truth, bbox) = PICTURES.at(index);
        let middle = truth.at(bbox.center().0 as u32, bbox.center().1 as u32).unwrap();
        // The detection of this very frame, the first one included.
        assert_eq!(step.report.target.unwrap().bbox, *bbox, "{index}");
        assert_eq!(step.report.status, TrackStatus::Tracking, "{index}");
        let (range, std) = step.report.fused_m.unwrap();
        assert!((range - f64::from(middle)).abs() < 0.04, "{index}: {range} +-{std}, {middle}");
        let place = step.report.position_m.unwrap();
        assert!((place[2] - range).abs() < 1e-9 && place[0].abs() < 0.3, "{index}: {place:?}");
        assert_eq!(step.depth.is_some(), index % 6 == 0, "{index}");
        assert_eq!(step.detections.len(), 2);
    }
    assert_eq!(*asked.lock().unwrap(), [0, 6, 12, 18, 24]);
}

#[test]
fn a_known_height_ranges_without_depth() {
    let mut told = options();
    // The square has 0.24 m.
    told.ranging.target_height_m = Some(Uncertain::new(0.24, 0.012));
    let follower = Follower::new(&PICTURES.camera, told).unwrap();
    let mut serial = Serial::new(follower, Box::new(Truth { fails_at: None }), None, 0.2);
    for index in 0..12 {
        let report = quiet(&mut serial, index).unwrap().report;
        let (_, truth, bbox) = PICTURES.at(index);
        let middle = truth.at(bbox.center().0 as u32, bbox.center().1 as u32).unwrap();
        assert_eq!((report.network_m, report.fast_m, report.ground_m), (None, None, None));
        for range in [report.size_m.unwrap(), report.fused_m.unwrap().0] {
            assert!((range / f64::from(middle) - 1.0).abs() < 0.05, "{range} {middle}");
        }
    }
}

#[test]
fn what_fails_costs_its_frame() {
    let follower = Follower::new(&PICTURES.camera, options()).unwrap();
    let mut serial = Serial::new(follower, Box::new(Truth { fails_at: Some(5) }), None, 0.2);
    for index in 0..10 {
        match quiet(&mut serial, index) {
            Ok(step) => assert!(index != 5 && step.report.target.is_some(), "{index}"),
            Err(StepError::Detector(error)) => {
                assert_eq!((index, error.to_string().as_str()), (5, "out of memory"));
            }
            Err(other) => panic!("{index}: {other}"),
        }
    }
    let again = quiet(&mut serial, 9);
    assert!(matches!(again, Err(StepError::Frame(_))), "a stamp that was there already");
}
