//! What the filters answer is a function of the set of measurements: the order of
//! arrival, losses and duplicates make no difference, to the last bit.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;

use common::{Random, Setup, log};
use proptest::prelude::*;
use realnet_core::Stamp;
use realnet_core::nalgebra::{Matrix2, Vector1, Vector2};
use realnet_fusion::{
    Arrival, BadMeasurement, Gaussian, LateError, LateFilter, LateOptions, Model, Publisher,
    TargetFilter, TargetMeasurement, TargetOptions,
};

/// Position and velocity; positions are measured; a gate; the state counts its refusals,
/// and starts again after three.
#[derive(Clone, Copy)]
struct Line;

#[derive(Clone, Debug, PartialEq)]
struct LineState {
    gaussian: Gaussian<2>,
    refusals: u32,
}

impl Model for Line {
    type State = LineState;
    type Source = u8;
    type Measurement = (f64, f64);
    type Outcome = bool;

    fn check(&self, &(value, std): &(f64, f64)) -> Result<(), BadMeasurement> {
        BadMeasurement::unless_within("position", value, -1e6, 1e6)?;
        BadMeasurement::unless_within("std", std, 1e-6, 1e6)
    }

    fn predict(&self, state: &mut LineState, from: Stamp, to: Stamp) {
        let dt = to.seconds_since(from);
        assert!(dt > 0.0, "asked to predict over {dt} s");
        let noise = Vector2::new(0.5 * dt, 1.0);
        state.gaussian.predict(&Matrix2::new(1.0, dt, 0.0, 1.0), &noise, &Vector1::new(dt));
    }

    fn update(&self, state: &mut LineState, _: Stamp, _: u8, &(value, std): &(f64, f64)) -> bool {
        let row = Vector2::new(1.0, 0.0);
        let residual = value - state.gaussian.mean().x;
        let spread = state.gaussian.variance_along(&row) + std * std;
        if residual * residual > 9.0 * spread {
            state.refusals += 1;
            if state.refusals >= 3 {
                *state = start(value);
            }
            return false;
        }
        state.refusals = 0;
        state.gaussian.update(residual, &row, std * std).is_ok()
    }
}

fn start(value: f64) -> LineState {
    let gaussian = Gaussian::independent(Vector2::new(value, 0.0), &Vector2::new(3.0, 1.0));
    LineState { gaussian: gaussian.unwrap(), refusals: 0 }
}

fn line(horizon_s: f64, capacity: usize) -> LateFilter<Line> {
    let options = LateOptions { horizon_s, capacity, max_ahead_s: f64::INFINITY };
    LateFilter::new(Line, start(0.0), &options).unwrap()
}

type Reading = (Stamp, u8, (f64, f64));

/// Uneven steps, several sources at one stamp, some of them far off.
fn readings() -> impl Strategy<Value = Vec<Reading>> {
    let one = (0..40_u32, 0..3_u8, -3.0..3.0f64, 0.05..2.0f64, 0..8_u8);
    proptest::collection::vec(one, 1..60).prop_map(|all| {
        let mut taken = std::collections::BTreeMap::new();
        for (tick, source, value, std, kind) in all {
            let stamp = Stamp::from_nanos(i64::from(tick * tick) * 1_000_000);
            let value = if kind == 0 { value * 50.0 } else { value };
            taken.entry((stamp, source)).or_insert((value, std));
        }
        taken.into_iter().map(|((stamp, source), reading)| (stamp, source, reading)).collect()
    })
}

fn shuffle<T>(items: &mut [T], random: &mut Random) {
    for last in (1..items.len()).rev() {
        items.swap(last, random.bits() as usize % (last + 1));
    }
}

/// Nothing of a filter: the measurements in order, one after the other.
fn batch(readings: &[Reading]) -> (LineState, Vec<bool>) {
    let mut state = start(0.0);
    let mut outcomes = Vec::new();
    let mut last = None;
    for (stamp, source, reading) in readings {
        if let Some(last) = last.filter(|last| last < stamp) {
            Line.predict(&mut state, last, *stamp);
        }
        outcomes.push(Line.update(&mut state, *stamp, *source, reading));
        last = Some(*stamp);
    }
    (state, outcomes)
}

