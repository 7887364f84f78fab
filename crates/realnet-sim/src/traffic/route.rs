//! Paths to drive along.

use crate::perception::Random;
use rand::RngExt;
use realnet_core::Pose2;
use realnet_core::nalgebra::Vector2;
use std::f64::consts::PI;

/// From pose to pose of a route's table, metres.
const SPACING: f64 = 0.01;

/// A path by its length: curvature is continuous, in straight lines over the length
/// (clothoids, arcs and straights), so a car can follow it exactly. Before its start
/// and behind its end it goes on straight.
///
/// Built up piece by piece from its start. Lengths are in metres; curvatures in 1/m,
/// positive to the left; angles in radians.
///
/// ```
/// use realnet_core::Pose2;
/// use realnet_sim::traffic::Route;
///
/// // to the right about a quarter of a circle of 1 m
/// let route = Route::new(Pose2::IDENTITY).straight(2.0).turn(-1.0, 1.57, 0.3).straight(1.0);
/// assert!((route.pose(route.length()).heading + 1.57).abs() < 1e-9);
/// assert_eq!(route.curvature(1.0), 0.0);
/// assert_eq!(route.curvature(2.5), -1.0);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// Length until there, the curvature there and the angle turned until there.
    bends: Vec<[f64; 3]>,
    /// Every [`SPACING`], from the start on.
    poses: Vec<Pose2>,
}

impl Route {
    /// A path that starts here, straight.
    #[must_use]
    pub fn new(start: Pose2) -> Self {
        Self { bends: vec![[0.0; 3]], poses: vec![start] }
    }

