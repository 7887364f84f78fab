//! The corners of one body, followed from the depth map's frame to the present.

use crate::motion::shift::ShiftSearch;
use crate::motion::{BodyMotion, MotionError, MotionFailure, MotionOptions, Start};
use realnet_core::nalgebra::{Point3, UnitQuaternion, Vector6};
use realnet_core::{CameraModel, Pose, Stamp};
use realnet_pose::{Correspondences, PnpError, PnpSolver, RansacOptions};
use realnet_vision::{FlowError, FlowOptions, LucasKanade, Pyramid, Track, TrackStatus};

/// Corners below which no motion is looked for: those of the smallest problem
/// that the solver accepts, without and with a rotation to go by.
const LEAST_CORNERS: usize = 6;
const LEAST_HELD: usize = 4;

/// The threshold that is tried first, as a share of the full one: slow movers among
/// the background are outliers to it. The full one is for noisy depth maps.
const FINE: f64 = 1.0 / 3.0;
/// Samples drawn for it, at most.
const FINE_SAMPLES: usize = 500;
/// The last rate predicts for so long, seconds, or for twice the step it was measured
/// over. After a longer gap the body may have stopped, and where texture repeats a
/// wrong prediction finds the wrong repetition.
const HORIZON: f64 = 0.2;

/// The highest level of flow from a predicted place.
const NEAR_LEVEL: usize = 1;
/// Share of the corners that must agree with a motion found so; fewer of them are no
/// reason to fail, but to look again on all levels.
const NEAR_SHARE: f64 = 0.6;
/// Share of the corners found so below which the prediction is given up.
const HOPE: f64 = 0.2;
/// Most steps of flow a level from a predicted place.
const NEAR_STEPS: u32 = 10;

/// One rigid body.
#[derive(Clone, Debug)]
pub(super) struct Body {
    name: &'static str,
    seed: u64,
    pixels: Vec<[f32; 2]>,
    points: Vec<Point3<f64>>,
    initial: Vec<[f32; 2]>,
    tracks: Vec<Track>,
    /// Points found and their rays, and the place of each among all.
    found: Vec<Point3<f64>>,
    rays: Vec<[f64; 2]>,
    places: Vec<usize>,
    inliers: Vec<bool>,
    fine: PnpSolver,
    solver: PnpSolver,
    held: Option<Held>,
    past: Past,
}

/// The last motion, and how fast it changes.
#[derive(Clone, Copy, Debug)]
struct Past {
    now_from_then: Pose,
    stamp: Stamp,
    /// Twist a second of `now_from_then`, from the left: in the camera's frame.
    rate: Vector6<f64>,
    /// Seconds over which it was measured.
    step: f64,
}

impl Past {
    /// At rest.
    fn new(stamp: Stamp) -> Self {
        Self { now_from_then: Pose::identity(), stamp, rate: Vector6::zeros(), step: 0.0 }
    }

    /// The motion carried on to a frame `seconds` later, if that can be said.
    fn predicted(&self, seconds: f64) -> Option<Pose> {
        let rests = self.rate == Vector6::zeros();
        let fresh = rests || seconds <= HORIZON.max(2.0 * self.step);
        fresh.then(|| Pose::exp(&(self.rate * seconds)) * self.now_from_then)
    }
}

/// How corners are looked for.
#[derive(Clone, Debug)]
pub(super) struct Flows {
    /// On the lower levels alone, at half the cost: when they are where predicted.
    near: LucasKanade,
    /// On all levels.
    far: LucasKanade,
}

impl Flows {
    pub(super) fn new(options: FlowOptions) -> Result<Self, FlowError> {
        let max_level = options.max_level.min(NEAR_LEVEL);
        let max_iterations = options.max_iterations.min(NEAR_STEPS);
        let near = LucasKanade::new(FlowOptions { max_level, max_iterations, ..options })?;
        Ok(Self { near, far: LucasKanade::new(options)? })
    }

    pub(super) fn pyramid(&self) -> Pyramid {
        self.far.pyramid()
    }
}

/// The pictures that flow runs between.
pub(super) struct Pictures<'a> {
    pub(super) then: &'a Pyramid,
    pub(super) now: &'a Pyramid,
    pub(super) camera: &'a CameraModel,
}

/// A rotation to go by where the corners give none.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    pub(super) rotation: UnitQuaternion<f64>,
    /// Standard deviation about any axis, radians.
    pub(super) std: f64,
}

