//! From a starting motion to the box's motion.

use super::fit::{Fit, Pair, Similarity, fit};
use super::view::{BOX, MIDDLE, SIDE, Sampler, View};
use super::{BoxMotion, Carried, CarriedPoint, CarryError, CarryOptions, in_sight};
use realnet_core::{BoundingBox, Frame, Stamp};
use realnet_vision::{
    Corner, CornerDetector, CornerMask, CornerOptions, FlowError, FlowOptions, LucasKanade,
    Pyramid, Region, Track, Window,
};

/// Side of the windows compared, in pixels of the view.
const WINDOW: u32 = 15;
/// Farthest a point may come back from where it started, in pixels of the view.
const ROUND_TRIP: f32 = 1.0;
/// Least distance of two points that give a scale, in pixels of the view.
const BASELINE: f32 = 0.2 * BOX;
/// Scales a round may find on top of the one it starts from.
const SCALES: (f32, f32) = (0.6, 1.7);
/// What no residual shows, in sides of the box: motion that the box has and its
/// corners do not; and that for each share of the corners that do not move with the
/// others, as when the target turns. Measured on boxes drawn by hand.
const UNSEEN: (f32, f32) = (0.005, 0.08);
/// Rounds: each starts from what the one before found.
const ROUNDS: usize = 3;

/// Corners of a box and what it takes to find them again.
#[derive(Clone, Debug)]
pub(super) struct Aligner {
    detector: CornerDetector,
    method: LucasKanade,
    mask: CornerMask,
    sampler: Sampler,
    view: View,
    level: usize,
    /// Half the box's sides in pixels of the view.
    half: [f32; 2],
    from: Frame,
    from_pyramid: Pyramid,
    to: Frame,
    to_pyramid: Pyramid,
    corners: Vec<Corner>,
    points: Vec<[f32; 2]>,
    tracks: Vec<Track>,
    pairs: Vec<Pair>,
    carried: Vec<CarriedPoint>,
}

impl Aligner {
    pub(super) fn new(options: &CarryOptions) -> Result<Self, FlowError> {
        let detector = CornerDetector::new(CornerOptions {
            max_corners: options.max_points,
            quality_level: 0.01,
            min_distance: 5.0,
            cells: (4, 4),
        })?;
        let method = LucasKanade::new(FlowOptions {
            window: Window::new(WINDOW, WINDOW)?,
            max_level: 2,
            max_iterations: 20,
            epsilon: 0.03,
            max_round_trip: Some(ROUND_TRIP),
            ..FlowOptions::default()
        })?;
        let pixels = vec![0; (SIDE * SIDE) as usize];
        let blank = || {
            Frame::grey8(Stamp::ZERO, SIDE, SIDE, pixels.clone()).map_err(|_| FlowError::NoPicture)
        };
        Ok(Self {
            detector,
            mask: CornerMask::new(SIDE, SIDE, false),
            sampler: Sampler::default(),
            view: View { center: [0.0; 2], unit: 1.0 },
            level: 0,
            half: [0.0; 2],
            from: blank()?,
            from_pyramid: method.pyramid(),
            to: blank()?,
            to_pyramid: method.pyramid(),
            method,
            corners: Vec::new(),
            points: Vec::new(),
            tracks: Vec::new(),
            pairs: Vec::new(),
            carried: Vec::new(),
        })
    }

    /// Looks for corners in the box.
    pub(super) fn start(
        &mut self,
        from: &Pyramid,
        bbox: &BoundingBox,
        options: &CarryOptions,
    ) -> Result<(), CarryError> {
        self.view = View::of(bbox, BOX);
        self.level = Sampler::level(from, self.view.unit);
        self.sampler.fill_view(from, self.level, self.view, &mut self.from);
        self.from_pyramid.build(&self.from);
        self.half = [bbox.width(), bbox.height()].map(|side| side / self.view.unit / 2.0);

        // The box's pixels that lie in the picture, but for its outermost ones.
        let picture = from.full()?;
        let range = |i: usize, limit: u32| {
            let inside = |v: f32| (v - self.view.center[i]) / self.view.unit;
            let low = inside(2.0).max(-self.half[i]) + MIDDLE;
            let high = inside(limit as f32 - 3.0).min(self.half[i]) + MIDDLE;
            (low.ceil().max(0.0) as u32, (high.floor() + 1.0).max(0.0) as u32)
        };
        let ((x0, x1), (y0, y1)) = (range(0, picture.width()), range(1, picture.height()));
        self.mask.fill(false);
        let (width, height) = (x1.saturating_sub(x0), y1.saturating_sub(y0));
        self.mask.set(Region { x: x0, y: y0, width, height }, true);
        self.detector.detect(&self.from_pyramid, Some(&self.mask), &mut self.corners)?;
        self.points.clear();
        self.points.extend(self.corners.iter().map(|corner| corner.point));
        if self.points.len() < options.min_inliers {
            let (corners, needed) = (self.points.len(), options.min_inliers);
            return Err(CarryError::NoTexture { corners, needed });
        }
        Ok(())
    }

