//! `realnet follow` as a user runs it: frames in, ranges and commands out.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]
#![allow(dead_code, reason = "helpers for the other tests")]

mod common;

use common::{Run, realnet, shared};
use serde_json::Value;
use tempfile::tempdir;

/// The keys that every reader may count on, in their order.
const KEYS: [&str; 13] = [
    "frame",
    "source",
    "stamp_ns",
    "state",
    "class",
    "box",
    "range_m",
    "range_sigma_m",
    "position_m",
    "velocity_mps",
    "cues",
    "command",
    "ms",
];

fn lines(run: &Run) -> Vec<Value> {
    run.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Everything but how long it took.
fn timeless(mut lines: Vec<Value>) -> Vec<Value> {
    for line in &mut lines {
        line.as_object_mut().unwrap().remove("ms").unwrap();
    }
    lines
}

/// A car in a room, a second from frame to frame, with the program's own networks.
#[test]
fn a_car_is_seen_ranged_and_followed() {
    let Some(pictures) = shared("data/rc-car/seq2/images") else { return };
    let (pictures, folder) = (pictures.to_str().unwrap().to_owned(), tempdir().unwrap());
    let save = folder.path().to_str().unwrap();
    let args = ["follow", "--source", &pictures, "--fps", "1", "--limit", "12", "--fov", "65"];
    let more = ["--target", "rc_car", "--engine", "rten", "--json", "--save", save];
    let run = realnet(&[args.as_slice(), &more].concat());
    assert_eq!(run.code, Some(0), "{run:#?}");
    assert!(run.stderr.starts_with("realnet: 12 frames; frame to command: p50"), "{run:#?}");
    let found = lines(&run);
    assert_eq!(found.len(), 12);
    for line in &found {
        assert_eq!(line.as_object().unwrap().keys().collect::<Vec<_>>(), KEYS);
        assert_eq!((&line["state"], &line["class"]), (&"tracking".into(), &"rc_car".into()));
        let (range, std) = (line["range_m"].as_f64().unwrap(), line["range_sigma_m"].as_f64());
        assert!((0.8..4.5).contains(&range) && std.unwrap() < 0.5 * range, "{line}");
        assert_eq!(line["position_m"][2].as_f64().unwrap(), range);
        // Neither the camera's height nor the target's was told.
        assert!(line["cues"]["ground"].is_null() && line["cues"]["size"].is_null(), "{line}");
        let edges: Vec<f64> =
            line["box"].as_array().unwrap().iter().map(|edge| edge.as_f64().unwrap()).collect();
        assert!(edges[0] < edges[2] && edges[1] < edges[3] && edges[3] <= 720.0, "{line}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 12);
    // The same frames give the same answers.
    let again = realnet(&[args.as_slice(), &more[..5]].concat());
    assert_eq!(timeless(lines(&again)), timeless(found));
}

#[test]
fn without_a_depth_network_the_ground_tells() {
    let Some(pictures) = shared("data/rc-car/seq2/images") else { return };
    let pictures = pictures.to_str().unwrap();
    let args = ["follow", "--source", pictures, "--fps", "1", "--limit", "6", "--fov", "65"];
    let ground = ["--depth", "none", "--camera-height", "0.2", "--engine", "rten", "--json"];
    let run = realnet(&[args.as_slice(), &ground].concat());
    let found = lines(&run);
    assert_eq!((run.code, found.len()), (Some(0), 6), "{run:#?}");
    for line in found {
        assert!(line["cues"]["network"].is_null() && line["cues"]["motion"].is_null(), "{line}");
        assert!(line["range_m"].is_null() || line["cues"]["ground"].is_f64(), "{line}");
    }
    // Nothing tells a range: nothing is said, and nobody drives.
    let run = realnet(&[args.as_slice(), &["--depth", "none", "--json"]].concat());
    for line in lines(&run) {
        assert!(line["range_m"].is_null() && line["box"].is_array(), "{line}");
        assert_eq!(line["command"]["speed_mps"], 0.0, "{line}");
    }
}

/// A grey picture of this size.
fn grey(folder: &std::path::Path, name: &str, width: u32, height: u32) {
    image::GrayImage::from_pixel(width, height, image::Luma([90])).save(folder.join(name)).unwrap();
}

#[test]
fn an_empty_room_and_bad_pictures() {
    let folder = tempdir().unwrap();
    for (name, width) in [("a.png", 320), ("b.png", 320), ("d.png", 300), ("e.png", 320)] {
        grey(folder.path(), name, width, 240);
    }
    std::fs::write(folder.path().join("c.png"), "no picture").unwrap();
    let source = folder.path().to_str().unwrap();
    let run = realnet(&["follow", "--source", source, "--engine", "rten", "--json"]);
    assert_eq!(run.code, Some(2), "{run:#?}");
    let found = lines(&run);
    let frames: Vec<u64> = found.iter().map(|line| line["frame"].as_u64().unwrap()).collect();
    assert_eq!(frames, [0, 1, 4], "those of the first one's size");
    for line in found {
        assert_eq!(line["state"], "searching");
        assert!(line["box"].is_null() && line["range_m"].is_null() && line["class"].is_null());
        assert_eq!(
            (&line["command"]["speed_mps"], &line["command"]["stop"]),
            (&0.0.into(), &"no-target".into())
        );
    }
    for said in ["taken to see 65 degrees", "c.png", "300x240"] {
        assert!(run.stderr.contains(said), "{said}: {}", run.stderr);
    }
}

#[test]
fn bad_input_is_named() {
    let folder = tempdir().unwrap();
    grey(folder.path(), "a.png", 64, 48);
    let source = folder.path().to_str().unwrap();
    for (args, said) in [
        (vec!["--target", "cat"], "no class 'cat'"),
        (vec!["--detector", "nowhere.onnx"], "nowhere.onnx"),
        (vec!["--depth", "nowhere.onnx"], "nowhere.onnx"),
        (vec!["--camera", "nowhere.yaml"], "nowhere.yaml"),
        (vec!["--fov", "200"], "200"),
        (vec!["--camera-height", "-1"], "-1"),
        (vec!["--gap", "0"], "above 0"),
        (vec!["--camera-forward", "nan"], "nan"),
    ] {
        let run = realnet(&[vec!["follow", "--source", source], args].concat());
        assert!(run.code == Some(2) && run.stderr.contains(said), "{said}: {run:#?}");
    }
}

/// Frames that come faster than they are done with: the newest is taken, none waits.
#[test]
fn in_real_time_the_newest_frame_counts() {
    let Some(pictures) = shared("data/rc-car/seq2/images") else { return };
    let pictures = format!("{}/00000*.jpg", pictures.display());
    let args = ["follow", "--source", &pictures, "--fps", "1000", "--realtime", "--fov", "65"];
    let run = realnet(&[args.as_slice(), &["--engine", "rten", "--json"]].concat());
    assert_eq!(run.code, Some(0), "{run:#?}");
    let frames: Vec<u64> = lines(&run).iter().map(|line| line["frame"].as_u64().unwrap()).collect();
    assert!(frames.is_sorted() && frames.last() == Some(&9), "{frames:?}");
    // What was not said anything of is told.
    let missing = 10 - frames.len();
    let told = format!("{missing} frames came while another one was in work");
    assert!(missing == 0 || run.stderr.contains(&told), "{run:#?}");
    assert!(run.stderr.contains("frame to command: p50"), "{run:#?}");
}

/// The robot hears every command, and a stop at the end; nothing without `--drive`.
#[test]
fn motors_hear_commands_and_a_stop() {
    let Some(pictures) = shared("data/rc-car/seq2/images") else { return };
    let pictures = format!("{}/00000*.jpg", pictures.display());
    let robot = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    robot.set_nonblocking(true).unwrap();
    let actuator = format!("udp://{}", robot.local_addr().unwrap());
    let args = ["follow", "--source", &pictures, "--fps", "20", "--fov", "65", "--json"];
    let motors = ["--actuator", &actuator, "--engine", "rten"];
    let heard = || {
        let mut bytes = [0; 512];
        let messages =
            std::iter::from_fn(|| robot.recv(&mut bytes).ok().map(|n| bytes[..n].to_vec()));
        messages.map(|bytes| serde_json::from_slice(&bytes).unwrap()).collect::<Vec<Value>>()
    };
    let run = realnet(&[args.as_slice(), &motors, &["--realtime"]].concat());
    assert_eq!((run.code, heard().len()), (Some(0), 0), "{run:#?}");
    let run = realnet(&[args.as_slice(), &motors, &["--realtime", "--drive"]].concat());
    assert_eq!(run.code, Some(0), "{run:#?}");
    let messages = heard();
    let said = lines(&run);
    assert!(messages.len() >= said.len() + 5, "{} {}", messages.len(), said.len());
    for line in &said {
        let command = &line["command"];
        let sent = |message: &Value| {
            (message["speed_mps"].as_f64().unwrap() - command["speed_mps"].as_f64().unwrap()).abs()
                < 1e-6
                && message["stop"] == command["stop"]
        };
        assert!(messages.iter().any(sent), "{line}");
    }
    let last = messages.last().unwrap();
    assert_eq!((&last["speed_mps"], &last["stop"]), (&0.0.into(), &"requested".into()));
    // Recorded frames drive nobody.
    let run = realnet(&[args.as_slice(), &motors, &["--drive"]].concat());
    assert!(run.code == Some(2) && run.stderr.contains("--drive is for"), "{run:#?}");
}

/// Everything of a run, as a file that other programs read too.
#[test]
fn a_run_is_recorded() {
    use realnet::recording::{Content, RunReader};
    let Some(pictures) = shared("data/rc-car/seq2/images") else { return };
    let folder = tempdir().unwrap();
    let pictures = format!("{}/00000[0-4].jpg", pictures.display());
    let run_file = folder.path().join("run.mcap");
    let record = run_file.to_str().unwrap();
    let args = ["follow", "--source", &pictures, "--fps", "2", "--fov", "65", "--json"];
    let args = [args.as_slice(), &["--engine", "rten", "--record", record]].concat();
    let run = realnet(&args);
    assert_eq!(run.code, Some(0), "{run:#?}");
    let said = lines(&run);
    let recorded = RunReader::open(&run_file).unwrap();
    assert!(recorded.info().parameters.contains("--record"), "{:?}", recorded.info());
    let (mut states, mut counts) = (Vec::new(), [0; 5]);
    for message in recorded {
        let message = message.unwrap();
        let kind = match message.content {
            Content::Image(bytes) => {
                assert!(bytes.starts_with(&[0xff, 0xd8]), "a JPEG");
                0
            }
            Content::Calibration(camera) => {
                assert_eq!(camera.camera().width(), 1280);
                1
            }
            Content::Detections(found) => {
                assert!(found.iter().any(|found| found.class == "rc_car"), "{found:?}");
                2
            }
            Content::Depth(map) => {
                assert_eq!((map.width(), map.height()), (256, 144));
                3
            }
            Content::Command(command) => {
                assert_eq!(command.stamp, message.times.stamp);
                4
            }
            Content::State(state) => {
                states.push(state);
                continue;
            }
        };
        counts[kind] += 1;
    }
    assert_eq!((counts, &states), ([5, 1, 5, 5, 5], &said));
    // A recording is never overwritten.
    let again = realnet(&args);
    assert!(again.code != Some(0) && again.stderr.contains("run.mcap"), "{again:#?}");
}

/// Frames that cannot be followed leave no motor without a command.
#[test]
fn refused_frames_are_commands_too() {
    let folder = tempdir().unwrap();
    for index in 0..90 {
        let width = if index == 0 { 320 } else { 300 };
        grey(folder.path(), &format!("{index:02}.png"), width, 240);
    }
    let robot = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    robot.set_nonblocking(true).unwrap();
    let actuator = format!("udp://{}", robot.local_addr().unwrap());
    let source = folder.path().to_str().unwrap();
    let args = ["follow", "--source", source, "--fov", "65", "--realtime", "--engine", "rten"];
    let run = realnet(&[args.as_slice(), &["--actuator", &actuator, "--drive"]].concat());
    assert_eq!(run.code, Some(2), "{run:#?}");
    let refused = run.stderr.matches("after those of 320x240").count();
    let messages = std::iter::from_fn(|| robot.recv(&mut [0; 512]).ok()).count();
    // That of the first frame, those of the refused ones, and the last stops.
    assert!(refused > 0 && messages >= 1 + refused + 5, "{messages} for {refused}: {run:#?}");
}
