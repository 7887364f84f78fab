//! Tests of the augmentation of pictures with depth, and of the check of their sets.

use super::*;
use crate::{
    CheckReport, DepthBatch, DepthPart, DepthSetOptions, DepthSource, HoldOut, Problem,
    RgbdPicture, SetOptions, SourceCamera, SourceList,
};
use proptest::prelude::*;
use realnet_core::{CameraCalibration, CameraModel, DepthMap, Distortion, Frame, Stamp};
use realnet_io::{depth, picture};
use realnet_vision::{Filter, Letterboxer};

/// Depth of the bowl `z = NEAR + BEND (x² + y²)`, which a turn about the optical axis and a
/// mirror leave as it is; flat enough that every ray of the cameras below meets it.
const NEAR: f64 = 1.5;
const BEND: f64 = 0.08;

fn camera(width: u32, height: u32, focal: f64) -> CameraModel {
    let intrinsics = Intrinsics {
        fx: focal,
        fy: focal * 1.02,
        cx: 0.47 * f64::from(width),
        cy: 0.55 * f64::from(height),
    };
    CameraModel::new(width, height, intrinsics, Distortion::None).unwrap()
}

/// The bowl, the red of each pixel telling its depth, with a patch of unknown depth.
fn bowl(camera: CameraModel) -> RgbdPicture {
    let (width, height) = (camera.width(), camera.height());
    let (mut depths, mut colors) = (Vec::new(), Vec::new());
    for v in 0..height {
        for u in 0..width {
            let [x, y] = camera.unproject([f64::from(u), f64::from(v)]).unwrap();
            let a = BEND * (x * x + y * y);
            // z = NEAR + a z², the smaller root.
            let z = if a > 1e-9 { (1.0 - (1.0 - 4.0 * a * NEAR).sqrt()) / (2.0 * a) } else { NEAR };
            let hidden = u < width / 8 && v < height / 8;
            depths.push(if hidden { 0.0 } else { z as f32 });
            colors.extend([(z * 60.0).min(255.0) as u8, u as u8, v as u8]);
        }
    }
    RgbdPicture {
        frame: Frame::rgb8(Stamp::ZERO, width, height, colors).unwrap(),
        depth: DepthMap::new(Stamp::ZERO, width, height, depths).unwrap(),
        camera,
    }
}

fn set(pictures: Vec<RgbdPicture>, options: &DepthSetOptions) -> Arc<DepthSet> {
    Arc::new(DepthSet::from_memory(pictures, options).unwrap())
}

fn canonical() -> CanonicalFocal {
    CanonicalFocal::new(70.0).unwrap()
}

