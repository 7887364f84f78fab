//! What goes into an evaluation.

use realnet_core::BoundingBox;
use thiserror::Error;

/// One labelled object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundTruth {
    /// Which image; any number, the same for all boxes of one image.
    pub image_id: u64,
    /// Category identifier; any number, gaps are fine.
    pub category: u32,
    /// Where, in pixels. The overlap is computed in f64 from these f32 edges: a
    /// box from a file of decimals whose overlap or area lies on a limit to the
    /// last bit may fall on the other side of it than in pycocotools.
    pub bbox: BoundingBox,
    /// Area in square pixels that decides between small, medium and large.
    /// COCO annotations give the area of the segment here, which is smaller
    /// than that of the box; without segments it is the area of the box.
    pub area: f64,
    /// A region with many objects that were not labelled one by one (COCO's
    /// `iscrowd`). It is never missed, and detections inside it are not counted
    /// as wrong.
    pub crowd: bool,
}

impl GroundTruth {
    /// A single object whose area is that of its box.
    #[must_use]
    pub fn new(image_id: u64, category: u32, bbox: BoundingBox) -> Self {
        let area = Rect::from(bbox).area;
        Self { image_id, category, bbox, area, crowd: false }
    }
}

/// One detection to be judged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Which image, as in [`GroundTruth::image_id`].
    pub image_id: u64,
    /// Category identifier, as in [`GroundTruth::category`].
    pub category: u32,
    /// Where, in pixels.
    pub bbox: BoundingBox,
    /// Any finite number, higher is surer. The confidence curves and the
    /// confusion matrix look at 0 to 1.
    pub confidence: f32,
}

/// Why an evaluation was refused. Positions count from 0 in the slice given.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum EvalError {
    /// A confidence is not a number, or infinite.
    #[error("prediction {index} (image {image_id}, category {category}) has confidence {value}")]
    Confidence {
        /// Position in the predictions.
        index: usize,
        /// Its image.
        image_id: u64,
        /// Its category.
        category: u32,
        /// The value found.
        value: f32,
    },
    /// The edges of a predicted box are not finite, or swapped.
    #[error(
        "prediction {index} (image {image_id}) has the box {found:?}: edges must be finite with x0 <= x1 and y0 <= y1"
    )]
    PredictionBox {
        /// Position in the predictions.
        index: usize,
        /// Its image.
        image_id: u64,
        /// Left, top, right, bottom.
        found: [f32; 4],
    },
    /// The edges of a labelled box are not finite, or swapped.
    #[error(
        "label {index} (image {image_id}) has the box {found:?}: edges must be finite with x0 <= x1 and y0 <= y1"
    )]
    LabelBox {
        /// Position in the ground truth.
        index: usize,
        /// Its image.
        image_id: u64,
        /// Left, top, right, bottom.
        found: [f32; 4],
    },
    /// The area of a label is negative or not finite.
    #[error(
        "label {index} (image {image_id}) has the area {found}: it must be finite and at least 0"
    )]
    LabelArea {
        /// Position in the ground truth.
        index: usize,
        /// Its image.
        image_id: u64,
        /// The value found.
        found: f64,
    },
    /// A category that is not among those to be evaluated.
    #[error("{what} {index} has category {category}, which is not among the {known} known ones")]
    Category {
        /// `"label"` or `"prediction"`.
        what: &'static str,
        /// Position in its slice.
        index: usize,
        /// The category found.
        category: u32,
        /// How many categories there are.
        known: usize,
    },
    /// An option has a value that makes no sense.
    #[error("{option} must be {rule}, found {found}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// What it must be.
        rule: &'static str,
        /// What it is.
        found: String,
    },
    /// More boxes than positions of 32 bits.
    #[error("{found} boxes are too many: at most {} can be evaluated at once", u32::MAX)]
    TooMany {
        /// How many there are.
        found: usize,
    },
}

/// A box in f64, as the overlap is computed in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rect {
    x0: f64,
    y0: f64,
    x1: f64,
    y1: f64,
    /// Area in square pixels.
    pub(crate) area: f64,
}

impl From<BoundingBox> for Rect {
    fn from(b: BoundingBox) -> Self {
        let [x0, y0, x1, y1] = <[f32; 4]>::from(b).map(f64::from);
        Self { x0, y0, x1, y1, area: (x1 - x0) * (y1 - y0) }
    }
}

