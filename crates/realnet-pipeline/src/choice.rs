//! Which of several detections is the target, where no carried box says so.

use realnet_core::{BoundingBox, Detection, Pose2, TrackStatus};
use realnet_fusion::Track;

/// How well the height of the target's box is known, in its logarithm: it shows other
/// sides when it turns.
const HEIGHT_STD: f64 = 0.15;
/// How well a direction is known at best, in its tangent.
const TANGENT_STD: f64 = 0.02;
/// What is further from where the target should be is another, standard deviations.
const GATE: f64 = 3.5;

/// How much a detection suggests itself while nothing is known: sure, large, and ahead.
/// `width`: pixels in a row of the picture.
pub(crate) fn prominence(detection: &Detection, width: u32) -> f64 {
    let half = 0.5 * f64::from(width);
    let aside = (f64::from(detection.bbox.center().0) - half) / (0.3 * half);
    let size = f64::from(detection.bbox.area()) * f64::from(detection.confidence);
    size * (-0.5 * aside * aside).exp()
}

/// Where the target should be in a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Expectation {
    tangent: f64,
    tangent_std: f64,
    depth_m: f64,
    depth_std_m: f64,
    status: TrackStatus,
}

impl Expectation {
    /// From what is known of the target at a frame's time, and the camera's place in the
    /// fixed frame then; `None` for a track that is searching.
    pub(crate) fn new(track: &Track, fixed_from_camera: &Pose2) -> Option<Self> {
        let motion = track.motion?;
        let there = fixed_from_camera.inverse().transform_point(&motion.position);
        let turn = fixed_from_camera.rotation().transpose();
        let covariance = turn * motion.position_covariance() * turn.transpose();
        let depth_m = there.x.max(0.1);
        Some(Self {
            tangent: there.y / depth_m,
            tangent_std: covariance[(1, 1)].max(0.0).sqrt() / depth_m,
            depth_m,
            depth_std_m: covariance[(0, 0)].max(0.0).sqrt(),
            status: track.status,
        })
    }

