//! Engines: what runs an ONNX graph.
//!
//! There are two behind one trait. `rten` is compiled in: pure Rust, no set-up,
//! on every processor. ONNX Runtime is a shared library that is looked for when
//! the program starts: faster on a plain processor, and the way to CUDA,
//! TensorRT and OpenVINO. Both run the same bytes.
//!
//! This crate never looks around on the machine: the caller says where a library
//! may be ([`RuntimeOptions::ort_libraries`]).

mod ort_engine;
mod rten_engine;

pub use ort_engine::{OrtLibrary, OrtLibraryError};
pub use rten_engine::RTEN_VERSION;

use crate::onnx::{ElementType, OnnxModel};
use std::{fmt, path::PathBuf};
use thiserror::Error;

/// Largest width and height of an input, in pixels.
pub(crate) const MAX_SIDE: u32 = 16_384;

/// Which engine to use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EngineChoice {
    /// ONNX Runtime when a usable library is found, else rten.
    #[default]
    Auto,
    /// The embedded engine.
    Rten,
    /// ONNX Runtime; rten, with a note, when no usable library is found.
    Ort,
}

/// What ONNX Runtime computes on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Provider {
    /// The processor.
    #[default]
    Cpu,
    /// NVIDIA's CUDA.
    Cuda,
    /// NVIDIA's TensorRT, with CUDA for what it lacks.
    TensorRt,
    /// Intel's OpenVINO.
    OpenVino,
}

impl Provider {
    /// All of them, the processor first.
    pub const ALL: [Self; 4] = [Self::Cpu, Self::Cuda, Self::TensorRt, Self::OpenVino];

    /// The name on a command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Cuda => "cuda",
            Self::TensorRt => "tensorrt",
            Self::OpenVino => "openvino",
        }
    }
}

impl fmt::Display for Provider {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// How to start a [`Runtime`].
#[derive(Clone, Debug, Default)]
pub struct RuntimeOptions {
    /// Which engine.
    pub choice: EngineChoice,
    /// Threads of one inference; 0 leaves it to the engine (one a core).
    pub threads: usize,
    /// What ONNX Runtime computes on; anything but the processor asks for ONNX
    /// Runtime even when the choice is [`EngineChoice::Auto`].
    pub provider: Provider,
    /// Where an ONNX Runtime library may be, best first.
    pub ort_libraries: Vec<PathBuf>,
}

/// Why an engine could not load or run a network.
#[derive(Debug, Error)]
pub enum EngineError {
    /// The engine refused the graph.
    #[error("{engine} cannot load the network: {reason}")]
    Load {
        /// Name of the engine.
        engine: &'static str,
        /// The engine's own words.
        reason: String,
    },
    /// The network's input is not one picture.
    #[error(
        "the network's input must be float32 1x3xHxW with fixed H and W up to {MAX_SIDE}, found {found}"
    )]
    Input {
        /// Names and shapes found.
        found: String,
    },
    /// The engine failed while it ran.
    #[error("{engine} failed to run the network: {reason}")]
    Run {
        /// Name of the engine.
        engine: &'static str,
        /// The engine's own words.
        reason: String,
    },
}

/// One output of a network, valid during the call that hands it out.
#[derive(Clone, Copy, Debug)]
pub struct TensorView<'a> {
    /// Name in the graph.
    pub name: &'a str,
    /// Length of each axis, outermost first.
    pub shape: &'a [usize],
    /// The values, row-major.
    pub data: &'a [f32],
}

/// A loaded network with one picture as input.
pub trait Engine: Send {
    /// Name, version and device of what runs the network.
    fn describe(&self) -> String;

    /// The input's size, (width, height).
    fn input_size(&self) -> (u32, u32);

    /// The input to be filled: `[1, 3, height, width]`, row-major. It keeps its
    /// content between runs.
    fn input(&mut self) -> &mut [f32];

