//! The target's box in every frame: late detections, phantoms, other cars, duplicates.
#![allow(missing_docs, clippy::unwrap_used)]

mod pictures;

use pictures::Pictures;
use realnet_core::{BoundingBox, DepthMap, Detection, Frame, Stamp};
use realnet_pipeline::{Sight, SightOptions, TargetBox};
use realnet_range::carry::CarryError;
use realnet_range::motion::{MotionOptions, MotionTracker};
use std::sync::LazyLock;

static PICTURES: LazyLock<Pictures> = LazyLock::new(|| Pictures::new((240, 180), 24));

/// Frames of the world as [`Sight`] gets them.
struct Eye {
    tracker: MotionTracker,
    sight: Sight,
    next: u64,
    rate_hz: f64,
}

impl Eye {
    fn new(options: SightOptions) -> Self {
        let tracker = MotionTracker::new(&PICTURES.camera, MotionOptions::default()).unwrap();
        Self { tracker, sight: Sight::new(options).unwrap(), next: 0, rate_hz: 30.0 }
    }

    fn stamp(&self, index: u64) -> Stamp {
        Stamp::of_frame(index, self.rate_hz)
    }

    /// The world at a frame: it is as fast with other cameras as with one of 30 Hz.
    fn shot(&self, index: u64) -> &(Frame, DepthMap, BoundingBox) {
        PICTURES.at((index as f64 * 30.0 / self.rate_hz) as u64)
    }

    fn frame(&mut self) -> Option<TargetBox> {
        let frame = self.shot(self.next).0.clone().with_stamp(self.stamp(self.next));
        self.next += 1;
        self.tracker.push(&frame).unwrap();
        self.sight.frame(self.tracker.picture())
    }

    /// The same, of a picture of one grey.
    fn dark(&mut self) -> Option<TargetBox> {
        let mut frame = PICTURES.at(0).0.clone().with_stamp(self.stamp(self.next));
        frame.data_mut().fill(0);
        self.next += 1;
        self.tracker.push(&frame).unwrap();
        self.sight.frame(self.tracker.picture())
    }

    fn truth(&self, index: u64) -> BoundingBox {
        self.shot(index).2
    }

    fn tell(&mut self, index: u64, boxes: &[BoundingBox]) -> Option<TargetBox> {
        let of = |bbox: &BoundingBox| Detection { class_id: 0, confidence: 0.8, bbox: *bbox };
        let detections: Vec<_> = boxes.iter().map(of).collect();
        self.sight.detections(
            self.stamp(index),
            &detections,
            |_| true,
            |d| Some(f64::from(d.bbox.area())),
        )
    }

    /// Three frames, each with its detection at once: the target is taken up.
    fn take_up(&mut self) {
        for _ in 0..3 {
            let index = self.next;
            self.frame();
            self.tell(index, &[self.truth(index)]);
        }
        assert!(self.sight.box_at(at(self.next - 1)).is_some());
    }
}

fn at(index: u64) -> Stamp {
    Stamp::of_frame(index, 30.0)
}

fn moved(bbox: BoundingBox, x: f32) -> BoundingBox {
    BoundingBox::new(bbox.x0 + x, bbox.y0, bbox.x1 + x, bbox.y1)
}

#[track_caller]
fn is_at(found: Option<TargetBox>, truth: BoundingBox) {
    let found = found.unwrap().bbox;
    assert!(found.iou(&truth) > 0.8, "{found:?} for {truth:?}");
}

#[test]
fn a_late_detection_is_carried_to_the_present() {
    let mut eye = Eye::new(SightOptions { hits: 1, ..SightOptions::default() });
    for _ in 0..6 {
        assert_eq!(eye.frame(), None);
    }
    // It comes five frames late.
    let found = eye.tell(0, &[eye.truth(0)]).unwrap();
    assert_eq!((found.stamp, found.bbox), (at(0), eye.truth(0)));
    assert_eq!(eye.sight.box_at(at(5)), None, "carried with the next frame");
    // After 0.4 s it goes on from a box that was carried.
    for index in 6..20 {
        let now = eye.frame();
        is_at(now, eye.truth(index));
        let now = now.unwrap();
        assert_eq!((now.stamp, now.detected), (at(index), at(0)));
        assert_eq!(eye.sight.box_at(at(index)), Some(now));
        assert!(now.center_std[0] > found.center_std[0], "less sure than what it is from");
    }
    // A later one corrects the box, an earlier one does not.
    let aside = moved(eye.truth(15), 3.0);
    assert_eq!(eye.tell(15, &[aside]).unwrap().bbox, aside);
    assert_eq!(eye.tell(14, &[eye.truth(14)]), None);
    assert_eq!(eye.frame().unwrap().detected, at(15));
}

#[test]
fn phantoms_and_messages_that_come_twice_are_not_taken_up() {
    let mut eye = Eye::new(SightOptions::default());
    let phantom = |index: u64| {
        let x = 20.0 + 70.0 * (index % 3) as f32;
        BoundingBox::new(x, 40.0, x + 40.0, 70.0)
    };
    for index in 0..8 {
        eye.frame();
        assert_eq!(eye.tell(index, &[phantom(index)]), None, "here and there");
    }
    let still = BoundingBox::new(20.0, 40.0, 60.0, 70.0);
    eye.frame();
    for _ in 0..5 {
        assert_eq!(eye.tell(8, &[still]), None, "one look is one hit, however often it comes");
    }
    eye.frame();
    assert_eq!(eye.tell(9, &[still]), None);
    assert_eq!(eye.tell(7, &[still]), None, "neither does an older one count");
    eye.frame();
    assert!(eye.tell(10, &[still]).is_some(), "three looks");
}

