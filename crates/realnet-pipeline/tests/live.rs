//! Frames that come by themselves: networks on threads that are slow, fail or panic.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod pictures;

use pictures::Pictures;
use realnet_core::{BoundingBox, DepthMap, Detection, Frame, Stamp, StopReason, TrackStatus};
use realnet_pipeline::{
    DepthEstimator, Follower, FollowerOptions, Live, NetworkCounts, NetworkError, ObjectDetector,
    Work,
};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, LazyLock};

static PICTURES: LazyLock<Pictures> = LazyLock::new(|| Pictures::new((240, 180), 31));
const RATE_HZ: f64 = 30.0;

fn frame(index: u64) -> Arc<Frame> {
    Arc::new(PICTURES.at(index).0.clone().with_stamp(Stamp::of_frame(index, RATE_HZ)))
}

/// The picture that a frame is.
fn index(frame: &Frame) -> u64 {
    (frame.stamp().secs_f64() * RATE_HZ).round() as u64
}

/// What a network is to do with the frame that it has.
enum Do {
    Answer,
    Fail,
    Panic,
}

/// A network that knows the truth and waits to be told what to do with it.
struct Told(Receiver<Do>);

impl Told {
    fn wait(&self) -> Result<(), NetworkError> {
        match self.0.recv() {
            Ok(Do::Answer) => Ok(()),
            Ok(Do::Fail) => Err("out of memory".into()),
            Ok(Do::Panic) => panic!("as this test wants it"),
            Err(_) => Err("the test is over".into()),
        }
    }
}

impl ObjectDetector for Told {
    fn detect(
        &mut self,
        frame: &Frame,
        _: Option<&BoundingBox>,
    ) -> Result<Vec<Detection>, NetworkError> {
        self.wait().map(|()| PICTURES.detections(index(frame)).to_vec())
    }
}

impl DepthEstimator for Told {
    fn depth(&mut self, frame: &Frame) -> Result<DepthMap, NetworkError> {
        self.wait()?;
        let mut map = PICTURES.at(index(frame)).1.clone();
        map.set_stamp(frame.stamp());
        Ok(map)
    }
}

/// A follower whose networks are told what to do, at frame `next`.
struct Robot {
    live: Live,
    detector: Sender<Do>,
    depth: Sender<Do>,
    next: u64,
}

impl Robot {
    fn new() -> Self {
        let mut options = FollowerOptions::default();
        options.sight.hits = 1;
        options.ranging.ground_range = false;
        let follower = Follower::new(&PICTURES.camera, options).unwrap();
        let ((detector, sees), (depth, ranges)) = (channel(), channel());
        let networks: (Box<dyn ObjectDetector>, Box<dyn DepthEstimator>) =
            (Box::new(Told(sees)), Box::new(Told(ranges)));
        let live = Live::start(follower, networks.0, Some(networks.1), 0.2).unwrap();
        Self { live, detector, depth, next: 0 }
    }

    fn frame(&mut self) -> realnet_pipeline::Step {
        let frame = frame(self.next);
        self.next += 1;
        let now = frame.stamp().seconds_later(0.02);
        self.live.frame(&frame, now, &mut |_| {}).unwrap()
    }

    /// Waits until a network's answer was taken up, between two frames.
    fn hear(&mut self, work: Work) {
        let now = Stamp::of_frame(self.next - 1, RATE_HZ).seconds_later(0.025);
        loop {
            self.live.idle(now);
            if self.live.times().any(|time| time.work == work && time.ms >= 0.0) {
                return;
            }
            std::thread::yield_now();
        }
    }

    /// A frame and its answers.
    fn seen(&mut self) -> realnet_pipeline::Step {
        let depth_before = self.live.counts()[1].taken;
        let step = self.frame();
        self.detector.send(Do::Answer).unwrap();
        self.hear(Work::Detect);
        if self.live.counts()[1].taken > depth_before {
            self.depth.send(Do::Answer).unwrap();
            self.hear(Work::Depth);
        }
        step
    }
}

