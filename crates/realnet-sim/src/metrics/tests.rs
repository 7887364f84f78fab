use super::*;
use realnet_core::StopReason;

/// A frame that tracks a target 2 m ahead, 1 m off the bumper, with a range of
/// `fused` m; the network's is 2.4 m.
fn frame(index: usize, fused: f64) -> FrameLog {
    FrameLog {
        time_s: index as f64 / 10.0,
        range_true_m: Some(2.0),
        range_network_m: Some(2.4),
        network_age_s: Some(0.4),
        range_fused_m: Some(fused),
        range_fused_std_m: Some(0.1),
        status: TrackStatus::Tracking,
        gap_m: 1.0,
        clearance_m: 1.0,
        ..FrameLog::default()
    }
}

fn log(frames: impl IntoIterator<Item = FrameLog>) -> RunLog {
    RunLog { desired_gap_m: 1.0, frames: frames.into_iter().collect(), ..RunLog::default() }
}

#[track_caller]
fn close(found: Option<f64>, wanted: f64) {
    assert!(found.is_some_and(|v| (v - wanted).abs() < 1e-12), "{found:?} for {wanted}");
}

#[test]
fn a_run_without_frames_says_nothing() {
    let figures = RunFigures::from_log(&RunLog::default(), 1.0);
    assert_eq!(figures, RunFigures::default());
}

#[test]
fn ranges_against_the_truth() {
    let mut frames = [2.1, 1.8, 2.2, 2.0].map(|fused| frame(0, fused));
    for (frame, network) in frames.iter_mut().zip([None, Some(2.4), Some(2.4), Some(1.6)]) {
        frame.range_network_m = network;
    }
    let figures = RunFigures::from_log(&log(frames), 0.0);
    // |errors| 0.1, 0.2, 0.2, 0 of 2 m
    close(figures.tracked.abs_rel, 0.5 / 4.0 / 2.0);
    close(figures.tracked.bias, 0.1 / 4.0 / 2.0);
    // changes -0.3, 0.4, -0.2
    close(figures.tracked.jitter_m, (0.29f64 / 3.0).sqrt());
    assert_eq!((figures.tracked.frames, figures.tracked.pairs), (4, 3));
    // Without the first, where the network says nothing.
    close(figures.fused.abs_rel, 0.4 / 3.0 / 2.0);
    close(figures.fused.bias, 0.0);
    close(figures.fused.jitter_m, (0.2f64 / 2.0).sqrt());
    assert_eq!((figures.fused.frames, figures.fused.pairs), (3, 2));
    // 0.4, 0.4, -0.4; changes 0, -0.8
    close(figures.network.abs_rel, 0.2);
    close(figures.network.jitter_m, (0.64f64 / 2.0).sqrt());
    assert_eq!((figures.network.frames, figures.network.pairs), (3, 2));
    close(figures.network.known_share, 0.75);
    assert_eq!(figures.fast, CueFigures { known_share: Some(0.0), ..CueFigures::default() });
    // 0.2 is two deviations, rounding aside
    assert_eq!(figures.deviations, 4);
}

#[test]
fn what_is_left_over_from_before_a_loss_is_not_compared() {
    let ages = [0.4, HELD_S, HELD_S + 0.01, f64::NAN, 0.3];
    let frames = (0..).zip(ages).map(|(index, age)| FrameLog {
        network_age_s: Some(age),
        range_network_m: Some(if age <= HELD_S { 2.2 } else { 9.0 }),
        range_fast_m: Some(2.1),
        ..frame(index, if age <= HELD_S { 2.02 } else { 2.5 })
    });
    let figures = RunFigures::from_log(&log(frames), 0.0);
    for (cue, abs_rel) in [(figures.fused, 0.01), (figures.network, 0.1), (figures.fast, 0.05)] {
        assert_eq!((cue.frames, cue.pairs), (3, 1), "the same frames for all");
        close(cue.abs_rel, abs_rel);
    }
    close(figures.network.known_share, 3.0 / 5.0);
    // The filter has no excuse: all of its frames are judged somewhere.
    assert_eq!((figures.tracked.frames, figures.deviations), (5, 5));
    close(figures.tracked.abs_rel, (3.0 * 0.01 + 2.0 * 0.25) / 5.0);
}

#[test]
fn within_two_deviations_is_inclusive_and_needs_a_deviation() {
    let mut frames = [2.125, 2.25, 2.375, 2.0, 2.0].map(|fused| frame(0, fused));
    for frame in &mut frames {
        frame.range_fused_std_m = Some(0.125);
    }
    frames[3].range_fused_std_m = None;
    frames[4].range_fused_std_m = Some(f64::NAN);
    let figures = RunFigures::from_log(&log(frames), 0.0);
    assert_eq!(figures.deviations, 3);
    close(figures.within_two_std, 2.0 / 3.0);
}

