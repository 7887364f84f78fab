//! Average precision and recall by the COCO protocol.

use crate::index::{Cell, Class, Index, Matcher, Rules, Verdict, by_falling_confidence};
use crate::types::{EvalError, GroundTruth, Prediction};

/// Which objects count, by their area.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum AreaRange {
    /// All of them.
    All,
    /// By default up to 32² square pixels.
    Small,
    /// By default 32² to 96² square pixels.
    Medium,
    /// By default from 96² square pixels.
    Large,
}

impl AreaRange {
    /// All four, in the order of [`CocoOptions::areas`].
    pub const EACH: [Self; 4] = [Self::All, Self::Small, Self::Medium, Self::Large];
}

/// Settings of an evaluation; the default is COCO's own.
#[derive(Clone, Debug, PartialEq)]
pub struct CocoOptions {
    /// Least overlaps of a match, rising, above 0 and at most 1; by default
    /// 0.5 to 0.95 in steps of 0.05.
    pub iou_thresholds: Vec<f64>,
    /// Recalls at which the precision is sampled, rising; by default 0 to 1 in
    /// steps of 0.01.
    pub recall_points: Vec<f64>,
    /// Least and greatest area in square pixels, both inclusive, in the order
    /// of [`AreaRange::EACH`].
    pub areas: [[f64; 2]; 4],
    /// At most so many detections of a category in an image are looked at, the
    /// surest first; rising, by default 1, 10 and 100. All precisions of
    /// [`CocoSummary`] are those of the last.
    pub max_detections: [usize; 3],
}

impl Default for CocoOptions {
    fn default() -> Self {
        // The arithmetic of numpy.linspace, so that thresholds are the same f64.
        let spread = |from: f64, to: f64, steps: u32| -> Vec<f64> {
            let step = (to - from) / f64::from(steps);
            let inner = (0..steps).map(|i| f64::from(i) * step + from);
            inner.chain(std::iter::once(to)).collect()
        };
        let most = 1e5 * 1e5;
        let (small, large) = (32.0 * 32.0, 96.0 * 96.0);
        Self {
            iou_thresholds: spread(0.5, 0.95, 9),
            recall_points: spread(0.0, 1.0, 100),
            areas: [[0.0, most], [0.0, small], [small, large], [large, most]],
            max_detections: [1, 10, 100],
        }
    }
}

impl CocoOptions {
    fn check(&self) -> Result<(), EvalError> {
        let refuse = |option, rule, found: String| Err(EvalError::Option { option, rule, found });
        let rising = |v: &[f64]| !v.is_empty() && v.windows(2).all(|w| w[0] < w[1]);
        let within = |v: &[f64]| v.iter().all(|t| (0.0..=1.0).contains(t));
        let ious = &self.iou_thresholds;
        if !rising(ious) || !within(ious) || ious.first().is_some_and(|&t| t <= 0.0) {
            let rule = "rising numbers above 0 and at most 1";
            return refuse("iou_thresholds", rule, format!("{ious:?}"));
        }
        let recalls = &self.recall_points;
        if !rising(recalls) || !within(recalls) {
            return refuse("recall_points", "rising numbers 0 to 1", format!("{recalls:?}"));
        }
        if !self.areas.iter().all(|[least, most]| least <= most) {
            return refuse("areas", "pairs of least and most", format!("{:?}", self.areas));
        }
        let limits = self.max_detections;
        if limits[0] == 0 || limits.windows(2).any(|w| w[0] >= w[1]) {
            return refuse("max_detections", "rising numbers above 0", format!("{limits:?}"));
        }
        Ok(())
    }
}

/// The scores of one category; `None` where no label counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClassScore {
    /// Category identifier.
    pub category: u32,
    /// Labels that are no crowd.
    pub instances: usize,
    /// Images with at least one such label.
    pub images: usize,
    /// Average precision over all IoU thresholds.
    pub ap: Option<f64>,
    /// Average precision at IoU 0.5.
    pub ap50: Option<f64>,
    /// Greatest recall, averaged over all IoU thresholds, with the last limit
    /// of [`CocoOptions::max_detections`].
    pub ar: Option<f64>,
}

