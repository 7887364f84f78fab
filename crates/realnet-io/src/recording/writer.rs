//! Writing a recording.

use super::topics::Topic;
use super::{RunInfo, StateSchema, Times, messages};
use crate::picture::{self, Encoding};
use foxglove::messages::Timestamp;
use mcap::records::MessageHeader;
use mcap::write::{Metadata, NoSeek};
use mcap::{Attachment, McapError, WriteOptions, Writer};
use prost::Message;
use realnet_core::{CameraCalibration, DepthMap, Detection, DriveCommand, Frame, Stamp};
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use thiserror::Error;

/// Seconds of arrival after which a chunk is handed to the operating system.
pub const CHUNK_SECONDS: f64 = 1.0;
/// Bytes of messages after which a chunk is handed to the operating system.
pub const CHUNK_BYTES: usize = 4 << 20;

/// The attachment that holds [`RunInfo::parameters`].
pub(super) const PARAMETERS: &str = "parameters.toml";
/// The metadata record that holds [`RunInfo::versions`].
pub(super) const VERSIONS: &str = "realnet";
/// The frame of reference of a camera without a name.
const CAMERA: &str = "camera";

/// Why something is not in a recording.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The file could not be made; one that exists is never overwritten.
    #[error("cannot create the recording {name}: {reason}")]
    Create {
        /// The file.
        name: String,
        /// What the operating system said.
        reason: io::Error,
    },
    /// The schema of the state is not the JSON Schema of an object.
    #[error("the schema of {name} is not a JSON object with \"type\": \"object\"")]
    Schema {
        /// Name of the schema.
        name: String,
    },
    /// The file could not be written, for example because the disk is full. The
    /// recording ends here.
    #[error("cannot write the recording {name}: {reason}; {}", readable(*kept))]
    Write {
        /// The file.
        name: String,
        /// Arrival of the last message that is in the file.
        kept: Option<Stamp>,
        /// What went wrong.
        reason: io::Error,
    },
    /// The recording has ended with an earlier [`RecordError::Write`].
    #[error("the recording {name} has ended with an error; {}", readable(*kept))]
    Ended {
        /// The file.
        name: String,
        /// Arrival of the last message that is in the file.
        kept: Option<Stamp>,
    },
    /// A time that the format does not have. Only this message is missing.
    #[error(
        "{topic}: the time {stamp} is not recorded, it must be from 0 to 4294967295.999999999 s"
    )]
    Time {
        /// Topic of the message.
        topic: &'static str,
        /// The time.
        stamp: Stamp,
    },
    /// Bytes that are neither JPEG nor PNG, or a frame that cannot be encoded.
    /// Only this message is missing.
    #[error("{topic}: {reason}")]
    Picture {
        /// Topic of the message.
        topic: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// A state that does not become JSON. Only this message is missing.
    #[error("{topic}: {reason}")]
    Json {
        /// Topic of the message.
        topic: &'static str,
        /// What the serialiser said.
        reason: serde_json::Error,
    },
    /// The format has no room for it, for example for more than 4 GiB of parameters.
    #[error("cannot write the recording {name}: {reason}")]
    Format {
        /// The file.
        name: String,
        /// What the library said.
        reason: McapError,
    },
}

fn readable(kept: Option<Stamp>) -> String {
    match kept {
        Some(arrival) => format!("what arrived until {arrival} stays readable"),
        None => "no message is in it".into(),
    }
}

/// The times of a message as the file has them.
#[derive(Clone, Copy)]
struct FileTimes {
    log_time: u64,
    publish_time: u64,
    timestamp: Timestamp,
}

impl FileTimes {
    fn new(topic: Topic, times: Times) -> Result<Self, RecordError> {
        let (log_time, _) = in_file(topic, times.arrival)?;
        let (publish_time, timestamp) = in_file(topic, times.stamp)?;
        Ok(Self { log_time, publish_time, timestamp })
    }
}

