//! Vehicles that drive by a script: where one is at any time, exactly.
//!
//! A [`Route`] is a path with continuous curvature, a [`SpeedProfile`] a speed with
//! bounded acceleration over time; a [`ScriptedVehicle`] drives the one at the other.
//! Nothing is integrated from frame to frame: any time can be asked for, in any order.

mod profile;
mod route;
mod vehicle;

pub use profile::SpeedProfile;
pub use route::Route;
pub use vehicle::ScriptedVehicle;
