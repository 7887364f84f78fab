//! `realnet frames` as a user runs it: a box drawn once becomes labels that lie on the
//! target, nothing that is there is written again, and lost frames stay outside.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod common;
#[allow(dead_code)]
#[path = "common/room.rs"]
mod room;

use common::{Run, ffmpeg, has_ffmpeg, listing, realnet, shared};
use realnet::datasets::{TargetBoxes, YoloDataset};
use room::{FIRST, HEIGHT, Room, Square, WIDTH, blank};
use serde_json::Value;
use std::path::{Path, PathBuf};
use tempfile::{TempDir, tempdir};

const FRAMES: u64 = 12;

/// Colour pictures of a room with a square that moves, in `walk/`.
struct Walk {
    room: Room,
}

impl Walk {
    fn new() -> Self {
        let room = Room::new(Square::Moving, FRAMES);
        std::fs::create_dir(room.path("walk")).unwrap();
        for k in 0..FRAMES {
            let name = format!("walk/{:06}.png", FIRST + k);
            std::fs::copy(room.color(k), room.path(&name)).unwrap();
        }
        Self { room }
    }

    fn text(&self, name: &str) -> String {
        self.room.path(name).to_str().unwrap().to_owned()
    }

    fn picture(&self, k: u64) -> PathBuf {
        self.room.path(&format!("walk/{:06}.png", FIRST + k))
    }

    /// The box of the first frame, for the command line.
    fn first_box(&self) -> String {
        let boxes = TargetBoxes::read(&self.room.boxes()).unwrap();
        let edges = <[f32; 4]>::from(boxes.get(FIRST, WIDTH, HEIGHT).unwrap());
        edges.map(|edge| edge.to_string()).join(",")
    }

    fn run(&self, out: &str, more: &[&str]) -> Run {
        let (source, out) = (self.text("walk"), self.text(out));
        realnet(&[&["frames", "--source", &source, "--out", &out], more].concat())
    }

    fn files(&self, out: &str) -> Vec<(PathBuf, Vec<u8>)> {
        let root = self.room.path(out);
        let mut found = Vec::new();
        let mut left = vec![root.clone()];
        while let Some(path) = left.pop() {
            if path.is_dir() {
                left.extend(std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()));
            } else {
                let name = path.strip_prefix(&root).unwrap().to_owned();
                found.push((name, std::fs::read(path).unwrap()));
            }
        }
        found.sort();
        found
    }
}

fn summary(run: &Run) -> Value {
    assert_eq!(run.stdout.lines().count(), 1, "{run:#?}");
    serde_json::from_str(&run.stdout).unwrap()
}

#[track_caller]
fn assert_bad(run: &Run, wanted: &[&str]) {
    assert_eq!(run.code, Some(2), "{run:#?}");
    for words in wanted {
        assert!(run.stderr.contains(words), "{words:?} is missing: {run:#?}");
    }
}

fn data_set(folder: &Path) -> YoloDataset {
    YoloDataset::open(&folder.join("data.yaml")).unwrap()
}

#[test]
fn a_box_drawn_once_becomes_labels() {
    let walk = Walk::new();
    let more = ["--box", &walk.first_box(), "--class", "RC car", "--json"];
    let run = walk.run("set", &more).quiet();
    let found = summary(&run);
    assert_eq!(found["pictures"], FRAMES);
    assert_eq!((&found["given"], &found["carried"]), (&1.into(), &(FRAMES - 1).into()));
    let truth = TargetBoxes::read(&walk.room.boxes()).unwrap();
    let data = data_set(&walk.room.path("set"));
    assert_eq!(data.names(), ["RC car"]);
    let samples = data.split("train").unwrap();
    assert_eq!(samples.len() as u64, FRAMES);
    for (k, sample) in (0..).zip(&samples) {
        let rows = data.labels(sample).unwrap().rows;
        let wanted = truth.get(FIRST + k, WIDTH, HEIGHT).unwrap();
        let iou = rows[0].to_pixels(WIDTH, HEIGHT).iou(&wanted);
        assert!(rows.len() == 1 && iou > 0.8, "frame {k}: IoU {iou}");
        // Pictures are taken as they are.
        assert_eq!(std::fs::read(&sample.image).unwrap(), std::fs::read(walk.picture(k)).unwrap());
    }
    let page = std::fs::read_to_string(walk.room.path("set/review.html")).unwrap();
    assert_eq!(page.matches("<figure ").count() as u64, FRAMES);
    assert_eq!(page.matches("<i title=\"RC car\"").count() as u64, FRAMES);
    assert!(page.contains("src=\"images/train/walk_000003.png\""));
    // Every third.
    let more = ["--box", &walk.first_box(), "--every", "3"];
    walk.run("third", &more).quiet();
    let names = listing(&walk.room.path("third/labels/train"));
    assert_eq!(names, ["walk_000000.txt", "walk_000003.txt", "walk_000006.txt", "walk_000009.txt"]);
}

