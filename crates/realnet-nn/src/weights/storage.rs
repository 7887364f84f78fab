//! Element types, storages and the views that tensors are.

use half::{bf16, f16};

use super::{Tensor, WeightsError};

/// Element type of a storage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dtype {
    F64,
    F32,
    F16,
    Bf16,
    I64,
    I32,
    I16,
    I8,
    U8,
}

impl Dtype {
    /// From the class of a storage (`FloatStorage`) or the name of a dtype (`float32`).
    pub(super) fn from_torch(name: &str) -> Option<Self> {
        Some(match name {
            "DoubleStorage" | "float64" | "double" => Dtype::F64,
            "FloatStorage" | "float32" | "float" => Dtype::F32,
            "HalfStorage" | "float16" | "half" => Dtype::F16,
            "BFloat16Storage" | "bfloat16" => Dtype::Bf16,
            "LongStorage" | "int64" | "long" => Dtype::I64,
            "IntStorage" | "int32" | "int" => Dtype::I32,
            "ShortStorage" | "int16" | "short" => Dtype::I16,
            "CharStorage" | "int8" => Dtype::I8,
            "ByteStorage" | "uint8" | "BoolStorage" | "bool" | "UntypedStorage" => Dtype::U8,
            _ => return None,
        })
    }

    /// Bytes of one element.
    pub(super) fn size(self) -> usize {
        match self {
            Dtype::F64 | Dtype::I64 => 8,
            Dtype::F32 | Dtype::I32 => 4,
            Dtype::F16 | Dtype::Bf16 | Dtype::I16 => 2,
            Dtype::I8 | Dtype::U8 => 1,
        }
    }

    /// One element; `bytes` has [`Dtype::size`] bytes.
    fn decode(self, bytes: &[u8], big_endian: bool) -> Option<f32> {
        let mut le = [0u8; 8];
        let le = le.get_mut(..bytes.len())?;
        le.copy_from_slice(bytes);
        if big_endian {
            le.reverse();
        }
        let le: &[u8] = le;
        Some(match self {
            Dtype::F64 => f64::from_le_bytes(le.try_into().ok()?) as f32,
            Dtype::F32 => f32::from_le_bytes(le.try_into().ok()?),
            Dtype::F16 => f16::from_le_bytes(le.try_into().ok()?).to_f32(),
            Dtype::Bf16 => bf16::from_le_bytes(le.try_into().ok()?).to_f32(),
            Dtype::I64 => i64::from_le_bytes(le.try_into().ok()?) as f32,
            Dtype::I32 => i32::from_le_bytes(le.try_into().ok()?) as f32,
            Dtype::I16 => f32::from(i16::from_le_bytes(le.try_into().ok()?)),
            Dtype::I8 => f32::from(i8::from_le_bytes(le.try_into().ok()?)),
            Dtype::U8 => f32::from(*le.first()?),
        })
    }

    /// All elements of a dense little- or big-endian buffer.
    pub(super) fn decode_all(self, bytes: &[u8], big_endian: bool) -> Vec<f32> {
        bytes.chunks_exact(self.size()).filter_map(|b| self.decode(b, big_endian)).collect()
    }
}

/// A tensor as a view of a storage; all numbers count elements.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct View {
    pub dtype: Dtype,
    pub offset: usize,
    pub shape: Vec<usize>,
    pub stride: Vec<usize>,
}

impl View {
    /// Number of elements; `None` if it overflows.
    pub(super) fn count(&self) -> Option<usize> {
        self.shape.iter().try_fold(1usize, |n, &d| n.checked_mul(d))
    }

    /// Copies the elements out of the storage's bytes.
    pub(super) fn read(
        &self,
        name: &str,
        bytes: &[u8],
        big_endian: bool,
    ) -> Result<Tensor, WeightsError> {
        let error = |reason| WeightsError::Tensor { name: name.to_owned(), reason };
        let stored = bytes.len() / self.dtype.size();
        let count = self.count();
        // One past the last element that the view touches.
        let end = self.shape.iter().zip(&self.stride).try_fold(self.offset, |at, (&d, &s)| {
            at.checked_add(d.saturating_sub(1).checked_mul(s)?)
        });
        let end = end.and_then(|last| last.checked_add(1));
        let (Some(count), Some(end)) = (count, end) else {
            return Err(error(format!("shape {:?} is too large", self.shape)));
        };
        if count == 0 {
            return Tensor::new(self.shape.clone(), Vec::new())
                .ok_or_else(|| error("an empty tensor with elements".to_owned()));
        }
        if end > stored {
            return Err(error(format!(
                "shape {:?} with strides {:?} from element {} ends at element {end}, \
                 but the storage holds {stored}",
                self.shape, self.stride, self.offset
            )));
        }
        let data = if self.is_dense() {
            let size = self.dtype.size();
            let dense = bytes.get(self.offset * size..(self.offset + count) * size);
            self.dtype.decode_all(dense.unwrap_or_default(), big_endian)
        } else {
            self.gather(bytes, count, big_endian)
        };
        Tensor::new(self.shape.clone(), data)
            .ok_or_else(|| error(format!("shape {:?} does not fit its elements", self.shape)))
    }

