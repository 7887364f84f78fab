//! The video of a run: what the camera saw, what was made of it, and where all were.

mod inset;

use super::table::number;
use anyhow::Result;
use inset::Inset;
use realnet::{BoundingBox, Frame, annotate::Annotator, video::VideoWriter};
use realnet_core::TrackStatus;
use realnet_sim::{FrameLog, RunLog};
use std::path::Path;

/// Colours of Okabe and Ito (2008), as in the page's charts.
const GREEN: [u8; 3] = [0, 158, 115];
const AMBER: [u8; 3] = [230, 159, 0];
const RED: [u8; 3] = [213, 94, 0];
const GREY: [u8; 3] = [150; 3];

/// Writes a run as it goes on, or afterwards.
pub(super) struct RunVideo {
    writer: VideoWriter,
    overlay: Overlay,
}

impl RunVideo {
    /// A video of `width` x `height` pixels at `fps` frames a second; see
    /// [`VideoWriter::create`].
    pub(super) fn create(path: &Path, width: u32, height: u32, fps: f64) -> Result<Self> {
        let writer = VideoWriter::create(path, width, height, fps)?;
        Ok(Self { writer, overlay: Overlay::new()? })
    }

    /// Draws on a frame, see [`Overlay::annotate`], and appends it.
    pub(super) fn write(
        &mut self,
        frame: &mut Frame,
        run: &RunLog,
        index: usize,
        bbox: Option<BoundingBox>,
    ) -> Result<()> {
        self.overlay.annotate(frame, run, index, bbox);
        Ok(self.writer.write(frame)?)
    }

    /// Waits until the file is there.
    pub(super) fn finish(self) -> Result<()> {
        Ok(self.writer.finish()?)
    }
}

/// What is drawn on the frames.
pub(super) struct Overlay {
    annotator: Annotator,
}

impl Overlay {
    pub(super) fn new() -> Result<Self> {
        Ok(Self { annotator: Annotator::new(Vec::new())? })
    }

    /// Draws on the frame that `run.frames[index]` is about: `bbox`, the target's box
    /// that the follower goes by, with the fused and the true range; status, speed and
    /// steering of those asked for, gap; a rim with the reason while it is stopped; and all from above,
    /// the follower's nose up. Frames after `index` are not looked at.
    pub(super) fn annotate(
        &self,
        frame: &mut Frame,
        run: &RunLog,
        index: usize,
        bbox: Option<BoundingBox>,
    ) {
        let Some(log) = run.frames.get(index) else { return };
        if let Some(bbox) = bbox {
            self.annotator.draw_box(frame, &bbox, status_color(log.status), &range_words(log));
        }
        if let Some(reason) = log.stop {
            let all = BoundingBox::new(0.0, 0.0, frame.width() as f32, frame.height() as f32);
            self.annotator.draw_box(frame, &all, RED, &format!("stop: {reason}"));
        }
        self.annotator.draw_caption(frame, &caption(log, bbox.is_none()));
        Inset::of(run, index).draw(frame, status_color(log.status));
    }
}

fn status_color(status: TrackStatus) -> [u8; 3] {
    match status {
        TrackStatus::Tracking => GREEN,
        TrackStatus::Coasting => AMBER,
        TrackStatus::Lost => RED,
        TrackStatus::Searching => GREY,
    }
}

/// Fused and true range.
fn range_words(log: &FrameLog) -> String {
    let fused = match (log.range_fused_m, log.range_fused_std_m) {
        (Some(range), Some(std)) => {
            format!("{} ±{} m", number(Some(range), 2), number(Some(std), 2))
        }
        (Some(range), None) => format!("{} m", number(Some(range), 2)),
        (None, _) => "range unknown".to_owned(),
    };
    match log.range_true_m {
        Some(truth) => format!("{fused}, true {}", number(Some(truth), 2)),
        None => fused,
    }
}

