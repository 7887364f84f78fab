//! Depth maps from picture files.
//!
//! A depth file is a grey PNG or a binary PGM (`P5`) of 8 or 16 bits whose
//! values divided by a scale are metres: 1000 for millimetres (Kinect, 7-Scenes,
//! NYU, ROS `16UC1`), 5000 for TUM RGB-D, 256 for KITTI. The values are taken as
//! they are written, whatever the maximum in a PGM header. 0 means *unknown*,
//! and so does 65535 in 16 bits: it is a saturated or invalid pixel (7-Scenes
//! writes it for 'no measurement'), never a distance.

use crate::atomic::{self, WriteError};
use crate::picture::Limits;
use image::codecs::png::PngDecoder;
use image::{ImageDecoder, ImageEncoder};
use realnet_core::{DepthMap, DepthMapError, Stamp};
use std::io::{self, Cursor, Read};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why bytes are no depth map.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DepthDecodeError {
    /// No bytes.
    #[error("the file is empty")]
    Empty,
    /// Neither PNG nor binary PGM.
    #[error("a depth map is a grey PNG or a binary PGM (P5); this starts with {found:?}")]
    Format {
        /// The first bytes as text.
        found: String,
    },
    /// A PNG in colour, with alpha or a palette, or of less than 8 bits.
    #[error(
        "a depth map is a grey PNG of 8 or 16 bits, this one is {bits} bits of {kind} \
         (a picture, or depth painted in colours?)"
    )]
    Kind {
        /// Bits a sample.
        bits: u8,
        /// What a pixel is.
        kind: &'static str,
    },
    /// A damaged or truncated PNG.
    #[error("damaged or truncated PNG: {0}")]
    Png(String),
    /// A damaged or truncated PGM.
    #[error("damaged or truncated PGM: {0}")]
    Pgm(String),
    /// More pixels than [`Limits::max_pixels`].
    #[error("{width}x{height} pixels exceed the limit of {limit} pixels")]
    TooLarge {
        /// Pixels a row.
        width: u64,
        /// Rows.
        height: u64,
        /// The limit.
        limit: u64,
    },
    /// A scale that is not a positive number.
    #[error("a depth scale of {scale} units a metre is not possible")]
    Scale {
        /// The value.
        scale: f64,
    },
    /// The values do not make a map.
    #[error(transparent)]
    Map(#[from] DepthMapError),
}

/// Why a depth file cannot be used.
#[derive(Debug, Error)]
pub enum DepthFileError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        reason: io::Error,
    },
    /// The file is longer than [`Limits::max_bytes`].
    #[error("{}: more than {limit} bytes, the limit of a picture file", path.display())]
    TooLong {
        /// The file.
        path: PathBuf,
        /// The limit in bytes.
        limit: u64,
    },
    /// The bytes are no depth map.
    #[error("{}: {reason}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What is wrong with its bytes.
        reason: DepthDecodeError,
    },
}

/// Reads a depth file whose values are `scale` to the metre; its stamp is
/// [`Stamp::ZERO`].
///
/// # Errors
/// [`DepthFileError`] with the path and the reason.
pub fn read(path: &Path, scale: f64, limits: &Limits) -> Result<DepthMap, DepthFileError> {
    let failed = |reason| DepthFileError::Read { path: path.to_path_buf(), reason };
    let file = std::fs::File::open(path).map_err(failed)?;
    let mut bytes = Vec::new();
    file.take(limits.max_bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > limits.max_bytes {
        return Err(DepthFileError::TooLong { path: path.to_path_buf(), limit: limits.max_bytes });
    }
    decode(&bytes, scale, limits)
        .map_err(|reason| DepthFileError::Decode { path: path.to_path_buf(), reason })
}

/// Decodes the bytes of a depth file, see [`read`].
///
/// # Errors
/// [`DepthDecodeError`] when the bytes are no whole depth map, exceed `limits`,
/// or `scale` is not a positive number.
pub fn decode(bytes: &[u8], scale: f64, limits: &Limits) -> Result<DepthMap, DepthDecodeError> {
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(DepthDecodeError::Scale { scale });
    }
    let raw = if bytes.is_empty() {
        return Err(DepthDecodeError::Empty);
    } else if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        png(bytes, limits)?
    } else if bytes.starts_with(b"P5") {
        pgm(bytes, limits)?
    } else {
        let head = bytes.get(..16).unwrap_or(bytes);
        return Err(DepthDecodeError::Format { found: String::from_utf8_lossy(head).into_owned() });
    };
    let invalid = if raw.wide { u16::MAX } else { 0 };
    let metres = |v: u16| {
        if v == invalid { DepthMap::UNKNOWN } else { (f64::from(v) / scale) as f32 }
    };
    let data = raw.samples.into_iter().map(metres).collect();
    Ok(DepthMap::new(Stamp::ZERO, raw.width, raw.height, data)?)
}

