//! The camera's pitch against the ground, estimated while driving.

use super::attitude::{Attitude, MAX_ANGLE, Uncertain, ray_derivatives};
use realnet_core::OptionError;
use realnet_core::nalgebra::{Matrix6, UnitQuaternion, Vector3};
use realnet_core::{CameraError, CameraModel, Pose};
use thiserror::Error;

/// Where a pitch comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PitchSource {
    /// The ground in a depth map.
    GroundFit,
    /// The direction in which the camera moves.
    Translation,
    /// The horizon in the picture.
    Horizon,
    /// How the camera is mounted.
    Mount,
}

/// One measurement of the pitch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PitchMeasurement {
    /// Where it comes from.
    pub source: PitchSource,
    /// Pitch in radians, positive: nose down.
    pub pitch_rad: f64,
    /// Its standard deviation, radians.
    pub std_rad: f64,
}

/// Why there is no pitch.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PitchError {
    /// The camera did not move far enough along its axis for a direction.
    #[error("the camera moved {forward_m:.4} m +- {std_m:.4} m forward: no direction")]
    TooSlow {
        /// Motion along the optical axis, metres.
        forward_m: f64,
        /// Its standard deviation, metres.
        std_m: f64,
    },
    /// The two points of the horizon are too close together, or not finite.
    #[error("({}, {}) and ({}, {}) do not define a horizon", a[0], a[1], b[0], b[1])]
    NoHorizon {
        /// First pixel.
        a: [f64; 2],
        /// Second pixel.
        b: [f64; 2],
    },
    /// The camera has no ray for a pixel.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A number given does not fit.
    #[error(transparent)]
    Option(#[from] OptionError),
}

/// The forward motion must be this many of its deviations.
const MIN_FORWARD_SIGMAS: f64 = 5.0;

/// The pitch from the direction in which the camera moved: a vehicle moves
/// parallel to the ground, forwards, backwards or in a bend, so `down . motion =
/// 0`. With the motion `d` in the camera's present optical frame,
/// `tan(pitch) = -(sin(roll) d_x + cos(roll) d_y) / d_z`.
///
/// `now_from_before` takes points of the previous camera frame to the present
/// one, `covariance` is that of its left perturbation `[v; w]` (metres, radians),
/// as `realnet_pose::Estimate` has it. `heave_std_m` is the standard deviation of
/// how far the camera rose or sank between the frames (springs, bumps).
///
/// # Errors
/// [`PitchError::TooSlow`] when the motion along the axis is less than five of
/// its deviations, [`PitchError::Option`] for numbers that do not fit.
pub fn pitch_from_translation(
    now_from_before: &Pose,
    covariance: &Matrix6<f64>,
    roll_rad: Uncertain,
    heave_std_m: f64,
) -> Result<PitchMeasurement, PitchError> {
    roll_rad.check_within("roll_rad", MAX_ANGLE)?;
    OptionError::check("heave_std_m", heave_std_m, heave_std_m >= 0.0, "at least 0")?;
    let size = covariance.abs().max();
    OptionError::check("covariance", size, covariance.iter().all(|v| v.is_finite()), "finite")?;
    // The previous camera lies at t: the camera moved by -t, and its error is
    // -(v + w x t) = -v + t x w.
    let t = now_from_before.translation();
    let moved = -t;
    let error = |along: &Vector3<f64>| {
        let by_w = along.cross(&t);
        let mut row = realnet_core::nalgebra::Vector6::zeros();
        row.fixed_rows_mut::<3>(0).copy_from(&-along);
        row.fixed_rows_mut::<3>(3).copy_from(&by_w);
        (covariance * row).dot(&row)
    };
    let forward_std = error(&Vector3::z()).max(0.0).sqrt();
    let forward_m = moved.z;
    let ok = forward_m.abs() > MIN_FORWARD_SIGMAS * forward_std;
    if !ok || !moved.iter().all(|value| value.is_finite()) {
        return Err(PitchError::TooSlow { forward_m, std_m: forward_std });
    }
    let (sr, cr) = roll_rad.value.sin_cos();
    let sunk = sr * moved.x + cr * moved.y;
    let tangent = -sunk / forward_m;
    // d(pitch) = d(tan) / (1 + tan^2)
    let by_motion = Vector3::new(-sr, -cr, -tangent) / forward_m;
    let by_roll = (cr * moved.x - sr * moved.y) / forward_m;
    let by_heave = (1.0 + tangent * tangent).sqrt() / forward_m;
    let variance = error(&by_motion).max(0.0)
        + (by_roll * roll_rad.std).powi(2)
        + (by_heave * heave_std_m).powi(2);
    let std_rad = variance.sqrt() / (1.0 + tangent * tangent);
    OptionError::check("deviation of the pitch", std_rad, true, "finite")?;
    Ok(PitchMeasurement { source: PitchSource::Translation, pitch_rad: tangent.atan(), std_rad })
}

