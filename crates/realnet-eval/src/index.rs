//! Boxes sorted by category and image, and the greedy assignment of detections
//! to labels that COCO's scores and the confidence curves share.

use crate::types::{EvalError, GroundTruth, Prediction, Rect, check};
use std::ops::Range;

/// A label, ready for matching.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Label {
    pub(crate) rect: Rect,
    /// Area for the area ranges, not always that of the box.
    pub(crate) area: f64,
    pub(crate) crowd: bool,
}

/// A detection, ready for matching.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    pub(crate) rect: Rect,
    pub(crate) confidence: f32,
}

/// The boxes of one category in one image.
#[derive(Clone, Debug)]
pub(crate) struct Cell<'a> {
    /// In the order of the input.
    pub(crate) labels: &'a [Label],
    /// By falling confidence, equal ones in the order of the input.
    pub(crate) found: &'a [Found],
}

/// All boxes of one category.
#[derive(Clone, Debug)]
pub(crate) struct Class {
    pub(crate) category: u32,
    /// Labels that are no crowd.
    pub(crate) instances: usize,
    /// Images with at least one such label.
    pub(crate) images: usize,
    cells: Vec<(Range<usize>, Range<usize>)>,
}

/// All boxes by category, each category by image.
#[derive(Clone, Debug)]
pub(crate) struct Index {
    labels: Vec<Label>,
    found: Vec<Found>,
    /// By rising category.
    pub(crate) classes: Vec<Class>,
}

/// Maps confidences to integers of the opposite order; both zeros are equal.
fn falling(confidence: f32) -> u32 {
    let bits = (confidence + 0.0).to_bits();
    let rising = if bits >> 31 == 1 { !bits } else { bits | 1 << 31 };
    !rising
}

impl Index {
    pub(crate) fn new(
        truth: &[GroundTruth],
        predictions: &[Prediction],
    ) -> Result<Self, EvalError> {
        check(truth, predictions)?;
        // The position comes last in each key, so an unstable sort keeps the
        // order of the input among equals.
        let mut label_keys: Vec<(u32, u64, usize)> =
            truth.iter().enumerate().map(|(i, g)| (g.category, g.image_id, i)).collect();
        label_keys.sort_unstable();
        let mut found_keys: Vec<(u32, u64, u32, u32)> = (0u32..)
            .zip(predictions)
            .map(|(i, p)| (p.category, p.image_id, falling(p.confidence), i))
            .collect();
        found_keys.sort_unstable();

        let labels = label_keys
            .iter()
            .filter_map(|&(_, _, i)| truth.get(i))
            .map(|g| Label { rect: g.bbox.into(), area: g.area, crowd: g.crowd })
            .collect::<Vec<_>>();
        let found = found_keys
            .iter()
            .filter_map(|&(_, _, _, i)| predictions.get(i as usize))
            .map(|p| Found { rect: p.bbox.into(), confidence: p.confidence })
            .collect::<Vec<_>>();

        let mut classes: Vec<Class> = Vec::new();
        let (mut l, mut f) = (0, 0);
        loop {
            let next_label = label_keys.get(l).map(|&(category, image, _)| (category, image));
            let next_found = found_keys.get(f).map(|&(category, image, ..)| (category, image));
            let cell = match (next_label, next_found) {
                (Some(a), Some(b)) => a.min(b),
                (Some(a), None) => a,
                (None, Some(b)) => b,
                (None, None) => break,
            };
            let (l0, f0) = (l, f);
            while label_keys.get(l).is_some_and(|k| (k.0, k.1) == cell) {
                l += 1;
            }
            while found_keys.get(f).is_some_and(|k| (k.0, k.1) == cell) {
                f += 1;
            }
            let single = labels.get(l0..l).unwrap_or_default().iter().filter(|g| !g.crowd).count();
            if classes.last().is_none_or(|c| c.category != cell.0) {
                let category = cell.0;
                classes.push(Class { category, instances: 0, images: 0, cells: Vec::new() });
            }
            if let Some(class) = classes.last_mut() {
                class.instances += single;
                class.images += usize::from(single > 0);
                class.cells.push((l0..l, f0..f));
            }
        }
        Ok(Self { labels, found, classes })
    }

    /// The images of a class by rising identifier.
    pub(crate) fn cells<'a>(&'a self, class: &'a Class) -> impl Iterator<Item = Cell<'a>> {
        class.cells.iter().map(|(labels, found)| Cell {
            labels: self.labels.get(labels.clone()).unwrap_or_default(),
            found: self.found.get(found.clone()).unwrap_or_default(),
        })
    }
}

/// What became of a detection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// It matches no label.
    Wrong,
    /// It matches a label that counts.
    Right,
    /// It matches a label that does not count (a crowd, or one outside the area
    /// range), or matches nothing and lies outside the area range itself.
    Ignored,
}

