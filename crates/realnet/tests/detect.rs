//! `realnet detect` as a user runs it: the boxes of the reference, every kind of
//! source, every kind of result.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod common;

use common::{has_ffmpeg, iou, listing, realnet, shared, tiny, without_ms};
use realnet::results::{Record, RecordDetection};
use serde_json::Value;
use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::Stdio,
};
use tempfile::tempdir;

/// Runs `realnet detect --engine rten --json` and more.
fn detect(more: &[&str]) -> common::Run {
    realnet(&[&["detect", "--engine", "rten", "--json"], more].concat())
}

fn text(path: &Path) -> &str {
    path.to_str().expect("temporary and shared paths are UTF-8")
}

/// The reference's boxes of one picture at one size.
struct Golden {
    ratio: f64,
    pad: [f64; 2],
    /// Box in pixels of the letterboxed picture, confidence, class.
    detections: Vec<([f64; 4], f64, u32)>,
}

/// The reference's answers by name (`bus_640`), or nothing when they are not there.
fn golden() -> Option<Vec<(String, Golden)>> {
    let path = shared("golden/yolov5n/expected.json")?;
    let json: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let read = |(name, entry): (&String, &Value)| {
        let letterbox = &entry["letterbox"];
        let number = |key: &str| letterbox[key].as_f64().unwrap();
        let rows = entry["detections_xyxy_conf_class_in_letterbox_px"].as_array().unwrap();
        let detections = rows.iter().map(|row| {
            let value = |at: usize| row[at].as_f64().unwrap();
            ([value(0), value(1), value(2), value(3)], value(4), value(5) as u32)
        });
        let golden = Golden {
            ratio: number("ratio"),
            pad: [number("pad_x"), number("pad_y")],
            detections: detections.collect(),
        };
        (name.clone(), golden)
    };
    let all: Vec<_> = json.as_object().unwrap().iter().map(read).collect();
    assert_eq!(all.len(), 4, "two pictures at two sizes");
    Some(all)
}

/// The detection of `found` that is most like a wanted one of this class.
fn closest(found: &[RecordDetection], class: u32, wanted: [f64; 4]) -> Option<&RecordDetection> {
    let same = found.iter().filter(|d| d.class_id == class);
    same.max_by(|a, b| iou(a.bbox, wanted).total_cmp(&iou(b.bbox, wanted)))
}

/// Asserts the same classes in the same order with boxes and confidences that
/// differ by at most so much.
#[track_caller]
fn assert_alike(a: &Record, b: &Record, pixels: f64, confidence: f64) {
    assert_eq!(a.detections.len(), b.detections.len(), "{a:#?}\n{b:#?}");
    for wanted in &a.detections {
        let found = closest(&b.detections, wanted.class_id, wanted.bbox).expect("the same classes");
        let far = wanted.bbox.iter().zip(found.bbox).map(|(a, b)| (a - b).abs());
        let far = far.fold(0.0, f64::max);
        let unsure = (wanted.confidence - found.confidence).abs();
        assert!(far <= pixels && unsure <= confidence, "{wanted:?} {found:?}");
    }
}

#[test]
fn letterboxed_pictures_give_the_boxes_of_the_reference() {
    let (Some(golden), Some(model)) = (golden(), shared("models/yolov5n.pt")) else { return };
    for (name, golden) in golden {
        let Some(picture) = shared(&format!("golden/yolov5n/{name}_letterbox.png")) else { return };
        let (_, size) = name.split_once('_').unwrap();
        let run =
            detect(&["--model", text(&model), "--source", text(&picture), "--imgsz", size]).quiet();
        let found = run.record().detections;
        assert_eq!(found.len(), golden.detections.len(), "{name}: {found:#?}");
        for (bbox, confidence, class) in golden.detections {
            let near = closest(&found, class, bbox).expect("the reference's class");
            let far = near.bbox.iter().zip(bbox).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(far < 0.1, "{name}: {near:?} is {far} px from {bbox:?}");
            assert!((near.confidence - confidence).abs() < 1e-3, "{name}: {near:?} {confidence}");
        }
    }
}

