//! Metres to the target: the depth map's when one comes, the fast path's between.

use crate::odometry::CameraMount;
use crate::sight::TargetBox;
use crate::step::{BackgroundStep, Steps};
use realnet_core::nalgebra::{Point3, UnitQuaternion, Vector6};
use realnet_core::{BoundingBox, CameraModel, DepthMap, Frame, Stamp};
use realnet_range::cues::{
    BoxDepth, DepthInBox, DepthInBoxError, DepthInBoxOptions, DepthNoise, GroundFit,
    GroundFitOptions, GroundPlane, GroundPrior, GroundRange, OptionError, PeakRule, PitchFilter,
    PitchFilterOptions, PitchMeasurement, SigmaRule, SizeRange, Uncertain, pitch_from_translation,
};
use realnet_range::motion::{BodyMotion, MotionError, MotionOptions, MotionTracker};
use realnet_vision::Pyramid;
use thiserror::Error;

/// How far the axle heaves between a depth map's frame and the present one, metres.
const HEAVE_STD_M: f64 = 0.002;
/// Own noise of a depth in the box, as a share: what is left of the pixels' noise.
const MAP_STD: f64 = 0.005;
/// A rotation about the lateral axis from one frame to the next that is a knock, radians.
const KNOCK_RAD: f64 = 0.015;
/// How far the bend of a depth map tilts the ground in it, radians.
const GROUND_BEND_RAD: f64 = 0.008;
/// How far it tilts the direction of a way that is measured from it, radians: a few
/// corners on patches that err differently, over a way of a hand's breadth.
const WAY_BEND_RAD: f64 = 0.04;
/// The ground in a map is looked for within three of these of the pitch known so far,
/// radians; and if it is not there, for a knock that went unseen, of the second.
const GROUND_SEARCH_RAD: [f64; 2] = [0.02, 0.05];
/// A box must not reach within this of the picture's edge for its height to be known.
const BORDER_PX: f32 = 2.0;

/// How ranges are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangingOptions {
    /// The camera's and the target's motion since the depth map.
    pub motion: MotionOptions,
    /// The depth of the target in its box.
    pub depth_in_box: DepthInBoxOptions,
    /// Standard deviation of the depth network's scale from map to map, as a share.
    pub map_std: f64,
    /// Standard deviation of the mount's pitch, radians.
    pub pitch_std_rad: f64,
    /// Whether the target's foot on the ground is a range of its own.
    pub ground_range: bool,
    /// Height of the target, metres, where it is known: a range of its own.
    pub target_height_m: Option<Uncertain>,
    /// How far behind the target's seen surface its foot stands, metres: the overhang of
    /// a car over its rear wheels.
    pub foot_behind_m: f64,
    /// Half the way between its left and right foot, metres: of a target that is turned
    /// aside one stands nearer than the other.
    pub foot_aside_m: f64,
}

impl Default for RangingOptions {
    fn default() -> Self {
        Self {
            motion: MotionOptions::default(),
            depth_in_box: DepthInBoxOptions::default(),
            map_std: 0.1,
            pitch_std_rad: 0.01,
            ground_range: true,
            target_height_m: None,
            foot_behind_m: 0.08,
            foot_aside_m: 0.08,
        }
    }
}

/// Why ranging cannot start.
#[derive(Debug, Error)]
pub enum RangingError {
    /// An option of the fast path.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// An option of a cue.
    #[error(transparent)]
    Option(#[from] OptionError),
}

/// A place of the target in the robot's base frame, seen in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenRange {
    /// The frame.
    pub stamp: Stamp,
    /// Depth along the optical axis, metres.
    pub depth_m: f64,
    /// Metres ahead of the camera, in the plane.
    pub forward_m: f64,
    /// Standard deviation of either as a share, without what is common to all ranges
    /// of one source.
    pub std_share: f64,
}

/// The map that fast ranges start from.
#[derive(Clone, Copy, Debug)]
struct Key {
    stamp: Stamp,
    /// The target's middle on the map's frame, optical frame, metres, as the network
    /// gives it.
    point: Point3<f64>,
    bbox: BoundingBox,
    whole: bool,
}

/// Turns frames, boxes and depth maps into ranges.
pub struct Ranging {
    options: RangingOptions,
    camera: CameraModel,
    mount: CameraMount,
    tracker: MotionTracker,
    depth_in_box: DepthInBox,
    ground_fit: GroundFit,
    pitch: PitchFilter,
    steps: Steps,
    key: Option<Key>,
}

