//! What to do while the target is not seen, in seconds.

use crate::OptionError;
use crate::check::positive;
use realnet_core::{Stamp, TargetState, TrackStatus};

/// How a robot looks for a target that it lost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Search {
    /// It stands, the wheels straight.
    #[default]
    Stand,
    /// It turns on the spot to the side where the target was seen last; for differential
    /// drives, a car stands.
    Turn {
        /// Rate of turn, radians a second.
        yaw_rate_rad_s: f64,
    },
}

/// Options of lost-target behaviour. All times are ages of the newest measurement of the
/// target, in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LostOptions {
    /// Up to this age the target counts as seen.
    pub coast_after_s: f64,
    /// From here on the robot becomes slower and slower; between `coast_after_s` and this
    /// it follows the prediction, but no faster than before.
    pub slow_after_s: f64,
    /// From here on it stands: the set coasting time.
    pub stop_after_s: f64,
    /// From here on it searches.
    pub search_after_s: f64,
    /// From here on it no longer does.
    pub search_until_s: f64,
    /// How it searches.
    pub search: Search,
}

impl Default for LostOptions {
    fn default() -> Self {
        Self {
            coast_after_s: 0.25,
            slow_after_s: 0.75,
            stop_after_s: 1.25,
            search_after_s: 2.0,
            search_until_s: 10.0,
            search: Search::Stand,
        }
    }
}

impl LostOptions {
    pub(crate) fn check(&self) -> Result<(), OptionError> {
        let times = [
            ("lost.coast_after_s", self.coast_after_s),
            ("lost.slow_after_s", self.slow_after_s),
            ("lost.stop_after_s", self.stop_after_s),
            ("lost.search_after_s", self.search_after_s),
            ("lost.search_until_s", self.search_until_s),
        ];
        let mut least = 0.0;
        for (name, value) in times {
            let ok = (least..=1e6).contains(&value);
            OptionError::check(name, value, ok, "at least 0 and the time before it in the list")?;
            least = value;
        }
        match self.search {
            Search::Stand => Ok(()),
            Search::Turn { yaw_rate_rad_s } => {
                positive("lost.search.yaw_rate_rad_s", yaw_rate_rad_s)
            }
        }
    }
}

/// What the controller does about the target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Phase {
    /// There was no target yet: it stands.
    #[default]
    NoTarget,
    /// It follows.
    Tracking,
    /// It follows the prediction, no faster than before.
    Coasting,
    /// It follows the prediction, slower and slower.
    Slowing,
    /// It stands.
    Stopped,
    /// It searches.
    Searching,
}

impl Phase {
    /// The name in files and plots.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NoTarget => "no-target",
            Self::Tracking => "tracking",
            Self::Coasting => "coasting",
            Self::Slowing => "slowing",
            Self::Stopped => "stopped",
            Self::Searching => "searching",
        }
    }
}

/// What remains of a target that was seen.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LostTarget {
    phase: Phase,
    /// Of the newest measurement of a target that was followed.
    seen: Option<Stamp>,
    /// Greatest speed while coasting.
    ceiling: f64,
    /// Whether the target was on the left when it was seen last.
    left: bool,
}

impl LostTarget {
    /// The phase at `now`; `speed` is what was commanded last. With the bound of the
    /// speed that belongs to it.
    pub(crate) fn step(
        &mut self,
        options: &LostOptions,
        now: Stamp,
        target: &TargetState,
        speed: f64,
    ) -> (Phase, f64) {
        let estimate = target
            .estimate
            .filter(|_| matches!(target.status, TrackStatus::Tracking | TrackStatus::Coasting));
        let current = target.measured.filter(|_| estimate.is_some());
        if let Some(measured) = current {
            self.seen = Some(measured);
        }
        let Some(seen) = self.seen else {
            self.phase = Phase::NoTarget;
            return (self.phase, 0.0);
        };
        let age = now.seconds_since(seen);
        let was_free = matches!(self.phase, Phase::NoTarget | Phase::Tracking);
        self.phase = if current.is_none() || age > options.stop_after_s {
            let searches = age > options.search_after_s && age <= options.search_until_s;
            if searches { Phase::Searching } else { Phase::Stopped }
        } else if age > options.slow_after_s {
            Phase::Slowing
        } else if age > options.coast_after_s || target.status == TrackStatus::Coasting {
            Phase::Coasting
        } else {
            Phase::Tracking
        };
        if let (Phase::Tracking, Some(estimate)) = (self.phase, estimate) {
            self.left = estimate.position.y >= 0.0;
        }
        let bound = match self.phase {
            Phase::Tracking => f64::INFINITY,
            Phase::NoTarget | Phase::Stopped | Phase::Searching => 0.0,
            Phase::Coasting | Phase::Slowing => {
                let last = speed.max(0.0);
                if was_free {
                    self.ceiling = last;
                }
                // in what is left of the slowing time, by an even deceleration
                let span = options.stop_after_s - options.slow_after_s;
                let left = options.stop_after_s - age;
                let share = if self.phase == Phase::Slowing && span > 0.0 {
                    (left / span).clamp(0.0, 1.0)
                } else {
                    1.0
                };
                last.min(self.ceiling * share)
            }
        };
        (self.phase, bound)
    }

