//! Data sets on disk, good and bad.
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use common::shared;
use realnet_core::BoundingBox;
use realnet_io::datasets::{CocoDataset, DatasetError, TargetBoxes, YoloDataset, coco};
use std::fs;
use std::path::Path;

/// A folder with `images/1.jpg …` and labels for the first picture.
fn data_set(yaml: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let at = |p: &str| dir.path().join(p);
    for folder in ["a/images/sub", "a/labels", "b/images"] {
        fs::create_dir_all(at(folder)).unwrap();
    }
    for image in ["a/images/10.jpg", "a/images/9.jpg", "a/images/sub/1.png", "b/images/x.jpg"] {
        fs::write(at(image), "picture").unwrap();
    }
    fs::write(at("a/images/notes.md"), "no picture").unwrap();
    fs::write(at("a/labels/9.txt"), "0 0.5 0.5 0.1 0.1\n1 0.1 0.1 0.1 0.1\n").unwrap();
    fs::write(at("data.yaml"), yaml).unwrap();
    dir
}

fn open(dir: &Path) -> Result<YoloDataset, DatasetError> {
    YoloDataset::open(&dir.join("data.yaml"))
}

fn images(dir: &Path, split: &str) -> Result<Vec<String>, String> {
    let samples = open(dir).and_then(|d| d.split(split)).map_err(|e| e.to_string())?;
    let relative = |p: &Path| p.strip_prefix(dir).unwrap().display().to_string();
    Ok(samples.iter().map(|s| relative(&s.image).replace("/./", "/")).collect())
}

#[test]
fn the_rc_car_set_loads() {
    let Some(file) = shared("data/rc-car/data.yaml") else { return };
    let data = YoloDataset::open(&file).unwrap();
    assert_eq!(data.names(), ["rc_car"]);
    assert_eq!(data.split("train").unwrap().len(), 200);
    let samples = data.split("val").unwrap();
    assert_eq!(samples.len(), 100);
    assert!(samples[99].image.ends_with("seq4/images/000099.jpg"));
    for sample in &samples {
        assert!(sample.labels.ends_with(
            Path::new("seq4/labels").join(sample.image.with_extension("txt").file_name().unwrap())
        ));
        let labels = data.labels(sample).unwrap();
        assert_eq!((labels.rows.len(), labels.duplicates), (1, 0));
        let b = labels.rows[0].to_pixels(1280, 720);
        assert!(b.is_proper() && b.x0 >= -0.01 && b.x1 <= 1280.01);
    }
    let error = data.split("test").unwrap_err().to_string();
    assert!(error.contains("no `test` entry; there are: train, val"), "{error}");
}

#[test]
fn the_boxes_of_real_targets_load() {
    if let Some(file) = shared("data/blurcar/boxes.csv") {
        let boxes = TargetBoxes::read(&file).unwrap();
        assert!(boxes.numbers().eq(0..100));
        let wanted = BoundingBox::new(231.0, 175.0, 333.0, 264.0);
        assert_eq!(boxes.get(0, 640, 480), Some(wanted));
    }
    if let Some(folder) = shared("data/rc-car/seq2/labels") {
        let boxes = TargetBoxes::read(&folder).unwrap();
        assert!(boxes.numbers().eq(0..100));
        let inside = BoundingBox::new(-0.5, -0.5, 1280.5, 720.5);
        for number in boxes.numbers() {
            let b = boxes.get(number, 1280, 720).unwrap();
            assert!(b.is_proper() && (b.intersection(&inside) - b.area()).abs() < 1.0);
        }
    }
}

#[test]
fn folders_lists_and_texts_are_entries() {
    let dir =
        data_set("train: [a/images, b/images]\nval: val.txt\ntest: a/test.txt\nnames: [x, y]");
    let wanted = ["a/images/9.jpg", "a/images/10.jpg", "a/images/sub/1.png", "b/images/x.jpg"];
    assert_eq!(images(dir.path(), "train").unwrap(), wanted);
    // Relative to the data set, and `./` to the list itself.
    fs::write(dir.path().join("val.txt"), "b/images/x.jpg\n\n./a/images/9.jpg\r\n").unwrap();
    assert_eq!(images(dir.path(), "val").unwrap(), ["b/images/x.jpg", "a/images/9.jpg"]);
    fs::write(dir.path().join("a/test.txt"), "./images/10.jpg\nimages/9.jpg\nb/images/x.jpg")
        .unwrap();
    let wanted = ["a/images/10.jpg", "a/images/9.jpg", "b/images/x.jpg"];
    assert_eq!(images(dir.path(), "test").unwrap(), wanted);
    let absolute = dir.path().join("a/images/9.jpg").display().to_string();
    fs::write(dir.path().join("val.txt"), absolute).unwrap();
    assert_eq!(images(dir.path(), "val").unwrap(), ["a/images/9.jpg"]);
}

