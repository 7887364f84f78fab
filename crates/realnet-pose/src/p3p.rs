//! Three points: Lambda Twist's pencil of conics with the line pair taken from
//! the adjugate.
//!
//! With unit bearings `y_i`, unknown distances `l_i > 0` and `a_ij = |X_i -
//! X_j|^2` the law of cosines reads (Persson and Nordberg, "Lambda Twist: An
//! Accurate Fast Robust Perspective Three Point (P3P) Solver", ECCV 2018, eq. 3
//! to 5)
//!
//! ```text
//! l_i^2 + l_j^2 - 2 (y_i . y_j) l_i l_j = a_ij,   short  L^T M_ij L = a_ij
//! ```
//!
//! Two combinations free of constants, `D1 = a23 M12 - a12 M23` and `D2 = a23
//! M13 - a13 M23`, are conics through the (up to four) solutions (their eq. 6 to
//! 9). A member `D0 = D1 + g D2` with `det D0 = 0`, a cubic in `g`, is a pair of
//! lines. Its lines are read off without an eigenvalue: for `D0 = l m^T + m l^T`
//! the adjugate is `-(l x m)(l x m)^T`, and `D0 + [l x m]_x = 2 l m^T` up to the
//! order of the two (Ding, Yang, Larsson, Olsson and Astrom, "Revisiting the P3P
//! Problem", CVPR 2023, section 3). Each line meets another member of the pencil
//! in two points. Distances are then polished on the three equations by Newton's
//! method (Lambda Twist, section 3.8), and the rotation is that between the
//! orthonormal frames of the two triangles.

use crate::geometry::Rt;
use realnet_core::Pose;
use realnet_core::nalgebra::{Matrix3, Point3, Unit, Vector3};
use std::ops::Deref;

/// Triangles with less than this `2 area / longest side^2` have no pose.
const SLIVER: f64 = 1e-6;
/// Bearings closer than this (sine of the angle) are the same.
const SAME_BEARING: f64 = 1e-9;
/// Largest error of a distance equation, in units of the longest side squared.
const RESIDUAL: f64 = 1e-9;

/// The poses of a P3P problem: a list of at most four, in fixed space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct P3pPoses {
    poses: [Pose; 4],
    len: usize,
}

impl Deref for P3pPoses {
    type Target = [Pose];

    fn deref(&self) -> &[Pose] {
        self.poses.get(..self.len).unwrap_or_default()
    }
}

/// All poses `camera_from_world` that put three `points` (world, metres) on
/// their `bearings` (unit vectors in the camera's frame), in front of the
/// camera. For the fourth point that tells the right one, see
/// [`PnpSolver::solve`](crate::PnpSolver::solve).
///
/// Empty when no such pose exists, and for degenerate input: collinear or
/// coincident points (twice the area below 1e-6 of the longest side squared),
/// equal bearings, values that are not finite.
///
/// ```
/// use realnet_core::nalgebra::{Point3, Unit, Vector3};
///
/// let points = [[1.0, 0.0, 5.0], [0.0, 1.0, 6.0], [-1.0, -0.5, 4.0]].map(Point3::from);
/// let poses = realnet_pose::p3p(&points, &points.map(|p| Unit::new_normalize(p.coords)));
/// assert!(poses.iter().any(|pose| pose.translation_norm() < 1e-9));
/// ```
#[must_use]
pub fn p3p(points: &[Point3<f64>; 3], bearings: &[Unit<Vector3<f64>>; 3]) -> P3pPoses {
    let mut raw = [Rt::identity(); 4];
    let len = solve(points, &bearings.map(Unit::into_inner), &mut raw);
    P3pPoses { poses: raw.map(Rt::to_pose), len }
}

/// A symmetric 3x3 matrix.
#[derive(Clone, Copy)]
struct Sym {
    xx: f64,
    xy: f64,
    xz: f64,
    yy: f64,
    yz: f64,
    zz: f64,
}

impl Sym {
    fn adjugate(&self) -> Self {
        Self {
            xx: self.yy * self.zz - self.yz * self.yz,
            xy: self.xz * self.yz - self.xy * self.zz,
            xz: self.xy * self.yz - self.xz * self.yy,
            yy: self.xx * self.zz - self.xz * self.xz,
            yz: self.xy * self.xz - self.xx * self.yz,
            zz: self.xx * self.yy - self.xy * self.xy,
        }
    }

