//! The scenarios.

use super::draft::Draft;
use super::{Setup, driving, failing, seeing, traffic};
use realnet_core::CameraError;
use std::fmt;

/// A situation that a follower is tried in.
#[derive(Clone, Copy)]
pub struct Scenario {
    name: &'static str,
    description: &'static str,
    duration_s: f64,
    recipe: fn(&mut Draft),
}

impl fmt::Debug for Scenario {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Scenario").field("name", &self.name).finish_non_exhaustive()
    }
}

const fn new(
    name: &'static str,
    duration_s: f64,
    recipe: fn(&mut Draft),
    description: &'static str,
) -> Scenario {
    Scenario { name, description, duration_s, recipe }
}

/// From easy to hard, by group.
static LIST: [Scenario; 32] = [
    // what the target does
    new("steady", 12.0, driving::steady, "A target drives ahead at about 0.5 m/s."),
    new("curves", 10.0, driving::curves, "It wanders through gentle curves."),
    new("stopped-ahead", 8.0, driving::stopped_ahead, "It is parked a few metres ahead."),
    new("stop-and-go", 12.0, driving::stop_and_go, "It stops and starts again, twice."),
    new("hard-braking", 8.0, driving::hard_braking, "It brakes at 4 m/s^2 from 0.9 m/s."),
    new("slalom", 11.0, driving::slalom, "It drives a slalom."),
    new(
        "tight-turns",
        12.0,
        driving::tight_turns,
        "It turns around on circles of 1.15 m, both ways.",
    ),
    new("figure-eight", 13.0, driving::figure_eight, "It drives a figure eight."),
    new("backwards", 11.0, driving::backwards, "It stops and backs up towards the follower."),
    new("fast", 9.0, driving::fast, "It drives away through curves at 1.2 m/s."),
    new("leaves-view", 12.0, driving::leaves_view, "It turns off, is lost, and comes back."),
    // who follows it
    new("robot", 10.0, driving::robot, "A robot on two wheels follows through curves."),
    new("worn-car", 9.0, driving::worn_car, "Crooked steering, a weak motor, a slippery floor."),
    // who else is there
    new("parked-cars", 8.0, traffic::parked_cars, "The way leads past parked cars."),
    new(
        "crossing-traffic",
        8.0,
        traffic::crossing,
        "Others cross ahead of the target and pass by.",
    ),
    new("cut-in", 11.0, traffic::cut_in, "A car cuts in between, stays, and leaves again."),
    new("occlusion", 10.0, traffic::occlusion, "Cars cross between target and follower."),
    // what the camera sees
    new("low-light", 8.0, seeing::low_light, "It is dusk."),
    new("exposure", 8.0, seeing::exposure, "The light changes at once, down and up."),
    new("blur", 8.0, seeing::blur, "Long exposures blur what moves."),
    new("low-texture", 8.0, seeing::low_texture, "Floor and walls are plain."),
    new("moving-clutter", 8.0, seeing::moving_clutter, "People and balls move about."),
    new("knocked-camera", 8.0, seeing::knocked_camera, "The camera is knocked by 5 degrees."),
    // what fails
    new("no-target", 5.0, failing::no_target, "Nobody is there."),
    new("slow-depth", 9.0, failing::slow_depth, "The depth network takes 1 frame a second."),
    new("depth-lost", 9.0, failing::depth_lost, "No depth maps arrive for 4 s."),
    new("wrong-scale", 9.0, failing::wrong_scale, "All depths are wrong by a third."),
    new("detections-lost", 9.0, failing::detections_lost, "No detections arrive for 2 s."),
    new("poor-detector", 8.0, failing::poor_detector, "Misses, phantoms and boxes that jitter."),
    new("swapped-messages", 8.0, failing::swapped_messages, "Late, lost, doubled, out of order."),
    new(
        "emergency-stop",
        10.0,
        failing::emergency_stop,
        "Somebody asks for a stop, and releases it.",
    ),
    new("blackout", 11.0, failing::blackout, "Frames stop for a second; then the light goes out."),
];

impl Scenario {
    /// All scenarios, by group from easy to hard.
    #[must_use]
    pub fn list() -> &'static [Self] {
        &LIST
    }

    /// The scenario of a name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        LIST.iter().find(|scenario| scenario.name == name)
    }

    /// Its name, in files and on the command line.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        self.name
    }

    /// What happens in it, in a sentence.
    #[must_use]
    pub const fn description(&self) -> &'static str {
        self.description
    }

    /// How long it lasts, s.
    #[must_use]
    pub const fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Draws all that is random in it: the same seed, the same run.
    ///
    /// # Errors
    /// [`CameraError`] if its camera cannot be built.
    pub fn instantiate(&self, seed: u64) -> Result<Setup, CameraError> {
        let mut draft = Draft::new(self, seed)?;
        (self.recipe)(&mut draft);
        Ok(draft.finish())
    }
}
