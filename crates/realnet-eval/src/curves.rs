//! Precision, recall and F1 against confidence.

use crate::coco::mean;
use crate::index::{Index, Matcher, Rules, Verdict};
use crate::types::{EvalError, GroundTruth, Prediction};

/// Points of the confidence axis.
const POINTS: u16 = 1000;

/// The curves of one category, one value for each of
/// [`ConfidenceCurves::confidences`].
#[derive(Clone, Debug, PartialEq)]
pub struct ClassCurves {
    /// Category identifier.
    pub category: u32,
    /// Labels that are no crowd, at least 1.
    pub instances: usize,
    /// Images with at least one such label.
    pub images: usize,
    /// TP / (TP + FP).
    pub precision: Vec<f64>,
    /// TP / instances.
    pub recall: Vec<f64>,
    /// 2 TP / (TP + FP + instances), the harmonic mean of the two.
    pub f1: Vec<f64>,
}

/// Precision, recall and F1 at 1000 confidences from 0 to 1, at one IoU.
///
/// With TP and FP the true and false positives among the detections of a
/// category whose confidence is at least c, and n its labels:
///
/// * precision P(c) = TP / (TP + FP); with no detection left it is 1 (nothing
///   reported is wrong), but 0 for a category that is never detected;
/// * recall R(c) = TP / n;
/// * F1(c) = 2 P R / (P + R) = 2 TP / (TP + FP + n).
///
/// The means weigh each category with labels alike. The operating point is the
/// lowest confidence at which the mean of F1 is greatest; a report's
/// precision, recall and F1 are those at that one confidence, for each category
/// and, as means, overall. The overall F1 is the mean of the categories' F1, not
/// that of the mean precision and recall. Values are not smoothed.
#[derive(Clone, Debug, PartialEq)]
pub struct ConfidenceCurves {
    /// Least overlap of a match.
    pub iou_threshold: f64,
    /// The confidences, `i / 999`.
    pub confidences: Vec<f64>,
    /// Categories with labels, by rising identifier.
    pub classes: Vec<ClassCurves>,
    /// Mean over `classes`; empty without any.
    pub mean_precision: Vec<f64>,
    /// Mean over `classes`; empty without any.
    pub mean_recall: Vec<f64>,
    /// Mean over `classes`; empty without any.
    pub mean_f1: Vec<f64>,
    /// Position of the greatest mean F1 in `confidences`; 0 without classes.
    pub best: usize,
}

/// Precision, recall and F1 at one confidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OperatingPoint {
    /// The confidence.
    pub confidence: f64,
    /// TP / (TP + FP).
    pub precision: f64,
    /// TP / labels.
    pub recall: f64,
    /// Harmonic mean; overall the mean of the categories'.
    pub f1: f64,
}

impl ConfidenceCurves {
    /// Means at the confidence of the greatest mean F1; `None` without labels.
    #[must_use]
    pub fn overall(&self) -> Option<OperatingPoint> {
        self.point(&self.mean_precision, &self.mean_recall, &self.mean_f1)
    }

    /// A category's values at the same confidence; `None` without labels of it.
    #[must_use]
    pub fn of_category(&self, category: u32) -> Option<OperatingPoint> {
        let class = self.classes.iter().find(|c| c.category == category)?;
        self.point(&class.precision, &class.recall, &class.f1)
    }

    fn point(&self, precision: &[f64], recall: &[f64], f1: &[f64]) -> Option<OperatingPoint> {
        Some(OperatingPoint {
            confidence: *self.confidences.get(self.best)?,
            precision: *precision.get(self.best)?,
            recall: *recall.get(self.best)?,
            f1: *f1.get(self.best)?,
        })
    }
}

