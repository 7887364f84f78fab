//! A data set of boxes, checked.

use super::Target;
use crate::cache::{Cache, in_parallel};
use crate::check::{CheckReport, Finding, Problem};
use crate::{DataError, SampleError, SetOptions};
use realnet_core::{Frame, OptionError, PixelFormat};
use realnet_io::datasets::labels::{self, LabelErrorKind};
use realnet_io::datasets::{DatasetError, LabelError, YoloDataset, yolo};
use realnet_io::picture::{self, Limits, PictureError};
use realnet_vision::{Filter, Letterbox, Region, resize};
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A picture of a [`DetectionSet`].
#[derive(Clone, Debug, PartialEq)]
pub struct DetectionImage {
    /// Its file; empty for one given in memory.
    pub path: PathBuf,
    /// Pixels a row, as in the file.
    pub width: u32,
    /// Rows, as in the file.
    pub height: u32,
    /// What is in it; empty for background.
    pub targets: Vec<Target>,
}

/// Pictures with boxes, all of which were read once and found good.
#[derive(Debug)]
pub struct DetectionSet {
    names: Vec<String>,
    size: u32,
    images: Vec<DetectionImage>,
    report: CheckReport,
    limits: Limits,
    /// Place of each picture in the list it came from, by which it is kept.
    keys: Vec<usize>,
    cache: Cache<Frame>,
}

/// What the check of one picture found.
struct Checked {
    image: Option<DetectionImage>,
    findings: Vec<Finding>,
}

impl DetectionSet {
    /// Reads and checks one split (`train`, `val`, `test`) of a YOLO `data.yaml` for a
    /// network with an input of `size` x `size` pixels.
    ///
    /// All pictures are decoded, by several threads, and kept in memory as far as
    /// [`SetOptions::cache_bytes`] allows. Pictures that are missing or broken, boxes
    /// outside of their picture, rows with NaN and rows written twice are left out or
    /// clipped and counted, see [`DetectionSet::report`]. An empty or missing label file
    /// makes a background.
    ///
    /// # Errors
    /// [`DataError::Dataset`] for the `data.yaml`, and with file and line for a label row
    /// that is none or whose class does not exist; [`DataError::NothingLeft`];
    /// [`DataError::Option`] for a size that is not from 8 to 4096.
    pub fn open(
        data: &Path,
        split: &str,
        size: u32,
        options: &SetOptions,
    ) -> Result<Self, DataError> {
        check_size(size)?;
        let dataset = YoloDataset::open(data)?;
        let samples = dataset.split_with_missing(split)?;
        let cache = Cache::new(options.cache_bytes);
        let classes = dataset.names().len();
        let results = in_parallel(samples.len(), crate::threads(options.threads), |index| {
            let keep = |frame: Frame| {
                let frame = Arc::new(fitted(frame, size));
                cache.offer(index, &frame, frame.data().len());
            };
            check_one(samples.get(index), classes, &options.limits, keep)
        });
        let mut checked = Vec::with_capacity(results.len());
        for (result, sample) in results.into_iter().zip(&samples) {
            checked.push(match result {
                Ok(result) => result?,
                Err(panic) => Checked::broken(Problem::BrokenImage, &sample.image, panic),
            });
        }
        Self::build(dataset.names().to_vec(), size, checked, options.limits, cache)
    }

    /// A set of pictures in memory, checked as those of files are.
    ///
    /// # Errors
    /// As [`DetectionSet::open`]; the line of a bad class is the place of its target, from
    /// 1, and the file is the place of the picture.
    pub fn from_memory(
        names: Vec<String>,
        pictures: Vec<(Frame, Vec<Target>)>,
        size: u32,
    ) -> Result<Self, DataError> {
        check_size(size)?;
        let mut checked = Vec::with_capacity(pictures.len());
        let cache = Cache::new(usize::MAX);
        for (index, (frame, targets)) in pictures.into_iter().enumerate() {
            let mut findings = Vec::new();
            let (width, height) = (frame.width(), frame.height());
            let place = PathBuf::from(format!("picture {index}"));
            let mut kept = Vec::new();
            for (line, target) in (1..).zip(targets) {
                if target.class_id as usize >= names.len() {
                    let (text, classes) = (target.class_id.to_string(), names.len());
                    let kind = LabelErrorKind::Class { text, classes };
                    let error = LabelError { line, kind };
                    return Err(DatasetError::Label { path: place, error }.into());
                }
                kept.push((line, Ok(target)));
            }
            let targets = clean(kept, (width, height), &place, &mut findings);
            let image = DetectionImage { path: PathBuf::new(), width, height, targets };
            let frame = Arc::new(fitted(frame, size));
            cache.offer(index, &frame, frame.data().len());
            checked.push(Checked { image: Some(image), findings });
        }
        Self::build(names, size, checked, Limits::default(), cache)
    }

