//! The pose of a calibrated camera from points known in space and seen in the
//! picture (PnP), with the deviation of the answer, or a reason why there is none;
//! and depth maps warped by such poses ([`DepthWarper`]), or read as surfaces
//! ([`SurfaceNormals`]).
//!
//! | function | what it needs | what it gives |
//! |---|---|---|
//! | [`p3p`] | 3 points and their bearings | up to 4 poses that fit exactly |
//! | [`dlt`] | 6 or more points off a plane, no outliers | the algebraic pose |
//! | [`PnpSolver::refine`] | a pose nearby, 4 or more points | the Huber estimate, its covariance |
//! | [`PnpSolver::solve_translation`] | 4 or more points, a rotation | the translation, its covariance |
//! | [`PnpSolver::solve`] | points with outliers, a seed | RANSAC, refined, with covariance |
//!
//! A correspondence is a point in the *world* (any rigid body: the ground, the
//! last frame's camera, a target) and the ray `[x / z, y / z]` on which the
//! camera sees it, as [`CameraModel::unproject`] gives it, so that every lens
//! model works. All poses are `camera_from_world`, the camera in its optical
//! frame (x right, y down, z forward). Residuals are in pixels: the difference
//! of the rays times the two focal lengths, that is, pixels of the picture with
//! the lens taken out.
//!
//! # What an accepted pose promises
//!
//! [`Estimate::covariance`] is the covariance of the *left* perturbation
//! `xi = [v; w]` in `camera_from_world = exp(xi) * estimate` with the twist order
//! of [`Pose::exp`]: translation (metres) first, rotation (radians) second, both
//! in the camera's frame. [`Estimate::p_value`] turns it into the probability
//! that the truth is as far away as a given pose. When this promise cannot be
//! made the solver answers with a [`PnpError`] that says why: too few points
//! agree, or they lie on a line, or a second pose explains them as well, or the
//! pose would be too uncertain to be linearised.
//!
//! No clock, no thread, no hidden randomness: the same input and seed give the
//! same bytes, on machines with and without AVX2. A [`PnpSolver`] owns its
//! scratch and does not allocate once it has seen the largest problem.
//!
//! ```
//! use realnet_core::{CameraModel, Distortion, Intrinsics, Pose};
//! use realnet_core::nalgebra::{Point3, Vector3, Vector6};
//! use realnet_pose::{PnpSolver, RansacOptions};
//!
//! let intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 320.0, cy: 240.0 };
//! let camera = CameraModel::new(640, 480, intrinsics, Distortion::None)?;
//! let camera_from_world = Pose::exp(&Vector6::new(0.1, -0.2, 4.0, 0.1, 0.2, -0.1));
//! let points: Vec<Point3<f64>> = (0..40)
//!     .map(|i| f64::from(i))
//!     .map(|i| Point3::new((i * 0.7).sin(), (i * 1.3).cos(), (i * 2.1).sin()))
//!     .collect();
//! let mut pixels = Vec::new();
//! for point in &points {
//!     pixels.push(camera.project(&(camera_from_world * *point))?);
//! }
//! pixels[3] = [12.0, 400.0]; // a wrong match
//!
//! let mut solver = PnpSolver::new(RansacOptions::default())?;
//! let estimate = solver.solve_pixels(&camera, &points, &pixels, 1)?;
//! assert!(!solver.inliers()[3]);
//! assert_eq!(estimate.inliers, 39);
//! let error = camera_from_world * estimate.camera_from_world.inverse();
//! assert!(error.rotation_angle() < 1e-9 && error.translation_norm() < 1e-9);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`CameraModel::unproject`]: realnet_core::CameraModel::unproject
//! [`Pose::exp`]: realnet_core::Pose::exp

#![allow(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "`!(a < b)` is how not-a-number fails a test here"
)]

mod ambiguity;
mod dlt;
mod error;
mod estimate;
mod geometry;
mod kernel;
mod lm;
mod normals;
mod options;
mod p3p;
mod problem;
mod ransac;
mod rng;
mod solver;
mod statistics;
mod translation;
mod warp;

pub use dlt::dlt;
pub use error::PnpError;
pub use estimate::{Estimate, Origin};
pub use normals::{NormalMap, NormalOptions, SurfaceNormals};
pub use options::{RansacOptions, RefineOptions};
pub use p3p::{P3pPoses, p3p};
pub use problem::Correspondences;
pub use solver::PnpSolver;
pub use warp::{DepthWarper, WarpError, WarpRegion};