/// The result of [`evaluate`]: COCO's twelve numbers and what they are made of.
/// `None` stands where pycocotools gives -1: no label counts there, or the IoU
/// threshold was not asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct CocoSummary {
    /// Average precision over IoU thresholds and categories (mAP50-95).
    pub ap: Option<f64>,
    /// The same at IoU 0.5 alone (mAP50).
    pub ap50: Option<f64>,
    /// The same at IoU 0.75 alone.
    pub ap75: Option<f64>,
    /// `ap` of small objects.
    pub ap_small: Option<f64>,
    /// `ap` of medium objects.
    pub ap_medium: Option<f64>,
    /// `ap` of large objects.
    pub ap_large: Option<f64>,
    /// Greatest recall, averaged over IoU thresholds and categories, for each
    /// of [`CocoOptions::max_detections`].
    pub ar: [Option<f64>; 3],
    /// The last of `ar` for small objects.
    pub ar_small: Option<f64>,
    /// The last of `ar` for medium objects.
    pub ar_medium: Option<f64>,
    /// The last of `ar` for large objects.
    pub ar_large: Option<f64>,
    /// Categories with labels or predictions, by rising identifier.
    pub per_class: Vec<ClassScore>,
    table: Table,
    options: CocoOptions,
}

/// Precision and recall of each setting, -1 where no label counts.
#[derive(Clone, Debug, PartialEq)]
struct Table {
    /// `[class][area][limit][threshold][recall point]`.
    precision: Vec<f64>,
    /// `[class][area][limit][threshold]`.
    recall: Vec<f64>,
    points: usize,
    thresholds: usize,
}

impl Table {
    /// Position of a class, area range and limit, the first threshold of it.
    fn row(&self, class: usize, area: usize, limit: usize) -> usize {
        ((class * 4 + area) * 3 + limit) * self.thresholds
    }

    fn curve(&self, class: usize, area: usize, limit: usize, threshold: usize) -> Option<&[f64]> {
        if area >= 4 || limit >= 3 || threshold >= self.thresholds {
            return None;
        }
        let row = self.row(class, area, limit) + threshold;
        let curve = self.precision.get(row * self.points..(row + 1) * self.points)?;
        (*curve.first()? >= 0.0).then_some(curve)
    }

    fn recall(&self, class: usize, area: usize, limit: usize, threshold: usize) -> Option<f64> {
        if area >= 4 || limit >= 3 || threshold >= self.thresholds {
            return None;
        }
        let recall = *self.recall.get(self.row(class, area, limit) + threshold)?;
        (recall >= 0.0).then_some(recall)
    }
}

/// Mean, `None` of nothing.
pub(crate) fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.into_iter().fold((0.0, 0usize), |(s, n), v| (s + v, n + 1));
    (count > 0).then(|| sum / count as f64)
}

impl CocoSummary {
    /// The twelve numbers in pycocotools' order: AP, AP50, AP75, AP of small,
    /// medium, large; AR with 1, 10, 100 detections, AR of small, medium, large.
    #[must_use]
    pub fn stats(&self) -> [Option<f64>; 12] {
        [
            self.ap,
            self.ap50,
            self.ap75,
            self.ap_small,
            self.ap_medium,
            self.ap_large,
            self.ar[0],
            self.ar[1],
            self.ar[2],
            self.ar_small,
            self.ar_medium,
            self.ar_large,
        ]
    }

    /// The settings it was made with.
    #[must_use]
    pub fn options(&self) -> &CocoOptions {
        &self.options
    }

    /// Position of the threshold `iou` (within 1e-9) in the settings.
    #[must_use]
    pub fn threshold_index(&self, iou: f64) -> Option<usize> {
        self.options.iou_thresholds.iter().position(|t| (t - iou).abs() < 1e-9)
    }

    /// Interpolated precisions (the greatest at this or a higher recall) at the
    /// recalls of [`CocoOptions::recall_points`]. `class` counts in
    /// [`CocoSummary::per_class`], `limit` in [`CocoOptions::max_detections`]
    /// and `threshold` in [`CocoOptions::iou_thresholds`]. `None` where no label
    /// counts or an index is too high.
    #[must_use]
    pub fn precision(
        &self,
        class: usize,
        area: AreaRange,
        limit: usize,
        threshold: usize,
    ) -> Option<&[f64]> {
        self.table.curve(class, area as usize, limit, threshold)
    }

    /// Greatest recall reached, indices as in [`CocoSummary::precision`].
    #[must_use]
    pub fn recall(
        &self,
        class: usize,
        area: AreaRange,
        limit: usize,
        threshold: usize,
    ) -> Option<f64> {
        self.table.recall(class, area as usize, limit, threshold)
    }

