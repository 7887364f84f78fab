//! The real YOLOv5n against its reference output, its own safetensors copy,
//! and itself in other forms. Skipped when the shared files are missing.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use std::path::PathBuf;

use realnet_nn::onnx::{Dim, OnnxModel};
use realnet_nn::weights::Checkpoint;
use realnet_nn::yolov5::{DetectorMetadata, ExportError, OnnxOptions, YoloV5};
use rten::{Model, Value};
use rten_tensor::NdTensor;
use rten_tensor::prelude::*;

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

/// Little-endian float32 array of an `.npy` file (version 1) in C order.
fn read_npy(path: &PathBuf) -> Vec<f32> {
    let bytes = std::fs::read(path).unwrap();
    assert_eq!(&bytes[..6], b"\x93NUMPY");
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let text = String::from_utf8_lossy(&bytes[10..10 + header]);
    assert!(text.contains("'<f4'") && text.contains("'fortran_order': False"), "{text}");
    bytes[10 + header..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

fn image(path: &PathBuf) -> (Vec<f32>, usize, usize) {
    let image = image::open(path).unwrap().to_rgb8();
    let (w, h) = (image.width() as usize, image.height() as usize);
    let planes = (0..3).flat_map(|c| image.pixels().map(move |p| f32::from(p.0[c]) / 255.0));
    (planes.collect(), w, h)
}

fn run(onnx: &[u8], input: &[f32], w: usize, h: usize) -> Vec<Vec<f32>> {
    let model = Model::load(onnx.to_vec()).unwrap();
    let input = NdTensor::from_data([1, 3, h, w], input.to_vec());
    let inputs = vec![(model.input_ids()[0], input.into())];
    let outputs = model.run(inputs, model.output_ids(), None).unwrap();
    outputs
        .into_iter()
        .map(|o| match o {
            Value::FloatTensor(t) => t.to_vec(),
            other => panic!("{:?}", other.dtype()),
        })
        .collect()
}

/// Largest |a − b| / max(1, |b|), and largest |a − b|.
fn difference(a: &[f32], b: &[f32]) -> (f32, f32) {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold((0.0, 0.0), |(r, p), (a, b)| {
        let d = (a - b).abs();
        assert!(d.is_finite());
        (f32::max(r, d / b.abs().max(1.0)), f32::max(p, d))
    })
}

const SIZE: OnnxOptions = OnnxOptions { width: 320, height: 320, half: false };

#[test]
fn pickle_and_safetensors_hold_the_same_network() {
    let (Some(pt), Some(safe)) =
        (shared("models/yolov5n.pt"), shared("models/yolov5n_fp16.safetensors"))
    else {
        return;
    };
    let (pt, safe) = (Checkpoint::read(pt).unwrap(), Checkpoint::read(safe).unwrap());
    assert_eq!(pt.class_names, safe.class_names);
    assert_eq!(pt.strides, Some(vec![8.0, 16.0, 32.0]));
    assert_eq!(safe.strides, pt.strides);
    let names: Vec<&String> = pt.tensors.keys().collect();
    assert_eq!(names, safe.tensors.keys().collect::<Vec<_>>());
    assert!(names.len() > 280, "{}", names.len());
    for (name, a) in &pt.tensors {
        let b = &safe.tensors[name];
        assert_eq!(a.shape(), b.shape(), "{name}");
        for (a, b) in a.data().iter().zip(b.data()) {
            assert!((a - b).abs() <= a.abs() * 1e-3 + 1e-7, "{name}: {a} {b}");
        }
    }
    let (a, b) = (YoloV5::from_checkpoint(&pt).unwrap(), YoloV5::from_checkpoint(&safe).unwrap());
    assert_eq!(a.class_names(), b.class_names());
    assert_eq!(a.strides(), [8, 16, 32]);
    assert_eq!(a.anchors(), b.anchors());
    assert_eq!(a.anchors()[0], [[10.0, 13.0], [16.0, 30.0], [33.0, 23.0]]);
    assert_eq!(a.parameters(), 1_867_405);
}

#[test]
fn network_gives_the_reference_output() {
    let (Some(pt), Some(picture), Some(expected)) = (
        shared("models/yolov5n.pt"),
        shared("golden/yolov5n/bus_320_letterbox.png"),
        shared("golden/yolov5n/bus_320_raw.npy"),
    ) else {
        return;
    };
    let network = YoloV5::from_checkpoint(&Checkpoint::read(pt).unwrap()).unwrap();
    let (input, w, h) = image(&picture);
    let expected = read_npy(&expected);
    let onnx = network.to_onnx(&SIZE).unwrap();
    let output = run(&onnx, &input, w, h).remove(0);
    let (relative, plain) = difference(&output, &expected);
    println!("max |a-b|/max(1,|b|) {relative:e}, max |a-b| {plain:e}");
    assert!(relative <= 1e-3, "{relative}");

    // Half precision moves boxes by fractions of a pixel, not more.
    let half = network.to_onnx(&OnnxOptions { half: true, ..SIZE }).unwrap();
    assert!(half.len() * 10 < onnx.len() * 6, "{} {}", half.len(), onnx.len());
    let (relative, plain) = difference(&run(&half, &input, w, h)[0], &expected);
    println!("half: max |a-b|/max(1,|b|) {relative:e}, max |a-b| {plain:e}");
    assert!(relative <= 0.05, "{relative}");
}

/// The heads decoded by hand equal the output; they work at another input size.
#[test]
fn heads_stand_alone() {
    let (Some(pt), Some(picture)) =
        (shared("models/yolov5n.pt"), shared("golden/yolov5n/bus_320_letterbox.png"))
    else {
        return;
    };
    let network = YoloV5::from_checkpoint(&Checkpoint::read(pt).unwrap()).unwrap();
    let (input, w, h) = image(&picture);
    let full = network.to_onnx(&SIZE).unwrap();
    let mut model = OnnxModel::from_bytes(&full).unwrap();
    assert_eq!(model.to_bytes(), full);
    let metadata = DetectorMetadata::from_onnx(&model).unwrap();
    assert_eq!(metadata.heads, ["head0", "head1", "head2"]);
    assert_eq!(metadata.names, network.class_names());
    assert_eq!(metadata.strides, network.strides());
    assert_eq!(metadata.anchors, network.anchors());
    assert_eq!((metadata.imgsz, metadata.max_stride), (Some([320, 320]), Some(32)));
    let heads: Vec<&str> = metadata.heads.iter().map(String::as_str).collect();
    model.keep_outputs(&heads).unwrap();
    assert!(!model.has_tensor("output0") && !model.has_tensor("decode.split"));
    assert_eq!(model.outputs()[2].dims, Some([1, 255, 10, 10].map(Dim::Fixed).to_vec()));
    let outputs = run(&model.to_bytes(), &input, w, h);

    let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
    let mut decoded = Vec::new();
    for ((head, stride), anchors) in outputs.iter().zip(&metadata.strides).zip(&metadata.anchors) {
        let (rows, cols) = (h / stride, w / stride);
        for (a, anchor) in anchors.iter().enumerate() {
            for y in 0..rows {
                for x in 0..cols {
                    let at = |i: usize| sigmoid(head[((a * 85 + i) * rows + y) * cols + x]);
                    let s = *stride as f32;
                    decoded.push((2.0 * at(0) - 0.5 + x as f32) * s);
                    decoded.push((2.0 * at(1) - 0.5 + y as f32) * s);
                    decoded.push((2.0 * at(2)).powi(2) * anchor[0]);
                    decoded.push((2.0 * at(3)).powi(2) * anchor[1]);
                    decoded.extend((4..85).map(at));
                }
            }
        }
    }
    let (relative, _) = difference(&run(&full, &input, w, h)[0], &decoded);
    assert!(relative < 1e-4, "{relative}");

    model.set_input_dims(&[1, 3, 192, 256]).unwrap();
    let small = run(&model.to_bytes(), &input[..3 * 192 * 256], 256, 192);
    let mut direct = OnnxModel::from_bytes(
        &network.to_onnx(&OnnxOptions { width: 256, height: 192, half: false }).unwrap(),
    )
    .unwrap();
    direct.keep_outputs(&heads).unwrap();
    assert_eq!(small, run(&direct.to_bytes(), &input[..3 * 192 * 256], 256, 192));
    assert_eq!(small[0].len(), 255 * 24 * 32);
}

#[test]
fn sizes_between_strides_are_refused() {
    let Some(pt) = shared("models/yolov5n.pt") else { return };
    let network = YoloV5::from_checkpoint(&Checkpoint::read(pt).unwrap()).unwrap();
    let error = network.to_onnx(&OnnxOptions { width: 300, ..SIZE }).unwrap_err();
    let expected = ExportError::InputSize { what: "width", value: 300, stride: 32, next: 320 };
    assert_eq!(error, expected);
    assert!(network.to_onnx(&OnnxOptions { height: 0, ..SIZE }).is_err());
}
