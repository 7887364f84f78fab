//! `realnet sim --dataset`: pictures to learn from, as files.

use crate::cli::failure::{OrBadInput, Outcome, bad_input, say};
use crate::cli::{interrupt, progress};
use anyhow::{Context, Result};
use realnet_core::{CameraCalibration, Detection};
use realnet_io::datasets::labels::row_of;
use realnet_io::{atomic, depth, picture};
use realnet_sim::dataset::{
    CLIP_FRAMES, DatasetSpec, KnownMount, MIN_PIXELS, MIN_VISIBLE, Sample, Sampler, Split,
    VALIDATION, class_names,
};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Depth units a metre, as our reader takes PNG files of the numbered layout.
const DEPTH_SCALE: f64 = 5000.0;
/// Written first: what a folder's files follow from.
const RECIPE: &str = "dataset.json";

/// What the files of a folder follow from; a folder is gone on with only by the same.
#[derive(Debug, Deserialize, PartialEq, Serialize)]
struct Recipe {
    format: u32,
    /// Of the program: another one may draw other pictures of the same seed.
    version: String,
    seed: u64,
    width: u32,
    height: u32,
    /// A known mount: metres above the ground, radians of pitch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    camera_height_m: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    camera_pitch_rad: Option<f64>,
}

/// Writes the first `frames` samples of `spec` into `folder`, `jobs` at a time; those
/// that are there already are kept. Ctrl-C leaves whole files, to be gone on with.
pub(super) fn write(
    folder: &Path,
    spec: DatasetSpec,
    frames: u64,
    jobs: usize,
    command: &str,
) -> Result<Outcome> {
    write_until(folder, spec, frames, jobs, command, &interrupt::interrupted)
}

/// As [`write`]; it ends early once `ends_early` says so.
fn write_until(
    folder: &Path,
    spec: DatasetSpec,
    frames: u64,
    jobs: usize,
    command: &str,
    ends_early: &(dyn Fn() -> bool + Sync),
) -> Result<Outcome> {
    prepare(folder, &spec)?;
    let bar = progress::bar(Some(frames), "dataset");
    let clips = frames.div_ceil(CLIP_FRAMES);
    let next = AtomicU64::new(0);
    let work = || -> Result<()> {
        let mut sampler = Sampler::new(spec);
        loop {
            let clip = next.fetch_add(1, Ordering::Relaxed);
            if clip >= clips || ends_early() {
                return Ok(());
            }
            let end = frames.min((clip + 1) * CLIP_FRAMES);
            let done = one_clip(folder, &mut sampler, clip, end, ends_early, || bar.inc(1));
            if let Err(error) = done.with_context(|| format!("clip {clip}")) {
                // The others need not go on.
                next.store(clips, Ordering::Relaxed);
                return Err(error);
            }
        }
    };
    let outcomes: Vec<Result<()>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..jobs.max(1)).map(|_| scope.spawn(work)).collect();
        let joined = threads.into_iter().map(|thread| {
            thread.join().unwrap_or_else(|_| Err(anyhow::anyhow!("a clip ended in a panic")))
        });
        joined.collect()
    });
    bar.finish_and_clear();
    // Whatever happened, what is said to be there is there.
    let counted = frames_there(folder).and_then(|there| {
        let text = readme(&spec, there, frames, command);
        atomic::write(&folder.join("README.md"), text.as_bytes())?;
        Ok(there)
    });
    outcomes.into_iter().collect::<Result<()>>()?;
    let there = counted?;
    say(format!("{there} frames are in {}", folder.display()));
    if ends_early() && there < frames {
        say("the same command goes on with it");
        return Ok(Outcome::Interrupted);
    }
    Ok(Outcome::Done)
}

