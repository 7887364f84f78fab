//! Both engines against the reference output, and the detector on top of them.
//! Skipped where the shared files, or ONNX Runtime (`ORT_DYLIB_PATH`), are missing.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use realnet_core::{BoundingBox, Detection, Frame, Stamp};
use realnet_nn::{
    detector::{DetectError, Detector, DetectorModel, DetectorOptions, ModelError, Stage},
    engine::{EngineChoice, EngineError, Provider, Runtime, RuntimeOptions},
    onnx::OnnxModel,
    weights::Checkpoint,
    yolov5::{OnnxOptions, YoloV5},
};
use std::path::PathBuf;

fn shared(path: &str) -> Option<PathBuf> {
    let root = std::env::var("REALNET_SHARED")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared").to_owned());
    let path = PathBuf::from(root).join(path);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is missing", path.display());
    None
}

/// rten, and ONNX Runtime where the environment names one.
fn runtimes() -> Vec<Runtime> {
    let rten = RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() };
    let mut runtimes = vec![Runtime::start(&rten)];
    match std::env::var_os("ORT_DYLIB_PATH") {
        Some(path) => {
            let runtime = Runtime::start(&RuntimeOptions {
                choice: EngineChoice::Ort,
                ort_libraries: vec![path.into()],
                ..Default::default()
            });
            assert_eq!(runtime.note(), None, "ORT_DYLIB_PATH must name a usable library");
            runtimes.push(runtime);
        }
        None => println!("ONNX Runtime skipped: ORT_DYLIB_PATH is not set"),
    }
    runtimes
}

fn read_frame(path: &PathBuf) -> Frame {
    let image = image::open(path).unwrap().to_rgb8();
    let (width, height) = (image.width(), image.height());
    Frame::rgb8(Stamp::ZERO, width, height, image.into_raw()).unwrap()
}

#[test]
fn both_engines_give_the_reference_output() {
    let (Some(weights), Some(picture), Some(raw)) = (
        shared("models/yolov5n.pt"),
        shared("golden/yolov5n/bus_320_letterbox.png"),
        shared("golden/yolov5n/bus_320_raw.npy"),
    ) else {
        return;
    };
    let bytes = std::fs::read(raw).unwrap();
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let expected: Vec<f32> =
        bytes[10 + header..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let network = YoloV5::from_checkpoint(&Checkpoint::read(weights).unwrap()).unwrap();
    let onnx = network.to_onnx(&OnnxOptions { width: 320, height: 320, half: false }).unwrap();
    let frame = read_frame(&picture);
    for runtime in runtimes() {
        let mut engine = runtime.load(OnnxModel::from_bytes(&onnx).unwrap()).unwrap();
        for (channel, plane) in engine.input().chunks_exact_mut(320 * 320).enumerate() {
            for (value, pixel) in plane.iter_mut().zip(frame.data().chunks_exact(3)) {
                *value = f32::from(pixel[channel]) / 255.0;
            }
        }
        let mut worst = f32::INFINITY;
        engine
            .run(&mut |outputs| {
                assert_eq!(outputs.len(), 1);
                assert_eq!((outputs[0].name, outputs[0].shape), ("output0", &[1, 6300, 85][..]));
                worst = outputs[0]
                    .data
                    .iter()
                    .zip(&expected)
                    .map(|(a, b)| (a - b).abs() / b.abs().max(1.0))
                    .fold(0.0, f32::max);
            })
            .unwrap();
        println!("{}: {worst:e}", engine.describe());
        assert!(worst < 1e-3, "{}: {worst}", engine.describe());
    }
}

#[derive(serde::Deserialize)]
struct Expected {
    detections_xyxy_conf_class_in_letterbox_px: Vec<[f32; 6]>,
}

fn same(found: &[Detection], expected: &[[f32; 6]], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}: {found:?}");
    for (found, e) in found.iter().zip(expected) {
        assert_eq!(found.class_id, e[5] as u32, "{what}");
        assert!((found.confidence - e[4]).abs() < 1e-3, "{what}: {} {}", found.confidence, e[4]);
        for (a, b) in <[f32; 4]>::from(found.bbox).into_iter().zip(e) {
            assert!((a - b).abs() < 0.1, "{what}: {:?} {e:?}", found.bbox);
        }
    }
}

