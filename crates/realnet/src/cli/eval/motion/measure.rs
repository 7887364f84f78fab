//! The fast path run over a sequence, and what came of it.

use anyhow::{Context, Result};
use realnet::{
    BoundingBox, CameraModel, DepthMap, Frame, Pose,
    cues::{
        BoxDepth, DepthHistogram, DepthInBox, DepthInBoxOptions, DepthNoise, ForegroundGate,
        SigmaRule,
    },
    datasets::rgbd::RgbdFrame,
    eval::{DepthErrors, DepthMetrics, DepthProtocol, ImageDepth, RelativePoseErrors},
    motion::{MotionError, MotionOptions, MotionTracker},
};
use serde::Serialize;
use std::{collections::BTreeMap, time::Instant};

/// Structured light and time of flight end before this, metres.
const MAX_DEPTH_M: f64 = 10.0;

/// The figures, as `--json` prints them.
#[derive(Debug, Serialize)]
pub(super) struct Figures {
    pub(super) abs_rel: Option<f64>,
    pub(super) sq_rel: Option<f64>,
    pub(super) rmse: Option<f64>,
    pub(super) rmse_log: Option<f64>,
    pub(super) d1: Option<f64>,
    pub(super) abs_rel_hold: Option<f64>,
    pub(super) rpe_trans_m: Option<f64>,
    pub(super) rpe_rot_deg: Option<f64>,
    pub(super) failed_share: Option<f64>,
    pub(super) ms_per_frame: Option<f64>,

    pub(super) frames: usize,
    pub(super) given: usize,
    pub(super) produced: usize,
    pub(super) failed: usize,
    pub(super) failures: BTreeMap<String, usize>,
    /// Over the pixels that the produced map knows, the held one or not.
    pub(super) abs_rel_known: Option<f64>,
    /// Shares of the pixels with a true depth.
    pub(super) known_share: Option<f64>,
    pub(super) known_share_hold: Option<f64>,
    pub(super) sq_rel_hold: Option<f64>,
    pub(super) rmse_hold: Option<f64>,
    pub(super) rmse_log_hold: Option<f64>,
    pub(super) d1_hold: Option<f64>,
    pub(super) target_frames: usize,
    pub(super) target_failed: usize,
    pub(super) target_abs_rel: Option<f64>,
    pub(super) target_abs_rel_hold: Option<f64>,
    pub(super) rpe_pairs: usize,
    pub(super) rpe_missing: usize,
    pub(super) rpe_trans_m_max: Option<f64>,
    pub(super) rpe_rot_deg_max: Option<f64>,
    /// Corners, flow and motion; medians.
    pub(super) ms_motion: Option<f64>,
    pub(super) ms_warp: Option<f64>,
    /// Corners found on a given map, and lifted.
    pub(super) ms_key: Option<f64>,
    pub(super) protocol: String,
}

/// A frame of `frames.csv`.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct FrameFigures {
    pub(super) frame: u64,
    pub(super) since_depth: u64,
    pub(super) abs_rel: Option<f64>,
    pub(super) abs_rel_hold: Option<f64>,
    pub(super) known_share: Option<f64>,
    pub(super) rpe_trans_m: Option<f64>,
    pub(super) rpe_rot_deg: Option<f64>,
    pub(super) corners: usize,
    pub(super) tracked: usize,
    pub(super) inliers: usize,
    pub(super) ms: f64,
    pub(super) failure: Option<String>,
    pub(super) target_failure: Option<String>,
}

/// The frame of the last depth map, as it was.
pub(super) struct Key {
    pub(super) number: u64,
    pub(super) color: Frame,
    pub(super) depth: DepthMap,
    pub(super) target: Option<KeyTarget>,
}

/// The target on that frame.
pub(super) struct KeyTarget {
    pub(super) bbox: BoundingBox,
    pub(super) found: Result<(BoxDepth, DepthHistogram, ForegroundGate), String>,
}

/// A frame for which depth was produced, to be looked at.
pub(super) struct View<'a> {
    pub(super) figures: &'a FrameFigures,
    pub(super) key: &'a Key,
    pub(super) color: &'a Frame,
    pub(super) truth: &'a DepthMap,
    pub(super) produced: &'a DepthMap,
    pub(super) tracker: &'a MotionTracker,
}

/// Figures of one part of the pixels, with and without the motion.
struct Compared {
    produced: DepthMetrics,
    held: DepthMetrics,
}

impl Compared {
    fn new(protocol: &DepthProtocol) -> Result<Self> {
        let metrics = || DepthMetrics::new(protocol.clone());
        Ok(Self { produced: metrics()?, held: metrics()? })
    }

