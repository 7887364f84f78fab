//! Small random networks of the authors' layout with a ResNeXt encoder: what is built from
//! them, and which error names what does not fit. (`realnet-train` compares the large ones with
//! the released code.)
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use realnet_nn::{
    depth::{DepthCoding, DepthModel, DepthWeights, Detail},
    engine::{EngineChoice, Runtime, RuntimeOptions},
    onnx::{Dim, OnnxOptions},
    vnl::{Vnl, VnlError},
    weights::{Checkpoint, Tensor, TensorError},
};

fn put(c: &mut Checkpoint, name: String, shape: &[usize]) {
    let mut state = name.bytes().fold(7u32, |h, b| h.wrapping_mul(31) ^ u32::from(b));
    let data = (0..shape.iter().product())
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let unit = (state >> 8) as f32 / (1 << 24) as f32;
            if name.ends_with("running_var") { 0.5 + unit } else { unit - 0.45 }
        })
        .collect();
    c.tensors.insert(name, Tensor::new(shape.to_vec(), data).unwrap());
}

fn norm(c: &mut Checkpoint, path: &str, channels: usize) {
    for part in ["weight", "bias", "running_mean", "running_var"] {
        put(c, format!("{path}.{part}"), &[channels]);
    }
}

fn transfer(c: &mut Checkpoint, path: &str, [input, out]: [usize; 2]) {
    put(c, format!("{path}.conv1.weight"), &[out, input, 1, 1]);
    put(c, format!("{path}.conv2.weight"), &[out, out, 3, 3]);
    put(c, format!("{path}.conv2.bias"), &[out]);
    norm(c, &format!("{path}.bn1"), out);
    put(c, format!("{path}.conv3.weight"), &[out, out, 3, 3]);
}

const BODY: &str = "encoder_modules.bottomup";
const TOP: &str = "encoder_modules.bottomup_top";

fn bottleneck(c: &mut Checkpoint, path: &str, [input, out]: [usize; 2]) {
    let inner = 64;
    for (part, shape) in
        [(1, [inner, input, 1, 1]), (2, [inner, inner / 32, 3, 3]), (3, [out, inner, 1, 1])]
    {
        put(c, format!("{path}.conv{part}.weight"), &shape);
        norm(c, &format!("{path}.bn{part}"), shape[0]);
    }
    if input != out {
        put(c, format!("{path}.shortcut.conv.weight"), &[out, input, 1, 1]);
        norm(c, &format!("{path}.shortcut.bn"), out);
    }
}

/// With so many blocks in the stages.
fn network(blocks: [usize; 4], bins: usize) -> Checkpoint {
    let c = &mut Checkpoint::default();
    put(c, format!("{BODY}.res1.conv1.weight"), &[4, 3, 7, 7]);
    norm(c, &format!("{BODY}.res1.bn1"), 4);
    let widths = [6, 7, 8, 9];
    let mut input = 4;
    for (stage, (width, blocks)) in widths.into_iter().zip(blocks).enumerate() {
        for block in 0..blocks {
            bottleneck(c, &format!("{BODY}.res{}.{block}", stage + 2), [input, width]);
            input = width;
        }
    }
    for (index, (from, to)) in widths.into_iter().rev().zip([16, 8, 8, 8]).enumerate() {
        let path = format!("encoder_modules.topdown_lateral_modules.{index}.lateral");
        transfer(c, &path, [from, to]);
    }
    for (name, kernel) in [("1x1", 1), ("3_1", 3), ("3_2", 3), ("3_3", 3)] {
        put(c, format!("{TOP}.aspp_conv{name}.weight"), &[16, 9, kernel, kernel]);
        norm(c, &format!("{TOP}.aspp_bn{name}"), 16);
    }
    put(c, format!("{TOP}.globalpool_conv1x1.weight"), &[16, 9, 1, 1]);
    norm(c, &format!("{TOP}.globalpool_bn"), 16);
    put(c, "decoder_modules.top.0.weight".into(), &[16, 80, 1, 1]);
    norm(c, "decoder_modules.top.1", 16);
    for (step, channels) in [(1, 16), (2, 8), (3, 8), (4, 8)] {
        let path = format!("decoder_modules.topdown_fcn{step}");
        let inner = channels / 8;
        put(c, format!("{path}.afa_block.conv1.weight"), &[inner, 2 * channels, 1, 1]);
        put(c, format!("{path}.afa_block.conv2.weight"), &[channels, inner, 1, 1]);
        transfer(c, &format!("{path}.ftb_block"), [channels, 8]);
    }
    transfer(c, "decoder_modules.topdown_fcn5.ftb", [8, 8]);
    put(c, "decoder_modules.topdown_predict.conv1.weight".into(), &[bins, 8, 3, 3]);
    put(c, "decoder_modules.topdown_predict.conv1.bias".into(), &[bins]);
    std::mem::take(c)
}