    /// Trace of the product.
    fn dot(&self, b: &Self) -> f64 {
        self.xx * b.xx
            + self.yy * b.yy
            + self.zz * b.zz
            + 2.0 * (self.xy * b.xy + self.xz * b.xz + self.yz * b.yz)
    }

    fn add_scaled(&self, s: f64, b: &Self) -> Self {
        Self {
            xx: self.xx + s * b.xx,
            xy: self.xy + s * b.xy,
            xz: self.xz + s * b.xz,
            yy: self.yy + s * b.yy,
            yz: self.yz + s * b.yz,
            zz: self.zz + s * b.zz,
        }
    }
}

/// The law of cosines of the three pairs: cosines and squared sides.
struct Sides {
    b12: f64,
    b13: f64,
    b23: f64,
    a12: f64,
    a13: f64,
    a23: f64,
}

pub(crate) fn solve(
    points: &[Point3<f64>; 3],
    bearings: &[Vector3<f64>; 3],
    out: &mut [Rt; 4],
) -> usize {
    let [x1, x2, x3] = points;
    let [y1, y2, y3] = bearings;
    let (d12, d13, d23) = (x2 - x1, x3 - x1, x3 - x2);
    let (a12, a13, a23) = (d12.norm_squared(), d13.norm_squared(), d23.norm_squared());
    let unit = a12.max(a13).max(a23);
    let normal = d12.cross(&d13);
    // Written so that not-a-number leaves here.
    if !(unit > 0.0 && normal.norm() > SLIVER * unit && unit.is_finite()) {
        return 0;
    }
    let same = |a: &Vector3<f64>, b: &Vector3<f64>| {
        a.cross(b).norm_squared() < SAME_BEARING * SAME_BEARING
    };
    if same(y1, y2) || same(y1, y3) || same(y2, y3) {
        return 0;
    }
    let sides = Sides {
        b12: y1.dot(y2),
        b13: y1.dot(y3),
        b23: y2.dot(y3),
        a12: a12 / unit,
        a13: a13 / unit,
        a23: a23 / unit,
    };
    let world = frame(&d12, &normal);
    let world_mean = (x1.coords + x2.coords + x3.coords) / 3.0;
    let length = unit.sqrt();
    let mut found = 0;
    sides.each_solution(|l| {
        let Some(slot) = out.get_mut(found) else { return };
        let (p1, p2, p3) = (y1 * (l.x * length), y2 * (l.y * length), y3 * (l.z * length));
        let q12 = p2 - p1;
        let r = frame(&q12, &q12.cross(&(p3 - p1))) * world.transpose();
        let t = (p1 + p2 + p3) / 3.0 - r * world_mean;
        if r.iter().chain(t.iter()).all(|value| value.is_finite()) {
            *slot = Rt { r, t };
            found += 1;
        }
    });
    found
}

/// The orthonormal frame of a triangle from a side and its normal.
fn frame(side: &Vector3<f64>, normal: &Vector3<f64>) -> Matrix3<f64> {
    let e1 = side / side.norm();
    let e3 = normal / normal.norm();
    Matrix3::from_columns(&[e1, e3.cross(&e1), e3])
}

impl Sides {
    fn each_solution(&self, mut found: impl FnMut(Vector3<f64>)) {
        let &Self { b12, b13, b23, a12, a13, a23 } = self;
        let mut d1 =
            Sym { xx: a23, xy: -a23 * b12, xz: 0.0, yy: a23 - a12, yz: a12 * b23, zz: -a12 };
        let mut d2 =
            Sym { xx: a23, xy: 0.0, xz: -a23 * b13, yy: -a13, yz: a13 * b23, zz: a23 - a13 };
        let (mut adj1, mut adj2) = (d1.adjugate(), d2.adjugate());
        // det(D1 + g D2) = c3 g^3 + c2 g^2 + c1 g + c0. The trace of adj(D) D is
        // three times the determinant.
        let (det1, det2) = (adj1.dot(&d1) / 3.0, adj2.dot(&d2) / 3.0);
        if det1.abs() > det2.abs() {
            // The other way round, so that the leading coefficient is not small.
            std::mem::swap(&mut d1, &mut d2);
            std::mem::swap(&mut adj1, &mut adj2);
        }
        let (c0, c3) = if det1.abs() > det2.abs() { (det2, det1) } else { (det1, det2) };
        let (c2, c1) = (adj2.dot(&d1), adj1.dot(&d2));
        let g = if c3 == 0.0 { 0.0 } else { simple_root(c2 / c3, c1 / c3, c0 / c3) };
        let pair = d1.add_scaled(g, &d2);
        // The member of the pencil least like the pair.
        let conic = if g.abs() > 1.0 { d1 } else { d2 };
        let Some(lines) = split(&pair) else { return };
        for line in lines {
            for direction in meet(&line, &conic).into_iter().flatten() {
                if let Some(l) = self.distances(direction) {
                    found(l);
                }
            }
        }
    }

