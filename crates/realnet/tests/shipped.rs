//! The networks in models/ are what their cards say.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]
#![allow(dead_code, reason = "helpers for the other tests")]

mod common;

use common::{realnet, shared};
use std::path::{Path, PathBuf};

fn model(name: &str) -> String {
    let path: PathBuf = [env!("CARGO_MANIFEST_DIR"), "../../models", name].iter().collect();
    path.to_str().expect("the path of the clone is UTF-8").to_owned()
}

/// The JSON object of a run that judged something.
fn judged(args: &[&str]) -> serde_json::Value {
    let run = realnet(args);
    assert_eq!(run.code, Some(0), "{run:#?}");
    serde_json::from_str(run.stdout.trim()).unwrap()
}

fn figure(found: &serde_json::Value, name: &str) -> f64 {
    found[name].as_f64().unwrap_or_else(|| panic!("no {name} in {found}"))
}

/// Pictures of the simulator that no network was trained on.
fn drawn(folder: &Path) -> String {
    let out = folder.join("drawn");
    let path = out.to_str().unwrap().to_owned();
    let size = ["--width", "480", "--height", "360"];
    let args =
        ["sim", "--dataset", &path, "--frames", "48", "--seed", "1000", "--camera-height", "0.18"];
    let run = realnet(&[args.as_slice(), &size].concat());
    assert_eq!(run.code, Some(0), "{run:#?}");
    path
}

/// What the detector finds in pictures, its classes being the simulator's and the car.
fn detected(pictures: &str) -> serde_json::Value {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data.yaml");
    let text = format!("val: {pictures}\nnames: [rc_car, truck, buggy, robot]\n");
    std::fs::write(&data, text).unwrap();
    let (data, model) = (data.to_str().unwrap(), model("vehicles-yolov5n-320.onnx"));
    let found = judged(&["val", "detect", "--data", data, "--model", &model, "--json"]);
    println!("{found}");
    found
}

#[test]
fn the_car_in_a_room_that_was_not_learned() {
    let Some(pictures) = shared("data/rc-car/seq4/images") else { return };
    let found = detected(pictures.to_str().unwrap());
    assert!(figure(&found, "map50") > 0.97, "{found}");
    assert!(figure(&found, "map50_95") > 0.74, "{found}");
}

#[test]
fn drawn_vehicles() {
    let folder = tempfile::tempdir().unwrap();
    let found = detected(&format!("{}/images/train", drawn(folder.path())));
    assert!(figure(&found, "map50") > 0.25, "{found}");
}

/// The depth networks, and what their errors must stay below in drawn rooms and on
/// photographs (abs_rel), and above (d1).
const DEPTH: [(&str, f64, f64, f64); 2] =
    [("vnl-lite-256x192.onnx", 0.18, 0.3, 0.45), ("vnl-lite-128x96.onnx", 0.2, 0.3, 0.45)];

#[test]
fn depth_of_drawn_rooms() {
    let folder = tempfile::tempdir().unwrap();
    let drawn = drawn(folder.path());
    let data = format!("{drawn}/rgbd/train");
    for (name, most, ..) in DEPTH {
        let found = judged(&["val", "depth", "--data", &data, "--model", &model(name), "--json"]);
        println!("{name}: {found}");
        assert!(figure(&found, "abs_rel") < most, "{found}");
    }
}

#[test]
fn depth_of_scenes_that_were_not_learned() {
    let Some(data) = shared("data/nyu-depth-v2/train") else { return };
    let data = data.to_str().unwrap();
    for (name, _, most, least) in DEPTH {
        let chosen = ["--format", "nyu", "--from", "1400", "--model", &model(name)];
        let args = ["val", "depth", "--data", data, "--json"];
        let found = judged(&[args.as_slice(), &chosen].concat());
        println!("{name}: {found}");
        assert!(figure(&found, "abs_rel") < most, "{found}");
        assert!(figure(&found, "d1") > least, "{found}");
    }
}

/// As many bytes as a clone should have to carry.
#[test]
fn all_of_them_are_small_and_have_a_card() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
    let mut bytes = 0;
    let mut networks = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "onnx") {
            bytes += path.metadata().unwrap().len();
            networks += 1;
            assert!(path.with_extension("md").is_file(), "{} has no card", path.display());
        }
    }
    assert_eq!(networks, 3);
    assert!(bytes < 20_000_000, "{bytes} bytes");
}
