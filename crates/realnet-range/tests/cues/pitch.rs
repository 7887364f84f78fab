use crate::random::{Rng, assert_consistent, camera};
use proptest::prelude::*;
use realnet_core::Pose;
use realnet_core::nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use realnet_range::cues::{
    Attitude, PitchError, PitchFilter, PitchFilterOptions, PitchMeasurement, PitchSource,
    Uncertain, attitude_from_horizon, pitch_from_translation,
};

/// The camera's rotation from one attitude to the next, with a turn about the
/// vertical (radians, to the left) between them.
fn rotation(before: Attitude, now: Attitude, turn: f64) -> UnitQuaternion<f64> {
    let level_from_optical = |attitude: Attitude| {
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), attitude.pitch_rad)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), attitude.roll_rad)
            * realnet_core::body_from_optical().rotation()
    };
    let now_level_from_before_level = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -turn);
    level_from_optical(now).inverse() * now_level_from_before_level * level_from_optical(before)
}

/// The pose change of a camera that turns and moves by `moved` along the ground:
/// forward and to the left in the present heading, and up.
fn motion(before: Attitude, now: Attitude, turn: f64, moved: [f64; 3]) -> Pose {
    let r = rotation(before, now, turn);
    let optical_from_level = rotation(Attitude::default(), now, 0.0)
        * realnet_core::body_from_optical().rotation().inverse();
    Pose::new(r, -(optical_from_level * Vector3::from(moved)))
}

fn diagonal(v: f64, w: f64) -> Matrix6<f64> {
    Matrix6::from_diagonal(&Vector6::new(v * v, v * v, v * v, w * w, w * w, w * w))
}

/// A correlated random covariance and a draw from it.
fn correlated(rng: &mut Rng, v: f64, w: f64) -> (Matrix6<f64>, Vector6<f64>) {
    let mix = Matrix6::from_fn(|row, column| {
        let scale = if row < 3 { v } else { w };
        scale * if row == column { 1.0 } else { rng.uniform(-0.4, 0.4) }
    });
    (mix * mix.transpose(), mix * Vector6::from_fn(|_, _| rng.normal()))
}

proptest! {
    #[test]
    fn the_direction_of_motion_gives_the_pitch(
        pitches in prop::array::uniform2(-0.4..0.6f64), rolls in prop::array::uniform2(-0.3..0.3f64),
        turn in -0.3..0.3f64, forward in 0.02..1.0f64, back in any::<bool>(), left in -0.3..0.3f64
    ) {
        let before = Attitude::new(pitches[0], rolls[0]);
        let now = Attitude::new(pitches[1], rolls[1]);
        let forward = if back { -forward } else { forward };
        let pose = motion(before, now, turn, [forward, left * forward, 0.0]);
        let found = pitch_from_translation(
            &pose, &diagonal(1e-5, 1e-5), Uncertain::exact(rolls[1]), 0.0
        ).unwrap();
        prop_assert!((found.pitch_rad - pitches[1]).abs() < 1e-9, "{} {}", found.pitch_rad, pitches[1]);
    }

    #[test]
    fn two_points_of_the_horizon_give_pitch_and_roll(
        lens in any::<bool>(), pitch in -0.3..0.3f64, roll in -0.3..0.3f64,
        left in -0.5..-0.1f64, right in 0.1..0.5f64, swapped in any::<bool>()
    ) {
        let camera = camera(lens);
        let attitude = Attitude::new(pitch, roll);
        let a = attitude.horizon_pixel(&camera, left).unwrap();
        let b = attitude.horizon_pixel(&camera, right).unwrap();
        let (a, b) = if swapped { (b, a) } else { (a, b) };
        let found = attitude_from_horizon(&camera, a, b, 1.0).unwrap();
        prop_assert!((found.attitude.pitch_rad - pitch).abs() < 1e-9);
        prop_assert!((found.attitude.roll_rad - roll).abs() < 1e-9);
        prop_assert!(found.pitch_std_rad < 0.01 && found.roll_std_rad < 0.03);
    }

    #[test]
    fn rotations_carry_the_pitch(
        pitches in prop::array::uniform2(-0.5..0.5f64), roll in -0.3..0.3f64, turn in -1.0..1.0f64
    ) {
        let options = PitchFilterOptions {
            roll_rad: Uncertain::exact(roll), process_std: 0.0, floor_std_rad: 0.0,
            ..PitchFilterOptions::default()
        };
        let mut filter = PitchFilter::new(Uncertain::new(pitches[0], 0.01), options).unwrap();
        let r = rotation(Attitude::new(pitches[0], roll), Attitude::new(pitches[1], roll), turn);
        filter.predict(&r, 0.0, 0.1).unwrap();
        prop_assert!((filter.pitch_rad().value - pitches[1]).abs() < 1e-12);
    }
}