/// Makes the folders, or checks that the folder was begun by the same recipe.
fn prepare(folder: &Path, spec: &DatasetSpec) -> Result<()> {
    let recipe = Recipe {
        format: 1,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        seed: spec.seed,
        width: spec.width,
        height: spec.height,
        camera_height_m: spec.mount.map(|mount| mount.height_m),
        camera_pitch_rad: spec.mount.map(|mount| mount.pitch_rad),
    };
    let path = folder.join(RECIPE);
    match std::fs::read(&path) {
        Ok(bytes) => {
            let known: Recipe = serde_json::from_slice(&bytes)
                .map_err(|error| bad_input(format!("{}: {error}", path.display())))?;
            if known != recipe {
                return Err(bad_input(format!(
                    "{} was begun otherwise ({known:?}, now {recipe:?}): choose another folder",
                    folder.display()
                )));
            }
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let occupied = std::fs::read_dir(folder).is_ok_and(|mut list| list.next().is_some());
            if occupied {
                return Err(bad_input(format!(
                    "{} has files but no {RECIPE}: choose an empty folder",
                    folder.display()
                )));
            }
        }
        Err(error) => return Err(bad_input(format!("{}: {error}", path.display()))),
    }
    for split in [Split::Train, Split::Val] {
        for kind in ["images", "labels"] {
            make_folder(&folder.join(kind).join(split.name()))?;
        }
    }
    let mut data = "path: .\ntrain: images/train\nval: images/val\nnames:\n".to_owned();
    for (index, name) in class_names().iter().enumerate() {
        let _ = writeln!(data, "  {index}: {name}");
    }
    atomic::write(&folder.join("data.yaml"), data.as_bytes())?;
    let mut text = serde_json::to_string_pretty(&recipe)?;
    text.push('\n');
    Ok(atomic::write(&path, text.as_bytes())?)
}

fn make_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path)
        .with_context(|| format!("cannot make the folder {}", path.display()))
        .or_bad_input()
}

/// Counts the frames with all their files, whichever command made them.
fn frames_there(folder: &Path) -> Result<u64> {
    let mut there = 0;
    for split in [Split::Train, Split::Val] {
        let labels = folder.join("labels").join(split.name());
        let entries = std::fs::read_dir(&labels)
            .with_context(|| format!("cannot list the folder {}", labels.display()))?;
        for entry in entries {
            // Labels are written last of a frame's files.
            let name = entry.with_context(|| labels.display().to_string())?.file_name();
            let index = name.to_str().and_then(|name| name.strip_suffix(".txt")?.parse().ok());
            there += u64::from(index.is_some_and(|index| Files::of(folder, index).are_there()));
        }
    }
    Ok(there)
}

/// The files of a sample.
struct Files {
    image: PathBuf,
    labels: PathBuf,
    color: PathBuf,
    depth: PathBuf,
}

impl Files {
    fn of(folder: &Path, index: u64) -> Self {
        let (clip, step) = (index / CLIP_FRAMES, index % CLIP_FRAMES);
        let split = Split::of_clip(clip).name();
        let sequence = sequence(folder, clip);
        Self {
            image: folder.join("images").join(split).join(format!("{index:06}.jpg")),
            labels: folder.join("labels").join(split).join(format!("{index:06}.txt")),
            color: sequence.join("color").join(format!("{step:06}.png")),
            depth: sequence.join("depth").join(format!("{step:06}.png")),
        }
    }

    fn all(&self) -> [&Path; 4] {
        [&self.image, &self.labels, &self.color, &self.depth]
    }

    fn are_there(&self) -> bool {
        self.all().iter().all(|path| path.is_file())
    }
}

fn sequence(folder: &Path, clip: u64) -> PathBuf {
    folder.join("rgbd").join(Split::of_clip(clip).name()).join(format!("{clip:05}"))
}

