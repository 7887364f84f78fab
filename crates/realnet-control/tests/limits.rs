//! No input makes a command outside of the limits: random inputs with not-a-number,
//! infinities, huge and tiny values, stamps that repeat and jump.
#![allow(missing_docs, clippy::unwrap_used)]

use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use realnet_control::{
    ControlInput, ControlOptions, Controller, DeadBand, Drive, Governor, Limiter, PursuitRule,
    Search, StopAction, VehicleOptions, VehiclePredictor,
};
use realnet_core::nalgebra::{Matrix2, Vector2};
use realnet_core::{
    DriveCommand, Pose2, Stamp, StopReason, TargetEstimate, TargetState, TrackStatus,
};
use std::cell::Cell;

/// Mostly numbers that occur, sometimes ones that do not.
fn number(size: f64) -> impl Strategy<Value = f64> {
    prop_oneof![
        600 => -size..size,
        5 => Just(0.0),
        1 => prop_oneof![
            Just(f64::NAN), Just(f64::INFINITY), Just(f64::NEG_INFINITY), Just(1e300),
            Just(-1e300), Just(f64::MIN_POSITIVE), Just(1e6), Just(-1e-320),
        ],
    ]
}

fn point(size: f64) -> impl Strategy<Value = Vector2<f64>> {
    (number(size), number(size)).prop_map(|(x, y)| Vector2::new(x, y))
}

prop_compose! {
    fn estimate()(
        ahead in 0.3..4.0f64, position in point(1.5), speed in 0.0..2.0f64, velocity in point(1.0), acceleration in point(3.0),
        spread in prop::array::uniform4(number(0.004)), valid in prop::bool::weighted(0.9),
    ) -> TargetEstimate {
        let [a, b, c, d] = if valid { spread.map(f64::abs) } else { spread };
        TargetEstimate {
            position: position + Vector2::new(ahead, 0.0),
            velocity: velocity + Vector2::new(speed, 0.0),
            acceleration,
            position_covariance: Matrix2::new(a, b, b, c),
            velocity_covariance: Matrix2::new(d, b, b, a),
        }
    }
}

#[derive(Clone, Debug)]
struct Event {
    step_ns: i64,
    idle: bool,
    request: Option<bool>,
    ahead_ns: i64,
    age_ns: Option<i64>,
    status: TrackStatus,
    estimate: Option<TargetEstimate>,
    trail: Vec<Vector2<f64>>,
    own_speed: Option<f64>,
}

fn nanos(usual: std::ops::Range<i64>) -> impl Strategy<Value = i64> {
    prop_oneof![
        600 => usual,
        10 => Just(0),
        5 => -2_000_000_000..2_000_000_000_i64,
        1 => prop_oneof![Just(i64::MIN), Just(i64::MAX)],
    ]
}

prop_compose! {
    fn event()(
        step_ns in nanos(1_000_000..60_000_000), idle in prop::bool::weighted(0.2),
        request in prop::option::weighted(0.03, prop::bool::weighted(0.3)),
        ahead_ns in nanos(0..200_000_000),
        age_ns in prop::option::weighted(0.97, prop_oneof![4 => nanos(0..250_000_000), 1 => nanos(0..1_500_000_000)]),
        status in prop_oneof![
            40 => Just(TrackStatus::Tracking), 4 => Just(TrackStatus::Coasting),
            1 => Just(TrackStatus::Searching), 1 => Just(TrackStatus::Lost),
        ],
        estimate in prop::option::weighted(0.98, estimate()),
        trail in prop::collection::vec(point(2.0), 0..6),
        own_speed in prop::option::of(number(2.0)),
    ) -> Event {
        Event { step_ns, idle, request, ahead_ns, age_ns, status, estimate, trail, own_speed }
    }
}

fn options() -> impl Strategy<Value = ControlOptions> {
    // The wide one's wheels are the limit: turning takes from its speed.
    let wide = Drive::Differential {
        track_m: 0.6,
        max_wheel_speed_m_s: 0.9,
        max_yaw_rate_rad_s: 3.0,
        max_yaw_acceleration_rad_s2: 100.0,
    };
    let drive = prop_oneof![2 => Just(Drive::CAR), 1 => Just(Drive::ROBOT), 1 => Just(wide)];
    let rule = prop_oneof![
        Just(PursuitRule::Trail),
        Just(PursuitRule::Target),
        Just(PursuitRule::Tangent)
    ];
    let band = prop_oneof![Just(0.0), Just(0.1), Just(0.3)];
    let numbers = (0.0..1.0f64, -0.2..0.2f64, 0.0..3.0f64);
    (drive, rule, band, numbers, any::<bool>(), any::<bool>()).prop_map(
        move |(drive, rule, band, (reverse, trim, compensation), brake, turn)| {
            let mut options = ControlOptions::default();
            options.vehicle.drive = drive;
            options.vehicle.max_deceleration_m_s2 = if drive == wide { 1.5 } else { 4.0 };
            options.vehicle.dead_band = DeadBand { min_speed_m_s: band, ..DeadBand::default() };
            options.vehicle.max_reverse_speed_m_s = if reverse < 0.5 { 0.0 } else { reverse };
            options.vehicle.lag_compensation = compensation;
            if matches!(drive, Drive::Ackermann { .. }) {
                options.vehicle.steering_trim_rad = trim;
            }
            options.pursuit.rule = rule;
            options.governor.stop = if brake { StopAction::Brake } else { StopAction::AtOnce };
            if turn {
                options.lost.search = Search::Turn { yaw_rate_rad_s: 1.0 };
            }
            options
        },
    )
}