    fn is_dense(&self) -> bool {
        let mut expected = 1;
        self.shape.iter().zip(&self.stride).rev().all(|(&d, &s)| {
            let fits = d == 1 || s == expected;
            expected *= d;
            fits
        })
    }

    fn gather(&self, bytes: &[u8], count: usize, big_endian: bool) -> Vec<f32> {
        let size = self.dtype.size();
        let mut index = vec![0usize; self.shape.len()];
        let mut at = self.offset;
        let mut data = Vec::with_capacity(count);
        for _ in 0..count {
            let element = bytes.get(at * size..(at + 1) * size);
            data.extend(element.and_then(|b| self.dtype.decode(b, big_endian)));
            // Step like an odometer, the last dimension fastest. The stride of a
            // dimension of size 1 may be any number: it is added and taken away.
            for ((i, &d), &s) in index.iter_mut().zip(&self.shape).zip(&self.stride).rev() {
                *i += 1;
                at = at.wrapping_add(s);
                if *i < d {
                    break;
                }
                at = at.wrapping_sub(i.wrapping_mul(s));
                *i = 0;
            }
        }
        data
    }
}

/// Bounds what is read from a file by a small multiple of its length.
#[derive(Debug)]
pub(super) struct Budget {
    size: u64,
    limit: u64,
    bytes_left: u64,
    elements_left: u64,
}

impl Budget {
    /// A budget for a file of `size` bytes: eight times its length and 16 MiB
    /// for raw bytes, and as much for converted elements.
    pub(super) fn new(size: usize) -> Self {
        let size = size as u64;
        let limit = size.saturating_mul(8).saturating_add(16 << 20);
        Budget { size, limit, bytes_left: limit, elements_left: limit / 4 }
    }

    /// Takes bytes to be decompressed.
    pub(super) fn bytes(&mut self, count: u64, what: &str) -> Result<(), WeightsError> {
        let left = self.bytes_left.checked_sub(count);
        self.bytes_left = left.ok_or_else(|| self.bomb(what))?;
        Ok(())
    }

    /// Takes elements to be converted to f32.
    pub(super) fn elements(&mut self, count: usize, what: &str) -> Result<(), WeightsError> {
        let left = self.elements_left.checked_sub(count as u64);
        self.elements_left = left.ok_or_else(|| self.bomb(what))?;
        Ok(())
    }

    fn bomb(&self, what: &str) -> WeightsError {
        WeightsError::Bomb { what: what.to_owned(), limit: self.limit, size: self.size }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(offset: usize, shape: &[usize], stride: &[usize]) -> View {
        View { dtype: Dtype::U8, offset, shape: shape.to_vec(), stride: stride.to_vec() }
    }

    #[test]
    fn strided_views_are_gathered_in_row_major_order() {
        let bytes: Vec<u8> = (0..12).collect();
        let transposed = view(0, &[4, 3], &[1, 4]).read("t", &bytes, false).unwrap();
        assert_eq!(transposed.data(), [0., 4., 8., 1., 5., 9., 2., 6., 10., 3., 7., 11.]);
        let column = view(1, &[3, 1], &[4, 7]).read("t", &bytes, false).unwrap();
        assert_eq!(column.data(), [1., 5., 9.]);
        let expanded = view(5, &[2, 2], &[0, 1]).read("t", &bytes, false).unwrap();
        assert_eq!(expanded.data(), [5., 6., 5., 6.]);
    }

    #[test]
    fn views_stay_inside_their_storage() {
        let bytes = [0u8; 12];
        assert!(view(0, &[12], &[1]).read("t", &bytes, false).is_ok());
        for bad in [view(1, &[12], &[1]), view(0, &[3, 4], &[4, 2]), view(13, &[], &[])] {
            let text = bad.read("t", &bytes, false).unwrap_err().to_string();
            assert!(text.contains("storage holds 12"), "{text}");
        }
        let huge = view(usize::MAX, &[usize::MAX, 2], &[usize::MAX, 1]);
        assert!(huge.read("t", &bytes, false).unwrap_err().to_string().contains("too large"));
    }

    #[test]
    fn element_types_are_converted() {
        let one = |dtype: Dtype, bytes: &[u8]| dtype.decode_all(bytes, false);
        assert_eq!(one(Dtype::F16, &[0x00, 0x3c]), [1.0]);
        assert_eq!(one(Dtype::Bf16, &[0x80, 0x3f]), [1.0]);
        assert_eq!(one(Dtype::F64, &(-2.5f64).to_le_bytes()), [-2.5]);
        assert_eq!(one(Dtype::I64, &(-7i64).to_le_bytes()), [-7.0]);
        assert_eq!(one(Dtype::I8, &[0xff]), [-1.0]);
        assert_eq!(Dtype::F32.decode_all(&1.5f32.to_be_bytes(), true), [1.5]);
    }
}
