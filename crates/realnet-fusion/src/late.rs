//! A filter whose measurements may come late, twice, or not at all.

use realnet_core::{OptionError, Stamp};
use std::collections::VecDeque;
use thiserror::Error;

/// What a [`LateFilter`] estimates and how: the state, how time changes it, what a
/// measurement tells about it. All functions depend on their arguments alone, or a
/// replay would not give what the first run gave.
pub trait Model {
    /// Everything that a measurement or time may change: usually a
    /// [`Gaussian`](crate::Gaussian), with counters and modes if the model has them.
    type State: Clone;
    /// Who measured. Two measurements with the same stamp are used in the order of
    /// their sources; a second one with the same stamp and source is a duplicate.
    type Source: Copy + Ord;
    /// What was measured, with its uncertainty.
    type Measurement: Clone;
    /// What became of a measurement: used, outside the gate, ...
    type Outcome: Clone;

    /// Refuses a measurement before it is stored: numbers that are not finite, a
    /// deviation that is not positive.
    ///
    /// # Errors
    ///
    /// [`BadMeasurement`] names the number.
    fn check(&self, measurement: &Self::Measurement) -> Result<(), BadMeasurement>;

    /// Moves the state from one time to a later one.
    fn predict(&self, state: &mut Self::State, from: Stamp, to: Stamp);

    /// Uses a measurement, or leaves it unused (a gate belongs here: it is then part of
    /// the replay, and its decision does not depend on the order of arrival).
    fn update(
        &self,
        state: &mut Self::State,
        stamp: Stamp,
        source: Self::Source,
        measurement: &Self::Measurement,
    ) -> Self::Outcome;
}

/// A number that no measurement can have.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("{what} is {value}, outside {low} to {high}")]
pub struct BadMeasurement {
    /// Which number.
    pub what: &'static str,
    /// Its value.
    pub value: f64,
    /// Lowest value that is allowed.
    pub low: f64,
    /// Highest value that is allowed.
    pub high: f64,
}

impl BadMeasurement {
    /// Refuses what lies outside `low` to `high` or is not a number.
    ///
    /// # Errors
    ///
    /// Itself.
    pub fn unless_within(
        what: &'static str,
        value: f64,
        low: f64,
        high: f64,
    ) -> Result<(), BadMeasurement> {
        if (low..=high).contains(&value) { Ok(()) } else { Err(Self { what, value, low, high }) }
    }
}

/// Why a measurement or a question is refused. Nothing is changed then.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum LateError {
    /// Older than what is kept for replay.
    #[error("stamp {stamp} is before the horizon {horizon} (newest measurement {newest})")]
    BeforeHorizon {
        /// Of the measurement or the question.
        stamp: Stamp,
        /// Oldest stamp that can still be taken.
        horizon: Stamp,
        /// Newest measurement.
        newest: Stamp,
    },
    /// So far in the future that the stamp must be wrong; taking it would push all that
    /// is kept over the horizon.
    #[error("stamp {stamp} is {ahead_s} s ahead of {newest}, the limit is {limit_s} s")]
    TooFarAhead {
        /// Of the measurement.
        stamp: Stamp,
        /// Newest time that is known.
        newest: Stamp,
        /// From there to the measurement, seconds.
        ahead_s: f64,
        /// The limit, seconds.
        limit_s: f64,
    },
    /// A number that no measurement can have.
    #[error("measurement of {stamp}: {bad}")]
    Bad {
        /// Of the measurement.
        stamp: Stamp,
        /// The number.
        bad: BadMeasurement,
    },
    /// Nothing was measured yet.
    #[error("nothing was measured yet")]
    Empty,
}

/// How a measurement came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// It is the newest.
    InOrder,
    /// So many measurements that are newer will be replayed after it.
    Late {
        /// Number of measurements.
        replayed: usize,
    },
    /// One with this stamp and source is there; this one was dropped.
    Duplicate,
}