    fn build(
        names: Vec<String>,
        size: u32,
        checked: Vec<Checked>,
        limits: Limits,
        cache: Cache<Frame>,
    ) -> Result<Self, DataError> {
        let mut report = CheckReport { pictures: checked.len(), ..CheckReport::default() };
        let mut counts = vec![0; names.len()];
        let (mut images, mut keys) = (Vec::new(), Vec::new());
        for (key, Checked { image, findings }) in checked.into_iter().enumerate() {
            report.findings.extend(findings);
            let Some(image) = image else { continue };
            report.backgrounds += usize::from(image.targets.is_empty());
            for target in &image.targets {
                if let Some(count) = counts.get_mut(target.class_id as usize) {
                    *count += 1;
                }
            }
            images.push(image);
            keys.push(key);
        }
        report.usable = images.len();
        report.classes = names.iter().cloned().zip(counts).collect();
        report.cached = cache.used();
        if images.iter().all(|image| image.targets.is_empty()) {
            return Err(DataError::NothingLeft { report: Box::new(report) });
        }
        Ok(Self { names, size, images, report, limits, keys, cache })
    }

    /// Class names by class index.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Side of the network's input in pixels.
    #[must_use]
    pub fn size(&self) -> u32 {
        self.size
    }

    /// The pictures, in the order of the data set.
    #[must_use]
    pub fn images(&self) -> &[DetectionImage] {
        &self.images
    }

    /// What was found when the set was read, to be shown before training.
    #[must_use]
    pub fn report(&self) -> &CheckReport {
        &self.report
    }

    /// Width and height of every object in pixels of the network's input, without
    /// augmentation: what anchors are fitted to.
    pub fn object_sizes(&self) -> impl Iterator<Item = [f32; 2]> + '_ {
        self.images.iter().flat_map(|image| {
            let longest = image.width.max(image.height) as f32;
            let scale = self.size as f32 / longest;
            let (width, height) = (image.width as f32 * scale, image.height as f32 * scale);
            image.targets.iter().map(move |target| [target.w * width, target.h * height])
        })
    }

    /// The same pictures with one class, `name`, for everything that is labelled: what a
    /// follower needs that does not care which of several vehicles it follows.
    #[must_use]
    pub fn with_single_class(mut self, name: &str) -> Self {
        self.names = vec![name.to_owned()];
        let targets = self.images.iter_mut().flat_map(|image| &mut image.targets);
        targets.for_each(|target| target.class_id = 0);
        self
    }

    /// The same pictures with the objects of these classes alone, which are numbered in the
    /// order given; what else is labelled becomes background, from which the network learns
    /// what its target is not.
    ///
    /// # Errors
    /// [`DataError::UnknownClass`] for a name that the set does not have,
    /// [`DataError::ClassTwice`] for one that stands twice, and [`DataError::NothingLeft`] where no object is of these classes.
    pub fn with_classes(mut self, classes: &[String]) -> Result<Self, DataError> {
        let new_id = |old: &String| (0..).zip(classes).find(|(_, name)| *name == old);
        if let Some(name) = classes.iter().find(|name| !self.names.contains(name)) {
            return Err(DataError::UnknownClass { name: name.clone(), known: self.names });
        }
        let mut seen = HashSet::new();
        if let Some(name) = classes.iter().find(|name| !seen.insert(*name)) {
            return Err(DataError::ClassTwice { name: name.clone() });
        }
        let ids: Vec<_> = self.names.iter().map(|old| new_id(old).map(|(id, _)| id)).collect();
        for image in &mut self.images {
            image.targets.retain_mut(|target| {
                match ids.get(target.class_id as usize).copied().flatten() {
                    Some(id) => {
                        target.class_id = id;
                        true
                    }
                    None => false,
                }
            });
        }
        if self.images.iter().all(|image| image.targets.is_empty()) {
            return Err(DataError::NothingLeft { report: Box::new(self.report) });
        }
        self.names = classes.to_vec();
        Ok(self)
    }

    /// The picture of an index, RGB, its longer side as long as the network's input.
    ///
    /// # Errors
    /// [`SampleError`] for an index beyond the last one, and for a file that has changed
    /// since it was checked.
    pub fn frame(&self, index: usize) -> Result<Arc<Frame>, SampleError> {
        let path = self.images.get(index).map(|image| image.path.clone()).unwrap_or_default();
        let Some(&key) = self.keys.get(index) else {
            let reason = format!("the set has {} pictures", self.images.len());
            return Err(SampleError { index, path, reason });
        };
        self.cache.get_or(
            key,
            |frame| frame.data().len(),
            || match picture::read_with(&path, &self.limits, Vec::new()) {
                Ok(frame) => Ok(fitted(frame, self.size)),
                Err(error) => Err(SampleError { index, reason: reason(&error), path }),
            },
        )
    }
}

