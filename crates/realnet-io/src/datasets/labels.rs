//! YOLO label rows.
//!
//! A row is `class cx cy w h`, centre and size divided by the picture's width
//! and height, or a polygon `class x1 y1 x2 y2 x3 y3 …`, of which the enclosing
//! box is taken (each row for itself, whatever the other rows are). Values may
//! leave 0..1 by [`TOLERANCE`], as Ultralytics allows, and are then clipped.

use super::{DatasetError, read_text};
use realnet_core::{BoundingBox, Detection};
use std::path::Path;
use thiserror::Error;

/// How far a value may lie outside 0..1.
pub const TOLERANCE: f64 = 0.01;

/// One labelled object, normalised by the picture's size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Label {
    /// Index of the class.
    pub class_id: u32,
    /// Centre x over picture width.
    pub cx: f64,
    /// Centre y over picture height.
    pub cy: f64,
    /// Width over picture width.
    pub w: f64,
    /// Height over picture height.
    pub h: f64,
}

impl Label {
    /// The box in pixels of a picture of `width` x `height`.
    #[must_use]
    pub fn to_pixels(&self, width: u32, height: u32) -> BoundingBox {
        let (w, h) = (f64::from(width), f64::from(height));
        BoundingBox::new(
            ((self.cx - self.w / 2.0) * w) as f32,
            ((self.cy - self.h / 2.0) * h) as f32,
            ((self.cx + self.w / 2.0) * w) as f32,
            ((self.cy + self.h / 2.0) * h) as f32,
        )
    }
}

/// The labels of one picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Labels {
    /// The objects, in the order of the file, without duplicates.
    pub rows: Vec<Label>,
    /// How many rows were exact duplicates of an earlier one and left out.
    pub duplicates: usize,
}

/// What is wrong in a row.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum LabelErrorKind {
    /// Neither a box nor a polygon.
    #[error(
        "{found} values in a row; a box has 5 (class cx cy w h), a polygon 1 + 2n with n >= 3, separated by spaces"
    )]
    Count {
        /// Values found.
        found: usize,
    },
    /// Not a number, or not a finite one.
    #[error("value {column} is {text:?}, not a finite number")]
    Number {
        /// Which value, from 1.
        column: usize,
        /// As it is written.
        text: String,
    },
    /// The class is not a whole number below the number of classes.
    #[error("class {text} is not one of the {classes} classes (0 to {})", classes.saturating_sub(1))]
    Class {
        /// As it is written.
        text: String,
        /// How many classes there are.
        classes: usize,
    },
    /// A coordinate outside 0..1.
    #[error(
        "value {column} is {value}, outside 0..1: coordinates are divided by the picture's size"
    )]
    Range {
        /// Which value, from 1.
        column: usize,
        /// The value.
        value: f64,
    },
}

/// A bad row.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("line {line}: {kind}")]
pub struct LabelError {
    /// The line, from 1.
    pub line: usize,
    /// What is wrong.
    pub kind: LabelErrorKind,
}

/// Parses the text of a label file; empty lines are skipped.
///
/// # Errors
/// [`LabelError`] for the first bad row.
pub fn parse(text: &str, classes: usize) -> Result<Labels, LabelError> {
    let mut labels = Labels::default();
    let mut seen = std::collections::HashSet::new();
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (index, line) in text.lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        let row = row(line, classes).map_err(|kind| LabelError { line: index + 1, kind })?;
        let key = (row.class_id, [row.cx, row.cy, row.w, row.h].map(f64::to_bits));
        if seen.insert(key) {
            labels.rows.push(row);
        } else {
            labels.duplicates += 1;
        }
    }
    Ok(labels)
}

/// The rows of a label file one by one, each with its line (from 1), for a reader that
/// goes on after a bad one; empty lines are skipped. Coordinates outside 0..1 are left
/// as they are, so [`LabelErrorKind::Range`] is not among the errors, and rows that are
/// written twice come twice.
pub fn rows(
    text: &str,
    classes: usize,
) -> impl Iterator<Item = (usize, Result<Label, LabelErrorKind>)> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let rows = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    rows.map(move |(line, row)| (line, values(row, classes).map(|(class, v)| label(class, &v))))
}

