//! COCO json: ground truth and results, in and out.

use super::DatasetError;
use crate::atomic::{self, WriteError};
use realnet_core::BoundingBox;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// One picture of a [`CocoDataset`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CocoImage {
    /// The picture's number.
    pub id: u64,
    /// Its file name, relative to the folder of the pictures.
    pub file_name: String,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// One labelled object of a [`CocoDataset`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CocoAnnotation {
    /// The object's number.
    pub id: u64,
    /// Number of its picture ([`CocoImage::id`]).
    pub image_id: u64,
    /// Class index, contiguous from 0.
    pub class_id: u32,
    /// Left, top, width, height in pixels.
    pub bbox: [f64; 4],
    /// Area in square pixels (of the segment, where there is one).
    pub area: f64,
    /// A crowd, which the protocol ignores.
    pub iscrowd: bool,
}

/// One detection of a results file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CocoResult {
    /// The picture's number.
    pub image_id: u64,
    /// COCO number of the class (not the class index).
    pub category_id: u64,
    /// Left, top, width, height in pixels.
    pub bbox: [f64; 4],
    /// Confidence.
    pub score: f64,
}

/// Left, top, width, height as a box of edges.
#[must_use]
pub fn to_box([x, y, w, h]: [f64; 4]) -> BoundingBox {
    BoundingBox::new(x as f32, y as f32, (x + w) as f32, (y + h) as f32)
}

/// COCO ground truth. COCO numbers its classes with gaps; here they are indices
/// from 0 in ascending order of the COCO number, and the numbers are kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CocoDataset {
    /// The pictures, in the order of the file.
    pub images: Vec<CocoImage>,
    /// The objects, in the order of the file.
    pub annotations: Vec<CocoAnnotation>,
    /// Class names by class index.
    pub names: Vec<String>,
    /// COCO number of each class index.
    pub category_ids: Vec<u64>,
}

#[derive(Serialize, Deserialize)]
struct RawCategory {
    id: u64,
    name: String,
}

#[derive(Serialize, Deserialize)]
struct RawAnnotation {
    id: Option<u64>,
    image_id: u64,
    category_id: u64,
    bbox: [f64; 4],
    area: Option<f64>,
    #[serde(default)]
    iscrowd: u8,
}

#[derive(Serialize, Deserialize)]
struct RawDataset {
    images: Vec<CocoImage>,
    annotations: Vec<RawAnnotation>,
    categories: Vec<RawCategory>,
}

