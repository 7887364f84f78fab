//! A follower that is told things in any order, with any stamps and any numbers, does not
//! panic, does not command outside of the limits, and follows again when sense returns.
#![allow(missing_docs, clippy::unwrap_used)]

mod drive;
mod pictures;

use drive::limits::Limits;
use drive::soak::START;
use pictures::Pictures;
use proptest::prelude::*;
use proptest::sample::select;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};
use realnet_control::{ControlOptions, VehicleOptions};
use realnet_core::{BoundingBox, DepthMap, Detection, Frame, Stamp, TrackStatus};
use realnet_pipeline::{Follower, FollowerOptions, FrameReport};
use std::cell::Cell;
use std::sync::LazyLock;

const SIZE: (u32, u32) = (120, 90);

static PICTURES: LazyLock<Pictures> = LazyLock::new(|| Pictures::new(SIZE, 20));

/// When something was, or is.
#[derive(Clone, Copy, Debug)]
enum When {
    /// So many frames before the present one.
    Ago(u64),
    /// Beside a frame, nanoseconds.
    Beside(i64),
    /// Nanoseconds since the epoch.
    At(i64),
}

#[derive(Clone, Debug)]
enum Event {
    /// The next frames as they should be, with detections, maps and commands.
    Regular(u32),
    /// A frame at another time, or of another size.
    Frame {
        when: When,
        fits: bool,
    },
    Keep,
    Detections(When, Vec<Detection>),
    Depth {
        when: When,
        size: (u32, u32),
        values: Vec<f32>,
    },
    Command(When),
    Idle(When),
    Stop,
    Release,
}

fn when(far: bool) -> impl Strategy<Value = When> {
    let future = if far { 1 } else { 0 };
    let hour = 3_600_000_000_000_i64;
    prop_oneof![
        8 => (0..20_u64).prop_map(When::Ago),
        2 => (-2_000_000_000..0_i64).prop_map(When::Beside),
        2 => (0..2 * future + 1).prop_map(|ns| When::Beside(10_000_000 * i64::from(ns))),
        1 => select(vec![i64::MIN, i64::MIN + 1, -1, 0, 1, START.nanos() - 1]).prop_map(When::At),
        future => select(vec![i64::MAX, i64::MAX - 1, START.nanos() + hour]).prop_map(When::At),
    ]
}

fn edge() -> impl Strategy<Value = f32> {
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, 1e-40, -0.0, 1e9];
    prop_oneof![9 => -60.0..180.0_f32, 1 => select(odd.to_vec())]
}

fn detection() -> impl Strategy<Value = Detection> {
    let odd = [f32::NAN, f32::INFINITY, -1.0, 0.0, 1e30];
    let confidence = prop_oneof![5 => 0.0..1.0_f32, 1 => select(odd.to_vec())];
    let edges = [edge(), edge(), edge(), edge()];
    (0..3_u32, confidence, edges, any::<bool>()).prop_map(|(class_id, confidence, edges, sort)| {
        let [x0, y0, x1, y1] = edges;
        let bbox = if sort {
            BoundingBox::new(x0.min(x1), y0.min(y1), x0.max(x1), y0.max(y1))
        } else {
            BoundingBox::new(x0, y0, x1, y1)
        };
        Detection { class_id, confidence, bbox }
    })
}

fn depths() -> impl Strategy<Value = Vec<f32>> {
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 0.0, 1e-30, 1e30, f32::MAX];
    let value = prop_oneof![3 => 0.1..10.0_f32, 1 => select(odd.to_vec())];
    // Repeated over the map.
    prop_oneof![
        prop::collection::vec(value, 1..40),
        select(odd.to_vec()).prop_map(|value| vec![value]),
        (0.1..10.0_f32).prop_map(|value| vec![value]),
    ]
}