#[test]
fn pictures_give_the_boxes_of_the_reference() {
    let (Some(golden), Some(model)) = (golden(), shared("models/yolov5n.pt")) else { return };
    let mut strays = Vec::new();
    for (name, golden) in golden {
        let (stem, size) = name.split_once('_').unwrap();
        let Some(picture) = shared(&format!("data/samples/{stem}.jpg")) else { return };
        let args = ["--model", text(&model), "--source", text(&picture), "--imgsz", size];
        let record = detect(&args).quiet().record();
        let [width, height] = [f64::from(record.width), f64::from(record.height)];
        assert_eq!(record.detections.len(), golden.detections.len(), "{name}: {record:#?}");
        for (bbox, _, class) in golden.detections {
            let edge = |at: usize, limit: f64| {
                ((bbox[at] - golden.pad[at % 2]) / golden.ratio).clamp(0.0, limit)
            };
            let wanted = [edge(0, width), edge(1, height), edge(2, width), edge(3, height)];
            let near = closest(&record.detections, class, wanted).expect("the reference's class");
            let share = iou(near.bbox, wanted);
            if share < 0.98 {
                strays.push(format!("{name}: IoU {share:.4} of {near:?} and {wanted:.3?}"));
            }
        }
    }
    assert!(strays.is_empty(), "{}", strays.join("\n"));
}

#[test]
fn json_has_the_promised_fields_in_their_order() {
    let (Some(model), Some(bus)) = (shared("models/yolov5n.pt"), shared("data/samples/bus.jpg"))
    else {
        return;
    };
    let run = detect(&["--model", text(&model), "--source", text(&bus)]).quiet();
    assert_eq!(run.stdout.matches('\n').count(), 1, "one line a frame and nothing else");
    let value: Value = serde_json::from_str(&run.stdout).unwrap();
    let keys = |value: &Value| -> Vec<String> {
        value.as_object().expect("an object").keys().cloned().collect()
    };
    assert_eq!(
        keys(&value),
        ["frame", "source", "stamp_ns", "width", "height", "detections", "ms"]
    );
    assert_eq!(value["frame"], 0);
    assert_eq!(value["source"], text(&bus));
    assert_eq!(value["stamp_ns"], 0);
    assert_eq!((&value["width"], &value["height"]), (&810.into(), &1080.into()));
    assert_eq!(keys(&value["ms"]), ["pre", "infer", "post"]);
    let detections = value["detections"].as_array().unwrap();
    assert_eq!(detections.len(), 4);
    for detection in detections {
        assert_eq!(keys(detection), ["class_id", "class", "confidence", "box"]);
        let edges = detection["box"].as_array().unwrap();
        let edges: Vec<f64> = edges.iter().map(|edge| edge.as_f64().unwrap()).collect();
        let [x0, y0, x1, y1] = edges[..] else { panic!("{detection}") };
        assert!(0.0 <= x0 && x0 < x1 && x1 <= 810.0 && 0.0 <= y0 && y0 < y1 && y1 <= 1080.0);
    }
    let names: Vec<_> = detections.iter().map(|d| d["class"].as_str().unwrap()).collect();
    assert_eq!(names, ["person", "person", "person", "bus"], "most confident first");
}

#[test]
fn the_same_run_twice_gives_the_same_bytes() {
    let Some(model) = shared("models/yolov5n.pt") else { return };
    let Some(samples) = shared("data/samples") else { return };
    let folder = tempdir().unwrap();
    let run = |name: &str| {
        let out = folder.path().join(name);
        let coco = folder.path().join(format!("{name}.json"));
        let run = detect(&[
            "--model",
            text(&model),
            "--source",
            text(&samples),
            "--imgsz",
            "320",
            "--save",
            text(&out),
            "--save-txt",
            text(&out),
            "--save-coco",
            text(&coco),
        ]);
        let files: Vec<_> =
            listing(&out).into_iter().map(|f| std::fs::read(out.join(f)).unwrap()).collect();
        (without_ms(&run.quiet().stdout), listing(&out), files, std::fs::read(coco).unwrap())
    };
    let first = run("first");
    assert_eq!(first.1, ["bus.jpg", "bus.txt", "zidane.jpg", "zidane.txt"]);
    assert!(first == run("second"), "records, pictures, text or COCO results differ");
}

