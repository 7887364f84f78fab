//! Model files that are damaged, hostile or something else.

use crate::{
    cases::{Bench, Case, run},
    common::{listing, shared, tiny},
    pt::{Pickle, archive, stored, stream},
};
use prost::Message;
use realnet::onnx::proto::{StringStringEntryProto, TensorProto};
use zip::CompressionMethod;

/// Cases of files that hold weights, for `detect` and `convert` alike.
fn weights(marker: &str) -> Vec<(&'static str, Vec<u8>, Vec<&'static str>)> {
    let good = stored(&Pickle::one_tensor("w", 4, &[4], &[1]));
    let max = i32::MAX;
    let mut nest = Pickle::new().raw(b")");
    nest.0.extend(std::iter::repeat_n(0x85, 1_000_000));
    let own = Pickle::new().raw(b"}q\x00").text("model").raw(b"h\x00s").stop();
    let module = Pickle::new().global("torch.nn", "Module").raw(b")\x81q\x00}(");
    let child = module.text("_modules").raw(b"}").text("m").raw(b"h\x00sub").stop();
    let call = Pickle::new().global("os", "system").text(&format!("touch {marker}"));
    let safe = |header: &str, length: u64, data: usize| {
        let mut bytes = length.to_le_bytes().to_vec();
        bytes.extend_from_slice(header.as_bytes());
        bytes.resize(bytes.len() + data, 0);
        bytes
    };
    let header = r#"{"w":{"dtype":"F32","shape":[4],"data_offsets":[0,16]}}"#;
    let length = header.len() as u64;
    vec![
        ("a file without bytes", vec![], vec!["is empty"]),
        ("bytes of nothing known", vec![7; 4096], vec!["not a file of weights", "unknown first"]),
        ("a few words of text", b"hello".to_vec(), vec!["too short"]),
        ("half an archive", good[..good.len() / 2].to_vec(), vec!["damaged PyTorch archive"]),
        ("an archive without its end", good[..good.len() - 30].to_vec(), vec!["damaged"]),
        ("half a pickle", stored(b"\x80\x02}X\x05\x00\x00"), vec!["more bytes were expected"]),
        (
            "a string of 4 GB in 40 bytes",
            stored(b"\x80\x02X\xff\xff\xff\xff."),
            vec!["more bytes were expected"],
        ),
        (
            "a tensor of 10^18 numbers",
            stored(&Pickle::one_tensor("w", 4, &[max, max], &[0, 0])),
            vec!["refused: w"],
        ),
        (
            "a tensor beyond its storage",
            stored(&Pickle::one_tensor("head.bias", 4, &[5], &[1])),
            vec!["head.bias", "storage holds 4"],
        ),
        (
            "an archive that unpacks to 200 MB",
            archive(
                &Pickle::one_tensor("w", 50 << 20, &[1], &[1]),
                &vec![0; 200 << 20],
                CompressionMethod::Deflated,
            ),
            vec!["would take more than"],
        ),
        ("a million tuples inside each other", stored(&nest.stop()), vec!["its root is a tuple"]),
        ("a hundred thousand open marks", stored(&[b'('; 100_000]), vec!["marks"]),
        ("a dictionary that holds itself", stored(&own), vec!["the keys are [model]"]),
        ("a module that is its own child", stored(&child), vec!["nested deeper"]),
        ("a call of os.system", stored(&call.raw(b"\x85R").stop()), vec!["an object of os.system"]),
        (
            "weights of another network",
            stored(&Pickle::one_tensor("encoder.weight", 4, &[4], &[1])),
            vec!["no YOLOv5 network", "'encoder.weight'"],
        ),
        ("an old stream that announces 2^64 numbers", stream(u64::MAX), vec!["announces 1844674"]),
        ("half an old stream", stream(4)[..60].to_vec(), vec!["bytes were expected"]),
        ("half a safetensors file", safe(header, length, 8), vec!["damaged safetensors"]),
        (
            "a safetensors header of 2^64 bytes",
            safe(header, u64::MAX, 16),
            vec!["damaged safetensors"],
        ),
        (
            "safetensors of another network",
            safe(header, length, 16),
            vec!["no YOLOv5 network", "'w'"],
        ),
    ]
}

#[test]
fn weights_that_are_none_are_named() {
    let bench = Bench::new();
    std::fs::create_dir(bench.path("files")).unwrap();
    let marker = bench.text("executed");
    let mut cases = Vec::new();
    for (index, (what, bytes, says)) in (0..).zip(weights(&marker)) {
        let file = bench.write(&format!("files/{index}.pt"), bytes);
        let says = [&[file.as_str()], &says[..]].concat();
        let picture = bench.text("good.png");
        cases.push(Case::new(what, bench.detect(&file, &picture, &[]), 2, &says));
        let convert = ["convert", &file, "-o", &bench.text("files/out.onnx")];
        cases.push(Case::new(what, convert, 2, &says));
    }
    let count = cases.len() / 2;
    run(cases);
    assert!(!bench.path("executed").exists(), "a checkpoint ran a command");
    assert_eq!(listing(&bench.path("files")).len(), count, "a failed conversion left a file");
}

