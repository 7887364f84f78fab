//! Commands to the robot, and a stop at the end, whatever ends it.

use crate::cli::failure::{OrBadInput, bad_input, report};
use anyhow::{Error, Result};
use clap::Args;
use realnet::actuator::{self, Actuator, VescOptions};
use realnet_core::{DriveCommand, Stamp};

#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Motors")]
pub(super) struct MotorArgs {
    /// Where commands go: udp://HOST:PORT (a JSON object a datagram) or vesc:/dev/ttyACM0.
    /// Nothing is sent without --drive.
    #[arg(long, value_name = "WHAT")]
    actuator: Option<String>,
    /// Drive: send the commands. Lift the wheels off the ground first.
    #[arg(long, requires = "actuator")]
    drive: bool,
    /// Of a VESC: electrical revolutions a minute at 1 m/s.
    #[arg(long, value_name = "ERPM", default_value_t = VescOptions::default().erpm_per_m_s,
        allow_negative_numbers = true)]
    vesc_erpm: f64,
    /// Of a VESC: position of the servo that drives straight ahead, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = VescOptions::default().servo_straight)]
    vesc_straight: f64,
    /// Of a VESC: change of that position a radian of steering to the left.
    #[arg(long, value_name = "SHARE", default_value_t = VescOptions::default().servo_per_rad,
        allow_negative_numbers = true)]
    vesc_per_rad: f64,
}

impl MotorArgs {
    /// Opens the motors, if there are any; `live`: whether frames come by themselves.
    pub(super) fn open(&self, live: bool) -> Result<Option<Motors>> {
        let Some(spec) = &self.actuator else { return Ok(None) };
        if self.drive && !live {
            return Err(bad_input(
                "--drive is for frames that come by themselves: a camera, a stream, or --realtime",
            ));
        }
        let vesc = VescOptions {
            erpm_per_m_s: self.vesc_erpm,
            servo_straight: self.vesc_straight,
            servo_per_rad: self.vesc_per_rad,
        };
        let actuator = actuator::open(spec, &vesc).or_bad_input()?;
        Ok(Some(Motors { actuator, drives: self.drive, failed: None, last: Stamp::ZERO }))
    }
}

/// The robot's motors. They are told to stop when this is dropped.
pub(super) struct Motors {
    actuator: Box<dyn Actuator>,
    drives: bool,
    /// What is wrong with them, as it was told.
    failed: Option<String>,
    last: Stamp,
}

impl Motors {
    /// Sends a command; an error is one to be told: not the same again and again.
    pub(super) fn send(&mut self, command: &DriveCommand) -> Result<()> {
        self.last = command.stamp;
        if !self.drives {
            return Ok(());
        }
        let error = match self.actuator.send(command) {
            Ok(()) => {
                self.failed = None;
                return Ok(());
            }
            Err(error) => Error::new(error),
        };
        let words = error.to_string();
        if self.failed.replace(words.clone()) == Some(words) {
            return Ok(());
        }
        Err(error)
    }
}

impl Drop for Motors {
    fn drop(&mut self) {
        if !self.drives {
            return;
        }
        if let Err(error) = self.actuator.stop(self.last) {
            report(&Error::new(error).context("the last stop may not have been sent"));
        }
    }
}
