//! `realnet train` as a user runs it, on data sets that are drawn here.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]
// Signals and limits are those of Unix.
#![cfg_attr(not(unix), allow(dead_code, unused_imports))]

mod common;

use common::{Run, command, finish, listing, realnet};
use image::{ImageBuffer, Luma};
use realnet::{
    Detector, Frame, Stamp,
    depth::{DepthCoding, DepthModel},
    picture,
    weights::Checkpoint,
};
use std::{
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};
use tempfile::{TempDir, tempdir};

const SIDE: u32 = 64;
/// What a finished run leaves.
const FILES: [&str; 8] = [
    "args.toml",
    "batch.png",
    "best.onnx",
    "best.safetensors",
    "curves.png",
    "last.ckpt",
    "last.safetensors",
    "results.csv",
];

/// Numbers that are the same in each run.
struct Dice(u64);

impl Dice {
    fn below(&mut self, end: u32) -> u32 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % u64::from(end)) as u32
    }
}

/// A data set of bright squares on noise, one a picture.
struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new(train: u32) -> Self {
        let bench = Self { folder: tempdir().unwrap() };
        let mut dice = Dice(7);
        for (split, count) in [("train", train), ("val", 8)] {
            for index in 0..count {
                bench.square(split, index, &mut dice);
            }
        }
        bench.yaml("names: [square]");
        bench
    }

    fn yaml(&self, names: &str) {
        let text = format!("train: images/train\nval: images/val\n{names}\n");
        std::fs::write(self.path("data.yaml"), text).unwrap();
    }

    fn square(&self, split: &str, index: u32, dice: &mut Dice) {
        let mut pixels: Vec<u8> = (0..3 * SIDE * SIDE).map(|_| dice.below(60) as u8).collect();
        let side = 20 + dice.below(12);
        let [left, top] = [0; 2].map(|_| dice.below(SIDE - side));
        for row in top..top + side {
            for column in left..left + side {
                let at = 3 * (row * SIDE + column) as usize;
                pixels[at..at + 3].copy_from_slice(&[230, 200, 40]);
            }
        }
        let share = |pixels: f32| pixels / SIDE as f32;
        let [x, y] = [left, top].map(|edge| share(edge as f32 + side as f32 / 2.0));
        let label = format!("0 {x} {y} {0} {0}\n", share(side as f32));
        let image = self.path(&format!("images/{split}/{index:03}.png"));
        let text = self.path(&format!("labels/{split}/{index:03}.txt"));
        for path in [&image, &text] {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        }
        let frame = Frame::rgb8(Stamp::ZERO, SIDE, SIDE, pixels).unwrap();
        picture::write(&image, &frame).unwrap();
        std::fs::write(text, label).unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// `train detect` with small numbers.
    fn detect(&self, out: &str, more: &[&str]) -> Vec<String> {
        let (data, out) = (self.text("data.yaml"), self.text(out));
        let all = ["train", "detect", "--data", &data, "--out", &out, "--imgsz", "64"];
        let small = ["--batch", "8", "--epochs", "2", "--workers", "1"];
        let has = |flag: &str| more.contains(&flag);
        let pairs = all[2..].chunks(2).chain(small.chunks(2)).filter(|pair| !has(pair[0]));
        let mut words: Vec<String> = all[..2].iter().map(ToString::to_string).collect();
        words.extend(pairs.flatten().chain(more).map(ToString::to_string));
        words
    }
}