#[test]
fn frames_do_not_wait_for_networks() {
    let mut robot = Robot::new();
    for _ in 0..9 {
        assert!(robot.frame().report.target.is_none());
    }
    let counts = |taken, skipped| NetworkCounts { taken, skipped, failures: 0 };
    // Nine frames: the first for each, and for depth the seventh and those after it.
    assert_eq!(robot.live.counts(), [counts(1, 8), counts(1, 3)]);
    // The answers about the first frame are good for the present one.
    robot.depth.send(Do::Answer).unwrap();
    robot.detector.send(Do::Answer).unwrap();
    robot.hear(Work::Detect);
    let step = robot.frame();
    let (truth, at) = (PICTURES.at(9).2, step.report.target.unwrap());
    assert!(at.bbox.iou(&truth) > 0.8, "{at:?} {truth:?}");
    assert_eq!(at.detected, Stamp::ZERO);
}

#[test]
fn it_ranges_and_drives() {
    let mut robot = Robot::new();
    for _ in 0..20 {
        robot.seen();
    }
    let step = robot.seen();
    let (_, depth, bbox) = PICTURES.at(20);
    let middle = depth.at(bbox.center().0 as u32, bbox.center().1 as u32).unwrap();
    let (range, std) = step.report.fused_m.unwrap();
    assert!((range - f64::from(middle)).abs() < 0.04, "{range} +-{std}, {middle}");
    assert_eq!((step.report.status, step.command.stop), (TrackStatus::Tracking, None));
    assert_eq!(step.detections.len(), 2);
    // A map that came between two frames belongs to the next one's step, once.
    let maps = (0..6).filter(|_| robot.seen().depth.is_some()).count();
    assert_eq!(maps, 1);
}

/// A network that fails is asked again; one that panicked is not, and the robot stops for
/// the target that nobody confirms.
#[test]
fn what_fails_is_told_and_stops_the_robot() {
    let mut robot = Robot::new();
    for _ in 0..10 {
        robot.seen();
    }
    for (what, said) in [(Do::Fail, "out of memory"), (Do::Panic, "as this test wants it")] {
        robot.frame();
        robot.detector.send(what).unwrap();
        robot.hear(Work::Detect);
        let failures: Vec<_> = robot.live.failures().collect();
        assert_eq!(failures.len(), 1);
        assert_eq!(failures[0].work, Work::Detect);
        assert_eq!(failures[0].stamp, Stamp::of_frame(robot.next - 1, RATE_HZ));
        assert!(failures[0].error.to_string().contains(said), "{}", failures[0].error);
    }
    let taken = robot.live.counts()[0].taken;
    let (mut grey, mut stopped) = (frame(0).as_ref().clone(), None);
    grey.data_mut().fill(90);
    // Nor does flow hold the box any more: a wall of one grey.
    for _ in 0..150 {
        let stamp = Stamp::of_frame(robot.next, RATE_HZ);
        robot.next += 1;
        let dark = Arc::new(grey.clone().with_stamp(stamp));
        let step = robot.live.frame(&dark, stamp, &mut |_| {}).unwrap();
        stopped = step.command.stop.map(|stop| (stop, step.command.speed));
    }
    assert_eq!(robot.live.counts()[0].taken, taken);
    assert_eq!(robot.live.counts()[0].failures, 2);
    let (stop, speed) = stopped.unwrap();
    assert!(matches!(stop, StopReason::TargetLost | StopReason::NoTarget), "{stop}");
    assert_eq!(speed, 0.0);
}

#[test]
fn without_frames_it_stops() {
    let mut robot = Robot::new();
    for _ in 0..20 {
        robot.seen();
    }
    let last = Stamp::of_frame(robot.next - 1, RATE_HZ);
    let commands: Vec<_> =
        (0..40).map(|tick| robot.live.idle(last.seconds_later(0.05 * f64::from(tick)))).collect();
    let end = commands.last().unwrap();
    assert_eq!((end.stop, end.speed), (Some(StopReason::StaleInput), 0.0), "{end:?}");
}
