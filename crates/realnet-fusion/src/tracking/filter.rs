//! The target filter as its users see it.

use super::measurement::{Outcome, Source, TargetMeasurement};
use super::model::{TargetModel, TargetMoment};
use super::options::TargetOptions;
use super::track::{Motion, Track, TrailPoint};
use crate::late::{Arrival, LateError, LateFilter, LateOptions};
use realnet_core::{OptionError, Stamp, TrackStatus};
use std::collections::VecDeque;

/// Estimates where a target is and how it moves, in a plane frame that stands still,
/// from ranges and directions by a moving camera, in whatever order they come.
///
/// See the [crate](crate) for the model. All memory is allocated by
/// [`TargetFilter::new`].
pub struct TargetFilter {
    filter: LateFilter<TargetModel>,
    options: TargetOptions,
    /// Points that passed the horizon.
    old_trail: VecDeque<TrailPoint>,
}

impl TargetFilter {
    /// A filter that is searching.
    ///
    /// # Errors
    ///
    /// [`OptionError`] names the field that makes no sense.
    pub fn new(options: TargetOptions) -> Result<Self, OptionError> {
        options.check()?;
        let model = TargetModel::new(options);
        let initial = model.initial();
        let late = LateOptions {
            horizon_s: options.horizon_s,
            capacity: options.capacity,
            max_ahead_s: options.max_ahead_s,
        };
        let filter = LateFilter::new(model, initial, &late)?;
        let old_trail = VecDeque::with_capacity(options.trail_capacity);
        Ok(Self { filter, options, old_trail })
    }

    /// The options.
    #[must_use]
    pub const fn options(&self) -> &TargetOptions {
        &self.options
    }

    /// Takes a measurement, early or late. Whether it is used is decided by the replay:
    /// see [`TargetFilter::outcomes`].
    ///
    /// # Errors
    ///
    /// [`LateError`]; nothing is changed then.
    pub fn push(&mut self, measurement: TargetMeasurement) -> Result<Arrival, LateError> {
        let Self { filter, old_trail, options } = self;
        let limit = options.trail_capacity;
        let mut keep = |stamp: Stamp, moment: &TargetMoment| {
            let Some(point) = moment.trail_point(stamp).filter(|_| limit > 0) else { return };
            if old_trail.back().is_some_and(|last| last.stamp == stamp) {
                old_trail.pop_back();
            } else if old_trail.len() == limit {
                old_trail.pop_front();
            }
            old_trail.push_back(point);
        };
        filter.push_with(measurement.stamp, measurement.source(), measurement, &mut keep)
    }

    /// Tells that it is now `now`, for the limit of [`TargetOptions::max_ahead_s`]; changes
    /// nothing else. [`TargetFilter::track_at`] tells it too: needed only where a
    /// measurement comes before the first question after a pause.
    pub fn advance(&mut self, now: Stamp) {
        self.filter.advance(now);
    }

    /// What is known about the target at a time, at or after the horizon: usually the
    /// time at which the next command takes effect.
    ///
    /// # Errors
    ///
    /// [`LateError::BeforeHorizon`]. Before the first measurement the answer is a track
    /// that is searching.
    pub fn track_at(&mut self, stamp: Stamp) -> Result<Track, LateError> {
        self.filter.advance(stamp);
        let unknown_above = self.options.unknown_above;
        let nothing = |measured| Track {
            stamp,
            status: TrackStatus::Searching,
            measured,
            motion: None,
            unknown_above,
        };
        let estimate = match self.filter.at(stamp) {
            Ok(estimate) => estimate,
            Err(LateError::Empty) => return Ok(nothing(None)),
            Err(error) => return Err(error),
        };
        let moment = estimate.state;
        let status = moment.status_at(stamp, &self.options.times);
        if status == TrackStatus::Searching {
            return Ok(nothing(moment.newest_range()));
        }
        let gaussian = moment.gaussian();
        let mean = gaussian.mean().fixed_rows::<6>(0).into_owned();
        let motion = Motion::new(&mean, gaussian.covariance_of_first::<6>());
        let measured = moment.newest_range();
        Ok(Track { stamp, status, measured, motion: Some(motion), unknown_above })
    }

    /// Where the target was at each measured stamp from `since` on, the oldest first;
    /// within the horizon by what is known now of the measurements up to each.
    pub fn trail(&mut self, since: Stamp) -> impl Iterator<Item = TrailPoint> {
        let first = self.old_trail.partition_point(|point| point.stamp < since);
        let old = self.old_trail.range(first..).copied();
        let mut kept = self.filter.states(since).peekable();
        // Of several measurements with one stamp the last has all of them in it.
        let kept = std::iter::from_fn(move || {
            loop {
                let (stamp, moment) = kept.next()?;
                if kept.peek().is_some_and(|(next, _)| *next == stamp) {
                    continue;
                }
                if let Some(point) = moment.trail_point(stamp) {
                    return Some(point);
                }
            }
        });
        old.chain(kept)
    }

    /// What became of the measurements within the horizon, in the order of their stamps.
    pub fn outcomes(&mut self) -> impl Iterator<Item = (Stamp, Source, Outcome)> {
        self.filter.outcomes().map(|(stamp, source, outcome)| (stamp, source, *outcome))
    }

    /// The scale of the network's depth maps as it is estimated at a time: what a depth
    /// of the network has to be divided by, and the relative standard deviation of that.
    ///
    /// # Errors
    ///
    /// Those of [`LateFilter::at`].
    pub fn network_scale_at(&mut self, stamp: Stamp) -> Result<(f64, f64), LateError> {
        Ok(self.filter.at(stamp)?.state.network_scale())
    }

    /// The oldest time that a measurement or a question may have.
    #[must_use]
    pub fn horizon(&self) -> Option<Stamp> {
        self.filter.horizon()
    }

    /// Stamp of the newest measurement.
    #[must_use]
    pub const fn newest(&self) -> Option<Stamp> {
        self.filter.newest()
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.filter.clear();
        self.old_trail.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracking::{DirectionSource, Reading};
    use realnet_core::Pose2;

    #[test]
    fn after_a_pause_it_must_be_told_what_time_it_is() {
        let options = TargetOptions::default();
        let mut filter = TargetFilter::new(options).unwrap();
        let at = |seconds: f64| TargetMeasurement {
            stamp: Stamp::from_secs_f64(seconds),
            fixed_from_camera: Pose2::IDENTITY,
            reading: Reading::Direction {
                tangent: 0.0,
                std: 0.01,
                source: DirectionSource::Detection,
            },
        };
        filter.push(at(1.0)).unwrap();
        let later = 3.0 * options.max_ahead_s;
        let refused = filter.push(at(later));
        assert!(matches!(refused, Err(LateError::TooFarAhead { .. })), "{refused:?}");
        filter.advance(Stamp::from_secs_f64(later));
        assert_eq!(filter.push(at(later)), Ok(Arrival::InOrder));
        // Time does not go back by being told so.
        filter.advance(Stamp::ZERO);
        assert_eq!(filter.push(at(later + options.max_ahead_s)), Ok(Arrival::InOrder));
    }
}