    /// Finds the box's motion from a start close to it.
    pub(super) fn align(
        &mut self,
        to: &Pyramid,
        bbox: &BoundingBox,
        start: BoxMotion,
        options: &CarryOptions,
    ) -> Result<Carried, CarryError> {
        let picture = to.full()?;
        let size = (picture.width(), picture.height());
        let tolerance = options.tolerance * BOX;
        let corners = self.points.len();
        let needed =
            ((options.min_share * corners as f32).ceil() as usize).max(options.min_inliers);
        let mut motion = start;
        let mut found: Option<(View, Fit)> = None;
        for round in 0..ROUNDS {
            let view = self.view.moved(motion);
            self.sampler.fill_view(to, self.level, view, &mut self.to);
            self.to_pyramid.build(&self.to);
            self.track(view, size)?;
            if self.pairs.len() < needed {
                return Err(CarryError::Lost { corners, tracked: self.pairs.len(), needed });
            }
            let fit = fit(&self.pairs, tolerance, BASELINE, SCALES);
            let inliers = fit.map_or(0, |fit| fit.inliers);
            let Some(fit) = fit.filter(|_| inliers >= needed) else {
                return Err(CarryError::NoConsensus { tracked: self.pairs.len(), inliers, needed });
            };
            let Similarity { scale, shift } = fit.similarity;
            motion = BoxMotion {
                shift: [0, 1].map(|i| motion.shift[i] + shift[i] * view.unit),
                scale: motion.scale * scale,
            };
            found = Some((view, fit));
            let close = shift[0].hypot(shift[1]) < 0.05 * BOX && (scale - 1.0).abs() < 0.05;
            if close || round + 1 == ROUNDS {
                break;
            }
        }
        let Some((view, fit)) = found else {
            return Err(CarryError::Lost { corners, tracked: 0, needed });
        };
        let moved = motion.apply(bbox);
        in_sight(&moved, size)?;
        let similarity = self.similarity(to, self.view.moved(motion));
        if similarity < options.min_similarity {
            return Err(CarryError::Unlike { similarity, needed: options.min_similarity });
        }
        self.carried.clear();
        self.carried.extend(self.pairs.iter().map(|pair| CarriedPoint {
            from: self.view.to_picture(pair.from),
            to: view.to_picture(pair.to),
            inlier: fit.holds(pair, tolerance),
        }));
        let unexplained = 1.0 - fit.inliers as f32 / corners as f32;
        let unseen = UNSEEN.0.hypot(UNSEEN.1 * unexplained);
        Ok(Carried {
            bbox: moved,
            motion,
            corners,
            tracked: self.pairs.len(),
            inliers: fit.inliers,
            similarity,
            searched: false,
            center_sd: fit.shift_sd.map(|sd| sd.hypot(unseen * BOX) * view.unit),
            size_sd: (fit.scale_sd / fit.similarity.scale).hypot(unseen),
        })
    }

    /// The corners found again by the last [`Aligner::align`] that succeeded.
    pub(super) fn carried(&self) -> &[CarriedPoint] {
        &self.carried
    }

    /// Fills the pairs: corners found again, inside the picture, relative to the
    /// middle of the views.
    fn track(&mut self, view: View, (width, height): (u32, u32)) -> Result<(), FlowError> {
        let (from, to) = (&self.from_pyramid, &self.to_pyramid);
        self.method.track(from, to, &self.points, None, &mut self.tracks)?;
        let inside = |point: [f32; 2]| {
            let [x, y] = view.to_picture(point);
            x >= 0.0 && y >= 0.0 && x <= (width - 1) as f32 && y <= (height - 1) as f32
        };
        self.pairs.clear();
        for (point, track) in self.points.iter().zip(&self.tracks) {
            let pair =
                Pair { from: point.map(|v| v - MIDDLE), to: track.point.map(|v| v - MIDDLE) };
            if track.is_tracked() && inside(pair.to) {
                self.pairs.push(pair);
            }
        }
        Ok(())
    }

    /// Correlation of the box's content before and in `view`, over every second
    /// pixel of the view that lies inside the picture both times; 0 when either is flat.
    fn similarity(&mut self, to: &Pyramid, view: View) -> f32 {
        let Ok(picture) = to.full() else { return 0.0 };
        self.sampler.fill_view(to, self.level, view, &mut self.to);
        let inside = |view: View, i: usize, at: f32, limit: u32| {
            let at = view.center[i] + (at - MIDDLE) * view.unit;
            at >= 0.0 && at <= (limit - 1) as f32
        };
        let both = |i: usize, at: u32, limit: u32| {
            let at = at as f32;
            (at - MIDDLE).abs() <= self.half[i]
                && inside(self.view, i, at, limit)
                && inside(view, i, at, limit)
        };
        let side = SIDE as usize;
        let rows = self.from.data().chunks_exact(side).zip(self.to.data().chunks_exact(side));
        let mut sums = [0_u64; 6];
        for (y, (a, b)) in rows.enumerate().step_by(2) {
            if !both(1, y as u32, picture.height()) {
                continue;
            }
            for (x, (&a, &b)) in a.iter().zip(b).enumerate().step_by(2) {
                if both(0, x as u32, picture.width()) {
                    let (a, b) = (u64::from(a), u64::from(b));
                    for (sum, term) in sums.iter_mut().zip([1, a, b, a * a, b * b, a * b]) {
                        *sum += term;
                    }
                }
            }
        }
        let [n, a, b, aa, bb, ab] = sums.map(|sum| sum as f64);
        let spread = (n * aa - a * a) * (n * bb - b * b);
        if spread > 0.0 { ((n * ab - a * b) / spread.sqrt()) as f32 } else { 0.0 }
    }
}