#[test]
fn deviations_of_the_direction_are_consistent() {
    let mut rng = Rng(51);
    let squares: Vec<f64> = (0..2000)
        .map(|_| {
            let now = Attitude::new(rng.uniform(-0.2, 0.4), rng.uniform(-0.1, 0.1));
            let (forward, left) = (rng.uniform(0.1, 0.5), rng.uniform(-0.05, 0.05));
            let (heave_std, roll_std) = (0.001, 0.01);
            let moved = [forward, left, heave_std * rng.normal()];
            let turn = rng.uniform(-0.05, 0.05);
            let truth = motion(Attitude::default(), now, turn, moved);
            let (covariance, draw) = correlated(&mut rng, 0.003, 0.003);
            let roll = Uncertain::new(now.roll_rad + roll_std * rng.normal(), roll_std);
            let seen = Pose::exp(&draw) * truth;
            let found = pitch_from_translation(&seen, &covariance, roll, heave_std).unwrap();
            assert_eq!(found.source, PitchSource::Translation);
            ((found.pitch_rad - now.pitch_rad) / found.std_rad).powi(2)
        })
        .collect();
    assert_consistent(&squares);
}

#[test]
fn standing_still_has_no_direction() {
    let level = Attitude::default();
    let roll = Uncertain::exact(0.0);
    let slow = motion(level, level, 0.0, [0.01, 0.0, 0.0]);
    match pitch_from_translation(&slow, &diagonal(0.003, 0.001), roll, 0.0) {
        Err(PitchError::TooSlow { forward_m, std_m }) => {
            assert!((forward_m - 0.01).abs() < 1e-12 && (std_m - 0.003).abs() < 1e-5);
        }
        other => panic!("{other:?}"),
    }
    let nowhere = Pose::identity();
    assert!(pitch_from_translation(&nowhere, &Matrix6::zeros(), roll, 0.0).is_err());
    let hole = Pose::from_translation(Vector3::new(f64::NAN, 0.0, -1.0));
    assert!(pitch_from_translation(&hole, &diagonal(0.001, 0.001), roll, 0.0).is_err());
    let fast = motion(level, level, 0.0, [1.0, 0.0, 0.0]);
    let unknown = Matrix6::from_element(f64::NAN);
    assert!(pitch_from_translation(&fast, &unknown, roll, 0.0).is_err());
    assert!(pitch_from_translation(&fast, &diagonal(0.001, 0.001), roll, -1.0).is_err());
}

#[test]
fn deviations_of_the_horizon_are_consistent() {
    let mut rng = Rng(52);
    let (mut pitch, mut roll) = (Vec::new(), Vec::new());
    for index in 0..2000 {
        let camera = camera(index % 2 == 0);
        let truth = Attitude::new(rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2));
        let std_px = 1.5;
        let mut point = |ray_x: f64| {
            let [u, v] = truth.horizon_pixel(&camera, ray_x).unwrap();
            [u, v + std_px * rng.normal()]
        };
        let (a, b) = (point(-0.4), point(0.3));
        let found = attitude_from_horizon(&camera, a, b, std_px).unwrap();
        assert_eq!(found.measurement().std_rad, found.pitch_std_rad);
        let error = found.attitude.pitch_rad - truth.pitch_rad;
        pitch.push((error / found.pitch_std_rad).powi(2));
        roll.push(((found.attitude.roll_rad - truth.roll_rad) / found.roll_std_rad).powi(2));
    }
    assert_consistent(&pitch);
    assert_consistent(&roll);
}

#[test]
fn points_that_are_no_horizon_are_refused() {
    let camera = camera(false);
    let above = attitude_from_horizon(&camera, [300.0, 100.0], [300.5, 100.0], 1.0);
    assert!(matches!(above, Err(PitchError::NoHorizon { .. })));
    let hole = attitude_from_horizon(&camera, [f64::NAN, 100.0], [400.0, 100.0], 1.0);
    assert!(hole.is_err());
    assert!(attitude_from_horizon(&camera, [100.0, 90.0], [400.0, 90.0], -1.0).is_err());
}

