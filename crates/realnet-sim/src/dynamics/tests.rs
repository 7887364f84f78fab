use super::*;
use crate::{VehicleKind, VehicleState};
use proptest::prelude::*;
use realnet_core::nalgebra::Vector2;
use realnet_core::{DriveCommand, Pose2, Stamp};
use std::f64::consts::PI;

const RADIUS: f64 = 0.03;

fn at(seconds: f64) -> Stamp {
    Stamp::from_secs_f64(seconds)
}

/// A car without lags, dead times, dead bands and errors.
fn plain_car() -> VehicleDynamics {
    let mut dynamics = VehicleDynamics::of(VehicleKind::TouringCar);
    dynamics.dead_time_s = 0.0;
    let DriveTrain::Ackermann(car) = &mut dynamics.drive else { unreachable!() };
    car.motor.lag_s = 0.0;
    (car.motor.start_speed, car.motor.hold_speed) = (0.0, 0.0);
    (car.steering.lag_s, car.steering.max_rate) = (0.0, 1e3);
    (car.understeer, car.relaxation) = (0.0, 0.0);
    dynamics
}

fn plain_robot() -> VehicleDynamics {
    let mut dynamics = VehicleDynamics::of(VehicleKind::Robot);
    dynamics.dead_time_s = 0.0;
    let motor = dynamics.motor_mut();
    (motor.lag_s, motor.start_speed, motor.hold_speed) = (0.0, 0.0, 0.0);
    dynamics
}

fn started(dynamics: VehicleDynamics, speed: f64) -> Vehicle {
    let start = VehicleState { speed, ..VehicleState::default() };
    Vehicle::new(dynamics, RADIUS, start, Stamp::ZERO).unwrap()
}

fn command(seconds: f64, speed: f64, steering_angle: f64, yaw_rate: f64) -> DriveCommand {
    DriveCommand { stamp: at(seconds), speed, steering_angle, yaw_rate, stop: None }
}

#[test]
fn braking_takes_the_way_of_the_delay_and_of_the_deceleration() {
    let mut dynamics = plain_car();
    dynamics.dead_time_s = 0.12;
    let (speed, braking) = (1.5, 4.0);
    dynamics.motor_mut().max_braking = braking;
    let mut car = started(dynamics, speed);
    car.command(&command(-1.0, speed, 0.0, 0.0));
    car.advance_to(at(1.0));
    let from = car.state().world_from_base.x;
    car.command(&command(1.0, 0.0, 0.0, 0.0));
    car.advance_to(at(1.2));
    assert!(car.state().braking);
    car.advance_to(at(3.0));
    let way = car.state().world_from_base.x - from;
    assert!((way - (speed * 0.12 + speed * speed / (2.0 * braking))).abs() < 2e-3, "{way}");
    assert_eq!(car.state().speed, 0.0);
    assert!(!car.state().braking);
    assert!((car.state().wheel_angle - car.state().world_from_base.x / RADIUS).abs() < 1e-6);
    // Friction ends braking earlier than the brakes could.
    dynamics.friction = 0.2;
    let mut slippery = started(dynamics, speed);
    slippery.command(&command(-1.0, 0.0, 0.0, 0.0));
    slippery.advance_to(at(3.0));
    let way = slippery.state().world_from_base.x;
    assert!((way - speed * speed / (2.0 * 0.2 * GRAVITY)).abs() < 2e-3, "{way}");
}

#[test]
fn a_step_of_speed_comes_after_the_dead_time_by_the_lag() {
    let mut dynamics = plain_car();
    (dynamics.dead_time_s, dynamics.motor_mut().lag_s) = (0.1, 0.2);
    let mut car = started(dynamics, 0.0);
    car.command(&command(0.0, 0.4, 0.0, 0.0));
    car.advance_to(at(0.0995));
    assert_eq!(car.state().speed, 0.0);
    for lags in [0.5, 1.0, 2.0, 4.0_f64] {
        car.advance_to(at(0.1 + 0.2 * lags));
        let expected = 0.4 * (1.0 - (-lags).exp());
        assert!((car.state().speed - expected).abs() < 1e-6, "{lags}: {}", car.state().speed);
    }
    // What limits the motor limits the step.
    let mut car = started(plain_car(), 0.0);
    car.command(&command(0.0, 9.0, 0.0, 0.0));
    car.advance_to(at(0.5));
    assert!((car.state().speed - 0.5 * 3.0).abs() < 1e-9);
    car.advance_to(at(5.0));
    assert_eq!(car.state().speed, 3.0);
}