/// Writes what is missing of a clip, up to the sample before `end`; then its poses.
fn one_clip(
    folder: &Path,
    sampler: &mut Sampler,
    clip: u64,
    end: u64,
    ends_early: impl Fn() -> bool,
    mut progress: impl FnMut(),
) -> Result<()> {
    let sequence = sequence(folder, clip);
    make_folder(&sequence.join("color"))?;
    make_folder(&sequence.join("depth"))?;
    let first = clip * CLIP_FRAMES;
    let (mut there, mut changed) = (first, false);
    for index in first..end {
        let files = Files::of(folder, index);
        if !files.are_there() {
            if ends_early() {
                break;
            }
            write_sample(&files, &sampler.sample(index))?;
            changed = true;
        }
        there = index + 1;
        progress();
    }
    let lines = sequence.join("pose.txt");
    if changed || !lines.is_file() {
        let mut poses = String::new();
        for index in first..there {
            let _ = writeln!(poses, "{}", pose_line(sampler, index));
        }
        atomic::write(&lines, poses.as_bytes())?;
        let name = format!("clip-{clip:05}");
        let camera = CameraCalibration::new(name, sampler.camera(clip)).to_ros_yaml();
        atomic::write(&sequence.join("camera.yaml"), camera.as_bytes())?;
    }
    Ok(())
}

/// A line of `pose.txt`.
fn pose_line(sampler: &mut Sampler, index: u64) -> String {
    let values = sampler.world_from_camera(index).to_tum();
    values.map(|value| format!("{value:.9}")).join(" ")
}

fn write_sample(files: &Files, sample: &Sample) -> Result<()> {
    picture::write(&files.image, &sample.frame)?;
    picture::write(&files.color, &sample.frame)?;
    depth::write(&files.depth, &sample.depth, DEPTH_SCALE)?;
    let mut rows = String::new();
    for label in &sample.labels {
        let detection = Detection { class_id: label.class_id, confidence: 1.0, bbox: label.bbox };
        rows.push_str(&row_of(&detection, sample.frame.width(), sample.frame.height(), false));
        rows.push('\n');
    }
    Ok(atomic::write(&files.labels, rows.as_bytes())?)
}