proptest! {
    #[test]
    fn any_order_gives_the_batch(readings in readings(), seed in any::<u64>()) {
        let (expected, outcomes) = batch(&readings);
        let random = &mut Random(seed);
        let mut arriving = readings.clone();
        // a third comes twice
        arriving.extend(readings.iter().filter(|(stamp, ..)| stamp.nanos() % 3 == 0));
        shuffle(&mut arriving, random);
        let mut filter = line(10.0, 200);
        let mut duplicates = 0;
        for (stamp, source, reading) in &arriving {
            let arrival = filter.push(*stamp, *source, *reading).unwrap();
            duplicates += usize::from(arrival == Arrival::Duplicate);
            if random.bits().is_multiple_of(4) {
                // questions in between change nothing
                filter.at(*stamp).unwrap();
            }
        }
        prop_assert_eq!(duplicates, arriving.len() - readings.len());
        let newest = readings.last().unwrap().0;
        let found = filter.at(newest).unwrap();
        prop_assert_eq!(&found.state, &expected, "equal to the last bit");
        prop_assert_eq!(found.measured, Some(newest));
        let found: Vec<bool> = filter.outcomes().map(|(_, _, used)| *used).collect();
        prop_assert_eq!(found, outcomes);
        // and in the middle
        let (middle, _) = batch(&readings[..=readings.len() / 2]);
        let stamp = readings[readings.len() / 2].0;
        if readings.get(readings.len() / 2 + 1).is_none_or(|next| next.0 > stamp) {
            prop_assert_eq!(filter.at(stamp).unwrap().state, middle);
        }
    }

    /// With a short horizon: what was not refused gives the same as in order, and what
    /// was refused really was too old.
    #[test]
    fn beyond_the_horizon_is_refused_with_a_reason(
        readings in readings(), seed in any::<u64>(), capacity in 3..80_usize,
    ) {
        let mut arriving = readings.clone();
        shuffle(&mut arriving, &mut Random(seed));
        let mut filter = line(0.4, capacity);
        let mut accepted = Vec::new();
        let mut finals = Vec::new();
        for (stamp, source, reading) in arriving {
            let (newest, horizon) = (filter.newest(), filter.horizon());
            let before: Vec<_> = filter.outcomes().map(|(s, k, o)| (s, k, *o)).collect();
            let full = filter.len() == capacity;
            match filter.push_with(stamp, source, reading, &mut |s, _| finals.push(s)) {
                Ok(arrival) => {
                    prop_assert!(arrival != Arrival::Duplicate);
                    accepted.push((stamp, source, reading));
                }
                Err(LateError::BeforeHorizon { stamp: refused, horizon: limit, newest: last }) => {
                    prop_assert_eq!((refused, Some(last)), (stamp, newest));
                    prop_assert!(refused <= limit || full);
                    prop_assert!(Some(limit) >= horizon);
                    let after: Vec<_> = filter.outcomes().map(|(s, k, o)| (s, k, *o)).collect();
                    prop_assert_eq!(before, after);
                }
                Err(other) => return Err(TestCaseError::fail(other.to_string())),
            }
            prop_assert!(filter.len() <= capacity);
        }
        prop_assert!(finals.is_sorted());
        prop_assert_eq!(finals.len() + filter.len(), accepted.len());
        accepted.sort_by_key(|(stamp, source, _)| (*stamp, *source));
        let (expected, _) = batch(&accepted);
        let newest = filter.newest().unwrap();
        prop_assert_eq!(filter.at(newest).unwrap().state, expected);
        let error = filter.at(Stamp::from_nanos(-1_000_000_000)).unwrap_err();
        prop_assert!(matches!(error, LateError::BeforeHorizon { .. }), "{error}");
    }

    /// The same for the target filter: re-ordered arrivals, losses, duplicates; also
    /// where targets are lost and begun anew and sources disagree.
    #[test]
    fn the_target_does_not_depend_on_the_order(
        seed in 0..1000_u64, order in any::<u64>(), lost in 0.0..0.6f64, jump in any::<bool>(),
    ) {
        let setup = Setup {
            seconds: 2.0, lost, ground: Some((0.05, 0.1)), size: Some((0.05, 0.1)),
            network_scale: if jump { 0.8 } else { 0.0 }, ..Setup::default()
        };
        let options = TargetOptions { horizon_s: 10.0, capacity: 400, ..TargetOptions::default() };
        let mut arriving: Vec<TargetMeasurement> =
            log(seed, &setup).arriving.into_iter().map(|a| a.measurement).collect();
        if jump {
            // Half way the target is another one.
            for m in arriving.iter_mut().filter(|m| m.stamp.secs_f64() > 1.0) {
                m.fixed_from_camera.heading += 0.8;
                m.fixed_from_camera.x += 3.0;
            }
        }
        let mut sorted = arriving.clone();
        sorted.sort_by_key(|m| (m.stamp, m.source()));
        let mut in_order = TargetFilter::new(options).unwrap();
        for m in &sorted {
            prop_assert_eq!(in_order.push(*m).unwrap(), Arrival::InOrder);
            in_order.track_at(m.stamp).unwrap();
        }
        let random = &mut Random(order);
        arriving.extend_from_within(..arriving.len() / 3);
        shuffle(&mut arriving, random);
        let mut shuffled = TargetFilter::new(options).unwrap();
        for m in &arriving {
            shuffled.push(*m).unwrap();
            if random.bits().is_multiple_of(8) {
                shuffled.track_at(m.stamp).unwrap();
            }
        }
        for s in [0.5, 1.0, 1.3, 2.0, 2.2] {
            let stamp = Stamp::from_secs_f64(s);
            let (a, b) = (in_order.track_at(stamp).unwrap(), shuffled.track_at(stamp).unwrap());
            prop_assert_eq!(a, b, "equal to the last bit");
        }
        prop_assert!(in_order.outcomes().eq(shuffled.outcomes()));
        let from = Stamp::ZERO;
        prop_assert!(in_order.trail(from).eq(shuffled.trail(from)));
    }
}

