//! What the target does, and who follows it.

use super::StopRule;
use super::draft::Draft;
use crate::VehicleKind;
use crate::dynamics::DriveTrain;
use crate::scene::SceneKind;
use crate::traffic::{Route, SpeedProfile};
use realnet_core::{Pose2, StopReason};
use std::f64::consts::PI;

/// Stands for a second, then goes on at a speed.
pub(super) fn starting(speed: f64) -> SpeedProfile {
    SpeedProfile::constant(0.0).hold(1.0).change(speed, 0.7)
}

/// A target that drives ahead with a slight bend, for scenarios that are about
/// something else.
pub(super) fn ahead(draft: &mut Draft, speed: f64) {
    let (kind, speed, side) = (draft.any_car(), draft.about(speed), draft.side());
    let offset = side * draft.between(0.2, 0.5);
    let route = Route::new(Pose2::IDENTITY).straight(1.0).lane_change(offset, 3.5);
    draft.target(kind, route, starting(speed));
    let expect = &mut draft.setup.expectations;
    expect.min_way_m = 0.6 * speed * (draft.setup.duration_s - 2.0);
    expect.min_tracked_share = Some(0.9);
}

pub(super) fn steady(draft: &mut Draft) {
    ahead(draft, 0.5);
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.05);
    expect.max_lateral_rmse_m = Some(0.05);
    expect.min_tracked_share = Some(0.95);
    expect.stops.push(StopRule::None { from_s: 3.0, until_s: f64::INFINITY });
}

pub(super) fn curves(draft: &mut Draft) {
    let (kind, speed) = (draft.any_car(), draft.about(0.5));
    let route = draft.wander(7.0, 0.5, 2.5);
    draft.target(kind, route, starting(speed));
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.12);
    expect.max_lateral_rmse_m = Some(0.08);
    expect.min_tracked_share = Some(0.95);
    expect.stops.push(StopRule::None { from_s: 3.0, until_s: f64::INFINITY });
}

pub(super) fn stopped_ahead(draft: &mut Draft) {
    let kind = draft.any_car();
    draft.start_gap = draft.between(1.2, 2.0);
    draft.target(kind, Route::new(Pose2::IDENTITY).straight(0.5), SpeedProfile::constant(0.0));
    let expect = &mut draft.setup.expectations;
    expect.max_final_gap_error_m = Some(0.15);
    expect.min_tracked_share = Some(0.9);
}

pub(super) fn stop_and_go(draft: &mut Draft) {
    let (kind, speed, side) = (draft.any_car(), draft.about(0.6), draft.side());
    let route = Route::new(Pose2::IDENTITY).straight(1.5).lane_change(0.3 * side, 3.0);
    let profile = starting(speed)
        .hold(draft.between(1.8, 2.2))
        .change(0.0, 1.2)
        .hold(draft.between(1.2, 1.8))
        .change(speed, 0.9)
        .hold(draft.between(1.8, 2.2))
        .change(0.0, 1.2)
        .hold(0.8)
        .change(speed, 0.9);
    draft.target(kind, route, profile);
    let expect = &mut draft.setup.expectations;
    expect.settle_s = 4.0;
    expect.max_gap_rmse_m = Some(0.2);
    expect.max_lateral_rmse_m = Some(0.08);
    expect.min_tracked_share = Some(0.95);
}

pub(super) fn hard_braking(draft: &mut Draft) {
    let (kind, speed) = (draft.any_car(), draft.about(0.9));
    let brakes_at = draft.between(5.0, 5.5);
    let start = starting(speed);
    let drives = brakes_at - start.changes_until();
    let route = Route::new(Pose2::IDENTITY).straight(5.0);
    draft.target(kind, route, start.hold(drives).change(0.0, 4.0));
    let expect = &mut draft.setup.expectations;
    // It cannot back up again after a stop that took its reaction time longer.
    expect.max_final_gap_error_m = Some(0.35);
    expect.min_tracked_share = Some(0.95);
    expect.min_way_m = 2.0;
}

pub(super) fn slalom(draft: &mut Draft) {
    let (kind, speed, side) = (draft.any_car(), draft.about(0.5), draft.side());
    draft.gap(0.8);
    let (peak, length) = (draft.about(0.9) * side, draft.between(2.3, 2.7));
    let route = Route::new(Pose2::IDENTITY).straight(0.5).slalom(peak, length, 2);
    draft.target(kind, route, starting(speed));
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.1);
    expect.max_lateral_rmse_m = Some(0.1);
    expect.min_tracked_share = Some(0.95);
}

pub(super) fn tight_turns(draft: &mut Draft) {
    let (kind, speed, side) = (draft.any_car(), draft.about(0.42), draft.side());
    draft.gap(0.6);
    draft.wide_camera();
    let route = Route::new(Pose2::IDENTITY)
        .straight(0.4)
        .turn(0.87 * side, 0.8 * PI, 0.4)
        .straight(0.2)
        .turn(-0.87 * side, 0.8 * PI, 0.4);
    draft.target(kind, route, starting(speed));
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.12);
    expect.max_lateral_rmse_m = Some(0.15);
    expect.min_tracked_share = Some(0.9);
}

