//! The records of an MCAP file one by one, those inside chunks too.
//!
//! The `mcap` crate, which writes the files, has readers as well. They do not
//! tell where a file is damaged, and (in version 0.26) a wrong length in a record
//! can make them panic or ask for gigabytes. A robot's recordings end with its
//! battery, so this reader trusts no byte. The format: <https://mcap.dev/spec>.

use super::fields::Fields;
use crc32fast::Hasher;
use foxglove::bytes::{Buf, Bytes};
use mcap::records::op;
use std::collections::BTreeMap;
use std::io::{self, Read};
use thiserror::Error;

/// Longest record that is read, bytes. A length beyond is a damaged one.
const MAX_RECORD: u64 = 256 << 20;
/// Bytes before the body of a record: its kind and its length.
const HEAD: u64 = 9;
/// Bytes of a chunk's fields before the name of its compression, and after.
const CHUNK_FIELDS: [u64; 2] = [32, 8];
/// Bytes of a message before its data.
const MESSAGE_FIELDS: usize = 22;

/// Why a recording cannot be read, or not further.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The file could not be opened.
    #[error("cannot open the recording {name}: {reason}")]
    Open {
        /// The file.
        name: String,
        /// What the operating system said.
        reason: io::Error,
    },
    /// The operating system failed to read on.
    #[error("cannot read the recording {name} at byte {at}: {reason}")]
    Read {
        /// The file.
        name: String,
        /// Bytes read before.
        at: u64,
        /// What the operating system said.
        reason: io::Error,
    },
    /// Another kind of file.
    #[error("{name} is no MCAP file")]
    NotMcap {
        /// The file.
        name: String,
    },
    /// The file breaks off: its writer was killed, or its disk full. All whole
    /// messages before have been given.
    #[error("the recording {name} breaks off at byte {at}")]
    BreaksOff {
        /// The file.
        name: String,
        /// Length of the file.
        at: u64,
    },
    /// Bytes that cannot be right. All messages before have been given; those of a
    /// chunk with a wrong checksum may be wrong themselves.
    #[error("the recording {name} is damaged at byte {at}: {what}")]
    Damaged {
        /// The file.
        name: String,
        /// Where the damaged record or chunk starts.
        at: u64,
        /// What is wrong.
        what: String,
    },
    /// A compressed chunk, which RealNet does not write.
    #[error(
        "the recording {name} is compressed ({compression} at byte {at}), which is not read here; \
         `mcap decompress` makes a copy that is"
    )]
    Compressed {
        /// The file.
        name: String,
        /// Where the chunk starts.
        at: u64,
        /// Name of the compression.
        compression: String,
    },
    /// A message that is not what its topic says. Reading goes on after it.
    #[error("the recording {name}, byte {at}: the message on {topic} is not readable: {reason}")]
    Message {
        /// The file.
        name: String,
        /// Where the message starts.
        at: u64,
        /// Its topic.
        topic: &'static str,
        /// What is wrong with it.
        reason: String,
    },
}

/// The records that a recording is made of.
pub(super) enum Record {
    Schema { id: u16, name: String },
    Channel { id: u16, schema_id: u16, topic: String, encoding: String },
    Message { channel_id: u16, log_time: u64, publish_time: u64, data: Bytes },
    Attachment { name: String, data: Vec<u8> },
    Metadata { name: String, entries: BTreeMap<String, String> },
}

impl Record {
    /// The record of this kind; `Ok(None)` for kinds that are not needed, `Err`
    /// for a body that is too short, has text that is none or a wrong checksum.
    fn parse(kind: u8, body: Vec<u8>) -> Result<Option<Self>, ()> {
        let mut fields = Fields(&body);
        let record = match kind {
            op::SCHEMA => fields.schema(),
            op::CHANNEL => fields.channel(),
            op::MESSAGE => match fields.message_head() {
                Some((channel_id, log_time, publish_time)) => {
                    let mut data = Bytes::from(body);
                    data.advance(MESSAGE_FIELDS);
                    Some(Self::Message { channel_id, log_time, publish_time, data })
                }
                None => None,
            },
            op::ATTACHMENT => fields.attachment(),
            op::METADATA => fields.metadata(),
            _ => return Ok(None),
        };
        record.map(Some).ok_or(())
    }
}

impl Fields<'_> {
    fn schema(&mut self) -> Option<Record> {
        Some(Record::Schema { id: self.u16()?, name: self.text()? })
    }

    fn channel(&mut self) -> Option<Record> {
        Some(Record::Channel {
            id: self.u16()?,
            schema_id: self.u16()?,
            topic: self.text()?,
            encoding: self.text()?,
        })
    }

    /// Channel, log time and publish time.
    fn message_head(&mut self) -> Option<(u16, u64, u64)> {
        let channel_id = self.u16()?;
        let _sequence = self.u32()?;
        Some((channel_id, self.u64()?, self.u64()?))
    }

    fn attachment(&mut self) -> Option<Record> {
        let body = self.0;
        let (_log_time, _create_time) = (self.u64()?, self.u64()?);
        let name = self.text()?;
        let _media_type = self.text()?;
        let data = self.long_counted()?.to_vec();
        let covered = body.get(..body.len() - self.0.len())?;
        let checksum = self.u32()?;
        (checksum == 0 || checksum == crc32fast::hash(covered))
            .then_some(Record::Attachment { name, data })
    }

    fn metadata(&mut self) -> Option<Record> {
        Some(Record::Metadata { name: self.text()?, entries: self.text_map()? })
    }
}

/// The chunk that is being read.
struct Chunk {
    start: u64,
    end: u64,
    /// 0 where the writer made none.
    checksum: u32,
    hasher: Hasher,
}

