//! Where commands go: the robot's motors.
//!
//! | actuator | what it sends |
//! |---|---|
//! | [`UdpJson`] | one JSON object a datagram, see [`UdpJson`] |
//! | [`Vesc`] | speed and servo position to a VESC motor controller, over a serial line |
//!
//! An actuator sends what it is given and nothing else. Commands are to come from the
//! controller's governor, at least every 100 ms; whoever ends sends a stop first, see
//! [`Actuator::stop`]. A motor controller must have a time-out of its own, for a program
//! that is killed cannot say anything any more.

mod udp;
mod vesc;

pub use udp::UdpJson;
pub use vesc::{Vesc, VescOptions};

use realnet_core::{DriveCommand, Stamp, StopReason};
use std::io;
use thiserror::Error;

/// Why a command could not be sent, or an actuator not be opened.
#[derive(Debug, Error)]
pub enum ActuatorError {
    /// What the user wrote names no actuator.
    #[error("'{found}' is no actuator: udp://HOST:PORT or vesc:/dev/ttyACM0")]
    Unknown {
        /// That.
        found: String,
    },
    /// An option is out of range.
    #[error("{option} is {value}, should be {allowed}")]
    Option {
        /// Its name.
        option: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        allowed: &'static str,
    },
    /// The system's error.
    #[error("{name}: {reason}")]
    Io {
        /// Which actuator.
        name: String,
        /// What the system says.
        reason: io::Error,
    },
}

/// Something that drives.
pub trait Actuator: Send {
    /// Which one it is, as the user wrote it.
    fn name(&self) -> &str;

    /// Sends a command.
    ///
    /// # Errors
    /// [`ActuatorError::Io`]: it may not have been sent.
    fn send(&mut self, command: &DriveCommand) -> Result<(), ActuatorError>;

    /// Sends a stop, as often as it takes for one to arrive where datagrams may be lost.
    ///
    /// # Errors
    /// [`ActuatorError::Io`] of the last one.
    fn stop(&mut self, now: Stamp) -> Result<(), ActuatorError> {
        let stopped = DriveCommand::stopped(now, StopReason::Requested);
        (0..5).map(|_| self.send(&stopped)).last().unwrap_or(Ok(()))
    }
}

/// Opens the actuator that `spec` names: `udp://HOST:PORT`, `vesc:/dev/ttyACM0`.
///
/// # Errors
/// [`ActuatorError`]: nothing of that name, or it cannot be opened.
pub fn open(spec: &str, vesc: &VescOptions) -> Result<Box<dyn Actuator>, ActuatorError> {
    if let Some(address) = spec.strip_prefix("udp://") {
        return Ok(Box::new(UdpJson::open(spec, address)?));
    }
    if let Some(port) = spec.strip_prefix("vesc:") {
        return Ok(Box::new(Vesc::open(spec, port, *vesc)?));
    }
    Err(ActuatorError::Unknown { found: spec.to_owned() })
}
