//! ONNX Runtime, loaded at run time.

use super::{Engine, EngineError, Provider, TensorView};
use ort::{
    environment::Environment,
    ep::{self, ExecutionProvider, ExecutionProviderDispatch},
    session::{Session, builder::GraphOptimizationLevel},
    value::TensorRef,
};
use std::{
    ffi::{CStr, c_char},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};
use thiserror::Error;

const NAME: &str = "ONNX Runtime";

/// Why a file cannot serve as ONNX Runtime.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OrtLibraryError {
    /// The file is not there, or not a shared library for this machine.
    #[error("ONNX Runtime cannot be loaded from {}: {reason}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The loader's own words.
        reason: String,
    },
    /// A shared library of something else.
    #[error("{} is not ONNX Runtime: it has no OrtGetApiBase", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// A release before the oldest one that is understood.
    #[error("ONNX Runtime {version} at {} is too old: 1.{minimum} or newer is needed", path.display())]
    TooOld {
        /// The file.
        path: PathBuf,
        /// Its version.
        version: String,
        /// Oldest minor version of release 1.
        minimum: u32,
    },
    /// The library was loaded but would not start.
    #[error("ONNX Runtime {version} at {} does not start: {reason}", path.display())]
    Start {
        /// The file.
        path: PathBuf,
        /// Its version.
        version: String,
        /// The library's own words.
        reason: String,
    },
}

/// A loaded ONNX Runtime. A process can use only one: the first that loads stays.
#[derive(Clone)]
pub struct OrtLibrary {
    path: PathBuf,
    version: String,
    environment: Environment,
}

impl std::fmt::Debug for OrtLibrary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OrtLibrary")
            .field("path", &self.path)
            .field("version", &self.version)
            .finish_non_exhaustive()
    }
}

/// The head of ONNX Runtime's `OrtApiBase`, unchanged since its first release.
#[repr(C)]
struct ApiBase {
    get_api: unsafe extern "C" fn(u32) -> *const std::ffi::c_void,
    get_version_string: unsafe extern "C" fn() -> *const c_char,
}

/// What the system's loader said; `libloading` itself only says `dlopen failed`.
fn loader_words(path: &Path, error: &libloading::Error) -> String {
    let cause = std::error::Error::source(error);
    let words = cause.map_or_else(|| error.to_string(), ToString::to_string);
    // The path stands in the message already.
    let prefix = format!("{}: ", path.display());
    words.strip_prefix(&prefix).map(str::to_owned).unwrap_or(words)
}

/// The one library of this process, by its real path; without an [`OrtLibrary`]
/// when it was loaded but did not start.
static CLAIM: Mutex<Option<(PathBuf, Option<OrtLibrary>)>> = Mutex::new(None);

impl OrtLibrary {
    /// Loads the library at `path`.
    ///
    /// # Errors
    /// [`OrtLibraryError`] with the path when it cannot be used.
    pub fn load(path: &Path) -> Result<Self, OrtLibraryError> {
        let version = Self::probe(path)?;
        let start = |reason: String| OrtLibraryError::Start {
            path: path.to_owned(),
            version: version.clone(),
            reason,
        };
        let real = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        // A panic while the lock is held leaves nothing half done.
        let mut claim = CLAIM.lock().unwrap_or_else(PoisonError::into_inner);
        match &*claim {
            Some((claimed, Some(library))) if *claimed == real => return Ok(library.clone()),
            Some((claimed, _)) => {
                let taken = claimed.display();
                return Err(start(format!("this process has already taken {taken}")));
            }
            None => {}
        }
        let builder = ort::init_from(path).map_err(|error| start(error.to_string()))?;
        *claim = Some((real.clone(), None));
        let environment = builder
            .with_name("realnet")
            .with_telemetry(false)
            .build()
            .map_err(|error| start(error.to_string()))?;
        environment.set_log_level(ort::logging::LogLevel::Error);
        let library = Self { path: path.to_owned(), version: version.clone(), environment };
        *claim = Some((real, Some(library.clone())));
        Ok(library)
    }

    /// The version of the library at `path`, without starting it.
    ///
    /// # Errors
    /// [`OrtLibraryError`] when there is none, or one that is too old.
    pub fn probe(path: &Path) -> Result<String, OrtLibraryError> {
        let open = |reason: String| OrtLibraryError::Open { path: path.to_owned(), reason };
        // dlopen itself runs no code of an ELF file that is not a library, but a
        // library's initialisers run: the path is the user's own choice.
        // SAFETY: as with every plug-in, the file is trusted to be what it says.
        let library = unsafe { libloading::Library::new(path) }
            .map_err(|error| open(loader_words(path, &error)))?;
        // SAFETY: the symbol has this signature in every release of ONNX Runtime.
        let get_base: libloading::Symbol<'_, unsafe extern "C" fn() -> *const ApiBase> =
            unsafe { library.get(b"OrtGetApiBase") }
                .map_err(|_| OrtLibraryError::Foreign { path: path.to_owned() })?;
        // SAFETY: the table and its strings live as long as the library does.
        let version = unsafe {
            let base = get_base();
            if base.is_null() {
                return Err(OrtLibraryError::Foreign { path: path.to_owned() });
            }
            let text = ((*base).get_version_string)();
            if text.is_null() {
                return Err(OrtLibraryError::Foreign { path: path.to_owned() });
            }
            CStr::from_ptr(text).to_string_lossy().into_owned()
        };
        let number = |index| version.split('.').nth(index).and_then(|part| part.parse().ok());
        let (major, minor): (u32, u32) = (number(0).unwrap_or(0), number(1).unwrap_or(0));
        let minimum = ort::MINOR_VERSION;
        if major < 1 || (major == 1 && minor < minimum) {
            return Err(OrtLibraryError::TooOld { path: path.to_owned(), version, minimum });
        }
        Ok(version)
    }

