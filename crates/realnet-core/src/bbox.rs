//! Axis-aligned boxes in pixels.

use serde::{Deserialize, Serialize};

/// An axis-aligned box in pixels: `x0, y0` its left and top edge, `x1, y1` its
/// right and bottom edge, x to the right and y down. Edges lie between pixels:
/// the box of one single pixel at the origin is `0, 0, 1, 1`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "[f32; 4]", into = "[f32; 4]")]
pub struct BoundingBox {
    /// Left edge.
    pub x0: f32,
    /// Top edge.
    pub y0: f32,
    /// Right edge.
    pub x1: f32,
    /// Bottom edge.
    pub y1: f32,
}

impl BoundingBox {
    /// A box from its left, top, right and bottom edge.
    #[must_use]
    pub const fn new(x0: f32, y0: f32, x1: f32, y1: f32) -> Self {
        Self { x0, y0, x1, y1 }
    }

    /// A box from its centre and size.
    #[must_use]
    pub fn from_center(cx: f32, cy: f32, width: f32, height: f32) -> Self {
        let (hw, hh) = (width / 2.0, height / 2.0);
        Self::new(cx - hw, cy - hh, cx + hw, cy + hh)
    }

    /// A box from its top-left corner and size (the COCO form).
    #[must_use]
    pub fn from_corner(x: f32, y: f32, width: f32, height: f32) -> Self {
        Self::new(x, y, x + width, y + height)
    }

    /// Width; negative when the edges are swapped.
    #[must_use]
    pub fn width(&self) -> f32 {
        self.x1 - self.x0
    }

    /// Height; negative when the edges are swapped.
    #[must_use]
    pub fn height(&self) -> f32 {
        self.y1 - self.y0
    }

    /// Centre, `(x, y)`.
    #[must_use]
    pub fn center(&self) -> (f32, f32) {
        ((self.x0 + self.x1) / 2.0, (self.y0 + self.y1) / 2.0)
    }

    /// Area in square pixels; 0 when an edge pair is swapped.
    #[must_use]
    pub fn area(&self) -> f32 {
        self.width().max(0.0) * self.height().max(0.0)
    }

    /// True when all edges are finite and both sides are longer than 0.
    #[must_use]
    pub fn is_proper(&self) -> bool {
        self.x0.is_finite()
            && self.y0.is_finite()
            && self.x1.is_finite()
            && self.y1.is_finite()
            && self.x1 > self.x0
            && self.y1 > self.y0
    }

    /// The box moved by `(dx, dy)`.
    #[must_use]
    pub fn translated(&self, dx: f32, dy: f32) -> Self {
        Self::new(self.x0 + dx, self.y0 + dy, self.x1 + dx, self.y1 + dy)
    }

    /// The part inside a picture of `width` x `height` pixels.
    #[must_use]
    pub fn clipped(&self, width: f32, height: f32) -> Self {
        Self::new(
            self.x0.clamp(0.0, width),
            self.y0.clamp(0.0, height),
            self.x1.clamp(0.0, width),
            self.y1.clamp(0.0, height),
        )
    }

    /// Area of the intersection with `other`.
    #[must_use]
    pub fn intersection(&self, other: &Self) -> f32 {
        let w = self.x1.min(other.x1) - self.x0.max(other.x0);
        let h = self.y1.min(other.y1) - self.y0.max(other.y0);
        w.max(0.0) * h.max(0.0)
    }

    /// Intersection over union, 0 to 1; 0 when both boxes are empty.
    #[must_use]
    pub fn iou(&self, other: &Self) -> f32 {
        let inter = self.intersection(other);
        let union = self.area() + other.area() - inter;
        if union > 0.0 { inter / union } else { 0.0 }
    }

    /// Generalised IoU, -1 to 1: `IoU - |C \ (A u B)| / |C|` with `C` the
    /// smallest box that encloses both (Rezatofighi et al., 2019, eq. 1).
    #[must_use]
    pub fn giou(&self, other: &Self) -> f32 {
        let inter = self.intersection(other);
        let union = self.area() + other.area() - inter;
        let hull = self.enclosing(other).area();
        if union > 0.0 && hull > 0.0 { inter / union - (hull - union) / hull } else { 0.0 }
    }

    /// The box in a picture `sx` times as wide and `sy` times as high.
    #[must_use]
    pub fn scaled(&self, sx: f32, sy: f32) -> Self {
        Self::new(self.x0 * sx, self.y0 * sy, self.x1 * sx, self.y1 * sy)
    }

    /// The smallest box that encloses both.
    #[must_use]
    pub fn enclosing(&self, other: &Self) -> Self {
        Self::new(
            self.x0.min(other.x0),
            self.y0.min(other.y0),
            self.x1.max(other.x1),
            self.y1.max(other.y1),
        )
    }
}

impl From<[f32; 4]> for BoundingBox {
    fn from([x0, y0, x1, y1]: [f32; 4]) -> Self {
        Self::new(x0, y0, x1, y1)
    }
}

impl From<BoundingBox> for [f32; 4] {
    fn from(b: BoundingBox) -> Self {
        [b.x0, b.y0, b.x1, b.y1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_box() -> impl Strategy<Value = BoundingBox> {
        (-500.0f32..500.0, -500.0f32..500.0, 1.0f32..300.0, 1.0f32..300.0)
            .prop_map(|(x, y, w, h)| BoundingBox::from_corner(x, y, w, h))
    }

    #[test]
    fn giou_of_distant_boxes_is_negative() {
        let a = BoundingBox::new(0.0, 0.0, 1.0, 1.0);
        let b = BoundingBox::new(3.0, 0.0, 4.0, 1.0);
        // hull 4, union 2, no overlap
        assert!((a.giou(&b) + 0.5).abs() < 1e-6);
    }

    #[test]
    fn clipping_keeps_the_inside() {
        let b = BoundingBox::new(-5.0, 10.0, 700.0, 500.0).clipped(640.0, 480.0);
        assert_eq!(<[f32; 4]>::from(b), [0.0, 10.0, 640.0, 480.0]);
    }

    proptest! {
        #[test]
        fn iou_is_symmetric_and_bounds_giou(a in any_box(), b in any_box()) {
            let iou = a.iou(&b);
            prop_assert!((iou - b.iou(&a)).abs() < 1e-6);
            prop_assert!((0.0..=1.0 + 1e-5).contains(&iou));
            let giou = a.giou(&b);
            prop_assert!(giou <= iou + 1e-5 && giou > -1.0);
            prop_assert!((a.iou(&a) - 1.0).abs() < 1e-4);
            prop_assert!((a.giou(&a) - 1.0).abs() < 1e-4);
        }
    }
}
