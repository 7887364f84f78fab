//! Our side of `bench/peers/detect/compare.py`: a raw frame in memory to boxes.
//!
//! For each line with a number on standard input it detects that many times and
//! answers with one JSON object: milliseconds of each frame and of its stages,
//! peak memory and the boxes.
#![allow(clippy::print_stdout, reason = "the answer of this program")]

use realnet::{
    Detector, DetectorModel, DetectorOptions, EngineChoice, Filter, Frame, Runtime, RuntimeOptions,
    Stamp,
};
use std::{error::Error, io::BufRead, path::Path, time::Instant};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let flag = |name: &str| {
        arguments.iter().position(|a| a == name).and_then(|at| arguments.get(at + 1)).cloned()
    };
    let need = |name: &str| flag(name).ok_or_else(|| format!("{name} is missing"));
    let frame = Frame::rgb8(Stamp::ZERO, 1280, 720, std::fs::read(need("--frame")?)?)?;
    let dylib = flag("--ort-dylib");
    let runtime = Runtime::start(&RuntimeOptions {
        choice: if dylib.is_some() { EngineChoice::Ort } else { EngineChoice::Rten },
        threads: flag("--threads").map_or(Ok(2), |n| n.parse())?,
        ort_libraries: dylib.map(Into::into).into_iter().collect(),
        ..Default::default()
    });
    if let Some(note) = runtime.note() {
        return Err(note.into());
    }
    let model = DetectorModel::open(Path::new(&need("--model")?))?;
    let filter = match flag("--resize").as_deref() {
        Some("linear") => Filter::Linear,
        _ => Filter::Triangle,
    };
    let options = DetectorOptions { filter, ..Default::default() };
    let mut detector = Detector::new(model, &runtime, options)?;
    println!("ready");
    for line in std::io::stdin().lock().lines() {
        let frames: usize = line?.trim().parse()?;
        let mut ms = vec![0.0; frames];
        let mut stages = [vec![], vec![], vec![]];
        let mut boxes = Vec::new();
        for ms in &mut ms {
            let start = Instant::now();
            let mut last = start;
            let found = detector.detect_marked(&frame, &mut |stage| {
                let now = Instant::now();
                stages[stage as usize].push((now - last).as_secs_f64() * 1e3);
                last = now;
            })?;
            *ms = start.elapsed().as_secs_f64() * 1e3;
            boxes = found.to_vec();
        }
        let boxes: Vec<_> = boxes
            .iter()
            .map(|d| serde_json::json!([d.class_id, d.confidence, <[f32; 4]>::from(d.bbox)]))
            .collect();
        let [pre, infer, post] = stages;
        println!(
            "{}",
            serde_json::json!({
                "ms": ms, "pre": pre, "infer": infer, "post": post,
                "peak_mb": peak_mb(), "boxes": boxes,
            })
        );
    }
    Ok(())
}

/// Peak resident memory in MiB, where Linux tells.
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kib.unwrap_or(f64::NAN) / 1024.0
}
