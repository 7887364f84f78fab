use super::*;
use realnet_core::PixelFormat;
use std::fs;
use tempfile::TempDir;

const IDENTITY: &str = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";

/// A folder with these files. Names that end in `.png` are written as pictures
/// (depth ones in 16 bits), `.pgm` as depth, anything else as the text given.
fn folder(files: &[(&str, &str)]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = dir.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        match picture::extension(&path).as_deref() {
            Some("pgm") => fs::write(&path, b"P5 2 2 65535 \x03\xe8\x03\xe8\x03\xe8\0\0").unwrap(),
            Some("png") if name.contains("depth") => {
                image::ImageBuffer::<image::Luma<u16>, _>::from_raw(
                    2,
                    2,
                    vec![0, 1000, 5000, 65535],
                )
                .unwrap()
                .save(&path)
                .unwrap();
            }
            Some("png" | "jpg") => {
                picture::write(&path, &Frame::rgb8(Stamp::ZERO, 2, 2, vec![9; 12]).unwrap())
                    .unwrap();
            }
            _ => fs::write(&path, text).unwrap(),
        }
    }
    dir
}

fn open(dir: &Path) -> Result<RgbdSequence, RgbdError> {
    RgbdSequence::open(dir, &RgbdOptions::default())
}

fn message(dir: &Path) -> String {
    open(dir).unwrap_err().to_string()
}

