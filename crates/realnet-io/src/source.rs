//! One iterator over every kind of frame source.
//!
//! | specification | what |
//! |---|---|
//! | `bus.jpg` | one picture |
//! | `frames/`, `frames/*.png` | pictures in natural order |
//! | `drive.mp4` | a video file, through an installed ffmpeg |
//! | `rtsp://…`, `http://…`, `udp://…` | a stream, through an installed ffmpeg |
//! | `/dev/video0`, `0` | a camera (cargo feature `v4l`) |
//!
//! A thread decodes ahead. Pictures and video files wait for the taker and lose
//! nothing; live sources keep only the newest frame and count what they drop.
//!
//! ```no_run
//! use realnet_io::source::{SourceOptions, open};
//!
//! for item in open("frames/", &SourceOptions::default())? {
//!     match item {
//!         Ok(item) => drop((item.index, item.name, item.frame.stamp())),
//!         Err(error) => drop(error), // this picture only; the next ones still come
//!     }
//! }
//! # Ok::<(), realnet_io::source::SourceError>(())
//! ```

#[cfg(all(feature = "v4l", target_os = "linux"))]
mod camera;
mod pictures;
mod queue;
mod stream;

use crate::picture::{self, Limits, PictureError};
use queue::{Queue, Taken};
use realnet_core::{Frame, Stamp};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use thiserror::Error;

pub use crate::ffmpeg::FfmpegError;

/// Why a source does not open or gives no frame.
#[derive(Debug, Error)]
pub enum SourceError {
    /// Nothing has this name.
    #[error("{spec}: no such file, folder or camera")]
    NotFound {
        /// The specification.
        spec: String,
    },
    /// A file without bytes.
    #[error("{}: the file is empty", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A file that cannot be opened.
    #[error("cannot read {}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        reason: io::Error,
    },
    /// A folder that cannot be listed.
    #[error("cannot list the folder {}: {reason}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the operating system said.
        reason: io::Error,
    },
    /// A folder or glob without pictures.
    #[error("{spec}: no .jpg, .jpeg or .png files")]
    NoPictures {
        /// The specification.
        spec: String,
    },
    /// A glob with a mistake, or a folder under it that cannot be listed.
    #[error("{pattern}: {reason}")]
    Glob {
        /// The pattern.
        pattern: String,
        /// What is wrong.
        reason: String,
    },
    /// A frame rate that is not a positive number.
    #[error("a frame rate of {fps} frames a second is not possible")]
    Fps {
        /// The value.
        fps: f64,
    },
    /// A picture that cannot be read.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// A file in which ffmpeg finds no video.
    #[error("{name}: no video stream")]
    NoVideo {
        /// The file or address.
        name: String,
    },
    /// A video frame larger than [`Limits::max_pixels`].
    #[error("{name}: frames of {width}x{height} pixels exceed the limit of {limit} pixels")]
    TooLarge {
        /// The file or address.
        name: String,
        /// Pixels a row.
        width: u64,
        /// Rows.
        height: u64,
        /// The limit.
        limit: u64,
    },
    /// ffmpeg is missing or failed.
    #[error(transparent)]
    Ffmpeg(#[from] FfmpegError),
    /// A video that ended early or with damaged parts; the frames before this
    /// error are good.
    #[error("{name}: damaged or truncated, {frames} frames were decoded: {message}")]
    Damaged {
        /// The file or address.
        name: String,
        /// Frames delivered.
        frames: u64,
        /// The last words of ffmpeg.
        message: String,
    },
    /// A live source that gave nothing for too long.
    #[error("{name}: no frame for {seconds} s")]
    Stalled {
        /// The camera or address.
        name: String,
        /// How long was waited.
        seconds: f64,
    },
    /// A camera, but this program was built without camera support.
    #[error(
        "{name}: cameras need a Linux build with the cargo feature `v4l` \
         (cargo build --release --features v4l)"
    )]
    NoCameraSupport {
        /// The camera.
        name: String,
    },
    /// A camera that fails or cannot do what was asked.
    #[error("{name}: {message}")]
    Camera {
        /// The camera.
        name: String,
        /// What is wrong, with the sizes on offer where that matters.
        message: String,
    },
    /// A defect of this program or of a decoder.
    #[error("{name}: the decoding thread ended unexpectedly")]
    Thread {
        /// The source.
        name: String,
    },
}

/// How a source is to be opened.
#[derive(Clone, Debug)]
pub struct SourceOptions {
    /// Frames a second: stamps of pictures (30 when `None`), and the rate asked
    /// of a camera (its own choice when `None`). Video has its own stamps.
    pub fps: Option<f64>,
    /// Width and height asked of a camera; `None` leaves the choice to it.
    pub size: Option<(u32, u32)>,
    /// Whether stale frames are dropped. `None`: streams and cameras drop,
    /// files never. `Some(true)` on a video file plays it at its own speed as if
    /// it were a camera; `Some(false)` on a stream keeps every frame. Pictures
    /// are never live.
    pub live: Option<bool>,
    /// Frames decoded ahead of the taker; default 4.
    pub ahead: usize,
    /// How long a live source may be silent before that is an error; default
    /// 15 s, `None` waits for ever.
    pub patience: Option<Duration>,
    /// Size limits of pictures and video frames.
    pub limits: Limits,
    /// The ffmpeg program; default `ffmpeg`, found through `PATH`.
    pub ffmpeg: PathBuf,
    /// The ffprobe program; default `ffprobe`. Without it a video has no known
    /// length.
    pub ffprobe: PathBuf,
}

