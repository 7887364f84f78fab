//! Who else is there.

use super::draft::Draft;
use super::driving::starting;
use crate::VehicleKind;
use crate::traffic::{Route, ScriptedVehicle};
use realnet_core::Pose2;
use std::f64::consts::FRAC_PI_2;

pub(super) fn parked_cars(draft: &mut Draft) {
    let (kind, speed) = (draft.any_car(), draft.about(0.5));
    let route = Route::new(Pose2::IDENTITY).straight(5.0);
    draft.target(kind, route, starting(speed));
    let mut ahead = 0.9;
    for index in 0..5 {
        let side = if index % 2 == 0 { 1.0 } else { -1.0 };
        let place = Pose2::new(ahead, side * draft.between(0.5, 0.65), draft.between(-0.4, 0.4));
        let kind = draft.any_car();
        draft.passing(kind, place, 0.0, 0.0);
        ahead += draft.between(0.7, 0.9);
    }
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.12);
    expect.max_lateral_rmse_m = Some(0.08);
    expect.min_tracked_share = Some(0.95);
}

pub(super) fn crossing(draft: &mut Draft) {
    let (kind, speed) = (draft.any_car(), draft.about(0.5));
    let route = Route::new(Pose2::IDENTITY).straight(5.0);
    draft.target(kind, route, starting(speed));
    // Two cross behind the target as the camera sees it, one comes the other way.
    for time_s in [2.9, 6.8] {
        let (other, side) = (draft.any_car(), draft.side());
        let way = draft.between(0.9, 1.2);
        let ahead = draft.target_at(time_s).x + kind.size().front() + draft.between(0.7, 1.0);
        let place = Pose2::new(ahead, 0.0, -side * FRAC_PI_2);
        draft.passing(other, place, time_s, way);
    }
    let (kind, side) = (draft.any_car(), draft.side());
    let place = Pose2::new(draft.target_at(5.2).x, side * 0.65, std::f64::consts::PI);
    draft.passing(kind, place, 5.2, 0.6);
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.1);
    expect.max_lateral_rmse_m = Some(0.1);
    expect.min_tracked_share = Some(0.9);
}

pub(super) fn cut_in(draft: &mut Draft) {
    let (kind, speed, side) = (draft.any_car(), draft.about(0.5), draft.side());
    draft.gap(1.4);
    draft.target(kind, Route::new(Pose2::IDENTITY).straight(6.0), starting(speed));
    // It comes from behind, passes the follower, and drives beside the way as fast as
    // the target and a little behind it; moves over, stays, and leaves again.
    let other = VehicleKind::Buggy.size();
    let behind = kind.size().rear_overhang + draft.between(0.25, 0.35) + other.front();
    let (back, faster, change) = (1.2, 0.6, 0.7);
    let caught_up = faster * faster / change;
    let profile = starting(speed + faster).hold((back - caught_up) / faster).change(speed, change);
    let matched = profile.way(profile.changes_until());
    let (lane, over) = (0.6 * side, 1.3);
    let route = Route::new(Pose2::new(-behind - back, lane, 0.0))
        .straight(matched)
        .lane_change(-lane, over)
        .straight(0.5)
        .lane_change(lane, over)
        .straight(1.0);
    let car = ScriptedVehicle { kind: VehicleKind::Buggy, route, profile, start: 0.0 };
    draft.setup.others.push(car);
    draft.setup.expectations.min_way_m = 1.5;
}

pub(super) fn occlusion(draft: &mut Draft) {
    let (kind, speed) = (draft.any_car(), draft.about(0.4));
    draft.gap(1.5);
    draft.target(kind, Route::new(Pose2::IDENTITY).straight(4.0), starting(speed));
    for time_s in [4.0, 6.5] {
        let (other, side) = (draft.any_car(), draft.side());
        let (way, before) = (draft.between(1.0, 1.4), draft.between(0.4, 0.5));
        let ahead = draft.target_at(time_s).x - kind.size().rear_overhang - before;
        // Its middle is on the line at that time.
        let middle = 0.5 * other.size().length - other.size().rear_overhang;
        let place = Pose2::new(ahead, side * middle, -side * FRAC_PI_2);
        draft.passing(other, place, time_s, way);
    }
    let expect = &mut draft.setup.expectations;
    expect.min_way_m = 1.2;
}