    /// Adds the pixels that `keep` says yes to; gives the two errors.
    fn add(
        &mut self,
        truth: &DepthMap,
        produced: &DepthMap,
        held: &DepthMap,
        keep: impl Fn(u32, u32) -> bool,
    ) -> Result<[Option<f64>; 2]> {
        let abs_rel = |image: ImageDepth| image.errors.map(|errors| errors.abs_rel);
        Ok([
            abs_rel(self.produced.add_where(truth, produced, &keep)?),
            abs_rel(self.held.add_where(truth, held, &keep)?),
        ])
    }
}

/// Runs the fast path and compares.
pub(super) struct Measurement {
    every: u64,
    late: u64,
    index: u64,
    tracker: MotionTracker,
    depth_in_box: DepthInBox,
    produced: Option<DepthMap>,
    /// A given map that is still on its way: when it comes, and the motion of the
    /// background up to its frame.
    coming: Option<(u64, Key, Option<Pose>)>,
    key: Option<Key>,
    /// Index of the key's frame.
    key_index: u64,
    /// The true place of the last camera, and the motion to it from the key.
    last: (Option<Pose>, Option<Pose>),
    /// Pixels that are known both ways, and all.
    both: Compared,
    all: Compared,
    target: Compared,
    rpe: RelativePoseErrors,
    frames: Vec<FrameFigures>,
    given: usize,
    failures: BTreeMap<String, usize>,
    failed: usize,
    target_failed: usize,
    target_frames: usize,
    ms: Milliseconds,
}

#[derive(Default)]
struct Milliseconds {
    motion: Vec<f64>,
    warp: Vec<f64>,
    key: Vec<f64>,
    frame: Vec<f64>,
}

impl Measurement {
    pub(super) fn new(camera: &CameraModel, every: u32, late: u32, seed: u64) -> Result<Self> {
        let protocol = DepthProtocol {
            max_depth: MAX_DEPTH_M,
            ..DepthProtocol::new("the data set's depth maps, as recorded")
        };
        let options = MotionOptions { seed, ..MotionOptions::default() };
        Ok(Self {
            every: u64::from(every),
            late: u64::from(late),
            index: 0,
            tracker: MotionTracker::new(camera, options)?,
            depth_in_box: DepthInBox::new(DepthInBoxOptions::default())?,
            produced: None,
            coming: None,
            key: None,
            key_index: 0,
            last: (None, None),
            both: Compared::new(&protocol)?,
            all: Compared::new(&protocol)?,
            target: Compared::new(&protocol)?,
            rpe: RelativePoseErrors::default(),
            frames: Vec::new(),
            given: 0,
            failures: BTreeMap::new(),
            failed: 0,
            target_failed: 0,
            target_frames: 0,
            ms: Milliseconds::default(),
        })
    }

    /// The frames for which depth was produced, or should have been.
    pub(super) fn frames(&self) -> &[FrameFigures] {
        &self.frames
    }

    /// The next frame cannot be used. Motion to and from it is not asked for.
    pub(super) fn skip(&mut self) -> Result<()> {
        self.last = (None, None);
        self.arrive()?;
        self.index += 1;
        Ok(())
    }

