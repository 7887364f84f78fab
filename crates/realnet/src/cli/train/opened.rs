//! What a training begins with: nothing, a file of options, or a run that goes on.

use super::{
    folder::Folder,
    given::Given,
    options::{MAY_CHANGE, RunArgs},
    recipe::Recipe,
};
use crate::cli::failure::bad_input;
use anyhow::Result;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// Options about a run, which it can be given each time.
const OF_A_RUN: [&str; 3] = ["resume", "out", "json"];

/// The folder and the file that were asked for.
pub(super) struct Opened {
    /// The folder of a run that goes on.
    pub(super) resumed: Option<Folder>,
    /// Its options, or other ones.
    pub(super) config: Option<PathBuf>,
    /// What they are.
    pub(super) recipe: Recipe,
}

impl Opened {
    /// Opens them. What decides the result of a run that goes on is in its folder, and must
    /// not be given.
    pub(super) fn new<T>(run: &RunArgs, given: &Given<T>, task: &str) -> Result<Self> {
        let resumed = match &run.resume {
            None => None,
            Some(path) => {
                let free = |name: &&str| OF_A_RUN.contains(name) || MAY_CHANGE.contains(name);
                if let Some(name) = given.names().find(|name| !free(name)) {
                    return Err(bad_input(format!(
                        "--{} cannot be changed when a run goes on; only {} can",
                        name.replace('_', "-"),
                        MAY_CHANGE.map(|name| format!("--{name}")).join(", ")
                    )));
                }
                let path = match (path, &run.out) {
                    (Some(path), None) | (None, Some(path)) => path,
                    (Some(_), Some(_)) => {
                        return Err(bad_input("--resume DIR goes on in DIR: leave out --out"));
                    }
                    (None, None) => return Err(bad_input("--resume: of which folder?")),
                };
                Some(Folder::resume(path, task)?)
            }
        };
        let config = resumed.as_ref().map(Folder::args).or_else(|| run.config.clone());
        let recipe = config.as_deref().map(|path| Recipe::read(path, task)).transpose()?;
        Ok(Self { resumed, config, recipe: recipe.unwrap_or_default() })
    }

    /// What the network of a run that goes on was built from.
    pub(super) fn network<N: DeserializeOwned>(&self) -> Result<Option<N>> {
        match (&self.resumed, &self.config) {
            (Some(_), Some(config)) => self.recipe.network(config).map(Some),
            _ => Ok(None),
        }
    }

    /// The folder to write to; a new run's is made.
    pub(super) fn folder(&self, run: &RunArgs, default: &str, task: &str) -> Result<Folder> {
        match &self.resumed {
            Some(folder) => Ok(folder.clone()),
            None => {
                let out = run.out.as_deref().unwrap_or(Path::new(default));
                Folder::create(out, task, run.overwrite)
            }
        }
    }

    /// Whether a run that goes on does so with other options.
    pub(super) fn is_changed<T>(&self, given: &Given<T>) -> bool {
        self.resumed.is_none() || given.names().any(|name| MAY_CHANGE.contains(&name))
    }
}
