//! What the check before the first step found.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

/// A kind of trouble with a file. None of them stops a training; see each for what
/// becomes of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Problem {
    /// A picture that does not exist: left out.
    MissingImage,
    /// A picture that cannot be decoded: left out.
    BrokenImage,
    /// A box partly outside its picture: clipped.
    BoxClipped,
    /// A box of which nothing, or less than a pixel, is inside its picture: dropped.
    BoxOutside,
    /// A row with NaN or an infinite number: dropped.
    RowNotFinite,
    /// A row that is written twice: dropped.
    RowTwice,
    /// A picture without a depth map: left out.
    NoDepth,
    /// A depth map that cannot be read: left out.
    BrokenDepth,
    /// A depth map in which nothing is known: left out.
    DepthUnknown,
    /// A depth map of another size than its picture: left out.
    SizeMismatch,
    /// Depths that are NaN, infinite or negative: taken as unknown.
    DepthNotFinite,
    /// A picture whose camera cannot be read: left out.
    BadCamera,
}

impl Problem {
    /// What it is and what becomes of it, in words.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::MissingImage => "pictures are missing (left out)",
            Self::BrokenImage => "pictures are broken (left out)",
            Self::BoxClipped => "boxes reach outside their picture (clipped)",
            Self::BoxOutside => "boxes lie outside their picture or are empty (dropped)",
            Self::RowNotFinite => "label rows have NaN or infinite numbers (dropped)",
            Self::RowTwice => "label rows are written twice (dropped)",
            Self::NoDepth => "pictures have no depth map (left out)",
            Self::BrokenDepth => "depth maps are broken (left out)",
            Self::DepthUnknown => "depth maps know no depth at all (left out)",
            Self::SizeMismatch => "depth maps are not of the size of their picture (left out)",
            Self::DepthNotFinite => "depth maps have NaN, infinite or negative depths (unknown)",
            Self::BadCamera => "pictures have a camera file that cannot be used (left out)",
        }
    }
}

/// One trouble.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Its kind.
    pub problem: Problem,
    /// The file; empty for what was given in memory.
    pub path: PathBuf,
    /// The line, from 1, where there is one.
    pub line: Option<usize>,
    /// What exactly, for people.
    pub detail: String,
}

impl Finding {
    pub(crate) fn new(
        problem: Problem,
        path: impl Into<PathBuf>,
        detail: impl fmt::Display,
    ) -> Self {
        Self { problem, path: path.into(), line: None, detail: detail.to_string() }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The detail of an error about a file begins with its name already.
        let path = self.path.display().to_string();
        if !self.detail.contains(&path) || path.is_empty() {
            write!(f, "{path}")?;
            if let Some(line) = self.line {
                write!(f, ":{line}")?;
            }
            write!(f, ": ")?;
        }
        f.write_str(&self.detail)
    }
}

/// What a data set holds and what is wrong with it. Its [`Display`](fmt::Display) is
/// some lines for people: counts, then each kind of trouble with its number and first
/// example.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CheckReport {
    /// Pictures that were looked at.
    pub pictures: usize,
    /// Pictures that can be learned from.
    pub usable: usize,
    /// Usable pictures without any object (data sets of boxes).
    pub backgrounds: usize,
    /// Name and number of objects of each class (data sets of boxes).
    pub classes: Vec<(String, usize)>,
    /// All that was found, in the order of the pictures.
    pub findings: Vec<Finding>,
    /// Pictures and bytes in memory after the check.
    pub cached: (usize, usize),
}

impl CheckReport {
    /// How often there was trouble of a kind.
    #[must_use]
    pub fn count(&self, problem: Problem) -> usize {
        self.findings.iter().filter(|finding| finding.problem == problem).count()
    }
}

impl fmt::Display for CheckReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {} pictures are usable", self.usable, self.pictures)?;
        if self.backgrounds > 0 {
            write!(f, ", {} of them without objects", self.backgrounds)?;
        }
        let (cached, bytes) = self.cached;
        write!(f, "; {cached} in memory ({:.0} MB)", bytes as f64 / 1e6)?;
        if !self.classes.is_empty() {
            let total: usize = self.classes.iter().map(|(_, count)| count).sum();
            write!(f, "\n{total} objects:")?;
            for (at, (name, count)) in self.classes.iter().enumerate() {
                write!(f, "{} {name} {count}", if at > 0 { "," } else { "" })?;
            }
        }
        let mut kinds: BTreeMap<Problem, (usize, &Finding)> = BTreeMap::new();
        for finding in &self.findings {
            kinds.entry(finding.problem).or_insert((0, finding)).0 += 1;
        }
        for (problem, (count, first)) in kinds {
            write!(f, "\nwarning: {count} {}, first: {first}", problem.text())?;
        }
        Ok(())
    }
}
