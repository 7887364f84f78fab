//! What the follower is tried in.
//!
//! A [`Scenario`] is a name and a recipe. With a seed it becomes a [`Setup`]: the
//! world, the vehicles and what they do, the camera, the networks and their faults,
//! and what is expected. The seed varies what differs from day to day: rooms and
//! light, speeds by 15 %, the place at the start, friction, the vehicle's own errors,
//! latencies, noise.
//!
//! ```
//! use realnet_sim::scenario::Scenario;
//!
//! let scenario = Scenario::named("hard-braking").expect("it is in the list");
//! let setup = scenario.instantiate(7)?;
//! let target = setup.target.as_ref().expect("somebody is followed");
//! assert!(target.state(4.0).speed > 0.7);
//! assert_eq!(target.state(setup.duration_s).speed, 0.0);
//! assert_eq!(setup, scenario.instantiate(7)?);
//! # Ok::<(), realnet_core::CameraError>(())
//! ```

mod draft;
mod driving;
mod expectations;
mod failing;
mod list;
mod seeing;
mod setup;
mod traffic;

pub use expectations::{Expectations, StopRule};
pub use list::Scenario;
pub use setup::{CameraSetup, FollowerSetup, Knock, Setup};

#[cfg(test)]
mod ideal;
#[cfg(test)]
mod tests;
