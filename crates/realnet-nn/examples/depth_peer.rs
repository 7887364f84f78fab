//! Our side of `bench/peers/depth/compare.py`: a normalised picture in the
//! network's input, or a raw frame in memory, to depth in metres.
//!
//! For each line with a number on standard input it predicts that many times and
//! answers with one JSON object: milliseconds of each and, of frames, of the stages.
//!
//! ```text
//! depth_peer --model vnl.safetensors --form depth|full|half|frame [--threads N]
//!            [--size WxH] [--ort-dylib FILE] [--write FILE.onnx]
//! ```
//!
//! | form | from | to |
//! |---|---|---|
//! | `depth` | input | depth by the file as it is written |
//! | `full` | input | logits of every pixel by the engine, depth by us |
//! | `half` | input | the network's fast logits (VNL: of every second pixel) by the engine, depth by us |
//! | `frame` | 1280x720 RGB | the whole of `DepthNet` with its default options |
//!
//! With `--write` it writes the graph of the form and ends.
#![allow(clippy::print_stdout, reason = "the answer of this program")]

use realnet_core::{Frame, Stamp};
use realnet_nn::{
    depth::{DepthModel, DepthNet, DepthOptions, DepthWeights, Detail, SoftSum},
    engine::{EngineChoice, Runtime, RuntimeOptions},
    onnx::{OnnxModel, OnnxOptions},
    weights::Checkpoint,
};
use std::{error::Error, io::BufRead, path::Path, time::Instant};

type Times = Vec<(&'static str, f64)>;
type Step = Box<dyn FnMut() -> Result<Times, Box<dyn Error>>>;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let flag = |name: &str| {
        arguments.iter().position(|a| a == name).and_then(|at| arguments.get(at + 1)).cloned()
    };
    let need = |name: &str| flag(name).ok_or_else(|| format!("{name} is missing"));
    let path = need("--model")?;
    let size = flag("--size").unwrap_or_else(|| "256x256".to_owned());
    let (width, height) = size.split_once('x').ok_or("--size is WxH")?;
    let size: (u32, u32) = (width.parse()?, height.parse()?);
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
    let form = need("--form")?;
    let mut step: Step = match form.as_str() {
        "frame" => frames(&path, &runtime, size)?,
        "depth" | "full" | "half" => {
            let (network, sum) = graph(&path, &form, size)?;
            if let Some(file) = flag("--write") {
                std::fs::write(file, network.to_bytes())?;
                return Ok(());
            }
            inputs(network, sum, &runtime)?
        }
        other => return Err(format!("unknown form '{other}'").into()),
    };
    println!("ready");
    for line in std::io::stdin().lock().lines() {
        let count: usize = line?.trim().parse()?;
        let mut answer = serde_json::Map::new();
        for _ in 0..count {
            for (what, ms) in step()? {
                let list = answer.entry(what).or_insert_with(|| serde_json::json!([]));
                list.as_array_mut().ok_or("not a list")?.push(ms.into());
            }
        }
        println!("{}", serde_json::Value::Object(answer));
    }
    Ok(())
}

/// The graph of a form, and how to read its logits.
fn graph(
    path: &str,
    form: &str,
    size: (u32, u32),
) -> Result<(OnnxModel, Option<SoftSum>), Box<dyn Error>> {
    if form == "depth" {
        let network = DepthWeights::from_checkpoint(&Checkpoint::read(path)?)?;
        let (width, height) = (size.0 as usize, size.1 as usize);
        let file = network.to_onnx(&OnnxOptions { width, height, half: false })?;
        return Ok((OnnxModel::from_vec(file)?, None));
    }
    let detail = if form == "full" { Detail::Full } else { Detail::Fast };
    let model = DepthModel::open(Path::new(path))?;
    let (network, metadata) = model.network(Some(size), detail)?;
    let bins = network.outputs().first().and_then(|o| o.fixed_dims()?.get(1).copied());
    let sum = SoftSum::new(&metadata.coding, bins.ok_or("the logits have no shape")?);
    Ok((network, Some(sum)))
}

fn inputs(
    network: OnnxModel,
    mut sum: Option<SoftSum>,
    runtime: &Runtime,
) -> Result<Step, Box<dyn Error>> {
    let mut engine = runtime.load(network)?;
    for (i, value) in engine.input().iter_mut().enumerate() {
        *value = (i as f32 * 0.37).sin() * 2.0;
    }
    let mut depths = Vec::new();
    Ok(Box::new(move || {
        let start = Instant::now();
        let mut inferred = start;
        engine.run(&mut |outputs| {
            inferred = Instant::now();
            if let (Some(sum), [logits]) = (&mut sum, outputs) {
                depths.resize(logits.data.len() / sum.bins(), 0.0);
                sum.run(logits.data, 1.0, &mut depths);
            }
        })?;
        let ms = start.elapsed().as_secs_f64() * 1e3;
        Ok(vec![("ms", ms), ("infer", (inferred - start).as_secs_f64() * 1e3)])
    }))
}

fn frames(path: &str, runtime: &Runtime, size: (u32, u32)) -> Result<Step, Box<dyn Error>> {
    let data = (0..1280 * 720 * 3).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8);
    let frame = Frame::rgb8(Stamp::ZERO, 1280, 720, data.collect())?;
    let options = DepthOptions { size: Some(size), ..Default::default() };
    let mut net = DepthNet::new(&DepthModel::open(Path::new(path))?, runtime, &options)?;
    let mut memory = Vec::new();
    Ok(Box::new(move || {
        let start = Instant::now();
        let mut last = start;
        let mut stages = Vec::with_capacity(4);
        let names = ["pre", "infer", "post"];
        let map = net.depth_marked(&frame, None, std::mem::take(&mut memory), &mut |stage| {
            let now = Instant::now();
            stages.push((names[stage as usize], (now - last).as_secs_f64() * 1e3));
            last = now;
        })?;
        memory = map.into_data();
        stages.push(("ms", start.elapsed().as_secs_f64() * 1e3));
        Ok(stages)
    }))
}