/// The line below; with the range, when there is no box to write it on.
fn caption(log: &FrameLog, with_range: bool) -> String {
    let mut text = format!(
        "{:6.2} s  {}  speed {} of {} m/s  steering {}° of {}°  gap {} m",
        log.time_s,
        log.status,
        number(Some(log.speed), 2),
        number(Some(log.speed_command), 2),
        number(Some(log.steering.to_degrees()), 0),
        number(Some(log.steering_command.to_degrees()), 0),
        number(Some(log.gap_m), 2),
    );
    if with_range && log.range_fused_m.is_some() {
        text = format!("{text}  {}", range_words(log));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::report::tests::{keep, plausible};
    use super::*;
    use realnet::Stamp;

    fn grey(width: u32, height: u32) -> Frame {
        let pixels = vec![120; width as usize * height as usize * 3];
        Frame::rgb8(Stamp::ZERO, width, height, pixels).unwrap()
    }

    fn changed(frame: &Frame, [x0, y0, x1, y1]: [usize; 4]) -> usize {
        let rows = frame.data().chunks_exact(frame.stride()).take(y1).skip(y0);
        let pixels =
            |row: &[u8]| row.chunks_exact(3).take(x1).skip(x0).filter(|p| **p != [120; 3]).count();
        rows.map(pixels).sum()
    }

    #[test]
    fn a_frame_says_what_held() {
        let run = plausible();
        let overlay = Overlay::new().unwrap();
        let bbox = BoundingBox::new(250.0, 150.0, 390.0, 260.0);
        let mut tracked = grey(640, 360);
        overlay.annotate(&mut tracked, &run, 300, Some(bbox));
        let at =
            |frame: &Frame, x: usize, y: usize| frame.data()[(y * 640 + x) * 3..][..3].to_vec();
        assert_eq!(at(&tracked, 250, 200), GREEN, "the box is there, in the colour of the status");
        assert!(changed(&tracked, [0, 340, 300, 360]) > 2000, "the caption");
        assert!(changed(&tracked, [480, 0, 640, 140]) > 10_000, "the view from above");
        assert_eq!(changed(&tracked, [0, 0, 240, 330]), 0, "nothing else");
        // Lost and stopped, without a box: a rim.
        let mut stopped = grey(640, 360);
        overlay.annotate(&mut stopped, &run, 452, None);
        assert_eq!(at(&stopped, 0, 200), RED);
        assert_eq!(changed(&stopped, [250, 140, 400, 270]), 0, "no box");
        for (name, frame) in [("tracked.png", &tracked), ("stopped.png", &stopped)] {
            keep(name, |path| realnet::picture::write(path, frame).unwrap());
        }
        // Beyond the end there is nothing to say.
        let mut beyond = grey(64, 36);
        overlay.annotate(&mut beyond, &run, run.frames.len(), None);
        assert_eq!(beyond, grey(64, 36));
    }

    #[test]
    fn words() {
        let mut log = plausible().frames[300];
        (log.range_fused_m, log.range_fused_std_m) = (Some(1.234), Some(0.056));
        log.range_true_m = Some(1.2);
        assert_eq!(range_words(&log), "1.23 ±0.06 m, true 1.20");
        log.range_true_m = None;
        assert_eq!(range_words(&log), "1.23 ±0.06 m");
        log.range_fused_m = None;
        assert_eq!(range_words(&log), "range unknown");
        let log = FrameLog { time_s: 3.5, gap_m: f64::NAN, speed: -0.001, ..FrameLog::default() };
        assert_eq!(
            caption(&log, true),
            "  3.50 s  searching  speed 0.00 of 0.00 m/s  steering 0° of 0°  gap - m"
        );
    }

    #[test]
    fn any_size_and_any_number() {
        let mut run = plausible();
        let overlay = Overlay::new().unwrap();
        for (width, height) in [(1, 1), (33, 7), (160, 120)] {
            overlay.annotate(
                &mut grey(width, height),
                &run,
                100,
                Some([0.0, 0.0, 9.0, 9.0].into()),
            );
        }
        run.frames[100].follower.heading = f64::NAN;
        run.frames[99].target.x = f64::INFINITY;
        overlay.annotate(&mut grey(160, 120), &run, 100, None);
    }

    #[test]
    fn the_file_is_a_video() {
        if std::process::Command::new("ffmpeg").arg("-version").output().is_err() {
            eprintln!("skipped: there is no ffmpeg");
            return;
        }
        let run = plausible();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mp4");
        let mut video = RunVideo::create(&path, 320, 180, 30.0).unwrap();
        for index in 0..5 {
            video.write(&mut grey(320, 180), &run, index, None).unwrap();
        }
        video.finish().unwrap();
        assert!(std::fs::read(&path).unwrap().get(4..8) == Some(b"ftyp"), "an MP4 file");
    }
}