/// Computes [`ConfidenceCurves`] at `iou_threshold` (0.5 is customary).
///
/// Detections choose labels as in [`crate::evaluate`], in order of confidence and
/// within their category, but all of them are looked at; those that match a
/// crowd count neither as right nor as wrong.
///
/// # Errors
/// [`EvalError`] for bad boxes or confidences, or a threshold outside ]0, 1].
pub fn confidence_curves(
    truth: &[GroundTruth],
    predictions: &[Prediction],
    iou_threshold: f64,
) -> Result<ConfidenceCurves, EvalError> {
    if !(iou_threshold > 0.0 && iou_threshold <= 1.0) {
        return Err(EvalError::Option {
            option: "iou_threshold",
            rule: "above 0 and at most 1",
            found: iou_threshold.to_string(),
        });
    }
    let index = Index::new(truth, predictions)?;
    let confidences: Vec<f64> = (0..POINTS).map(|i| f64::from(i) / f64::from(POINTS - 1)).collect();
    let rules = Rules {
        thresholds: &[iou_threshold],
        areas: &[[0.0, f64::INFINITY]],
        max_found: usize::MAX,
    };
    let mut matcher = Matcher::default();
    let mut classes = Vec::new();
    for class in index.classes.iter().filter(|c| c.instances > 0) {
        let mut rows = [Vec::new()];
        let mut scores = Vec::new();
        for cell in index.cells(class) {
            matcher.judge(&cell, rules, &mut rows, &mut [0]);
            scores.extend(cell.found.iter().map(|f| f64::from(f.confidence)));
        }
        let [verdicts] = rows;
        let counts = count_above(&confidences, &scores, &verdicts);
        let instances = class.instances as f64;
        let detected = verdicts.iter().any(|v| *v != Verdict::Ignored);
        let nothing = if detected { 1.0 } else { 0.0 };
        classes.push(ClassCurves {
            category: class.category,
            instances: class.instances,
            images: class.images,
            precision: counts
                .iter()
                .map(|&(tp, fp)| if tp + fp > 0.0 { tp / (tp + fp) } else { nothing })
                .collect(),
            recall: counts.iter().map(|(tp, _)| tp / instances).collect(),
            f1: counts.iter().map(|(tp, fp)| 2.0 * tp / (tp + fp + instances)).collect(),
        });
    }
    let mean_of = |curve: fn(&ClassCurves) -> &[f64]| -> Vec<f64> {
        let at = |i: usize| mean(classes.iter().filter_map(|c| curve(c).get(i).copied()));
        (0..confidences.len()).filter_map(at).collect()
    };
    let mean_f1 = mean_of(|c| &c.f1);
    let mut best = (0, 0.0);
    for (i, &f1) in mean_f1.iter().enumerate() {
        if f1 > best.1 {
            best = (i, f1);
        }
    }
    Ok(ConfidenceCurves {
        iou_threshold,
        mean_precision: mean_of(|c| &c.precision),
        mean_recall: mean_of(|c| &c.recall),
        mean_f1,
        best: best.0,
        confidences,
        classes,
    })
}

