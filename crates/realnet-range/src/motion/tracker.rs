//! The fast path from frame to frame.

use crate::cues::ForegroundGate;
use crate::motion::body::{Body, Flows, Held, Pictures};
use crate::motion::key::KeyFinder;
use crate::motion::shift::ShiftSearch;
use crate::motion::{KeySummary, Motion, MotionError, MotionFailure, MotionOptions};
use realnet_core::nalgebra::Point3;
use realnet_core::{CameraModel, DepthMap, Frame, Pose, Stamp};
use realnet_pose::{DepthWarper, WarpRegion};
use realnet_vision::{FlowError, Pyramid, Track};

/// Follows the corners of a depth map's frame into the present frame; see the
/// [module](super).
#[derive(Clone, Debug)]
pub struct MotionTracker {
    options: MotionOptions,
    camera: CameraModel,
    finder: KeyFinder,
    flow: Flows,
    target_flow: Flows,
    search: ShiftSearch,
    then: Pyramid,
    kept: Pyramid,
    now: Pyramid,
    /// A frame was pushed, and kept.
    started: bool,
    waiting: Option<Kept>,
    background: Body,
    target: Body,
    depth: Option<Depth>,
    motion: Option<Motion>,
}

/// The frame whose depth map is to come.
#[derive(Clone, Copy, Debug)]
struct Kept {
    stamp: Stamp,
    background: Option<Pose>,
    target: Option<Pose>,
}

/// The last depth map.
#[derive(Clone, Debug)]
struct Depth {
    map: DepthMap,
    gate: Option<ForegroundGate>,
    warper: DepthWarper,
}

