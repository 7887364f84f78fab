//! Boxes of one target by frame number: a CSV file, or a folder of YOLO labels.

use super::{DatasetError, labels, read_text};
use realnet_core::BoundingBox;
use std::collections::BTreeMap;
use std::path::Path;

/// The first line of a CSV file.
const HEADER: [&str; 5] = ["frame", "x0", "y0", "x1", "y1"];
/// Any class index below this is fine: the class is not looked at.
const CLASSES: usize = 1 << 16;

/// The box of one target in each frame where it is known.
///
/// Read from a CSV file with the header `frame,x0,y0,x1,y1` and a line for each
/// frame (edges in pixels, in the sense of [`BoundingBox`]), or from a folder of
/// YOLO labels whose names are frame numbers (`000012.txt`), with at most one
/// box in each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TargetBoxes {
    boxes: BTreeMap<u64, Edges>,
}

/// Edges as they are written.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Edges {
    Pixels(BoundingBox),
    Normalised(labels::Label),
}

impl TargetBoxes {
    /// Reads a CSV file or a folder of labels.
    ///
    /// # Errors
    /// [`DatasetError`] with the file, the line and what is wrong there.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        if path.is_dir() {
            return Self::read_labels(path);
        }
        Self::parse_csv(&read_text(path)?).map_err(|(line, message)| DatasetError::Boxes {
            path: path.to_path_buf(),
            line,
            message,
        })
    }

    /// Parses the text of a CSV file.
    ///
    /// # Errors
    /// The line, from 1, and what is wrong in it.
    pub fn parse_csv(text: &str) -> Result<Self, (usize, String)> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut rows = (1..).zip(text.lines()).filter(|(_, row)| !row.trim().is_empty());
        let wanted = HEADER.join(",");
        let header = rows.next().map_or("", |(_, row)| row);
        if !header.split(',').map(str::trim).eq(HEADER) {
            let found: String = header.chars().take(60).collect();
            return Err((1, format!("the first line must be `{wanted}`, found {found:?}")));
        }
        let mut boxes = BTreeMap::new();
        for (line, row) in rows {
            let (number, bbox) = csv_row(row).map_err(|message| (line, message))?;
            if boxes.insert(number, Edges::Pixels(bbox)).is_some() {
                return Err((line, format!("a second box for frame {number}")));
            }
        }
        Ok(Self { boxes })
    }

    fn read_labels(folder: &Path) -> Result<Self, DatasetError> {
        let failed = |reason| DatasetError::Read { path: folder.to_path_buf(), reason };
        let mut boxes = BTreeMap::new();
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(failed)? {
            paths.push(entry.map_err(failed)?.path());
        }
        paths.sort();
        for path in paths {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let is_text = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("txt"));
            let digits = !stem.is_empty() && stem.bytes().all(|b| b.is_ascii_digit());
            let (true, true, Ok(number)) = (is_text, digits, stem.parse::<u64>()) else { continue };
            let bad = |message| DatasetError::Boxes { path: path.clone(), line: 1, message };
            let found = labels::read(&path, CLASSES)?;
            match found.rows[..] {
                [] => {}
                [label] => {
                    if boxes.insert(number, Edges::Normalised(label)).is_some() {
                        return Err(bad(format!("a second file for frame {number}")));
                    }
                }
                _ => {
                    let count = found.rows.len();
                    return Err(bad(format!("{count} boxes, at most one is a target's")));
                }
            }
        }
        if boxes.is_empty() {
            return Err(DatasetError::Boxes {
                path: folder.to_path_buf(),
                line: 0,
                message: "no label file named by a frame number (000012.txt) has a box".into(),
            });
        }
        Ok(Self { boxes })
    }

    /// The box in frame `number`, in pixels of a picture of `width` x `height`;
    /// `None` when there is none.
    #[must_use]
    pub fn get(&self, number: u64, width: u32, height: u32) -> Option<BoundingBox> {
        match self.boxes.get(&number)? {
            Edges::Pixels(bbox) => Some(*bbox),
            Edges::Normalised(label) => Some(label.to_pixels(width, height)),
        }
    }

    /// The numbers of the frames with a box, rising.
    pub fn numbers(&self) -> impl Iterator<Item = u64> {
        self.boxes.keys().copied()
    }

    /// How many frames have a box.
    #[must_use]
    pub fn len(&self) -> usize {
        self.boxes.len()
    }

    /// True when no frame has a box.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.boxes.is_empty()
    }
}

