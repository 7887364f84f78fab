//! `realnet track` as a user runs it: corners and flow of a made-up scene whose
//! motion is known, boxes carried, given, found and lost, and what is saved.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod common;

use common::{Run, command, finish, frames_in, has_ffmpeg, iou, listing, realnet, shared, tiny};
use realnet::{Frame, Stamp, picture};
use serde_json::Value;
use std::path::{Path, PathBuf};
use tempfile::{TempDir, tempdir};

const WIDTH: u32 = 192;
const HEIGHT: u32 = 144;
/// The target in frame 0, and its step from frame to frame.
const TARGET: [f64; 4] = [60.0, 40.0, 124.0, 88.0];
const STEP: [f64; 2] = [2.0, 1.0];

/// A texture: random values on a lattice of 6 pixels, smooth in between.
fn texture(seed: i64, x: i64, y: i64) -> u8 {
    let value = |x: i64, y: i64| {
        let mut h = (x.wrapping_mul(374_761_393) ^ y.wrapping_mul(668_265_263)) + seed * 97;
        h = (h ^ (h >> 13)).wrapping_mul(1_274_126_177);
        ((h ^ (h >> 16)) & 0xff) as f64
    };
    let (u, v) = (x.div_euclid(6), y.div_euclid(6));
    let (s, t) = (x.rem_euclid(6) as f64 / 6.0, y.rem_euclid(6) as f64 / 6.0);
    let row = |v| value(u, v) * (1.0 - s) + value(u + 1, v) * s;
    (40.0 + 0.7 * (row(v) * (1.0 - t) + row(v + 1) * t)) as u8
}

/// The box of the target in frame `k`.
fn target(k: i64) -> [f64; 4] {
    let at = |i: usize| TARGET[i] + STEP[i % 2] * k as f64;
    [at(0), at(1), at(2), at(3)]
}

/// Frame `k`: a background that moves left by 3 pixels a frame behind a target.
fn scene(k: i64) -> Frame {
    let [x0, y0, x1, y1] = target(k).map(|edge| edge as i64);
    let pixel = |x: i64, y: i64| match (x0..x1).contains(&x) && (y0..y1).contains(&y) {
        true => texture(1, x - x0, y - y0),
        false => texture(2, x + 3 * k, y),
    };
    let places = (0..i64::from(HEIGHT)).flat_map(|y| (0..i64::from(WIDTH)).map(move |x| (x, y)));
    let grey = Frame::grey8(Stamp::ZERO, WIDTH, HEIGHT, places.map(|(x, y)| pixel(x, y)).collect());
    grey.unwrap().to_rgb()
}

/// A folder with `frames/000100.png` and the next ones.
fn frames(count: i64) -> TempDir {
    let folder = tempdir().unwrap();
    std::fs::create_dir(folder.path().join("frames")).unwrap();
    for k in 0..count {
        picture::write(&frame_path(&folder, k), &scene(k)).unwrap();
    }
    folder
}

fn frame_path(folder: &TempDir, k: i64) -> PathBuf {
    folder.path().join(format!("frames/{:06}.png", 100 + k))
}

fn text(path: &Path) -> &str {
    path.to_str().expect("temporary and shared paths are UTF-8")
}

/// Runs `realnet track --json` on the frames of a folder.
fn track(folder: &TempDir, more: &[&str]) -> Run {
    let source = folder.path().join("frames");
    realnet(&[&["track", "--json", "--source", text(&source)], more].concat())
}

