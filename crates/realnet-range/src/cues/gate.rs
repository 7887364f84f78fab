//! Target or background, by the box and by depth.

use realnet_core::{BoundingBox, DepthMap};

/// Which body a pixel belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Side {
    /// Inside the box, at the target's depth.
    Target,
    /// Outside the box, or inside it and further away than the target.
    Background,
    /// Near an edge of the box at the target's depth, inside the box and nearer
    /// than the target (an occluder), or inside the box without a depth.
    Unclear,
}

/// Splits pixels into target and background: the target is what lies inside a
/// box and within an interval of depths. [`SigmaRule`](super::SigmaRule) makes
/// one from a depth map; made by hand, any box and interval will do.
///
/// Two conventions meet here, as in [`realnet_core`]: pixel *positions* count
/// from the centre of the first pixel (corners, `CameraModel`), *box edges* from
/// the edge of the picture. The box coordinate of a position is larger by 0.5;
/// the methods add it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForegroundGate {
    /// The target's box, in pixels of the depth map.
    pub bbox: BoundingBox,
    /// Smallest depth of the target, metres.
    pub near: f32,
    /// Largest depth of the target, metres.
    pub far: f32,
    /// Half the width of the band about the edges of the box, in pixels, in
    /// which depth alone must decide: a detector's edges are not exact.
    pub margin_px: f32,
}

impl ForegroundGate {
    /// Half the width of the band about the box's edges unless told otherwise,
    /// pixels.
    pub const DEFAULT_MARGIN_PX: f32 = 2.0;

    /// The gate of a box and an interval of depths in metres, with
    /// [`ForegroundGate::DEFAULT_MARGIN_PX`].
    #[must_use]
    pub const fn new(bbox: BoundingBox, near: f32, far: f32) -> Self {
        Self { bbox, near, far, margin_px: Self::DEFAULT_MARGIN_PX }
    }

    /// True when the position lies inside the box and the depth, in metres, in
    /// the interval (ends included); the band about the edges is not regarded.
    /// `x` and `y` count from the centre of the first pixel. An unknown depth is
    /// never inside.
    #[must_use]
    pub fn contains(&self, x: f32, y: f32, depth: f32) -> bool {
        self.covers_depth(depth) && self.inset(x, y) >= 0.0
    }

    /// True when a depth in metres lies in the interval, ends included.
    #[must_use]
    pub fn covers_depth(&self, depth: f32) -> bool {
        DepthMap::is_known(depth) && depth >= self.near && depth <= self.far
    }

    /// The side of the position `[x, y]`, counted from the centre of the first
    /// pixel, with a depth in metres (0 or NaN: unknown).
    ///
    /// | where | nearer than the interval | in it | further | unknown |
    /// |---|---|---|---|---|
    /// | inside the box | unclear | target | background | unclear |
    /// | within `margin_px` of an edge | unclear | unclear | background | unclear |
    /// | outside | background | background | background | background |
    ///
    /// A position that is not a number is unclear.
    #[must_use]
    pub fn class_of(&self, [x, y]: [f32; 2], depth: f32) -> Side {
        let inset = self.inset(x, y);
        let margin = self.margin_px.max(0.0);
        let behind = DepthMap::is_known(depth) && depth > self.far;
        if inset.is_nan() {
            Side::Unclear
        } else if inset < -margin || behind {
            Side::Background
        } else if inset >= margin && self.covers_depth(depth) {
            Side::Target
        } else {
            Side::Unclear
        }
    }

    /// The gate after the target moved to `bbox` and `delta_m` metres away from
    /// the camera.
    #[must_use]
    pub fn moved(&self, bbox: BoundingBox, delta_m: f32) -> Self {
        Self { bbox, near: self.near + delta_m, far: self.far + delta_m, ..*self }
    }

    /// The gate in a picture `sx` times as wide and `sy` times as high. The
    /// margin grows with the smaller of the two.
    #[must_use]
    pub fn scaled(&self, sx: f32, sy: f32) -> Self {
        Self { bbox: self.bbox.scaled(sx, sy), margin_px: self.margin_px * sx.min(sy), ..*self }
    }

    /// Distance to the nearest edge, pixels: positive inside the box. Outside it
    /// is minus the largest overshoot along an axis.
    fn inset(&self, x: f32, y: f32) -> f32 {
        let (x, y) = (x + 0.5, y + 0.5);
        if x.is_nan() || y.is_nan() {
            return f32::NAN;
        }
        let b = &self.bbox;
        (x - b.x0).min(b.x1 - x).min(y - b.y0).min(b.y1 - y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gate() -> ForegroundGate {
        ForegroundGate::new(BoundingBox::new(10.0, 20.0, 30.0, 50.0), 1.5, 2.0)
    }

    #[test]
    fn the_box_holds_the_pixels_whose_centres_it_holds() {
        let gate = gate();
        assert!(gate.contains(10.0, 20.0, 1.7), "centre of the first pixel inside");
        assert!(!gate.contains(9.0, 20.0, 1.7) && !gate.contains(10.0, 19.0, 1.7));
        assert!(gate.contains(29.0, 49.0, 1.7), "and of the last");
        assert!(!gate.contains(30.0, 49.0, 1.7) && !gate.contains(29.0, 50.0, 1.7));
    }

    #[test]
    fn the_ends_of_the_interval_belong_to_it_and_unknown_depths_do_not() {
        let gate = gate();
        for (depth, inside) in [
            (1.5, true),
            (2.0, true),
            (1.499, false),
            (2.001, false),
            (0.0, false),
            (-1.7, false),
            (f32::NAN, false),
            (f32::INFINITY, false),
        ] {
            assert_eq!(gate.contains(20.0, 30.0, depth), inside, "{depth}");
            assert_eq!(gate.covers_depth(depth), inside, "{depth}");
        }
    }

    #[test]
    fn the_table_of_sides() {
        let gate = gate();
        let depths = [1.0, 1.7, 5.0, f32::NAN];
        use Side::{Background, Target, Unclear};
        for (point, sides) in [
            ([20.0, 30.0], [Unclear, Target, Background, Unclear]),
            // one pixel inside and one outside of the left edge
            ([10.5, 30.0], [Unclear, Unclear, Background, Unclear]),
            ([8.5, 30.0], [Unclear, Unclear, Background, Unclear]),
            // three outside
            ([6.5, 30.0], [Background; 4]),
            ([20.0, 60.0], [Background; 4]),
            ([f32::NAN, 30.0], [Unclear; 4]),
        ] {
            for (depth, side) in depths.into_iter().zip(sides) {
                assert_eq!(gate.class_of(point, depth), side, "{point:?} {depth}");
            }
        }
    }

    #[test]
    fn a_gate_follows_its_target_and_its_picture() {
        let moved = gate().moved(gate().bbox.translated(100.0, 0.0), 0.5);
        assert!(moved.contains(120.0, 30.0, 2.4) && !moved.contains(120.0, 30.0, 1.7));
        let double = gate().scaled(2.0, 2.0);
        assert!(double.contains(20.0, 40.0, 1.7) && !double.contains(19.0, 40.0, 1.7));
        assert_eq!(double.margin_px, 4.0);
    }
}
