//! A picture and what is really in it.

use realnet_core::{BoundingBox, DepthMap, Frame};

/// A picture with its truth, in buffers that are used again.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// The picture, RGB, at the middle of the exposure.
    pub frame: Frame,
    /// Depth of each pixel's middle along the optical axis, metres; 0 is unknown: the
    /// sky, and what the lens does not see. Without noise or blur.
    pub depth: DepthMap,
    /// What each pixel shows: 0 the scene, `i + 1` the actor `i`, 255 what moves by
    /// itself in the scene. Row by row.
    pub mask: Vec<u8>,
    pub(super) truths: Vec<Option<Truth>>,
    /// Gain of the exposure that was used.
    pub(super) gain: f64,
}

/// How an actor is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// The tight box of the pixels that show it.
    pub bbox: BoundingBox,
    /// The box of its whole shape, as if nothing hid it and the picture had no edges.
    /// Corners that the lens cannot see are left out.
    pub full_bbox: BoundingBox,
    /// Number of pixels that show it.
    pub pixels: usize,
    /// Share of its silhouette within the picture that is not hidden, 0 to 1.
    pub visible_share: f64,
    /// Share of `full_bbox` that lies within the picture, 0 to 1.
    pub inside_share: f64,
    /// Median depth of the pixels that show it, metres.
    pub depth_median_m: f64,
    /// Least depth of them, metres.
    pub depth_min_m: f64,
}

impl Rendered {
    /// How the actor `index` of the shot is seen; `None` when no pixel shows it.
    #[must_use]
    pub fn truth(&self, index: usize) -> Option<Truth> {
        self.truths.get(index).copied().flatten()
    }

    /// The gain of the exposure.
    #[must_use]
    pub fn gain(&self) -> f64 {
        self.gain
    }
}
