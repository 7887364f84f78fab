//! How far a box is from another.

use burn::tensor::Tensor;
use std::f32::consts::PI;

/// What is added to areas and sides against a division by 0.
const EPSILON: f32 = 1e-7;

/// A loss between boxes. All but the last are `1 - IoU` with a penalty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BoxLoss {
    /// Intersection over union.
    Iou,
    /// Less the share of the smallest enclosing box that neither covers (Rezatofighi et al.,
    /// 2019).
    #[default]
    Giou,
    /// Less the squared distance of the middles over the squared diagonal of the enclosing
    /// box (Zheng et al., 2020).
    Diou,
    /// And less a term of the aspect ratios (the same).
    Ciou,
    /// The first YOLO's (Redmon et al., 2016): squared differences of the middles in cells,
    /// and of the roots of the sides as shares of the picture.
    SquaredError,
}

/// Left, top, right, bottom of boxes `[n, 4]` given by middle, width and height.
fn edges(boxes: &Tensor<2>) -> [Tensor<2>; 4] {
    let column = |i: usize| boxes.clone().narrow(1, i, 1);
    let (x, y, w, h) = (column(0), column(1), column(2) * 0.5, column(3) * 0.5);
    [x.clone() - w.clone(), y.clone() - h.clone(), x + w, y + h]
}

/// Intersection over union, with the penalty of `kind`, of each pair: boxes `[n, 4]` as
/// middle, width, height in one unit; the answer is `[n, 1]`, at most 1. Of
/// [`BoxLoss::SquaredError`] it is the plain one. No gradient goes through the weight of the
/// aspect ratios, as in the reference implementation.
#[must_use]
pub fn iou(found: &Tensor<2>, wanted: &Tensor<2>, kind: BoxLoss) -> Tensor<2> {
    let [l1, t1, r1, b1] = edges(found);
    let [l2, t2, r2, b2] = edges(wanted);
    let side = |tensor: &Tensor<2>, i: usize| tensor.clone().narrow(1, i, 1);
    let (w1, h1) = (side(found, 2), side(found, 3));
    let (w2, h2) = (side(wanted, 2), side(wanted, 3));
    let both = |low: (&Tensor<2>, &Tensor<2>), high: (&Tensor<2>, &Tensor<2>)| {
        (high.0.clone().min_pair(high.1.clone()) - low.0.clone().max_pair(low.1.clone()))
            .clamp_min(0.0)
    };
    let intersection = both((&l1, &l2), (&r1, &r2)) * both((&t1, &t2), (&b1, &b2));
    let union = w1.clone() * h1.clone() + w2.clone() * h2.clone() - intersection.clone() + EPSILON;
    let iou = intersection / union.clone();
    if matches!(kind, BoxLoss::Iou | BoxLoss::SquaredError) {
        return iou;
    }
    let width = r1.clone().max_pair(r2.clone()) - l1.clone().min_pair(l2.clone());
    let height = b1.clone().max_pair(b2.clone()) - t1.clone().min_pair(t2.clone());
    if kind == BoxLoss::Giou {
        let hull = width * height + EPSILON;
        return iou - (hull.clone() - union) / hull;
    }
    let diagonal = width.square() + height.square() + EPSILON;
    let across = (l2 + r2 - l1 - r1).square() + (t2 + b2 - t1 - b1).square();
    let distance = across * 0.25 / diagonal;
    if kind == BoxLoss::Diou {
        return iou - distance;
    }
    let angle = |w: Tensor<2>, h: Tensor<2>| (w / h).atan();
    let aspect = (angle(w2, h2) - angle(w1, h1)).square() * (4.0 / (PI * PI));
    let weight = aspect.clone() / (aspect.clone() - iou.clone() + (1.0 + EPSILON));
    iou - (distance + aspect * weight.detach())
}

/// The loss of each pair, `[n, 1]`, at least 0. Boxes are in cells; the picture has
/// `cells[0]` columns and `cells[1]` rows of them.
#[must_use]
pub fn box_loss(
    found: &Tensor<2>,
    wanted: &Tensor<2>,
    kind: BoxLoss,
    cells: [usize; 2],
) -> Tensor<2> {
    if kind != BoxLoss::SquaredError {
        return -iou(found, wanted, kind) + 1.0;
    }
    let of = |tensor: &Tensor<2>, i: usize| tensor.clone().narrow(1, i, 1);
    let middle = |i: usize| (of(found, i) - of(wanted, i)).square();
    let side = |i: usize, cells: usize| {
        let root = |tensor: &Tensor<2>| (of(tensor, i) / cells as f32 + EPSILON).sqrt();
        (root(found) - root(wanted)).square()
    };
    middle(0) + middle(1) + side(2, cells[0]) + side(3, cells[1])
}
