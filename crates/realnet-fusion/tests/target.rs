//! The target filter in single situations.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;

use common::{Random, Setup, log};
use proptest::prelude::*;
use realnet_core::nalgebra::{Matrix6, Vector2};
use realnet_core::{Pose2, Stamp, TrackStatus};
use realnet_fusion::{
    Arrival, DirectionSource, LateError, Outcome, RangeSource, Reading, StatusTimes, TargetFilter,
    TargetMeasurement, TargetOptions,
};

fn at(seconds: f64) -> Stamp {
    Stamp::from_secs_f64(seconds)
}

fn direction(seconds: f64, camera: Pose2, tangent: f64) -> TargetMeasurement {
    let source = DirectionSource::Detection;
    let reading = Reading::Direction { tangent, std: 0.005, source };
    TargetMeasurement { stamp: at(seconds), fixed_from_camera: camera, reading }
}

fn range(seconds: f64, camera: Pose2, depth_m: f64, source: RangeSource) -> TargetMeasurement {
    let reading = Reading::Range { depth_m, relative_std: 0.01, source };
    TargetMeasurement { stamp: at(seconds), fixed_from_camera: camera, reading }
}

const FIRST: RangeSource = RangeSource::Network { map: Stamp::ZERO };

fn filter() -> TargetFilter {
    TargetFilter::new(TargetOptions::default()).unwrap()
}

/// Both of a target ahead of a camera that stands at the origin.
fn push_ahead(filter: &mut TargetFilter, seconds: f64, depth: f64) {
    filter.push(direction(seconds, Pose2::IDENTITY, 0.0)).unwrap();
    filter.push(range(seconds, Pose2::IDENTITY, depth, FIRST)).unwrap();
}

#[test]
fn the_status_follows_seconds_and_not_frames() {
    let times = StatusTimes { coast_after_s: 0.4, lost_after_s: 1.0, forget_after_s: 3.0 };
    for fps in [3.0, 8.0, 30.0, 90.0] {
        let mut filter =
            TargetFilter::new(TargetOptions { times, ..TargetOptions::default() }).unwrap();
        assert_eq!(filter.track_at(at(0.0)).unwrap().status, TrackStatus::Searching);
        let frames = (2.0 * fps) as u32;
        let mut last = 0.0;
        for frame in 0..=frames {
            last = f64::from(frame) / fps;
            push_ahead(&mut filter, last, 1.0);
        }
        for (after, expected) in [
            (0.0, TrackStatus::Tracking),
            (0.39, TrackStatus::Tracking),
            (0.41, TrackStatus::Coasting),
            (0.99, TrackStatus::Coasting),
            (1.01, TrackStatus::Lost),
            (2.99, TrackStatus::Lost),
            (3.01, TrackStatus::Searching),
        ] {
            let track = filter.track_at(at(last + after)).unwrap();
            assert_eq!(track.status, expected, "{after} s after the last of {fps} fps");
            assert_eq!(track.motion.is_some(), expected != TrackStatus::Searching);
            assert_eq!(track.measured, Some(at(last)));
        }
        // Directions alone do not keep it tracked.
        for tenth in 1..=8 {
            filter.push(direction(last + f64::from(tenth) / 10.0, Pose2::IDENTITY, 0.0)).unwrap();
        }
        assert_eq!(filter.track_at(at(last + 0.8)).unwrap().status, TrackStatus::Coasting);
        // After it was forgotten it begins anew, elsewhere.
        push_ahead(&mut filter, last + 5.0, 4.0);
        let track = filter.track_at(at(last + 5.0)).unwrap();
        assert_eq!(track.status, TrackStatus::Tracking);
        assert!((track.range_from(&Pose2::IDENTITY).unwrap().depth_m - 4.0).abs() < 0.1);
    }
}

#[test]
fn one_kind_alone_begins_nothing() {
    let mut filter = filter();
    for i in 0..10 {
        filter.push(direction(f64::from(i) * 0.03, Pose2::IDENTITY, 0.0)).unwrap();
    }
    assert_eq!(filter.track_at(at(0.3)).unwrap().status, TrackStatus::Searching);
    assert!(filter.outcomes().all(|(_, _, outcome)| outcome == Outcome::Waits));
    // too far from the last direction
    filter.push(range(0.7, Pose2::IDENTITY, 1.0, FIRST)).unwrap();
    assert_eq!(filter.track_at(at(0.7)).unwrap().status, TrackStatus::Searching);
    filter.push(direction(0.8, Pose2::IDENTITY, 0.1)).unwrap();
    let track = filter.track_at(at(0.8)).unwrap();
    assert_eq!(track.status, TrackStatus::Tracking);
    assert_eq!(filter.outcomes().last().unwrap().2, Outcome::Began);
    let motion = track.motion.unwrap();
    assert!((motion.position - Vector2::new(1.0, 0.1)).norm() < 0.03, "{}", motion.position);
}

