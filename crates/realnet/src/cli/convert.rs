//! `realnet convert`.

use super::{
    failure::{OrBadInput, Outcome, keep_input, say},
    model_args::parse_size,
};
use anyhow::{Context, Result};
use clap::Args;
use realnet::{
    depth::DepthWeights,
    weights::Checkpoint,
    yolov5::{OnnxOptions, YoloV5},
};
use realnet_io::atomic;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub(crate) struct ConvertArgs {
    /// YOLOv5, VNL or vnl-lite weights: .pt (whole module or state dict) or .safetensors.
    weights: PathBuf,
    /// The ONNX file to write [default: beside the weights].
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Input size in pixels: N or WIDTHxHEIGHT [default: that of the training if the file tells, else 640 for YOLOv5, 256 for VNL (384 with ResNeXt), 256x192 for vnl-lite].
    #[arg(long, value_name = "N|WxH", value_parser = parse_size)]
    imgsz: Option<(u32, u32)>,
    /// Store the weights in 16 bits: half the file, computed in 32 bits all the same.
    #[arg(long)]
    half: bool,
}

pub(crate) fn run(args: &ConvertArgs) -> Result<Outcome> {
    let output = args.output.clone().unwrap_or_else(|| args.weights.with_extension("onnx"));
    keep_input(&output, &args.weights)?;
    let checkpoint = Checkpoint::read(&args.weights)
        .with_context(|| args.weights.display().to_string())
        .or_bad_input()?;
    let name = || args.weights.display().to_string();
    let options = |default| {
        let (width, height) = args.imgsz.unwrap_or(default);
        OnnxOptions { width: width as usize, height: height as usize, half: args.half }
    };
    let (onnx, OnnxOptions { width, height, .. }, what) = if DepthWeights::recognises(&checkpoint) {
        let network =
            DepthWeights::from_checkpoint(&checkpoint).with_context(name).or_bad_input()?;
        let options = options(checkpoint.size.unwrap_or(network.default_size()));
        let (millions, bins) = (network.parameters() as f64 / 1e6, network.bins());
        let architecture = network.architecture();
        let what = format!("{architecture} depth of {millions:.1} million parameters, {bins} bins");
        (network.to_onnx(&options).or_bad_input()?, options, what)
    } else {
        let network = YoloV5::from_checkpoint(&checkpoint).with_context(name).or_bad_input()?;
        let options = options(checkpoint.size.unwrap_or((640, 640)));
        let (millions, classes) = (network.parameters() as f64 / 1e6, network.class_names().len());
        let what = format!("YOLOv5 of {millions:.1} million parameters, {classes} classes");
        (network.to_onnx(&options).or_bad_input()?, options, what)
    };
    atomic::write(&output, &onnx)?;
    say(format!(
        "{}: {what}, input {width}x{height}, {:.1} MB",
        output.display(),
        onnx.len() as f64 / 1e6,
    ));
    Ok(Outcome::Done)
}