    /// How well a box suits, the higher the better; `None`: not at all. `tangent` and `std`
    /// are its direction's, `height` what is known of the target's: pixels x metres.
    pub(crate) fn likeness(
        &self,
        tangent: f64,
        std: f64,
        bbox: &BoundingBox,
        height: Option<f64>,
    ) -> Option<f64> {
        // A lost target may have turned round; it is known by its size alone.
        let wide = if self.status == TrackStatus::Lost { 3.0 } else { 1.0 };
        let deviation = (self.tangent_std * wide).hypot(std).hypot(TANGENT_STD);
        let side = (tangent - self.tangent) / deviation;
        let size = height.map_or(0.0, |height| {
            let expected = height / self.depth_m;
            let log = (f64::from(bbox.height()) / expected).ln();
            log / (wide * self.depth_std_m / self.depth_m).hypot(HEIGHT_STD)
        });
        let distance = side.hypot(size);
        (distance < GATE).then_some(-distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::Stamp;
    use realnet_core::nalgebra::{Matrix6, Vector2};
    use realnet_fusion::Motion;
    use std::f64::consts::FRAC_PI_2;

    const WIDTH: u32 = 640;

    fn detection(x: f32, side: f32, confidence: f32) -> Detection {
        let bbox = BoundingBox::from_center(x, 180.0, side, side);
        Detection { class_id: 0, confidence, bbox }
    }

    /// A target with these standard deviations along x and y of the fixed frame.
    fn track(position: [f64; 2], std: [f64; 2], status: TrackStatus) -> Track {
        let mut covariance = Matrix6::identity();
        (covariance[(0, 0)], covariance[(1, 1)]) = (std[0] * std[0], std[1] * std[1]);
        let motion = Motion {
            position: Vector2::from(position),
            velocity: Vector2::zeros(),
            acceleration: Vector2::zeros(),
            covariance,
        };
        let stamp = Stamp::ZERO;
        Track { stamp, status, measured: Some(stamp), motion: Some(motion), unknown_above: 0.5 }
    }

    fn ahead(status: TrackStatus) -> Expectation {
        let track = track([2.0, 0.0], [0.1, 0.04], status);
        Expectation::new(&track, &Pose2::IDENTITY).unwrap()
    }

    fn of_height(height: f32) -> BoundingBox {
        BoundingBox::from_center(320.0, 180.0, 80.0, height)
    }

    #[test]
    fn what_is_large_sure_and_ahead_suggests_itself() {
        let rate = |x, side, confidence| prominence(&detection(x, side, confidence), WIDTH);
        let best = rate(320.0, 60.0, 0.8);
        assert!((best - 3600.0 * 0.8).abs() < 1e-3, "ahead it is area times confidence: {best}");
        assert!((rate(320.0, 120.0, 0.8) / best - 4.0).abs() < 1e-6);
        assert!((rate(320.0, 60.0, 0.4) / best - 0.5).abs() < 1e-6);
        // Three tenths of half the picture aside are one deviation, on either side.
        for x in [320.0 - 96.0, 320.0 + 96.0] {
            assert!((rate(x, 60.0, 0.8) / best - (-0.5_f64).exp()).abs() < 1e-6);
        }
        assert!(rate(600.0, 150.0, 0.9) < best, "a large one at the edge is not the target");
    }

    #[test]
    fn the_target_is_expected_where_the_camera_sees_it() {
        // The camera looks along y from (1, 1): the target is 2 m ahead, 0.5 m to its left.
        let camera = Pose2::new(1.0, 1.0, FRAC_PI_2);
        let seen = track([0.5, 3.0], [0.1, 0.4], TrackStatus::Tracking);
        let found = Expectation::new(&seen, &camera).unwrap();
        assert!((found.depth_m - 2.0).abs() < 1e-9 && (found.tangent - 0.25).abs() < 1e-9);
        // What is along the fixed frame's y is depth here.
        assert!((found.depth_std_m - 0.4).abs() < 1e-9, "{found:?}");
        assert!((found.tangent_std - 0.05).abs() < 1e-9, "{found:?}");
        // Behind the camera: no division by what is not ahead.
        let behind = Expectation::new(&seen, &Pose2::new(0.5, 4.0, FRAC_PI_2)).unwrap();
        assert!(behind.depth_m == 0.1 && behind.tangent.is_finite());
        let searching = Track { motion: None, status: TrackStatus::Searching, ..seen };
        assert!(Expectation::new(&searching, &camera).is_none());
    }

    #[test]
    fn a_box_is_judged_by_its_direction() {
        let expected = ahead(TrackStatus::Tracking);
        let rate = |tangent| expected.likeness(tangent, 0.01, &of_height(60.0), None);
        assert_eq!(rate(0.0), Some(0.0));
        // 0.04 m at 2 m, the box's own deviation, and what no direction is better than
        let deviation = 0.02_f64.hypot(0.01).hypot(TANGENT_STD);
        for sign in [-1.0, 1.0] {
            let found = rate(sign * 2.0 * deviation).unwrap();
            assert!((found + 2.0).abs() < 1e-9, "{found}");
            assert!(rate(sign * 0.99 * GATE * deviation).is_some());
            assert_eq!(rate(sign * 1.01 * GATE * deviation), None);
        }
        // One that is lost may be further aside.
        let lost = ahead(TrackStatus::Lost);
        assert!(lost.likeness(1.5 * GATE * deviation, 0.01, &of_height(60.0), None).is_some());
    }

    #[test]
    fn a_box_is_judged_by_its_size_once_that_is_known() {
        let expected = ahead(TrackStatus::Tracking);
        let rate = |height, known| expected.likeness(0.0, 0.01, &of_height(height), known);
        // 60 pixels at 2 m
        let known = Some(120.0);
        assert!(rate(60.0, known).unwrap().abs() < 1e-9);
        let deviation = 0.05_f64.hypot(HEIGHT_STD);
        let larger = 60.0 * (2.0 * deviation).exp();
        assert!((rate(larger as f32, known).unwrap() + 2.0).abs() < 1e-4);
        assert_eq!(rate(120.0, known), None, "twice as large is another");
        assert_eq!(rate(30.0, known), None, "and so is half");
        assert_eq!(rate(120.0, None), Some(0.0), "of unknown size any will do");
        // Both count together, and what is no number suits nothing.
        let aside = expected.likeness(0.05, 0.01, &of_height(larger as f32), known).unwrap();
        assert!(aside < rate(larger as f32, known).unwrap());
        assert_eq!(expected.likeness(f64::NAN, 0.01, &of_height(60.0), known), None);
        assert_eq!(rate(0.0, known), None);
    }
}