fn in_file(topic: Topic, stamp: Stamp) -> Result<(u64, Timestamp), RecordError> {
    const SECOND: u64 = 1_000_000_000;
    let nanos = u64::try_from(stamp.nanos()).ok();
    let parts = nanos.and_then(|nanos| {
        let seconds = u32::try_from(nanos / SECOND).ok()?;
        Some((nanos, Timestamp::new_checked(seconds, (nanos % SECOND) as u32)?))
    });
    parts.ok_or(RecordError::Time { topic: topic.name(), stamp })
}

/// The messages that are not yet handed to the operating system.
#[derive(Clone, Copy)]
struct Pending {
    /// Arrival of the first one.
    first: Stamp,
    /// Arrival of the last one.
    last: Stamp,
    bytes: usize,
}

impl Pending {
    fn is_due(&self) -> bool {
        // A clock that was set back ends a chunk too.
        self.bytes >= CHUNK_BYTES || self.last.seconds_since(self.first).abs() >= CHUNK_SECONDS
    }
}

/// A channel of the file and the number of its next message.
#[derive(Clone, Copy, Default)]
struct Channel {
    id: u16,
    sequence: u32,
}

/// Writes a recording, see the [module documentation](super) for what is in it
/// and what survives.
///
/// Messages are to be given in the order of their arrival; they are read in the
/// order given. Each call copies into memory, and about once a second one of
/// them writes: give the writer a thread of its own where that must not be
/// waited for. Memory holds one chunk ([`CHUNK_BYTES`] and the largest message)
/// and the index of the file, less than a kilobyte for each chunk.
///
/// [`RunWriter::finish`] writes the index. A writer that is dropped tries the
/// same; without an index the file is still readable.
pub struct RunWriter<W: Write> {
    mcap: Writer<NoSeek<W>>,
    name: String,
    frame_id: String,
    channels: [Channel; Topic::ALL.len()],
    message: Vec<u8>,
    pending: Option<Pending>,
    kept: Option<Stamp>,
    ended: bool,
}

impl RunWriter<BufWriter<File>> {
    /// A recording in the new file `path`.
    ///
    /// # Errors
    /// [`RecordError::Create`] when the file exists or cannot be made, and those of
    /// [`RunWriter::new`].
    pub fn create(
        path: &Path,
        info: &RunInfo,
        state: StateSchema<'_>,
    ) -> Result<Self, RecordError> {
        let name = path.display().to_string();
        match File::create_new(path) {
            Ok(file) => Self::new(BufWriter::new(file), name, info, state),
            Err(reason) => Err(RecordError::Create { name, reason }),
        }
    }
}

impl<W: Write> RunWriter<W> {
    /// A recording into `out`, called `name` in errors. What `out` holds back is
    /// lost with the process; it is flushed after each chunk.
    ///
    /// # Errors
    /// [`RecordError::Schema`] for a schema that is not one of an object,
    /// [`RecordError::Write`] when `out` fails.
    pub fn new(
        out: W,
        name: impl Into<String>,
        info: &RunInfo,
        state: StateSchema<'_>,
    ) -> Result<Self, RecordError> {
        let name = name.into();
        check_schema(state)?;
        // The writer seeks nowhere, so it gathers a chunk in memory and writes it whole.
        let options = WriteOptions::new()
            .library(format!("realnet {} {}", env!("CARGO_PKG_VERSION"), mcap::LIBRARY_IDENTIFIER))
            .compression(None)
            .chunk_size(None)
            .disable_seeking(true);
        let opened = options.create(NoSeek::new(out)).and_then(|mut mcap| {
            write_info(&mut mcap, info)?;
            let channels = add_channels(&mut mcap, state)?;
            Ok((mcap, channels))
        });
        let (mcap, channels) = opened.map_err(|error| file_error(&name, None, error))?;
        Ok(Self {
            mcap,
            name,
            frame_id: CAMERA.into(),
            channels,
            message: Vec::new(),
            pending: None,
            kept: None,
            ended: false,
        })
    }

