//! The direct linear transform.

use crate::geometry::{Extent, LINE_LIMIT, PLANE_LIMIT, Rt};
use crate::{Correspondences, PnpError};
use realnet_core::Pose;
use realnet_core::nalgebra::{Matrix3, SMatrix, Vector3};

type Row = SMatrix<f64, 1, 12>;

/// Second smallest over largest singular value below which the twelve unknowns
/// have a second solution.
const SECOND_SOLUTION: f64 = 1e-9;

/// The pose from 6 or more points that are not on a plane, without outliers: the
/// smallest singular vector of the linear equations in normalised coordinates
/// (Hartley and Zisserman, Multiple View Geometry, 2nd edition, algorithm 7.1),
/// its left 3x3 part replaced by the nearest rotation.
///
/// It minimises an algebraic error: refine it with
/// [`PnpSolver::refine`](crate::PnpSolver::refine), which also gives the
/// covariance. Does not allocate.
///
/// # Errors
/// [`PnpError::TooFewPoints`] below 6; [`PnpError::Collinear`] and
/// [`PnpError::Planar`] by the extents of the points; [`PnpError::Degenerate`]
/// for other critical sets; [`PnpError::Behind`] when points come out behind the
/// camera; [`PnpError::ReprojectionTooLarge`] when the root mean square of the
/// residual coordinates exceeds `max_rms_px`.
pub fn dlt(problem: &Correspondences<'_>, max_rms_px: f64) -> Result<Pose, PnpError> {
    problem.at_least(6)?;
    let extent = Extent::of(problem.points().iter());
    let ratio = extent.line_ratio();
    if ratio < LINE_LIMIT {
        return Err(PnpError::Collinear { ratio, limit: LINE_LIMIT });
    }
    let ratio = extent.plane_ratio();
    if ratio < PLANE_LIMIT {
        return Err(PnpError::Planar { ratio, limit: PLANE_LIMIT });
    }
    let count = problem.len() as f64;
    let size = extent.deviations.iter().map(|d| d * d).sum::<f64>().sqrt() / 3f64.sqrt();
    let mut ray_mean = [0.0; 2];
    for ray in problem.rays() {
        ray_mean[0] += ray[0] / count;
        ray_mean[1] += ray[1] / count;
    }
    let spread = problem.rays().iter().map(|ray| {
        let (dx, dy) = (ray[0] - ray_mean[0], ray[1] - ray_mean[1]);
        dx * dx + dy * dy
    });
    let ray_size = (0.5 * spread.sum::<f64>() / count).sqrt();
    if !(ray_size > 0.0 && ray_size.is_finite()) {
        return Err(PnpError::Degenerate { ratio: 0.0, limit: SECOND_SOLUTION });
    }

    // Equations are folded twelve at a time into the triangular factor, whose
    // singular vectors are those of all equations.
    let mut stack = SMatrix::<f64, 24, 12>::zeros();
    let mut rows = 12;
    for (point, ray) in problem.points().iter().zip(problem.rays()) {
        let p = (point.coords - extent.mean) / size;
        let (u, v) = ((ray[0] - ray_mean[0]) / ray_size, (ray[1] - ray_mean[1]) / ray_size);
        let along = |first: f64, second: f64, third: f64| {
            let h = [p.x, p.y, p.z, 1.0];
            Row::from_fn(|_, i| [first, second, third][i / 4] * h[i % 4])
        };
        stack.set_row(rows, &along(1.0, 0.0, -u));
        stack.set_row(rows + 1, &along(0.0, 1.0, -v));
        rows += 2;
        if rows == 24 {
            fold(&mut stack);
            rows = 12;
        }
    }
    fold(&mut stack);
    let triangle = stack.fixed_rows::<12>(0).into_owned();
    let Some(svd) = triangle.try_svd(false, true, f64::EPSILON, 200) else {
        return Err(PnpError::NotConverged { iterations: 200 });
    };
    let mut order: [usize; 12] = std::array::from_fn(|i| i);
    order.sort_by(|&a, &b| svd.singular_values[b].total_cmp(&svd.singular_values[a]));
    let ratio = svd.singular_values[order[10]] / svd.singular_values[order[0]];
    if ratio.is_nan() || ratio < SECOND_SOLUTION {
        return Err(PnpError::Degenerate { ratio, limit: SECOND_SOLUTION });
    }
    let Some(v_t) = svd.v_t else {
        return Err(PnpError::NotConverged { iterations: 200 });
    };
    let solution = v_t.row(order[11]).into_owned();
    let mut m = Matrix3::from_fn(|r, c| solution[4 * r + c]);
    let mut t = Vector3::from_fn(|r, _| solution[4 * r + 3]);

    // Rays back to their own scale.
    let denormalise =
        Matrix3::new(ray_size, 0.0, ray_mean[0], 0.0, ray_size, ray_mean[1], 0.0, 0.0, 1.0);
    m = denormalise * m;
    t = denormalise * t;
    if m.determinant() < 0.0 {
        m = -m;
        t = -t;
    }
    let svd = m.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(PnpError::NotConverged { iterations: 0 });
    };
    let scale = svd.singular_values.sum() / 3.0;
    if !(svd.singular_values.min() > 1e-9 * scale) {
        let ratio = svd.singular_values.min() / svd.singular_values.max();
        return Err(PnpError::Degenerate { ratio, limit: 1e-9 });
    }
    let r = u * v_t;
    // M (X - mean) / size + t, over scale / size: the unit of length returns.
    let t = t * (size / scale) - r * extent.mean;
    let pose = Rt { r, t };
    check(problem, &pose, max_rms_px)?;
    Ok(pose.to_pose())
}

/// The triangular factor of all rows to the top, zeros below.
fn fold(stack: &mut SMatrix<f64, 24, 12>) {
    let r = stack.qr().r();
    stack.fill(0.0);
    stack.fixed_rows_mut::<12>(0).copy_from(&r);
}

/// All points in front, and their residuals.
fn check(problem: &Correspondences<'_>, pose: &Rt, max_rms_px: f64) -> Result<(), PnpError> {
    let [fx, fy] = problem.focal();
    let mut behind = 0;
    let mut sum = 0.0;
    for (point, ray) in problem.points().iter().zip(problem.rays()) {
        let p = pose.r * point.coords + pose.t;
        behind += usize::from(!(p.z > 0.0));
        let (du, dv) = (fx * (p.x / p.z - ray[0]), fy * (p.y / p.z - ray[1]));
        sum += du * du + dv * dv;
    }
    if behind > 0 {
        return Err(PnpError::Behind { count: behind, points: problem.len() });
    }
    let rms_px = (0.5 * sum / problem.len() as f64).sqrt();
    if !(rms_px <= max_rms_px) {
        return Err(PnpError::ReprojectionTooLarge { rms_px, limit_px: max_rms_px });
    }
    Ok(())
}
