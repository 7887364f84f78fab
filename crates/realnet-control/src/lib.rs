//! Driving: from a target's state to a drive command, and a governor that stops.
//!
//! ```text
//! target, trail ──▶ pursuit ──curvature──┐
//!        │                               ▼
//!        └──▶ gap PID ──speed──▶ bounds ──▶ limits, dead band ──▶ governor ──▶ command
//!                                  ▲                                 │
//!            lost target, seconds ─┘          vehicle predictor ◀────┘
//! ```
//!
//! | part | what |
//! |---|---|
//! | [`Controller`] | all of them, wired |
//! | [`aim`], [`PursuitRule`] | pure pursuit of the target's trail, of the target, or by the paper's law |
//! | [`GapController`], [`SpeedOptions`] | PID of the gap with feed-forward; bounds by stopping distance and curvature |
//! | [`Limiter`], [`VehicleOptions`] | angle, rates, speeds, dead band; car or differential drive |
//! | [`VehiclePredictor`] | own motion from the commands: dead time, lags, limits |
//! | [`LostOptions`], [`Phase`] | coast, slow down, stop, search: by times in seconds |
//! | [`Governor`] | the last word: every stop and its reason |
//!
//! Times are arguments, nothing is random, nothing is allocated in a step, and each step
//! takes the intervals as they come. No input makes a command that is not finite or
//! outside the limits.
//!
//! The target is given in the robot's base frame as it will be when the command takes
//! effect ([`Controller::effect_time`]); [`VehiclePredictor::advance`] gives the robot's
//! own pose then.
//!
//! ```
//! use realnet_control::{ControlInput, ControlOptions, Controller};
//! use realnet_core::nalgebra::{Matrix2, Vector2};
//! use realnet_core::{Stamp, StopReason, TargetEstimate, TargetState, TrackStatus};
//!
//! let mut controller = Controller::new(ControlOptions::default())?;
//! let mut speed = 0.0;
//! for frame in 0..30 {
//!     let now = Stamp::of_frame(frame, 30.0);
//!     // 3 m ahead, a little to the left, driving away
//!     let estimate = TargetEstimate {
//!         position: Vector2::new(3.0, 0.2),
//!         velocity: Vector2::new(0.5, 0.0),
//!         acceleration: Vector2::zeros(),
//!         position_covariance: Matrix2::identity() * 1e-4,
//!         velocity_covariance: Matrix2::identity() * 1e-2,
//!     };
//!     let target = TargetState {
//!         stamp: controller.effect_time(now),
//!         measured: Some(now),
//!         status: TrackStatus::Tracking,
//!         estimate: Some(estimate),
//!     };
//!     let command = controller.step(&ControlInput::new(now, &target));
//!     assert!(command.stop.is_none() && command.steering_angle >= 0.0);
//!     speed = command.speed;
//! }
//! assert!(speed > 1.0);
//! // Nothing more comes in; a timer asks.
//! let later = Stamp::of_frame(36, 30.0);
//! let command = controller.idle(later);
//! assert_eq!((command.speed, command.stop), (0.0, Some(StopReason::StaleInput)));
//! # Ok::<(), realnet_control::OptionError>(())
//! ```
//!
//! # Choices
//!
//! - The robot follows the target's trail, not the target, and by default not the paper's
//!   law, which is singular at the desired gap ([`PursuitRule`]). In the slalom of
//!   `tests/following.rs` it stays within 2 to 4 cm of the path; pursuing the target, or by
//!   the paper's law, it is more than four times as far off.
//! - The speed of the target is averaged over a fifth of a second where it makes for
//!   comfort (feed-forward) and taken as it is, less its deviation, where a collision is at
//!   stake (stopping distance).
//! - Steering and speed are computed for the moment when they act, not for now; of the
//!   lags that remain, gains make up for a part ([`VehicleOptions::lag_compensation`],
//!   [`SpeedOptions::kd`]).
//! - The governor looks at inputs and commands alone, not at what the controller made of
//!   them.

mod check;
mod controller;
mod governor;
mod input;
mod limits;
mod lost;
mod predictor;
mod pursuit;
mod speed;
mod vehicle;

pub use controller::{ControlOptions, Controller, Telemetry};
pub use governor::{Governor, GovernorOptions, StopAction};
pub use input::{ControlInput, Gap};
pub use limits::{Limiter, Motion};
pub use lost::{LostOptions, Phase, Search};
pub use predictor::VehiclePredictor;
pub use pursuit::{Aim, PursuitOptions, PursuitRule, ViewLimit, aim};
pub use realnet_core::OptionError;
pub use speed::{GapControl, GapController, OwnMotion, SpeedBound, SpeedBounds, SpeedOptions};
pub use vehicle::{DeadBand, Drive, VehicleOptions};
