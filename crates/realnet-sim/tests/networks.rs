//! Networks that look at what the simulator draws, instead of the truth that plays them.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

use realnet_core::{BoundingBox, DepthMap, Detection, Frame, Stamp};
use realnet_pipeline::{DepthEstimator, NetworkError, ObjectDetector};
use realnet_sim::scenario::{Scenario, Setup};
use realnet_sim::{Perception, RunError, RunLog, follower_options, run_with};
use std::ops::ControlFlow;

/// Says the same of every frame, and notes which ones it saw.
#[derive(Default)]
struct Constant {
    found: Vec<Detection>,
    depth_m: f32,
    fails: bool,
    seen: Vec<Stamp>,
}

impl ObjectDetector for Constant {
    fn detect(
        &mut self,
        frame: &Frame,
        _: Option<&BoundingBox>,
    ) -> Result<Vec<Detection>, NetworkError> {
        self.seen.push(frame.stamp());
        if self.fails { Err("no memory".into()) } else { Ok(self.found.clone()) }
    }
}

impl DepthEstimator for Constant {
    fn depth(&mut self, frame: &Frame) -> Result<DepthMap, NetworkError> {
        self.seen.push(frame.stamp());
        Ok(DepthMap::new(frame.stamp(), 160, 90, vec![self.depth_m; 160 * 90])?)
    }
}

fn setup() -> Setup {
    let mut setup = Scenario::named("steady").unwrap().instantiate(3).unwrap();
    setup.duration_s = 3.0;
    setup
}

fn seen_by(detector: &mut Constant, depth: Option<&mut Constant>) -> Result<RunLog, RunError> {
    let setup = setup();
    let depth = depth.map(|depth| depth as &mut dyn DepthEstimator);
    let perception = Perception::Networks { detector, depth };
    run_with(&setup, follower_options(&setup), perception, |_| ControlFlow::Continue(()))
}

#[test]
fn networks_are_shown_frames_at_the_rates_and_latencies_of_the_setup() {
    let bbox = BoundingBox::new(280.0, 150.0, 360.0, 230.0);
    let found = vec![Detection { class_id: 0, confidence: 0.9, bbox }];
    let mut detector = Constant { found, ..Constant::default() };
    let mut depth = Constant { depth_m: 1.7, ..Constant::default() };
    let log = seen_by(&mut detector, Some(&mut depth)).unwrap();
    assert_eq!((detector.seen.len(), depth.seen.len()), (91, 10));
    for (stamp, logged) in depth.seen.iter().zip(&log.depth_maps) {
        assert!((logged.time_s - stamp.secs_f64()).abs() < 1e-9);
        let late = logged.arrived_s - logged.time_s;
        assert!((0.2..0.35).contains(&late), "{late}");
        // What this network says, not the truth.
        assert!(logged.range_m.is_none_or(|range| (range - 1.7).abs() < 1e-3), "{logged:?}");
    }
    let ranges = log.depth_maps.iter().filter(|map| map.range_m.is_some()).count();
    assert!(ranges >= 5, "{ranges} of {:#?}", log.depth_maps);
    assert!(log.detections.iter().any(|answer| answer.found));
}

#[test]
fn nobody_is_followed_who_is_not_seen() {
    let log = seen_by(&mut Constant::default(), None).unwrap();
    assert!(log.depth_maps.is_empty() && log.detections.iter().all(|answer| !answer.found));
    assert!((85..=91).contains(&log.detections.len()), "{}", log.detections.len());
    assert!(log.frames.iter().all(|frame| frame.speed_command == 0.0));
}

#[test]
fn a_network_that_fails_ends_the_run_with_its_words() {
    let mut broken = Constant { fails: true, ..Constant::default() };
    let error = seen_by(&mut broken, None).unwrap_err();
    let RunError::Network { network, source } = error else { panic!("{error}") };
    assert_eq!((network, source.to_string().as_str()), ("detector", "no memory"));
}
