//! The target as the moving camera sees it.

use realnet_core::nalgebra::{Matrix6, Vector2, Vector6};
use realnet_core::{Pose2, Stamp};

/// Nearer than this along the optical axis a target is not in view, metres.
pub(crate) const NEAREST: f64 = 0.01;
/// The logarithm of the range stays within this of zero: 45 µm to 22 km.
const LONGEST_LOG: f64 = 10.0;
/// Poses further apart than this tell nothing of the camera's motion, seconds.
const CAMERA_GAP_S: f64 = 0.5;
/// Its acceleration is smoothed over this time, seconds.
const CAMERA_SMOOTHING_S: f64 = 0.1;

/// Where the camera is and how it moves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Camera {
    stamp: Stamp,
    position: Vector2<f64>,
    velocity: Vector2<f64>,
    acceleration: Vector2<f64>,
}

impl Camera {
    /// By the poses of successive measurements.
    pub(crate) fn moved_to(camera: Option<Self>, stamp: Stamp, pose: &Pose2) -> Self {
        let position = pose.position();
        let (velocity, acceleration) = (Vector2::zeros(), Vector2::zeros());
        let fresh = Self { stamp, position, velocity, acceleration };
        let Some(last) = camera else { return fresh };
        let seconds = stamp.seconds_since(last.stamp);
        if seconds <= 0.0 {
            return last;
        }
        if seconds > CAMERA_GAP_S {
            return fresh;
        }
        let velocity = (position - last.position) / seconds;
        let acceleration = (velocity - last.velocity) / seconds;
        let share = seconds / (seconds + CAMERA_SMOOTHING_S);
        let acceleration = last.acceleration + (acceleration - last.acceleration) * share;
        Self { velocity, acceleration, ..fresh }
    }

    /// Whether it was followed since `last`.
    pub(crate) fn follows(&self, last: &Self) -> bool {
        self.stamp.seconds_since(last.stamp) <= CAMERA_GAP_S
    }

    /// Position, velocity and acceleration.
    pub(crate) fn motion(&self) -> Vector6<f64> {
        let Self { position, velocity, acceleration, .. } = self;
        Vector6::new(position.x, position.y, velocity.x, velocity.y, acceleration.x, acceleration.y)
    }
}

/// The target seen from the camera, in the coordinates in which all that is measured is
/// linear, and in which what is not observable is one fixed direction: a longer range
/// with a smaller scale error of its map, all relative motion growing with it.
#[derive(Clone, Copy)]
pub(crate) struct Seen {
    pub(crate) log_depth: f64,
    /// Lateral over forward distance.
    pub(crate) tangent: f64,
    /// Velocity and acceleration relative to the camera over the depth, along the axes
    /// of the fixed frame.
    pub(crate) rate: Vector2<f64>,
    pub(crate) rate_change: Vector2<f64>,
}

impl Seen {
    pub(crate) fn new(state: &Vector6<f64>, pose: &Pose2, camera: &Camera) -> Option<Self> {
        let position = Vector2::new(state[0], state[1]) - pose.position();
        let (forward, left) = axes(pose);
        let depth = forward.dot(&position);
        if depth.is_nan() || depth <= NEAREST {
            return None;
        }
        Some(Self {
            log_depth: depth.ln(),
            tangent: left.dot(&position) / depth,
            rate: (Vector2::new(state[2], state[3]) - camera.velocity) / depth,
            rate_change: (Vector2::new(state[4], state[5]) - camera.acceleration) / depth,
        })
    }

    pub(crate) fn depth(&self) -> f64 {
        self.log_depth.exp()
    }

    /// After a correction.
    pub(crate) fn plus(&self, change: &Vector6<f64>) -> Self {
        Self {
            log_depth: (self.log_depth + change[0]).clamp(-LONGEST_LOG, LONGEST_LOG),
            tangent: self.tangent + change[1],
            rate: self.rate + change.fixed_rows::<2>(2),
            rate_change: self.rate_change + change.fixed_rows::<2>(4),
        }
    }

    /// Position, velocity, acceleration in the fixed frame.
    pub(crate) fn state(&self, pose: &Pose2, camera: &Camera) -> Vector6<f64> {
        let depth = self.depth();
        let position = pose.transform_point(&(Vector2::new(1.0, self.tangent) * depth));
        let velocity = camera.velocity + self.rate * depth;
        let acceleration = camera.acceleration + self.rate_change * depth;
        Vector6::new(position.x, position.y, velocity.x, velocity.y, acceleration.x, acceleration.y)
    }