fn lines(run: &Run) -> Vec<Value> {
    run.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn edges(value: &Value) -> [f64; 4] {
    let edges: Vec<f64> = value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    edges.try_into().unwrap()
}

fn statuses(records: &[Value]) -> Vec<&str> {
    records.iter().map(|r| r["box_status"].as_str().unwrap_or("none")).collect()
}

#[test]
fn flow_of_a_known_motion() {
    let folder = frames(4);
    let run = track(&folder, &["--fps", "10"]).quiet();
    let records = lines(&run);
    assert_eq!(records.len(), 4);
    let keys: Vec<_> = records[1].as_object().unwrap().keys().map(String::as_str).collect();
    let wanted = [
        "frame",
        "source",
        "stamp_ns",
        "width",
        "height",
        "corners",
        "tracked",
        "lost",
        "median_flow_px",
        "box",
        "box_status",
        "reason",
        "carried",
        "iou",
        "ms",
    ];
    assert_eq!(keys, wanted);
    let first = &records[0];
    assert_eq!((&first["corners"], &first["tracked"]), (&0.into(), &0.into()));
    assert_eq!(first["median_flow_px"], Value::Null);
    for (k, record) in records.iter().enumerate().skip(1) {
        assert_eq!(record["frame"], k);
        assert_eq!(record["stamp_ns"], k as i64 * 100_000_000);
        assert_eq!((&record["width"], &record["height"]), (&WIDTH.into(), &HEIGHT.into()));
        let number = |value: &Value| value.as_u64().unwrap();
        let lost = &record["lost"];
        let lost = number(&lost["outside"]) + number(&lost["flat"]) + number(&lost["round_trip"]);
        let (corners, tracked) = (number(&record["corners"]), number(&record["tracked"]));
        assert_eq!(corners, tracked + lost);
        assert!(corners > 60 && tracked > corners * 7 / 10, "{record}");
        let flow = record["median_flow_px"].as_f64().unwrap();
        assert!((flow - 3.0).abs() < 0.1, "most of the picture moves by 3 pixels: {flow}");
        for key in ["box", "box_status", "reason", "carried", "iou"] {
            assert_eq!(record[key], Value::Null, "no target was asked for");
        }
        for stage in ["pyramid", "flow", "carry", "detect"] {
            assert!(record["ms"][stage].as_f64().unwrap() >= 0.0);
        }
    }
    let few = lines(&track(&folder, &["--corners", "20", "--limit", "2"]).quiet());
    assert_eq!((few.len(), &few[1]["corners"]), (2, &20.into()));
    assert_eq!(common::without_ms(&run.stdout), {
        common::without_ms(&track(&folder, &["--fps", "10"]).quiet().stdout)
    });
}

#[test]
fn a_given_box_is_carried() {
    let folder = frames(8);
    let records = lines(&track(&folder, &["--box", "60,40,124,88"]).quiet());
    assert_eq!(statuses(&records)[..2], ["given", "carried"]);
    for (k, record) in records.iter().enumerate() {
        let (found, wanted) = (edges(&record["box"]), target(k as i64));
        let far = found.iter().zip(wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(far < 1.5, "frame {k}: {found:?}, not {wanted:?}");
        // The corners outside the box are the background's.
        if k > 0 {
            assert_eq!(record["box_status"], "carried");
            assert!((record["median_flow_px"].as_f64().unwrap() - 3.0).abs() < 0.05);
            let carried = &record["carried"];
            let count = |key: &str| carried[key].as_u64().unwrap();
            assert!(count("inliers") <= count("tracked") && count("tracked") <= count("corners"));
            assert!(carried["similarity"].as_f64().unwrap() > 0.9);
        }
    }
}

#[test]
fn boxes_of_a_file_come_every_so_often() {
    let folder = frames(7);
    let path = folder.path().join("boxes.csv");
    // By the numbers in the names; frame 104 lies elsewhere on purpose.
    let row = |k: i64| {
        let [x0, y0, x1, y1] = if k == 4 { [20.0, 20.0, 90.0, 90.0] } else { target(k) };
        format!("{},{x0},{y0},{x1},{y1}\n", 100 + k)
    };
    let rows = |numbers: &[i64]| -> String {
        "frame,x0,y0,x1,y1\n"
            .chars()
            .chain(numbers.iter().flat_map(|k| row(*k).chars().collect::<Vec<_>>()))
            .collect()
    };
    std::fs::write(&path, rows(&[0, 1, 2, 3, 4, 6])).unwrap();
    let args = ["--boxes", text(&path), "--every", "4"];
    let records = lines(&track(&folder, &args).quiet());
    let wanted = ["given", "carried", "carried", "carried", "given", "carried", "carried"];
    assert_eq!(statuses(&records), wanted);
    assert_eq!(edges(&records[4]["box"]), [20.0, 20.0, 90.0, 90.0]);
    for k in [1, 2, 3] {
        let overlap = records[k]["iou"].as_f64().unwrap();
        assert!(overlap > 0.93, "{overlap}");
        let by_hand = iou(edges(&records[k]["box"]), target(k as i64));
        assert!((overlap - by_hand).abs() < 2e-3, "{overlap} {by_hand}");
    }
    assert_eq!(records[0]["iou"], Value::Null, "what was given was not followed");
    assert_eq!(records[5]["iou"], Value::Null, "frame 105 is not in the file");
    // A box that is late is taken when it comes.
    std::fs::write(&path, rows(&[2])).unwrap();
    let records = lines(&track(&folder, &args).quiet());
    assert_eq!(statuses(&records)[..4], ["waiting", "waiting", "given", "carried"]);
    std::fs::write(&path, "frame,x0,y0,x1,y1\n0,1,1,9,9\n").unwrap();
    let run = track(&folder, &args);
    assert_eq!((run.code, statuses(&lines(&run))[6]), (Some(0), "waiting"));
    assert!(run.stderr.contains("boxes.csv: no box for any frame"), "{run:#?}");
    std::fs::write(&path, rows(&[2, 3])).unwrap();
    let source = folder.path().join("frames");
    let run = realnet(&[&["track", "--source", text(&source)], &args[..]].concat()).quiet();
    let last = run.stdout.lines().last().unwrap();
    assert!(
        last.starts_with("7 frames: ") && last.contains("; box carried in 4 frames, lost in 0")
    );
    assert!(last.ends_with("IoU at least 0.5 in 1 of 1 frames followed"), "{last}");
}

#[test]
fn a_lost_box_says_why_and_is_found_again_soon() {
    let folder = frames(9);
    let blank = Frame::rgb8(Stamp::ZERO, WIDTH, HEIGHT, vec![90; (WIDTH * HEIGHT * 3) as usize]);
    picture::write(&frame_path(&folder, 3), &blank.unwrap()).unwrap();
    let records = lines(&track(&folder, &["--box", "60,40,124,88"]).quiet());
    assert_eq!(statuses(&records)[2..5], ["carried", "lost", "carried"]);
    let lost = &records[3];
    assert_eq!((&lost["box"], &lost["carried"]), (&Value::Null, &Value::Null));
    assert!(lost["reason"].as_str().unwrap().contains("corners were found again"), "{lost}");
    assert_eq!(records[4]["reason"], Value::Null);
    assert!(iou(edges(&records[4]["box"]), target(4)) > 0.9);
    // After too long a time nothing is claimed.
    let records = lines(&track(&folder, &["--box", "60,40,124,88", "--fps", "1"]).quiet());
    assert_eq!(
        statuses(&records)[2..],
        ["carried", "lost", "lost", "lost", "lost", "lost", "lost"]
    );
    assert_eq!(records[8]["reason"], records[3]["reason"]);
}

#[test]
fn a_network_finds_the_target_every_so_often() {
    let folder = frames(7);
    let model = folder.path().join("tiny.onnx");
    std::fs::write(&model, tiny::bytes()).unwrap();
    let args = ["--model", text(&model), "--engine", "rten", "--every", "3", "--classes", "lamp"];
    let records = lines(&track(&folder, &args).quiet());
    let wanted = ["detected", "carried", "carried", "detected", "carried", "carried", "detected"];
    assert_eq!(statuses(&records), wanted);
    // Its only box, 64x64 pixels of the network being 192x192 of the frame.
    for k in [0, 3, 6] {
        let found = edges(&records[k]["box"]);
        let wanted = [48.0, 48.0, 144.0, 96.0];
        assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 0.1), "{found:?}");
    }
    assert!(edges(&records[1]["box"]) != edges(&records[0]["box"]));
    // Too sure a threshold finds nothing.
    let records = lines(&track(&folder, &[&args[..], &["--conf", "0.99"]].concat()).quiet());
    assert_eq!(statuses(&records), ["waiting"; 7]);
    // A box to start with, the network later.
    let first = [&args[..], &["--box", "60,40,124,88"]].concat();
    let records = lines(&track(&folder, &first).quiet());
    assert_eq!(statuses(&records)[..4], ["given", "carried", "carried", "detected"]);
}