/// Memory of a [`LateFilter`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LateOptions {
    /// How far back of the newest measurement one may lie, seconds.
    pub horizon_s: f64,
    /// Most measurements that are kept. If more than this lie within `horizon_s` the
    /// oldest are let go and the horizon is nearer.
    pub capacity: usize,
    /// How far ahead of the newest known time ([`LateFilter::advance`]) a measurement
    /// may lie, seconds; infinite for no limit.
    pub max_ahead_s: f64,
}

impl Default for LateOptions {
    fn default() -> Self {
        Self { horizon_s: 1.0, capacity: 256, max_ahead_s: f64::INFINITY }
    }
}

/// The state at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate<S> {
    /// That time.
    pub stamp: Stamp,
    /// Stamp of the newest measurement in it; `None` if the initial state is all.
    pub measured: Option<Stamp>,
    /// The state, predicted from that measurement.
    pub state: S,
}

/// A measurement that is kept, and what became of it.
struct Entry<M: Model> {
    stamp: Stamp,
    source: M::Source,
    measurement: M::Measurement,
    outcome: Option<M::Outcome>,
}

impl<M: Model> Entry<M> {
    const fn key(&self) -> (Stamp, M::Source) {
        (self.stamp, self.source)
    }
}

/// A filter that takes measurements in any order.
///
/// Measurements are kept sorted by stamp and source, each with the state after it. A
/// late one takes its place, and those after it are replayed from the state before it
/// when the next question is asked (so a bundle of late measurements costs one replay).
/// Therefore **every answer is a function of the set of measurements** within the
/// horizon, equal to the last bit to that of a filter which got them in order, once
/// each. What lies before the horizon is refused with an error.
///
/// All memory is allocated by [`LateFilter::new`] (unless cloning the state does).
pub struct LateFilter<M: Model> {
    model: M,
    horizon_ns: i64,
    capacity: usize,
    max_ahead_s: f64,
    initial: M::State,
    /// The state after all measurements that were let go, and the key of the last one.
    base: M::State,
    base_key: Option<(Stamp, M::Source)>,
    entries: VecDeque<Entry<M>>,
    /// The states after the first entries; the rest is yet to be replayed.
    states: VecDeque<M::State>,
    newest: Option<Stamp>,
    now: Option<Stamp>,
}

impl<M: Model> LateFilter<M> {
    /// A filter without measurements. `initial` holds at the time of the first
    /// measurement, whichever that will be.
    ///
    /// # Errors
    ///
    /// [`OptionError`] if a time is not positive or the capacity is 0.
    pub fn new(model: M, initial: M::State, options: &LateOptions) -> Result<Self, OptionError> {
        let LateOptions { horizon_s, capacity, max_ahead_s } = *options;
        OptionError::check("horizon_s", horizon_s, horizon_s > 0.0, "positive and finite")?;
        // It may be infinite.
        if max_ahead_s.is_nan() || max_ahead_s <= 0.0 {
            let rule = "positive";
            return Err(OptionError { name: "max_ahead_s", value: max_ahead_s, rule });
        }
        OptionError::check("capacity", capacity as f64, capacity > 0, "at least 1")?;
        Ok(Self {
            model,
            horizon_ns: Stamp::from_secs_f64(horizon_s).nanos(),
            capacity,
            max_ahead_s,
            base: initial.clone(),
            initial,
            base_key: None,
            entries: VecDeque::with_capacity(capacity),
            states: VecDeque::with_capacity(capacity),
            newest: None,
            now: None,
        })
    }

    /// The model.
    pub const fn model(&self) -> &M {
        &self.model
    }

    /// Stamp of the newest measurement.
    #[must_use]
    pub const fn newest(&self) -> Option<Stamp> {
        self.newest
    }