pub(super) fn figure_eight(draft: &mut Draft) {
    let (kind, side) = (draft.any_car(), draft.side());
    let speed = draft.about(0.9);
    draft.gap(0.65);
    draft.wide_camera();
    draft.setup.scene.kind = SceneKind::Hall;
    let curvature = side * draft.between(0.75, 0.88);
    let route = Route::new(Pose2::IDENTITY).straight(0.5).turn(curvature, 1.9 * PI, 0.5).turn(
        -curvature,
        1.9 * PI,
        0.5,
    );
    draft.target(kind, route, starting(speed));
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.15);
    expect.max_lateral_rmse_m = Some(0.15);
    expect.min_tracked_share = Some(0.9);
}

pub(super) fn backwards(draft: &mut Draft) {
    let (kind, speed) = (draft.any_car(), draft.about(0.5));
    // From a gap of 1 m: about half of it is left.
    let (back, way) = (draft.about(0.25), draft.between(0.4, 0.55));
    let route = Route::new(Pose2::IDENTITY).straight(4.0);
    let profile = starting(speed)
        .hold(2.0)
        .change(0.0, 1.0)
        .hold(0.7)
        .change(-back, 0.6)
        .hold(way / back - back / 0.6)
        .change(0.0, 0.6)
        .hold(0.8)
        .change(speed, 0.7);
    draft.target(kind, route, profile);
    let expect = &mut draft.setup.expectations;
    expect.min_tracked_share = Some(0.9);
    expect.max_lateral_rmse_m = Some(0.1);
    expect.min_way_m = 1.5;
}

pub(super) fn fast(draft: &mut Draft) {
    let (kind, speed) = (draft.any_car(), draft.about(1.15));
    draft.gap(1.2);
    let hall = draft.side() > 0.0;
    draft.setup.scene.kind = if hall { SceneKind::Hall } else { SceneKind::Track };
    let route = draft.wander(10.0, 0.35, 5.0);
    draft.target(kind, route, starting(speed));
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.15);
    expect.max_lateral_rmse_m = Some(0.15);
    expect.min_tracked_share = Some(0.9);
    expect.min_way_m = 4.0;
}

pub(super) fn leaves_view(draft: &mut Draft) {
    // Off to one side on a small circle, out of sight; around, and back across the
    // picture, farther ahead; then on.
    let (speed, side) = (draft.between(0.75, 0.9), draft.side());
    let (tight, away) = (side / 0.38, draft.between(0.9, 1.2));
    let route = Route::new(Pose2::IDENTITY)
        .straight(1.8)
        .turn(tight, 0.5 * PI, 0.15)
        .straight(away)
        .turn(-tight, PI, 0.15)
        .straight(away)
        .turn(tight, 0.5 * PI, 0.15)
        .straight(1.0);
    let slower = 0.5 * speed;
    let until_back = route.length() - 1.0;
    let start = starting(speed);
    let rest = (until_back - start.way(start.changes_until())) / speed;
    draft.target(VehicleKind::Buggy, route, start.hold(rest).change(slower, 0.7));
    let expect = &mut draft.setup.expectations;
    expect.min_way_m = 1.0;
    // It crosses the picture and is gone again: a car cannot turn on the spot after it.
    expect.tracks_at_end = false;
    expect.regains_for_s = Some(0.5);
}

pub(super) fn robot(draft: &mut Draft) {
    let (kind, speed) = (draft.any_car(), draft.about(0.45));
    draft.follower(VehicleKind::Robot);
    let mismatch = draft.between(-0.04, 0.04);
    if let DriveTrain::Differential(robot) = &mut draft.setup.follower.dynamics.drive {
        robot.mismatch = mismatch;
    }
    let route = draft.wander(7.0, 0.6, 2.5);
    draft.target(kind, route, starting(speed));
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.1);
    expect.max_lateral_rmse_m = Some(0.1);
    expect.min_tracked_share = Some(0.95);
}

pub(super) fn worn_car(draft: &mut Draft) {
    let (kind, speed) = (draft.any_car(), draft.about(0.6));
    let (trim, gain) = (draft.side() * draft.between(0.04, 0.07), draft.between(0.8, 0.88));
    let friction = draft.between(0.3, 0.4);
    let dynamics = &mut draft.setup.follower.dynamics;
    dynamics.friction = friction;
    dynamics.dead_time_s *= 1.5;
    let motor = dynamics.motor_mut();
    (motor.gain, motor.lag_s) = (gain, 1.5 * motor.lag_s);
    (motor.start_speed, motor.hold_speed) = (0.16, 0.12);
    if let DriveTrain::Ackermann(car) = &mut dynamics.drive {
        car.steering.trim = trim;
    }
    let route = draft.wander(7.0, 0.5, 3.0);
    draft.target(kind, route, starting(speed));
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.15);
    expect.max_lateral_rmse_m = Some(0.15);
    expect.min_tracked_share = Some(0.95);
}

/// A stop for a reason begins in time, and the speed commanded is 0 from then on.
pub(super) fn stops(reason: StopReason, from_s: f64, within_s: f64, until_s: f64) -> [StopRule; 2] {
    [
        StopRule::Begins { reason, from_s, until_s: from_s + within_s },
        StopRule::Commanded { from_s: from_s + within_s, until_s },
    ]
}