#[test]
fn slow_circles_have_the_radius_of_the_bicycle() {
    let size = VehicleKind::TouringCar.size();
    for (steering, speed) in [(0.2_f64, 0.3), (-0.4, 0.2), (0.3, -0.25)] {
        let mut car = started(plain_car(), 0.0);
        car.command(&command(0.0, speed, steering, 0.0));
        car.advance_to(at(1.0));
        let (start, radius) = (car.state(), size.wheelbase / steering.tan());
        let middle = start.world_from_base.transform_point(&Vector2::new(0.0, radius));
        for seconds in [1.7, 3.0, 4.5] {
            car.advance_to(at(seconds));
            let reached = (car.state().world_from_base.position() - middle).norm();
            assert!((reached - radius.abs()).abs() < 1e-6, "{reached} {radius}");
        }
        let turned = car.state().world_from_base.heading - start.world_from_base.heading;
        assert!((turned - speed / radius * 3.5).abs() < 1e-6);
    }
}

#[test]
fn steering_is_trimmed_limited_and_takes_its_time() {
    let mut dynamics = plain_car();
    let DriveTrain::Ackermann(car) = &mut dynamics.drive else { unreachable!() };
    (car.steering.trim, car.steering.max_rate) = (0.05, 2.0);
    let mut car = started(dynamics, 0.0);
    car.command(&command(0.0, 0.0, 0.25, 0.0));
    car.advance_to(at(0.1));
    assert!((car.state().steering_angle - 0.2).abs() < 1e-9);
    car.advance_to(at(0.2));
    assert!((car.state().steering_angle - 0.3).abs() < 1e-9);
    car.command(&command(0.2, 0.0, -2.0, 0.0));
    car.advance_to(at(2.0));
    assert_eq!(car.state().steering_angle, -0.45);
    assert_eq!(car.state().world_from_base, Pose2::IDENTITY);
}

#[test]
fn a_fast_car_understeers_by_what_its_tyres_give() {
    let mut dynamics = plain_car();
    dynamics.friction = 0.3;
    let mut car = started(dynamics, 2.0);
    car.command(&command(-1.0, 2.0, 0.4, 0.0));
    car.advance_to(at(1.0));
    let across = car.state().yaw_rate * car.state().speed;
    assert!((across - 0.3 * GRAVITY).abs() < 1e-6, "{across}");
    // Linear tyres, below their limit: L + k v^2 instead of L.
    let DriveTrain::Ackermann(tyres) = &mut dynamics.drive else { unreachable!() };
    tyres.understeer = 0.02;
    dynamics.friction = 5.0;
    let mut car = started(dynamics, 2.0);
    car.command(&command(-1.0, 2.0, 0.2, 0.0));
    car.advance_to(at(1.0));
    let wheelbase = VehicleKind::TouringCar.size().wheelbase;
    let expected = 2.0 * 0.2_f64.tan() / (wheelbase + 0.02 * 4.0);
    assert!((car.state().yaw_rate - expected).abs() < 1e-6);
}

#[test]
fn motors_have_a_dead_band() {
    let mut dynamics = plain_car();
    let motor = dynamics.motor_mut();
    (motor.start_speed, motor.hold_speed) = (0.2, 0.1);
    let mut car = started(dynamics, 0.0);
    let mut speed_after = |seconds: f64, speed: f64| {
        car.command(&command(seconds, speed, 0.0, 0.0));
        car.advance_to(at(seconds + 1.0));
        car.state().speed
    };
    assert_eq!(speed_after(0.0, 0.19), 0.0);
    assert_eq!(speed_after(1.0, -0.19), 0.0);
    assert!((speed_after(2.0, 0.21) - 0.21).abs() < 1e-9);
    assert!((speed_after(3.0, 0.11) - 0.11).abs() < 1e-9);
    assert_eq!(speed_after(4.0, 0.09), 0.0);
    assert_eq!(speed_after(5.0, 0.15), 0.0);
    assert!((speed_after(6.0, -0.3) + 0.3).abs() < 1e-9);
}

