//! Tables of scenarios and of their runs, for people.

use super::json::RunResult;
use realnet_sim::{CueFigures, RunFigures};
use serde::Serialize;

/// Width that texts are broken to.
const WIDTH: usize = 100;

/// What all runs of a scenario come to. Mean and worst are over the runs that say
/// something about a figure.
#[derive(Clone, Debug)]
pub(super) struct ScenarioSummary {
    /// Its name.
    pub(super) scenario: String,
    /// Runs that passed.
    pub(super) passes: usize,
    /// Runs.
    pub(super) seeds: usize,
    /// Metres.
    pub(super) gap_rmse_m: MeanWorst,
    /// Fused range.
    pub(super) range_abs_rel: MeanWorst,
    /// Range of the network, held.
    pub(super) range_abs_rel_network_only: MeanWorst,
    /// Fused range, metres.
    pub(super) range_jitter_m: MeanWorst,
    /// Range of the network, held, metres.
    pub(super) range_jitter_network_only_m: MeanWorst,
    /// Share of the frames with the true range within two deviations.
    pub(super) within_two_std: MeanWorst,
    /// Least free space around the follower, metres.
    pub(super) min_gap_m: MeanWorst,
    /// Share of the frames with a visible target that were tracked.
    pub(super) tracked_share: MeanWorst,
    /// Seeds of the runs that failed, with the reasons.
    pub(super) failures: Vec<FailedRun>,
}

/// Mean and worst of a figure; unknown when no run says anything about it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct MeanWorst {
    /// The mean over the runs.
    pub(super) mean: Option<f64>,
    /// The worst run's.
    pub(super) worst: Option<f64>,
}

/// A run that failed.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FailedRun {
    /// Its seed.
    pub(super) seed: u64,
    /// Why, a sentence each.
    pub(super) reasons: Vec<String>,
}

impl MeanWorst {
    fn of(values: impl Iterator<Item = Option<f64>>, worse: fn(f64, f64) -> f64) -> Self {
        let known: Vec<f64> = values.flatten().filter(|value| value.is_finite()).collect();
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        Self { mean: Some(mean).filter(|m| m.is_finite()), worst: known.into_iter().reduce(worse) }
    }
}

/// The scenarios of these runs, in the order of their first runs.
pub(super) fn summaries(runs: &[RunResult]) -> Vec<ScenarioSummary> {
    let mut names: Vec<&str> = Vec::new();
    for run in runs {
        if !names.contains(&run.scenario.as_str()) {
            names.push(&run.scenario);
        }
    }
    names.into_iter().map(|name| ScenarioSummary::of(name, runs)).collect()
}

impl ScenarioSummary {
    fn of(name: &str, runs: &[RunResult]) -> Self {
        let own = || runs.iter().filter(|run| run.scenario == name);
        let high = |value: fn(&RunFigures) -> Option<f64>| {
            MeanWorst::of(own().map(|run| value(&run.figures)), f64::max)
        };
        let low = |value: fn(&RunFigures) -> Option<f64>| {
            MeanWorst::of(own().map(|run| value(&run.figures)), f64::min)
        };
        Self {
            scenario: name.to_owned(),
            passes: own().filter(|run| run.passed()).count(),
            seeds: own().count(),
            gap_rmse_m: high(|f| f.gap_rmse_m),
            range_abs_rel: high(|f| f.fused.abs_rel),
            range_abs_rel_network_only: high(|f| f.network.abs_rel),
            range_jitter_m: high(|f| f.fused.jitter_m),
            range_jitter_network_only_m: high(|f| f.network.jitter_m),
            within_two_std: low(|f| f.within_two_std),
            min_gap_m: low(|f| f.min_gap_m),
            tracked_share: low(|f| f.tracked_share),
            failures: own()
                .filter(|run| !run.passed())
                .map(|run| FailedRun { seed: run.seed, reasons: run.failures.clone() })
                .collect(),
        }
    }

