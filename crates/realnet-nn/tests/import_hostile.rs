//! Damaged and malicious files: each gives an error with a clear text, and
//! nothing in them is executed or believed.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use std::collections::BTreeMap;
use std::io::{Cursor, Write};

use realnet_nn::onnx::OnnxModel;
use realnet_nn::weights::{Checkpoint, Tensor};
use realnet_nn::yolov5::YoloV5;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Writes pickles of protocol 2 by hand.
#[derive(Clone, Default)]
struct Pickler(Vec<u8>);

impl Pickler {
    fn new() -> Self {
        Pickler(vec![0x80, 2])
    }
    fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }
    fn text(self, text: &str) -> Self {
        let len = u32::try_from(text.len()).unwrap().to_le_bytes();
        self.raw(b"X").raw(&len).raw(text.as_bytes())
    }
    fn global(self, module: &str, name: &str) -> Self {
        self.raw(format!("c{module}\n{name}\n").as_bytes())
    }
    fn int(self, n: i32) -> Self {
        self.raw(b"J").raw(&n.to_le_bytes())
    }
    /// A tensor over storage `key` of `count` floats.
    fn tensor(self, key: &str, count: i32, offset: i32, shape: &[i32], stride: &[i32]) -> Self {
        let tuple =
            |p: Self, items: &[i32]| items.iter().fold(p.raw(b"("), |p, &n| p.int(n)).raw(b"t");
        let p = self.global("torch._utils", "_rebuild_tensor_v2").raw(b"((");
        let p = p.text("storage").global("torch", "FloatStorage").text(key).text("cpu");
        let p = p.int(count).raw(b"tQ").int(offset);
        tuple(tuple(p, shape), stride).raw(b"\x89}tR")
    }
    fn stop(self) -> Vec<u8> {
        self.raw(b".").0
    }
}

/// A flat dictionary with one tensor under the name `w`.
fn one_tensor(count: i32, offset: i32, shape: &[i32], stride: &[i32]) -> Vec<u8> {
    Pickler::new().raw(b"}").text("w").tensor("0", count, offset, shape, stride).raw(b"s").stop()
}