impl Body {
    pub(super) fn new(
        name: &'static str,
        options: &MotionOptions,
        capacity: usize,
    ) -> Result<Self, MotionError> {
        let fine = RansacOptions {
            threshold_px: FINE * options.ransac.threshold_px,
            max_iterations: options.ransac.max_iterations.min(FINE_SAMPLES),
            ..options.ransac
        };
        Ok(Self {
            name,
            fine: PnpSolver::with_capacity(fine, capacity)?,
            seed: options.seed,
            pixels: Vec::with_capacity(capacity),
            points: Vec::with_capacity(capacity),
            initial: Vec::with_capacity(capacity),
            tracks: Vec::with_capacity(capacity),
            found: Vec::with_capacity(capacity),
            rays: Vec::with_capacity(capacity),
            places: Vec::with_capacity(capacity),
            inliers: Vec::with_capacity(capacity),
            solver: PnpSolver::with_capacity(options.ransac, capacity)?,
            held: None,
            past: Past::new(Stamp::ZERO),
        })
    }

    pub(super) fn clear(&mut self) {
        self.pixels.clear();
        self.points.clear();
        self.tracks.clear();
        self.inliers.clear();
    }

    pub(super) fn add(&mut self, pixel: [f32; 2], point: Point3<f64>) {
        self.pixels.push(pixel);
        self.points.push(point);
    }

    pub(super) fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Corners on the depth map's frame, where the flow took them, and whether
    /// they agree with the motion. Empty before the first estimate.
    pub(super) fn tracks(&self) -> impl Iterator<Item = ([f32; 2], &Track, bool)> {
        let inliers = self.inliers.iter().copied().chain(std::iter::repeat(false));
        self.pixels.iter().zip(&self.tracks).zip(inliers).map(|((p, t), i)| (*p, t, i))
    }

    /// The points of the corners in then's optical frame.
    pub(super) fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// The last motion, to a frame of `stamp` if it is of that time.
    pub(super) fn motion_at(&self, stamp: Stamp) -> Option<Pose> {
        (self.past.stamp == stamp).then_some(self.past.now_from_then)
    }

    /// A new frame becomes `then`, `kept` away from the old one.
    pub(super) fn rebase(&mut self, kept_from_then: Option<Pose>, stamp: Stamp) {
        match kept_from_then {
            Some(kept_from_then) if self.past.stamp >= stamp => {
                self.past.now_from_then = self.past.now_from_then * kept_from_then.inverse();
            }
            _ => {
                self.past.now_from_then = Pose::identity();
                self.past.stamp = stamp;
            }
        }
    }

    /// Forgets how it moved: the next body of this name is another one.
    pub(super) fn forget(&mut self, stamp: Stamp) {
        self.past = Past::new(stamp);
    }

    /// The motion from then to now: a rigid one, or where there is none and a
    /// rotation is `held`, a translation under that rotation.
    pub(super) fn estimate(
        &mut self,
        pictures: &Pictures<'_>,
        flows: &mut Flows,
        search: &mut ShiftSearch,
        held: Option<Held>,
    ) -> Result<BodyMotion, MotionFailure> {
        self.inliers.clear();
        self.held = held;
        let needed = if held.is_some() { LEAST_HELD } else { LEAST_CORNERS };
        if self.len() < needed {
            self.tracks.clear();
            let (body, found) = (self.name, self.len());
            return Err(MotionFailure::Corners { body, found, needed });
        }
        let seconds = pictures.now.stamp().seconds_since(self.past.stamp);
        let last = self.past.now_from_then;
        let predicted = self.past.predicted(seconds);
        let Flows { near, far } = flows;
        let many = NEAR_SHARE * self.len() as f64;
        // The reason that is given is the last attempt's, as are the tracks.
        let mut answer = match &predicted {
            Some(predicted) => {
                let close = self.attempt(pictures, near, Start::Predicted, predicted);
                let found = self.places.len() as f64 / self.len() as f64;
                match close {
                    Ok(motion) if motion.estimate.inliers as f64 >= many => Ok(motion),
                    // Where next to nothing is found the prediction is to blame.
                    Err(_) if found < HOPE && *predicted != last => {
                        self.attempt(pictures, far, Start::Last, &last)
                    }
                    _ => self.attempt(pictures, far, Start::Predicted, predicted),
                }
            }
            None => self.attempt(pictures, far, Start::Last, &last),
        };
        if answer.is_err() {
            let shift = search.run(pictures.then, pictures.now, &self.pixels);
            if let Some(shift) = shift {
                self.initial.clear();
                let moved = self.pixels.iter().map(|p| [p[0] + shift[0], p[1] + shift[1]]);
                self.initial.extend(moved);
                answer = self.follow(pictures, far, Start::Search, &last);
            }
        }
        if let Ok(motion) = &answer {
            self.remember(motion.now_from_then(), pictures.now.stamp());
        }
        answer
    }

