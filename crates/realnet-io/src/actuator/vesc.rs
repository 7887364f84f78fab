//! A VESC motor controller on a serial line.

use super::{Actuator, ActuatorError};
use crc::{CRC_16_XMODEM, Crc};
use realnet_core::DriveCommand;
use serial2::SerialPort;
use std::io;
use std::time::Duration;

/// What a command is for this motor and this servo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VescOptions {
    /// Electrical revolutions a minute at one metre a second: 60 times pole pairs times gear
    /// ratio over the wheel's circumference in metres. Negative for a motor that turns the
    /// other way.
    pub erpm_per_m_s: f64,
    /// Position of the servo at which it drives straight ahead, 0 to 1.
    pub servo_straight: f64,
    /// Change of that position a radian of steering to the left; negative where the servo
    /// turns the other way.
    pub servo_per_rad: f64,
}

impl Default for VescOptions {
    /// A 1:10 car as they are usually built: 4614 electrical revolutions a minute at 1 m/s,
    /// servo at 0.5, -1.2 a radian.
    fn default() -> Self {
        Self { erpm_per_m_s: 4614.0, servo_straight: 0.5, servo_per_rad: -1.2 }
    }
}

/// Speed (`COMM_SET_RPM`) and servo position (`COMM_SET_SERVO_POS`) for a VESC over USB or
/// UART. Its own time-out (in VESC Tool: App settings, general) must be on: it is what stops
/// the car when nothing comes any more.
#[derive(Debug)]
pub struct Vesc {
    name: String,
    port: SerialPort,
    options: VescOptions,
}

/// `datatypes.h` of the firmware: `COMM_PACKET_ID`.
const SET_RPM: u8 = 8;
const SET_SERVO_POS: u8 = 12;
/// A frame of a payload below 256 bytes: this, its length, it, its checksum, the end.
const START: u8 = 2;
const END: u8 = 3;
const CHECKSUM: Crc<u16> = Crc::<u16>::new(&CRC_16_XMODEM);

/// USB does not care; UARTs of these controllers are set to this.
const BAUD: u32 = 115_200;
/// A line that takes longer than this for 19 bytes is stuck.
const PATIENCE: Duration = Duration::from_millis(20);

impl Vesc {
    /// Opens a serial port; `name` is for errors.
    ///
    /// # Errors
    /// [`ActuatorError`] for options out of range and a port that cannot be opened.
    pub fn open(name: &str, port: &str, options: VescOptions) -> Result<Self, ActuatorError> {
        options.check()?;
        let failed = |reason| ActuatorError::Io { name: name.to_owned(), reason };
        let port = SerialPort::open(port, BAUD).map_err(failed)?;
        Self::on(name, port, options).map_err(failed)
    }

    fn on(name: &str, mut port: SerialPort, options: VescOptions) -> io::Result<Self> {
        port.set_write_timeout(PATIENCE)?;
        Ok(Self { name: name.to_owned(), port, options })
    }
}

impl VescOptions {
    fn check(&self) -> Result<(), ActuatorError> {
        let Self { erpm_per_m_s, servo_straight, servo_per_rad } = *self;
        let other_than_0 = |value: f64| value.is_finite() && value != 0.0;
        for (option, value, fits, allowed) in [
            ("erpm_per_m_s", erpm_per_m_s, other_than_0(erpm_per_m_s), "a number other than 0"),
            (
                "servo_straight",
                servo_straight,
                (0.0..=1.0).contains(&servo_straight),
                "0 to 1, the servo's ends",
            ),
            ("servo_per_rad", servo_per_rad, other_than_0(servo_per_rad), "a number other than 0"),
        ] {
            if !fits {
                return Err(ActuatorError::Option { option, value, allowed });
            }
        }
        Ok(())
    }

    /// Electrical revolutions a minute and servo position of a command; a number that is
    /// none stands.
    fn settings(&self, command: &DriveCommand) -> (i32, f64) {
        let erpm = (command.speed * self.erpm_per_m_s).round();
        let servo = self.servo_straight + self.servo_per_rad * command.steering_angle;
        let servo = if servo.is_finite() { servo.clamp(0.0, 1.0) } else { self.servo_straight };
        // What is not a number becomes 0.
        (erpm as i32, servo)
    }
}

