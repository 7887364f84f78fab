//! Time: a Kalman filter whose measurements may come late, and the target's state.
//!
//! | for | type |
//! |---|---|
//! | measurements that come late, twice or not at all, of anything | [`LateFilter`] |
//! | a covariance that stays positive definite | [`Gaussian`] |
//! | output whose stamps never go back | [`Publisher`] |
//! | where a followed target is and how it moves | [`TargetFilter`] |
//! | a cubic in time through the last positions | [`CubicTrajectory`] |
//!
//! Nothing here reads a clock, starts a thread or allocates after construction.
//!
//! # Late measurements
//!
//! [`LateFilter`] needs a [`Model`]: what the state is, what time does to it, what a
//! measurement tells. It keeps the measurements of a horizon with the states between
//! them, rewinds to where a late one belongs and replays. Its answers are a function
//! of the set of measurements, whatever their order, and a measurement that is too
//! late for that is an error, not a surprise.
//!
//! A level in a tank, measured by a fast gauge and by a laboratory whose exact answer
//! takes a minute:
//!
//! ```
//! use realnet_core::Stamp;
//! use realnet_core::nalgebra::{Matrix2, Vector1, Vector2};
//! use realnet_fusion::{
//!     Arrival, BadMeasurement, Gaussian, LateFilter, LateOptions, Model, Publisher,
//! };
//!
//! /// The state is (level, inflow); the inflow wanders.
//! struct Tank;
//!
//! impl Model for Tank {
//!     type State = Gaussian<2>;
//!     type Source = u8;
//!     type Measurement = (f64, f64); // level and its standard deviation
//!     type Outcome = bool; // used
//!
//!     fn check(&self, &(level, std): &(f64, f64)) -> Result<(), BadMeasurement> {
//!         BadMeasurement::unless_within("level", level, 0.0, 100.0)?;
//!         BadMeasurement::unless_within("std of the level", std, 1e-6, 100.0)
//!     }
//!
//!     fn predict(&self, state: &mut Gaussian<2>, from: Stamp, to: Stamp) {
//!         let dt = to.seconds_since(from);
//!         let noise = Vector2::new(0.5 * dt, 1.0);
//!         state.predict(&Matrix2::new(1.0, dt, 0.0, 1.0), &noise, &Vector1::new(1e-6 * dt));
//!     }
//!
//!     fn update(
//!         &self, state: &mut Gaussian<2>, _: Stamp, _: u8, &(level, std): &(f64, f64),
//!     ) -> bool {
//!         let row = Vector2::new(1.0, 0.0);
//!         let residual = level - state.mean().x;
//!         let spread = state.variance_along(&row) + std * std;
//!         // The gate is a part of the replay, so it does not depend on the order either.
//!         residual.powi(2) < 16.0 * spread && state.update(residual, &row, std * std).is_ok()
//!     }
//! }
//!
//! let second = |s: i64| Stamp::from_nanos(s * 1_000_000_000);
//! let unknown = Gaussian::independent(Vector2::new(50.0, 0.0), &Vector2::new(50.0, 1.0))?;
//! let options = LateOptions { horizon_s: 120.0, ..LateOptions::default() };
//! let mut tank = LateFilter::new(Tank, unknown, &options)?;
//! for s in 0..90 {
//!     tank.push(second(s), 0, (20.0 + 0.1 * s as f64, 2.0))?;
//! }
//! let before = tank.at(second(90))?.state.covariance()[(0, 0)];
//! // The laboratory's sample was drawn at 30 s.
//! let arrival = tank.push(second(30), 1, (23.0, 0.01))?;
//! assert_eq!(arrival, Arrival::Late { replayed: 59 });
//! let after = tank.at(second(90))?;
//! assert!(after.state.covariance()[(0, 0)] < before);
//! assert!((after.state.mean().x - 29.0).abs() < 0.1);
//! // Sent twice, and sent too late: neither does harm.
//! assert_eq!(tank.push(second(30), 1, (23.0, 0.01))?, Arrival::Duplicate);
//! tank.push(second(200), 0, (40.0, 2.0))?;
//! let error = tank.push(second(40), 1, (24.0, 0.01)).unwrap_err();
//! assert!(error.to_string().contains("before the horizon"));
//! // What is published does not go back in time.
//! let mut output = Publisher::new();
//! assert_eq!(output.publish(&mut tank, second(210))?.stamp, second(210));
//! assert_eq!(output.publish(&mut tank, second(205))?.stamp, second(210));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # The target
//!
//! [`TargetFilter`] follows position, velocity and acceleration of a target in a plane
//! frame that stands still, from ranges and directions of a moving camera. Its motion
//! is white jerk with an acceleration that decays (Singer), so that a prediction over
//! seconds does not run away.
//!
//! The errors of ranges are not independent from frame to frame, and treating them so
//! would make the filter far too sure. They are therefore part of the state:
//!
//! * each depth map of the network has a scale error of its own, shared by all ranges
//!   derived from that map: those moved from it to later frames by flow have it too. So
//!   the filter takes the precise *ratios* of the fast ranges as what they are, learns
//!   the velocity from them, and averages the scale over maps. A map that comes late
//!   corrects the past and, through the replay, everything since;
//! * all maps share an error that changes slowly;
//! * ground ranges share the error of the camera's pitch, size ranges that of the size.
//!
//! What cannot be known must stay unknown, or the deviations are no longer honest. The
//! range and the scale error of its map can grow and shrink together, and no range of that
//! map tells. Two things would make a plain extended Kalman filter believe that it knows:
//!
//! * the direction of what is not observable, as the filter sees it, turns with every
//!   correction of the estimate. So corrections are made in the logarithm of the range, the
//!   tangent of the direction and the motion relative to the camera over the range, where
//!   it does not turn, and the covariance goes along with the estimate;
//! * the motion of a target of known agility, seen from a robot of known motion, tells of
//!   its distance; but a follower's motion is an answer to the target's, and its odometry
//!   may take its unit of length from the same depth maps, so this is no independent view,
//!   and the range would drift away. So the scale error is carried on in proportion to what
//!   is relative to the camera, wherever the camera goes: its motion tells nothing of the
//!   distance (an observability-constrained filter). And only the first ranges of a map
//!   tell of errors, the others of the motion alone (Schmidt's consider filter,
//!   [`Gaussian::update_only`]).
//!
//! What is expected of a shared error never loses its hold: all of them are stationary, so
//! that a range that goes up and down for long still is between what the sources say.
//!
//! ```
//! use realnet_core::{Pose2, Stamp, TrackStatus};
//! use realnet_fusion::{
//!     DirectionSource, RangeSource, Reading, TargetFilter, TargetMeasurement, TargetOptions,
//! };
//!
//! let mut filter = TargetFilter::new(TargetOptions::default())?;
//! let frame = |index: u64| Stamp::of_frame(index, 30.0);
//! let camera = Pose2::IDENTITY; // stands still in this example
//! // Ahead at 1 m, driving away at 0.3 m/s. The network says 10 % too much.
//! for index in 0..30 {
//!     let (stamp, depth) = (frame(index), 1.0 + 0.01 * index as f64);
//!     let direction =
//!         Reading::Direction { tangent: 0.0, std: 0.01, source: DirectionSource::Detection };
//!     filter.push(TargetMeasurement { stamp, fixed_from_camera: camera, reading: direction })?;
//!     let source = RangeSource::Network { map: frame(0) };
//!     let range = Reading::Range { depth_m: 1.1 * depth, relative_std: 0.01, source };
//!     filter.push(TargetMeasurement { stamp, fixed_from_camera: camera, reading: range })?;
//! }
//! // The range from the ground comes late, and is nearer to the truth.
//! let ground = Reading::Range { depth_m: 1.1, relative_std: 0.02, source: RangeSource::Ground };
//! filter.push(TargetMeasurement { stamp: frame(10), fixed_from_camera: camera, reading: ground })?;
//!
//! let track = filter.track_at(frame(32))?;
//! assert_eq!(track.status, TrackStatus::Tracking);
//! let range = track.range_from(&camera).expect("it is tracked");
//! assert!((range.depth_m - 1.32).abs() < 0.05 && range.std_m < 0.1);
//! let seen = track.seen_from(&Pose2::IDENTITY).estimate.expect("it is certain enough");
//! assert!((seen.velocity.x - 0.3).abs() < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod cubic;
mod gaussian;
mod late;
mod tracking;

pub use cubic::{Cubic, CubicError, CubicTrajectory, TrajectoryPoint};
pub use gaussian::{Gaussian, GaussianError};
pub use late::{
    Arrival, BadMeasurement, Estimate, LateError, LateFilter, LateOptions, Model, Publisher,
};
pub use realnet_core::OptionError;
pub use tracking::{
    DirectionSource, Motion, Outcome, RangeSource, Reading, SharedError, Source, StatusTimes,
    TargetFilter, TargetMeasurement, TargetOptions, Track, TrackRange, TrailPoint,
};
