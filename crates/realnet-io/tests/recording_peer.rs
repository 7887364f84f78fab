//! What the MCAP packages of PyPI read in a recording.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

mod run;

use realnet_core::Detection;
use realnet_io::recording::{Content, Recorded};
use run::{calibration, info, write_run};
use serde_json::{Value, json};
use std::process::Command;

/// What the script prints for the file; `None` after a message that the test is
/// skipped.
fn peer(path: &std::path::Path) -> Option<Value> {
    let python = |args: &[&str]| Command::new("python3").args(args).output();
    if !python(&["-c", "import mcap, mcap_protobuf"]).is_ok_and(|o| o.status.success()) {
        println!("skipped: python3 has no mcap and mcap-protobuf-support");
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../bench/peers/mcap/read.py");
    let output = python(&[script, path.to_str().unwrap()]).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

fn corners(found: &Detection) -> [[f64; 2]; 4] {
    let [x0, y0, x1, y1] = <[f32; 4]>::from(found.bbox).map(f64::from);
    [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
}

/// The topic of a message and its content as the script describes it; of
/// detections also the annotations.
fn described(recorded: &Recorded) -> Vec<(&'static str, Value)> {
    let stamp = recorded.times.stamp.nanos();
    match &recorded.content {
        Content::Image(picture) => {
            let crc = crc32fast::hash(picture);
            let size = picture.len();
            let described = json!({
                "stamp": stamp, "format": "jpeg", "crc": crc, "size": size, "frame_id": "front"
            });
            vec![("/camera/image", described)]
        }
        Content::Calibration(camera) => {
            assert_eq!(**camera, calibration());
            let described = json!({
                "stamp": stamp, "frame_id": "front", "width": 24, "height": 16,
                "model": "plumb_bob", "d": [-0.3, 0.1, 1e-4, -2e-4, 0.05],
                "k": [500.1, 0.0, 11.5, 0.0, 499.7, 7.3, 0.0, 0.0, 1.0],
                "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
                "p": [500.1, 0.0, 11.5, 0.0, 0.0, 499.7, 7.3, 0.0, 0.0, 0.0, 1.0, 0.0],
            });
            vec![("/camera/calibration", described)]
        }
        Content::Detections(found) => {
            let objects = found.iter().map(|named| {
                let found = &named.detection;
                json!({
                    "class_id": found.class_id, "class": named.class,
                    "confidence": f64::from(found.confidence),
                    "box": <[f32; 4]>::from(found.bbox).map(f64::from),
                })
            });
            let texts = found.iter().map(|f| format!("{} {:.2}", f.class, f.detection.confidence));
            let points = found.iter().map(|f| corners(&f.detection));
            let annotations = json!({
                "stamp": stamp,
                "texts": texts.collect::<Vec<_>>(),
                "points": points.collect::<Vec<_>>(),
            });
            vec![
                ("/detections", json!({"detections": objects.collect::<Vec<_>>()})),
                ("/detections/annotations", annotations),
            ]
        }
        Content::Depth(map) => {
            let depths: Vec<_> = map.data().iter().map(|&depth| f64::from(depth)).collect();
            let described = json!({
                "stamp": stamp, "width": map.width(), "height": map.height(), "depths": depths
            });
            vec![("/depth", described)]
        }
        Content::State(state) => vec![("/target", state.clone())],
        Content::Command(command) => {
            let described = json!({
                "speed_mps": command.speed, "steering_rad": command.steering_angle,
                "yaw_rate_radps": command.yaw_rate, "stop": command.stop.map(|stop| stop.name()),
            });
            vec![("/command", described)]
        }
    }
}

#[test]
fn python_reads_the_same_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let (bytes, given) = write_run(45);
    std::fs::write(&path, bytes).unwrap();
    let Some(theirs) = peer(&path) else { return };

    assert_eq!(theirs["attachments"], json!({"parameters.toml": info().parameters}));
    assert_eq!(theirs["metadata"], json!({"realnet": info().versions}));
    let expected: Vec<_> = given
        .iter()
        .flat_map(|recorded| described(recorded).into_iter().map(|of| (recorded.times, of)))
        .collect();
    assert_eq!(theirs["message_count"], expected.len());
    let theirs = theirs["messages"].as_array().unwrap();
    assert_eq!(theirs.len(), expected.len());
    for (message, (times, (topic, content))) in theirs.iter().zip(expected) {
        assert_eq!(message["topic"], topic);
        assert_eq!(message["log_time"], times.arrival.nanos());
        assert_eq!(message["publish_time"], times.stamp.nanos());
        assert_eq!(message["content"], content, "{topic} {}", message["sequence"]);
    }
}