impl CocoDataset {
    /// Reads a ground-truth file.
    ///
    /// # Errors
    /// [`DatasetError::Read`], or [`DatasetError::Coco`] with the place and the
    /// value: a doubled picture or class number, an object of an unknown picture
    /// or class, a box with a negative side.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        Self::parse(&read_bytes(path)?).map_err(|message| at(path, message))
    }

    /// Parses the bytes of a ground-truth file.
    ///
    /// # Errors
    /// The place and what is wrong there.
    pub fn parse(json: &[u8]) -> Result<Self, String> {
        let raw: RawDataset = serde_json::from_slice(json).map_err(|e| e.to_string())?;
        let mut categories = BTreeMap::new();
        for (i, category) in raw.categories.into_iter().enumerate() {
            if let Some(name) = categories.insert(category.id, category.name) {
                return Err(format!(
                    "categories[{i}].id {} was already given to {name:?}",
                    category.id
                ));
            }
        }
        let category_ids: Vec<u64> = categories.keys().copied().collect();
        let index: HashMap<u64, u32> =
            (0u32..).zip(&category_ids).map(|(class, id)| (*id, class)).collect();
        let mut known = HashMap::new();
        for (i, image) in raw.images.iter().enumerate() {
            if let Some(first) = known.insert(image.id, i) {
                return Err(format!("images[{i}].id {} is also images[{first}].id", image.id));
            }
        }
        let mut annotations = Vec::with_capacity(raw.annotations.len());
        for (i, a) in raw.annotations.into_iter().enumerate() {
            let place = format!("annotations[{i}]");
            if !known.contains_key(&a.image_id) {
                return Err(format!("{place}.image_id {}: no such picture", a.image_id));
            }
            let Some(class_id) = index.get(&a.category_id).copied() else {
                return Err(format!("{place}.category_id {}: no such category", a.category_id));
            };
            check_box(&a.bbox).map_err(|e| format!("{place}.bbox {e}"))?;
            let area = a.area.unwrap_or(a.bbox[2] * a.bbox[3]);
            if area < 0.0 {
                return Err(format!("{place}.area {area} is negative"));
            }
            let iscrowd = match a.iscrowd {
                0 => false,
                1 => true,
                other => return Err(format!("{place}.iscrowd {other} is neither 0 nor 1")),
            };
            let id = a.id.unwrap_or(i as u64 + 1);
            let (image_id, bbox) = (a.image_id, a.bbox);
            annotations.push(CocoAnnotation { id, image_id, class_id, bbox, area, iscrowd });
        }
        let names = categories.into_values().collect();
        Ok(Self { images: raw.images, annotations, names, category_ids })
    }

    /// Class index of a COCO class number.
    #[must_use]
    pub fn class_of(&self, category_id: u64) -> Option<u32> {
        let index = self.category_ids.binary_search(&category_id).ok()?;
        u32::try_from(index).ok()
    }

    /// Writes the ground truth, whole or not at all.
    ///
    /// # Errors
    /// [`WriteError`] with the path.
    pub fn write(&self, path: &Path) -> Result<(), WriteError> {
        let number = |class: usize| self.category_ids.get(class).copied().unwrap_or(class as u64);
        let raw = RawDataset {
            images: self.images.clone(),
            annotations: self
                .annotations
                .iter()
                .map(|a| RawAnnotation {
                    id: Some(a.id),
                    image_id: a.image_id,
                    category_id: number(a.class_id as usize),
                    bbox: a.bbox,
                    area: Some(a.area),
                    iscrowd: u8::from(a.iscrowd),
                })
                .collect(),
            categories: self
                .names
                .iter()
                .enumerate()
                .map(|(i, name)| RawCategory { id: number(i), name: name.clone() })
                .collect(),
        };
        atomic::write_with(path, |out| Ok(serde_json::to_writer(out, &raw)?))
    }
}

fn check_box(b: &[f64; 4]) -> Result<(), String> {
    let sides = [b[2], b[3]].iter().all(|s| *s >= 0.0);
    if sides && b.iter().all(|v| v.is_finite()) {
        Ok(())
    } else {
        Err(format!("{b:?}: width and height must not be negative"))
    }
}

/// Reads a results file.
///
/// # Errors
/// [`DatasetError::Read`], or [`DatasetError::Coco`] with the place and value.
pub fn read_results(path: &Path) -> Result<Vec<CocoResult>, DatasetError> {
    parse_results(&read_bytes(path)?).map_err(|message| at(path, message))
}

/// Parses the bytes of a results file.
///
/// # Errors
/// The place and what is wrong there.
pub fn parse_results(json: &[u8]) -> Result<Vec<CocoResult>, String> {
    let results: Vec<CocoResult> = serde_json::from_slice(json).map_err(|e| e.to_string())?;
    for (i, result) in results.iter().enumerate() {
        check_box(&result.bbox).map_err(|e| format!("[{i}].bbox {e}"))?;
    }
    Ok(results)
}

