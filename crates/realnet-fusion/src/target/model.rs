//! The model behind the target filter.
//!
//! State: position, velocity, acceleration (x and y of each, fixed frame); the scale
//! errors of the last maps; the scale error common to all maps; the shared errors of
//! ground and size ranges. All errors are of the logarithm of the range.

use super::measurement::{Outcome, RangeSource, Reading, Source, TargetMeasurement};
use super::motion;
use super::options::{SharedError, StatusTimes, TargetOptions};
use super::track::TrailPoint;
use crate::gaussian::Gaussian;
use crate::late::{BadMeasurement, Model};
use realnet_core::nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use realnet_core::{Stamp, TrackStatus};

/// Maps whose scale errors are followed at a time: ranges of the one before the newest
/// go on coming until the newest one is there.
const MAPS: usize = 4;
const FIRST_MAP: usize = 6;
const NETWORK: usize = FIRST_MAP + MAPS;
const GROUND: usize = NETWORK + 1;
const SIZE: usize = NETWORK + 2;
const STATES: usize = NETWORK + 3;

/// Nearer than this along the optical axis a target is not in view, metres.
const NEAREST: f64 = 0.01;
/// The logarithm of the range stays within this of zero: 45 µm to 22 km.
const LONGEST_LOG: f64 = 10.0;

type Row = SVector<f64, STATES>;

/// Kinds of measurements that are refused or accepted as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stream {
    Direction,
    Network,
    Ground,
    Size,
}

impl Stream {
    const RANGES: [Self; 3] = [Self::Network, Self::Ground, Self::Size];

    const fn of(measurement: &TargetMeasurement) -> Self {
        match measurement.reading {
            Reading::Direction { .. } => Self::Direction,
            Reading::Range { source: RangeSource::Network { .. }, .. } => Self::Network,
            Reading::Range { source: RangeSource::Ground, .. } => Self::Ground,
            Reading::Range { source: RangeSource::Size, .. } => Self::Size,
        }
    }
}

/// What is known of one stream.
#[derive(Clone, Copy, Debug, Default)]
struct StreamState {
    /// Newest measurement that was used.
    accepted: Option<Stamp>,
    /// First of the refusals since then.
    refused_since: Option<Stamp>,
    /// Number of them.
    refusals: u32,
}

/// All that a measurement or time may change.
#[derive(Clone)]
pub(crate) struct TargetMoment {
    gaussian: Gaussian<STATES>,
    /// There is a target; otherwise only the errors mean something.
    alive: bool,
    /// Which map's scale error is in which place.
    maps: [Option<Stamp>; MAPS],
    streams: [StreamState; 4],
    /// The last ones, used or not, to begin a track with.
    last_direction: Option<TargetMeasurement>,
    last_range: Option<TargetMeasurement>,
}

impl TargetMoment {
    pub(crate) const fn gaussian(&self) -> &Gaussian<STATES> {
        &self.gaussian
    }

    fn stream(&mut self, stream: Stream) -> &mut StreamState {
        let [direction, network, ground, size] = &mut self.streams;
        match stream {
            Stream::Direction => direction,
            Stream::Network => network,
            Stream::Ground => ground,
            Stream::Size => size,
        }
    }

    const fn newest_direction(&self) -> Option<Stamp> {
        let [direction, ..] = &self.streams;
        direction.accepted
    }

    pub(crate) fn newest_range(&self) -> Option<Stamp> {
        let [_, ranges @ ..] = &self.streams;
        ranges.iter().filter_map(|stream| stream.accepted).max()
    }

    /// Since the older one of the newest range and the newest direction, seconds.
    fn age_at(&self, stamp: Stamp) -> f64 {
        match (self.newest_direction(), self.newest_range()) {
            (Some(direction), Some(range)) => stamp.seconds_since(direction.min(range)),
            _ => f64::INFINITY,
        }
    }

    pub(crate) fn status_at(&self, stamp: Stamp, times: &StatusTimes) -> TrackStatus {
        let age = self.age_at(stamp);
        if !self.alive || age > times.forget_after_s {
            TrackStatus::Searching
        } else if age > times.lost_after_s {
            TrackStatus::Lost
        } else if age > times.coast_after_s {
            TrackStatus::Coasting
        } else {
            TrackStatus::Tracking
        }
    }

    pub(crate) fn trail_point(&self, stamp: Stamp) -> Option<TrailPoint> {
        let covariance = self.gaussian.covariance_of_first::<2>();
        self.alive.then_some(TrailPoint { stamp, position: self.position(), covariance })
    }

    fn position(&self) -> Vector2<f64> {
        let mean = self.gaussian.mean();
        Vector2::new(mean[0], mean[1])
    }

