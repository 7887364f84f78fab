//! Small random `vnl-lite` networks: what is built from them, what the file gives, and which
//! error names what does not fit.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use realnet_core::{Frame, Stamp};
use realnet_nn::{
    depth::{
        Alignment, DepthCoding, DepthMetadata, DepthModel, DepthModelError, DepthNet, DepthOptions,
        DepthSize, DepthWeights, SoftSum,
    },
    engine::{EngineChoice, Runtime, RuntimeOptions},
    onnx::{Dim, OnnxModel, OnnxOptions},
    vnl_lite::{VnlLite, VnlLiteError},
    weights::{Checkpoint, Tensor, TensorError},
};

const CODING: DepthCoding = DepthCoding {
    min: 0.25,
    max: 12.1,
    scale: 1.0,
    focal: 207.6,
    mean: [0.4, 0.5, 0.45],
    std: [0.25, 0.2, 0.21],
};

fn put(c: &mut Checkpoint, name: String, shape: &[usize]) {
    let mut state = name.bytes().fold(7u32, |h, b| h.wrapping_mul(31) ^ u32::from(b));
    let data = (0..shape.iter().product())
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let unit = (state >> 8) as f32 / (1 << 24) as f32;
            if name.ends_with("running_var") { 0.3 + unit } else { unit - 0.4 }
        })
        .collect();
    c.tensors.insert(name, Tensor::new(shape.to_vec(), data).unwrap());
}

fn block(c: &mut Checkpoint, path: &str, [input, out]: [usize; 2], kernel: usize) {
    put(c, format!("{path}.conv.weight"), &[out, input, kernel, kernel]);
    for part in ["weight", "bias", "running_mean", "running_var"] {
        put(c, format!("{path}.bn.{part}"), &[out]);
    }
}

/// Every stage has its own width and number of blocks.
fn network() -> Checkpoint {
    let c = &mut Checkpoint { depth: Some(CODING), bn_eps: Some(2e-5), ..Default::default() };
    block(c, "stem", [3, 4], 3);
    let mut input = 4;
    for (stage, (width, blocks)) in [(5, 1), (6, 2), (7, 1), (8, 3)].into_iter().enumerate() {
        for index in 0..blocks {
            let path = format!("stages.{stage}.{index}");
            block(c, &format!("{path}.c1"), [input, width], 3);
            block(c, &format!("{path}.c2"), [width, width], 3);
            if index == 0 {
                block(c, &format!("{path}.around"), [input, width], 1);
            }
            input = width;
        }
    }
    for (index, step) in [[8, 7], [7, 6], [6, 9]].into_iter().enumerate() {
        block(c, &format!("reduce.{index}"), step, 1);
        block(c, &format!("merge.{index}"), [step[1]; 2], 3);
    }
    block(c, "skip", [5, 9], 1);
    put(c, "head.weight".into(), &[11, 9, 3, 3]);
    put(c, "head.bias".into(), &[11]);
    std::mem::take(c)
}

fn rten() -> Runtime {
    Runtime::start(&RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() })
}

/// The only output for an input of waves.
fn run(model: OnnxModel) -> (Vec<usize>, Vec<f32>) {
    let mut engine = rten().load(model).unwrap();
    for (i, value) in engine.input().iter_mut().enumerate() {
        *value = (i as f32 * 0.37).sin() * 2.0;
    }
    let mut result = None;
    engine
        .run(&mut |outputs| {
            assert_eq!(outputs.len(), 1);
            result = Some((outputs[0].shape.to_vec(), outputs[0].data.to_vec()));
        })
        .unwrap();
    result.unwrap()
}

#[test]
fn all_numbers_come_from_the_shapes() {
    let checkpoint = network();
    assert!(VnlLite::recognises(&checkpoint) && DepthWeights::recognises(&checkpoint));
    let net = VnlLite::from_checkpoint(&checkpoint).unwrap();
    assert_eq!((net.bins(), net.max_stride(), net.coding()), (11, 32, &CODING));
    let folded = |name: &str| name.ends_with(".running_mean") || name.ends_with(".running_var");
    let scales = |name: &str| name.ends_with(".bn.weight");
    let weights = checkpoint.tensors.iter().filter(|(name, _)| !folded(name) && !scales(name));
    assert_eq!(net.parameters(), weights.map(|(_, tensor)| tensor.data().len()).sum::<usize>());

    let weights = DepthWeights::from_checkpoint(&checkpoint).unwrap();
    assert_eq!((weights.architecture(), weights.default_size()), ("vnl-lite", (256, 192)));
    assert_eq!((weights.bins(), weights.coding()), (11, &CODING));
    let model = DepthModel::from_weights("small", weights);
    let (network, metadata) = model.network(None, Default::default()).unwrap();
    let expected = DepthMetadata {
        coding: CODING,
        logits: vec!["logits".to_owned()],
        alignment: Alignment::Centres,
        stride: 32,
    };
    assert_eq!(metadata, expected);
    assert_eq!(network.inputs()[0].dims, Some([1, 3, 192, 256].map(Dim::Fixed).to_vec()));
    assert_eq!(network.outputs()[0].dims, Some([1, 11, 48, 64].map(Dim::Fixed).to_vec()));
}

