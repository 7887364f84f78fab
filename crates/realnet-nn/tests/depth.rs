//! The VNL depth network with the authors' parameter names against the reference
//! output of their program, on both engines. Skipped where the shared files, or
//! ONNX Runtime (`ORT_DYLIB_PATH`), are missing.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use realnet_core::{CameraModel, Distortion, Frame, Intrinsics, Stamp};
use realnet_nn::{
    depth::{
        Alignment, DepthCoding, DepthError, DepthMetadata, DepthModel, DepthModelError, DepthNet,
        DepthOptions, DepthSize, Detail, SoftSum,
    },
    engine::{EngineChoice, Runtime, RuntimeOptions},
    onnx::{OnnxModel, OnnxOptions},
    vnl::{Vnl, VnlError},
    weights::{Checkpoint, Tensor, TensorError},
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

fn weights() -> Option<Checkpoint> {
    Some(Checkpoint::read(shared("golden/vnl/mobilenetv2_random.safetensors")?).unwrap())
}

struct Golden {
    input: Tensor,
    depth: Tensor,
    logits: Tensor,
}

fn golden() -> Option<Golden> {
    let path = shared("golden/vnl/mobilenetv2_random_io.safetensors")?;
    let mut tensors = Checkpoint::read(path).unwrap().tensors;
    let mut take = |name: &str| tensors.remove(name).unwrap();
    Some(Golden { input: take("input"), depth: take("depth"), logits: take("logits_stride32") })
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

/// Shape and values of the only output for `input`.
fn run(runtime: &Runtime, model: OnnxModel, input: &[f32]) -> (Vec<usize>, Vec<f32>) {
    let mut engine = runtime.load(model).unwrap();
    engine.input().copy_from_slice(input);
    let mut result = None;
    engine
        .run(&mut |outputs| {
            assert_eq!(outputs.len(), 1);
            result = Some((outputs[0].shape.to_vec(), outputs[0].data.to_vec()));
        })
        .unwrap();
    result.unwrap()
}

/// Largest and mean |a − b| / b.
fn relative(a: impl IntoIterator<Item = f32>, b: impl IntoIterator<Item = f32>) -> (f32, f32) {
    let errors: Vec<f32> = a.into_iter().zip(b).map(|(a, b)| (a - b).abs() / b).collect();
    assert!(!errors.is_empty() && errors.iter().all(|e| e.is_finite()));
    (errors.iter().copied().fold(0.0, f32::max), errors.iter().sum::<f32>() / errors.len() as f32)
}

#[test]
fn the_network_gives_the_reference_output() {
    let (Some(weights), Some(golden)) = (weights(), golden()) else { return };
    let vnl = Vnl::from_checkpoint(&weights).unwrap();
    assert_eq!((vnl.bins(), vnl.max_stride()), (60, 8));
    let size = OnnxOptions { width: 256, height: 256, half: false };
    let file = OnnxModel::from_vec(vnl.to_onnx(&size).unwrap()).unwrap();
    let reference: Vec<f32> = golden.depth.data().iter().map(|d| d * 10.0).collect();
    let small = vnl.to_onnx(&OnnxOptions { half: true, ..size }).unwrap();
    assert!(small.len() < 6_000_000, "{} bytes", small.len());
    let small = OnnxModel::from_vec(small).unwrap();
    for runtime in runtimes() {
        let name = runtime.describe();
        // What the file gives to whoever runs it.
        let (shape, depth) = run(&runtime, file.clone(), golden.input.data());
        assert_eq!(shape, [1, 1, 256, 256]);
        let (worst, mean) = relative(depth, reference.iter().copied());
        println!("{name}: depth of the file, largest {worst:e}, mean {mean:e}");
        assert!(worst < 1e-4, "{worst}");
        // Weights of 16 bits.
        let (_, depth) = run(&runtime, small.clone(), golden.input.data());
        let (worst, mean) = relative(depth, reference.iter().copied());
        println!("{name}: depth of the small file, largest {worst:e}, mean {mean:e}");
        assert!(worst < 0.01 && mean < 1e-3, "{worst} {mean}");

        // What RealNet makes of the logits at full size.
        let model = DepthModel::from_weights("golden", vnl.clone());
        let (network, metadata) = model.network(None, Detail::Full).unwrap();
        let (shape, logits) = run(&runtime, network, golden.input.data());
        assert_eq!(shape, [1, 60, 256, 256]);
        let mut worst = 0f32;
        for (i, expected) in golden.logits.data().iter().enumerate() {
            let (bin, y, x) = (i / 64, i / 8 % 8 * 32, i % 8 * 32);
            worst = worst.max((logits[(bin * 256 + y) * 256 + x] - expected).abs());
        }
        let largest = golden.logits.data().iter().fold(0f32, |m, x| m.max(x.abs()));
        println!("{name}: logits up to {largest}, largest difference {worst:e}");
        assert!(worst < 1e-4 * largest.max(1.0), "{worst}");
        let mut full = vec![0.0; 256 * 256];
        SoftSum::new(&metadata.coding, 60).run(&logits, 1.0, &mut full);
        let (worst, mean) = relative(full, reference.iter().copied());
        println!("{name}: depth by our sum, largest {worst:e}, mean {mean:e}");
        assert!(worst < 1e-4, "{worst}");
    }
}

/// A square of `n` pixels made larger, bilinear, corners on corners.
fn enlarge(small: &[f32], n: usize, target: usize) -> Vec<f32> {
    let tap = |i: usize| {
        let at = i as f32 * (n - 1) as f32 / (target - 1) as f32;
        let first = (at as usize).min(n - 2);
        (first, at - first as f32)
    };
    let mut large = Vec::new();
    for (y, fy) in (0..target).map(tap) {
        for (x, fx) in (0..target).map(tap) {
            let row = |y: usize| small[y * n + x] * (1.0 - fx) + small[y * n + x + 1] * fx;
            large.push(row(y) * (1.0 - fy) + row(y + 1) * fy);
        }
    }
    large
}

/// Where the released network predicts from zeros beyond the border, at the outer
/// two pixels, its depth jumps, and nothing at half size can follow. Inside, the
/// logits at half size are close to the released ones in between. Made larger as
/// depth rather than as logits they differ more, where depth has edges, of which
/// random weights make many.
#[test]
fn the_fast_logits_stay_close_to_the_reference() {
    let (Some(weights), Some(golden)) = (weights(), golden()) else { return };
    let model = DepthModel::from_weights("golden", Vnl::from_checkpoint(&weights).unwrap());
    let (network, metadata) = model.network(None, Detail::Fast).unwrap();
    assert_eq!(metadata.alignment, Alignment::Corners);
    let inner = |map: Vec<f32>| {
        let rows = map.chunks_exact(256).skip(4).take(248);
        rows.flat_map(|row| row[4..252].to_vec()).collect::<Vec<f32>>()
    };
    let reference = inner(golden.depth.data().iter().map(|d| d * 10.0).collect());
    let mut sum = SoftSum::new(&metadata.coding, 60);
    for runtime in runtimes() {
        let name = runtime.describe();
        let (shape, logits) = run(&runtime, network.clone(), golden.input.data());
        assert_eq!(shape, [1, 60, 128, 128]);
        let large: Vec<f32> =
            logits.chunks_exact(128 * 128).flat_map(|plane| enlarge(plane, 128, 256)).collect();
        let mut depth = vec![0.0; 256 * 256];
        sum.run(&large, 1.0, &mut depth);
        let (worst, mean) = relative(inner(depth), reference.iter().copied());
        println!("{name}: logits made larger, largest {worst:e}, mean {mean:e}");
        assert!(worst < 0.01 && mean < 2e-4, "{worst} {mean}");

        let mut half = vec![0.0; 128 * 128];
        sum.run(&logits, 1.0, &mut half);
        let (worst, mean) = relative(inner(enlarge(&half, 128, 256)), reference.iter().copied());
        println!("{name}: depth made larger, largest {worst:e}, mean {mean:e}");
        assert!(worst < 0.25 && mean < 0.0025, "{worst} {mean}");
    }
}

fn noise_frame(width: u32, height: u32) -> Frame {
    let data = (0..width * height * 3).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8);
    Frame::rgb8(Stamp::from_nanos(77), width, height, data.collect()).unwrap()
}

#[test]
fn frames_become_maps_of_the_size_asked_for() {
    let Some(weights) = weights() else { return };
    let vnl = Vnl::from_checkpoint(&weights).unwrap();
    let file = vnl.to_onnx(&OnnxOptions { width: 64, height: 64, half: false }).unwrap();
    let weights = DepthModel::from_weights("weights", vnl);
    let file = DepthModel::from_vec("file.onnx", file).unwrap();
    let runtime = &runtimes()[0];
    let frame = noise_frame(96, 54);
    let depth = |model: &DepthModel, options: &DepthOptions, camera: Option<&CameraModel>| {
        DepthNet::new(model, runtime, options).unwrap().depth(&frame, camera).unwrap()
    };
    let small = DepthOptions { size: Some((64, 64)), ..Default::default() };
    let own = depth(&weights, &small, None);
    // 96x54 on 64x64: 64x36 between bars.
    assert_eq!((own.width(), own.height(), own.stamp()), (64, 36, Stamp::from_nanos(77)));
    assert_eq!(own.known_share(), 1.0);
    // The file written by us is the same network, and takes other sizes.
    assert_eq!(depth(&file, &DepthOptions::default(), None), own);
    let wide = DepthOptions { size: Some((96, 56)), detail: Detail::Full, ..Default::default() };
    assert_eq!(depth(&file, &wide, None), depth(&weights, &wide, None));
    for (output, size) in [(DepthSize::Frame, (96, 54)), (DepthSize::Fixed(10, 7), (10, 7))] {
        let map = depth(&weights, &DepthOptions { output, ..small.clone() }, None);
        assert_eq!((map.width(), map.height()), size);
        // The same depths, whatever the size.
        let mean =
            |map: &realnet_core::DepthMap| map.data().iter().sum::<f32>() / map.data().len() as f32;
        assert!((mean(&map) / mean(&own) - 1.0).abs() < 0.05, "{output:?}");
    }
    // Twice the focal length: twice as far. 96 pixels become 64.
    let camera = |focal: f64| {
        let intrinsics = Intrinsics { fx: focal, fy: focal, cx: 48.0, cy: 27.0 };
        CameraModel::new(96, 54, intrinsics, Distortion::None).unwrap()
    };
    let same = camera(519.0 * 96.0 / 64.0);
    let (worst, _) =
        relative(depth(&weights, &small, Some(&same)).into_data(), own.data().to_vec());
    assert!(worst < 1e-6, "{worst}");
    let double = camera(2.0 * 519.0 * 96.0 / 64.0);
    let twice = own.data().iter().map(|d| 2.0 * d);
    let (worst, _) = relative(depth(&weights, &small, Some(&double)).into_data(), twice);
    assert!(worst < 1e-5, "{worst}");
}

#[test]
fn memory_is_used_again() {
    let Some(weights) = weights() else { return };
    let model = DepthModel::from_weights("golden", Vnl::from_checkpoint(&weights).unwrap());
    let options = DepthOptions { size: Some((64, 64)), ..Default::default() };
    let mut net = DepthNet::new(&model, &runtimes()[0], &options).unwrap();
    let frame = noise_frame(64, 64);
    let first = net.depth(&frame, None).unwrap();
    let (copy, memory) = (first.clone(), first.into_data());
    let place = memory.as_ptr();
    let again = net.depth_marked(&frame, None, memory, &mut |_| {}).unwrap();
    assert_eq!(again, copy);
    assert_eq!(again.data().as_ptr(), place);
}

#[test]
fn other_cameras_and_files_are_refused() {
    let Some(weights) = weights() else { return };
    let vnl = Vnl::from_checkpoint(&weights).unwrap();
    let runtime = &runtimes()[0];
    let options = DepthOptions { size: Some((64, 64)), ..Default::default() };
    let model = DepthModel::from_weights("golden", vnl.clone());
    let mut net = DepthNet::new(&model, runtime, &options).unwrap();
    let intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 320.0, cy: 240.0 };
    let camera = CameraModel::new(640, 480, intrinsics, Distortion::None).unwrap();
    let error = net.depth(&noise_frame(64, 48), Some(&camera)).unwrap_err();
    assert!(matches!(error, DepthError::CameraSize { .. }), "{error}");
    assert!(error.to_string().contains("640x480"), "{error}");

    let empty = DepthOptions { output: DepthSize::Fixed(0, 4), ..options.clone() };
    assert!(matches!(DepthNet::new(&model, runtime, &empty), Err(DepthError::Map(_))));
    let odd = DepthOptions { size: Some((100, 64)), ..options };
    let error = DepthNet::new(&model, runtime, &odd).unwrap_err().to_string();
    assert!(error.contains("golden: input width 100") && error.contains("104"), "{error}");

    let onnx = vnl.to_onnx(&OnnxOptions { width: 64, height: 64, half: false }).unwrap();
    let file = OnnxModel::from_vec(onnx).unwrap();
    let change = |key: &str, value: &str| {
        let mut file = file.clone();
        file.set_metadata(key, value);
        DepthModel::from_vec("changed.onnx", file.to_bytes()).unwrap_err().to_string()
    };
    assert!(change("realnet_align", "left").contains("'corners' or 'centres'"));
    assert!(change("realnet_logits", "here,there").contains("'here,there'"));
    assert!(change("realnet_depth", "{}").contains("an object of"));
    assert!(change("stride", "0").contains("'stride'"));
    let text = r#"{"min":2,"max":1,"scale":1,"focal":1,"mean":[0,0,0],"std":[1,1,1]}"#;
    assert!(change("realnet_depth", text).contains("greater than min"));
    if let Some(yolo) = shared("models/yolov5n.pt") {
        let error = DepthModel::open(&yolo).unwrap_err();
        assert!(matches!(error, DepthModelError::Import { .. }), "{error}");
        assert!(error.to_string().contains("no depth network"), "{error}");
    }
    for (bytes, text) in [(&b""[..], "empty"), (b"\x08\x07", "graph"), (b"hello", "not a file")] {
        let error = DepthModel::from_vec("it", bytes.to_vec()).unwrap_err().to_string();
        assert!(error.starts_with("it: ") && error.contains(text), "{error}");
    }
}

