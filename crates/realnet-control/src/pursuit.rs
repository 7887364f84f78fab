//! Which way to turn: pure pursuit.

use crate::OptionError;
use crate::check::{not_negative, positive};
use realnet_core::nalgebra::Vector2;

/// What pure pursuit pursues.
///
/// The law of the paper this project follows, `R = (d^2 - d0^2) / (2 x)` with lateral
/// offset `x`, distance `d` and desired distance `d0`, is the circle on which the robot
/// ends with the target straight ahead at the distance `d0`: the tangent from the target
/// to that circle has the length `d0`. It is right while a robot approaches a standing
/// target. It is singular at `d = d0`, which is where a follower spends its life: there
/// every lateral error asks for the full lock, and nearer than `d0` for the wrong side.
/// So it is on offer, with its denominator bounded from below, but not the default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum PursuitRule {
    /// The point of the target's own path on the look-ahead circle: the robot drives
    /// where the target drove and does not cut its corners. Where the trail is too short
    /// or broken, as [`PursuitRule::Target`].
    #[default]
    Trail,
    /// The target itself, `kappa = 2 y / d^2`: the arc that leads through it. Needs no
    /// trail; cuts corners.
    Target,
    /// The paper's law, `kappa = 2 y / (d^2 - d0^2)`, denominator at least the square of
    /// the least look-ahead distance.
    Tangent,
}

/// Options of pure pursuit. Distances are from the origin of the base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PursuitOptions {
    /// What is pursued.
    pub rule: PursuitRule,
    /// The look-ahead distance at standstill, metres: shorter cuts corners less, longer is
    /// calmer. It also bounds the denominator of every rule. With the defaults the loop
    /// stays well damped at 1.8 m/s when the vehicle's dead time is twice the one
    /// reckoned with; with 0.25 m and 0.2 s it does not.
    pub min_lookahead_m: f64,
    /// What the look-ahead distance grows by with the speed, seconds.
    pub lookahead_s: f64,
    /// The greatest look-ahead distance, metres.
    pub max_lookahead_m: f64,
    /// Points of the trail that are further apart are not one trail, metres: only what
    /// came after the jump is followed. The same from its newest point to the target.
    pub max_trail_jump_m: f64,
    /// Where the trail gives way to keeping the target in view; `None`: nowhere.
    pub view: Option<ViewLimit>,
    /// A differential drive turns on the spot towards the target, as fast as this times
    /// the bearing (1/s), the less the faster it drives.
    pub facing_gain: f64,
    /// At this speed and above it does not turn more than the path asks for, m/s.
    pub facing_until_m_s: f64,
}

impl Default for PursuitOptions {
    fn default() -> Self {
        Self {
            rule: PursuitRule::Trail,
            min_lookahead_m: 0.35,
            lookahead_s: 0.25,
            max_lookahead_m: 1.5,
            max_trail_jump_m: 0.5,
            view: None,
            facing_gain: 2.0,
            facing_until_m_s: 0.3,
        }
    }
}

impl PursuitOptions {
    pub(crate) fn check(&self) -> Result<(), OptionError> {
        let least = self.min_lookahead_m;
        OptionError::check(
            "pursuit.min_lookahead_m",
            least,
            (0.01..=1000.0).contains(&least),
            "at least 0.01 m, at most 1000 m",
        )?;
        not_negative("pursuit.lookahead_s", self.lookahead_s)?;
        OptionError::check(
            "pursuit.max_lookahead_m",
            self.max_lookahead_m,
            (least..=1000.0).contains(&self.max_lookahead_m),
            "at least min_lookahead_m, at most 1000 m",
        )?;
        positive("pursuit.max_trail_jump_m", self.max_trail_jump_m)?;
        self.view.as_ref().map_or(Ok(()), ViewLimit::check)?;
        not_negative("pursuit.facing_gain", self.facing_gain)?;
        positive("pursuit.facing_until_m_s", self.facing_until_m_s)
    }

    /// The look-ahead distance at a speed, metres.
    #[must_use]
    pub fn lookahead_m(&self, speed_m_s: f64) -> f64 {
        (self.min_lookahead_m + self.lookahead_s * speed_m_s.abs()).min(self.max_lookahead_m)
    }
}

