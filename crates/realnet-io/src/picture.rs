//! JPEG and PNG files to frames and back.
//!
//! Pictures are read as OpenCV's `imread` reads them with its default flags:
//! turned by the EXIF orientation, alpha dropped (not blended), 16-bit samples
//! cut to their upper byte, grey repeated into RGB. Unlike `imread`, a damaged
//! or truncated file is an error, never a picture with a grey rest. What the
//! bytes are counts, not what the name says.

use crate::atomic::{self, WriteError};
use image::codecs::{jpeg::JpegEncoder, png::PngDecoder};
use image::metadata::Orientation;
use image::{DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, RgbImage};
use realnet_core::{Frame, FrameError, PixelFormat, Stamp};
use std::io::{self, Cursor, Read};
use std::path::{Path, PathBuf};
use thiserror::Error;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};

/// File name extensions (lower case) that are read as pictures.
pub const EXTENSIONS: [&str; 3] = ["jpg", "jpeg", "png"];

/// What a picture may cost before it is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Width times height; default 100 million (300 MB as RGB).
    pub max_pixels: u64,
    /// Size of the file in bytes; default 512 MiB.
    pub max_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { max_pixels: 100_000_000, max_bytes: 512 << 20 }
    }
}

/// Why bytes are no picture.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// No bytes.
    #[error("the file is empty")]
    Empty,
    /// Neither JPEG nor PNG.
    #[error("neither JPEG nor PNG: {found}")]
    Format {
        /// What the first bytes look like.
        found: String,
    },
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
    /// A damaged or truncated JPEG, or one of an unsupported kind.
    #[error("damaged, truncated or unsupported JPEG: {0}")]
    Jpeg(String),
    /// A damaged or truncated PNG, or one of an unsupported kind.
    #[error("damaged, truncated or unsupported PNG: {0}")]
    Png(String),
    /// The decoded pixels do not make a frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
}

/// Why a picture file could not be read or written.
#[derive(Debug, Error)]
pub enum PictureError {
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
    FileTooLarge {
        /// The file.
        path: PathBuf,
        /// The limit in bytes.
        limit: u64,
    },
    /// The bytes are no picture.
    #[error("{}: {reason}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What is wrong with its bytes.
        reason: DecodeError,
    },
    /// A name whose extension is no picture format.
    #[error("{}: pictures are written as .jpg, .jpeg or .png", path.display())]
    Extension {
        /// The name asked for.
        path: PathBuf,
    },
    /// The picture cannot be encoded (a JPEG side ends at 65535 pixels).
    #[error("{}: cannot encode {width}x{height} pixels: {reason}", path.display())]
    Encode {
        /// The file asked for.
        path: PathBuf,
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
        /// What the encoder said.
        reason: String,
    },
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// True for a name that ends in one of [`EXTENSIONS`], in any case.
#[must_use]
pub fn has_picture_extension(path: &Path) -> bool {
    extension(path).is_some_and(|e| EXTENSIONS.contains(&e.as_str()))
}

/// The extension in lower case.
pub(crate) fn extension(path: &Path) -> Option<String> {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase())
}

/// Reads a JPEG or PNG file as RGB with the default [`Limits`]; its stamp is
/// [`Stamp::ZERO`].
///
/// # Errors
/// [`PictureError`] with the path and the reason.
pub fn read(path: &Path) -> Result<Frame, PictureError> {
    read_with(path, &Limits::default(), Vec::new())
}

/// As [`read`], with limits and a used buffer whose memory may be taken.
///
/// # Errors
/// [`PictureError`] with the path and the reason.
pub fn read_with(path: &Path, limits: &Limits, buffer: Vec<u8>) -> Result<Frame, PictureError> {
    let failed = |reason| PictureError::Read { path: path.to_path_buf(), reason };
    let file = std::fs::File::open(path).map_err(failed)?;
    let mut bytes = Vec::new();
    file.take(limits.max_bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > limits.max_bytes {
        return Err(PictureError::FileTooLarge {
            path: path.to_path_buf(),
            limit: limits.max_bytes,
        });
    }
    decode(&bytes, limits, buffer)
        .map_err(|reason| PictureError::Decode { path: path.to_path_buf(), reason })
}

/// Decodes the bytes of a JPEG or PNG file to RGB; the stamp is
/// [`Stamp::ZERO`]. The memory of `buffer` is used again where that is possible.
///
/// # Errors
/// [`DecodeError`] when the bytes are no whole picture or exceed `limits`.
pub fn decode(bytes: &[u8], limits: &Limits, buffer: Vec<u8>) -> Result<Frame, DecodeError> {
    if bytes.is_empty() {
        Err(DecodeError::Empty)
    } else if bytes.starts_with(&[0xff, 0xd8, 0xff]) {
        decode_jpeg(bytes, limits, buffer)
    } else if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        decode_png(bytes, limits)
    } else {
        Err(DecodeError::Format { found: guess(bytes) })
    }
}