fn row(line: &str, classes: usize) -> Result<Label, LabelErrorKind> {
    let (class_id, mut values) = values(line, classes)?;
    for (index, value) in values.iter_mut().enumerate() {
        if !(-TOLERANCE..=1.0 + TOLERANCE).contains(value) {
            return Err(LabelErrorKind::Range { column: index + 2, value: *value });
        }
        *value = value.clamp(0.0, 1.0);
    }
    Ok(label(class_id, &values))
}

/// The class and the numbers behind it: 4, or 6 and more.
fn values(line: &str, classes: usize) -> Result<(u32, Vec<f64>), LabelErrorKind> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let (Some((class, rest)), found) = (words.split_first(), words.len()) else {
        return Err(LabelErrorKind::Count { found: 0 });
    };
    if !(found == 5 || (found >= 7 && found % 2 == 1)) {
        return Err(LabelErrorKind::Count { found });
    }
    let class_id = class_of(class, classes)?;
    let values: Result<_, _> = rest.iter().zip(2..).map(|(w, column)| number(w, column)).collect();
    Ok((class_id, values?))
}

/// A box, or the one around a polygon.
fn label(class_id: u32, values: &[f64]) -> Label {
    if let [cx, cy, w, h] = *values {
        return Label { class_id, cx, cy, w, h };
    }
    let bounds = |offset: usize| {
        values
            .iter()
            .skip(offset)
            .step_by(2)
            .fold((f64::MAX, f64::MIN), |(lo, hi), v| (lo.min(*v), hi.max(*v)))
    };
    let ((x0, x1), (y0, y1)) = (bounds(0), bounds(1));
    let (cx, cy) = ((x0 + x1) / 2.0, (y0 + y1) / 2.0);
    Label { class_id, cx, cy, w: x1 - x0, h: y1 - y0 }
}

fn number(word: &str, column: usize) -> Result<f64, LabelErrorKind> {
    match word.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(LabelErrorKind::Number { column, text: word.chars().take(40).collect() }),
    }
}

/// The class; some tools write it as `2.0`.
fn class_of(word: &str, classes: usize) -> Result<u32, LabelErrorKind> {
    let value = number(word, 1)?;
    let whole = value.fract() == 0.0 && value >= 0.0 && value < classes as f64;
    if whole && value <= f64::from(u32::MAX) {
        Ok(value as u32)
    } else {
        Err(LabelErrorKind::Class { text: word.chars().take(40).collect(), classes })
    }
}

/// Reads the label file of a picture. A missing file means: nothing in the
/// picture.
///
/// # Errors
/// [`DatasetError::Label`] with file, line and value, or
/// [`DatasetError::Read`].
pub fn read(path: &Path, classes: usize) -> Result<Labels, DatasetError> {
    let text = match read_text(path) {
        Ok(text) => text,
        Err(DatasetError::Read { reason, .. }) if reason.kind() == std::io::ErrorKind::NotFound => {
            return Ok(Labels::default());
        }
        Err(error) => return Err(error),
    };
    parse(&text, classes).map_err(|error| DatasetError::Label { path: path.to_path_buf(), error })
}

