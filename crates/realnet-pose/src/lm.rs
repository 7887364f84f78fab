//! Levenberg and Marquardt's method on SE(3).

use crate::geometry::Rt;
use crate::kernel::{Loss, Normal, Soa};
use realnet_core::Pose;
use realnet_core::nalgebra::Vector6;

/// Where a minimisation ended.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Minimum {
    pub(crate) pose: Rt,
    pub(crate) normal: Normal,
    pub(crate) steps: usize,
    pub(crate) converged: bool,
}

/// Minimises the sum of losses from `start`, at most `max_steps` steps. It has
/// converged when a full step would lower the cost by less than `tolerance` of
/// it, or when rounding stops it there.
pub(crate) fn minimise(
    soa: &Soa,
    start: &Rt,
    loss: Loss,
    max_steps: usize,
    tolerance: f64,
) -> Minimum {
    let mut pose = *start;
    let mut here = soa.normal(&pose, loss);
    let mut damping = 0.0;
    let [fx, fy] = soa.focal();
    // A change of every ray by this much is rounding.
    let rounding = |share: f64| soa.len() as f64 * (share * fx.max(fy)).powi(2);
    let mut steps = 0;
    let mut converged = false;
    while steps < max_steps {
        steps += 1;
        let mut damped = here.hessian;
        for axis in 0..6 {
            damped[(axis, axis)] *= 1.0 + damping;
        }
        let Some(factor) = damped.cholesky() else {
            if damping > 1e6 {
                break;
            }
            damping = f64::max(damping * 10.0, 1e-6);
            continue;
        };
        let step: Vector6<f64> = -factor.solve(&here.gradient);
        let decrease = -here.gradient.dot(&step);
        if decrease <= tolerance * here.cost || decrease <= rounding(1e-13) {
            converged = true;
            break;
        }
        let trial = moved(&pose, &step);
        let there = soa.normal(&trial, loss);
        if there.cost < here.cost {
            pose = trial;
            here = there;
            damping = if damping < 1e-6 { 0.0 } else { damping * 0.1 };
        } else {
            if decrease <= 1e-3 * tolerance.sqrt() * here.cost || decrease <= rounding(1e-9) {
                converged = true;
                break;
            }
            damping = f64::max(damping * 10.0, 1e-3);
        }
    }
    Minimum { pose, normal: here, steps, converged }
}

/// `exp(step) * pose`.
pub(crate) fn moved(pose: &Rt, step: &Vector6<f64>) -> Rt {
    let by = Rt::from_pose(&Pose::exp(step));
    Rt { r: by.r * pose.r, t: by.r * pose.t + by.t }
}
