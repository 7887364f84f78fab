//! Video files and network streams, decoded by an installed ffmpeg.
//!
//! ffmpeg writes raw RGB frames to a pipe, and its `showinfo` filter tells the
//! time stamp and size of every frame on standard error. No frame is doubled or
//! left out on the way (`-fps_mode passthrough`), rotation is applied.

use super::queue::Queue;
use super::{
    Produce, Release, Source, SourceError, SourceFrame, SourceKind, SourceOptions, unix_now,
};
use crate::ffmpeg::{self, FfmpegError, Log, Running};
use crate::picture;
use realnet_core::{Frame, Stamp};
use std::io::Read;
use std::path::Path;
use std::process::{ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// How long ffmpeg may take to end once its output has ended.
const FAREWELL: Duration = Duration::from_secs(10);

/// Extensions of addresses that are files, not live streams.
const FILE_EXTENSIONS: [&str; 9] =
    ["mp4", "m4v", "mov", "mkv", "webm", "avi", "mpg", "mpeg", "wmv"];

/// Opens a video file (`path`) or an address.
pub(super) fn open(
    spec: &str,
    path: Option<&Path>,
    options: &SourceOptions,
) -> Result<Source, SourceError> {
    let live = options.live.unwrap_or_else(|| path.is_none() && !is_file_address(spec));
    let queue = Arc::new(Queue::new(options.ahead, live));
    let mut length = None;
    if let Some(path) = path {
        let facts = probe(path, options)?;
        queue.set_fps(facts.fps);
        length = facts.frames;
    }
    let input = path.map_or_else(|| spec.into(), ffmpeg::file_url);
    let child: Arc<Mutex<Option<Arc<Running>>>> = Arc::default();
    let mut producer = Producer {
        job: Job {
            input,
            program: options.ffmpeg.clone(),
            paced: live && path.is_some(),
            live_input: live && path.is_none(),
        },
        name: spec.to_string(),
        live,
        max_pixels: options.limits.max_pixels,
        queue: Arc::clone(&queue),
        child: Arc::clone(&child),
        run: None,
        old_option: false,
        index: 0,
        clock: Clock::default(),
    };
    // Started here so that a missing program is an error of `open`.
    producer.spawn()?;
    let release: Release = Arc::new(move || {
        if let Some(running) = ffmpeg::lock(&child).as_ref() {
            running.kill();
        }
    });
    let kind = if path.is_some() { SourceKind::Video } else { SourceKind::Stream };
    let wiring = (queue, release);
    let mut source =
        Source::start(kind, spec.to_string(), live, length, options, wiring, Box::new(producer))?;
    source.files = path.into_iter().map(Path::to_path_buf).collect();
    Ok(source)
}

fn is_file_address(address: &str) -> bool {
    let path = address.split(['?', '#']).next().unwrap_or(address);
    address.starts_with("http")
        && picture::extension(Path::new(path))
            .is_some_and(|e| FILE_EXTENSIONS.contains(&e.as_str()))
}

/// What ffprobe knows of a file.
#[derive(Debug, Default, PartialEq)]
struct Facts {
    fps: Option<f64>,
    frames: Option<u64>,
}

/// Asks ffprobe. Without ffprobe nothing is known and nothing is wrong.
fn probe(path: &Path, options: &SourceOptions) -> Result<Facts, SourceError> {
    let name = path.display().to_string();
    let output = ffmpeg::command(&options.ffprobe)
        .args(["-hide_banner", "-loglevel", "level+error", "-select_streams", "V:0"])
        .args(["-show_entries", "stream=nb_frames,avg_frame_rate,duration:format=duration"])
        .args(["-of", "json", "-i"])
        .arg(ffmpeg::file_url(path))
        .output();
    let output = match output {
        Ok(output) => output,
        Err(_) => return Ok(Facts::default()),
    };
    if !output.status.success() {
        let mut log = Log::follow(std::io::Cursor::new(output.stderr), |_| {});
        log.finish();
        let message = log.last_words();
        return Err(FfmpegError::Failed { subject: name, message }.into());
    }
    read_facts(&output.stdout).ok_or(SourceError::NoVideo { name })
}

/// The answer of ffprobe; `None` when it names no stream.
fn read_facts(json: &[u8]) -> Option<Facts> {
    let answer: serde_json::Value = serde_json::from_slice(json).unwrap_or_default();
    let stream = answer.get("streams")?.get(0)?;
    let text = |value: &serde_json::Value, key: &str| {
        value.get(key).and_then(serde_json::Value::as_str).map(str::to_string)
    };
    let fps = text(stream, "avg_frame_rate").and_then(|r| ratio(&r)).filter(|f| *f > 0.0);
    let duration = text(stream, "duration")
        .or_else(|| answer.get("format").and_then(|f| text(f, "duration")))
        .and_then(|d| d.parse::<f64>().ok());
    let frames = text(stream, "nb_frames")
        .and_then(|n| n.parse().ok())
        .or_else(|| Some((fps? * duration?).round() as u64))
        .filter(|n| *n > 0);
    Some(Facts { fps, frames })
}

/// `30000/1001` as a number.
fn ratio(text: &str) -> Option<f64> {
    let (top, bottom) = text.split_once('/')?;
    let (top, bottom): (f64, f64) = (top.trim().parse().ok()?, bottom.trim().parse().ok()?);
    (bottom != 0.0).then_some(top / bottom)
}

/// What `showinfo` tells.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Told {
    /// The unit of the stamps, `numerator / denominator` seconds, and the
    /// nominal rate.
    Unit { numerator: i64, denominator: i64, fps: Option<f64> },
    /// A frame: its stamp in units, width and height.
    Frame { pts: Option<i64>, width: usize, height: usize },
}

