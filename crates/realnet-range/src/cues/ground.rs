//! Range from the ground plane.

use super::attitude::{Attitude, MAX_ANGLE, Uncertain, ray_derivatives};
use realnet_core::OptionError;
use realnet_core::nalgebra::Point3;
use realnet_core::{BoundingBox, CameraError, CameraModel};
use thiserror::Error;

/// Why the ground plane gives no range.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum GroundRangeError {
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
    /// The box reaches to the end of the picture, so the target's foot may lie
    /// beyond.
    #[error("the box ends at row {bottom} of {rows}: the target's foot may be cut off")]
    Cut {
        /// Bottom edge of the box.
        bottom: f32,
        /// Rows of the picture.
        rows: u32,
    },
    /// The middle of the bottom edge does not lie on the picture.
    #[error("the foot of the box at ({u}, {v}) lies outside the picture")]
    Outside {
        /// Column.
        u: f64,
        /// Row.
        v: f64,
    },
    /// The ray through the foot of the box does not go down.
    #[error("the foot of the box is {above_rad} rad above the horizon (pitch {pitch_rad} rad)")]
    AboveHorizon {
        /// Elevation of the ray, radians; 0 on the horizon.
        above_rad: f64,
        /// Pitch of the camera, radians.
        pitch_rad: f64,
    },
    /// The answer would be too uncertain to be a normal variable.
    #[error("range {depth_m:.2} m +- {std_m:.2} m: at most a share of {limit} is accepted")]
    TooUncertain {
        /// Depth of the ground point, metres.
        depth_m: f64,
        /// Its standard deviation, metres.
        std_m: f64,
        /// Largest share of the range.
        limit: f64,
    },
    /// The camera has no ray for the foot of the box.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A number given does not fit.
    #[error(transparent)]
    Option(#[from] OptionError),
}

/// Range from the ground plane: the depth of the point where the ray through the
/// middle of the box's bottom edge meets the ground. The deviations of the
/// fields are taken to be independent.
///
/// The point is where the target touches the ground nearest to the camera, seen
/// under the box's bottom edge: for a car ahead its rear tyres, not its middle.
///
/// With `d = down . [x, y, 1]` of [`Attitude::down`] and the ray `[x, y]`,
/// `Z = height / d`. Errors of `d` are nearly normal, so those of `Z` are when
/// they are small against it: `max_std_share` is the limit of that.
///
/// ```
/// use realnet_core::{BoundingBox, CameraModel, Distortion, Intrinsics};
/// use realnet_range::cues::{GroundRange, Uncertain};
///
/// let intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5 };
/// let camera = CameraModel::new(640, 480, intrinsics, Distortion::None)?;
/// // 0.2 m above the ground, level
/// let cue = GroundRange::new(Uncertain::new(0.2, 0.005), Uncertain::new(0.0, 0.01));
/// // 50 rows below the principal point: Z = 0.2 * 500 / 50
/// let range = cue.measure(&camera, BoundingBox::new(300.0, 220.0, 340.0, 290.0))?;
/// assert!((range.depth_m - 2.0).abs() < 1e-9);
/// // a pitch of 0.01 rad is 5 rows of 50
/// assert!((range.pitch_m - 0.2).abs() < 0.01);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundRange {
    /// Height of the camera above the ground, metres.
    pub camera_height_m: Uncertain,
    /// Pitch of the camera against the ground, radians, positive: nose down.
    pub pitch_rad: Uncertain,
    /// Roll of the camera against the ground, radians, positive: right side down.
    pub roll_rad: Uncertain,
    /// Standard deviation of the box's bottom edge, and of its middle, pixels.
    pub edge_std_px: f64,
    /// Boxes that end within this many pixels of the picture's end are refused.
    pub border_px: f32,
    /// Ranges with a larger deviation, as a share of the range, are refused.
    pub max_std_share: f64,
}

/// A range from the ground plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundEstimate {
    /// Depth of the target's foot along the optical axis, metres.
    pub depth_m: f64,
    /// Its standard deviation, metres: the root of the squares of the four below.
    pub std_m: f64,
    /// The foot in the optical frame, metres.
    pub foot: Point3<f64>,
    /// What the deviation of the box's edge makes of it, metres.
    pub edge_m: f64,
    /// What that of the camera's height makes, metres.
    pub height_m: f64,
    /// What that of the pitch makes, metres.
    pub pitch_m: f64,
    /// What that of the roll makes, metres.
    pub roll_m: f64,
}