    /// Whether all runs passed.
    pub(super) fn passed(&self) -> bool {
        self.passes == self.seeds
    }
}

/// The ranges of many runs as if they were one run: what the fusion gains over the
/// network alone.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RangeGain {
    /// The fused range.
    pub(super) fused: CueFigures,
    /// The network's, held.
    pub(super) network: CueFigures,
    /// Tracked frames with a deviation.
    pub(super) deviations: usize,
    /// Share of these with the true range within two deviations.
    pub(super) within_two_std: Option<f64>,
}

impl RangeGain {
    /// Of these runs.
    pub(super) fn of<'a>(runs: impl IntoIterator<Item = &'a RunResult> + Clone) -> Self {
        let figures = || runs.clone().into_iter().map(|run| &run.figures);
        let (mut within, mut all) = (0.0, 0);
        for run in figures() {
            within += run.within_two_std.unwrap_or(0.0) * run.deviations as f64;
            all += run.deviations;
        }
        Self {
            fused: CueFigures::pooled(figures().map(|f| &f.fused)),
            network: CueFigures::pooled(figures().map(|f| &f.network)),
            deviations: all,
            within_two_std: (all > 0).then(|| within / all as f64),
        }
    }

    /// The fused range's error as a share of the network's.
    pub(super) fn error_ratio(&self) -> Option<f64> {
        ratio(self.fused.abs_rel, self.network.abs_rel)
    }

    /// The fused range's jitter as a share of the network's.
    pub(super) fn jitter_ratio(&self) -> Option<f64> {
        ratio(self.fused.jitter_m, self.network.jitter_m)
    }

    /// In words, on two lines.
    pub(super) fn words(&self) -> String {
        format!(
            "range of all runs as one: off by {} %, the network's held one by {} % (ratio {}); jitter \
             {} mm\nof {} mm (ratio {}); the true range is within two deviations on {} % of the frames",
            percent(self.fused.abs_rel, 2),
            percent(self.network.abs_rel, 2),
            number(self.error_ratio(), 2),
            number(self.fused.jitter_m.map(|m| 1e3 * m), 1),
            number(self.network.jitter_m.map(|m| 1e3 * m), 1),
            number(self.jitter_ratio(), 2),
            percent(self.within_two_std, 1),
        )
    }
}

fn ratio(part: Option<f64>, whole: Option<f64>) -> Option<f64> {
    Some(part? / whole?).filter(|ratio| ratio.is_finite())
}

/// A number for people; `-` when it is unknown.
pub(super) fn number(value: Option<f64>, digits: usize) -> String {
    match value.filter(|value| value.is_finite()) {
        Some(value) => {
            let text = format!("{value:.digits$}");
            // No -0.00.
            let zero = text.starts_with('-') && !text.contains(|c: char| ('1'..='9').contains(&c));
            if zero { text.trim_start_matches('-').to_owned() } else { text }
        }
        None => "-".to_owned(),
    }
}

/// A share in per cent, without the sign.
pub(super) fn percent(share: Option<f64>, digits: usize) -> String {
    number(share.map(|share| 100.0 * share), digits)
}

/// Columns of the table after the name: what stands over a group, and the names and
/// widths of its columns.
const COLUMNS: [(&str, &[(&str, usize)]); 7] = [
    ("", &[("passed", 7)]),
    ("gap rmse, m", &[("mean", 6), ("worst", 6)]),
    ("range error, %", &[("mean", 5), ("worst", 5), ("net", 5)]),
    ("jitter, mm", &[("mean", 6), ("net", 6)]),
    ("in 2 sd", &[("%", 7)]),
    ("least", &[("gap, m", 6)]),
    ("tracked", &[("%", 7)]),
];