#[test]
fn any_number_of_blocks_is_built() {
    for (blocks, bins) in [([1, 1, 1, 1], 5), ([1, 2, 3, 2], 100)] {
        let weights = DepthWeights::from_checkpoint(&network(blocks, bins)).unwrap();
        assert_eq!((weights.architecture(), weights.default_size()), ("VNL", (384, 384)));
        // 100 bins are the authors' for KITTI.
        let coding = if bins == 100 { DepthCoding::KITTI } else { DepthCoding::default() };
        assert_eq!((weights.bins(), weights.coding()), (bins, &coding));
        let model = DepthModel::from_weights("small", weights);
        for (detail, [height, width]) in [(Detail::Full, [48, 64]), (Detail::Fast, [24, 32])] {
            let (network, metadata) = model.network(Some((64, 48)), detail).unwrap();
            assert_eq!((metadata.coding, metadata.stride), (coding, 16));
            let dims = [1, bins, height, width];
            assert_eq!(network.outputs()[0].dims, Some(dims.map(Dim::Fixed).to_vec()));
            let rten = RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() };
            let mut engine = Runtime::start(&rten).load(network).unwrap();
            engine.input().fill(0.5);
            let mut found: Vec<usize> = Vec::new();
            engine.run(&mut |outputs| found.extend(outputs[0].shape)).unwrap();
            assert_eq!(found, dims);
        }
        let error = model.network(Some((64, 40)), Detail::Fast).unwrap_err().to_string();
        assert!(error.contains("input height 40") && error.contains("48"), "{error}");
    }
}

fn refused(change: impl FnOnce(&mut Checkpoint)) -> TensorError {
    let mut checkpoint = network([1, 2, 1, 1], 5);
    change(&mut checkpoint);
    match Vnl::from_checkpoint(&checkpoint).unwrap_err() {
        VnlError::Tensor(error) => error,
        other => panic!("{other}"),
    }
}

#[test]
fn what_does_not_fit_is_named() {
    let around = format!("{BODY}.res4.0.shortcut.conv.weight");
    let missing = refused(|c| drop(c.tensors.remove(&around)));
    assert_eq!(missing, TensorError::Missing { name: around });
    let block = refused(|c| c.tensors.retain(|name, _| !name.contains(".res3.0.")));
    assert_eq!(block, TensorError::Missing { name: format!("{BODY}.res3.0.conv1.weight") });
    let surplus = refused(|c| put(c, format!("{BODY}.res2.2.conv1.weight"), &[1]));
    let name = format!("{BODY}.res2.2.conv1.weight");
    assert_eq!(surplus, TensorError::Surplus { name, count: 1 });

    for (name, found, expected) in [
        (format!("{BODY}.res1.conv1.weight"), &[4, 3, 3, 3][..], "[out, 3, 7, 7]"),
        (format!("{BODY}.res2.0.conv2.weight"), &[64, 4, 3, 3], "[64, 2, 3, 3]"),
        (format!("{BODY}.res3.0.shortcut.conv.weight"), &[7, 7, 1, 1], "[7, 6, 1, 1]"),
        (format!("{TOP}.aspp_conv3_2.weight"), &[8, 9, 3, 3], "[16, 9, 3, 3]"),
        (format!("{TOP}.globalpool_conv1x1.weight"), &[8, 9, 1, 1], "[16, 9, 1, 1]"),
        ("decoder_modules.top.0.weight".to_owned(), &[16, 64, 1, 1], "[out, 80, 1, 1]"),
    ] {
        let error = refused(|c| put(c, name.clone(), found));
        let (expected, found) = (expected.to_owned(), found.to_vec());
        assert_eq!(error, TensorError::Shape { name, expected, found });
    }
    // 32 groups do not divide 40 channels.
    let error = refused(|c| {
        put(c, format!("{BODY}.res2.0.conv1.weight"), &[40, 4, 1, 1]);
        norm(c, &format!("{BODY}.res2.0.bn1"), 40);
    });
    let name = format!("{BODY}.res2.0.conv1.weight");
    let expected = "[a multiple of 32, 4, 1, 1]".to_owned();
    assert_eq!(error, TensorError::Shape { name, expected, found: vec![40, 4, 1, 1] });
}

#[test]
fn half_storage_and_sizes_are_checked() {
    let vnl = Vnl::from_checkpoint(&network([1, 1, 1, 1], 5)).unwrap();
    assert_eq!(vnl.max_stride(), 16);
    let size = OnnxOptions { width: 32, height: 16, half: false };
    let [full, half] =
        [false, true].map(|half| vnl.to_onnx(&OnnxOptions { half, ..size }).unwrap().len());
    assert!(half < full, "{half} {full}");
    assert!(vnl.to_onnx(&OnnxOptions { width: 8, ..size }).is_err());
}
