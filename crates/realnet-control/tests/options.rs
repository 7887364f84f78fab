//! Options that cannot be worked with are named with their value.
#![allow(missing_docs, clippy::unwrap_used)]

use realnet_control::{ControlOptions, Controller, Drive, Governor, Search, VehicleOptions};

type Change = fn(&mut ControlOptions, f64);

/// Every option that is a number, and values it must refuse besides those that are not
/// finite.
const OPTIONS: &[(&str, Change, &[f64])] = &[
    ("vehicle.front_m", |o, v| o.vehicle.front_m = v, &[-0.1]),
    ("vehicle.max_speed_m_s", |o, v| o.vehicle.max_speed_m_s = v, &[0.0, -1.0]),
    ("vehicle.max_reverse_speed_m_s", |o, v| o.vehicle.max_reverse_speed_m_s = v, &[-0.1]),
    ("vehicle.max_acceleration_m_s2", |o, v| o.vehicle.max_acceleration_m_s2 = v, &[0.0]),
    ("vehicle.max_deceleration_m_s2", |o, v| o.vehicle.max_deceleration_m_s2 = v, &[0.0, -4.0]),
    ("vehicle.dead_band.min_speed_m_s", |o, v| o.vehicle.dead_band.min_speed_m_s = v, &[-0.1, 2.0]),
    ("vehicle.dead_band.start_share", |o, v| o.vehicle.dead_band.start_share = v, &[0.0, 1.1]),
    ("vehicle.dead_band.stop_share", |o, v| o.vehicle.dead_band.stop_share = v, &[-0.1, 1.1]),
    ("vehicle.dead_band.stand_s", |o, v| o.vehicle.dead_band.stand_s = v, &[-0.1]),
    ("vehicle.dead_time_s", |o, v| o.vehicle.dead_time_s = v, &[-0.1, 3.0]),
    ("vehicle.speed_lag_s", |o, v| o.vehicle.speed_lag_s = v, &[-0.1, 3.0]),
    ("vehicle.steering_lag_s", |o, v| o.vehicle.steering_lag_s = v, &[-0.1, 3.0]),
    ("vehicle.steering_trim_rad", |o, v| o.vehicle.steering_trim_rad = v, &[0.3, -0.3]),
    ("vehicle.lag_compensation", |o, v| o.vehicle.lag_compensation = v, &[-0.1, 4.0]),
    ("vehicle.drive.wheelbase_m", |o, v| car(o, v, 0.42, 4.0), &[0.0]),
    ("vehicle.drive.max_steering_rad", |o, v| car(o, 0.26, v, 4.0), &[0.0, 1.6]),
    ("vehicle.drive.max_steering_rate_rad_s", |o, v| car(o, 0.26, 0.42, v), &[0.0]),
    ("vehicle.drive.track_m", |o, v| robot(o, v, 1.0, 3.0, 12.0), &[0.0]),
    ("vehicle.drive.max_wheel_speed_m_s", |o, v| robot(o, 0.2, v, 3.0, 12.0), &[0.0, 0.1]),
    ("vehicle.drive.max_yaw_rate_rad_s", |o, v| robot(o, 0.2, 1.0, v, 12.0), &[0.0]),
    ("vehicle.drive.max_yaw_acceleration_rad_s2", |o, v| robot(o, 0.2, 1.0, 3.0, v), &[0.0]),
    ("pursuit.min_lookahead_m", |o, v| o.pursuit.min_lookahead_m = v, &[0.0, 1e4]),
    ("pursuit.lookahead_s", |o, v| o.pursuit.lookahead_s = v, &[-0.1]),
    ("pursuit.max_lookahead_m", |o, v| o.pursuit.max_lookahead_m = v, &[0.1]),
    ("pursuit.max_trail_jump_m", |o, v| o.pursuit.max_trail_jump_m = v, &[0.0]),
    ("pursuit.facing_gain", |o, v| o.pursuit.facing_gain = v, &[-1.0]),
    ("pursuit.facing_until_m_s", |o, v| o.pursuit.facing_until_m_s = v, &[0.0]),
    ("speed.gap_m", |o, v| o.speed.gap_m = v, &[0.0, 0.35]),
    ("speed.headway_s", |o, v| o.speed.headway_s = v, &[-0.1]),
    ("speed.kp", |o, v| o.speed.kp = v, &[-0.1]),
    ("speed.ki", |o, v| o.speed.ki = v, &[-0.1]),
    ("speed.kd", |o, v| o.speed.kd = v, &[-0.1]),
    ("speed.smoothing_s", |o, v| o.speed.smoothing_s = v, &[-0.1]),
    ("speed.max_integral_m_s", |o, v| o.speed.max_integral_m_s = v, &[-0.1]),
    ("speed.integral_band_m", |o, v| o.speed.integral_band_m = v, &[-0.1]),
    ("speed.restart_error_m", |o, v| o.speed.restart_error_m = v, &[-0.1]),
    ("speed.restart_speed_m_s", |o, v| o.speed.restart_speed_m_s = v, &[-0.1]),
    (
        "speed.max_lateral_acceleration_m_s2",
        |o, v| o.speed.max_lateral_acceleration_m_s2 = v,
        &[0.0],
    ),
    ("speed.target_deceleration_m_s2", |o, v| o.speed.target_deceleration_m_s2 = v, &[0.0]),
    ("speed.brake_share", |o, v| o.speed.brake_share = v, &[0.0, 1.1]),
    ("speed.perception_latency_s", |o, v| o.speed.perception_latency_s = v, &[-0.1]),
    ("speed.range_sigmas", |o, v| o.speed.range_sigmas = v, &[-0.1]),
    ("speed.speed_sigmas", |o, v| o.speed.speed_sigmas = v, &[-0.1]),
    ("lost.coast_after_s", |o, v| o.lost.coast_after_s = v, &[-0.1]),
    ("lost.slow_after_s", |o, v| o.lost.slow_after_s = v, &[0.1]),
    ("lost.stop_after_s", |o, v| o.lost.stop_after_s = v, &[0.1]),
    ("lost.search_after_s", |o, v| o.lost.search_after_s = v, &[0.1]),
    ("lost.search_until_s", |o, v| o.lost.search_until_s = v, &[0.1]),
    (
        "lost.search.yaw_rate_rad_s",
        |o, v| o.lost.search = Search::Turn { yaw_rate_rad_s: v },
        &[0.0, -1.0],
    ),
    ("governor.stopping_radius_m", |o, v| o.governor.stopping_radius_m = v, &[-0.1]),
    ("governor.restart_margin_m", |o, v| o.governor.restart_margin_m = v, &[-0.1]),
    ("governor.stale_after_s", |o, v| o.governor.stale_after_s = v, &[0.0]),
    ("governor.max_relative_std", |o, v| o.governor.max_relative_std = v, &[0.0]),
];