/// Reads records from anywhere, and knows the place.
pub(super) struct Records<R> {
    source: R,
    name: String,
    at: u64,
    chunk: Option<Chunk>,
    ended: bool,
}

impl<R: Read> Records<R> {
    /// Checks that this is an MCAP file.
    pub(super) fn new(source: R, name: String) -> Result<Self, ReadError> {
        let mut records = Self { source, name, at: 0, chunk: None, ended: false };
        match records.bytes(mcap::MAGIC.len() as u64) {
            Ok(magic) if magic == mcap::MAGIC => Ok(records),
            Ok(_) | Err(ReadError::BreaksOff { .. }) => {
                Err(ReadError::NotMcap { name: records.name })
            }
            Err(error) => Err(error),
        }
    }

    /// What the file is called in errors.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// The next record and where it starts; `None` after the end of the file.
    /// Nothing follows an error.
    pub(super) fn next(&mut self) -> Result<Option<(u64, Record)>, ReadError> {
        while !self.ended {
            match self.step() {
                Ok(None) => {}
                Ok(found) => return Ok(found),
                Err(error) => {
                    self.ended = true;
                    return Err(error);
                }
            }
        }
        Ok(None)
    }

    /// Damage that starts at `at`.
    fn damaged(&self, at: u64, what: impl Into<String>) -> ReadError {
        ReadError::Damaged { name: self.name.clone(), at, what: what.into() }
    }

    /// One record; `None` for one that is not needed.
    fn step(&mut self) -> Result<Option<(u64, Record)>, ReadError> {
        if self.chunk.as_ref().is_some_and(|chunk| chunk.end == self.at) {
            return self.end_chunk().map(|()| None);
        }
        let start = self.at;
        let (kind, length) = self.head()?;
        if kind == op::CHUNK && self.chunk.is_none() {
            return self.begin_chunk(start, length).map(|()| None);
        }
        if length > MAX_RECORD {
            return Err(self.damaged(start, format!("a record of {length} bytes")));
        }
        let body = self.bytes(length)?;
        if kind == op::FOOTER && self.chunk.is_none() {
            return self.end(start).map(|()| None);
        }
        match Record::parse(kind, body) {
            Ok(record) => Ok(record.map(|record| (start, record))),
            Err(()) => Err(self.damaged(start, format!("a record of kind {kind:#04x} is broken"))),
        }
    }

    /// Kind and length of a record.
    fn head(&mut self) -> Result<(u8, u64), ReadError> {
        let start = self.at;
        let head = self.bytes(HEAD)?;
        let parts = head.split_first().and_then(|(&kind, rest)| Some((kind, Fields(rest).u64()?)));
        parts.ok_or_else(|| self.damaged(start, "no record"))
    }

    /// Reads the fields of a chunk that stand before its records.
    fn begin_chunk(&mut self, start: u64, length: u64) -> Result<(), ReadError> {
        let [before, after] = CHUNK_FIELDS;
        let wrong = "the lengths in a chunk do not fit";
        let fields = self.bytes(before)?;
        let mut fields = Fields(&fields);
        let _times = (fields.u64(), fields.u64());
        let (_size, checksum, compression) = (fields.u64(), fields.u32(), fields.u32());
        let (Some(checksum), Some(compression)) = (checksum, compression) else {
            return Err(self.damaged(start, wrong));
        };
        let compression = u64::from(compression);
        if before + compression + after > length || compression > MAX_RECORD {
            return Err(self.damaged(start, wrong));
        }
        let compression = self.bytes(compression)?;
        let size = self.bytes(after)?;
        let end = start.checked_add(HEAD).and_then(|body| body.checked_add(length));
        let (Some(size), Some(end)) = (Fields(&size).u64(), end) else {
            return Err(self.damaged(start, wrong));
        };
        if !compression.is_empty() {
            let compression = String::from_utf8_lossy(&compression).into_owned();
            return Err(ReadError::Compressed { name: self.name.clone(), at: start, compression });
        }
        if self.at.checked_add(size) != Some(end) {
            return Err(self.damaged(start, wrong));
        }
        self.chunk = Some(Chunk { start, end, checksum, hasher: Hasher::new() });
        Ok(())
    }

    fn end_chunk(&mut self) -> Result<(), ReadError> {
        let Some(Chunk { start, checksum, hasher, .. }) = self.chunk.take() else { return Ok(()) };
        let found = hasher.finalize();
        if checksum != 0 && checksum != found {
            let what = format!("checksum of a chunk is {found:08x}, expected {checksum:08x}");
            return Err(self.damaged(start, what));
        }
        Ok(())
    }

    /// What follows the last record.
    fn end(&mut self, footer: u64) -> Result<(), ReadError> {
        if self.bytes(mcap::MAGIC.len() as u64)? != mcap::MAGIC {
            return Err(self.damaged(footer, "no end of file after the last record"));
        }
        self.ended = true;
        Ok(())
    }

    /// The next bytes. The memory taken grows with what is there, not with what
    /// is asked for.
    fn bytes(&mut self, count: u64) -> Result<Vec<u8>, ReadError> {
        if let Some(chunk) = &self.chunk
            && count > chunk.end.saturating_sub(self.at)
        {
            return Err(self.damaged(chunk.start, "a record reaches beyond its chunk"));
        }
        let mut bytes = Vec::new();
        let read = self.source.by_ref().take(count).read_to_end(&mut bytes);
        self.at += bytes.len() as u64;
        let name = || self.name.clone();
        if let Err(reason) = read {
            return Err(ReadError::Read { name: name(), at: self.at, reason });
        }
        if (bytes.len() as u64) < count {
            return Err(ReadError::BreaksOff { name: name(), at: self.at });
        }
        if let Some(chunk) = &mut self.chunk {
            chunk.hasher.update(&bytes);
        }
        Ok(bytes)
    }
}