#[test]
fn a_box_that_flow_holds_is_not_swapped_for_another_car() {
    let mut eye = Eye::new(SightOptions::default());
    eye.take_up();
    // A larger one beside it, and none where it is, for less than the time to let go.
    for index in 3..9 {
        is_at(eye.frame(), eye.truth(index));
        let other = BoundingBox::new(2.0, 60.0, 80.0, 130.0);
        assert!(other.area() > eye.truth(index).area());
        assert_eq!(eye.tell(index, &[other]), None);
    }
    is_at(eye.frame(), eye.truth(9));
    // Among several the one that overlaps is the target.
    let among = [BoundingBox::new(2.0, 60.0, 80.0, 130.0), eye.truth(9)];
    assert_eq!(eye.tell(9, &among).unwrap().bbox, eye.truth(9));
}

#[test]
fn a_box_without_support_is_let_go() {
    let options = SightOptions::default();
    let mut eye = Eye::new(options);
    eye.take_up();
    let mut held = 0;
    for index in 3..20 {
        held += u32::from(eye.frame().is_some());
        eye.tell(index, &[]);
    }
    let most = (options.unsupported_for_s * 30.0).ceil() as u32;
    assert!((most - 1..=most + 1).contains(&held), "{held} frames");
    // Without any word it is carried for longer, but not for ever.
    let mut eye = Eye::new(SightOptions { carry_for_s: 0.5, ..options });
    eye.take_up();
    let held = (0..30).filter(|_| eye.frame().is_some()).count();
    assert!((14..=16).contains(&held), "{held} frames");
}

#[test]
fn a_dark_picture_is_passed_over() {
    let mut eye = Eye::new(SightOptions::default());
    eye.take_up();
    assert_eq!(eye.dark(), None);
    is_at(eye.frame(), eye.truth(4));
    eye.sight.restart();
    assert_eq!(eye.frame(), None, "nothing is left to carry");
}

/// A detector that looks so often, and whose answers take so long: after how many looks
/// it has the target, and how many of the last 100 frames had it.
fn of_detector(camera_hz: f64, detector_hz: f64, late_s: f64, chosen: bool) -> (u64, usize) {
    let mut eye = Eye::new(SightOptions::default());
    eye.rate_hz = camera_hz;
    let every = (camera_hz / detector_hz).round() as u64;
    let late = (late_s * camera_hz).round() as u64;
    let (mut looks, mut taken_up, mut held) = (0, None, 0);
    let last = 5 * every + late + 100;
    for index in 0..last {
        let there = eye.frame();
        if chosen && index % every == 0 {
            eye.sight.keep_for_detector();
        }
        held += usize::from(index + 100 >= last && there.is_some());
        if let Some(of) = index.checked_sub(late).filter(|of| of % every == 0) {
            looks += 1;
            let truth = eye.truth(of);
            let found = eye.tell(of, &[truth]);
            if found.is_some() {
                taken_up.get_or_insert(looks);
            }
        }
    }
    (taken_up.unwrap_or(u64::MAX), held)
}

#[test]
fn a_detector_of_any_rate_finds_the_target_and_keeps_it() {
    // A slow one answers when it looks again.
    for (camera_hz, detector_hz, late_s) in [
        (30.0, 30.0, 0.05),
        (60.0, 60.0, 0.05),
        (60.0, 30.0, 0.3),
        (30.0, 10.0, 0.1),
        (30.0, 3.0, 1.0 / 3.0),
        (30.0, 3.0, 1.0),
        (30.0, 1.0, 1.0),
        (60.0, 1.0, 1.4),
        (30.0, 0.5, 1.4),
        (5.0, 0.5, 1.4),
    ] {
        let found = of_detector(camera_hz, detector_hz, late_s, false);
        assert!(found.0 == 3 && found.1 > 95, "{found:?} {camera_hz} {detector_hz} {late_s}");
    }
    // Where it is said which frames it has, it may be later.
    for (detector_hz, late_s) in [(0.5, 2.0), (1.0, 2.0), (10.0, 2.0)] {
        let found = of_detector(30.0, detector_hz, late_s, true);
        assert!(found.0 == 3 && found.1 > 95, "{found:?} {detector_hz} {late_s}");
    }
}

#[test]
fn a_slow_detector_does_not_make_a_target_of_phantoms() {
    let mut eye = Eye::new(SightOptions::default());
    let there = BoundingBox::new(20.0, 40.0, 60.0, 70.0);
    for index in 0..400 {
        eye.frame();
        // Once a second, at two places; then every other time.
        let boxes: &[BoundingBox] = match index {
            0..200 if index % 60 == 0 => &[moved(there, 110.0)],
            0..200 => &[there],
            _ if index % 60 == 0 => &[],
            _ => &[there],
        };
        if index % 30 == 0 {
            assert_eq!(eye.tell(index, boxes), None, "{index}");
        }
    }
}

#[test]
fn options_that_make_no_sense_are_named() {
    let good = SightOptions::default();
    for (bad, name) in [
        (SightOptions { min_iou: f32::NAN, ..good }, "min_iou"),
        (SightOptions { min_confidence: 2.0, ..good }, "min_confidence"),
        (SightOptions { edge_std_px: 0.0, ..good }, "edge_std_px"),
        (SightOptions { carry_for_s: f64::NAN, ..good }, "carry_for_s"),
        (SightOptions { unsupported_for_s: -1.0, ..good }, "unsupported_for_s"),
    ] {
        let error = Sight::new(bad).err();
        assert!(
            matches!(error, Some(CarryError::Option { option, .. }) if option == name),
            "{error:?}"
        );
    }
}
