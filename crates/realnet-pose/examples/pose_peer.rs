//! The RealNet side of bench/peers/pose/compare.py: solves problems from a file
//! and tells the time of each.
//!
//! The file holds, in `f64` of this machine's byte order, for each problem
//! `points` times `x y z u v`. Focal lengths and principal point come from the
//! command line. Each line `first count` on the standard input is answered by a
//! line of JSON: `us`, the time of each problem, and `poses`, the rows of `[R t]`
//! or `null` for a refusal.
#![allow(clippy::print_stdout)]

use realnet_core::nalgebra::Point3;
use realnet_core::{CameraModel, Distortion, Intrinsics};
use realnet_pose::{PnpSolver, RansacOptions};
use std::fmt::Write as _;
use std::io::{BufRead as _, Write as _};
use std::time::Instant;

type Anything = Box<dyn std::error::Error>;

fn main() -> Result<(), Anything> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let get = |name: &str| -> Result<&str, Anything> {
        let mut pairs = arguments.chunks_exact(2);
        let pair = pairs.find(|pair| pair[0] == name);
        Ok(pair.map(|pair| pair[1].as_str()).ok_or_else(|| format!("{name} is missing"))?)
    };
    let number = |name: &str| -> Result<f64, Anything> { Ok(get(name)?.parse()?) };
    let bytes = std::fs::read(get("--problems")?)?;
    let count = number("--points")? as usize;
    let (fx, fy, cx, cy) = (number("--fx")?, number("--fy")?, number("--cx")?, number("--cy")?);
    let camera = CameraModel::new(640, 480, Intrinsics { fx, fy, cx, cy }, Distortion::None)?;
    let options = RansacOptions {
        threshold_px: number("--threshold")?,
        confidence: number("--confidence")?,
        ..RansacOptions::default()
    };
    let mut values = Vec::with_capacity(bytes.len() / 8);
    for chunk in bytes.chunks_exact(8) {
        values.push(f64::from_ne_bytes(chunk.try_into()?));
    }
    let mut problems = Vec::new();
    for rows in values.chunks_exact(5 * count) {
        let points: Vec<_> =
            rows.chunks_exact(5).map(|row| Point3::new(row[0], row[1], row[2])).collect();
        let pixels: Vec<_> = rows.chunks_exact(5).map(|row| [row[3], row[4]]).collect();
        problems.push((points, pixels));
    }
    let mut solver = PnpSolver::with_capacity(options, count)?;
    let mut output = std::io::stdout().lock();
    writeln!(output, "ready")?;
    output.flush()?;
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let mut words = line.split_whitespace().map(str::parse::<usize>);
        let (first, some) = (words.next().ok_or("first")??, words.next().ok_or("count")??);
        let (mut times, mut poses) = (String::new(), String::new());
        for (index, (points, pixels)) in problems.iter().enumerate().skip(first).take(some) {
            let start = Instant::now();
            let answer = solver.solve_pixels(&camera, points, pixels, index as u64);
            let micros = start.elapsed().as_secs_f64() * 1e6;
            let comma = if index == first { "" } else { "," };
            write!(times, "{comma}{micros:.3}")?;
            match answer {
                Ok(estimate) => {
                    let m = estimate.camera_from_world.to_matrix();
                    let rows: Vec<f64> = (0..12).map(|i| m[(i / 4, i % 4)]).collect();
                    write!(poses, "{comma}{rows:?}")?;
                }
                Err(_) => write!(poses, "{comma}null")?,
            }
        }
        writeln!(output, "{{\"us\":[{times}],\"poses\":[{poses}]}}")?;
        output.flush()?;
    }
    Ok(())
}