#[test]
fn a_missing_label_file_is_background_and_a_bad_one_an_error() {
    let dir = data_set("path: .\nval: a/images\nnames: {0: x, 1: y}");
    let data = open(dir.path()).unwrap();
    let samples = data.split("val").unwrap();
    let counts: Vec<_> = samples.iter().map(|s| data.labels(s).unwrap().rows.len()).collect();
    assert_eq!(counts, [2, 0, 0]);
    fs::write(dir.path().join("a/labels/9.txt"), "0 0.5 0.5 0.1 0.1\n2 0.1 0.1 0.1 0.1\n").unwrap();
    let error = data.labels(&samples[0]).unwrap_err().to_string();
    assert!(error.contains("a/labels/9.txt:2: class 2"), "{error}");
    fs::write(dir.path().join("a/labels/9.txt"), [0xff, 0xfe, 0]).unwrap();
    let error = data.labels(&samples[0]).unwrap_err().to_string();
    assert!(error.contains("9.txt"), "{error}");
    fs::remove_file(dir.path().join("a/labels/9.txt")).unwrap();
    fs::create_dir(dir.path().join("a/labels/9.txt")).unwrap();
    assert!(matches!(data.labels(&samples[0]), Err(DatasetError::Read { .. })));
}

#[test]
fn what_a_data_yaml_lacks_is_named() {
    for (yaml, split, wanted) in [
        ("path: ../none\nval: a\nnames: [x]", "val", "none, which does not exist"),
        ("val: none/images\nnames: [x]", "val", "none/images, which does not exist"),
        ("val: none.txt\nnames: [x]", "val", "none.txt, which does not exist"),
        ("val: a/labels\nnames: [x]", "val", "has no .jpg"),
        ("val: a/images\nnames: [x]", "train", "no `train` entry; there are: val"),
        ("val: a/images", "val", "neither `names` nor `nc`"),
        ("val: [a\nnames", "val", "data.yaml: "),
        ("", "val", "data.yaml: "),
    ] {
        let dir = data_set(yaml);
        let error = images(dir.path(), split).unwrap_err();
        assert!(error.contains(wanted) && error.contains("data.yaml"), "{yaml}: {error}");
    }
    let dir = data_set("val: val.txt\nnames: [x]");
    fs::write(dir.path().join("val.txt"), "a/images/9.jpg\na/images/11.jpg\n").unwrap();
    let error = images(dir.path(), "val").unwrap_err();
    assert!(error.contains("val.txt:2") && error.contains("a/images/11.jpg"), "{error}");
    let error = YoloDataset::open(&dir.path().join("none.yaml")).unwrap_err().to_string();
    assert!(error.contains("none.yaml: No such file"), "{error}");
}

#[test]
fn coco_files_name_themselves() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("gt.json");
    for (text, wanted) in
        [("", "EOF"), ("{\"images\":[]", "EOF"), ("[]", "line 1"), ("{}", "images")]
    {
        fs::write(&path, text).unwrap();
        let error = CocoDataset::read(&path).unwrap_err().to_string();
        assert!(error.contains("gt.json: ") && error.contains(wanted), "{text}: {error}");
    }
    fs::write(&path, r#"[{"image_id":1,"category_id":2,"bbox":[0,0,1],"score":1}]"#).unwrap();
    let error = coco::read_results(&path).unwrap_err().to_string();
    assert!(error.contains("gt.json: ") && error.contains("line 1 column"), "{error}");
    let error = CocoDataset::read(&dir.path().join("none.json")).unwrap_err().to_string();
    assert!(error.contains("none.json: No such file"), "{error}");
    let error = CocoDataset::default().write(&dir.path().join("no/gt.json")).unwrap_err();
    assert!(error.to_string().contains("no/gt.json"));
}
