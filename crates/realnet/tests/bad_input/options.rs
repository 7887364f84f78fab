//! Command lines that cannot be meant.

use crate::{
    cases::{Bench, Case, run},
    common::{command, finish, realnet, shared, without_ms},
};

#[test]
fn options_out_of_range_are_named() {
    let bench = Bench::new();
    let (model, picture) = (bench.text("good.onnx"), bench.text("good.png"));
    let case = |more: &[&str], says: &[&str]| {
        let what = more.join(" ");
        let says = [&[more[0]], says].concat();
        Case::new(&what, bench.detect(&model, &picture, more), 2, &says)
    };
    run(vec![
        case(&["--conf", "1.5"], &["'1.5' is not a number from 0 to 1"]),
        case(&["--conf", "high"], &["'high' is not a number from 0 to 1"]),
        case(&["--conf", "nan"], &["'nan'"]),
        case(&["--iou", "2"], &["'2' is not a number from 0 to 1"]),
        case(&["--imgsz", "0"], &["'0' is not a number of pixels"]),
        case(&["--imgsz", "640x"], &["'' is not a number of pixels"]),
        case(&["--imgsz", "1000000"], &["16384"]),
        case(&["--max-det", "many"], &["'many'"]),
        case(&["--min-size", "nan"], &["'nan' is not a number of pixels"]),
        case(&["--min-size", "-3"], &["'-3' is not a number of pixels"]),
        case(&["--near", "1,2,3"], &["'1,2,3' is not x0,y0,x1,y1"]),
        case(&["--near", "9,2,3,4"], &["x0 < x1"]),
        case(&["--fps", "0"], &["'0' is not a number above 0"]),
        case(&["--size", "640*480"], &["'640*480'"]),
        case(&["--threads", "0"], &["1..=1024"]),
        case(&["--provider", "abacus"], &["'abacus'", "cpu, cuda, tensorrt, openvino"]),
        case(&["--limit", "all"], &["'all'"]),
        case(&["--save-conf"], &["--save-txt"]),
        case(&["--sauce"], &["unexpected argument"]),
    ]);
}

#[test]
fn choices_that_do_not_exist_are_named() {
    let bench = Bench::new();
    let (model, picture) = (bench.text("good.onnx"), bench.text("good.png"));
    let detect = |more: &[&str]| bench.detect(&model, &picture, more);
    run(vec![
        Case::new(
            "an unknown class",
            detect(&["--classes", "lamp,cat"]),
            2,
            &["no class 'cat'", "it has lamp"],
        ),
        Case::new("a class too many", detect(&["--classes", "1"]), 2, &["no class '1'"]),
        Case::new(
            "a size that the file does not have",
            detect(&["--imgsz", "96"]),
            2,
            &["good.onnx", "fixed input of 64x64", "96x96 was asked for"],
        ),
        Case::new(
            "an unknown engine",
            ["detect", "--model", &model, "--source", &picture, "--engine", "steam"],
            2,
            &["'steam'", "auto, rten, ort"],
        ),
        Case::new("no source", ["detect", "--model", &model], 2, &["--source"]),
        Case::new("no model", ["detect", "--source", &picture], 2, &["--model"]),
        Case::new("an unknown command", ["paint"], 2, &["'paint'"]),
        Case::new("val of what", ["val", "sound"], 2, &["'sound'"]),
    ]);
}

#[test]
fn sizes_that_the_stride_does_not_divide_are_named() {
    let Some(weights) = shared("models/yolov5n.pt") else { return };
    let bench = Bench::new();
    let weights = weights.to_str().unwrap();
    let (picture, output) = (bench.text("good.png"), bench.text("out.onnx"));
    let says = |what: &'static str| [what, "multiple of 32", "the next one is 128"];
    run(vec![
        Case::new(
            "detect at 100",
            bench.detect(weights, &picture, &["--imgsz", "100"]),
            2,
            &says("width 100"),
        ),
        Case::new(
            "detect at 320x100",
            bench.detect(weights, &picture, &["--imgsz", "320x100"]),
            2,
            &says("height 100"),
        ),
        Case::new(
            "near at 100",
            bench.detect(weights, &picture, &["--near", "0,0,9,9", "--near-imgsz", "100"]),
            2,
            &says("width 100"),
        ),
        Case::new(
            "convert at 100",
            ["convert", weights, "-o", &output, "--imgsz", "100"],
            2,
            &says("width 100"),
        ),
    ]);
    assert!(!bench.path("out.onnx").exists());
}

/// A library that is none is no reason to stop: the embedded engine stands in,
/// and one line says so.
#[test]
fn broken_ort_libraries_fall_back_with_one_line() {
    let bench = Bench::new();
    let (model, picture) = (bench.text("good.onnx"), bench.text("good.png"));
    let wanted = realnet(&bench.detect(&model, &picture, &[])).quiet();
    let base = ["detect", "--json", "--model", &model, "--source", &picture];
    let table = [
        (bench.write("text.so", "no library at all\n".repeat(100)), "invalid ELF header"),
        (bench.write("zero.so", ""), "file too short"),
        (bench.text("absent.so"), "No such file"),
    ];
    for (library, says) in table {
        let more = ["--engine", "ort", "--ort-dylib", &library];
        let run = realnet(&[&base[..], &more].concat());
        assert_eq!(run.code, Some(0), "{run:#?}");
        assert_eq!(run.stderr.lines().count(), 1, "{run:#?}");
        let says = if cfg!(target_os = "linux") { says } else { "" };
        for part in ["realnet: ", &library, says, "using rten"] {
            assert!(run.stderr.contains(part), "{part}: {run:#?}");
        }
        assert_eq!(without_ms(&run.stdout), without_ms(&wanted.stdout));

        let engines = realnet(&["engines", "--json", "--ort-dylib", &library]).quiet();
        let value: serde_json::Value = serde_json::from_str(&engines.stdout).unwrap();
        assert_eq!(value["auto"], "rten");
        let entry = &value["ort"]["libraries"][0];
        assert_eq!((&entry["path"], &entry["usable"]), (&library.into(), &false.into()));
        assert!(entry["reason"].as_str().unwrap().contains(says), "{value}");
    }
    // A bare name is a file here, not one in the folders of the system's loader.
    let args = ["engines", "--json", "--ort-dylib", "zero.so"];
    let run = finish(command().args(args).current_dir(bench.path("."))).quiet();
    let value: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    let entry = &value["ort"]["libraries"][0];
    assert!(entry["path"].as_str().unwrap().ends_with("/zero.so"), "{value}");
    let says = if cfg!(target_os = "linux") { "file too short" } else { "" };
    assert!(entry["reason"].as_str().unwrap().contains(says), "{value}");
}

#[cfg(not(feature = "train"))]
#[test]
fn training_that_was_not_built_in_says_how_to_get_it() {
    for args in [&["train"][..], &["train", "detect", "--data", "data.yaml", "--epochs", "3"]] {
        let run = realnet(args);
        assert_eq!(run.code, Some(2), "{run:#?}");
        assert!(run.stderr.contains("--features train"), "{run:#?}");
    }
}