#[test]
fn a_robot_turns_on_the_spot_and_keeps_its_curve_when_its_wheels_are_too_slow() {
    let mut robot = started(plain_robot(), 0.0);
    robot.command(&command(0.0, 0.0, 0.0, PI / 2.0));
    robot.advance_to(at(2.0));
    assert!(robot.state().world_from_base.position().norm() < 1e-9);
    assert!((robot.state().yaw_rate - PI / 2.0).abs() < 1e-6);
    // 1.6 m/s at the outer wheel is all it has, and enough grip for that
    let mut dynamics = plain_robot();
    dynamics.friction = 2.0;
    let mut robot = started(dynamics, 0.0);
    robot.command(&command(0.0, 2.0, 0.0, 4.0));
    robot.advance_to(at(3.0));
    let VehicleState { speed, yaw_rate, .. } = robot.state();
    let DriveTrain::Differential(wheels) = dynamics.drive else { unreachable!() };
    assert!((speed / yaw_rate - 0.5).abs() < 1e-6, "{speed} {yaw_rate}");
    assert!((speed + 0.5 * wheels.track * yaw_rate - 1.6).abs() < 1e-6);
    // the stronger right wheel turns it to the left
    let DriveTrain::Differential(wheels) = &mut dynamics.drive else { unreachable!() };
    wheels.mismatch = 0.1;
    let mut robot = started(dynamics, 0.0);
    robot.command(&command(0.0, 0.5, 0.0, 0.0));
    robot.advance_to(at(2.0));
    assert!(robot.state().world_from_base.heading > 0.1);
}

#[test]
fn commands_from_before_and_broken_ones() {
    let mut car = started(plain_car(), 0.0);
    car.command(&command(1.0, 0.5, 0.1, 0.0));
    car.command(&command(0.5, 2.0, 0.0, 0.0));
    car.advance_to(at(2.0));
    assert!((car.state().speed - 0.5).abs() < 1e-9);
    car.command(&command(2.0, f64::NAN, 0.3, 0.0));
    car.advance_to(at(3.0));
    assert_eq!((car.state().speed, car.state().steering_angle), (0.0, 0.1));
    let here = car.state();
    car.advance_to(at(2.5));
    assert_eq!((car.state(), car.time()), (here, at(3.0)));
}

#[test]
fn what_cannot_be_driven_with_is_named() {
    let mut dynamics = plain_car();
    dynamics.friction = f64::NAN;
    let error = Vehicle::new(dynamics, RADIUS, VehicleState::default(), Stamp::ZERO).unwrap_err();
    assert_eq!(error.to_string(), "vehicle dynamics: friction is NaN");
    let mut dynamics = plain_car();
    let DriveTrain::Ackermann(car) = &mut dynamics.drive else { unreachable!() };
    car.wheelbase = 0.0;
    assert_eq!(dynamics.check(), Err(DynamicsError::Parameter { name: "wheelbase", value: 0.0 }));
    dynamics = plain_robot();
    dynamics.motor_mut().max_speed = -1.0;
    assert!(dynamics.check().is_err());
    let lost = VehicleState { speed: f64::INFINITY, ..VehicleState::default() };
    let error = Vehicle::new(plain_car(), RADIUS, lost, Stamp::ZERO).unwrap_err();
    assert_eq!(error, DynamicsError::Start);
    for kind in VehicleKind::ALL {
        VehicleDynamics::of(kind).check().unwrap();
    }
}

#[test]
fn gaps_and_clearances() {
    let square = |x: f64, y: f64| {
        [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[a, b]| Vector2::new(x + a, y + b))
    };
    assert_eq!(clearance(&square(0.0, 0.0), &square(3.0, 0.5)), 2.0);
    assert_eq!(clearance(&square(0.0, 0.0), &square(4.0, 5.0)), 5.0);
    assert_eq!(clearance(&square(0.0, 0.0), &square(0.9, 0.9)), 0.0);
    // one inside the other
    let point = |x: f64, y: f64| [Vector2::new(x, y); 3];
    assert_eq!(clearance(&square(0.0, 0.0), &point(0.5, 0.5)), 0.0);
    assert_eq!(clearance(&square(0.0, 0.0), &[]), f64::INFINITY);
    let size = VehicleKind::TouringCar.size();
    let gap = |pose| gap_ahead(&pose, &size, &square(2.0, -0.5));
    assert!((gap(Pose2::IDENTITY) - (2.0 - size.front())).abs() < 1e-12);
    assert_eq!(gap(Pose2::new(2.0, 0.0, 0.0)), 0.0);
    // from the side: the line to the middle meets the left edge 0.25 m above it
    let beside = Pose2::new(1.5 - size.front(), 0.5, 0.0);
    assert!((gap(beside) - 0.5_f64.hypot(0.25)).abs() < 1e-12, "{}", gap(beside));
}

fn any_dynamics() -> impl Strategy<Value = VehicleDynamics> {
    (0..4usize, 0.1..1.5f64, 0.0..0.2f64, 0.0..0.3f64, 0.7..1.3f64).prop_map(
        |(kind, friction, dead_time_s, lag_s, gain)| {
            let mut dynamics = VehicleDynamics::of(VehicleKind::ALL[kind]);
            (dynamics.friction, dynamics.dead_time_s) = (friction, dead_time_s);
            (dynamics.motor_mut().lag_s, dynamics.motor_mut().gain) = (lag_s, gain);
            dynamics
        },
    )
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![8 => -3.0..3.0f64, 1 => any::<f64>(), 1 => Just(f64::NAN)]
}

