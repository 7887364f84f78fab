//! Picture files, good and bad.
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use realnet_core::{Frame, PixelFormat, Stamp};
use realnet_io::picture::{self, DecodeError, Encoding, Limits, PictureError};
use realnet_io::source::{SourceOptions, open};
use std::path::Path;

/// A picture with structure, so that its JPEG is not trivial.
fn pattern(width: u32, height: u32) -> Frame {
    let data = (0..height)
        .flat_map(|y| (0..width).flat_map(move |x| [x * 5, y * 3, (x * y) / 7].map(|v| v as u8)))
        .collect();
    Frame::rgb8(Stamp::ZERO, width, height, data).unwrap()
}

fn decode(bytes: &[u8]) -> Result<Frame, DecodeError> {
    picture::decode(bytes, &Limits::default(), Vec::new())
}

fn difference(a: &Frame, b: &Frame) -> f64 {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let sum: u64 = a.data().iter().zip(b.data()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.data().len() as f64
}

/// A PNG of any colour type, through the `image` crate.
fn png(color: image::ExtendedColorType, width: u32, height: u32, data: &[u8]) -> Vec<u8> {
    use image::ImageEncoder;
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(data, width, height, color)
        .unwrap();
    bytes
}

#[test]
fn png_is_lossless_and_jpeg_is_close() {
    let dir = tempfile::tempdir().unwrap();
    let frame = pattern(97, 61);
    let path = dir.path().join("a.png");
    picture::write(&path, &frame).unwrap();
    assert_eq!(picture::read(&path).unwrap(), frame);
    let path = dir.path().join("a.JPG");
    picture::write(&path, &frame).unwrap();
    assert!(difference(&picture::read(&path).unwrap(), &frame) < 4.0);
    let grey = frame.to_grey();
    for name in ["g.png", "g.jpg"] {
        let path = dir.path().join(name);
        picture::write(&path, &grey).unwrap();
        let back = picture::read(&path).unwrap();
        assert_eq!(back.format(), PixelFormat::Rgb8);
        assert!(difference(&back, &grey.to_rgb()) < 4.0);
    }
}

#[test]
fn alpha_is_dropped_and_sixteen_bits_are_cut() {
    use image::ExtendedColorType::{L16, La8, Rgb16, Rgba8, Rgba16};
    let rgb = |bytes: Vec<u8>| decode(&bytes).unwrap().into_data();
    assert_eq!(rgb(png(Rgba8, 1, 1, &[9, 8, 7, 0])), [9, 8, 7]);
    assert_eq!(rgb(png(La8, 1, 1, &[200, 3])), [200; 3]);
    // The encoder takes 16-bit samples in the machine's own order.
    let wide: Vec<u8> =
        [0x12ffu16, 0x34ff, 0x56ff, 0x1000].iter().flat_map(|v| v.to_ne_bytes()).collect();
    assert_eq!(rgb(png(Rgba16, 1, 1, &wide)), [0x12, 0x34, 0x56]);
    assert_eq!(rgb(png(Rgb16, 1, 1, &wide[..6])), [0x12, 0x34, 0x56]);
    assert_eq!(rgb(png(L16, 1, 1, &wide[..2])), [0x12; 3]);
}

/// A JPEG with an EXIF block that holds nothing but the orientation.
fn with_orientation(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    let length = (exif.len() + 2) as u16;
    let mut bytes = vec![0xff, 0xd8, 0xff, 0xe1];
    bytes.extend(length.to_be_bytes());
    bytes.extend(exif);
    bytes.extend(&jpeg[2..]);
    bytes
}

#[test]
fn exif_orientation_is_applied() {
    // White at the top left of a black picture.
    let mut frame = Frame::rgb8(Stamp::ZERO, 64, 32, vec![0; 64 * 32 * 3]).unwrap();
    for y in 0..16 {
        frame.data_mut()[y * 192..y * 192 + 48].fill(255);
    }
    let jpeg = picture::encode(&frame, Encoding::Jpeg { quality: 95 }).unwrap();
    // Orientation, size, and the corner (right, bottom) where white must be.
    for (orientation, size, right, bottom) in [
        (1, (64, 32), false, false),
        (2, (64, 32), true, false),
        (3, (64, 32), true, true),
        (4, (64, 32), false, true),
        (5, (32, 64), false, false),
        (6, (32, 64), true, false),
        (7, (32, 64), true, true),
        (8, (32, 64), false, true),
        (9, (64, 32), false, false),
    ] {
        let turned = decode(&with_orientation(&jpeg, orientation)).unwrap();
        let (w, h) = (turned.width(), turned.height());
        assert_eq!((w, h), size, "orientation {orientation}");
        let x = if right { w - 4 } else { 4 } as usize;
        let y = if bottom { h - 4 } else { 4 } as usize;
        assert!(turned.data()[(y * w as usize + x) * 3] > 200, "orientation {orientation}");
    }
}

#[test]
fn every_truncation_of_a_jpeg_is_an_error() {
    let whole = picture::encode(&pattern(160, 120), Encoding::Jpeg { quality: 90 }).unwrap();
    assert!(decode(&whole).is_ok());
    for length in 0..whole.len() {
        assert!(decode(&whole[..length]).is_err(), "{length} of {} bytes", whole.len());
    }
}

#[test]
fn every_truncation_of_a_png_is_an_error() {
    let whole = picture::encode(&pattern(40, 30), Encoding::Png).unwrap();
    for length in 0..whole.len() - 16 {
        assert!(decode(&whole[..length]).is_err(), "{length} of {} bytes", whole.len());
    }
}

#[test]
fn real_jpegs_cut_in_half_are_errors() {
    for name in ["data/samples/bus.jpg", "data/samples/zidane.jpg"] {
        let Some(path) = common::shared(name) else { return };
        let bytes = std::fs::read(path).unwrap();
        let frame = decode(&bytes).unwrap();
        assert!(frame.width() > 700);
        for percent in [1, 10, 50, 90, 99] {
            let cut = &bytes[..bytes.len() * percent / 100];
            assert!(matches!(decode(cut), Err(DecodeError::Jpeg(_))), "{name} at {percent} %");
        }
    }
}

#[test]
fn bad_files_are_named_with_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    let jpeg = picture::encode(&pattern(64, 64), Encoding::Jpeg { quality: 90 }).unwrap();
    let cases: [(&str, &[u8], &str); 8] = [
        ("empty.jpg", b"", "the file is empty"),
        ("text.jpg", b"hello, I am text", "text that starts with \"hello, I am text\""),
        ("gif.png", b"GIF89a\x01\0", "GIF"),
        ("webp.jpg", b"RIFF\0\0\0\0WEBPVP8 ", "WebP"),
        ("lfs.jpg", b"version https://git-lfs.github.com/spec/v1", "Git LFS"),
        ("bytes.png", b"\x00\x01\x02\xfe", "[00, 01, 02, fe]"),
        ("cut.jpg", &jpeg[..jpeg.len() / 2], "JPEG"),
        ("head.png", b"\x89PNG\r\n\x1a\n", "PNG"),
    ];
    for (name, bytes, wanted) in cases {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let error = picture::read(&path).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(wanted), "{error}");
    }
    let error = picture::read(&dir.path().join("none.jpg")).unwrap_err().to_string();
    assert!(error.contains("none.jpg") && error.contains("No such file"), "{error}");
    assert!(matches!(picture::read(dir.path()), Err(PictureError::Read { .. })));
    // The contents count, not the name.
    let path = dir.path().join("really-a-jpeg.png");
    std::fs::write(&path, &jpeg).unwrap();
    assert_eq!(picture::read(&path).unwrap().width(), 64);
}

