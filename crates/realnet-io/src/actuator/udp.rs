//! Commands as JSON datagrams.

use super::{Actuator, ActuatorError};
use realnet_core::DriveCommand;
use serde::Serialize;
use std::io;
use std::net::UdpSocket;

/// Sends each command as one UDP datagram of JSON:
///
/// ```json
/// {"stamp_ns":1700000000000000000,"speed_mps":0.42,"steering_rad":0.05,"yaw_rate_radps":0.081,"stop":null}
/// ```
///
/// `stop` is the reason why it stops, or null; speed is metres a second, steering the angle
/// of the virtual front wheel, radians, positive to the left, and 0 for a differential drive,
/// which reads the yaw rate, radians a second. A receiver that hears nothing for 0.3 s
/// should stop.
#[derive(Debug)]
pub struct UdpJson {
    name: String,
    socket: UdpSocket,
    line: Vec<u8>,
}

#[derive(Serialize)]
struct Message {
    stamp_ns: i64,
    speed_mps: f64,
    steering_rad: f64,
    yaw_rate_radps: f64,
    stop: Option<&'static str>,
}

impl UdpJson {
    /// To `HOST:PORT`; `name` is for errors.
    ///
    /// # Errors
    /// [`ActuatorError::Io`] when the address means nothing.
    pub fn open(name: &str, address: &str) -> Result<Self, ActuatorError> {
        let open = || {
            // Any port of the side from which the address can be reached.
            let sockets = std::net::ToSocketAddrs::to_socket_addrs(address)?;
            let mut last = io::Error::from(io::ErrorKind::AddrNotAvailable);
            for to in sockets {
                let own = if to.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
                match UdpSocket::bind(own).and_then(|s| s.connect(to).map(|()| s)) {
                    Ok(socket) => return Ok(socket),
                    Err(error) => last = error,
                }
            }
            Err(last)
        };
        let failed = |reason| ActuatorError::Io { name: name.to_owned(), reason };
        Ok(Self { socket: open().map_err(failed)?, name: name.to_owned(), line: Vec::new() })
    }
}

impl Actuator for UdpJson {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, command: &DriveCommand) -> Result<(), ActuatorError> {
        let message = Message {
            stamp_ns: command.stamp.nanos(),
            speed_mps: command.speed,
            steering_rad: command.steering_angle,
            yaw_rate_radps: command.yaw_rate,
            stop: command.stop.map(|stop| stop.name()),
        };
        self.line.clear();
        let written = serde_json::to_writer(&mut self.line, &message).map_err(io::Error::from);
        let sent = written.and_then(|()| match self.socket.send(&self.line) {
            // The answer to an earlier datagram: nobody listens yet.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => Ok(0),
            sent => sent,
        });
        let failed = |reason| ActuatorError::Io { name: self.name.clone(), reason };
        sent.map(|_| ()).map_err(failed)
    }
}