#[test]
fn frames_are_saved_with_what_was_found() {
    let folder = frames(4);
    let save = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let args = [&["--box", "60,40,124,88", "--save", text(&out)], more].concat();
        let run = track(&folder, &args).quiet();
        let read = |f: &String| std::fs::read(out.join(f)).unwrap();
        (listing(&out), listing(&out).iter().map(read).collect::<Vec<_>>(), lines(&run))
    };
    let (names, files, records) = save("first", &[]);
    let wanted = ["000100.png", "000101.png", "000102.png", "000103.png", "before_after.jpg"];
    assert_eq!(names, wanted);
    assert!((names, files) == (save("second", &[]).0, save("second", &[]).1), "the same bytes");

    let drawn = picture::read(&folder.path().join("first/000102.png")).unwrap();
    let plain = scene(2);
    let differs = |x: usize, y: usize| {
        let at = (y * WIDTH as usize + x) * 3;
        drawn.data()[at..at + 3] != plain.data()[at..at + 3]
    };
    let all = (0..HEIGHT as usize).flat_map(|y| (0..WIDTH as usize).map(move |x| (x, y)));
    let changed = all.filter(|&(x, y)| differs(x, y)).count() as f64;
    let share = changed / f64::from(WIDTH * HEIGHT);
    assert!((0.05..0.7).contains(&share), "marks, box and caption cover {share} of the picture");
    let [x0, y0, _, y1] = edges(&records[2]["box"]).map(|edge| edge.round() as usize);
    let yellow = (y0..y1).filter(|y| {
        let at = (y * WIDTH as usize + x0) * 3;
        drawn.data()[at..at + 3] == [240, 228, 66]
    });
    assert!(yellow.count() > (y1 - y0) * 8 / 10, "the box's left edge");

    let pair = picture::read(&folder.path().join("first/before_after.jpg")).unwrap();
    assert_eq!((pair.width(), pair.height()), (2 * WIDTH + 2, HEIGHT));
    // Its halves are frames 100 and 101, a seam between them.
    let column = |x: u32| -> Vec<u8> {
        (0..HEIGHT).map(|y| pair.data()[((y * pair.width() + x) * 3) as usize]).collect()
    };
    assert!(column(WIDTH).iter().all(|v| *v > 200), "a white seam");
    let third = folder.path().join("third");
    save("third", &["--pair", "3"]);
    let other = picture::read(&third.join("before_after.jpg")).unwrap();
    assert_ne!(other, pair);

    let out = folder.path().join("fourth");
    let run = track(&folder, &["--save", text(&out), "--pair", "4"]);
    assert_eq!(run.code, Some(2), "{run:#?}");
    assert!(run.stderr.contains("--pair 4: no frame 4"), "{run:#?}");
    assert!(!listing(&out).contains(&"before_after.jpg".to_owned()));
}

