//! The outcome of a run, and what it says as JSON.

use realnet_sim::{RunFigures, StopLog};
use serde::{Serialize, Serializer};

/// A run that was judged.
#[derive(Clone, Debug, Default)]
pub(super) struct RunResult {
    /// Name of the scenario.
    pub(super) scenario: String,
    /// The seed of the run.
    pub(super) seed: u64,
    /// What it came to.
    pub(super) figures: RunFigures,
    /// What it did not do that it should have done, a sentence each; none: it passed.
    pub(super) failures: Vec<String>,
}

impl RunResult {
    /// Whether it did all it should have done.
    pub(super) fn passed(&self) -> bool {
        self.failures.is_empty()
    }

    /// The JSON object of the run.
    pub(super) fn record(&self) -> RunRecord<'_> {
        let RunFigures { fused, network, fast, tracked, .. } = self.figures;
        let figures = &self.figures;
        RunRecord {
            scenario: &self.scenario,
            seed: self.seed,
            gap_rmse_m: figures.gap_rmse_m,
            lateral_rmse_m: figures.lateral_rmse_m,
            range_abs_rel: fused.abs_rel,
            range_abs_rel_network_only: network.abs_rel,
            range_jitter_m: fused.jitter_m,
            range_jitter_network_only_m: network.jitter_m,
            min_gap_m: figures.min_gap_m,
            collisions: figures.collisions,
            tracked_share: figures.tracked_share,
            stops: figures.stops.iter().map(StopRecord::from).collect(),
            pass: self.passed(),
            failures: &self.failures,
            within_two_std: figures.within_two_std,
            range_bias_rel: fused.bias,
            range_abs_rel_fast: fast.abs_rel,
            range_jitter_fast_m: fast.jitter_m,
            range_known_share: fused.known_share,
            range_known_share_network_only: network.known_share,
            range_known_share_fast: fast.known_share,
            range_frames: fused.frames,
            range_abs_rel_tracked: tracked.abs_rel,
            range_frames_tracked: tracked.frames,
            visible_frames: figures.visible,
            frames: figures.frames,
            duration_s: figures.duration_s,
        }
    }
}

/// One line of JSON, fields in this order; null where a run says nothing about a
/// figure. Numbers have six decimals at most.
#[derive(Clone, Debug, Serialize)]
pub(super) struct RunRecord<'a> {
    scenario: &'a str,
    seed: u64,
    #[serde(serialize_with = "rounded")]
    gap_rmse_m: Option<f64>,
    #[serde(serialize_with = "rounded")]
    lateral_rmse_m: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_abs_rel: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_abs_rel_network_only: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_jitter_m: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_jitter_network_only_m: Option<f64>,
    #[serde(serialize_with = "rounded")]
    min_gap_m: Option<f64>,
    collisions: usize,
    #[serde(serialize_with = "rounded")]
    tracked_share: Option<f64>,
    stops: Vec<StopRecord>,
    pass: bool,
    failures: &'a [String],
    #[serde(serialize_with = "rounded")]
    within_two_std: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_bias_rel: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_abs_rel_fast: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_jitter_fast_m: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_known_share: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_known_share_network_only: Option<f64>,
    #[serde(serialize_with = "rounded")]
    range_known_share_fast: Option<f64>,
    range_frames: usize,
    #[serde(serialize_with = "rounded")]
    range_abs_rel_tracked: Option<f64>,
    range_frames_tracked: usize,
    visible_frames: usize,
    frames: usize,
    #[serde(serialize_with = "rounded_number")]
    duration_s: f64,
}

/// A stop; `until_s` is null when it lasted until the end.
#[derive(Clone, Copy, Debug, Serialize)]
struct StopRecord {
    reason: &'static str,
    #[serde(serialize_with = "rounded_number")]
    from_s: f64,
    #[serde(serialize_with = "rounded")]
    until_s: Option<f64>,
}

