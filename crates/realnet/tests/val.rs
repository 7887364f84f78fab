//! `realnet val detect` as a user runs it.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod common;

use common::{listing, realnet, shared, tiny};
use serde_json::{Value, json};
use std::path::Path;
use tempfile::tempdir;

fn val(more: &[&str]) -> common::Run {
    realnet(&[&["val", "detect", "--engine", "rten"], more].concat())
}

fn text(path: &Path) -> &str {
    path.to_str().expect("temporary and shared paths are UTF-8")
}

/// The single JSON object of a run.
fn report(run: &common::Run) -> Value {
    assert_eq!(run.stdout.lines().count(), 1, "{run:#?}");
    serde_json::from_str(&run.stdout).unwrap()
}

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn keys(value: &Value) -> Vec<&str> {
    value.as_object().expect("an object").keys().map(String::as_str).collect()
}

const SCORES: [&str; 5] = ["map50", "map50_95", "precision", "recall", "f1"];

/// Asserts that two reports measure the same.
#[track_caller]
fn assert_same_scores(a: &Value, b: &Value) {
    for key in SCORES {
        let (x, y) = (a[key].as_f64().unwrap(), b[key].as_f64().unwrap());
        assert!((x - y).abs() < 1e-9, "{key}: {x} and {y}");
    }
    assert_eq!((&a["images"], &a["instances"]), (&b["images"], &b["instances"]));
}

/// The real frames with the real network, which knows no RC car but takes it for
/// cars and other things.
struct RcCar {
    model: String,
    data: String,
    images: String,
    labels: std::path::PathBuf,
}

fn rc_car() -> Option<RcCar> {
    let own = |path: std::path::PathBuf| text(&path).to_owned();
    Some(RcCar {
        model: own(shared("models/yolov5n.pt")?),
        data: own(shared("data/rc-car/data.yaml")?),
        images: own(shared("data/rc-car/seq4/images")?),
        labels: shared("data/rc-car/seq4/labels")?,
    })
}

const LIMIT: usize = 10;

#[test]
fn rc_car_gives_one_object_with_the_promised_fields() {
    let Some(car) = rc_car() else { return };
    let folder = tempdir().unwrap();
    let save = folder.path().join("plots");
    let base = ["--model", &car.model, "--data", &car.data, "--imgsz", "320", "--single-cls"];
    let more = ["--limit", "10", "--json", "--save", text(&save)];
    let run = val(&[&base[..], &more].concat());
    assert_eq!(run.code, Some(0), "{run:#?}");
    let value = report(&run);
    let wanted = [&SCORES[..], &["images", "instances", "per_class"]].concat();
    assert_eq!(keys(&value), wanted);
    assert_eq!((&value["images"], &value["instances"]), (&json!(LIMIT), &json!(LIMIT)));
    for key in SCORES {
        let score = value[key].as_f64().unwrap();
        assert!(0.0 < score && score <= 1.0, "{key} {score}");
    }
    let class = &value["per_class"][0];
    assert_eq!(class["class"], "object");
    for key in SCORES {
        assert_eq!(class[key], value[key], "one class is all classes");
    }

    assert_eq!(
        listing(&save),
        [
            "confusion_matrix.png",
            "f1_curve.png",
            "labels.json",
            "metrics.json",
            "pr_curve.png",
            "precision_curve.png",
            "predictions.json",
            "recall_curve.png"
        ]
    );
    for plot in listing(&save).iter().filter(|name| name.ends_with(".png")) {
        let plot = realnet::picture::read(&save.join(plot)).unwrap();
        assert!(plot.width() >= 400 && plot.height() >= 300);
        let background = plot.data()[..3].to_vec();
        assert!(plot.data().chunks_exact(3).any(|pixel| pixel != background), "an empty plot");
    }
    assert_eq!(read_json(&save.join("metrics.json")), value);
    let predictions = read_json(&save.join("predictions.json"));
    assert!(predictions.as_array().unwrap().len() >= LIMIT);

    // What was saved for other tools evaluates to the same.
    let labels = save.join("labels.json");
    let base = ["--model", &car.model, "--data", text(&labels), "--images", &car.images];
    let again = val(&[&base[..], &["--imgsz", "320", "--single-cls", "--json"]].concat());
    assert_eq!(again.code, Some(0), "{again:#?}");
    assert_same_scores(&value, &report(&again));
}