#[test]
fn bombs_are_refused_before_they_are_unpacked() {
    let limits = Limits { max_pixels: 1000, max_bytes: 1 << 20 };
    for encoding in [Encoding::Png, Encoding::Jpeg { quality: 90 }] {
        let bytes = picture::encode(&pattern(64, 64), encoding).unwrap();
        let error = picture::decode(&bytes, &limits, Vec::new()).unwrap_err();
        assert_eq!(error, DecodeError::TooLarge { width: 64, height: 64, limit: 1000 });
    }
    // A header that promises 65535 x 65535 pixels and holds none.
    let mut huge = picture::encode(&pattern(64, 64), Encoding::Jpeg { quality: 90 }).unwrap();
    let at = huge.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    huge[at + 5..at + 9].fill(0xff);
    assert!(matches!(decode(&huge), Err(DecodeError::TooLarge { .. } | DecodeError::Jpeg(_))));
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("big.jpg");
    std::fs::write(&path, vec![0; 2000]).unwrap();
    let limits = Limits { max_bytes: 1999, ..Limits::default() };
    let error = picture::read_with(&path, &limits, Vec::new()).unwrap_err().to_string();
    assert!(error.contains("big.jpg: more than 1999 bytes"), "{error}");
}

#[test]
fn unwritable_pictures_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let frame = pattern(8, 8);
    for (name, wanted) in [("no/such/folder.jpg", "No such file"), ("a.bmp", ".png"), ("a", ".png")]
    {
        let error = picture::write(&dir.path().join(name), &frame).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(wanted), "{error}");
    }
    std::fs::create_dir(dir.path().join("folder.png")).unwrap();
    let error = picture::write(&dir.path().join("folder.png"), &frame).unwrap_err().to_string();
    assert!(error.contains("folder.png") && error.contains("directory"), "{error}");
    let wide = Frame::rgb8(Stamp::ZERO, 70_000, 1, vec![0; 210_000]).unwrap();
    let error = picture::write(&dir.path().join("wide.jpg"), &wide).unwrap_err().to_string();
    assert!(error.contains("wide.jpg") && error.contains("70000x1"), "{error}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "rubbish was left");
}

