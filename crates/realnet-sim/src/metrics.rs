//! What a run comes to, in numbers.

use crate::{FrameLog, RunLog, StopLog};
use realnet_core::TrackStatus;

/// Longest time that a range of the network counts as held, from the exposure of its
/// frame, seconds: a network of 1 Hz that is 0.27 s late is held for up to 1.27 s.
/// What is older is no longer held between two maps, but left over from before the
/// maps or the target were lost.
pub const HELD_S: f64 = 1.5;

/// How well one source of ranges did.
///
/// Sources are judged on two sets of frames:
///
/// - *tracked frames*: the target is visible (its true range is known), the track's
///   status is [`TrackStatus::Tracking`] and there is a fused range;
/// - *compared frames*: tracked frames on which there is a range of the network that is
///   not older than [`HELD_S`] ([`FrameLog::network_age_s`]).
///
/// Sources that are compared are judged on the compared frames, all on the same ones,
/// so that a source gains nothing by keeping silent on the hard frames; `frames` says on
/// how many of them it spoke. The fused range and the network's speak on all of them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CueFigures {
    /// Frames of the set with a range of this source.
    pub frames: usize,
    /// Mean over these of |range - truth| / truth.
    pub abs_rel: Option<f64>,
    /// Mean over these of (range - truth) / truth: which way it errs.
    pub bias: Option<f64>,
    /// Pairs of frames, one following the other, that are both among these.
    pub pairs: usize,
    /// Root mean square over the pairs of the change of (range - truth) from the
    /// first frame to the second, metres.
    pub jitter_m: Option<f64>,
    /// Share of the frames with a visible target, of any status, with a range of
    /// this source, 0 to 1.
    pub known_share: Option<f64>,
}

/// The figures of a run. What cannot be said, since no frame says anything about
/// it, is `None`; a value is always finite. Frames whose value is not finite are left
/// out of the figure concerned.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunFigures {
    /// Exposure time of the last frame, seconds since the start.
    pub duration_s: f64,
    /// Camera frames.
    pub frames: usize,
    /// Frames where the target is visible.
    pub visible: usize,
    /// Root mean square over the frames from the settling time on of
    /// [`FrameLog::gap_m`] against [`RunLog::desired_gap_m`], metres.
    pub gap_rmse_m: Option<f64>,
    /// Root mean square over the frames from the settling time on of
    /// [`FrameLog::lateral_m`], metres.
    pub lateral_rmse_m: Option<f64>,
    /// The fused range, [`FrameLog::range_fused_m`], on the compared frames.
    pub fused: CueFigures,
    /// The network alone: its newest range that arrived, held until the next, for
    /// [`HELD_S`] at most ([`FrameLog::range_held_m`]); on the compared frames.
    pub network: CueFigures,
    /// The fast path alone, [`FrameLog::range_fast_m`], on the compared frames.
    pub fast: CueFigures,
    /// The fused range on all tracked frames, with those on which it has to do without
    /// the network.
    pub tracked: CueFigures,
    /// Tracked frames with a deviation of the fused range.
    pub deviations: usize,
    /// Share of these where the true range is at most two deviations from the fused
    /// one, 0 to 1.
    pub within_two_std: Option<f64>,
    /// Least [`FrameLog::clearance_m`] of all frames, metres.
    pub min_gap_m: Option<f64>,
    /// How often the clearance became 0 or less; a run that starts so has one.
    pub collisions: usize,
    /// Share of the frames with a visible target whose status is
    /// [`TrackStatus::Tracking`], 0 to 1.
    pub tracked_share: Option<f64>,
    /// The stops, as in [`RunLog::stops`].
    pub stops: Vec<StopLog>,
}

impl RunFigures {
    /// The figures of a run; gap and lateral deviation count from `settle_s` seconds
    /// after its start.
    #[must_use]
    pub fn from_log(log: &RunLog, settle_s: f64) -> Self {
        let frames = || log.frames.iter();
        let settled = || frames().filter(|frame| frame.time_s >= settle_s);
        let visible = frames().filter(|frame| truth(frame).is_some()).count();
        let tracked =
            frames().filter(|f| truth(f).is_some() && f.status == TrackStatus::Tracking).count();
        let (mut deviations, mut within) = (0, 0);
        for (frame, truth) in
            log.frames.iter().filter_map(|frame| Some((frame, tracked_truth(frame)?)))
        {
            let std = frame.range_fused_std_m.filter(|std| std.is_finite());
            if let (Some(range), Some(std)) = (frame.range_fused_m, std) {
                deviations += 1;
                within += usize::from((range - truth).abs() <= 2.0 * std);
            }
        }
        Self {
            duration_s: log.frames.last().map_or(0.0, |frame| frame.time_s),
            frames: log.frames.len(),
            visible,
            gap_rmse_m: rms(settled().map(|frame| frame.gap_m - log.desired_gap_m)),
            lateral_rmse_m: rms(settled().map(|frame| frame.lateral_m)),
            fused: CueFigures::of(log, compared_truth, |frame| frame.range_fused_m),
            network: CueFigures::of(log, compared_truth, FrameLog::range_held_m),
            fast: CueFigures::of(log, compared_truth, |frame| frame.range_fast_m),
            tracked: CueFigures::of(log, tracked_truth, |frame| frame.range_fused_m),
            deviations,
            within_two_std: share(within, deviations),
            min_gap_m: frames()
                .map(|frame| frame.clearance_m)
                .filter(|clearance| clearance.is_finite())
                .reduce(f64::min),
            collisions: collisions(&log.frames),
            tracked_share: share(tracked, visible),
            stops: log.stops.clone(),
        }
    }
}

