//! Reading a recording.

use super::records::{ReadError, Record, Records};
use super::topics::Topic;
use super::writer::{PARAMETERS, VERSIONS};
use super::{Recorded, RunInfo, Times, messages};
use foxglove::bytes::Bytes;
use realnet_core::Stamp;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// A channel of the file.
pub(super) struct Channel {
    pub(super) topic: String,
    /// Name of the schema; empty without one.
    pub(super) schema: String,
    pub(super) encoding: String,
    /// What it is about, if it is one of [`Topic`].
    known: Option<Topic>,
}

/// A message as it stands in the file.
pub(super) struct RawMessage {
    at: u64,
    pub(super) channel_id: u16,
    pub(super) times: Times,
    pub(super) data: Bytes,
}

/// The messages of a file with what stands around them.
pub(super) struct Messages<R> {
    records: Records<R>,
    schemas: BTreeMap<u16, String>,
    pub(super) channels: BTreeMap<u16, Channel>,
    pub(super) info: RunInfo,
}

impl Messages<BufReader<File>> {
    pub(super) fn open(path: &Path) -> Result<Self, ReadError> {
        let name = path.display().to_string();
        match File::open(path) {
            Ok(file) => Self::new(BufReader::new(file), name),
            Err(reason) => Err(ReadError::Open { name, reason }),
        }
    }
}

impl<R: Read> Messages<R> {
    pub(super) fn new(source: R, name: String) -> Result<Self, ReadError> {
        let records = Records::new(source, name)?;
        let (schemas, channels) = (BTreeMap::new(), BTreeMap::new());
        Ok(Self { records, schemas, channels, info: RunInfo::default() })
    }

    /// The next message; `None` after the last.
    pub(super) fn next(&mut self) -> Result<Option<RawMessage>, ReadError> {
        while let Some((at, record)) = self.records.next()? {
            match record {
                Record::Message { channel_id, log_time, publish_time, data } => {
                    let times = Times { arrival: stamp(log_time), stamp: stamp(publish_time) };
                    return Ok(Some(RawMessage { at, channel_id, times, data }));
                }
                Record::Schema { id, name } => {
                    self.schemas.insert(id, name);
                }
                Record::Channel { id, schema_id, topic, encoding } => {
                    let schema = self.schemas.get(&schema_id).cloned().unwrap_or_default();
                    let known = Topic::of(&topic, &schema, &encoding);
                    self.channels.insert(id, Channel { topic, schema, encoding, known });
                }
                Record::Attachment { name, data } if name == PARAMETERS => {
                    self.info.parameters = String::from_utf8_lossy(&data).into_owned();
                }
                Record::Metadata { name, entries } if name == VERSIONS => {
                    self.info.versions = entries;
                }
                Record::Attachment { .. } | Record::Metadata { .. } => {}
            }
        }
        Ok(None)
    }

    /// What a message says; `None` for one of another program, or one that only
    /// repeats.
    fn decode(&self, message: RawMessage) -> Result<Option<Recorded>, ReadError> {
        let RawMessage { at, channel_id, times, data } = message;
        let channel = self.channels.get(&channel_id);
        let Some(topic) = channel.and_then(|channel| channel.known) else { return Ok(None) };
        match messages::decode(topic, times, data) {
            Ok(content) => Ok(content.map(|content| Recorded { times, content })),
            Err(reason) => {
                let name = self.records.name().to_owned();
                Err(ReadError::Message { name, at, topic: topic.name(), reason })
            }
        }
    }
}

/// Saturates at 292 years, where a [`Stamp`] ends.
fn stamp(nanos: u64) -> Stamp {
    Stamp::from_nanos(i64::try_from(nanos).unwrap_or(i64::MAX))
}

/// Reads a recording: an iterator over its messages in the order in which they
/// were written. Topics that [`RunWriter`](super::RunWriter) does not write are
/// passed over. Memory holds one message; no index is needed.
///
/// After [`ReadError::Message`] the next message follows; after another error
/// nothing does.
///
/// ```no_run
/// use realnet_io::recording::{Content, RunReader};
/// use std::path::Path;
///
/// let run = RunReader::open(Path::new("run.mcap"))?;
/// let gap = run.info().parameters.lines().find(|line| line.starts_with("gap"));
/// for recorded in run {
///     if let Content::Depth(map) = recorded?.content {
///         assert!(map.width() > 0);
///     }
/// }
/// # Ok::<(), realnet_io::recording::ReadError>(())
/// ```
pub struct RunReader<R> {
    messages: Messages<R>,
    /// Read already, to get to know what stands before it.
    first: Option<Result<Option<RawMessage>, ReadError>>,
}

impl RunReader<BufReader<File>> {
    /// Opens a file.
    ///
    /// # Errors
    /// [`ReadError::Open`], [`ReadError::NotMcap`], [`ReadError::Read`].
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        Messages::open(path).map(Self::before_first)
    }
}

impl<R: Read> RunReader<R> {
    /// Reads `source`, called `name` in errors.
    ///
    /// # Errors
    /// [`ReadError::NotMcap`], [`ReadError::Read`].
    pub fn new(source: R, name: impl Into<String>) -> Result<Self, ReadError> {
        Messages::new(source, name.into()).map(Self::before_first)
    }

    fn before_first(mut messages: Messages<R>) -> Self {
        let first = Some(messages.next());
        Self { messages, first }
    }

    /// What the run was made with; empty in files of other programs.
    pub fn info(&self) -> &RunInfo {
        &self.messages.info
    }
}

impl<R: Read> Iterator for RunReader<R> {
    type Item = Result<Recorded, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let message = match self.first.take().unwrap_or_else(|| self.messages.next()) {
                Ok(message) => message?,
                Err(error) => return Some(Err(error)),
            };
            if let Some(recorded) = self.messages.decode(message).transpose() {
                return Some(recorded);
            }
        }
    }
}