/// True and false positives with at least each of the rising `confidences`.
fn count_above(confidences: &[f64], scores: &[f64], verdicts: &[Verdict]) -> Vec<(f64, f64)> {
    // A detection counts at all confidences up to its own: note it at the last
    // of them, then sum from the end.
    let mut counts = vec![(0.0, 0.0); confidences.len()];
    for (score, verdict) in scores.iter().zip(verdicts) {
        let reached = confidences.partition_point(|c| c <= score);
        let slot = reached.checked_sub(1).and_then(|last| counts.get_mut(last));
        match (slot, verdict) {
            (Some(slot), Verdict::Right) => slot.0 += 1.0,
            (Some(slot), Verdict::Wrong) => slot.1 += 1.0,
            _ => {}
        }
    }
    let (mut tp, mut fp) = (0.0, 0.0);
    for slot in counts.iter_mut().rev() {
        tp += slot.0;
        fp += slot.1;
        *slot = (tp, fp);
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::BoundingBox;

    fn square(x: f32) -> BoundingBox {
        BoundingBox::from_corner(x, 0.0, 10.0, 10.0)
    }

    fn guess(category: u32, x: f32, confidence: f32) -> Prediction {
        Prediction { image_id: 1, category, bbox: square(x), confidence }
    }

    #[test]
    fn curves_by_hand() {
        let truth = [GroundTruth::new(1, 4, square(0.0)), GroundTruth::new(1, 4, square(50.0))];
        let guesses = [guess(4, 0.0, 0.75), guess(4, 90.0, 0.5), guess(4, 50.0, 0.25)];
        let curves = confidence_curves(&truth, &guesses, 0.5).unwrap();
        let class = &curves.classes[0];
        let at = |c: f64| {
            let i = curves.confidences.iter().position(|&x| x >= c).unwrap();
            (class.precision[i], class.recall[i], class.f1[i])
        };
        assert_eq!(at(0.0), (2.0 / 3.0, 1.0, 0.8));
        assert_eq!(at(0.2), (2.0 / 3.0, 1.0, 0.8));
        assert_eq!(at(0.3), (0.5, 0.5, 0.5));
        assert_eq!(at(0.6), (1.0, 0.5, 2.0 / 3.0));
        assert_eq!(at(0.8), (1.0, 0.0, 0.0));
        assert_eq!(curves.best, 0);
        let point = curves.overall().unwrap();
        assert_eq!((point.confidence, point.precision, point.recall), (0.0, 2.0 / 3.0, 1.0));
        assert_eq!(curves.of_category(4), Some(point));
        assert_eq!(curves.of_category(5), None);
    }

    #[test]
    fn the_operating_point_is_shared() {
        // Category 1 is best below 0.4, category 2 only above 0.6; together the
        // mean of F1 is greatest where both are still good enough.
        let truth = [GroundTruth::new(1, 1, square(0.0)), GroundTruth::new(1, 2, square(50.0))];
        let guesses =
            [guess(1, 0.0, 0.4), guess(2, 50.0, 0.9), guess(2, 90.0, 0.6), guess(2, 120.0, 0.3)];
        let curves = confidence_curves(&truth, &guesses, 0.5).unwrap();
        let point = curves.overall().unwrap();
        // 0.3 < c <= 0.4: F1 of 1 is 1, of 2 is 2/3.
        assert!(point.confidence > 0.3 && point.confidence <= 0.31, "{point:?}");
        assert!((point.f1 - 5.0 / 6.0).abs() < 1e-12);
        assert!((point.precision - 0.75).abs() < 1e-12);
        assert_eq!(curves.of_category(2).unwrap().precision, 0.5);
    }

    #[test]
    fn crowds_and_silent_categories() {
        let crowd = GroundTruth { crowd: true, ..GroundTruth::new(1, 1, square(0.0)) };
        let truth =
            [crowd, GroundTruth::new(1, 1, square(50.0)), GroundTruth::new(1, 2, square(0.0))];
        let guesses = [guess(1, 0.0, 0.9), guess(1, 50.0, 0.8), guess(3, 0.0, 0.9)];
        let curves = confidence_curves(&truth, &guesses, 0.5).unwrap();
        assert_eq!(curves.classes.len(), 2);
        assert_eq!(curves.classes[0].precision[0], 1.0);
        assert_eq!(curves.classes[1].precision, vec![0.0; 1000]);
        assert_eq!(curves.overall().unwrap().f1, 0.5);
        assert_eq!(confidence_curves(&[], &guesses, 0.5).unwrap().overall(), None);
        assert!(confidence_curves(&[], &[], 0.0).is_err());
        assert!(confidence_curves(&[], &[], f64::NAN).is_err());
    }

    #[test]
    fn confidences_outside_of_0_to_1() {
        let truth = [GroundTruth::new(1, 1, square(0.0))];
        let sure = confidence_curves(&truth, &[guess(1, 0.0, 3.0)], 0.5).unwrap();
        assert_eq!(sure.classes[0].recall, vec![1.0; 1000]);
        let unsure = confidence_curves(&truth, &[guess(1, 0.0, -3.0)], 0.5).unwrap();
        assert_eq!(unsure.classes[0].recall, vec![0.0; 1000]);
    }
}