    /// Where the library is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The library's version.
    #[must_use]
    pub fn version(&self) -> &str {
        &self.version
    }

    /// The providers this build of the library has. One that is listed can still
    /// fail for want of a device or driver.
    #[must_use]
    pub fn providers(&self) -> Vec<Provider> {
        Provider::ALL.into_iter().filter(|p| self.missing_provider(*p).is_none()).collect()
    }

    pub(super) fn describe(&self, provider: Provider) -> String {
        format!("{NAME} {} on {provider} ({})", self.version, self.path.display())
    }

    /// Why `provider` cannot be used, if so.
    pub(super) fn missing_provider(&self, provider: Provider) -> Option<String> {
        let available = match provider {
            Provider::Cpu => return None,
            Provider::Cuda => ep::CUDA::is_available(),
            Provider::TensorRt => ep::TensorRT::is_available(),
            Provider::OpenVino => ep::OpenVINO::is_available(),
        };
        match available {
            Ok(true) => None,
            Ok(false) => Some(format!(
                "ONNX Runtime {} at {} was built without provider {provider}",
                self.version,
                self.path.display()
            )),
            Err(error) => Some(format!("provider {provider} cannot be asked for: {error}")),
        }
    }

    pub(super) fn load_network(
        &self,
        bytes: &[u8],
        size: (u32, u32),
        threads: usize,
        provider: Provider,
    ) -> Result<OrtEngine, EngineError> {
        let session = self
            .session(bytes, threads, provider)
            .map_err(|error| EngineError::Load { engine: NAME, reason: error.to_string() })?;
        let input_name =
            session.inputs().first().map(|input| input.name().to_owned()).unwrap_or_default();
        let output_names = session.outputs().iter().map(|o| o.name().to_owned()).collect();
        let (width, height) = size;
        Ok(OrtEngine {
            session,
            input_name,
            output_names,
            input: vec![0.0; 3 * width as usize * height as usize],
            size,
            description: self.describe(provider),
        })
    }

    fn session(
        &self,
        bytes: &[u8],
        threads: usize,
        provider: Provider,
    ) -> Result<Session, ort::Error> {
        let mut builder = Session::builder(&self.environment)?
            .with_optimization_level(GraphOptimizationLevel::All)?
            .with_flush_to_zero()?;
        if threads > 0 {
            builder = builder.with_intra_threads(threads)?;
        }
        let providers = dispatch(provider);
        if !providers.is_empty() {
            builder = builder.with_execution_providers(providers)?;
        }
        builder.commit_from_memory(bytes)
    }
}

fn dispatch(provider: Provider) -> Vec<ExecutionProviderDispatch> {
    match provider {
        Provider::Cpu => Vec::new(),
        Provider::Cuda => vec![ep::CUDA::default().build().error_on_failure()],
        Provider::TensorRt => vec![
            ep::TensorRT::default().build().error_on_failure(),
            ep::CUDA::default().build().error_on_failure(),
        ],
        Provider::OpenVino => vec![ep::OpenVINO::default().build().error_on_failure()],
    }
}

/// A network in ONNX Runtime.
pub(super) struct OrtEngine {
    session: Session,
    input_name: String,
    output_names: Vec<String>,
    input: Vec<f32>,
    size: (u32, u32),
    description: String,
}

impl Engine for OrtEngine {
    fn describe(&self) -> String {
        self.description.clone()
    }

    fn input_size(&self) -> (u32, u32) {
        self.size
    }

    fn input(&mut self) -> &mut [f32] {
        &mut self.input
    }

    fn run(&mut self, read: &mut dyn FnMut(&[TensorView<'_>])) -> Result<(), EngineError> {
        let failed =
            |error: ort::Error| EngineError::Run { engine: NAME, reason: error.to_string() };
        let (width, height) = (self.size.0 as usize, self.size.1 as usize);
        let input =
            TensorRef::from_array_view(([1, 3, height, width], &self.input[..])).map_err(failed)?;
        let outputs =
            self.session.run(ort::inputs![self.input_name.as_str() => input]).map_err(failed)?;
        let mut tensors = Vec::with_capacity(self.output_names.len());
        for name in &self.output_names {
            let value = outputs.get(name).ok_or_else(|| EngineError::Run {
                engine: NAME,
                reason: format!("output '{name}' is missing"),
            })?;
            let (shape, data) = value.try_extract_tensor::<f32>().map_err(failed)?;
            let shape: Vec<usize> =
                shape.iter().map(|&side| usize::try_from(side).unwrap_or(0)).collect();
            tensors.push((name, shape, data));
        }
        let views: Vec<TensorView<'_>> =
            tensors.iter().map(|(name, shape, data)| TensorView { name, shape, data }).collect();
        read(&views);
        Ok(())
    }
}
