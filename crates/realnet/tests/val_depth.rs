//! `realnet val depth` as a user runs it: figures that can be told beforehand, the
//! protocol that is printed with them, and what is wrong with bad input.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod common;

use common::{Run, listing, realnet, shared, tiny};
use image::{ImageBuffer, Luma};
use realnet::{
    onnx::proto::{GraphProto, ModelProto, OperatorSetIdProto, StringStringEntryProto},
    picture,
};
use serde_json::Value;
use std::path::{Path, PathBuf};
use tempfile::{TempDir, tempdir};

const WIDTH: u32 = 40;
const HEIGHT: u32 = 30;

/// The keys of `--json` that every reader may count on, in their order.
const KEYS: [&str; 12] = [
    "abs_rel",
    "sq_rel",
    "rmse",
    "rmse_log",
    "log10",
    "silog",
    "d1",
    "d2",
    "d3",
    "images",
    "protocol",
    "ms_per_image",
];

/// Writes a grey PNG of 16 bits.
fn write_depth(path: &Path, depth: impl Fn(u32, u32) -> u16) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    ImageBuffer::<Luma<u16>, Vec<u16>>::from_fn(WIDTH, HEIGHT, |x, y| Luma([depth(x, y)]))
        .save(path)
        .unwrap();
}

fn write_picture(path: &Path, grey: u8) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    tiny::picture(path, WIDTH, HEIGHT, grey);
}

/// Pictures 10, 20, 30 with true depth in millimetres, and maps produced by another
/// program.
struct Bench {
    folder: TempDir,
}

const NUMBERS: [u32; 3] = [10, 20, 30];

/// Millimetres: 1 m on the left, 2, 3 or 4 m on the right.
fn truth(number: u32, x: u32) -> u16 {
    if x < WIDTH / 2 { 1000 } else { 1000 + 100 * number as u16 }
}