#[test]
fn saved_pictures_are_drawn_on_at_the_boxes_only() {
    let (Some(model), Some(bus)) = (shared("models/yolov5n.pt"), shared("data/samples/bus.jpg"))
    else {
        return;
    };
    let folder = tempdir().unwrap();
    let out = folder.path().join("made/on/the/way");
    let record = detect(&["--model", text(&model), "--source", text(&bus), "--save", text(&out)])
        .quiet()
        .record();
    assert_eq!(listing(&out), ["bus.jpg"]);
    let before = realnet::picture::read(&bus).unwrap();
    let after = realnet::picture::read(&out.join("bus.jpg")).unwrap();
    let (width, height) = (before.width(), before.height());
    assert_eq!((after.width(), after.height()), (width, height));

    let difference = |x: u32, y: u32| -> f64 {
        let at = (y as usize * width as usize + x as usize) * 3;
        let pairs = before.data()[at..at + 3].iter().zip(&after.data()[at..at + 3]);
        pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / 3.0
    };
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
    for detection in &record.detections {
        let [x0, y0, x1, y1] = detection.bbox.map(|edge| edge.round() as u32);
        let (x1, y1) = (x1.min(width - 1), y1.min(height - 1));
        let sides = (y0..=y1).flat_map(|y| [difference(x0, y), difference(x1, y)]);
        let ends = (x0..=x1).flat_map(|x| [difference(x, y0), difference(x, y1)]);
        let drawn = mean(sides.chain(ends).collect());
        assert!(drawn > 30.0, "the edges of {detection:?} differ by {drawn} only");
    }
    // Far from boxes and the labels above them only the JPEG was written again.
    let far = |x: u32, y: u32| {
        record.detections.iter().all(|detection| {
            let [x0, y0, x1, y1] = detection.bbox;
            let (x, y) = (f64::from(x), f64::from(y));
            x < x0 - 16.0 || x > x1.max(x0 + 200.0) + 16.0 || y < y0 - 60.0 || y > y1 + 16.0
        })
    };
    let untouched: Vec<f64> = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .filter(|&(x, y)| far(x, y))
        .map(|(x, y)| difference(x, y))
        .collect();
    assert!(untouched.len() > 100_000, "{} pixels", untouched.len());
    let drift = mean(untouched);
    assert!(drift < 4.0, "untouched pixels differ by {drift}");
}