const ROUGH: DepthAugment = DepthAugment {
    fliplr: 0.5,
    degrees: 30.0,
    zoom: [0.6, 2.0],
    translate: 0.2,
    color: ColorAugment::NONE,
};

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, ..ProptestConfig::default() })]
    /// Every depth of an augmented sample, back in metres and lifted by the sample's
    /// camera, lies on the bowl: whatever the source's camera, zoom, turn and shift.
    #[test]
    fn points_stay_on_their_surface(
        index in 0usize..1000, (w, h) in (60u32..130, 60u32..130), focal in 80.0f64..160.0,
        oversample in 1.0f64..2.0, epoch in 0u32..100,
    ) {
        let options = DepthSetOptions { oversample, ..DepthSetOptions::training((64, 48)) };
        let samples = DepthSamples::training(
            set(vec![bowl(camera(w, h, focal))], &options), ROUGH, canonical(),
            Normalization::default(), index as u64,
        ).unwrap();
        let sample = samples.sample(epoch, 0).unwrap();
        let Intrinsics { fx, fy, cx, cy } = sample.camera;
        let mut known = 0;
        for (i, depth) in sample.depth.iter().enumerate() {
            if !DepthMap::is_known(*depth) { continue }
            known += 1;
            let z = f64::from(depth * sample.metres_per_unit);
            let (u, v) = ((i % 64) as f64, (i / 64) as f64);
            let (x, y) = ((u - cx) * z / fx, (v - cy) * z / fy);
            let wanted = NEAR + BEND * (x * x + y * y);
            prop_assert!((z - wanted).abs() < 0.02 * wanted, "{} {}: {} {}", u, v, z, wanted);
            // The picture moved with the depth; at its edge it is mixed with the bars.
            let is_inside = [i.wrapping_sub(64), i.wrapping_sub(1), i + 1, i + 64]
                .into_iter()
                .all(|n| sample.depth.get(n).is_some_and(|depth| *depth > 0.0));
            let red = f64::from(sample.image[i]) * 255.0;
            let off = (red - (z * 60.0).min(255.0)).abs();
            let is_edge = i % 64 == 0 || i % 64 == 63;
            prop_assert!(is_edge || !is_inside || off < 9.0, "{} {}: {} {}", u, v, red, z);
        }
        prop_assert!(known > 100, "{}", known);
    }

    /// A point before and after re-projects to places that the warp connects.
    #[test]
    fn a_point_re_projects_where_the_warp_takes_it(
        seed: u64, (x, y, z) in (-1.0f64..1.0, -1.0f64..1.0, 0.5f64..10.0),
    ) {
        let options = DepthSetOptions::training((64, 48));
        let set = set(vec![bowl(camera(100, 80, 90.0))], &options);
        let kept = set.kept(0).unwrap();
        let mut dice = Dice::new(seed, Purpose::Depth, 0, 0);
        let view = View::new(&ROUGH, &mut dice, &kept, (64, 48));
        // The turn and mirror of the rays, from the map and the two cameras.
        let matrix = |k: Intrinsics| {
            Matrix3::new(k.fx, 0.0, k.cx + 0.5, 0.0, k.fy, k.cy + 0.5, 0.0, 0.0, 1.0)
        };
        let (source, out) = (matrix(kept.camera), matrix(view.camera));
        let turn = source.try_inverse().unwrap() * view.source_from_out * out;
        prop_assert!((turn * turn.transpose() - Matrix3::identity()).norm() < 1e-9);
        prop_assert!((turn[(2, 2)] - 1.0).abs() < 1e-12);
        let before = realnet_core::nalgebra::Vector3::new(x, y, z);
        let after = turn.transpose() * before;
        prop_assert!((after.z - z).abs() < 1e-9);
        let (p, q) = (source * before / z, out * after / after.z);
        let [u, v] = warp::apply(&view.source_from_out, [q.x, q.y]);
        prop_assert!((u - p.x).abs() < 1e-6 && (v - p.y).abs() < 1e-6);
    }
}

/// The same scene through two cameras, and cropped: the depth to learn is in proportion to
/// the focal length on the input, and metres come back.
#[test]
fn another_camera_and_a_crop_keep_the_metres() {
    let options = DepthSetOptions::validation((64, 48));
    let sample = |focal: f64| {
        let picture = bowl(camera(64, 48, focal));
        let samples = DepthSamples::validation(
            set(vec![picture], &options),
            canonical(),
            Normalization::default(),
        );
        samples.unwrap().sample(0, 0).unwrap()
    };
    let middle = 26 * 64 + 30; // at the principal point, (30.08, 26.4)
    let (wide, tele) = (sample(70.0), sample(140.0));
    for (sample, focal) in [(&wide, 70.0f32), (&tele, 140.0)] {
        let units = sample.depth[middle];
        assert!((units - 1.5 * 70.0 / (focal * 1.02f32.sqrt())).abs() < 1e-3, "{units}");
        assert!((units * sample.metres_per_unit - 1.5).abs() < 1e-3);
        assert!((sample.camera.fx - f64::from(focal)).abs() < 1e-9);
    }
    assert!((wide.depth[middle] / tele.depth[middle] - 2.0).abs() < 1e-3);
}

