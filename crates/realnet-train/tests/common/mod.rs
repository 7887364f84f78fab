#![allow(dead_code, unreachable_pub, clippy::print_stdout)]

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use realnet_nn::engine::{EngineChoice, Runtime, RuntimeOptions};
use realnet_nn::onnx::OnnxModel;
use realnet_nn::weights::{self, Checkpoint};
use realnet_train::names::{Tensors, take_all, tensors};
use safetensors::{Dtype, SafeTensors};
use std::path::{Path, PathBuf};

/// A file of reference values.
pub struct File(pub Vec<u8>);

impl File {
    /// One of `data/`.
    pub fn open(name: &str) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
        Self(std::fs::read(path).unwrap())
    }

    /// All numbers of a tensor, whatever their type.
    pub fn numbers(&self, name: &str) -> Vec<f64> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let view = file.tensor(name).unwrap_or_else(|e| panic!("{name}: {e}"));
        let bytes = view.data();
        match view.dtype() {
            Dtype::F64 => {
                bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
            }
            Dtype::F32 => bytes
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes(b.try_into().unwrap()).into())
                .collect(),
            Dtype::I64 => bytes
                .chunks_exact(8)
                .map(|b| i64::from_le_bytes(b.try_into().unwrap()) as f64)
                .collect(),
            Dtype::I8 => bytes.iter().map(|b| f64::from(*b as i8)).collect(),
            Dtype::U8 => bytes.iter().map(|b| f64::from(*b)).collect(),
            other => panic!("{name} has type {other:?}"),
        }
    }
}

fn shared() -> PathBuf {
    std::env::var_os("REALNET_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    )
}

/// A file of the shared reference values.
pub fn golden(name: &str) -> Option<File> {
    let path = shared().join("golden").join(name);
    let bytes = std::fs::read(&path).ok();
    if bytes.is_none() {
        println!("skipped: {} is missing", path.display());
    }
    bytes.map(File)
}

/// Weights of the shared models.
pub fn weights(name: &str) -> Option<Checkpoint> {
    let path = shared().join("models").join(name);
    if !path.exists() {
        println!("skipped: {} is missing", path.display());
        return None;
    }
    Some(Checkpoint::read(path).unwrap())
}

/// Whether all differences are within `absolute + relative · |expected|`.
pub fn close(what: &str, found: &[f64], expected: &[f64], absolute: f64, relative: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (f, e)) in found.iter().zip(expected).enumerate() {
        let limit = absolute + relative * e.abs();
        assert!((f - e).abs() <= limit, "{what} [{i}]: {f} instead of {e}");
    }
}

/// Width, height and RGB bytes of a shared reference picture.
pub fn picture(name: &str) -> Option<(usize, usize, Vec<u8>)> {
    let path = shared().join("golden").join(name);
    if !path.exists() {
        println!("skipped: {} is missing", path.display());
        return None;
    }
    let frame = realnet_io::picture::read(&path).unwrap();
    Some((frame.width() as usize, frame.height() as usize, frame.data().to_vec()))
}

/// The numbers of a shared NumPy file of 32-bit floats.
pub fn npy(name: &str) -> Option<Vec<f64>> {
    let path = shared().join("golden").join(name);
    let Ok(bytes) = std::fs::read(&path) else {
        println!("skipped: {} is missing", path.display());
        return None;
    };
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let text = std::str::from_utf8(&bytes[10..10 + header]).unwrap();
    assert!(text.contains("'<f4'") && text.contains("'fortran_order': False"), "{text}");
    let floats = bytes[10 + header..].chunks_exact(4);
    Some(floats.map(|b| f32::from_le_bytes(b.try_into().unwrap()).into()).collect())
}

pub fn device() -> Device {
    Device::flex()
}

pub fn numbers<const D: usize>(tensor: &Tensor<D>) -> Vec<f64> {
    tensor.clone().into_data().try_to_vec::<f32>().unwrap().into_iter().map(f64::from).collect()
}

/// The same network with statistics and scales as training leaves them.
pub fn worn<M: Module>(net: M) -> M {
    let worn: Tensors = tensors(&net).unwrap();
    let worn = worn.into_iter().map(|(name, tensor)| {
        let seed = name.bytes().fold(7u32, |h, b| h.wrapping_mul(31) ^ u32::from(b));
        let unit = |i: usize| f64::from(seed.wrapping_add(i as u32 * 7919) % 1000) / 1000.0;
        let [least, width] = match name.rsplit('.').next().unwrap() {
            "running_var" => [0.4, 1.2],
            "running_mean" => [-0.3, 0.6],
            "bias" => [-0.2, 0.5],
            "weight" if tensor.shape().len() == 1 => [1.0, 1.0],
            _ => return (name, tensor),
        };
        let data = (0..tensor.data().len()).map(|i| (least + width * unit(i)) as f32);
        let tensor = weights::Tensor::new(tensor.shape().to_vec(), data.collect()).unwrap();
        (name, tensor)
    });
    take_all(net, &worn.collect()).unwrap()
}

/// The only output of a file for an input of noise, on the embedded engine.
pub fn run(model: OnnxModel, input: &[f32]) -> Vec<f64> {
    let runtime = RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() };
    let mut engine = Runtime::start(&runtime).load(model).unwrap();
    engine.input().copy_from_slice(input);
    let mut found = Vec::new();
    engine
        .run(&mut |outputs| found.extend(outputs[0].data.iter().copied().map(f64::from)))
        .unwrap();
    found
}

pub fn noise(width: usize, height: usize) -> (Vec<f32>, Tensor<4>) {
    let mut state = 5u32;
    let pixels = (0..3 * width * height).map(|_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 22) as f32 - 2.0
    });
    let pixels: Vec<f32> = pixels.collect();
    let data = TensorData::new(pixels.clone(), [1, 3, height, width]);
    (pixels, Tensor::from_data(data, &device()))
}

/// The largest difference between two pixels of a plane: what tells that a picture was seen.
pub fn spread(values: &[f64], plane: usize) -> f64 {
    let span = |plane: &[f64]| {
        let [least, most] =
            plane.iter().fold([f64::MAX, f64::MIN], |[a, b], v| [a.min(*v), b.max(*v)]);
        most - least
    };
    values.chunks_exact(plane).map(span).fold(0.0, f64::max)
}