#[test]
fn a_lost_box_leaves_its_frames_outside() {
    let walk = Walk::new();
    for k in 5..FRAMES {
        blank(&walk.picture(k));
    }
    let run = walk.run("set", &["--box", &walk.first_box(), "--json"]).quiet();
    let found = summary(&run);
    assert_eq!((&found["pictures"], &found["lost"]), (&5.into(), &(FRAMES - 5).into()));
    assert_eq!(listing(&walk.room.path("set/images/train")).len(), 5);
    assert_eq!(listing(&walk.room.path("set/labels/train")).len(), 5);
    assert_eq!(listing(&walk.room.path("set/lost")).len() as u64, FRAMES - 5);
    let list = std::fs::read_to_string(walk.room.path("set/lost.csv")).unwrap();
    assert_eq!(list.lines().count() as u64, 1 + FRAMES - 5);
    assert!(list.lines().nth(1).unwrap().starts_with("walk_000005,5,\""), "{list}");
    assert!(!list.contains(",\"\""), "each has a reason: {list}");
}

#[test]
fn boxes_of_a_file_are_taken_where_they_are() {
    let walk = Walk::new();
    let all = std::fs::read_to_string(walk.room.boxes()).unwrap();
    // Only those of frames 4 and 8.
    let lines: Vec<&str> = all.lines().collect();
    let file = walk.text("two.csv");
    std::fs::write(&file, [lines[0], lines[5], lines[9]].join("\n")).unwrap();
    let found = summary(&walk.run("set", &["--boxes", &file, "--json"]).quiet());
    let count = |key: &str| found[key].as_u64().unwrap();
    assert_eq!((count("waiting"), count("given"), count("carried")), (4, 2, FRAMES - 6));
    let list = std::fs::read_to_string(walk.room.path("set/lost.csv")).unwrap();
    assert!(list.contains("walk_000000,0,\"no box yet\""), "{list}");
    assert!(!walk.room.path("set/images/train/walk_000003.png").exists());
}

#[test]
fn a_run_is_gone_on_with_and_corrections_stay() {
    let walk = Walk::new();
    let seed = walk.first_box();
    walk.run("whole", &["--box", &seed]).quiet();
    walk.run("parts", &["--box", &seed, "--limit", "5"]).quiet();
    assert_eq!(listing(&walk.room.path("parts/labels/train")).len(), 5);
    walk.run("parts", &["--box", &seed]).quiet();
    assert_eq!(walk.files("whole"), walk.files("parts"));
    // What a person corrected or took out stays so.
    let label = walk.room.path("parts/labels/train/walk_000002.txt");
    std::fs::write(&label, "0 0.5 0.5 0.25 0.25\n").unwrap();
    std::fs::remove_file(walk.room.path("parts/images/train/walk_000003.png")).unwrap();
    walk.run("parts", &["--box", &seed]).quiet();
    assert_eq!(std::fs::read_to_string(&label).unwrap(), "0 0.5 0.5 0.25 0.25\n");
    assert!(!walk.room.path("parts/images/train/walk_000003.png").exists());
    let page = std::fs::read_to_string(walk.room.path("parts/review.html")).unwrap();
    assert!(page.contains("left:37.50%;top:37.50%;width:25.00%;height:25.00%"));
    assert!(!page.contains("walk_000003.png"));
    // Another command is another run.
    let other = walk.run("parts", &["--box", &seed, "--every", "2"]);
    assert_bad(&other, &["was begun otherwise", "--name"]);
    // Further recordings come beside it.
    let more = ["--box", &seed, "--name", "second", "--split", "val"];
    walk.run("parts", &more).quiet();
    let data = data_set(&walk.room.path("parts"));
    assert_eq!(data.split("val").unwrap().len() as u64, FRAMES);
    let unknown = walk.run("parts", &["--name", "third", "--class", "truck"]);
    assert_bad(&unknown, &["no class 'truck'", "data.yaml"]);
}