#[test]
fn folders_come_in_natural_order_with_stamps() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("tiny.onnx"), tiny::bytes()).unwrap();
    std::fs::create_dir(path("frames")).unwrap();
    // Brighter and brighter in natural order, which is not that of the alphabet.
    for (name, grey) in [("1.png", 90), ("2.jpg", 120), ("10.png", 200), ("100.JPG", 250)] {
        tiny::picture(&path("frames").join(name.to_lowercase()), 128, 96, grey);
        std::fs::rename(path("frames").join(name.to_lowercase()), path("frames").join(name))
            .unwrap();
    }
    std::fs::write(path("frames/notes.txt"), "no picture").unwrap();
    std::fs::write(path("frames/.3.jpg"), "hidden").unwrap();
    let (model, frames) = (path("tiny.onnx"), path("frames"));
    let run = |source: &str, more: &[&str]| {
        detect(&[&["--model", text(&model), "--source", source], more].concat()).quiet().records()
    };
    let names = |records: &[Record]| -> Vec<String> {
        let name = |record: &Record| record.source.rsplit('/').next().unwrap().to_owned();
        records.iter().map(name).collect()
    };

    let all = run(text(&frames), &["--fps", "8"]);
    assert_eq!(names(&all), ["1.png", "2.jpg", "10.png", "100.JPG"]);
    assert_eq!(all.iter().map(|r| r.frame).collect::<Vec<_>>(), [0, 1, 2, 3]);
    let stamps: Vec<i64> = all.iter().map(|r| r.stamp_ns).collect();
    assert_eq!(stamps, [0, 125_000_000, 250_000_000, 375_000_000]);
    // The right pixels went into the network: 128x96 becomes 64x48 between two
    // strips of grey 114, and the confidence is the mean brightness.
    for (record, grey) in all.iter().zip([90.0, 120.0, 200.0, 250.0]) {
        let confidence = (0.75 * grey + 0.25 * 114.0) / 255.0;
        let [found] = &record.detections[..] else { panic!("{record:?}") };
        assert!((found.confidence - confidence).abs() < 3e-3, "{found:?} {confidence}");
        assert_eq!((found.class_id, found.class.as_str()), (0, tiny::CLASS));
        let [x0, y0, x1, y1] = tiny::BOX;
        let wanted = [x0 * 2.0, (y0 - 8.0) * 2.0, x1 * 2.0, (y1 - 8.0) * 2.0];
        assert!(found.bbox.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-2), "{found:?}");
    }

    assert_eq!(names(&run(&format!("{}/*.png", text(&frames)), &[])), ["1.png", "10.png"]);
    assert_eq!(names(&run(&format!("{}/1*", text(&frames)), &[])), ["1.png", "10.png", "100.JPG"]);
    assert_eq!(names(&run(text(&frames), &["--limit", "2"])), ["1.png", "2.jpg"]);
    assert!(run(text(&frames), &["--limit", "0"]).is_empty());
    let thirty: Vec<i64> = run(text(&frames), &[]).iter().map(|r| r.stamp_ns).collect();
    assert_eq!(thirty, [0, 33_333_333, 66_666_667, 100_000_000], "30 frames a second by default");
    // Confident ones only, and boxes of some size only.
    let strict = run(text(&frames), &["--conf", "0.6"]);
    assert_eq!(strict.iter().map(|r| r.detections.len()).collect::<Vec<_>>(), [0, 0, 1, 1]);
    let large = run(text(&frames), &["--min-size", "33"]);
    assert!(large.iter().all(|record| record.detections.is_empty()), "the box is 64x32");
    let none = run(text(&frames), &["--max-det", "0"]);
    assert!(none.iter().all(|record| record.detections.is_empty()));
}

#[test]
fn pictures_of_one_name_do_not_overwrite_each_other() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("tiny.onnx"), tiny::bytes()).unwrap();
    for (sub, grey) in [("a", 100), ("b", 200)] {
        std::fs::create_dir(path(sub)).unwrap();
        tiny::picture(&path(sub).join("same.png"), 64, 64, grey);
    }
    let (model, glob, out) = (path("tiny.onnx"), path("?/same.png"), path("out"));
    let run = realnet(&[
        "detect",
        "--engine",
        "rten",
        "--model",
        text(&model),
        "--source",
        text(&glob),
        "--save",
        text(&out),
        "--save-txt",
        text(&out),
    ])
    .quiet();
    assert_eq!(run.stdout.lines().count(), 2, "one line a picture for people: {}", run.stdout);
    assert!(run.stdout.contains("a/same.png #0 64x64: 1 lamp ("), "{}", run.stdout);
    assert_eq!(listing(&out), ["same-2.png", "same-2.txt", "same.png", "same.txt"]);
}

#[test]
fn classes_are_chosen_by_name_or_number() {
    let (Some(model), Some(bus)) = (shared("models/yolov5n.pt"), shared("data/samples/bus.jpg"))
    else {
        return;
    };
    let classes = |wanted: &str| -> Vec<String> {
        let args = ["--model", text(&model), "--source", text(&bus), "--classes", wanted];
        let record = detect(&args).quiet().record();
        record.detections.into_iter().map(|d| d.class).collect()
    };
    assert_eq!(classes("bus"), ["bus"]);
    assert_eq!(classes("5"), ["bus"]);
    assert_eq!(classes("person"), ["person"; 3]);
    assert_eq!(classes("bus,person"), ["person", "person", "person", "bus"]);
    assert_eq!(classes("traffic light"), [""; 0]);
}