/// A frame of up to 255 bytes of payload.
fn frame(payload: &[u8], out: &mut Vec<u8>) {
    out.extend([START, payload.len() as u8]);
    out.extend(payload);
    out.extend(CHECKSUM.checksum(payload).to_be_bytes());
    out.push(END);
}

/// Both messages of a command.
fn frames(options: &VescOptions, command: &DriveCommand) -> Vec<u8> {
    let (erpm, servo) = options.settings(command);
    let mut bytes = Vec::with_capacity(19);
    let [a, b, c, d] = erpm.to_be_bytes();
    frame(&[SET_RPM, a, b, c, d], &mut bytes);
    let [high, low] = ((servo * 1000.0).round() as i16).to_be_bytes();
    frame(&[SET_SERVO_POS, high, low], &mut bytes);
    bytes
}

impl Actuator for Vesc {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, command: &DriveCommand) -> Result<(), ActuatorError> {
        let bytes = frames(&self.options, command);
        let failed = |reason| ActuatorError::Io { name: self.name.clone(), reason };
        self.port.write_all(&bytes).map_err(failed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::{Stamp, StopReason};

    fn driving(speed: f64, steering_angle: f64) -> DriveCommand {
        DriveCommand { speed, steering_angle, ..DriveCommand::default() }
    }

    #[test]
    fn frames_are_those_of_the_protocol() {
        // CRC-16/XMODEM of "123456789", from the catalogue of checksums.
        assert_eq!(CHECKSUM.checksum(b"123456789"), 0x31c3);
        let options =
            VescOptions { erpm_per_m_s: 1000.0, servo_straight: 0.5, servo_per_rad: -1.0 };
        let bytes = frames(&options, &driving(1.5, 0.1));
        // 1500 and 400 of 1000.
        assert_eq!(bytes[..7], [2, 5, 8, 0, 0, 0x05, 0xdc]);
        assert_eq!(bytes[9..15], [3, 2, 3, 12, 0x01, 0x90]);
        assert_eq!((bytes.len(), bytes[17]), (18, 3));
        // The checksums are those of another implementation.
        let mut own = [0; 16];
        let length = vesc::encode(vesc::Command::SetRpm(1500), &mut own).unwrap();
        assert_eq!(bytes[..length], own[..length]);
    }

    #[test]
    fn what_cannot_be_stays_within_the_servo_and_stands() {
        let options = VescOptions::default();
        assert_eq!(options.settings(&driving(0.0, 3.0)).1, 0.0);
        assert_eq!(options.settings(&driving(0.0, -3.0)).1, 1.0);
        let nowhere = driving(f64::NAN, f64::NAN);
        assert_eq!(options.settings(&nowhere), (0, options.servo_straight));
        for (bad, option) in [
            (VescOptions { erpm_per_m_s: 0.0, ..options }, "erpm_per_m_s"),
            (VescOptions { servo_straight: 1.5, ..options }, "servo_straight"),
            (VescOptions { servo_per_rad: f64::NAN, ..options }, "servo_per_rad"),
        ] {
            let error = Vesc::open("car", "/dev/null", bad).unwrap_err().to_string();
            assert!(error.starts_with(option), "{error}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_serial_line_gets_every_command_and_a_stop() {
        let (own, mut other) = SerialPort::pair().unwrap();
        other.set_read_timeout(Duration::from_secs(5)).unwrap();
        let mut vesc = Vesc::on("car", own, VescOptions::default()).unwrap();
        vesc.send(&driving(1.0, 0.0)).unwrap();
        let mut bytes = vec![0; 18];
        other.read_exact(&mut bytes).unwrap();
        assert_eq!(bytes, frames(&VescOptions::default(), &driving(1.0, 0.0)));
        vesc.stop(Stamp::ZERO).unwrap();
        other.read_exact(&mut bytes).unwrap();
        let stopped = DriveCommand::stopped(Stamp::ZERO, StopReason::Requested);
        assert_eq!(bytes, frames(&VescOptions::default(), &stopped));
        let error = Vesc::open("vesc:/nowhere", "/nowhere", VescOptions::default()).unwrap_err();
        assert!(error.to_string().starts_with("vesc:/nowhere: "), "{error}");
    }
}