fn car(options: &mut ControlOptions, wheelbase_m: f64, max_steering_rad: f64, rate: f64) {
    let max_steering_rate_rad_s = rate;
    options.vehicle.drive =
        Drive::Ackermann { wheelbase_m, max_steering_rad, max_steering_rate_rad_s };
}

fn robot(options: &mut ControlOptions, track_m: f64, wheel: f64, yaw: f64, acceleration: f64) {
    options.vehicle.drive = Drive::Differential {
        track_m,
        max_wheel_speed_m_s: wheel,
        max_yaw_rate_rad_s: yaw,
        max_yaw_acceleration_rad_s2: acceleration,
    };
}

#[test]
fn each_bad_option_is_named_with_its_value() {
    for (name, change, bad) in OPTIONS {
        let never = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300];
        for value in bad.iter().copied().chain(never) {
            let mut options = ControlOptions::default();
            change(&mut options, value);
            let error = Controller::new(options).unwrap_err();
            assert_eq!(error.name, *name, "{error}");
            assert!(error.value == value || value.is_nan(), "{error}");
            assert!(error.to_string().starts_with(&format!("{name} is {value}, it must be ")));
            assert_eq!(Governor::new(&options).unwrap_err().name, *name);
        }
    }
}

#[test]
fn the_defaults_are_options() {
    assert!(ControlOptions::default().check().is_ok());
    let robot = ControlOptions { vehicle: VehicleOptions::robot(), ..Default::default() };
    assert!(robot.check().is_ok());
    let mut trimmed = robot;
    trimmed.vehicle.steering_trim_rad = 0.01;
    assert_eq!(trimmed.check().unwrap_err().name, "vehicle.steering_trim_rad");
}
