//! Which category is taken for which.

use crate::types::{EvalError, GroundTruth, Prediction, Rect, check};
use std::collections::BTreeMap;

/// Settings of a confusion matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConfusionOptions {
    /// Detections below this confidence are left out.
    pub confidence: f32,
    /// Least overlap of a match.
    pub iou: f64,
}

impl Default for ConfusionOptions {
    /// Confidence 0.25, IoU 0.45.
    fn default() -> Self {
        Self { confidence: 0.25, iou: 0.45 }
    }
}

/// Counts of predicted against true categories. Row and column number
/// [`ConfusionMatrix::background`] stand for 'nothing there': its row counts
/// labels that nothing matches, its column detections that match no label.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfusionMatrix {
    categories: Vec<u32>,
    counts: Vec<u64>,
}

impl ConfusionMatrix {
    /// Category identifiers of the rows and columns, background left out.
    #[must_use]
    pub fn categories(&self) -> &[u32] {
        &self.categories
    }

    /// Number of the background's row and column.
    #[must_use]
    pub fn background(&self) -> usize {
        self.categories.len()
    }

    /// How often something of category `categories()[truth]` was taken for
    /// `categories()[predicted]`; 0 outside of the matrix.
    #[must_use]
    pub fn count(&self, predicted: usize, truth: usize) -> u64 {
        let side = self.categories.len() + 1;
        if truth >= side {
            return 0;
        }
        self.counts.get(predicted * side + truth).copied().unwrap_or(0)
    }

    /// Share of the true category's column, 0 to 1; `None` for an empty column.
    #[must_use]
    pub fn share(&self, predicted: usize, truth: usize) -> Option<f64> {
        let column: u64 = (0..=self.background()).map(|row| self.count(row, truth)).sum();
        (column > 0).then(|| self.count(predicted, truth) as f64 / column as f64)
    }

    fn add(&mut self, predicted: usize, truth: usize) {
        let side = self.categories.len() + 1;
        if let Some(count) = self.counts.get_mut(predicted * side + truth) {
            *count += 1;
        }
    }
}

/// The boxes of one image with the rows or columns of their categories.
#[derive(Default)]
struct Image {
    labels: Vec<(usize, Rect, bool)>,
    found: Vec<(usize, Rect, f32)>,
}

/// Counts which of `categories` is taken for which, regardless of order.
///
/// In each image the pair of label and detection with the greatest overlap is
/// matched first, whatever the categories, and each box at most once. Of equal
/// overlaps the pair of one category goes first, then the surer detection, then
/// the order of the input. Crowds are no labels; a detection that matches
/// nothing but lies in a crowd of its category, for at least the share `iou` of
/// its area, is left out.
///
/// # Errors
/// [`EvalError`] for bad boxes, confidences or options, for a category that is
/// not in `categories`, and for one that is twice in there.
pub fn confusion_matrix(
    truth: &[GroundTruth],
    predictions: &[Prediction],
    categories: &[u32],
    options: ConfusionOptions,
) -> Result<ConfusionMatrix, EvalError> {
    check(truth, predictions)?;
    if !(options.iou > 0.0 && options.iou <= 1.0) {
        let (option, found) = ("iou", options.iou.to_string());
        return Err(EvalError::Option { option, rule: "above 0 and at most 1", found });
    }
    if options.confidence.is_nan() {
        let (option, found) = ("confidence", options.confidence.to_string());
        return Err(EvalError::Option { option, rule: "a number", found });
    }
    let mut rows = BTreeMap::new();
    for (row, &category) in categories.iter().enumerate() {
        if rows.insert(category, row).is_some() {
            let (option, found) = ("categories", format!("{category} twice"));
            return Err(EvalError::Option { option, rule: "without repetition", found });
        }
    }
    let row_of = |what, index, category: u32| {
        let known = categories.len();
        rows.get(&category).copied().ok_or(EvalError::Category { what, index, category, known })
    };
    let mut images: BTreeMap<u64, Image> = BTreeMap::new();
    for (i, g) in truth.iter().enumerate() {
        let row = row_of("label", i, g.category)?;
        images.entry(g.image_id).or_default().labels.push((row, g.bbox.into(), g.crowd));
    }
    for (i, p) in predictions.iter().enumerate() {
        let row = row_of("prediction", i, p.category)?;
        if p.confidence >= options.confidence {
            let found = (row, p.bbox.into(), p.confidence);
            images.entry(p.image_id).or_default().found.push(found);
        }
    }
    let side = categories.len() + 1;
    let mut matrix =
        ConfusionMatrix { categories: categories.to_vec(), counts: vec![0; side * side] };
    for image in images.values() {
        image.count(options.iou, &mut matrix);
    }
    Ok(matrix)
}