fn read(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The objects of `--json`, one an epoch.
fn epochs(stdout: &str) -> Vec<serde_json::Value> {
    stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Asserts how a run ended, and that it says these words.
#[track_caller]
fn says(run: &Run, code: i32, words: &[&str]) {
    assert_eq!(run.code, Some(code), "{run:#?}");
    for word in words {
        assert!(run.stderr.contains(word) || run.stdout.contains(word), "{word}: {run:#?}");
    }
}

/// Starts a run, waits for a line with `word` on its standard output, does something to it,
/// and waits for the end.
fn after(args: &[String], word: &str, act: impl FnOnce(u32)) -> Run {
    let mut child =
        command().args(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut reader = BufReader::new(child.stdout.take().unwrap());
    let mut stdout = String::new();
    while !stdout.lines().any(|line| line.contains(word)) {
        assert!(reader.read_line(&mut stdout).unwrap() > 0, "{stdout}");
    }
    act(child.id());
    reader.read_to_string(&mut stdout).unwrap();
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    Run { code: output.status.code(), stdout, stderr }
}

/// A run that gets the signal of Ctrl-C after that line.
#[cfg(unix)]
fn interrupted(args: &[String], word: &str) -> Run {
    after(args, word, |pid| {
        let sent = Command::new("kill").args(["-INT", &pid.to_string()]).status().unwrap();
        assert!(sent.success());
    })
}

#[test]
fn a_detector_learns_and_leaves_its_files() {
    let bench = Bench::new(24);
    let more = ["--epochs", "4", "--optimizer", "adamw", "--lr", "0.004", "--json"];
    let more = [&more[..], &["--warmup-epochs", "0", "--augment", "mosaic=0"]].concat();
    let args = bench.detect("runs/one", &more);
    let run = realnet(&args);
    says(&run, 0, &["train: 24 of 24 pictures are usable; objects: 24 square"]);
    let found = epochs(&run.stdout);
    assert_eq!(found.len(), 4);
    let loss = |epoch: &serde_json::Value| epoch["loss"].as_f64().unwrap();
    assert!(loss(&found[3]) < 0.9 * loss(&found[0]), "{}", run.stdout);
    let out = bench.path("runs/one");
    assert_eq!(listing(&out), FILES);

    let csv = String::from_utf8(read(&out.join("results.csv"))).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    let head = ["epoch", "loss", "box", "obj", "cls", "lr", "mAP50", "mAP50-95", "fitness", "best"];
    assert_eq!(rows[0], head);
    assert_eq!(rows.len(), 5);
    for (row, epoch) in rows[1..].iter().zip(&found) {
        assert_eq!(row[1].parse::<f64>().unwrap(), loss(epoch));
        assert_eq!(row[0].parse::<u64>().unwrap(), epoch["epoch"].as_u64().unwrap());
    }
    // The network knows its classes and its size.
    let mut detector = Detector::open(&out.join("best.onnx")).unwrap();
    assert_eq!(detector.names(), ["square"]);
    let frame = picture::read(&bench.path("images/val/000.png")).unwrap();
    detector.detect(&frame).unwrap();
    for (picture_name, least) in [("batch.png", SIDE), ("curves.png", 800)] {
        let frame = picture::read(&out.join(picture_name)).unwrap();
        assert!(frame.width() >= least, "{picture_name}");
    }

    // A folder with a run is not written over by accident.
    says(&realnet(&args), 2, &["holds a run", "--resume", "--overwrite"]);
    // Its options make the same again; what the command line says wins over them.
    let config = bench.text("runs/one/args.toml");
    let two = bench.text("runs/two");
    let again = ["train", "detect", "--out", &two, "--config", &config, "--json"];
    says(&realnet(&again), 0, &[]);
    for name in ["last.safetensors", "best.safetensors", "best.onnx", "results.csv"] {
        assert_eq!(read(&out.join(name)), read(&bench.path("runs/two").join(name)), "{name}");
    }
    let other = ["--seed", "5", "--epochs", "1", "--optimizer", "sgd", "--overwrite"];
    let run = realnet(&[&again[..], &other].concat());
    says(&run, 0, &[]);
    assert_eq!(epochs(&run.stdout).len(), 1);
    assert_ne!(loss(&epochs(&run.stdout)[0]), loss(&found[0]));
    assert_eq!(listing(&bench.path("runs/two")), FILES);
    let options = String::from_utf8(read(&bench.path("runs/two/args.toml"))).unwrap();
    // The rate of the file was for another optimiser.
    for line in ["epochs = 1", "seed = 5", "optimizer = \"sgd\"", "lr = 0.01", "mosaic = 0"] {
        assert!(options.lines().any(|own| own.starts_with(line)), "{line}: {options}");
    }

    // Training on from weights, with other classes.
    bench.yaml("names: [square, ring]");
    let weights = bench.text("runs/one/best.safetensors");
    let on = bench.detect("runs/three", &["--epochs", "1", "--model", &weights]);
    let words = ["yolov5n: ", "another shape in the file", "the file has 1, the data 2"];
    says(&realnet(&on), 0, &words);
    // The run of the other classes does not go on with these.
    let run = realnet(&["train", "detect", "--resume", &bench.text("runs/one"), "--epochs", "9"]);
    says(&run, 2, &["the run is for the classes square; the data now have square, ring"]);
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_what_goes_on_to_the_same_result() {
    let bench = Bench::new(24);
    // Patience and step as well: all of it must go on.
    let more = ["--epochs", "4", "--accumulate", "2", "--schedule", "linear", "--json"];
    says(&realnet(&bench.detect("whole", &more)), 0, &[]);
    let run = interrupted(&bench.detect("parts", &more), "\"epoch\":1,");
    let parts = bench.text("parts");
    says(&run, 130, &["interrupted; ", "last.ckpt holds everything up to "]);
    says(&run, 130, &[&format!("realnet train detect --resume {parts}")]);
    let done = epochs(&run.stdout).len();
    assert!((1..4).contains(&done), "{}", run.stdout);
    // What was lost between checkpoint and files comes back, though it be the best.
    for name in ["results.csv", "last.safetensors"] {
        std::fs::remove_file(bench.path("parts").join(name)).unwrap();
    }
    let checkpoint = bench.text("parts/last.ckpt");
    let run = realnet(&["train", "detect", "--resume", &checkpoint, "--json"]);
    says(&run, 0, &["going on "]);
    assert_eq!(epochs(&run.stdout).len(), 4 - done);
    for name in ["last.safetensors", "best.safetensors", "best.onnx", "results.csv"] {
        let (whole, parts) = (bench.path("whole").join(name), bench.path("parts").join(name));
        assert_eq!(read(&whole), read(&parts), "{name}");
    }
    // Nothing is left to do; and what decides the result cannot change.
    let run = realnet(&["train", "detect", "--resume", &parts]);
    says(&run, 0, &["all 4 epochs are done"]);
    let run = realnet(&["train", "detect", "--resume", &parts, "--lr", "0.5"]);
    says(&run, 2, &["--lr cannot be changed"]);
}

#[test]
fn several_devices_and_those_that_are_not_there() {
    let bench = Bench::new(8);
    let more = ["--device", "cpu,cpu", "--epochs", "1", "--batch", "2", "--classes", "square"];
    let words = ["device: cpu,cpu, a step is 2 batches of 2", "done after 1 epochs"];
    says(&realnet(&bench.detect("two", &more)), 0, &words);
    let options = std::fs::read_to_string(bench.path("two/args.toml")).unwrap();
    for line in ["device = [\"cpu\", \"cpu\"]", "accumulate = 2", "classes = [\"square\"]"] {
        assert!(options.contains(line), "{line}: {options}");
    }
    // The steps stay what they were on one device.
    let run =
        ["train", "detect", "--resume", &bench.text("two"), "--device", "cpu", "--epochs", "2"];
    says(&realnet(&run), 0, &["device: cpu, a step is 2 batches of 2", "done after 2 epochs"]);

    let refused = |more: &[&str], words: &[&str]| {
        says(&realnet(&bench.detect("none", more)), 2, words);
        assert!(!bench.path("none").join("args.toml").exists());
    };
    refused(&["--device", "gpu"], &["\"gpu\" is not cpu, cuda"]);
    refused(&["--device", "cuda:77"], &["--device cuda:77"]);
    refused(&["--device", "cpu,cpu", "--accumulate", "3"], &["accumulate is 3"]);
    refused(&["--classes", "circle"], &["class \"circle\" is not one of square"]);
}

#[cfg(unix)]
#[test]
fn an_interrupted_first_epoch_goes_on_where_it_was() {
    let bench = Bench::new(24);
    let more = ["--batch", "1", "--epochs", "1", "--accumulate", "2"];
    says(&realnet(&bench.detect("whole", &more)), 0, &[]);
    let run = interrupted(&bench.detect("run", &more), "device: cpu");
    says(&run, 130, &["last.ckpt holds everything up to step ", " of epoch 1; go on: "]);
    assert_eq!(listing(&bench.path("run")), ["args.toml", "batch.png", "last.ckpt"]);
    // The same command does not write over it.
    says(&realnet(&bench.detect("run", &more)), 2, &["holds a run", "--resume"]);
    let run = realnet(&["train", "detect", "--resume", &bench.text("run")]);
    says(&run, 0, &["going on in epoch 1 of 1, after step ", "done after 1 epochs"]);
    for name in ["last.safetensors", "best.onnx", "results.csv"] {
        let (whole, parts) = (bench.path("whole").join(name), bench.path("run").join(name));
        assert_eq!(read(&whole), read(&parts), "{name}");
    }
    // Without a checkpoint there is nothing to go on with.
    std::fs::remove_file(bench.path("run/last.ckpt")).unwrap();
    let run = realnet(&["train", "detect", "--resume", &bench.text("run")]);
    says(&run, 2, &["there is nothing to go on with", "Start again", "args.toml"]);
}

/// A file that cannot grow is what a full disk is.
#[cfg(unix)]
#[test]
fn a_full_disk_costs_one_epoch() {
    let bench = Bench::new(8);
    says(&realnet(&bench.detect("run", &["--epochs", "1"])), 0, &[]);
    let (out, program) = (bench.text("run"), env!("CARGO_BIN_EXE_realnet"));
    let before = read(&bench.path("run/last.ckpt"));
    let script = "trap '' XFSZ; ulimit -f 16000; exec \"$@\"";
    let mut limited = Command::new("sh");
    limited.args(["-c", script, "sh", program, "train", "detect", "--resume", &out]);
    limited.args(["--epochs", "2"]).env_remove("ORT_DYLIB_PATH");
    let run = finish(&mut limited);
    says(&run, 1, &["cannot write", "last.ckpt", "epoch 2 is lost", "up to the end of epoch 1"]);
    assert_eq!(before, read(&bench.path("run/last.ckpt")));
    assert_eq!(listing(&bench.path("run")), FILES, "rubbish was left");
    says(&realnet(&["train", "detect", "--resume", &out]), 0, &["2/2"]);
}

#[test]
fn a_broken_checkpoint_is_named() {
    let bench = Bench::new(8);
    says(&realnet(&bench.detect("run", &["--epochs", "1"])), 0, &[]);
    let (out, path) = (bench.text("run"), bench.path("run/last.ckpt"));
    let whole = read(&path);
    let resume = ["train", "detect", "--resume", &out, "--epochs", "2"];
    for (bytes, words) in [
        (&whole[..whole.len() / 2], "is cut off"),
        (&b"PK\x03\x04 something else"[..], "is no checkpoint of a training"),
        (&[][..], "is no checkpoint of a training"),
    ] {
        std::fs::write(&path, bytes).unwrap();
        says(&realnet(&resume), 2, &["last.ckpt", words]);
    }
    std::fs::write(&path, &whole).unwrap();
    std::fs::write(bench.path("run/args.toml"), "task = \"detect\"\nepoch = 3\n").unwrap();
    says(&realnet(&resume), 2, &["args.toml", "there is no option 'epoch'; there are data, model"]);
    std::fs::write(bench.path("run/args.toml"), "task = \"depth\"\n").unwrap();
    says(&realnet(&resume), 2, &["args.toml", "depth"]);
    let weights = bench.text("run/last.safetensors");
    says(&realnet(&["train", "detect", "--resume", &weights]), 2, &["give them as --model"]);
    says(&realnet(&["train", "detect", "--resume"]), 2, &["of which folder"]);
    let nothing = bench.text("nothing");
    says(&realnet(&["train", "detect", "--resume", &nothing]), 2, &["holds no run"]);
}

#[test]
fn bad_data_are_told_before_the_first_step() {
    let bench = Bench::new(16);
    let run = |more: &[&str]| realnet(&bench.detect("run", more));
    // What can be left out is counted and named.
    std::fs::write(bench.path("images/train/000.png"), "no picture").unwrap();
    for index in 1..13 {
        let label = "0 nan 0.5 0.1 0.1\n0 0.5 0.5 0.3 0.3\n";
        std::fs::write(bench.path(&format!("labels/train/{index:03}.txt")), label).unwrap();
    }
    std::fs::write(bench.path("labels/train/013.txt"), "").unwrap();
    let learned = run(&["--epochs", "1"]);
    says(&learned, 0, &["train: 15 of 16 pictures are usable, 1 of them without objects"]);
    says(&learned, 0, &["warning: train: 1 pictures are broken", "000.png"]);
    says(&learned, 0, &["warning: train: 12 label rows have NaN", "010.txt:1", "and 2 more"]);
    assert!(!learned.stderr.contains("012.txt"), "{}", learned.stderr);

    let refused = |more: &[&str], words: &[&str]| {
        std::fs::remove_dir_all(bench.path("run")).unwrap_or_default();
        says(&run(more), 2, words);
        assert!(!bench.path("run/args.toml").exists());
    };
    std::fs::write(bench.path("labels/val/003.txt"), "4 0.5 0.5 0.2 0.2\n").unwrap();
    refused(&[], &["val of ", "003.txt:1", "4"]);
    std::fs::remove_file(bench.path("labels/val/003.txt")).unwrap();
    refused(&["--data", &bench.text("none.yaml")], &["none.yaml"]);
    refused(&["--imgsz", "100"], &["imgsz is 100, it must be a multiple of 32"]);
    refused(&["--epochs", "0"], &["epochs is 0"]);
    refused(&["--lr", "nan"], &["lr is NaN"]);
    refused(&["--augment", "mosaik=1"], &["there is no 'mosaik'; there are", "mosaic"]);
    refused(&["--augment", "mosaic=2"], &["mosaic", "from 0 to 1"]);
    refused(&["--model", "yolov5z"], &["yolov5z: no such file, and not one of yolov5n"]);
    refused(&["--model", &bench.text("data.yaml")], &["data.yaml", "not a file of weights"]);
    let options = bench.text("options.toml");
    for (text, words) in [
        ("lr = \"much\"", "lr = \"much\""),
        ("epoch = 3", "there is no option 'epoch'"),
        ("task = \"depth\"", "is for `realnet train` \"depth\", not detect"),
        ("[augment]\nmosaik = 1", "there is no 'mosaik'"),
        ("lr = ", "options.toml"),
    ] {
        std::fs::write(&options, text).unwrap();
        refused(&["--config", &options], &[words]);
    }
    for index in 0..8 {
        std::fs::write(bench.path(&format!("images/val/{index:03}.png")), "").unwrap();
    }
    refused(&[], &["val of ", "nothing to learn from is left"]);
    // A file in the way of the folder is no fault of the data.
    std::fs::write(bench.path("file"), "in the way").unwrap();
    says(&realnet(&bench.detect("file/below", &[])), 1, &["file/below"]);
}

#[test]
fn a_picture_that_breaks_later_costs_itself() {
    let bench = Bench::new(16);
    let args = bench.detect("run", &["--cache", "0", "--epochs", "3", "--batch", "4"]);
    let run = after(&args, "1/3", |_| {
        std::fs::write(bench.path("images/train/003.png"), "broken now").unwrap();
    });
    says(&run, 0, &["warning: 1 pictures cannot be read any more", "3/3"]);
    // Many mosaics want it, but it is one file.
    let named = run.stderr.lines().filter(|line| line.contains("003.png")).count();
    assert_eq!(named, 1, "{}", run.stderr);
    // One of the validation would be missing in the figures: that is an error.
    let args = bench.detect("run", &["--cache", "0", "--epochs", "3", "--overwrite"]);
    let run = after(&args, "1/3", |_| {
        std::fs::write(bench.path("images/val/003.png"), "broken now").unwrap();
    });
    says(&run, 1, &["in epoch ", "val/003.png", "go on: ", "--resume"]);
}

#[test]
fn a_diverging_training_ends_with_words() {
    let bench = Bench::new(16);
    // Each step turns the weights around and makes them many times as large.
    let more = ["--optimizer", "adamw", "--lr", "10", "--weight-decay", "0.9", "--clip", "0"];
    let more =
        [&more[..], &["--warmup-epochs", "0", "--schedule", "step", "--epochs", "60"]].concat();
    let run = realnet(&bench.detect("run", &more));
    says(&run, 1, &["the training diverged: ", "smaller --lr"]);
}

#[test]
fn samples_can_be_looked_at() {
    let bench = Bench::new(16);
    let sheet = bench.text("sheet.png");
    let more = ["--sheet", &sheet, "--sheet-count", "6", "--augment", "mosaic=0"];
    says(&realnet(&bench.detect("run", &more)), 0, &["sheet.png"]);
    let frame = picture::read(sheet.as_ref()).unwrap();
    assert_eq!((frame.width(), frame.height()), (4 * SIDE + 3 * 4, 2 * SIDE + 4));
    // The squares are in it.
    let bright = frame.data().chunks_exact(3).filter(|p| p[0] > 150 && p[2] < 100).count();
    assert!(bright > 1000, "{bright}");
    assert!(!bench.path("run").exists(), "nothing was trained");
}

/// An RGB-D folder: a ramp that leans away at different angles, which its picture shows by
/// its brightness.
fn ramps(folder: &Path, count: u32) {
    let mut dice = Dice(3);
    for name in ["rgb", "depth"] {
        std::fs::create_dir_all(folder.join(name)).unwrap();
    }
    for index in 0..count {
        let [near, lean] = [800 + dice.below(1500), 10 + dice.below(30)];
        let mm = |x: u32, y: u32| near + lean * (SIDE - y) + (x % 7) * 3;
        let pixels = (0..SIDE * SIDE).flat_map(|at| {
            let grey = (mm(at % SIDE, at / SIDE) / 20) as u8;
            [grey, 255 - grey, 90]
        });
        let frame = Frame::rgb8(Stamp::ZERO, SIDE, SIDE, pixels.collect()).unwrap();
        picture::write(&folder.join(format!("rgb/{index:03}.png")), &frame).unwrap();
        ImageBuffer::<Luma<u16>, Vec<u16>>::from_fn(SIDE, SIDE, |x, y| Luma([mm(x, y) as u16]))
            .save(folder.join(format!("depth/{index:03}.png")))
            .unwrap();
    }
    std::fs::write(folder.join("intrinsics.txt"), "60 60 31.5 31.5\n").unwrap();
}

/// `train depth` with small numbers; of 20 pictures 4 are for validation.
fn depth<'a>(data: &'a str, out: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let small = ["--imgsz", "64", "--batch", "4", "--workers", "1", "--depth-scale", "1000"];
    let small = [&small[..], &["--hold-out-block", "2", "--hold-out-gap", "0"]].concat();
    let small = small.chunks(2).filter(|pair| !more.contains(&pair[0])).flatten().copied();
    let first = ["train", "depth", "--data", data, "--out", out];
    first.into_iter().chain(small).chain(more.iter().copied()).collect()
}

#[cfg(unix)]
#[test]
fn depth_learns_goes_on_and_leaves_its_files() {
    let folder = tempdir().unwrap();
    let (data, path) = (folder.path().join("ramps"), |name: &str| folder.path().join(name));
    ramps(&data, 20);
    let (data, whole) = (data.display().to_string(), path("whole").display().to_string());
    let more = ["--epochs", "3", "--warmup-epochs", "0", "--json"];
    let run = realnet(&depth(&data, &whole, &more));
    says(
        &run,
        0,
        &[
            "train: 16 of 16",
            "validation: compared at 64x64; truth: as in the files; crop: none",
            "val: 4 of 4",
            "vnl-lite: 2.69 million parameters",
            "0.0 % lie outside of the classes",
        ],
    );
    let found = epochs(&run.stdout);
    let value = |epoch: &serde_json::Value, name: &str| epoch[name].as_f64().unwrap();
    assert_eq!(found.len(), 3);
    for name in ["loss", "wce", "normals"] {
        assert!(value(&found[2], name) > 0.0);
        assert!(value(&found[2], name) < 0.95 * value(&found[0], name), "{}", run.stdout);
    }
    assert!(found.iter().all(|epoch| (0.0..10.0).contains(&value(epoch, "abs_rel"))));
    let mut files = FILES.to_vec();
    files.push("val.txt");
    files.sort_unstable();
    assert_eq!(listing(whole.as_ref()), files);
    // Another command compares the same pictures, and finds none of them among the others.
    let list = path("whole/val.txt").display().to_string();
    assert_eq!(std::fs::read_to_string(&list).unwrap().lines().skip(1).count(), 4);
    let judged = |data: &str| {
        let (scale, fx) = (["--depth-scale", "1000"], ["--fx", "64"]);
        let model = path("whole/best.onnx").display().to_string();
        let given = ["val", "depth", "--data", data, "--model", &model, "--split", &list, "--json"];
        realnet(&[given.as_slice(), &scale, &fx].concat())
    };
    for data in [&data, &format!("{data}/../ramps")] {
        let run = judged(data);
        says(&run, 0, &[]);
        let judged_by: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        assert_eq!(judged_by["images"], 4, "{}", run.stdout);
    }
    let other = path("others");
    ramps(&other, 4);
    says(&judged(&other.display().to_string()), 2, &["no picture with a depth map was chosen"]);
    // The file says how its numbers are metres.
    let coding = |name: &str| {
        DepthModel::open(&path(name).join("best.onnx")).unwrap();
        Checkpoint::read(path(name).join("best.safetensors")).unwrap().depth
    };
    let expected = DepthCoding { min: 0.02, max: 6.0, focal: 64.0, ..DepthCoding::default() };
    assert_eq!(coding("whole"), Some(expected));
    // And which size it was trained at, which all commands take.
    let weights = path("whole/best.safetensors");
    assert_eq!(Checkpoint::read(&weights).unwrap().size, Some((SIDE, SIDE)));
    let [weights, onnx] = [weights, path("x.onnx")].map(|path| path.display().to_string());
    says(&realnet(&["convert", &weights, "-o", &onnx]), 0, &[&format!("input {SIDE}x{SIDE}")]);

    // One epoch or two, then the rest.
    let parts = path("parts").display().to_string();
    let words = depth(&data, &parts, &more);
    let words: Vec<String> = words.iter().map(ToString::to_string).collect();
    says(&interrupted(&words, "\"epoch\":1,"), 130, &["realnet train depth --resume"]);
    says(&realnet(&["train", "depth", "--resume", &parts]), 0, &["going on after epoch"]);
    for name in ["last.safetensors", "best.onnx", "results.csv"] {
        assert_eq!(read(&path("whole").join(name)), read(&path("parts").join(name)), "{name}");
    }

    // Training on keeps what the file's numbers mean; other classes are other numbers.
    let weights = path("whole/best.safetensors").display().to_string();
    let on = path("on").display().to_string();
    let more = ["--model", &weights, "--epochs", "1", "--imgsz", "96x64", "--normals-gain", "0"];
    let run = realnet(&depth(&data, &on, &more));
    says(
        &run,
        0,
        &["weights: ", "depth: 80 classes from 0.200 to 60.0 m for a focal length of 64 px"],
    );
    assert_eq!(coding("on"), Some(expected));
    let run = realnet(&depth(
        &data,
        &path("x").display().to_string(),
        &["--model", &weights, "--bins", "9"],
    ));
    says(&run, 2, &["--bins 9: the weights have 80"]);
}

#[test]
fn bad_depth_data_are_told_before_the_first_step() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    ramps(&path("ramps"), 20);
    let (data, out) = (path("ramps").display().to_string(), path("run").display().to_string());
    let unknown = ImageBuffer::<Luma<u16>, Vec<u16>>::new(SIDE, SIDE);
    unknown.save(path("ramps/depth/001.png")).unwrap();
    std::fs::write(path("ramps/rgb/002.png"), "no picture").unwrap();
    std::fs::remove_file(path("ramps/depth/003.png")).unwrap();
    let sheet = path("sheet.png").display().to_string();
    let run = realnet(&depth(&data, &out, &["--sheet", &sheet, "--sheet-count", "3"]));
    says(
        &run,
        0,
        &["depth maps know no depth at all", "001.png", "pictures are broken", "002.png"],
    );
    let frame = picture::read(sheet.as_ref()).unwrap();
    assert_eq!((frame.width(), frame.height()), (6 * SIDE + 2 * 4, SIDE));
    assert!(!path("run").exists(), "nothing was trained");

    let refused = |more: &[&str], words: &[&str]| {
        let run = realnet(&depth(&data, &out, more));
        says(&run, 2, words);
        assert!(!path("run/args.toml").exists());
    };
    refused(&["--hold-out-every", "50"], &["val of ", "--hold-out-every", "nothing to learn from"]);
    refused(&["--focal", "0"], &["focal is 0"]);
    refused(
        &["--min-depth", "5", "--max-depth", "2"],
        &["max is 0.2, it must be greater than min"],
    );
    refused(&["--model", "vnl"], &["vnl: no such file, and not one of vnl-lite, vnl-mobilenetv2"]);
    refused(&["--augment", "mosaic=1"], &["there is no 'mosaic'; there are", "zoom"]);
    refused(&["--model", "vnl-resnext50", "--weights", "none.pt"], &["none.pt"]);
    std::fs::remove_file(path("ramps/intrinsics.txt")).unwrap();
    refused(&[], &["the camera is not known", "intrinsics.txt"]);
}
