//! The files of the data set.

use super::record::{Entry, Kind};
use crate::cli::{
    detect::make_directory,
    failure::{OrBadInput, bad_input},
};
use anyhow::{Context, Result};
use realnet::{
    BoundingBox, Detection,
    datasets::YoloDataset,
    picture,
    source::{SourceFrame, SourceKind},
};
use realnet_io::{atomic, datasets::labels::row_of};
use std::path::{Path, PathBuf};

/// The folder of a data set, and the part and name of a run in it.
pub(super) struct FrameSet {
    folder: PathBuf,
    split: &'static str,
    class_id: u32,
    run: String,
}

impl FrameSet {
    /// Makes the folders, and `data.yaml` unless there is one.
    pub(super) fn open(folder: &Path, split: &'static str, class: &str, run: &str) -> Result<Self> {
        make_directory(folder)?;
        for part in ["images/train", "images/val", "labels/train", "labels/val", "runs"] {
            make_directory(&folder.join(part))?;
        }
        let yaml = folder.join("data.yaml");
        if !yaml.exists() {
            let text =
                format!("path: .\ntrain: images/train\nval: images/val\nnames:\n  0: '{class}'\n");
            atomic::write(&yaml, text.as_bytes())?;
        }
        let data = YoloDataset::open(&yaml).or_bad_input()?;
        let class_id = data.names().iter().position(|name| name == class).ok_or_else(|| {
            bad_input(format!(
                "{}: no class '{class}' among {}: add it there",
                yaml.display(),
                data.names().join(", ")
            ))
        })?;
        let (folder, run) = (folder.to_owned(), run.to_owned());
        Ok(Self { folder, split, class_id: class_id as u32, run })
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Where the run's record is.
    pub(super) fn record(&self) -> PathBuf {
        self.folder.join("runs").join(&self.run).with_added_extension("json")
    }

    /// The page to look at.
    pub(super) fn page(&self) -> PathBuf {
        self.folder.join("review.html")
    }

    /// The list of frames that are outside the set.
    pub(super) fn lost_list(&self) -> PathBuf {
        self.folder.join("lost.csv")
    }

    /// Writes a frame's files where they are missing: a file that is there may have
    /// been corrected. Labels are the last, so a frame with labels is whole.
    pub(super) fn write(
        &self,
        entry: &Entry,
        bbox: Option<BoundingBox>,
        shot: &SourceFrame,
        kind: SourceKind,
    ) -> Result<()> {
        let name = frame_name(&self.run, entry.index);
        let folder = match entry.kind {
            Kind::Waiting => return Ok(()),
            Kind::Lost => {
                let folder = self.folder.join("lost");
                make_directory(&folder)?;
                folder
            }
            Kind::Plain | Kind::Given | Kind::Carried => {
                self.folder.join("images").join(self.split)
            }
        };
        // Pictures as they are, without loss; frames of a video become pictures.
        let own = Path::new(&shot.name);
        let is_file = matches!(kind, SourceKind::Picture | SourceKind::Pictures);
        let extension = own.extension().and_then(|text| text.to_str()).filter(|_| is_file);
        let image = folder.join(&name).with_added_extension(extension.unwrap_or("jpg"));
        if !image.exists() {
            if is_file {
                let bytes = std::fs::read(own)
                    .with_context(|| format!("cannot read {}", own.display()))
                    .or_bad_input()?;
                atomic::write(&image, &bytes)?;
            } else {
                picture::write(&image, &shot.frame)?;
            }
        }
        let (Kind::Given | Kind::Carried, Some(bbox)) = (entry.kind, bbox) else { return Ok(()) };
        let labels = self.folder.join("labels").join(self.split).join(name);
        let labels = labels.with_added_extension("txt");
        if !labels.exists() {
            let (width, height) = (shot.frame.width(), shot.frame.height());
            let bbox = bbox.clipped(width as f32, height as f32);
            let detection = Detection { class_id: self.class_id, confidence: 1.0, bbox };
            let row = row_of(&detection, width, height, false);
            atomic::write(&labels, format!("{row}\n").as_bytes())?;
        }
        Ok(())
    }
}

/// The name, without extension, of a frame of a run.
pub(super) fn frame_name(run: &str, index: u64) -> String {
    format!("{run}_{index:06}")
}