#[test]
fn a_real_checkpoint_cut_short_is_damaged() {
    let Some(model) = shared("models/yolov5n.pt") else { return };
    let bench = Bench::new();
    let bytes = std::fs::read(model).unwrap();
    let cases = [1000, bytes.len() / 2, bytes.len() - 1000].map(|length| {
        let file = bench.write(&format!("{length}.pt"), &bytes[..length]);
        let args = bench.detect(&file, &bench.text("good.png"), &[]);
        Case::new("a download that broke off", args, 2, &[&file, "damaged PyTorch archive"])
    });
    run(cases.into());
}

#[test]
fn models_that_are_not_there_are_named() {
    let bench = Bench::new();
    let picture = bench.text("good.png");
    let absent = bench.text("absent.pt");
    std::fs::create_dir(bench.path("folder")).unwrap();
    let folder = bench.text("folder");
    let lfs = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n";
    let pointer = bench.write("pointer.pt", lfs);
    let cases = vec![
        Case::new("no such model", bench.detect(&absent, &picture, &[]), 2, &[&absent, "No such"]),
        Case::new("a folder", bench.detect(&folder, &picture, &[]), 2, &[&folder, "directory"]),
        Case::new(
            "a picture",
            bench.detect(&picture, &picture, &[]),
            2,
            &["not a file of weights"],
        ),
        Case::new("a pointer of Git LFS", bench.detect(&pointer, &picture, &[]), 2, &[&pointer]),
        Case::new("nothing to convert", ["convert", &absent], 2, &[&absent, "No such"]),
        Case::new(
            "ONNX to convert",
            ["convert", &bench.text("good.onnx"), "-o", &bench.text("o.onnx")],
            2,
            &["good.onnx"],
        ),
    ];
    run(cases);
}

#[test]
fn onnx_files_that_are_no_detector_are_named() {
    let bench = Bench::new();
    let picture = bench.text("good.png");
    let output = |dims: &'static [i64]| {
        tiny::changed(|graph| graph.output = vec![tiny::value_info("output0", dims)])
    };
    let input = |dims: &'static [i64]| {
        tiny::changed(|graph| graph.input = vec![tiny::value_info("images", dims)])
    };
    let mut noise = tiny::bytes();
    noise.iter_mut().zip(0u32..).for_each(|(byte, at)| *byte = (at * 151 % 251) as u8);
    let elsewhere = TensorProto {
        external_data: vec![StringStringEntryProto {
            key: "location".to_owned(),
            value: "weights.bin".to_owned(),
        }],
        data_location: Some(1),
        ..tiny::constant("class", &[1, 1, 1], &[])
    };
    let mut outside = tiny::proto();
    if let Some(graph) = &mut outside.graph {
        graph.initializer[1] = elsewhere;
    }
    let mut names = tiny::proto();
    names.metadata_props[0].value = "{0: 'a', 1: 'b', 2: 'c'}".to_owned();
    if let Some(graph) = &mut names.graph {
        graph.output = vec![tiny::value_info("output0", &[1, 100, 6])];
    }
    let table: Vec<(&str, Vec<u8>, i32, &[&str])> = vec![
        ("random bytes", noise, 2, &["not an ONNX file"]),
        ("no bytes", vec![], 2, &["empty"]),
        ("a version and nothing else", b"\x08\x07".to_vec(), 2, &["no graph"]),
        (
            "half a file",
            tiny::bytes()[..tiny::bytes().len() / 2].to_vec(),
            2,
            &["not an ONNX file"],
        ),
        ("a classifier", output(&[1, 1000]), 2, &["'output0'", "[1, 1000]", "1xNx(5+C)"]),
        ("too few values a box", output(&[1, 100, 4]), 2, &["[1, 100, 4]", "4 values a box"]),
        (
            "more names than classes",
            names.encode_to_vec(),
            2,
            &["6 values a box, 8 are needed for 3 classes"],
        ),
        ("one channel", input(&[1, 1, 64, 64]), 2, &[".onnx: ", "1x3xHxW", "[1, 1, 64, 64]"]),
        ("an input of rank 2", input(&[1, 12288]), 2, &["[1, 12288]"]),
        (
            "two inputs",
            tiny::changed(|graph| {
                graph.initializer.pop();
                graph.input.push(tiny::value_info("class", &[1, 1, 1]));
            }),
            2,
            &["'images'", "'class'"],
        ),
        (
            "an operation that nobody knows",
            tiny::changed(|graph| graph.node[0].op_type = "Frobnicate".to_owned()),
            2,
            &["rten cannot load the network", "Frobnicate"],
        ),
        (
            "a node without its input",
            tiny::changed(|graph| graph.node[0].input[0] = "nothing".to_owned()),
            2,
            &[".onnx: ", "1x3xHxW", "found none"],
        ),
        (
            "another shape than promised",
            tiny::changed(|graph| {
                graph.initializer[1] = tiny::constant("class", &[1, 1, 2], &[1.0; 2]);
            }),
            1,
            &["network output 'output0' must have shape", "1 classes, found [1, 1, 7]"],
        ),
    ];
    let mut cases = Vec::new();
    for (index, (what, bytes, code, says)) in (0..).zip(table) {
        let file = bench.write(&format!("bad{index}.onnx"), bytes);
        cases.push(Case::new(what, bench.detect(&file, &picture, &[]), code, says));
    }
    let file = bench.write("outside.onnx", outside.encode_to_vec());
    let args = bench.detect(&file, &picture, &[]);
    let says = ["'class'", "weights.bin", "single file"];
    cases.push(Case::new("weights in another file", args, 2, &says));
    run(cases);
}
