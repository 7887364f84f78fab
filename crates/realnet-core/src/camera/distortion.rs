//! Lens distortion on the plane at unit depth, forward and back.

use super::CameraError;

/// Rays further out than this (89.94 degrees off the axis) are refused by every
/// model with distortion: there a picture on a plane means nothing.
const MAX_RADIUS: f64 = 1000.0;
/// No lens has a coefficient beyond this; larger ones would overflow below.
const MAX_COEFFICIENT: f64 = 1e6;
/// Relative residual on the unit plane up to which an inverse counts as found.
const TOLERANCE: f64 = 2e-13;
/// Newton steps; well-behaved lenses need fewer than ten.
const MAX_STEPS: u32 = 60;

/// How a lens bends rays, in the models and coefficient order of OpenCV and ROS.
///
/// With `x, y` on the plane at unit depth and `r^2 = x^2 + y^2`, the first two
/// models move the ray to
///
/// ```text
/// x' = x g + 2 p1 x y + p2 (r^2 + 2 x^2)
/// y' = y g + p1 (r^2 + 2 y^2) + 2 p2 x y
/// ```
///
/// (Brown 1966; OpenCV's calib3d) with the radial factor `g` given below.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// A perfect pinhole.
    None,
    /// `k1, k2, p1, p2, k3`: `g = 1 + k1 r^2 + k2 r^4 + k3 r^6`.
    PlumbBob([f64; 5]),
    /// `k1, k2, p1, p2, k3, k4, k5, k6`:
    /// `g = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)`.
    RationalPolynomial([f64; 8]),
    /// `k1, k2, k3, k4` of Kannala and Brandt (2006), OpenCV's fisheye model:
    /// a ray at the angle `t` to the axis lands at the radius
    /// `t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)`.
    Equidistant([f64; 4]),
}

impl Distortion {
    /// The coefficients in the order of the variant's documentation; none for
    /// [`Distortion::None`].
    #[must_use]
    pub fn coefficients(&self) -> &[f64] {
        match self {
            Self::None => &[],
            Self::PlumbBob(k) => k,
            Self::RationalPolynomial(k) => k,
            Self::Equidistant(k) => k,
        }
    }

    /// Checks the coefficients and finds the radius up to which the model is
    /// one to one, infinite for a pinhole.
    ///
    /// The bound is proved, not sampled. With the radial map `f(r) = r g(r)`
    /// and `rho = |(p1, p2)|`, the Jacobian is symmetric, so the model is the
    /// gradient of a potential and one to one on a disc where that Jacobian is
    /// positive definite. For `f' > 8 rho r` on the disc it is: then
    /// `f / r > 4 rho r`, and in the axes along and across the ray the Jacobian
    /// `[[f' + 6 rho r c, 2 rho r s], [2 rho r s, f/r + 2 rho r c]]`
    /// (`c, s` the direction of the ray against `(p2, p1)`) has a positive
    /// trace and determinant.
    pub(super) fn valid_radius(&self) -> Result<f64, CameraError> {
        for (index, &value) in self.coefficients().iter().enumerate() {
            if !value.is_finite() || value.abs() > MAX_COEFFICIENT {
                return Err(CameraError::Coefficient { index, value, limit: MAX_COEFFICIENT });
            }
        }
        if let Self::Equidistant([k1, k2, k3, k4]) = *self {
            let limit = MAX_RADIUS.atan();
            let slope = [1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4];
            let squared = first_sign_change(&slope, limit * limit);
            return Ok(squared.map_or(MAX_RADIUS, |t2| t2.sqrt().tan().min(MAX_RADIUS)));
        }
        let Some(brown) = Brown::of(self) else { return Ok(f64::INFINITY) };
        let Brown { n, d, p1, p2 } = brown;
        let fold = first_sign_change(&fold_polynomial(&n, &d, p1.hypot(p2)), MAX_RADIUS);
        let pole = first_sign_change(&d, MAX_RADIUS * MAX_RADIUS).map(f64::sqrt);
        Ok(fold.unwrap_or(MAX_RADIUS).min(pole.unwrap_or(MAX_RADIUS)))
    }