    /// Factor and relative deviation.
    pub(crate) fn network_scale(&self) -> (f64, f64) {
        let mut row = Row::zeros();
        row[NETWORK] = 1.0;
        (self.gaussian.mean()[NETWORK].exp(), self.gaussian.variance_along(&row).sqrt())
    }
}

/// A measurement and the state in the camera's log-polar coordinates: the logarithm
/// of the depth and the tangent of the direction.
struct Relation {
    /// Depth, metres, and tangent of the estimate.
    depth: f64,
    tangent: f64,
    /// Derivative of (log depth, tangent) by the position in the fixed frame.
    jacobian: Matrix2<f64>,
    /// Derivative of the measurement by the state, the position in log-polar.
    row: Row,
    residual: f64,
    variance: f64,
}

pub(crate) struct TargetModel {
    options: TargetOptions,
}

impl TargetModel {
    pub(crate) const fn new(options: TargetOptions) -> Self {
        Self { options }
    }

    /// Searching; the errors as they are expected.
    pub(crate) fn initial(&self) -> TargetMoment {
        let options = &self.options;
        let mut gaussian = Gaussian::standard();
        for map in 0..MAPS {
            gaussian.restart(FIRST_MAP + map, 0.0, options.map_scale_std.powi(2));
        }
        gaussian.restart(NETWORK, 0.0, options.network_error.std.powi(2));
        gaussian.restart(GROUND, 0.0, options.ground_error.std.powi(2));
        gaussian.restart(SIZE, 0.0, options.size_error.std.powi(2));
        TargetMoment {
            gaussian,
            alive: false,
            maps: [None; MAPS],
            streams: [StreamState::default(); 4],
            last_direction: None,
            last_range: None,
        }
    }

    /// Position, velocity and acceleration after `seconds`.
    fn move_target(&self, moment: &mut TargetMoment, seconds: f64) {
        let options = &self.options;
        let (transition, noise, variances) =
            motion::step(options.jerk_density, options.acceleration_time_s, seconds);
        let mut head = moment.gaussian.mean_mut().fixed_rows_mut::<6>(0);
        let moved = transition * &head;
        head.copy_from(&moved);
        moment.gaussian.transform_first(&transition, &noise, &variances);
    }

    /// The place of a map's scale error; a new map takes the place of the oldest. None
    /// for a map that is older than all that are followed. Depends on stamps alone.
    fn place_of(&self, moment: &mut TargetMoment, map: Stamp) -> Option<usize> {
        if let Some(place) = moment.maps.iter().position(|known| *known == Some(map)) {
            return Some(FIRST_MAP + place);
        }
        // None sorts before all stamps.
        let (place, oldest) = moment.maps.iter_mut().enumerate().min_by_key(|(_, map)| **map)?;
        if oldest.is_some_and(|oldest| oldest > map) {
            return None;
        }
        *oldest = Some(map);
        moment.gaussian.renew(FIRST_MAP + place, NETWORK, self.options.map_scale_std.powi(2));
        Some(FIRST_MAP + place)
    }

    fn relate(
        &self,
        moment: &mut TargetMoment,
        measurement: &TargetMeasurement,
    ) -> Result<Relation, Outcome> {
        let to_camera = measurement.fixed_from_camera.rotation().transpose();
        let camera = measurement.fixed_from_camera.position();
        let mut row = Row::zeros();
        let place = match measurement.reading {
            Reading::Range { source: RangeSource::Network { map }, .. } => {
                self.place_of(moment, map).ok_or(Outcome::OldMap)?
            }
            Reading::Range { source: RangeSource::Ground, .. } => GROUND,
            Reading::Range { source: RangeSource::Size, .. } => SIZE,
            Reading::Direction { .. } => 1,
        };
        let seen = to_camera * (moment.position() - camera);
        let depth = seen.x;
        if depth.is_nan() || depth <= NEAREST {
            return Err(Outcome::OutOfView);
        }
        let tangent = seen.y / depth;
        let error = moment.gaussian.mean()[place];
        let (residual, std) = match measurement.reading {
            Reading::Direction { tangent: measured, std, .. } => {
                row[1] = 1.0;
                (measured - tangent, std)
            }
            Reading::Range { depth_m, relative_std, source: RangeSource::Ground } => {
                row[0] = (1.0 + error * depth).max(0.2);
                row[GROUND] = depth;
                (depth_m.ln() - depth.ln() - error * depth, relative_std)
            }
            Reading::Range { depth_m, relative_std, .. } => {
                row[0] = 1.0;
                row[place] = 1.0;
                (depth_m.ln() - depth.ln() - error, relative_std)
            }
        };
        let polar = Matrix2::new(1.0, 0.0, -tangent, 1.0) / depth;
        let jacobian = polar * to_camera;
        Ok(Relation { depth, tangent, jacobian, row, residual, variance: std * std })
    }

