//! Tests of the augmentation of pictures with boxes.

use super::*;
use crate::SetOptions;
use proptest::prelude::*;
use realnet_core::Stamp;
use realnet_vision::{Filter, Letterboxer};

/// A grey picture with a bright rectangle of each target.
fn picture(width: u32, height: u32, targets: &[Target], shade: u8) -> Frame {
    let mut data = vec![shade; 3 * (width * height) as usize];
    for target in targets {
        let b = target.to_pixels(width as f32, height as f32);
        for y in b.y0.round() as u32..b.y1.round() as u32 {
            for x in b.x0.round() as u32..b.x1.round() as u32 {
                let at = 3 * (y * width + x) as usize;
                data[at..at + 3].copy_from_slice(&[250, 250, 10]);
            }
        }
    }
    Frame::rgb8(Stamp::ZERO, width, height, data).unwrap()
}

fn target(cx: f32, cy: f32, w: f32, h: f32) -> Target {
    Target { class_id: 0, cx, cy, w, h }
}

fn set() -> Arc<DetectionSet> {
    let pictures = (0..9)
        .map(|i| {
            let at = 0.25 + 0.05 * i as f32;
            let targets = [target(at, 0.5, 0.25, 0.25), target(0.9, at, 0.1, 0.2)];
            let shown = &targets[..i % 3];
            (picture(160, 80 + 10 * i as u32, shown, 20 + i as u8), shown.to_vec())
        })
        .collect();
    Arc::new(DetectionSet::from_memory(vec!["box".into()], pictures, 64).unwrap())
}

#[test]
fn validation_is_the_letterbox_of_run_time() {
    let data = (0..3 * 90 * 50u32).map(|i| (i * 7919 % 256) as u8).collect();
    let frame = Frame::rgb8(Stamp::ZERO, 90, 50, data).unwrap();
    let targets = vec![target(0.5, 0.5, 0.2, 0.4)];
    let set = DetectionSet::from_memory(vec!["a".into()], vec![(frame.clone(), targets)], 64);
    let sample = DetectionSamples::validation(Arc::new(set.unwrap())).sample(0, 0).unwrap();
    let mut wanted = vec![0.0; 3 * 64 * 64];
    let mut boxer = Letterboxer::new(64, 64, Filter::Triangle).unwrap();
    let letterbox = boxer.run(&frame, None, &mut wanted).unwrap();
    let batch = crate::DetectionBatch::collate(&[sample]);
    for (found, wanted) in batch.images.iter().zip(&wanted) {
        assert!((found - wanted).abs() < 1e-6, "{found} {wanted}");
    }
    let [place, class, cx, cy, w, h] = batch.targets[0];
    let b = letterbox.input_from_frame(&BoundingBox::new(36.0, 15.0, 54.0, 35.0));
    let wanted = Target::from_pixels(0, &b, 64.0, 64.0);
    assert_eq!((place, class), (0.0, 0.0));
    for (found, wanted) in
        [cx, cy, w, h].into_iter().zip([wanted.cx, wanted.cy, wanted.w, wanted.h])
    {
        assert!((found - wanted).abs() < 1e-5);
    }
}

