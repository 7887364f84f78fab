//! What is shown of a run over time, and how late things came.

use super::chart::{Chart, TIME};
use crate::cli::sim::table::{number, percent};
use realnet_core::TrackStatus;
use realnet_sim::{FrameLog, RunFigures, RunLog};

/// All charts of a run.
pub(super) struct Plots<'a> {
    log: &'a RunLog,
    figures: &'a RunFigures,
    span: (f64, f64),
    /// When the target was not tracked.
    untracked: Vec<(f64, f64)>,
}

impl<'a> Plots<'a> {
    pub(super) fn new(log: &'a RunLog, figures: &'a RunFigures) -> Self {
        let untracked = periods(log, |frame| (frame.status != TrackStatus::Tracking).then_some(()));
        let untracked = untracked.into_iter().map(|(from, to, ())| (from, to)).collect();
        Self { log, figures, span: span(log), untracked }
    }

    /// Range over time, as in the paper's filter figures.
    pub(super) fn range(&self) -> String {
        let arrivals = self.log.depth_maps.iter().map(|map| map.arrived_s).collect();
        let measured = self.log.depth_maps.iter();
        let measured = measured.filter_map(|map| Some((map.time_s, map.range_m?))).collect();
        self.over_time("Range over time", "m")
            .band(
                "fused, two deviations",
                "fused",
                self.of(|f| {
                    let (range, std) = (f.range_fused_m?, f.range_fused_std_m?);
                    Some((range - 2.0 * std, range + 2.0 * std))
                }),
            )
            .line("network, held", "network", "thin", self.of(FrameLog::range_held_m))
            .line("fast", "fast", "thin", self.of(|f| f.range_fast_m))
            .line("fused", "fused", "", self.of(|f| f.range_fused_m))
            .line("truth", "truth", "dashed", self.of(|f| f.range_true_m))
            .rings("map, at its exposure", "network", measured)
            .ticks("map arrives", "network", arrivals)
            .height(320.0)
            .html()
    }

    /// Error of the ranges over time.
    pub(super) fn error(&self) -> String {
        let error = |range: fn(&FrameLog) -> Option<f64>| {
            self.of(move |f| Some(range(f)? - f.range_true_m?))
        };
        let note = format!(
            "While tracked, with a range of the network: fused off by {} % ({} mm of jitter), the network’s held range by {} % \
             ({} mm); the truth is within two deviations on {} % of the frames.",
            percent(self.figures.fused.abs_rel, 2),
            number(self.figures.fused.jitter_m.map(|m| 1e3 * m), 1),
            percent(self.figures.network.abs_rel, 2),
            number(self.figures.network.jitter_m.map(|m| 1e3 * m), 1),
            percent(self.figures.within_two_std, 1),
        );
        self.over_time("Error against the truth", "range − truth, m")
            .band(
                "two deviations",
                "fused",
                self.of(|f| {
                    f.range_true_m?;
                    let std = f.range_fused_std_m?;
                    Some((-2.0 * std, 2.0 * std))
                }),
            )
            .line("network, held", "network", "thin", error(FrameLog::range_held_m))
            .line("fast", "fast", "thin", error(|f| f.range_fast_m))
            .line("fused", "fused", "", error(|f| f.range_fused_m))
            .reaching(0.0)
            .note(note)
            .html()
    }

    /// Gap and clearance over time.
    pub(super) fn gap(&self) -> String {
        let desired = self.log.desired_gap_m;
        let worst = self.log.frames.iter().filter(|f| f.clearance_m.is_finite());
        let worst = worst.min_by(|a, b| a.clearance_m.total_cmp(&b.clearance_m));
        let chart = self
            .over_time("Gap", "m")
            .line("least clearance to anything", "other", "thin", self.of(|f| Some(f.clearance_m)))
            .line("gap to the target", "own", "", self.of(|f| Some(f.gap_m)))
            .line("asked", "truth", "dashed", self.of(|f| f.gap_m.is_finite().then_some(desired)))
            .reaching(0.0);
        match worst {
            Some(frame) => chart
                .note(format!(
                    "Nearest at {:.2} s: {} m; {}.",
                    frame.time_s,
                    number(Some(frame.clearance_m), 3),
                    match self.figures.collisions {
                        0 => "no collision".to_owned(),
                        1 => "1 collision".to_owned(),
                        more => format!("{more} collisions"),
                    }
                ))
                .html(),
            None => chart.html(),
        }
    }

    /// Distance from the target's path over time.
    pub(super) fn lateral(&self) -> String {
        self.over_time("Distance from the target’s path", "m to the left")
            .line("follower", "own", "", self.of(|f| Some(f.lateral_m)))
            .reaching(0.0)
            .reaching(0.1)
            .reaching(-0.1)
            .height(200.0)
            .html()
    }

    /// Speeds over time.
    pub(super) fn speed(&self) -> String {
        let has_target = self.log.frames.iter().any(|frame| frame.gap_m.is_finite());
        self.over_time("Speed", "m/s")
            .line("limit", "other", "thin", self.of(|f| f.speed_limit))
            .line("target", "target", "", self.of(|f| has_target.then_some(f.target_speed)))
            .line("follower", "own", "", self.of(|f| Some(f.speed)))
            .line("command", "truth", "dashed", self.of(|f| Some(f.speed_command)))
            .reaching(0.0)
            .html()
    }