    /// The bent ray. `radius` comes from [`Distortion::valid_radius`].
    pub(super) fn distort(&self, ray: [f64; 2], radius: f64) -> Result<[f64; 2], CameraError> {
        let r = ray[0].hypot(ray[1]);
        if !r.is_finite() {
            return Err(CameraError::NotFinite { x: ray[0], y: ray[1] });
        }
        if r > radius {
            return Err(CameraError::OutsideLens { radius: r, limit: radius });
        }
        Ok(match (self, Brown::of(self)) {
            (_, Some(brown)) => brown.map(ray).0,
            (Self::Equidistant(k), _) => {
                let t = r.atan();
                let scale = if r > 0.0 { equidistant(k, t).0 / r } else { 1.0 };
                [ray[0] * scale, ray[1] * scale]
            }
            _ => ray,
        })
    }

    /// The ray that [`Distortion::distort`] bends to `bent`.
    pub(super) fn undistort(&self, bent: [f64; 2], radius: f64) -> Result<[f64; 2], CameraError> {
        if !(bent[0].is_finite() && bent[1].is_finite()) {
            return Err(CameraError::NotFinite { x: bent[0], y: bent[1] });
        }
        match (self, Brown::of(self)) {
            (_, Some(brown)) => brown.invert(bent, radius),
            (Self::Equidistant(k), _) => invert_equidistant(k, bent, radius),
            _ => Ok(bent),
        }
    }
}

/// The two models with tangential terms in one form: numerator and denominator
/// of the radial factor as polynomials in `r^2`, lowest power first.
struct Brown {
    n: [f64; 4],
    d: [f64; 4],
    p1: f64,
    p2: f64,
}

