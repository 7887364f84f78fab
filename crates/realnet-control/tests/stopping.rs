//! Every reason to stop, by a simulated clock with uneven intervals.
#![allow(missing_docs, clippy::unwrap_used)]

mod world;

use realnet_control::{
    ControlInput, ControlOptions, Controller, Phase, Search, StopAction, VehicleOptions,
};
use realnet_core::nalgebra::{Matrix2, Vector2};
use realnet_core::{DriveCommand, Stamp, StopReason, TargetEstimate, TargetState, TrackStatus};
use world::Noise;

/// Ahead by so much, driving away at 1 m/s.
fn ahead(x: f64) -> TargetEstimate {
    TargetEstimate {
        position: Vector2::new(x, 0.1),
        velocity: Vector2::new(1.0, 0.0),
        acceleration: Vector2::zeros(),
        position_covariance: Matrix2::identity() * 4e-4,
        velocity_covariance: Matrix2::identity() * 1e-2,
    }
}

struct Bench {
    controller: Controller,
    noise: Noise,
    now: f64,
}

impl Bench {
    fn new(options: ControlOptions, seed: u64) -> Self {
        let controller = Controller::new(options).unwrap();
        Self { controller, noise: Noise::new(seed), now: 100.0 }
    }

    /// 2 to 50 ms later.
    fn tick(&mut self) -> Stamp {
        self.now += 0.002 + 0.048 * self.noise.even();
        Stamp::from_secs_f64(self.now)
    }

    fn state(&self, now: Stamp, measured: Option<Stamp>) -> TargetState {
        TargetState {
            stamp: self.controller.effect_time(now),
            measured,
            status: TrackStatus::Tracking,
            estimate: Some(ahead(1.5)),
        }
    }

    fn step(&mut self, change: impl FnOnce(&mut TargetState)) -> DriveCommand {
        let now = self.tick();
        let mut state = self.state(now, Some(now));
        change(&mut state);
        self.controller.step(&ControlInput::new(now, &state))
    }

    fn idle(&mut self) -> DriveCommand {
        let now = self.tick();
        self.controller.idle(now)
    }

    /// Until it drives.
    fn drive(&mut self) -> DriveCommand {
        let mut last = DriveCommand::default();
        for _ in 0..60 {
            last = self.step(|_| {});
        }
        assert!(last.speed > 0.8 && last.stop.is_none(), "{last:?}");
        last
    }
}

fn stands(command: DriveCommand, reason: StopReason) {
    assert_eq!(command.stop, Some(reason));
    assert_eq!((command.speed, command.yaw_rate), (0.0, 0.0), "{reason}");
}

/// The bar: within 0.2 s of the last valid input, by a timer alone.
#[test]
fn without_input_it_stands_within_the_set_time() {
    for seed in 0..200 {
        let mut bench = Bench::new(ControlOptions::default(), seed);
        bench.drive();
        let last = bench.now;
        loop {
            let command = bench.idle();
            let since = bench.now - last;
            if since <= 0.15 {
                assert!(command.stop.is_none() && command.speed > 0.8);
            } else {
                stands(command, StopReason::StaleInput);
                assert!(since <= 0.2, "{since}");
                break;
            }
        }
        // It goes on when inputs come again, from 0 and by the limits.
        let command = bench.step(|_| {});
        assert!(command.stop.is_none() && command.speed < 0.5);
        bench.drive();
    }
}

/// The bar: inputs go on, but what they tell of the target gets old: within the set
/// coasting time plus 0.2 s of the last measurement.
#[test]
fn without_measurements_it_stands_after_the_coasting_time() {
    for stop in [StopAction::AtOnce, StopAction::Brake] {
        for seed in 0..100 {
            let mut options = ControlOptions::default();
            options.governor.stop = stop;
            let mut bench = Bench::new(options, seed);
            let mut speed = bench.drive().speed;
            let last = bench.now;
            let measured = Some(Stamp::from_secs_f64(last));
            let mut phases = Vec::new();
            let coast = options.lost.stop_after_s;
            while bench.now < last + 8.0 {
                let command = bench.step(|state| state.measured = measured);
                let phase = bench.controller.telemetry().phase;
                if phases.last() != Some(&phase) {
                    phases.push(phase);
                }
                assert!(command.speed <= speed || phase == Phase::Tracking);
                speed = command.speed;
                let age = bench.now - last;
                if phase == Phase::Slowing {
                    assert_eq!(command.stop, Some(StopReason::TargetLost));
                }
                if age > coast + 0.2 || (age > coast && stop == StopAction::AtOnce) {
                    stands(command, StopReason::TargetLost);
                }
            }
            let expected = [
                Phase::Tracking,
                Phase::Coasting,
                Phase::Slowing,
                Phase::Stopped,
                Phase::Searching,
            ];
            assert_eq!(phases, expected);
            bench.drive();
        }
    }
}