    /// Steering over time.
    pub(super) fn steering(&self) -> String {
        self.over_time("Steering", "degrees to the left")
            .line("wheels", "own", "", self.of(|f| Some(f.steering.to_degrees())))
            .line("command", "truth", "dashed", self.of(|f| Some(f.steering_command.to_degrees())))
            .reaching(0.0)
            .reaching(5.0)
            .reaching(-5.0)
            .html()
    }

    /// How long after exposure depth maps and detections came.
    pub(super) fn latency(&self) -> String {
        let ms = |exposed: f64, arrived: f64| 1e3 * (arrived - exposed);
        let maps: Vec<f64> =
            self.log.depth_maps.iter().map(|m| ms(m.time_s, m.arrived_s)).collect();
        let boxes: Vec<f64> =
            self.log.detections.iter().map(|d| ms(d.time_s, d.arrived_s)).collect();
        if maps.is_empty() && boxes.is_empty() {
            return "<p class=\"note\">No depth map and no detection arrived.</p>\n".to_owned();
        }
        let most = maps.iter().chain(&boxes).copied().filter(|v| v.is_finite()).fold(0.0, f64::max);
        let bin = bin_width(most);
        let end = ((most / bin).floor() + 1.0) * bin;
        Chart::new(
            "Latency of depth maps and detections",
            ["from exposure to arrival, ms", "share, %"],
            (0.0, end),
        )
        .bars("depth maps", "network", histogram(&maps, bin))
        .bars("detections", "fast", histogram(&boxes, bin))
        .note([latency_words("Depth maps", &maps), latency_words("Detections", &boxes)].join(" "))
        .height(220.0)
        .html()
    }

    fn over_time(&self, title: &'static str, axis: &'static str) -> Chart {
        Chart::new(title, [TIME, axis], self.span).shaded(&self.untracked)
    }

    fn of<T>(
        &self,
        value: impl Fn(&FrameLog) -> Option<T>,
    ) -> impl Iterator<Item = (f64, Option<T>)> {
        self.log.frames.iter().map(move |frame| (frame.time_s, value(frame)))
    }
}

/// The time from the first to the last frame, or to what came after it.
pub(super) fn span(log: &RunLog) -> (f64, f64) {
    let times = || log.frames.iter().map(|frame| frame.time_s);
    (times().fold(0.0, f64::min), times().fold(0.0, f64::max))
}

/// The periods in which a value holds, from the first frame with it to the first
/// frame without it (the last frame of the run, if there is none).
pub(super) fn periods<T: PartialEq>(
    log: &RunLog,
    value: impl Fn(&FrameLog) -> Option<T>,
) -> Vec<(f64, f64, T)> {
    let mut periods: Vec<(f64, f64, T)> = Vec::new();
    let mut open = false;
    for frame in &log.frames {
        let value = value(frame);
        if open && let Some(last) = periods.last_mut() {
            last.1 = frame.time_s;
            open = value.as_ref() == Some(&last.2);
        }
        if let Some(value) = value.filter(|_| !open) {
            periods.push((frame.time_s, frame.time_s, value));
            open = true;
        }
    }
    periods
}

/// A round width that gives about thirty bins.
fn bin_width(most: f64) -> f64 {
    let widths = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0];
    widths.into_iter().find(|width| most / width <= 40.0).unwrap_or(most / 40.0)
}

/// Left and right edges of the bins that hold something, with the share of the values
/// in each, per cent.
fn histogram(values: &[f64], bin: f64) -> Vec<(f64, f64, f64)> {
    let mut bins: Vec<(i64, usize)> = Vec::new();
    for index in values.iter().filter(|v| v.is_finite()).map(|v| (v / bin + 1e-6).floor() as i64) {
        match bins.iter_mut().find(|(own, _)| *own == index) {
            Some((_, count)) => *count += 1,
            None => bins.push((index, 1)),
        }
    }
    bins.sort_unstable();
    let share = |count| 100.0 * count as f64 / values.len() as f64;
    let edge = |index: i64| index as f64 * bin;
    bins.into_iter().map(|(index, count)| (edge(index), edge(index + 1), share(count))).collect()
}

/// Number, median and extremes in words.
fn latency_words(what: &str, values: &[f64]) -> String {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.get(sorted.len() / 2);
    match (sorted.first(), middle, sorted.last()) {
        (Some(least), Some(median), Some(most)) => format!(
            "{what}: {} arrived, {least:.0} to {most:.0} ms after exposure, median {median:.0} ms.",
            values.len()
        ),
        _ => format!("{what}: none arrived."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn periods_end_where_the_value_changes() {
        let values = [None, Some('a'), Some('a'), Some('b'), None, Some('b')];
        let frames = (0..6).map(|i| FrameLog { time_s: f64::from(i), ..FrameLog::default() });
        let log = RunLog { frames: frames.collect(), ..RunLog::default() };
        let found = periods(&log, |frame| values[frame.time_s as usize]);
        assert_eq!(found, [(1.0, 3.0, 'a'), (3.0, 4.0, 'b'), (5.0, 5.0, 'b')]);
    }

    #[test]
    fn a_histogram_sums_up_to_everything() {
        let values = [50.0, 59.9, 60.0, 271.0];
        let bins = histogram(&values, 10.0);
        assert_eq!(bins, [(50.0, 60.0, 50.0), (60.0, 70.0, 25.0), (270.0, 280.0, 25.0)]);
        assert!(histogram(&[], 10.0).is_empty());
        assert_eq!(
            latency_words("Maps", &values),
            "Maps: 4 arrived, 50 to 271 ms after exposure, median 60 ms."
        );
    }
}