/// What the camera sees: a target that leaves it is lost. On a bend of radius `R` a robot
/// that drives exactly where the target drove sees it, at the distance `d` along the bend,
/// under about `d / (2 R)`; a camera of 70 degrees loses it where `R < 0.8 d`. So the more
/// the target nears the edge of the picture, the more the robot cuts the bend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewLimit {
    /// The camera's place ahead of the origin of the base frame, metres.
    pub camera_forward_m: f64,
    /// Below this bearing of the target from the camera the trail alone is pursued,
    /// radians.
    pub from_rad: f64,
    /// From this bearing on the target alone is, radians.
    pub until_rad: f64,
}

impl ViewLimit {
    /// Share of the target itself in what is pursued, 0 to 1.
    fn share(&self, target: &Vector2<f64>) -> f64 {
        let bearing = target.y.atan2(target.x - self.camera_forward_m).abs();
        ((bearing - self.from_rad) / (self.until_rad - self.from_rad)).clamp(0.0, 1.0)
    }

    fn check(&self) -> Result<(), OptionError> {
        not_negative("pursuit.view.camera_forward_m", self.camera_forward_m)?;
        not_negative("pursuit.view.from_rad", self.from_rad)?;
        OptionError::check(
            "pursuit.view.until_rad",
            self.until_rad,
            self.until_rad > self.from_rad && self.until_rad.is_finite(),
            "above pursuit.view.from_rad",
        )
    }
}

/// The point that is pursued.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aim {
    /// In the base frame, metres.
    pub point: Vector2<f64>,
    /// Whether it is of the trail; otherwise it is the target.
    pub on_trail: bool,
    /// The curvature that leads there, 1/m, positive to the left. Not yet limited to
    /// what the vehicle can do.
    pub curvature: f64,
}

/// Where to steer, and by which curvature. `distance_m` is the desired distance of the
/// target from the origin of the base frame (used by [`PursuitRule::Tangent`] alone).
/// All numbers must be finite.
#[must_use]
pub fn aim(
    options: &PursuitOptions,
    target: &Vector2<f64>,
    trail: &[Vector2<f64>],
    speed_m_s: f64,
    distance_m: f64,
) -> Aim {
    let least = options.min_lookahead_m;
    let on_trail = match options.rule {
        PursuitRule::Trail => {
            trail_point(target, trail, options.lookahead_m(speed_m_s), options.max_trail_jump_m)
        }
        PursuitRule::Target | PursuitRule::Tangent => None,
    };
    let point = on_trail.unwrap_or(*target);
    let curvature = match options.rule {
        PursuitRule::Tangent => {
            let power = point.norm_squared() - distance_m * distance_m;
            2.0 * point.y / power.max(least * least)
        }
        PursuitRule::Trail | PursuitRule::Target => {
            let share = options.view.map_or(0.0, |view| view.share(target));
            (1.0 - share) * curvature_to(&point, least) + share * curvature_to(target, least)
        }
    };
    Aim { point, on_trail: on_trail.is_some(), curvature }
}

/// The arc through a point, `2 y / d^2 = 2 sin(bearing) / d`, with `d` no less than
/// `least`. A point behind asks for as much as one abeam: the arc through a point
/// straight behind would be a straight line forward.
fn curvature_to(point: &Vector2<f64>, least: f64) -> f64 {
    let distance = point.norm();
    if distance < 1e-9 {
        return 0.0;
    }
    let sine = if point.x >= 0.0 { point.y / distance } else { 1.0_f64.copysign(point.y) };
    2.0 * sine / distance.max(least)
}

/// The point of the path (trail, then target) where it leaves the circle of the
/// look-ahead distance around the origin, searched from the path's nearest point
/// onwards. `None` when there is no usable trail or the path ends within the circle.
fn trail_point(
    target: &Vector2<f64>,
    trail: &[Vector2<f64>],
    lookahead: f64,
    max_jump: f64,
) -> Option<Vector2<f64>> {
    let trail = unbroken(target, trail, max_jump);
    let path = || trail.iter().chain(std::iter::once(target));
    let segments = || path().zip(path().skip(1));
    // the nearest point of the path: the origin is at 0
    let nearest = |(from, to): (&Vector2<f64>, &Vector2<f64>)| {
        let along = to - from;
        let length2 = along.norm_squared();
        let t = if length2 > 1e-12 { (-from.dot(&along) / length2).clamp(0.0, 1.0) } else { 0.0 };
        (from + along * t).norm_squared()
    };
    let (index, distance2) =
        segments().map(nearest).enumerate().min_by(|(_, a), (_, b)| a.total_cmp(b))?;
    // Far from the path, aim at it at half a right angle rather than straight across.
    let radius2 = (lookahead * lookahead).max(2.0 * distance2);
    let (from, to) = segments().skip(index).find(|(_, to)| to.norm_squared() >= radius2)?;
    // |from + t along| = radius, the larger root: where the path leaves the circle
    let along = to - from;
    let (a, half_b) = (along.norm_squared(), from.dot(&along));
    let c = from.norm_squared() - radius2;
    let root = (half_b * half_b - a * c).max(0.0).sqrt();
    let t = if a > 1e-12 { ((root - half_b) / a).clamp(0.0, 1.0) } else { 1.0 };
    Some(from + along * t)
}