    /// Takes the next frame with its true depth. `see` is shown what was produced.
    ///
    /// # Errors
    /// [`MotionError::Size`] and [`MotionError::Order`] say that the frame cannot be
    /// used; it is then to be [skipped](Self::skip).
    pub(super) fn frame(
        &mut self,
        frame: &RgbdFrame,
        color: Frame,
        truth: Option<DepthMap>,
        bbox: Option<BoundingBox>,
        see: impl FnOnce(&View<'_>) -> Result<()>,
    ) -> Result<()> {
        let start = Instant::now();
        self.tracker.push(&color).with_context(|| frame.name.clone())?;
        let mut now_from_key = None;
        let given = self.index.is_multiple_of(self.every);
        let mut figures = FrameFigures { frame: frame.number, ..FrameFigures::default() };
        if self.key.is_some() {
            let motion = self.tracker.estimate();
            figures.since_depth = self.index - self.key_index;
            if let Ok(background) = &motion.background {
                now_from_key = Some(background.now_from_then());
                figures.corners = background.corners;
                figures.tracked = background.tracked;
                figures.inliers = background.estimate.inliers;
            }
            let target = self.key.as_ref().and_then(|key| key.target.as_ref());
            figures.target_failure = match (&motion.target, target.map(|target| &target.found)) {
                (Some(Err(failure)), _) => Some(failure.to_string()),
                // Without a range it was taken for background.
                (None, Some(Err(reason))) => Some(reason.clone()),
                _ => None,
            };
            let motion_ms = milliseconds(start);
            self.relative_pose(frame.world_from_camera, now_from_key, &mut figures);
            let wanted = self.late > 0 || !given;
            if let (true, Some(truth)) = (wanted, &truth) {
                self.produce(motion_ms, &mut figures)?;
                self.compare(truth, bbox, &mut figures)?;
                if let (Some(key), Some(produced)) = (&self.key, &self.produced) {
                    let tracker = &self.tracker;
                    see(&View { figures: &figures, key, color: &color, truth, produced, tracker })?;
                }
                self.frames.push(figures);
            }
        }
        self.last = (frame.world_from_camera, now_from_key);
        if let (true, Some(depth)) = (given, truth) {
            self.tracker.keep();
            let target = bbox.map(|bbox| self.key_target(&depth, bbox));
            let key = Key { number: frame.number, color, depth, target };
            self.coming = Some((self.index + self.late, key, now_from_key));
        }
        self.arrive()?;
        self.index += 1;
        Ok(())
    }

    /// A given map that is due.
    fn arrive(&mut self) -> Result<()> {
        let Some((_, key, kept_from_key)) = self.coming.take_if(|(due, ..)| *due == self.index)
        else {
            return Ok(());
        };
        let gate = key.target.as_ref().and_then(|t| t.found.as_ref().ok()).map(|found| found.2);
        let start = Instant::now();
        self.tracker.set_depth(&key.depth, gate.as_ref())?;
        self.ms.key.push(milliseconds(start));
        self.last.1 = match (self.last.1, kept_from_key) {
            _ if self.late == 0 => Some(Pose::identity()),
            (Some(last), Some(kept)) => Some(last * kept.inverse()),
            _ => None,
        };
        if self.key.is_none() && self.late > 0 {
            // No motion up to here was asked for, so none is missing.
            self.last.0 = None;
        }
        self.key_index = self.index - self.late;
        self.given += 1;
        self.key = Some(key);
        Ok(())
    }

    /// The target on a given map.
    fn key_target(&mut self, depth: &DepthMap, bbox: BoundingBox) -> KeyTarget {
        let found = self.depth_in_box.measure(depth, bbox, DepthNoise::NONE);
        let found = found.and_then(|range| {
            let foreground = self.depth_in_box.foreground(&SigmaRule::default())?;
            Ok((range, self.depth_in_box.overview().clone(), foreground.gate))
        });
        KeyTarget { bbox, found: found.map_err(|error| error.to_string()) }
    }

    /// Compares the motion since the last frame.
    fn relative_pose(
        &mut self,
        place: Option<Pose>,
        now_from_key: Option<Pose>,
        figures: &mut FrameFigures,
    ) {
        let (Some(last_place), Some(place)) = (self.last.0, place) else { return };
        match (self.last.1, now_from_key) {
            (Some(last), Some(now)) => {
                let truth = last_place.inverse() * place;
                let (metres, degrees) = self.rpe.add(&truth, &(last * now.inverse()));
                figures.rpe_trans_m = Some(metres);
                figures.rpe_rot_deg = Some(degrees);
            }
            _ => self.rpe.add_missing(),
        }
    }

    /// The depth now, into `self.produced`; all unknown when that failed.
    fn produce(&mut self, motion_ms: f64, figures: &mut FrameFigures) -> Result<()> {
        let Some(key) = &self.key else { return Ok(()) };
        let (width, height) = (key.depth.width(), key.depth.height());
        let produced = match &mut self.produced {
            Some(produced) => produced,
            None => self.produced.insert(DepthMap::unknown(key.depth.stamp(), width, height)?),
        };
        let start = Instant::now();
        match self.tracker.depth_now(produced) {
            Ok(()) => {
                let warp_ms = milliseconds(start);
                figures.ms = motion_ms + warp_ms;
                self.ms.motion.push(motion_ms);
                self.ms.warp.push(warp_ms);
                self.ms.frame.push(figures.ms);
            }
            Err(MotionError::Unknown(failure)) => {
                produced.data_mut().fill(DepthMap::UNKNOWN);
                figures.ms = motion_ms;
                self.ms.frame.push(motion_ms);
                self.failed += 1;
                let failure = failure.to_string();
                *self.failures.entry(without_numbers(&failure)).or_default() += 1;
                figures.failure = Some(failure);
            }
            Err(error) => return Err(error.into()),
        }
        Ok(())
    }

    fn compare(
        &mut self,
        truth: &DepthMap,
        bbox: Option<BoundingBox>,
        figures: &mut FrameFigures,
    ) -> Result<()> {
        let (Some(key), Some(produced)) = (&self.key, &self.produced) else { return Ok(()) };
        let held = &key.depth;
        let known = |x, y| produced.at(x, y).is_some() && held.at(x, y).is_some();
        [figures.abs_rel, figures.abs_rel_hold] = self.both.add(truth, produced, held, known)?;
        self.all.add(truth, produced, held, |_, _| true)?;
        let (true_pixels, produced_pixels) = (0..truth.height())
            .flat_map(|y| truth.row(y).iter().zip(produced.row(y)))
            .filter(|(t, _)| DepthMap::is_known(**t))
            .fold((0_u64, 0_u64), |(all, found), (_, p)| {
                (all + 1, found + u64::from(DepthMap::is_known(*p)))
            });
        figures.known_share =
            (true_pixels > 0).then(|| produced_pixels as f64 / true_pixels as f64);
        if let (Some(bbox), true) = (bbox, key.target.is_some()) {
            self.target_frames += 1;
            self.target_failed += usize::from(figures.target_failure.is_some());
            let inside = |x: u32, y: u32| {
                let (x, y) = (x as f32 + 0.5, y as f32 + 0.5);
                x >= bbox.x0 && x <= bbox.x1 && y >= bbox.y0 && y <= bbox.y1
            };
            self.target.add(truth, produced, held, |x, y| inside(x, y) && known(x, y))?;
        }
        Ok(())
    }

    pub(super) fn figures(&self) -> Figures {
        let (both, hold) = (self.both.produced.report(), self.both.held.report());
        let (all, all_hold) = (self.all.produced.report(), self.all.held.report());
        let rpe = self.rpe.report(1);
        let of = |errors: Option<DepthErrors>, value: fn(&DepthErrors) -> f64| {
            errors.as_ref().map(value)
        };
        let abs_rel = |metrics: &DepthMetrics| of(metrics.report().errors(), |e| e.abs_rel);
        let produced = self.frames.len();
        Figures {
            abs_rel: of(both.errors(), |e| e.abs_rel),
            sq_rel: of(both.errors(), |e| e.sq_rel),
            rmse: of(both.errors(), |e| e.rmse),
            rmse_log: of(both.errors(), |e| e.rmse_log),
            d1: of(both.errors(), |e| e.d1),
            abs_rel_hold: of(hold.errors(), |e| e.abs_rel),
            rpe_trans_m: rpe.translation_m.map(|e| e.mean),
            rpe_rot_deg: rpe.rotation_deg.map(|e| e.mean),
            failed_share: (produced > 0).then(|| self.failed as f64 / produced as f64),
            ms_per_frame: median(&self.ms.frame),
            frames: self.index as usize,
            given: self.given,
            produced,
            failed: self.failed,
            failures: self.failures.clone(),
            abs_rel_known: of(all.errors(), |e| e.abs_rel),
            known_share: all.known_share,
            known_share_hold: all_hold.known_share,
            sq_rel_hold: of(hold.errors(), |e| e.sq_rel),
            rmse_hold: of(hold.errors(), |e| e.rmse),
            rmse_log_hold: of(hold.errors(), |e| e.rmse_log),
            d1_hold: of(hold.errors(), |e| e.d1),
            target_frames: self.target_frames,
            target_failed: self.target_failed,
            target_abs_rel: abs_rel(&self.target.produced),
            target_abs_rel_hold: abs_rel(&self.target.held),
            rpe_pairs: rpe.pairs,
            rpe_missing: rpe.missing,
            rpe_trans_m_max: rpe.translation_m.map(|e| e.max),
            rpe_rot_deg_max: rpe.rotation_deg.map(|e| e.max),
            ms_motion: median(&self.ms.motion),
            ms_warp: median(&self.ms.warp),
            ms_key: median(&self.ms.key),
            protocol: format!(
                "{}; compared: pixels known in truth, produced and held map; motion: from each \
                 frame to the next, mean",
                all.protocol
            ),
        }
    }
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1000.0
}

fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// A reason with its numbers left out, so that the same ones are counted together.
fn without_numbers(reason: &str) -> String {
    let mut text = String::new();
    for c in reason.chars() {
        let digit = c.is_ascii_digit() || (c == '.' && text.ends_with('#'));
        if !digit {
            text.push(c);
        } else if !text.ends_with('#') {
            text.push('#');
        }
    }
    text
}
