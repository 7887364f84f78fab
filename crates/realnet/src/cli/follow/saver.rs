//! What `realnet follow --save` leaves on disk.

use super::record::{command_text, range_text};
use crate::cli::detect::make_directory;
use crate::cli::frame_files::{FrameFiles, FrameNames};
use anyhow::Result;
use realnet::annotate::{Annotator, class_color};
use realnet::pipeline::Step;
use realnet::source::{Source, SourceFrame};
use realnet::{Detection, Frame};
use std::path::Path;

/// Other objects than the target.
const OTHERS: [u8; 3] = [150, 150, 150];

/// Writes as the frames come.
pub(super) struct Saver {
    names: FrameNames,
    files: FrameFiles,
    annotator: Annotator,
}

impl Saver {
    pub(super) fn new(folder: &Path, source: &Source) -> Result<Self> {
        make_directory(folder)?;
        Ok(Self {
            names: FrameNames::new(source, &[]),
            files: FrameFiles::new(folder),
            annotator: Annotator::new(Vec::new())?,
        })
    }

    /// Draws on a frame and saves it.
    pub(super) fn save(
        &mut self,
        shot: &mut SourceFrame,
        step: &Step,
        class: Option<&Detection>,
        name: &str,
        fps: Option<f64>,
    ) -> Result<()> {
        self.draw(&mut shot.frame, step, class, name);
        let own = self.names.of(shot.index, &shot.name);
        self.files.write(&self.names, &own, &shot.name, &shot.frame, fps)
    }

    fn draw(&self, frame: &mut Frame, step: &Step, class: Option<&Detection>, name: &str) {
        for other in step.detections.iter().filter(|other| Some(*other) != class) {
            self.annotator.draw_box(frame, &other.bbox, OTHERS, "");
        }
        if let Some(at) = step.report.target {
            let label = format!("{name} {}", range_text(step));
            let color = class_color(class.map_or(0, |found| found.class_id));
            self.annotator.draw_box(frame, &at.bbox, color, label.trim());
        }
        let caption = format!("{}   {}", step.report.status, command_text(step));
        self.annotator.draw_caption(frame, &caption);
    }

    /// Closes what is open.
    pub(super) fn finish(self) -> Result<()> {
        self.files.finish()
    }
}
