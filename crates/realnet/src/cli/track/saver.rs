//! What `realnet track --save` leaves on disk.

use super::super::{detect::make_directory, failure::keep_input};
use anyhow::Result;
use realnet::{
    Frame, picture,
    source::{Source, SourceFrame, SourceKind},
    video::VideoWriter,
};
use std::{
    collections::HashSet,
    path::{Path, PathBuf},
};

/// The picture of one pair.
const BEFORE_AFTER: &str = "before_after";

/// Writes as the frames come: pictures under their own names, everything else as
/// one video.
pub(super) struct Saver {
    folder: PathBuf,
    video: Option<VideoWriter>,
    /// A video's name without extension, when the source is no set of pictures.
    moving: Option<String>,
    used: HashSet<String>,
}

impl Saver {
    pub(super) fn new(folder: &Path, source: &Source) -> Result<Self> {
        make_directory(folder)?;
        let moving = match source.kind() {
            SourceKind::Picture | SourceKind::Pictures => None,
            SourceKind::Video => Some(stem(source.name())),
            SourceKind::Stream => Some("stream".to_owned()),
            SourceKind::Camera => Some("camera".to_owned()),
        };
        let used = HashSet::from([BEFORE_AFTER.to_owned()]);
        Ok(Self { folder: folder.to_path_buf(), video: None, moving, used })
    }

    /// Saves one frame that was drawn on.
    pub(super) fn write(&mut self, shot: &SourceFrame, fps: Option<f64>) -> Result<()> {
        let SourceFrame { frame, name, .. } = shot;
        let source = Path::new(name);
        let Some(moving) = &self.moving else {
            let extension = source.extension().filter(|_| picture::has_picture_extension(source));
            let own = self.unused(stem(name));
            let path =
                self.folder.join(own).with_added_extension(extension.unwrap_or("jpg".as_ref()));
            keep_input(&path, source)?;
            return Ok(picture::write(&path, frame)?);
        };
        let video = match &mut self.video {
            Some(video) => video,
            None => {
                let path = self.folder.join(format!("{moving}.mp4"));
                keep_input(&path, source)?;
                let (width, height) = (frame.width(), frame.height());
                let fps = fps.unwrap_or(30.0);
                self.video.insert(VideoWriter::create(&path, width, height, fps)?)
            }
        };
        Ok(video.write(frame)?)
    }

    /// Saves the picture of a pair.
    pub(super) fn before_after(&self, picture: &Frame) -> Result<()> {
        let path = self.folder.join(BEFORE_AFTER).with_added_extension("jpg");
        Ok(picture::write(&path, picture)?)
    }

    /// A name that no other picture of this run has.
    fn unused(&mut self, name: String) -> String {
        let mut own = name.clone();
        let mut number = 2;
        while !self.used.insert(own.clone()) {
            own = format!("{name}-{number}");
            number += 1;
        }
        own
    }

    /// Closes what is open, and saves `pair` if there is one.
    pub(super) fn finish(self, pair: Option<Frame>) -> Result<()> {
        let pair = pair.map_or(Ok(()), |picture| self.before_after(&picture));
        if let Some(video) = self.video {
            video.finish()?;
        }
        pair
    }
}

fn stem(name: &str) -> String {
    let stem = Path::new(name).file_stem().unwrap_or("frame".as_ref());
    stem.to_string_lossy().into_owned()
}