#[test]
fn frames_of_a_video_are_pictures_without_labels() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempdir().unwrap();
    let text = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let video = text("drive 1.mp4");
    ffmpeg(&["-f", "lavfi", "-i", "testsrc=size=64x48:rate=10:duration=2", &video]);
    let run = realnet(&["frames", "--source", &video, "--out", &text("set"), "--every", "5"]);
    assert_eq!(run.code, Some(0), "{run:#?}");
    assert!(run.stdout.contains("20 frames seen, 4 pictures"), "{run:#?}");
    assert!(run.stdout.contains("without labels"), "{run:#?}");
    let names = listing(&folder.path().join("set/images/train"));
    assert_eq!(names[..2], ["drive_1_000000.jpg", "drive_1_000005.jpg"]);
    assert_eq!((names.len(), listing(&folder.path().join("set/labels/train")).len()), (4, 0));
}

#[test]
fn bad_input_is_named() {
    let walk = Walk::new();
    assert_bad(&walk.run("set", &["--box", "9,9,1,1"]), &["x0 < x1"]);
    assert_bad(&walk.run("set", &["--class", "a: b"]), &["'a: b' is not a name"]);
    assert_bad(&walk.run("set", &["--name", "../up"]), &["'../up' is not a name"]);
    let missing = walk.text("nothing");
    let out = walk.text("set");
    let run = realnet(&["frames", "--source", &missing, "--out", &out]);
    assert_bad(&run, &["nothing"]);
    // A broken picture costs only itself.
    std::fs::write(walk.picture(3), "no picture").unwrap();
    let run = walk.run("set", &["--json"]);
    assert_bad(&run, &["000103.png"]);
    assert_eq!(summary(&run)["pictures"], FRAMES - 1);
    std::fs::write(walk.room.path("set/runs/walk.json"), "{").unwrap();
    assert_bad(&walk.run("set", &[]), &["walk.json"]);
}

/// The run cannot end before the signal: its complaints fill the pipe to this test,
/// which reads one of thousands before it sends the signal.
#[cfg(unix)]
#[test]
fn an_interrupted_set_is_whole_and_gone_on_with() {
    use std::io::{BufRead, BufReader, Read};
    use std::process::{Command, Stdio};
    let folder: TempDir = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir(path("many")).unwrap();
    for k in 0..2000 {
        let name = path(&format!("many/{k:06}.png"));
        if k % 10 == 0 { blank(&name) } else { std::fs::write(name, "no picture").unwrap() }
    }
    let args = ["frames", "--source", "many", "--out", "set"];
    let mut child = common::command()
        .current_dir(folder.path())
        .args(args)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut reader = BufReader::with_capacity(64, child.stderr.take().unwrap());
    let mut stderr = String::new();
    reader.read_line(&mut stderr).unwrap();
    let pid = child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
    reader.read_to_string(&mut stderr).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{stderr}");
    assert!(stderr.ends_with("the same command goes on with it\n"), "{stderr}");
    let images = listing(&path("set/images/train"));
    assert!(images.len() < 200, "{}", images.len());
    let record: Value =
        serde_json::from_slice(&std::fs::read(path("set/runs/many.json")).unwrap()).unwrap();
    assert_eq!(record["frames"].as_array().unwrap().len(), images.len());
    for name in &images {
        realnet::picture::read(&path("set/images/train").join(name)).unwrap();
    }
    let run = common::finish(common::command().current_dir(folder.path()).args(args));
    assert_eq!(run.code, Some(2), "the broken pictures");
    assert_eq!(listing(&path("set/images/train")).len(), 200);
}

#[test]
fn a_blurred_car_is_carried_through_a_hundred_frames() {
    let Some(images) = shared("data/blurcar/images") else { return };
    let Some(boxes) = shared("data/blurcar/boxes.csv") else { return };
    let folder = tempdir().unwrap();
    let out = folder.path().join("set");
    let run = realnet(&[
        "frames",
        "--source",
        images.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
        "--box",
        "231,175,333,264",
        "--class",
        "car",
    ])
    .quiet();
    assert!(run.stdout.contains("100 frames seen"), "{run:#?}");
    let truth = TargetBoxes::read(&boxes).unwrap();
    let data = data_set(&out);
    let (mut sum, mut worst) = (0.0, 1.0_f32);
    let samples = data.split("train").unwrap();
    assert!(samples.len() >= 95, "{}", samples.len());
    for sample in &samples {
        let stem = sample.image.file_stem().unwrap().to_str().unwrap();
        let number = stem.strip_prefix("blurcar_").expect("the set's name, not `images`");
        let wanted = truth.get(number.parse().unwrap(), 640, 480).unwrap();
        let iou = data.labels(sample).unwrap().rows[0].to_pixels(640, 480).iou(&wanted);
        sum += iou;
        worst = worst.min(iou);
    }
    let mean = sum / samples.len() as f32;
    assert!(mean > 0.8 && worst > 0.6, "mean IoU {mean}, worst {worst}");
}
