//! When a run has passed.

use crate::{RunFigures, RunLog, StopLog};
use realnet_core::{StopReason, TrackStatus};

/// Below this a follower stands, m/s.
const STANDING: f64 = 0.01;

/// What has to be seen of the stops of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StopRule {
    /// A stop for this reason begins between two times.
    Begins {
        /// Why.
        reason: StopReason,
        /// Earliest begin, s.
        from_s: f64,
        /// Latest begin, s.
        until_s: f64,
    },
    /// There is no stop, for whatever reason, at any time between two.
    None {
        /// From when, s.
        from_s: f64,
        /// Until when, s.
        until_s: f64,
    },
    /// Speed 0 is commanded in every frame between two times.
    Commanded {
        /// From when, s.
        from_s: f64,
        /// Until when, s.
        until_s: f64,
    },
    /// It stands in every frame between two times.
    Stands {
        /// From when, s.
        from_s: f64,
        /// Until when, s.
        until_s: f64,
    },
}

/// When a run has passed. There must never be a collision nor a number that is not
/// finite where there must be one; what else must hold is set.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expectations {
    /// From when on the gap and the lateral deviation count, s.
    pub settle_s: f64,
    /// Greatest root mean square of the gap's error, metres.
    pub max_gap_rmse_m: Option<f64>,
    /// Greatest root mean square of the lateral deviation, metres.
    pub max_lateral_rmse_m: Option<f64>,
    /// Least share of the frames with a visible target that it is tracked in.
    pub min_tracked_share: Option<f64>,
    /// Greatest mean relative error of the fused range on all tracked frames.
    pub max_range_abs_rel: Option<f64>,
    /// Greatest error of the gap in the last frame, metres.
    pub max_final_gap_error_m: Option<f64>,
    /// The target is tracked in the last frame.
    pub tracks_at_end: bool,
    /// The target is tracked again for this long, s, after it was not for as long.
    pub regains_for_s: Option<f64>,
    /// Least way that the follower drives, metres: it must not pass by standing.
    pub min_way_m: f64,
    /// Greatest way that the follower drives, metres.
    pub max_way_m: Option<f64>,
    /// About stops.
    pub stops: Vec<StopRule>,
}

impl Expectations {
    /// What of it does not hold, in words; empty: passed.
    #[must_use]
    pub fn check(&self, figures: &RunFigures, log: &RunLog) -> Vec<String> {
        let mut failures = Vec::new();
        let Some(last) = log.frames.last() else {
            return vec!["there are no frames".to_owned()];
        };
        if figures.collisions > 0 {
            let plural = if figures.collisions == 1 { "" } else { "s" };
            failures.push(format!("{} collision{plural}", figures.collisions));
        }
        failures.extend(not_finite(log));
        let mut bound = |name: &str, value: Option<f64>, bound: Option<f64>, is_upper: bool| {
            let Some(bound) = bound else { return };
            let (side, sign) = if is_upper { ("at most", 1.0) } else { ("at least", -1.0) };
            match value {
                // Written so that a value that is not a number fails.
                Some(value) if sign * value <= sign * bound => {}
                Some(value) => {
                    failures.push(format!("{name} is {value:.3}, should be {side} {bound:.3}"));
                }
                None => {
                    failures.push(format!("{name} is unknown, should be {side} {bound:.3}"));
                }
            }
        };
        bound("gap RMSE in m", figures.gap_rmse_m, self.max_gap_rmse_m, true);
        bound("lateral RMSE in m", figures.lateral_rmse_m, self.max_lateral_rmse_m, true);
        bound("tracked share", figures.tracked_share, self.min_tracked_share, false);
        bound("relative range error", figures.tracked.abs_rel, self.max_range_abs_rel, true);
        let gap_error = (last.gap_m - log.desired_gap_m).abs();
        bound("gap error at the end in m", Some(gap_error), self.max_final_gap_error_m, true);
        let way = log
            .frames
            .windows(2)
            .filter_map(|pair| {
                let (first, second) = (pair.first()?, pair.get(1)?);
                Some((second.follower.position() - first.follower.position()).norm())
            })
            .sum();
        bound("way in m", Some(way), Some(self.min_way_m), false);
        bound("way in m", Some(way), self.max_way_m, true);
        if let Some(seconds) = self.regains_for_s
            && !regains(log, seconds)
        {
            failures.push(format!(
                "the target is not tracked for {seconds:.1} s after it was lost for as long"
            ));
        }
        if self.tracks_at_end && last.status != TrackStatus::Tracking {
            failures.push(format!("the target is {} at the end, not tracked", last.status));
        }
        failures.extend(self.stops.iter().filter_map(|rule| rule.check(log)));
        failures
    }
}