#[test]
fn metadata_go_there_and_back() {
    let Some(weights) = weights() else { return };
    let coding =
        DepthCoding { focal: 357.3, max: 2.5, mean: [0.1, 0.2, 0.3], ..Default::default() };
    let vnl = Vnl::from_checkpoint(&weights).unwrap().with_coding(coding).unwrap();
    let onnx = vnl.to_onnx(&OnnxOptions { width: 64, height: 64, half: true }).unwrap();
    let file = OnnxModel::from_vec(onnx).unwrap();
    let metadata = DepthMetadata::from_onnx(&file).unwrap().unwrap();
    assert_eq!(metadata.coding, coding);
    assert_eq!(metadata.logits, ["logits", "logits_half"]);
    assert!(vnl.with_coding(DepthCoding { max: 0.0, ..coding }).is_err());
}

#[test]
fn weights_that_do_not_fit_name_the_tensor() {
    let Some(good) = weights() else { return };
    let vnl = Vnl::from_checkpoint(&good).unwrap();
    assert!(Vnl::recognises(&good));
    let refused = |change: &dyn Fn(&mut Checkpoint)| {
        let mut checkpoint = good.clone();
        change(&mut checkpoint);
        Vnl::from_checkpoint(&checkpoint).unwrap_err()
    };
    let conv = "decoder_modules.topdown_fcn2.ftb_block.conv3.weight";
    let error = refused(&|c| drop(c.tensors.remove(conv)));
    assert_eq!(error, TensorError::Missing { name: conv.to_owned() }.into());
    let error = refused(&|c| {
        c.tensors.insert(conv.to_owned(), Tensor::new(vec![64, 64], vec![0.0; 4096]).unwrap());
    });
    let VnlError::Tensor(TensorError::Shape { name, .. }) = &error else { panic!("{error}") };
    assert_eq!(name, conv);
    assert!(error.to_string().contains("[64, 64, 3, 3]"), "{error}");
    let variance = "encoder_modules.bottomup.res3.1.conv.4.running_var";
    for (value, text) in [(f32::NAN, "NaN or infinity"), (-1.0, "negative variance")] {
        let error = refused(&|c| {
            let n = c.tensors[variance].shape()[0];
            let tensor = Tensor::new(vec![n], vec![value; n]).unwrap();
            c.tensors.insert(variance.to_owned(), tensor);
        });
        assert!(error.to_string().contains(variance) && error.to_string().contains(text));
    }
    let extra = "encoder_modules.bottomup.res6.0.weight";
    let error = refused(&|c| {
        c.tensors.insert(extra.to_owned(), Tensor::new(vec![1], vec![0.0]).unwrap());
    });
    assert_eq!(error, TensorError::Surplus { name: extra.to_owned(), count: 1 }.into());
    // As the authors' checkpoints name them: the model is a part of another.
    let mut inner = good.clone();
    inner.tensors =
        good.tensors.iter().map(|(k, v)| (format!("depth_model.{k}"), v.clone())).collect();
    assert_eq!(Vnl::from_checkpoint(&inner).unwrap(), vnl);
}