    /// Uses a measurement if its residual is within `gate` deviations.
    fn apply(
        &self,
        moment: &mut TargetMoment,
        measurement: &TargetMeasurement,
        gate: f64,
    ) -> Outcome {
        let relation = match self.relate(moment, measurement) {
            Ok(relation) => relation,
            Err(outcome) => return outcome,
        };
        let Relation { depth, tangent, jacobian, row, residual, variance } = relation;
        // The same row with the position in the fixed frame.
        let along = jacobian.transpose() * Vector2::new(row[0], row[1]);
        let mut fixed_row = row;
        fixed_row[0] = along.x;
        fixed_row[1] = along.y;
        let spread = moment.gaussian.variance_along(&fixed_row) + variance;
        let deviations = residual / spread.sqrt();
        if deviations.is_nan() || deviations.abs() > gate {
            return Outcome::Gated { deviations };
        }
        // In log-polar coordinates all that is measured is linear: no iteration is
        // needed, and what is not observable (the common scale of the range and the
        // map's error) stays so, although the estimate that it is linearised at moves.
        let none = (SMatrix::<f64, 2, 0>::zeros(), SVector::<f64, 0>::zeros());
        let gaussian = &mut moment.gaussian;
        gaussian.transform_first(&jacobian, &none.0, &none.1);
        gaussian.mean_mut()[0] = depth.ln();
        gaussian.mean_mut()[1] = tangent;
        let used = gaussian.update(residual, &row, variance).is_ok();
        let depth = gaussian.mean()[0].clamp(-LONGEST_LOG, LONGEST_LOG).exp();
        let tangent = gaussian.mean()[1];
        let pose = &measurement.fixed_from_camera;
        let position = pose.transform_point(&Vector2::new(depth, tangent * depth));
        let cartesian = pose.rotation() * Matrix2::new(1.0, 0.0, tangent, 1.0) * depth;
        gaussian.transform_first(&cartesian, &none.0, &none.1);
        gaussian.mean_mut()[0] = position.x;
        gaussian.mean_mut()[1] = position.y;
        if used { Outcome::Used { deviations } } else { Outcome::Gated { deviations } }
    }

    /// Begins a track at `now`, the stamp of the last range or direction, if the other
    /// one is not too old.
    fn begin(&self, moment: &mut TargetMoment, now: Stamp) -> Outcome {
        let (Some(direction), Some(range)) = (moment.last_direction, moment.last_range) else {
            return Outcome::Waits;
        };
        let apart = direction.stamp.seconds_since(range.stamp);
        let (Reading::Direction { tangent, .. }, Reading::Range { depth_m, source, .. }) =
            (direction.reading, range.reading)
        else {
            return Outcome::Waits;
        };
        if apart.abs() > self.options.begin_within_s {
            return Outcome::Waits;
        }
        let mean = moment.gaussian.mean();
        let depth = match source {
            RangeSource::Network { map } => match self.place_of(moment, map) {
                Some(place) => depth_m / moment.gaussian.mean()[place].exp(),
                None => return Outcome::OldMap,
            },
            RangeSource::Ground => {
                let error = mean[GROUND];
                (0..4).fold(depth_m, |depth, _| depth_m * (-error * depth).clamp(-1.0, 1.0).exp())
            }
            RangeSource::Size => depth_m / mean[SIZE].exp(),
        };
        let poses = (direction.fixed_from_camera, range.fixed_from_camera);
        // The direction as it would be seen from where the range was measured.
        let angle = poses.0.heading - poses.1.heading + tangent.atan();
        let (sin, cos) = angle.sin_cos();
        if cos < 0.1 {
            return Outcome::Waits;
        }
        let place = Vector2::new(depth, depth * sin / cos);
        let position = poses.1.transform_point(&place);
        let options = &self.options;
        // So wide that the two measurements alone decide where it is.
        let spread = (10.0 * place.norm()).powi(2);
        let (speed, acceleration) =
            (options.start_speed_std.powi(2), options.start_acceleration_std.powi(2));
        let gaussian = &mut moment.gaussian;
        let variances = [spread, spread, speed, speed, acceleration, acceleration];
        let means = [position.x, position.y, 0.0, 0.0, 0.0, 0.0];
        // From the last one up: what one lets go is taken up by those before it.
        for (index, (mean, variance)) in means.into_iter().zip(variances).enumerate().rev() {
            gaussian.restart(index, mean, variance);
        }
        let (older, newer) = if apart > 0.0 { (range, direction) } else { (direction, range) };
        moment.streams = [StreamState::default(); 4];
        moment.alive = true;
        for measurement in [older, newer] {
            if measurement.stamp == newer.stamp && apart != 0.0 {
                self.move_target(moment, apart.abs());
            }
            let outcome = self.apply(moment, &measurement, f64::INFINITY);
            if !matches!(outcome, Outcome::Used { .. }) {
                moment.alive = false;
                return outcome;
            }
            moment.stream(Stream::of(&measurement)).accepted = Some(measurement.stamp);
        }
        debug_assert!(newer.stamp == now);
        Outcome::Began
    }