/// Without augmentation the network is shown what it is shown at run time, and the depth
/// is the file's.
#[test]
fn validation_is_the_letterbox_of_run_time() {
    let picture = bowl(camera(90, 50, 80.0));
    let options = DepthSetOptions::validation((64, 48));
    let normalization = Normalization::IMAGENET;
    let set = set(vec![picture.clone()], &options);
    let samples = DepthSamples::validation(set, canonical(), normalization).unwrap();
    let sample = samples.sample(0, 0).unwrap();
    let mut wanted = vec![0.0; 3 * 64 * 48];
    let mut boxer = Letterboxer::new(64, 48, Filter::Triangle).unwrap();
    let letterbox = boxer.run(&picture.frame, None, &mut wanted).unwrap();
    for (i, (found, wanted)) in sample.image.iter().zip(&wanted).enumerate() {
        let (mean, std) = (normalization.mean[i / 3072], normalization.std[i / 3072]);
        assert!((found - (wanted - mean) / std).abs() < 1e-5, "{i}");
    }
    let (_, height) = letterbox.scaled_size();
    for (y, row) in (0u32..).zip(sample.depth.chunks_exact(64)) {
        let is_bar = y < letterbox.top() || y >= letterbox.top() + height;
        let known = row.iter().filter(|depth| **depth > 0.0).count();
        assert!(if is_bar { known == 0 } else { known >= 55 }, "{y}: {known}");
    }
    let batch = DepthBatch::collate(&[sample.clone(), sample.clone()]);
    assert_eq!((batch.count, batch.images.len(), batch.depths.len()), (2, 6 * 3072, 2 * 3072));
    assert_eq!(batch.cameras, [sample.camera; 2]);
    assert!(sample.known_share() > 0.5 && sample.known_share() < 0.8);
}

#[test]
fn depths_beyond_the_range_are_unknown() {
    let options = DepthSetOptions::validation((64, 48));
    let of = |least, most| {
        let samples = DepthSamples::validation(
            set(vec![bowl(camera(64, 48, 70.0))], &options),
            canonical(),
            Normalization::default(),
        );
        let sample = samples.unwrap().with_range(least, most).sample(0, 0).unwrap();
        sample.depth.into_iter().filter(|depth| *depth > 0.0).collect::<Vec<_>>()
    };
    let (all, some) = (of(0.0, 100.0), of(1.5, 1.6));
    assert!(some.len() < all.len() && !some.is_empty());
    assert!(some.iter().all(|depth| (1.5..=1.6).contains(depth)));
}

#[test]
fn a_sample_follows_from_seed_epoch_and_index() {
    let pictures: Vec<_> = (0..4).map(|i| bowl(camera(80, 60, 80.0 + f64::from(i)))).collect();
    let new = |seed| {
        let set = set(pictures.clone(), &DepthSetOptions::training((64, 48)));
        let options = (DepthAugment::default(), canonical(), Normalization::default());
        DepthSamples::training(set, options.0, options.1, options.2, seed).unwrap()
    };
    let (one, same, other) = (new(1), new(1), new(2));
    let backwards: Vec<_> = (0..4).rev().map(|i| same.sample(7, i).unwrap()).collect();
    for (index, again) in (0..4).zip(backwards.into_iter().rev()) {
        let sample = one.sample(7, index).unwrap();
        assert_eq!(sample, again);
        assert_ne!(sample.image, one.sample(8, index).unwrap().image);
        assert_ne!(sample.camera, other.sample(7, index).unwrap().camera);
    }
}

