//! What a run found: JSON lines, YOLO text and COCO results.

use crate::atomic::{self, WriteError};
use crate::datasets::coco::{self, CocoResult};
use crate::datasets::labels;
use realnet_core::{Detection, Frame};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::io::{self, Write};
use std::path::Path;

/// Milliseconds spent on one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageMs {
    /// Preparing the network input.
    #[serde(serialize_with = "three_decimals")]
    pub pre: f64,
    /// The network itself.
    #[serde(serialize_with = "three_decimals")]
    pub infer: f64,
    /// From the network output to boxes.
    #[serde(serialize_with = "three_decimals")]
    pub post: f64,
}

/// One object of a [`Record`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordDetection {
    /// Index of the class.
    pub class_id: u32,
    /// Name of the class; its index as text when it has none.
    pub class: String,
    /// 0 to 1, written with 5 decimals.
    #[serde(serialize_with = "five_decimals")]
    pub confidence: f64,
    /// Left, top, right, bottom in pixels of the source frame, written with 3
    /// decimals.
    #[serde(rename = "box", serialize_with = "pixels")]
    pub bbox: [f64; 4],
}

/// What was found in one frame: one line of JSON, fields in this order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Number of the frame in its source, from 0.
    pub frame: u64,
    /// Path of the picture, or the source.
    pub source: String,
    /// Stamp of the frame in nanoseconds.
    pub stamp_ns: i64,
    /// Pixels a row of the source frame.
    pub width: u32,
    /// Rows of the source frame.
    pub height: u32,
    /// The objects.
    pub detections: Vec<RecordDetection>,
    /// Time spent.
    pub ms: StageMs,
}

impl Record {
    /// The record of `frame`, number `index` of `source`.
    #[must_use]
    pub fn new(
        index: u64,
        source: &str,
        frame: &Frame,
        detections: &[Detection],
        names: &[String],
        ms: StageMs,
    ) -> Self {
        let detections = detections
            .iter()
            .map(|d| RecordDetection {
                class_id: d.class_id,
                class: names
                    .get(d.class_id as usize)
                    .cloned()
                    .unwrap_or_else(|| d.class_id.to_string()),
                confidence: f64::from(d.confidence),
                bbox: <[f32; 4]>::from(d.bbox).map(f64::from),
            })
            .collect();
        Self {
            frame: index,
            source: source.to_string(),
            stamp_ns: frame.stamp().nanos(),
            width: frame.width(),
            height: frame.height(),
            detections,
            ms,
        }
    }

    /// Writes the record as one line.
    ///
    /// # Errors
    /// Those of `out`, for example a closed pipe.
    pub fn write_line(&self, mut out: impl Write) -> io::Result<()> {
        // One write a line: a reader of a pipe gets whole lines.
        let mut line = serde_json::to_vec(self)?;
        line.push(b'\n');
        out.write_all(&line)
    }
}

fn rounded(value: f64, scale: f64) -> f64 {
    (value * scale).round() / scale
}

fn three_decimals<S: serde::Serializer>(value: &f64, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_f64(rounded(*value, 1e3))
}

fn five_decimals<S: serde::Serializer>(value: &f64, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_f64(rounded(*value, 1e5))
}

fn pixels<S: serde::Serializer>(value: &[f64; 4], s: S) -> Result<S::Ok, S::Error> {
    value.map(|v| rounded(v, 1e3)).serialize(s)
}

/// Writes the detections of one frame as YOLO text, `class cx cy w h`
/// normalised by the frame's size, with the confidence as a sixth column if
/// asked. A frame without detections gives an empty file.
///
/// # Errors
/// [`WriteError`] with the path.
pub fn write_yolo(
    path: &Path,
    detections: &[Detection],
    width: u32,
    height: u32,
    with_confidence: bool,
) -> Result<(), WriteError> {
    let text: String = detections
        .iter()
        .map(|d| labels::row_of(d, width, height, with_confidence) + "\n")
        .collect();
    atomic::write(path, text.as_bytes())
}

/// Numbers for pictures, as COCO files want them.
///
/// A picture whose name is a number has this number (`000123.jpg` is 123), as
/// Ultralytics does it; every other picture, and a second one with a number
/// already given away, gets the next free number from 0.
#[derive(Clone, Debug, Default)]
pub struct ImageIds {
    used: HashSet<u64>,
    next: u64,
}

impl ImageIds {
    /// The number of a picture. Ask once for each picture.
    pub fn assign(&mut self, path: &Path) -> u64 {
        let stem = path.file_stem().map(|s| s.to_string_lossy()).unwrap_or_default();
        let digits = !stem.is_empty() && stem.bytes().all(|b| b.is_ascii_digit());
        if digits
            && let Ok(id) = stem.parse()
            && self.used.insert(id)
        {
            return id;
        }
        loop {
            let id = self.next;
            self.next += 1;
            if self.used.insert(id) {
                return id;
            }
        }
    }
}

