//! Range from the known size of the target.

use super::attitude::{Attitude, MAX_ANGLE, Uncertain};
use realnet_core::OptionError;
use realnet_core::{BoundingBox, CameraError, CameraModel};
use thiserror::Error;

/// A dimension of the target, and of its box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Dimension {
    /// From the top to the bottom edge.
    Height,
    /// From the left to the right edge.
    Width,
}

impl std::fmt::Display for Dimension {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Height => "height",
            Self::Width => "width",
        })
    }
}

/// Why the size gives no range.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SizeRangeError {
    /// Neither height nor width of the target is known.
    #[error("neither the height nor the width of the target is known")]
    UnknownSize,
    /// The edges are swapped, equal or not finite.
    #[error("the box {x0} {y0} {x1} {y1} has no area")]
    ImproperBox {
        /// Left edge.
        x0: f32,
        /// Top edge.
        y0: f32,
        /// Right edge.
        x1: f32,
        /// Bottom edge.
        y1: f32,
    },
    /// The box reaches an end of the picture in the measured direction, so part
    /// of the target may lie beyond.
    #[error(
        "the box spans {start} to {end} of {size} pixels: part of the target's {dimension} \
         may be cut off"
    )]
    Cut {
        /// What was to be measured.
        dimension: Dimension,
        /// First edge of the box in that direction.
        start: f32,
        /// Second edge.
        end: f32,
        /// Pixels of the picture in that direction.
        size: u32,
    },
    /// The answer would be too uncertain to be a normal variable.
    #[error(
        "range {depth_m:.2} m +- {std_m:.2} m by {dimension}: at most a share of {limit} is accepted"
    )]
    TooUncertain {
        /// What was measured.
        dimension: Dimension,
        /// Depth, metres.
        depth_m: f64,
        /// Its standard deviation, metres.
        std_m: f64,
        /// Largest share of the range.
        limit: f64,
    },
    /// The camera has no ray for an edge of the box.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A number given does not fit.
    #[error(transparent)]
    Option(#[from] OptionError),
}

/// Range from the known size of the target: `Z = size / (difference of the rays
/// of the two edges)`, for a pinhole `f size / pixels`. The rays have the lens
/// taken out. The deviations of the two edges and of the size are taken to be
/// independent.
///
/// The height stands upright on the ground, seen by a camera of the given pitch;
/// the depth is that of its middle. The width is taken to be parallel to the
/// picture: that of a car seen askew is between its width and its length, which
/// the deviation of [`SizeRange::width_m`] has to say.
///
/// ```
/// use realnet_core::{BoundingBox, CameraModel, Distortion, Intrinsics};
/// use realnet_range::cues::{SizeRange, Uncertain};
///
/// let intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5 };
/// let camera = CameraModel::new(640, 480, intrinsics, Distortion::None)?;
/// let cue = SizeRange::from_height(Uncertain::new(0.2, 0.01));
/// let range = cue.measure(&camera, BoundingBox::new(300.0, 220.0, 340.0, 270.0))?;
/// assert!((range.depth_m - 2.0).abs() < 1e-9);
/// // 5 % of size, and two edges of 1.5 pixels each on 50
/// assert!((range.std_m - 2.0 * (0.05f64.powi(2) + 2.0 * 0.03f64.powi(2)).sqrt()).abs() < 1e-4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SizeRange {
    /// Height of the target, metres, where known.
    pub height_m: Option<Uncertain>,
    /// Width of the target, metres, where known.
    pub width_m: Option<Uncertain>,
    /// Pitch of the camera against the ground, radians, positive: nose down. It
    /// matters little and is taken to be exact.
    pub pitch_rad: f64,
    /// Standard deviation of each edge of the box, pixels.
    pub edge_std_px: f64,
    /// Boxes within this many pixels of the picture's ends are refused.
    pub border_px: f32,
    /// Ranges with a larger deviation, as a share of the range, are refused.
    pub max_std_share: f64,
}

/// A range from the size of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SizeEstimate {
    /// Depth along the optical axis, metres.
    pub depth_m: f64,
    /// Its standard deviation, metres: the root of the squares of the two below.
    pub std_m: f64,
    /// What the deviation of the box's edges makes of it, metres.
    pub edge_m: f64,
    /// What that of the size makes, metres.
    pub size_m: f64,
    /// What was measured.
    pub dimension: Dimension,
}

impl SizeRange {
    const NEW: Self = Self {
        height_m: None,
        width_m: None,
        pitch_rad: 0.0,
        edge_std_px: 1.5,
        border_px: 2.0,
        max_std_share: 0.25,
    };

    /// A target of known height: a level camera, edges within 1.5 pixels, a
    /// border of 2 pixels, deviations up to 0.25 of the range.
    #[must_use]
    pub const fn from_height(height_m: Uncertain) -> Self {
        Self { height_m: Some(height_m), ..Self::NEW }
    }

    /// A target of known width, otherwise as [`SizeRange::from_height`].
    #[must_use]
    pub const fn from_width(width_m: Uncertain) -> Self {
        Self { width_m: Some(width_m), ..Self::NEW }
    }

