//! Errors of camera motion.
//!
//! The relative pose error of Sturm, Engelhard, Endres, Burgard and Cremers
//! ("A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012, eq. 1):
//! with `Q` the true and `P` the estimated poses `world_from_camera`,
//!
//! `E_i = (Q_i^-1 Q_(i+delta))^-1 (P_i^-1 P_(i+delta))`
//!
//! over all pairs that are `delta` frames apart. Its translation part and the
//! angle of its rotation say how wrong the motion over `delta` frames is,
//! whatever frame of reference each trajectory is in.

use realnet_core::Pose;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why trajectories cannot be compared.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OdometryError {
    /// The trajectories are not of one length.
    #[error("{truth} true and {estimate} estimated poses: one for each frame is needed")]
    Length {
        /// True poses.
        truth: usize,
        /// Estimated poses.
        estimate: usize,
    },
    /// A motion over no frames.
    #[error("the motion over 0 frames is nothing to be compared: delta must be at least 1")]
    Delta,
}

/// Mean, root mean square, median and largest of a number of errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorSummary {
    /// Mean.
    pub mean: f64,
    /// Root mean square.
    pub rmse: f64,
    /// Median; of an even number the mean of the middle two.
    pub median: f64,
    /// The largest.
    pub max: f64,
}

impl ErrorSummary {
    /// The summary of some errors; `None` of none.
    #[must_use]
    pub fn of(errors: &[f64]) -> Option<Self> {
        let n = errors.len() as f64;
        Some(Self {
            mean: errors.iter().sum::<f64>() / n,
            rmse: (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt(),
            median: crate::depth::median(&mut errors.to_vec())?,
            max: errors.iter().copied().max_by(f64::total_cmp)?,
        })
    }
}

/// Relative pose errors of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RelativePoseReport {
    /// Frames from one pose of a pair to the other; 0 when motions of different
    /// lengths were added.
    pub delta: usize,
    /// Pairs compared.
    pub pairs: usize,
    /// Pairs with a true motion but no estimate.
    pub missing: usize,
    /// Lengths of the translation errors, metres.
    pub translation_m: Option<ErrorSummary>,
    /// Angles of the rotation errors, degrees.
    pub rotation_deg: Option<ErrorSummary>,
}

/// Collects the errors of motions, one by one.
#[derive(Clone, Debug, Default)]
pub struct RelativePoseErrors {
    translation: Vec<f64>,
    rotation: Vec<f64>,
    missing: usize,
}

impl RelativePoseErrors {
    /// Adds a motion, both in the same sense (`earlier_from_later`, say), and
    /// gives its error: metres and degrees.
    pub fn add(&mut self, truth: &Pose, estimate: &Pose) -> (f64, f64) {
        let error = truth.inverse() * *estimate;
        let found = (error.translation_norm(), error.rotation_angle().to_degrees());
        self.translation.push(found.0);
        self.rotation.push(found.1);
        found
    }

    /// Counts a motion without an estimate.
    pub fn add_missing(&mut self) {
        self.missing += 1;
    }

    /// The errors so far, of motions over `delta` frames.
    #[must_use]
    pub fn report(&self, delta: usize) -> RelativePoseReport {
        RelativePoseReport {
            delta,
            pairs: self.translation.len(),
            missing: self.missing,
            translation_m: ErrorSummary::of(&self.translation),
            rotation_deg: ErrorSummary::of(&self.rotation),
        }
    }
}