impl FrameLog {
    /// The network's range for as long as it counts as held, [`HELD_S`].
    #[must_use]
    pub fn range_held_m(&self) -> Option<f64> {
        let age_s = self.network_age_s?;
        self.range_network_m.filter(|range| range.is_finite() && age_s <= HELD_S)
    }
}

impl CueFigures {
    /// On the frames where `judged` knows the true range.
    fn of(
        log: &RunLog,
        judged: impl Fn(&FrameLog) -> Option<f64>,
        range: impl Fn(&FrameLog) -> Option<f64>,
    ) -> Self {
        let range = |frame: &FrameLog| range(frame).filter(|range| range.is_finite());
        let error_and_truth = |frame: &FrameLog| {
            let truth = judged(frame)?;
            Some((range(frame)? - truth, truth))
        };
        let errors = || log.frames.iter().filter_map(error_and_truth);
        let visible = || log.frames.iter().filter(|frame| truth(frame).is_some());
        let error_of = |frame: &FrameLog| error_and_truth(frame).map(|(error, _)| error);
        let changes = || {
            log.frames
                .windows(2)
                .filter_map(|pair| Some(error_of(pair.get(1)?)? - error_of(pair.first()?)?))
        };
        Self {
            frames: errors().count(),
            abs_rel: mean(errors().map(|(error, truth)| error.abs() / truth)),
            bias: mean(errors().map(|(error, truth)| error / truth)),
            pairs: changes().count(),
            jitter_m: rms(changes()),
            known_share: share(visible().filter(|f| range(f).is_some()).count(), visible().count()),
        }
    }

    /// The figures of several runs as if they were one: each frame, each pair of
    /// frames counts the same. The shares of known frames are not pooled.
    #[must_use]
    pub fn pooled<'a>(runs: impl IntoIterator<Item = &'a Self>) -> Self {
        let mut pooled = Self::default();
        let (mut abs_rel, mut bias, mut square) = (0.0, 0.0, 0.0);
        for run in runs {
            pooled.frames += run.frames;
            pooled.pairs += run.pairs;
            abs_rel += run.abs_rel.unwrap_or(0.0) * run.frames as f64;
            bias += run.bias.unwrap_or(0.0) * run.frames as f64;
            square += run.jitter_m.unwrap_or(0.0).powi(2) * run.pairs as f64;
        }
        let over = |sum: f64, count: usize| (count > 0).then(|| sum / count as f64);
        pooled.abs_rel = over(abs_rel, pooled.frames);
        pooled.bias = over(bias, pooled.frames);
        pooled.jitter_m = over(square, pooled.pairs).map(f64::sqrt);
        pooled
    }
}

/// The true range of a visible target.
fn truth(frame: &FrameLog) -> Option<f64> {
    frame.range_true_m.filter(|range| range.is_finite() && *range > 0.0)
}

/// The true range on a tracked frame, see [`CueFigures`].
fn tracked_truth(frame: &FrameLog) -> Option<f64> {
    let fused = frame.range_fused_m.filter(|range| range.is_finite());
    truth(frame).filter(|_| frame.status == TrackStatus::Tracking && fused.is_some())
}

/// The true range on a compared frame, see [`CueFigures`].
fn compared_truth(frame: &FrameLog) -> Option<f64> {
    tracked_truth(frame).filter(|_| frame.range_held_m().is_some())
}

/// Entries into contact.
fn collisions(frames: &[FrameLog]) -> usize {
    let mut touching = false;
    let mut entries = 0;
    for frame in frames.iter().filter(|frame| !frame.clearance_m.is_nan()) {
        let touches = frame.clearance_m <= 0.0;
        entries += usize::from(touches && !touching);
        touching = touches;
    }
    entries
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0usize);
    for value in values.filter(|value| value.is_finite()) {
        sum += value;
        count += 1;
    }
    (count > 0).then(|| sum / count as f64)
}

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    mean(values.map(|value| value * value)).map(f64::sqrt)
}

fn share(part: usize, all: usize) -> Option<f64> {
    (all > 0).then(|| part as f64 / all as f64)
}

#[cfg(test)]
mod tests;
