//! What a run has done, to be gone on with.

use crate::cli::failure::{OrBadInput, bad_input};
use anyhow::{Context, Result};
use realnet_io::atomic;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What the frames of a run follow from; a run is gone on with only by the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Recipe {
    pub(super) source: String,
    pub(super) every: u64,
    #[serde(rename = "box")]
    pub(super) bbox: Option<[f32; 4]>,
    pub(super) boxes: Option<String>,
    pub(super) class: String,
    pub(super) split: String,
}

/// What a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Kind {
    /// Nobody asked for boxes.
    Plain,
    /// Its box was given.
    Given,
    /// Its box was carried to it.
    Carried,
    /// The box was lost: outside the set.
    Lost,
    /// There was no box yet: outside the set.
    Waiting,
}

/// One frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Entry {
    /// Number of the frame in its source, from 0.
    pub(super) index: u64,
    pub(super) kind: Kind,
    /// Why the box was lost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) reason: Option<String>,
    /// Correlation of the box's content with that of the frame before, -1 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) similarity: Option<f32>,
    /// Standard deviation of the centre since the box was given, as a share of the
    /// box's sides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) drift: Option<f64>,
}

/// A run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Record {
    pub(super) recipe: Recipe,
    /// The first frame of the source that was not looked at.
    pub(super) next: u64,
    pub(super) frames: Vec<Entry>,
}

impl Record {
    /// The record in a file, or a new one.
    pub(super) fn open(path: &Path, recipe: Recipe) -> Result<Self> {
        let Some(known) = Self::read(path)? else {
            return Ok(Self { recipe, next: 0, frames: Vec::new() });
        };
        if known.recipe != recipe {
            return Err(bad_input(format!(
                "{} was begun otherwise ({:?}, now {recipe:?}): choose another --name or --out",
                path.display(),
                known.recipe
            )));
        }
        Ok(known)
    }

    /// The record in a file, if there is one.
    pub(super) fn read(path: &Path) -> Result<Option<Self>> {
        match std::fs::read(path) {
            Ok(bytes) => serde_json::from_slice(&bytes)
                .with_context(|| path.display().to_string())
                .or_bad_input()
                .map(Some),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(bad_input(format!("cannot read {}: {error}", path.display()))),
        }
    }

    pub(super) fn save(&self, path: &Path) -> Result<()> {
        let mut text = serde_json::to_string(self)?;
        text.push('\n');
        Ok(atomic::write(path, text.as_bytes())?)
    }
}