    /// From a direction of `(l1, l2, l3)` to its length, polished.
    fn distances(&self, direction: Vector3<f64>) -> Option<Vector3<f64>> {
        let &Self { b12, b13, b23, a12, a13, a23 } = self;
        // Not-a-number leaves here too.
        let direction = if direction.x < 0.0 { -direction } else { direction };
        if !(direction.x > 0.0 && direction.y > 0.0 && direction.z > 0.0) {
            return None;
        }
        let law = |p: f64, q: f64, b: f64| p * p + q * q - 2.0 * b * p * q;
        let (x, y, z) = (direction.x, direction.y, direction.z);
        let total = law(x, y, b12) + law(x, z, b13) + law(y, z, b23);
        let mut l = direction * ((a12 + a13 + a23) / total).sqrt();
        let error = |l: &Vector3<f64>| {
            Vector3::new(
                law(l.x, l.y, b12) - a12,
                law(l.x, l.z, b13) - a13,
                law(l.y, l.z, b23) - a23,
            )
        };
        let mut e = error(&l);
        for _ in 0..4 {
            if e.amax() < 4.0 * f64::EPSILON {
                break;
            }
            // Half the Jacobian is [a b 0; c 0 d; 0 e f].
            let (ja, jb) = (l.x - b12 * l.y, l.y - b12 * l.x);
            let (jc, jd) = (l.x - b13 * l.z, l.z - b13 * l.x);
            let (je, jf) = (l.y - b23 * l.z, l.z - b23 * l.y);
            let determinant = -ja * jd * je - jb * jc * jf;
            let cross = e.y * jf - jd * e.z;
            let step = Vector3::new(
                -e.x * jd * je - jb * cross,
                ja * cross - e.x * jc * jf,
                jc * je * e.x - ja * je * e.y - jb * jc * e.z,
            ) * (0.5 / determinant);
            let next = l - step;
            let next_error = error(&next);
            // At a double solution the step may lead away.
            if !(next_error.amax() < e.amax()) {
                break;
            }
            l = next;
            e = next_error;
        }
        (e.amax() < RESIDUAL && l.min() > 0.0).then_some(l)
    }
}

/// A real root of `x^3 + a x^2 + b x + c`, the one furthest from the inflection:
/// it is never a double root unless all three are one.
fn simple_root(a: f64, b: f64, c: f64) -> f64 {
    let shift = a / 3.0;
    // x = t - a / 3: t^3 + p t + q. For q < 0 the root sought is the largest,
    // which is positive; otherwise the mirror image.
    let p = b - a * shift;
    let q = c + shift * (2.0 * shift * shift - b);
    let (sign, q) = if q > 0.0 { (-1.0, -q) } else { (1.0, q) };
    // Above the root, from where Newton's method falls without overshooting:
    // f(t) >= 0 there and f is convex.
    let mut t = (-p).max(0.0).sqrt() + (-q).cbrt();
    for _ in 0..50 {
        let slope = 3.0 * t * t + p;
        if slope <= 0.0 {
            break;
        }
        let step = ((t * t + p) * t + q) / slope;
        t -= step;
        if step <= 4.0 * f64::EPSILON * t.abs() {
            break;
        }
    }
    sign * t - shift
}

/// The two lines of a symmetric matrix of rank 2, none when they are not real.
fn split(pair: &Sym) -> Option<[Vector3<f64>; 2]> {
    let adjugate = pair.adjugate();
    let scale = pair.dot(pair);
    let diagonal = [-adjugate.xx, -adjugate.yy, -adjugate.zz];
    let largest = diagonal[0].max(diagonal[1]).max(diagonal[2]);
    let crossing = if largest > 1e-14 * scale {
        let root = largest.sqrt();
        if largest == diagonal[0] {
            Vector3::new(root, -adjugate.xy / root, -adjugate.xz / root)
        } else if largest == diagonal[1] {
            Vector3::new(-adjugate.xy / root, root, -adjugate.yz / root)
        } else {
            Vector3::new(-adjugate.xz / root, -adjugate.yz / root, root)
        }
    } else if adjugate.xx.max(adjugate.yy).max(adjugate.zz) > 1e-10 * scale {
        // The lines are complex: no real solution.
        return None;
    } else {
        // One line twice.
        Vector3::zeros()
    };
    let (x, y, z) = (crossing.x, crossing.y, crossing.z);
    let product = Matrix3::new(
        pair.xx,
        pair.xy - z,
        pair.xz + y,
        pair.xy + z,
        pair.yy,
        pair.yz - x,
        pair.xz - y,
        pair.yz + x,
        pair.zz,
    );
    let (row, column) = product.iamax_full();
    Some([product.column(column).into_owned(), product.row(row).transpose()])
}