impl Bench {
    /// All maps are `factor` times the truth.
    fn new(factor: f64) -> Self {
        let bench = Self { folder: tempdir().unwrap() };
        for n in NUMBERS {
            write_picture(&bench.path(&format!("nyu/rgb/{n:04}.jpg")), 90);
            write_depth(&bench.path(&format!("nyu/depth/{n:04}.png")), |x, _| truth(n, x));
            write_depth(&bench.map(n), |x, _| (f64::from(truth(n, x)) * factor).round() as u16);
        }
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    fn map(&self, number: u32) -> PathBuf {
        self.path(&format!("maps/{number:04}.png"))
    }

    fn run(&self, more: &[&str]) -> Run {
        let (data, maps) = (self.text("nyu"), self.text("maps"));
        let base = ["val", "depth", "--format", "nyu", "--data", &data, "--predictions", &maps];
        realnet(&[&base, more].concat())
    }
}

/// The single JSON object of a run.
#[track_caller]
fn report(run: &Run) -> Value {
    assert_eq!(run.stdout.lines().count(), 1, "{run:#?}");
    serde_json::from_str(&run.stdout).unwrap()
}

#[track_caller]
fn assert_near(report: &Value, key: &str, wanted: f64) {
    let found = report[key].as_f64().unwrap_or_else(|| panic!("{key} in {report:#}"));
    assert!((found - wanted).abs() < 1e-6 * wanted.abs().max(1.0), "{key}: {found}, not {wanted}");
}

#[track_caller]
fn assert_bad(run: &Run, wanted: &[&str]) {
    assert_eq!(run.code, Some(2), "{run:#?}");
    for words in wanted {
        assert!(run.stderr.contains(words), "{words:?} is missing: {run:#?}");
    }
}

#[test]
fn figures_are_those_of_the_formulas() {
    let bench = Bench::new(1.1);
    let run = bench.run(&["--json"]).quiet();
    // The keys in their order, which a map of serde_json would not keep.
    let places: Vec<usize> =
        KEYS.iter().map(|key| run.stdout.find(&format!("\"{key}\":")).unwrap()).collect();
    assert!(places.is_sorted(), "{places:?}");
    let found = report(&run);
    assert_eq!(found.as_object().unwrap().len(), KEYS.len());
    assert_near(&found, "abs_rel", 0.1);
    // Half of the pixels at 1 m, half at 2, 3 or 4 m.
    let mean = |f: fn(f64) -> f64| {
        NUMBERS.map(|n| (f(1.0) + f(1.0 + f64::from(n) / 10.0)) / 2.0).iter().sum::<f64>() / 3.0
    };
    assert_near(&found, "sq_rel", mean(|g| 0.01 * g));
    let rms = |g: f64| (0.01 * (1.0 + g * g) / 2.0).sqrt();
    assert_near(&found, "rmse", (rms(2.0) + rms(3.0) + rms(4.0)) / 3.0);
    assert_near(&found, "rmse_log", 1.1_f64.ln());
    assert_near(&found, "log10", 1.1_f64.log10());
    assert!(found["silog"].as_f64().unwrap() < 1e-4, "one factor has no scale-invariant error");
    for key in ["d1", "d2", "d3"] {
        assert_near(&found, key, 1.0);
    }
    assert_eq!((&found["images"], &found["ms_per_image"]), (&3.into(), &Value::Null));
    let protocol = &found["protocol"];
    assert_eq!(protocol["crop"], "full");
    assert_eq!(protocol["pooling"], "per_image");
    assert_eq!(protocol["max_depth"], 10.0);
    assert_eq!(protocol["median_scaling"], false);
    assert_eq!(protocol["depth_scale"], 1000.0);
    assert_eq!(protocol["pixels"], 3 * WIDTH * HEIGHT);
    assert_eq!(protocol["selection"]["first"], "0010");

    let pooled = report(&bench.run(&["--json", "--pooling", "pooled"]).quiet());
    let squares = [2.0, 3.0, 4.0].map(|g: f64| 0.01 * (1.0 + g * g) / 2.0);
    assert_near(&pooled, "rmse", (squares.iter().sum::<f64>() / 3.0).sqrt());
    let scaled = report(&bench.run(&["--json", "--median-scaling"]).quiet());
    assert!(scaled["abs_rel"].as_f64().unwrap() < 1e-6, "{scaled:#}");
    assert_eq!(scaled["protocol"]["median_scaling"], true);
}

/// A wall that is met head-on, and maps that take it for one turned by 20 degrees about the
/// vertical: every normal is 20 degrees off, for the camera that is given.
#[test]
fn normals_are_compared_where_they_are_asked_for() {
    let bench = Bench::new(1.0);
    let slope = 20.0_f64.to_radians().tan();
    for n in NUMBERS {
        write_depth(&bench.path(&format!("nyu/depth/{n:04}.png")), |_, _| 2000);
        let ray = |x: u32| (f64::from(x) - f64::from(WIDTH - 1) / 2.0) / 40.0;
        write_depth(&bench.map(n), |x, _| (2000.0 / (1.0 + slope * ray(x))).round() as u16);
    }
    let found = report(&bench.run(&["--json", "--normals", "--fx", "40"]).quiet());
    let normals = &found["normals"];
    for key in ["mean_deg", "median_deg"] {
        assert!((normals[key].as_f64().unwrap() - 20.0).abs() < 0.2, "{normals:#}");
    }
    assert_eq!((&normals["within_11"], &normals["within_22"]), (&0.0.into(), &1.0.into()));
    assert_eq!(normals["window"], 7);
    let all = normals["pixels"].as_u64().unwrap();
    assert!((u64::from(WIDTH * HEIGHT)..=3 * u64::from(WIDTH * HEIGHT)).contains(&all), "{all}");
    // Eigen's crop of NYU has fewer pixels.
    let crop = ["--json", "--normals", "--fx", "40", "--crop", "eigen-nyu"];
    let cropped = report(&bench.run(&crop).quiet())["normals"]["pixels"].as_u64().unwrap();
    assert!(cropped > 0 && cropped < all, "{cropped} of {all}");
    let run = bench.run(&["--normals", "--fx", "40"]).quiet();
    assert!(run.stdout.contains("surface normals: mean "), "{}", run.stdout);
    assert!(!bench.run(&[]).quiet().stdout.contains("normals"));
}

#[test]
fn the_table_says_how_it_was_measured() {
    let bench = Bench::new(1.3);
    let run = bench.run(&["--truth", "by hand", "--crop", "eigen", "--cap", "2.5"]).quiet();
    for words in [
        "truth: by hand; crop: Eigen for NYU; depths: 0.001 to 2.5 m; median scaling: no",
        "the paper's table (mean of images)",
        "Accuracy: share of pixels with max(g / p, p / g) < 1.25",
        "0010 to 0030",
    ] {
        assert!(run.stdout.contains(words), "{words:?} is missing: {}", run.stdout);
    }
    // Beyond the cap there is only the left half of the others; 1.3 is beyond 1.25.
    let found = report(&bench.run(&["--json", "--cap", "2.5"]).quiet());
    assert_eq!(found["protocol"]["pixels"], WIDTH * HEIGHT + 2 * WIDTH / 2 * HEIGHT);
    assert!(found["d1"].as_f64().unwrap() < 0.2, "2.6 m is lowered to 2.5: {found:#}");
    let cropped = report(&bench.run(&["--json", "--crop", "eigen-nyu"]).quiet());
    let window = (WIDTH * 601 / 640 - WIDTH * 41 / 640) * (HEIGHT * 471 / 480 - HEIGHT * 45 / 480);
    assert_eq!(cropped["protocol"]["pixels"], 3 * window);
}

#[test]
fn pictures_are_chosen_by_number_and_by_list() {
    let bench = Bench::new(1.1);
    let chosen = |more: &[&str]| {
        let found = report(&bench.run(&[&["--json"], more].concat()).quiet());
        let selection = &found["protocol"]["selection"];
        let name = |key: &str| selection[key].as_str().unwrap().to_owned();
        (found["images"].as_u64().unwrap(), name("first"), name("last"))
    };
    let own = |n, first: &str, last: &str| (n, first.to_owned(), last.to_owned());
    assert_eq!(chosen(&["--from", "11"]), own(2, "0020", "0030"));
    assert_eq!(chosen(&["--from", "10", "--to", "20"]), own(2, "0010", "0020"));
    assert_eq!(chosen(&["--limit", "1"]), own(1, "0010", "0010"));
    let list = bench.text("list.txt");
    std::fs::write(&list, "# held out\n0030.jpg\n\n10 # by number\n").unwrap();
    assert_eq!(chosen(&["--split", &list]), own(2, "0010", "0030"));
    std::fs::write(&list, "10\n11\n").unwrap();
    assert_bad(&bench.run(&["--split", &list]), &["list.txt:2", "'11'"]);
    assert_bad(&bench.run(&["--from", "21", "--to", "29"]), &["no picture"]);
    assert_bad(&bench.run(&["--from", "3", "--to", "2"]), &["--from 3 is after --to 2"]);
}

#[test]
fn a_bad_picture_costs_only_itself() {
    let bench = Bench::new(1.1);
    std::fs::remove_file(bench.map(10)).unwrap();
    let run = bench.run(&["--json"]);
    assert_bad(&run, &["no produced depth of", "0010.jpg"]);
    let found = report(&run);
    assert_eq!((&found["images"], &found["protocol"]["images_left_out"]), (&2.into(), &1.into()));
    assert_near(&found, "abs_rel", 0.1);
    // A map of another size is not resized in silence.
    ImageBuffer::<Luma<u16>, Vec<u16>>::new(8, 8).save(bench.map(10)).unwrap();
    assert_bad(&bench.run(&[]), &["8x8 depths for a picture of 40x30"]);
    std::fs::write(bench.path("nyu/rgb/0020.jpg"), "no picture").unwrap();
    assert_bad(&bench.run(&[]), &["0020.jpg"]);
    // A picture without depth is left out; one whose depth is all unknown is counted.
    let bench = Bench::new(1.1);
    std::fs::remove_file(bench.path("nyu/depth/0010.png")).unwrap();
    write_depth(&bench.path("nyu/depth/0020.png"), |_, _| 0);
    let run = bench.run(&["--json"]);
    assert_eq!(run.code, Some(0), "{run:#?}");
    assert!(run.stderr.contains("1 pictures have no depth map"), "{run:#?}");
    assert!(run.stderr.contains("1 pictures had no pixel to compare"), "{run:#?}");
    assert_eq!(report(&run)["images"], 1);
    write_depth(&bench.path("nyu/depth/0030.png"), |_, _| 0);
    assert_bad(&bench.run(&["--json"]), &["no pixel of 2 pictures could be compared"]);
}

#[test]
fn what_could_mislead_is_asked_for() {
    let bench = Bench::new(1.1);
    let (data, maps) = (bench.text("nyu"), bench.text("maps"));
    let plain = ["val", "depth", "--data", &data, "--predictions", &maps];
    // Five thousand units a metre are a custom, not a fact.
    let run = realnet(&plain);
    assert!(run.stderr.contains("millimetres need --depth-scale 1000"), "{run:#?}");
    realnet(&[&plain[..], &["--depth-scale", "1000"]].concat()).quiet();
    // Two crops have the one name.
    let run = realnet(&[&plain[..], &["--crop", "eigen"]].concat());
    assert_bad(&run, &["eigen-kitti", "eigen-nyu"]);
    // A network needs the camera.
    let model = bench.path("flat.onnx");
    std::fs::write(&model, flat()).unwrap();
    let run = realnet(&["val", "depth", "--data", &data, "--model", model.to_str().unwrap()]);
    assert_bad(&run, &["no camera is known", "--fx"]);
    assert_bad(&realnet(&["val", "depth", "--data", &data]), &["--model", "--predictions"]);
    assert_bad(&bench.run(&["--min-depth", "3", "--cap", "2"]), &["depths from 3 to 2 m"]);
    assert_bad(&bench.run(&["--predictions-scale", "0"]), &["--predictions-scale"]);
    let folder = bench.text("maps");
    let run = realnet(&["val", "depth", "--data", &folder, "--predictions", &folder]);
    assert_bad(&run, &["no RGB-D sequence here"]);
}

/// A network that says 1 m for its own focal length of 64 px whatever grey it sees:
/// three bins from 0.1 to 10 m, equally likely, their mean in logarithms.
fn flat() -> Vec<u8> {
    let graph = GraphProto {
        name: "flat".to_owned(),
        node: vec![tiny::node("GlobalAveragePool", &["image"], "logits", &[], &[])],
        input: vec![tiny::value_info("image", &[1, 3, 64, 64])],
        output: vec![tiny::value_info("logits", &[1, 3, 1, 1])],
        ..Default::default()
    };
    let coding =
        r#"{"min":0.1,"max":10,"scale":1,"focal":64,"mean":[0,0,0],"std":[1,1,1]}"#.to_owned();
    let entry =
        |(key, value): (&str, String)| StringStringEntryProto { key: key.to_owned(), value };
    tiny::bytes_of(ModelProto {
        ir_version: Some(8),
        graph: Some(graph),
        opset_import: vec![OperatorSetIdProto { domain: String::new(), version: Some(13) }],
        metadata_props: [
            ("realnet_depth", coding),
            ("realnet_logits", "logits".to_owned()),
            ("realnet_align", "centres".to_owned()),
            ("stride", "32".to_owned()),
        ]
        .map(entry)
        .to_vec(),
        ..Default::default()
    })
}

#[test]
fn the_camera_makes_metres_of_a_network() {
    let bench = Bench::new(1.0);
    std::fs::write(bench.path("flat.onnx"), flat()).unwrap();
    for n in NUMBERS {
        write_depth(&bench.path(&format!("nyu/depth/{n:04}.png")), |_, _| 2000);
    }
    let (data, model) = (bench.text("nyu"), bench.text("flat.onnx"));
    let base = ["val", "depth", "--data", &data, "--model", &model, "--engine", "rten", "--json"];
    let with = |more: &[&str]| report(&realnet(&[&base, more].concat()).quiet());
    let millimetres = ["--depth-scale", "1000"];
    // 40 pixels become 64: 80 px there are 128 on the input, twice the network's.
    let found = with(&[&millimetres[..], &["--fx", "80"]].concat());
    assert!(found["abs_rel"].as_f64().unwrap() < 1e-4, "{found:#}");
    assert!(found["ms_per_image"].as_f64().unwrap() > 0.0);
    assert_eq!(found["protocol"]["estimator"]["input"], serde_json::json!([64, 64]));
    let found = with(&[&millimetres[..], &["--fx", "40"]].concat());
    assert!((found["abs_rel"].as_f64().unwrap() - 0.5).abs() < 1e-4, "{found:#}");
    // camera.yaml of the data is that camera, and PNG files beside it have 5000 units a metre.
    for n in NUMBERS {
        write_depth(&bench.path(&format!("nyu/depth/{n:04}.png")), |_, _| 10_000);
    }
    let yaml = "image_width: 80\nimage_height: 60\ncamera_name: c\n\
                camera_matrix: {rows: 3, cols: 3, data: [160, 0, 40, 0, 160, 30, 0, 0, 1]}\n\
                distortion_model: plumb_bob\n\
                distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n";
    std::fs::write(bench.path("nyu/camera.yaml"), yaml).unwrap();
    let found = with(&[]);
    assert!(found["abs_rel"].as_f64().unwrap() < 1e-4, "{found:#}");
    assert_eq!(found["protocol"]["camera"], "camera.yaml of the data");
    // A folder of two such folders.
    std::fs::create_dir(bench.path("both")).unwrap();
    std::fs::rename(bench.path("nyu"), bench.path("both/a")).unwrap();
    for part in ["rgb/0010.jpg", "depth/0010.png", "camera.yaml"] {
        let (from, to) = (format!("both/a/{part}"), bench.path(&format!("both/b/{part}")));
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::copy(bench.path(&from), to).unwrap();
    }
    let (both, report_folder) = (bench.text("both"), bench.text("report"));
    let base = ["val", "depth", "--data", &both, "--model", &model, "--engine", "rten", "--json"];
    let run = realnet(&[&base[..], &["--report", &report_folder]].concat());
    assert_eq!(run.code, Some(0), "{run:#?}");
    let found = report(&run);
    assert_eq!(
        (&found["images"], &found["protocol"]["selection"]["last"]),
        (&4.into(), &"b/0010".into())
    );
    let names = listing(&bench.path("report"));
    for name in ["index.html", "metrics.json", "images.csv", "depth-0.png", "depth-4.png"] {
        assert!(names.iter().any(|found| found == name), "{names:?}");
    }
    let row = picture::read(&bench.path("report/depth-0.png")).unwrap();
    assert!(row.width() >= 4 * WIDTH, "picture, truth, depth and error in a row");
    let csv = std::fs::read_to_string(bench.path("report/images.csv")).unwrap();
    assert_eq!(csv.lines().count(), 5);
    assert!(csv.contains("\n\"b/0010\",1200,1200,,"), "{csv}");
    let metrics: Value =
        serde_json::from_slice(&std::fs::read(bench.path("report/metrics.json")).unwrap()).unwrap();
    assert_eq!(metrics["abs_rel"], found["abs_rel"]);
}

#[test]
fn kitti_has_two_truths() {
    let bench = Bench::new(1.0);
    let stem = "drive_0002_sync_image_0000000005_image_02";
    write_picture(&bench.path(&format!("kitti/image/{stem}.png")), 90);
    let map = |part: &str| {
        bench.path(&format!("kitti/{part}/drive_0002_sync_{part}_0000000005_image_02.png"))
    };
    // A scan is sparse.
    write_depth(&map("groundtruth_depth"), |x, _| if x % 2 == 0 { 20 * 256 } else { 0 });
    write_depth(&map("velodyne_raw"), |x, _| if x % 4 == 0 { 25 * 256 } else { 0 });
    write_depth(&bench.path(&format!("made/{stem}.png")), |_, _| 22_000);
    let (data, made) = (bench.text("kitti"), bench.text("made"));
    let base = ["val", "depth", "--data", &data, "--predictions", &made, "--json"];
    let improved = report(&realnet(&base).quiet());
    assert_near(&improved, "abs_rel", 0.1);
    assert_eq!(improved["protocol"]["truth"], "improved ground truth");
    assert_eq!(improved["protocol"]["max_depth"], 80.0);
    assert_eq!(improved["protocol"]["pixels"], WIDTH / 2 * HEIGHT);
    let raw = report(&realnet(&[&base[..], &["--truth", "raw"]].concat()).quiet());
    assert_near(&raw, "abs_rel", 3.0 / 25.0);
    assert_eq!(raw["protocol"]["truth"], "raw LiDAR");
    let run = realnet(&[&base[..], &["--truth", "lidar"]].concat());
    assert_bad(&run, &["'improved'", "'raw'"]);
    // The camera of each picture has a file of its own.
    let model = bench.text("flat.onnx");
    std::fs::write(&model, flat()).unwrap();
    let matrix = bench.path(&format!("kitti/intrinsics/{stem}.txt"));
    std::fs::create_dir_all(matrix.parent().unwrap()).unwrap();
    std::fs::write(&matrix, "800 0 20 0 800 15 0 0 1\n").unwrap();
    let net = ["val", "depth", "--data", &data, "--model", &model, "--engine", "rten", "--json"];
    // 800 px of 40 are 1280 of 64, twenty times the network's.
    let found = report(&realnet(&net).quiet());
    assert!(found["abs_rel"].as_f64().unwrap() < 1e-4, "{found:#}");
    std::fs::write(&matrix, "800 0\n").unwrap();
    assert_bad(&realnet(&net), &["2 numbers"]);
}

#[test]
fn converted_vnl_weights_say_the_same() {
    let Some(weights) = shared("golden/vnl/mobilenetv2_random.safetensors") else { return };
    let bench = Bench::new(1.0);
    let onnx = bench.text("vnl.onnx");
    let weights = weights.to_str().unwrap().to_owned();
    let run = realnet(&["convert", &weights, "-o", &onnx, "--imgsz", "64"]);
    assert_eq!(run.code, Some(0), "{run:#?}");
    assert!(run.stderr.contains("VNL depth") && run.stderr.contains("input 64x64"), "{run:#?}");
    let data = bench.text("nyu");
    let figures = |model: &str| {
        let base = ["val", "depth", "--format", "nyu", "--data", &data, "--model", model];
        let more = ["--engine", "rten", "--imgsz", "64", "--limit", "1", "--json"];
        report(&realnet(&[&base[..], &more].concat()).quiet())
    };
    let (from_weights, from_onnx) = (figures(&weights), figures(&onnx));
    for key in &KEYS[..9] {
        let (a, b) = (from_weights[key].as_f64().unwrap(), from_onnx[key].as_f64().unwrap());
        assert!((a - b).abs() < 1e-5 * a.abs().max(1.0), "{key}: {a} and {b}");
    }
    assert!(from_weights["protocol"]["camera"].as_str().unwrap().starts_with("customary of NYU"));
}