fn shared(relative: &str) -> Option<PathBuf> {
    let root = std::env::var_os("REALNET_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    #[allow(clippy::print_stdout)]
    {
        println!("skipped: {} is missing", path.display());
    }
    None
}

#[test]
fn seven_scenes_frames_by_number() {
    let dir = folder(&[
        ("frame-000012.color.png", ""),
        ("frame-000012.depth.png", ""),
        ("frame-000012.pose.txt", "1 0 0 0.5\t0 1 0 0\r\n0 0 1 -2\n0 0 0 1"),
        ("frame-000010.color.jpg", ""),
        ("frame-000013.depth.png", ""),
        ("frame-x.color.png", ""),
        ("notes.txt", "text"),
    ]);
    let sequence = open(dir.path()).unwrap();
    assert_eq!((sequence.layout(), sequence.depth_scale()), (RgbdLayout::SevenScenes, 1000.0));
    let [a, b] = sequence.frames() else { panic!("{:?}", sequence.frames()) };
    assert_eq!((a.number, a.name.as_str(), a.stamp.nanos()), (10, "frame-000010.color.jpg", 0));
    assert_eq!((&a.depth_path, a.world_from_camera), (&None, None));
    assert!(matches!(a.depth(), Err(RgbdError::NoDepth { .. })));
    assert_eq!(a.read().unwrap().1, None);
    assert_eq!((b.number, b.stamp.nanos()), (12, 66_666_667));
    let pose = b.world_from_camera.unwrap();
    assert_eq!(pose.translation().as_slice(), [0.5, 0.0, -2.0]);
    let (color, depth) = b.read().unwrap();
    let depth = depth.unwrap();
    assert_eq!(
        (color.format(), color.stamp(), depth.stamp()),
        (PixelFormat::Rgb8, b.stamp, b.stamp)
    );
    assert_eq!(depth.data(), [0.0, 1.0, 5.0, 0.0]);

    let options = RgbdOptions { fps: 10.0, depth_scale: Some(2000.0), ..RgbdOptions::default() };
    let sequence = RgbdSequence::open(dir.path(), &options).unwrap();
    assert_eq!(sequence.frames()[1].stamp.nanos(), 200_000_000);
    assert_eq!(sequence.frames()[1].depth().unwrap().data(), [0.0, 0.5, 2.5, 0.0]);
}

#[test]
fn bad_poses_name_their_file() {
    for (text, wanted) in [
        ("", "0 numbers, a pose has 16"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "12 numbers, a pose has 16"),
        (&format!("{IDENTITY}7"), "17 numbers"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 x", "value 16 is \"x\", not a number"),
        ("1 0 0 nan 0 1 0 0 0 0 1 0 0 0 0 1", "entry 3 of a pose is NaN"),
        ("-inf 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1", "entry 0 of a pose is -inf"),
        ("2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1", "not orthonormal"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1", "determinant -1"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1", "the last row"),
    ] {
        let dir = folder(&[("frame-000000.color.png", ""), ("frame-000000.pose.txt", text)]);
        let error = message(dir.path());
        assert!(error.contains(wanted) && error.contains("frame-000000.pose.txt: "), "{error}");
    }
    let dir = folder(&[("frame-000000.color.png", "")]);
    fs::write(dir.path().join("frame-000000.pose.txt"), [0xff, 0xfe]).unwrap();
    assert!(message(dir.path()).contains("frame-000000.pose.txt"));
}

#[test]
fn tum_lists_are_associated() {
    let dir = folder(&[
        ("rgb/a.png", ""),
        ("rgb/b.png", ""),
        ("depth/a.png", ""),
        ("depth/b.png", ""),
        ("rgb.txt", "# color\n#\n1305031102.300000 rgb/b.png\n1305031102.175304 rgb/a.png\n"),
        ("depth.txt", "1305031102.160407 depth/a.png\n1305031102.330000 depth/b.png\n"),
        (
            "groundtruth.txt",
            "# stamp tx ty tz qx qy qz qw\n1305031102.1700 1 0 0 0 0 0 1\n1305031102.1800 2 0 0 0 0 0 1\n",
        ),
    ]);
    let sequence = open(dir.path()).unwrap();
    assert_eq!((sequence.layout(), sequence.depth_scale()), (RgbdLayout::Tum, 5000.0));
    let [a, b] = sequence.frames() else { panic!("{:?}", sequence.frames()) };
    assert_eq!((a.number, a.name.as_str()), (0, "a.png"));
    assert_eq!(a.stamp.nanos(), 1_305_031_102_175_304_000);
    assert_eq!(a.depth_stamp.unwrap().nanos(), 1_305_031_102_160_407_000);
    assert_eq!(a.depth().unwrap().stamp(), a.stamp);
    assert_eq!(a.depth().unwrap().data(), [0.0, 0.2, 1.0, 0.0]);
    let pose = a.world_from_camera.unwrap();
    assert!((pose.translation().x - 1.5304).abs() < 1e-9);
    assert_eq!((&b.depth_path, b.world_from_camera), (&None, None));

    let options = RgbdOptions { max_stamp_difference: 0.2, ..RgbdOptions::default() };
    let sequence = RgbdSequence::open(dir.path(), &options).unwrap();
    assert!(sequence.frames()[1].depth_path.is_some());
    assert_eq!(sequence.frames()[1].world_from_camera.unwrap().translation().x, 2.0);
}

#[test]
fn tum_folders_without_lists() {
    let dir = folder(&[
        ("rgb/1305031102.175304.png", ""),
        ("rgb/cover.png", ""),
        ("depth/1305031102.160407.png", ""),
    ]);
    let sequence = open(dir.path()).unwrap();
    assert_eq!((sequence.layout(), sequence.frames().len()), (RgbdLayout::Tum, 1));
    assert!(sequence.frames()[0].depth_path.is_some());
}

#[test]
fn bad_tum_files_name_file_and_line() {
    let good = [("rgb/a.png", ""), ("rgb.txt", "1.0 rgb/a.png\n")];
    for (file, text, wanted) in [
        ("rgb.txt", "# only\n\n", "rgb.txt with stamps and file names"),
        ("rgb.txt", "1.0 rgb/a.png\n2.0\n", "rgb.txt:2: \"2.0\" is not a stamp and a file name"),
        ("rgb.txt", "x rgb/a.png\n", "rgb.txt:1: \"x\" is not a stamp"),
        ("rgb.txt", "1.0 rgb/none.png\n", "rgb/none.png does not exist"),
        ("depth.txt", "1.0 depth/none.png", "depth.txt:1: "),
        ("groundtruth.txt", "#\n1.0 1 2 3 0 0 0\n", "groundtruth.txt:2: 6 numbers, a pose has 7"),
        ("groundtruth.txt", "1.0 1 2 3 0 0 0 1 1\n", "groundtruth.txt:1: 8 numbers"),
        ("groundtruth.txt", "1.0 1 2 nan 0 0 0 1\n", "groundtruth.txt:1: entry 2 of a pose is NaN"),
        ("groundtruth.txt", "1.0 1 2 3 0 0 0 2\n", "groundtruth.txt:1: "),
        ("groundtruth.txt", "nan 1 2 3 0 0 0 1\n", "groundtruth.txt:1: \"nan\" is not a stamp"),
    ] {
        let dir = folder(&good);
        fs::write(dir.path().join(file), text).unwrap();
        let error = message(dir.path());
        assert!(error.contains(wanted), "{file} {text:?}: {error}");
    }
}

#[test]
fn numbered_folders_and_pairs() {
    let poses = "0 0 1 0 0 0 1\n0 0 2 0 0 0 1\n";
    let dir = folder(&[
        ("color/10.png", ""),
        ("color/9.png", ""),
        ("color/cover.png", ""),
        ("depth/9.pgm", ""),
        ("depth/10.pgm", ""),
        ("pose.txt", poses),
    ]);
    let sequence = open(dir.path()).unwrap();
    assert_eq!((sequence.layout(), sequence.depth_scale()), (RgbdLayout::Numbered, 1000.0));
    let numbers: Vec<_> = sequence.frames().iter().map(|f| f.number).collect();
    assert_eq!(numbers, [9, 10]);
    assert_eq!(sequence.frames()[1].world_from_camera.unwrap().translation().z, 2.0);
    assert_eq!(sequence.frames()[0].depth().unwrap().data(), [1.0, 1.0, 1.0, 0.0]);
    fs::write(dir.path().join("pose.txt"), "0 0 1 0 0 0 1\n").unwrap();
    assert!(message(dir.path()).contains("pose.txt: 1 poses for 2 frames"));
    fs::write(dir.path().join("pose.txt"), format!("{poses}0 0 1 0 0 0")).unwrap();
    assert!(message(dir.path()).contains("pose.txt:3: 6 numbers, a pose has 7"));

    let dir = folder(&[("1.png", ""), ("1_depth.png", ""), ("2.png", ""), ("x_depth.png", "")]);
    let sequence = open(dir.path()).unwrap();
    assert_eq!((sequence.layout(), sequence.depth_scale()), (RgbdLayout::Pairs, 5000.0));
    let depths: Vec<_> = sequence.frames().iter().map(|f| f.depth_path.is_some()).collect();
    assert_eq!(depths, [true, false]);
}

#[test]
fn what_is_missing_or_ambiguous_is_said() {
    let dir = folder(&[("readme.txt", "x")]);
    let error = message(dir.path());
    for wanted in ["no RGB-D sequence here", "7-Scenes", "rgb.txt", "color/", "N_depth.png"] {
        assert!(error.contains(wanted), "{error}");
    }
    let dir = folder(&[("seq-10/x.txt", ""), ("seq-02/x.txt", ""), ("seq.txt", "")]);
    let error = message(dir.path());
    assert!(
        error.ends_with("holds several sequences, open one of them: seq-02, seq-10"),
        "{error}"
    );
    let error = message(&dir.path().join("none"));
    assert!(error.contains("none: No such file"), "{error}");
    let dir = folder(&[("frame-000001.color.png", ""), ("frame-1.color.jpg", "")]);
    let error = message(dir.path());
    assert!(error.contains("frame 1 has two colour files"), "{error}");
    for layout in
        [RgbdLayout::SevenScenes, RgbdLayout::Tum, RgbdLayout::Numbered, RgbdLayout::Pairs]
    {
        let empty = tempfile::tempdir().unwrap();
        let options = RgbdOptions { layout: Some(layout), ..RgbdOptions::default() };
        let error = RgbdSequence::open(empty.path(), &options).unwrap_err();
        assert!(error.to_string().contains(&format!("in the {layout} layout")), "{error}");
    }
    let bad = [
        RgbdOptions { fps: 0.0, ..RgbdOptions::default() },
        RgbdOptions { depth_scale: Some(f64::NAN), ..RgbdOptions::default() },
        RgbdOptions { max_stamp_difference: -1.0, ..RgbdOptions::default() },
    ];
    for options in bad {
        let error = RgbdSequence::open(dir.path(), &options).unwrap_err();
        assert!(matches!(error, RgbdError::Option { .. }), "{error}");
    }
}

#[test]
fn sizes_that_differ_and_broken_files_are_named() {
    let dir = folder(&[("1.png", ""), ("1_depth.png", "")]);
    fs::write(dir.path().join("1_depth.png"), "P5 1 1 255 a").unwrap();
    let frame = open(dir.path()).unwrap().frames()[0].clone();
    let error = frame.read().unwrap_err().to_string();
    assert!(
        error.contains("1_depth.png is 1x1, but ") && error.contains("1.png is 2x2"),
        "{error}"
    );
    fs::write(dir.path().join("1_depth.png"), "no depth").unwrap();
    let error = frame.read().unwrap_err().to_string();
    assert!(error.contains("1_depth.png: a depth map is"), "{error}");
    fs::write(dir.path().join("1.png"), "no picture").unwrap();
    assert!(frame.read().unwrap_err().to_string().contains("1.png: neither JPEG nor PNG"));
    fs::remove_file(dir.path().join("1_depth.png")).unwrap();
    assert!(frame.depth().unwrap_err().to_string().contains("1_depth.png: No such file"));
}

#[test]
fn the_red_kitchen_opens() {
    let Some(dir) = shared("data/7scenes-redkitchen") else { return };
    let sequence = open(&dir).unwrap();
    assert_eq!((sequence.layout(), sequence.frames().len()), (RgbdLayout::SevenScenes, 400));
    assert!(sequence.frames().iter().all(|f| f.depth_path.is_some()));
    let frame = &sequence.frames()[399];
    assert_eq!((frame.number, frame.stamp.nanos()), (399, 13_300_000_000));
    let (color, depth) = frame.read().unwrap();
    assert_eq!((color.width(), color.height()), (320, 240));
    let depth = depth.unwrap();
    assert!(depth.known_share() > 0.5);
    assert!(depth.data().iter().all(|d| *d < 10.0));
    // Neighbouring cameras are near each other.
    for pair in sequence.frames().windows(2) {
        let [a, b] = [0, 1].map(|i| pair[i].world_from_camera.unwrap());
        let step = a.inverse() * b;
        assert!(step.translation_norm() < 0.1 && step.rotation_angle() < 0.1, "{}", pair[1].name);
    }
}

#[test]
fn the_slambook_sequences_open() {
    for (folder, layout, frames, scale, poses, depth) in [
        ("ch5/rgbd", RgbdLayout::Numbered, 5, 1000.0, true, 0.5..10.0),
        ("ch12/dense_RGBD/data", RgbdLayout::Numbered, 5, 5000.0, true, 0.5..5.0),
        ("ch7", RgbdLayout::Pairs, 2, 5000.0, false, 0.9..11.0),
    ] {
        let Some(dir) = shared(&format!("data/tum-slambook/{folder}")) else { return };
        let sequence = open(&dir).unwrap();
        assert_eq!((sequence.layout(), sequence.depth_scale()), (layout, scale), "{folder}");
        assert_eq!(sequence.frames().len(), frames, "{folder}");
        for frame in sequence.frames() {
            assert_eq!(frame.world_from_camera.is_some(), poses);
            let (_, map) = frame.read().unwrap();
            let map = map.unwrap();
            assert!(map.known_share() > 0.6, "{}", frame.name);
            let known = map.data().iter().filter(|d| DepthMap::is_known(**d));
            assert!(known.into_iter().all(|d| depth.contains(d)), "{folder} {}", frame.name);
        }
    }
}

#[test]
fn suggested_intrinsics_are_for_the_published_size() {
    let found = RgbdLayout::SevenScenes.customary_intrinsics(640, 480).unwrap();
    assert_eq!((found.fx, found.cx), (525.0, 320.0));
    assert_eq!(RgbdLayout::Tum.customary_intrinsics(640, 480).unwrap().cx, 319.5);
    assert_eq!(RgbdLayout::SevenScenes.customary_intrinsics(320, 240), None);
    assert_eq!(RgbdLayout::Pairs.customary_intrinsics(640, 480), None);
}

#[test]
fn kitti_selections_and_drives() {
    let selection = folder(&[
        ("image/d_sync_image_0000000005_image_02.png", ""),
        ("image/d_sync_image_0000000009_image_02.png", ""),
        ("groundtruth_depth/d_sync_groundtruth_depth_0000000005_image_02.png", ""),
        ("intrinsics/d_sync_image_0000000005_image_02.txt", "7e2 0 6e2 0 7.1e2 1.7e2 0 0 1\n"),
    ]);
    let read = open(selection.path()).unwrap();
    assert_eq!((read.layout(), read.depth_scale()), (RgbdLayout::Kitti, 256.0));
    let [first, second] = read.frames() else { panic!("{:?}", read.frames()) };
    let (_, depth) = first.read().unwrap();
    assert_eq!(depth.unwrap().data(), [0.0, 1000.0 / 256.0, 5000.0 / 256.0, 0.0]);
    let camera = first.camera(2, 2).unwrap().unwrap();
    assert_eq!((camera.fx(), camera.fy(), camera.cx(), camera.cy()), (700.0, 710.0, 600.0, 170.0));
    assert!(second.depth_path.is_none() && second.camera(2, 2).unwrap().is_none());

    let drive = folder(&[
        ("calib_cam_to_cam.txt", "R_02: 1 2\nP_rect_02: 7 0 6 45 0 8 2 -0.3 0 0 1 0\n"),
        ("drive/image_02/data/0000000005.png", ""),
        ("drive/image_02/data/0000000006.png", ""),
        ("drive/proj_depth/groundtruth/image_02/0000000006.png", ""),
    ]);
    let read = open(&drive.path().join("drive")).unwrap();
    let [first, second] = read.frames() else { panic!("{:?}", read.frames()) };
    assert_eq!((first.number, second.number), (5, 6));
    assert!(first.depth_path.is_none() && second.depth_path.is_some());
    let camera = second.camera(2, 2).unwrap().unwrap();
    assert_eq!((camera.fx(), camera.fy(), camera.cx(), camera.cy()), (7.0, 8.0, 6.0, 2.0));
}

#[test]
fn cameras_are_read_from_files_beside_the_pictures() {
    let with = |name: &str, text: &str| {
        let dir = folder(&[("rgb/1.png", ""), ("depth/1.png", ""), (name, text)]);
        let frame = open(dir.path()).unwrap().frames()[0].clone();
        frame.camera(2, 2)
    };
    let camera = with("intrinsics.txt", "5, 6, 0.5 0.25\n").unwrap().unwrap();
    assert_eq!((camera.fx(), camera.fy(), camera.cx(), camera.cy()), (5.0, 6.0, 0.5, 0.25));
    assert_eq!(with("other.txt", "5 6 0.5 0.25").unwrap(), None);
    for (text, wanted) in [
        ("5 6 0.5", "3 numbers, expected 4"),
        ("5 x 1 2", "\"x\" is no number"),
        ("0 6 1 2", "focal length fx is 0"),
    ] {
        let error = with("intrinsics.txt", text).unwrap_err().to_string();
        assert!(error.contains("intrinsics.txt: ") && error.contains(wanted), "{error}");
    }
    let yaml = |width, height| {
        let intrinsics = Intrinsics { fx: 10.0, fy: 10.0, cx: 1.5, cy: 1.5 };
        let camera =
            CameraModel::new(width, height, intrinsics, realnet_core::Distortion::None).unwrap();
        realnet_core::CameraCalibration::new("c", camera).to_ros_yaml()
    };
    let camera = with("camera.yaml", &yaml(4, 4)).unwrap().unwrap();
    assert_eq!((camera.width(), camera.fx(), camera.cx()), (2, 5.0, 0.5));
    let error = with("camera.yaml", &yaml(4, 2)).unwrap_err().to_string();
    assert!(error.contains("4x2 pixels") && error.contains("2x2: another shape"), "{error}");
}