fn any_commands() -> impl Strategy<Value = Vec<DriveCommand>> {
    prop::collection::vec((0.0..1.0f64, any_number(), any_number(), any_number()), 1..12)
        .prop_map(|all| all.into_iter().map(|(t, v, s, w)| command(t, v, s, w)).collect())
}

/// A regular polygon.
fn polygon((corners, x, y, radius, turn): (usize, f64, f64, f64, f64)) -> Vec<Vector2<f64>> {
    let angle = |i: usize| turn + 2.0 * PI * i as f64 / corners as f64;
    (0..corners)
        .map(|i| Vector2::new(x, y) + radius * Vector2::new(angle(i).cos(), angle(i).sin()))
        .collect()
}

fn any_polygon() -> impl Strategy<Value = Vec<Vector2<f64>>> {
    (3..7usize, -2.0..2.0f64, -2.0..2.0f64, 0.1..1.2f64, 0.0..6.3f64).prop_map(polygon)
}

proptest! {
    #[test]
    fn nothing_breaks_the_limits_of_friction_and_motor(
        dynamics in any_dynamics(), commands in any_commands(),
    ) {
        let mut vehicle = started(dynamics, 0.0);
        commands.iter().for_each(|command| vehicle.command(command));
        let grip = dynamics.friction * GRAVITY;
        let most = dynamics.motor().max_speed;
        let mut before = vehicle.state();
        for millisecond in 1..1500 {
            vehicle.advance_to(Stamp::from_nanos(millisecond * 1_000_000));
            let now = vehicle.state();
            let pose = now.world_from_base;
            let all = [pose.x, pose.y, pose.heading, now.speed, now.yaw_rate, now.wheel_angle];
            prop_assert!(all.iter().all(|number| number.is_finite()), "{now:?}");
            prop_assert!(now.speed.abs() <= most * (1.0 + 1e-9));
            let along = (now.speed - before.speed) / 1e-3;
            let turned = (pose.heading - before.world_from_base.heading) / 1e-3;
            let across = turned * 0.5 * (now.speed + before.speed);
            prop_assert!(along.hypot(across) <= grip * (1.0 + 1e-6), "{along} {across} {grip}");
            // One wheel of a robot may brake while the other one speeds up.
            let is_robot = matches!(dynamics.drive, DriveTrain::Differential(_));
            let brakes = now.speed.abs() < before.speed.abs() || now.speed * before.speed < 0.0;
            let limits = dynamics.motor();
            let limit = if is_robot || brakes { limits.max_braking } else { limits.max_acceleration };
            prop_assert!(along.abs() <= limit + 1e-6, "{along}");
            before = now;
        }
    }

    #[test]
    fn how_often_it_is_looked_at_changes_nothing(
        dynamics in any_dynamics(), commands in any_commands(),
        looks in prop::collection::vec(0..1_000_000_000i64, 0..40),
    ) {
        let mut looks = looks;
        looks.sort_unstable();
        let mut often = started(dynamics, 0.3);
        let mut once = often.clone();
        commands.iter().for_each(|command| {
            often.command(command);
            once.command(command);
        });
        for look in looks {
            often.advance_to(Stamp::from_nanos(look));
            let state = often.state();
            prop_assert!(state.speed.is_finite());
        }
        often.advance_to(at(1.2));
        once.advance_to(at(1.2));
        prop_assert_eq!(often.state(), once.state());
    }

    #[test]
    fn clearance_is_the_least_distance_of_points(a in any_polygon(), b in any_polygon()) {
        let reported = clearance(&a, &b);
        prop_assert!((reported - clearance(&b, &a)).abs() < 1e-12);
        // Points all along the sides.
        let dense = |polygon: &[Vector2<f64>]| -> Vec<Vector2<f64>> {
            let next = polygon.iter().cycle().skip(1);
            polygon.iter().zip(next).flat_map(|(from, to)| {
                (0..50).map(move |i| from + (to - from) * (f64::from(i) / 50.0))
            }).collect()
        };
        let (points_a, points_b) = (dense(&a), dense(&b));
        let least = points_a.iter().flat_map(|p| points_b.iter().map(move |q| (p - q).norm()))
            .fold(f64::INFINITY, f64::min);
        // Sides are at most 2.1 m long, so points are at most 0.042 m apart.
        prop_assert!(reported <= least + 1e-12);
        prop_assert!(reported == 0.0 || reported > least - 0.043, "{reported} {least}");
    }
}