    /// Length of what it was built up from, metres.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.bends.last().map_or(0.0, |bend| bend[0])
    }

    /// Goes on for `length` while the curvature changes to `curvature`.
    #[must_use]
    pub fn ease(mut self, curvature: f64, length: f64) -> Self {
        if length > 0.0 && length < 1e4 && curvature.is_finite() {
            let [start, before, turned] = self.bends.last().copied().unwrap_or_default();
            let end = start + length;
            self.bends.push([end, curvature, turned + 0.5 * (before + curvature) * length]);
            while let Some(&last) = self.poses.last() {
                let from = (self.poses.len() - 1) as f64 * SPACING;
                if from + SPACING > end {
                    break;
                }
                self.poses.push(self.on(last, from, SPACING));
            }
        }
        self
    }

    /// Goes straight on.
    #[must_use]
    pub fn straight(self, length: f64) -> Self {
        self.ease(0.0, length)
    }

    /// Turns by `angle` (its size counts) at a curvature that sets in and out over
    /// `ease` metres each (0.01 at least), less where the turn is too short for that.
    #[must_use]
    pub fn turn(self, curvature: f64, angle: f64, ease: f64) -> Self {
        let whole = (angle / curvature).abs();
        let ease = ease.max(SPACING).min(whole);
        self.ease(curvature, ease).ease(curvature, whole - ease).ease(0.0, ease)
    }

    /// Half a wave of curvature, of this peak.
    fn lobe(self, peak: f64, length: f64) -> Self {
        let parts = 12;
        (1..=parts).fold(self, |route, part| {
            let phase = PI * f64::from(part) / f64::from(parts);
            route.ease(peak * phase.sin(), length / f64::from(parts))
        })
    }

    /// A slalom: `waves` times over to the left (to the right if `peak` is negative)
    /// and back within `length` each. The curvature goes up to `peak`.
    #[must_use]
    pub fn slalom(self, peak: f64, length: f64, waves: u32) -> Self {
        // Half a bend first and half a bend last keep the heading around 0.
        let middle = (1..2 * waves).fold(self.lobe(0.5 * peak, 0.5 * length), |route, index| {
            let side = if index % 2 == 0 { peak } else { -peak };
            route.lobe(side, 0.5 * length)
        });
        middle.lobe(0.5 * peak, 0.5 * length)
    }

    /// Moves over to the left by `offset` (to the right if negative) within `length`.
    #[must_use]
    pub fn lane_change(self, offset: f64, length: f64) -> Self {
        // The offset of a full sine wave of curvature, for small headings.
        let peak = 2.0 * PI * offset / (length * length);
        self.lobe(peak, 0.5 * length).lobe(-peak, 0.5 * length)
    }

    /// Wanders about at random for `length`, with curvatures up to `peak`, within
    /// about `radius` of `middle`.
    #[must_use]
    pub fn wander(
        self,
        random: &mut Random,
        length: f64,
        peak: f64,
        middle: Vector2<f64>,
        radius: f64,
    ) -> Self {
        let until = self.length() + length;
        let mut route = self;
        while route.length() < until {
            let pose = route.pose(route.length());
            let home = pose.inverse().transform_point(&middle);
            let away = home.norm() / radius.max(0.1);
            let lot = peak * (2.0 * random.random::<f64>() - 1.0);
            // The farther out, the more it turns to where it came from.
            let back = peak * home.y.atan2(home.x).clamp(-1.0, 1.0);
            let share = (away - 0.4).clamp(0.0, 1.0);
            let piece = 0.4 + 0.5 * random.random::<f64>();
            route = route.ease((1.0 - share) * lot + share * back, piece);
        }
        route.ease(0.0, 0.4)
    }

    /// Angle turned until a length.
    fn turned(&self, at: f64) -> f64 {
        let (before, next) = self.around(at);
        match (before, next) {
            (Some([from, start, turned]), Some([to, end, _])) => {
                let along = at - from;
                turned + along * (start + 0.5 * (end - start) * along / (to - from))
            }
            (Some([.., turned]), None) => *turned,
            (None, _) => 0.0,
        }
    }

    /// The pose `length` behind one at `at`: a clothoid this short is an arc of its
    /// mean curvature, to 1e-7 m.
    fn on(&self, pose: Pose2, at: f64, length: f64) -> Pose2 {
        pose.driven(length, self.turned(at + length) - self.turned(at), 1.0)
    }

    fn around(&self, at: f64) -> (Option<&[f64; 3]>, Option<&[f64; 3]>) {
        let next = self.bends.partition_point(|bend| bend[0] <= at);
        (next.checked_sub(1).and_then(|index| self.bends.get(index)), self.bends.get(next))
    }

    /// Curvature at a length, 1/m; 0 before the start and behind the end.
    #[must_use]
    pub fn curvature(&self, at: f64) -> f64 {
        match self.around(at) {
            (Some([from, start, _]), Some([to, end, _])) => {
                start + (end - start) * (at - from) / (to - from)
            }
            _ => 0.0,
        }
    }

    /// Pose at a length: x along the path. Less than 0 is before the start.
    #[must_use]
    pub fn pose(&self, at: f64) -> Pose2 {
        let within = at.clamp(0.0, self.length());
        let index = ((within / SPACING) as usize).min(self.poses.len().saturating_sub(1));
        let from = self.poses.get(index).copied().unwrap_or_default();
        let start = index as f64 * SPACING;
        self.on(from, start, within - start).driven(1.0, 0.0, at - within)
    }

    /// How far a point is from the part of the path between two lengths, metres,
    /// positive: left of it. Where the path is nearest, its length, comes second.
    #[must_use]
    pub fn lateral(&self, point: &Vector2<f64>, from: f64, until: f64) -> (f64, f64) {
        let (from, until) = (from.min(until), from.max(until));
        let distance = |at: f64| (self.pose(at).position() - point).norm();
        let steps = (((until - from) / (5.0 * SPACING)).ceil() as usize).max(1);
        let step = (until - from) / steps as f64;
        let (mut nearest, mut least) = (from, f64::INFINITY);
        for index in 0..=steps {
            let at = from + step * index as f64;
            let here = distance(at);
            if here < least {
                (nearest, least) = (at, here);
            }
        }
        // Along the tangent to the foot of the perpendicular; twice is enough.
        for _ in 0..3 {
            let ahead = self.pose(nearest).inverse().transform_point(point);
            nearest = (nearest + ahead.x).clamp(from, until);
        }
        (self.pose(nearest).inverse().transform_point(point).y, nearest)
    }

    /// Least and greatest coordinates of the path between two lengths, metres.
    #[must_use]
    pub fn bounds(&self, from: f64, until: f64) -> (Vector2<f64>, Vector2<f64>) {
        let steps = (((until - from) / 0.05).ceil() as usize).max(1);
        let start = self.pose(from).position();
        (0..=steps).fold((start, start), |(least, most), index| {
            let at = from + (until - from) * index as f64 / steps as f64;
            let here = self.pose(at).position();
            (least.inf(&here), most.sup(&here))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::random_stream;
    use proptest::prelude::*;

    #[test]
    fn a_circle_closes() {
        let route = Route::new(Pose2::new(1.0, 2.0, 0.3)).turn(1.25, 2.0 * PI, 0.0);
        assert!((route.length() - 2.0 * PI / 1.25 - 0.01).abs() < 1e-12);
        let (start, end) = (route.pose(0.0), route.pose(route.length()));
        assert!((start.position() - end.position()).norm() < 0.02);
        assert!((end.heading - start.heading - 2.0 * PI).abs() < 1e-9);
        let middle = start.transform_point(&Vector2::new(0.0, 0.8));
        for at in [0.7, 2.0, 4.4] {
            assert!(((route.pose(at).position() - middle).norm() - 0.8).abs() < 0.01);
            let (lateral, nearest) = route.lateral(&middle, at - 0.5, at + 0.5);
            assert!((lateral - 0.8).abs() < 0.01, "{lateral} at {nearest}");
        }
    }

    #[test]
    fn slaloms_and_lane_changes_end_in_their_direction() {
        let route = Route::new(Pose2::IDENTITY).slalom(0.8, 2.0, 3).straight(1.0);
        let end = route.pose(route.length());
        assert!(end.heading.abs() < 1e-9 && end.y.abs() < 0.02, "{end:?}");
        let (least, most) = route.bounds(0.0, route.length());
        assert!(most.y > 0.15 && least.y > -0.01, "{least:?} {most:?}");
        let end = Route::new(Pose2::IDENTITY).lane_change(0.5, 2.5).pose(2.5);
        assert!(end.heading.abs() < 1e-9 && (end.y - 0.5).abs() < 0.05, "{end:?}");
    }

    #[test]
    fn lateral_is_positive_on_the_left() {
        let route = Route::new(Pose2::new(0.0, 0.0, PI / 2.0)).straight(3.0);
        let (left, at) = route.lateral(&Vector2::new(-0.3, 1.234), 0.0, 3.0);
        assert!((left - 0.3).abs() < 1e-9 && (at - 1.234).abs() < 1e-9);
        // behind the start the path goes on straight
        let (right, at) = route.lateral(&Vector2::new(0.2, -1.0), -2.0, 3.0);
        assert!((right + 0.2).abs() < 1e-9 && (at + 1.0).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn a_path_has_no_jumps_and_the_curvature_that_it_says(
            seed in any::<u64>(), at in -1.0..12.0f64,
        ) {
            let mut random = random_stream(seed, "test");
            let route = Route::new(Pose2::new(0.0, 0.0, 1.0)).wander(
                &mut random, 10.0, 1.2, Vector2::zeros(), 2.5,
            );
            let step = 1e-4;
            let (here, there) = (route.pose(at), route.pose(at + step));
            prop_assert!(((there.position() - here.position()).norm() - step).abs() < 1e-6);
            let turned = (there.heading - here.heading) / step;
            prop_assert!((turned - route.curvature(at)).abs() < 1e-3, "{turned}");
            prop_assert!(route.curvature(at).abs() <= 1.2);
            let (least, most) = route.bounds(0.0, route.length());
            // Out at 2.5 m, it comes back on a circle of 0.83 m that it has to ease into.
            prop_assert!(least.min() > -5.5 && most.max() < 5.5, "{least:?} {most:?}");
        }
    }
}
