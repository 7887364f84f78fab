//! Anchors: the sizes of boxes that a detector's scales begin with, and those that fit a
//! data set.
//!
//! A box and an anchor fit as well as the worse of their two sides does:
//! `m = min over width and height of min(r, 1/r)`, `r = box / anchor`. A target is learned at
//! an anchor when `m > 1 / anchor_t` (see [`matches`](crate::loss::detection::matches)).

use crate::nets::yolov5::ANCHORS;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

/// Anchors by scale: width and height in pixels of the network's input.
pub type Anchors = [[[f32; 2]; ANCHORS]; 3];

/// How well anchors fit boxes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AnchorFit {
    /// Share of the boxes that some anchor fits: the best recall that can be learned.
    pub recall: f64,
    /// Mean number of anchors that fit a box.
    pub above: f64,
    /// Mean of the best anchor's `m`, which counts as 0 where it does not fit.
    pub fitness: f64,
}

impl AnchorFit {
    /// Of anchors for boxes, both `[width, height]`, when sides may differ by less than a
    /// factor of `anchor_t`. All 0 without boxes.
    #[must_use]
    pub fn new(boxes: &[[f32; 2]], anchors: &[[f32; 2]], anchor_t: f32) -> Self {
        let least = 1.0 / anchor_t;
        let mut sum = Self::default();
        for size in boxes {
            let mut best = 0.0_f32;
            for anchor in anchors {
                let worse = |ratio: f32| ratio.min(ratio.recip());
                let m = worse(size[0] / anchor[0]).min(worse(size[1] / anchor[1]));
                best = best.max(m);
                sum.above += f64::from(u8::from(m > least));
            }
            if best > least {
                sum.recall += 1.0;
                sum.fitness += f64::from(best);
            }
        }
        let count = boxes.len().max(1) as f64;
        Self { recall: sum.recall / count, above: sum.above / count, fitness: sum.fitness / count }
    }
}

/// How anchors are looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnchorSearch {
    /// Factor by which sides may differ.
    pub anchor_t: f32,
    /// Random changes that are tried after the k-means.
    pub generations: usize,
    /// Where all randomness comes from.
    pub seed: u64,
}

impl Default for AnchorSearch {
    /// The reference implementation's numbers.
    fn default() -> Self {
        Self { anchor_t: 4.0, generations: 1000, seed: 0 }
    }
}

/// Recall above which anchors stay as they are.
pub const ENOUGH_RECALL: f64 = 0.98;

/// Anchors for boxes whose sizes are `boxes`
/// ([`object_sizes`](realnet_data::DetectionSet::object_sizes)): those given where they fit, else better ones;
/// and how they fit.
#[must_use]
pub fn fitting(
    anchors: &Anchors,
    boxes: &[[f32; 2]],
    search: &AnchorSearch,
) -> (Anchors, AnchorFit) {
    let flat = anchors.as_flattened();
    let own = AnchorFit::new(boxes, flat, search.anchor_t);
    if own.recall > ENOUGH_RECALL {
        return (*anchors, own);
    }
    let found = search.run(boxes, flat.len());
    let fit = AnchorFit::new(boxes, &found, search.anchor_t);
    if found.len() != flat.len() || fit.fitness <= own.fitness {
        return (*anchors, own);
    }
    let mut scales = *anchors;
    for (slot, size) in scales.iter_mut().flatten().zip(found) {
        *slot = size;
    }
    (scales, fit)
}

impl AnchorSearch {
    /// `count` anchors for boxes, sorted by area: k-means (Lloyd, 1982; started by Arthur and
    /// Vassilvitskii's k-means++, 2007) of the sides' logarithms, then random changes that are
    /// kept where the fitness grows. Boxes of less than 2 pixels on both
    /// sides are left out. None where there are fewer boxes than `count`.
    #[must_use]
    pub fn run(&self, boxes: &[[f32; 2]], count: usize) -> Vec<[f32; 2]> {
        let large = |size: &&[f32; 2]| size.iter().any(|side| *side >= 2.0);
        let boxes: Vec<[f32; 2]> = boxes.iter().filter(large).copied().collect();
        if boxes.len() < count || count == 0 {
            return Vec::new();
        }
        let mut dice = Pcg64Mcg::seed_from_u64(self.seed);
        // What counts are ratios, so near means near in logarithms.
        let logarithms: Vec<[f32; 2]> =
            boxes.iter().map(|size| size.map(|side| side.max(f32::MIN_POSITIVE).ln())).collect();
        let means = k_means(&logarithms, count, &mut dice);
        let mut best: Vec<[f32; 2]> =
            means.into_iter().map(|mean| mean.map(|side| side.exp().max(2.0))).collect();
        let fitness = |anchors: &[[f32; 2]]| AnchorFit::new(&boxes, anchors, self.anchor_t).fitness;
        let mut most = fitness(&best);
        for _ in 0..self.generations {
            let strength: f32 = dice.random();
            let mut changed = best.clone();
            for side in changed.iter_mut().flatten() {
                let step: f32 = StandardNormal.sample(&mut dice);
                if dice.random::<f64>() < 0.9 {
                    *side = (*side * (1.0 + strength * 0.1 * step).clamp(0.3, 3.0)).max(2.0);
                }
            }
            let now = fitness(&changed);
            if now > most {
                (most, best) = (now, changed);
            }
        }
        best.sort_by(|a, b| (a[0] * a[1]).total_cmp(&(b[0] * b[1])));
        best
    }
}

fn squared(a: &[f32; 2], b: &[f32; 2]) -> f32 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

/// Means of `count` groups of points.
fn k_means(points: &[[f32; 2]], count: usize, dice: &mut Pcg64Mcg) -> Vec<[f32; 2]> {
    let first = points.get(dice.random_range(0..points.len().max(1)));
    let mut means: Vec<[f32; 2]> = first.copied().into_iter().collect();
    let mut distances = vec![f32::INFINITY; points.len()];
    while means.len() < count {
        let Some(last) = means.last().copied() else { break };
        for (distance, point) in distances.iter_mut().zip(points) {
            *distance = distance.min(squared(point, &last));
        }
        // A point is drawn with a chance that grows with its squared distance.
        let mut left = dice.random::<f32>() * distances.iter().sum::<f32>();
        let drawn = distances.iter().position(|distance| {
            left -= distance;
            left <= 0.0 && *distance > 0.0
        });
        // Fewer different points than groups: doubles do no harm.
        means.extend(points.get(drawn.unwrap_or(0)));
    }
    for _ in 0..300 {
        let mut sums = vec![[0.0_f32; 3]; means.len()];
        for point in points {
            let near = |a: &(usize, &[f32; 2]), b: &(usize, &[f32; 2])| {
                squared(point, a.1).total_cmp(&squared(point, b.1))
            };
            let group = means.iter().enumerate().min_by(near).map_or(0, |(group, _)| group);
            if let Some([w, h, number]) = sums.get_mut(group) {
                *w += point[0];
                *h += point[1];
                *number += 1.0;
            }
        }
        let before = means.clone();
        for (mean, [w, h, number]) in means.iter_mut().zip(sums) {
            if number > 0.0 {
                *mean = [w / number, h / number];
            }
        }
        if means == before {
            break;
        }
    }
    means
}
