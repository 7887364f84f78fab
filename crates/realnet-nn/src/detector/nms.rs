//! Non-maximum suppression.

use super::decode::Candidate;
use realnet_core::BoundingBox;

/// More candidates than this are cut, least confident first, before suppression.
const MOST_CANDIDATES: usize = 30_000;

/// Greedy suppression: the most confident candidate stays, those of the same
/// class (of any class when `agnostic`) that overlap it by more than `iou` go,
/// and so on, until `max_det` stay. Equal confidences keep their order, so the
/// result depends on nothing but the input.
pub(crate) fn suppress(candidates: &mut Vec<Candidate>, iou: f32, agnostic: bool, max_det: usize) {
    candidates.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
    candidates.truncate(MOST_CANDIDATES);
    let mut kept = 0;
    for index in 0..candidates.len() {
        if kept == max_det {
            break;
        }
        let candidate = candidates[index];
        let stays = candidates[..kept].iter().all(|winner| {
            let rivals = agnostic || winner.class_id == candidate.class_id;
            !rivals || !overlaps(&winner.bbox, &candidate.bbox, iou)
        });
        if stays {
            candidates[kept] = candidate;
            kept += 1;
        }
    }
    candidates.truncate(kept);
}

/// `IoU > threshold` without the division.
fn overlaps(a: &BoundingBox, b: &BoundingBox, threshold: f32) -> bool {
    let inter = a.intersection(b);
    inter > threshold * (a.area() + b.area() - inter)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn candidate(x: f32, confidence: f32, class_id: u32) -> Candidate {
        Candidate { bbox: BoundingBox::from_corner(x, 0.0, 10.0, 10.0), confidence, class_id }
    }

    #[test]
    fn classes_do_not_suppress_each_other() {
        let all = vec![candidate(0.0, 0.5, 0), candidate(1.0, 0.9, 0), candidate(1.0, 0.8, 1)];
        let mut by_class = all.clone();
        suppress(&mut by_class, 0.45, false, 10);
        assert_eq!(by_class.iter().map(|c| c.confidence).collect::<Vec<_>>(), [0.9, 0.8]);
        let mut agnostic = all.clone();
        suppress(&mut agnostic, 0.45, true, 10);
        assert_eq!(agnostic.len(), 1);
        let mut limited = all;
        suppress(&mut limited, 0.45, false, 1);
        assert_eq!(limited.len(), 1);
    }

    proptest! {
        #[test]
        fn survivors_do_not_overlap_and_losers_do(
            raw in prop::collection::vec((0.0f32..60.0, 0.01f32..1.0, 0u32..3), 0..60)
        ) {
            let all: Vec<_> = raw.iter().map(|&(x, c, k)| candidate(x, c, k)).collect();
            let mut kept = all.clone();
            suppress(&mut kept, 0.45, false, usize::MAX);
            for (i, a) in kept.iter().enumerate() {
                for b in &kept[..i] {
                    prop_assert!(a.class_id != b.class_id || a.bbox.iou(&b.bbox) <= 0.4501);
                    prop_assert!(b.confidence >= a.confidence);
                }
            }
            for loser in all.iter().filter(|c| !kept.contains(c)) {
                prop_assert!(kept.iter().any(|k| k.class_id == loser.class_id
                    && k.confidence >= loser.confidence && k.bbox.iou(&loser.bbox) > 0.4499));
            }
        }
    }
}
