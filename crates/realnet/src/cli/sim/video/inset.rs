//! The small view from above in a corner of the video.

use realnet::Frame;
use realnet_core::nalgebra::Vector2;
use realnet_core::{PixelFormat, Pose2};
use realnet_sim::{FrameLog, RunLog, VehicleKind};

const OWN: [u8; 3] = [86, 180, 233];
const OTHER: [u8; 3] = [170; 3];
const RING: [u8; 3] = [110; 3];
/// Of the frame's height.
const SIZE: f64 = 0.38;
/// Where the follower is, from the top.
const NOSE: f64 = 0.78;
/// How long the tracks behind are, seconds.
const TRAIL_S: f64 = 8.0;

/// The follower and its surroundings at a moment of a run.
pub(super) struct Inset<'a> {
    run: &'a RunLog,
    index: usize,
    now: FrameLog,
}

impl<'a> Inset<'a> {
    pub(super) fn of(run: &'a RunLog, index: usize) -> Self {
        Self { run, index, now: run.frames.get(index).copied().unwrap_or_default() }
    }

    /// Draws it at the upper right; the target in this colour. A grey frame is left as
    /// it is, and so is one without room for it.
    pub(super) fn draw(&self, frame: &mut Frame, target_color: [u8; 3]) {
        let side = (f64::from(frame.height()) * SIZE).round();
        let margin = (side * 0.06).round();
        if frame.format() != PixelFormat::Rgb8
            || side < 24.0
            || side + margin > f64::from(frame.width())
        {
            return;
        }
        // The gap that is asked for fills half of the view, and a metre more is seen.
        let metres = (2.0 * self.run.desired_gap_m + 2.0).clamp(4.0, 40.0);
        let left = f64::from(frame.width()) - side - margin;
        let mut pad = Pad {
            frame,
            low: Vector2::new(left, margin),
            high: Vector2::new(left + side, margin + side),
            scale: side / metres,
            base_from_world: self.now.follower.inverse(),
        };
        pad.ground();
        for ring in 1..=(metres.floor() as i32) {
            pad.ring(f64::from(ring));
        }
        for (from, to) in self.run.walls.iter().zip(self.run.walls.iter().cycle().skip(1)) {
            pad.line(from, to, OTHER);
        }
        for body in &self.run.bodies {
            let pose = body.poses.get(self.index).or(body.poses.last());
            pad.polygon(&body.outline, pose.copied().unwrap_or_default(), OTHER);
        }
        let has_target = self.now.gap_m.is_finite();
        if has_target {
            self.trail(&mut pad, |frame| frame.target, target_color);
        }
        self.trail(&mut pad, |frame| frame.follower, OWN);
        let fallback = VehicleKind::TouringCar.size();
        let corners = |size: Option<realnet_sim::VehicleSize>| {
            size.unwrap_or(fallback).corners(&Pose2::IDENTITY)
        };
        if has_target {
            pad.polygon(&corners(self.run.target_size), self.now.target, target_color);
        }
        pad.polygon(&corners(self.run.follower_size), self.now.follower, OWN);
    }

    fn trail(&self, pad: &mut Pad<'_>, pose: impl Fn(&FrameLog) -> Pose2, color: [u8; 3]) {
        let frames = self.run.frames.get(..=self.index).unwrap_or_default();
        let recent = frames.iter().rev().take_while(|f| self.now.time_s - f.time_s <= TRAIL_S);
        let places: Vec<Vector2<f64>> = recent.step_by(5).map(|f| pose(f).position()).collect();
        for pair in places.windows(2) {
            if let [a, b] = pair {
                pad.line(a, b, color);
            }
        }
    }
}

/// The part of the frame that is drawn on.
struct Pad<'a> {
    frame: &'a mut Frame,
    low: Vector2<f64>,
    high: Vector2<f64>,
    /// Pixels a metre.
    scale: f64,
    base_from_world: Pose2,
}