fn csv_row(row: &str) -> Result<(u64, BoundingBox), String> {
    let words: Vec<&str> = row.split(',').map(str::trim).collect();
    let [frame, edges @ ..] = words.as_slice() else { return Err("an empty line".into()) };
    let shown = |word: &str| word.chars().take(40).collect::<String>();
    if edges.len() != 4 {
        return Err(format!("{} values, `{}` has 5", words.len(), HEADER.join(",")));
    }
    let number =
        frame.parse::<u64>().map_err(|_| format!("{:?} is not a frame number", shown(frame)))?;
    let mut values = [0.0f32; 4];
    for ((value, word), name) in values.iter_mut().zip(edges).zip(&HEADER[1..]) {
        *value = match word.parse::<f32>() {
            Ok(v) if v.is_finite() => v,
            _ => return Err(format!("{name} is {:?}, not a finite number", shown(word))),
        };
    }
    let bbox = BoundingBox::from(values);
    if bbox.is_proper() {
        Ok((number, bbox))
    } else {
        Err(format!("the box {values:?} is empty: x0 < x1 and y0 < y1 are needed"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn boxes_of_a_file() {
        let text = "\u{feff}frame, x0,y0,x1,y1\r\n7,1,2,3.5,4\n\n3,-1,0,5,6\n";
        let boxes = TargetBoxes::parse_csv(text).unwrap();
        assert_eq!(boxes.numbers().collect::<Vec<_>>(), [3, 7]);
        assert_eq!(boxes.get(7, 640, 480), Some(BoundingBox::new(1.0, 2.0, 3.5, 4.0)));
        assert_eq!(boxes.get(4, 640, 480), None);
        assert!(TargetBoxes::parse_csv("frame,x0,y0,x1,y1\n").unwrap().is_empty());
    }

    #[test]
    fn every_bad_line_is_named() {
        for (row, wanted) in [
            ("1,2,3,4", "4 values"),
            ("1,2,3,4,5,6", "6 values"),
            ("-1,2,3,4,5", "\"-1\" is not a frame number"),
            ("1.5,2,3,4,5", "\"1.5\" is not a frame number"),
            ("1,a,3,4,5", "x0 is \"a\""),
            ("1,2,3,nan,5", "x1 is \"nan\""),
            ("1,2,3,4,1e99", "y1 is \"1e99\""),
            ("1,4,3,4,5", "is empty"),
            ("0,4,3,5,5", "a second box for frame 0"),
        ] {
            let text = format!("frame,x0,y0,x1,y1\n0,1,1,2,2\n{row}\n");
            let (line, message) = TargetBoxes::parse_csv(&text).unwrap_err();
            assert!(line == 3 && message.contains(wanted), "{row}: {line}: {message}");
        }
        for text in ["", "0,1,2,3,4\n", "frame;x0;y0;x1;y1\n"] {
            let (line, message) = TargetBoxes::parse_csv(text).unwrap_err();
            assert!(line == 1 && message.contains("`frame,x0,y0,x1,y1`"), "{message}");
        }
    }

    #[test]
    fn a_folder_of_labels_by_number() {
        let dir = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
        write("classes.txt", "car\n");
        write("000002.txt", "5 0.5 0.5 0.5 0.25\n");
        write("000003.txt", "");
        let boxes = TargetBoxes::read(dir.path()).unwrap();
        let found = boxes.get(2, 100, 200).unwrap();
        assert_eq!(<[f32; 4]>::from(found), [25.0, 75.0, 75.0, 125.0]);
        assert_eq!((boxes.len(), boxes.get(3, 100, 200)), (1, None));

        write("4.txt", "0 0.5 0.5 0.5 0.25\n0 0.1 0.1 0.1 0.1\n");
        let error = TargetBoxes::read(dir.path()).unwrap_err().to_string();
        assert!(error.contains("4.txt:1: 2 boxes"), "{error}");
        write("4.txt", "0 0.5 0.5 nan 0.25\n");
        let error = TargetBoxes::read(dir.path()).unwrap_err().to_string();
        assert!(error.contains("4.txt:1: value 4 is \"nan\""), "{error}");
        write("4.txt", "");
        write("2.txt", "5 0.5 0.5 0.5 0.25\n");
        let error = TargetBoxes::read(dir.path()).unwrap_err().to_string();
        assert!(error.contains("2.txt:1: a second file for frame 2"), "{error}");
        let error = TargetBoxes::read(tempfile::tempdir().unwrap().path()).unwrap_err().to_string();
        assert!(error.contains("no label file named by a frame number"), "{error}");
        let error = TargetBoxes::read(&dir.path().join("no.csv")).unwrap_err().to_string();
        assert!(error.contains("no.csv: No such file"), "{error}");
    }

    proptest! {
        #[test]
        fn any_text_is_boxes_or_an_error(text in "(frame,x0,y0,x1,y1\n)?[0-9a-e,.\\-\n]{0,120}") {
            let _ = TargetBoxes::parse_csv(&text);
        }
    }
}
