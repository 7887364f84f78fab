//! Our side of `bench/peers/flow/compare.py`: corners of each frame of a raw
//! grey sequence and their flow to the next one.
//!
//! For each line with a number on standard input it takes that many frames and
//! answers with one JSON object: milliseconds of each frame and of its stages.
//! For the line `tracks` it answers with the corners and tracks of every pair.
#![allow(clippy::print_stdout, reason = "the answer of this program")]

use realnet_core::{Frame, Stamp};
use realnet_vision::{CornerDetector, CornerOptions, FlowOptions, FlowTracker};
use std::{error::Error, io::BufRead, time::Instant};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let flag = |name: &str| {
        let at = arguments.iter().position(|a| a == name);
        at.and_then(|at| arguments.get(at + 1)).ok_or_else(|| format!("{name} is missing"))
    };
    let (width, height): (u32, u32) = (flag("--width")?.parse()?, flag("--height")?.parse()?);
    let raw = std::fs::read(flag("--frames")?)?;
    let frames = raw
        .chunks_exact(width as usize * height as usize)
        .map(|data| Frame::grey8(Stamp::ZERO, width, height, data.to_vec()))
        .collect::<Result<Vec<_>, _>>()?;
    let max_corners = flag("--corners")?.parse()?;
    let mut detector = CornerDetector::new(CornerOptions { max_corners, ..Default::default() })?;
    let options = FlowOptions { max_round_trip: None, ..Default::default() };
    let mut tracker = FlowTracker::new(options)?;
    let (mut corners, mut points, mut tracks) = (Vec::new(), Vec::new(), Vec::new());
    let mut next = 0;
    println!("ready");
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let all = line.trim() == "tracks";
        let count = if all { frames.len() - 1 } else { line.trim().parse()? };
        if all {
            next = 0;
        }
        let (mut ms, mut stages, mut pairs) = (Vec::new(), [vec![], vec![], vec![]], Vec::new());
        for _ in 0..count {
            if next == 0 {
                tracker.push(&frames[0]);
                next = 1;
            }
            let start = Instant::now();
            tracker.push(&frames[next]);
            let pyramid = Instant::now();
            detector.detect(tracker.previous(), None, &mut corners)?;
            let found = Instant::now();
            points.clear();
            points.extend(corners.iter().map(|c| c.point));
            tracker.track(&points, None, &mut tracks)?;
            let end = Instant::now();
            ms.push((end - start).as_secs_f64() * 1e3);
            let times = [pyramid - start, found - pyramid, end - found];
            stages.iter_mut().zip(times).for_each(|(s, t)| s.push(t.as_secs_f64() * 1e3));
            next = (next + 1) % frames.len();
            if all {
                let pair: Vec<_> = (points.iter().zip(&tracks))
                    .map(|(p, t)| (*p, t.point, t.is_tracked(), t.error))
                    .collect();
                pairs.push(pair);
            }
        }
        let [pyramid, corners, flow] = stages;
        println!(
            "{}",
            serde_json::json!({
                "ms": ms, "pyramid": pyramid, "corners": corners, "flow": flow, "pairs": pairs,
            })
        );
    }
    Ok(())
}