/// An attitude from the horizon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HorizonAttitude {
    /// Pitch and roll.
    pub attitude: Attitude,
    /// Standard deviation of the pitch, radians.
    pub pitch_std_rad: f64,
    /// Standard deviation of the roll, radians.
    pub roll_std_rad: f64,
}

impl HorizonAttitude {
    /// The pitch, for a [`PitchFilter`].
    #[must_use]
    pub fn measurement(&self) -> PitchMeasurement {
        let (pitch_rad, std_rad) = (self.attitude.pitch_rad, self.pitch_std_rad);
        PitchMeasurement { source: PitchSource::Horizon, pitch_rad, std_rad }
    }
}

/// The attitude from two pixels `a`, `b` on the horizon, in either order, each
/// with an independent error of `std_px` in its row. The ground is below.
///
/// The rays of the horizon are parallel to the ground, so `down` is along their
/// cross product.
///
/// # Errors
/// [`PitchError::Camera`] when the lens has no ray for a pixel,
/// [`PitchError::NoHorizon`] when the pixels are less than 1 column apart,
/// [`PitchError::Option`] for a deviation below 0.
pub fn attitude_from_horizon(
    camera: &CameraModel,
    a: [f64; 2],
    b: [f64; 2],
    std_px: f64,
) -> Result<HorizonAttitude, PitchError> {
    OptionError::check("std_px", std_px, std_px >= 0.0, "at least 0")?;
    let (a, b) = if a[0] <= b[0] { (a, b) } else { (b, a) };
    let none = PitchError::NoHorizon { a, b };
    let apart = b[0] - a[0];
    if apart.is_nan() || apart < 1.0 {
        return Err(none);
    }
    let lift = |[x, y]: [f64; 2]| Vector3::new(x, y, 1.0);
    let (ray_a, ray_b) = (lift(camera.unproject(a)?), lift(camera.unproject(b)?));
    // z x x = y: from the left to the right ray the right hand's thumb points down.
    let down = ray_a.cross(&ray_b);
    let attitude = Attitude::from_down(&down).filter(|_| down.y > 0.0).ok_or(none)?;
    let (mut pitch, mut roll) = (0.0_f64, 0.0_f64);
    let norm = down.norm();
    let unit = down / norm;
    for (pixel, other, sign) in [(a, ray_b, -1.0), (b, ray_a, 1.0)] {
        let [_, [dx, dy]] = ray_derivatives(camera, pixel)?;
        let change = sign * other.cross(&Vector3::new(dx, dy, 0.0));
        let by_pitch = (change.z - unit.z * unit.dot(&change)) / norm / attitude.pitch_rad.cos();
        let level = down.x * down.x + down.y * down.y;
        let by_roll = (down.y * change.x - down.x * change.y) / level;
        pitch = pitch.hypot(by_pitch * std_px);
        roll = roll.hypot(by_roll * std_px);
    }
    Ok(HorizonAttitude { attitude, pitch_std_rad: pitch, roll_std_rad: roll })
}

/// What [`PitchFilter`] assumes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PitchFilterOptions {
    /// Roll of the camera against the ground, radians, positive: right side
    /// down. It is not estimated; its deviation counts where it matters.
    pub roll_rad: Uncertain,
    /// How fast the pitch wanders beyond what the rotations say, radians per root
    /// second: changes of the ground's slope, drift of the rotations.
    pub process_std: f64,
    /// Measurements further from the prediction than this many deviations of the
    /// difference are not used.
    pub gate_sigmas: f64,
    /// The deviation is never less than this, radians: measurements share errors
    /// (the depth source's, the calibration's) that do not average away.
    pub floor_std_rad: f64,
    /// After so many refused measurements in a row the filter starts again from
    /// the last one: then it is the filter that is wrong. `None` for never.
    pub restart_after: Option<u32>,
}