#[test]
fn a_turned_camera_and_the_base_frame() {
    // The camera stands at (2, 1) and looks along y; the target is 1.5 m ahead of it and
    // 0.3 m to its left, and drives at 0.4 m/s along y.
    let camera = Pose2::new(2.0, 1.0, std::f64::consts::FRAC_PI_2);
    let mut filter = filter();
    for i in 0..60 {
        let t = f64::from(i) / 30.0;
        let depth = 1.5 + 0.4 * t;
        filter.push(direction(t, camera, 0.3 / depth)).unwrap();
        filter.push(range(t, camera, depth, FIRST)).unwrap();
        filter.push(range(t, camera, depth, RangeSource::Size)).unwrap();
        filter.push(range(t, camera, depth, RangeSource::Ground)).unwrap();
    }
    let stamp = at(59.0 / 30.0);
    let track = filter.track_at(stamp).unwrap();
    let motion = track.motion.unwrap();
    let depth = 1.5 + 0.4 * 59.0 / 30.0;
    assert!((motion.position - Vector2::new(1.7, 1.0 + depth)).norm() < 0.02);
    assert!((motion.velocity - Vector2::new(0.0, 0.4)).norm() < 0.05, "{}", motion.velocity);
    // The base is 0.2 m behind the camera.
    let base = Pose2::new(2.0, 0.8, std::f64::consts::FRAC_PI_2);
    let seen = track.seen_from(&base);
    assert_eq!((seen.stamp, seen.measured, seen.status), (stamp, Some(stamp), track.status));
    let estimate = seen.estimate.unwrap();
    assert!((estimate.position - Vector2::new(depth + 0.2, 0.3)).norm() < 0.02);
    assert!((estimate.velocity - Vector2::new(0.4, 0.0)).norm() < 0.05);
    let range = track.range_from(&camera).unwrap();
    assert!((range.depth_m - depth).abs() < 0.02);
    // The line of sight is nearly the axis.
    let relative = range.std_m / range.depth_m;
    assert!((estimate.distance_std() / estimate.distance() - relative).abs() < 0.02);
    assert!(track.range_from(&Pose2::new(2.0, 9.0, camera.heading)).is_none(), "behind");
}

#[test]
fn coasting_does_not_run_away_and_becomes_unknown() {
    // Braking at 3 m/s² when it is last seen.
    let mut filter = filter();
    let mut t = 0.0;
    while t < 0.5 {
        push_ahead(&mut filter, t, 2.0 + 1.5 * t - 1.5 * t * t);
        t += 1.0 / 30.0;
    }
    let seen = filter.track_at(at(0.5)).unwrap().motion.unwrap();
    assert!(seen.acceleration.x < -1.5, "{}", seen.acceleration);
    let mut last = 0.0;
    for tenths in 5..40 {
        let stamp = at(f64::from(tenths) / 10.0);
        let track = filter.track_at(stamp).unwrap();
        let motion = track.motion.unwrap();
        assert!(motion.velocity.x > -2.0, "it would drive backwards at {}", motion.velocity.x);
        assert!(motion.covariance[(0, 0)] > last);
        last = motion.covariance[(0, 0)];
        let certain = last.sqrt() <= 0.5 * motion.position.norm();
        let state = track.seen_from(&Pose2::IDENTITY);
        assert_eq!(state.estimate.is_some(), certain);
        assert_eq!(state.status, track.status);
    }
    assert!(filter.track_at(at(3.9)).unwrap().seen_from(&Pose2::IDENTITY).estimate.is_none());
}