/// Sends the events to a controller and checks every command against the one before.
/// Returns how many of the commands move the vehicle.
fn drive(options: ControlOptions, events: &[Event]) -> Result<usize, TestCaseError> {
    let mut moved = 0;
    let mut controller = Controller::new(options).unwrap();
    let vehicle = options.vehicle;
    let mut now = Stamp::ZERO;
    let mut last: Option<DriveCommand> = None;
    for event in events {
        now = Stamp::from_nanos(now.nanos().wrapping_add(event.step_ns));
        match event.request {
            Some(true) => controller.request_stop(),
            Some(false) => controller.release(),
            None => {}
        }
        let sent = if event.idle {
            controller.idle(now)
        } else {
            let target = TargetState {
                stamp: Stamp::from_nanos(now.nanos().wrapping_add(event.ahead_ns)),
                measured: event.age_ns.map(|age| Stamp::from_nanos(now.nanos().wrapping_sub(age))),
                status: event.status,
                estimate: event.estimate,
            };
            let trail = &event.trail;
            let own_speed = event.own_speed;
            let input = ControlInput { now, target: &target, trail, own_speed };
            let sent = controller.step(&input);
            if !input.is_usable() && sent.stop != Some(StopReason::Requested) {
                prop_assert_eq!(sent.stop, Some(StopReason::NotFinite));
            }
            sent
        };
        prop_assert_eq!(sent.stamp, now);
        moved += usize::from(sent.speed != 0.0);
        within(&vehicle, &sent)?;
        rates(&vehicle, last.as_ref(), &sent)?;
        let model =
            controller.predictor().advance(Pose2::IDENTITY, now, controller.effect_time(now));
        prop_assert!(model.x.is_finite() && model.y.is_finite() && model.heading.is_finite());
        let telemetry = controller.telemetry();
        prop_assert!(telemetry.curvature.is_finite() && telemetry.own_speed.is_finite());
        if let Some(gap) = telemetry.gap {
            prop_assert!(gap.speed_m_s.is_finite() && gap.integral_m_s.is_finite());
        }
        last = Some(sent);
    }
    Ok(moved)
}

fn within(vehicle: &VehicleOptions, sent: &DriveCommand) -> Result<(), TestCaseError> {
    let least = vehicle.dead_band.min_speed_m_s;
    prop_assert!(sent.speed <= vehicle.max_speed_m_s, "{:?}", sent);
    prop_assert!(sent.speed >= -vehicle.max_reverse_speed_m_s, "{:?}", sent);
    prop_assert!(sent.speed == 0.0 || sent.speed.abs() >= least, "{:?}", sent);
    prop_assert!(sent.yaw_rate.is_finite(), "{:?}", sent);
    match vehicle.drive {
        Drive::Ackermann { wheelbase_m, max_steering_rad, .. } => {
            prop_assert!(sent.steering_angle.abs() <= max_steering_rad, "{:?}", sent);
            let angle = sent.steering_angle - vehicle.steering_trim_rad;
            let yaw_rate = sent.speed * angle.tan() / wheelbase_m;
            prop_assert!((sent.yaw_rate - yaw_rate).abs() < 1e-9, "{:?}", sent);
        }
        Drive::Differential { track_m, max_wheel_speed_m_s, max_yaw_rate_rad_s, .. } => {
            prop_assert_eq!(sent.steering_angle, 0.0);
            prop_assert!(sent.yaw_rate.abs() <= max_yaw_rate_rad_s, "{:?}", sent);
            let wheel = sent.speed.abs() + 0.5 * track_m * sent.yaw_rate.abs();
            prop_assert!(wheel <= max_wheel_speed_m_s + 1e-12, "{:?}", sent);
        }
    }
    Ok(())
}