/// The bright rectangles lie where the boxes say, whatever happened to the picture.
#[test]
fn boxes_are_around_what_they_label() {
    let rough = DetectionAugment {
        mosaic: 0.5,
        degrees: 10.0,
        translate: 0.1,
        scale: 0.3,
        shear: 3.0,
        perspective: 0.0005,
        flipud: 0.5,
        fliplr: 0.5,
        ..DetectionAugment::NONE
    };
    let samples = DetectionSamples::training(set(), rough, 3).unwrap();
    let (mut seen, mut bright, mut stray) = (0, 0, 0);
    for epoch in 0..40 {
        for index in 0..samples.len() {
            let sample = samples.sample(epoch, index).unwrap();
            let boxes: Vec<_> = sample.targets.iter().map(|t| t.to_pixels(64.0, 64.0)).collect();
            let is_bright = |x: usize, y: usize| {
                sample.image[y * 64 + x] > 200 && sample.image[2 * 4096 + y * 64 + x] < 60
            };
            for b in &boxes {
                assert!(
                    b.x0 >= -1e-3 && b.y0 >= -1e-3 && b.x1 <= 64.001 && b.y1 <= 64.001,
                    "{b:?}"
                );
                let inside = (0..4096).filter(|i| {
                    let (x, y) = ((i % 64) as f32 + 0.5, (i / 64) as f32 + 0.5);
                    x > b.x0 && x < b.x1 && y > b.y0 && y < b.y1 && is_bright(i % 64, i / 64)
                });
                seen += 1;
                // A turned rectangle fills most of the box around it; a corner that is left
                // at the edge of the picture may not.
                let is_cut = b.x0 < 1.0 || b.y0 < 1.0 || b.x1 > 63.0 || b.y1 > 63.0;
                let share = if is_cut { 0.0 } else { 0.5 };
                assert!(inside.count() as f32 >= share * b.area(), "{epoch} {index} {b:?}");
            }
            for (x, y) in (0..4096).map(|i| (i % 64, i / 64)).filter(|&(x, y)| is_bright(x, y)) {
                let (x, y) = (x as f32 + 0.5, y as f32 + 0.5);
                let near = |b: &BoundingBox| {
                    x > b.x0 - 1.0 && x < b.x1 + 1.0 && y > b.y0 - 1.0 && y < b.y1 + 1.0
                };
                bright += 1;
                stray += usize::from(!boxes.iter().any(near));
            }
        }
    }
    assert!(seen > 300 && bright > 10_000, "{seen} {bright}");
    // Only rests of rectangles, too small to be learned, have no box.
    assert!(stray * 50 < bright, "{stray} of {bright}");
}

#[test]
fn the_last_epochs_are_without_mosaic() {
    let augment = DetectionAugment { mosaic: 1.0, ..DetectionAugment::NONE };
    let with = DetectionSamples::training(set(), augment, 1).unwrap().with_mosaic_until(5);
    let plain = DetectionSamples::validation(set());
    for index in 0..with.len() {
        assert_ne!(with.sample(4, index).unwrap().image, plain.sample(0, index).unwrap().image);
        assert_eq!(with.sample(5, index).unwrap().image, plain.sample(0, index).unwrap().image);
    }
}

#[test]
fn a_sample_follows_from_seed_epoch_and_index() {
    let augment = DetectionAugment { mixup: 0.5, ..DetectionAugment::default() };
    let one = DetectionSamples::training(set(), augment, 9).unwrap();
    let same = DetectionSamples::training(set(), augment, 9).unwrap();
    let other = DetectionSamples::training(set(), augment, 10).unwrap();
    // Backwards, so that what came before does not matter.
    let backwards: Vec<_> = (0..one.len()).rev().map(|i| same.sample(2, i).unwrap()).collect();
    for (index, again) in (0..one.len()).zip(backwards.into_iter().rev()) {
        let sample = one.sample(2, index).unwrap();
        assert_eq!(sample, again);
        assert_ne!(sample.image, one.sample(3, index).unwrap().image);
        assert_ne!(sample.image, other.sample(2, index).unwrap().image);
    }
}

#[test]
fn mixup_keeps_the_objects_of_both() {
    let augment = DetectionAugment { mosaic: 1.0, mixup: 1.0, ..DetectionAugment::NONE };
    let single = DetectionAugment { mixup: 0.0, ..augment };
    let mean = |augment| {
        let samples = DetectionSamples::training(set(), augment, 4).unwrap();
        let all = (0..20).flat_map(|e| (0..9).map(move |i| (e, i)));
        all.map(|(e, i)| samples.sample(e, i).unwrap().targets.len()).sum::<usize>() as f64 / 180.0
    };
    let (one, two) = (mean(single), mean(augment));
    assert!((1.7..2.3).contains(&(two / one)), "{one} {two}");
}

#[test]
fn options_have_yolov5s_names_and_ranges() {
    let text = "mosaic: 0.5\nhsv_s: 0.2\nfliplr: 0.0\nexposure: 1";
    let read: DetectionAugment = serde_saphyr::from_str(text).unwrap();
    assert_eq!((read.mosaic, read.color.hsv_s, read.fliplr, read.scale), (0.5, 0.2, 0.0, 0.5));
    for bad in ["degrees: 200", "translate: -0.1", "scale: 1", "hsv_v: 2", "perspective: .nan"] {
        let read: DetectionAugment = serde_saphyr::from_str(bad).unwrap();
        assert!(read.check().is_err(), "{bad}");
    }
}

