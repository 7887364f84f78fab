//! What a validation run says in the end.

use crate::coco::CocoSummary;
use crate::curves::ConfidenceCurves;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Scores of a validation run, the JSON object of `val --json`. A score is
/// `null` where there are no labels to measure it by.
///
/// Precision, recall and F1 are those at the confidence of the greatest mean
/// F1, at IoU 0.5 (see [`ConfidenceCurves`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Mean average precision at IoU 0.5.
    pub map50: Option<f64>,
    /// Mean average precision over IoU 0.5 to 0.95.
    pub map50_95: Option<f64>,
    /// Mean precision of the classes.
    pub precision: Option<f64>,
    /// Mean recall of the classes.
    pub recall: Option<f64>,
    /// Mean F1 of the classes.
    pub f1: Option<f64>,
    /// Images evaluated, with those that show nothing.
    pub images: usize,
    /// Labels, crowds left out.
    pub instances: usize,
    /// Classes with labels, by rising identifier.
    pub per_class: Vec<ClassReport>,
}

/// Scores of one class.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClassReport {
    /// Its name.
    pub class: String,
    /// Images that show it.
    pub images: usize,
    /// Labels, crowds left out.
    pub instances: usize,
    /// Precision at the common confidence.
    pub precision: Option<f64>,
    /// Recall at the common confidence.
    pub recall: Option<f64>,
    /// F1 at the common confidence.
    pub f1: Option<f64>,
    /// Average precision at IoU 0.5.
    pub map50: Option<f64>,
    /// Average precision over IoU 0.5 to 0.95.
    pub map50_95: Option<f64>,
}

/// The name of a category, or its number when it has none.
pub(crate) fn name_of(names: &BTreeMap<u32, String>, category: u32) -> String {
    names.get(&category).cloned().unwrap_or_else(|| category.to_string())
}

impl Report {
    /// Puts together what was measured over `images` images. `names` are those
    /// of the categories; one that is missing is called by its number.
    #[must_use]
    pub fn new(
        summary: &CocoSummary,
        curves: &ConfidenceCurves,
        images: usize,
        names: &BTreeMap<u32, String>,
    ) -> Self {
        let labelled = || summary.per_class.iter().filter(|c| c.instances > 0);
        let per_class = labelled().map(|score| {
            let point = curves.of_category(score.category);
            ClassReport {
                class: name_of(names, score.category),
                images: score.images,
                instances: score.instances,
                precision: point.map(|p| p.precision),
                recall: point.map(|p| p.recall),
                f1: point.map(|p| p.f1),
                map50: score.ap50,
                map50_95: score.ap,
            }
        });
        let point = curves.overall();
        Self {
            map50: summary.ap50,
            map50_95: summary.ap,
            precision: point.map(|p| p.precision),
            recall: point.map(|p| p.recall),
            f1: point.map(|p| p.f1),
            images,
            instances: labelled().map(|c| c.instances).sum(),
            per_class: per_class.collect(),
        }
    }

    /// A plain text table: all classes together, then one line a class when
    /// there is more than one. Every line ends with a line feed.
    #[must_use]
    pub fn table(&self) -> String {
        let all = ClassReport {
            class: "all".to_owned(),
            images: self.images,
            instances: self.instances,
            precision: self.precision,
            recall: self.recall,
            f1: self.f1,
            map50: self.map50,
            map50_95: self.map50_95,
        };
        let classes = if self.per_class.len() > 1 { self.per_class.as_slice() } else { &[] };
        let rows = || std::iter::once(&all).chain(classes);
        let longest = rows().map(|r| r.class.chars().count()).max().unwrap_or(0).max(5);
        let mut text = format!(
            "{:<longest$} {:>8} {:>10} {:>8} {:>8} {:>8} {:>8} {:>9}\n",
            "Class", "Images", "Instances", "P", "R", "F1", "mAP50", "mAP50-95"
        );
        let number = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"));
        for r in rows() {
            let [p, recall, f1, map50, map] =
                [r.precision, r.recall, r.f1, r.map50, r.map50_95].map(number);
            // Writing into a string cannot fail.
            let _ = writeln!(
                text,
                "{:<longest$} {:>8} {:>10} {p:>8} {recall:>8} {f1:>8} {map50:>8} {map:>9}",
                r.class, r.images, r.instances
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CocoOptions, GroundTruth, Prediction, confidence_curves, evaluate};
    use realnet_core::BoundingBox;

    fn report(found: bool) -> Report {
        let bbox = BoundingBox::new(0.0, 0.0, 10.0, 10.0);
        let truth = [GroundTruth::new(1, 0, bbox), GroundTruth::new(2, 5, bbox)];
        let guesses = [
            Prediction { image_id: 1, category: 0, bbox, confidence: 0.5 },
            Prediction { image_id: 1, category: 2, bbox, confidence: 0.5 },
        ];
        let guesses = if found { guesses.as_slice() } else { &[] };
        let truth = if found { truth.as_slice() } else { &[] };
        let summary = evaluate(truth, guesses, &CocoOptions::default()).unwrap();
        let curves = confidence_curves(truth, guesses, 0.5).unwrap();
        let names = BTreeMap::from([(0, "person".to_owned()), (2, "car".to_owned())]);
        Report::new(&summary, &curves, 3, &names)
    }

    #[test]
    fn json_has_the_promised_fields_in_order() {
        // One true positive of one detection scores 1 - 2^-52, as in pycocotools.
        let tidy = |v: &mut Option<f64>| *v = v.map(|v| (v * 1e9).round() / 1e9);
        let mut report = report(true);
        tidy(&mut report.map50);
        tidy(&mut report.map50_95);
        for class in &mut report.per_class {
            tidy(&mut class.map50);
            tidy(&mut class.map50_95);
        }
        let json = serde_json::to_string(&report).unwrap();
        let text = r#"{"map50":0.5,"map50_95":0.5,"precision":0.5,"recall":0.5,"f1":0.5,"images":3,"instances":2,"per_class":[{"class":"person","images":1,"instances":1,"precision":1.0,"recall":1.0,"f1":1.0,"map50":1.0,"map50_95":1.0},{"class":"5","images":1,"instances":1,"precision":0.0,"recall":0.0,"f1":0.0,"map50":0.0,"map50_95":0.0}]}"#;
        assert_eq!(json, text);
        let back: Report = serde_json::from_str(&json).unwrap();
        assert_eq!(back, report);
    }

    #[test]
    fn the_table_is_aligned() {
        let expected = "\
Class    Images  Instances        P        R       F1    mAP50  mAP50-95
all           3          2    0.500    0.500    0.500    0.500     0.500
person        1          1    1.000    1.000    1.000    1.000     1.000
5             1          1    0.000    0.000    0.000    0.000     0.000
";
        let table = report(true).table();
        let squeezed = table.lines().map(str::len).collect::<Vec<_>>();
        assert!(squeezed.windows(2).all(|w| w[0] == w[1]), "{table}");
        let words = |t: &str| t.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(words(&table), words(expected));
    }

    #[test]
    fn without_labels_scores_are_null() {
        let report = report(false);
        let json = serde_json::to_string(&report).unwrap();
        assert!(json.starts_with(r#"{"map50":null,"map50_95":null,"precision":null"#), "{json}");
        assert!(report.table().lines().last().unwrap().ends_with(" -"));
        assert_eq!(report.table().lines().count(), 2);
    }
}