fn names(spec: &str) -> Vec<String> {
    open(spec, &SourceOptions::default())
        .unwrap()
        .map(|item| {
            let name = item.unwrap().name;
            Path::new(&name).file_name().unwrap().to_string_lossy().into_owned()
        })
        .collect()
}

#[test]
fn folders_and_globs_come_in_natural_order() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str| picture::write(&dir.path().join(name), &pattern(16, 8)).unwrap();
    for name in ["10.png", "9.jpg", "1.jpeg", "b2.PNG", "b10.png"] {
        write(name);
    }
    write(".hidden.png");
    std::fs::write(dir.path().join("notes.txt"), "x").unwrap();
    std::fs::create_dir(dir.path().join("sub.png")).unwrap();
    let folder = dir.path().display().to_string();
    assert_eq!(names(&folder), ["1.jpeg", "9.jpg", "10.png", "b2.PNG", "b10.png"]);
    assert_eq!(names(&format!("{folder}/b*")), ["b2.PNG", "b10.png"]);
    assert_eq!(names(&format!("{folder}/[0-9].*")), ["1.jpeg", "9.jpg"]);
    assert_eq!(names(&format!("file://{folder}/10.png")), ["10.png"]);
}

#[test]
fn stamps_come_from_the_frame_rate_and_a_bad_picture_is_passed_over() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["0.png", "2.png"] {
        picture::write(&dir.path().join(name), &pattern(16, 8)).unwrap();
    }
    std::fs::write(dir.path().join("1.png"), b"").unwrap();
    let options = SourceOptions { fps: Some(10.0), ..SourceOptions::default() };
    let mut source = open(&dir.path().display().to_string(), &options).unwrap();
    assert_eq!((source.len_hint(), source.fps(), source.is_live()), (Some(3), Some(10.0), false));
    let first = source.next().unwrap().unwrap();
    assert_eq!((first.index, first.frame.stamp()), (0, Stamp::ZERO));
    source.recycle(first.frame);
    let error = source.next().unwrap().unwrap_err().to_string();
    assert!(error.contains("1.png: the file is empty"), "{error}");
    let last = source.next().unwrap().unwrap();
    assert_eq!((last.index, last.frame.stamp().nanos()), (2, 200_000_000));
    assert!(source.next().is_none());
    assert!(source.next().is_none());
}

#[test]
fn sources_that_do_not_exist_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().display().to_string();
    std::fs::write(dir.path().join("zero.mp4"), b"").unwrap();
    for (spec, wanted) in [
        (format!("{folder}/none.mp4"), "none.mp4: no such file"),
        (folder.clone(), "no .jpg, .jpeg or .png files"),
        (format!("{folder}/*.jpg"), "*.jpg: no .jpg"),
        (format!("{folder}/a[.jpg"), "a[.jpg"),
        (format!("{folder}/zero.mp4"), "zero.mp4: the file is empty"),
        (String::new(), "no such file"),
    ] {
        let error = open(&spec, &SourceOptions::default()).err().unwrap().to_string();
        assert!(error.contains(wanted), "{spec}: {error}");
    }
    for fps in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let options = SourceOptions { fps: Some(fps), ..SourceOptions::default() };
        assert!(open(&folder, &options).is_err(), "{fps}");
    }
}

#[cfg(not(feature = "v4l"))]
#[test]
fn without_camera_support_the_feature_is_named() {
    for spec in ["/dev/video0", "0"] {
        let error = open(spec, &SourceOptions::default()).err().unwrap().to_string();
        assert!(error.contains("/dev/video0") && error.contains("`v4l`"), "{error}");
    }
}

#[test]
fn a_source_can_be_stopped_and_dropped_midway() {
    let dir = tempfile::tempdir().unwrap();
    for i in 0..20 {
        picture::write(&dir.path().join(format!("{i}.png")), &pattern(64, 64)).unwrap();
    }
    let spec = dir.path().display().to_string();
    let mut source = open(&spec, &SourceOptions::default()).unwrap();
    assert!(source.next().unwrap().is_ok());
    source.stopper().stop();
    assert!(source.next().is_none());
    let mut source = open(&spec, &SourceOptions::default()).unwrap();
    assert!(source.next().unwrap().is_ok());
}
