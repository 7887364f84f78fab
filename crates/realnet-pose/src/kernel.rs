//! The two loops over all points: the truncated cost of a pose, and its normal
//! equations.
//!
//! Points are kept coordinate by coordinate in whole blocks of [`LANES`]. The
//! arithmetic is the same in every lane and without fused multiply-add, so the
//! portable and the AVX2 build give the same bits.

#![allow(clippy::needless_range_loop, reason = "lanes of several arrays side by side")]

use crate::geometry::Rt;
use crate::problem::Correspondences;
use realnet_core::nalgebra::{Matrix6, Vector6};

/// Points in a block: a cache line of `f64`.
pub(crate) const LANES: usize = 8;
/// Blocks between two looks at the running cost.
const STRIDE: usize = 4;

type Lane = [f64; LANES];

/// A block of points. Padding has rays that are not numbers, so that it is never
/// within a threshold.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Block {
    x: Lane,
    y: Lane,
    z: Lane,
    /// Rays times focal lengths.
    u: Lane,
    v: Lane,
}

const PADDING: Block = Block {
    x: [0.0; LANES],
    y: [0.0; LANES],
    z: [0.0; LANES],
    u: [f64::NAN; LANES],
    v: [f64::NAN; LANES],
};

/// Correspondences in blocks.
#[derive(Clone, Debug, Default)]
pub(crate) struct Soa {
    blocks: Vec<Block>,
    len: usize,
    focal: [f64; 2],
}

/// How residuals (pixels) count: squared to `huber`, linearly from there, and
/// not at all beyond `cutoff`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Loss {
    pub(crate) huber: f64,
    pub(crate) cutoff: f64,
}

impl Loss {
    /// Cost of a residual of length `r` below the cutoff.
    #[inline(always)]
    fn rho(&self, r: f64) -> f64 {
        if r <= self.huber { r * r } else { self.huber * (2.0 * r - self.huber) }
    }
}

/// The normal equations of a pose under a loss, for the left perturbation
/// `exp(xi) * pose`, `xi = [v; w]`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Normal {
    /// Sum of the losses, squared pixels; a point beyond the cutoff or behind
    /// the camera costs the loss at the cutoff.
    pub(crate) cost: f64,
    /// Points in front of the camera and within the cutoff.
    pub(crate) within: usize,
    /// Sum of `w J^T J`.
    pub(crate) hessian: Matrix6<f64>,
    /// Sum of `w J^T r`.
    pub(crate) gradient: Vector6<f64>,
}

/// What remains of a lane's residual.
pub(crate) struct Residual {
    /// Squared length, pixels; not-a-number for padding.
    pub(crate) squared: f64,
    /// Depth in the camera's frame.
    pub(crate) depth: f64,
}

impl Soa {
    pub(crate) fn with_capacity(points: usize) -> Self {
        let blocks = Vec::with_capacity(points.div_ceil(LANES));
        Self { blocks, len: 0, focal: [1.0, 1.0] }
    }

