//! What `realnet track --save` leaves on disk.

use super::super::{
    detect::make_directory,
    frame_files::{FrameFiles, FrameNames},
};
use anyhow::Result;
use realnet::{
    Frame,
    source::{Source, SourceFrame},
};
use std::path::Path;

/// The picture of one pair, without and with its extension.
const BEFORE_AFTER: [&str; 2] = ["before_after", "before_after.jpg"];

/// Writes as the frames come.
pub(super) struct Saver {
    names: FrameNames,
    files: FrameFiles,
}

impl Saver {
    pub(super) fn new(folder: &Path, source: &Source) -> Result<Self> {
        make_directory(folder)?;
        let names = FrameNames::new(source, &BEFORE_AFTER[..1]);
        Ok(Self { names, files: FrameFiles::new(folder) })
    }

    /// Saves one frame that was drawn on.
    pub(super) fn write(&mut self, shot: &SourceFrame, fps: Option<f64>) -> Result<()> {
        let SourceFrame { frame, index, name } = shot;
        let own = self.names.of(*index, name);
        self.files.write(&self.names, &own, name, frame, fps)
    }

    /// Saves the picture of a pair.
    pub(super) fn before_after(&self, picture: &Frame) -> Result<()> {
        self.files.write_extra(&self.names, BEFORE_AFTER[1], picture)
    }

    /// Closes what is open, and saves `pair` if there is one.
    pub(super) fn finish(self, pair: Option<Frame>) -> Result<()> {
        let pair = pair.map_or(Ok(()), |picture| self.before_after(&picture));
        self.files.finish()?;
        pair
    }
}