/// Rules of one matching.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rules<'a> {
    /// Least overlaps of a match.
    pub(crate) thresholds: &'a [f64],
    /// Least and greatest area that count, both inclusive.
    pub(crate) areas: &'a [[f64; 2]],
    /// Only so many detections of a cell are looked at.
    pub(crate) max_found: usize,
}

fn outside(area: f64, range: [f64; 2]) -> bool {
    area < range[0] || area > range[1]
}

/// Matching with its memory, so that many cells cost few allocations.
#[derive(Debug, Default)]
pub(crate) struct Matcher {
    /// `[detection][label]`, labels in the order of the input.
    overlaps: Vec<f64>,
    /// Greatest overlap of each detection.
    best: Vec<f64>,
    /// Labels that count first, each part in the order of the input.
    order: Vec<usize>,
    /// By position in `order`.
    taken: Vec<bool>,
}

impl Matcher {
    /// Judges the first `max_found` detections of a cell: `verdicts` gets one
    /// row for each pair of area range and threshold, area ranges first, and
    /// each row is extended by one verdict a detection. `counting` is raised by
    /// the number of labels that count, one number an area range.
    ///
    /// As in pycocotools, detections choose in order of their confidence; each
    /// takes the label with the greatest overlap that is still free (crowds stay
    /// free), the last of equals; a label that does not count is taken only when
    /// none that counts reaches the threshold.
    pub(crate) fn judge(
        &mut self,
        cell: &Cell<'_>,
        rules: Rules<'_>,
        verdicts: &mut [Vec<Verdict>],
        counting: &mut [usize],
    ) {
        let labels = cell.labels;
        let found = cell.found.get(..rules.max_found).unwrap_or(cell.found);
        self.overlaps.clear();
        self.best.clear();
        for f in found {
            let start = self.overlaps.len();
            self.overlaps.extend(labels.iter().map(|g| f.rect.overlap(&g.rect, g.crowd)));
            let row = self.overlaps.get(start..).unwrap_or_default();
            self.best.push(row.iter().copied().fold(0.0, f64::max));
        }
        let rows = verdicts.chunks_mut(rules.thresholds.len().max(1));
        for ((&range, rows), counting) in rules.areas.iter().zip(rows).zip(counting) {
            let ignored = |g: &Label| g.crowd || outside(g.area, range);
            self.order.clear();
            self.order.extend((0..labels.len()).filter(|&i| !labels.get(i).is_some_and(ignored)));
            let count = self.order.len();
            *counting += count;
            self.order.extend((0..labels.len()).filter(|&i| labels.get(i).is_some_and(ignored)));
            for (&threshold, row) in rules.thresholds.iter().zip(rows) {
                self.assign(labels, found, count, threshold, |f, label| {
                    row.push(match label {
                        Some(position) if position < count => Verdict::Right,
                        Some(_) => Verdict::Ignored,
                        None if outside(f.rect.area, range) => Verdict::Ignored,
                        None => Verdict::Wrong,
                    });
                });
            }
        }
    }

    /// Calls `judged` for each detection with the position in `order` of its label.
    fn assign(
        &mut self,
        labels: &[Label],
        found: &[Found],
        count: usize,
        threshold: f64,
        mut judged: impl FnMut(&Found, Option<usize>),
    ) {
        // An overlap of exactly 1 must be reachable in spite of rounding.
        let least = threshold.min(1.0 - 1e-10);
        self.taken.clear();
        self.taken.resize(labels.len(), false);
        let rows = self.overlaps.chunks_exact(labels.len().max(1));
        // Without labels there are no rows, and nothing can match.
        let rows = rows.map(Some).chain(std::iter::repeat(None));
        for ((f, row), &best) in found.iter().zip(rows).zip(&self.best) {
            let Some(row) = row.filter(|_| best >= least) else {
                judged(f, None);
                continue;
            };
            let mut chosen = None;
            let mut so_far = least;
            for ((position, &label), &taken) in self.order.iter().enumerate().zip(&self.taken) {
                if taken {
                    continue;
                }
                if position >= count && chosen.is_some_and(|c| c < count) {
                    break;
                }
                match row.get(label) {
                    Some(&overlap) if overlap >= so_far => {
                        so_far = overlap;
                        chosen = Some(position);
                    }
                    _ => {}
                }
            }
            if let Some(position) = chosen {
                let crowd =
                    self.order.get(position).and_then(|&i| labels.get(i)).is_some_and(|g| g.crowd);
                if let Some(taken) = self.taken.get_mut(position) {
                    *taken = !crowd;
                }
            }
            judged(f, chosen);
        }
    }
}