impl Ranging {
    /// Before the first frame.
    ///
    /// # Errors
    /// [`RangingError`] for options out of range.
    pub fn new(
        camera: &CameraModel,
        mount: &CameraMount,
        options: RangingOptions,
    ) -> Result<Self, RangingError> {
        let pitch = Uncertain::new(mount.pitch_rad, options.pitch_std_rad);
        let filter = PitchFilterOptions {
            process_std: 0.002,
            floor_std_rad: 0.003,
            ..PitchFilterOptions::default()
        };
        let motion = MotionOptions { scale_std: options.map_std, ..options.motion };
        Ok(Self {
            options,
            camera: *camera,
            mount: *mount,
            tracker: MotionTracker::new(camera, motion)?,
            depth_in_box: DepthInBox::new(options.depth_in_box)?,
            ground_fit: GroundFit::new(GroundFitOptions::default())?,
            pitch: PitchFilter::new(pitch, filter)?,
            steps: Steps::default(),
            key: None,
        })
    }

    /// Takes a frame and finds the motion since the depth map's. Answers with that of the
    /// background since the last frame.
    ///
    /// # Errors
    /// [`MotionError`] for a frame of another size or out of order; it is left out.
    pub fn frame(&mut self, frame: &Frame) -> Result<Option<BackgroundStep>, MotionError> {
        self.tracker.push(frame)?;
        let step = self.steps.next(self.tracker.estimate());
        if let Some(step) = &step {
            self.nod(step);
        }
        Ok(step)
    }

    /// Forgets all frames and maps, for those of another time. What is known of the pitch
    /// stays.
    ///
    /// # Errors
    /// None that [`Ranging::new`] did not give for the same options.
    pub fn restart(&mut self) -> Result<(), MotionError> {
        let motion = MotionOptions { scale_std: self.options.map_std, ..self.options.motion };
        self.tracker = MotionTracker::new(&self.camera, motion)?;
        (self.steps, self.key) = (Steps::default(), None);
        Ok(())
    }

    /// The present frame goes to the depth network.
    pub fn keep(&mut self) {
        self.tracker.keep();
        self.steps.keep(self.tracker.motion());
    }

    /// The present frame.
    #[must_use]
    pub fn picture(&self) -> &Pyramid {
        self.tracker.picture()
    }

    /// Pitch of the camera against the ground, radians, positive: nose down.
    #[must_use]
    pub fn pitch_rad(&self) -> Uncertain {
        self.pitch.pitch_rad()
    }

    /// Takes a depth map; `at` is the target's box on its frame, `expected` its range
    /// there as far as known, with deviation, metres. Answers with the range as the
    /// network gives it.
    ///
    /// # Errors
    /// Beside the range: [`MotionError::NotKept`] for a map of another frame than the one
    /// kept. It is then not the start of fast ranges.
    pub fn depth(
        &mut self,
        map: &DepthMap,
        at: Option<TargetBox>,
        expected: Option<(f64, f64)>,
    ) -> (Option<SeenRange>, Result<(), MotionError>) {
        let (sx, sy) = (
            map.width() as f32 / self.camera.width() as f32,
            map.height() as f32 / self.camera.height() as f32,
        );
        let scaled = at.map(|at| at.bbox.scaled(sx, sy));
        let found = scaled.and_then(|bbox| self.in_box(map, bbox, expected).ok());
        let gate = found.and_then(|_| self.depth_in_box.foreground(&SigmaRule::default()).ok());
        let expected_map = self.tracker.kept() == Some(map.stamp());
        if expected_map {
            self.level_by_way();
        }
        let kept = self.tracker.set_depth(map, gate.map(|foreground| foreground.gate).as_ref());
        let point = found.zip(at).and_then(|(found, at)| self.lift(&at.bbox, found.depth_m));
        if kept.is_ok() {
            self.steps.rebase();
            self.level_by(map, scaled);
            self.key = point.zip(at).map(|(point, at)| Key {
                stamp: map.stamp(),
                point,
                bbox: at.bbox,
                whole: self.is_whole(&at.bbox),
            });
        }
        let seen = point.map(|point| self.seen(map.stamp(), point, MAP_STD));
        (seen, kept.map(|_| ()))
    }

    fn in_box(
        &mut self,
        map: &DepthMap,
        bbox: BoundingBox,
        expected: Option<(f64, f64)>,
    ) -> Result<BoxDepth, DepthInBoxError> {
        let peak = match expected {
            // Networks err in scale: a third more or less is no surprise.
            Some((depth_m, std_m)) if depth_m > 0.0 && std_m.is_finite() => {
                PeakRule::Expected { depth_m, std_m: std_m.hypot(0.3 * depth_m) }
            }
            _ => PeakRule::Highest,
        };
        self.depth_in_box.set_peak(peak)?;
        self.depth_in_box.measure(map, bbox, DepthNoise::NONE)
    }

    /// Corrects the pitch by the ground in a map.
    fn level_by(&mut self, map: &DepthMap, target: Option<BoundingBox>) {
        if let Some(plane) = self.fit_ground(map, target) {
            self.correct_pitch(plane.measurement(), GROUND_BEND_RAD);
        }
    }