    fn new(index: &Index, table: Table, options: CocoOptions) -> Self {
        let classes = index.classes.len();
        let thresholds = table.thresholds;
        let find = |iou: f64| options.iou_thresholds.iter().position(|t| (t - iou).abs() < 1e-9);
        let precision = |class: std::ops::Range<usize>, t: std::ops::Range<usize>, area| {
            let curves = class.flat_map(|k| {
                let table = &table;
                t.clone().filter_map(move |t| table.curve(k, area, 2, t))
            });
            mean(curves.flatten().copied())
        };
        let recall = |class: std::ops::Range<usize>, area, limit| {
            mean(class.flat_map(|k| {
                let table = &table;
                (0..thresholds).filter_map(move |t| table.recall(k, area, limit, t))
            }))
        };
        let at = |class: std::ops::Range<usize>, iou| {
            find(iou).and_then(|t| precision(class, t..t + 1, 0))
        };
        let all = 0..classes;
        let per_class = index.classes.iter().enumerate().map(|(k, class)| ClassScore {
            category: class.category,
            instances: class.instances,
            images: class.images,
            ap: precision(k..k + 1, 0..thresholds, 0),
            ap50: at(k..k + 1, 0.5),
            ar: recall(k..k + 1, 0, 2),
        });
        Self {
            ap: precision(all.clone(), 0..thresholds, 0),
            ap50: at(all.clone(), 0.5),
            ap75: at(all.clone(), 0.75),
            ap_small: precision(all.clone(), 0..thresholds, 1),
            ap_medium: precision(all.clone(), 0..thresholds, 2),
            ap_large: precision(all.clone(), 0..thresholds, 3),
            ar: [0, 1, 2].map(|limit| recall(all.clone(), 0, limit)),
            ar_small: recall(all.clone(), 1, 2),
            ar_medium: recall(all.clone(), 2, 2),
            ar_large: recall(all.clone(), 3, 2),
            per_class: per_class.collect(),
            table,
            options,
        }
    }
}

/// Judges `predictions` by the COCO protocol (Lin et al., *Microsoft COCO*,
/// 2014, and its reference program `COCOeval` for boxes).
///
/// Detections of one category in one image choose their label in order of
/// confidence; see [`CocoOptions`] for thresholds and limits. The average
/// precision is the mean of the interpolated precision at 101 recalls. Labels
/// that are crowds or outside the area range are ignored together with the
/// detections that match them; unmatched detections outside the area range are
/// ignored as well. Equal confidences keep the order of image identifiers,
/// within an image that of the input, as in pycocotools. Images without labels
/// need no mention: their detections are wrong all the same.
///
/// # Errors
/// [`EvalError`] for a confidence that is not finite, a box whose edges are not
/// finite or swapped, a negative area, or senseless options.
///
/// ```
/// use realnet_core::BoundingBox;
/// use realnet_eval::{CocoOptions, GroundTruth, Prediction, evaluate};
///
/// let bbox = BoundingBox::new(10.0, 10.0, 60.0, 40.0);
/// let truth = [GroundTruth::new(1, 2, bbox)];
/// let found = [Prediction { image_id: 1, category: 2, bbox, confidence: 0.9 }];
/// let summary = evaluate(&truth, &found, &CocoOptions::default())?;
/// assert!((summary.ap.unwrap() - 1.0).abs() < 1e-9);
/// assert_eq!(summary.ap_large, None);
/// # Ok::<(), realnet_eval::EvalError>(())
/// ```
pub fn evaluate(
    truth: &[GroundTruth],
    predictions: &[Prediction],
    options: &CocoOptions,
) -> Result<CocoSummary, EvalError> {
    options.check()?;
    let index = Index::new(truth, predictions)?;
    let mut table = Table {
        precision: Vec::new(),
        recall: Vec::new(),
        points: options.recall_points.len(),
        thresholds: options.iou_thresholds.len(),
    };
    let mut scratch = Scratch::default();
    for class in &index.classes {
        scratch.judge(&index, class, options);
        scratch.accumulate(options, &mut table);
    }
    Ok(CocoSummary::new(&index, table, options.clone()))
}

/// Memory used again from class to class.
#[derive(Debug, Default)]
struct Scratch {
    matcher: Matcher,
    /// `[area][threshold][detection]`, detections by image.
    verdicts: Vec<Vec<Verdict>>,
    /// Labels that count, an area range.
    counting: [usize; 4],
    confidences: Vec<f32>,
    /// Position of each detection in its image.
    ranks: Vec<usize>,
    /// Precision at each true positive.
    hits: Vec<f64>,
}