    /// Records a frame as the bytes of a JPEG or PNG file.
    ///
    /// # Errors
    /// [`RecordError`]; [`RecordError::Picture`] for other bytes.
    pub fn image(&mut self, times: Times, picture: &[u8]) -> Result<(), RecordError> {
        let topic = Topic::Image;
        let format = messages::picture_format(picture).ok_or_else(|| RecordError::Picture {
            topic: topic.name(),
            reason: format!("{} bytes that are neither JPEG nor PNG", picture.len()),
        })?;
        let at = FileTimes::new(topic, times)?;
        let message = messages::image(at.timestamp, &self.frame_id, format, picture);
        self.protobuf(topic, times.arrival, at, &message)
    }

    /// Records a frame that is not compressed yet, by its own stamp. With
    /// [`Encoding::Png`] it comes back exactly.
    ///
    /// # Errors
    /// [`RecordError`]; [`RecordError::Picture`] when it is too large for the encoding.
    pub fn frame(
        &mut self,
        arrival: Stamp,
        frame: &Frame,
        encoding: Encoding,
    ) -> Result<(), RecordError> {
        let picture = picture::encode(frame, encoding)
            .map_err(|reason| RecordError::Picture { topic: Topic::Image.name(), reason })?;
        self.image(Times { arrival, stamp: frame.stamp() }, &picture)
    }

    /// Records the camera. Its name becomes the frame of reference of the pictures
    /// and depth maps that follow, so it is best recorded first.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn calibration(
        &mut self,
        times: Times,
        calibration: &CameraCalibration,
    ) -> Result<(), RecordError> {
        let topic = Topic::Calibration;
        let at = FileTimes::new(topic, times)?;
        let name = Some(calibration.name()).filter(|name| !name.is_empty());
        self.frame_id = name.unwrap_or(CAMERA).into();
        let message = messages::calibration(at.timestamp, &self.frame_id, calibration);
        self.protobuf(topic, times.arrival, at, &message)
    }

    /// Records what a detector found in a frame, nothing included; `names` are
    /// those of the classes.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn detections(
        &mut self,
        times: Times,
        found: &[Detection],
        names: &[String],
    ) -> Result<(), RecordError> {
        self.json(Topic::Detections, times, &messages::detections(found, names))?;
        let topic = Topic::Annotations;
        let at = FileTimes::new(topic, times)?;
        let message = messages::annotations(at.timestamp, found, names);
        self.protobuf(topic, times.arrival, at, &message)
    }

    /// Records a depth map, by its own stamp.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn depth(&mut self, arrival: Stamp, map: &DepthMap) -> Result<(), RecordError> {
        let topic = Topic::Depth;
        let at = FileTimes::new(topic, Times { arrival, stamp: map.stamp() })?;
        let message = messages::depth(at.timestamp, &self.frame_id, map);
        self.protobuf(topic, arrival, at, &message)
    }

    /// Records the state of the target, an object of the schema given at the start.
    ///
    /// # Errors
    /// [`RecordError`]; [`RecordError::Json`] when it cannot be serialised.
    pub fn state(&mut self, times: Times, state: &impl Serialize) -> Result<(), RecordError> {
        self.json(Topic::State, times, state)
    }

    /// Records what the vehicle was told, by the command's own stamp.
    ///
    /// # Errors
    /// [`RecordError`].
    pub fn command(&mut self, arrival: Stamp, command: &DriveCommand) -> Result<(), RecordError> {
        let times = Times { arrival, stamp: command.stamp };
        self.json(Topic::Command, times, &messages::command(command))
    }

    /// Hands everything to the operating system now, for example because nothing
    /// more is expected for a while.
    ///
    /// # Errors
    /// [`RecordError::Write`] and [`RecordError::Ended`].
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.check_open()?;
        let Some(pending) = self.pending.take() else { return Ok(()) };
        let flushed = self.mcap.flush();
        self.check(flushed)?;
        self.kept = Some(pending.last);
        Ok(())
    }

    /// Writes the index and gives back what was written to.
    ///
    /// # Errors
    /// [`RecordError::Write`] and [`RecordError::Ended`].
    pub fn finish(mut self) -> Result<W, RecordError> {
        self.flush()?;
        let finished = self.mcap.finish().map(|_| ());
        self.check(finished)?;
        Ok(self.mcap.into_inner().into_inner())
    }

    fn protobuf(
        &mut self,
        topic: Topic,
        arrival: Stamp,
        at: FileTimes,
        message: &impl Message,
    ) -> Result<(), RecordError> {
        self.message.clear();
        // A vector has room for every message.
        let _ = message.encode(&mut self.message);
        self.put(topic, arrival, at)
    }

    fn json(
        &mut self,
        topic: Topic,
        times: Times,
        message: &impl Serialize,
    ) -> Result<(), RecordError> {
        let at = FileTimes::new(topic, times)?;
        self.message.clear();
        serde_json::to_writer(&mut self.message, message)
            .map_err(|reason| RecordError::Json { topic: topic.name(), reason })?;
        self.put(topic, times.arrival, at)
    }

    /// Appends the encoded message.
    fn put(&mut self, topic: Topic, arrival: Stamp, at: FileTimes) -> Result<(), RecordError> {
        self.check_open()?;
        let channel = &mut self.channels[topic as usize];
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.sequence,
            log_time: at.log_time,
            publish_time: at.publish_time,
        };
        channel.sequence = channel.sequence.wrapping_add(1);
        let written = self.mcap.write_to_known_channel(&header, &self.message);
        self.check(written)?;
        let pending =
            self.pending.get_or_insert(Pending { first: arrival, last: arrival, bytes: 0 });
        pending.last = arrival;
        pending.bytes += self.message.len();
        if pending.is_due() { self.flush() } else { Ok(()) }
    }

    fn check_open(&self) -> Result<(), RecordError> {
        if self.ended {
            return Err(RecordError::Ended { name: self.name.clone(), kept: self.kept });
        }
        Ok(())
    }

    /// After an error the recording has ended: a part of a chunk may be in the file.
    fn check(&mut self, result: Result<(), McapError>) -> Result<(), RecordError> {
        result.map_err(|error| {
            self.ended = true;
            file_error(&self.name, self.kept, error)
        })
    }
}

