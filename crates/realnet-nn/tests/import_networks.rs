//! Small random networks of the known layouts: what is built from them, and
//! which error names what does not fit.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use realnet_nn::onnx::{Dim, OnnxModel};
use realnet_nn::weights::{Checkpoint, Tensor};
use realnet_nn::yolov5::{ImportError, OnnxOptions, YoloV5};

const CLASSES: usize = 2;

fn put(c: &mut Checkpoint, name: String, shape: &[usize]) {
    let mut state = name.bytes().fold(7u32, |h, b| h.wrapping_mul(31) ^ u32::from(b));
    let data = (0..shape.iter().product())
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            0.1 + (state >> 8) as f32 / (1 << 24) as f32
        })
        .collect();
    c.tensors.insert(name, Tensor::new(shape.to_vec(), data).unwrap());
}

fn conv(c: &mut Checkpoint, path: &str, input: usize, out: usize, k: usize) {
    put(c, format!("{path}.conv.weight"), &[out, input, k, k]);
    for part in ["weight", "bias", "running_mean", "running_var"] {
        put(c, format!("{path}.bn.{part}"), &[out]);
    }
}

fn c3(c: &mut Checkpoint, path: &str, input: usize, out: usize) {
    let half = out / 2;
    conv(c, &format!("{path}.cv1"), input, half, 1);
    conv(c, &format!("{path}.cv2"), input, half, 1);
    conv(c, &format!("{path}.m.0.cv1"), half, half, 1);
    conv(c, &format!("{path}.m.0.cv2"), half, half, 3);
    conv(c, &format!("{path}.cv3"), out, out, 1);
}

/// A network all of whose layers have 4 channels; 4 stages have three heads, 5 four.
fn network(stages: usize, focus: bool) -> Checkpoint {
    let c = &mut Checkpoint::default();
    let at = |n: usize| format!("model.{n}");
    match focus {
        true => conv(c, "model.0.conv", 12, 4, 3),
        false => conv(c, "model.0", 3, 4, 6),
    }
    for stage in 0..stages {
        conv(c, &at(2 * stage + 1), 4, 4, 3);
        let shift = usize::from(focus && stage + 1 == stages);
        c3(c, &at(2 * stage + 2 + shift), 4, 4);
    }
    let spp = at(2 * stages + usize::from(!focus));
    conv(c, &format!("{spp}.cv1"), 4, 2, 1);
    conv(c, &format!("{spp}.cv2"), 8, 4, 1);
    let (down, mut n) = (stages - 2, 2 * stages + 2);
    for _ in 0..down {
        conv(c, &at(n), 4, 4, 1);
        c3(c, &at(n + 3), 8, 4);
        n += 4;
    }
    for _ in 0..down {
        conv(c, &at(n), 4, 4, 3);
        c3(c, &at(n + 2), 8, 4);
        n += 3;
    }
    for head in 0..=down {
        put(c, format!("model.{n}.m.{head}.weight"), &[3 * (5 + CLASSES), 4, 1, 1]);
        put(c, format!("model.{n}.m.{head}.bias"), &[3 * (5 + CLASSES)]);
    }
    put(c, format!("model.{n}.anchors"), &[down + 1, 3, 2]);
    std::mem::take(c)
}

#[test]
fn all_layouts_are_built() {
    for (stages, focus) in [(4, false), (4, true), (5, false), (5, true)] {
        let net = YoloV5::from_checkpoint(&network(stages, focus)).unwrap();
        assert_eq!(net.strides(), &[8, 16, 32, 64][..stages - 1]);
        assert_eq!(net.class_names(), ["class0", "class1"]);
        let size = OnnxOptions { width: 192, height: 128, half: false };
        let mut model = OnnxModel::from_bytes(&net.to_onnx(&size).unwrap()).unwrap();
        let rows = net.rows(192, 128);
        assert_eq!(model.outputs()[0].dims, Some([1, rows, 7].map(Dim::Fixed).to_vec()));
        rten::Model::load(model.to_bytes()).unwrap();
        model.keep_outputs(&["head1"]).unwrap();
        assert_eq!(model.outputs()[0].dims, Some([1, 21, 8, 12].map(Dim::Fixed).to_vec()));
    }
}

fn refused(change: impl FnOnce(&mut Checkpoint)) -> ImportError {
    let mut checkpoint = network(4, false);
    change(&mut checkpoint);
    YoloV5::from_checkpoint(&checkpoint).unwrap_err()
}

#[test]
fn what_does_not_fit_is_named() {
    let name = "model.4.m.0.cv2.bn.running_var".to_owned();
    let missing = refused(|c| drop(c.tensors.remove(&name)));
    assert!(matches!(&missing, ImportError::MissingTensor { name: n, .. } if *n == name));
    let shape = refused(|c| put(c, name.clone(), &[3]));
    assert_eq!(shape.to_string(), format!("tensor '{name}' has shape [3], expected [2]"));
    let input = refused(|c| put(c, "model.5.conv.weight".into(), &[4, 9, 3, 3]));
    assert!(
        input.to_string().ends_with("has shape [4, 9, 3, 3], expected [out, 4, k, k]"),
        "{input}"
    );
    let surplus = refused(|c| put(c, "model.4.extra".into(), &[1]));
    assert_eq!(surplus, ImportError::SurplusTensors { name: "model.4.extra".into(), count: 1 });
    let names = refused(|c| c.class_names = Some(vec!["car".into()]));
    assert_eq!(names, ImportError::Names { names: 1, classes: CLASSES });
    let strides = refused(|c| c.strides = Some(vec![4.0, 8.0, 16.0]));
    assert!(strides.to_string().contains("[4.0, 8.0, 16.0]"), "{strides}");
    let nan = Tensor::new(vec![2], vec![f32::NAN, 1.0]).unwrap();
    let value = refused(|c| drop(c.tensors.insert(name.clone(), nan)));
    assert!(matches!(&value, ImportError::Value { name: n, .. } if *n == name), "{value}");
}
