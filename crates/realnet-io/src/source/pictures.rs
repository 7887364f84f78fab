//! Pictures, folders of pictures and globs.

use super::{Produce, SourceError, SourceFrame, SourceOptions};
use crate::picture;
use realnet_core::Stamp;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The pictures of a folder in natural order (`2.jpg` before `10.jpg`); not of
/// its subfolders, and no hidden files.
pub(super) fn in_folder(folder: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let failed = |reason| SourceError::Folder { path: folder.to_path_buf(), reason };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let path = entry.path();
        let hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
        if !hidden && picture::has_picture_extension(&path) && !path.is_dir() {
            found.push(path);
        }
    }
    if found.is_empty() {
        return Err(SourceError::NoPictures { spec: folder.display().to_string() });
    }
    sort(&mut found);
    Ok(found)
}

/// The pictures that a glob names, in natural order.
pub(super) fn of_glob(pattern: &str) -> Result<Vec<PathBuf>, SourceError> {
    let bad = |reason: String| SourceError::Glob { pattern: pattern.to_string(), reason };
    let mut found = Vec::new();
    for path in glob::glob(pattern).map_err(|e| bad(e.to_string()))? {
        let path = path.map_err(|e| bad(e.to_string()))?;
        if picture::has_picture_extension(&path) && !path.is_dir() {
            found.push(path);
        }
    }
    if found.is_empty() {
        return Err(SourceError::NoPictures { spec: pattern.to_string() });
    }
    sort(&mut found);
    Ok(found)
}

/// Natural order; equal keys (`1.jpg`, `01.jpg`) by bytes, so that the order
/// never depends on the file system.
fn sort(paths: &mut [PathBuf]) {
    paths.sort_by(|a, b| {
        natord::compare(&a.to_string_lossy(), &b.to_string_lossy()).then_with(|| a.cmp(b))
    });
}

/// Decodes pictures one after the other. One that cannot be read is an error of
/// its own; the next ones still come.
pub(super) struct Pictures {
    paths: Arc<[PathBuf]>,
    /// The next one's place among them.
    next: usize,
    fps: f64,
    limits: picture::Limits,
}

impl Pictures {
    pub(super) fn new(paths: Arc<[PathBuf]>, options: &SourceOptions, fps: f64) -> Self {
        Self { paths, next: 0, fps, limits: options.limits }
    }
}

impl Produce for Pictures {
    fn next(&mut self, spare: Vec<u8>) -> Option<Result<SourceFrame, SourceError>> {
        let path = self.paths.get(self.next)?;
        let index = self.next as u64;
        self.next += 1;
        Some(match picture::read_with(path, &self.limits, spare) {
            Ok(frame) => Ok(SourceFrame {
                frame: frame.with_stamp(Stamp::of_frame(index, self.fps)),
                index,
                name: path.display().to_string(),
            }),
            Err(error) => Err(error.into()),
        })
    }
}
