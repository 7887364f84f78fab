//! How the target moves by itself: white jerk, and an acceleration that decays.

use realnet_core::nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3};

/// Nodes and weights of Gauss-Legendre's rule of three points on 0..1.
const NODES: [(f64, f64); 3] = [
    (0.112_701_665_379_258_3, 5.0 / 18.0),
    (0.5, 8.0 / 18.0),
    (0.887_298_334_620_741_7, 5.0 / 18.0),
];

/// What an acceleration of 1 becomes after `seconds`: (position, velocity,
/// acceleration), where the acceleration decays by exp(-rate t); Singer, *Estimating
/// optimal tracking filter performance for manned maneuvering targets*, 1970.
fn response(rate: f64, seconds: f64) -> Vector3<f64> {
    let x = rate * seconds;
    if x < 1e-3 {
        // To third order in x; what is left out is below 1e-12 of it.
        let position = 0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x / 120.0));
        let velocity = 1.0 - x * (0.5 - x * (1.0 / 6.0 - x / 24.0));
        let acceleration = (-x).exp();
        return Vector3::new(position * seconds * seconds, velocity * seconds, acceleration);
    }
    let gone = -(-x).exp_m1();
    Vector3::new((x - gone) / (rate * rate), gone / rate, 1.0 - gone)
}

/// Transition of (position, velocity, acceleration) of one axis.
fn transition_of_axis(rate: f64, seconds: f64) -> Matrix3<f64> {
    let response = response(rate, seconds);
    Matrix3::new(
        1.0,
        seconds,
        response[0], //
        0.0,
        1.0,
        response[1], //
        0.0,
        0.0,
        response[2],
    )
}

/// Over `seconds`, of positions, velocities and accelerations (x and y of each): the
/// transition, the directions of six independent noises, and their variances.
///
/// The noise is the integral of response responseᵀ times the jerk's density, by
/// Gauss-Legendre with three nodes: exact for white jerk, and positive by construction
/// at any step, where the closed form cancels for short ones.
pub(crate) fn step(
    jerk_density: f64,
    acceleration_time_s: f64,
    seconds: f64,
) -> (Matrix6<f64>, SMatrix<f64, 6, 6>, SVector<f64, 6>) {
    let rate = 1.0 / acceleration_time_s;
    let axis = transition_of_axis(rate, seconds);
    let mut transition = Matrix6::zeros();
    for i in 0..3 {
        for j in i..3 {
            transition[(2 * i, 2 * j)] = axis[(i, j)];
            transition[(2 * i + 1, 2 * j + 1)] = axis[(i, j)];
        }
    }
    let mut noise = SMatrix::<f64, 6, 6>::zeros();
    let mut variances = SVector::<f64, 6>::zeros();
    for (k, (node, weight)) in NODES.into_iter().enumerate() {
        let reply = response(rate, node * seconds);
        for i in 0..3 {
            noise[(2 * i, 2 * k)] = reply[i];
            noise[(2 * i + 1, 2 * k + 1)] = reply[i];
        }
        variances[2 * k] = jerk_density * seconds * weight;
        variances[2 * k + 1] = variances[2 * k];
    }
    (transition, noise, variances)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn covariance(density: f64, time: f64, seconds: f64) -> Matrix3<f64> {
        let (_, noise, variances) = step(density, time, seconds);
        let whole = noise * SMatrix::from_diagonal(&variances) * noise.transpose();
        Matrix3::from_fn(|i, j| whole[(2 * i, 2 * j)])
    }

    #[test]
    fn white_jerk_has_its_closed_form() {
        for t in [1e-3, 0.033, 1.0, 7.0_f64] {
            let found = covariance(3.0, f64::INFINITY, t);
            let expected = 3.0
                * Matrix3::new(
                    t.powi(5) / 20.0,
                    t.powi(4) / 8.0,
                    t.powi(3) / 6.0,
                    t.powi(4) / 8.0,
                    t.powi(3) / 3.0,
                    t.powi(2) / 2.0,
                    t.powi(3) / 6.0,
                    t.powi(2) / 2.0,
                    t,
                );
            assert!((found - expected).norm() < 1e-12 * expected.norm(), "{t}");
        }
    }

    #[test]
    fn two_steps_are_one() {
        let (density, time) = (10.0, 0.5);
        let (half, once) = (transition_of_axis(2.0, 0.3), transition_of_axis(2.0, 0.6));
        assert!((half * half - once).norm() < 1e-12);
        let part = covariance(density, time, 0.3);
        let twice = half * part * half.transpose() + part;
        let once = covariance(density, time, 0.6);
        assert!((twice - once).norm() < 1e-4 * once.norm(), "{twice} {once}");
        // In the long run the acceleration has the promised deviation.
        let mut state = Matrix3::zeros();
        for _ in 0..100 {
            state = half * state * half.transpose() + part;
        }
        assert!((state[(2, 2)] - density * time / 2.0).abs() < 1e-4);
    }

    #[test]
    fn the_series_meets_the_closed_form() {
        for rate in [0.01, 1.0, 20.0] {
            let below = response(rate, 0.999_999e-3 / rate);
            let above = response(rate, 1.000_001e-3 / rate);
            let change = (above - below).component_div(&above);
            assert!(change.amax() < 5e-6, "{change}");
        }
    }
}