/// `far`: also stamps that lie far ahead.
fn event(far: bool) -> impl Strategy<Value = Event> {
    let (width, height) = SIZE;
    let sizes =
        vec![SIZE, (width / 2, height / 2), (1, 1), (7, 3), (1, 500), (3 * width, 2 * height)];
    prop_oneof![
        6 => (1..4_u32).prop_map(Event::Regular),
        2 => (when(far), any::<bool>()).prop_map(|(when, fits)| Event::Frame { when, fits }),
        1 => Just(Event::Keep),
        3 => (when(true), prop::collection::vec(detection(), 0..4))
            .prop_map(|(when, found)| Event::Detections(when, found)),
        3 => (when(true), select(sizes), depths())
            .prop_map(|(when, size, values)| Event::Depth { when, size, values }),
        2 => when(far).prop_map(Event::Command),
        2 => when(far).prop_map(Event::Idle),
        1 => Just(Event::Stop),
        1 => Just(Event::Release),
    ]
}

/// A follower, what it is shown, and what it must not do.
struct Run {
    follower: Follower,
    limits: Limits,
    index: u64,
    last_frame: Option<Stamp>,
    elsewhere: Option<Stamp>,
    last_report: Option<FrameReport>,
    moving: usize,
}

impl Run {
    fn new(vehicle: VehicleOptions) -> Self {
        let control = ControlOptions { vehicle, ..ControlOptions::default() };
        let options = FollowerOptions { control, ..FollowerOptions::default() };
        Self {
            follower: Follower::new(&PICTURES.camera, options).unwrap(),
            limits: Limits::new(vehicle),
            index: 0,
            last_frame: None,
            elsewhere: None,
            last_report: None,
            moving: 0,
        }
    }

    fn stamp(index: u64) -> Stamp {
        Stamp::from_nanos(START.nanos() + Stamp::of_frame(index, 30.0).nanos())
    }

    fn time(&self, when: When) -> Stamp {
        match when {
            When::Ago(frames) => Self::stamp(self.index.saturating_sub(frames)),
            When::Beside(nanos) => Stamp::from_nanos(Self::stamp(self.index).nanos() + nanos),
            When::At(nanos) => Stamp::from_nanos(nanos),
        }
    }

    fn frame(&mut self, frame: &Frame) -> Result<(), TestCaseError> {
        let fits = (frame.width(), frame.height()) == SIZE;
        // Neither overtaken nor of another time, or the second one of that.
        let seconds = |last: Stamp| frame.stamp().seconds_since(last);
        let ahead = self.last_frame.map(seconds);
        let near = ahead.is_none_or(|ahead| (-1.0..=60.0).contains(&ahead));
        let elsewhere = self.elsewhere.take().map(seconds);
        let again = !near && elsewhere.is_some_and(|ahead| ahead > 0.0 && ahead <= 60.0);
        self.elsewhere = (!near && !again).then_some(frame.stamp());
        let report = self.follower.frame(frame);
        let later = ahead.is_none_or(|ahead| ahead > 0.0) && near;
        prop_assert_eq!(report.is_ok(), fits && (later || again));
        if again {
            self.last_frame = None;
        }
        let Ok(report) = report else { return Ok(()) };
        self.last_frame = Some(frame.stamp());
        self.last_report = Some(report);
        let own = report.fixed_from_base;
        prop_assert!(own.x.is_finite() && own.y.is_finite() && own.heading.is_finite());
        let (fused, std) = report.fused_m.unzip();
        let ranges = [report.network_m, report.fast_m, report.ground_m, fused, std];
        for range in ranges.into_iter().flatten() {
            prop_assert!(range > 0.0 && range.is_finite(), "{report:?}");
        }
        if let Some(target) = report.target {
            prop_assert!(target.bbox.is_proper() && target.edge_std.is_finite(), "{target:?}");
        }
        let pitch = self.follower.pitch();
        prop_assert!(pitch.value.abs() < 1.6 && pitch.std.is_finite(), "{pitch:?}");
        Ok(())
    }

    fn command(&mut self, now: Stamp, idle: bool) -> Result<(), TestCaseError> {
        let sent = if idle { self.follower.idle(now) } else { self.follower.command(now) };
        self.moving += usize::from(sent.speed != 0.0);
        let checked = self.limits.check(now, &sent);
        prop_assert_eq!(checked, Ok(()), "{:?}", sent);
        Ok(())
    }

