//! PyTorch files written by hand, byte by byte.

use std::io::{Cursor, Write};
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

/// A pickle of protocol 2 in the making.
#[derive(Clone)]
pub struct Pickle(pub Vec<u8>);

impl Pickle {
    pub fn new() -> Self {
        Self(vec![0x80, 2])
    }

    pub fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    pub fn text(self, text: &str) -> Self {
        let length = u32::try_from(text.len()).unwrap().to_le_bytes();
        self.raw(b"X").raw(&length).raw(text.as_bytes())
    }

    pub fn global(self, module: &str, name: &str) -> Self {
        self.raw(format!("c{module}\n{name}\n").as_bytes())
    }

    pub fn int(self, number: i32) -> Self {
        self.raw(b"J").raw(&number.to_le_bytes())
    }

    /// A float tensor of `shape` over the storage `0` of `count` numbers.
    pub fn tensor(self, count: i32, shape: &[i32], stride: &[i32]) -> Self {
        let tuple = |pickle: Self, items: &[i32]| {
            items.iter().fold(pickle.raw(b"("), |pickle, &item| pickle.int(item)).raw(b"t")
        };
        let pickle = self.global("torch._utils", "_rebuild_tensor_v2").raw(b"((").text("storage");
        let pickle = pickle.global("torch", "FloatStorage").text("0").text("cpu").int(count);
        tuple(tuple(pickle.raw(b"tQ").int(0), shape), stride).raw(b"\x89}tR")
    }

    /// A dictionary of one tensor, whole.
    pub fn one_tensor(name: &str, count: i32, shape: &[i32], stride: &[i32]) -> Vec<u8> {
        Self::new().raw(b"}").text(name).tensor(count, shape, stride).raw(b"s").stop()
    }

    pub fn stop(self) -> Vec<u8> {
        self.raw(b".").0
    }
}

/// An archive with this pickle and the storage `0`.
pub fn archive(pickle: &[u8], storage: &[u8], method: CompressionMethod) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(method);
    for (name, bytes) in [("archive/data.pkl", pickle), ("archive/data/0", storage)] {
        zip.start_file(name, options).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// As [`archive`], stored, with 16 bytes of storage.
pub fn stored(pickle: &[u8]) -> Vec<u8> {
    archive(pickle, &[0; 16], CompressionMethod::Stored)
}

/// A file in the form from before PyTorch 1.6, of one tensor of four numbers,
/// that says to hold `announced`.
pub fn stream(announced: u64) -> Vec<u8> {
    let mut file = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.".to_vec();
    file.extend(Pickle::new().int(1001).stop());
    file.extend(Pickle::new().raw(b"}").text("little_endian").raw(b"\x88s").stop());
    file.extend(Pickle::one_tensor("w", 4, &[4], &[1]));
    file.extend(Pickle::new().raw(b"]").text("0").raw(b"a").stop());
    file.extend(announced.to_le_bytes());
    file.extend([0; 16]);
    file
}
