//! Results that cannot be written. Tests may run as root, whom permissions do
//! not stop: a file where a folder must be stands in the way of everyone.

use crate::{
    cases::{Bench, Case, run, unfit},
    common::{command, ffmpeg, finish, has_ffmpeg, listing, realnet, shared, tiny},
};

#[test]
fn results_without_a_place_are_refused_before_the_work() {
    let bench = Bench::new();
    let (model, picture) = (bench.text("good.onnx"), bench.text("good.png"));
    let file = bench.write("file", "in the way");
    let below = bench.text("file/below");
    let coco = bench.text("file/boxes.json");
    std::fs::create_dir(bench.path("folder")).unwrap();
    let folder = bench.text("folder");
    let data = bench.write("data.yaml", "val: .\nnames: [lamp]\n");
    let detect = |more: &[&str]| bench.detect(&model, &picture, more);
    run(vec![
        Case::new("--save", detect(&["--save", &file]), 1, &[&file, "not a directory"]),
        Case::new("--save below a file", detect(&["--save", &below]), 1, &[&below]),
        Case::new("--save-txt", detect(&["--save-txt", &file]), 1, &[&file, "not a directory"]),
        Case::new("--save-coco below a file", detect(&["--save-coco", &coco]), 1, &["file"]),
        Case::new("--save-coco", detect(&["--save-coco", &folder]), 1, &[&folder, "directory"]),
        Case::new("val --save", bench.val(&data, &["--save", &file]), 1, &[&file, "directory"]),
    ]);
    assert_eq!(std::fs::read(bench.path("file")).unwrap(), b"in the way");
}

#[test]
fn conversions_without_a_place_leave_nothing() {
    let Some(weights) = shared("models/yolov5n.pt") else { return };
    let bench = Bench::new();
    let copy = bench.write("copy.onnx", std::fs::read(weights).unwrap());
    let nowhere = bench.text("no/such/folder/out.onnx");
    std::fs::create_dir(bench.path("folder.onnx")).unwrap();
    let folder = bench.text("folder.onnx");
    run(vec![
        Case::new("no folder", ["convert", &copy, "-o", &nowhere], 1, &[&nowhere, "No such"]),
        Case::new("a folder", ["convert", &copy, "-o", &folder], 1, &[&folder, "directory"]),
        // By its name the weights would be their own result.
        Case::new("itself", ["convert", &copy], 2, &[&copy, "overwritten"]),
    ]);
    assert_eq!(listing(bench.path("copy.onnx").parent().unwrap()).len(), 4, "rubbish was left");
}

#[test]
fn an_output_that_fails_midway_leaves_the_earlier_ones_whole() {
    let bench = Bench::new();
    std::fs::create_dir_all(bench.path("frames")).unwrap();
    for index in 1..=3 {
        tiny::picture(&bench.path(&format!("frames/{index}.png")), 64, 64, 200);
    }
    // A folder stands where the second annotated picture belongs.
    std::fs::create_dir_all(bench.path("out/2.png")).unwrap();
    let (out, coco) = (bench.text("out"), bench.text("boxes.json"));
    let more = ["--save", &out, "--save-txt", &out, "--save-coco", &coco];
    let run = realnet(&bench.detect(&bench.text("good.onnx"), &bench.text("frames"), &more));
    assert_eq!(run.code, Some(1), "{run:#?}");
    assert_eq!(run.stderr.lines().count(), 1, "{run:#?}");
    assert!(run.stderr.contains("out/2.png") && run.stderr.contains("directory"), "{run:#?}");
    assert_eq!(run.records().len(), 2, "each line is whole");
    assert_eq!(listing(&bench.path("out")), ["1.png", "1.txt", "2.png", "2.txt"]);
    realnet::picture::read(&bench.path("out/1.png")).unwrap();
    let boxes: Vec<serde_json::Value> =
        serde_json::from_slice(&std::fs::read(coco).unwrap()).unwrap();
    assert_eq!(boxes.len(), 2, "the boxes found so far are written all the same");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_a_failure() {
    let bench = Bench::new();
    let (model, picture) = (bench.text("good.onnx"), bench.text("good.png"));
    let says = "No space left on device";
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    let run = finish(command().args(bench.detect(&model, &picture, &[])).stdout(full));
    assert_eq!(run.code, Some(1), "{run:#?}");
    assert!(run.stderr.contains(says), "{run:#?}");

    let run = realnet(&bench.detect(&model, &picture, &["--save-coco", "/dev/full"]));
    assert_eq!(run.code, Some(1), "{run:#?}");
    assert!(run.stderr.contains("/dev/full") && run.stderr.contains(says), "{run:#?}");
    assert_eq!(run.records().len(), 1);
}

#[test]
fn results_never_replace_an_input_that_is_still_to_be_read() {
    let bench = Bench::new();
    for folder in ["a", "b"] {
        std::fs::create_dir(bench.path(folder)).unwrap();
        tiny::picture(&bench.path(folder).join("1.png"), 64, 64, 200);
    }
    // A picture whose name ends as a text's does.
    let odd = bench.write("odd.txt", std::fs::read(bench.path("good.png")).unwrap());
    let inputs =
        || ["a/1.png", "b/1.png", "odd.txt"].map(|n| std::fs::read(bench.path(n)).unwrap());
    let before = inputs();
    // Of `a/1.png` would be made `b/1.png`, which comes next.
    let (all, second) = (bench.text("[ab]/1.png"), bench.text("b"));
    let model = bench.text("good.onnx");
    let detect = |more: &[&str]| realnet(&bench.detect(&model, &all, more));
    let save = detect(&["--save", &second]);
    let coco = detect(&["--save-coco", &bench.text("b/1.png")]);
    let track = realnet(&["track", "--json", "--source", &all, "--save", &second]);
    let here = bench.text("");
    let text = realnet(&bench.detect(&model, &odd, &["--save-txt", &here]));
    for (run, input) in
        [(save, "b/1.png"), (coco, "b/1.png"), (track, "b/1.png"), (text, "odd.txt")]
    {
        assert_eq!(run.code, Some(2), "{run:#?}");
        assert_eq!(unfit(&run.stderr), [""; 0], "{run:#?}");
        let says = format!("{input} would be overwritten");
        assert!(run.stderr.contains(&says), "{run:#?}");
    }
    assert!(inputs() == before, "an input was changed");
    // A folder of its own, twice: only inputs are protected.
    let out = bench.text("out");
    for _ in 0..2 {
        let run = detect(&["--save", &out]).quiet();
        assert_eq!(run.records().len(), 2);
        assert_eq!(listing(&bench.path("out")), ["1-2.png", "1.png"]);
    }
}

#[test]
fn a_video_named_by_an_address_is_kept() {
    if !has_ffmpeg() {
        return;
    }
    let bench = Bench::new();
    let video = bench.text("drive.mp4");
    ffmpeg(&["-f", "lavfi", "-i", "testsrc=size=64x64:rate=5:duration=1", &video]);
    let before = std::fs::read(&video).unwrap();
    let run =
        realnet(&["track", "--source", &format!("file://{video}"), "--save", &bench.text("")]);
    assert_eq!(run.code, Some(2), "{run:#?}");
    assert!(run.stderr.contains("drive.mp4 would be overwritten"), "{run:#?}");
    assert!(std::fs::read(&video).unwrap() == before);
}