/// What the file gives to others is what we make of its logits: depth at every fourth pixel,
/// bilinear between the centres of these cells.
#[test]
fn depth_of_the_file_is_that_of_its_logits() {
    let net = VnlLite::from_checkpoint(&network()).unwrap();
    let (width, height) = (96, 64);
    let size = OnnxOptions { width, height, half: false };
    let file = OnnxModel::from_vec(net.to_onnx(&size).unwrap()).unwrap();
    let (shape, depth) = run(file.clone());
    assert_eq!(shape, [1, 1, height, width]);
    let mut cut = file;
    cut.keep_outputs(&["logits"]).unwrap();
    assert!(!cut.has_tensor("depth"));
    let (shape, logits) = run(cut);
    let (columns, rows) = (width / 4, height / 4);
    assert_eq!(shape, [1, 11, rows, columns]);
    let mut samples = vec![0.0; rows * columns];
    SoftSum::new(&CODING, 11).run(&logits, 1.0, &mut samples);
    let [least, most] = samples.iter().fold([f32::MAX, 0.0], |[a, b], s| [a.min(*s), b.max(*s)]);
    assert!(most > 1.05 * least, "{least} to {most}");
    // The samples beside a pixel, and the share of the second.
    let between = |pixel: usize, samples: usize| {
        let at = ((pixel as f32 + 0.5) / 4.0 - 0.5).clamp(0.0, (samples - 1) as f32);
        (at as usize, (at as usize + 1).min(samples - 1), at.fract())
    };
    for (index, found) in depth.iter().enumerate() {
        let (top, bottom, down) = between(index / width, rows);
        let (left, right, across) = between(index % width, columns);
        let row = |row: usize| {
            samples[row * columns + left] * (1.0 - across) + samples[row * columns + right] * across
        };
        let expected = row(top) * (1.0 - down) + row(bottom) * down;
        assert!((found / expected - 1.0).abs() < 1e-4, "{index}: {found} {expected}");
    }
}

#[test]
fn half_storage_is_half_and_close() {
    let net = VnlLite::from_checkpoint(&network()).unwrap();
    let size = OnnxOptions { width: 64, height: 64, half: false };
    let files = [false, true].map(|half| net.to_onnx(&OnnxOptions { half, ..size }).unwrap());
    // Two bytes a weight, less the nodes that widen them, which count in so small a network.
    let saved = files[0].len() - files[1].len();
    assert!(saved > net.parameters(), "{saved} of {}", files[0].len());
    let [full, half] = files.map(|file| run(OnnxModel::from_vec(file).unwrap()).1);
    assert_ne!(full, half);
    for (a, b) in full.iter().zip(&half) {
        assert!((a / b - 1.0).abs() < 0.02, "{a} {b}");
    }
}

/// Wide pictures on a wide input: bars above and below, samples at every fourth pixel.
#[test]
fn frames_become_maps() {
    let model = DepthModel::from_weights("small", VnlLite::from_checkpoint(&network()).unwrap());
    let data = (0..160 * 90 * 3).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8);
    let frame = Frame::rgb8(Stamp::from_nanos(5), 160, 90, data.collect()).unwrap();
    let options = |output| DepthOptions { size: Some((128, 96)), output, ..Default::default() };
    for (output, size) in [(DepthSize::Network, (128, 72)), (DepthSize::Frame, (160, 90))] {
        let mut net = DepthNet::new(&model, &rten(), &options(output)).unwrap();
        let map = net.depth(&frame, None).unwrap();
        assert_eq!((map.width(), map.height(), map.known_share()), (size.0, size.1, 1.0));
    }
    let odd = DepthOptions { size: Some((256, 200)), ..Default::default() };
    let error = DepthNet::new(&model, &rten(), &odd).unwrap_err().to_string();
    assert!(error.contains("input height 200") && error.contains("224"), "{error}");
}

fn refused(change: impl FnOnce(&mut Checkpoint)) -> VnlLiteError {
    let mut checkpoint = network();
    change(&mut checkpoint);
    VnlLite::from_checkpoint(&checkpoint).unwrap_err()
}

fn shape(name: &str, expected: &str, found: &[usize]) -> VnlLiteError {
    let (name, expected, found) = (name.to_owned(), expected.to_owned(), found.to_vec());
    TensorError::Shape { name, expected, found }.into()
}