/// Encodes a depth map as a grey PNG of 16 bits, `scale` units to the metre, rounded to
/// the nearest; unknown depths, and those beyond 65534 units, are 0: unknown.
///
/// # Errors
/// The encoder's message, for a map larger than the format allows, or that `scale` is
/// not a positive number.
pub fn encode(map: &DepthMap, scale: f64) -> Result<Vec<u8>, String> {
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(DepthDecodeError::Scale { scale }.to_string());
    }
    let largest = f64::from(u16::MAX - 1);
    let units = |depth: f32| {
        let units = (f64::from(depth) * scale).round();
        if DepthMap::is_known(depth) && units <= largest { units as u16 } else { 0 }
    };
    // The encoder takes 16 bits in the machine's own order.
    let samples: Vec<u8> = map.data().iter().flat_map(|&d| units(d).to_ne_bytes()).collect();
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(&samples, map.width(), map.height(), image::ExtendedColorType::L16)
        .map_err(|e| e.to_string())?;
    Ok(bytes)
}

/// Writes a depth map as [`encode`] does, whole or not at all. The folder must exist.
///
/// # Errors
/// [`WriteError`] with the path.
pub fn write(path: &Path, map: &DepthMap, scale: f64) -> Result<(), WriteError> {
    let bytes = encode(map, scale).map_err(|e| WriteError::new(path, io::Error::other(e)))?;
    atomic::write(path, &bytes)
}

/// Samples as they are written, row by row.
struct Raw {
    width: u32,
    height: u32,
    /// Two bytes a sample.
    wide: bool,
    samples: Vec<u16>,
}

fn check_size(width: u32, height: u32, limits: &Limits) -> Result<(), DepthDecodeError> {
    let (width, height) = (u64::from(width), u64::from(height));
    if width.saturating_mul(height) > limits.max_pixels {
        return Err(DepthDecodeError::TooLarge { width, height, limit: limits.max_pixels });
    }
    Ok(())
}

fn png(bytes: &[u8], limits: &Limits) -> Result<Raw, DepthDecodeError> {
    let broken = |e: image::ImageError| DepthDecodeError::Png(e.to_string());
    // The header block comes first and has its depth and colour type here
    // (PNG specification, 11.2.1). The decoder would widen fewer bits and
    // palettes without a word.
    let wide = match (bytes.get(24), bytes.get(25)) {
        (Some(8), Some(0)) => false,
        (Some(16), Some(0)) => true,
        (Some(&bits), Some(&kind)) => {
            let kind = match kind {
                0 => "grey",
                2 => "RGB colour",
                3 => "palette",
                4 => "grey with alpha",
                6 => "RGB colour with alpha",
                _ => "an unknown kind",
            };
            return Err(DepthDecodeError::Kind { bits, kind });
        }
        _ => return Err(DepthDecodeError::Png("the file ends in its header".into())),
    };
    let mut budget = image::Limits::default();
    budget.max_alloc = Some(limits.max_pixels.saturating_mul(2).saturating_add(1 << 20));
    let decoder = PngDecoder::with_limits(Cursor::new(bytes), budget).map_err(broken)?;
    let (width, height) = decoder.dimensions();
    check_size(width, height, limits)?;
    let image = image::DynamicImage::from_decoder(decoder).map_err(broken)?;
    let samples = match image {
        image::DynamicImage::ImageLuma8(grey) => grey.iter().map(|&v| u16::from(v)).collect(),
        image::DynamicImage::ImageLuma16(grey) => grey.into_raw(),
        // A transparent colour (tRNS) adds an alpha channel.
        _ => {
            let bits = if wide { 16 } else { 8 };
            return Err(DepthDecodeError::Kind { bits, kind: "grey with alpha" });
        }
    };
    Ok(Raw { width, height, wide, samples })
}

