//! `realnet convert`.

use super::{
    failure::{OrBadInput, Outcome, keep_input, say},
    model_args::parse_size,
};
use anyhow::{Context, Result};
use clap::Args;
use realnet::{
    weights::Checkpoint,
    yolov5::{OnnxOptions, YoloV5},
};
use realnet_io::atomic;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub(crate) struct ConvertArgs {
    /// YOLOv5 weights: .pt (whole module or state dict) or .safetensors.
    weights: PathBuf,
    /// The ONNX file to write [default: beside the weights].
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Input size in pixels: N or WIDTHxHEIGHT.
    #[arg(long, value_name = "N|WxH", default_value = "640", value_parser = parse_size)]
    imgsz: (u32, u32),
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
    let network = YoloV5::from_checkpoint(&checkpoint)
        .with_context(|| args.weights.display().to_string())
        .or_bad_input()?;
    let (width, height) = args.imgsz;
    let options = OnnxOptions { width: width as usize, height: height as usize, half: args.half };
    let onnx = network.to_onnx(&options).or_bad_input()?;
    atomic::write(&output, &onnx)?;
    say(format!(
        "{}: YOLOv5 of {:.1} million parameters, {} classes, input {width}x{height}, {:.1} MB",
        output.display(),
        network.parameters() as f64 / 1e6,
        network.class_names().len(),
        onnx.len() as f64 / 1e6,
    ));
    Ok(Outcome::Done)
}