impl Image {
    fn count(&self, least: f64, matrix: &mut ConfusionMatrix) {
        let mut pairs = Vec::new();
        for (l, (truth, label, crowd)) in self.labels.iter().enumerate() {
            for (f, (predicted, rect, confidence)) in self.found.iter().enumerate() {
                let overlap = rect.overlap(label, false);
                if !crowd && overlap >= least {
                    pairs.push((overlap, truth == predicted, *confidence, l, f));
                }
            }
        }
        pairs.sort_by(|a, b| {
            let falling = b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)).then(b.2.total_cmp(&a.2));
            falling.then((a.3, a.4).cmp(&(b.3, b.4)))
        });
        let mut label_of = vec![None; self.found.len()];
        let mut taken = vec![false; self.labels.len()];
        for (_, _, _, l, f) in pairs {
            if let (Some(taken @ false), Some(slot @ None)) =
                (taken.get_mut(l), label_of.get_mut(f))
            {
                *taken = true;
                *slot = self.labels.get(l);
            }
        }
        let nothing = matrix.background();
        for ((predicted, rect, _), matched) in self.found.iter().zip(label_of) {
            let in_crowd = |(truth, label, crowd): &(usize, Rect, bool)| {
                *crowd && truth == predicted && rect.overlap(label, true) >= least
            };
            match matched {
                Some((truth, _, _)) => matrix.add(*predicted, *truth),
                None if self.labels.iter().any(in_crowd) => {}
                None => matrix.add(*predicted, nothing),
            }
        }
        for ((truth, _, crowd), taken) in self.labels.iter().zip(taken) {
            if !crowd && !taken {
                matrix.add(nothing, *truth);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::BoundingBox;

    fn label(category: u32, x: f32) -> GroundTruth {
        GroundTruth::new(1, category, BoundingBox::from_corner(x, 0.0, 10.0, 10.0))
    }

    fn guess(category: u32, x: f32, confidence: f32) -> Prediction {
        let bbox = BoundingBox::from_corner(x, 0.0, 10.0, 10.0);
        Prediction { image_id: 1, category, bbox, confidence }
    }

    fn counts(truth: &[GroundTruth], predictions: &[Prediction]) -> Vec<u64> {
        let options = ConfusionOptions::default();
        confusion_matrix(truth, predictions, &[7, 3], options).unwrap().counts
    }

    #[test]
    fn by_hand() {
        let truth = [label(7, 0.0), label(7, 100.0), label(3, 200.0)];
        let guesses = [
            guess(7, 0.0, 0.9),
            guess(3, 101.0, 0.8),
            guess(7, 300.0, 0.7),
            guess(7, 200.0, 0.2), // too unsure
        ];
        // Rows: predicted 7, 3, background; columns: true 7, 3, background.
        assert_eq!(counts(&truth, &guesses), [1, 0, 1, 1, 0, 0, 0, 1, 0]);
        let matrix =
            confusion_matrix(&truth, &guesses, &[7, 3], ConfusionOptions::default()).unwrap();
        assert_eq!(matrix.share(0, 0), Some(0.5));
        assert_eq!(matrix.share(2, 1), Some(1.0));
        assert_eq!(matrix.count(0, 3), 0);
    }

    #[test]
    fn overlap_decides_before_confidence_and_category_breaks_ties() {
        let truth = [label(7, 0.0)];
        assert_eq!(
            counts(&truth, &[guess(7, 2.0, 0.9), guess(3, 1.0, 0.5)])[..6],
            [0, 0, 1, 1, 0, 0]
        );
        assert_eq!(
            counts(&truth, &[guess(3, 1.0, 0.9), guess(7, 1.0, 0.5)])[..6],
            [1, 0, 0, 0, 0, 1]
        );
    }

    #[test]
    fn crowds_excuse_their_own_category() {
        let crowd = GroundTruth { crowd: true, ..label(7, 0.0) };
        assert_eq!(counts(&[crowd], &[guess(7, 0.0, 0.9)]), [0; 9]);
        assert_eq!(counts(&[crowd], &[guess(3, 0.0, 0.9)])[5], 1);
    }

    #[test]
    fn unknown_categories_are_named() {
        let options = ConfusionOptions::default();
        let error =
            confusion_matrix(&[label(7, 0.0), label(9, 0.0)], &[], &[7], options).unwrap_err();
        assert_eq!(
            error.to_string(),
            "label 1 has category 9, which is not among the 1 known ones"
        );
        assert!(confusion_matrix(&[], &[guess(9, 0.0, 0.1)], &[7], options).is_err());
        assert!(confusion_matrix(&[], &[], &[7, 7], options).is_err());
        let bad = ConfusionOptions { iou: 0.0, ..options };
        assert!(confusion_matrix(&[], &[], &[7], bad).is_err());
    }
}
