//! The `data.yaml` of YOLO data sets, in the form of Ultralytics.
//!
//! `path` is relative to the file itself (to its folder when missing). `train`,
//! `val` and `test` are each a folder, a text file with one picture a line, or a
//! list of these, relative to `path`. The labels of `…/images/a/b.jpg` are in
//! `…/labels/a/b.txt` (the last `/images/` counts); a missing label file means
//! that nothing is in the picture.

use super::labels::{self, Labels};
use super::{DatasetError, read_text};
use crate::picture;
use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, SeqAccess, Visitor};
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

/// One picture of a data set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sample {
    /// The picture.
    pub image: PathBuf,
    /// Where its labels are, if there are any.
    pub labels: PathBuf,
}

/// A YOLO data set: class names and parts of pictures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct YoloDataset {
    file: PathBuf,
    root: PathBuf,
    names: Vec<String>,
    splits: BTreeMap<String, Vec<String>>,
}

/// The contents of a `data.yaml`; other keys are ignored.
#[derive(Deserialize)]
struct Raw {
    path: Option<String>,
    train: Option<Entries>,
    val: Option<Entries>,
    test: Option<Entries>,
    names: Option<Names>,
    nc: Option<usize>,
}

/// One entry or a list of them.
struct Entries(Vec<String>);

impl<'de> Deserialize<'de> for Entries {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl<'de> Visitor<'de> for Reader {
            type Value = Entries;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a folder, a .txt file, or a list of these")
            }
            fn visit_str<E>(self, text: &str) -> Result<Entries, E> {
                Ok(Entries(vec![text.to_string()]))
            }
            fn visit_unit<E>(self) -> Result<Entries, E> {
                Ok(Entries(Vec::new()))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Entries, A::Error> {
                let mut list = Vec::new();
                while let Some(entry) = seq.next_element()? {
                    list.push(entry);
                }
                Ok(Entries(list))
            }
        }
        deserializer.deserialize_any(Reader)
    }
}

/// Class names as a list or as a map from index to name.
enum Names {
    List(Vec<String>),
    Map(BTreeMap<u32, String>),
}

impl<'de> Deserialize<'de> for Names {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl<'de> Visitor<'de> for Reader {
            type Value = Names;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of class names, or a map from class index to name")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Names, A::Error> {
                let mut list = Vec::new();
                while let Some(name) = seq.next_element()? {
                    list.push(name);
                }
                Ok(Names::List(list))
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Names, A::Error> {
                let mut names = BTreeMap::new();
                while let Some((index, name)) = map.next_entry()? {
                    names.insert(index, name);
                }
                Ok(Names::Map(names))
            }
        }
        deserializer.deserialize_any(Reader)
    }
}

impl YoloDataset {
    /// Reads a `data.yaml`. The pictures are looked for by
    /// [`YoloDataset::split`].
    ///
    /// # Errors
    /// [`DatasetError::Read`], [`DatasetError::Yaml`], or
    /// [`DatasetError::Missing`] when `path` does not exist.
    pub fn open(file: &Path) -> Result<Self, DatasetError> {
        let dataset = Self::parse(&read_text(file)?, file)
            .map_err(|message| DatasetError::Yaml { path: file.to_path_buf(), message })?;
        if dataset.root.is_dir() {
            Ok(dataset)
        } else {
            let origin = format!("{}: `path`", file.display());
            Err(DatasetError::Missing { origin, missing: dataset.root })
        }
    }

