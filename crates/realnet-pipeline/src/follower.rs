//! All stages together: what a live robot and a replay both run.

use crate::choice::{Expectation, prominence};
use crate::odometry::{CameraMount, OwnOdometry};
use crate::ranging::{Ranging, RangingError, RangingOptions, SeenRange};
use crate::sight::{Sight, SightOptions, TargetBox};
use realnet_control::{ControlInput, ControlOptions, Controller, OptionError, ViewLimit};
use realnet_core::nalgebra::{Vector2, Vector3};
use realnet_core::{
    CameraModel, DepthMap, Detection, DriveCommand, Frame, Pose2, Stamp, TargetState, TrackStatus,
};
use realnet_fusion::{
    DirectionSource, LateError, RangeSource, Reading, TargetFilter, TargetMeasurement,
    TargetOptions,
};
use realnet_range::carry::CarryError;
use realnet_range::cues::Uncertain;
use realnet_range::motion::MotionError;
use thiserror::Error;

/// How far back the target's path is given to the controller, seconds.
const TRAIL_S: f64 = 6.0;
/// Share of the difference between seen and promised speed that is believed in a frame:
/// two thirds of a second at 30 frames a second, two depth maps.
const SPEED_GAIN: f64 = 0.05;
/// Above this speed a target looks the way it drives, m/s.
const HEADING_SPEED: f64 = 0.2;
/// Share of a whole box in what is known about their shape.
const ASPECT_GAIN: f32 = 0.1;

/// A frame is of another time when it is so much later than the last one, or so much
/// earlier, seconds: no pause of the camera, and no message that was overtaken.
const JUMP_AHEAD_S: f64 = 60.0;
const JUMP_BACK_S: f64 = 1.0;

/// Everything that can be set.
#[derive(Clone, Debug, PartialEq)]
pub struct FollowerOptions {
    /// Where the camera sits.
    pub mount: CameraMount,
    /// Classes of the detector that may be the target; empty: all.
    pub classes: Vec<u32>,
    /// How the box is held.
    pub sight: SightOptions,
    /// How ranges are found.
    pub ranging: RangingOptions,
    /// How they are fused.
    pub fusion: TargetOptions,
    /// How the robot is driven.
    pub control: ControlOptions,
    /// Whether bends are cut where the camera would lose the target otherwise: sets
    /// [`PursuitOptions::view`](realnet_control::PursuitOptions::view).
    pub keep_in_view: bool,
}

impl Default for FollowerOptions {
    fn default() -> Self {
        Self {
            mount: CameraMount::default(),
            classes: Vec::new(),
            sight: SightOptions::default(),
            ranging: RangingOptions::default(),
            fusion: TargetOptions::default(),
            control: ControlOptions::default(),
            keep_in_view: true,
        }
    }
}

