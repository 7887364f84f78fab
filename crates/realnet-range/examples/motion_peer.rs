//! The fast path's side of `bench/peers/depth/compare.py`.
//!
//! For each line with a number on standard input it takes that many frames of a
//! drawn drive (corners of background and target, both motions, the whole depth map
//! warped; the pyramid included) and answers with one JSON object: milliseconds of
//! each, and of its parts.
//!
//! ```text
//! motion_peer --size WxH
//! ```
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program for measuring")]

#[path = "../tests/scene/mod.rs"]
mod scene;

use scene::drive::Drive;
use serde_json::json;
use std::{error::Error, io::BufRead, time::Instant};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [flag, size] = arguments.as_slice() else { return Err("motion_peer --size WxH".into()) };
    let (width, height) = size.split_once('x').filter(|_| flag == "--size").ok_or("--size WxH")?;
    let drive = Drive::new((width.parse()?, height.parse()?));
    let mut lap = drive.lap();
    let mut out = drive.depth.clone();
    println!("ready");
    for line in std::io::stdin().lock().lines() {
        let count: usize = line?.trim().parse()?;
        let (mut all, mut motion) = (Vec::new(), Vec::new());
        for _ in 0..count {
            let start = Instant::now();
            lap.push();
            lap.tracker.estimate();
            motion.push(start.elapsed().as_secs_f64() * 1e3);
            lap.tracker.depth_now(&mut out)?;
            all.push(start.elapsed().as_secs_f64() * 1e3);
        }
        println!("{}", json!({ "ms": all, "motion": motion }));
    }
    Ok(())
}