#[test]
fn what_cannot_be_is_refused() {
    for bad in [
        DepthAugment { zoom: [1.0, 0.5], ..DepthAugment::NONE },
        DepthAugment { zoom: [f64::NAN, 1.0], ..DepthAugment::NONE },
        DepthAugment { degrees: -1.0, ..DepthAugment::NONE },
        DepthAugment { translate: 0.9, ..DepthAugment::NONE },
    ] {
        assert!(bad.check().is_err(), "{bad:?}");
    }
    assert!(CanonicalFocal::new(0.0).is_err() && CanonicalFocal::new(f64::NAN).is_err());
    let set = set(vec![bowl(camera(64, 48, 70.0))], &DepthSetOptions::validation((64, 48)));
    let flat = Normalization { mean: [0.0; 3], std: [1.0, 0.0, 1.0] };
    assert!(DepthSamples::validation(set, canonical(), flat).is_err());
}

#[test]
fn memory_sets_are_checked() {
    let good = bowl(camera(64, 48, 70.0));
    let with = |depth: DepthMap| RgbdPicture { depth, ..good.clone() };
    let map = |width, height, value| {
        DepthMap::new(Stamp::ZERO, width, height, vec![value; (width * height) as usize]).unwrap()
    };
    let mut strange = good.depth.clone();
    strange.data_mut()[3000] = f32::NAN;
    strange.data_mut()[3001] = f32::INFINITY;
    strange.data_mut()[3002] = -2.0;
    let pictures = vec![
        good.clone(),
        with(map(64, 48, 0.0)),
        with(map(64, 48, f32::NAN)),
        with(map(32, 24, 1.0)),
        with(strange),
        RgbdPicture { camera: camera(32, 24, 30.0), ..good.clone() },
    ];
    let options = DepthSetOptions::validation((64, 48));
    let set = Arc::new(DepthSet::from_memory(pictures.clone(), &options).unwrap());
    let report: &CheckReport = set.report();
    assert_eq!((report.pictures, report.usable, set.len()), (6, 2, 2));
    assert_eq!(report.count(Problem::DepthUnknown), 2);
    assert_eq!(report.count(Problem::SizeMismatch), 1);
    assert_eq!(report.count(Problem::DepthNotFinite), 1);
    assert_eq!(report.count(Problem::BadCamera), 1);
    let text = report.to_string();
    assert!(
        text.contains("picture 3: the picture has 64x48 pixels, its depth map 32x24"),
        "{text}"
    );
    assert!(text.contains("picture 4: 3 of 3072 depths"), "{text}");
    let samples = DepthSamples::validation(set, canonical(), Normalization::default()).unwrap();
    let sample = samples.sample(0, 1).unwrap();
    assert_eq!(sample.depth[3000..3003], [0.0; 3]);
    assert!(sample.depth.iter().all(|depth| depth.is_finite()));
    let error = DepthSet::from_memory(pictures[1..4].to_vec(), &options).unwrap_err().to_string();
    assert!(error.contains("0 of 3 pictures are usable"), "{error}");
}

/// Writes a folder of `rgb/N.jpg` and `depth/N.png` in millimetres.
fn write_folder(folder: &Path, frames: usize) {
    for sub in ["rgb", "depth"] {
        std::fs::create_dir_all(folder.join(sub)).unwrap();
    }
    let bowl = bowl(camera(80, 60, 90.0));
    for n in 0..frames {
        picture::write(&folder.join(format!("rgb/{n:04}.png")), &bowl.frame).unwrap();
        depth::write(&folder.join(format!("depth/{n:04}.png")), &bowl.depth, 1000.0).unwrap();
    }
}

fn given() -> SourceCamera {
    // For pictures twice as large: (c + 0.5) / 2 - 0.5.
    SourceCamera { fx: 180.0, fy: 183.6, cx: 75.7, cy: 66.5, width: Some(160), height: Some(120) }
}

