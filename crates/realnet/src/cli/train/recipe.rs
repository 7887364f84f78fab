//! What decides the result, as a file: `args.toml`.

use super::given::Given;
use crate::cli::{
    command_line,
    failure::{OrBadInput, bad_input},
};
use anyhow::{Context, Result};
use clap::{Args, Command};
use serde::{Serialize, de::DeserializeOwned};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Keys of the file that are no options.
const TASK: &str = "task";
const VERSION: &str = "version";
const AUGMENT: &str = "augment";
const NETWORK: &str = "network";

/// An option on which others depend, and these.
const OPTIMIZER: &str = "optimizer";
const OF_OPTIMIZER: [&str; 3] = ["lr", "momentum", "weight_decay"];

/// A file of options.
#[derive(Debug, Default)]
pub(super) struct Recipe {
    options: Table,
    augment: Option<Table>,
    network: Option<Table>,
}

impl Recipe {
    /// Reads options for `task`. Paths among them are relative to the file.
    pub(super) fn read(path: &Path, task: &str) -> Result<Self> {
        let name = || path.display().to_string();
        let text = std::fs::read_to_string(path).with_context(name).or_bad_input()?;
        let mut options: Table =
            text.parse().map_err(|error| bad_input(format!("{}: {error}", path.display())))?;
        if let Some(other) = options.remove(TASK)
            && other.as_str() != Some(task)
        {
            return Err(bad_input(format!(
                "{}: is for `realnet train` {other}, not {task}",
                path.display()
            )));
        }
        options.remove(VERSION);
        let mut table = |key| match options.remove(key) {
            None => Ok(None),
            Some(Value::Table(table)) => Ok(Some(table)),
            Some(_) => Err(bad_input(format!("{}: {key} must be a table", path.display()))),
        };
        let (augment, network) = (table(AUGMENT)?, table(NETWORK)?);
        Ok(Self { options, augment, network })
    }

    /// Changes of the samples, if the file has any.
    pub(super) fn augment(&self) -> Option<&Table> {
        self.augment.as_ref()
    }

    /// What the network of the run was built from; for going on with it.
    pub(super) fn network<N: DeserializeOwned>(&self, path: &Path) -> Result<N> {
        let missing = || bad_input(format!("{}: [{NETWORK}] is missing", path.display()));
        let table = self.network.clone().ok_or_else(missing)?;
        table.try_into().with_context(|| format!("{}: [{NETWORK}]", path.display())).or_bad_input()
    }

    /// The options of the file, where they are not on the command line, else those of there.
    ///
    /// `path` is that of the file, for errors. Another optimiser than the file's has its own
    /// rates.
    pub(super) fn merged<S, T>(&self, settings: &S, given: &Given<T>, path: &Path) -> Result<S>
    where
        S: Args + Serialize + DeserializeOwned,
    {
        let command = S::augment_args(Command::new("options"));
        let known: Vec<&str> = command.get_arguments().map(|arg| arg.get_id().as_str()).collect();
        let mut table = Table::try_from(settings)?;
        let is_other = given.has(OPTIMIZER)
            && self.options.get(OPTIMIZER).is_some_and(|own| Some(own) != table.get(OPTIMIZER));
        for (key, value) in &self.options {
            if !known.contains(&key.as_str()) {
                return Err(bad_input(format!(
                    "{}: there is no option '{key}'; there are {}",
                    path.display(),
                    known.join(", ")
                )));
            }
            if given.has(key) || is_other && OF_OPTIMIZER.contains(&key.as_str()) {
                continue;
            }
            // By itself, so that the error has its name.
            let mut one = Table::try_from(settings)?;
            one.insert(key.clone(), value.clone());
            if let Err(error) = one.try_into::<S>() {
                let words = error.message().to_owned();
                return Err(bad_input(format!("{}: {key} = {value}: {words}", path.display())));
            }
            table.insert(key.clone(), value.clone());
        }
        table.try_into().or_bad_input()
    }
}

/// `path`, which stands in the file `config`.
pub(super) fn beside(config: &Path, path: &Path) -> PathBuf {
    config.parent().unwrap_or(Path::new("")).join(path)
}

/// The text of `args.toml`.
pub(super) fn text(
    task: &str,
    settings: &impl Serialize,
    augment: &impl Serialize,
    network: &impl Serialize,
) -> Result<String> {
    #[derive(Serialize)]
    struct File<'a, S, A, N> {
        task: &'a str,
        version: &'a str,
        #[serde(flatten)]
        settings: &'a S,
        augment: &'a A,
        network: &'a N,
    }
    let version = env!("CARGO_PKG_VERSION");
    let file = File { task, version, settings, augment, network };
    let command: String =
        command_line().chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    Ok(format!(
        "# Written by: {command}\n# Again, elsewhere: realnet train {task} --config THIS_FILE \
         --out DIR\n# [network] is what it was built from, and is read by --resume alone.\n\n{}",
        toml::to_string(&file)?
    ))
}