/// Why a follower cannot start.
#[derive(Debug, Error)]
pub enum FollowerError {
    /// An option of the box's carrying.
    #[error(transparent)]
    Sight(#[from] CarryError),
    /// An option of ranging.
    #[error(transparent)]
    Ranging(#[from] RangingError),
    /// An option of the fusion.
    #[error(transparent)]
    Fusion(OptionError),
    /// An option of the control.
    #[error(transparent)]
    Control(OptionError),
}

/// What is known when a frame was taken.
#[derive(Clone, Copy, Debug)]
pub struct FrameReport {
    /// Exposure time of the frame.
    pub stamp: Stamp,
    /// The target's box in it.
    pub target: Option<TargetBox>,
    /// Depth of the newest network map that came, held, metres along the optical axis.
    pub network_m: Option<f64>,
    /// The same moved to this frame by flow.
    pub fast_m: Option<f64>,
    /// By the target's foot on the ground.
    pub ground_m: Option<f64>,
    /// By the target's known height.
    pub size_m: Option<f64>,
    /// Pitch of the camera against the ground, radians, positive: nose down.
    pub pitch_rad: f64,
    /// Fused, with its standard deviation, metres along the optical axis.
    pub fused_m: Option<(f64, f64)>,
    /// Middle of the target's box at the fused range, metres in the camera's optical frame
    /// (x right, y down, z forward).
    pub position_m: Option<[f64; 3]>,
    /// Velocity over ground, m/s along the axes of the camera's optical frame.
    pub velocity_m_s: Option<[f64; 3]>,
    /// Tracked, coasting, lost.
    pub status: TrackStatus,
    /// The robot's own place by its odometry.
    pub fixed_from_base: Pose2,
}

/// Follows a target: frames go in at once, detections and depth maps when they are
/// ready, commands come out. No thread, no clock: the caller says what time it is.
///
/// Answers may be late: see [`Sight`] for how late a detection may be. Depth maps may be as
/// late as [`TargetOptions::horizon_s`] to count as a range of their own, and up to 4 s to
/// be where fast ranges start.
///
/// A frame whose stamp is more than 60 s ahead of the last one's, or more than 1 s behind
/// it, is refused. If the next one is refused too and follows on it by no more than 60 s, the
/// clock was set: the follower starts again there, with no target, and what it knows of the
/// camera's pitch and a stop that was requested stay. A single wild stamp costs its frame.
pub struct Follower {
    options: FollowerOptions,
    sight: Sight,
    ranging: Ranging,
    odometry: OwnOdometry,
    fusion: TargetFilter,
    controller: Controller,
    network: Option<SeenRange>,
    /// Which way the target drives, radians in the fixed frame, once it drove.
    heading: Option<f64>,
    /// Width of the target's box over its height, of the last boxes that were whole.
    aspect: Option<f32>,
    /// Height of the target's box times its range, pixels x metres: to know it again.
    height: Option<f64>,
    trail: Vec<Vector2<f64>>,
    /// Stamp of the last frame.
    last: Option<Stamp>,
    /// Stamp of a frame of another time, if that was the last one to come.
    elsewhere: Option<Stamp>,
}

impl Follower {
    /// Before the first frame.
    ///
    /// # Errors
    /// [`FollowerError`] names the option that does not fit.
    pub fn new(camera: &CameraModel, options: FollowerOptions) -> Result<Self, FollowerError> {
        let mut options = options;
        if options.keep_in_view {
            options.control.pursuit.view = view_limit(camera, &options.mount);
        }
        let max_speed = 2.0 * options.control.vehicle.max_speed_m_s + 1.0;
        Ok(Self {
            sight: Sight::new(options.sight)?,
            ranging: Ranging::new(camera, &options.mount, options.ranging)?,
            odometry: OwnOdometry::new(&options.mount, max_speed),
            fusion: TargetFilter::new(options.fusion).map_err(FollowerError::Fusion)?,
            controller: Controller::new(options.control).map_err(FollowerError::Control)?,
            network: None,
            heading: None,
            aspect: None,
            height: None,
            trail: Vec::with_capacity(options.fusion.trail_capacity + options.fusion.capacity),
            last: None,
            elsewhere: None,
            options,
        })
    }

    /// The options.
    #[must_use]
    pub const fn options(&self) -> &FollowerOptions {
        &self.options
    }

    /// Pitch of the camera against the ground, radians, positive: nose down.
    #[must_use]
    pub fn pitch(&self) -> Uncertain {
        self.ranging.pitch_rad()
    }

    /// The newest range by a depth map alone.
    #[must_use]
    pub const fn network_range(&self) -> Option<SeenRange> {
        self.network
    }

    /// The controller, for its telemetry.
    #[must_use]
    pub const fn controller(&self) -> &Controller {
        &self.controller
    }

    /// The filter, for its outcomes.
    #[must_use]
    pub const fn fusion(&self) -> &TargetFilter {
        &self.fusion
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// [`MotionError`] for a frame of another size or out of order, which includes one of
    /// another time (see [`Follower`]); it is left out.
    pub fn frame(&mut self, frame: &Frame) -> Result<FrameReport, MotionError> {
        let stamp = frame.stamp();
        self.check_time(stamp)?;
        let predictor = self.controller.predictor();
        let promised = (predictor.speed_at(stamp), predictor.yaw_rate_at(stamp));
        let background = self.ranging.frame(frame)?;
        let step = match background.and_then(|step| self.odometry.seen(&step)) {
            // Turns are seen exactly, but lengths have the scale error of the depth map in
            // them: averaged over several maps, they correct what the commands promise.
            Some((speed, yaw_rate)) => {
                let speed = promised.0 + SPEED_GAIN * (speed - promised.0);
                self.controller.predictor_mut().correct(stamp, Some(speed), Some(yaw_rate));
                (speed, yaw_rate)
            }
            None => promised,
        };
        self.odometry.step(stamp, step);
        self.last = Some(stamp);
        self.fusion.advance(stamp);
        let target = self.sight.frame(self.ranging.picture());
        let fast = self.ranging.fast(target.as_ref());
        if let Some(at) = target {
            self.measure_direction(&at, DirectionSource::Flow);
        }
        if let Some((seen, map)) = fast {
            self.measure_range(&seen, RangeSource::Network { map });
        }
        let by_box = self.measure_by_box(target.as_ref());
        Ok(self.report(stamp, target, fast.map(|(seen, _)| seen.depth_m), by_box))
    }

    /// What is known of the last frame once detections and depth of that very frame are
    /// there, which is how recorded frames may be gone through: its report again.
    pub fn revised(&mut self, before: &FrameReport) -> FrameReport {
        let (stamp, known) = (before.stamp, [before.ground_m, before.size_m]);
        if self.last != Some(stamp) {
            return *before;
        }
        let target = self.sight.box_at(stamp);
        // What was measured by the box of flow is not measured twice.
        let by_box = match before.target {
            None => self.measure_by_box(target.as_ref()),
            Some(_) => known,
        };
        self.report(stamp, target, before.fast_m, by_box)
    }

    /// Ranges by the box alone: by its foot on the ground, by its height.
    fn measure_by_box(&mut self, target: Option<&TargetBox>) -> [Option<f64>; 2] {
        let Some(at) = target else { return [None; 2] };
        let ground = self.ranging.ground(at, self.aside(at));
        let size = self.ranging.size(at);
        for (seen, source) in [(ground, RangeSource::Ground), (size, RangeSource::Size)] {
            if let Some(seen) = seen {
                self.measure_range(&seen, source);
            }
        }
        [ground, size].map(|seen| seen.map(|seen| seen.depth_m))
    }

    /// Whether a frame is of the time of the last one, or starts another.
    fn check_time(&mut self, stamp: Stamp) -> Result<(), MotionError> {
        let elsewhere = self.elsewhere.take();
        let Some(last) = self.last else { return Ok(()) };
        let seconds = stamp.seconds_since(last);
        if (-JUMP_BACK_S..=JUMP_AHEAD_S).contains(&seconds) {
            return Ok(()); // the tracker refuses those that were overtaken
        }
        let follows = |at: Stamp| stamp > at && stamp.seconds_since(at) <= JUMP_AHEAD_S;
        if elsewhere.is_some_and(follows) {
            return self.restart();
        }
        self.elsewhere = Some(stamp);
        Err(MotionError::Order { found: stamp, last })
    }

    /// Forgets all that has a stamp.
    fn restart(&mut self) -> Result<(), MotionError> {
        self.ranging.restart()?;
        self.sight.restart();
        self.odometry.restart();
        self.fusion.clear();
        (self.network, self.heading, self.aspect, self.height) = (None, None, None, None);
        self.last = None;
        Ok(())
    }

    fn report(
        &mut self,
        stamp: Stamp,
        target: Option<TargetBox>,
        fast_m: Option<f64>,
        [ground_m, size_m]: [Option<f64>; 2],
    ) -> FrameReport {
        let track = self.fusion.track_at(stamp).ok();
        let camera = self.odometry.camera_at(stamp);
        let range = track.zip(camera).and_then(|(track, camera)| track.range_from(&camera));
        if let Some(motion) = track.and_then(|track| track.motion)
            && motion.velocity.norm() > HEADING_SPEED
        {
            self.heading = Some(motion.velocity.y.atan2(motion.velocity.x));
        }
        if track.is_none_or(|track| track.status == TrackStatus::Searching) {
            // The next target is another one.
            (self.height, self.aspect, self.heading) = (None, None, None);
        }
        let by_forward = self.ranging.depth_of_forward(target.as_ref());
        let fused_m = range.map(|r| (r.depth_m * by_forward, r.std_m * by_forward));
        if let (Some((range, _)), Some(at)) = (fused_m, target)
            && self.ranging.is_whole(&at.bbox)
        {
            self.height = Some(f64::from(at.bbox.height()) * range);
        }
        let fixed_from_base = self.odometry.pose_at(stamp).unwrap_or_default();
        let position = fused_m.zip(target).and_then(|((m, _), at)| self.ranging.lift(&at.bbox, m));
        let velocity =
            track.and_then(|track| track.seen_from(&fixed_from_base).estimate).map(|estimate| {
                let base = Vector3::new(estimate.velocity.x, estimate.velocity.y, 0.0);
                self.options.mount.base_from_optical().rotation().inverse() * base
            });
        FrameReport {
            stamp,
            target,
            network_m: self.network.map(|seen| seen.depth_m),
            fast_m,
            ground_m,
            size_m,
            pitch_rad: self.ranging.pitch_rad().value,
            fused_m,
            position_m: position.map(|place| place.coords.into()),
            velocity_m_s: velocity.map(Into::into),
            status: track.map_or(TrackStatus::Searching, |track| track.status),
            fixed_from_base,
        }
    }

    /// The present frame goes to the depth network. Its map is to be given to
    /// [`Follower::depth`]; that of a frame kept earlier is then no longer the start of
    /// fast ranges.
    pub fn keep_for_depth(&mut self) {
        self.ranging.keep();
    }

    /// The present frame goes to the detector, see [`Sight::keep_for_detector`]. Without any
    /// call every frame is kept as if it did.
    pub fn keep_for_detector(&mut self) {
        self.sight.keep_for_detector();
    }

    /// Takes what the detector found on the frame of `stamp`. Answers with the target's
    /// box there, if it is among it.
    pub fn detections(&mut self, stamp: Stamp, detections: &[Detection]) -> Option<TargetBox> {
        let Self { sight, ranging, odometry, fusion, options, height, .. } = self;
        let camera = odometry.camera_at(stamp);
        let track = fusion.track_at(stamp).ok();
        let expected = track.zip(camera).and_then(|(track, at)| Expectation::new(&track, &at));
        let allowed =
            |d: &Detection| options.classes.is_empty() || options.classes.contains(&d.class_id);
        let found = sight.detections(stamp, detections, allowed, |detection| {
            let at = TargetBox::of_detection(stamp, detection.bbox, &options.sight);
            match (&expected, ranging.direction(&at)) {
                (None, _) => Some(prominence(detection, ranging.width())),
                (Some(expected), Some((tangent, std))) => {
                    expected.likeness(tangent, std, &detection.bbox, *height)
                }
                (Some(_), None) => None,
            }
        });
        // The box is carried on by flow, which measures every frame; where there was no
        // flow the detection itself is the measurement.
        if let Some(at) = found {
            self.measure_direction(&at, DirectionSource::Detection);
        }
        found
    }

    /// Takes a depth map, whenever it comes.
    ///
    /// # Errors
    /// [`MotionError::NotKept`] when its frame is not the one that was kept last; its
    /// range is used all the same.
    pub fn depth(&mut self, map: &DepthMap) -> Result<(), MotionError> {
        let stamp = map.stamp();
        let at = self.sight.box_at(stamp);
        let expected = self.odometry.camera_at(stamp).and_then(|camera| {
            let range = self.fusion.track_at(stamp).ok()?.range_from(&camera)?;
            Some((range.depth_m, range.std_m))
        });
        let (seen, kept) = self.ranging.depth(map, at, expected);
        if let Some(seen) = seen {
            if self.network.is_none_or(|network| network.stamp < seen.stamp) {
                self.network = Some(seen);
            }
            self.measure_range(&seen, RangeSource::Network { map: stamp });
        }
        kept
    }

    /// The command for now.
    pub fn command(&mut self, now: Stamp) -> DriveCommand {
        let effect = self.controller.effect_time(now);
        let (state, fixed_from_base) = self.target_for(now, effect);
        let base_from_fixed = fixed_from_base.inverse();
        self.trail.clear();
        let points = self.fusion.trail(now.seconds_later(-TRAIL_S));
        self.trail.extend(points.map(|point| base_from_fixed.transform_point(&point.position)));
        let input = ControlInput { now, target: &state, trail: &self.trail, own_speed: None };
        self.controller.step(&input)
    }

    /// The command when no frame came: by a timer.
    pub fn idle(&mut self, now: Stamp) -> DriveCommand {
        self.controller.idle(now)
    }

    /// Stops the robot until [`Follower::release`].
    pub fn request_stop(&mut self) {
        self.controller.request_stop();
    }

    /// Takes back [`Follower::request_stop`].
    pub fn release(&mut self) {
        self.controller.release();
    }

    /// The target as the robot will see it at `when`, by what is known `now`, and where
    /// the robot will be.
    fn target_for(&mut self, now: Stamp, when: Stamp) -> (TargetState, Pose2) {
        let (from, pose) = self.odometry.last().unwrap_or((now, Pose2::IDENTITY));
        let fixed_from_base = self.controller.predictor().advance(pose, from, when);
        let state = match self.fusion.track_at(when) {
            Ok(track) => track.seen_from(&fixed_from_base),
            Err(_) => TargetState { stamp: when, ..TargetState::default() },
        };
        (state, fixed_from_base)
    }

    /// How far the target is turned away from the line of sight, radians: 0 when it is
    /// seen from behind.
    fn aside(&self, at: &TargetBox) -> f64 {
        let sight = self.odometry.pose_at(at.stamp).map(|pose| {
            let tangent = self.ranging.direction(at).map_or(0.0, |(tangent, _)| tangent);
            pose.heading + tangent.atan()
        });
        match (sight, self.heading) {
            (Some(sight), Some(heading)) => heading - sight,
            _ => 0.0,
        }
    }

    fn measure_range(&mut self, seen: &SeenRange, source: RangeSource) {
        let reading = Reading::Range {
            depth_m: seen.forward_m,
            relative_std: seen.std_share.max(0.003),
            source,
        };
        self.measure(seen.stamp, reading);
    }

    fn measure_direction(&mut self, at: &TargetBox, source: DirectionSource) {
        if self.ranging.is_whole(&at.bbox) {
            let aspect = at.bbox.width() / at.bbox.height();
            let before = self.aspect.unwrap_or(aspect);
            self.aspect = Some(before + ASPECT_GAIN * (aspect - before));
        }
        let whole = self.ranging.completed(at, self.aspect);
        if let Some((tangent, std)) = whole.and_then(|at| self.ranging.direction(&at)) {
            self.measure(at.stamp, Reading::Direction { tangent, std, source });
        }
    }

    /// Numbers out of range and stamps before the horizon cost only themselves.
    fn measure(&mut self, stamp: Stamp, reading: Reading) -> Option<LateError> {
        let fixed_from_camera = self.odometry.camera_at(stamp)?;
        self.fusion.push(TargetMeasurement { stamp, fixed_from_camera, reading }).err()
    }
}

/// From a third of the picture's half width on, the target counts more than its trail.
fn view_limit(camera: &CameraModel, mount: &CameraMount) -> Option<ViewLimit> {
    let half = 0.5 * camera.horizontal_fov().ok()?;
    let camera_forward_m = mount.forward_m.max(0.0);
    Some(ViewLimit { camera_forward_m, from_rad: 0.33 * half, until_rad: 0.75 * half })
}