#[test]
fn folders_are_checked_and_divided_by_blocks() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_folder(folder.path(), 20);
    std::fs::remove_file(path("depth/0001.png")).unwrap();
    std::fs::write(path("depth/0002.png"), b"\x89PNG\r\n\x1a\n").unwrap();
    std::fs::write(path("rgb/0003.png"), b"").unwrap();
    let blank = DepthMap::unknown(Stamp::ZERO, 80, 60).unwrap();
    depth::write(&path("depth/0004.png"), &blank, 1000.0).unwrap();
    let small = DepthMap::new(Stamp::ZERO, 40, 30, vec![1.0; 1200]).unwrap();
    depth::write(&path("depth/0005.png"), &small, 1000.0).unwrap();
    let source = DepthSource {
        depth_scale: Some(1000.0),
        camera: Some(given()),
        hold_out: Some(HoldOut { block: 5, every: 2, gap: 0 }),
        ..DepthSource::new(folder.path())
    };
    let list = SourceList { sources: vec![source.clone()] };
    let options = DepthSetOptions::validation((64, 48));
    let open = |part| DepthSet::open(&list, part, &options);
    let (train, val) = (open(DepthPart::Train).unwrap(), open(DepthPart::Val).unwrap());
    let report = train.report();
    assert_eq!((report.pictures, report.usable), (10, 6), "{report}");
    for problem in
        [Problem::NoDepth, Problem::BrokenDepth, Problem::BrokenImage, Problem::DepthUnknown]
    {
        assert_eq!(report.count(problem), 1, "{problem:?}");
    }
    assert_eq!(val.report().count(Problem::SizeMismatch), 1);
    assert_eq!((val.len(), open(DepthPart::All).unwrap().len()), (9, 15));
    assert!(train.path(1).unwrap().ends_with("rgb/0010.png"), "{:?}", train.path(1));
    // The bowl comes back in metres from files and a camera that were scaled.
    let samples =
        DepthSamples::validation(Arc::new(val), canonical(), Normalization::default()).unwrap();
    let sample = samples.sample(0, 0).unwrap();
    let Intrinsics { fx, fy, cx, cy } = sample.camera;
    for (i, depth) in sample.depth.iter().enumerate().filter(|(_, d)| **d > 0.0) {
        let z = f64::from(depth * sample.metres_per_unit);
        let (x, y) = (((i % 64) as f64 - cx) * z / fx, ((i / 64) as f64 - cy) * z / fy);
        assert!((z - NEAR - BEND * (x * x + y * y)).abs() < 0.01, "{i}: {z}");
    }
    // Depths beyond the limit are unknown, and so all of them for a low one.
    let near = DepthSource { max_depth: Some(1.0), ..source.clone() };
    let list = SourceList { sources: vec![near] };
    let error = DepthSet::open(&list, DepthPart::Val, &options).unwrap_err().to_string();
    assert!(error.contains("no depth is known up to 1 m"), "{error}");
}

#[test]
fn cameras_are_asked_for_and_must_fit() {
    let folder = tempfile::tempdir().unwrap();
    write_folder(folder.path(), 2);
    let options = DepthSetOptions::training((64, 48));
    let open = |camera| {
        let source =
            DepthSource { camera, depth_scale: Some(1000.0), ..DepthSource::new(folder.path()) };
        DepthSet::open(&SourceList { sources: vec![source] }, DepthPart::Train, &options)
    };
    let error = open(None).unwrap_err().to_string();
    assert!(error.contains("the camera is not known. Give fx, fy, cx, cy"), "{error}");
    let error = open(Some(SourceCamera { height: Some(160), ..given() })).unwrap_err().to_string();
    assert!(error.contains("160x160 pixels, this one has 80x60: another shape"), "{error}");
    let error = open(Some(SourceCamera { fx: 0.0, ..given() })).unwrap_err().to_string();
    assert!(error.contains("focal length fx is 0"), "{error}");
    assert!(open(Some(given())).is_ok());
    std::fs::write(folder.path().join("intrinsics.txt"), "90 91.8 37.6 33").unwrap();
    assert!(open(None).is_ok());
    std::fs::write(folder.path().join("intrinsics.txt"), "90").unwrap();
    let error = open(None).unwrap_err().to_string();
    assert!(error.contains("2 pictures have a camera file that cannot be used"), "{error}");
}