    /// All as it should be: detections two frames late, depth maps eight.
    fn regular(&mut self) -> Result<(), TestCaseError> {
        self.index += 1;
        let (index, stamp) = (self.index, Self::stamp(self.index));
        self.frame(&PICTURES.at(index).0.clone().with_stamp(stamp))?;
        if index.is_multiple_of(10) {
            self.follower.keep_for_depth();
        }
        if let Some(of) = index.checked_sub(2) {
            self.follower.detections(Self::stamp(of), &PICTURES.detections(of));
        }
        if let Some(of) = index.checked_sub(8).filter(|of| of.is_multiple_of(10)) {
            // Another one may have been kept since.
            let _ = self.follower.depth(&PICTURES.at(of).1.clone().with_stamp(Self::stamp(of)));
        }
        self.command(Stamp::from_nanos(stamp.nanos() + 20_000_000), false)
    }

    fn event(&mut self, event: &Event) -> Result<(), TestCaseError> {
        match event {
            Event::Regular(frames) => (0..*frames).try_for_each(|_| self.regular())?,
            Event::Frame { when, fits } => {
                let frame = PICTURES.at(self.index).0.clone().with_stamp(self.time(*when));
                if *fits {
                    self.frame(&frame)?;
                } else {
                    let other = Frame::grey8(frame.stamp(), 7, 5, vec![80; 35]).unwrap();
                    self.frame(&other)?;
                }
            }
            Event::Keep => self.follower.keep_for_depth(),
            Event::Detections(when, found) => {
                self.follower.detections(self.time(*when), found);
            }
            Event::Depth { when, size, values } => {
                let pixels = (size.0 * size.1) as usize;
                let data = values.iter().copied().cycle().take(pixels).collect();
                let map = DepthMap::new(self.time(*when), size.0, size.1, data).unwrap();
                // Of a frame that was not kept it is refused; either is well.
                let _ = self.follower.depth(&map);
            }
            Event::Command(when) => self.command(self.time(*when), false)?,
            Event::Idle(when) => self.command(self.time(*when), true)?,
            Event::Stop => self.follower.request_stop(),
            Event::Release => self.follower.release(),
        }
        Ok(())
    }
}

fn vehicle() -> impl Strategy<Value = VehicleOptions> {
    prop_oneof![2 => Just(VehicleOptions::default()), 1 => Just(VehicleOptions::robot())]
}

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

#[test]
fn nothing_that_is_said_makes_it_panic_or_leave_the_limits() {
    let events = prop::collection::vec(event(true), 1..30);
    let moving = Cell::new(0);
    let test = |(vehicle, begun, events): (VehicleOptions, bool, Vec<Event>)| {
        let mut run = Run::new(vehicle);
        if begun {
            run.event(&Event::Regular(60))?;
        }
        events.iter().try_for_each(|event| run.event(event))?;
        moving.set(moving.get() + usize::from(run.moving > 5));
        Ok(())
    };
    let begun = prop::bool::weighted(0.7);
    TestRunner::new(config(40)).run(&(vehicle(), begun, events), test).unwrap();
    assert!(moving.get() > 5, "{} of 40 moved", moving.get());
}

#[test]
fn it_follows_again_when_sense_returns() {
    let events = prop::collection::vec(event(false), 1..20);
    let test = |events: Vec<Event>| {
        let mut run = Run::new(VehicleOptions::default());
        run.event(&Event::Regular(60))?;
        events.iter().try_for_each(|event| run.event(event))?;
        run.event(&Event::Release)?;
        run.event(&Event::Regular(60))?;
        let report = run.last_report.unwrap();
        prop_assert_eq!(report.status, TrackStatus::Tracking);
        // It is 1.2 m ahead. A depth map of nonsense that was kept may have turned the
        // camera's pitch, and with it the range of the target's foot, for longer.
        let range = report.fused_m.map(|(range, _)| range);
        prop_assert!(range.is_some_and(|range| (0.8..1.7).contains(&range)), "{:?}", report);
        // The target drives to and fro, and is followed one way.
        run.moving = 0;
        run.event(&Event::Regular(38))?;
        prop_assert!(run.moving > 8, "moves in {} of 38 frames", run.moving);
        Ok(())
    };
    // The same ones each time: what may be said includes depth maps that are wrong in every
    // pixel, and no filter can be asked to see through all of them within two seconds.
    let random = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    TestRunner::new_with_rng(config(12), random).run(&events, test).unwrap();
}