#[test]
fn each_reason_is_named_and_the_most_urgent_first() {
    let nan = f64::NAN;
    let mut bench = Bench::new(ControlOptions::default(), 1);
    stands(bench.idle(), StopReason::MissingInput);
    stands(bench.step(|state| state.estimate = None), StopReason::NoTarget);
    stands(bench.step(|state| state.measured = None), StopReason::NoTarget);
    stands(bench.step(|state| state.status = TrackStatus::Searching), StopReason::NoTarget);
    bench.drive();
    stands(bench.step(|state| state.estimate = None), StopReason::TargetLost);
    stands(bench.step(|state| state.status = TrackStatus::Lost), StopReason::TargetLost);
    bench.drive();
    stands(bench.step(|state| state.estimate = Some(ahead(0.34 + 0.33))), StopReason::TooClose);
    bench.drive();
    let doubt = |state: &mut TargetState| {
        state.estimate =
            Some(TargetEstimate { position_covariance: Matrix2::identity(), ..ahead(1.5) });
    };
    stands(bench.step(doubt), StopReason::TooUncertain);
    bench.drive();
    let broken = |state: &mut TargetState| {
        state.estimate = Some(TargetEstimate { velocity: Vector2::new(nan, 0.0), ..ahead(1.5) });
    };
    stands(bench.step(broken), StopReason::NotFinite);
    bench.drive();
    // A prediction for a moment long ago; a measurement from the future.
    let old = |state: &mut TargetState| state.stamp = Stamp::ZERO;
    stands(bench.step(old), StopReason::StaleInput);
    bench.drive();
    let future = |state: &mut TargetState| state.measured = Some(Stamp::from_secs_f64(1e6));
    stands(bench.step(future), StopReason::StaleInput);
    bench.drive();
    // The request is latched, and wins over all others.
    bench.controller.request_stop();
    stands(bench.idle(), StopReason::Requested);
    stands(bench.step(broken), StopReason::Requested);
    stands(bench.step(|_| {}), StopReason::Requested);
    bench.controller.release();
    assert_eq!(bench.idle().stop, None);
    bench.drive();
}

#[test]
fn not_finite_own_speed_and_trail_stop_it_and_leave_nothing_behind() {
    let mut bench = Bench::new(ControlOptions::default(), 2);
    bench.drive();
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
        let now = bench.tick();
        let state = bench.state(now, Some(now));
        let mut input = ControlInput::new(now, &state);
        input.own_speed = Some(bad);
        stands(bench.controller.step(&input), StopReason::NotFinite);
        bench.drive();
        let now = bench.tick();
        let state = bench.state(now, Some(now));
        let trail = [Vector2::new(0.5, 0.0), Vector2::new(bad, 0.0)];
        let mut input = ControlInput::new(now, &state);
        input.trail = &trail;
        stands(bench.controller.step(&input), StopReason::NotFinite);
        bench.drive();
    }
    // Only unusable inputs: as if there were none.
    let last = bench.now;
    while bench.now < last + 0.3 {
        let bad = |state: &mut TargetState| {
            state.estimate.as_mut().unwrap().position.x = f64::NAN;
        };
        stands(bench.step(bad), StopReason::NotFinite);
    }
    stands(bench.idle(), StopReason::StaleInput);
}

#[test]
fn a_clock_that_jumps_back_stops_it_until_inputs_come_by_the_new_time() {
    let mut bench = Bench::new(ControlOptions::default(), 3);
    bench.drive();
    bench.now = 10.0;
    stands(bench.idle(), StopReason::StaleInput);
    bench.drive();
    // and forward
    bench.now = 1000.0;
    stands(bench.idle(), StopReason::StaleInput);
    bench.drive();
}

#[test]
fn near_the_stopping_radius_it_does_not_start_and_stop() {
    let mut bench = Bench::new(ControlOptions::default(), 4);
    bench.drive();
    let at = |gap: f64| move |state: &mut TargetState| state.estimate = Some(ahead(0.34 + gap));
    assert_eq!(bench.step(at(0.37)).stop, None);
    stands(bench.step(at(0.33)), StopReason::TooClose);
    stands(bench.step(at(0.37)), StopReason::TooClose);
    stands(bench.idle(), StopReason::TooClose);
    stands(bench.step(at(0.38)), StopReason::TooClose);
    assert_eq!(bench.step(at(0.42)).stop, None);
    assert_eq!(bench.step(at(0.37)).stop, None);
}

#[test]
fn after_doubt_a_little_more_certainty_is_asked_for() {
    let mut bench = Bench::new(ControlOptions::default(), 8);
    bench.drive();
    let doubt = |share: f64| {
        move |state: &mut TargetState| {
            let estimate = state.estimate.as_mut().unwrap();
            let std = share * estimate.distance();
            estimate.position_covariance = Matrix2::identity() * std * std;
        }
    };
    assert_eq!(bench.step(doubt(0.34)).stop, None);
    stands(bench.step(doubt(0.36)), StopReason::TooUncertain);
    stands(bench.step(doubt(0.34)), StopReason::TooUncertain);
    stands(bench.step(doubt(0.29)), StopReason::TooUncertain);
    assert_eq!(bench.step(doubt(0.27)).stop, None);
    assert_eq!(bench.step(doubt(0.34)).stop, None);
}