impl MotionTracker {
    /// A tracker for pictures of this camera.
    ///
    /// # Errors
    /// [`MotionError::Option`], [`MotionError::Flow`] and [`MotionError::Pnp`] for
    /// options out of range.
    pub fn new(camera: &CameraModel, options: MotionOptions) -> Result<Self, MotionError> {
        let step = options.max_depth_step;
        if !(step > 0.0 && step.is_finite()) {
            let (name, value) = ("max_depth_step", f64::from(step));
            return Err(MotionError::Option { name, value, rule: "greater than 0" });
        }
        for (name, value) in
            [("scale_std", options.scale_std), ("target_turn_std", options.target_turn_std)]
        {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(MotionError::Option { name, value, rule: "at least 0" });
            }
        }
        let flow = Flows::new(options.flow)?;
        let target_flow = Flows::new(options.target_flow)?;
        let (own, most) = (options.target_flow.window.size(), options.flow.window.size());
        if own.0 > most.0 || own.1 > most.1 {
            return Err(FlowError::PyramidWindow { expected: own, found: most }.into());
        }
        // Corners of the box that lie behind the target are the background's.
        let capacity = options.background.max_corners.saturating_add(options.target.max_corners);
        let capacity = capacity.min(1 << 16);
        Ok(Self {
            finder: KeyFinder::new(camera, &options)?,
            search: ShiftSearch::default(),
            then: flow.pyramid(),
            kept: flow.pyramid(),
            now: flow.pyramid(),
            flow,
            target_flow,
            started: false,
            waiting: None,
            background: Body::new("background", &options, capacity)?,
            target: Body::new("target", &options, capacity)?,
            depth: None,
            motion: None,
            camera: *camera,
            options,
        })
    }

    /// The camera whose pictures are tracked.
    #[must_use]
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// [`MotionError::Size`] and [`MotionError::Order`]; the frame is then left
    /// out.
    pub fn push(&mut self, frame: &Frame) -> Result<(), MotionError> {
        let found = (frame.width(), frame.height());
        let camera = (self.camera.width(), self.camera.height());
        if found != camera {
            return Err(MotionError::Size { found, camera });
        }
        let last = self.now.stamp();
        if self.started && frame.stamp() <= last {
            return Err(MotionError::Order { found: frame.stamp(), last });
        }
        self.now.build(frame);
        self.started = true;
        self.motion = None;
        Ok(())
    }

    /// The present frame as a pyramid, for others that look at the same pictures.
    #[must_use]
    pub fn picture(&self) -> &Pyramid {
        &self.now
    }

    /// Keeps the present frame: its depth map is to come. A frame kept before, whose
    /// depth map did not come, is forgotten. Without effect before the first frame.
    pub fn keep(&mut self) {
        if !self.started {
            return;
        }
        self.kept.copy_from(&self.now);
        let stamp = self.now.stamp();
        let background = self.background.motion_at(stamp);
        let target = self.target.motion_at(stamp);
        self.waiting = Some(Kept { stamp, background, target });
    }

    /// The stamp of the frame that waits for its depth map.
    #[must_use]
    pub fn kept(&self) -> Option<Stamp> {
        self.waiting.map(|kept| kept.stamp)
    }

    /// The depth map of the kept frame, of any size with the frame's field of view,
    /// and where the target is on it (in pixels of the *map*). From now on motions
    /// are from this frame.
    ///
    /// # Errors
    /// [`MotionError::NotKept`] when the map's stamp is not that of the kept frame,
    /// [`MotionError::DepthSize`] for a map whose camera cannot be made. What was
    /// known stays.
    pub fn set_depth(
        &mut self,
        depth: &DepthMap,
        gate: Option<&ForegroundGate>,
    ) -> Result<KeySummary, MotionError> {
        let Some(kept) = self.waiting.filter(|kept| kept.stamp == depth.stamp()) else {
            return Err(MotionError::NotKept(depth.stamp()));
        };
        self.take_map(depth, gate)?;
        self.waiting = None;
        std::mem::swap(&mut self.then, &mut self.kept);
        self.background.rebase(kept.background, kept.stamp);
        let followed = gate.is_some() && self.target.len() > 0;
        if followed {
            self.target.rebase(kept.target, kept.stamp);
        } else {
            self.target.forget(kept.stamp);
        }
        self.motion = None;
        self.finder.find(
            &self.then,
            &self.camera,
            depth,
            gate,
            &mut self.background,
            &mut self.target,
        )
    }

    fn take_map(
        &mut self,
        depth: &DepthMap,
        gate: Option<&ForegroundGate>,
    ) -> Result<(), MotionError> {
        let (width, height) = (depth.width(), depth.height());
        match &mut self.depth {
            Some(known) if (known.map.width(), known.map.height()) == (width, height) => {
                known.map.copy_from(depth);
                known.gate = gate.copied();
            }
            _ => {
                let camera = self
                    .camera
                    .scaled(width, height)
                    .map_err(|source| MotionError::DepthSize { width, height, source })?;
                let warper = DepthWarper::new(&camera);
                self.depth = Some(Depth { map: depth.clone(), gate: gate.copied(), warper });
            }
        }
        Ok(())
    }

    /// The motions from the depth map's frame to the present one.
    pub fn estimate(&mut self) -> &Motion {
        let Self { then, now, camera, flow, target_flow, search, .. } = self;
        let pictures = Pictures { then, now, camera };
        let (background, target) = match &self.depth {
            None => (Err(MotionFailure::NoDepth), None),
            Some(depth) => {
                let background = self.background.estimate(&pictures, flow, search, None);
                // A target that does not turn over the ground turns as the ground does.
                let held = background.as_ref().ok().map(|background| {
                    let seconds = pictures.now.stamp().seconds_since(pictures.then.stamp());
                    let own = self.options.target_turn_std * seconds;
                    Held {
                        rotation: background.now_from_then().rotation(),
                        std: own.hypot(background.estimate.rotation_std()),
                    }
                });
                let target =
                    depth.gate.map(|_| self.target.estimate(&pictures, target_flow, search, held));
                (background, target)
            }
        };
        // A frame may be kept before its motion is known.
        let now = self.now.stamp();
        if let Some(kept) = self.waiting.as_mut().filter(|kept| kept.stamp == now) {
            kept.background = self.background.motion_at(now);
            kept.target = self.target.motion_at(now);
        }
        let scale_std = self.options.scale_std;
        let (then, now) = (self.then.stamp(), self.now.stamp());
        self.motion.insert(Motion { then, now, background, target, scale_std })
    }

    /// The answer of the last [`MotionTracker::estimate`], if it was for the present
    /// frame.
    #[must_use]
    pub fn motion(&self) -> Option<&Motion> {
        self.motion.as_ref()
    }

    /// The corners of the background: where they were on the depth map's frame,
    /// where flow took them, and whether they agree with the motion.
    pub fn background_tracks(&self) -> impl Iterator<Item = ([f32; 2], &Track, bool)> {
        self.background.tracks()
    }

    /// The corners of the target, as [`MotionTracker::background_tracks`].
    pub fn target_tracks(&self) -> impl Iterator<Item = ([f32; 2], &Track, bool)> {
        self.target.tracks()
    }

    /// The points of the background that its corners were lifted to, in then's
    /// optical frame, metres, in the order of [`MotionTracker::background_tracks`].
    #[must_use]
    pub fn background_points(&self) -> &[Point3<f64>] {
        self.background.points()
    }

    /// The points of the target, as [`MotionTracker::background_points`].
    #[must_use]
    pub fn target_points(&self) -> &[Point3<f64>] {
        self.target.points()
    }

    /// The motions to the present frame, and the map they start from.
    fn estimated(&mut self) -> Result<(&Motion, &mut Depth), MotionFailure> {
        match (&self.motion, &mut self.depth) {
            (Some(motion), Some(depth)) => Ok((motion, depth)),
            (_, None) => Err(MotionFailure::NoDepth),
            (None, _) => Err(MotionFailure::NotEstimated),
        }
    }

    /// The depth map as it is now: warped by the motions of the last
    /// [`MotionTracker::estimate`]. Where the target's motion is unknown, the pixels
    /// that it covered are unknown.
    ///
    /// # Errors
    /// [`MotionError::Unknown`] when the camera's motion is unknown: then the whole
    /// map is, and `out` is left as it was. [`MotionError::Warp`] when `out` is not of the
    /// depth map's size.
    pub fn depth_now(&mut self, out: &mut DepthMap) -> Result<(), MotionError> {
        let (motion, depth) = self.estimated()?;
        let background = match &motion.background {
            Ok(background) => background.now_from_then(),
            Err(failure) => return Err(failure.clone().into()),
        };
        let target = motion.target.as_ref().and_then(|target| target.as_ref().ok());
        let region = depth.gate.map(|gate| region(&gate, target.map(|body| body.now_from_then())));
        let map = &depth.map;
        depth.warper.warp(map, motion.now, Some(&background), region.as_ref(), out)?;
        Ok(())
    }

    /// The cheap way: the target's part of the depth map alone, warped by its
    /// motion; all else is unknown. It does not need the camera's own motion.
    ///
    /// # Errors
    /// As [`MotionTracker::depth_now`], for the target's motion.
    pub fn target_depth_now(&mut self, out: &mut DepthMap) -> Result<(), MotionError> {
        let (motion, depth) = self.estimated()?;
        let (target, gate) = match (&motion.target, depth.gate) {
            (Some(Ok(target)), Some(gate)) => (target.now_from_then(), gate),
            (Some(Err(failure)), _) => return Err(failure.clone().into()),
            _ => return Err(MotionFailure::NoTarget.into()),
        };
        let region = region(&gate, Some(target));
        depth.warper.warp(&depth.map, motion.now, None, Some(&region), out)?;
        Ok(())
    }
}

/// The pixels of a depth map that belong to the target: those whose centres lie
/// in the box.
fn region(gate: &ForegroundGate, motion: Option<Pose>) -> WarpRegion {
    let first = |edge: f32| (edge - 0.5).ceil().max(0.0) as u32;
    let behind = |edge: f32| ((edge - 0.5).floor() + 1.0).max(0.0) as u32;
    let b = gate.bbox;
    WarpRegion {
        start: (first(b.x0), first(b.y0)),
        end: (behind(b.x1), behind(b.y1)),
        depths: (gate.near, gate.far),
        motion,
    }
}