impl Brown {
    fn of(distortion: &Distortion) -> Option<Self> {
        match *distortion {
            Distortion::PlumbBob([k1, k2, p1, p2, k3]) => {
                Some(Self { n: [1.0, k1, k2, k3], d: [1.0, 0.0, 0.0, 0.0], p1, p2 })
            }
            Distortion::RationalPolynomial([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                Some(Self { n: [1.0, k1, k2, k3], d: [1.0, k4, k5, k6], p1, p2 })
            }
            Distortion::None | Distortion::Equidistant(_) => None,
        }
    }

    /// The bent ray and the Jacobian `[xx, xy, yy]`, which is symmetric.
    fn map(&self, [x, y]: [f64; 2]) -> ([f64; 2], [f64; 3]) {
        let Self { n, d, p1, p2 } = self;
        let s = x * x + y * y;
        let (num, num_slope) = value_and_slope(n, s);
        let (den, den_slope) = value_and_slope(d, s);
        let g = num / den;
        // d g / d s
        let slope = (num_slope - g * den_slope) / den;
        let bent = [
            x * g + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * g + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        ];
        let jacobian = [
            g + 2.0 * slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            2.0 * slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
            g + 2.0 * slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        ];
        (bent, jacobian)
    }

    /// Newton's method kept inside the disc of `radius`, with the step halved
    /// until the residual falls. The map is the gradient of a convex potential
    /// there, so a target with a preimage is reached; any other ends with a
    /// residual and is refused.
    fn invert(&self, bent: [f64; 2], radius: f64) -> Result<[f64; 2], CameraError> {
        let size = bent[0].hypot(bent[1]);
        let scale = size.max(1.0);
        let shrink = if size > 0.9 * radius { 0.9 * radius / size } else { 1.0 };
        let mut ray = [bent[0] * shrink, bent[1] * shrink];
        let residual_at = |ray: [f64; 2]| {
            let (image, jacobian) = self.map(ray);
            let error = [image[0] - bent[0], image[1] - bent[1]];
            (error, error[0].hypot(error[1]), jacobian)
        };
        let (mut error, mut residual, mut jacobian) = residual_at(ray);
        for _ in 0..MAX_STEPS {
            if residual <= f64::EPSILON * 0.5 * size {
                break;
            }
            let [a, b, c] = jacobian;
            let det = a * c - b * b;
            let step = [(c * error[0] - b * error[1]) / det, (a * error[1] - b * error[0]) / det];
            let mut t = 1.0;
            let better = loop {
                let candidate = [ray[0] - t * step[0], ray[1] - t * step[1]];
                // Not-a-number, from a singular Jacobian, fails both tests.
                if candidate[0].hypot(candidate[1]) <= radius {
                    let found = residual_at(candidate);
                    if found.1 < residual {
                        break Some((candidate, found));
                    }
                }
                t *= 0.5;
                if t < 1e-12 {
                    break None;
                }
            };
            let Some((candidate, found)) = better else { break };
            ray = candidate;
            (error, residual, jacobian) = found;
        }
        if residual <= TOLERANCE * scale {
            Ok(ray)
        } else {
            Err(CameraError::NoInverse { x: bent[0], y: bent[1], residual })
        }
    }
}

/// Radius on the picture and its slope for a ray at angle `t`.
fn equidistant([k1, k2, k3, k4]: &[f64; 4], t: f64) -> (f64, f64) {
    let t2 = t * t;
    let (value, slope) = value_and_slope(&[1.0, *k1, *k2, *k3, *k4], t2);
    (t * value, value + 2.0 * t2 * slope)
}

/// Newton's method on the angle inside a bracket that shrinks by bisection.
fn invert_equidistant(k: &[f64; 4], bent: [f64; 2], radius: f64) -> Result<[f64; 2], CameraError> {
    let target = bent[0].hypot(bent[1]);
    if target == 0.0 {
        return Ok(bent);
    }
    let (mut low, mut high) = (0.0, radius.atan());
    let edge = equidistant(k, high).0;
    if target > edge {
        let residual = target - edge;
        return Err(CameraError::NoInverse { x: bent[0], y: bent[1], residual });
    }
    let mut t = target.min(high);
    let mut residual = f64::INFINITY;
    for _ in 0..2 * MAX_STEPS {
        let (value, slope) = equidistant(k, t);
        let error = value - target;
        residual = error.abs();
        if residual <= f64::EPSILON * 0.5 * target {
            break;
        }
        if error > 0.0 {
            high = t;
        } else {
            low = t;
        }
        let newton = t - error / slope;
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if next == t {
            break;
        }
        t = next;
    }
    if residual <= TOLERANCE * target.max(1.0) {
        let scale = t.tan() / target;
        Ok([bent[0] * scale, bent[1] * scale])
    } else {
        Err(CameraError::NoInverse { x: bent[0], y: bent[1], residual })
    }
}

/// A polynomial, lowest power first, and its derivative at `x`.
fn value_and_slope(c: &[f64], x: f64) -> (f64, f64) {
    c.iter().rev().fold((0.0, 0.0), |(value, slope), &k| (value * x + k, slope * x + value))
}

/// `(f'(r) - 8 rho r) D^2` as a polynomial in `r`, where `f = r N(r^2) / D(r^2)`.
fn fold_polynomial(n: &[f64; 4], d: &[f64; 4], rho: f64) -> Vec<f64> {
    let mut p = vec![0.0; 14];
    for (i, ni) in n.iter().enumerate() {
        for (j, dj) in d.iter().enumerate() {
            // In s = r^2: (N + 2 s N') D - 2 s N D'
            let factor = 1.0 + 2.0 * i as f64 - 2.0 * j as f64;
            p[2 * (i + j)] += factor * ni * dj;
        }
    }
    for (i, di) in d.iter().enumerate() {
        for (j, dj) in d.iter().enumerate() {
            p[2 * (i + j) + 1] -= 8.0 * rho * di * dj;
        }
    }
    p
}

/// The first place in `(0, limit)` where a polynomial that is positive at 0
/// turns negative, from the side where it is still positive.
fn first_sign_change(c: &[f64], limit: f64) -> Option<f64> {
    sign_changes(c, limit).first().copied()
}

/// All sign changes of a polynomial in `(0, limit)`, ascending: between two
/// neighbouring extrema, which are the sign changes of the derivative, lies at
/// most one, found by bisection to the last bit.
fn sign_changes(c: &[f64], limit: f64) -> Vec<f64> {
    let degree = c.iter().rposition(|&k| k != 0.0).unwrap_or(0);
    if degree == 0 {
        return Vec::new();
    }
    let c = &c[..=degree];
    let derivative: Vec<f64> =
        c.iter().enumerate().skip(1).map(|(power, k)| power as f64 * k).collect();
    let mut roots = Vec::new();
    let mut left = 0.0;
    let mut left_value = value_and_slope(c, left).0;
    for right in sign_changes(&derivative, limit).into_iter().chain([limit]) {
        let right_value = value_and_slope(c, right).0;
        if right_value == 0.0 {
            continue;
        }
        if left_value != 0.0 && (left_value > 0.0) != (right_value > 0.0) {
            let (mut low, mut high) = (left, right);
            loop {
                let middle = 0.5 * (low + high);
                if middle <= low || middle >= high {
                    break;
                }
                let value = value_and_slope(c, middle).0;
                if value != 0.0 && (value > 0.0) == (left_value > 0.0) {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            roots.push(low);
        }
        (left, left_value) = (right, right_value);
    }
    roots
}