#[test]
fn a_robot_that_brakes_stays_on_its_curve() {
    let mut options = ControlOptions { vehicle: VehicleOptions::robot(), ..Default::default() };
    options.governor.stop = StopAction::Brake;
    let mut bench = Bench::new(options, 9);
    let aside = |state: &mut TargetState| state.estimate.as_mut().unwrap().position.y = 0.6;
    let mut last = DriveCommand::default();
    for _ in 0..60 {
        last = bench.step(aside);
    }
    assert!(last.speed > 0.5 && last.yaw_rate > 0.1, "{last:?}");
    let curvature = last.yaw_rate / last.speed;
    bench.controller.request_stop();
    let mut brakes = 0;
    loop {
        let command = bench.idle();
        if command.speed == 0.0 {
            assert_eq!(command.yaw_rate, 0.0);
            break;
        }
        assert!((command.yaw_rate / command.speed - curvature).abs() < 1e-9, "{command:?}");
        brakes += 1;
    }
    assert!(brakes >= 3);
}

#[test]
fn a_stop_forgets_the_integral() {
    let mut bench = Bench::new(ControlOptions::default(), 10);
    // 0.2 m too far for a while
    for _ in 0..100 {
        bench.step(|state| state.estimate = Some(ahead(1.54)));
    }
    let integral = |bench: &Bench| bench.controller.telemetry().gap.unwrap().integral_m_s;
    assert!(integral(&bench) > 0.02);
    bench.controller.request_stop();
    bench.idle();
    bench.controller.release();
    bench.step(|state| state.estimate = Some(ahead(1.34)));
    assert!(integral(&bench).abs() < 0.005);
}

#[test]
fn braking_instead_of_0_at_once_takes_the_greatest_deceleration() {
    let mut options = ControlOptions::default();
    options.governor.stop = StopAction::Brake;
    let mut bench = Bench::new(options, 5);
    let mut last = bench.drive();
    let angle = last.steering_angle;
    bench.controller.request_stop();
    let begin = bench.now;
    while last.speed > 0.0 {
        let command = bench.idle();
        let seconds = command.stamp.seconds_since(last.stamp);
        let expected = last.speed - 4.0 * seconds;
        let expected = if expected < 0.1 { 0.0 } else { expected };
        assert!((command.speed - expected).abs() < 1e-9, "{command:?} after {last:?}");
        assert_eq!(command.stop, Some(StopReason::Requested));
        assert_eq!(command.steering_angle, angle, "it stays on its path");
        last = command;
    }
    assert!(bench.now - begin < 2.0 / 4.0 + 0.05);
}

#[test]
fn a_robot_searches_on_the_spot_and_a_car_stands() {
    let search = Search::Turn { yaw_rate_rad_s: 0.8 };
    for (vehicle, side) in [
        (VehicleOptions::robot(), 1.0),
        (VehicleOptions::robot(), -1.0),
        (VehicleOptions::default(), 1.0),
    ] {
        let mut options = ControlOptions { vehicle, ..Default::default() };
        options.lost.search = search;
        let mut bench = Bench::new(options, 6);
        let aside = |state: &mut TargetState| {
            state.estimate.as_mut().unwrap().position.y = 0.4 * side;
        };
        for _ in 0..40 {
            bench.step(aside);
        }
        let last = bench.now;
        let mut turned = 0.0;
        while bench.now < last + 15.0 {
            let before = bench.now;
            let command = bench.step(|state| {
                state.estimate = None;
                state.status = TrackStatus::Lost;
            });
            let age = bench.now - last;
            assert_eq!(command.stop, Some(StopReason::TargetLost));
            assert_eq!(command.speed, 0.0);
            if age > 2.2 && age < 10.0 && vehicle.drive.turns_on_the_spot() {
                assert!((command.yaw_rate - 0.8 * side).abs() < 1e-12, "{command:?}");
            }
            if age > 10.2 {
                assert_eq!(command.yaw_rate, 0.0);
            }
            turned += command.yaw_rate * (bench.now - before);
        }
        let turns = vehicle.drive.turns_on_the_spot();
        assert!(if turns { turned * side > 6.0 } else { turned == 0.0 }, "{turned}");
        // Stale input stops the search too.
        for _ in 0..5 {
            bench.now += 0.05;
            bench.idle();
        }
        stands(bench.idle(), StopReason::StaleInput);
    }
}

#[test]
fn wheels_stay_on_the_path_while_it_brakes_and_are_straight_when_it_stands() {
    let mut bench = Bench::new(ControlOptions::default(), 7);
    let aside = |state: &mut TargetState| state.estimate.as_mut().unwrap().position.y = 0.6;
    let mut last = DriveCommand::default();
    for _ in 0..60 {
        last = bench.step(aside);
    }
    assert!(last.steering_angle > 0.1 && last.speed > 0.5, "{last:?}");
    let first = bench.step(|state| state.estimate = None);
    assert_eq!((first.speed, first.steering_angle), (0.0, last.steering_angle));
    for _ in 0..80 {
        last = bench.step(|state| state.estimate = None);
    }
    assert_eq!(last.steering_angle, 0.0);
}