#[test]
fn a_pair_of_a_scene_at_rest_is_shown_too() {
    let folder = frames(1);
    for k in 1..4 {
        std::fs::copy(frame_path(&folder, 0), frame_path(&folder, k)).unwrap();
    }
    let out = folder.path().join("out");
    let records = lines(&track(&folder, &["--save", text(&out)]).quiet());
    assert!(records[1]["median_flow_px"].as_f64().unwrap() < 0.01);
    assert!(listing(&out).contains(&"before_after.jpg".to_owned()));
}

#[test]
fn pictures_of_other_sizes_start_anew() {
    let folder = frames(4);
    tiny::picture(&frame_path(&folder, 2), 64, 48, 120);
    let run = track(&folder, &["--box", "60,40,124,88"]);
    assert_eq!(run.code, Some(0), "{run:#?}");
    assert!(run.stderr.contains("frame 2: no flow from 192x144 to 64x48 pixels"));
    let records = lines(&run);
    assert_eq!((&records[2]["corners"], &records[3]["corners"]), (&0.into(), &0.into()));
    assert_eq!(records[2]["box_status"], "lost");
    assert!(records[2]["reason"].as_str().unwrap().contains("64x48"), "{}", records[2]);
}

#[test]
fn a_broken_picture_is_told_and_passed_over() {
    let folder = frames(4);
    std::fs::write(frame_path(&folder, 1), "no picture").unwrap();
    let run = track(&folder, &[]);
    assert_eq!(run.code, Some(2), "{run:#?}");
    assert!(run.stderr.contains("000101.png: neither JPEG nor PNG"), "{run:#?}");
    let flow: Vec<_> = lines(&run).iter().map(|r| r["median_flow_px"].as_f64()).collect();
    let [None, Some(two), Some(one)] = flow[..] else { panic!("{flow:?}") };
    assert!((two - 6.0).abs() < 0.1 && (one - 3.0).abs() < 0.1, "{flow:?}");
}