/// A detection as a row, six decimals, with the confidence as a sixth value if
/// asked. The picture's sides must not be 0.
#[must_use]
pub fn row_of(detection: &Detection, width: u32, height: u32, with_confidence: bool) -> String {
    let (w, h) = (f64::from(width), f64::from(height));
    let [x0, y0, x1, y1] = <[f32; 4]>::from(detection.bbox).map(f64::from);
    let mut row = format!(
        "{} {:.6} {:.6} {:.6} {:.6}",
        detection.class_id,
        (x0 + x1) / 2.0 / w,
        (y0 + y1) / 2.0 / h,
        (x1 - x0) / w,
        (y1 - y0) / h
    );
    if with_confidence {
        row.push_str(&format!(" {:.6}", detection.confidence));
    }
    row
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn boxes_polygons_and_duplicates() {
        let text =
            "\u{feff}0 0.5 0.5 0.2 0.1\n\n 1.0 0.1 0.2 0.3 0.2 0.2 0.6 \r\n0 0.5 0.5 0.2 0.1";
        let labels = parse(text, 2).unwrap();
        assert_eq!(labels.duplicates, 1);
        assert_eq!(labels.rows[0], Label { class_id: 0, cx: 0.5, cy: 0.5, w: 0.2, h: 0.1 });
        let b = labels.rows[1].to_pixels(100, 100);
        let expected = [10.0, 20.0, 30.0, 60.0];
        for (found, wanted) in <[f32; 4]>::from(b).into_iter().zip(expected) {
            assert!((found - wanted).abs() < 1e-4);
        }
        assert_eq!(parse("0 1.005 -0.005 0.2 0.1", 1).unwrap().rows[0].cx, 1.0);
    }

    #[test]
    fn rows_go_on_after_a_bad_one() {
        let text = "0 1.2 0.5 0.6 0.1\n\n0 nan 0.5 0.2 0.1\n7 0.5 0.5 0.2 0.1\n1 0 0 2 0 2 4";
        let read: Vec<_> = rows(text, 2).collect();
        assert_eq!(read[0], (1, Ok(Label { class_id: 0, cx: 1.2, cy: 0.5, w: 0.6, h: 0.1 })));
        assert_eq!(read[1].0, 3);
        assert!(matches!(read[1].1, Err(LabelErrorKind::Number { column: 2, .. })));
        assert_eq!(read[2].0, 4);
        assert!(matches!(read[2].1, Err(LabelErrorKind::Class { classes: 2, .. })));
        assert_eq!(read[3], (5, Ok(Label { class_id: 1, cx: 1.0, cy: 2.0, w: 2.0, h: 4.0 })));
    }

    #[test]
    fn every_bad_row_names_line_and_value() {
        for (row, wanted) in [
            ("0 0.5 0.5 0.2", "line 2: 4 values"),
            ("0 0.5 0.5 0.2 0.1 0.9", "line 2: 6 values"),
            ("0 0.5 0.5 0.2 0.1 0.9 0.1 0.2", "line 2: 8 values"),
            ("2 0.5 0.5 0.2 0.1", "class 2 is not one of the 2 classes (0 to 1)"),
            ("-1 0.5 0.5 0.2 0.1", "class -1"),
            ("0.5 0.5 0.5 0.2 0.1", "class 0.5"),
            ("car 0.5 0.5 0.2 0.1", "value 1 is \"car\""),
            ("0 0.5 x 0.2 0.1", "value 3 is \"x\", not a finite number"),
            ("0 0.5 nan 0.2 0.1", "value 3 is \"nan\""),
            ("0 0.5 0.5 inf 0.1", "value 4 is \"inf\""),
            ("0 0.5 0.5 1e999 0.1", "value 4 is \"1e999\""),
            ("0 320 240 64 48", "value 2 is 320, outside 0..1"),
            ("0 0.5 0.5 -0.2 0.1", "value 4 is -0.2"),
            ("0,0.5,0.5,0.2,0.1", "line 2: 1 values"),
        ] {
            let error = parse(&format!("0 0.5 0.5 0.1 0.1\n{row}"), 2).unwrap_err().to_string();
            assert!(error.contains(wanted) && error.contains("line 2"), "{row}: {error}");
        }
    }

    proptest! {
        #[test]
        fn rows_round_trip(
            class_id in 0u32..80,
            (x, y) in (0.0f32..600.0, 0.0f32..400.0),
            (w, h) in (0.5f32..40.0, 0.5f32..80.0),
        ) {
            let bbox = BoundingBox::from_corner(x, y, w, h);
            let row = row_of(&Detection { class_id, confidence: 0.5, bbox }, 640, 480, false);
            let read = parse(&row, 80).unwrap().rows[0];
            prop_assert_eq!(read.class_id, class_id);
            let back = <[f32; 4]>::from(read.to_pixels(640, 480));
            for (a, b) in back.into_iter().zip(<[f32; 4]>::from(bbox)) {
                prop_assert!((a - b).abs() < 2e-3);
            }
        }

        #[test]
        fn any_text_is_labels_or_an_error(text in "[0-9a-z .+\\-\n]{0,200}") {
            let _ = parse(&text, 3);
        }
    }
}
