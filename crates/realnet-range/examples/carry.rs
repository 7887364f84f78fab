//! Boxes carried by optical flow on real frames: the figures of docs/benchmarks.md.
//!
//! `cargo run --release -p realnet-range --example carry -- DATA` where DATA holds
//! `blurcar` and `rc-car`; prints JSON. A box that was refused counts as a miss.
//! `--sweep` varies one option at a time instead, `--pairs` lists every step.
#![allow(clippy::print_stdout)]

#[path = "../tests/carry_sequences/mod.rs"]
mod sequences;

use realnet_core::{BoundingBox, Frame};
use realnet_range::carry::{
    BoxCarrier, BoxMotion, Carried, CarryError, CarryOptions, SearchOptions,
};
use realnet_vision::{Pyramid, Window};
use serde_json::{Value, json};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

type Outcome<T> = Result<T, Box<dyn Error>>;

/// Frames of a sequence, ready for flow.
struct Sequence {
    name: &'static str,
    frames: Vec<(Pyramid, BoundingBox)>,
    /// The same frames, their rows in reverse.
    upside_down: Vec<Pyramid>,
    size: (f32, f32),
    /// Median of building a pyramid.
    pyramid_ms: f64,
}

impl Sequence {
    fn new(name: &'static str, frames: &[(Frame, BoundingBox)]) -> Self {
        let size =
            frames.first().map_or((0.0, 0.0), |(f, _)| (f.width() as f32, f.height() as f32));
        let mut times = Vec::new();
        let mut build = |frame: &Frame| {
            let mut pyramid = Pyramid::new(3, Window::default());
            pyramid.build(frame);
            let start = Instant::now();
            pyramid.build(frame);
            times.push(start.elapsed().as_secs_f64() * 1e3);
            pyramid
        };
        let upside_down =
            frames.iter().map(|(frame, _)| build(&sequences::upside_down(frame))).collect();
        let frames = frames.iter().map(|(frame, bbox)| (build(frame), *bbox)).collect();
        Self { name, frames, upside_down, size, pyramid_ms: median(&mut times) }
    }
}

/// One step: the result, its IoU with the truth (0 when refused) and its time.
struct Step {
    frame: usize,
    result: Result<Carried, CarryError>,
    iou: f32,
    /// IoU of the last truth, held.
    held: f32,
    truth: BoundingBox,
    ms: f64,
}

/// Carries the box from each frame to the next. Every `every`-th frame's comes from
/// the truth, the others' from the step before; after a refusal the next frame is
/// tried from the last frame that has a box.
fn run(sequence: &Sequence, options: CarryOptions, every: usize) -> Outcome<Vec<Step>> {
    let mut carrier = BoxCarrier::new(options)?;
    let frames = &sequence.frames;
    let Some(first) = frames.first() else { return Err("no frames".into()) };
    let mut last = (first, first.1, BoxMotion::NONE);
    let mut seed = first.1;
    let mut steps = Vec::new();
    for (i, pair) in frames.windows(2).enumerate() {
        let [present, next] = pair else { continue };
        if i % every == 0 {
            (last, seed) = ((present, present.1, BoxMotion::NONE), present.1);
        }
        // The step into a frame whose box comes from the truth is not needed, unless
        // all of them do.
        if every > 1 && (i + 1) % every == 0 {
            continue;
        }
        let start = Instant::now();
        let result = carrier.carry(&last.0.0, &next.0, &last.1, last.2);
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let (width, height) = sequence.size;
        let iou = |bbox: &BoundingBox| bbox.clipped(width, height).iou(&next.1);
        let found = result.as_ref().map_or(0.0, |carried| iou(&carried.bbox));
        if let Ok(carried) = &result {
            last = (next, carried.bbox, carried.motion);
        }
        steps.push(Step { frame: i + 1, result, iou: found, held: iou(&seed), truth: next.1, ms });
    }
    Ok(steps)
}

/// The share of the steps from each frame's true box into the next frame turned
/// upside down that are accepted: none is right.
fn accepted_upside_down(sequence: &Sequence, options: CarryOptions) -> Outcome<f64> {
    let mut carrier = BoxCarrier::new(options)?;
    let pairs = sequence.frames.iter().zip(sequence.upside_down.iter().skip(1));
    let accepted = pairs
        .filter(|((from, bbox), to)| carrier.carry(from, to, bbox, BoxMotion::NONE).is_ok())
        .count();
    Ok(share(accepted, sequence.frames.len() - 1))
}