    fn remember(&mut self, now_from_then: Pose, stamp: Stamp) {
        let seconds = stamp.seconds_since(self.past.stamp);
        if seconds > 0.0 {
            let step = now_from_then * self.past.now_from_then.inverse();
            self.past.rate = step.log() / seconds;
            self.past.step = seconds;
        }
        self.past.now_from_then = now_from_then;
        self.past.stamp = stamp;
    }

    /// Flow from where the pose `start` puts the points.
    fn attempt(
        &mut self,
        pictures: &Pictures<'_>,
        flow: &mut LucasKanade,
        name: Start,
        start: &Pose,
    ) -> Result<BodyMotion, MotionFailure> {
        self.initial.clear();
        let camera = pictures.camera;
        self.initial.extend(self.points.iter().zip(&self.pixels).map(|(point, pixel)| {
            match camera.project(&(*start * *point)) {
                Ok(place) => place.map(|v| v as f32),
                Err(_) => *pixel,
            }
        }));
        self.follow(pictures, flow, name, start)
    }

    /// Flow from `self.initial`, and the motion it gives.
    fn follow(
        &mut self,
        pictures: &Pictures<'_>,
        flow: &mut LucasKanade,
        start: Start,
        near: &Pose,
    ) -> Result<BodyMotion, MotionFailure> {
        let body = self.name;
        self.inliers.clear();
        let initial = Some(self.initial.as_slice());
        let flowed =
            flow.track(pictures.then, pictures.now, &self.pixels, initial, &mut self.tracks);
        if let Err(FlowError::NoPicture) = flowed {
            return Err(MotionFailure::NoDepth);
        }
        self.found.clear();
        self.rays.clear();
        self.places.clear();
        let camera = pictures.camera;
        for (place, (track, point)) in self.tracks.iter().zip(&self.points).enumerate() {
            let pixel = track.point.map(f64::from);
            if track.is_tracked()
                && camera.contains(pixel)
                && let Ok(ray) = camera.unproject(pixel)
            {
                self.found.push(*point);
                self.rays.push(ray);
                self.places.push(place);
            }
        }
        let (tracked, corners) = (self.found.len(), self.len());
        if tracked < if self.held.is_some() { LEAST_HELD } else { LEAST_CORNERS } {
            let count = |status| self.tracks.iter().filter(|t| t.status == status).count();
            let (outside, flat) = (count(TrackStatus::Outside), count(TrackStatus::Flat));
            let lost = corners - tracked - outside - flat;
            return Err(MotionFailure::Lost { body, tracked, corners, outside, flat, lost });
        }
        let focal = [camera.fx(), camera.fy()];
        let estimate = Correspondences::new(&self.found, &self.rays, focal).and_then(|problem| {
            // A threshold that nearly all of the points meet is wide enough.
            if let Ok(estimate) = self.fine.solve_near(&problem, near, self.seed)
                && 5 * estimate.inliers > 4 * tracked
            {
                return Ok((estimate, true));
            }
            let rigid = self.solver.solve_near(&problem, near, self.seed);
            let estimate = match (rigid, self.held) {
                (Err(reason), Some(Held { rotation, std })) => self
                    .solver
                    .solve_translation(&problem, &rotation, std, self.seed)
                    .map_err(|_| reason),
                (rigid, _) => rigid,
            };
            estimate.map(|estimate| (estimate, false))
        });
        let (estimate, fine) =
            estimate.map_err(|reason: PnpError| MotionFailure::Pose { body, tracked, reason })?;
        self.inliers.resize(corners, false);
        let inliers = if fine { self.fine.inliers() } else { self.solver.inliers() };
        for (&place, &inlier) in self.places.iter().zip(inliers) {
            if let Some(entry) = self.inliers.get_mut(place) {
                *entry = inlier;
            }
        }
        Ok(BodyMotion { estimate, corners, tracked, start })
    }
}