impl From<&StopLog> for StopRecord {
    fn from(stop: &StopLog) -> Self {
        Self { reason: stop.reason.name(), from_s: stop.from_s, until_s: stop.until_s }
    }
}

/// A number to six decimals, which is a micrometre or a microsecond; null when it is
/// not finite.
fn rounded<S: Serializer>(value: &Option<f64>, s: S) -> Result<S::Ok, S::Error> {
    value.filter(|v| v.is_finite()).map(micro).serialize(s)
}

/// As [`rounded`].
fn rounded_number<S: Serializer>(value: &f64, s: S) -> Result<S::Ok, S::Error> {
    rounded(&Some(*value), s)
}

fn micro(value: f64) -> f64 {
    // Adding 0 makes -0 a 0.
    (value * 1e6).round() / 1e6 + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::StopReason;
    use realnet_sim::CueFigures;

    fn run() -> RunResult {
        let cue = |abs_rel, jitter_m| CueFigures {
            frames: 80,
            abs_rel: Some(abs_rel),
            bias: Some(-0.01),
            pairs: 79,
            jitter_m: Some(jitter_m),
            known_share: Some(0.8),
        };
        let figures = RunFigures {
            duration_s: 9.9 + 1e-9,
            frames: 100,
            visible: 100,
            gap_rmse_m: Some(0.034_567_891),
            lateral_rmse_m: Some(0.5),
            fused: cue(0.02, 0.003),
            network: cue(0.1, 0.06),
            fast: cue(0.05, 0.01),
            tracked: cue(0.03, 0.004),
            deviations: 80,
            within_two_std: Some(0.95),
            min_gap_m: Some(-1e-9),
            collisions: 1,
            tracked_share: Some(0.8),
            stops: vec![
                StopLog { from_s: 1.5, until_s: Some(2.25), reason: StopReason::TooClose },
                StopLog { from_s: 8.0, until_s: None, reason: StopReason::TargetLost },
            ],
        };
        RunResult { scenario: "stop-and-go".into(), seed: 7, figures, failures: Vec::new() }
    }

    #[test]
    fn json_has_the_promised_fields_in_order() {
        let json = serde_json::to_string(&run().record()).unwrap();
        let promised = concat!(
            r#"{"scenario":"stop-and-go","seed":7,"gap_rmse_m":0.034568,"lateral_rmse_m":0.5,"#,
            r#""range_abs_rel":0.02,"range_abs_rel_network_only":0.1,"range_jitter_m":0.003,"#,
            r#""range_jitter_network_only_m":0.06,"min_gap_m":0.0,"collisions":1,"#,
            r#""tracked_share":0.8,"stops":[{"reason":"too-close","from_s":1.5,"until_s":2.25},"#,
            r#"{"reason":"target-lost","from_s":8.0,"until_s":null}],"pass":true,"#,
            r#""failures":[],"within_two_std":0.95,"#,
        );
        assert!(json.starts_with(promised), "{json}");
        let tail = r#""frames":100,"duration_s":9.9}"#;
        assert!(json.ends_with(tail), "{json}");
    }

    #[test]
    fn a_failed_run_says_why() {
        let run = RunResult { failures: vec!["2 collisions".into()], ..run() };
        let json = serde_json::to_string(&run.record()).unwrap();
        assert!(json.contains(r#""pass":false,"failures":["2 collisions"],"#), "{json}");
    }

    #[test]
    fn what_is_unknown_is_null() {
        let figures = RunFigures { gap_rmse_m: Some(f64::NAN), ..RunFigures::default() };
        let run = RunResult { figures, ..RunResult::default() };
        let value = serde_json::to_value(run.record()).unwrap();
        for key in ["gap_rmse_m", "range_abs_rel", "min_gap_m", "tracked_share", "within_two_std"] {
            assert!(value[key].is_null(), "{key}: {value}");
        }
        assert_eq!(value["stops"], serde_json::json!([]));
    }
}