impl Default for SourceOptions {
    fn default() -> Self {
        Self {
            fps: None,
            size: None,
            live: None,
            ahead: 4,
            patience: Some(Duration::from_secs(15)),
            limits: Limits::default(),
            ffmpeg: "ffmpeg".into(),
            ffprobe: "ffprobe".into(),
        }
    }
}

/// One frame of a source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceFrame {
    /// The picture, RGB, with its stamp:
    /// pictures count from 0 by [`SourceOptions::fps`]; video files carry their
    /// presentation time, 0 at the first frame; live streams the Unix time of
    /// arrival (exposure was earlier by the unknown delay of the stream);
    /// cameras the Unix time of the driver's capture stamp.
    pub frame: Frame,
    /// Number of the frame in its source, from 0. Live sources count the
    /// dropped frames too, so gaps show; unreadable pictures keep their number.
    pub index: u64,
    /// The picture's path, or the source's specification.
    pub name: String,
}

/// What a source is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceKind {
    /// Exactly one picture file.
    Picture,
    /// A folder or glob of pictures.
    Pictures,
    /// A video file.
    Video,
    /// A network stream.
    Stream,
    /// A camera device.
    Camera,
}

/// Makes frames, on a thread of its own.
trait Produce: Send {
    /// The next frame, in the memory of `spare` if possible. After `None`
    /// it is not called again.
    fn next(&mut self, spare: Vec<u8>) -> Option<Result<SourceFrame, SourceError>>;
}

/// Frees a producer that waits for the outside world.
type Release = Arc<dyn Fn() + Send + Sync>;

/// Ends a [`Source`] from another thread, such as a Ctrl-C handler.
#[derive(Clone)]
pub struct Stopper {
    queue: Arc<Queue>,
    release: Release,
}

impl Stopper {
    /// The source gives no frame any more; a waiting `next` returns at once.
    pub fn stop(&self) {
        self.queue.stop();
        (self.release)();
    }
}

/// An open source: an iterator of frames. Dropping it ends its thread and its
/// child process.
pub struct Source {
    kind: SourceKind,
    name: String,
    live: bool,
    length: Option<u64>,
    files: Arc<[PathBuf]>,
    patience: Option<Duration>,
    stopper: Stopper,
    thread: Option<JoinHandle<()>>,
}

impl Source {
    fn start(
        kind: SourceKind,
        name: String,
        live: bool,
        length: Option<u64>,
        options: &SourceOptions,
        (queue, release): (Arc<Queue>, Release),
        mut producer: Box<dyn Produce>,
    ) -> Result<Self, SourceError> {
        /// Tells the taker that nothing more comes, also after a panic.
        struct Finish(Arc<Queue>);
        impl Drop for Finish {
            fn drop(&mut self) {
                self.0.finish(std::thread::panicking());
            }
        }
        let shared = Arc::clone(&queue);
        let thread = std::thread::Builder::new().name("realnet-source".into()).spawn(move || {
            let end = Finish(shared);
            while !end.0.is_stopped() {
                let Some(item) = producer.next(end.0.spare()) else { break };
                if !end.0.push(item) {
                    break;
                }
            }
        });
        let thread =
            Some(thread.map_err(|reason| SourceError::File { path: name.clone().into(), reason })?);
        let patience = if live { options.patience } else { None };
        let stopper = Stopper { queue, release };
        let files = Arc::default();
        Ok(Self { kind, name, live, length, files, patience, stopper, thread })
    }

    /// What the source is.
    #[must_use]
    pub fn kind(&self) -> SourceKind {
        self.kind
    }

    /// The specification it was opened with.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The files it reads: the pictures in their order, or the video. None for
    /// streams and cameras.
    #[must_use]
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// True when stale frames are dropped.
    #[must_use]
    pub fn is_live(&self) -> bool {
        self.live
    }

    /// Frames to be expected in all, for a progress bar: exact for pictures, as
    /// the container says (or duration times rate) for video files.
    #[must_use]
    pub fn len_hint(&self) -> Option<u64> {
        self.length
    }

    /// Frames a second: the option for pictures, the average rate of a video,
    /// the rate of a stream once its first frame is there.
    #[must_use]
    pub fn fps(&self) -> Option<f64> {
        self.stopper.queue.fps()
    }

    /// Stale frames that a live source has dropped so far.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.stopper.queue.dropped()
    }

    /// Gives the memory of a used frame back.
    pub fn recycle(&self, frame: Frame) {
        self.stopper.queue.recycle(frame.into_data());
    }

    /// A handle that ends this source from another thread.
    #[must_use]
    pub fn stopper(&self) -> Stopper {
        self.stopper.clone()
    }
}

