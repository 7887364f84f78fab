//! Answers that come late, cameras that pause, clocks that are set.
#![allow(missing_docs, clippy::unwrap_used)]

mod pictures;

use pictures::Pictures;
use realnet_core::{Stamp, TrackStatus};
use realnet_pipeline::{Follower, FollowerOptions, FrameReport};
use realnet_range::motion::MotionError;
use std::sync::LazyLock;

static PICTURES: LazyLock<Pictures> = LazyLock::new(|| Pictures::new((240, 180), 40));

/// Frames of a follower whose clock can be set; detections come two frames late, depth
/// maps so many.
struct Drive {
    follower: Follower,
    rate_hz: f64,
    map_late: u64,
    /// Where the camera's clock started, seconds.
    from_s: f64,
    index: u64,
}

impl Drive {
    fn new(rate_hz: f64, map_late: u64) -> Self {
        let follower = Follower::new(&PICTURES.camera, FollowerOptions::default()).unwrap();
        Self { follower, rate_hz, map_late, from_s: 10_000.0, index: 0 }
    }

    fn stamp(&self, index: u64) -> Stamp {
        Stamp::of_frame(index, self.rate_hz).seconds_later(self.from_s)
    }

    /// The next frame and all that belongs to it.
    fn frame(&mut self) -> Result<FrameReport, MotionError> {
        self.index += 1;
        let index = self.index;
        let shot = |index: u64| PICTURES.at((index as f64 * 30.0 / self.rate_hz) as u64);
        let frame = shot(index).0.clone().with_stamp(self.stamp(index));
        let report = self.follower.frame(&frame);
        let every = self.map_late + 2;
        if index.is_multiple_of(every) {
            self.follower.keep_for_depth();
        }
        if let Some(of) = index.checked_sub(2) {
            let place = (of as f64 * 30.0 / self.rate_hz) as u64;
            self.follower.detections(self.stamp(of), &PICTURES.detections(place));
        }
        if let Some(of) = index.checked_sub(self.map_late).filter(|of| of.is_multiple_of(every)) {
            // At the start, and after another clock, none was kept.
            let _ = self.follower.depth(&shot(of).1.clone().with_stamp(self.stamp(of)));
        }
        self.follower.command(self.stamp(index).seconds_later(0.02));
        report
    }

    fn frames(&mut self, count: u64) -> FrameReport {
        (0..count).map(|_| self.frame().unwrap()).last().unwrap()
    }
}

#[track_caller]
fn follows(report: &FrameReport) {
    assert_eq!(report.status, TrackStatus::Tracking);
    let range = report.fused_m.map(|(range, _)| range);
    assert!(
        report.target.is_some() && range.is_some_and(|r| (0.9..1.6).contains(&r)),
        "{report:?}"
    );
}

#[test]
fn a_map_that_is_more_than_a_second_late_is_used_at_sixty_frames_a_second() {
    for (rate_hz, map_late) in [(30.0, 39), (60.0, 78)] {
        let mut drive = Drive::new(rate_hz, map_late);
        drive.frames(4 * map_late);
        assert!(drive.follower.network_range().is_some(), "{map_late} frames at {rate_hz}");
        let fast = (0..30).filter(|_| drive.frame().unwrap().fast_m.is_some()).count();
        assert!(fast > 15, "{fast} fast ranges at {rate_hz}");
    }
}

#[test]
fn the_first_measurements_after_a_pause_are_used() {
    let mut drive = Drive::new(30.0, 8);
    follows(&drive.frames(90));
    let limit = drive.follower.fusion().options().max_ahead_s;
    drive.from_s += 2.0 * limit;
    let report = drive.frame().unwrap();
    assert!(report.fast_m.is_some(), "the map's corners are still there: {report:?}");
    assert_eq!(drive.follower.fusion().newest(), Some(drive.stamp(drive.index)));
    follows(&drive.frames(60));
}

#[test]
fn one_wild_stamp_costs_its_frame() {
    for wild_s in [3600.0, 61.0, -1.1, -3600.0, 9e9, -9e9] {
        let mut drive = Drive::new(30.0, 8);
        follows(&drive.frames(90));
        drive.from_s += wild_s;
        assert!(matches!(drive.frame(), Err(MotionError::Order { .. })), "{wild_s}");
        drive.from_s -= wild_s;
        follows(&drive.frames(1));
        // Again, and later once more: they are not two frames of one clock.
        drive.from_s += wild_s;
        assert!(drive.frame().is_err());
        drive.from_s -= wild_s;
        follows(&drive.frames(1));
    }
}

#[test]
fn it_starts_again_when_the_clock_was_set() {
    let mut drive = Drive::new(30.0, 8);
    follows(&drive.frames(90));
    for set_s in [3600.0, -7200.0, -5.0, 61.0] {
        let pitch = drive.follower.pitch();
        drive.from_s += set_s;
        assert!(drive.frame().is_err(), "{set_s}: it may be one wild stamp");
        let report = drive.frames(1);
        assert_eq!((report.target, report.status), (None, TrackStatus::Searching), "{set_s}");
        assert_eq!(drive.follower.pitch(), pitch);
        follows(&drive.frames(90));
    }
}

#[test]
fn a_clock_that_is_set_back_a_little_is_waited_for() {
    let mut drive = Drive::new(30.0, 8);
    follows(&drive.frames(90));
    drive.from_s -= 0.5;
    let refused = (0..30).filter(|_| drive.frame().is_err()).count();
    assert!((14..=16).contains(&refused), "{refused}");
    follows(&drive.frames(60));
}