#[test]
fn only_tracked_frames_count_for_ranges() {
    // Hidden, coasting, without a fused range, with a broken one: all far off.
    let hidden = FrameLog { range_true_m: None, ..frame(1, 9.0) };
    let coasting = FrameLog { status: TrackStatus::Coasting, ..frame(2, 9.0) };
    let silent = FrameLog { range_fused_m: None, range_network_m: Some(9.0), ..frame(3, 9.0) };
    let broken = FrameLog { range_network_m: Some(9.0), ..frame(4, f64::NAN) };
    let figures = RunFigures::from_log(
        &log([frame(0, 2.2), hidden, coasting, silent, broken, frame(5, 2.0)]),
        0.0,
    );
    close(figures.fused.abs_rel, 0.05);
    assert_eq!((figures.fused.frames, figures.fused.pairs), (2, 0), "the two are no neighbours");
    assert_eq!(figures.fused.jitter_m, None);
    assert_eq!(figures.network.frames, 2);
    close(figures.network.abs_rel, 0.2);
    // visible: all but the hidden one; fused there: 0, coasting, 5
    assert_eq!(figures.visible, 5);
    close(figures.fused.known_share, 3.0 / 5.0);
    close(figures.network.known_share, 1.0);
    close(figures.tracked_share, 4.0 / 5.0);
}

#[test]
fn gap_and_side_count_once_settled() {
    let gaps = [(5.0, 9.0), (1.5, 0.3), (0.5, -0.1), (f64::INFINITY, f64::NAN)];
    let frames = (0..).zip(gaps).map(|(i, (gap_m, lateral_m))| FrameLog {
        gap_m,
        lateral_m,
        ..frame(i, 2.0)
    });
    let log = log(frames);
    let figures = RunFigures::from_log(&log, 0.1);
    close(figures.gap_rmse_m, 0.5);
    close(figures.lateral_rmse_m, (0.1f64 / 2.0).sqrt());
    let figures = RunFigures::from_log(&log, 0.0);
    close(figures.gap_rmse_m, (16.5f64 / 3.0).sqrt());
    let figures = RunFigures::from_log(&log, 60.0);
    assert_eq!((figures.gap_rmse_m, figures.lateral_rmse_m), (None, None));
    close(Some(figures.duration_s), 0.3);
}

#[test]
fn collisions_are_entries_into_contact() {
    let of = |clearances: &[f64]| {
        let frames =
            clearances.iter().map(|&clearance_m| FrameLog { clearance_m, ..frame(0, 2.0) });
        let figures = RunFigures::from_log(&log(frames), 0.0);
        (figures.collisions, figures.min_gap_m)
    };
    assert_eq!(of(&[1.0, 0.5, 0.7]), (0, Some(0.5)));
    assert_eq!(of(&[1.0, 0.0, -0.1, f64::NAN, -0.2, 0.1, -0.3]), (2, Some(-0.3)));
    assert_eq!(of(&[-1.0, 1.0]), (1, Some(-1.0)));
    assert_eq!(of(&[f64::INFINITY, f64::NAN]), (0, None));
}

#[test]
fn nothing_visible_means_no_share() {
    let frames = (0..5).map(|i| FrameLog {
        range_true_m: None,
        range_fused_m: None,
        range_network_m: None,
        status: TrackStatus::Searching,
        ..frame(i, 0.0)
    });
    let stop = StopLog { from_s: 0.0, until_s: None, reason: StopReason::NoTarget };
    let log = RunLog { stops: vec![stop], ..log(frames) };
    let figures = RunFigures::from_log(&log, 0.0);
    assert_eq!((figures.tracked_share, figures.within_two_std), (None, None));
    assert_eq!(figures.fused, CueFigures::default());
    assert_eq!(figures.stops, [stop]);
}

#[test]
fn pooled_runs_are_as_one() {
    let fused = [[2.1, 1.8, 2.2, 2.0], [2.3, 2.2, 1.9, 2.05]];
    let runs = fused.map(|values| values.map(|fused| frame(0, fused)));
    let apart = runs.map(|frames| RunFigures::from_log(&log(frames), 0.0).fused);
    // One run, with a hidden frame between the two so that no pair spans them.
    let hidden = FrameLog { range_true_m: None, ..frame(0, 0.0) };
    let together = log(runs[0].into_iter().chain([hidden]).chain(runs[1]));
    let together = RunFigures::from_log(&together, 0.0).fused;
    let pooled = CueFigures::pooled(&apart);
    assert_eq!((pooled.frames, pooled.pairs), (together.frames, together.pairs));
    close(pooled.abs_rel, together.abs_rel.unwrap());
    close(pooled.bias, together.bias.unwrap());
    close(pooled.jitter_m, together.jitter_m.unwrap());
    assert_eq!(CueFigures::pooled(&[]), CueFigures::default());
    let silent = CueFigures::default();
    assert_eq!(CueFigures::pooled([&silent, &apart[0]]).abs_rel, apart[0].abs_rel);
}