/// The relative pose error of a trajectory. Entry `i` of both slices is
/// `world_from_camera` of frame `i`, `None` where it is not known. Pairs without
/// truth are left out; those with truth but without estimate are counted as
/// missing.
///
/// # Errors
/// [`OdometryError`] when the slices differ in length or `delta` is 0.
pub fn relative_pose_error(
    truth: &[Option<Pose>],
    estimate: &[Option<Pose>],
    delta: usize,
) -> Result<RelativePoseReport, OdometryError> {
    if truth.len() != estimate.len() {
        let (truth, estimate) = (truth.len(), estimate.len());
        return Err(OdometryError::Length { truth, estimate });
    }
    if delta == 0 {
        return Err(OdometryError::Delta);
    }
    let motions = |poses: &[Option<Pose>]| -> Vec<Option<Pose>> {
        let later = poses.iter().skip(delta);
        let motion = |(a, b): (&Option<Pose>, &Option<Pose>)| Some((*a)?.inverse() * (*b)?);
        poses.iter().zip(later).map(motion).collect()
    };
    let mut errors = RelativePoseErrors::default();
    for (truth, estimate) in motions(truth).iter().zip(motions(estimate)) {
        match (truth, estimate) {
            (Some(truth), Some(estimate)) => {
                errors.add(truth, &estimate);
            }
            (Some(_), None) => errors.add_missing(),
            (None, _) => {}
        }
    }
    Ok(errors.report(delta))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realnet_core::nalgebra::{Vector3, Vector6};

    fn at(x: f64, y: f64, degrees: f64) -> Option<Pose> {
        let turn = Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, degrees.to_radians());
        Some(Pose::new(Pose::exp(&turn).rotation(), Vector3::new(x, y, 0.0)))
    }

    #[test]
    fn by_hand() {
        let truth = [at(0.0, 0.0, 0.0), at(1.0, 0.0, 0.0), at(2.0, 0.0, 0.0), at(3.0, 0.0, 0.0)];
        // The first step is 0.1 m too long, the second turns by 2 degrees too
        // much, the third goes 1 m along the turned axis, which is right.
        let end = 2.1 + 2f64.to_radians().cos();
        let guess = [
            at(0.0, 0.0, 0.0),
            at(1.1, 0.0, 0.0),
            at(2.1, 0.0, 2.0),
            at(end, 2f64.to_radians().sin(), 2.0),
        ];
        let report = relative_pose_error(&truth, &guess, 1).unwrap();
        let (t, r) = (report.translation_m.unwrap(), report.rotation_deg.unwrap());
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a}, expected {b}");
        assert_eq!((report.pairs, report.missing, report.delta), (3, 0, 1));
        close(t.mean, 0.1 / 3.0);
        close(t.rmse, 0.1 / 3f64.sqrt());
        close(t.max, 0.1);
        close(t.median, 0.0);
        close(r.mean, 2.0 / 3.0);
        close(r.rmse, 2.0 / 3f64.sqrt());
        close(r.max, 2.0);
        // Over three frames the turn has moved the end to the side too.
        let report = relative_pose_error(&truth, &guess, 3).unwrap();
        let wanted = ((end - 3.0).powi(2) + 2f64.to_radians().sin().powi(2)).sqrt();
        close(report.translation_m.unwrap().rmse, wanted);
        close(report.rotation_deg.unwrap().max, 2.0);
    }

    #[test]
    fn gaps_are_counted_or_left_out() {
        let truth =
            [at(0.0, 0.0, 0.0), None, at(2.0, 0.0, 0.0), at(3.0, 0.0, 0.0), at(4.0, 0.0, 0.0)];
        let guess =
            [at(0.0, 0.0, 0.0), at(1.0, 0.0, 0.0), at(2.0, 0.0, 0.0), None, at(4.0, 0.0, 0.0)];
        let report = relative_pose_error(&truth, &guess, 1).unwrap();
        assert_eq!((report.pairs, report.missing), (0, 2));
        assert_eq!((report.translation_m, report.rotation_deg), (None, None));
        let report = relative_pose_error(&truth, &guess, 2).unwrap();
        assert_eq!((report.pairs, report.missing), (2, 0));
        let report = relative_pose_error(&truth, &guess, 9).unwrap();
        assert_eq!((report.pairs, report.missing), (0, 0));
        assert_eq!(relative_pose_error(&truth, &guess, 0), Err(OdometryError::Delta));
        let error = relative_pose_error(&truth, &guess[1..], 1).unwrap_err().to_string();
        assert!(error.starts_with("5 true and 4 estimated poses"), "{error}");
    }

    fn any_pose() -> impl Strategy<Value = Option<Pose>> {
        prop::array::uniform6(-1.5..1.5f64).prop_map(|t| Some(Pose::exp(&Vector6::from(t))))
    }

    proptest! {
        #[test]
        fn the_frame_of_reference_does_not_matter(
            truth in prop::collection::vec(any_pose(), 6), other in any_pose()
        ) {
            let moved: Vec<_> = truth.iter().map(|p| Some(other? * (*p)?)).collect();
            let report = relative_pose_error(&truth, &moved, 2).unwrap();
            prop_assert!(report.translation_m.unwrap().max < 1e-12);
            prop_assert!(report.rotation_deg.unwrap().max < 1e-10);
        }
    }
}
