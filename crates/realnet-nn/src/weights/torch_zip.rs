//! PyTorch archives: a zip with one pickle and one entry per storage.

use std::collections::HashMap;
use std::io::{Cursor, Read};

use zip::ZipArchive;

use super::pickle::Pickle;
use super::state::{self, Source, StorageRef};
use super::storage::Budget;
use super::{Checkpoint, WeightsError};

/// Largest pickle read, in bytes; that of YOLOv5x has 0.3 MB.
const MAX_PICKLE: u64 = 64 << 20;
/// Most entries an archive may have.
const MAX_ENTRIES: usize = 200_000;

struct Archive<'a> {
    zip: ZipArchive<Cursor<&'a [u8]>>,
    /// Folder inside the archive that all entries share, with its slash.
    prefix: String,
    big_endian: bool,
    budget: Budget,
    /// The storage read last: tensors in a row often share one.
    last: HashMap<String, Vec<u8>>,
}

/// Reads a checkpoint from the bytes of an archive.
pub(super) fn read(bytes: &[u8]) -> Result<Checkpoint, WeightsError> {
    let archive_error = |reason: String| WeightsError::Archive { reason };
    let zip = ZipArchive::new(Cursor::new(bytes)).map_err(|e| archive_error(e.to_string()))?;
    if zip.len() > MAX_ENTRIES {
        return Err(archive_error(format!(
            "{} entries; at most {MAX_ENTRIES} are read",
            zip.len()
        )));
    }
    let names: Vec<String> =
        zip.file_names().filter_map(Result::ok).map(|name| name.into_owned()).collect();
    let pickle = names
        .iter()
        .filter(|n| *n == "data.pkl" || n.ends_with("/data.pkl"))
        .min_by_key(|n| n.len())
        .ok_or_else(|| {
            let what = if names.iter().any(|n| n.ends_with("constants.pkl")) {
                " (a TorchScript archive without data.pkl)"
            } else {
                ""
            };
            archive_error(format!("no data.pkl among its {} entries{what}", names.len()))
        })?
        .clone();
    let prefix = pickle.trim_end_matches("data.pkl").to_owned();
    let mut archive = Archive {
        zip,
        prefix,
        big_endian: false,
        budget: Budget::new(bytes.len()),
        last: HashMap::new(),
    };
    let byteorder = format!("{}byteorder", archive.prefix);
    if names.contains(&byteorder) {
        archive.big_endian = archive.entry(&byteorder, 64)? == b"big";
    }
    let bytes = archive.entry(&pickle, MAX_PICKLE)?;
    let pickle = Pickle::parse(&bytes)
        .map_err(|source| WeightsError::Pickle { part: "data.pkl of the archive", source })?;
    drop(bytes);
    state::checkpoint(&pickle, &mut archive)
}

impl Archive<'_> {
    /// The decompressed bytes of an entry of at most `limit` bytes.
    fn entry(&mut self, name: &str, limit: u64) -> Result<Vec<u8>, WeightsError> {
        let error = |reason: String| WeightsError::Archive { reason: format!("{name}: {reason}") };
        let file = self.zip.by_name(name).map_err(|e| error(e.to_string()))?;
        let size = file.size();
        if size > limit {
            return Err(error(format!("{size} bytes; at most {limit} are expected")));
        }
        // Paid for before a byte is unpacked. `take` holds the entry to its word.
        self.budget.bytes(size, name)?;
        let mut bytes = Vec::new();
        file.take(size + 1).read_to_end(&mut bytes).map_err(|e| error(e.to_string()))?;
        if bytes.len() as u64 != size {
            return Err(error(format!("{} bytes; {size} were announced", bytes.len())));
        }
        Ok(bytes)
    }
}

impl Source for Archive<'_> {
    fn budget(&mut self) -> &mut Budget {
        &mut self.budget
    }

    fn with_storage<T>(
        &mut self,
        storage: &StorageRef,
        read: impl FnOnce(&[u8], bool) -> Result<T, WeightsError>,
    ) -> Result<T, WeightsError> {
        if !self.last.contains_key(&storage.key) {
            let announced = storage.bytes().unwrap_or(u64::MAX);
            let name = format!("{}data/{}", self.prefix, storage.key);
            let bytes = self.entry(&name, announced)?;
            self.last.clear();
            self.last.insert(storage.key.clone(), bytes);
        }
        let bytes = self.last.get(&storage.key).map_or(&[][..], Vec::as_slice);
        read(bytes, self.big_endian)
    }
}