/// Reads one line of ffmpeg's log; `None` when it is about something else.
fn told(line: &str) -> Option<Told> {
    // `[Parsed_showinfo_1 @ 0x5646c4fbe280] [info] n:   1 pts:      1 pts_time:0.04 …`
    let rest = line.strip_prefix("[Parsed_showinfo_")?.split_once("[info] ")?.1;
    // The text after `key`, up to the next blank or comma.
    let value = |key: &str| {
        let after = rest.split_once(key)?.1.trim_start();
        after.split([' ', ',']).next()
    };
    if rest.starts_with("config in") {
        let (numerator, denominator) = value("time_base:")?.split_once('/')?;
        let (numerator, denominator) = (numerator.parse().ok()?, denominator.parse().ok()?);
        let fps = value("frame_rate:").and_then(ratio);
        return (numerator > 0 && denominator > 0).then_some(Told::Unit {
            numerator,
            denominator,
            fps,
        });
    }
    if !rest.starts_with("n:") {
        return None;
    }
    let (width, height) = value(" s:")?.split_once('x')?;
    let (width, height) = (width.parse().ok()?, height.parse().ok()?);
    // `NOPTS` where the container has no stamp.
    Some(Told::Frame { pts: value(" pts:")?.parse().ok(), width, height })
}

/// Presentation stamps to nanoseconds after the first frame.
#[derive(Debug)]
struct Clock {
    numerator: i64,
    denominator: i64,
    fps: Option<f64>,
    first: Option<i128>,
    last: Option<Stamp>,
}

impl Default for Clock {
    fn default() -> Self {
        Self { numerator: 1, denominator: 1000, fps: None, first: None, last: None }
    }
}

impl Clock {
    /// Takes over the unit that ffmpeg announces. A filter graph that is built
    /// anew (the picture size changed midway) may announce another one.
    fn set_unit(&mut self, numerator: i64, denominator: i64, fps: Option<f64>) {
        let (old, new) = (self.numerator, numerator);
        self.first = self.first.map(|first| {
            let top = first * i128::from(old) * i128::from(denominator);
            top / (i128::from(self.denominator) * i128::from(new))
        });
        *self = Self { numerator, denominator, fps: fps.or(self.fps), ..*self };
    }