    /// Parses the text of a `data.yaml` that is (or would be) `file`.
    ///
    /// # Errors
    /// What is wrong, with line and column where the parser knows them.
    pub fn parse(text: &str, file: &Path) -> Result<Self, String> {
        let raw: Raw = serde_saphyr::from_str(text).map_err(|e| e.to_string())?;
        let names = match (raw.names, raw.nc) {
            (Some(Names::List(list)), _) => list,
            (Some(Names::Map(map)), _) => {
                for (wanted, found) in (0u32..).zip(map.keys()) {
                    if wanted != *found {
                        return Err(format!("`names` has {found} but not {wanted}"));
                    }
                }
                map.into_values().collect()
            }
            (None, Some(nc)) if nc <= 65_536 => (0..nc).map(|i| format!("class{i}")).collect(),
            (None, Some(nc)) => return Err(format!("`nc` {nc} is too many classes")),
            (None, None) => return Err("neither `names` nor `nc`".into()),
        };
        if let Some(nc) = raw.nc
            && nc != names.len()
        {
            return Err(format!("`nc` is {nc}, but there are {} `names`", names.len()));
        }
        if names.is_empty() {
            return Err("`names` is empty".into());
        }
        let folder = file.parent().unwrap_or(Path::new(""));
        let root = raw.path.map_or_else(|| folder.to_path_buf(), |p| folder.join(p));
        // `path: .` leaves no trace in the names of the pictures.
        let root: PathBuf = root.components().collect();
        // "" is the present folder, but no name for it.
        let root = if root.as_os_str().is_empty() { PathBuf::from(".") } else { root };
        let splits = [("train", raw.train), ("val", raw.val), ("test", raw.test)]
            .into_iter()
            .filter_map(|(split, entries)| Some((split.to_string(), entries?.0)))
            .filter(|(_, entries)| !entries.is_empty())
            .collect();
        Ok(Self { file: file.to_path_buf(), root, names, splits })
    }

    /// Class names by class index.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The parts this data set has: `train`, `val`, `test`.
    pub fn splits(&self) -> impl Iterator<Item = &str> {
        self.splits.keys().map(String::as_str)
    }

    /// The pictures of one part: entry by entry, folders (with subfolders) in
    /// natural order, lists in their own.
    ///
    /// # Errors
    /// [`DatasetError`] when there is no such part, a folder, list or listed
    /// picture is missing, or there is no picture at all.
    pub fn split(&self, split: &str) -> Result<Vec<Sample>, DatasetError> {
        self.pictures(split, true)
    }

    /// As [`YoloDataset::split`], but pictures of a list that do not exist are given too,
    /// for a reader that counts and leaves out what is missing.
    ///
    /// # Errors
    /// [`DatasetError`] when there is no such part, a folder or list is missing, or there
    /// is no picture at all.
    pub fn split_with_missing(&self, split: &str) -> Result<Vec<Sample>, DatasetError> {
        self.pictures(split, false)
    }

    /// The pictures of one part; those of a list `must_exist` or not.
    fn pictures(&self, split: &str, must_exist: bool) -> Result<Vec<Sample>, DatasetError> {
        let Some(entries) = self.splits.get(split) else {
            let present = self.splits().collect::<Vec<_>>().join(", ");
            let (path, split) = (self.file.clone(), split.to_string());
            return Err(DatasetError::NoSplit { path, split, present });
        };
        let mut images = Vec::new();
        for entry in entries {
            let path = self.root.join(entry);
            if path.is_dir() {
                let mut found = Vec::new();
                walk(&path, &mut found, 0)?;
                found.sort_by(|a, b| {
                    natord::compare(&a.to_string_lossy(), &b.to_string_lossy())
                        .then_with(|| a.cmp(b))
                });
                images.append(&mut found);
            } else if path.is_file() {
                images.append(&mut self.listed(&path, must_exist)?);
            } else {
                let origin = format!("{}: `{split}`", self.file.display());
                return Err(DatasetError::Missing { origin, missing: path });
            }
        }
        if images.is_empty() {
            let (path, split) = (self.file.clone(), split.to_string());
            return Err(DatasetError::NoPictures { path, split });
        }
        Ok(images.into_iter().map(|image| Sample { labels: labels_of(&image), image }).collect())
    }

    /// Reads the labels of a picture, see [`labels::read`].
    ///
    /// # Errors
    /// As [`labels::read`].
    pub fn labels(&self, sample: &Sample) -> Result<Labels, DatasetError> {
        labels::read(&sample.labels, self.names.len())
    }