impl Scratch {
    fn judge(&mut self, index: &Index, class: &Class, options: &CocoOptions) {
        let [.., most] = options.max_detections;
        self.verdicts.resize_with(4 * options.iou_thresholds.len(), Vec::new);
        self.verdicts.iter_mut().for_each(Vec::clear);
        self.counting = [0; 4];
        self.confidences.clear();
        self.ranks.clear();
        let rules =
            Rules { thresholds: &options.iou_thresholds, areas: &options.areas, max_found: most };
        for cell in index.cells(class) {
            self.matcher.judge(&cell, rules, &mut self.verdicts, &mut self.counting);
            let Cell { found, .. } = cell;
            self.confidences.extend(found.iter().take(most).map(|f| f.confidence));
            self.ranks.extend(0..found.len().min(most));
        }
    }

    fn accumulate(&mut self, options: &CocoOptions, table: &mut Table) {
        let thresholds = options.iou_thresholds.len();
        let order = by_falling_confidence(&self.confidences);
        let orders = options.max_detections.map(|limit| {
            let within = |i: &u32| self.ranks.get(*i as usize).is_some_and(|&rank| rank < limit);
            order.iter().copied().filter(within).collect::<Vec<u32>>()
        });
        for (rows, &counting) in self.verdicts.chunks(thresholds).zip(&self.counting) {
            for order in &orders {
                for row in rows {
                    if counting == 0 {
                        table.recall.push(-1.0);
                        table.precision.extend(options.recall_points.iter().map(|_| -1.0));
                    } else {
                        let recall = interpolate(
                            row,
                            order,
                            counting,
                            &options.recall_points,
                            &mut self.hits,
                            &mut table.precision,
                        );
                        table.recall.push(recall);
                    }
                }
            }
        }
    }
}