    /// The rate of turn of a search, radians a second, 0 if there is none.
    pub(crate) fn search(&self, options: &LostOptions) -> f64 {
        match (self.phase, options.search) {
            (Phase::Searching, Search::Turn { yaw_rate_rad_s }) => {
                if self.left {
                    yaw_rate_rad_s
                } else {
                    -yaw_rate_rad_s
                }
            }
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::TargetEstimate;
    use realnet_core::nalgebra::{Matrix2, Vector2};

    fn state(measured: f64, status: TrackStatus) -> TargetState {
        TargetState {
            stamp: Stamp::from_secs_f64(measured),
            measured: Some(Stamp::from_secs_f64(measured)),
            status,
            estimate: Some(TargetEstimate {
                position: Vector2::new(1.5, -0.1),
                velocity: Vector2::zeros(),
                acceleration: Vector2::zeros(),
                position_covariance: Matrix2::zeros(),
                velocity_covariance: Matrix2::zeros(),
            }),
        }
    }

    #[test]
    fn a_coasting_track_is_followed_no_faster_than_before() {
        let options = LostOptions::default();
        let mut lost = LostTarget::default();
        let mut step = |now: f64, measured: f64, status, speed| {
            lost.step(&options, Stamp::from_secs_f64(now), &state(measured, status), speed)
        };
        assert_eq!(step(1.0, 1.0, TrackStatus::Tracking, 0.5), (Phase::Tracking, f64::INFINITY));
        assert_eq!(step(1.1, 1.0, TrackStatus::Coasting, 0.5), (Phase::Coasting, 0.5));
        assert_eq!(step(1.2, 1.0, TrackStatus::Coasting, 0.4), (Phase::Coasting, 0.4));
        // The vehicle may be slower than its bound, the bound does not rise again.
        assert_eq!(step(1.3, 1.0, TrackStatus::Coasting, 0.9), (Phase::Coasting, 0.5));
        assert_eq!(step(1.4, 1.4, TrackStatus::Tracking, 0.4).1, f64::INFINITY);
        // Too old, whatever the status says.
        assert_eq!(step(1.7, 1.4, TrackStatus::Tracking, 0.4), (Phase::Coasting, 0.4));
        let (phase, bound) = step(2.4, 1.4, TrackStatus::Tracking, 0.4);
        assert!(phase == Phase::Slowing && (bound - 0.2).abs() < 1e-9, "{bound}");
        assert_eq!(step(2.7, 1.4, TrackStatus::Tracking, 0.1), (Phase::Stopped, 0.0));
    }

    #[test]
    fn no_time_for_slowing_is_no_division_by_zero() {
        let options = LostOptions { slow_after_s: 1.25, ..LostOptions::default() };
        assert!(options.check().is_ok());
        let mut lost = LostTarget::default();
        for i in 0..20 {
            let now = Stamp::from_secs_f64(0.1 * f64::from(i));
            let (_, bound) = lost.step(&options, now, &state(0.0, TrackStatus::Tracking), 1.0);
            assert!(!bound.is_nan());
        }
    }

    #[test]
    fn the_search_goes_to_the_side_where_it_was_last() {
        let search = Search::Turn { yaw_rate_rad_s: 1.0 };
        let options = LostOptions { search, ..LostOptions::default() };
        let mut lost = LostTarget::default();
        let nothing = TargetState::default();
        let mut step = |now: f64, state: &TargetState| {
            let (phase, _) = lost.step(&options, Stamp::from_secs_f64(now), state, 0.0);
            (phase, lost.search(&options))
        };
        assert_eq!(step(0.5, &nothing), (Phase::NoTarget, 0.0));
        assert_eq!(step(1.0, &state(1.0, TrackStatus::Tracking)), (Phase::Tracking, 0.0));
        assert_eq!(step(2.0, &nothing), (Phase::Stopped, 0.0));
        assert_eq!(step(3.1, &nothing), (Phase::Searching, -1.0));
        assert_eq!(step(11.1, &nothing), (Phase::Stopped, 0.0));
    }
}
