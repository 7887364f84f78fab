//! Sources that are missing, damaged or something else.

use crate::{
    cases::{Bench, Case, run, unfit},
    common::{ffmpeg, has_ffmpeg, listing, realnet, tiny},
};

/// A JPEG of `width` x `height` pixels that is worth truncating.
fn jpeg(bench: &Bench, name: &str) -> Vec<u8> {
    let path = bench.path(name);
    let (width, height) = (160u32, 120u32);
    let pixels = (0..width * height).flat_map(|at| [at * 7 % 251, at * 13 % 241, at * 29 % 239]);
    let data = pixels.map(|value| value as u8).collect();
    let frame = realnet::Frame::rgb8(realnet::Stamp::ZERO, width, height, data).unwrap();
    realnet::picture::write(&path, &frame).unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn pictures_that_are_none_are_named() {
    let bench = Bench::new();
    let model = bench.text("good.onnx");
    let jpg = jpeg(&bench, "whole.jpg");
    let png = std::fs::read(bench.path("good.png")).unwrap();
    // The header of a PNG of 60000 x 60000 pixels with a right checksum.
    let mut bomb = png.clone();
    bomb[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
    let checksum = crc32(&bomb[12..29]).to_be_bytes();
    bomb[29..33].copy_from_slice(&checksum);
    let table: [(&str, &str, Vec<u8>, &str); 9] = [
        ("no bytes", "zero.jpg", vec![], "the file is empty"),
        ("half a JPEG", "half.jpg", jpg[..jpg.len() / 2].to_vec(), "truncated"),
        ("the start of a JPEG", "start.jpg", jpg[..3].to_vec(), "JPEG"),
        ("half a PNG", "half.png", png[..png.len() / 2].to_vec(), "truncated"),
        ("text", "text.jpg", b"I am no picture\n".to_vec(), "text that starts with"),
        ("a GIF", "moving.png", b"GIF89a\x01\x00\x01\x00".to_vec(), "GIF"),
        ("a pointer of Git LFS", "lfs.jpg", b"version https://git-lfs.github.com".to_vec(), "LFS"),
        ("zeros", "zeros.png", vec![0; 5000], "neither JPEG nor PNG"),
        ("a PNG that unpacks to 10 GB", "bomb.png", bomb, "60000x60000 pixels exceed"),
    ];
    let mut cases = Vec::new();
    for (what, name, bytes, says) in table {
        let file = bench.write(name, bytes);
        cases.push(Case::new(what, bench.detect(&model, &file, &[]), 2, &[&file, says]));
    }
    run(cases);
}

/// The checksum of PNG chunks, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg());
    !bytes.iter().fold(!0, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), step))
}

#[test]
fn sources_that_are_not_there_are_named() {
    let bench = Bench::new();
    let model = bench.text("good.onnx");
    for folder in ["empty", "words.jpg.d"] {
        std::fs::create_dir(bench.path(folder)).unwrap();
    }
    bench.write("words/notes.txt", "no pictures here");
    let case = |what: &str, source: &str, says: &[&str]| {
        Case::new(what, bench.detect(&model, source, &[]), 2, says)
    };
    let at = |name: &str| bench.text(name);
    run(vec![
        case("no such picture", &at("absent.jpg"), &[&at("absent.jpg"), "no such file"]),
        case("no such video", &at("absent.mp4"), &[&at("absent.mp4"), "no such file"]),
        case("a folder under a file", &at("good.png/a.jpg"), &[&at("good.png/a.jpg")]),
        case("an empty folder", &at("empty"), &[&at("empty"), "no .jpg, .jpeg or .png"]),
        case("a folder without pictures", &at("words"), &[&at("words"), "no .jpg, .jpeg or .png"]),
        case("a glob without matches", &at("*.jpeg"), &["*.jpeg", "no .jpg, .jpeg or .png"]),
        case("a glob with a mistake", &at("[.png"), &["[.png", "Pattern syntax"]),
        case("nothing", "", &["no such file"]),
    ]);
}

#[cfg(not(feature = "v4l"))]
#[test]
fn cameras_need_their_feature() {
    let bench = Bench::new();
    let model = bench.text("good.onnx");
    let case = |source: &str| {
        let says = ["/dev/video0", "--features v4l"];
        Case::new("a camera", bench.detect(&model, source, &[]), 2, &says)
    };
    run(vec![case("/dev/video0"), case("0")]);
}

#[test]
fn videos_need_ffmpeg() {
    let bench = Bench::new();
    let model = bench.text("good.onnx");
    let video = bench.write("a.mp4", b"\0\0\0\x18ftypmp42");
    std::fs::create_dir(bench.path("nothing")).unwrap();
    let case = |source: &str| {
        let args = bench.detect(&model, source, &[]);
        Case::new("no ffmpeg", args, 2, &["ffmpeg", "apt install ffmpeg"])
            .with_path(&bench.path("nothing"))
    };
    run(vec![case(&video), case("rtsp://127.0.0.1:1/stream")]);
}