impl Pad<'_> {
    /// Where a place of the world is, in pixels: the follower's nose is up.
    fn at(&self, place: &Vector2<f64>) -> Vector2<f64> {
        let base = self.base_from_world.transform_point(place);
        self.origin() + self.scale * Vector2::new(-base.y, -base.x)
    }

    fn origin(&self) -> Vector2<f64> {
        let size = self.high - self.low;
        self.low + Vector2::new(0.5 * size.x, NOSE * size.y)
    }

    fn ground(&mut self) {
        let (low, high) = (self.low, self.high);
        self.paint(low, high, [20, 24, 30], |_| 0.72);
    }

    /// A circle around the follower, metres.
    fn ring(&mut self, radius: f64) {
        let (origin, radius) = (self.origin(), radius * self.scale);
        let reach = Vector2::repeat(radius + 1.0);
        self.paint(origin - reach, origin + reach, RING, |p| {
            0.6 * (1.0 - ((p - origin).norm() - radius).abs())
        });
    }

    fn line(&mut self, a: &Vector2<f64>, b: &Vector2<f64>, color: [u8; 3]) {
        let (a, b) = (self.at(a), self.at(b));
        let along = b - a;
        let square = along.norm_squared().max(1e-9);
        let reach = Vector2::repeat(2.0);
        self.paint(a.inf(&b) - reach, a.sup(&b) + reach, color, |p| {
            let share = ((p - a).dot(&along) / square).clamp(0.0, 1.0);
            0.8 * (1.3 - (p - a - share * along).norm())
        });
    }

    /// A convex polygon in its own frame.
    fn polygon(&mut self, corners: &[Vector2<f64>], pose: Pose2, color: [u8; 3]) {
        let corners: Vec<_> = corners.iter().map(|c| self.at(&pose.transform_point(c))).collect();
        // Twice the area; its sign says which way around the corners go.
        let next = corners.iter().cycle().skip(1);
        let area: f64 = corners.iter().zip(next).map(|(a, b)| a.x * b.y - a.y * b.x).sum();
        let side = -area.signum();
        let (Some(first), Some(last)) = (corners.first().copied(), corners.last().copied()) else {
            return;
        };
        let low = corners.iter().fold(first, |low, corner| low.inf(corner));
        let high = corners.iter().fold(first, |high, corner| high.sup(corner));
        let reach = Vector2::repeat(1.0);
        self.paint(low - reach, high + reach, color, |p| {
            // How far it is outside of the edge that it is farthest outside of.
            let mut from = last;
            let mut outside = f64::NEG_INFINITY;
            for to in &corners {
                let edge = (to - from).try_normalize(1e-9).unwrap_or_default();
                outside = outside.max(side * (edge.x * (p - from).y - edge.y * (p - from).x));
                from = *to;
            }
            0.5 - outside
        });
    }

    /// Mixes a colour into the pixels between two corners, by a share that is limited
    /// to 0 to 1.
    fn paint(
        &mut self,
        low: Vector2<f64>,
        high: Vector2<f64>,
        color: [u8; 3],
        share: impl Fn(Vector2<f64>) -> f64,
    ) {
        let (low, high) = (low.sup(&self.low), high.inf(&self.high));
        if !(low.x < high.x && low.y < high.y) {
            return;
        }
        let (x0, x1) = (low.x.floor() as usize, high.x.ceil() as usize);
        let (y0, y1) = (low.y.floor() as usize, high.y.ceil() as usize);
        let stride = self.frame.stride();
        let rows = self.frame.data_mut().chunks_exact_mut(stride).enumerate();
        for (y, row) in rows.take(y1).skip(y0) {
            for (x, pixel) in row.chunks_exact_mut(3).enumerate().take(x1).skip(x0) {
                let share = share(Vector2::new(x as f64, y as f64)).clamp(0.0, 1.0);
                for (old, new) in pixel.iter_mut().zip(color) {
                    let mixed = f64::from(*old) * (1.0 - share) + f64::from(new) * share;
                    *old = mixed.round() as u8;
                }
            }
        }
    }
}