#[test]
fn the_filter_is_consistent() {
    let mut rng = Rng(53);
    let (mut ends, mut roll_matters) = (Vec::new(), Vec::new());
    for _ in 0..800 {
        let roll_std = 0.03;
        let roll = roll_std * rng.normal();
        let mount = Uncertain::new(rng.uniform(-0.2, 0.3), 0.03);
        let mut truth = mount.value + mount.std * rng.normal();
        let options = PitchFilterOptions {
            roll_rad: Uncertain::new(0.0, roll_std),
            process_std: 0.01,
            floor_std_rad: 0.0,
            gate_sigmas: 10.0,
            ..PitchFilterOptions::default()
        };
        let mut filter = PitchFilter::new(mount, options).unwrap();
        let (dt, turn_std) = (0.033_f64, 0.001);
        for frame in 0..60 {
            let next = truth + 0.004 * rng.normal();
            let turn = 0.02;
            let exact = rotation(Attitude::new(truth, roll), Attitude::new(next, roll), turn);
            let error = Vector3::from_fn(|_, _| turn_std * rng.normal());
            let seen = UnitQuaternion::from_scaled_axis(error) * exact;
            // what the rotation does not say: the slope of the ground changes
            truth = next + options.process_std * dt.sqrt() * rng.normal();
            filter.predict(&seen, turn_std, dt).unwrap();
            if frame == 29 {
                roll_matters
                    .push(((filter.pitch_rad().value - truth) / filter.pitch_rad().std).powi(2));
            }
            if frame > 30 && frame % 10 == 0 {
                let std_rad = 0.01;
                let pitch_rad = truth + std_rad * rng.normal();
                let source = PitchSource::GroundFit;
                let update = filter.update(&PitchMeasurement { source, pitch_rad, std_rad });
                assert!(update.unwrap().accepted);
            }
        }
        ends.push(((filter.pitch_rad().value - truth) / filter.pitch_rad().std).powi(2));
    }
    assert_consistent(&roll_matters);
    assert_consistent(&ends);
}

#[test]
fn a_cue_that_disagrees_is_reported_and_not_used_until_it_insists() {
    let mount = Uncertain::new(0.1, 0.01);
    let options = PitchFilterOptions { restart_after: Some(3), ..PitchFilterOptions::default() };
    let mut filter = PitchFilter::new(mount, options).unwrap();
    let source = PitchSource::Translation;
    let wrong = PitchMeasurement { source, pitch_rad: 0.3, std_rad: 0.02 };
    for refused in 1..=2 {
        let update = filter.update(&wrong).unwrap();
        assert!(!update.accepted && !update.restarted);
        assert!((update.innovation_rad - 0.2).abs() < 1e-12);
        assert!((update.sigmas() - 0.2 / 0.02f64.hypot(0.01)).abs() < 1e-9);
        assert_eq!((filter.pitch_rad(), filter.refused_in_a_row()), (mount, refused));
    }
    let right = PitchMeasurement { pitch_rad: 0.11, ..wrong };
    assert!(filter.update(&right).unwrap().accepted);
    // 0.1 + 0.01 * 1 / 5
    assert!((filter.pitch_rad().value - 0.102).abs() < 1e-12);
    assert_eq!(filter.refused_in_a_row(), 0);
    let last = (0..3).map(|_| filter.update(&wrong).unwrap()).last().unwrap();
    assert!(last.restarted && !last.accepted);
    assert_eq!(filter.pitch_rad(), Uncertain::new(0.3, 0.02));
}

#[test]
fn the_deviation_has_a_floor_and_bad_numbers_change_nothing() {
    let options = PitchFilterOptions { floor_std_rad: 0.002, ..PitchFilterOptions::default() };
    let mut filter = PitchFilter::new(Uncertain::new(0.1, 0.01), options).unwrap();
    let source = PitchSource::Horizon;
    let good = PitchMeasurement { source, pitch_rad: 0.1, std_rad: 0.002 };
    for _ in 0..100 {
        filter.update(&good).unwrap();
    }
    assert!((filter.pitch_rad().std - 0.002).abs() < 1e-12);
    let before = filter.clone();
    let identity = UnitQuaternion::identity();
    assert!(filter.update(&PitchMeasurement { pitch_rad: f64::NAN, ..good }).is_err());
    assert!(filter.update(&PitchMeasurement { std_rad: 0.0, ..good }).is_err());
    assert!(filter.predict(&identity, f64::NAN, 0.1).is_err());
    assert!(filter.predict(&identity, 0.0, -0.1).is_err());
    let over = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 1.45);
    assert!(filter.predict(&over, 0.0, 0.1).is_err(), "looks straight down");
    assert!(filter.reset(Uncertain::new(2.0, 0.1)).is_err());
    assert_eq!(filter, before);
    assert!(PitchFilter::new(Uncertain::new(0.0, f64::INFINITY), options).is_err());
}