#[test]
fn text_and_coco_results_agree_with_json() {
    let Some(model) = shared("models/yolov5n.pt") else { return };
    let Some(samples) = shared("data/samples") else { return };
    let folder = tempdir().unwrap();
    let (plain, rated) = (folder.path().join("plain"), folder.path().join("rated"));
    let coco = folder.path().join("results.json");
    let base = ["--model", text(&model), "--source", text(&samples), "--imgsz", "320"];
    let one = detect(&[&base[..], &["--save-txt", text(&plain)]].concat()).quiet();
    let more = ["--save-txt", text(&rated), "--save-conf", "--save-coco", text(&coco)];
    let two = detect(&[&base[..], &more].concat()).quiet();
    assert_eq!(without_ms(&one.stdout), without_ms(&two.stdout), "saving changes no box");

    let results: Vec<Value> = serde_json::from_slice(&std::fs::read(coco).unwrap()).unwrap();
    let mut results = results.iter();
    for (image, record) in two.records().iter().enumerate() {
        let stem = Path::new(&record.source).with_extension("txt");
        let rows = |folder: &Path| -> Vec<Vec<f64>> {
            let text = std::fs::read_to_string(folder.join(stem.file_name().unwrap())).unwrap();
            let row = |line: &str| line.split(' ').map(|word| word.parse().unwrap()).collect();
            text.lines().map(row).collect()
        };
        let (plain, rated) = (rows(&plain), rows(&rated));
        assert!(!rated.is_empty() && rated.len() == record.detections.len());
        for ((row, short), detection) in rated.iter().zip(&plain).zip(&record.detections) {
            assert_eq!(&row[..5], &short[..], "the confidence is the sixth column");
            let [class, cx, cy, w, h, confidence] = row[..] else { panic!("{row:?}") };
            assert_eq!(class, f64::from(detection.class_id));
            assert!((confidence - detection.confidence).abs() < 1e-5);
            let (width, height) = (f64::from(record.width), f64::from(record.height));
            let wanted = [cx - w / 2.0, cy - h / 2.0, cx + w / 2.0, cy + h / 2.0];
            let scale = [width, height, width, height];
            for ((edge, share), scale) in detection.bbox.iter().zip(wanted).zip(scale) {
                assert!((edge - share * scale).abs() < 5e-3, "{row:?} {detection:?}");
            }
            let result = results.next().expect("a COCO result a box");
            assert_eq!(result["image_id"], image);
            assert_eq!(result["category_id"], detection.class_id);
            let side = |at: usize| result["bbox"][at].as_f64().unwrap();
            let [x0, y0, x1, y1] = detection.bbox;
            for (found, wanted) in
                [(side(0), x0), (side(1), y0), (side(2), x1 - x0), (side(3), y1 - y0)]
            {
                assert!((found - wanted).abs() < 5e-3, "{result} {detection:?}");
            }
            assert!((result["score"].as_f64().unwrap() - detection.confidence).abs() < 1e-5);
        }
    }
    assert!(results.next().is_none());
}

#[test]
fn every_form_of_the_weights_gives_the_same_boxes() {
    let (Some(model), Some(bus)) = (shared("models/yolov5n.pt"), shared("data/samples/bus.jpg"))
    else {
        return;
    };
    let Some(safe) = shared("models/yolov5n_fp16.safetensors") else { return };
    let folder = tempdir().unwrap();
    let (onnx, half) = (folder.path().join("n.onnx"), folder.path().join("half.onnx"));
    let convert = |output: &Path, more: &[&str]| {
        let args = ["convert", text(&model), "-o", text(output), "--imgsz", "320"];
        let run = realnet(&[&args[..], more].concat());
        assert!(run.code == Some(0) && run.stdout.is_empty(), "{run:#?}");
        assert!(run.stderr.contains("80 classes, input 320x320"), "{run:#?}");
    };
    convert(&onnx, &[]);
    convert(&half, &["--half"]);
    let size = |path: &Path| std::fs::metadata(path).unwrap().len() as f64;
    let share = size(&half) / size(&onnx);
    assert!((0.45..0.6).contains(&share), "half of the weights make {share} of the file");

    let run = |model: &Path, more: &[&str]| {
        detect(&[&["--model", text(model), "--source", text(&bus)], more].concat()).quiet()
    };
    let from_pt = run(&model, &["--imgsz", "320"]);
    let from_onnx = run(&onnx, &[]);
    assert_eq!(without_ms(&from_pt.stdout), without_ms(&from_onnx.stdout));
    assert!(!from_pt.record().detections.is_empty());
    assert_alike(&from_pt.record(), &run(&half, &[]).record(), 1.0, 5e-3);
    assert_alike(&from_pt.record(), &run(&safe, &["--imgsz", "320"]).record(), 1.0, 5e-3);
    // A converted file is not tied to its size.
    let (a, b) = (run(&model, &["--imgsz", "640x480"]), run(&onnx, &["--imgsz", "640x480"]));
    assert_eq!(without_ms(&a.stdout), without_ms(&b.stdout));
}