    /// The pictures of a list: `./x` is relative to the list's folder, anything
    /// else to the data set's `path`, or, if it is not there, to the list's
    /// folder too.
    fn listed(&self, list: &Path, must_exist: bool) -> Result<Vec<PathBuf>, DatasetError> {
        let folder = list.parent().unwrap_or(Path::new(""));
        let mut found = Vec::new();
        for (index, line) in read_text(list)?.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() {
                continue;
            }
            let candidates = match line.strip_prefix("./") {
                Some(rest) => [Some(folder.join(rest)), None],
                None => [Some(self.root.join(line)), Some(folder.join(line))],
            };
            let there = candidates.iter().flatten().find(|p| p.is_file());
            if must_exist && there.is_none() {
                let origin = format!("{}:{}", list.display(), index + 1);
                return Err(DatasetError::Missing { origin, missing: self.root.join(line) });
            }
            found.extend(there.or(candidates.iter().flatten().next()).cloned());
        }
        Ok(found)
    }
}

/// Collects the pictures of a folder and its subfolders.
fn walk(folder: &Path, found: &mut Vec<PathBuf>, depth: usize) -> Result<(), DatasetError> {
    let failed = |reason| DatasetError::Read { path: folder.to_path_buf(), reason };
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let path = entry.path();
        if entry.file_name().as_encoded_bytes().starts_with(b".") {
            continue;
        }
        if path.is_dir() {
            // Deep enough for every data set; a link to its own parent ends.
            if depth < 16 && !path.is_symlink() {
                walk(&path, found, depth + 1)?;
            }
        } else if picture::has_picture_extension(&path) {
            found.push(path);
        }
    }
    Ok(())
}

/// The label file of a picture: the last folder `images` becomes `labels`, the
/// extension `txt`.
#[must_use]
pub fn labels_of(image: &Path) -> PathBuf {
    let mut parts: Vec<_> = image.components().collect();
    let folders = parts.len().saturating_sub(1);
    let last = parts.iter().take(folders).rposition(|c| c.as_os_str() == "images");
    if let Some(part) = last.and_then(|i| parts.get_mut(i)) {
        *part = std::path::Component::Normal("labels".as_ref());
    }
    parts.iter().collect::<PathBuf>().with_extension("txt")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<YoloDataset, String> {
        YoloDataset::parse(text, Path::new("/d/sub/data.yaml"))
    }

    #[test]
    fn lists_maps_and_paths() {
        let data =
            parse("path: ../x\ntrain: [a, b.txt]\nval: c\ntest:\nnames: [car, no, 7]\nextra: 1")
                .unwrap();
        assert_eq!(data.names(), ["car", "no", "7"]);
        assert_eq!(data.root, Path::new("/d/sub/../x"));
        assert_eq!(data.splits().collect::<Vec<_>>(), ["train", "val"]);
        let data = parse("val: c\nnames:\n  1: b\n  0: a\nnc: 2").unwrap();
        assert_eq!(data.names(), ["a", "b"]);
        assert_eq!(data.root, Path::new("/d/sub"));
        assert_eq!(parse("val: c\nnc: 2").unwrap().names(), ["class0", "class1"]);
    }

    #[test]
    fn mistakes_are_named() {
        for (text, wanted) in [
            ("val: c", "neither `names` nor `nc`"),
            ("names: []", "`names` is empty"),
            ("names: {0: a, 2: b}", "has 2 but not 1"),
            ("names: [a]\nnc: 3", "`nc` is 3, but there are 1"),
            ("nc: 99999999999", "too many"),
            ("names: {a: 1}", "line 1"),
            ("names: 5", "class names"),
            ("names: [a\n", "line"),
            ("names: [a]\nval: {x: 1}", "a folder"),
            ("- a", "line 1"),
            ("", ""),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(wanted), "{text}: {error}");
        }
    }

    #[test]
    fn the_last_images_folder_counts() {
        let labels = |p: &str| labels_of(Path::new(p)).display().to_string();
        assert_eq!(labels("/images/a/images/b/1.jpg"), "/images/a/labels/b/1.txt");
        assert_eq!(labels("images/1.v2.jpeg"), "labels/1.v2.txt");
        assert_eq!(labels("pics/1.png"), "pics/1.txt");
        assert_eq!(labels("my-images/images"), "my-images/images.txt");
    }
}