#[test]
fn small_thin_and_hidden_boxes_are_no_candidates() {
    let before = BoundingBox::from_corner(0.0, 0.0, 20.0, 20.0);
    let after = |w, h| is_candidate(&before, &BoundingBox::from_corner(0.0, 0.0, w, h), 1.0);
    assert!(after(10.0, 10.0) && after(20.0, 2.5));
    assert!(!after(2.0, 30.0) && !after(6.0, 6.0) && !after(0.0, 0.0));
    let long = BoundingBox::from_corner(0.0, 0.0, 300.0, 2.5);
    assert!(!is_candidate(&long, &long, 1.0));
    assert!(!is_candidate(&before, &BoundingBox::from_corner(0.0, 0.0, 10.0, 10.0), 2.0));
}

/// Files of every kind of trouble.
#[test]
fn the_check_counts_and_names_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for sub in ["images", "labels"] {
        std::fs::create_dir(path(sub)).unwrap();
    }
    let frame = picture(40, 30, &[], 90);
    let write = |name: &str, rows: Option<&str>| {
        realnet_io::picture::write(&path(&format!("images/{name}.png")), &frame).unwrap();
        if let Some(rows) = rows {
            std::fs::write(path(&format!("labels/{name}.txt")), rows).unwrap();
        }
    };
    write("good", Some("0 0.5 0.5 0.2 0.2\n1 0.2 0.2 0.1 0.1\n"));
    write("background", Some("\n"));
    write("nothing", None);
    write("twice", Some("0 0.5 0.5 0.2 0.2\n0 0.5 0.5 0.2 0.2\n"));
    write("nan", Some("0 nan 0.5 0.2 0.2\n0 0.5 inf 0.2 0.2\n0 0.5 0.5 0.2 0.2\n"));
    write(
        "over",
        Some("0 0.95 0.5 0.2 0.2\n0 1.5 0.5 0.2 0.2\n0 0.5 0.5 -0.2 0.2\n0 0.5 0.5 0 0\n"),
    );
    std::fs::write(path("images/broken.jpg"), b"\xff\xd8\xff nothing").unwrap();
    std::fs::write(path("images/empty.jpg"), b"").unwrap();
    std::fs::write(path("list.txt"), "images/gone.jpg\n").unwrap();
    let yaml = "path: .\ntrain: [images, list.txt]\nnames: [car, bus]\n";
    std::fs::write(path("data.yaml"), yaml).unwrap();
    let open = |threads| {
        let options = SetOptions { threads, ..SetOptions::default() };
        DetectionSet::open(&path("data.yaml"), "train", 32, &options)
    };
    let set = open(2).unwrap();
    let report = set.report();
    assert_eq!(report, open(1).unwrap().report());
    assert_eq!((report.pictures, report.usable, report.backgrounds), (9, 6, 2));
    assert_eq!(report.classes, [("car".to_owned(), 4), ("bus".to_owned(), 1)]);
    use crate::Problem;
    for (problem, count) in [
        (Problem::MissingImage, 1),
        (Problem::BrokenImage, 2),
        (Problem::BoxClipped, 1),
        (Problem::BoxOutside, 3),
        (Problem::RowNotFinite, 2),
        (Problem::RowTwice, 1),
    ] {
        assert_eq!(report.count(problem), count, "{problem:?}");
    }
    let text = report.to_string();
    assert!(text.contains("6 of 9 pictures are usable, 2 of them without objects"), "{text}");
    assert!(text.contains("labels/nan.txt:1: value 2 is nan"), "{text}");
    assert!(text.contains("1 boxes reach outside their picture (clipped), first:"), "{text}");
    // The clipped one ends at the edge.
    let clipped = set.images().iter().find(|i| i.path.ends_with("over.png")).unwrap();
    let edge = clipped.targets[0].to_pixels(1.0, 1.0);
    assert!((edge.x1 - 1.0).abs() < 1e-6 && (edge.x0 - 0.85).abs() < 1e-6);

    write("class", Some("0 0.5 0.5 0.2 0.2\n2 0.5 0.5 0.2 0.2\n"));
    let error = open(2).unwrap_err().to_string();
    assert!(
        error.ends_with("class.txt:2: class 2 is not one of the 2 classes (0 to 1)"),
        "{error}"
    );
    write("class", Some("0 0.5 0.5 0.2\n"));
    assert!(open(2).unwrap_err().to_string().contains("class.txt:1: 4 values in a row"));
}