/// Whether the target, once tracked, is not tracked for a time, and then is for as long.
fn regains(log: &RunLog, seconds: f64) -> bool {
    let runs = log.frames.chunk_by(|a, b| {
        (a.status == TrackStatus::Tracking) == (b.status == TrackStatus::Tracking)
    });
    let long = runs.filter_map(|run| {
        let (first, last) = (run.first()?, run.last()?);
        let long = last.time_s - first.time_s >= seconds;
        long.then_some(first.status == TrackStatus::Tracking)
    });
    // tracked, not tracked, tracked
    let mut stages = long.skip_while(|tracked| !tracked);
    stages.any(|tracked| !tracked) && stages.any(|tracked| tracked)
}

fn not_finite(log: &RunLog) -> Option<String> {
    let frame = log.frames.iter().find(|frame| {
        let commands = [frame.speed_command, frame.steering_command];
        let pose = [frame.follower.x, frame.follower.y, frame.follower.heading];
        let motion = [frame.speed, frame.steering];
        let fused = [frame.range_fused_m, frame.range_fused_std_m];
        let mut all = commands.iter().chain(&pose).chain(&motion).chain(fused.iter().flatten());
        !all.all(|number| number.is_finite())
    })?;
    Some(format!("a number is not finite at {:.3} s", frame.time_s))
}

