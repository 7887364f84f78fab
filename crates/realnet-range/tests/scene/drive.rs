//! A drive of some frames, to be timed.

use super::{Scene, sized};
use realnet_core::nalgebra::{Vector3, Vector6};
use realnet_core::{CameraModel, DepthMap, Frame, Pose, Stamp};
use realnet_range::cues::ForegroundGate;
use realnet_range::motion::{MotionOptions, MotionTracker};

/// Frames between two depth maps.
const FRAMES: i64 = 9;

/// A camera at half a metre a second behind a target that drives away.
pub struct Drive {
    pub camera: CameraModel,
    pub frames: Vec<Frame>,
    pub depth: DepthMap,
    pub gate: ForegroundGate,
}

impl Drive {
    pub fn new((width, height): (u32, u32)) -> Self {
        let camera = sized(width, height);
        let scene = Scene::new(camera);
        let camera_from_world =
            |t: f64| Pose::exp(&(Vector6::new(0.05, 0.0, 0.5, 0.01, 0.1, 0.0) * t)).inverse();
        let camera_from_target = |t: f64| {
            camera_from_world(t) * Pose::from_translation(Vector3::new(-0.1, 0.1, 2.0 + 0.6 * t))
        };
        let draw = |index: i64| {
            let t = index as f64 / 30.0;
            let stamp = Stamp::from_nanos(index * 33_333_333);
            scene.draw(stamp, &camera_from_world(t), &camera_from_target(t))
        };
        let depth = draw(0).1;
        let frames = (0..=FRAMES).map(|index| draw(index).0.to_rgb()).collect();
        Self { camera, frames, depth, gate: scene.gate(&camera_from_target(0.0)) }
    }

    /// A tracker that was given the depth of the first frame.
    pub fn keyed(&self) -> MotionTracker {
        let mut tracker = MotionTracker::new(&self.camera, MotionOptions::default()).unwrap();
        tracker.push(&self.frames[0]).unwrap();
        tracker.keep();
        let summary = tracker.set_depth(&self.depth, Some(&self.gate)).unwrap();
        assert!(summary.background + summary.target >= 120, "{summary:?}");
        tracker
    }

    /// Frames round and round.
    pub fn lap(&self) -> Lap<'_> {
        let start = self.keyed();
        Lap { drive: self, tracker: start.clone(), start, next: 1 }
    }
}

/// A tracker that goes through the frames; after the last it is as at the start.
pub struct Lap<'a> {
    drive: &'a Drive,
    start: MotionTracker,
    pub tracker: MotionTracker,
    next: usize,
}

impl Lap<'_> {
    /// The tracker takes the next frame.
    pub fn push(&mut self) {
        if self.next > FRAMES as usize {
            self.tracker.clone_from(&self.start);
            self.next = 1;
        }
        self.tracker.push(&self.drive.frames[self.next]).unwrap();
        self.next += 1;
    }
}