#[test]
fn videos_are_annotated_and_stamped() {
    let Some(model) = shared("models/yolov5n.pt") else { return };
    let Some(video) = shared("data/samples/carnd_highway.mp4") else { return };
    if !has_ffmpeg() {
        return;
    }
    let folder = tempdir().unwrap();
    let (out, coco) = (folder.path().join("out"), folder.path().join("boxes.json"));
    let run = detect(&[
        "--model",
        text(&model),
        "--source",
        text(&video),
        "--imgsz",
        "320x192",
        "--save",
        text(&out),
        "--save-txt",
        text(&out),
        "--save-coco",
        text(&coco),
    ])
    .quiet();
    let records = run.records();
    assert_eq!(records.len(), 38);
    for (index, record) in (0..).zip(&records) {
        assert_eq!(record.frame, index);
        assert_eq!(record.stamp_ns, 40_000_000 * index as i64, "25 frames a second");
        assert_eq!((record.width, record.height), (1280, 720));
        assert_eq!(record.source, text(&video));
    }
    assert!(records.iter().any(|r| r.detections.iter().any(|d| d.class == "car")));
    assert_eq!(common::frames_in(&out.join("carnd_highway.mp4")), 38);
    let files = listing(&out);
    assert_eq!(files.len(), 1 + 38, "{files:?}");
    assert!(files.contains(&"carnd_highway_000037.txt".to_owned()), "{files:?}");
    let results: Vec<Value> = serde_json::from_slice(&std::fs::read(coco).unwrap()).unwrap();
    assert_eq!(results.len(), records.iter().map(|r| r.detections.len()).sum::<usize>());

    let first = detect(&[
        "--model",
        text(&model),
        "--source",
        text(&video),
        "--imgsz",
        "320x192",
        "--limit",
        "3",
    ])
    .quiet();
    assert_eq!(without_ms(&first.stdout), without_ms(&run.stdout)[..3]);
}

#[test]
fn near_looks_around_a_box_only() {
    let (Some(model), Some(bus)) = (shared("models/yolov5n.pt"), shared("data/samples/bus.jpg"))
    else {
        return;
    };
    let base = ["--model", text(&model), "--source", text(&bus)];
    let whole = detect(&base).quiet().record();
    let target = whole.detections.iter().find(|d| d.class == "person").unwrap();
    let [x0, y0, x1, y1] = target.bbox;
    let near = detect(&[&base[..], &["--near", &format!("{x0},{y0},{x1},{y1}")]].concat());
    let near = near.quiet().record();
    assert_eq!((near.width, near.height), (whole.width, whole.height));
    let found = closest(&near.detections, target.class_id, target.bbox).expect("a person");
    let share = iou(found.bbox, target.bbox);
    // Seen at another size: alike, not equal.
    assert!(share > 0.75, "IoU {share} of {found:?} and {target:?}");
    // The crop is a square of twice the longer side around the target, moved
    // and cut to lie inside the frame.
    let side = 2.0 * (x1 - x0).max(y1 - y0);
    let crop = |center: f64, limit: u32| {
        let (limit, length) = (f64::from(limit), side.min(f64::from(limit)));
        let start = (center - length / 2.0).clamp(0.0, limit - length);
        (start - 1.0, start + length + 1.0)
    };
    let (left, right) = crop((x0 + x1) / 2.0, near.width);
    let (top, bottom) = crop((y0 + y1) / 2.0, near.height);
    assert!(top > 0.0, "the crop is smaller than the frame");
    for detection in &near.detections {
        let [x0, y0, x1, y1] = detection.bbox;
        let inside = left <= x0 && x1 <= right && top <= y0 && y1 <= bottom;
        assert!(inside, "{detection:?} outside {left}..{right} x {top}..{bottom}");
    }
    // Away from every object there is nothing to see.
    let corner = detect(&[&base[..], &["--near", "700,980,800,1070", "--conf", "0.5"]].concat());
    assert!(corner.quiet().record().detections.is_empty());
}