    /// Number of measurements that are kept.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether nothing was measured yet.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.newest.is_none()
    }

    /// The oldest time that a measurement or a question may have; `None` before the
    /// first measurement.
    #[must_use]
    pub fn horizon(&self) -> Option<Stamp> {
        let newest = self.newest?;
        let by_time = Stamp::from_nanos(newest.nanos().saturating_sub(self.horizon_ns));
        Some(self.base_key.map_or(by_time, |(stamp, _)| stamp.max(by_time)))
    }

    /// Forgets all measurements, and starts again from the initial state.
    pub fn clear(&mut self) {
        self.entries.clear();
        self.states.clear();
        self.base = self.initial.clone();
        self.base_key = None;
        self.newest = None;
        self.now = None;
    }

    /// Tells that it is now `now`, for the limit of [`LateOptions::max_ahead_s`]; changes
    /// nothing else. Needed only where nothing may be measured for longer than that.
    pub fn advance(&mut self, now: Stamp) {
        self.now = self.now.max(Some(now));
    }

    /// Takes a measurement.
    ///
    /// # Errors
    ///
    /// [`LateError::Bad`], [`LateError::BeforeHorizon`], [`LateError::TooFarAhead`].
    pub fn push(
        &mut self,
        stamp: Stamp,
        source: M::Source,
        measurement: M::Measurement,
    ) -> Result<Arrival, LateError> {
        self.push_with(stamp, source, measurement, &mut |_, _| ())
    }

    /// [`LateFilter::push`] that hands over what becomes final: the state after each
    /// measurement that passes the horizon, in the order of stamps.
    ///
    /// # Errors
    ///
    /// Those of [`LateFilter::push`].
    pub fn push_with(
        &mut self,
        stamp: Stamp,
        source: M::Source,
        measurement: M::Measurement,
        on_final: &mut impl FnMut(Stamp, &M::State),
    ) -> Result<Arrival, LateError> {
        self.model.check(&measurement).map_err(|bad| LateError::Bad { stamp, bad })?;
        if let Some(newest) = self.now.max(self.newest) {
            let ahead_s = stamp.seconds_since(newest);
            if ahead_s > self.max_ahead_s {
                let limit_s = self.max_ahead_s;
                return Err(LateError::TooFarAhead { stamp, newest, ahead_s, limit_s });
            }
        }
        let key = (stamp, source);
        if let (Some(newest), Some(horizon)) = (self.newest, self.horizon()) {
            let passed = self.base_key.is_some_and(|base| key <= base);
            if stamp < horizon || passed {
                return Err(LateError::BeforeHorizon { stamp, horizon, newest });
            }
        }
        let place = self.entries.partition_point(|entry| entry.key() < key);
        if self.entries.get(place).is_some_and(|entry| entry.key() == key) {
            return Ok(Arrival::Duplicate);
        }
        let mut place = place;
        if self.entries.len() == self.capacity {
            if place == 0 {
                // Older than all of a full buffer: the horizon is at its front.
                let newest = self.newest.unwrap_or(stamp);
                let horizon = self.entries.front().map_or(stamp, |entry| entry.stamp);
                return Err(LateError::BeforeHorizon { stamp, horizon, newest });
            }
            self.let_go(on_final);
            place -= 1;
        }
        self.newest = self.newest.max(Some(stamp));
        self.states.truncate(place);
        let entry = Entry { stamp, source, measurement, outcome: None };
        self.entries.insert(place, entry);
        if let Some(newest) = self.newest {
            let horizon = newest.nanos().saturating_sub(self.horizon_ns);
            while self.entries.front().is_some_and(|entry| entry.stamp.nanos() < horizon) {
                self.let_go(on_final);
                place = place.saturating_sub(1);
            }
        }
        let replayed = self.entries.len().saturating_sub(place + 1);
        Ok(if replayed == 0 { Arrival::InOrder } else { Arrival::Late { replayed } })
    }

    /// The state at a time at or after the horizon, by all measurements up to that
    /// time; predicted if it lies after the newest.
    ///
    /// # Errors
    ///
    /// [`LateError::Empty`] before the first measurement, [`LateError::BeforeHorizon`].
    pub fn at(&mut self, stamp: Stamp) -> Result<Estimate<M::State>, LateError> {
        let (Some(newest), Some(horizon)) = (self.newest, self.horizon()) else {
            return Err(LateError::Empty);
        };
        if stamp < horizon {
            return Err(LateError::BeforeHorizon { stamp, horizon, newest });
        }
        self.replay();
        let count = self.entries.partition_point(|entry| entry.stamp <= stamp);
        let last = count.checked_sub(1);
        let (from, state) = match last.and_then(|i| self.entries.get(i).zip(self.states.get(i))) {
            Some((entry, state)) => (Some(entry.stamp), state),
            None => (self.base_key.map(|(stamp, _)| stamp), &self.base),
        };
        let mut state = state.clone();
        if let Some(from) = from.filter(|from| *from < stamp) {
            self.model.predict(&mut state, from, stamp);
        }
        Ok(Estimate { stamp, measured: from, state })
    }

    /// What became of the measurements that are kept, in the order of stamp and source.
    pub fn outcomes(&mut self) -> impl Iterator<Item = (Stamp, M::Source, &M::Outcome)> {
        self.replay();
        let known = |entry: &'_ Entry<M>| (entry.stamp, entry.source);
        self.entries.iter().filter_map(move |entry| {
            let (stamp, source) = known(entry);
            entry.outcome.as_ref().map(|outcome| (stamp, source, outcome))
        })
    }

    /// The states after each measurement that is kept from `since` on, in the order of
    /// stamp and source.
    pub fn states(&mut self, since: Stamp) -> impl Iterator<Item = (Stamp, &M::State)> {
        self.replay();
        let first = self.entries.partition_point(|entry| entry.stamp < since);
        let stamps = self.entries.iter().map(|entry| entry.stamp);
        stamps.zip(self.states.iter()).skip(first)
    }

    /// Lets the oldest measurement go: the state after it is the new base.
    fn let_go(&mut self, on_final: &mut impl FnMut(Stamp, &M::State)) {
        if self.states.is_empty() {
            self.replay_one();
        }
        if let (Some(entry), Some(state)) = (self.entries.pop_front(), self.states.pop_front()) {
            on_final(entry.stamp, &state);
            self.base = state;
            self.base_key = Some((entry.stamp, entry.source));
        }
    }

    fn replay(&mut self) {
        while self.states.len() < self.entries.len() {
            self.replay_one();
        }
    }

    /// The state after the first entry that has none.
    fn replay_one(&mut self) {
        let index = self.states.len();
        let (from, state) = match index.checked_sub(1) {
            Some(last) => (self.entries.get(last).map(|entry| entry.stamp), self.states.back()),
            None => (self.base_key.map(|(stamp, _)| stamp), None),
        };
        let mut state = state.unwrap_or(&self.base).clone();
        let Some(entry) = self.entries.get_mut(index) else { return };
        if let Some(from) = from.filter(|from| *from < entry.stamp) {
            self.model.predict(&mut state, from, entry.stamp);
        }
        let outcome = self.model.update(&mut state, entry.stamp, entry.source, &entry.measurement);
        entry.outcome = Some(outcome);
        self.states.push_back(state);
    }
}

/// Asks a filter for output whose stamps never go back, whatever comes late: a late
/// measurement changes the next answer, never its time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Publisher {
    last: Option<Stamp>,
}

impl Publisher {
    /// Nothing is published yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { last: None }
    }

    /// Stamp of the last output.
    #[must_use]
    pub const fn last(&self) -> Option<Stamp> {
        self.last
    }

    /// The stamp of the next output: the one asked for, or that of the last output if
    /// that is later.
    pub fn next_stamp(&mut self, asked: Stamp) -> Stamp {
        let stamp = self.last.map_or(asked, |last| last.max(asked));
        self.last = Some(stamp);
        stamp
    }

    /// The state at `asked`, or at the stamp of the last output if that is later.
    ///
    /// # Errors
    ///
    /// Those of [`LateFilter::at`]; nothing is published then.
    pub fn publish<M: Model>(
        &mut self,
        filter: &mut LateFilter<M>,
        asked: Stamp,
    ) -> Result<Estimate<M::State>, LateError> {
        let stamp = self.last.map_or(asked, |last| last.max(asked));
        let estimate = filter.at(stamp)?;
        self.last = Some(stamp);
        Ok(estimate)
    }
}