#[test]
fn a_set_without_objects_or_pictures_is_refused() {
    let frame = picture(40, 30, &[], 90);
    let error = DetectionSet::from_memory(vec!["a".into()], vec![(frame.clone(), vec![])], 32);
    let text = error.unwrap_err().to_string();
    assert!(text.starts_with("nothing to learn from is left: 1 of 1 pictures"), "{text}");
    assert!(DetectionSet::from_memory(vec!["a".into()], vec![], 32).is_err());
    let bad = vec![(frame.clone(), vec![Target { class_id: 1, ..target(0.5, 0.5, 0.5, 0.5) }])];
    let text = DetectionSet::from_memory(vec!["a".into()], bad, 32).unwrap_err().to_string();
    assert_eq!(text, "picture 0:1: class 1 is not one of the 1 classes (0 to 0)");
    assert!(DetectionSet::from_memory(vec!["a".into()], vec![], 4).is_err());
}

/// A picture that vanishes after the check costs its sample only.
#[test]
fn a_picture_that_vanishes_later_is_an_error_of_its_sample() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir(path("images")).unwrap();
    std::fs::create_dir(path("labels")).unwrap();
    for name in ["a", "b"] {
        let file = path(&format!("images/{name}.png"));
        realnet_io::picture::write(&file, &picture(40, 30, &[], 90)).unwrap();
        std::fs::write(path(&format!("labels/{name}.txt")), "0 0.5 0.5 0.5 0.5").unwrap();
    }
    std::fs::write(path("data.yaml"), "train: images\nnames: [car]\n").unwrap();
    let options = SetOptions { cache_bytes: 0, ..SetOptions::default() };
    let set = DetectionSet::open(&path("data.yaml"), "train", 32, &options).unwrap();
    assert_eq!(set.report().cached, (0, 0));
    std::fs::remove_file(path("images/b.png")).unwrap();
    let samples = DetectionSamples::validation(Arc::new(set));
    assert!(samples.sample(0, 0).is_ok());
    let error = samples.sample(0, 1).unwrap_err();
    assert!(error.path.ends_with("b.png") && error.index == 1, "{error}");
}

proptest! {
    /// The box of a warped box holds all its warped corners and is no larger than they ask.
    #[test]
    fn boxes_hold_their_corners(
        (x, y) in (-50.0f32..100.0, -50.0f32..100.0), (w, h) in (1.0f32..60.0, 1.0f32..60.0),
        index in 0usize..1000,
    ) {
        let augment = DetectionAugment {
            degrees: 45.0, translate: 0.4, scale: 0.8, shear: 20.0, perspective: 0.001,
            ..DetectionAugment::NONE
        };
        let mut dice = Dice::new(1, Purpose::Detection, 0, index);
        let scene = Scene { mosaic: true, flipud: index % 2 == 0, fliplr: index % 3 == 0 };
        let map = scene.flips(64.0) * geometry(&augment, &mut dice, 128.0, 64.0);
        let before = BoundingBox::from_corner(x, y, w, h);
        let Some(after) = around_corners(&map, &before) else { return Ok(()) };
        let (mut left, mut top) = (f64::MAX, f64::MAX);
        for i in 0..=4 {
            for j in 0..=4 {
                let (s, t) = (f64::from(i) / 4.0, f64::from(j) / 4.0);
                let at = [f64::from(x) + s * f64::from(w), f64::from(y) + t * f64::from(h)];
                let [u, v] = warp::apply(&map, at);
                let slack = 1e-3 * (1.0 + u.abs() + v.abs());
                prop_assert!(u >= f64::from(after.x0) - slack && u <= f64::from(after.x1) + slack);
                prop_assert!(v >= f64::from(after.y0) - slack && v <= f64::from(after.y1) + slack);
                (left, top) = (left.min(u), top.min(v));
            }
        }
        prop_assert!((left - f64::from(after.x0)).abs() < 1e-3 * (1.0 + left.abs()));
        prop_assert!((top - f64::from(after.y0)).abs() < 1e-3 * (1.0 + top.abs()));
    }
}