impl ScenarioSummary {
    /// What stands in the columns, here and on the page.
    pub(super) fn cells(&self) -> [String; 11] {
        let millimetres = |value: Option<f64>| number(value.map(|m| 1e3 * m), 1);
        [
            format!("{}/{}", self.passes, self.seeds),
            number(self.gap_rmse_m.mean, 3),
            number(self.gap_rmse_m.worst, 3),
            percent(self.range_abs_rel.mean, 1),
            percent(self.range_abs_rel.worst, 1),
            percent(self.range_abs_rel_network_only.mean, 1),
            millimetres(self.range_jitter_m.mean),
            millimetres(self.range_jitter_network_only_m.mean),
            percent(self.within_two_std.mean, 1),
            number(self.min_gap_m.worst, 2),
            percent(self.tracked_share.mean, 1),
        ]
    }
}

/// The table of `sim --all`: a line a scenario, the whole, and the reasons of the
/// runs that failed. `net` is the range of the network alone, held between its maps;
/// `in 2 sd` the share of frames with the true range within two deviations; `least
/// gap` is of all runs.
pub(super) fn runs_table(runs: &[RunResult]) -> String {
    let scenarios = summaries(runs);
    let names = scenarios.iter().map(|s| s.scenario.chars().count());
    let longest = names.max().unwrap_or(0).max("scenario".len());
    let mut text = " ".repeat(longest);
    for (group, columns) in COLUMNS {
        let width = columns.iter().map(|(_, width)| width + 1).sum::<usize>() - 1;
        text += &match columns {
            [_] => format!("  {group:>width$}"),
            _ => format!("  {group:^width$}"),
        };
    }
    text.truncate(text.trim_end().len());
    let line = |text: &mut String, name: &str, cells: &[String]| {
        *text += &format!("\n{name:<longest$}");
        let mut cells = cells.iter();
        for (_, columns) in COLUMNS {
            for (index, (_, width)) in columns.iter().enumerate() {
                let gap = if index == 0 { "  " } else { " " };
                let cell = cells.next().map_or("", String::as_str);
                *text += &format!("{gap}{cell:>width$}");
            }
        }
    };
    let heads = COLUMNS.iter().flat_map(|(_, columns)| columns.iter());
    line(&mut text, "scenario", &heads.map(|(name, _)| (*name).to_owned()).collect::<Vec<_>>());
    for scenario in &scenarios {
        line(&mut text, &scenario.scenario, &scenario.cells());
    }
    let passed = runs.iter().filter(|run| run.passed()).count();
    text += &format!("\n\n{passed} of {} runs passed", runs.len());
    let gain = RangeGain::of(runs);
    if gain.fused.frames > 0 {
        text += &format!("\n{}", gain.words());
    }
    for scenario in scenarios.iter().filter(|scenario| !scenario.passed()) {
        text += &format!("\n\n{} failed", scenario.scenario);
        for run in &scenario.failures {
            let reasons = format!("seed {}: {}", run.seed, run.reasons.join("; "));
            for (index, part) in wrapped(&reasons, WIDTH - 4).into_iter().enumerate() {
                text += &format!("\n{}{part}", if index == 0 { "  " } else { "    " });
            }
        }
    }
    text
}