impl Checked {
    fn broken(problem: Problem, path: &Path, detail: impl std::fmt::Display) -> Self {
        Self { image: None, findings: vec![Finding::new(problem, path, detail)] }
    }
}

fn check_size(size: u32) -> Result<(), OptionError> {
    let ok = (8..=4096).contains(&size);
    OptionError::check("imgsz", f64::from(size), ok, "from 8 to 4096 pixels")
}

/// The error without the name of the file, which its reader has.
pub(crate) fn reason(error: &PictureError) -> String {
    match error {
        PictureError::Read { reason, .. } => reason.to_string(),
        PictureError::Decode { reason, .. } => reason.to_string(),
        other => other.to_string(),
    }
}

/// As large as the letterbox makes it, in RGB.
fn fitted(frame: Frame, size: u32) -> Frame {
    let frame = if frame.format() == PixelFormat::Rgb8 { frame } else { frame.to_rgb() };
    let (width, height) = Letterbox::fit(Region::whole(&frame), (size, size)).scaled_size();
    // The sides are at least 1.
    resize(&frame, width, height, Filter::Triangle).unwrap_or(frame)
}

fn check_one(
    sample: Option<&yolo::Sample>,
    classes: usize,
    limits: &Limits,
    keep: impl FnOnce(Frame),
) -> Result<Checked, DataError> {
    let Some(yolo::Sample { image: path, labels }) = sample else {
        return Ok(Checked { image: None, findings: Vec::new() });
    };
    // Labels first: a class that does not exist is an error, also beside a broken picture.
    let mut rows = Vec::new();
    match std::fs::read_to_string(labels) {
        Ok(text) => {
            for (line, row) in labels::rows(&text, classes) {
                let bad = |kind| {
                    let path = labels.clone();
                    DatasetError::Label { path, error: LabelError { line, kind } }
                };
                rows.push((
                    line,
                    match row {
                        Ok(row) => Ok(Target {
                            class_id: row.class_id,
                            cx: row.cx as f32,
                            cy: row.cy as f32,
                            w: row.w as f32,
                            h: row.h as f32,
                        }),
                        // A number, but none to use, as training tools write it by mistake.
                        Err(LabelErrorKind::Number { column, text })
                            if column > 1 && text.parse::<f64>().is_ok() =>
                        {
                            Err(format!("value {column} is {text}"))
                        }
                        Err(kind) => return Err(bad(kind).into()),
                    },
                ));
            }
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
        Err(reason) => return Err(DatasetError::Read { path: labels.clone(), reason }.into()),
    }
    let frame = match picture::read_with(path, limits, Vec::new()) {
        Ok(frame) => frame,
        Err(PictureError::Read { reason, .. }) if reason.kind() == std::io::ErrorKind::NotFound => {
            return Ok(Checked::broken(Problem::MissingImage, path, reason));
        }
        Err(error) => return Ok(Checked::broken(Problem::BrokenImage, path, reason(&error))),
    };
    let mut findings = Vec::new();
    let (width, height) = (frame.width(), frame.height());
    let targets = clean(rows, (width, height), labels, &mut findings);
    let image = DetectionImage { path: path.clone(), width, height, targets };
    keep(frame);
    Ok(Checked { image: Some(image), findings })
}

/// The targets that can be learned from, clipped to the picture.
fn clean(
    rows: Vec<(usize, Result<Target, String>)>,
    (width, height): (u32, u32),
    path: &Path,
    findings: &mut Vec<Finding>,
) -> Vec<Target> {
    /// How far a clipped edge may have moved, as a share, to be called rounding.
    const ROUNDING: f32 = 1e-4;
    let (width, height) = (width as f32, height as f32);
    let mut kept: Vec<Target> = Vec::new();
    let mut seen = std::collections::HashSet::new();
    for (line, row) in rows {
        let mut note = |problem, detail: String| {
            let line = Some(line);
            findings.push(Finding { problem, path: path.to_path_buf(), line, detail });
        };
        let finite = |t: &Target| [t.cx, t.cy, t.w, t.h].iter().all(|value| value.is_finite());
        let target = match row {
            Ok(target) if finite(&target) => target,
            Ok(target) => {
                note(Problem::RowNotFinite, format!("{target:?}"));
                continue;
            }
            Err(detail) => {
                note(Problem::RowNotFinite, detail);
                continue;
            }
        };
        let written = [target.cx, target.cy, target.w, target.h];
        if !seen.insert((target.class_id, written.map(f32::to_bits))) {
            note(Problem::RowTwice, format!("{written:?}"));
            continue;
        }
        let whole = target.to_pixels(1.0, 1.0);
        let inside = whole.clipped(1.0, 1.0);
        if !whole.is_proper() || inside.width() * width < 1.0 || inside.height() * height < 1.0 {
            note(Problem::BoxOutside, format!("box {written:?} (middle and size as shares)"));
            continue;
        }
        let moved = |a: f32, b: f32| (a - b).abs() > ROUNDING;
        if moved(whole.x0, inside.x0)
            || moved(whole.y0, inside.y0)
            || moved(whole.x1, inside.x1)
            || moved(whole.y1, inside.y1)
        {
            note(Problem::BoxClipped, format!("box {written:?} (middle and size as shares)"));
        }
        kept.push(Target::from_pixels(target.class_id, &inside, 1.0, 1.0));
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::Stamp;

    #[test]
    fn one_class_for_everything() {
        let frame = Frame::rgb8(Stamp::ZERO, 40, 20, vec![9; 40 * 20 * 3]).unwrap();
        let target = |class_id, cx| Target { class_id, cx, cy: 0.5, w: 0.2, h: 0.4 };
        let pictures = vec![(frame, vec![target(0, 0.2), target(2, 0.7)])];
        let names = ["car", "truck", "robot"].map(str::to_owned).to_vec();
        let set = DetectionSet::from_memory(names, pictures, 32).unwrap();
        let set = set.with_single_class("vehicle");
        assert_eq!(set.names(), ["vehicle"]);
        assert!(set.images()[0].targets.iter().all(|target| target.class_id == 0));
        assert_eq!(set.images()[0].targets.len(), 2);
        let frame = set.frame(0).unwrap();
        assert_eq!((frame.width(), frame.height()), (32, 16));
        assert!(set.frame(1).is_err());
    }

    #[test]
    fn some_classes_and_the_rest_is_background() {
        let frame = |seed| Frame::rgb8(Stamp::ZERO, 40, 20, vec![seed; 2400]).unwrap();
        let target = |class_id| Target { class_id, cx: 0.5, cy: 0.5, w: 0.2, h: 0.4 };
        let set = || {
            let pictures = vec![
                (frame(1), vec![target(0), target(2), target(1)]),
                (frame(2), vec![target(1)]),
            ];
            let names = ["car", "truck", "robot"].map(str::to_owned).to_vec();
            DetectionSet::from_memory(names, pictures, 32).unwrap()
        };
        let some = set().with_classes(&["robot".to_owned(), "car".to_owned()]).unwrap();
        assert_eq!(some.names(), ["robot", "car"]);
        let ids = |index: usize| {
            some.images()[index].targets.iter().map(|target| target.class_id).collect::<Vec<_>>()
        };
        assert_eq!((ids(0), ids(1)), (vec![1, 0], vec![]));

        let error = set().with_classes(&["cart".to_owned()]).unwrap_err();
        assert_eq!(error.to_string(), "class \"cart\" is not one of car, truck, robot");
        let twice = ["car", "robot", "car"].map(str::to_owned);
        let error = set().with_classes(&twice).unwrap_err();
        assert_eq!(error.to_string(), "class \"car\" is given twice");
        let none = vec![(frame(3), vec![target(0)])];
        let none = DetectionSet::from_memory(set().names().to_vec(), none, 32).unwrap();
        let error = none.with_classes(&["truck".to_owned()]).unwrap_err();
        assert!(matches!(error, DataError::NothingLeft { .. }));
    }
}