fn file_error(name: &str, kept: Option<Stamp>, error: McapError) -> RecordError {
    let name = name.to_owned();
    match error {
        McapError::Io(reason) => RecordError::Write { name, kept, reason },
        reason => RecordError::Format { name, reason },
    }
}

fn check_schema(state: StateSchema<'_>) -> Result<(), RecordError> {
    let schema = serde_json::from_str::<serde_json::Value>(state.json);
    let of_object = schema.is_ok_and(|schema| schema.get("type").is_some_and(|t| t == "object"));
    if of_object { Ok(()) } else { Err(RecordError::Schema { name: state.name.into() }) }
}

fn write_info<W: Write>(mcap: &mut Writer<NoSeek<W>>, info: &RunInfo) -> Result<(), McapError> {
    mcap.write_metadata(&Metadata { name: VERSIONS.into(), metadata: info.versions.clone() })?;
    mcap.attach(&Attachment {
        log_time: 0,
        create_time: 0,
        name: PARAMETERS.into(),
        media_type: "application/toml".into(),
        data: Cow::Borrowed(info.parameters.as_bytes()),
    })?;
    mcap.flush()
}

fn add_channels<W: Write>(
    mcap: &mut Writer<NoSeek<W>>,
    state: StateSchema<'_>,
) -> Result<[Channel; Topic::ALL.len()], McapError> {
    let mut channels = [Channel::default(); Topic::ALL.len()];
    for (channel, topic) in channels.iter_mut().zip(Topic::ALL) {
        let schema = topic.schema(state);
        let schema_id = mcap.add_schema(&schema.name, &schema.encoding, &schema.data)?;
        channel.id =
            mcap.add_channel(schema_id, topic.name(), topic.encoding(), &BTreeMap::new())?;
    }
    Ok(channels)
}