/// What bytes that are no JPEG or PNG look like, for people.
fn guess(bytes: &[u8]) -> String {
    let at =
        |offset: usize, magic: &[u8]| bytes.get(offset..).is_some_and(|b| b.starts_with(magic));
    let name = if at(0, b"GIF8") {
        "GIF"
    } else if at(0, b"RIFF") && at(8, b"WEBP") {
        "WebP"
    } else if at(0, b"BM") {
        "BMP"
    } else if at(0, b"II*\0") || at(0, b"MM\0*") {
        "TIFF"
    } else if at(4, b"ftyphei") || at(4, b"ftypmif") {
        "HEIF"
    } else if at(4, b"ftypavif") {
        "AVIF"
    } else if at(4, b"ftyp") {
        "an MP4 video"
    } else if at(0, b"version https://git-lfs") {
        "a Git LFS pointer, not the file itself"
    } else {
        let head = &bytes[..bytes.len().min(16)];
        return if head.iter().all(|b| matches!(b, 9 | 10 | 13 | 32..=126)) {
            format!("text that starts with {:?}", String::from_utf8_lossy(head))
        } else {
            format!("it starts with the bytes {head:02x?}")
        };
    };
    format!("it looks like {name}")
}

fn check_size(width: usize, height: usize, limits: &Limits) -> Result<(), DecodeError> {
    let (width, height) = (width as u64, height as u64);
    if width.saturating_mul(height) > limits.max_pixels {
        return Err(DecodeError::TooLarge { width, height, limit: limits.max_pixels });
    }
    Ok(())
}

/// True when an end marker follows the pixel data. Inside the data a 0xff byte
/// is always escaped or a restart marker (ITU-T T.81, B.1.1.5); the segments
/// before, which may hold a whole preview picture, are stepped over.
fn has_end_marker(jpeg: &[u8]) -> bool {
    let mut at = 2;
    while let Some(&[0xff, marker, high, low]) = jpeg.get(at..at + 4) {
        if marker == 0xff {
            at += 1; // fill byte
            continue;
        }
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker == 0xda {
            break;
        }
    }
    jpeg.get(at..).is_some_and(|data| data.windows(2).any(|pair| pair == [0xff, 0xd9]))
}

/// Decodes a JPEG to RGB. Strict: a file that ends before its last pixel, or bad
/// code words, are an error. (Data cut out before a good end marker are filled
/// up by the decoder without a word; this cannot be told from outside.)
fn decode_jpeg(bytes: &[u8], limits: &Limits, mut pixels: Vec<u8>) -> Result<Frame, DecodeError> {
    let broken = |e: zune_jpeg::errors::DecodeErrors| DecodeError::Jpeg(e.to_string());
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX))
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(broken)?;
    let (width, height) =
        decoder.dimensions().ok_or_else(|| DecodeError::Jpeg("no size in the header".into()))?;
    check_size(width, height, limits)?;
    let orientation = decoder.exif().and_then(|e| Orientation::from_exif_chunk(e));
    pixels.clear();
    pixels.resize(width * height * 3, 0);
    decoder.decode_into(&mut pixels).map_err(broken)?;
    // The decoder passes over an end inside the last rows.
    if !has_end_marker(bytes) {
        return Err(DecodeError::Jpeg("the file ends before the end of the picture".into()));
    }
    // Both sides are at most 65535.
    let (width, height) = (width as u32, height as u32);
    match orientation {
        None | Some(Orientation::NoTransforms) => {
            Ok(Frame::rgb8(Stamp::ZERO, width, height, pixels)?)
        }
        Some(orientation) => {
            let found = pixels.len();
            let image = RgbImage::from_raw(width, height, pixels).ok_or(FrameError::Length {
                width,
                height,
                channels: 3,
                expected: width as usize * height as usize * 3,
                found,
            })?;
            upright(DynamicImage::ImageRgb8(image), orientation)
        }
    }
}

