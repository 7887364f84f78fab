//! The RealNet side of bench/peers/motion/compare.py: the motion between two
//! pictures, with the matches it comes from.
//!
//! `matches --data FOLDER --pairs 0-4,9-13 --camera fx,fy,cx,cy [--depth-scale 1000]`
//! follows corners of the first picture of each pair, lifted by its depth map, into
//! the second ([`MotionTracker`]). Any RGB-D layout is read, frames are named by
//! their numbers. A line of JSON for each pair: the matches (`points` in the first
//! camera's optical frame, metres; `pixels` in the second picture), the answer, the
//! files, and `truth`, the motion that the data's own poses give, or `null`.
//!
//! `matches --matches FILE` solves matches from elsewhere: each line of the file has
//! `points`, `pixels`, `size` and `camera`, and is answered by a line of JSON.
//!
//! An answer is `pose`, the rows of `[R t]` that take points of the first camera to
//! the second, `inliers` and the deviations; or `pose: null` and `refused`, the reason.
#![allow(clippy::print_stdout)]

use realnet_core::nalgebra::Point3;
use realnet_core::{CameraModel, Distortion, Intrinsics, Pose, Stamp};
use realnet_io::datasets::rgbd::{RgbdFrame, RgbdOptions, RgbdSequence};
use realnet_pose::{Estimate, PnpSolver};
use realnet_range::motion::{MotionOptions, MotionTracker};
use serde_json::{Value, json};
use std::error::Error;
use std::path::Path;

type Outcome<T> = Result<T, Box<dyn Error>>;

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let get = |name: &str| -> Option<&str> {
        let mut pairs = arguments.chunks_exact(2);
        pairs.find(|pair| pair[0] == name).map(|pair| pair[1].as_str())
    };
    let need = |name: &str| get(name).ok_or_else(|| format!("{name} is missing"));
    if let Some(file) = get("--matches") {
        for line in std::fs::read_to_string(file)?.lines() {
            println!("{}", solve(&serde_json::from_str(line)?)?);
        }
        return Ok(());
    }
    let intrinsics = intrinsics(need("--camera")?.split(',').map(str::parse::<f64>))?;
    let depth_scale = get("--depth-scale").map(str::parse).transpose()?;
    let options = RgbdOptions { depth_scale, ..RgbdOptions::default() };
    let sequence = RgbdSequence::open(need("--data")?.as_ref(), &options)?;
    for pair in need("--pairs")?.split(',') {
        let (first, second) = pair.split_once('-').ok_or("a pair is two numbers, as 0-4")?;
        let frame = |name: &str| -> Outcome<&RgbdFrame> {
            let number: u64 = name.parse()?;
            let found = sequence.frames().iter().find(|frame| frame.number == number);
            Ok(found.ok_or_else(|| format!("there is no frame {number}"))?)
        };
        println!("{}", follow(frame(first)?, frame(second)?, intrinsics)?);
    }
    Ok(())
}

fn intrinsics<E: Error + 'static>(
    values: impl Iterator<Item = Result<f64, E>>,
) -> Outcome<Intrinsics> {
    let values = values.collect::<Result<Vec<_>, _>>()?;
    let [fx, fy, cx, cy] = values[..] else { return Err("a camera is fx,fy,cx,cy".into()) };
    Ok(Intrinsics { fx, fy, cx, cy })
}

/// Follows the corners of `first` into `second`.
fn follow(first: &RgbdFrame, second: &RgbdFrame, intrinsics: Intrinsics) -> Outcome<Value> {
    // A pair may go back in time; the tracker is not told.
    let (then, now) = (Stamp::ZERO, Stamp::from_secs_f64(0.1));
    let picture = first.color()?.with_stamp(then);
    let (width, height) = (picture.width(), picture.height());
    let camera = CameraModel::new(width, height, intrinsics, Distortion::None)?;
    let mut tracker = MotionTracker::new(&camera, MotionOptions::default())?;
    tracker.push(&picture)?;
    tracker.keep();
    tracker.set_depth(&first.depth()?.with_stamp(then), None)?;
    tracker.push(&second.color()?.with_stamp(now))?;
    let motion = tracker.estimate().background.clone();

    // Those that the tracker gives to its solver.
    let (mut points, mut pixels) = (Vec::new(), Vec::new());
    for ((_, track, _), point) in tracker.background_tracks().zip(tracker.background_points()) {
        if track.is_tracked() && camera.contains(track.point.map(f64::from)) {
            points.push([point.x, point.y, point.z]);
            pixels.push(track.point);
        }
    }
    let mut answer = match &motion {
        Ok(motion) => accepted(&motion.estimate),
        Err(failure) => refused(failure),
    };
    let path = |path: &Path| path.display().to_string();
    let truth = first.world_from_camera.zip(second.world_from_camera);
    for (key, value) in [
        ("first", json!(first.number)),
        ("second", json!(second.number)),
        ("pictures", json!([path(&first.color_path), path(&second.color_path)])),
        ("depth", json!(first.depth_path.as_deref().map(path))),
        ("size", json!([width, height])),
        ("points", json!(points)),
        ("pixels", json!(pixels)),
        ("truth", json!(truth.map(|(first, second)| rows(&(second.inverse() * first))))),
    ] {
        answer[key] = value;
    }
    Ok(answer)
}

/// Solves matches from elsewhere as the tracker solves its own.
fn solve(problem: &Value) -> Outcome<Value> {
    let numbers = |value: &Value| -> Outcome<Vec<f64>> {
        let list = value.as_array().ok_or("a list of numbers is missing")?;
        let numbers: Option<Vec<f64>> = list.iter().map(Value::as_f64).collect();
        Ok(numbers.ok_or("a list holds something else than numbers")?)
    };
    let lists = |name: &str| -> Outcome<Vec<Vec<f64>>> {
        let list = problem[name].as_array().ok_or_else(|| format!("{name} is missing"))?;
        list.iter().map(numbers).collect()
    };
    let mut points = Vec::new();
    for row in lists("points")? {
        let [x, y, z] = row[..] else { return Err("a point has three numbers".into()) };
        points.push(Point3::new(x, y, z));
    }
    let mut pixels = Vec::new();
    for row in lists("pixels")? {
        let [x, y] = row[..] else { return Err("a pixel has two numbers".into()) };
        pixels.push([x, y]);
    }
    let [width, height] = numbers(&problem["size"])?[..] else { return Err("size".into()) };
    let camera = numbers(&problem["camera"])?.into_iter().map(Ok::<_, std::fmt::Error>);
    let camera =
        CameraModel::new(width as u32, height as u32, intrinsics(camera)?, Distortion::None)?;
    let MotionOptions { ransac, seed, .. } = MotionOptions::default();
    let mut solver = PnpSolver::with_capacity(ransac, points.len())?;
    Ok(match solver.solve_pixels(&camera, &points, &pixels, seed) {
        Ok(estimate) => accepted(&estimate),
        Err(reason) => refused(&reason),
    })
}

fn accepted(estimate: &Estimate) -> Value {
    json!({
        "pose": rows(&estimate.camera_from_world),
        "inliers": estimate.inliers,
        "noise_px": estimate.noise_px,
        "rotation_std": estimate.rotation_std(),
        "translation_std": estimate.translation_std(),
    })
}

fn refused(reason: &impl Error) -> Value {
    json!({ "pose": null, "refused": reason.to_string() })
}

/// The rows of `[R t]`.
fn rows(pose: &Pose) -> Vec<f64> {
    let matrix = pose.to_matrix();
    (0..12).map(|i| matrix[(i / 4, i % 4)]).collect()
}
