//! Annotated video, written through an installed ffmpeg.
//!
//! The result is an MP4 that plays everywhere: H.264 (`libx264`, 4:2:0) where
//! the installed ffmpeg has it, MPEG-4 part 2 otherwise.

use crate::atomic::{Pending, WriteError};
use crate::ffmpeg::{self, FfmpegError, Log, Running};
use realnet_core::{Frame, PixelFormat};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Stdio};
use std::time::Duration;
use thiserror::Error;

/// How long ffmpeg may take to encode what it has buffered and to move the index
/// of a very long video to its front.
const FAREWELL: Duration = Duration::from_secs(1800);

/// Why a video could not be written.
#[derive(Debug, Error)]
pub enum VideoError {
    /// ffmpeg is missing or failed.
    #[error(transparent)]
    Ffmpeg(#[from] FfmpegError),
    /// The file could not be created or renamed.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// A frame rate that is not a positive number.
    #[error("{}: a frame rate of {fps} frames a second is not possible", path.display())]
    Fps {
        /// The video.
        path: PathBuf,
        /// The value.
        fps: f64,
    },
    /// A frame of another size than the first one.
    #[error(
        "{}: a frame of {found_width}x{found_height} pixels in a video of {width}x{height}",
        path.display()
    )]
    Size {
        /// The video.
        path: PathBuf,
        /// Pixels a row of the video.
        width: u32,
        /// Rows of the video.
        height: u32,
        /// Pixels a row of the frame.
        found_width: u32,
        /// Rows of the frame.
        found_height: u32,
    },
}

/// Writes frames to an MP4 file. The file gets its name in
/// [`VideoWriter::finish`]; a writer that is dropped before does the same and
/// keeps silent about errors.
#[derive(Debug)]
pub struct VideoWriter {
    path: PathBuf,
    size: (u32, u32),
    frames: u64,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    stdin: ChildStdin,
    running: Running,
    log: Log,
    pending: Pending,
}

impl VideoWriter {
    /// Starts a video of `width` x `height` pixels (odd sides are padded by one
    /// black row or column) at `fps` frames a second, by the `ffmpeg` in `PATH`.
    ///
    /// # Errors
    /// [`VideoError`]: no ffmpeg, an unwritable folder, an impossible rate.
    pub fn create(path: &Path, width: u32, height: u32, fps: f64) -> Result<Self, VideoError> {
        Self::create_with(Path::new("ffmpeg"), path, width, height, fps)
    }

    /// As [`VideoWriter::create`], with the ffmpeg program to use.
    ///
    /// # Errors
    /// As [`VideoWriter::create`].
    pub fn create_with(
        program: &Path,
        path: &Path,
        width: u32,
        height: u32,
        fps: f64,
    ) -> Result<Self, VideoError> {
        if !(fps.is_finite() && fps > 0.0) {
            return Err(VideoError::Fps { path: path.to_path_buf(), fps });
        }
        let pending = Pending::new(path)?;
        let codec: &[&str] = if has_x264(program)? {
            &["-c:v", "libx264", "-preset", "veryfast", "-crf", "20"]
        } else {
            &["-c:v", "mpeg4", "-q:v", "3"]
        };
        let mut child = ffmpeg::command(program)
            .args(["-hide_banner", "-nostats", "-loglevel", "level+warning", "-y"])
            .args(["-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-video_size", &format!("{width}x{height}"), "-framerate", &fps.to_string()])
            .args(["-i", "pipe:0", "-an"])
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"])
            .args(codec)
            .args(["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"])
            .arg(ffmpeg::file_url(pending.path()))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|e| ffmpeg::start_error(program, e))?;
        let pipes = (child.stdin.take(), child.stderr.take());
        let running = Running::new(child);
        let (Some(stdin), Some(stderr)) = pipes else {
            let reason = std::io::Error::other("no pipe to the program");
            return Err(ffmpeg::start_error(program, reason).into());
        };
        let open = Some(Open { stdin, running, log: Log::follow(stderr, |_| {}), pending });
        Ok(Self { path: path.to_path_buf(), size: (width, height), frames: 0, open })
    }

    /// Appends a frame; a grey one becomes RGB.
    ///
    /// # Errors
    /// [`VideoError::Size`] for a frame of another size (the video goes on), or
    /// [`VideoError::Ffmpeg`] with the last words of ffmpeg when it has ended.
    pub fn write(&mut self, frame: &Frame) -> Result<(), VideoError> {
        let (width, height) = self.size;
        if (frame.width(), frame.height()) != self.size {
            let (path, found_width, found_height) =
                (self.path.clone(), frame.width(), frame.height());
            return Err(VideoError::Size { path, width, height, found_width, found_height });
        }
        let Some(open) = self.open.as_mut() else {
            return Err(failed(&self.path, "the writer has ended after an error".into()).into());
        };
        let written = match frame.format() {
            PixelFormat::Rgb8 => open.stdin.write_all(frame.data()),
            PixelFormat::Grey8 => open.stdin.write_all(frame.to_rgb().data()),
        };
        match written {
            Ok(()) => {
                self.frames += 1;
                Ok(())
            }
            // The pipe is closed: what ffmpeg said is the reason.
            Err(error) => Err(self.close().err().unwrap_or_else(|| {
                failed(&self.path, format!("ffmpeg takes no more frames: {error}")).into()
            })),
        }
    }

    /// Waits until everything is encoded and gives the file its name.
    ///
    /// # Errors
    /// [`VideoError`] when ffmpeg failed (also: no frame was written) or the
    /// file cannot be renamed; nothing is left behind then.
    pub fn finish(mut self) -> Result<(), VideoError> {
        self.close()
    }

    fn close(&mut self) -> Result<(), VideoError> {
        let Some(Open { stdin, running, mut log, pending }) = self.open.take() else {
            return Ok(());
        };
        drop(stdin);
        let status = running.wait(FAREWELL);
        log.finish();
        match status {
            // A video without frames is no video, even if ffmpeg writes a header.
            Ok(status) if status.success() && self.frames == 0 => {
                Err(failed(&self.path, "no frame was written".into()).into())
            }
            Ok(status) if status.success() => Ok(pending.commit()?),
            Ok(_) => Err(failed(&self.path, log.last_words()).into()),
            Err(error) => Err(failed(&self.path, error.to_string()).into()),
        }
    }
}

impl Drop for VideoWriter {
    fn drop(&mut self) {
        // Who wants to know calls `finish`.
        let _ = self.close();
    }
}

fn failed(path: &Path, message: String) -> FfmpegError {
    FfmpegError::Failed { subject: path.display().to_string(), message }
}

/// True when this ffmpeg can encode H.264 by libx264.
fn has_x264(program: &Path) -> Result<bool, FfmpegError> {
    let output = ffmpeg::command(program)
        .args(["-hide_banner", "-v", "error", "-encoders"])
        .output()
        .map_err(|e| ffmpeg::start_error(program, e))?;
    Ok(String::from_utf8_lossy(&output.stdout).contains(" libx264 "))
}