#[test]
fn coco_labels_evaluate_as_the_yolo_form_does() {
    let Some(car) = rc_car() else { return };
    let (mut images, mut annotations) = (Vec::new(), Vec::new());
    for index in 0..LIMIT {
        // Numbers, names and extra fields as COCO files have them.
        let id = 1000 + index;
        images.push(json!({
            "license": 1, "file_name": format!("{index:06}.jpg"), "id": id, "width": 1280,
            "height": 720,
        }));
        let rows = std::fs::read_to_string(car.labels.join(format!("{index:06}.txt"))).unwrap();
        for row in rows.lines() {
            let numbers: Vec<f64> = row.split(' ').map(|word| word.parse().unwrap()).collect();
            let [_, cx, cy, w, h] = numbers[..] else { panic!("{row}") };
            let (w, h) = (w * 1280.0, h * 720.0);
            annotations.push(json!({
                "id": annotations.len() + 1, "image_id": id, "category_id": 17, "iscrowd": 0,
                "bbox": [cx * 1280.0 - w / 2.0, cy * 720.0 - h / 2.0, w, h], "area": w * h,
            }));
        }
    }
    let categories = [json!({ "id": 17, "name": "rc_car", "supercategory": "vehicle" })];
    let coco = json!({
        "info": {}, "images": images, "annotations": annotations, "categories": categories,
    });
    let folder = tempdir().unwrap();
    let file = folder.path().join("labels.json");
    std::fs::write(&file, coco.to_string()).unwrap();

    let base = ["--model", &car.model, "--imgsz", "320", "--single-cls", "--json", "--data"];
    let from_coco = val(&[&base[..], &[text(&file), "--images", &car.images]].concat());
    let from_yolo = val(&[&base[..], &[&car.data, "--limit", "10"]].concat());
    assert_eq!((from_coco.code, from_yolo.code), (Some(0), Some(0)), "{from_coco:#?}");
    assert_same_scores(&report(&from_yolo), &report(&from_coco));
}

#[test]
fn classes_that_the_network_lacks_are_named() {
    let Some(car) = rc_car() else { return };
    let run = val(&["--model", &car.model, "--data", &car.data, "--json"]);
    assert_eq!(run.code, Some(2), "{run:#?}");
    assert!(run.stdout.is_empty(), "{run:#?}");
    assert_eq!(run.stderr.lines().count(), 1, "{run:#?}");
    for part in ["rc_car", "1 of the data's 1 classes", "--single-cls"] {
        assert!(run.stderr.contains(part), "{part}: {run:#?}");
    }
}

/// A data set of bright pictures, each with one box where the tiny detector sees
/// one, and one dark picture without labels.
fn lamps(folder: &Path, names: &str) -> std::path::PathBuf {
    let (images, labels) = (folder.join("images"), folder.join("labels"));
    std::fs::create_dir_all(&images).unwrap();
    std::fs::create_dir_all(&labels).unwrap();
    for index in 0..4 {
        tiny::picture(&images.join(format!("{index}.png")), tiny::SIDE, tiny::SIDE, 240);
        std::fs::write(labels.join(format!("{index}.txt")), "0 0.5 0.5 0.5 0.25\n").unwrap();
    }
    tiny::picture(&images.join("dark.png"), tiny::SIDE, tiny::SIDE, 5);
    std::fs::write(folder.join("tiny.onnx"), tiny::bytes()).unwrap();
    let data = folder.join("data.yaml");
    std::fs::write(&data, format!("path: .\nval: images\nnames: {names}\n")).unwrap();
    data
}

#[test]
fn perfect_boxes_score_one() {
    let folder = tempdir().unwrap();
    let data = lamps(folder.path(), "[lamp]");
    let model = folder.path().join("tiny.onnx");
    let base = ["--model", text(&model), "--data", text(&data)];
    let value = report(&val(&[&base[..], &["--json"]].concat()).quiet());
    for key in SCORES {
        assert_eq!(value[key], 1.0, "{key} in {value}");
    }
    // The picture without a label file counts, and shows nothing.
    assert_eq!((&value["images"], &value["instances"]), (&json!(5), &json!(4)));
    assert_eq!(value["per_class"][0]["class"], "lamp");

    let table = val(&base).quiet().stdout;
    let all = table.lines().find(|line| line.starts_with("all")).expect("a line for all");
    let words: Vec<_> = all.split_whitespace().collect();
    assert_eq!(words, ["all", "5", "4", "1.000", "1.000", "1.000", "1.000", "1.000"]);

    // A wrong box costs what it must: one of four labels is elsewhere.
    std::fs::write(folder.path().join("labels/3.txt"), "0 0.1 0.1 0.1 0.1\n").unwrap();
    let value = report(&val(&[&base[..], &["--json"]].concat()).quiet());
    assert_eq!(value["recall"], 0.75, "{value}");
    let map50 = value["map50"].as_f64().unwrap();
    assert!(map50 < 1.0 && map50 > 0.4, "{value}");
}

#[test]
fn labels_that_stand_twice_are_said_and_count_once() {
    let folder = tempdir().unwrap();
    let data = lamps(folder.path(), "{0: lamp}");
    let model = folder.path().join("tiny.onnx");
    let row = "0 0.5 0.5 0.5 0.25\n";
    std::fs::write(folder.path().join("labels/0.txt"), row.repeat(2)).unwrap();
    let run = val(&["--model", text(&model), "--data", text(&data), "--json"]);
    assert_eq!(run.code, Some(0), "{run:#?}");
    assert_eq!(report(&run)["instances"], 4);
    assert_eq!(run.stderr.lines().count(), 1, "{run:#?}");
    assert!(run.stderr.contains('1') && run.stderr.contains("twice"), "{run:#?}");
}
