//! A training as a file.

use super::{Begun, EpochReport, Task, Trainer};
use crate::optim::Ema;
use burn::module::Module;
use burn::optim::OptimizerRecord;
use burn::store::ModuleRecord;
use burn::tensor::Bytes;
use realnet_io::atomic::{self, WriteError};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// How the file begins: what it is, and the version of its layout.
const MAGIC: &[u8; 8] = b"RNTRAIN1";
/// Model, moving average, optimiser.
const RECORDS: usize = 3;

/// Why a checkpoint cannot be written or read.
#[derive(Debug, Error)]
pub enum CheckpointError {
    /// Reading.
    #[error("{}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// Writing.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// It is no checkpoint, or damaged.
    #[error("{}: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A part of the training that does not go into a file.
    #[error("the {what} cannot be stored: {reason}")]
    Store {
        /// Which part.
        what: &'static str,
        /// What the framework says.
        reason: String,
    },
    /// It is one of another training.
    #[error("{}: was trained with {name} {stored}, now it is {given}", path.display())]
    Other {
        /// The file.
        path: PathBuf,
        /// What differs.
        name: &'static str,
        /// In the file.
        stored: String,
        /// Asked for.
        given: String,
    },
}

/// What stands before the records, as JSON.
#[derive(Serialize, Deserialize)]
struct Header {
    /// Of the options: what must be the same for the same result.
    options: super::TrainOptions,
    /// Updates of the moving average.
    updates: u64,
    history: Vec<EpochReport>,
    #[serde(default)]
    begun: Option<Begun>,
    /// Bytes of the records.
    lengths: [usize; RECORDS],
}

impl<T: Task> Trainer<T> {
    /// Writes everything that the training needs to go on, whole or not at all.
    ///
    /// # Errors
    /// [`CheckpointError`] when it cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), CheckpointError> {
        let store = |what: &'static str| {
            move |error: &dyn std::fmt::Debug| CheckpointError::Store {
                what,
                reason: format!("{error:?}"),
            }
        };
        // Only then are the statistics of the normalisation those of the last step.
        let model = self.model.valid().into_record().into_bytes();
        let average = self.ema.model().clone().into_record().into_bytes();
        let optimizer = self.optimizer.to_record().into_bytes();
        let records = [
            model.map_err(|e| store("network")(&e))?,
            average.map_err(|e| store("moving average")(&e))?,
            optimizer.map_err(|e| store("optimiser")(&e))?,
        ];
        let header = Header {
            options: self.options.clone(),
            updates: self.ema.updates(),
            history: self.history.clone(),
            begun: self.begun.clone(),
            lengths: std::array::from_fn(|i| records[i].len()),
        };
        let header = serde_json::to_vec(&header).map_err(|e| store("history")(&e))?;
        let mut bytes = MAGIC.to_vec();
        bytes.extend((header.len() as u64).to_le_bytes());
        bytes.extend(header);
        for record in records {
            bytes.extend_from_slice(&record);
        }
        atomic::write(path, &bytes)?;
        Ok(())
    }

    pub(super) fn load(&mut self, path: &Path) -> Result<(), CheckpointError> {
        let read = |source| CheckpointError::Read { path: path.to_owned(), source };
        let wrong = |reason: String| CheckpointError::Format { path: path.to_owned(), reason };
        let cut = || wrong("is cut off".to_owned());
        let bytes = std::fs::read(path).map_err(read)?;
        let rest = bytes.strip_prefix(MAGIC);
        let rest = rest.ok_or_else(|| wrong("is no checkpoint of a training".to_owned()))?;
        let (length, rest) = rest.split_first_chunk::<8>().ok_or_else(cut)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| cut())?;
        let (header, mut rest) = rest.split_at_checked(length).ok_or_else(cut)?;
        let header: Header = serde_json::from_slice(header)
            .map_err(|error| wrong(format!("its header: {error}")))?;
        self.compare(&header, path)?;
        let mut records: [Vec<u8>; RECORDS] = Default::default();
        for (record, length) in records.iter_mut().zip(header.lengths) {
            let (bytes, behind) = rest.split_at_checked(length).ok_or_else(cut)?;
            (*record, rest) = (bytes.to_vec(), behind);
        }
        let [model, average, optimizer] = records;
        let part =
            |what: &str, error: &dyn std::fmt::Debug| wrong(format!("its {what}: {error:?}"));
        let model = ModuleRecord::from_bytes(Bytes::from_bytes_vec(model))
            .map_err(|e| part("network", &e))?;
        let average = ModuleRecord::from_bytes(Bytes::from_bytes_vec(average))
            .map_err(|e| part("moving average", &e))?;
        let optimizer = OptimizerRecord::from_bytes(Bytes::from_bytes_vec(optimizer))
            .map_err(|e| part("optimiser", &e))?;
        // The network first: the optimiser knows its parameters by the ids that come with it.
        self.model = self.model.clone().try_load_record(model).map_err(|e| part("network", &e))?;
        let averaged = self.ema.model().clone();
        let averaged = averaged.try_load_record(average).map_err(|e| part("moving average", &e))?;
        let [decay, ramp] = self.options.ema;
        self.ema = Ema::new(averaged, header.updates, decay, ramp);
        self.optimizer =
            self.options.optimizer.init(self.options.weight_decay).load_record(optimizer);
        self.history = header.history;
        self.begun = header.begun;
        Ok(())
    }

    /// Only the end may be moved; everything else is part of the result.
    fn compare(&self, header: &Header, path: &Path) -> Result<(), CheckpointError> {
        let differs = |name, stored: &dyn std::fmt::Debug, given: &dyn std::fmt::Debug| {
            let (stored, given) = (format!("{stored:?}"), format!("{given:?}"));
            (stored != given).then(|| CheckpointError::Other {
                path: path.to_owned(),
                name,
                stored,
                given,
            })
        };
        let (stored, given) = (&header.options, &self.options);
        let errors = [
            differs("seed", &stored.seed, &given.seed),
            differs("optimizer", &stored.optimizer, &given.optimizer),
            differs("lr", &stored.lr, &given.lr),
            differs("weight-decay", &stored.weight_decay, &given.weight_decay),
            differs("accumulate", &stored.accumulate, &given.accumulate),
        ];
        errors.into_iter().flatten().next().map_or(Ok(()), Err)
    }
}
