//! `realnet engines`.

use super::{engine_args::library_file, failure::Outcome, output::Output};
use anyhow::Result;
use clap::Args;
use realnet::find_ort_libraries;
use realnet_nn::engine::{OrtLibrary, RTEN_VERSION};
use serde_json::json;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub(crate) struct EnginesArgs {
    /// Look at this ONNX Runtime library only.
    #[arg(long, value_name = "FILE")]
    ort_dylib: Option<PathBuf>,
    /// One JSON object on standard output.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &EnginesArgs) -> Result<Outcome> {
    let paths = match &args.ort_dylib {
        Some(path) => vec![library_file(path)],
        None => find_ort_libraries(),
    };
    let probes: Vec<_> = paths.iter().map(|path| (path, OrtLibrary::probe(path))).collect();
    // Only one library can live in a process: the one that `auto` would take.
    let used = probes
        .iter()
        .filter(|(_, probe)| probe.is_ok())
        .find_map(|(path, _)| OrtLibrary::load(path).ok());

    let mut output = Output::stdout();
    if args.json {
        let libraries: Vec<_> = probes
            .iter()
            .map(|(path, probe)| match probe {
                Ok(version) => json!({ "path": path, "version": version, "usable": true }),
                Err(error) => {
                    json!({ "path": path, "usable": false, "reason": error.to_string() })
                }
            })
            .collect();
        let providers = used
            .as_ref()
            .map(|library| library.providers().iter().map(|p| p.name()).collect::<Vec<_>>());
        let auto = if used.is_some() { "ort" } else { "rten" };
        output.json(&json!({
            "auto": auto,
            "rten": { "version": RTEN_VERSION, "providers": ["cpu"] },
            "ort": {
                "libraries": libraries,
                "used": used.as_ref().map(OrtLibrary::path),
                "providers": providers.unwrap_or_default(),
            },
        }))?;
        return Ok(Outcome::Done);
    }
    output.line(format_args!("rten {RTEN_VERSION}  built in; cpu; runs ONNX in float32"))?;
    for (path, probe) in &probes {
        match (probe, &used) {
            (Ok(version), Some(library)) if library.path() == path.as_path() => {
                let providers: Vec<_> = library.providers().iter().map(|p| p.name()).collect();
                output.line(format_args!(
                    "ONNX Runtime {version}  {}; {}",
                    path.display(),
                    providers.join(", ")
                ))?;
            }
            (Ok(version), _) => output.line(format_args!(
                "ONNX Runtime {version}  {}; usable by --ort-dylib",
                path.display()
            ))?,
            (Err(error), _) => output.line(format_args!("not usable: {error}"))?,
        }
    }
    if probes.is_empty() {
        output.line(
            "ONNX Runtime: no library found (2 to 3 times faster; `pip install onnxruntime`, \
             or name one by --ort-dylib or ORT_DYLIB_PATH)",
        )?;
    }
    let auto = if used.is_some() { "ONNX Runtime" } else { "rten" };
    output.line(format_args!("--engine auto uses {auto}"))?;
    Ok(Outcome::Done)
}