#[test]
fn detections_are_those_of_the_reference() {
    let (Some(weights), Some(golden)) = (shared("models/yolov5n.pt"), shared("golden/yolov5n"))
    else {
        return;
    };
    let text = std::fs::read(golden.join("expected.json")).unwrap();
    let expected: std::collections::BTreeMap<String, Expected> =
        serde_json::from_slice(&text).unwrap();
    assert!(expected.len() >= 2);
    for runtime in runtimes() {
        for (name, expected) in &expected {
            let size: u32 = name.rsplit('_').next().unwrap().parse().unwrap();
            let options = DetectorOptions { size: Some((size, size)), ..Default::default() };
            let model = DetectorModel::open(&weights).unwrap();
            let mut detector = Detector::new(model, &runtime, options).unwrap();
            let frame = read_frame(&golden.join(format!("{name}_letterbox.png")));
            let found = detector.detect(&frame).unwrap().to_vec();
            let what = format!("{name} on {}", detector.engine());
            same(&found, &expected.detections_xyxy_conf_class_in_letterbox_px, &what);
        }
    }
}

/// Pictures of somebody else's ONNX file: cut to the decoded output only, without
/// RealNet's metadata, it gives the same boxes as the heads do.
#[test]
fn foreign_files_give_the_same_boxes() {
    let (Some(weights), Some(picture)) =
        (shared("models/yolov5n.pt"), shared("golden/yolov5n/bus_320_letterbox.png"))
    else {
        return;
    };
    let network = YoloV5::from_checkpoint(&Checkpoint::read(weights).unwrap()).unwrap();
    let onnx = network.to_onnx(&OnnxOptions { width: 320, height: 320, half: false }).unwrap();
    let mut foreign = OnnxModel::from_bytes(&onnx).unwrap();
    foreign.set_metadata("realnet_heads", "gone");
    foreign.set_metadata("anchors", "[[[1,1]]]");
    foreign.set_metadata("realnet_strides", "[8]");
    let runtime =
        Runtime::start(&RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() });
    let frame = read_frame(&picture);
    let detect = |bytes: Vec<u8>, options: DetectorOptions| {
        let model = DetectorModel::from_vec("model.onnx", bytes).unwrap();
        let mut detector = Detector::new(model, &runtime, options)?;
        Ok::<_, DetectError>(detector.detect(&frame)?.to_vec())
    };
    let own = detect(onnx, DetectorOptions::default()).unwrap();
    let other = detect(foreign.to_bytes(), DetectorOptions::default()).unwrap();
    assert!(!own.is_empty());
    assert_eq!(own.len(), other.len());
    for (a, b) in own.iter().zip(&other) {
        assert_eq!(a.class_id, b.class_id);
        assert!(a.bbox.iou(&b.bbox) > 0.999 && (a.confidence - b.confidence).abs() < 1e-4);
    }
    // Its size cannot be changed, and it says so.
    let options = DetectorOptions { size: Some((640, 640)), ..Default::default() };
    let error = detect(foreign.to_bytes(), options).unwrap_err();
    assert!(matches!(error, DetectError::Model(ModelError::FixedSize { .. })), "{error}");
}

#[test]
fn near_a_box_the_same_object_is_found_in_frame_pixels() {
    let (Some(weights), Some(picture)) =
        (shared("models/yolov5n.pt"), shared("data/samples/bus.jpg"))
    else {
        return;
    };
    let frame = read_frame(&picture);
    let runtime =
        Runtime::start(&RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() });
    let model = DetectorModel::open(&weights).unwrap();
    let options = DetectorOptions {
        size: Some((640, 640)),
        region_size: Some((320, 320)),
        classes: vec![0],
        min_size: 20.0,
        ..Default::default()
    };
    let mut detector = Detector::new(model, &runtime, options).unwrap();
    let mut stages = Vec::new();
    let whole = detector.detect_marked(&frame, &mut |stage| stages.push(stage)).unwrap().to_vec();
    assert_eq!(stages, [Stage::Preprocess, Stage::Infer, Stage::Postprocess]);
    let person = whole[0].bbox;
    let shifted = person.translated(15.0, -10.0);
    let near = detector.detect_near(&frame, &shifted).unwrap().to_vec();
    assert!(near.iter().any(|d| d.class_id == 0 && d.bbox.iou(&person) > 0.8), "{near:?}");
    // A box outside the frame is looked for at its border, and nothing breaks.
    let outside = BoundingBox::new(-900.0, -900.0, -800.0, -800.0);
    detector.detect_near(&frame, &outside).unwrap();
}