    /// The stamp of a frame, to the nearest nanosecond; one without a
    /// presentation stamp follows its predecessor by one frame period.
    fn stamp(&mut self, pts: Option<i64>) -> Stamp {
        let stamp = match (pts.map(i128::from), self.last) {
            (Some(at), _) => {
                let units = at - *self.first.get_or_insert(at);
                let (top, bottom) = (i128::from(self.numerator), i128::from(self.denominator));
                let nanos = (units * top)
                    .saturating_mul(1_000_000_000)
                    .saturating_add(bottom / 2)
                    .div_euclid(bottom);
                let far = if nanos < 0 { i64::MIN } else { i64::MAX };
                Stamp::from_nanos(i64::try_from(nanos).unwrap_or(far))
            }
            (None, None) => Stamp::ZERO,
            (None, Some(last)) => {
                let period = Stamp::from_secs_f64(1.0 / self.fps.unwrap_or(30.0)).nanos();
                Stamp::from_nanos(last.nanos().saturating_add(period))
            }
        };
        self.last = Some(stamp);
        stamp
    }

    /// The time of arrival, later than any before even if the clock was set back.
    fn arrival(&mut self) -> Stamp {
        let mut now = unix_now();
        if let Some(last) = self.last
            && now <= last
        {
            now = Stamp::from_nanos(last.nanos().saturating_add(1));
        }
        self.last = Some(now);
        now
    }
}

/// What ffmpeg is to do.
struct Job {
    input: std::ffi::OsString,
    program: std::path::PathBuf,
    /// Read a file at its own speed.
    paced: bool,
    /// The input is a stream of which only the newest frame counts.
    live_input: bool,
}

impl Job {
    fn command(&self, old_option: bool) -> Command {
        let mut command = ffmpeg::command(&self.program);
        command.args(["-hide_banner", "-nostdin", "-nostats", "-loglevel", "level+info"]);
        if self.live_input {
            // Not `-fflags nobuffer`: it throws away what was read to find out the
            // format, often the only key frame for seconds.
            command.args(["-flags", "low_delay"]);
            let input = self.input.to_string_lossy();
            if input.starts_with("rtsp://") || input.starts_with("rtsps://") {
                // Lost UDP packets would smear pictures.
                command.args(["-rtsp_transport", "tcp"]);
            }
        }
        if self.paced {
            command.arg("-re");
        }
        command.arg("-i").arg(&self.input);
        // `V`: a real video stream, no cover picture. `showinfo` comes last, so
        // its size is that of the written frame.
        command.args(["-map", "0:V:0", "-vf", "format=rgb24,showinfo=checksum=0"]);
        // The new name exists since ffmpeg 5.1, the old one up to 7.
        command.args(if old_option { ["-vsync", "0"] } else { ["-fps_mode", "passthrough"] });
        command.args(["-f", "rawvideo", "pipe:1"]);
        command
    }
}

/// One running ffmpeg.
struct Run {
    running: Arc<Running>,
    stdout: ChildStdout,
    told: Receiver<Told>,
    log: Log,
}

struct Producer {
    job: Job,
    name: String,
    live: bool,
    max_pixels: u64,
    queue: Arc<Queue>,
    child: Arc<Mutex<Option<Arc<Running>>>>,
    run: Option<Run>,
    old_option: bool,
    index: u64,
    clock: Clock,
}