    /// A source of ranges that disagrees for long while another one agrees: its shared
    /// error is not what was expected of it.
    fn reopen(&self, moment: &mut TargetMoment, stream: Stream) {
        let variance = self.options.reopened_std.powi(2);
        let gaussian = &mut moment.gaussian;
        match stream {
            Stream::Direction => {}
            Stream::Ground => gaussian.add_noise_to(GROUND, variance),
            Stream::Size => gaussian.add_noise_to(SIZE, variance),
            Stream::Network => {
                gaussian.add_noise_to(NETWORK, variance);
                for place in FIRST_MAP..FIRST_MAP + MAPS {
                    gaussian.renew(place, NETWORK, self.options.map_scale_std.powi(2));
                }
            }
        }
    }

    /// What follows from a measurement that was not used.
    fn refuse(
        &self,
        moment: &mut TargetMoment,
        measurement: &TargetMeasurement,
        outcome: Outcome,
    ) -> Outcome {
        let stamp = measurement.stamp;
        let stream = Stream::of(measurement);
        let state = moment.stream(stream);
        let since = *state.refused_since.get_or_insert(stamp);
        state.refusals = state.refusals.saturating_add(1);
        let long = stamp.seconds_since(since) >= self.options.reset_after_s;
        if !long || state.refusals < self.options.reset_count {
            return outcome;
        }
        let mut agrees = |other| other != stream && moment.stream(other).accepted >= Some(since);
        if stream != Stream::Direction && Stream::RANGES.into_iter().any(&mut agrees) {
            self.reopen(moment, stream);
            if let Outcome::Used { .. } = self.apply(moment, measurement, f64::INFINITY) {
                let accepted = Some(stamp);
                *moment.stream(stream) = StreamState { accepted, ..StreamState::default() };
                return Outcome::Reopened;
            }
        }
        moment.alive = false;
        self.begin(moment, stamp)
    }
}

impl Model for TargetModel {
    type State = TargetMoment;
    type Source = Source;
    type Measurement = TargetMeasurement;
    type Outcome = Outcome;

    fn check(&self, measurement: &TargetMeasurement) -> Result<(), BadMeasurement> {
        measurement.check()
    }

    fn predict(&self, moment: &mut TargetMoment, from: Stamp, to: Stamp) {
        let seconds = to.seconds_since(from);
        let options = &self.options;
        if moment.age_at(to) > options.times.forget_after_s {
            moment.alive = false;
        }
        if moment.alive {
            self.move_target(moment, seconds);
            for (place, map) in (FIRST_MAP..).zip(moment.maps) {
                if map.is_some() {
                    let variance = options.map_drift.powi(2) * seconds;
                    moment.gaussian.add_noise_to(place, variance);
                }
            }
        }
        let errors = [
            (NETWORK, options.network_error),
            (GROUND, options.ground_error),
            (SIZE, options.size_error),
        ];
        for (place, SharedError { std, time_s }) in errors {
            let kept = (-seconds / time_s).exp().max(1e-6);
            moment.gaussian.scale(place, kept);
            let gained = -(-2.0 * seconds / time_s).exp_m1();
            moment.gaussian.add_noise_to(place, std * std * gained);
        }
    }

    fn update(
        &self,
        moment: &mut TargetMoment,
        stamp: Stamp,
        _source: Source,
        measurement: &TargetMeasurement,
    ) -> Outcome {
        match measurement.reading {
            Reading::Direction { .. } => moment.last_direction = Some(*measurement),
            Reading::Range { .. } => moment.last_range = Some(*measurement),
        }
        if !moment.alive {
            return self.begin(moment, stamp);
        }
        match self.apply(moment, measurement, self.options.gate_deviations) {
            outcome @ Outcome::Used { .. } => {
                let accepted = Some(stamp);
                *moment.stream(Stream::of(measurement)) =
                    StreamState { accepted, ..StreamState::default() };
                outcome
            }
            Outcome::OldMap => Outcome::OldMap,
            outcome => self.refuse(moment, measurement, outcome),
        }
    }
}