/// The figures of one run.
pub(super) fn run_table(run: &RunResult) -> String {
    let f = &run.figures;
    let verdict = if run.passed() { "passed" } else { "failed" };
    let mut text = format!("{}, seed {}: {verdict}", run.scenario, run.seed);
    for failure in &run.failures {
        text += &format!("\n  {failure}");
    }
    text += &format!("\n\n{:<26}{:>8}{:>8}{:>8}", "range", "fused", "fast", "network");
    let mut row = |name: &str, value: fn(&CueFigures) -> String| {
        let [fused, fast, network] = [&f.fused, &f.fast, &f.network].map(value);
        text += &format!("\n  {name:<24}{fused:>8}{fast:>8}{network:>8}");
    };
    row("off by, mean, %", |cue| percent(cue.abs_rel, 2));
    row("bias, %", |cue| percent(cue.bias, 2));
    row("jitter, RMS, mm", |cue| number(cue.jitter_m.map(|m| 1e3 * m), 1));
    row("known while visible, %", |cue| percent(cue.known_share, 1));
    for (name, value) in [
        ("  truth within 2 sd, %", percent(f.within_two_std, 1)),
        ("gap, RMSE, m", number(f.gap_rmse_m, 3)),
        ("off the path, RMSE, m", number(f.lateral_rmse_m, 3)),
        ("least clearance, m", number(f.min_gap_m, 3)),
        ("collisions", f.collisions.to_string()),
        ("tracked while visible, %", percent(f.tracked_share, 1)),
        ("seconds", number(Some(f.duration_s), 1)),
        ("stops", f.stops.len().to_string()),
    ] {
        text += &format!("\n{name:<26}{value:>8}");
    }
    for stop in &f.stops {
        let until = match stop.until_s {
            Some(until) => format!("{} s", number(Some(until), 2)),
            None => "the end".to_owned(),
        };
        text += &format!("\n  {} from {} s to {until}", stop.reason, number(Some(stop.from_s), 2));
    }
    text
}

/// A scenario that can be run.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ScenarioRow<'a> {
    /// Its name.
    pub(super) scenario: &'a str,
    /// How long a run takes in the world of the simulator.
    pub(super) seconds: f64,
    /// What happens in it.
    pub(super) description: &'a str,
}