    /// The range of the target in `bbox`, whose edges lie between the pixels of
    /// the camera's picture. When both dimensions are known and give a range, it
    /// is the one with the smaller deviation; they are not averaged, because what
    /// makes a box too high usually makes it too wide.
    ///
    /// # Errors
    /// [`SizeRangeError`] with the reason why there is none; with two dimensions
    /// the reason of the height.
    pub fn measure(
        &self,
        camera: &CameraModel,
        bbox: BoundingBox,
    ) -> Result<SizeEstimate, SizeRangeError> {
        self.check()?;
        let BoundingBox { x0, y0, x1, y1 } = bbox;
        if !bbox.is_proper() {
            return Err(SizeRangeError::ImproperBox { x0, y0, x1, y1 });
        }
        let height = self.height_m.map(|size| self.by_height(camera, bbox, size));
        let width = self.width_m.map(|size| self.by_width(camera, bbox, size));
        match (height, width) {
            (None, None) => Err(SizeRangeError::UnknownSize),
            (Some(only), None) | (None, Some(only)) => only,
            (Some(Ok(a)), Some(Ok(b))) => Ok(if a.std_m <= b.std_m { a } else { b }),
            (Some(Ok(one)), Some(Err(_))) | (Some(Err(_)), Some(Ok(one))) => Ok(one),
            (Some(Err(reason)), Some(Err(_))) => Err(reason),
        }
    }

    fn by_height(
        &self,
        camera: &CameraModel,
        bbox: BoundingBox,
        size: Uncertain,
    ) -> Result<SizeEstimate, SizeRangeError> {
        let dimension = Dimension::Height;
        self.whole(dimension, bbox.y0, bbox.y1, camera.height())?;
        let u = 0.5 * (f64::from(bbox.x0) + f64::from(bbox.x1)) - 0.5;
        let up = -Attitude::new(self.pitch_rad, 0.0).down();
        // The foot X and the head X + size up on the rays of both edges, and from
        // them the depth of the middle.
        let depth_by_size = |top: f64, bottom: f64| -> Result<f64, CameraError> {
            let top = camera.unproject([u, top])?[1];
            let bottom = camera.unproject([u, bottom])?[1];
            Ok((top * up.z - up.y) / (bottom - top) + 0.5 * up.z)
        };
        self.estimate(dimension, size, depth_by_size, bbox.y0, bbox.y1)
    }

    fn by_width(
        &self,
        camera: &CameraModel,
        bbox: BoundingBox,
        size: Uncertain,
    ) -> Result<SizeEstimate, SizeRangeError> {
        let dimension = Dimension::Width;
        self.whole(dimension, bbox.x0, bbox.x1, camera.width())?;
        let v = 0.5 * (f64::from(bbox.y0) + f64::from(bbox.y1)) - 0.5;
        let depth_by_size = |left: f64, right: f64| -> Result<f64, CameraError> {
            Ok(1.0 / (camera.unproject([right, v])?[0] - camera.unproject([left, v])?[0]))
        };
        self.estimate(dimension, size, depth_by_size, bbox.x0, bbox.x1)
    }

    /// The depth is the size times a factor of the two edges.
    fn estimate(
        &self,
        dimension: Dimension,
        size: Uncertain,
        depth_by_size: impl Fn(f64, f64) -> Result<f64, CameraError>,
        first: f32,
        second: f32,
    ) -> Result<SizeEstimate, SizeRangeError> {
        let (first, second) = (f64::from(first) - 0.5, f64::from(second) - 0.5);
        let factor = depth_by_size(first, second)?;
        // Central differences; a quarter of a pixel holds for small boxes too.
        let step = 0.25_f64.min(0.1 * (second - first));
        let by_first = depth_by_size(first + step, second)? - depth_by_size(first - step, second)?;
        let by_second = depth_by_size(first, second + step)? - depth_by_size(first, second - step)?;
        let depth_m = size.value * factor;
        let gain = size.value * self.edge_std_px / (2.0 * step);
        let edge_m = gain * by_first.hypot(by_second);
        let size_m = size.std * factor.abs();
        let std_m = edge_m.hypot(size_m);
        let limit = self.max_std_share;
        // Also refuses not-a-number, and a lens that turns the edges around.
        if depth_m > 0.0 && std_m <= limit * depth_m {
            Ok(SizeEstimate { depth_m, std_m, edge_m, size_m, dimension })
        } else {
            Err(SizeRangeError::TooUncertain { dimension, depth_m, std_m, limit })
        }
    }

    fn whole(
        &self,
        dimension: Dimension,
        start: f32,
        end: f32,
        size: u32,
    ) -> Result<(), SizeRangeError> {
        if start > self.border_px && end < size as f32 - self.border_px {
            Ok(())
        } else {
            Err(SizeRangeError::Cut { dimension, start, end, size })
        }
    }

    fn check(&self) -> Result<(), OptionError> {
        if let Some(height) = self.height_m {
            height.check_positive("height_m")?;
        }
        if let Some(width) = self.width_m {
            width.check_positive("width_m")?;
        }
        Uncertain::exact(self.pitch_rad).check_within("pitch_rad", MAX_ANGLE)?;
        let check = OptionError::check;
        check("edge_std_px", self.edge_std_px, self.edge_std_px >= 0.0, "at least 0")?;
        check("border_px", f64::from(self.border_px), self.border_px >= 0.0, "at least 0")?;
        check("max_std_share", self.max_std_share, self.max_std_share > 0.0, "greater than 0")
    }
}