/// Where a line meets a conic, up to scale.
fn meet(line: &Vector3<f64>, conic: &Sym) -> [Option<Vector3<f64>>; 2] {
    // Coordinates turned so that the largest entry of the line comes last.
    let (k, l, q) = match line.iamax() {
        0 => {
            let q = Sym {
                xx: conic.yy,
                xy: conic.yz,
                xz: conic.xy,
                yy: conic.zz,
                yz: conic.xz,
                zz: conic.xx,
            };
            (0, Vector3::new(line.y, line.z, line.x), q)
        }
        1 => {
            let q = Sym {
                xx: conic.zz,
                xy: conic.xz,
                xz: conic.yz,
                yy: conic.xx,
                yz: conic.xy,
                zz: conic.yy,
            };
            (1, Vector3::new(line.z, line.x, line.y), q)
        }
        _ => (2, *line, *conic),
    };
    // On the line z = s x + t y; the conic there is a x^2 + 2 b x y + c y^2.
    let (s, t) = (-l.x / l.z, -l.y / l.z);
    let a = q.xx + s * (2.0 * q.xz + s * q.zz);
    let b = q.xy + t * q.xz + s * q.yz + s * t * q.zz;
    let c = q.yy + t * (2.0 * q.yz + t * q.zz);
    let discriminant = b * b - a * c;
    // A little below 0 is a tangent line and rounding; worse guesses fail later.
    if !(discriminant >= -1e-9 * (b * b + (a * c).abs())) {
        return [None, None];
    }
    let h = -(b + discriminant.max(0.0).sqrt().copysign(b));
    [(h, a), (c, h)].map(|(x, y)| {
        let z = s * x + t * y;
        Some(match k {
            0 => Vector3::new(z, x, y),
            1 => Vector3::new(y, z, x),
            _ => Vector3::new(x, y, z),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realnet_core::nalgebra::Vector6;

    #[test]
    fn roots() {
        // Coefficients from roots, and the root furthest from their mean.
        for (roots, expected) in [
            ([1.0, 2.0, 4.0], 4.0),
            ([-1.0, -2.0, -4.0], -4.0),
            ([1.0, 1.0, 2.0], 2.0),
            ([-3.0, 5.0, 5.0], -3.0),
            ([0.0, 0.0, 0.0], 0.0),
            ([1e-3, 1e-3, 1e6], 1e6),
        ] {
            let [r, s, t] = roots;
            let found = simple_root(-(r + s + t), r * s + r * t + s * t, -r * s * t);
            assert!((found - expected).abs() <= 1e-12 * expected.abs(), "{roots:?}: {found}");
        }
        // One real root: t^3 + t - 2 and t^3 - 8
        assert!((simple_root(0.0, 1.0, -2.0) - 1.0).abs() < 1e-15);
        assert!((simple_root(0.0, 0.0, -8.0) - 2.0).abs() < 1e-15);
        // A triple root is only good to the cube root of rounding.
        assert!((simple_root(-3.0, 3.0, -1.0) - 1.0).abs() < 1e-5);
    }

    fn problem() -> impl Strategy<Value = (Pose, [Point3<f64>; 3])> {
        let camera_point = (-0.8..0.8f64, -0.8..0.8f64, 0.5..20.0f64)
            .prop_map(|(x, y, z)| Point3::new(x * z, y * z, z));
        (prop::array::uniform6(-3.0..3.0f64), prop::array::uniform3(camera_point))
            .prop_map(|(twist, seen)| (Pose::exp(&Vector6::from(twist)), seen))
    }

    fn sliver(p: &[Point3<f64>; 3]) -> f64 {
        let (a, b, c) = (p[1] - p[0], p[2] - p[0], p[2] - p[1]);
        let longest = a.norm().max(b.norm()).max(c.norm());
        a.cross(&b).norm() / (longest * longest)
    }

    fn bearings(seen: &[Point3<f64>; 3]) -> [Unit<Vector3<f64>>; 3] {
        seen.map(|p| Unit::new_normalize(p.coords))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]

        #[test]
        fn every_answer_fits((pose, seen) in problem()) {
            let world = seen.map(|p| pose.inverse() * p);
            for found in p3p(&world, &bearings(&seen)).iter() {
                for (point, bearing) in world.iter().zip(bearings(&seen)) {
                    let there = (*found * *point).coords;
                    prop_assert!(there.dot(&bearing) > 0.0, "in front");
                    prop_assert!(there.cross(&bearing).norm() < 1e-6 * there.norm());
                }
            }
        }

        #[test]
        fn order_does_not_matter((pose, seen) in problem()) {
            prop_assume!(sliver(&seen) > 0.05);
            let world = seen.map(|p| pose.inverse() * p);
            let near = |a: &Pose, b: &Pose| {
                let d = *a * b.inverse();
                d.rotation_angle() < 1e-3 && d.translation_norm() < 1e-2
            };
            let first = p3p(&world, &bearings(&seen));
            let turned = |p: [_; 3]| { let [a, b, c] = p; [c, a, b] };
            let second = p3p(&turned(world), &turned(seen).map(|p| Unit::new_normalize(p.coords)));
            let truth_in = |poses: &P3pPoses| poses.iter().any(|p| near(p, &pose));
            prop_assert_eq!(truth_in(&first), truth_in(&second));
        }
    }

    /// The truth is among the answers, but for the few triples on the danger
    /// cylinder to rounding; and as exact as the problem lets it be.
    #[test]
    fn truth_is_found() {
        use proptest::strategy::ValueTree;
        use proptest::test_runner::TestRunner;
        let mut runner = TestRunner::deterministic();
        let mut errors = Vec::new();
        for _ in 0..100_000 {
            let (pose, seen) = problem().new_tree(&mut runner).unwrap().current();
            if sliver(&seen) < 1e-3 {
                continue;
            }
            let world = seen.map(|p| pose.inverse() * p);
            let error = p3p(&world, &bearings(&seen))
                .iter()
                .map(|found| {
                    let d = *found * pose.inverse();
                    d.rotation_angle() + d.translation_norm() / pose.translation_norm().max(1.0)
                })
                .fold(f64::INFINITY, f64::min);
            errors.push(error);
        }
        errors.sort_by(f64::total_cmp);
        let at = |share: f64| errors[(errors.len() as f64 * share) as usize];
        println!(
            "{} problems: {:e} {:e} {:e} {:e}",
            errors.len(),
            at(0.5),
            at(0.99),
            at(0.999),
            at(0.9999)
        );
        assert!(errors.len() > 90_000);
        assert!(at(0.5) < 1e-13, "median {:e}", at(0.5));
        assert!(at(0.99) < 1e-10, "99 %: {:e}", at(0.99));
        assert!(at(0.9999) < 1e-5, "99.99 %: {:e}", at(0.9999));
    }

    #[test]
    fn degenerate_triples_have_none() {
        let good = [[1.0, 0.0, 5.0], [0.0, 1.0, 6.0], [-1.0, -0.5, 4.0]].map(Point3::from);
        let rays = bearings(&good);
        assert!(!p3p(&good, &rays).is_empty());
        let line = [[1.0, 0.0, 5.0], [2.0, 0.0, 5.0], [4.0, 0.0, 5.0]].map(Point3::from);
        assert!(p3p(&line, &bearings(&line)).is_empty(), "collinear");
        assert!(p3p(&[good[0], good[0], good[2]], &rays).is_empty(), "coincident");
        assert!(p3p(&good, &[rays[0], rays[0], rays[2]]).is_empty(), "equal bearings");
        assert!(p3p(&[good[0]; 3], &[rays[0]; 3]).is_empty(), "one place");
        let nan = Point3::new(f64::NAN, 0.0, 1.0);
        assert!(p3p(&[good[0], good[1], nan], &rays).is_empty(), "not a number");
        let infinite = Point3::new(f64::INFINITY, 0.0, 1.0);
        assert!(p3p(&[good[0], good[1], infinite], &rays).is_empty(), "infinite");
        let bad = Unit::new_unchecked(Vector3::new(f64::NAN, 0.0, 1.0));
        assert!(p3p(&good, &[rays[0], rays[1], bad]).is_empty(), "bearing");
    }
}