#[test]
fn videos_become_videos() {
    if !has_ffmpeg() {
        return;
    }
    let folder = frames(6);
    let video = folder.path().join("drive.mp4");
    let pattern = folder.path().join("frames/000%d.png");
    let start = ["-framerate", "10", "-start_number", "100", "-i", text(&pattern)];
    common::ffmpeg(&[&start[..], &["-c:v", "mpeg4", "-q:v", "1", text(&video)]].concat());
    let out = folder.path().join("out");
    let run = realnet(&["track", "--source", text(&video), "--save", text(&out)]).quiet();
    assert_eq!(listing(&out), ["before_after.jpg", "drive.mp4"]);
    assert_eq!(frames_in(&out.join("drive.mp4")), 6);
    let lines: Vec<_> = run.stdout.lines().collect();
    assert_eq!(lines.len(), 7, "a line a frame and one in the end: {}", run.stdout);
    assert!(lines[1].contains("drive.mp4 #1 192x144: ") && lines[1].contains("median flow 3."));
    let save = folder.path();
    let run = realnet(&["track", "--source", text(&video), "--save", text(save)]);
    assert_eq!(run.code, Some(2), "{run:#?}");
    assert!(run.stderr.contains("would be overwritten"), "{run:#?}");
}

#[test]
fn bad_input_is_refused_in_clear_words() {
    let folder = frames(2);
    let source = folder.path().join("frames");
    let one = frame_path(&folder, 0);
    let bad = folder.path().join("bad.csv");
    std::fs::write(&bad, "frame,x0,y0,x1,y1\n100,5,5,1,9\n").unwrap();
    let base = ["--source", text(&source)];
    let cases: &[(&[&str], &str)] = &[
        (&["--source", text(&one)], "one picture has no motion"),
        (&["--source", "/none/there"], "no such file"),
        (&[&base[..], &["--boxes", "/none.csv"]].concat(), "/none.csv"),
        (&[&base[..], &["--boxes", text(&bad)]].concat(), "bad.csv:2: the box"),
        (&[&base[..], &["--model", text(&bad)]].concat(), "bad.csv"),
        (&[&base[..], &["--every", "3"]].concat(), "--boxes <FILE|DIR>|--model <FILE>"),
        (&[&base[..], &["--classes", "car"]].concat(), "--model"),
        (&[&base[..], &["--pair", "2"]].concat(), "--save"),
        (&[&base[..], &["--pair", "0", "--save", "x"]].concat(), "--pair"),
        (&[&base[..], &["--box", "1,2,3"]].concat(), "x0,y0,x1,y1"),
        (&[&base[..], &["--box", "1,2,3,4", "--boxes", text(&bad)]].concat(), "cannot be used"),
        (&[&base[..], &["--boxes", text(&bad), "--model", "m"]].concat(), "cannot be used"),
        (&[&base[..], &["--window", "2"]].concat(), "--window"),
        (&[&base[..], &["--levels", "16"]].concat(), "--levels"),
        (&[&base[..], &["--corners", "0"]].concat(), "--corners"),
        (&[&base[..], &["--min-distance", "1e7"]].concat(), "min_distance"),
        (&[&base[..], &["--quality", "2"]].concat(), "--quality"),
        (&[&base[..], &["--save", text(&source)]].concat(), "would be overwritten"),
    ];
    for (args, wanted) in cases {
        let run = finish(command().arg("track").args(*args));
        assert_eq!(run.code, Some(2), "{args:?}: {run:#?}");
        assert!(run.stderr.contains(wanted), "{args:?}: {}", run.stderr);
    }
    assert_eq!(picture::read(&one).unwrap().data(), scene(0).data(), "the input is as it was");
}

#[test]
fn a_real_car_with_strong_blur_is_followed() {
    let (Some(images), Some(boxes)) =
        (shared("data/blurcar/images"), shared("data/blurcar/boxes.csv"))
    else {
        return;
    };
    let args = ["track", "--json", "--source", text(&images), "--boxes", text(&boxes)];
    let run = realnet(&[&args[..], &["--every", "15"]].concat()).quiet();
    let records = lines(&run);
    assert_eq!(records.len(), 100);
    let followed: Vec<f64> = records.iter().filter_map(|r| r["iou"].as_f64()).collect();
    assert_eq!(followed.len(), 93);
    let good = followed.iter().filter(|iou| **iou >= 0.5).count();
    assert!(good >= 84, "IoU 0.5 in {good} of 93 frames");
}
