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
    /// Greatest mean relative error of the fused range.
    pub max_range_abs_rel: Option<f64>,
    /// Greatest error of the gap in the last frame, metres.
    pub max_final_gap_error_m: Option<f64>,
    /// The target is tracked in the last frame.
    pub tracks_at_end: bool,
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
            failures.push(format!("{} collisions", figures.collisions));
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
        bound("relative range error", figures.fused.abs_rel, self.max_range_abs_rel, true);
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
        if self.tracks_at_end && last.status != TrackStatus::Tracking {
            failures.push(format!("the target is {} at the end, not tracked", last.status));
        }
        failures.extend(self.stops.iter().filter_map(|rule| rule.check(log)));
        failures
    }
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