/// Positions by falling confidence, equal ones in their order.
pub(crate) fn by_falling_confidence(confidences: &[f32]) -> Vec<u32> {
    let mut keys: Vec<(u32, u32)> =
        (0u32..).zip(confidences).map(|(i, &c)| (falling(c), i)).collect();
    keys.sort_unstable();
    keys.into_iter().map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::BoundingBox;

    #[test]
    fn keys_fall_as_confidences_rise() {
        let rising = [-2.0, -0.5, 0.0, 1e-30, 0.5, 1.0, 7.0f32];
        assert!(rising.windows(2).all(|w| falling(w[0]) > falling(w[1])));
        assert_eq!(falling(0.0), falling(-0.0));
        assert_eq!(by_falling_confidence(&[0.5, 0.9, 0.5, 0.9]), [1, 3, 0, 2]);
    }

    fn verdicts(
        truth: &[GroundTruth],
        predictions: &[Prediction],
        range: [f64; 2],
    ) -> (Vec<Verdict>, usize) {
        let index = Index::new(truth, predictions).unwrap();
        let rules = Rules { thresholds: &[0.5], areas: &[range], max_found: 100 };
        let (mut rows, mut counting) = (vec![Vec::new()], [0]);
        let mut matcher = Matcher::default();
        for class in &index.classes {
            for cell in index.cells(class) {
                matcher.judge(&cell, rules, &mut rows, &mut counting);
            }
        }
        (rows.remove(0), counting[0])
    }

    fn guess(x0: f32, x1: f32, confidence: f32) -> Prediction {
        let bbox = BoundingBox::new(x0, 0.0, x1, 10.0);
        Prediction { image_id: 1, category: 1, bbox, confidence }
    }

    #[test]
    fn the_surer_detection_takes_the_label() {
        let truth = [GroundTruth::new(1, 1, BoundingBox::new(0.0, 0.0, 10.0, 10.0))];
        let (rows, counting) =
            verdicts(&truth, &[guess(0.0, 10.0, 0.6), guess(0.0, 8.0, 0.9)], [0.0, 1e10]);
        assert_eq!((rows, counting), (vec![Verdict::Right, Verdict::Wrong], 1));
    }

    #[test]
    fn crowds_swallow_any_number_and_never_count() {
        let bbox = BoundingBox::new(0.0, 0.0, 100.0, 10.0);
        let truth = [GroundTruth { crowd: true, ..GroundTruth::new(1, 1, bbox) }];
        let guesses = [guess(0.0, 10.0, 0.9), guess(20.0, 30.0, 0.8), guess(200.0, 210.0, 0.7)];
        let (rows, counting) = verdicts(&truth, &guesses, [0.0, 1e10]);
        assert_eq!(rows, [Verdict::Ignored, Verdict::Ignored, Verdict::Wrong]);
        assert_eq!(counting, 0);
    }

    #[test]
    fn a_counting_label_wins_over_a_better_ignored_one() {
        let small = GroundTruth::new(1, 1, BoundingBox::new(0.0, 0.0, 6.0, 10.0));
        let large = GroundTruth::new(1, 1, BoundingBox::new(0.0, 0.0, 10.0, 10.0));
        let guesses = [guess(0.0, 10.0, 0.9)];
        // Only areas up to 64 count: the label of 60 is taken at an overlap of
        // 0.6 though the label of 100 fits exactly.
        let (rows, counting) = verdicts(&[large, small], &guesses, [0.0, 64.0]);
        assert_eq!((rows, counting), (vec![Verdict::Right], 1));
        // With nothing that counts the large one is taken and ignored.
        let (rows, counting) = verdicts(&[large], &guesses, [0.0, 64.0]);
        assert_eq!((rows, counting), (vec![Verdict::Ignored], 0));
        // An unmatched detection outside the range is ignored, inside it is wrong.
        let (rows, _) = verdicts(&[], &guesses, [0.0, 64.0]);
        assert_eq!(rows, [Verdict::Ignored]);
        let (rows, _) = verdicts(&[], &guesses, [0.0, 100.0]);
        assert_eq!(rows, [Verdict::Wrong]);
    }

    #[test]
    fn classes_count_their_images_without_crowds() {
        let bbox = BoundingBox::new(0.0, 0.0, 1.0, 1.0);
        let crowd = GroundTruth { crowd: true, ..GroundTruth::new(3, 5, bbox) };
        let truth = [
            GroundTruth::new(2, 5, bbox),
            crowd,
            GroundTruth::new(2, 5, bbox),
            GroundTruth::new(1, 4, bbox),
        ];
        let stray = Prediction { image_id: 9, category: 8, bbox, confidence: 0.1 };
        let index = Index::new(&truth, &[stray]).unwrap();
        let counts: Vec<_> =
            index.classes.iter().map(|c| (c.category, c.instances, c.images)).collect();
        assert_eq!(counts, [(4, 1, 1), (5, 2, 1), (8, 0, 0)]);
    }
}
