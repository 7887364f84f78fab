//! The model behind the target filter.
//!
//! State: position, velocity, acceleration (x and y of each, fixed frame); the scale
//! errors of the last maps; the scale error common to all maps; the shared errors of
//! ground and size ranges. All errors are of the logarithm of the range.

use super::measurement::{Outcome, RangeSource, Reading, Source, TargetMeasurement};
use super::motion;
use super::options::{SharedError, StatusTimes, TargetOptions};
use super::seen::{Camera, NEAREST, Seen};
use super::track::TrailPoint;
use crate::gaussian::Gaussian;
use crate::late::{BadMeasurement, Model};
use realnet_core::nalgebra::{Matrix6, SMatrix, SVector, Vector1, Vector2, Vector6};
use realnet_core::{Pose2, Stamp, TrackStatus};

/// Maps whose scale errors are followed at a time: ranges of the one before the newest
/// go on coming until the newest one is there.
const MAPS: usize = 4;
const FIRST_MAP: usize = 6;
const NETWORK: usize = FIRST_MAP + MAPS;
const GROUND: usize = NETWORK + 1;
const SIZE: usize = NETWORK + 2;
const STATES: usize = NETWORK + 3;

/// So many ranges of a map tell of its scale error; those after them of the motion alone.
/// What the motion itself tells of the scale is not wanted: a follower moves as the target
/// does, so its motion is no independent view of it, and in minutes the range would drift.
const LEARNING_RANGES: u32 = 3;

/// Change of the logarithm of the range after which the error of the ground ranges is
/// another one.
const GROUND_STEP: f64 = 0.15;

/// The difference of two shared errors is known when its deviation is at most this share.
const KNOWN_SHARE: f64 = 0.2;

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

/// A depth map whose scale error is followed.
#[derive(Clone, Copy, Debug)]
struct MapInUse {
    stamp: Stamp,
    /// Ranges of it after the first one.
    ranges: u32,
}

/// Which errors a measurement corrects, besides the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Tells {
    All,
    /// That of its own map alone.
    Own,
    Motion,
}