/// Collects COCO results and writes them at the end, with all their digits: an
/// evaluation of the file must see the boxes that the network found.
#[derive(Clone, Debug, Default)]
pub struct CocoCollector {
    category_ids: Option<Vec<u64>>,
    results: Vec<CocoResult>,
}

impl CocoCollector {
    /// A collector. `category_ids` gives the COCO number of each class index;
    /// without it both are equal.
    #[must_use]
    pub fn new(category_ids: Option<Vec<u64>>) -> Self {
        Self { category_ids, results: Vec::new() }
    }

    /// Adds the detections of one picture.
    pub fn add(&mut self, image_id: u64, detections: &[Detection]) {
        let ids = self.category_ids.as_deref();
        self.results.extend(detections.iter().map(|d| {
            let class = u64::from(d.class_id);
            let mapped = ids.and_then(|ids| ids.get(d.class_id as usize)).copied();
            let b = <[f32; 4]>::from(d.bbox).map(f64::from);
            CocoResult {
                image_id,
                category_id: mapped.unwrap_or(class),
                bbox: [b[0], b[1], b[2] - b[0], b[3] - b[1]],
                score: f64::from(d.confidence),
            }
        }));
    }

    /// The results so far.
    #[must_use]
    pub fn results(&self) -> &[CocoResult] {
        &self.results
    }

    /// Writes all results as one JSON array, whole or not at all.
    ///
    /// # Errors
    /// [`WriteError`] with the path.
    pub fn write(&self, path: &Path) -> Result<(), WriteError> {
        coco::write_results(path, &self.results)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::Stamp;

    fn sample() -> (Frame, Vec<Detection>) {
        let frame = Frame::rgb8(Stamp::from_nanos(40_000_000), 4, 2, vec![0; 24]).unwrap();
        let bbox = [0.1, 0.2, 3.000_04, 1.5].into();
        (frame, vec![Detection { class_id: 0, confidence: 0.82, bbox }])
    }

    #[test]
    fn a_record_is_the_promised_line() {
        let (frame, detections) = sample();
        let ms = StageMs { pre: 0.412_34, infer: 4.0, post: 0.1 };
        let names = ["person".to_string()];
        let record = Record::new(1, "a.mp4", &frame, &detections, &names, ms);
        let mut line = Vec::new();
        record.write_line(&mut line).unwrap();
        assert_eq!(
            String::from_utf8(line.clone()).unwrap(),
            "{\"frame\":1,\"source\":\"a.mp4\",\"stamp_ns\":40000000,\"width\":4,\"height\":2,\
             \"detections\":[{\"class_id\":0,\"class\":\"person\",\"confidence\":0.82,\
             \"box\":[0.1,0.2,3.0,1.5]}],\"ms\":{\"pre\":0.412,\"infer\":4.0,\"post\":0.1}}\n"
        );
        let back: Record = serde_json::from_slice(&line).unwrap();
        assert_eq!(back.detections[0].class, "person");
    }

    #[test]
    fn classes_without_a_name_are_numbers() {
        let (frame, detections) = sample();
        let record = Record::new(0, "x", &frame, &detections, &[], StageMs::default());
        assert_eq!(record.detections[0].class, "0");
    }

    #[test]
    fn image_ids_are_unique() {
        let mut ids = ImageIds::default();
        let mut id = |name: &str| ids.assign(Path::new(name));
        assert_eq!(id("a/000001.jpg"), 1);
        assert_eq!(id("bus.jpg"), 0);
        assert_eq!(id("zidane.jpg"), 2);
        assert_eq!(id("b/1.jpg"), 3);
        assert_eq!(id("99999999999999999999999.jpg"), 4);
        assert_eq!(id("+7.jpg"), 5);
    }

    #[test]
    fn coco_results_use_the_category_numbers() {
        let (_, detections) = sample();
        let mut collector = CocoCollector::new(Some(vec![17]));
        collector.add(5, &detections);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("r.json");
        collector.write(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with(r#"[{"image_id":5,"category_id":17,"bbox":["#), "{text}");
        assert_eq!(collector.results()[0].score as f32, 0.82);
        assert_eq!(collector.results()[0].bbox[0] as f32, 0.1);
        assert_eq!(coco::read_results(&path).unwrap(), collector.results());
        let error = collector.write(&dir.path().join("no/r.json")).unwrap_err();
        assert!(error.to_string().contains("no/r.json"));
    }

    #[test]
    fn yolo_text_round_trips() {
        let (_, detections) = sample();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.txt");
        write_yolo(&path, &detections, 4, 2, true).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text, "0 0.387505 0.425000 0.725010 0.650000 0.820000\n");
        write_yolo(&path, &detections, 4, 2, false).unwrap();
        let read = labels::read(&path, 1).unwrap();
        assert!((read.rows[0].to_pixels(4, 2).x1 - 3.0).abs() < 1e-3);
    }
}