#[test]
fn an_outlier_is_gated_and_a_jump_begins_anew() {
    let mut filter = filter();
    let mut t = 0.0;
    let mut frames = |filter: &mut TargetFilter, count: u32, depth: f64, tangent: f64| {
        for _ in 0..count {
            t += 1.0 / 30.0;
            filter.push(direction(t, Pose2::IDENTITY, tangent)).unwrap();
            filter.push(range(t, Pose2::IDENTITY, depth, FIRST)).unwrap();
        }
        t
    };
    frames(&mut filter, 30, 1.0, 0.0);
    let now = frames(&mut filter, 1, 2.5, 0.5);
    let gated = filter.outcomes().filter(|(_, _, o)| matches!(o, Outcome::Gated { .. })).count();
    assert_eq!(gated, 2);
    let track = filter.track_at(at(now)).unwrap();
    assert!((track.range_from(&Pose2::IDENTITY).unwrap().depth_m - 1.0).abs() < 0.05);
    frames(&mut filter, 5, 1.0, 0.0);
    // Another target for good: after 0.3 s it is that one.
    let now = frames(&mut filter, 8, 2.5, 0.5);
    let depth = |filter: &mut TargetFilter, now| {
        filter.track_at(at(now)).unwrap().range_from(&Pose2::IDENTITY).unwrap().depth_m
    };
    assert!(depth(&mut filter, now) < 1.3);
    let now = frames(&mut filter, 6, 2.5, 0.5);
    assert!((depth(&mut filter, now) - 2.5).abs() < 0.15);
    assert!(filter.outcomes().any(|(_, _, outcome)| outcome == Outcome::Began));
    assert_eq!(filter.track_at(at(now)).unwrap().status, TrackStatus::Tracking);
}

/// The camera is knocked: the ground ranges jump, the network's do not.
#[test]
fn a_source_that_jumps_is_opened_and_does_no_harm() {
    let mut filter = filter();
    for i in 0..120 {
        let t = f64::from(i) / 30.0;
        push_ahead(&mut filter, t, 1.0);
        filter.push(range(t, Pose2::IDENTITY, 1.0, RangeSource::Size)).unwrap();
        let ground = if i < 60 { 1.0 } else { 1.8 };
        filter.push(range(t, Pose2::IDENTITY, ground, RangeSource::Ground)).unwrap();
        let track = filter.track_at(at(t)).unwrap();
        let depth = track.range_from(&Pose2::IDENTITY).unwrap().depth_m;
        assert!((depth - 1.0).abs() < 0.08, "{depth} at {t} s");
        assert_eq!(track.status, TrackStatus::Tracking);
        if i == 90 {
            let opened = filter.outcomes().filter(|(_, _, o)| *o == Outcome::Reopened).count();
            assert!((1..=2).contains(&opened), "{opened}");
        }
    }
    assert!(matches!(filter.outcomes().last().unwrap().2, Outcome::Used { .. }));
}

#[test]
fn a_late_map_corrects_what_was_derived_since() {
    // The first map says 20 % too much; the second one, of 1 s, comes at 1.4 s, is right.
    let mut filter = filter();
    for i in 0..42 {
        push_ahead(&mut filter, f64::from(i) / 30.0, 1.2);
    }
    let before = filter.track_at(at(1.4)).unwrap().range_from(&Pose2::IDENTITY).unwrap();
    let second = RangeSource::Network { map: at(1.0) };
    let arrival = filter.push(range(1.0, Pose2::IDENTITY, 1.0, second)).unwrap();
    assert!(matches!(arrival, Arrival::Late { replayed: 22..=26 }), "{arrival:?}");
    let after = filter.track_at(at(1.4)).unwrap().range_from(&Pose2::IDENTITY).unwrap();
    assert!((before.depth_m - 1.2).abs() < 0.01);
    // The middle of both, in the logarithm.
    assert!((after.depth_m - 1.2_f64.sqrt()).abs() < 0.01, "{after:?}");
    assert!(after.std_m / after.depth_m < before.std_m / before.depth_m);
}

/// Robot and target drive at 0.5 m/s. A better scale changes the distance; the speed
/// over ground, which is the robot's own, it must not change.
#[test]
fn a_corrected_scale_does_not_change_the_speed_of_who_keeps_the_distance() {
    let mut filter = filter();
    let camera = |t: f64| Pose2::new(0.5 * t, 0.0, 0.0);
    for i in 0..60 {
        let t = f64::from(i) / 30.0;
        filter.push(direction(t, camera(t), 0.0)).unwrap();
        filter.push(range(t, camera(t), 1.3, FIRST)).unwrap();
    }
    let newest = filter.newest().unwrap();
    let before = filter.track_at(newest).unwrap().motion.unwrap();
    let stamp = newest.secs_f64();
    let second = RangeSource::Network { map: newest };
    filter.push(range(stamp, camera(stamp), 0.9, second)).unwrap();
    let after = filter.track_at(newest).unwrap().motion.unwrap();
    assert!(after.position.x < before.position.x - 0.15);
    let change = (after.velocity - before.velocity).norm();
    assert!(change < 0.015 && (after.velocity.x - 0.5).abs() < 0.03, "{change} {}", after.velocity);
}