/// The form that `realnet sim --dataset` writes: clips with a camera each, divided already.
#[test]
fn sets_of_the_simulator_keep_their_division() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("dataset.json"), "{}").unwrap();
    for (clip, focal) in [("train/00000", 90.0), ("train/00001", 70.0), ("val/00004", 80.0)] {
        let clip = folder.path().join("rgbd").join(clip);
        for sub in ["color", "depth"] {
            std::fs::create_dir_all(clip.join(sub)).unwrap();
        }
        let camera = camera(80, 60, focal);
        let bowl = bowl(camera);
        for n in 0..2 {
            picture::write(&clip.join(format!("color/{n:06}.png")), &bowl.frame).unwrap();
            depth::write(&clip.join(format!("depth/{n:06}.png")), &bowl.depth, 5000.0).unwrap();
        }
        let yaml = CameraCalibration::new("clip", camera).to_ros_yaml();
        std::fs::write(clip.join("camera.yaml"), yaml).unwrap();
    }
    // A clip that was interrupted before its first frame.
    std::fs::create_dir_all(folder.path().join("rgbd/train/00002/color")).unwrap();
    let list = SourceList::open(folder.path()).unwrap();
    let options = DepthSetOptions::validation((80, 60));
    let focals = |part| {
        let set = Arc::new(DepthSet::open(&list, part, &options).unwrap());
        let samples = DepthSamples::validation(set, canonical(), Normalization::default()).unwrap();
        let all = (0..samples.len()).map(|i| samples.sample(0, i).unwrap());
        all.map(|s| {
            (s.camera.fx.round(), (s.metres_per_unit * s.depth[33 * 80 + 38] * 10.0).round())
        })
        .collect::<Vec<_>>()
    };
    assert_eq!(focals(DepthPart::Train), [(90.0, 15.0), (90.0, 15.0), (70.0, 15.0), (70.0, 15.0)]);
    assert_eq!(focals(DepthPart::Val), [(80.0, 15.0), (80.0, 15.0)]);
}

#[test]
fn lists_are_read_and_their_errors_named() {
    let folder = tempfile::tempdir().unwrap();
    write_folder(&folder.path().join("nyu"), 4);
    let file = folder.path().join("depth.yaml");
    let read = |text: &str| {
        std::fs::write(&file, text).unwrap();
        SourceList::open(&file)
    };
    let list = read(
        "sources:\n  - path: nyu\n    depth_scale: 1000\n    hold_out: { block: 1, every: 2 }\n    \
         camera: { fx: 90, fy: 91.8, cx: 37.6, cy: 33 }\n",
    )
    .unwrap();
    let options = DepthSetOptions {
        set: SetOptions { cache_bytes: 0, ..SetOptions::default() },
        ..DepthSetOptions::training((64, 48))
    };
    let set = Arc::new(DepthSet::open(&list, DepthPart::Val, &options).unwrap());
    assert_eq!((set.len(), set.report().cached), (2, (0, 0)));
    // Nothing is in memory: a file that vanishes is an error of its sample.
    std::fs::remove_file(folder.path().join("nyu/depth/0003.png")).unwrap();
    let samples = DepthSamples::validation(set, canonical(), Normalization::default()).unwrap();
    assert!(samples.sample(0, 0).is_ok());
    assert!(samples.sample(0, 1).unwrap_err().to_string().contains("0003.png"));
    for (text, wanted) in [
        ("sources: []", "`sources` is empty"),
        ("sources:\n  - path: a\n    depth_scal: 1", "depth_scal"),
        ("nothing", "depth.yaml: "),
    ] {
        let error = read(text).unwrap_err().to_string();
        assert!(error.contains(wanted), "{error}");
    }
    let list = read("sources: [{ path: gone }]").unwrap();
    assert!(DepthSet::open(&list, DepthPart::Train, &options).is_err());
}
