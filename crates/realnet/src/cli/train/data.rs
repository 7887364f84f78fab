//! What is said about data: before the first step, and when a file breaks later.

use super::console::Console;
use crate::cli::failure::{bad_input, say};
use anyhow::Result;
use realnet_data::{CheckReport, Failure, Finding, Problem, Samples, epoch_order};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

/// Findings of a kind that are named.
const NAMED: usize = 10;

/// Says what a set holds and what is wrong with it.
pub(super) fn tell(console: &mut Console, part: &str, report: &CheckReport) {
    let CheckReport { pictures, usable, backgrounds, classes, findings, cached } = report;
    let mut line = format!("{part}: {usable} of {pictures} pictures are usable");
    if *backgrounds > 0 {
        line += &format!(", {backgrounds} of them without objects");
    }
    if !classes.is_empty() {
        let counts = classes.iter().map(|(name, count)| format!("{count} {name}"));
        line += &format!("; objects: {}", counts.collect::<Vec<_>>().join(", "));
    }
    let (kept, bytes) = *cached;
    line += &format!("; {kept} in memory ({:.0} MB)", bytes as f64 / 1e6);
    console.line(line);
    let mut kinds: BTreeMap<Problem, Vec<&Finding>> = BTreeMap::new();
    for finding in findings {
        kinds.entry(finding.problem).or_default().push(finding);
    }
    for (problem, findings) in kinds {
        say(format!("warning: {part}: {} {}", findings.len(), problem.text()));
        listed(&findings);
    }
}

/// Names the first ones.
fn listed(items: &[impl std::fmt::Display]) {
    for item in items.iter().take(NAMED) {
        say(format!("  {item}"));
    }
    if items.len() > NAMED {
        say(format!("  and {} more", items.len() - NAMED));
    }
}

/// Pictures of which no samples could be made in training: each is named once.
#[derive(Debug, Default)]
pub(super) struct Failures {
    named: BTreeSet<PathBuf>,
}

impl Failures {
    /// Names those that are new.
    pub(super) fn tell(&mut self, failures: &[Failure]) {
        let new: Vec<_> = failures
            .iter()
            .map(|failure| &failure.error)
            .filter(|error| self.named.insert(error.path.clone()))
            .collect();
        if new.is_empty() {
            return;
        }
        say(format!(
            "warning: {} pictures cannot be read any more; for each sample of one there is the \
             next sample twice",
            new.len()
        ));
        listed(&new);
    }
}

/// The first samples of the first epoch.
pub(super) fn first<S: Samples>(samples: &S, seed: u32, count: usize) -> Result<Vec<S::Sample>> {
    let order = epoch_order(samples.len(), u64::from(seed), 0);
    let made: Vec<_> =
        order.into_iter().filter_map(|index| samples.sample(0, index).ok()).take(count).collect();
    if made.is_empty() {
        return Err(bad_input("no sample can be made"));
    }
    Ok(made)
}