impl Default for PitchFilterOptions {
    fn default() -> Self {
        Self {
            roll_rad: Uncertain::new(0.0, 0.01),
            process_std: 0.01,
            gate_sigmas: 3.5,
            floor_std_rad: 0.001,
            restart_after: Some(8),
        }
    }
}

/// What came of a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PitchUpdate {
    /// Whether the measurement was used. If not, it disagrees with all that is
    /// known about the pitch.
    pub accepted: bool,
    /// Whether the filter started again from this measurement.
    pub restarted: bool,
    /// Measured minus predicted, radians.
    pub innovation_rad: f64,
    /// Standard deviation of that difference, radians.
    pub innovation_std_rad: f64,
}

impl PitchUpdate {
    /// The difference in its deviations, at least 0.
    #[must_use]
    pub fn sigmas(&self) -> f64 {
        self.innovation_rad.abs() / self.innovation_std_rad
    }
}

/// Kalman filter of the camera's pitch against the ground: rotations between
/// frames carry it, measurements correct it.
///
/// The roll is not estimated but *considered* (Schmidt, 1966): a constant roll
/// that is wrong turns part of every yaw into pitch, always to the same side, and
/// the covariance of pitch and roll keeps account of that.
///
/// Rotation and translation of one pose have correlated errors, which the filter
/// neglects: they are small against the deviation of a direction.
///
/// ```
/// use realnet_core::nalgebra::{UnitQuaternion, Vector3};
/// use realnet_range::cues::{PitchFilter, PitchFilterOptions, Uncertain};
/// use realnet_range::cues::{PitchMeasurement, PitchSource};
///
/// let mount = Uncertain::new(0.05, 0.02);
/// let mut filter = PitchFilter::new(mount, PitchFilterOptions::default())?;
/// // The nose drops by 0.01 rad: what was ahead moves up in the picture.
/// let now_from_before = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.01);
/// filter.predict(&now_from_before, 0.001, 0.033)?;
/// assert!((filter.pitch_rad().value - 0.06).abs() < 1e-9);
/// let source = PitchSource::Horizon;
/// let update = filter.update(&PitchMeasurement { source, pitch_rad: 0.063, std_rad: 0.01 })?;
/// assert!(update.accepted && filter.pitch_rad().std < 0.01);
/// # Ok::<(), realnet_range::cues::OptionError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct PitchFilter {
    options: PitchFilterOptions,
    pitch: f64,
    variance: f64,
    /// Covariance of the pitch with the roll that is assumed.
    with_roll: f64,
    refused: u32,
}

impl PitchFilter {
    /// Starts from the pitch of the mount, with its standard deviation.
    ///
    /// # Errors
    /// [`OptionError`] when a number does not fit.
    pub fn new(pitch_rad: Uncertain, options: PitchFilterOptions) -> Result<Self, OptionError> {
        let check = OptionError::check;
        options.roll_rad.check_within("roll_rad", MAX_ANGLE)?;
        check("process_std", options.process_std, options.process_std >= 0.0, "at least 0")?;
        check("gate_sigmas", options.gate_sigmas, options.gate_sigmas > 0.0, "greater than 0")?;
        let floor = options.floor_std_rad;
        check("floor_std_rad", floor, floor >= 0.0, "at least 0")?;
        let mut filter = Self { options, pitch: 0.0, variance: 0.0, with_roll: 0.0, refused: 0 };
        filter.reset(pitch_rad)?;
        Ok(filter)
    }

    /// Forgets everything and starts from a pitch.
    ///
    /// # Errors
    /// [`OptionError`] when a number does not fit; the filter is then unchanged.
    pub fn reset(&mut self, pitch_rad: Uncertain) -> Result<(), OptionError> {
        pitch_rad.check_within("pitch_rad", MAX_ANGLE)?;
        self.pitch = pitch_rad.value;
        self.set_variance(pitch_rad.std.powi(2));
        self.with_roll = 0.0;
        self.refused = 0;
        Ok(())
    }