#[test]
fn a_missing_ort_library_falls_back_with_one_line() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("tiny.onnx"), tiny::bytes()).unwrap();
    tiny::picture(&path("a.png"), 64, 64, 200);
    let (model, picture, library) = (path("tiny.onnx"), path("a.png"), path("libnothing.so"));
    let base = ["detect", "--json", "--model", text(&model), "--source", text(&picture)];
    let wanted = realnet(&[&base[..], &["--engine", "rten"]].concat()).quiet();
    assert_eq!(wanted.record().detections.len(), 1);
    for engine in [&["--engine", "ort"][..], &[]] {
        let args = [&base[..], engine, &["--ort-dylib", text(&library)]].concat();
        let run = realnet(&args);
        assert_eq!(run.code, Some(0), "{run:#?}");
        assert_eq!(run.stderr.lines().count(), 1, "{run:#?}");
        for part in ["realnet: ", text(&library), "using rten"] {
            assert!(run.stderr.contains(part), "{part}: {run:#?}");
        }
        assert_eq!(without_ms(&run.stdout), without_ms(&wanted.stdout));
    }
}

#[test]
fn both_engines_find_the_same() {
    let run = realnet(&["engines", "--json"]);
    let engines: Value = serde_json::from_str(&run.quiet().stdout).unwrap();
    assert!(engines["rten"]["version"].is_string(), "{engines}");
    if engines["auto"] != "ort" {
        println!("skipped: no ONNX Runtime library was found");
        return;
    }
    let used = engines["ort"]["used"].as_str().expect("the library that auto takes");
    assert!(Path::new(used).is_file(), "{engines}");
    let (Some(model), Some(samples)) = (shared("models/yolov5n.pt"), shared("data/samples")) else {
        return;
    };
    for size in ["640", "320"] {
        let args = ["--model", text(&model), "--source", text(&samples), "--imgsz", size];
        let rten = detect(&args).quiet().records();
        let args = [&["detect", "--json", "--engine", "ort", "--ort-dylib", used], &args[..]];
        let ort = realnet(&args.concat()).quiet().records();
        assert_eq!((rten.len(), ort.len()), (2, 2));
        for (rten, ort) in rten.iter().zip(&ort) {
            assert!(!rten.detections.is_empty());
            assert_alike(rten, ort, 0.05, 5e-4);
        }
    }
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("tiny.onnx"), tiny::bytes()).unwrap();
    std::fs::create_dir(path("frames")).unwrap();
    for index in 0..40 {
        tiny::picture(&path("frames").join(format!("{index}.png")), 64, 64, 200);
    }
    let mut child = common::command()
        .args(["detect", "--engine", "rten", "--json", "--model"])
        .args([path("tiny.onnx"), "--source".into(), path("frames")])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    assert!(line.starts_with("{\"frame\":0,"), "{line}");
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn results_never_replace_the_input() {
    let (Some(model), Some(bus)) = (shared("models/yolov5n.pt"), shared("data/samples/bus.jpg"))
    else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("bus.jpg");
    std::fs::copy(&bus, &picture).unwrap();
    let before = std::fs::read(&picture).unwrap();
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let run = realnet(&[
        "detect".to_owned(),
        "--imgsz=64".to_owned(),
        "--engine=rten".to_owned(),
        format!("--model={}", text(&model)),
        format!("--source={}", text(folder.path())),
        format!("--save={}/.", text(folder.path())),
    ]);
    assert_eq!(run.code, Some(2), "{}", run.stderr);
    assert!(run.stderr.contains("would be overwritten"), "{}", run.stderr);
    assert_eq!(std::fs::read(&picture).unwrap(), before);
}
