//! How vehicles answer to commands, and how near they come to each other.
//!
//! A vehicle takes [`DriveCommand`](realnet_core::DriveCommand)s by their stamps and carries them out after the
//! dead time of its actuators, through the dead band, the lags and the limits of
//! motor and steering, and through tyres that slip when they are asked for more than
//! friction gives. Time is a grid of 1 ms from the vehicle's start: what a vehicle
//! does depends on its commands alone, never on how often it is looked at.
//!
//! | what | how |
//! |---|---|
//! | car | bicycle model: curvature `tan(steering) / (wheelbase + k v^2)`, `k` the understeer of linear tyres, reached over the tyres' relaxation length |
//! | differential drive | two motors, each with dead band, lag and limits |
//! | tyres | friction circle: `a_along^2 + a_across^2 <= (mu g)^2`; braking comes first, as with wheels that lock; a car that is asked for more curvature understeers |
//!
//! There is no lateral drift: the base frame's origin moves along its x axis. At the
//! speeds of small robots the side-slip of the rear axle is below a degree.
//!
//! Why not a crate of rigid bodies: the wheeled vehicle of `rapier` is in three
//! dimensions only, and friction of contacts has no limits that could be stated and
//! tested; a robot in the plane needs a speed, a curvature and the circle that bounds
//! both. Distances of footprints are a few lines in the numbers used here; `parry2d`
//! would bring a second linear algebra for them.

mod ackermann;
mod actuator;
mod differential;
mod footprint;
mod vehicle;

pub use ackermann::Ackermann;
pub use actuator::{Motor, Steering};
pub use differential::Differential;
pub use footprint::{clearance, gap_ahead};
pub use vehicle::{DriveTrain, DynamicsError, Vehicle, VehicleDynamics};

#[cfg(test)]
mod tests;

/// Acceleration of gravity, m/s^2.
pub const GRAVITY: f64 = 9.81;

/// What is left across when `along` of the friction circle of radius `limit` is used.
fn friction_left(limit: f64, along: f64) -> f64 {
    (limit * limit - along * along).max(0.0).sqrt()
}

/// How far a first-order lag of `lag_s` seconds goes towards its goal in `step_s`,
/// 0 to 1: exact, and all the way without a lag.
fn lag_share(lag_s: f64, step_s: f64) -> f64 {
    if lag_s > 0.0 { 1.0 - (-step_s / lag_s).exp() } else { 1.0 }
}