impl Iterator for Source {
    type Item = Result<SourceFrame, SourceError>;

    /// Waits for the next frame. An error of one picture is followed by the
    /// other pictures; after an error of a video, stream or camera comes `None`.
    fn next(&mut self) -> Option<Self::Item> {
        let name = || self.name.clone();
        match self.stopper.queue.take(self.patience) {
            Taken::Item(item) => Some(item),
            Taken::End => None,
            Taken::Panicked => Some(Err(SourceError::Thread { name: name() })),
            Taken::Late => {
                self.stopper.stop();
                let seconds = self.patience.unwrap_or_default().as_secs_f64();
                Some(Err(SourceError::Stalled { name: name(), seconds }))
            }
        }
    }
}

impl Drop for Source {
    fn drop(&mut self) {
        self.stopper.stop();
        if let Some(thread) = self.thread.take() {
            // A panic was reported by `next`, or nobody is interested in it.
            let _ = thread.join();
        }
    }
}

/// Opens the source that `spec` names, see the table at the top of this module.
/// A name of digits is a camera; a file of that name is `./0`.
///
/// # Errors
/// [`SourceError`]: nothing of that name, an empty or unreadable file, a folder
/// without pictures, no video in it, no ffmpeg, no camera support.
pub fn open(spec: &str, options: &SourceOptions) -> Result<Source, SourceError> {
    if let Some(fps) = options.fps
        && !(fps.is_finite() && fps > 0.0)
    {
        return Err(SourceError::Fps { fps });
    }
    if let Some(path) = spec.strip_prefix("file://") {
        return open_path(spec, Path::new(path), options);
    }
    if spec.contains("://") {
        return stream::open(spec, None, options);
    }
    let digits = !spec.is_empty() && spec.bytes().all(|b| b.is_ascii_digit());
    if digits || spec.starts_with("/dev/video") {
        let device = if digits { format!("/dev/video{spec}") } else { spec.to_string() };
        return open_camera(&device, options);
    }
    open_path(spec, Path::new(spec), options)
}

fn open_path(spec: &str, path: &Path, options: &SourceOptions) -> Result<Source, SourceError> {
    let meta = match std::fs::metadata(path) {
        Ok(meta) => meta,
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            return if spec.contains(['*', '?', '[']) {
                open_pictures(SourceKind::Pictures, spec, pictures::of_glob(spec)?, options)
            } else {
                Err(SourceError::NotFound { spec: spec.to_string() })
            };
        }
        Err(reason) => return Err(SourceError::File { path: path.to_path_buf(), reason }),
    };
    if meta.is_dir() {
        let found = pictures::in_folder(path)?;
        return open_pictures(SourceKind::Pictures, spec, found, options);
    }
    if meta.is_file() && meta.len() == 0 {
        return Err(SourceError::Empty { path: path.to_path_buf() });
    }
    if picture::has_picture_extension(path) || (meta.is_file() && starts_like_a_picture(path)?) {
        return open_pictures(SourceKind::Picture, spec, vec![path.to_path_buf()], options);
    }
    stream::open(spec, Some(path), options)
}

fn starts_like_a_picture(path: &Path) -> Result<bool, SourceError> {
    let failed = |reason| SourceError::File { path: path.to_path_buf(), reason };
    let mut head = Vec::new();
    std::fs::File::open(path).map_err(failed)?.take(8).read_to_end(&mut head).map_err(failed)?;
    Ok(head.starts_with(&[0xff, 0xd8, 0xff]) || head == b"\x89PNG\r\n\x1a\n")
}

fn open_pictures(
    kind: SourceKind,
    spec: &str,
    paths: Vec<PathBuf>,
    options: &SourceOptions,
) -> Result<Source, SourceError> {
    let fps = options.fps.unwrap_or(30.0);
    let queue = Arc::new(Queue::new(options.ahead, false));
    queue.set_fps(Some(fps));
    let length = Some(paths.len() as u64);
    let files: Arc<[PathBuf]> = paths.into();
    let producer = Box::new(pictures::Pictures::new(Arc::clone(&files), options, fps));
    let wiring: (_, Release) = (queue, Arc::new(|| {}));
    let mut source =
        Source::start(kind, spec.to_string(), false, length, options, wiring, producer)?;
    source.files = files;
    Ok(source)
}

#[cfg(all(feature = "v4l", target_os = "linux"))]
fn open_camera(device: &str, options: &SourceOptions) -> Result<Source, SourceError> {
    camera::open(device, options)
}

#[cfg(not(all(feature = "v4l", target_os = "linux")))]
fn open_camera(device: &str, _: &SourceOptions) -> Result<Source, SourceError> {
    Err(SourceError::NoCameraSupport { name: device.to_string() })
}

/// The Unix time now. A clock before 1970 reads as 1970.
fn unix_now() -> Stamp {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Stamp::from_nanos(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}
