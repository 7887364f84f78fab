//! Everything that `realnet detect` leaves on disk.

use super::{
    super::frame_files::{FrameFiles, FrameNames},
    make_directory,
};
use anyhow::Result;
use clap::Args;
use realnet::{
    Detection, Frame,
    annotate::Annotator,
    results::{self, CocoCollector, ImageIds},
    source::{Source, SourceFrame},
};
use std::path::{Path, PathBuf};

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
    pictures: Option<(FrameFiles, Annotator)>,
    texts: Option<(PathBuf, bool)>,
    coco: Option<(PathBuf, CocoCollector)>,
    ids: ImageIds,
    names: FrameNames,
}

impl Saver {
    pub(super) fn new(args: &SaveArgs, source: &Source, names: &[String]) -> Result<Self> {
        for directory in [&args.save, &args.save_txt].into_iter().flatten() {
            make_directory(directory)?;
        }
        let file_names = FrameNames::new(source, &[]);
        // Written at the end: what stands in its way is to be known before the work.
        if let Some(path) = &args.save_coco {
            if path.is_dir() {
                anyhow::bail!("{} is a directory, not a file for results", path.display());
            }
            if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
                make_directory(folder)?;
            }
            file_names.keep_inputs(path)?;
        }
        let pictures = match &args.save {
            Some(directory) => Some((FrameFiles::new(directory), Annotator::new(names.to_vec())?)),
            None => None,
        };
        Ok(Self {
            pictures,
            texts: args.save_txt.clone().map(|directory| (directory, args.save_conf)),
            coco: args.save_coco.clone().map(|path| (path, CocoCollector::new(None))),
            ids: ImageIds::default(),
            names: file_names,
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
        let own = self.names.of(index, &name);
        if let Some((directory, with_confidence)) = &self.texts {
            let path = directory.join(format!("{own}.txt"));
            self.names.keep_inputs(&path)?;
            results::write_yolo(&path, found, frame.width(), frame.height(), *with_confidence)?;
        }
        if let Some((_, collector)) = &mut self.coco {
            let id = if self.names.is_moving() { index } else { self.ids.assign(Path::new(&name)) };
            collector.add(id, found);
        }
        if let Some((files, annotator)) = &mut self.pictures {
            annotator.draw(&mut frame, found);
            files.write(&self.names, &own, &name, &frame, fps)?;
        }
        Ok(frame)
    }

    /// Closes what is open.
    pub(super) fn finish(self) -> Result<()> {
        if let Some((files, _)) = self.pictures {
            files.finish()?;
        }
        if let Some((path, collector)) = self.coco {
            collector.write(&path)?;
        }
        Ok(())
    }
}