fn median(values: &mut Vec<f64>) -> f64 {
    values.retain(|v| v.is_finite());
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn share(count: usize, of: usize) -> f64 {
    (count as f64 / of.max(1) as f64 * 1e4).round() / 1e4
}

fn summary(steps: &[Step], seeds: usize) -> Value {
    let n = steps.len();
    let good = steps.iter().filter(|s| s.iou >= 0.5).count();
    let accepted: Vec<_> =
        steps.iter().filter_map(|s| s.result.as_ref().ok().map(|c| (s, c))).collect();
    let mean =
        accepted.iter().map(|(s, _)| f64::from(s.iou)).sum::<f64>() / accepted.len().max(1) as f64;
    // Of boxes that are on the target: is their error within two deviations?
    let mut inside = [0; 3];
    let on_target: Vec<_> = accepted.iter().filter(|(s, _)| s.iou >= 0.5).collect();
    for (step, carried) in &on_target {
        let ((x, y), (tx, ty)) = (carried.bbox.center(), step.truth.center());
        let size = (carried.bbox.width() * carried.bbox.height()
            / (step.truth.width() * step.truth.height()))
        .sqrt()
        .ln();
        inside[0] += usize::from((x - tx).abs() <= 2.0 * carried.center_sd[0]);
        inside[1] += usize::from((y - ty).abs() <= 2.0 * carried.center_sd[1]);
        inside[2] += usize::from(size.abs() <= 2.0 * carried.size_sd);
    }
    let times = |searched: bool| {
        let of = |s: &&Step| s.result.as_ref().map_or(true, |c| c.searched) == searched;
        median(&mut steps.iter().filter(of).map(|s| s.ms).collect())
    };
    let reasons = steps.iter().filter_map(|s| s.result.as_ref().err()).fold(
        std::collections::BTreeMap::<String, usize>::new(),
        |mut counts, error| {
            let name = format!("{error:?}");
            let name = name.split([' ', '(']).next().unwrap_or_default().to_owned();
            *counts.entry(name).or_default() += 1;
            counts
        },
    );
    json!({
        "carried": n,
        "seeds": seeds,
        "iou_50": share(good, n),
        "iou_50_with_seeds": share(good + seeds, n + seeds),
        "iou_50_held": share(steps.iter().filter(|s| s.held >= 0.5).count(), n),
        "iou_75": share(steps.iter().filter(|s| s.iou >= 0.75).count(), n),
        "mean_iou_accepted": (mean * 1e4).round() / 1e4,
        "refused": n - accepted.len(),
        "refused_why": reasons,
        "accepted_below_50": accepted.iter().filter(|(s, _)| s.iou < 0.5).count(),
        "searched": accepted.iter().filter(|(_, c)| c.searched).count(),
        "within_2_sd_x_y_size": inside.map(|count| share(count, on_target.len())),
        "ms_without_search": times(false),
        "ms_with_search": times(true),
    })
}

fn evaluate(sequences: &[Sequence], options: CarryOptions, list: bool) -> Outcome<Value> {
    let mut report = serde_json::Map::new();
    let mut pairs = Vec::new();
    for sequence in sequences {
        let blurcar = sequence.name == "blurcar";
        let mut add = |name: &str, every: usize| -> Outcome<Vec<Step>> {
            let steps = run(sequence, options, every)?;
            if list {
                for s in &steps {
                    let figures = format!("iou {:.3} held {:.3} {:.2} ms", s.iou, s.held, s.ms);
                    println!("{name} {} {figures} {:?}", s.frame, s.result);
                }
            }
            let seeds = if every > 1 { sequence.frames.len().div_ceil(every) } else { 0 };
            let mut result = summary(&steps, seeds);
            result["accepted_upside_down"] = json!(accepted_upside_down(sequence, options)?);
            result["pyramid_ms"] = json!(sequence.pyramid_ms);
            report.insert(name.to_owned(), result);
            Ok(steps)
        };
        if blurcar {
            add("blurcar", 15)?;
            add("blurcar pairs", 1)?;
        } else {
            pairs.extend(add(sequence.name, 1)?);
        }
    }
    report.insert("rc-car".to_owned(), summary(&pairs, 0));
    Ok(report.into())
}

/// The figures that count when one option is changed.
fn sweep(sequences: &[Sequence]) -> Outcome<()> {
    let base = CarryOptions::default();
    let search = SearchOptions::default();
    let mut trials = vec![("default".to_owned(), base)];
    let mut vary = |name: &str, values: &[f32], set: &dyn Fn(f32) -> CarryOptions| {
        trials.extend(values.iter().map(|&v| (format!("{name} {v}"), set(v))));
    };
    vary("max_points", &[30.0, 100.0], &|v| CarryOptions { max_points: v as usize, ..base });
    vary("min_inliers", &[4.0, 10.0], &|v| CarryOptions { min_inliers: v as usize, ..base });
    vary("min_share", &[0.1, 0.15, 0.3], &|v| CarryOptions { min_share: v, ..base });
    vary("tolerance", &[0.02, 0.03, 0.06], &|v| CarryOptions { tolerance: v, ..base });
    vary("min_similarity", &[0.4, 0.6, 0.7], &|v| CarryOptions { min_similarity: v, ..base });
    vary("sure_similarity", &[0.75, 0.95], &|v| CarryOptions { sure_similarity: v, ..base });
    let with = |search| CarryOptions { search: Some(search), ..base };
    vary("search.radius", &[1.2, 2.0], &|v| with(SearchOptions { radius: v, ..search }));
    vary("search.steps", &[3.0, 7.0], &|v| with(SearchOptions { steps: v as u32, ..search }));
    trials.push(("no search".to_owned(), CarryOptions { search: None, ..base }));
    for (name, options) in trials {
        let report = evaluate(sequences, options, false)?;
        let figures = |s: &str| {
            let of = &report[s];
            let (right, wrong) = (&of["iou_50"], &of["accepted_below_50"]);
            format!("{s} {right} ({wrong} wrong, upside down {})", of["accepted_upside_down"])
        };
        let all = ["blurcar", "blurcar pairs", "seq2", "seq3", "seq4"].map(figures);
        println!("{name}: {}", all.join(", "));
    }
    Ok(())
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let flag = |name: &str| arguments.iter().any(|a| a == name);
    let data = arguments
        .iter()
        .find(|a| !a.starts_with('-'))
        .ok_or("usage: carry DATA [--sweep] [--pairs]")?;
    let data = Path::new(data);
    let mut all = vec![Sequence::new("blurcar", &sequences::blurcar(data)?)];
    for name in ["seq2", "seq3", "seq4"] {
        all.push(Sequence::new(name, &sequences::rc_car(data, name)?));
    }
    if flag("--sweep") {
        return sweep(&all);
    }
    let report = evaluate(&all, CarryOptions::default(), flag("--pairs"))?;
    println!("{}", serde_json::to_string_pretty(&report)?);
    Ok(())
}