/// The table of `sim --list`.
pub(super) fn list_table(rows: &[ScenarioRow<'_>]) -> String {
    let longest = rows.iter().map(|row| row.scenario.chars().count()).max().unwrap_or(0).max(8);
    let mut text = format!("{:<longest$}  seconds  what happens", "scenario");
    for row in rows {
        let parts = wrapped(row.description, WIDTH.saturating_sub(longest + 11).max(30));
        let first = parts.first().map_or("", String::as_str);
        text += &format!("\n{:<longest$}  {:>7.0}  {first}", row.scenario, row.seconds);
        for part in parts.iter().skip(1) {
            text += &format!("\n{:longest$}           {part}", "");
        }
    }
    text
}

/// A text in lines of at most `width` characters, broken between words.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::StopReason;
    use realnet_sim::StopLog;

    fn cue(frames: usize, abs_rel: f64, jitter_m: f64) -> CueFigures {
        let (abs_rel, jitter_m) = (Some(abs_rel), Some(jitter_m));
        CueFigures { frames, abs_rel, pairs: frames, jitter_m, ..CueFigures::default() }
    }

    fn run(scenario: &str, seed: u64, scale: f64, failures: &[&str]) -> RunResult {
        let figures = RunFigures {
            gap_rmse_m: Some(0.02 * scale),
            fused: cue(100, 0.01 * scale, 0.002 * scale),
            network: cue(100, 0.08, 0.05),
            deviations: 100,
            within_two_std: Some(0.97 - 0.01 * scale),
            min_gap_m: Some(0.9 / scale),
            tracked_share: Some(1.0),
            ..RunFigures::default()
        };
        let failures = failures.iter().map(|f| (*f).to_owned()).collect();
        RunResult { scenario: scenario.into(), seed, figures, failures }
    }

    fn runs() -> Vec<RunResult> {
        vec![
            run("steady", 0, 1.0, &[]),
            run(
                "hard-braking",
                0,
                2.0,
                &["1 collision", "least gap -0.02 m, at least 0.10 m asked"],
            ),
            run("steady", 1, 3.0, &[]),
            RunResult { scenario: "no-target".into(), ..RunResult::default() },
        ]
    }

    #[test]
    fn the_table_of_runs() {
        let expected = "
                        gap rmse, m    range error, %     jitter, mm    in 2 sd   least  tracked
scenario       passed    mean  worst   mean worst   net    mean    net        %  gap, m        %
steady            2/2   0.040  0.060    2.0   3.0   8.0     4.0   50.0     95.0    0.30    100.0
hard-braking      0/1   0.040  0.040    2.0   2.0   8.0     4.0   50.0     95.0    0.45    100.0
no-target         1/1       -      -      -     -     -       -      -        -       -        -

3 of 4 runs passed
range of all runs as one: off by 2.00 %, the network's held one by 8.00 % (ratio 0.25); jitter 4.3 mm
of 50.0 mm (ratio 0.09); the true range is within two deviations on 95.0 % of the frames

hard-braking failed
  seed 0: 1 collision; least gap -0.02 m, at least 0.10 m asked";
        let table = runs_table(&runs());
        assert_eq!(format!("\n{table}"), expected, "{table}");
    }

    #[test]
    fn the_table_of_one_run() {
        let mut run = run("steady", 5, 2.0, &["1 collision"]);
        run.figures.stops = vec![
            StopLog { from_s: 0.0, until_s: Some(0.4), reason: StopReason::NoTarget },
            StopLog { from_s: 14.9, until_s: None, reason: StopReason::TargetLost },
        ];
        let expected = "\
steady, seed 5: failed
  1 collision

range                        fused    fast network
  off by, mean, %             2.00       -    8.00
  bias, %                        -       -       -
  jitter, RMS, mm              4.0       -    50.0
  known while visible, %         -       -       -
  truth within 2 sd, %        95.0
gap, RMSE, m                 0.040
off the path, RMSE, m            -
least clearance, m           0.450
collisions                       0
tracked while visible, %     100.0
seconds                        0.0
stops                            2
  no-target from 0.00 s to 0.40 s
  target-lost from 14.90 s to the end";
        assert_eq!(run_table(&run), expected, "\n{}", run_table(&run));
    }

    #[test]
    fn the_table_of_no_runs_at_all() {
        assert!(runs_table(&[]).ends_with("\n\n0 of 0 runs passed"), "{}", runs_table(&[]));
        assert_eq!(RangeGain::of(&[]).error_ratio(), None);
    }

    #[test]
    fn the_list_is_broken_into_lines() {
        let long = "The target brakes as hard as it can from 1.5 m/s while the depth network is at its \
                    slowest, and stands still for five seconds.";
        let rows = [
            ScenarioRow { scenario: "steady", seconds: 20.0, description: "Straight on." },
            ScenarioRow { scenario: "hard-braking", seconds: 12.4, description: long },
        ];
        let expected = "\
scenario      seconds  what happens
steady             20  Straight on.
hard-braking       12  The target brakes as hard as it can from 1.5 m/s while the depth network is
                       at its slowest, and stands still for five seconds.";
        assert_eq!(list_table(&rows), expected, "\n{}", list_table(&rows));
        assert!(list_table(&rows).lines().all(|line| line.len() <= WIDTH));
    }

    #[test]
    fn a_summary_knows_the_worst_by_its_direction() {
        let all = summaries(&runs());
        let [steady, braking, none] = all.as_slice() else { panic!("{all:?}") };
        let of = |mean, worst| MeanWorst { mean: Some(mean), worst: Some(worst) };
        assert_eq!(steady.gap_rmse_m, of(0.04, 0.06));
        assert_eq!((steady.min_gap_m, steady.passed()), (of(0.6, 0.3), true));
        assert_eq!((braking.passes, braking.seeds), (0, 1));
        assert_eq!(braking.failures[0].reasons[0], "1 collision");
        assert_eq!(none.gap_rmse_m, MeanWorst::default());
    }

    #[test]
    fn numbers_for_people() {
        assert_eq!(number(Some(-0.004), 2), "0.00");
        assert_eq!(number(Some(-0.006), 2), "-0.01");
        assert_eq!(number(Some(f64::NAN), 2), "-");
        assert_eq!(percent(Some(0.456), 0), "46");
    }
}