    /// Takes the correspondences for which `keep` holds.
    pub(crate) fn fill(&mut self, problem: &Correspondences<'_>, keep: impl Fn(usize) -> bool) {
        self.blocks.clear();
        self.focal = problem.focal();
        self.len = 0;
        let [fx, fy] = self.focal;
        let pairs = problem.points().iter().zip(problem.rays()).enumerate();
        for (_, (point, ray)) in pairs.filter(|(index, _)| keep(*index)) {
            let lane = self.len % LANES;
            if lane == 0 {
                self.blocks.push(PADDING);
            }
            if let Some(block) = self.blocks.last_mut() {
                block.x[lane] = point.x;
                block.y[lane] = point.y;
                block.z[lane] = point.z;
                block.u[lane] = fx * ray[0];
                block.v[lane] = fy * ray[1];
            }
            self.len += 1;
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Pixels per unit of a ray.
    pub(crate) fn focal(&self) -> [f64; 2] {
        self.focal
    }

    /// The residuals one after the other, in the order of the points.
    pub(crate) fn residuals(&self, pose: &Rt) -> impl Iterator<Item = Residual> + '_ {
        let rows = self.rows(pose);
        let blocks = self.blocks.iter();
        blocks
            .flat_map(move |block| {
                let [px, py, pz] = transform(&rows, block);
                (0..LANES).map(move |lane| {
                    let inverse = 1.0 / pz[lane];
                    let du = px[lane] * inverse - block.u[lane];
                    let dv = py[lane] * inverse - block.v[lane];
                    Residual { squared: du * du + dv * dv, depth: pz[lane] }
                })
            })
            .take(self.len)
    }

    /// The sum of `min(r^2, cutoff^2)`; points behind the camera count as beyond
    /// the cutoff. Stops early with a value of at least `bail` when it is
    /// certain to get there.
    pub(crate) fn cost(&self, pose: &Rt, cutoff: f64, bail: f64) -> f64 {
        let rows = self.rows(pose);
        let padding = (self.blocks.len() * LANES - self.len) as f64 * cutoff * cutoff;
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { cost_avx2(&self.blocks, &rows, cutoff * cutoff, bail + padding) }
                - padding;
        }
        cost_body(&self.blocks, &rows, cutoff * cutoff, bail + padding) - padding
    }

    /// The normal equations at `pose`.
    pub(crate) fn normal(&self, pose: &Rt, loss: Loss) -> Normal {
        let rows = self.rows(pose);
        let mut sums = Sums::default();
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            unsafe { normal_avx2(&self.blocks, &rows, self.focal, loss, &mut sums) };
            return sums.finish(self.len, loss);
        }
        normal_body(&self.blocks, &rows, self.focal, loss, &mut sums);
        sums.finish(self.len, loss)
    }

    /// The pose with its first two rows in pixels.
    fn rows(&self, pose: &Rt) -> [[f64; 4]; 3] {
        let scale = [self.focal[0], self.focal[1], 1.0];
        let (r, t) = (&pose.r, &pose.t);
        let row = |i: usize| [r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]].map(|value| value * scale[i]);
        [row(0), row(1), row(2)]
    }
}

#[inline(always)]
fn transform(rows: &[[f64; 4]; 3], block: &Block) -> [Lane; 3] {
    let mut out = [[0.0; LANES]; 3];
    for (lanes, row) in out.iter_mut().zip(rows) {
        for l in 0..LANES {
            lanes[l] = (row[0] * block.x[l] + row[1] * block.y[l]) + (row[2] * block.z[l] + row[3]);
        }
    }
    out
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn cost_avx2(blocks: &[Block], rows: &[[f64; 4]; 3], limit: f64, bail: f64) -> f64 {
    cost_body(blocks, rows, limit, bail)
}

#[inline(always)]
fn cost_body(blocks: &[Block], rows: &[[f64; 4]; 3], limit: f64, bail: f64) -> f64 {
    let mut sums = [0.0; LANES];
    let mut total = 0.0;
    for some in blocks.chunks(STRIDE) {
        for block in some {
            let [px, py, pz] = transform(rows, block);
            for l in 0..LANES {
                let inverse = 1.0 / pz[l];
                let du = px[l] * inverse - block.u[l];
                let dv = py[l] * inverse - block.v[l];
                let squared = du * du + dv * dv;
                let good = (pz[l] > 0.0) & (squared < limit);
                sums[l] += if good { squared } else { limit };
            }
        }
        total = sum(&sums);
        if total >= bail {
            break;
        }
    }
    total
}

#[inline(always)]
fn sum(s: &Lane) -> f64 {
    ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]))
}

