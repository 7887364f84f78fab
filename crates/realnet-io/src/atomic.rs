//! Files that are whole or not there.
//!
//! A file is written under a temporary name in the folder of its target and
//! renamed when it is complete, so that a reader, a full disk or a killed
//! process never meets half a file.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;
use thiserror::Error;

/// Why a file could not be written.
#[derive(Debug, Error)]
#[error("cannot write {}: {reason}", path.display())]
pub struct WriteError {
    /// The file that was to be written.
    pub path: PathBuf,
    /// What the operating system said.
    pub reason: io::Error,
}

impl WriteError {
    /// An error about `path`.
    pub fn new(path: impl Into<PathBuf>, reason: io::Error) -> Self {
        Self { path: path.into(), reason }
    }
}

/// Writes `path` through `fill`, whole or not at all.
///
/// An existing file is replaced, a symbolic link is followed, and what is no
/// regular file (`/dev/stdout`, a named pipe) is written to directly.
///
/// # Errors
/// [`WriteError`] with `path` and the reason; an existing file is then unchanged.
pub fn write_with(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), WriteError> {
    let named = |reason| WriteError::new(path, reason);
    if let Ok(meta) = std::fs::metadata(path)
        && !meta.is_file()
    {
        if meta.is_dir() {
            return Err(named(io::Error::from(io::ErrorKind::IsADirectory)));
        }
        let mut out = BufWriter::new(File::options().write(true).open(path).map_err(named)?);
        return fill(&mut out).and_then(|()| out.flush()).map_err(named);
    }
    let pending = Pending::new(path)?;
    let mut out = BufWriter::new(pending.file.as_file());
    fill(&mut out).and_then(|()| out.flush()).map_err(named)?;
    drop(out);
    pending.commit()
}

/// Writes `bytes` to `path`, see [`write_with`].
///
/// # Errors
/// As [`write_with`].
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
    write_with(path, |out| out.write_all(bytes))
}

/// A file that is being written under a temporary name beside its target.
/// Dropped without [`Pending::commit`] it disappears.
#[derive(Debug)]
pub struct Pending {
    file: NamedTempFile,
    target: PathBuf,
}

impl Pending {
    /// An empty temporary file beside `target`.
    ///
    /// # Errors
    /// [`WriteError`] when the folder is missing or not writable, or `target`
    /// is a folder.
    pub fn new(target: &Path) -> Result<Self, WriteError> {
        let named = |reason| WriteError::new(target, reason);
        if target.is_dir() {
            return Err(named(io::Error::from(io::ErrorKind::IsADirectory)));
        }
        // A link keeps pointing to where it points: its target is replaced.
        let real = std::fs::canonicalize(target).unwrap_or_else(|_| target.to_path_buf());
        let folder = match real.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        // Told here in the words of the system, which `tempfile` replaces.
        std::fs::metadata(folder).map_err(named)?;
        // A read-only file is not replaced just because its folder is writable.
        if std::fs::metadata(&real).is_ok_and(|m| m.permissions().readonly()) {
            return Err(named(io::Error::from(io::ErrorKind::PermissionDenied)));
        }
        let mut builder = tempfile::Builder::new();
        builder.prefix(".realnet-").suffix(".part");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // As `File::create`: the process's umask takes away from this.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        // The error of `tempfile` names its temporary file; the user knows the target.
        let file = builder.tempfile_in(folder).map_err(|e| named(anonymous(&e)))?;
        Ok(Self { file, target: real })
    }

    /// The temporary file's name.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// [`WriteError`] when the rename fails; the temporary file is removed.
    pub fn commit(self) -> Result<(), WriteError> {
        let target = self.target;
        match self.file.persist(&target) {
            Ok(_) => Ok(()),
            Err(e) => Err(WriteError::new(target, e.error)),
        }
    }
}

/// The same error without the temporary file's name in it.
fn anonymous(error: &io::Error) -> io::Error {
    match error.raw_os_error() {
        Some(code) => io::Error::from_raw_os_error(code),
        // `tempfile` wraps the system's error; its kind survives.
        None => io::Error::from(error.kind()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_rubbish() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.txt");
        write(&path, b"first").unwrap();
        let error = write_with(&path, |out| {
            out.write_all(b"sec")?;
            Err(io::Error::other("disk full"))
        })
        .unwrap_err();
        assert!(error.to_string().contains("a.txt: disk full"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_missing_folder_and_a_folder_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let missing = dir.path().join("no/such/a.txt");
        let error = write(&missing, b"x").unwrap_err().to_string();
        assert!(error.contains("no/such/a.txt") && !error.contains(".part"), "{error}");
        let error = write(dir.path(), b"x").unwrap_err().to_string();
        assert!(error.contains("directory"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_and_permissions_are_the_usual_ones() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let real = dir.path().join("real.txt");
        std::fs::write(&real, b"old").unwrap();
        let usual = std::fs::metadata(&real).unwrap().permissions().mode();
        let link = dir.path().join("link.txt");
        std::os::unix::fs::symlink(&real, &link).unwrap();
        write(&link, b"new").unwrap();
        assert_eq!(std::fs::read(&real).unwrap(), b"new");
        assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(std::fs::metadata(&real).unwrap().permissions().mode(), usual);
        write(Path::new("/dev/null"), b"gone").unwrap();
    }
}
