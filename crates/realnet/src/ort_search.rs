//! Where an ONNX Runtime library may be on this machine.

use std::{
    cmp::Reverse,
    env,
    ffi::OsStr,
    path::{Path, PathBuf},
};

/// ONNX Runtime libraries on this machine, in the order in which they are tried:
///
/// 1. the file that `ORT_DYLIB_PATH` names,
/// 2. beside this program,
/// 3. the wheel `onnxruntime` (or `onnxruntime-gpu`, `-openvino`) in the Python
///    installations on `PATH`, in the active Conda environment, in the user's
///    packages and in the system's,
/// 4. the directories of `LD_LIBRARY_PATH` and of the system.
///
/// Of several versions in one directory the newest comes first. The files are
/// only listed, not opened.
#[must_use]
pub fn find_ort_libraries() -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = Vec::new();
    let named = env::var_os("ORT_DYLIB_PATH").filter(|path| !path.is_empty());
    let candidates = named
        .map(PathBuf::from)
        .into_iter()
        .chain(directories().into_iter().flat_map(|directory| libraries_in(&directory)));
    for path in candidates {
        // Links to one file count once.
        let real = path.canonicalize().unwrap_or_else(|_| path.clone());
        if !found.iter().any(|known| known.canonicalize().is_ok_and(|known| known == real)) {
            found.push(path);
        }
    }
    found
}

fn directories() -> Vec<PathBuf> {
    let mut directories = Vec::new();
    if let Some(directory) = env::current_exe().ok().as_deref().and_then(Path::parent) {
        directories.push(directory.to_owned());
    }
    let split = |name: &str| -> Vec<PathBuf> {
        env::var_os(name).map(|value| env::split_paths(&value).collect()).unwrap_or_default()
    };
    let mut prefixes: Vec<PathBuf> = Vec::new();
    for bin in split("PATH") {
        if ["python3", "python"].iter().any(|python| bin.join(python).exists()) {
            prefixes.extend(bin.parent().map(Path::to_owned));
        }
    }
    prefixes.extend(env::var_os("CONDA_PREFIX").map(PathBuf::from));
    if let Some(home) = env::var_os("HOME").map(PathBuf::from) {
        prefixes.push(home.join(".local"));
        prefixes.extend(matches(&home.join(".pyenv/versions"), "*"));
    }
    for prefix in ["/usr/local", "/usr"] {
        prefixes.push(PathBuf::from(prefix));
    }
    for prefix in prefixes {
        for packages in ["lib/python3*/site-packages", "lib/python3*/dist-packages"] {
            directories.extend(matches(&prefix, &format!("{packages}/onnxruntime/capi")));
        }
    }
    directories.extend(split("LD_LIBRARY_PATH"));
    for system in ["/usr/local/lib", "/usr/lib", "/opt/onnxruntime/lib", "/opt/homebrew/lib"] {
        directories.push(PathBuf::from(system));
    }
    directories.extend(matches(Path::new("/usr/lib"), "*-linux-gnu*"));
    directories
}

/// Paths below `base` that match `pattern`, the last in the alphabet first, so
/// that newer Python versions come before older ones.
fn matches(base: &Path, pattern: &str) -> Vec<PathBuf> {
    let Some(base) = base.to_str() else { return Vec::new() };
    let pattern = format!("{}/{pattern}", glob::Pattern::escape(base));
    let mut paths: Vec<PathBuf> =
        glob::glob(&pattern).map(|paths| paths.flatten().collect()).unwrap_or_default();
    paths.reverse();
    paths
}

/// The ONNX Runtime libraries in one directory, newest version first.
fn libraries_in(directory: &Path) -> Vec<PathBuf> {
    let Ok(entries) = directory.read_dir() else { return Vec::new() };
    let mut paths: Vec<PathBuf> = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.file_name().and_then(OsStr::to_str).is_some_and(is_library))
        .collect();
    paths.sort_by_key(|path| Reverse(version_of(path)));
    paths
}

/// `libonnxruntime.so`, `libonnxruntime.so.1.20.0`, `libonnxruntime.1.20.0.dylib`
/// or `onnxruntime.dll`; not the provider libraries beside them.
fn is_library(name: &str) -> bool {
    let digits = |text: &str| text.chars().all(|c| c.is_ascii_digit() || c == '.');
    if let Some(rest) = name.strip_prefix("libonnxruntime.so") {
        return digits(rest);
    }
    if let Some(rest) = name.strip_prefix("libonnxruntime").and_then(|r| r.strip_suffix(".dylib")) {
        return digits(rest);
    }
    name == "onnxruntime.dll"
}

fn version_of(path: &Path) -> Vec<u32> {
    let name = path.file_name().and_then(OsStr::to_str).unwrap_or_default();
    name.split('.').filter_map(|part| part.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn provider_libraries_are_not_the_library() {
        assert!(is_library("libonnxruntime.so"));
        assert!(is_library("libonnxruntime.so.1.31.1"));
        assert!(is_library("libonnxruntime.1.20.0.dylib"));
        assert!(is_library("onnxruntime.dll"));
        assert!(!is_library("libonnxruntime_providers_shared.so"));
        assert!(!is_library("libonnxruntime.so.debug"));
        assert!(!is_library("onnxruntime_pybind11_state.so"));
    }

    #[test]
    fn newest_first() {
        let directory = tempfile::tempdir().unwrap();
        for name in ["libonnxruntime.so.1.9.0", "libonnxruntime.so.1.20.1", "other.so"] {
            std::fs::write(directory.path().join(name), b"x").unwrap();
        }
        let names: Vec<String> = libraries_in(directory.path())
            .iter()
            .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
            .collect();
        assert_eq!(names, ["libonnxruntime.so.1.20.1", "libonnxruntime.so.1.9.0"]);
    }
}
