//! Everything that a run needs to be told.

use super::Expectations;
use crate::dynamics::VehicleDynamics;
use crate::perception::{DepthNetworkModel, DetectorModel, Window};
use crate::scene::SceneSpec;
use crate::traffic::ScriptedVehicle;
use crate::{VehicleKind, VehicleState};
use realnet_control::ControlOptions;
use realnet_core::{CameraModel, Pose2};
use realnet_pipeline::CameraMount;

/// The follower's camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSetup {
    /// Lens and picture.
    pub model: CameraModel,
    /// Where it sits, as the follower knows it.
    pub mount: CameraMount,
    /// By how much it really looks further down than the follower knows, radians.
    pub pitch_error_rad: f64,
    /// By how much it really sits higher than the follower knows, metres.
    pub height_error_m: f64,
    /// Frames a second.
    pub rate_hz: f64,
    /// From the exposure of a frame until the follower has it, s.
    pub latency_s: f64,
    /// How long each frame is exposed, s: what makes motion blur.
    pub exposure_s: f64,
    /// Deviation of the noise of a pixel, grey levels of 255.
    pub noise: f64,
    /// When it is knocked out of its place, which the follower is not told.
    pub knocks: Vec<Knock>,
    /// When no frames arrive.
    pub outages: Vec<Window<()>>,
}

/// A camera is knocked: from a time on its body looks elsewhere. Several add up.
/// Angles are about the camera body's axes, in the order yaw, pitch, roll, radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Knock {
    /// When, s.
    pub time_s: f64,
    /// About x, which looks ahead; positive: its left side goes up.
    pub roll: f64,
    /// About y, which looks to the left; positive: nose down.
    pub pitch: f64,
    /// About z, which looks up; positive: to the left.
    pub yaw: f64,
}

/// The vehicle that follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowerSetup {
    /// What it is.
    pub kind: VehicleKind,
    /// How it really answers to commands; the follower is told what is usual for its
    /// kind, see [`Setup::control`].
    pub dynamics: VehicleDynamics,
    /// Where it stands at the start.
    pub start: VehicleState,
}

/// A run: a scenario with all that is random in it drawn.
///
/// Times are seconds since the start, which is stamp 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Name of the scenario.
    pub name: &'static str,
    /// What happens in it, in a sentence.
    pub description: &'static str,
    /// The seed that it was drawn with; models and scene are to draw from it too.
    pub seed: u64,
    /// How long it lasts, s.
    pub duration_s: f64,
    /// The world.
    pub scene: SceneSpec,
    /// The follower's camera.
    pub camera: CameraSetup,
    /// The follower.
    pub follower: FollowerSetup,
    /// Whom it is to follow; `None`: nobody is there.
    pub target: Option<ScriptedVehicle>,
    /// Other vehicles. A detector sees them as it sees the target.
    pub others: Vec<ScriptedVehicle>,
    /// The detector.
    pub detector: DetectorModel,
    /// The depth network.
    pub depth: DepthNetworkModel,
    /// The options of the follower's control: the vehicle as it is usual for its
    /// kind, the gap to keep.
    pub control: ControlOptions,
    /// From when until when a person asks for a stop.
    pub stop_requests: Vec<Window<()>>,
    /// When the run has passed.
    pub expectations: Expectations,
}

impl Setup {
    /// The gap that is to be kept, metres.
    #[must_use]
    pub const fn desired_gap_m(&self) -> f64 {
        self.control.speed.gap_m
    }

    /// How many frames the camera takes: at the start, and from then on at its rate.
    #[must_use]
    pub fn frames(&self) -> u64 {
        (self.duration_s * self.camera.rate_hz).floor() as u64 + 1
    }

    /// How the camera is turned against its mount at a time: roll, pitch and yaw as
    /// of a [`Knock`].
    #[must_use]
    pub fn camera_turn(&self, time_s: f64) -> [f64; 3] {
        let knocks = self.camera.knocks.iter().filter(|knock| knock.time_s <= time_s);
        knocks.fold([0.0; 3], |[roll, pitch, yaw], knock| {
            [roll + knock.roll, pitch + knock.pitch, yaw + knock.yaw]
        })
    }

    /// Whether a person asks for a stop at a time.
    #[must_use]
    pub fn stop_is_requested(&self, time_s: f64) -> bool {
        self.stop_requests.iter().any(|window| (window.from_s..window.until_s).contains(&time_s))
    }

    /// Whether the frame of a time arrives.
    #[must_use]
    pub fn frame_arrives(&self, time_s: f64) -> bool {
        !self.camera.outages.iter().any(|w| (w.from_s..w.until_s).contains(&time_s))
    }

    /// Distance of the follower's rear axle from the target's path, metres, positive:
    /// the follower is left of it. Not a number without a target.
    #[must_use]
    pub fn lateral_m(&self, time_s: f64, follower: &Pose2) -> f64 {
        let Some(target) = &self.target else { return f64::NAN };
        // The part of the path that the follower can be at: behind the target.
        let place = target.place(time_s);
        let (_, furthest) = target.profile.reach(time_s);
        let behind = self.desired_gap_m() + 2.5;
        let ahead = target.start + furthest;
        target.route.lateral(&follower.position(), place - behind, ahead).0
    }
}