fn decode_png(bytes: &[u8], limits: &Limits) -> Result<Frame, DecodeError> {
    let broken = |e: image::ImageError| DecodeError::Png(e.to_string());
    let mut budget = image::Limits::default();
    // Eight bytes a pixel are the widest PNG: RGBA of 16 bits.
    budget.max_alloc = Some(limits.max_pixels.saturating_mul(8).saturating_add(1 << 20));
    let mut decoder = PngDecoder::with_limits(Cursor::new(bytes), budget).map_err(broken)?;
    let (width, height) = decoder.dimensions();
    check_size(width as usize, height as usize, limits)?;
    // Text that is not readable as EXIF is no reason to refuse the pixels.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    upright(DynamicImage::from_decoder(decoder).map_err(broken)?, orientation)
}

fn upright(image: DynamicImage, orientation: Orientation) -> Result<Frame, DecodeError> {
    let mut image = DynamicImage::ImageRgb8(to_rgb8(image));
    image.apply_orientation(orientation);
    let image = image.into_rgb8();
    let (width, height) = image.dimensions();
    Ok(Frame::rgb8(Stamp::ZERO, width, height, image.into_raw())?)
}

/// To 8-bit RGB: the upper byte of 16-bit samples, alpha dropped.
fn to_rgb8(image: DynamicImage) -> RgbImage {
    let (width, height) = (image.width(), image.height());
    let data: Vec<u8> = match image {
        DynamicImage::ImageRgb8(rgb) => return rgb,
        DynamicImage::ImageLuma8(g) => g.iter().flat_map(|&v| [v; 3]).collect(),
        DynamicImage::ImageLumaA8(ga) => ga.pixels().flat_map(|p| [p.0[0]; 3]).collect(),
        DynamicImage::ImageRgba8(rgba) => {
            rgba.pixels().flat_map(|p| [p.0[0], p.0[1], p.0[2]]).collect()
        }
        DynamicImage::ImageLuma16(g) => g.iter().flat_map(|&v| [(v >> 8) as u8; 3]).collect(),
        DynamicImage::ImageLumaA16(ga) => {
            ga.pixels().flat_map(|p| [(p.0[0] >> 8) as u8; 3]).collect()
        }
        DynamicImage::ImageRgb16(rgb) => rgb.iter().map(|&v| (v >> 8) as u8).collect(),
        DynamicImage::ImageRgba16(rgba) => {
            rgba.pixels().flat_map(|p| [p.0[0], p.0[1], p.0[2]].map(|v| (v >> 8) as u8)).collect()
        }
        // The PNG decoder makes no other kind; the library's own rule for the rest.
        other => return other.into_rgb8(),
    };
    RgbImage::from_raw(width, height, data).unwrap_or_default()
}

/// How a picture is compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// JPEG of a quality from 1 to 100.
    Jpeg {
        /// 1 (small) to 100 (good).
        quality: u8,
    },
    /// PNG, lossless.
    Png,
}

/// Compresses a frame to the bytes of a picture file.
///
/// # Errors
/// The encoder's message, for a frame larger than the format allows.
pub fn encode(frame: &Frame, encoding: Encoding) -> Result<Vec<u8>, String> {
    let color = match frame.format() {
        PixelFormat::Rgb8 => ExtendedColorType::Rgb8,
        PixelFormat::Grey8 => ExtendedColorType::L8,
    };
    let (width, height) = (frame.width(), frame.height());
    let mut bytes = Vec::new();
    match encoding {
        Encoding::Jpeg { quality } => JpegEncoder::new_with_quality(
            &mut bytes,
            quality.clamp(1, 100),
        )
        .write_image(frame.data(), width, height, color),
        Encoding::Png => image::codecs::png::PngEncoder::new(&mut bytes).write_image(
            frame.data(),
            width,
            height,
            color,
        ),
    }
    .map_err(|e| e.to_string())?;
    Ok(bytes)
}

/// Writes a frame as JPEG (quality 95) or PNG, by the extension of `path`,
/// whole or not at all. The folder must exist.
///
/// # Errors
/// [`PictureError`] with the path: unknown extension, too large for the format,
/// or not writable.
pub fn write(path: &Path, frame: &Frame) -> Result<(), PictureError> {
    let encoding = match extension(path).as_deref() {
        Some("jpg" | "jpeg") => Encoding::Jpeg { quality: 95 },
        Some("png") => Encoding::Png,
        _ => return Err(PictureError::Extension { path: path.to_path_buf() }),
    };
    let bytes = encode(frame, encoding).map_err(|reason| PictureError::Encode {
        path: path.to_path_buf(),
        width: frame.width(),
        height: frame.height(),
        reason,
    })?;
    Ok(atomic::write(path, &bytes)?)
}
