//! The PyTorch stream of before 1.6: five pickles in a row (magic number,
//! protocol, system, object, storage keys), then every storage as its number
//! of elements and its raw bytes.

use std::collections::HashMap;
use std::ops::Range;

use super::pickle::{Pickle, Value};
use super::state::{self, Source, StorageRef};
use super::storage::Budget;
use super::{Checkpoint, WeightsError};

/// How a stream starts: protocol 2, LONG1 of ten bytes, and the magic number
/// 0x1950a86a20f9469cfc6c in little-endian order.
pub(super) const MAGIC_START: &[u8] =
    &[0x80, 2, 0x8a, 10, 0x6c, 0xfc, 0x9c, 0x46, 0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19];

struct Stream<'a> {
    bytes: &'a [u8],
    storages: HashMap<String, Range<usize>>,
    big_endian: bool,
    budget: Budget,
}

/// Reads a checkpoint from the bytes of a stream.
pub(super) fn read(bytes: &[u8]) -> Result<Checkpoint, WeightsError> {
    let mut at = 0;
    let mut next = |part: &'static str| {
        let pickle = Pickle::parse(bytes.get(at..).unwrap_or_default())
            .map_err(|source| WeightsError::Pickle { part, source })?;
        at += pickle.consumed();
        Ok::<_, WeightsError>(pickle)
    };
    next("magic number of the stream")?;
    let protocol = next("protocol of the stream")?;
    if protocol.int(protocol.root()) != Some(1001) {
        let found = match protocol.get(protocol.root()) {
            Value::Int(n) => n.to_string(),
            _ => protocol.describe(protocol.root()),
        };
        return Err(WeightsError::Stream { reason: format!("protocol {found}, not 1001") });
    }
    let system = next("system of the stream")?;
    let little = system.lookup(system.root(), "little_endian");
    let big_endian = little.is_some_and(|id| system.get(id) == &Value::Bool(false));
    let object = next("object of the stream")?;
    let keys = next("storage keys of the stream")?;
    let sizes = state::storage_sizes(&object);
    let storages = locate(bytes, at, &keys, &sizes, big_endian)?;
    let mut stream = Stream { bytes, storages, big_endian, budget: Budget::new(bytes.len()) };
    state::checkpoint(&object, &mut stream)
}

/// Finds each storage: the keys are in the order of the data.
fn locate(
    bytes: &[u8],
    start: usize,
    keys: &Pickle,
    sizes: &HashMap<String, usize>,
    big_endian: bool,
) -> Result<HashMap<String, Range<usize>>, WeightsError> {
    let error = |reason: String| WeightsError::Stream { reason };
    let list = keys.sequence(keys.root()).ok_or_else(|| {
        error(format!("the storage keys are {}, not a list", keys.describe(keys.root())))
    })?;
    let mut storages = HashMap::new();
    let mut at = start;
    for &id in list {
        let key = keys.str(id).ok_or_else(|| error("a storage key is not text".to_owned()))?;
        let element = *sizes
            .get(key)
            .ok_or_else(|| error(format!("storage '{key}' is not used by any tensor")))?;
        let header = bytes.get(at..at + 8).and_then(|b| <[u8; 8]>::try_from(b).ok());
        let header =
            header.ok_or_else(|| error(format!("the data of storage '{key}' is missing")))?;
        let count =
            if big_endian { u64::from_be_bytes(header) } else { u64::from_le_bytes(header) };
        at += 8;
        let end = usize::try_from(count)
            .ok()
            .and_then(|n| n.checked_mul(element))
            .and_then(|n| n.checked_add(at))
            .filter(|&end| end <= bytes.len())
            .ok_or_else(|| {
                error(format!(
                    "storage '{key}' announces {count} elements of {element} bytes, \
                     but {} bytes are left",
                    bytes.len().saturating_sub(at)
                ))
            })?;
        storages.insert(key.to_owned(), at..end);
        at = end;
    }
    Ok(storages)
}

impl Source for Stream<'_> {
    fn budget(&mut self) -> &mut Budget {
        &mut self.budget
    }

    fn with_storage<T>(
        &mut self,
        storage: &StorageRef,
        read: impl FnOnce(&[u8], bool) -> Result<T, WeightsError>,
    ) -> Result<T, WeightsError> {
        let range = self.storages.get(&storage.key).cloned();
        let bytes = range.and_then(|r| self.bytes.get(r)).ok_or_else(|| WeightsError::Stream {
            reason: format!("storage '{}' is not in the file", storage.key),
        })?;
        read(bytes, self.big_endian)
    }
}