/// What is known of one stream.
#[derive(Clone, Copy, Debug, Default)]
struct StreamState {
    /// Newest measurement that was used.
    accepted: Option<Stamp>,
    /// First of the refusals since then.
    refused_since: Option<Stamp>,
    /// Whether its shared error was opened in this track.
    reopened: bool,
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
    maps: [Option<MapInUse>; MAPS],
    camera: Option<Camera>,
    /// Position, velocity and acceleration of the camera if it had gone on since its last
    /// measurement as a target does.
    expected_camera: Option<Vector6<f64>>,
    /// The range, roughly, at which the error of the ground ranges was learned.
    ground_depth: f64,
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
            camera: None,
            expected_camera: None,
            ground_depth: 1.0,
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
        moment.expected_camera = moment.expected_camera.map(|camera| transition * camera);
    }

    /// Takes the camera's motion, and takes from the covariance what that motion would tell
    /// of the distance.
    ///
    /// An error of the scale is one of all that is relative to the camera, in proportion.
    /// The transition carries it on as if the camera had gone on as the target does; where
    /// the camera has gone another way by `d`, the error would be turned by `d`, and ranges
    /// would tell of it: motion parallax. It is turned back (the observability-constrained
    /// filter of Huang, Mourikis and Roumeliotis, 2010), and the part of `d` that the scale
    /// error really makes wrong is added as a noise.
    fn move_camera(moment: &mut TargetMoment, stamp: Stamp, pose: &Pose2) -> Camera {
        let camera = Camera::moved_to(moment.camera, stamp, pose);
        let moving = camera.motion();
        let expected = moment.expected_camera.replace(moving);
        let followed = moment.camera.is_some_and(|last| camera.follows(&last));
        moment.camera = Some(camera);
        let Some(d) = expected.map(|e| e - moving).filter(|d| followed && *d != Vector6::zeros())
        else {
            return camera;
        };
        let forward = pose.direction();
        let target = moment.position() - pose.position();
        let depth = forward.dot(&target);
        let before = depth - forward.dot(&d.fixed_rows::<2>(0));
        // The camera has not jumped past the target.
        if !(depth > NEAREST && before > 0.5 * depth && before < 2.0 * depth) {
            return camera;
        }
        let mut by_state = Vector6::zeros();
        by_state.fixed_rows_mut::<2>(0).copy_from(&(forward / before));
        let mut row = Row::zeros();
        row.fixed_rows_mut::<2>(0).copy_from(&by_state.fixed_rows::<2>(0));
        let variance = moment.gaussian.variance_along(&row);
        let turned = Matrix6::identity() + d * by_state.transpose();
        moment.gaussian.transform_first(&turned, &d, &Vector1::new(variance));
        camera
    }

    /// The error of the ground ranges is not the same at another range. It is kept as one
    /// number that is partly forgotten when the range changes by more than its noise, and
    /// never is less certain than was expected: however often the range goes up and down,
    /// the ground holds the range. (To follow the error as an angle would make the scale
    /// observable by any error of that angle's model.)
    fn move_ground_error(&self, moment: &mut TargetMoment, depth: f64) {
        let before = moment.ground_depth;
        let ratio = (depth / before).ln().abs();
        if ratio > GROUND_STEP {
            moment.ground_depth = depth;
            let kept = (-ratio).exp().max(1e-6);
            moment.gaussian.scale(GROUND, kept);
            let variance = self.ground_std(moment).powi(2) * (1.0 - kept * kept);
            moment.gaussian.add_noise_to(GROUND, variance);
        }
    }

    /// What is expected of the error of the ground ranges: that of an angle grows with the
    /// range; that of the place of the foot is in metres, and so grows nearer than 1 m.
    fn ground_std(&self, moment: &TargetMoment) -> f64 {
        self.options.ground_error.std * moment.ground_depth.max(moment.ground_depth.recip())
    }

    /// The place of a map's scale error, and how many ranges of the map there were. A new
    /// map takes the place of the oldest. None for a map that is older than all that are
    /// followed. Depends on stamps alone.
    fn place_of(&self, moment: &mut TargetMoment, map: Stamp) -> Option<(usize, u32)> {
        let known = |slot: &Option<MapInUse>| slot.is_some_and(|known| known.stamp == map);
        if let Some(place) = moment.maps.iter().position(known) {
            let slot = moment.maps.get_mut(place)?.as_mut()?;
            slot.ranges = slot.ranges.saturating_add(1);
            return Some((FIRST_MAP + place, slot.ranges));
        }
        // None sorts before all stamps.
        let by_stamp = |(_, slot): &(usize, &mut Option<MapInUse>)| slot.map(|used| used.stamp);
        let (place, oldest) = moment.maps.iter_mut().enumerate().min_by_key(by_stamp)?;
        if oldest.is_some_and(|oldest| oldest.stamp > map) {
            return None;
        }
        *oldest = Some(MapInUse { stamp: map, ranges: 0 });
        moment.gaussian.renew(FIRST_MAP + place, NETWORK, self.options.map_scale_std.powi(2));
        Some((FIRST_MAP + place, 0))
    }

    /// Uses a measurement if its residual is within `gate` deviations.
    fn apply(
        &self,
        moment: &mut TargetMoment,
        measurement: &TargetMeasurement,
        gate: f64,
    ) -> Outcome {
        let pose = &measurement.fixed_from_camera;
        let camera = Self::move_camera(moment, measurement.stamp, pose);
        let (place, tells) = match measurement.reading {
            Reading::Range { source: RangeSource::Network { map }, .. } => {
                match self.place_of(moment, map) {
                    Some((place, 0)) => (place, Tells::All),
                    Some((place, ranges)) if ranges < LEARNING_RANGES => (place, Tells::Own),
                    Some((place, _)) => (place, Tells::Motion),
                    None => return Outcome::OldMap,
                }
            }
            Reading::Range { source: RangeSource::Ground, .. } => (GROUND, Tells::All),
            Reading::Range { source: RangeSource::Size, .. } => (SIZE, Tells::All),
            Reading::Direction { .. } => (1, Tells::Motion),
        };
        let state = moment.gaussian.mean().fixed_rows::<6>(0).into_owned();
        let Some(seen) = Seen::new(&state, pose, &camera) else {
            return Outcome::OutOfView;
        };
        if place == GROUND {
            self.move_ground_error(moment, seen.depth());
        }
        // The derivative by what is seen, and by the errors.
        let mut row = Row::zeros();
        let error = moment.gaussian.mean()[place];
        let (by_log_depth, by_tangent, residual, std) = match measurement.reading {
            Reading::Direction { tangent, std, .. } => (0.0, 1.0, tangent - seen.tangent, std),
            Reading::Range { depth_m, relative_std, .. } => {
                row[place] = 1.0;
                (1.0, 0.0, depth_m.ln() - seen.log_depth - error, relative_std)
            }
        };
        let by_state = seen.seen_by_state(pose);
        for axis in 0..2 {
            row[axis] = by_log_depth * by_state[(0, axis)] + by_tangent * by_state[(1, axis)];
        }
        let gaussian = &mut moment.gaussian;
        let spread = gaussian.variance_along(&row) + std * std;
        let deviations = residual / spread.sqrt();
        if deviations.is_nan() || deviations.abs() > gate {
            return Outcome::Gated { deviations };
        }
        let corrects =
            |i| i < FIRST_MAP || tells == Tells::All || (tells == Tells::Own && i == place);
        if gaussian.update_only(residual, &row, std * std, corrects).is_err() {
            return Outcome::Gated { deviations };
        }
        // The correction is made in the coordinates of what is seen, where it is linear:
        // no iteration is needed. The deviations are those of these coordinates, too, so
        // they go along when the estimate moves. Otherwise each correction would turn the
        // direction that is not observable, and the filter would believe to have seen it.
        let change = by_state * (gaussian.mean().fixed_rows::<6>(0) - state);
        let corrected = seen.plus(&change);
        let transport = corrected.state_by_seen(pose) * by_state;
        let none = (SMatrix::<f64, 6, 0>::zeros(), SVector::<f64, 0>::zeros());
        gaussian.transform_first(&transport, &none.0, &none.1);
        let state = corrected.state(pose, &camera);
        gaussian.mean_mut().fixed_rows_mut::<6>(0).copy_from(&state);
        Outcome::Used { deviations }
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
                Some((place, _)) => depth_m / moment.gaussian.mean()[place].exp(),
                None => return Outcome::OldMap,
            },
            RangeSource::Ground => depth_m / mean[GROUND].exp(),
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
        self.move_ground_error(moment, depth);
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

    /// What network and ground say differs by more than is expected of their shared
    /// errors together: the filter has halved a difference that is no one's half. The
    /// network is taken to be wrong, and the range is asked of the ground again.
    fn settle(&self, moment: &mut TargetMoment, by_ground: &TargetMeasurement) {
        let options = &self.options;
        let ground_std = self.ground_std(moment);
        let expected = options.network_error.std.hypot(ground_std);
        let mut row = Row::zeros();
        (row[NETWORK], row[GROUND]) = (1.0, -1.0);
        let mean = moment.gaussian.mean();
        let difference = (mean[NETWORK] - mean[GROUND]).abs();
        let known = moment.gaussian.variance_along(&row).sqrt();
        let limit = options.disagreement_deviations * expected;
        // A ground whose own error had to be opened is no witness.
        let [_, network, ground, _] = &moment.streams;
        if network.reopened
            || ground.reopened
            || difference <= limit
            || known > KNOWN_SHARE * difference
        {
            return;
        }
        self.reopen(moment, Stream::Network);
        moment.stream(Stream::Network).reopened = true;
        moment.gaussian.restart(GROUND, 0.0, ground_std.powi(2));
        let mut away = Vector6::zeros();
        let camera = by_ground.fixed_from_camera.position();
        away.fixed_rows_mut::<2>(0).copy_from(&(moment.position() - camera));
        let variance = Vector1::new(options.reopened_std.powi(2));
        moment.gaussian.transform_first(&Matrix6::identity(), &away, &variance);
        self.apply(moment, by_ground, f64::INFINITY);
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
        // One that is refused itself, or that was fitted to the track by opening its error,
        // or that only began the track, is no witness for it.
        let mut agrees = |other| {
            let other_state = moment.stream(other);
            other != stream
                && other_state.accepted > Some(since)
                && other_state.refused_since.is_none()
                && !other_state.reopened
        };
        if stream != Stream::Direction && Stream::RANGES.into_iter().any(&mut agrees) {
            self.reopen(moment, stream);
            if let Outcome::Used { .. } = self.apply(moment, measurement, f64::INFINITY) {
                let accepted = Some(stamp);
                *moment.stream(stream) =
                    StreamState { accepted, reopened: true, ..StreamState::default() };
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
            let std = if place == GROUND { self.ground_std(moment) } else { std };
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
                let state = moment.stream(Stream::of(measurement));
                let reopened = state.reopened;
                *state = StreamState { accepted, reopened, ..StreamState::default() };
                if Stream::of(measurement) == Stream::Ground {
                    self.settle(moment, measurement);
                }
                outcome
            }
            Outcome::OldMap => Outcome::OldMap,
            outcome => self.refuse(moment, measurement, outcome),
        }
    }
}