/// The newest part of the trail without a jump, on to the target; empty when the
/// target is not at its end.
fn unbroken<'a>(
    target: &Vector2<f64>,
    trail: &'a [Vector2<f64>],
    max_jump: f64,
) -> &'a [Vector2<f64>] {
    let mut next = target;
    let mut start = trail.len();
    for point in trail.iter().rev() {
        if (next - point).norm_squared() > max_jump * max_jump {
            break;
        }
        start -= 1;
        next = point;
    }
    trail.get(start..).unwrap_or(&[])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realnet_core::Pose2;

    fn options(rule: PursuitRule) -> PursuitOptions {
        PursuitOptions { rule, ..PursuitOptions::default() }
    }

    fn points(points: &[(f64, f64)]) -> Vec<Vector2<f64>> {
        points.iter().map(|(x, y)| Vector2::new(*x, *y)).collect()
    }

    /// After an arc of a curvature and a length.
    fn driven(curvature: f64, length: f64) -> Pose2 {
        Pose2::IDENTITY.driven(1.0, curvature, length)
    }

    proptest! {
        #[test]
        fn the_arc_to_the_target_leads_through_it(x in 0.4..5.0f64, y in -3.0..3.0f64) {
            let target = Vector2::new(x, y);
            let aim = aim(&options(PursuitRule::Target), &target, &[], 0.5, 1.0);
            let turn = 2.0 * y.atan2(x);
            let length = if turn.abs() < 1e-6 { x } else { turn / aim.curvature };
            let end = driven(aim.curvature, length);
            prop_assert!((end.position() - target).norm() < 1e-9);
        }

        /// What the paper's law means: where the circle's tangent leads to the target, its
        /// distance is the desired one.
        #[test]
        fn the_papers_arc_ends_with_the_target_straight_ahead(
            x in 1.5..5.0f64, y in -2.0..2.0f64, desired in 0.5..1.4f64,
        ) {
            let target = Vector2::new(x, y);
            let aim = aim(&options(PursuitRule::Tangent), &target, &[], 0.5, desired);
            prop_assume!(y.abs() > 1e-3);
            // target = centre + R (sin t, -cos t) + d0 (cos t, sin t) after the turn t
            let radius = 1.0 / aim.curvature;
            let turn = (y - radius).atan2(x) + radius.atan2(desired);
            let length = (turn * radius).rem_euclid(std::f64::consts::TAU * radius.abs());
            let end = driven(aim.curvature, length).inverse().transform_point(&target);
            prop_assert!((end - Vector2::new(desired, 0.0)).norm() < 1e-6, "{end}");
        }

        #[test]
        fn left_and_right_are_the_same(
            x in -3.0..3.0f64, y in -3.0..3.0f64, bend in -0.3..0.3f64, speed in 0.0..2.0f64,
        ) {
            for rule in [PursuitRule::Trail, PursuitRule::Target, PursuitRule::Tangent] {
                let side = |sign: f64| {
                    let target = Vector2::new(x, sign * y);
                    let trail: Vec<_> = (0..20)
                        .map(|i| {
                            let back = 0.1 * f64::from(20 - i);
                            Vector2::new(x - back, sign * (y + bend * back * back))
                        })
                        .collect();
                    aim(&options(rule), &target, &trail, speed, 1.34)
                };
                let (left, right) = (side(1.0), side(-1.0));
                prop_assert!((left.curvature + right.curvature).abs() < 1e-9);
                prop_assert_eq!(left.on_trail, right.on_trail);
            }
        }

        /// The point lies on the trail and on the circle.
        #[test]
        fn the_trail_is_cut_by_the_look_ahead_circle(
            bend in -0.5..0.5f64, aside in -0.2..0.2f64, speed in 0.0..2.0f64, back in 0.0..1.0f64,
        ) {
            let shape = |x: f64| Vector2::new(x, aside + bend * x * x);
            let trail: Vec<_> = (0..60).map(|i| shape(0.05 * f64::from(i) - back)).collect();
            let target = shape(2.0);
            let options = PursuitOptions { max_trail_jump_m: 3.0, ..PursuitOptions::default() };
            let aim = aim(&options, &target, &trail, speed, 1.34);
            prop_assert!(aim.on_trail);
            let distance = aim.point.norm();
            prop_assert!((distance - options.lookahead_m(speed)).abs() < 1e-9, "{distance}");
            // chords of 5 cm of a curve
            prop_assert!((aim.point - shape(aim.point.x)).norm() < 1e-3);
            prop_assert!(aim.point.x > 0.0);
        }
    }

    #[test]
    fn the_trail_begins_ahead_or_aside() {
        let options = options(PursuitRule::Trail);
        // It begins 0.8 m ahead: on to a point of it, a little further than its begin.
        let trail = points(&[(0.8, 0.1), (1.0, 0.1), (1.2, 0.1)]);
        let ahead = aim(&options, &Vector2::new(1.4, 0.1), &trail, 0.0, 1.34);
        assert!(ahead.on_trail && ahead.point.x > 0.8 && ahead.point.x < 1.2, "{ahead:?}");
        // It runs past, 2 m to the left: towards it by 45 degrees, not straight across.
        let trail: Vec<_> = (0..60).map(|i| Vector2::new(0.1 * f64::from(i) - 1.0, 2.0)).collect();
        let aside = aim(&options, &Vector2::new(5.0, 2.0), &trail, 0.0, 1.34);
        assert!(aside.on_trail && (aside.point - Vector2::new(2.0, 2.0)).norm() < 1e-9);
    }

    #[test]
    fn what_is_behind_is_no_aim() {
        // The trail comes from behind, passes the robot and leads on.
        let trail: Vec<_> = (0..60).map(|i| Vector2::new(0.05 * f64::from(i) - 2.0, 0.1)).collect();
        let aim = aim(&options(PursuitRule::Trail), &Vector2::new(1.0, 0.1), &trail, 0.0, 1.34);
        assert!(aim.on_trail && aim.point.x > 0.3);
    }

    #[test]
    fn short_and_broken_trails_fall_back_to_the_target() {
        let options = options(PursuitRule::Trail);
        let target = Vector2::new(1.3, 0.2);
        let direct = curvature_to(&target, options.min_lookahead_m);
        let far = points(&[(5.0, 5.0), (5.2, 5.2)]);
        for trail in [&[][..], &far] {
            let aim = aim(&options, &target, trail, 0.5, 1.34);
            assert!(!aim.on_trail);
            assert_eq!((aim.point, aim.curvature), (target, direct));
        }
        // Of a trail with a jump only the newer part counts.
        let jumps = points(&[(0.2, -0.1), (0.4, -0.1), (0.6, 0.5), (0.8, 0.5), (1.0, 0.4)]);
        let jump = PursuitOptions { max_trail_jump_m: 0.4, ..options };
        let aim = aim(&jump, &target, &jumps, 0.0, 1.34);
        assert!(aim.on_trail && aim.point.y > 0.3, "{aim:?}");
    }

    #[test]
    fn every_place_of_the_target_has_a_finite_curvature() {
        for rule in [PursuitRule::Trail, PursuitRule::Target, PursuitRule::Tangent] {
            for (x, y) in
                [(0.0, 0.0), (1.34, 0.0), (1.34, 1e-12), (-1.0, 0.0), (-1.0, 0.1), (0.0, 1.0)]
            {
                let target = Vector2::new(x, y);
                let again = [target; 4];
                let aim = aim(&options(rule), &target, &again, 0.0, 1.34);
                assert!(aim.curvature.abs() <= 2.0 * 1.35 / 0.35_f64.powi(2), "{rule:?} {aim:?}");
            }
        }
        // A target behind is turned to as hard as one abeam.
        let behind = aim(&options(PursuitRule::Target), &Vector2::new(-1.0, 0.01), &[], 0.0, 1.0);
        assert!((behind.curvature - 2.0).abs() < 1e-3);
    }
}