impl Producer {
    fn spawn(&mut self) -> Result<(), SourceError> {
        let program = &self.job.program;
        let mut child = self
            .job
            .command(self.old_option)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|e| ffmpeg::start_error(program, e))?;
        let pipes = (child.stdout.take(), child.stderr.take());
        let running = Arc::new(Running::new(child));
        let (Some(stdout), Some(stderr)) = pipes else {
            let reason = std::io::Error::other("no pipe to the program");
            return Err(ffmpeg::start_error(program, reason).into());
        };
        let (sender, told_receiver) = channel();
        let log = Log::follow(stderr, move |line| {
            if let Some(told) = told(line) {
                // Nobody listens any more when the source is being dropped.
                let _ = sender.send(told);
            }
        });
        *ffmpeg::lock(&self.child) = Some(Arc::clone(&running));
        self.run = Some(Run { running, stdout, told: told_receiver, log });
        Ok(())
    }

    /// The next frame, `None` at the end of ffmpeg's output.
    fn frame(&mut self, buffer: &mut Vec<u8>) -> Result<Option<Frame>, SourceError> {
        let Some(run) = self.run.as_mut() else { return Ok(None) };
        loop {
            match run.told.recv() {
                Err(_) => return Ok(None),
                Ok(Told::Unit { numerator, denominator, fps }) => {
                    self.clock.set_unit(numerator, denominator, fps);
                    if self.queue.fps().is_none() {
                        self.queue.set_fps(fps);
                    }
                }
                Ok(Told::Frame { pts, width, height }) => {
                    let (w, h) = (width as u64, height as u64);
                    if w.saturating_mul(h) > self.max_pixels {
                        let (name, limit) = (self.name.clone(), self.max_pixels);
                        return Err(SourceError::TooLarge { name, width: w, height: h, limit });
                    }
                    buffer.resize(width * height * 3, 0);
                    if run.stdout.read_exact(buffer).is_err() {
                        return Ok(None);
                    }
                    let stamp =
                        if self.live { self.clock.arrival() } else { self.clock.stamp(pts) };
                    let data = std::mem::take(buffer);
                    let frame = Frame::rgb8(stamp, width as u32, height as u32, data);
                    return frame.map(Some).map_err(|e| self.failed(e.to_string()));
                }
            }
        }
    }

    fn failed(&self, message: String) -> SourceError {
        FfmpegError::Failed { subject: self.name.clone(), message }.into()
    }

    /// Ends the run: `Some` when ffmpeg has something to complain about.
    fn end(&mut self) -> Option<SourceError> {
        let Run { running, stdout, told, mut log } = self.run.take()?;
        // A closed pipe ends an ffmpeg that still writes.
        drop((stdout, told));
        let status = running.wait(FAREWELL);
        log.finish();
        if self.queue.is_stopped() {
            return None;
        }
        let good = status.is_ok_and(|s| s.success());
        if good && (self.live || log.errors().is_none()) && self.index > 0 {
            return None;
        }
        let message = log.last_words();
        Some(match (self.index, good) {
            (0, true) if log.errors().is_none() => SourceError::NoVideo { name: self.name.clone() },
            (0, _) if message.contains("matches no streams") => {
                SourceError::NoVideo { name: self.name.clone() }
            }
            (0, _) => self.failed(message),
            (frames, _) => SourceError::Damaged { name: self.name.clone(), frames, message },
        })
    }
}

impl Drop for Producer {
    fn drop(&mut self) {
        // A stopper may outlive the source; the child must not.
        *ffmpeg::lock(&self.child) = None;
    }
}

