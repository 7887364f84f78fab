//! Ctrl-C.
#![cfg(unix)]

use crate::{
    cases::Bench,
    common::{ffmpeg, frames_in, has_ffmpeg},
};
use realnet::results::Record;
use std::{
    io::{BufRead, BufReader, Read},
    process::{Command, Stdio},
};

/// The run cannot end before the signal: it soon waits for this test, which reads
/// one line of many thousand before it sends the signal.
#[test]
fn an_interrupted_video_is_whole() {
    if !has_ffmpeg() {
        return;
    }
    let bench = Bench::new();
    let video = bench.text("long.mp4");
    let source = "testsrc=size=64x64:rate=100:duration=60";
    ffmpeg(&["-f", "lavfi", "-i", source, "-preset", "ultrafast", &video]);
    let (out, coco) = (bench.text("out"), bench.text("boxes.json"));
    let more = ["--conf", "0", "--save", &out, "--save-coco", &coco];
    let mut child = crate::common::command()
        .args(bench.detect(&bench.text("good.onnx"), &video, &more))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut reader = BufReader::with_capacity(256, child.stdout.take().unwrap());
    let mut stdout = String::new();
    reader.read_line(&mut stdout).unwrap();
    assert!(stdout.starts_with("{\"frame\":0,"), "{stdout}");
    let pid = child.id().to_string();
    let sent = Command::new("kill").args(["-INT", &pid]).status().unwrap();
    assert!(sent.success());
    reader.read_to_string(&mut stdout).unwrap();
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{stderr}");
    assert!(stderr.is_empty(), "{stderr}");

    assert!(stdout.ends_with('\n'), "the last line is whole");
    let records: Vec<Record> =
        stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!((1..6000).contains(&records.len()), "{} frames", records.len());
    assert_eq!(frames_in(&bench.path("out/long.mp4")), records.len() as u64);
    let boxes: Vec<serde_json::Value> =
        serde_json::from_slice(&std::fs::read(coco).unwrap()).unwrap();
    assert_eq!(boxes.len(), records.iter().map(|r| r.detections.len()).sum::<usize>());
    assert!(!boxes.is_empty());
}
