//! Weights of files, in words.

use realnet_train::names::Taken;
use std::path::Path;

/// What became of the weights of a file.
pub(super) fn told(path: &Path, taken: &Taken) -> Vec<String> {
    let total = taken.taken + taken.missing.len() + taken.reshaped.len();
    let mut words =
        vec![format!("weights: {} of {total} tensors from {}", taken.taken, path.display())];
    let mut list = |names: &[String], why: &str| {
        let known: Vec<_> = names.iter().filter(|name| !name.contains("anchor")).collect();
        let Some((first, rest)) = known.split_first() else { return };
        let more = match rest.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        words.push(format!("  {first}{more}: {why}"));
    };
    list(&taken.reshaped, "another shape in the file, random at the start");
    list(&taken.missing, "not in the file, random at the start");
    list(&taken.unused, "not in the network, left out");
    words
}