impl Rect {
    /// Area of the intersection; 0 when the boxes only touch.
    #[inline]
    fn intersection(&self, other: &Self) -> f64 {
        let width = self.x1.min(other.x1) - self.x0.max(other.x0);
        let height = self.y1.min(other.y1) - self.y0.max(other.y0);
        if width > 0.0 && height > 0.0 { width * height } else { 0.0 }
    }

    /// Overlap of a detection (`self`) with a label: intersection over union,
    /// or over the detection's own area where the label is a crowd.
    #[inline]
    pub(crate) fn overlap(&self, label: &Self, crowd: bool) -> f64 {
        let inter = self.intersection(label);
        if inter <= 0.0 {
            return 0.0;
        }
        inter / if crowd { self.area } else { self.area + label.area - inter }
    }
}

fn is_ordered(b: &BoundingBox) -> bool {
    <[f32; 4]>::from(*b).iter().all(|v| v.is_finite()) && b.x0 <= b.x1 && b.y0 <= b.y1
}

/// Refuses what cannot be evaluated.
pub(crate) fn check(truth: &[GroundTruth], predictions: &[Prediction]) -> Result<(), EvalError> {
    let found = truth.len().max(predictions.len());
    if u32::try_from(found).is_err() {
        return Err(EvalError::TooMany { found });
    }
    for (index, g) in truth.iter().enumerate() {
        let image_id = g.image_id;
        if !is_ordered(&g.bbox) {
            return Err(EvalError::LabelBox { index, image_id, found: g.bbox.into() });
        }
        if !(g.area.is_finite() && g.area >= 0.0) {
            return Err(EvalError::LabelArea { index, image_id, found: g.area });
        }
    }
    for (index, p) in predictions.iter().enumerate() {
        let Prediction { image_id, category, bbox, confidence: value } = *p;
        if !value.is_finite() {
            return Err(EvalError::Confidence { index, image_id, category, value });
        }
        if !is_ordered(&bbox) {
            return Err(EvalError::PredictionBox { index, image_id, found: bbox.into() });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_overlap_with_a_crowd_is_over_the_detection() {
        let detection = Rect::from(BoundingBox::new(0.0, 0.0, 2.0, 2.0));
        let label = Rect::from(BoundingBox::new(1.0, 0.0, 11.0, 10.0));
        assert!((detection.overlap(&label, false) - 2.0 / 102.0).abs() < 1e-15);
        assert!((detection.overlap(&label, true) - 0.5).abs() < 1e-15);
    }

    #[test]
    fn empty_boxes_overlap_nothing() {
        let point = Rect::from(BoundingBox::new(1.0, 1.0, 1.0, 1.0));
        assert_eq!(point.overlap(&point, false), 0.0);
        assert_eq!(point.overlap(&point, true), 0.0);
    }

    #[test]
    fn refusals_name_the_index_and_the_value() {
        let bbox = BoundingBox::new(0.0, 0.0, 2.0, 2.0);
        let good = Prediction { image_id: 7, category: 3, bbox, confidence: 0.5 };
        let nan = Prediction { confidence: f32::NAN, ..good };
        let error = check(&[], &[good, nan]).unwrap_err();
        assert_eq!(error.to_string(), "prediction 1 (image 7, category 3) has confidence NaN");

        let swapped = Prediction { bbox: BoundingBox::new(3.0, 0.0, 2.0, 2.0), ..good };
        let error = check(&[], &[swapped]).unwrap_err();
        assert!(error.to_string().starts_with("prediction 0 (image 7) has the box [3.0, 0.0"));

        let label = GroundTruth::new(7, 3, bbox);
        assert_eq!(label.area, 4.0);
        assert_eq!(check(&[label], &[good]), Ok(()));
        let holed = GroundTruth { bbox: BoundingBox::new(0.0, f32::NAN, 2.0, 2.0), ..label };
        assert!(matches!(check(&[label, holed], &[]), Err(EvalError::LabelBox { index: 1, .. })));
        let flat = GroundTruth { area: -1.0, ..label };
        assert!(matches!(check(&[flat], &[]), Err(EvalError::LabelArea { index: 0, .. })));
    }
}