/// Writes a results file, whole or not at all.
///
/// # Errors
/// [`WriteError`] with the path.
pub fn write_results(path: &Path, results: &[CocoResult]) -> Result<(), WriteError> {
    atomic::write_with(path, |out| Ok(serde_json::to_writer(out, results)?))
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, DatasetError> {
    std::fs::read(path).map_err(|reason| DatasetError::Read { path: path.to_path_buf(), reason })
}

fn at(path: &Path, message: String) -> DatasetError {
    DatasetError::Coco { path: path.to_path_buf(), message }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = r#"{"info":{},"images":[{"id":7,"file_name":"a.jpg","width":640,"height":480,"x":1}],
        "annotations":[{"id":1,"image_id":7,"category_id":90,"bbox":[1,2,3.5,4],"iscrowd":1,
            "segmentation":[]},
            {"image_id":7,"category_id":1,"bbox":[0,0,1,1],"area":0.5}],
        "categories":[{"id":90,"name":"toothbrush"},{"id":1,"name":"person"}]}"#;

    #[test]
    fn gaps_in_the_class_numbers_are_closed() {
        let data = CocoDataset::parse(GOOD.as_bytes()).unwrap();
        assert_eq!(data.names, ["person", "toothbrush"]);
        assert_eq!(data.category_ids, [1, 90]);
        assert_eq!((data.class_of(90), data.class_of(2)), (Some(1), None));
        let [first, second] = data.annotations[..] else { panic!() };
        assert_eq!((first.class_id, first.area, first.iscrowd), (1, 14.0, true));
        assert_eq!((second.class_id, second.area, second.iscrowd, second.id), (0, 0.5, false, 2));
        assert_eq!(to_box(first.bbox), BoundingBox::new(1.0, 2.0, 4.5, 6.0));
    }

    #[test]
    fn what_is_written_reads_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("gt.json");
        let data = CocoDataset::parse(GOOD.as_bytes()).unwrap();
        data.write(&path).unwrap();
        assert_eq!(CocoDataset::read(&path).unwrap(), data);
    }

    #[test]
    fn every_mistake_names_its_place() {
        for (from, to, wanted) in [
            (
                "\"image_id\":7,\"category_id\":1",
                "\"image_id\":8,\"category_id\":1",
                "annotations[1].image_id 8",
            ),
            ("\"category_id\":90", "\"category_id\":91", "annotations[0].category_id 91"),
            ("[0,0,1,1]", "[0,0,-1,1]", "annotations[1].bbox [0.0, 0.0, -1.0, 1.0]"),
            ("[0,0,1,1]", "[0,0,1]", "line 4 column"),
            ("[0,0,1,1]", "[0,0,\"b\",1]", "line 4 column"),
            ("[0,0,1,1]", "[0,0,1e999,1]", "line 4 column"),
            ("\"iscrowd\":1", "\"iscrowd\":2", "annotations[0].iscrowd 2"),
            ("\"area\":0.5", "\"area\":-0.5", "annotations[1].area -0.5"),
            (
                "{\"id\":1,\"name\"",
                "{\"id\":90,\"name\"",
                "categories[1].id 90 was already given to \"toothbrush\"",
            ),
            (
                "\"images\":[",
                "\"images\":[{\"id\":7,\"file_name\":\"b\",\"width\":1,\"height\":1},",
                "images[1].id 7 is also images[0].id",
            ),
            ("\"images\"", "\"pictures\"", "missing field `images`"),
            ("\"person\"}]}", "\"person\"}]", "EOF while parsing"),
        ] {
            assert!(GOOD.contains(from), "{from}");
            let error = CocoDataset::parse(GOOD.replace(from, to).as_bytes()).unwrap_err();
            assert!(error.contains(wanted), "{to}: {error}");
        }
    }

    #[test]
    fn results_name_the_entry() {
        let good = r#"{"image_id":1,"category_id":2,"bbox":[0,0,1,1],"score":0.5}"#;
        let bad = good.replace("0,1,1", "0,1,-1");
        let error = parse_results(format!("[{good},{bad}]").as_bytes()).unwrap_err();
        assert!(error.contains("[1].bbox"), "{error}");
        let named = good.replace("\"image_id\":1", "\"image_id\":\"bus\"");
        let error = parse_results(format!("[{named}]").as_bytes()).unwrap_err();
        assert!(error.contains("bus"), "{error}");
    }
}
