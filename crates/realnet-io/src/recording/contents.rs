//! What is in a recording.

use super::reader::Messages;
use super::{ReadError, RunInfo};
use realnet_core::Stamp;
use std::collections::BTreeMap;
use std::path::Path;

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicContents {
    /// Its name.
    pub topic: String,
    /// Name of its schema; empty without one.
    pub schema: String,
    /// Encoding of its messages.
    pub encoding: String,
    /// Number of its messages.
    pub messages: u64,
    /// Bytes of its messages.
    pub bytes: u64,
}

/// What is in a recording, of whatever program.
#[derive(Debug)]
pub struct Contents {
    /// What the run was made with; empty in files of other programs.
    pub info: RunInfo,
    /// The topics in the order of their numbers, those without messages too.
    pub topics: Vec<TopicContents>,
    /// Earliest and latest arrival.
    pub arrivals: Option<(Stamp, Stamp)>,
    /// Why the file could not be read to its end. The counts are of what stands
    /// before.
    pub broken: Option<ReadError>,
}

/// Reads the file through, so that it is also known whether it is whole.
///
/// # Errors
/// [`ReadError::Open`], [`ReadError::NotMcap`], [`ReadError::Read`].
pub fn contents(path: &Path) -> Result<Contents, ReadError> {
    let mut messages = Messages::open(path)?;
    let mut counts: BTreeMap<u16, (u64, u64)> = BTreeMap::new();
    let mut arrivals: Option<(Stamp, Stamp)> = None;
    let broken = loop {
        let message = match messages.next() {
            Ok(Some(message)) => message,
            Ok(None) => break None,
            Err(error) => break Some(error),
        };
        let count = counts.entry(message.channel_id).or_default();
        count.0 += 1;
        count.1 += message.data.len() as u64;
        let arrival = message.times.arrival;
        let (first, last) = arrivals.unwrap_or((arrival, arrival));
        arrivals = Some((first.min(arrival), last.max(arrival)));
    };
    let topics = messages.channels.into_iter().map(|(id, channel)| {
        let (messages, bytes) = counts.get(&id).copied().unwrap_or_default();
        let (topic, schema, encoding) = (channel.topic, channel.schema, channel.encoding);
        TopicContents { topic, schema, encoding, messages, bytes }
    });
    Ok(Contents { info: messages.info, topics: topics.collect(), arrivals, broken })
}