    /// Derivative of this by the state.
    pub(crate) fn seen_by_state(&self, pose: &Pose2) -> Matrix6<f64> {
        let inverse = 1.0 / self.depth();
        let (forward, left) = axes(pose);
        let mut derivative = Matrix6::from_diagonal_element(inverse);
        let log_depth = forward * inverse;
        let tangent = (left - forward * self.tangent) * inverse;
        for axis in 0..2 {
            derivative[(0, axis)] = log_depth[axis];
            derivative[(1, axis)] = tangent[axis];
            for row in 0..2 {
                derivative[(2 + row, axis)] = -self.rate[row] * log_depth[axis];
                derivative[(4 + row, axis)] = -self.rate_change[row] * log_depth[axis];
            }
        }
        derivative
    }

    /// Derivative of the state by this: the inverse of [`Seen::seen_by_state`].
    pub(crate) fn state_by_seen(&self, pose: &Pose2) -> Matrix6<f64> {
        let depth = self.depth();
        let (forward, left) = axes(pose);
        let mut derivative = Matrix6::from_diagonal_element(depth);
        let log_depth = (forward + left * self.tangent) * depth;
        for row in 0..2 {
            derivative[(row, 0)] = log_depth[row];
            derivative[(row, 1)] = left[row] * depth;
            derivative[(2 + row, 0)] = self.rate[row] * depth;
            derivative[(4 + row, 0)] = self.rate_change[row] * depth;
        }
        derivative
    }
}

/// Forward and left of a camera in the fixed frame.
fn axes(pose: &Pose2) -> (Vector2<f64>, Vector2<f64>) {
    let forward = pose.direction();
    (forward, Vector2::new(-forward.y, forward.x))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> (Pose2, Camera) {
        let camera = Camera {
            stamp: Stamp::ZERO,
            position: Vector2::new(1.0, 2.0),
            velocity: Vector2::new(0.4, -0.3),
            acceleration: Vector2::new(-0.5, 1.0),
        };
        (Pose2::new(1.0, 2.0, 0.7), camera)
    }

    #[test]
    fn there_and_back_and_the_derivatives() {
        let (pose, camera) = camera();
        let state = Vector6::new(2.5, 4.0, 0.8, 0.3, -1.0, 0.5);
        let seen = Seen::new(&state, &pose, &camera).unwrap();
        assert!((seen.state(&pose, &camera) - state).norm() < 1e-12);
        let product = seen.seen_by_state(&pose) * seen.state_by_seen(&pose);
        assert!((product - Matrix6::identity()).norm() < 1e-12, "{product}");
        for axis in 0..6 {
            let mut step = Vector6::zeros();
            step[axis] = 1e-6;
            let moved = seen.plus(&step).state(&pose, &camera);
            let back = seen.plus(&-step).state(&pose, &camera);
            let numeric = (moved - back) / 2e-6;
            let error = numeric - seen.state_by_seen(&pose).column(axis);
            assert!(error.norm() < 1e-8, "{axis}: {error}");
        }
        let behind = Vector6::new(0.5, 1.5, 0.0, 0.0, 0.0, 0.0);
        assert!(Seen::new(&behind, &pose, &camera).is_none());
    }

    /// The direction that is not observable is the same wherever the target is believed
    /// to be: everything relative to the camera grows in proportion.
    #[test]
    fn a_longer_range_is_one_direction() {
        let (pose, camera) = camera();
        let state = Vector6::new(2.5, 4.0, 0.8, 0.3, -1.0, 0.5);
        let seen = Seen::new(&state, &pose, &camera).unwrap();
        let longer = seen.plus(&(Vector6::x() * 2.0_f64.ln())).state(&pose, &camera);
        let parts = [camera.position, camera.velocity, camera.acceleration];
        for (part, own) in parts.into_iter().enumerate() {
            let before = state.fixed_rows::<2>(2 * part) - own;
            let after = longer.fixed_rows::<2>(2 * part) - own;
            assert!((after - before * 2.0).norm() < 1e-12, "{part}");
        }
    }

    #[test]
    fn the_motion_of_the_camera_is_that_of_its_poses() {
        let mut camera = None;
        for frame in 0..60 {
            let t = f64::from(frame) / 30.0;
            let pose = Pose2::new(0.5 * t + 0.5 * t * t, -t, 0.0);
            let stamp = Stamp::from_secs_f64(t);
            let first = Camera::moved_to(camera, stamp, &pose);
            // another measurement of the same frame
            camera = Some(Camera::moved_to(Some(first), stamp, &pose));
        }
        let moved = camera.unwrap();
        assert!((moved.velocity - Vector2::new(2.45, -1.0)).norm() < 0.02);
        assert!((moved.acceleration - Vector2::new(1.0, 0.0)).norm() < 0.02);
        let later = Camera::moved_to(camera, Stamp::from_secs_f64(9.0), &Pose2::IDENTITY);
        assert_eq!(later.velocity, Vector2::zeros());
    }
}
