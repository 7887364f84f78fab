//! Recordings of runs: MCAP files with what came in, what was found and what
//! was commanded. Foxglove shows them, every MCAP library reads them, and
//! [`RunReader`] gives the exact values again.
//!
//! | topic | schema | encoding | what |
//! |---|---|---|---|
//! | `/camera/image` | `foxglove.CompressedImage` | protobuf | JPEG or PNG, the bytes that were given |
//! | `/camera/calibration` | `foxglove.CameraCalibration` | protobuf | the camera |
//! | `/detections` | `realnet.Detections` | json | what a detector found, exact |
//! | `/detections/annotations` | `foxglove.ImageAnnotations` | protobuf | the same as boxes and labels for Foxglove's image panel; not read back |
//! | `/depth` | `foxglove.RawImage` | protobuf | a depth map, `32FC1`, metres, exact |
//! | `/target` | the caller's | json | the state of the target, any [`Serialize`](serde::Serialize) with a JSON Schema |
//! | `/command` | `realnet.Command` | json | what the vehicle was told |
//!
//! Before the messages stand the run's parameters as the attachment
//! `parameters.toml` and its versions as the metadata `realnet`: [`RunInfo`].
//! The log time of a message is its time of arrival, its publish time the
//! exposure time of the frame it belongs to (of a command: when it was given):
//! [`Times`]. Messages stand in the order in which they were written, and are
//! read in that order.
//!
//! In JSON a number that is not finite is `null`, and is read as not-a-number.
//!
//! # What survives
//! Messages are gathered in memory into chunks, and a chunk goes to the
//! operating system whole: when the messages in it span a second of arrival, or
//! reach [`CHUNK_BYTES`]. So a killed process loses what arrived in its last
//! second. (A power failure also loses what the operating system had not yet
//! written to the disk.) [`RunReader`] gives every whole message of a file that
//! breaks off, then an error with the place. On a full disk the writer says so
//! once and refuses everything after, and what was written stays readable.
//!
//! Chunks are not compressed: nearly all bytes are JPEG, which does not shrink,
//! and a robot has better uses for its processor.
//!
//! ```
//! use realnet_core::{BoundingBox, Detection, DriveCommand, Stamp};
//! use realnet_io::recording::{Content, RunInfo, RunReader, RunWriter, StateSchema, Times};
//!
//! #[derive(serde::Serialize)]
//! struct State {
//!     range_m: f64,
//! }
//! let schema = StateSchema {
//!     name: "example.State",
//!     json: r#"{"type": "object", "properties": {"range_m": {"type": "number"}}}"#,
//! };
//! let info = RunInfo { parameters: "gap_m = 1.5\n".into(), ..RunInfo::default() };
//! let car = Detection {
//!     class_id: 0,
//!     confidence: 0.9,
//!     bbox: BoundingBox::new(10.0, 20.0, 50.0, 40.0),
//! };
//!
//! // A file: `RunWriter::create(path, &info, schema)`.
//! let mut run = RunWriter::new(Vec::new(), "in memory", &info, schema)?;
//! let stamp = Stamp::from_secs_f64(0.100);
//! let times = Times { arrival: Stamp::from_secs_f64(0.150), stamp };
//! run.detections(times, &[car], &["rc_car".into()])?;
//! run.state(times, &State { range_m: 2.5 })?;
//! run.command(times.arrival, &DriveCommand { stamp, speed: 0.8, ..DriveCommand::default() })?;
//! let bytes = run.finish()?;
//!
//! let run = RunReader::new(bytes.as_slice(), "in memory")?;
//! assert_eq!(run.info(), &info);
//! for recorded in run {
//!     let recorded = recorded?;
//!     assert_eq!(recorded.times, times);
//!     match recorded.content {
//!         Content::Detections(found) => assert_eq!(found[0].detection, car),
//!         Content::State(state) => assert_eq!(state["range_m"], 2.5),
//!         Content::Command(command) => assert_eq!(command.speed, 0.8),
//!         other => panic!("{other:?}"),
//!     }
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod contents;
mod fields;
mod messages;
mod reader;
mod records;
mod topics;
mod writer;

use realnet_core::{CameraCalibration, DepthMap, Detection, DriveCommand, Stamp};
use std::collections::BTreeMap;

pub use contents::{Contents, TopicContents, contents};
pub use reader::RunReader;
pub use records::ReadError;
pub use writer::{CHUNK_BYTES, CHUNK_SECONDS, RecordError, RunWriter};

/// What a run was made with; it stands before the first message.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunInfo {
    /// All settings, as the text of a configuration file in TOML.
    pub parameters: String,
    /// Versions by what they are of: the program, networks, engines.
    pub versions: BTreeMap<String, String>,
}

/// What the JSON objects on `/target` look like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateSchema<'a> {
    /// Name of the type, for example `realnet.Target`.
    pub name: &'a str,
    /// JSON Schema of an object.
    pub json: &'a str,
}

/// The two times of a message, both within the 4294967296 s (136 years) after
/// their epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Times {
    /// When it arrived, or was made. Foxglove's time line.
    pub arrival: Stamp,
    /// Exposure time of the frame it belongs to.
    pub stamp: Stamp,
}

/// A detection with the name of its class.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedDetection {
    /// Name of the class; its index as text when it has none.
    pub class: String,
    /// What was found.
    pub detection: Detection,
}

/// What a message says.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// A frame, as the bytes of a JPEG or PNG file for [`crate::picture::decode`].
    Image(Vec<u8>),
    /// The camera. Its name is `camera` where it was recorded without one.
    Calibration(Box<CameraCalibration>),
    /// What a detector found in one frame; empty when it found nothing.
    Detections(Vec<NamedDetection>),
    /// A depth map; its stamp is that of the message.
    Depth(DepthMap),
    /// The state of the target.
    State(serde_json::Value),
    /// A command; its stamp is that of the message.
    Command(DriveCommand),
}

/// One message of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// When it arrived and what moment it is about.
    pub times: Times,
    /// What it says.
    pub content: Content,
}