fn archive(pickle: &[u8], storages: &[(&str, &[u8])], method: CompressionMethod) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(method);
    zip.start_file("archive/data.pkl", options).unwrap();
    zip.write_all(pickle).unwrap();
    for (key, bytes) in storages {
        zip.start_file(format!("archive/data/{key}"), options).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn stored(pickle: &[u8]) -> Vec<u8> {
    archive(pickle, &[("0", &[0; 16])], CompressionMethod::Stored)
}

fn error(bytes: &[u8]) -> String {
    Checkpoint::from_bytes(bytes).unwrap_err().to_string()
}

fn refused(bytes: &[u8], part: &str) {
    let text = error(bytes);
    assert!(text.contains(part), "'{part}' is not in '{text}'");
}

#[test]
fn a_good_tensor_is_read() {
    let floats: Vec<u8> = [1.0f32, 2.0, 3.0, 4.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let pickle = one_tensor(4, 0, &[2, 2], &[1, 2]);
    for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        let file = archive(&pickle, &[("0", &floats)], method);
        let tensor = Checkpoint::from_bytes(&file).unwrap().tensors.remove("w").unwrap();
        assert_eq!((tensor.shape(), tensor.data()), (&[2, 2][..], &[1.0, 3.0, 2.0, 4.0][..]));
    }
}

#[test]
fn tensors_outside_their_storage_are_refused() {
    refused(&stored(&one_tensor(4, 0, &[5], &[1])), "storage holds 4");
    refused(&stored(&one_tensor(4, 1, &[4], &[1])), "storage holds 4");
    refused(&stored(&one_tensor(4, 0, &[2, 2], &[3, 1])), "storage holds 4");
    refused(&stored(&one_tensor(4, -1, &[1], &[1])), "offset is negative");
    refused(&stored(&one_tensor(4, 0, &[-4], &[1])), "shape holds a negative");
    refused(&stored(&one_tensor(4, 0, &[2], &[-1])), "strides holds a negative");
    refused(&stored(&one_tensor(4, 0, &[2, 2], &[1])), "differ in length");
    refused(&stored(&one_tensor(-4, 0, &[1], &[1])), "no length");
    refused(&stored(&one_tensor(2, 0, &[1], &[1])), "16 bytes; at most 8");
    refused(&stored(&one_tensor(4, 0, &[1; 40], &[1; 40])), "at most 16");
}

#[test]
fn huge_tensors_are_refused_before_they_are_made() {
    // Stride 0 would turn 4 floats into 10¹⁸.
    let max = i32::MAX;
    refused(&stored(&one_tensor(4, 0, &[max, max], &[0, 0])), "refused: w");
    refused(&stored(&one_tensor(4, 0, &[max, max, max], &[0, 0, 0])), "too large");
    // Many small views of one storage add up to too much as well.
    let mut pickle = Pickler::new().raw(b"}(");
    for i in 0..200 {
        pickle = pickle.text(&format!("w{i}")).tensor("0", 4, 0, &[1 << 20], &[0]);
    }
    refused(&stored(&pickle.raw(b"u").stop()), "too much for a file of");
}

#[test]
fn zip_bombs_are_refused() {
    let zeros = vec![0u8; 200 << 20];
    let file = archive(
        &one_tensor(50 << 20, 0, &[1], &[1]),
        &[("0", &zeros)],
        CompressionMethod::Deflated,
    );
    assert!(file.len() < 1 << 20, "{}", file.len());
    refused(&file, "archive/data/0 would take more than");
    let bomb = archive(&zeros, &[], CompressionMethod::Deflated);
    refused(&bomb, "at most 67108864 are expected");
}

#[test]
fn foreign_calls_stay_inert() {
    let marker = std::env::temp_dir().join(format!("realnet-inert-{}", std::process::id()));
    let command = format!("touch {}", marker.display());
    for (module, name) in [("os", "system"), ("posix", "system"), ("builtins", "exec")] {
        let call = Pickler::new().global(module, name).text(&command).raw(b"\x85R").stop();
        refused(&stored(&call), &format!("an object of {module}.{name}"));
    }
    // Beside a good tensor the call is just a value that is no tensor.
    let pickle = Pickler::new().raw(b"}(").text("evil").global("os", "system").text(&command);
    let pickle = pickle.raw(b"\x85R").text("w").tensor("0", 4, 0, &[4], &[1]).raw(b"u").stop();
    let checkpoint = Checkpoint::from_bytes(&stored(&pickle)).unwrap();
    assert_eq!(checkpoint.tensors.keys().collect::<Vec<_>>(), ["w"]);
    assert!(!marker.exists());
}

#[test]
fn recursive_and_deep_pickles_end() {
    // A dictionary that is its own 'model'.
    let own = Pickler::new().raw(b"}q\x00").text("model").raw(b"h\x00s").stop();
    refused(&stored(&own), "the keys are [model]");
    // A module that is its own child.
    let module = Pickler::new().global("torch.nn", "Module").raw(b")\x81q\x00}(");
    let module = module.text("_modules").raw(b"}").text("m").raw(b"h\x00sub").stop();
    refused(&stored(&module), "nested deeper");
    // Two children that are one: 2^60 paths, walked to the limit only.
    let mut twins = Pickler::new().raw(b"N0");
    twins = twins.global("torch.nn", "Module").raw(b")\x81}").text("_modules").raw(b"}sbq\x00");
    for _ in 0..60 {
        twins = twins.raw(b"0").global("torch.nn", "Module").raw(b")\x81}").text("_modules");
        twins = twins.raw(b"}(").text("a").raw(b"h\x00").text("b").raw(b"h\x00usbq\x00");
    }
    refused(&stored(&twins.stop()), "nested deeper");
    // A million tuples inside each other must not overflow the stack, on drop either.
    let mut nest = Pickler::new().raw(b")");
    nest.0.extend(std::iter::repeat_n(0x85, 1_000_000));
    refused(&stored(&nest.stop()), "its root is a tuple");
    refused(&stored(&Pickler::new().raw(&[b'('; 100_000]).stop()), "open marks");
}

#[test]
fn damaged_pickles_are_named() {
    for (bytes, part) in [
        (&b"\x80\x02"[..], "1 more bytes"),
        (b"\x80\x09.", "protocol 9"),
        (b".", "stack is empty"),
        (b"R.", "stack is empty"),
        (b"(0t.", "stack is empty"),
        (b"h\x07.", "memo entry 7"),
        (b"Nr\xff\xff\xff\xff.", "memo entries"),
        (b"X\xff\xff\xff\xff.", "more bytes were expected"),
        (b"\x8d\xff\xff\xff\xff\xff\xff\xff\xff.", "more bytes were expected"),
        (b"\x8e\xff\xff\xff\xff\xff\xff\xff\x7f.", "more bytes were expected"),
        (b"\x8b\xff\xff\xff\xff.", "more bytes were expected"),
        (b"\x82\x01.", "registered extensions"),
        (b"\x97.", "buffers outside"),
        (b"\xff.", "unknown operation"),
        (b"Ixyz\n.", "bad integer"),
        (b"}(Nu.", "odd number"),
        (b"NNa.", "list to append to"),
        (b"NNNs.", "dictionary to add to"),
        (b"cos\n", "more bytes"),
        (b"c\xff\xfe\nx\n.", "not UTF-8"),
    ] {
        refused(&stored(bytes), part);
    }
}

#[test]
fn every_truncation_is_an_error() {
    let good =
        archive(&one_tensor(4, 0, &[4], &[1]), &[("0", &[0; 16])], CompressionMethod::Stored);
    for len in 0..good.len() {
        assert!(Checkpoint::from_bytes(&good[..len]).is_err(), "{len}");
    }
    let pickle = one_tensor(4, 0, &[4], &[1]);
    for len in 0..pickle.len() {
        assert!(Checkpoint::from_bytes(&stored(&pickle[..len])).is_err(), "{len}");
    }
    // One flipped byte anywhere is an error or another checkpoint, never a panic.
    for at in 0..good.len() {
        let mut bad = good.clone();
        bad[at] ^= 0x5a;
        let _ = Checkpoint::from_bytes(&bad);
    }
}

fn stream(protocol: i32, object: &[u8], keys: &[u8], data: &[u8]) -> Vec<u8> {
    let mut file = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.".to_vec();
    file.extend(Pickler::new().int(protocol).stop());
    file.extend(Pickler::new().raw(b"}").text("little_endian").raw(b"\x88s").stop());
    file.extend_from_slice(object);
    file.extend_from_slice(keys);
    file.extend_from_slice(data);
    file
}

#[test]
fn old_streams_are_read_and_checked() {
    let object = one_tensor(4, 0, &[4], &[1]);
    let keys = Pickler::new().raw(b"]").text("0").raw(b"a").stop();
    let mut data = 4u64.to_le_bytes().to_vec();
    data.extend([1.0f32, 2.0, 3.0, 4.0].iter().flat_map(|x| x.to_le_bytes()));
    let good = stream(1001, &object, &keys, &data);
    assert_eq!(Checkpoint::from_bytes(&good).unwrap().tensors["w"].data(), [1.0, 2.0, 3.0, 4.0]);
    for len in 0..good.len() {
        assert!(Checkpoint::from_bytes(&good[..len]).is_err(), "{len}");
    }
    refused(&stream(1002, &object, &keys, &data), "protocol 1002");
    let huge = u64::MAX.to_le_bytes();
    refused(&stream(1001, &object, &keys, &huge), "announces 18446744073709551615");
    let foreign = Pickler::new().raw(b"]").text("9").raw(b"a").stop();
    refused(&stream(1001, &object, &foreign, &data), "storage '9' is not used");
    let none = Pickler::new().raw(b"].").0;
    refused(&stream(1001, &object, &none, &data), "storage '0' is not in the file");
}

#[test]
fn other_files_are_named() {
    refused(b"", "is empty");
    refused(&[0; 4096], "unknown first bytes");
    refused(b"short", "too short");
    refused(b"PK\x05\x06", "damaged PyTorch archive");
    let empty = ZipWriter::new(Cursor::new(Vec::new())).finish().unwrap().into_inner();
    refused(&empty, "no data.pkl");
    let text = Checkpoint::read("/nonexistent/weights.pt").unwrap_err().to_string();
    assert!(text.contains("cannot read /nonexistent/weights.pt"), "{text}");
}

#[test]
fn bad_safetensors_are_refused() {
    let file = |header: &str, data: usize| {
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend_from_slice(header.as_bytes());
        bytes.resize(bytes.len() + data, 0);
        bytes
    };
    let part = "damaged safetensors";
    refused(&file("{", 8), part);
    refused(&file(r#"{"w":{"dtype":"F32","shape":[4],"data_offsets":[0,16]}}"#, 8), part);
    refused(&file(r#"{"w":{"dtype":"F32","shape":[5],"data_offsets":[0,16]}}"#, 16), part);
    refused(&file(r#"{"w":{"dtype":"F32","shape":[4],"data_offsets":[16,0]}}"#, 16), part);
    let huge =
        r#"{"w":{"dtype":"F32","shape":[4294967296,4294967296,4294967296],"data_offsets":[0,16]}}"#;
    refused(&file(huge, 16), part);
    let mut long = u64::MAX.to_le_bytes().to_vec();
    long.extend_from_slice(b"{}      ");
    refused(&long, part);
}

#[test]
fn bad_onnx_is_refused() {
    let error = |bytes: &[u8]| OnnxModel::from_bytes(bytes).unwrap_err().to_string();
    assert!(error(b"").contains("empty"));
    assert!(error(b"PK\x03\x04 no protobuf").contains("not an ONNX file"));
    assert!(error(b"\x08\x07").contains("no graph"));
    assert!(error(b"\x08\x07\x3a\x00").contains("no nodes"));
    // Graphs in attributes of nodes in graphs …: refused at the decoder's depth limit.
    let mut deep: Vec<u8> = Vec::new();
    for _ in 0..3000 {
        for tag in [0x32u8, 0x2a, 0x0a] {
            let mut outer = vec![tag];
            let mut len = deep.len();
            while len >= 0x80 {
                outer.push((len & 0x7f) as u8 | 0x80);
                len >>= 7;
            }
            outer.push(len as u8);
            outer.extend_from_slice(&deep);
            deep = outer;
        }
        if deep.len() > 4000 {
            break;
        }
    }
    let mut model = vec![0x3a];
    model.extend([(deep.len() & 0x7f) as u8 | 0x80, (deep.len() >> 7) as u8]);
    model.extend_from_slice(&deep);
    assert!(error(&model).contains("recursion"), "{}", error(&model));
}

#[test]
fn networks_that_do_not_fit_are_named() {
    let build = |names: &[(&str, &[usize])]| {
        let tensor = |shape: &[usize]| {
            Tensor::new(shape.to_vec(), vec![0.5; shape.iter().product()]).unwrap()
        };
        let tensors: BTreeMap<String, Tensor> =
            names.iter().map(|(n, s)| ((*n).to_owned(), tensor(s))).collect();
        YoloV5::from_checkpoint(&Checkpoint { tensors, ..Default::default() })
            .unwrap_err()
            .to_string()
    };
    assert!(build(&[]).contains("no YOLOv5 network"));
    assert!(build(&[("encoder.weight", &[1])]).contains("first: 'encoder.weight'"));
    assert!(build(&[("model.3.conv.weight", &[1, 1, 1, 1])]).contains("4 layers"));
    assert!(build(&[("model.999999999.w", &[1])]).contains("1000000000 layers"));
    assert!(build(&[("model.18446744073709551615.w", &[1])]).contains(" layers; at most"));
    let text = build(&[("model.0.conv.weight", &[8, 3, 6, 6]), ("model.24.anchors", &[3, 3, 2])]);
    assert!(text.contains("layer model.1 looks like"), "{text}");
}