/// Appends the interpolated precision at each recall point to `precision` and
/// returns the greatest recall.
///
/// Only true positives matter: recall rises nowhere else, and the precision
/// falls from each to the next, so the running maximum is taken over them.
fn interpolate(
    verdicts: &[Verdict],
    order: &[u32],
    counting: usize,
    recall_points: &[f64],
    hits: &mut Vec<f64>,
    precision: &mut Vec<f64>,
) -> f64 {
    hits.clear();
    let mut seen = 0u32;
    for &i in order {
        match verdicts.get(i as usize) {
            Some(Verdict::Right) => {
                seen += 1;
                let right = (hits.len() + 1) as f64;
                hits.push(right / (f64::from(seen) + f64::EPSILON));
            }
            Some(Verdict::Wrong) => seen += 1,
            Some(Verdict::Ignored) | None => {}
        }
    }
    let mut highest = 0.0f64;
    for value in hits.iter_mut().rev() {
        highest = highest.max(*value);
        *value = highest;
    }
    let total = counting as f64;
    let mut hit = 0usize;
    for &point in recall_points {
        // The first true positive that reaches the recall; before any, the
        // recall is 0 and the maximum is that from the first one on.
        while hit < hits.len() && ((hit + 1) as f64) / total < point {
            hit += 1;
        }
        precision.push(hits.get(hit).copied().unwrap_or(0.0));
    }
    hits.len() as f64 / total
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::BoundingBox;

    fn square(image_id: u64, x: f32) -> GroundTruth {
        GroundTruth::new(image_id, 1, BoundingBox::from_corner(x, 0.0, 10.0, 10.0))
    }

    fn guess(image_id: u64, x: f32, confidence: f32) -> Prediction {
        let bbox = BoundingBox::from_corner(x, 0.0, 10.0, 10.0);
        Prediction { image_id, category: 1, bbox, confidence }
    }

    fn run(truth: &[GroundTruth], predictions: &[Prediction]) -> CocoSummary {
        evaluate(truth, predictions, &CocoOptions::default()).unwrap()
    }

    fn close(found: Option<f64>, expected: f64) {
        assert!(found.is_some_and(|f| (f - expected).abs() < 1e-9), "{found:?} {expected}");
    }

    #[test]
    fn thresholds_are_those_of_numpy() {
        let options = CocoOptions::default();
        assert_eq!(options.iou_thresholds.len(), 10);
        assert_eq!(options.iou_thresholds[5], 0.75);
        assert_eq!(options.iou_thresholds[9], 0.95);
        assert_eq!(options.recall_points.len(), 101);
        assert_eq!(options.recall_points[100], 1.0);
    }

    #[test]
    fn precision_by_hand() {
        // Right, wrong, right of three labels: precision 1 up to recall 1/3, 2/3
        // up to recall 2/3, then 0. Recall points 0..=0.33 are 34, up to 0.66 33.
        let truth = [square(1, 0.0), square(1, 100.0), square(2, 0.0)];
        let guesses = [guess(1, 0.0, 0.9), guess(1, 50.0, 0.8), guess(2, 0.0, 0.7)];
        let summary = run(&truth, &guesses);
        let expected = (34.0 + 33.0 * 2.0 / 3.0) / 101.0;
        close(summary.ap, expected);
        close(summary.ap50, expected);
        close(summary.ap_small, expected);
        assert_eq!((summary.ap_medium, summary.ap_large), (None, None));
        close(summary.ar[2], 2.0 / 3.0);
        // With one detection an image the wrong one is out: precision 1 to 2/3.
        close(summary.ar[0], 2.0 / 3.0);
        let first = summary.precision(0, AreaRange::All, 0, 0).unwrap();
        close(mean(first.iter().copied()), 67.0 / 101.0);
        assert_eq!(summary.precision(0, AreaRange::Large, 2, 0), None);
        assert_eq!(summary.precision(0, AreaRange::All, 2, 10), None);
        assert_eq!(summary.precision(1, AreaRange::All, 2, 0), None);
        assert_eq!(summary.recall(0, AreaRange::All, 3, 0), None);
        assert_eq!(summary.per_class[0].instances, 3);
        assert_eq!(summary.per_class[0].images, 2);
    }

    #[test]
    fn an_overlap_on_the_threshold_matches() {
        // 10x10 boxes 2.5 apart: intersection 75, union 125, IoU 0.6 exactly.
        let summary = run(&[square(1, 0.0)], &[guess(1, 2.5, 0.9)]);
        let matched = (0..10).filter(|&t| summary.recall(0, AreaRange::All, 2, t) == Some(1.0));
        assert_eq!(matched.collect::<Vec<_>>(), [0, 1, 2]);
        close(summary.ap, 0.3);
        close(summary.ap50, 1.0);
        close(summary.ap75, 0.0);
    }

    #[test]
    fn nothing_found_is_zero_and_nothing_to_find_is_none() {
        let summary = run(&[square(1, 0.0)], &[]);
        close(summary.ap, 0.0);
        close(summary.ar[0], 0.0);
        let summary = run(&[], &[guess(1, 0.0, 0.9)]);
        assert_eq!(summary.stats(), [None; 12]);
        assert_eq!(summary.per_class.len(), 1);
        assert_eq!(run(&[], &[]).stats(), [None; 12]);
    }

    #[test]
    fn detections_beyond_the_limit_are_not_seen() {
        let options = CocoOptions { max_detections: [1, 2, 3], ..CocoOptions::default() };
        let guesses: Vec<_> = (0..4u8)
            .map(|i| guess(1, 100.0 * f32::from(3 - i), 0.9 - 0.1 * f32::from(i)))
            .collect();
        let summary = evaluate(&[square(1, 0.0)], &guesses, &options).unwrap();
        close(summary.ap50, 0.0);
        let summary = run(&[square(1, 0.0)], &guesses);
        close(summary.ap50, 0.25);
    }

    #[test]
    fn senseless_options_are_refused() {
        let bad = [
            CocoOptions { iou_thresholds: vec![], ..CocoOptions::default() },
            CocoOptions { iou_thresholds: vec![0.0, 0.5], ..CocoOptions::default() },
            CocoOptions { iou_thresholds: vec![0.6, 0.5], ..CocoOptions::default() },
            CocoOptions { iou_thresholds: vec![f64::NAN], ..CocoOptions::default() },
            CocoOptions { recall_points: vec![0.0, 1.5], ..CocoOptions::default() },
            CocoOptions { max_detections: [0, 1, 2], ..CocoOptions::default() },
            CocoOptions { max_detections: [10, 10, 100], ..CocoOptions::default() },
            CocoOptions { areas: [[1.0, 0.0]; 4], ..CocoOptions::default() },
        ];
        for options in bad {
            let error = evaluate(&[], &[], &options).unwrap_err();
            assert!(matches!(error, EvalError::Option { .. }), "{error}");
        }
    }
}