/// A binary PGM: `P5`, width, height and maximum as decimal numbers with white
/// space or comments between, one white space, then the samples; two bytes each,
/// the higher first, when the maximum is above 255 (Netpbm's `pgm(5)`).
fn pgm(bytes: &[u8], limits: &Limits) -> Result<Raw, DepthDecodeError> {
    let broken = |what: String| DepthDecodeError::Pgm(what);
    let mut rest = bytes.get(2..).unwrap_or_default();
    let mut header = |name: &str| {
        let (value, after) = header_number(rest)
            .ok_or_else(|| DepthDecodeError::Pgm(format!("no {name} in the header")))?;
        rest = after;
        Ok::<u32, DepthDecodeError>(value)
    };
    let (width, height, max) = (header("width")?, header("height")?, header("maximum")?);
    if !(1..=65_535).contains(&max) {
        return Err(broken(format!("the maximum is {max}, it must be 1 to 65535")));
    }
    check_size(width, height, limits)?;
    let Some((b' ' | b'\t' | b'\n' | b'\r', data)) = rest.split_first() else {
        return Err(broken("no white space after the header".into()));
    };
    let wide = max > 255;
    let pixels = width as usize * height as usize;
    let expected = if wide { pixels * 2 } else { pixels };
    let Some(data) = data.get(..expected) else {
        let found = data.len();
        return Err(broken(format!(
            "{width}x{height} pixels need {expected} bytes, found {found}"
        )));
    };
    let samples = if wide {
        data.as_chunks().0.iter().map(|&pair| u16::from_be_bytes(pair)).collect()
    } else {
        data.iter().map(|&v| u16::from(v)).collect()
    };
    Ok(Raw { width, height, wide, samples })
}