impl StopRule {
    /// What does not hold.
    fn check(&self, log: &RunLog) -> Option<String> {
        if let Self::Commanded { from_s, until_s } | Self::Stands { from_s, until_s } = *self
            && !log.frames.iter().any(|frame| (from_s..=until_s).contains(&frame.time_s))
        {
            return Some(format!("there is no frame from {from_s:.2} to {until_s:.2} s"));
        }
        let frames = |from_s: f64, until_s: f64| {
            log.frames.iter().filter(move |frame| (from_s..=until_s).contains(&frame.time_s))
        };
        match *self {
            Self::Begins { reason, from_s, until_s } => {
                let begins = |stop: &&StopLog| {
                    stop.reason == reason && (from_s..=until_s).contains(&stop.from_s)
                };
                if log.stops.iter().any(|stop| begins(&stop)) {
                    return None;
                }
                Some(format!("no stop '{reason}' began from {from_s:.2} to {until_s:.2} s"))
            }
            Self::None { from_s, until_s } => {
                let overlaps = |stop: &&StopLog| {
                    stop.from_s <= until_s && stop.until_s.unwrap_or(f64::INFINITY) >= from_s
                };
                let stop = log.stops.iter().find(overlaps)?;
                Some(format!(
                    "stop '{}' at {:.2} s, none should be from {from_s:.2} to {until_s:.2} s",
                    stop.reason, stop.from_s
                ))
            }
            Self::Commanded { from_s, until_s } => {
                let frame = frames(from_s, until_s).find(|frame| frame.speed_command != 0.0)?;
                Some(format!(
                    "{:.2} m/s are commanded at {:.2} s, should be 0 from {from_s:.2} to {until_s:.2} s",
                    frame.speed_command, frame.time_s
                ))
            }
            Self::Stands { from_s, until_s } => {
                let moves = |frame: &&crate::FrameLog| {
                    let turning = frame.speed.abs() > STANDING;
                    turning || !frame.speed.is_finite()
                };
                let frame = frames(from_s, until_s).find(moves)?;
                Some(format!(
                    "drives at {:.2} m/s at {:.2} s, should stand from {from_s:.2} to {until_s:.2} s",
                    frame.speed, frame.time_s
                ))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FrameLog;
    use realnet_core::Pose2;

    /// 10 s at 0.5 m/s and the right gap, standing from 6 to 8 s on request.
    fn good() -> RunLog {
        let mut x = 0.0;
        let frames = (0..=300).map(|index| {
            let time_s = f64::from(index) / 30.0;
            let stands = (6.0..8.0).contains(&time_s);
            let speed = if stands { 0.0 } else { 0.5 };
            x += speed / 30.0;
            FrameLog {
                time_s,
                range_true_m: Some(1.1),
                range_fused_m: Some(1.1),
                range_fused_std_m: Some(0.02),
                status: TrackStatus::Tracking,
                gap_m: 1.02,
                clearance_m: 0.9,
                lateral_m: -0.03,
                speed_command: speed,
                speed,
                follower: Pose2::new(x, 0.0, 0.0),
                stop: stands.then_some(StopReason::Requested),
                ..FrameLog::default()
            }
        });
        let stop = StopLog { from_s: 6.0, until_s: Some(8.0), reason: StopReason::Requested };
        let frames = frames.collect();
        RunLog { desired_gap_m: 1.0, frames, stops: vec![stop], ..RunLog::default() }
    }

    fn strict() -> Expectations {
        Expectations {
            settle_s: 2.0,
            max_gap_rmse_m: Some(0.021),
            max_lateral_rmse_m: Some(0.031),
            min_tracked_share: Some(0.99),
            max_range_abs_rel: Some(0.01),
            max_final_gap_error_m: Some(0.021),
            regains_for_s: None,
            tracks_at_end: true,
            min_way_m: 3.9,
            max_way_m: Some(4.1),
            stops: vec![
                StopRule::Begins { reason: StopReason::Requested, from_s: 5.9, until_s: 6.1 },
                StopRule::None { from_s: 0.0, until_s: 5.9 },
                StopRule::Commanded { from_s: 6.0, until_s: 7.95 },
                StopRule::Stands { from_s: 6.0, until_s: 7.95 },
            ],
        }
    }

    fn failures(expect: &Expectations, log: &RunLog) -> Vec<String> {
        expect.check(&RunFigures::from_log(log, expect.settle_s), log)
    }

    #[test]
    fn a_good_run_passes_and_each_flaw_is_named() {
        assert_eq!(failures(&strict(), &good()), Vec::<String>::new());
        type Flaw = fn(&mut RunLog);
        let each = |change: fn(&mut FrameLog)| {
            let mut log = good();
            log.frames.iter_mut().for_each(change);
            log
        };
        let single = |flaw: Flaw| {
            let mut log = good();
            flaw(&mut log);
            log
        };
        let flaws = [
            (each(|f| f.gap_m = 1.03), "gap RMSE in m is 0.030, should be at most 0.021"),
            (each(|f| f.lateral_m = 0.05), "lateral RMSE in m is 0.050"),
            (each(|f| f.status = TrackStatus::Coasting), "tracked share is 0.000"),
            (each(|f| f.range_fused_m = Some(1.2)), "relative range error is 0.091"),
            (each(|f| f.range_fused_m = None), "relative range error is unknown"),
            (each(|f| f.follower = Pose2::IDENTITY), "way in m is 0.000, should be at least 3.9"),
            (each(|f| f.follower.x *= 1.1), "way in m is 4.4"),
            (each(|f| f.speed = 0.5), "drives at 0.50 m/s at 6.00 s"),
            (each(|f| f.speed_command = 0.5), "0.50 m/s are commanded at 6.00 s"),
            (each(|f| f.steering_command = f64::NAN), "not finite at 0.000 s"),
            (each(|f| f.range_fused_std_m = Some(f64::INFINITY)), "not finite at 0.000 s"),
            (single(|l| l.frames[99].clearance_m = 0.0), "1 collision"),
            (single(|l| l.frames[300].gap_m = 1.1), "gap error at the end in m is 0.100"),
            (single(|l| l.frames[300].gap_m = f64::NAN), "gap error at the end in m is NaN"),
            (single(|l| l.frames[300].status = TrackStatus::Lost), "the target is lost at the end"),
            (single(|l| l.stops[0].from_s = 6.2), "no stop 'requested' began from 5.90 to 6.10 s"),
            (single(|l| l.stops[0].from_s = 5.8), "stop 'requested' at 5.80 s, none should be"),
            (single(|l| l.frames.clear()), "there are no frames"),
        ];
        for (log, expected) in flaws {
            let found = failures(&strict(), &log);
            assert!(found.iter().any(|text| text.contains(expected)), "{expected}: {found:#?}");
        }
    }
}
