//! Why there is no pose.

use realnet_core::CameraError;
use thiserror::Error;

/// Why a problem has no pose that can be stood by.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PnpError {
    /// The two lists do not belong together.
    #[error("{points} points but {observations} observations of them")]
    LengthMismatch {
        /// Points in the world.
        points: usize,
        /// Rays or pixels.
        observations: usize,
    },
    /// A coordinate is not a number, or so large that its square is not.
    #[error("correspondence {index} is not finite or beyond 1e100")]
    NotFinite {
        /// Place in the list.
        index: usize,
    },
    /// A focal length is not finite and positive.
    #[error("the focal length along {axis} is {value}, it must be finite and positive")]
    FocalLength {
        /// `x` or `y`.
        axis: char,
        /// What was given.
        value: f64,
    },
    /// An option is out of its range.
    #[error("option {name} is {value}, it must be {range}")]
    Option {
        /// Its name.
        name: &'static str,
        /// What was given.
        value: f64,
        /// What is accepted.
        range: &'static str,
    },
    /// A pixel has no ray.
    #[error("pixel {index}: {source}")]
    Camera {
        /// Place in the list.
        index: usize,
        /// What the camera model says.
        source: CameraError,
    },
    /// The method needs more points.
    #[error("{found} points, at least {needed} are needed")]
    TooFewPoints {
        /// Points given.
        found: usize,
        /// Points needed.
        needed: usize,
    },
    /// The best pose explains too few points to rule out chance.
    #[error("the best pose explains {found} of {points} points, at least {needed} are needed")]
    TooFewInliers {
        /// Different points within the threshold.
        found: usize,
        /// Needed by the options or to rule out a match by chance.
        needed: usize,
        /// Points given.
        points: usize,
    },
    /// The points lie on a line, about which the camera may turn freely.
    #[error(
        "the points are collinear: their second extent is {ratio:.3e} of the first (limit {limit:.0e})"
    )]
    Collinear {
        /// Second over first standard deviation along the principal axes.
        ratio: f64,
        /// Smallest ratio accepted.
        limit: f64,
    },
    /// The points lie on a plane, where the DLT has no unique answer.
    #[error(
        "the points are coplanar: their third extent is {ratio:.3e} of the first (limit {limit:.0e}), which the DLT cannot solve"
    )]
    Planar {
        /// Third over first standard deviation along the principal axes.
        ratio: f64,
        /// Smallest ratio accepted.
        limit: f64,
    },
    /// The equations leave more than one answer (a critical set).
    #[error(
        "the equations do not fix the pose: a second solution fits to {ratio:.3e} (limit {limit:.0e})"
    )]
    Degenerate {
        /// Second smallest over largest singular value, or the reciprocal
        /// condition of the normal equations.
        ratio: f64,
        /// Smallest ratio accepted.
        limit: f64,
    },
    /// Points lie behind the camera.
    #[error("{count} of {points} points lie behind the camera")]
    Behind {
        /// How many.
        count: usize,
        /// Points given.
        points: usize,
    },
    /// The pose does not explain the picture.
    #[error(
        "the reprojection error is {rms_px:.3} px a coordinate, at most {limit_px:.3} px are accepted"
    )]
    ReprojectionTooLarge {
        /// Root mean square of the residual coordinates, pixels.
        rms_px: f64,
        /// Largest accepted, pixels.
        limit_px: f64,
    },
    /// The residuals go on beyond the threshold, so that the inliers are not the
    /// points of one pose but a choice of them.
    #[error(
        "{found} points lie just beyond the threshold of {threshold_px} px and {within} within: the noise is larger, or the points are not rigid"
    )]
    ThresholdTooSmall {
        /// Points between the threshold and 3.16 of it.
        found: usize,
        /// Points within it.
        within: usize,
        /// The threshold, pixels.
        threshold_px: f64,
    },
    /// Refinement did not come to rest.
    #[error("refinement did not converge within {iterations} steps")]
    NotConverged {
        /// Steps taken.
        iterations: usize,
    },
    /// The points fix the pose too loosely for its covariance to mean anything.
    #[error(
        "the pose is uncertain: standard deviation {rotation_rad:.4} rad (limit {rotation_limit}) and {translation_share:.4} of the distance (limit {translation_limit})"
    )]
    Uncertain {
        /// Largest standard deviation of the rotation over all axes, radians.
        rotation_rad: f64,
        /// Its limit.
        rotation_limit: f64,
        /// Largest standard deviation of the translation over all directions, as
        /// a share of the distance to the mean of the points.
        translation_share: f64,
        /// Its limit.
        translation_limit: f64,
    },
    /// Two separate poses explain the points about equally well.
    #[error(
        "two poses {rotation_rad:.4} rad and {translation_m:.4} m apart explain the points: {inliers} and {other_inliers} of them"
    )]
    Ambiguous {
        /// Angle between the two, radians.
        rotation_rad: f64,
        /// Distance between the two, metres: the translation of the motion that
        /// leads from one to the other.
        translation_m: f64,
        /// Points that the better one explains.
        inliers: usize,
        /// Points that the other one explains.
        other_inliers: usize,
    },
}