/// The next number of a PGM header, and what follows it.
fn header_number(mut text: &[u8]) -> Option<(u32, &[u8])> {
    loop {
        match text.split_first()? {
            (b'#', after) => {
                let end = after.iter().position(|b| matches!(b, b'\n' | b'\r'))?;
                text = after.get(end..)?;
            }
            (byte, after) if byte.is_ascii_whitespace() => text = after,
            _ => break,
        }
    }
    let digits = text.iter().position(|b| !b.is_ascii_digit()).unwrap_or(text.len());
    let (number, after) = text.split_at_checked(digits)?;
    Some((std::str::from_utf8(number).ok()?.parse().ok()?, after))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ExtendedColorType, codecs::png::PngEncoder};
    use proptest::prelude::*;

    fn decoded(bytes: &[u8], scale: f64) -> Result<DepthMap, DepthDecodeError> {
        decode(bytes, scale, &Limits::default())
    }

    fn encoded(color: ExtendedColorType, data: &[u8], width: u32, height: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        PngEncoder::new(&mut bytes).write_image(data, width, height, color).unwrap();
        bytes
    }

    #[test]
    fn sixteen_bits_of_png_and_pgm_are_the_same_metres() {
        let values: [u16; 6] = [0, 1, 1500, 40_000, 65_534, 65_535];
        let native: Vec<u8> = values.iter().flat_map(|v| v.to_ne_bytes()).collect();
        let png = encoded(ExtendedColorType::L16, &native, 3, 2);
        let mut pgm = b"P5 # depth\n3\t2\n# of a camera\n40000\n".to_vec();
        pgm.extend(values.iter().flat_map(|v| v.to_be_bytes()));
        for bytes in [png, pgm] {
            let map = decoded(&bytes, 1000.0).unwrap();
            assert_eq!((map.width(), map.height()), (3, 2));
            assert_eq!(map.data(), [0.0, 0.001, 1.5, 40.0, 65.534, 0.0]);
        }
    }

    #[test]
    fn what_is_encoded_is_decoded() {
        let data = vec![0.5, 0.0, f32::NAN, 13.1068, 13.1071, 1e9, 0.00012, -1.0];
        let map = DepthMap::new(Stamp::ZERO, 4, 2, data).unwrap();
        let back = decoded(&encode(&map, 5000.0).unwrap(), 5000.0).unwrap();
        assert_eq!(back.data(), [0.5, 0.0, 0.0, 13.1068, 0.0, 0.0, 0.0002, 0.0]);
        assert!(encode(&map, 0.0).is_err());
    }

    #[test]
    fn eight_bits_keep_their_largest_value() {
        let png = encoded(ExtendedColorType::L8, &[0, 10, 255], 3, 1);
        let pgm = b"P5 3 1 255 \x00\x0a\xff".to_vec();
        for bytes in [png, pgm] {
            assert_eq!(decoded(&bytes, 10.0).unwrap().data(), [0.0, 1.0, 25.5]);
        }
    }

    #[test]
    fn what_is_no_depth_map_is_named() {
        let rgb = encoded(ExtendedColorType::Rgb8, &[7; 12], 2, 2);
        let palette = {
            let mut bytes = encoded(ExtendedColorType::L8, &[7; 4], 2, 2);
            bytes[25] = 3;
            bytes
        };
        let good = encoded(ExtendedColorType::L16, &[7; 8], 2, 2);
        for (bytes, wanted) in [
            (&b""[..], "the file is empty"),
            (b"version https://git-lfs", "this starts with \"version https://\""),
            (b"P6 1 1 255 abc", "starts with \"P6 1 1 255 abc\""),
            (&rgb, "8 bits of RGB colour"),
            (&palette, "8 bits of palette"),
            (&good[..20], "ends in its header"),
            (&good[..good.len() - 14], "damaged or truncated PNG"),
            (b"P5 2 2", "no maximum in the header"),
            (b"P5 # 2 2 255", "no width in the header"),
            (b"P5 99999999999 2 255 ", "no width in the header"),
            (b"P5 2 2 70000 ", "the maximum is 70000"),
            (b"P5 2 2 255", "no white space"),
            (b"P5 2 2 255 abc", "2x2 pixels need 4 bytes, found 3"),
            (b"P5 2 2 256 abcdefg", "2x2 pixels need 8 bytes, found 7"),
            (b"P5 0 2 255 ", "0x2 pixels is empty"),
            (b"P5 4294967295 4294967295 255 ", "exceed the limit of 100000000 pixels"),
        ] {
            let error = decoded(bytes, 1000.0).unwrap_err().to_string();
            assert!(error.contains(wanted), "{error}");
        }
        for scale in [0.0, -1000.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(decoded(&good, scale), Err(DepthDecodeError::Scale { .. })));
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_map_or_an_error(
            header in "P5[ 0-9#\n]{0,20}", data in proptest::collection::vec(any::<u8>(), 0..64)
        ) {
            let mut bytes = header.into_bytes();
            bytes.extend(data);
            if let Ok(map) = decoded(&bytes, 5000.0) {
                prop_assert_eq!(map.data().len(), (map.width() * map.height()) as usize);
            }
        }

        #[test]
        fn a_changed_byte_never_panics(at in 0usize..80, value: u8) {
            let mut bytes = encoded(ExtendedColorType::L16, &[7; 32], 4, 4);
            if let Some(byte) = bytes.get_mut(at) {
                *byte = value;
            }
            let _ = decoded(&bytes, 1000.0);
        }
    }
}