#[test]
fn videos_that_are_none_are_named() {
    if !has_ffmpeg() {
        return;
    }
    let bench = Bench::new();
    let model = bench.text("good.onnx");
    let sound = bench.text("sound.mp4");
    ffmpeg(&["-f", "lavfi", "-i", "sine=duration=0.2", &sound]);
    let zero = bench.write("zero.mp4", b"");
    let words = bench.write("words.mp4", "these are words, not pictures in motion");
    let noise: Vec<u8> = (0..50_000u32).map(|at| (at * at % 251) as u8).collect();
    let noise = bench.write("noise.mkv", noise);
    let case = |what: &str, source: &str, says: &str| {
        Case::new(what, bench.detect(&model, source, &[]), 2, &[source, says])
    };
    run(vec![
        case("a video of no bytes", &zero, "the file is empty"),
        case("text", &words, "Invalid data"),
        case("noise", &noise, "Invalid data"),
        case("sound only", &sound, "no video stream"),
        case("a stream that nobody sends", "rtsp://127.0.0.1:1/stream", "Connection refused"),
    ]);
}

#[test]
fn what_came_before_the_end_of_a_broken_video_is_kept() {
    if !has_ffmpeg() {
        return;
    }
    let bench = Bench::new();
    let whole = bench.text("whole.mkv");
    ffmpeg(&["-f", "lavfi", "-i", "testsrc=size=128x96:rate=25:duration=4", "-g", "5", &whole]);
    let bytes = std::fs::read(&whole).unwrap();
    let video = bench.write("broken.mkv", &bytes[..bytes.len() / 2]);
    let (out, coco) = (bench.text("out"), bench.text("boxes.json"));
    let more = ["--save", &out, "--save-coco", &coco];
    let run = realnet(&bench.detect(&bench.text("good.onnx"), &video, &more));
    assert_eq!(run.code, Some(2), "{run:#?}");
    assert_eq!(unfit(&run.stderr), [""; 0], "{run:#?}");
    assert!(run.stderr.contains(&video) && run.stderr.contains("damaged or truncated"), "{run:#?}");
    let records = run.records();
    assert!((10..100).contains(&records.len()), "{} frames", records.len());
    assert!(run.stderr.contains(&format!("{} frames were decoded", records.len())), "{run:#?}");
    let saved = bench.path("out/broken.mp4");
    assert_eq!(crate::common::frames_in(&saved), records.len() as u64);
    let boxes: Vec<serde_json::Value> =
        serde_json::from_slice(&std::fs::read(coco).unwrap()).unwrap();
    assert_eq!(boxes.len(), records.iter().map(|r| r.detections.len()).sum::<usize>());
}

#[test]
fn one_bad_picture_among_good_ones_costs_only_itself() {
    let bench = Bench::new();
    for (name, grey) in [("1.png", 150), ("2.png", 180), ("4.png", 210)] {
        std::fs::create_dir_all(bench.path("frames")).unwrap();
        tiny::picture(&bench.path("frames").join(name), 64, 64, grey);
    }
    bench.write("frames/3.jpg", b"\xff\xd8\xff\xe0 and then nothing");
    let (out, coco) = (bench.text("out"), bench.text("boxes.json"));
    let more = ["--save", &out, "--save-txt", &out, "--save-coco", &coco];
    let run = realnet(&bench.detect(&bench.text("good.onnx"), &bench.text("frames"), &more));
    assert_eq!(run.code, Some(2), "{run:#?}");
    assert_eq!(unfit(&run.stderr), [""; 0], "{run:#?}");
    assert!(run.stderr.contains("frames/3.jpg") && run.stderr.contains("JPEG"), "{run:#?}");
    let records = run.records();
    let frames: Vec<_> = records.iter().map(|r| (r.frame, r.detections.len())).collect();
    assert_eq!(frames, [(0, 1), (1, 1), (3, 1)], "the bad picture keeps its number");
    assert_eq!(listing(&bench.path("out")), ["1.png", "1.txt", "2.png", "2.txt", "4.png", "4.txt"]);
    for name in ["1.png", "2.png", "4.png"] {
        realnet::picture::read(&bench.path("out").join(name)).unwrap();
    }
    let boxes: Vec<serde_json::Value> =
        serde_json::from_slice(&std::fs::read(coco).unwrap()).unwrap();
    let images: Vec<_> = boxes.iter().map(|b| b["image_id"].as_u64().unwrap()).collect();
    assert_eq!(images, [1, 2, 4]);
}
