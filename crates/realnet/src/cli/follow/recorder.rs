//! What `realnet follow --record` leaves on disk: everything, as an MCAP file.

use anyhow::{Context, Result};
use realnet::picture::Encoding;
use realnet::recording::{RecordError, RunInfo, RunWriter, StateSchema, Times};
use realnet::{CameraCalibration, CameraModel, DepthMap, Detection, Frame, Stamp};
use realnet_core::DriveCommand;
use serde_json::Value;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread::{Builder, JoinHandle};

/// Frames that may wait for the disk.
const WAITING: usize = 30;
/// Of the JPEG files that frames become.
const QUALITY: u8 = 90;

/// What is on `/target`: a line of `--json`.
const STATE: StateSchema<'_> = StateSchema {
    name: "realnet.Follow",
    json: r#"{"type":"object","properties":{
"frame":{"type":"integer"},"source":{"type":"string"},"stamp_ns":{"type":"integer"},
"state":{"type":"string"},"class":{"type":["string","null"]},
"box":{"type":["array","null"],"items":{"type":"number"}},
"range_m":{"type":["number","null"]},"range_sigma_m":{"type":["number","null"]},
"position_m":{"type":["array","null"],"items":{"type":"number"}},
"velocity_mps":{"type":["array","null"],"items":{"type":"number"}},
"cues":{"type":"object","properties":{"network":{"type":["number","null"]},
"motion":{"type":["number","null"]},"ground":{"type":["number","null"]},
"size":{"type":["number","null"]}}},
"command":{"type":"object","properties":{"steering_rad":{"type":"number"},
"speed_mps":{"type":"number"},"stop":{"type":["string","null"]}}},
"ms":{"type":"object"}}}"#,
};

/// A frame with all that came of it.
pub(super) struct Moment {
    /// When it came, by the clock of the stamps.
    pub(super) arrival: Stamp,
    pub(super) frame: Arc<Frame>,
    pub(super) detections: Vec<Detection>,
    /// The frame that they were found on, if they are new.
    pub(super) found_on: Option<Stamp>,
    pub(super) depth: Option<DepthMap>,
    pub(super) state: Value,
    pub(super) command: DriveCommand,
}

/// Writes on a thread of its own, so that no command waits for the disk.
pub(super) struct Recorder {
    moments: SyncSender<Moment>,
    thread: JoinHandle<Result<(), RecordError>>,
    /// Whether frames may be left out where the disk is too slow.
    live: bool,
    left_out: u64,
}

impl Recorder {
    /// Begins a recording of a camera's frames; `names` are those of the detector's classes.
    pub(super) fn start(
        path: &Path,
        camera: &CameraModel,
        names: Vec<String>,
        info: &RunInfo,
        live: bool,
    ) -> Result<Self> {
        let mut run = RunWriter::create(path, info, STATE)?;
        let camera = CameraCalibration::new("camera", *camera);
        let (moments, coming) = sync_channel::<Moment>(WAITING);
        let thread = Builder::new().name("recording".to_owned()).spawn(move || {
            for (index, moment) in coming.into_iter().enumerate() {
                let stamp = moment.frame.stamp();
                let times = Times { arrival: moment.arrival, stamp };
                if index == 0 {
                    run.calibration(times, &camera)?;
                }
                write(&mut run, times, &moment, &names)?;
            }
            run.finish().map(|_| ())
        })?;
        Ok(Self { moments, thread, live, left_out: 0 })
    }

    /// Takes what came of a frame.
    ///
    /// # Errors
    /// That of the writer, which has ended.
    pub(super) fn take(&mut self, moment: Moment) -> Result<(), Ended> {
        let sent = if self.live {
            self.moments.try_send(moment)
        } else {
            self.moments.send(moment).map_err(|error| TrySendError::Disconnected(error.0))
        };
        match sent {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_)) => {
                self.left_out += 1;
                Ok(())
            }
            Err(TrySendError::Disconnected(_)) => Err(Ended),
        }
    }

    /// Waits until all is written. How many frames were left out.
    pub(super) fn finish(self) -> Result<u64> {
        drop(self.moments);
        let ended = self.thread.join().unwrap_or(Ok(()));
        ended.context("the recording")?;
        Ok(self.left_out)
    }
}

/// The writer has ended; [`Recorder::finish`] says why.
#[derive(Debug)]
pub(super) struct Ended;

fn write(
    run: &mut RunWriter<BufWriter<File>>,
    times: Times,
    moment: &Moment,
    names: &[String],
) -> Result<(), RecordError> {
    run.frame(times.arrival, &moment.frame, Encoding::Jpeg { quality: QUALITY })?;
    if let Some(stamp) = moment.found_on {
        run.detections(Times { stamp, ..times }, &moment.detections, names)?;
    }
    if let Some(map) = &moment.depth {
        run.depth(times.arrival, map)?;
    }
    run.state(times, &moment.state)?;
    run.command(times.arrival, &moment.command)
}
