//! Commands on their way to a robot.
#![allow(missing_docs, clippy::unwrap_used)]

use realnet_core::{DriveCommand, Stamp, StopReason};
use realnet_io::actuator::{VescOptions, open};
use std::net::UdpSocket;
use std::time::Duration;

#[test]
fn datagrams_of_json() {
    let robot = UdpSocket::bind("127.0.0.1:0").unwrap();
    robot.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let spec = format!("udp://{}", robot.local_addr().unwrap());
    let mut actuator = open(&spec, &VescOptions::default()).unwrap();
    assert_eq!(actuator.name(), spec);
    let command = DriveCommand {
        stamp: Stamp::from_nanos(12),
        speed: 0.5,
        steering_angle: -0.25,
        yaw_rate: 0.125,
        stop: Some(StopReason::TooClose),
    };
    actuator.send(&command).unwrap();
    let heard = || {
        let mut bytes = [0; 512];
        let length = robot.recv(&mut bytes).unwrap();
        String::from_utf8(bytes[..length].to_vec()).unwrap()
    };
    assert_eq!(
        heard(),
        r#"{"stamp_ns":12,"speed_mps":0.5,"steering_rad":-0.25,"yaw_rate_radps":0.125,"stop":"too-close"}"#
    );
    actuator.stop(Stamp::ZERO).unwrap();
    assert!(heard().ends_with(
        r#""speed_mps":0.0,"steering_rad":0.0,"yaw_rate_radps":0.0,"stop":"requested"}"#
    ));
}

/// The first datagram to a port where nobody listens is answered by an error at the next:
/// that is no reason to end.
#[test]
fn nobody_listens_yet() {
    let nobody = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut actuator = open(&format!("udp://{nobody}"), &VescOptions::default()).unwrap();
    for _ in 0..5 {
        actuator.send(&DriveCommand::default()).unwrap();
    }
}

#[test]
fn what_is_no_actuator_is_named() {
    for (spec, said) in [
        ("motors", "'motors' is no actuator"),
        ("udp://127.0.0.1", "udp://127.0.0.1"),
        ("udp://127.0.0.1:99999", "99999"),
        ("vesc:/dev/nowhere", "vesc:/dev/nowhere"),
    ] {
        let error = open(spec, &VescOptions::default()).err().unwrap().to_string();
        assert!(error.contains(said), "{error}");
    }
}