#[test]
fn a_map_that_is_older_than_all_followed_is_left_out() {
    let mut filter = filter();
    for map in 1..=5 {
        let t = f64::from(map) * 0.1;
        filter.push(direction(t, Pose2::IDENTITY, 0.0)).unwrap();
        let source = RangeSource::Network { map: at(t) };
        filter.push(range(t, Pose2::IDENTITY, 1.0, source)).unwrap();
    }
    let before = filter.track_at(at(0.55)).unwrap();
    filter.push(range(0.55, Pose2::IDENTITY, 3.0, FIRST)).unwrap();
    assert_eq!(filter.outcomes().last().unwrap().2, Outcome::OldMap);
    let after = filter.track_at(at(0.55)).unwrap();
    let change = after.motion.unwrap().position - before.motion.unwrap().position;
    assert!(change.norm() < 1e-12);
}

#[test]
fn the_trail_has_one_point_for_each_stamp() {
    let setup = Setup { seconds: 12.0, ground: Some((0.05, 0.04)), ..Setup::default() };
    let log = log(5, &setup);
    let mut filter = filter();
    for arriving in &log.arriving {
        filter.push(arriving.measurement).unwrap();
    }
    let trail: Vec<_> = filter.trail(at(2.0)).collect();
    assert!(trail.windows(2).all(|pair| pair[0].stamp < pair[1].stamp));
    assert!(trail[0].stamp >= at(2.0) && trail[0].stamp < at(2.1), "beyond the horizon");
    assert!(trail.len() > 295, "{}", trail.len());
    let truth = |stamp| log.truth.iter().find(|truth| truth.stamp == stamp).unwrap().position;
    for point in &trail {
        let distance = (point.position - truth(point.stamp)).norm();
        assert!(distance < 5.0 * point.covariance.trace().sqrt(), "{distance}");
    }
}

#[test]
fn what_no_camera_measures_is_refused_and_changes_nothing() {
    let mut filter = filter();
    for i in 0..30 {
        push_ahead(&mut filter, f64::from(i) / 30.0, 1.0);
    }
    let before = filter.track_at(at(1.1)).unwrap();
    let good = range(1.0, Pose2::IDENTITY, 1.0, RangeSource::Size);
    let with = |reading| TargetMeasurement { reading, ..good };
    let source = RangeSource::Size;
    let by = DirectionSource::Flow;
    let mut bad = Vec::new();
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
        bad.push(with(Reading::Range { depth_m: value, relative_std: 0.1, source }));
        bad.push(with(Reading::Range { depth_m: 1.0, relative_std: value, source }));
        bad.push(with(Reading::Direction { tangent: value, std: 0.1, source: by }));
        bad.push(with(Reading::Direction { tangent: 0.0, std: value, source: by }));
        for pose in [(value, 0.0, 0.0), (0.0, value, 0.0), (0.0, 0.0, value)] {
            let fixed_from_camera = Pose2::new(pose.0, pose.1, pose.2);
            bad.push(TargetMeasurement { fixed_from_camera, ..good });
        }
    }
    bad.push(with(Reading::Range { depth_m: 0.0, relative_std: 0.1, source }));
    bad.push(with(Reading::Range { depth_m: 1.0, relative_std: 0.0, source }));
    bad.push(with(Reading::Direction { tangent: 0.0, std: -1.0, source: by }));
    for measurement in bad {
        let error = filter.push(measurement).unwrap_err();
        assert!(matches!(error, LateError::Bad { .. }), "{measurement:?}: {error}");
    }
    let old = filter.push(direction(-9.0, Pose2::IDENTITY, 0.0)).unwrap_err();
    assert!(matches!(old, LateError::BeforeHorizon { .. }), "{old}");
    let ahead = filter.push(direction(100.0, Pose2::IDENTITY, 0.0)).unwrap_err();
    assert!(matches!(ahead, LateError::TooFarAhead { .. }), "{ahead}");
    assert_eq!(filter.track_at(at(1.1)).unwrap(), before);
    // A robot that asked all along may go on after a pause.
    filter.track_at(at(99.0)).unwrap();
    filter.push(direction(100.0, Pose2::IDENTITY, 0.0)).unwrap();
    filter.clear();
    assert_eq!(filter.track_at(at(0.0)).unwrap().status, TrackStatus::Searching);
}