    /// Corrects the pitch by the direction in which the camera went since the last map.
    /// Once a map: what is measured on the way there errs alike.
    fn level_by_way(&mut self) {
        let Some(body) = self.tracker.motion().and_then(|motion| motion.background.as_ref().ok())
        else {
            return;
        };
        let covariance = body.estimate.covariance;
        let roll = Uncertain::new(0.0, 0.01);
        let moved = pitch_from_translation(&body.now_from_then(), &covariance, roll, HEAVE_STD_M);
        if let Ok(moved) = moved {
            self.correct_pitch(moved, WAY_BEND_RAD);
        }
    }

    /// Depth maps bend: a pitch by one of them has an error that its own deviation does
    /// not know.
    fn correct_pitch(&mut self, measured: PitchMeasurement, bend_rad: f64) {
        let std_rad = measured.std_rad.hypot(bend_rad);
        // Numbers out of range leave the filter as it was.
        let _ = self.pitch.update(&PitchMeasurement { std_rad, ..measured });
    }

    /// Follows knocks: a vehicle on the ground does not pitch by itself, so small rotations
    /// about the lateral axis are noise of the flow, and only a large one moves the camera
    /// against the ground.
    fn nod(&mut self, step: &BackgroundStep) {
        let turn = step.now_from_before.rotation();
        let (turn, std) = if step.is_sure && turn.scaled_axis().x.abs() > KNOCK_RAD {
            (turn, step.rotation_std)
        } else {
            (UnitQuaternion::identity(), 0.0)
        };
        // Numbers out of range leave the filter as it was.
        let _ = self.pitch.predict(&turn, std, step.seconds.max(0.0));
    }

    fn fit_ground(&mut self, map: &DepthMap, target: Option<BoundingBox>) -> Option<GroundPlane> {
        let camera = self.camera.scaled(map.width(), map.height()).ok()?;
        let Uncertain { value, std } = self.pitch.pitch_rad();
        let height_m = self.mount.height_m;
        let mut prior = GroundPrior {
            camera_height_m: Uncertain::new(height_m, height_m * 2.0 * self.options.map_std),
            pitch_rad: Uncertain::new(value, std),
            roll_rad: Uncertain::new(0.0, 0.01),
        };
        let exclude = target.as_slice();
        GROUND_SEARCH_RAD.into_iter().find_map(|search| {
            prior.pitch_rad.std = std.max(search);
            self.ground_fit.fit(map, &camera, exclude, &prior, DepthNoise::new(0.0, 0.02)).ok()
        })
    }

    /// The range in the present frame: the map's, moved by the target's motion, and the
    /// stamp of that map. The map's scale is common to all such ranges of one map; it is
    /// not in [`SeenRange::std_share`].
    #[must_use]
    pub fn fast(&self, present: Option<&TargetBox>) -> Option<(SeenRange, Stamp)> {
        let key = self.key?;
        let motion = self.tracker.motion().filter(|motion| motion.then == key.stamp)?;
        let by_motion = motion.target.as_ref().and_then(|t| t.as_ref().ok()).map(|body| {
            let point = body.now_from_then() * key.point;
            (point, depth_std(body, &point))
        });
        let by_size = || {
            let at = present.filter(|at| key.whole && self.is_whole(&at.bbox))?;
            let ratio = f64::from(key.bbox.height() / at.bbox.height());
            let std = f64::from(at.edge_std / at.bbox.height()) * 2.0;
            let point = self.lift(&at.bbox, key.point.z * ratio)?;
            Some((point, point.z * std.max(0.03)))
        };
        let (point, std_m) = by_motion.filter(|(p, s)| *s < 0.1 * p.z).or_else(by_size)?;
        if !(point.z > 0.0 && point.z.is_finite() && std_m.is_finite()) {
            return None;
        }
        let share = (std_m / point.z).hypot(MAP_STD);
        Some((self.seen(motion.now, point, share), key.stamp))
    }

    /// The range by the target's foot on the ground: where a target is that is turned
    /// `aside` radians from the line of sight.
    #[must_use]
    pub fn ground(&self, at: &TargetBox, aside: f64) -> Option<SeenRange> {
        if !self.options.ground_range {
            return None;
        }
        let height = Uncertain::new(self.mount.height_m, 0.0);
        let pitch = self.pitch.pitch_rad();
        let cue = GroundRange {
            edge_std_px: f64::from(at.edge_std),
            ..GroundRange::new(height, Uncertain::exact(pitch.value))
        };
        let found = cue.measure(&self.camera, at.bbox).ok()?;
        // The rear bumper from the wheel that is nearest; the way there is one along the
        // ground. Seen from ahead the front bumper overhangs alike.
        let behind = self.options.foot_behind_m * aside.cos().abs();
        let nearer = self.options.foot_aside_m * aside.sin().abs();
        let surface = found.foot.coords * (1.0 - (behind - nearer) / found.depth_m);
        let share = found.std_m.hypot(0.3 * nearer) / found.depth_m;
        (surface.z > 0.0).then(|| self.seen(at.stamp, Point3::from(surface), share))
    }