#[test]
fn what_does_not_fit_is_named() {
    let name = "stages.3.1.c2.bn.running_var".to_owned();
    let missing = refused(|c| drop(c.tensors.remove(&name)));
    assert_eq!(missing, TensorError::Missing { name: name.clone() }.into());
    let nan = Tensor::new(vec![8], vec![f32::NAN; 8]).unwrap();
    let error = refused(|c| drop(c.tensors.insert(name.clone(), nan)));
    assert_eq!(error.to_string(), format!("tensor '{name}' holds NaN or infinity"));
    // A gap in the blocks leaves the ones behind it over.
    let error = refused(|c| c.tensors.retain(|name, _| !name.starts_with("stages.3.1.")));
    let first = "stages.3.2.c1.bn.bias".to_owned();
    assert_eq!(error, TensorError::Surplus { name: first, count: 10 }.into());
    let error = refused(|c| block(c, "stages.4.0.c1", [8, 8], 3));
    assert!(error.to_string().contains("5 tensors belong to no layer"), "{error}");
    // Later blocks have nothing around them.
    let error = refused(|c| block(c, "stages.1.1.around", [6, 6], 1));
    assert!(error.to_string().contains("stages.1.1.around.bn.bias"), "{error}");

    for (name, found, expected) in [
        ("stem.conv.weight", &[4, 1, 3, 3][..], "[out, 3, 3, 3]"),
        ("stem.conv.weight", &[4, 3, 3], "[out, 3, 3, 3]"),
        ("stem.conv.weight", &[0, 3, 3, 3], "[out, 3, 3, 3]"),
        ("stages.0.0.c1.conv.weight", &[5, 4, 1, 1], "[out, 4, 3, 3]"),
        ("stages.2.0.c2.conv.weight", &[6, 7, 3, 3], "[7, 7, 3, 3]"),
        ("stages.2.0.around.conv.weight", &[6, 6, 1, 1], "[7, 6, 1, 1]"),
        ("reduce.0.conv.weight", &[9, 8, 1, 1], "[7, 8, 1, 1]"),
        ("merge.2.conv.weight", &[5, 9, 3, 3], "[9, 9, 3, 3]"),
        ("skip.conv.weight", &[8, 5, 1, 1], "[9, 5, 1, 1]"),
        ("head.weight", &[0, 9, 3, 3], "[out, 9, 3, 3]"),
        ("head.weight", &[], "[out, 9, 3, 3]"),
        ("head.bias", &[12], "[11]"),
    ] {
        let error = refused(|c| put(c, name.to_owned(), found));
        assert_eq!(error, shape(name, expected, found));
    }
    let error = refused(|c| c.bn_eps = Some(f64::NAN));
    assert!(error.to_string().contains("NaN or infinity after folding"), "{error}");
}

#[test]
fn a_coding_is_needed() {
    assert_eq!(refused(|c| c.depth = None), VnlLiteError::NoCoding);
    let error = refused(|c| c.depth = Some(DepthCoding { focal: f64::NAN, ..CODING }));
    assert!(matches!(error, VnlLiteError::Coding(_)), "{error}");
}

#[test]
fn other_weights_are_no_depth_network() {
    let mut other = Checkpoint::default();
    put(&mut other, "model.0.conv.weight".into(), &[4, 3, 6, 6]);
    assert!(!DepthWeights::recognises(&other));
    let error = VnlLite::from_checkpoint(&other).unwrap_err();
    assert!(matches!(error, VnlLiteError::NotVnlLite { tensors: 1, .. }), "{error}");
    let error = DepthWeights::from_checkpoint(&other).unwrap_err().to_string();
    assert!(error.contains("vnl-lite") && error.contains("'model.0.conv.weight'"), "{error}");
}

/// A safetensors file with one tensor and these metadata.
fn safetensors(metadata: &str) -> Vec<u8> {
    let tensor = r#""stem.conv.weight":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}"#;
    let header = format!("{{\"__metadata__\":{{{metadata}}},{tensor}}}");
    let mut file = (header.len() as u64).to_le_bytes().to_vec();
    file.extend(header.as_bytes());
    file.extend(1.0f32.to_le_bytes());
    file
}

#[test]
fn safetensors_tell_the_coding() {
    let quoted = |text: &str| format!("\"realnet_depth\":{}", serde_json::json!(text));
    let read = |metadata: &str| Checkpoint::from_bytes(&safetensors(metadata));
    assert_eq!(read(&quoted(&CODING.to_json())).unwrap().depth, Some(CODING));
    assert_eq!(read("").unwrap().depth, None);
    for (text, part) in [
        ("{}", "an object of min, max"),
        ("no json", "an object of min, max"),
        (&CODING.to_json().replace("12.1", "0.1"), "greater than min"),
    ] {
        let error = read(&quoted(text)).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    // And the way to the model.
    let error = DepthModel::from_vec("it", safetensors(&quoted("{}"))).unwrap_err();
    assert!(matches!(error, DepthModelError::Weights { .. }), "{error}");
}