#[test]
fn options_without_sense_are_named() {
    let default = TargetOptions::default();
    let late = StatusTimes { lost_after_s: 0.1, ..StatusTimes::default() };
    for (options, name) in [
        (TargetOptions { jerk_density: 0.0, ..default }, "jerk_density"),
        (TargetOptions { map_scale_std: f64::NAN, ..default }, "map_scale_std"),
        (TargetOptions { horizon_s: -1.0, ..default }, "horizon_s"),
        (TargetOptions { capacity: 0, ..default }, "capacity"),
        (TargetOptions { gate_deviations: 0.0, ..default }, "gate_deviations"),
        (TargetOptions { times: late, ..default }, "times.lost_after_s"),
    ] {
        let error = TargetFilter::new(options).err().unwrap();
        assert_eq!(error.name, name);
        assert!(error.to_string().starts_with(&format!("{name} is ")), "{error}");
    }
}

/// Positive definite: the correlations have a Cholesky factorisation, with no more help
/// than the rounding of their product.
fn positive_definite(covariance: &Matrix6<f64>) -> bool {
    let scale = covariance.diagonal().map(|v| 1.0 / v.sqrt());
    let scale = Matrix6::from_diagonal(&scale);
    let correlation = scale * covariance * scale;
    covariance == &covariance.transpose()
        && covariance.iter().all(|v| v.is_finite())
        && (correlation + Matrix6::identity() * 1e-13).cholesky().is_some()
}

proptest! {
    /// Measurements at the limits of what is accepted, from poses that jump, in any order.
    #[test]
    fn the_covariance_is_positive_definite_whatever_comes(seed in any::<u64>()) {
        let random = &mut Random(seed);
        let mut filter = filter();
        let mut pose = Pose2::IDENTITY;
        let mut last = 0.0_f64;
        for _ in 0..200 {
            last += [0.0, 1e-9, 1e-3, 0.03, 0.03, 0.7, 4.0][random.bits() as usize % 7];
            let seconds = last - [0.0, 0.0, 0.3, 1.4][random.bits() as usize % 4];
            if random.bits().is_multiple_of(20) {
                pose = Pose2::new(
                    random.uniform(-1e3, 1e3), random.uniform(-9.0, 9.0), random.normal());
            }
            pose.x += 0.01 * random.normal();
            let wild = random.bits().is_multiple_of(4);
            let depth_m = if wild { 10f64.powf(random.uniform(-2.0, 4.0)) } else { 1.0 };
            let std = 10f64.powf(random.uniform(-4.0, 0.9));
            let map = at(seconds - random.uniform(0.0, 0.5));
            let reading = match random.bits() % 5 {
                0 => {
                    let tangent = if wild { random.uniform(-100.0, 100.0) } else { 0.01 };
                    Reading::Direction { tangent, std, source: DirectionSource::Flow }
                }
                1 => Reading::Direction { tangent: 0.0, std: 0.01, source: DirectionSource::Detection },
                2 => Reading::Range { depth_m, relative_std: std, source: RangeSource::Ground },
                3 => Reading::Range { depth_m, relative_std: std, source: RangeSource::Size },
                _ => {
                    let source = RangeSource::Network { map };
                    Reading::Range { depth_m, relative_std: std, source }
                }
            };
            let stamp = at(seconds);
            let _ = filter.push(TargetMeasurement { stamp, fixed_from_camera: pose, reading });
            for ahead in [0.0, 0.2, 3.0] {
                let track = filter.track_at(at(last + ahead)).unwrap();
                if let Some(motion) = track.motion {
                    prop_assert!(positive_definite(&motion.covariance), "{}", motion.covariance);
                    let state = track.seen_from(&pose);
                    prop_assert!(state.estimate.is_none_or(|estimate| estimate.is_finite()));
                }
            }
        }
    }
}
