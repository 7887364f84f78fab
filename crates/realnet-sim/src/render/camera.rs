//! A camera on a vehicle, and its sensor.

use realnet_core::nalgebra::{UnitQuaternion, Vector3};
use realnet_core::{CameraModel, Pose, body_from_optical};

/// How bright a picture is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposure {
    /// A fixed gain; 1 shows a white surface in a well-lit room just below white.
    Fixed {
        /// The gain.
        gain: f64,
    },
    /// The mean of the picture is led to a set value.
    Auto {
        /// Time constant, seconds: how fast the gain follows a change of light.
        lag_s: f64,
        /// Mean linear light aimed at, 0 to 1.
        target: f64,
        /// The largest gain.
        max_gain: f64,
    },
}

/// Blur by motion during the exposure: the mean of several pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionBlur {
    /// How long the shutter is open, seconds.
    pub shutter_s: f64,
    /// Most pictures that are averaged; fewer where nothing moves far.
    pub max_samples: usize,
}

/// From light to bytes. A pixel's light `L` (1: white in a well-lit room) becomes
/// `g (v L + n)` with the gain `g`, the vignetting `v` and noise `n` of variance
/// `shot_noise^2 v L + read_noise^2`, is cut to 0 to 1, and is written as
/// `255 sqrt(.)`, close to the curve of sRGB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Standard deviation of the photon noise at light 1.
    pub shot_noise: f64,
    /// Standard deviation in the dark.
    pub read_noise: f64,
    /// Share of the light lost in the corners of the picture, falling with the square
    /// of the distance from the middle.
    pub vignetting: f64,
    /// Gain.
    pub exposure: Exposure,
    /// Blur, if any.
    pub blur: Option<MotionBlur>,
}

impl Default for Sensor {
    /// A small camera in a room: noise of about 2 grey levels, corners 25 % darker,
    /// automatic exposure, no blur.
    fn default() -> Self {
        Self {
            shot_noise: 0.012,
            read_noise: 0.0015,
            vignetting: 0.25,
            exposure: Exposure::Auto { lag_s: 0.25, target: 0.25, max_gain: 8.0 },
            blur: None,
        }
    }
}

impl Sensor {
    /// Without noise, vignetting or automatic exposure.
    #[must_use]
    pub const fn ideal() -> Self {
        Self {
            shot_noise: 0.0,
            read_noise: 0.0,
            vignetting: 0.0,
            exposure: Exposure::Fixed { gain: 1.0 },
            blur: None,
        }
    }
}

/// A camera on a vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimCamera {
    /// Rays and pixels.
    pub model: CameraModel,
    /// Where the optical frame sits on the vehicle's base frame.
    pub base_from_camera: Pose,
    /// From light to bytes.
    pub sensor: Sensor,
}

impl SimCamera {
    /// A camera 0.30 m before the rear axle and 0.18 m above the ground that looks
    /// straight ahead, with the default sensor.
    #[must_use]
    pub fn new(model: CameraModel) -> Self {
        let base_from_camera = base_from_mount(Vector3::new(0.30, 0.0, 0.18), 0.0, 0.0, 0.0);
        Self { model, base_from_camera, sensor: Sensor::default() }
    }
}

/// The pose of an optical frame on a vehicle: place in the base frame (metres, x
/// forward, y left, z up), yaw to the left, pitch down, roll to the right, radians.
#[must_use]
pub fn base_from_mount(place: Vector3<f64>, yaw: f64, pitch: f64, roll: f64) -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw)
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), roll);
    Pose::new(turn, place) * body_from_optical()
}