    /// The pitch in radians, positive: nose down.
    #[must_use]
    pub fn pitch_rad(&self) -> Uncertain {
        Uncertain::new(self.pitch, self.variance.sqrt())
    }

    /// Pitch and the roll assumed.
    #[must_use]
    pub fn attitude(&self) -> Attitude {
        Attitude::new(self.pitch, self.options.roll_rad.value)
    }

    /// How many measurements were refused since the last one that was used.
    #[must_use]
    pub fn refused_in_a_row(&self) -> u32 {
        self.refused
    }

    /// Carries the pitch over a rotation of the camera: `now_from_before` takes
    /// directions in the previous optical frame to the present one, `std_rad` is
    /// the standard deviation of its error about each axis, `dt_s` the time
    /// between the frames in seconds. With the identity and the rotation's
    /// deviation unknown, give the largest rate of pitch times the time.
    ///
    /// # Errors
    /// [`OptionError`] when a number does not fit or the camera would look
    /// straight up or down; the filter is then unchanged.
    pub fn predict(
        &mut self,
        now_from_before: &UnitQuaternion<f64>,
        std_rad: f64,
        dt_s: f64,
    ) -> Result<(), OptionError> {
        OptionError::check("std_rad", std_rad, std_rad >= 0.0, "at least 0")?;
        OptionError::check("dt_s", dt_s, dt_s >= 0.0, "at least 0")?;
        let (sp, cp) = self.pitch.sin_cos();
        let (sr, cr) = self.options.roll_rad.value.sin_cos();
        let down = now_from_before * self.attitude().down();
        let pitch = down.z.clamp(-1.0, 1.0).asin();
        OptionError::check("predicted pitch", pitch, pitch.abs() <= MAX_ANGLE, "an attitude")?;
        let cos = pitch.cos();
        let by_pitch = (now_from_before * Vector3::new(-sp * sr, -sp * cr, cp)).z / cos;
        let by_roll = (now_from_before * Vector3::new(cp * cr, -cp * sr, 0.0)).z / cos;
        // An error w of the rotation moves down by w x down, and the pitch by
        // (w_x down_y - w_y down_x) / cos: of the same size, |(x, y)| = cos.
        let roll_variance = self.options.roll_rad.std.powi(2);
        let variance = by_pitch * by_pitch * self.variance
            + 2.0 * by_pitch * by_roll * self.with_roll
            + by_roll * by_roll * roll_variance
            + std_rad * std_rad
            + self.options.process_std.powi(2) * dt_s;
        self.pitch = pitch;
        self.with_roll = by_pitch * self.with_roll + by_roll * roll_variance;
        self.set_variance(variance);
        Ok(())
    }

    /// Corrects the pitch by a measurement, unless it lies beyond the gate.
    ///
    /// # Errors
    /// [`OptionError`] when a number does not fit; the filter is then unchanged.
    pub fn update(&mut self, measurement: &PitchMeasurement) -> Result<PitchUpdate, OptionError> {
        let PitchMeasurement { pitch_rad, std_rad, .. } = *measurement;
        Uncertain::exact(pitch_rad).check_within("pitch_rad", MAX_ANGLE)?;
        OptionError::check("std_rad", std_rad, std_rad > 0.0, "greater than 0")?;
        let innovation_rad = pitch_rad - self.pitch;
        let total = self.variance + std_rad * std_rad;
        let innovation_std_rad = total.sqrt();
        let accepted = innovation_rad.abs() <= self.options.gate_sigmas * innovation_std_rad;
        let mut restarted = false;
        if accepted {
            let gain = self.variance / total;
            self.pitch += gain * innovation_rad;
            self.set_variance((1.0 - gain) * self.variance);
            self.with_roll *= 1.0 - gain;
            self.refused = 0;
        } else {
            self.refused = self.refused.saturating_add(1);
            restarted = self.options.restart_after.is_some_and(|limit| self.refused >= limit);
            if restarted {
                self.reset(Uncertain::new(pitch_rad, std_rad))?;
            }
        }
        Ok(PitchUpdate { accepted, restarted, innovation_rad, innovation_std_rad })
    }

    fn set_variance(&mut self, variance: f64) {
        self.variance = variance.max(self.options.floor_std_rad.powi(2));
    }
}