fn rates(
    vehicle: &VehicleOptions,
    last: Option<&DriveCommand>,
    sent: &DriveCommand,
) -> Result<(), TestCaseError> {
    let still = DriveCommand {
        stamp: sent.stamp,
        steering_angle: vehicle.steering_trim_rad,
        ..DriveCommand::default()
    };
    let last = last.unwrap_or(&still);
    let real = sent.stamp.seconds_since(last.stamp).max(0.0);
    let seconds = real.min(Limiter::LONGEST_STEP_S);
    let least = vehicle.dead_band.min_speed_m_s;
    let slack = 1e-9;
    let faster = sent.speed.abs() - last.speed.abs();
    if sent.speed * last.speed < 0.0 {
        prop_assert!(false, "from {:?} to {:?} without a stop", last, sent);
    }
    // over the dead band in one step, and not both at once
    let start = if last.speed == 0.0 { least } else { 0.0 };
    prop_assert!(
        faster <= (vehicle.max_acceleration_m_s2 * seconds).max(start) + slack,
        "{:?} {:?}",
        last,
        sent
    );
    let stops = sent.speed == 0.0
        && (sent.stop.is_some()
            || last.speed.abs() <= least + vehicle.max_deceleration_m_s2 * seconds + slack);
    prop_assert!(
        stops || -faster <= vehicle.max_deceleration_m_s2 * real + slack,
        "{:?} {:?}",
        last,
        sent
    );
    match vehicle.drive {
        Drive::Ackermann { max_steering_rate_rad_s, .. } => {
            let step = (sent.steering_angle - last.steering_angle).abs();
            prop_assert!(
                step <= max_steering_rate_rad_s * seconds + slack,
                "{:?} {:?}",
                last,
                sent
            );
        }
        Drive::Differential { max_yaw_acceleration_rad_s2, .. } => {
            let step = (sent.yaw_rate - last.yaw_rate).abs();
            let limit = max_yaw_acceleration_rad_s2 * seconds + slack;
            prop_assert!(sent.stop.is_some() || step <= limit, "{:?} {:?}", last, sent);
        }
    }
    Ok(())
}

fn any_command() -> impl Strategy<Value = DriveCommand> {
    (number(3.0), number(1.0), number(9.0), any::<i64>()).prop_map(|(speed, angle, rate, nanos)| {
        let stamp = Stamp::from_nanos(nanos);
        DriveCommand { stamp, speed, steering_angle: angle, yaw_rate: rate, stop: None }
    })
}

#[test]
fn no_command_is_outside_of_the_limits() {
    let config = ProptestConfig { cases: 1500, failure_persistence: None, ..Default::default() };
    let (mut moved, mut steps) = (Cell::new(0), Cell::new(0));
    let runs = (options(), prop::collection::vec(event(), 1..80));
    let outcome = TestRunner::new(config).run(&runs, |(options, events)| {
        moved.set(moved.get() + drive(options, &events)?);
        steps.set(steps.get() + events.len());
        Ok(())
    });
    if let Err(failure) = outcome {
        panic!("{failure}");
    }
    // The random inputs are not all of the kind that stops it.
    assert!(4 * *moved.get_mut() > *steps.get_mut(), "{moved:?} of {steps:?} commands move");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..Default::default() })]

    /// The governor alone, whatever it is given in place of a controller's proposals.
    #[test]
    fn the_governor_lets_nothing_through_that_is_outside(
        options in options(), proposals in prop::collection::vec((any_command(), any::<i64>()), 1..20),
    ) {
        let mut governor = Governor::new(&options).unwrap();
        for (proposal, nanos) in proposals {
            let now = Stamp::from_nanos(nanos);
            let sent = governor.check(now, Some(now), None, &proposal);
            prop_assert!(sent.speed <= options.vehicle.max_speed_m_s);
            prop_assert!(sent.speed >= -options.vehicle.max_reverse_speed_m_s);
            prop_assert!(sent.steering_angle.abs() <= 1.0 && sent.yaw_rate.is_finite());
            let finite = [proposal.speed, proposal.steering_angle, proposal.yaw_rate]
                .iter().all(|value| value.abs() <= 1e6);
            prop_assert_eq!(sent.stop == Some(StopReason::NotFinite), !finite);
        }
    }

    #[test]
    fn the_predictor_stays_finite(
        commands in prop::collection::vec((any_command(), any::<i64>(), number(2.0), number(3.0)), 1..20),
        from in any::<i64>(), to in any::<i64>(),
    ) {
        let mut predictor = VehiclePredictor::new(VehicleOptions::default()).unwrap();
        for (command, nanos, speed, yaw_rate) in commands {
            predictor.push(&command);
            predictor.correct(Stamp::from_nanos(nanos), Some(speed), Some(yaw_rate));
            let (from, to) = (Stamp::from_nanos(from), Stamp::from_nanos(to));
            let pose = predictor.advance(Pose2::IDENTITY, from, to);
            prop_assert!(pose.x.is_finite() && pose.y.is_finite() && pose.heading.is_finite());
        }
    }
}