impl Produce for Producer {
    fn next(&mut self, mut spare: Vec<u8>) -> Option<Result<SourceFrame, SourceError>> {
        loop {
            match self.frame(&mut spare) {
                Ok(Some(frame)) => {
                    let index = self.index;
                    self.index += 1;
                    return Some(Ok(SourceFrame { frame, index, name: self.name.clone() }));
                }
                Err(error) => {
                    self.run = None;
                    return Some(Err(error));
                }
                Ok(None) => {
                    let error = self.end()?;
                    let unknown = error.to_string().contains("fps_mode");
                    if !(unknown && self.index == 0 && !self.old_option) {
                        return Some(Err(error));
                    }
                    self.old_option = true;
                    if let Err(error) = self.spawn() {
                        return Some(Err(error));
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_showinfo_are_read() {
        let unit =
            told("[Parsed_showinfo_1 @ 0x5646] [info] config in time_base: 1/25, frame_rate: 25/1");
        assert_eq!(unit, Some(Told::Unit { numerator: 1, denominator: 25, fps: Some(25.0) }));
        let frame = told(
            "[Parsed_showinfo_1 @ 0x56] [info] n:   7 pts:     -7 pts_time:-0.28    pos:   335783 \
             fmt:rgb24 sar:1/1 s:1280x720 i:P iskey:0 type:P ",
        );
        assert_eq!(frame, Some(Told::Frame { pts: Some(-7), width: 1280, height: 720 }));
        let blind =
            told("[Parsed_showinfo_1 @ 0x56] [info] n:   0 pts: NOPTS pts_time:NOPTS s:2x4 i:P");
        assert_eq!(blind, Some(Told::Frame { pts: None, width: 2, height: 4 }));
        for other in [
            "",
            "[info] n: 0 pts: 1 s:2x4",
            "[Parsed_showinfo_1 @ 0x56] [info] color_range:pc",
            "[Parsed_showinfo_1 @ 0x56] [info] n: 1 pts: 1 s:axb",
            "[Parsed_showinfo_1 @ 0x56] [info] config in time_base: 0/0, frame_rate: 0/0",
            "[Parsed_showinfo_1 @ 0x56] [info] config out time_base: 0/0, frame_rate: 0/0",
        ] {
            assert_eq!(told(other), None, "{other}");
        }
    }

    #[test]
    fn stamps_start_at_zero_and_do_not_drift() {
        let mut clock =
            Clock { numerator: 1001, denominator: 30000, fps: Some(29.97), ..Clock::default() };
        assert_eq!(clock.stamp(Some(100)), Stamp::ZERO);
        assert_eq!(clock.stamp(Some(100 + 30000)).nanos(), 1_001_000_000_000);
        let next = clock.stamp(None);
        assert_eq!(next.nanos(), 1_001_033_366_700);
        assert_eq!(clock.stamp(Some(99)).nanos(), -33_366_667);
        assert_eq!(clock.stamp(Some(i64::MAX)).nanos(), i64::MAX);
        // The same moment in another unit.
        clock.set_unit(1001, 60000, None);
        assert_eq!(clock.stamp(Some(2 * 30100)).nanos(), 1_001_000_000_000);
    }

    #[test]
    fn arrival_never_goes_back() {
        let mut clock = Clock { last: Some(Stamp::from_nanos(i64::MAX - 2)), ..Clock::default() };
        assert_eq!(clock.arrival().nanos(), i64::MAX - 1);
    }

    #[test]
    fn ffprobe_answers() {
        let json = br#"{"streams":[{"avg_frame_rate":"25/1","nb_frames":"38","duration":"1.52"}]}"#;
        assert_eq!(read_facts(json), Some(Facts { fps: Some(25.0), frames: Some(38) }));
        let json =
            br#"{"streams":[{"avg_frame_rate":"30000/1001"}],"format":{"duration":"10.01"}}"#;
        assert_eq!(read_facts(json).unwrap().frames, Some(300));
        let json = br#"{"streams":[{"avg_frame_rate":"0/0"}],"format":{}}"#;
        assert_eq!(read_facts(json), Some(Facts::default()));
        assert_eq!(read_facts(br#"{"streams":[],"format":{}}"#), None);
        assert_eq!(read_facts(b"rubbish"), None);
    }

    #[test]
    fn addresses_of_files_are_not_live() {
        assert!(is_file_address("https://example.org/a/b.MP4?x=1"));
        assert!(!is_file_address("http://camera/stream.mjpg"));
        assert!(!is_file_address("http://camera/live.m3u8"));
        assert!(!is_file_address("rtsp://camera/b.mp4"));
    }
}