#[test]
fn a_second_late_measurement_may_be_older_than_the_first() {
    let second = |s: f64| Stamp::from_secs_f64(s);
    let mut filter = line(5.0, 100);
    let mut all = Vec::new();
    for i in 0..30 {
        all.push((second(f64::from(i) * 0.1), 0, (f64::from(i) * 0.05, 0.3)));
    }
    let late =
        [(second(2.0), 1, (1.1, 0.1)), (second(1.0), 2, (0.4, 0.1)), (second(0.0), 1, (0.0, 0.1))];
    for (stamp, source, reading) in &all {
        filter.push(*stamp, *source, *reading).unwrap();
    }
    for ((stamp, source, reading), expected) in late.iter().zip([9, 20, 31]) {
        let arrival = filter.push(*stamp, *source, *reading).unwrap();
        assert_eq!(arrival, Arrival::Late { replayed: expected });
        filter.at(second(3.0)).unwrap();
    }
    all.extend(late);
    all.sort_by_key(|(stamp, source, _)| (*stamp, *source));
    assert_eq!(filter.at(all[all.len() - 1].0).unwrap().state, batch(&all).0);
}

#[test]
fn bad_numbers_and_stamps_are_refused_and_change_nothing() {
    let options = LateOptions { max_ahead_s: 2.0, ..LateOptions::default() };
    let mut filter = LateFilter::new(Line, start(0.0), &options).unwrap();
    assert_eq!(filter.at(Stamp::ZERO).unwrap_err(), LateError::Empty);
    let at = |s: f64| Stamp::from_secs_f64(s);
    filter.push(at(1.0), 0, (0.5, 0.1)).unwrap();
    let before = filter.at(at(1.5)).unwrap();
    for bad in [f64::NAN, f64::INFINITY, 1e7] {
        let error = filter.push(at(1.2), 0, (bad, 0.1)).unwrap_err();
        assert!(matches!(
            error,
            LateError::Bad { bad: BadMeasurement { what: "position", .. }, .. }
        ));
    }
    assert!(filter.push(at(1.2), 0, (0.5, 0.0)).is_err());
    let error = filter.push(at(3.5), 0, (0.5, 0.1)).unwrap_err();
    assert_eq!(
        error.to_string(),
        "stamp 3.500000000 s is 2.5 s ahead of 1.000000000 s, the limit is 2 s"
    );
    assert_eq!(filter.at(at(1.5)).unwrap(), before);
    assert_eq!(filter.len(), 1);
    // Time went on, and nothing was measured in it.
    filter.advance(at(3.0));
    assert_eq!(filter.push(at(3.5), 0, (0.5, 0.1)), Ok(Arrival::InOrder));
    filter.clear();
    assert!(filter.is_empty() && filter.horizon().is_none());
    assert!(filter.push(at(-100.0), 0, (0.5, 0.1)).is_ok());
    for (horizon_s, capacity, max_ahead_s) in
        [(0.0, 5, 1.0), (f64::NAN, 5, 1.0), (1.0, 0, 1.0), (1.0, 5, -1.0), (1.0, 5, f64::NAN)]
    {
        let options = LateOptions { horizon_s, capacity, max_ahead_s };
        assert!(LateFilter::new(Line, start(0.0), &options).is_err(), "{options:?}");
    }
}

#[test]
fn published_stamps_never_go_back() {
    let at = |s: f64| Stamp::from_secs_f64(s);
    let mut filter = line(5.0, 100);
    let mut publisher = Publisher::new();
    assert!(publisher.publish(&mut filter, at(1.0)).is_err());
    assert_eq!(publisher.last(), None);
    let random = &mut Random(7);
    let mut last = at(-1.0);
    for step in 0..200 {
        let now = f64::from(step) * 0.03;
        let stamp = at(now - random.uniform(0.0, 1.0));
        filter.push(stamp, (random.bits() % 200) as u8, (now, 0.2)).unwrap();
        let output = publisher.publish(&mut filter, at(now - random.uniform(0.0, 0.5))).unwrap();
        assert!(output.stamp >= last, "{} after {last}", output.stamp);
        last = output.stamp;
    }
    assert_eq!(publisher.next_stamp(at(0.0)), last);
    assert_eq!(publisher.next_stamp(at(1e3)), at(1e3));
}
