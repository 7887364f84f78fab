#![allow(dead_code, unreachable_pub)]

use realnet_nn::weights::Checkpoint;
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
