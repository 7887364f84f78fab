//! What fails.

use super::StopRule;
use super::draft::Draft;
use super::driving::{ahead, stops};
use crate::perception::{ChannelFault, DepthFault, Window};
use crate::scene::LightChange;
use realnet_core::StopReason;

pub(super) fn no_target(draft: &mut Draft) {
    let expect = &mut draft.setup.expectations;
    expect.tracks_at_end = false;
    expect.min_way_m = 0.0;
    expect.max_way_m = Some(0.0);
    expect.stops.extend(stops(StopReason::NoTarget, 0.0, 1.0, f64::INFINITY));
}

pub(super) fn slow_depth(draft: &mut Draft) {
    ahead(draft, 0.5);
    draft.setup.depth.rate_hz = 1.0;
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.12);
    expect.max_lateral_rmse_m = Some(0.1);
}

pub(super) fn depth_lost(draft: &mut Draft) {
    ahead(draft, 0.5);
    let from_s = draft.between(3.5, 4.5);
    let faults = &mut draft.setup.depth.channel.faults;
    faults.push(Window::new(from_s, from_s + 4.0, ChannelFault::Loss(1.0)));
    draft.setup.expectations.max_lateral_rmse_m = Some(0.1);
}

pub(super) fn wrong_scale(draft: &mut Draft) {
    ahead(draft, 0.5);
    let factor = if draft.side() > 0.0 { 4.0 / 3.0 } else { 2.0 / 3.0 };
    draft.setup.depth.faults.push(Window::always(DepthFault::Scale(factor)));
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.4);
    expect.max_lateral_rmse_m = Some(0.1);
}

pub(super) fn detections_lost(draft: &mut Draft) {
    ahead(draft, 0.5);
    let from_s = draft.between(3.5, 4.5);
    let faults = &mut draft.setup.detector.channel.faults;
    faults.push(Window::new(from_s, from_s + 2.0, ChannelFault::Loss(1.0)));
    let expect = &mut draft.setup.expectations;
    expect.max_lateral_rmse_m = Some(0.15);
    expect.min_tracked_share = Some(0.6);
}

pub(super) fn poor_detector(draft: &mut Draft) {
    ahead(draft, 0.5);
    let detector = &mut draft.setup.detector;
    (detector.miss, detector.false_positives) = (0.25, 0.15);
    (detector.edge_noise, detector.edge_noise_px) = (0.04, 1.5);
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.15);
    expect.max_lateral_rmse_m = Some(0.15);
    expect.min_tracked_share = Some(0.85);
}

pub(super) fn swapped_messages(draft: &mut Draft) {
    ahead(draft, 0.5);
    let detections = &mut draft.setup.detector.channel;
    (detections.loss, detections.duplication) = (0.1, 0.2);
    detections.faults.push(Window::always(ChannelFault::Scatter(0.15)));
    let maps = &mut draft.setup.depth.channel;
    (maps.loss, maps.duplication) = (0.1, 0.2);
    maps.faults.push(Window::always(ChannelFault::Scatter(0.6)));
    let expect = &mut draft.setup.expectations;
    expect.max_gap_rmse_m = Some(0.15);
    expect.max_lateral_rmse_m = Some(0.12);
    expect.min_tracked_share = Some(0.85);
}

pub(super) fn emergency_stop(draft: &mut Draft) {
    ahead(draft, 0.5);
    let from_s = draft.between(4.5, 5.5);
    let until_s = from_s + 1.5;
    draft.setup.stop_requests.push(Window::new(from_s, until_s, ()));
    // The target drives on meanwhile, out of a car's reach for a while.
    let rules = &mut draft.setup.expectations.stops;
    rules.extend(stops(StopReason::Requested, from_s, 0.05, until_s - 0.02));
    rules.push(StopRule::Stands { from_s: from_s + 0.5, until_s: until_s - 0.02 });
}

pub(super) fn blackout(draft: &mut Draft) {
    ahead(draft, 0.5);
    let outage_s = draft.between(4.0, 4.5);
    draft.setup.camera.outages.push(Window::new(outage_s, outage_s + 1.0, ()));
    let dark_s = draft.between(7.8, 8.2);
    draft.setup.scene.light_changes.push(LightChange { time_s: dark_s, factor: 0.0 });
    draft.setup.depth.faults.push(Window::new(dark_s, f64::INFINITY, DepthFault::Blind));
    // The last valid input is a frame before the outage, and the last look at the
    // target one before the dark.
    let coasting_s = draft.setup.control.lost.stop_after_s;
    let expect = &mut draft.setup.expectations;
    expect.stops.extend(stops(StopReason::StaleInput, outage_s, 0.2, outage_s + 0.95));
    expect.stops.extend(stops(StopReason::TargetLost, dark_s, coasting_s + 0.2, f64::INFINITY));
    expect.tracks_at_end = false;
    expect.min_tracked_share = None;
}
