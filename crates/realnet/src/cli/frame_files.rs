//! Frames that were drawn on, as files: pictures under their own names,
//! everything else as one video.

use super::failure::bad_input;
use anyhow::Result;
use realnet::{
    Frame, picture,
    source::{Source, SourceKind},
    video::VideoWriter,
};
use std::{
    cell::OnceCell,
    collections::HashSet,
    path::{Path, PathBuf},
};

/// The names of a run's results, one a frame; and those that no result may have.
pub(crate) struct FrameNames {
    /// A video's name without extension, when the source is no set of pictures.
    moving: Option<String>,
    used: HashSet<String>,
    /// The files of the source, and where they really are, once that is asked.
    inputs: Vec<PathBuf>,
    real_inputs: OnceCell<HashSet<PathBuf>>,
}

impl FrameNames {
    /// Names for the frames of a source. No picture's result gets one of the
    /// `reserved` names.
    pub(crate) fn new(source: &Source, reserved: &[&str]) -> Self {
        let moving = match source.kind() {
            SourceKind::Picture | SourceKind::Pictures => None,
            SourceKind::Video => Some(stem(source.name())),
            SourceKind::Stream => Some("stream".to_owned()),
            SourceKind::Camera => Some("camera".to_owned()),
        };
        Self {
            moving,
            used: reserved.iter().map(|name| (*name).to_owned()).collect(),
            inputs: source.files().to_vec(),
            real_inputs: OnceCell::new(),
        }
    }

    /// Refuses to write a result over a file of the source, read already or not.
    pub(crate) fn keep_inputs(&self, output: &Path) -> Result<()> {
        // What is not there replaces nothing.
        let Ok(output) = output.canonicalize() else { return Ok(()) };
        let real = || self.inputs.iter().filter_map(|input| input.canonicalize().ok()).collect();
        if self.real_inputs.get_or_init(real).contains(&output) {
            return Err(bad_input(format!("the input {} would be overwritten", output.display())));
        }
        Ok(())
    }

    /// True when the frames are those of a video, stream or camera.
    pub(crate) fn is_moving(&self) -> bool {
        self.moving.is_some()
    }

    /// The name, without extension, of the results of frame `index` from `source`.
    /// No other frame of this run gets it: pictures of two folders may be called
    /// alike. Ask once for each frame.
    pub(crate) fn of(&mut self, index: u64, source: &str) -> String {
        if let Some(moving) = &self.moving {
            return format!("{moving}_{index:06}");
        }
        let name = stem(source);
        let mut own = name.clone();
        let mut number = 2;
        while !self.used.insert(own.clone()) {
            own = format!("{name}-{number}");
            number += 1;
        }
        own
    }
}

/// Writes frames into one folder, as they come.
pub(crate) struct FrameFiles {
    folder: PathBuf,
    video: Option<VideoWriter>,
}

impl FrameFiles {
    /// Files in `folder`, which must exist.
    pub(crate) fn new(folder: &Path) -> Self {
        Self { folder: folder.to_path_buf(), video: None }
    }

    /// Saves one frame from `source`: as the picture `own`, or in the video.
    pub(crate) fn write(
        &mut self,
        names: &FrameNames,
        own: &str,
        source: &str,
        frame: &Frame,
        fps: Option<f64>,
    ) -> Result<()> {
        let source = Path::new(source);
        let Some(moving) = &names.moving else {
            let extension = source.extension().filter(|_| picture::has_picture_extension(source));
            let extension = extension.unwrap_or("jpg".as_ref());
            let path = self.folder.join(own).with_added_extension(extension);
            names.keep_inputs(&path)?;
            return Ok(picture::write(&path, frame)?);
        };
        let video = match &mut self.video {
            Some(video) => video,
            None => {
                let path = self.folder.join(format!("{moving}.mp4"));
                names.keep_inputs(&path)?;
                let (width, height) = (frame.width(), frame.height());
                let fps = fps.unwrap_or(30.0);
                self.video.insert(VideoWriter::create(&path, width, height, fps)?)
            }
        };
        Ok(video.write(frame)?)
    }

    /// Saves a picture that is no frame.
    pub(crate) fn write_extra(
        &self,
        names: &FrameNames,
        name: &str,
        picture: &Frame,
    ) -> Result<()> {
        let path = self.folder.join(name);
        names.keep_inputs(&path)?;
        Ok(picture::write(&path, picture)?)
    }

    /// Closes what is open.
    pub(crate) fn finish(self) -> Result<()> {
        match self.video {
            Some(video) => Ok(video.finish()?),
            None => Ok(()),
        }
    }
}

fn stem(name: &str) -> String {
    let stem = Path::new(name).file_stem().unwrap_or("frame".as_ref());
    stem.to_string_lossy().into_owned()
}