#[test]
fn missing_and_foreign_libraries_fall_back_with_one_line() {
    let directory = tempfile::tempdir().unwrap();
    let text = directory.path().join("libonnxruntime.so");
    std::fs::write(&text, b"not a library").unwrap();
    for path in [text, directory.path().join("nowhere.so"), "libc.so.6".into()] {
        for choice in [EngineChoice::Auto, EngineChoice::Ort] {
            let runtime = Runtime::start(&RuntimeOptions {
                choice,
                ort_libraries: vec![path.clone()],
                ..Default::default()
            });
            let note = runtime.note().unwrap();
            assert!(note.ends_with("; using rten"), "{note}");
            assert!(note.contains(path.to_str().unwrap()) && !note.contains('\n'), "{note}");
            assert!(runtime.describe().starts_with("rten"));
        }
    }
    let wish = RuntimeOptions { provider: Provider::Cuda, ..Default::default() };
    assert!(Runtime::start(&wish).note().unwrap().contains("no ONNX Runtime library was found"));
}

#[test]
fn a_graph_that_does_not_look_at_one_picture_is_refused() {
    let Some(weights) = shared("models/yolov5n.pt") else { return };
    let network = YoloV5::from_checkpoint(&Checkpoint::read(weights).unwrap()).unwrap();
    let onnx = network.to_onnx(&OnnxOptions { width: 64, height: 64, half: false }).unwrap();
    let mut model = OnnxModel::from_bytes(&onnx).unwrap();
    model.set_input_dims(&[2, 3, 64, 64]).unwrap();
    let error = Runtime::start(&RuntimeOptions::default()).load(model).err().unwrap();
    assert!(matches!(error, EngineError::Input { .. }), "{error}");
    assert!(error.to_string().contains("[2, 3, 64, 64]"), "{error}");
}

#[test]
fn a_runtime_can_be_started_again() {
    for (first, second) in runtimes().into_iter().zip(runtimes()) {
        assert_eq!(first.describe(), second.describe());
    }
}

#[test]
fn absurd_input_sizes_are_refused_before_memory_is_asked_for() {
    let Some(weights) = shared("models/yolov5n.pt") else { return };
    let network = YoloV5::from_checkpoint(&Checkpoint::read(weights).unwrap()).unwrap();
    let onnx = network.to_onnx(&OnnxOptions { width: 64, height: 64, half: false }).unwrap();
    for side in [16_385, 100_000, u32::MAX as usize] {
        let mut model = OnnxModel::from_bytes(&onnx).unwrap();
        model.set_input_dims(&[1, 3, side, side]).unwrap();
        let error = Runtime::start(&RuntimeOptions::default()).load(model).err().unwrap();
        assert!(matches!(error, EngineError::Input { .. }), "{error}");
    }
}

/// A small box that is surer must not take the place of a large one.
#[test]
fn small_boxes_take_no_place() {
    let (Some(weights), Some(picture)) =
        (shared("models/yolov5n.pt"), shared("golden/yolov5n/bus_320_letterbox.png"))
    else {
        return;
    };
    let frame = read_frame(&picture);
    let runtime = Runtime::start(&RuntimeOptions::default());
    let found = |min_size, max_det| {
        let model = DetectorModel::open(&weights).unwrap();
        let size = Some((320, 320));
        let options = DetectorOptions { size, min_size, max_det, ..Default::default() };
        Detector::new(model, &runtime, options).unwrap().detect(&frame).unwrap().to_vec()
    };
    let side = |d: &Detection| d.bbox.width().min(d.bbox.height());
    let all = found(0.0, 300);
    let largest = all.iter().map(side).fold(0.0, f32::max);
    let one = found(largest - 1.0, 1);
    assert_eq!(one.len(), 1, "{all:?}");
    assert!(side(&one[0]) >= largest - 1.0);
}
