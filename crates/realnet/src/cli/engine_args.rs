//! Flags that choose the inference engine.

use super::failure::say;
use clap::{Args, ValueEnum};
use realnet::{EngineChoice, Provider, Runtime, RuntimeOptions, find_ort_libraries};
use std::path::{Path, PathBuf};

#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Engine")]
pub(crate) struct EngineArgs {
    /// Inference engine; auto takes ONNX Runtime where it is found.
    #[arg(long, value_enum, default_value_t = EngineFlag::Auto)]
    engine: EngineFlag,
    /// The ONNX Runtime library to use, instead of looking for one.
    #[arg(long, value_name = "FILE")]
    ort_dylib: Option<PathBuf>,
    /// Threads of one inference [default: one a core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// What ONNX Runtime computes on.
    #[arg(long, value_enum, default_value_t = ProviderFlag::Cpu)]
    provider: ProviderFlag,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum EngineFlag {
    Auto,
    Rten,
    Ort,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ProviderFlag {
    Cpu,
    Cuda,
    Tensorrt,
    Openvino,
}

/// The library that `--ort-dylib` names. The system's loader looks for a bare name
/// in its own folders only: a file here gets its full path.
pub(crate) fn library_file(path: &Path) -> PathBuf {
    let full = if path.is_file() { std::path::absolute(path).ok() } else { None };
    full.unwrap_or_else(|| path.to_owned())
}

impl EngineArgs {
    /// Starts the engine, and says so in one line when it is not the one asked for.
    pub(crate) fn start(&self) -> Runtime {
        self.start_with(self.threads.map_or(0, usize::from))
    }

    /// As [`EngineArgs::start`] for so many networks at a time, which share the cores unless
    /// the threads of each are given.
    pub(crate) fn start_sharing(&self, networks: usize) -> Runtime {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let share = (cores / networks.max(1)).max(1);
        self.start_with(self.threads.map_or(share, usize::from))
    }

    fn start_with(&self, threads: usize) -> Runtime {
        let choice = match (self.engine, &self.ort_dylib) {
            // Whoever names a library wants it.
            (EngineFlag::Auto, Some(_)) | (EngineFlag::Ort, _) => EngineChoice::Ort,
            (EngineFlag::Auto, None) => EngineChoice::Auto,
            (EngineFlag::Rten, _) => EngineChoice::Rten,
        };
        let ort_libraries = match (&self.ort_dylib, choice) {
            (Some(path), _) => vec![library_file(path)],
            (None, EngineChoice::Rten) => Vec::new(),
            (None, _) => find_ort_libraries(),
        };
        let provider = match self.provider {
            ProviderFlag::Cpu => Provider::Cpu,
            ProviderFlag::Cuda => Provider::Cuda,
            ProviderFlag::Tensorrt => Provider::TensorRt,
            ProviderFlag::Openvino => Provider::OpenVino,
        };
        let runtime = Runtime::start(&RuntimeOptions { choice, threads, provider, ort_libraries });
        if let Some(note) = runtime.note() {
            say(note);
        }
        runtime
    }
}