    /// The range by the target's height, where that is known.
    #[must_use]
    pub fn size(&self, at: &TargetBox) -> Option<SeenRange> {
        let cue = SizeRange {
            edge_std_px: f64::from(at.edge_std),
            pitch_rad: self.pitch.pitch_rad().value,
            ..SizeRange::from_height(self.options.target_height_m?)
        };
        let found = cue.measure(&self.camera, at.bbox).ok()?;
        let point = self.lift(&at.bbox, found.depth_m)?;
        Some(self.seen(at.stamp, point, found.edge_m / found.depth_m))
    }

    /// Tangent of the direction to a box, left positive, in the plane, with its
    /// standard deviation.
    #[must_use]
    pub fn direction(&self, at: &TargetBox) -> Option<(f64, f64)> {
        let point = self.lift(&at.bbox, 1.0)?;
        let base = self.level(&point);
        let std = f64::from(at.center_std[0]) / self.camera.fx();
        let tangent = base.y / base.x;
        (base.x > 0.1 && tangent.is_finite()).then_some((tangent, std))
    }

    /// Depth along the optical axis of what lies one metre ahead in the plane, at the
    /// height of a box's middle.
    #[must_use]
    pub fn depth_of_forward(&self, at: Option<&TargetBox>) -> f64 {
        let forward = at.and_then(|at| Some(self.level(&self.lift(&at.bbox, 1.0)?).x));
        forward.filter(|forward| *forward > 0.1).map_or(1.0, f64::recip)
    }

    /// A box that one side of the picture cuts, with the width that its height promises;
    /// `aspect` is width over height. Boxes in the picture are as they were; `None` for
    /// one that cannot be completed.
    #[must_use]
    pub fn completed(&self, at: &TargetBox, aspect: Option<f32>) -> Option<TargetBox> {
        let BoundingBox { x0, y0, x1, y1 } = at.bbox;
        let last = self.camera.width() as f32 - BORDER_PX;
        let (left, right) = (x0 <= BORDER_PX, x1 >= last);
        if !(left || right) {
            return Some(*at);
        }
        let width = (aspect? * (y1 - y0)).max(x1 - x0);
        let bbox = match (left, right) {
            (true, false) => BoundingBox::new(x1 - width, y0, x1, y1),
            (false, true) => BoundingBox::new(x0, y0, x0 + width, y1),
            _ => return None,
        };
        // Half of what is guessed at is in the middle.
        let guess = 0.15 * width;
        Some(TargetBox {
            bbox,
            center_std: [at.center_std[0].hypot(guess), at.center_std[1]],
            ..*at
        })
    }

    /// Pixels in a row of the camera's pictures.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.camera.width()
    }

    /// Whether no edge of the picture cuts the box.
    #[must_use]
    pub fn is_whole(&self, bbox: &BoundingBox) -> bool {
        let inside =
            |low: f32, high: f32, size: u32| low > BORDER_PX && high < size as f32 - BORDER_PX;
        inside(bbox.x0, bbox.x1, self.camera.width())
            && inside(bbox.y0, bbox.y1, self.camera.height())
    }

    pub(crate) fn lift(&self, bbox: &BoundingBox, depth_m: f64) -> Option<Point3<f64>> {
        let (x, y) = bbox.center();
        let pixel = [f64::from(x) - 0.5, f64::from(y) - 0.5];
        self.camera.unproject_at_depth(pixel, depth_m).ok()
    }

    /// A point of the optical frame in axes of the base frame, from the camera.
    fn level(&self, point: &Point3<f64>) -> Point3<f64> {
        let pitch_rad = self.pitch.pitch_rad().value;
        let at_origin = CameraMount { forward_m: 0.0, left_m: 0.0, height_m: 0.0, pitch_rad };
        at_origin.base_from_optical() * *point
    }

    fn seen(&self, stamp: Stamp, point: Point3<f64>, std_share: f64) -> SeenRange {
        SeenRange { stamp, depth_m: point.z, forward_m: self.level(&point).x, std_share }
    }
}

/// Standard deviation of the depth of a point that moved, metres.
fn depth_std(body: &BodyMotion, point: &Point3<f64>) -> f64 {
    // exp([v; w]) moves p by v + w x p.
    let row = Vector6::new(0.0, 0.0, 1.0, point.y, -point.x, 0.0);
    (body.estimate.covariance * row).dot(&row).max(0.0).sqrt()
}