    /// Runs the network on [`Engine::input`] and hands its outputs, in the order
    /// of the graph, to `read`.
    ///
    /// # Errors
    /// [`EngineError::Run`] when the engine fails; `read` is not called then.
    fn run(&mut self, read: &mut dyn FnMut(&[TensorView<'_>])) -> Result<(), EngineError>;
}

/// The engine that was chosen, ready to load networks.
///
/// ```
/// use realnet_nn::engine::{EngineChoice, Runtime, RuntimeOptions};
///
/// let runtime = Runtime::start(&RuntimeOptions::default());
/// assert!(runtime.describe().starts_with("rten")); // no library was named
/// assert!(runtime.note().is_none());
/// ```
#[derive(Debug)]
pub struct Runtime {
    backend: Backend,
    threads: usize,
    note: Option<String>,
}

#[derive(Debug)]
enum Backend {
    Rten,
    Ort(OrtLibrary, Provider),
}

impl Runtime {
    /// Chooses an engine. Never fails: rten is always there, and
    /// [`Runtime::note`] says why it had to stand in.
    #[must_use]
    pub fn start(options: &RuntimeOptions) -> Self {
        let wants_ort = options.choice == EngineChoice::Ort || options.provider != Provider::Cpu;
        let with = |backend, note| Self { backend, threads: options.threads, note };
        if options.choice == EngineChoice::Rten {
            let note = (options.provider != Provider::Cpu).then(|| {
                format!("rten runs on the processor; provider {} is not used", options.provider)
            });
            return with(Backend::Rten, note);
        }
        let mut failure = None;
        for path in &options.ort_libraries {
            match OrtLibrary::load(path) {
                Ok(library) => {
                    let (provider, note) = match library.missing_provider(options.provider) {
                        None => (options.provider, None),
                        Some(reason) => (Provider::Cpu, Some(format!("{reason}; using cpu"))),
                    };
                    return with(Backend::Ort(library, provider), note);
                }
                Err(error) => failure = failure.or(Some(error)),
            }
        }
        let note = match failure {
            Some(error) => Some(format!("{error}; using rten")),
            None if wants_ort => Some(
                "no ONNX Runtime library was found (see `realnet engines`); using rten".to_owned(),
            ),
            None => None,
        };
        with(Backend::Rten, note)
    }

    /// Name, version and device of the engine.
    #[must_use]
    pub fn describe(&self) -> String {
        match &self.backend {
            Backend::Rten => rten_engine::description(),
            Backend::Ort(library, provider) => library.describe(*provider),
        }
    }

    /// One line for the user when the engine is not the one that was asked for.
    #[must_use]
    pub fn note(&self) -> Option<&str> {
        self.note.as_deref()
    }

    /// Loads a network whose single input is one picture.
    ///
    /// # Errors
    /// [`EngineError::Input`] when the input is not `[1, 3, H, W]`,
    /// [`EngineError::Load`] when the engine refuses the graph.
    pub fn load(&self, model: OnnxModel) -> Result<Box<dyn Engine>, EngineError> {
        let size = picture_input(&model)?;
        let bytes = model.to_bytes();
        // The engine makes copies of its own: ours are gone before it does.
        drop(model);
        Ok(match &self.backend {
            Backend::Rten => Box::new(rten_engine::RtenEngine::load(bytes, size, self.threads)?),
            Backend::Ort(library, provider) => {
                Box::new(library.load_network(&bytes, size, self.threads, *provider)?)
            }
        })
    }
}

/// (width, height) of a model's single picture input.
fn picture_input(model: &OnnxModel) -> Result<(u32, u32), EngineError> {
    let inputs = model.inputs();
    if let [input] = inputs.as_slice()
        && let Some([1, 3, height, width]) = input.fixed_dims().as_deref()
        && let (Ok(width), Ok(height)) = (u32::try_from(*width), u32::try_from(*height))
        && (1..=MAX_SIDE).contains(&width)
        && (1..=MAX_SIDE).contains(&height)
        && input.element == ElementType::Float32
    {
        return Ok((width, height));
    }
    let found = inputs.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    Err(EngineError::Input { found: if found.is_empty() { "none".to_owned() } else { found } })
}