impl GroundRange {
    /// No roll with a deviation of 0.01 rad, edges within 1.5 pixels, a border of
    /// 2 pixels, deviations up to 0.25 of the range.
    #[must_use]
    pub const fn new(camera_height_m: Uncertain, pitch_rad: Uncertain) -> Self {
        Self {
            camera_height_m,
            pitch_rad,
            roll_rad: Uncertain::new(0.0, 0.01),
            edge_std_px: 1.5,
            border_px: 2.0,
            max_std_share: 0.25,
        }
    }

    /// The attitude, without its deviations.
    #[must_use]
    pub fn attitude(&self) -> Attitude {
        Attitude::new(self.pitch_rad.value, self.roll_rad.value)
    }

    /// The range of the target in `bbox`, whose edges lie between the pixels of
    /// the camera's picture.
    ///
    /// # Errors
    /// [`GroundRangeError`] with the reason why there is none.
    pub fn measure(
        &self,
        camera: &CameraModel,
        bbox: BoundingBox,
    ) -> Result<GroundEstimate, GroundRangeError> {
        self.check()?;
        let BoundingBox { x0, y0, x1, y1 } = bbox;
        if !bbox.is_proper() {
            return Err(GroundRangeError::ImproperBox { x0, y0, x1, y1 });
        }
        let rows = camera.height();
        if y1 >= rows as f32 - self.border_px {
            return Err(GroundRangeError::Cut { bottom: y1, rows });
        }
        let [u, v] = [0.5 * (f64::from(x0) + f64::from(x1)) - 0.5, f64::from(y1) - 0.5];
        if !camera.contains([u, v]) {
            return Err(GroundRangeError::Outside { u, v });
        }
        let [x, y] = camera.unproject([u, v])?;
        let [by_u, by_v] = ray_derivatives(camera, [u, v])?;

        let down = self.attitude().down();
        let fall = down.x * x + down.y * y + down.z;
        // Also refuses not-a-number.
        if fall.is_nan() || fall <= 0.0 {
            let above_rad = (-fall / (x * x + y * y + 1.0).sqrt()).asin();
            let pitch_rad = self.pitch_rad.value;
            return Err(GroundRangeError::AboveHorizon { above_rad, pitch_rad });
        }
        let depth_m = self.camera_height_m.value / fall;

        // dZ = -Z / fall dfall
        let gain = depth_m / fall;
        let (sp, cp) = self.pitch_rad.value.sin_cos();
        let (sr, cr) = self.roll_rad.value.sin_cos();
        let fall_by_pitch = cp - sp * (sr * x + cr * y);
        let fall_by_roll = cp * (cr * x - sr * y);
        let along = |ray: [f64; 2]| down.x * ray[0] + down.y * ray[1];
        let edge_m = gain * self.edge_std_px * along(by_u).hypot(along(by_v));
        let height_m = self.camera_height_m.std / fall;
        let pitch_m = gain * self.pitch_rad.std * fall_by_pitch.abs();
        let roll_m = gain * self.roll_rad.std * fall_by_roll.abs();
        let std_m = edge_m.hypot(height_m).hypot(pitch_m).hypot(roll_m);
        let limit = self.max_std_share;
        if std_m.is_nan() || std_m > limit * depth_m {
            return Err(GroundRangeError::TooUncertain { depth_m, std_m, limit });
        }
        let foot = Point3::new(x * depth_m, y * depth_m, depth_m);
        Ok(GroundEstimate { depth_m, std_m, foot, edge_m, height_m, pitch_m, roll_m })
    }

    fn check(&self) -> Result<(), OptionError> {
        self.camera_height_m.check_positive("camera_height_m")?;
        self.pitch_rad.check_within("pitch_rad", MAX_ANGLE)?;
        self.roll_rad.check_within("roll_rad", MAX_ANGLE)?;
        let check = OptionError::check;
        check("edge_std_px", self.edge_std_px, self.edge_std_px >= 0.0, "at least 0")?;
        check("border_px", f64::from(self.border_px), self.border_px >= 0.0, "at least 0")?;
        check("max_std_share", self.max_std_share, self.max_std_share > 0.0, "greater than 0")
    }
}