/// Places in [`Sums`]: the entries of the upper triangle that are not 0, the
/// gradient, the cost, the count.
const ENTRIES: [(usize, usize); 20] = [
    (0, 0),
    (0, 2),
    (0, 3),
    (0, 4),
    (0, 5),
    (1, 1),
    (1, 2),
    (1, 3),
    (1, 4),
    (1, 5),
    (2, 2),
    (2, 3),
    (2, 4),
    (2, 5),
    (3, 3),
    (3, 4),
    (3, 5),
    (4, 4),
    (4, 5),
    (5, 5),
];
const GRADIENT: usize = ENTRIES.len();
const COST: usize = GRADIENT + 6;
const COUNT: usize = COST + 1;

#[derive(Default)]
struct Sums {
    lanes: [Lane; COUNT + 1],
}

impl Sums {
    fn finish(&self, len: usize, loss: Loss) -> Normal {
        let total = self.lanes.map(|lanes| sum(&lanes));
        let mut hessian = Matrix6::zeros();
        for (&(row, column), value) in ENTRIES.iter().zip(total) {
            hessian[(row, column)] = value;
            hessian[(column, row)] = value;
        }
        let gradient = Vector6::from_fn(|row, _| total[GRADIENT + row]);
        let within = total[COUNT] as usize;
        let beyond = len.saturating_sub(within);
        let lost = if beyond > 0 { beyond as f64 * loss.rho(loss.cutoff) } else { 0.0 };
        Normal { cost: total[COST] + lost, within, hessian, gradient }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn normal_avx2(
    blocks: &[Block],
    rows: &[[f64; 4]; 3],
    focal: [f64; 2],
    loss: Loss,
    sums: &mut Sums,
) {
    normal_body(blocks, rows, focal, loss, sums);
}

/// With `x, y` the ray and `i` the inverse depth of a point, a left perturbation
/// moves the ray by
///
/// ```text
/// dx = [i, 0, -x i, -x y, 1 + x^2, -y] xi
/// dy = [0, i, -y i, -(1 + y^2), x y, x] xi
/// ```
///
/// (the derivative of `[X / Z, Y / Z]` with `dP = v + w x P`).
#[inline(always)]
fn normal_body(
    blocks: &[Block],
    rows: &[[f64; 4]; 3],
    focal: [f64; 2],
    loss: Loss,
    sums: &mut Sums,
) {
    let limit = loss.cutoff * loss.cutoff;
    let knee = loss.huber * loss.huber;
    let [fx, fy] = focal;
    let (to_x, to_y) = (1.0 / fx, 1.0 / fy);
    for block in blocks {
        let [px, py, pz] = transform(rows, block);
        let mut terms = [[0.0; LANES]; COUNT + 1];
        for l in 0..LANES {
            let i = 1.0 / pz[l];
            let (pu, pv) = (px[l] * i, py[l] * i);
            let (du, dv) = (pu - block.u[l], pv - block.v[l]);
            let squared = du * du + dv * dv;
            let good = (pz[l] > 0.0) & (squared < limit);
            let beyond = squared > knee;
            let length = squared.sqrt();
            let weight = if beyond { loss.huber / length } else { 1.0 };
            let cost = if beyond { loss.huber * (2.0 * length - loss.huber) } else { squared };
            // Selected, not multiplied: the lanes left out may be not-a-number.
            let w = if good { weight } else { 0.0 };
            let (x, y) = (if good { pu * to_x } else { 0.0 }, if good { pv * to_y } else { 0.0 });
            let i = if good { i } else { 0.0 };
            let (du, dv) = (if good { du } else { 0.0 }, if good { dv } else { 0.0 });
            terms[COST][l] = if good { cost } else { 0.0 };
            terms[COUNT][l] = if good { 1.0 } else { 0.0 };
            let (a2, a3, a4, a5) = (-x * i, -x * y, 1.0 + x * x, -y);
            let (b2, b3, b4, b5) = (-y * i, -(1.0 + y * y), x * y, x);
            let (wu, wv) = (w * fx * fx, w * fy * fy);
            let (ui, u2, u3, u4, u5) = (wu * i, wu * a2, wu * a3, wu * a4, wu * a5);
            let (vi, v2, v3, v4, v5) = (wv * i, wv * b2, wv * b3, wv * b4, wv * b5);
            terms[0][l] = ui * i;
            terms[1][l] = ui * a2;
            terms[2][l] = ui * a3;
            terms[3][l] = ui * a4;
            terms[4][l] = ui * a5;
            terms[5][l] = vi * i;
            terms[6][l] = vi * b2;
            terms[7][l] = vi * b3;
            terms[8][l] = vi * b4;
            terms[9][l] = vi * b5;
            terms[10][l] = u2 * a2 + v2 * b2;
            terms[11][l] = u2 * a3 + v2 * b3;
            terms[12][l] = u2 * a4 + v2 * b4;
            terms[13][l] = u2 * a5 + v2 * b5;
            terms[14][l] = u3 * a3 + v3 * b3;
            terms[15][l] = u3 * a4 + v3 * b4;
            terms[16][l] = u3 * a5 + v3 * b5;
            terms[17][l] = u4 * a4 + v4 * b4;
            terms[18][l] = u4 * a5 + v4 * b5;
            terms[19][l] = u5 * a5 + v5 * b5;
            let (ru, rv) = (w * fx * du, w * fy * dv);
            terms[GRADIENT][l] = ru * i;
            terms[GRADIENT + 1][l] = rv * i;
            terms[GRADIENT + 2][l] = ru * a2 + rv * b2;
            terms[GRADIENT + 3][l] = ru * a3 + rv * b3;
            terms[GRADIENT + 4][l] = ru * a4 + rv * b4;
            terms[GRADIENT + 5][l] = ru * a5 + rv * b5;
        }
        for (total, term) in sums.lanes.iter_mut().zip(&terms) {
            for l in 0..LANES {
                total[l] += term[l];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lm::moved;
    use realnet_core::nalgebra::{Matrix3, Point3, Vector3};

    /// Points before the camera (one behind it), rays with errors up to 6 px.
    fn soa(count: usize) -> Soa {
        let wave = |i: usize, step: f64| (1.0 + i as f64 * step).sin();
        let points: Vec<Point3<f64>> = (0..count)
            .map(|i| {
                let depth = if i == 5 { -3.0 } else { 4.0 + 2.0 * wave(i, 0.7) };
                Point3::new(2.0 * wave(i, 1.9), 1.5 * wave(i, 2.3), depth)
            })
            .collect();
        let rays: Vec<[f64; 2]> = points
            .iter()
            .enumerate()
            .map(|(i, p)| [p.x / p.z + 0.012 * wave(i, 3.1), p.y / p.z + 0.004 * wave(i, 4.7)])
            .collect();
        let mut soa = Soa::default();
        soa.fill(&Correspondences::new(&points, &rays, [500.0, 430.0]).unwrap(), |_| true);
        soa
    }

    fn pose() -> Rt {
        let start = Rt { r: Matrix3::identity(), t: Vector3::zeros() };
        moved(&start, &Vector6::new(2e-3, -1e-3, 3e-3, 1e-3, 2e-3, -1e-3))
    }

    #[test]
    fn costs_agree_with_the_residuals() {
        for count in [1, 7, 8, 9, 45, 200] {
            let soa = soa(count);
            assert_eq!(soa.residuals(&pose()).count(), count);
            let expected: f64 = soa
                .residuals(&pose())
                .map(|r| if r.depth > 0.0 && r.squared < 16.0 { r.squared } else { 16.0 })
                .sum();
            let cost = soa.cost(&pose(), 4.0, f64::INFINITY);
            assert!((cost - expected).abs() < 1e-9 * expected, "{count}: {cost} {expected}");
            let normal = soa.normal(&pose(), Loss { huber: f64::INFINITY, cutoff: 4.0 });
            assert!((normal.cost - expected).abs() < 1e-9 * expected, "{count}: {}", normal.cost);
            let within = soa.residuals(&pose()).filter(|r| r.depth > 0.0 && r.squared < 16.0);
            assert_eq!(normal.within, within.count());
            // Half of the cost is enough to give up at half of it.
            assert!(soa.cost(&pose(), 4.0, 0.5 * expected) >= 0.5 * expected);
        }
        assert_eq!(soa(8).residuals(&pose()).filter(|r| r.depth <= 0.0).count(), 1);
    }

    #[test]
    fn the_gradient_is_the_slope_of_the_cost() {
        let soa = soa(40);
        for loss in [
            Loss { huber: f64::INFINITY, cutoff: 1e6 },
            Loss { huber: 2.0, cutoff: 1e6 },
            Loss { huber: 1.0, cutoff: 3.0 },
        ] {
            let here = soa.normal(&pose(), loss);
            for axis in 0..6 {
                let at = |size: f64| {
                    let mut step = Vector6::zeros();
                    step[axis] = size;
                    soa.normal(&moved(&pose(), &step), loss).cost
                };
                let slope = (at(1e-7) - at(-1e-7)) / 2e-7;
                let analytic = 2.0 * here.gradient[axis];
                let scale = here.hessian[(axis, axis)].sqrt() * here.cost.sqrt();
                assert!((slope - analytic).abs() < 1e-5 * scale, "{axis}: {slope} {analytic}");
            }
        }
    }

    #[test]
    fn the_hessian_is_that_of_gauss_and_newton() {
        // Without residuals the second derivative of the cost is 2 J^T J.
        let wave = |i: usize, step: f64| (1.0 + i as f64 * step).sin();
        let points: Vec<Point3<f64>> =
            (0..20).map(|i| Point3::new(wave(i, 1.9), wave(i, 2.3), 4.0 + wave(i, 0.7))).collect();
        let exact: Vec<[f64; 2]> = points.iter().map(|p| [p.x / p.z, p.y / p.z]).collect();
        let mut soa = Soa::default();
        soa.fill(&Correspondences::new(&points, &exact, [500.0, 430.0]).unwrap(), |_| true);
        let loss = Loss { huber: f64::INFINITY, cutoff: 1e6 };
        let here = Rt::identity();
        let normal = soa.normal(&here, loss);
        assert!(normal.cost < 1e-20);
        for axis in 0..6 {
            let gradient = |size: f64| {
                let mut step = Vector6::zeros();
                step[axis] = size;
                soa.normal(&moved(&here, &step), loss).gradient
            };
            let column = (gradient(1e-6) - gradient(-1e-6)) / 2e-6;
            let difference = (column - normal.hessian.column(axis)).amax();
            assert!(difference < 1e-6 * normal.hessian.amax(), "{axis}: {difference:e}");
        }
    }

    /// The portable loops and those that this machine takes give the same bits.
    #[test]
    fn wide_registers_change_nothing() {
        for count in [3, 8, 200] {
            let soa = soa(count);
            let rows = soa.rows(&pose());
            let padding = (soa.blocks.len() * LANES - count) as f64 * 9.0;
            let portable = cost_body(&soa.blocks, &rows, 9.0, f64::INFINITY) - padding;
            assert_eq!(soa.cost(&pose(), 3.0, f64::INFINITY).to_bits(), portable.to_bits());
            let loss = Loss { huber: 1.0, cutoff: 3.0 };
            let mut sums = Sums::default();
            normal_body(&soa.blocks, &rows, soa.focal, loss, &mut sums);
            let (portable, taken) = (sums.finish(count, loss), soa.normal(&pose(), loss));
            assert_eq!(portable.hessian, taken.hessian);
            assert_eq!(portable.gradient, taken.gradient);
            assert_eq!(portable.cost.to_bits(), taken.cost.to_bits());
        }
    }
}
