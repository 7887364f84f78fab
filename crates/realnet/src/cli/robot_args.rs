//! The robot: where its camera sits, what it can do, what it is asked to do.

use super::camera_args::{parse_camera_forward, parse_camera_height, parse_camera_pitch};
use super::model_args::parse_positive;
use clap::Args;
use realnet::control::{ControlOptions, Drive, VehicleOptions};
use realnet::cues::Uncertain;
use realnet::pipeline::{CameraMount, FollowerOptions};

#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Robot [default: a 1:10 car]")]
pub(crate) struct RobotArgs {
    /// The camera above the ground, metres: ranges by the target's foot on the ground
    /// [default: unknown, no such ranges].
    #[arg(long, value_name = "M", value_parser = parse_camera_height)]
    camera_height: Option<f64>,
    /// How far it looks down, degrees.
    #[arg(long, value_name = "DEGREES", default_value = "0", allow_hyphen_values = true,
        value_parser = parse_camera_pitch)]
    camera_pitch: f64,
    /// The camera ahead of the rear axle, metres.
    #[arg(long, value_name = "M", default_value = "0.25", allow_negative_numbers = true,
        value_parser = parse_camera_forward)]
    camera_forward: f64,
    /// Height of the target, metres: ranges by its size [default: unknown, no such ranges].
    #[arg(long, value_name = "M", value_parser = parse_positive)]
    target_height: Option<f64>,
    /// Free space to keep behind the target, metres.
    #[arg(long, value_name = "M", default_value_t = 1.0, value_parser = parse_positive)]
    gap: f64,
    /// Greatest speed, m/s.
    #[arg(long, value_name = "M/S", default_value_t = 2.0, value_parser = parse_positive)]
    max_speed: f64,
    /// From axle to axle, metres.
    #[arg(long, value_name = "M", default_value_t = 0.26, value_parser = parse_positive)]
    wheelbase: f64,
    /// Greatest steering angle, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 24.0, value_parser = parse_positive)]
    max_steering: f64,
}

/// Standard deviation of a height that somebody measured, as a share.
const TARGET_HEIGHT_STD: f64 = 0.05;

impl RobotArgs {
    /// What the follower is told.
    pub(crate) fn follower(&self) -> FollowerOptions {
        let mut options = FollowerOptions::default();
        options.mount = CameraMount {
            forward_m: self.camera_forward,
            pitch_rad: self.camera_pitch,
            height_m: self.camera_height.unwrap_or(options.mount.height_m),
            ..options.mount
        };
        options.ranging.ground_range = self.camera_height.is_some();
        let height = |metres: f64| Uncertain::new(metres, TARGET_HEIGHT_STD * metres);
        options.ranging.target_height_m = self.target_height.map(height);
        options.control = self.control();
        options
    }

    fn control(&self) -> ControlOptions {
        let mut control = ControlOptions::default();
        control.vehicle = VehicleOptions {
            drive: Drive::Ackermann {
                wheelbase_m: self.wheelbase,
                max_steering_rad: self.max_steering.to_radians(),
                max_steering_rate_rad_s: 4.0,
            },
            max_speed_m_s: self.max_speed,
            ..control.vehicle
        };
        control.speed.gap_m = self.gap;
        control
    }
}