/// What the folder is, with the frames that are there and those that were asked for.
fn readme(spec: &DatasetSpec, there: u64, frames: u64, command: &str) -> String {
    let progress = match there {
        there if there < frames => format!("{there} of {frames} frames so far,"),
        _ => format!("{there} frames"),
    };
    let DatasetSpec { seed, width, height, mount } = spec;
    let mount = match mount {
        None => "another for each clip".to_owned(),
        Some(KnownMount { height_m, pitch_rad }) => format!(
            "{height_m} m above the ground, {:.1} degrees nose down, give or take {} mm and {:.1} degrees",
            pitch_rad.to_degrees(),
            1000.0 * KnownMount::HEIGHT_ERROR_M,
            KnownMount::ANGLE_ERROR_RAD.to_degrees()
        ),
    };
    let names = class_names().join(", ");
    let percent = (100.0 * MIN_VISIBLE) as u32;
    let most = f64::from(u16::MAX - 1) / DEPTH_SCALE;
    format!(
        "\
# A data set drawn by RealNet's simulator

{progress} of {width} x {height} pixels, seed {seed}. Made, and made longer or gone on
with after an interruption, by

    {command}

The same program and seed give the same bytes. Nothing here is a photograph.

| files | what |
|---|---|
| `data.yaml`, `images/`, `labels/` | YOLO: JPEG pictures; a row for each vehicle: class, then the middle and the size of its box as shares of the picture's width and height |
| `rgbd/train/NNNNN/`, `rgbd/val/NNNNN/` | the same frames without loss, clip by clip: `color/N.png`, `depth/N.png`, `pose.txt`, `camera.yaml` |
| `dataset.json` | what the files follow from |

Classes: {names}. A vehicle is labelled when it shows {MIN_PIXELS} pixels or more and at
least {percent} % of what it would show if nothing hid it; its box is the tight box of its
visible pixels.

Frame `i` of the pictures is frame `i mod {CLIP_FRAMES}` of clip `i / {CLIP_FRAMES}`. A clip is one
world with one camera; every {VALIDATION}th clip is for validation, so no world is in both splits.
The camera's mount: {mount}.

Depth is along the optical axis, exact, without noise or blur: 16-bit PNG, {DEPTH_SCALE} units a
metre; 0 is unknown (the sky, and what is further than {most:.1} m). Depth and pictures share
the lens: pixels are *not* rectified. `camera.yaml` is the intrinsics and the distortion of the
clip in the form of ROS; `pose.txt` has a line a frame, world from camera (optical frame: x
right, y down, z forward), `tx ty tz qx qy qz qw`, metres.
"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::DepthMap;
    use realnet_io::datasets::rgbd::{RgbdLayout, RgbdOptions, RgbdSequence};
    use realnet_io::datasets::yolo::YoloDataset;
    use realnet_io::picture::Limits;
    use std::collections::BTreeMap;

    const SPEC: DatasetSpec = DatasetSpec { seed: 5, width: 128, height: 72, mount: None };

    fn made(frames: u64, jobs: usize) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let outcome = write(folder.path(), SPEC, frames, jobs, "realnet sim").unwrap();
        assert_eq!(outcome, Outcome::Done);
        folder
    }

    /// All files below a folder with their bytes.
    fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut all = BTreeMap::new();
        let mut left = vec![folder.to_path_buf()];
        while let Some(path) = left.pop() {
            if path.is_dir() {
                left.extend(std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()));
            } else {
                let name = path.strip_prefix(folder).unwrap().to_path_buf();
                all.insert(name, std::fs::read(&path).unwrap());
            }
        }
        all
    }

    #[test]
    fn our_readers_read_it_back() {
        // Clips 0 to 4, the last for validation.
        let frames = 4 * CLIP_FRAMES + 3;
        let folder = made(frames, 2);
        let mut sampler = Sampler::new(SPEC);
        let yolo = YoloDataset::open(&folder.path().join("data.yaml")).unwrap();
        assert_eq!(yolo.names(), class_names());
        let mut boxes = 0;
        for (split, count) in [("train", 4 * CLIP_FRAMES), ("val", 3)] {
            let samples = yolo.split(split).unwrap();
            assert_eq!(samples.len() as u64, count);
            for read in samples {
                let stem = read.image.file_stem().unwrap().to_str().unwrap().to_owned();
                let sample = sampler.sample(stem.parse().unwrap());
                assert_eq!(sample.split.name(), split);
                let labels = yolo.labels(&read).unwrap().rows;
                assert_eq!(labels.len(), sample.labels.len());
                for (read, made) in labels.iter().zip(&sample.labels) {
                    assert_eq!(read.class_id, made.class_id);
                    assert!(read.to_pixels(128, 72).iou(&made.bbox) > 0.999);
                    boxes += 1;
                }
                let frame = picture::read(&read.image).unwrap();
                assert_eq!((frame.width(), frame.height()), (128, 72));
            }
        }
        assert!(boxes > 20, "{boxes}");
        for clip in 0..5 {
            let path = sequence(folder.path(), clip);
            let read = RgbdSequence::open(&path, &RgbdOptions::default()).unwrap();
            assert_eq!(read.layout(), RgbdLayout::Numbered);
            let steps = if clip == 4 { 3 } else { CLIP_FRAMES };
            assert_eq!(read.frames().len() as u64, steps);
            let yaml = std::fs::read_to_string(path.join("camera.yaml")).unwrap();
            let camera = *CameraCalibration::from_ros_yaml(&yaml).unwrap().camera();
            for (step, frame) in (0..).zip(read.frames()) {
                let sample = sampler.sample(clip * CLIP_FRAMES + step);
                let (color, depth) = frame.read().unwrap();
                assert_eq!(color.data(), sample.frame.data());
                for (read, made) in depth.unwrap().data().iter().zip(sample.depth.data()) {
                    // 65534 units are 13.1068 m.
                    if *made < 13.1067 {
                        assert!((read - made).abs() < 1.01e-4, "{read} {made}");
                    } else if *made > 13.107 {
                        assert!(!DepthMap::is_known(*read), "{read} {made}");
                    }
                }
                let pose = frame.world_from_camera.unwrap() * sample.world_from_camera.inverse();
                assert!(pose.translation_norm() < 1e-7 && pose.rotation_angle() < 1e-7);
                let rays = [[3.0, 5.0], [120.0, 60.0]].map(|at| {
                    let (a, b) = (camera.unproject(at), sample.camera.unproject(at));
                    (a.unwrap(), b.unwrap())
                });
                assert!(rays.iter().all(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9));
            }
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes_in_parts_too() {
        let frames = CLIP_FRAMES + 4;
        let whole = made(frames, 2);
        // In three parts, on one thread, the middle of it lost again.
        let parts = tempfile::tempdir().unwrap();
        for count in [3, CLIP_FRAMES + 1] {
            write(parts.path(), SPEC, count, 1, "realnet sim").unwrap();
        }
        std::fs::remove_file(Files::of(parts.path(), 5).depth).unwrap();
        write(parts.path(), SPEC, frames, 1, "realnet sim").unwrap();
        let (whole, parts) = (files(whole.path()), files(parts.path()));
        let names: Vec<_> = whole.keys().collect();
        assert_eq!(names, parts.keys().collect::<Vec<_>>());
        let different: Vec<_> =
            names.iter().filter(|name| whole[**name] != parts[**name]).collect();
        assert!(different.is_empty(), "{different:?}");
    }

    #[test]
    fn the_readme_counts_what_is_there() {
        let folder = tempfile::tempdir().unwrap();
        let says = || {
            let text = std::fs::read_to_string(folder.path().join("README.md")).unwrap();
            text.lines().nth(2).unwrap().to_owned()
        };
        // Interrupted at the fourth of twelve frames: asked once before each clip and frame.
        let asked = AtomicU64::new(0);
        let frames = 12;
        let ends = || asked.fetch_add(1, Ordering::Relaxed) >= 4;
        let outcome = write_until(folder.path(), SPEC, frames, 1, "realnet sim", &ends).unwrap();
        assert_eq!((outcome, frames_there(folder.path()).unwrap()), (Outcome::Interrupted, 3));
        assert!(says().starts_with("3 of 12 frames so far, of 128 x 72"), "{}", says());
        // Gone on with.
        write(folder.path(), SPEC, frames, 1, "realnet sim").unwrap();
        assert!(says().starts_with("12 frames of 128 x 72"), "{}", says());
        // A shorter command takes nothing away.
        write(folder.path(), SPEC, 2, 1, "realnet sim").unwrap();
        assert!(says().starts_with("12 frames of 128 x 72"), "{}", says());
    }

    #[test]
    fn a_folder_of_another_seed_is_refused() {
        let folder = made(1, 1);
        let other = DatasetSpec { seed: 6, ..SPEC };
        let error = write(folder.path(), other, 1, 1, "").unwrap_err().to_string();
        assert!(error.contains("seed: 5") && error.contains("seed: 6"), "{error}");
        let mount = Some(KnownMount { height_m: 0.18, pitch_rad: 0.0 });
        let error = write(folder.path(), DatasetSpec { mount, ..SPEC }, 1, 1, "").unwrap_err();
        assert!(error.to_string().contains("camera_height_m: Some(0.18)"), "{error}");
        let mounted = tempfile::tempdir().unwrap();
        for frames in [1, 2] {
            write(mounted.path(), DatasetSpec { mount, ..SPEC }, frames, 1, "").unwrap();
        }
        let text = std::fs::read_to_string(mounted.path().join("README.md")).unwrap();
        assert!(text.contains("mount: 0.18 m above the ground"), "{text}");
        let foreign = tempfile::tempdir().unwrap();
        std::fs::write(foreign.path().join("thesis.txt"), "text").unwrap();
        let error = write(foreign.path(), SPEC, 1, 1, "").unwrap_err().to_string();
        assert!(error.contains("choose an empty folder"), "{error}");
        let map = depth::read(&Files::of(folder.path(), 0).depth, DEPTH_SCALE, &Limits::default());
        assert!(map.unwrap().known_share() > 0.2);
    }
}
