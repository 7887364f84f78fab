//! The motion of camera and target since the last depth map, and the depth now.
//!
//! A depth map is rare and late: a network needs a third of a second for one.
//! Between two of them [`MotionTracker`] answers for every frame:
//!
//! 1. **On the frame of the depth map**, corners (Shi-Tomasi) are lifted to points
//!    by their depth. Those inside the target's [`ForegroundGate`] are the target's,
//!    those well outside of its box the background's (if they are few, those behind
//!    the target too: flow is disturbed near another body).
//! 2. **In each later frame** they are looked for by pyramidal Lucas-Kanade, from
//!    where the motion so far predicts them; if that fails from where they were
//!    last, and if that fails too from where a search of a small picture finds them.
//! 3. Each of the two sets gives **a rigid motion** by PnP: that of the background
//!    is the camera's own, reversed; both together give the target's. A target too
//!    small for a rotation of its own gets a translation.
//! 4. The depth map, **warped** by the two motions, is the depth now.
//!
//! What moves on its own without being the target is told from the ground once it
//! has moved by more than a pixel or so; until then it pulls at the camera's motion.
//!
//! A motion that cannot be stood by is a [`MotionFailure`] that says why, and what
//! depends on it is unknown.
//!
//! ```
//! use realnet_core::{CameraModel, DepthMap, Distortion, Frame, Intrinsics, Stamp};
//! use realnet_range::motion::{MotionOptions, MotionTracker};
//!
//! // A wall 2 m ahead with a pattern; the camera moves 2 cm to the right.
//! let intrinsics = Intrinsics { fx: 200.0, fy: 200.0, cx: 79.5, cy: 59.5 };
//! let camera = CameraModel::new(160, 120, intrinsics, Distortion::None)?;
//! let wall = |shift: f32| -> Vec<u8> {
//!     let grey = |x: f32, y: f32| (x * 0.31).sin() * (y * 0.23).cos() + (x * 0.11 + y * 0.17).sin();
//!     let pixel = |i: i32| 110.0 + 50.0 * grey((i % 160) as f32 + shift, (i / 160) as f32);
//!     (0..160 * 120).map(|i| pixel(i) as u8).collect()
//! };
//! let mut tracker = MotionTracker::new(&camera, MotionOptions::default())?;
//!
//! tracker.push(&Frame::grey8(Stamp::ZERO, 160, 120, wall(0.0))?)?;
//! tracker.keep(); // the frame that the depth network is given
//! let depth = DepthMap::new(Stamp::ZERO, 160, 120, vec![2.0; 160 * 120])?;
//! tracker.set_depth(&depth, None)?;
//!
//! let stamp = Stamp::from_secs_f64(0.1);
//! tracker.push(&Frame::grey8(stamp, 160, 120, wall(2.0))?)?;
//! let motion = tracker.estimate();
//! let velocity = motion.camera_velocity().ok_or("no motion")?;
//! assert!((velocity.linear().x - 0.2).abs() < 0.02, "{velocity:?}"); // m/s, x is right
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`ForegroundGate`]: crate::cues::ForegroundGate

mod body;
mod key;
mod shift;
mod tracker;
mod types;

pub use tracker::MotionTracker;
pub use types::{
    BodyMotion, KeySummary, Motion, MotionError, MotionFailure, MotionOptions, Start, Velocity,
};
