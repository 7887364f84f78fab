//! Everything that `realnet detect` leaves on disk.

use super::{super::failure::keep_input, make_directory};
use anyhow::Result;
use clap::Args;
use realnet::{
    Detection, Frame,
    annotate::Annotator,
    picture,
    results::{self, CocoCollector, ImageIds},
    source::{Source, SourceFrame, SourceKind},
    video::VideoWriter,
};
use std::{
    collections::HashSet,
    path::{Path, PathBuf},
};

#[derive(Debug, Args)]
#[command(next_help_heading = "Results")]
pub(crate) struct SaveArgs {
    /// Write annotated pictures, or one annotated video, into this directory.
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,
    /// Write YOLO text into this directory, a file a frame.
    #[arg(long, value_name = "DIR")]
    save_txt: Option<PathBuf>,
    /// With --save-txt: the confidence as a sixth column.
    #[arg(long, requires = "save_txt")]
    save_conf: bool,
    /// Write all boxes as COCO results into this file.
    #[arg(long, value_name = "FILE")]
    save_coco: Option<PathBuf>,
}

/// Writes as the frames come.
pub(super) struct Saver {
    pictures: Option<(PathBuf, Annotator)>,
    video: Option<VideoWriter>,
    texts: Option<(PathBuf, bool)>,
    coco: Option<(PathBuf, CocoCollector)>,
    ids: ImageIds,
    /// A video's name without extension, when the source is no set of pictures.
    moving: Option<String>,
    used: HashSet<String>,
}

impl Saver {
    pub(super) fn new(args: &SaveArgs, source: &Source, names: &[String]) -> Result<Self> {
        for directory in [&args.save, &args.save_txt].into_iter().flatten() {
            make_directory(directory)?;
        }
        // Written at the end: what stands in its way is to be known before the work.
        if let Some(path) = &args.save_coco {
            if path.is_dir() {
                anyhow::bail!("{} is a directory, not a file for results", path.display());
            }
            if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
                make_directory(folder)?;
            }
        }
        let pictures = match &args.save {
            Some(directory) => Some((directory.clone(), Annotator::new(names.to_vec())?)),
            None => None,
        };
        let moving = match source.kind() {
            SourceKind::Picture | SourceKind::Pictures => None,
            SourceKind::Video => Some(stem(source.name())),
            SourceKind::Stream => Some("stream".to_owned()),
            SourceKind::Camera => Some("camera".to_owned()),
        };
        Ok(Self {
            pictures,
            video: None,
            texts: args.save_txt.clone().map(|directory| (directory, args.save_conf)),
            coco: args.save_coco.clone().map(|path| (path, CocoCollector::new(None))),
            ids: ImageIds::default(),
            moving,
            used: HashSet::new(),
        })
    }

    /// Saves one frame and gives it back, drawn on or not, for its memory.
    pub(super) fn save(
        &mut self,
        shot: SourceFrame,
        found: &[Detection],
        fps: Option<f64>,
    ) -> Result<Frame> {
        let SourceFrame { mut frame, index, name } = shot;
        let own = match &self.moving {
            Some(moving) => format!("{moving}_{index:06}"),
            None => self.unused(stem(&name)),
        };
        if let Some((directory, with_confidence)) = &self.texts {
            let path = directory.join(format!("{own}.txt"));
            results::write_yolo(&path, found, frame.width(), frame.height(), *with_confidence)?;
        }
        if let Some((_, collector)) = &mut self.coco {
            let id = if self.moving.is_some() { index } else { self.ids.assign(Path::new(&name)) };
            collector.add(id, found);
        }
        if let Some((directory, annotator)) = &self.pictures {
            annotator.draw(&mut frame, found);
            match &self.moving {
                None => {
                    let source = Path::new(&name);
                    let extension =
                        source.extension().filter(|_| picture::has_picture_extension(source));
                    let path = directory
                        .join(own)
                        .with_added_extension(extension.unwrap_or("jpg".as_ref()));
                    keep_input(&path, source)?;
                    picture::write(&path, &frame)?;
                }
                Some(moving) => {
                    if self.video.is_none() {
                        let path = directory.join(format!("{moving}.mp4"));
                        keep_input(&path, Path::new(&name))?;
                        let (width, height) = (frame.width(), frame.height());
                        let writer =
                            VideoWriter::create(&path, width, height, fps.unwrap_or(30.0))?;
                        self.video = Some(writer);
                    }
                    if let Some(video) = &mut self.video {
                        video.write(&frame)?;
                    }
                }
            }
        }
        Ok(frame)
    }

    /// A name that no other picture of this run has: pictures of two folders
    /// may be called alike.
    fn unused(&mut self, name: String) -> String {
        let mut own = name.clone();
        let mut number = 2;
        while !self.used.insert(own.clone()) {
            own = format!("{name}-{number}");
            number += 1;
        }
        own
    }

    /// Closes what is open.
    pub(super) fn finish(self) -> Result<()> {
        if let Some(video) = self.video {
            video.finish()?;
        }
        if let Some((path, collector)) = self.coco {
            collector.write(&path)?;
        }
        Ok(())
    }
}

fn stem(name: &str) -> String {
    let stem = Path::new(name).file_stem().unwrap_or("frame".as_ref());
    stem.to_string_lossy().into_owned()
}
