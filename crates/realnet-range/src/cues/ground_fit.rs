//! The ground plane in a depth map.

use super::attitude::{Attitude, MAX_ANGLE, Uncertain};
use super::noise::DepthNoise;
use super::pitch::{PitchMeasurement, PitchSource};
use realnet_core::OptionError;
use realnet_core::nalgebra::{Matrix3, Vector3};
use realnet_core::{BoundingBox, CameraError, CameraModel, DepthMap};
use thiserror::Error;

/// Pixels that take part in the search; the refinement has all of them.
const SEARCH_SAMPLES: usize = 500;
/// Steps of the search over +-3 deviations of pitch, roll and height.
const SEARCH_STEPS: [usize; 3] = [31, 9, 13];
/// Rounds of the refinement.
const ROUNDS: usize = 16;
/// Pixels within so many deviations of the prior could be ground: one more than
/// the search spans, so that the noise of a floor at its end is not cut.
const GATE_SIGMAS: f64 = 4.0;
/// Vertical stripes of the picture that the jackknife leaves out one by one.
const STRIPES: usize = 10;
/// Residuals of a larger scale than this, in deviations of the pixel noise, are
/// no plane: depths that are spread evenly over the tolerance have 3.5.
const MAX_SCALE: f64 = 2.5;
/// Tukey's constant: 95 % of the efficiency of least squares on normal errors.
const TUKEY: f64 = 4.685;

/// What is known about the ground beforehand: how the camera is mounted, or what
/// the filter says now. The fit looks within three deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundPrior {
    /// Height of the camera, metres.
    pub camera_height_m: Uncertain,
    /// Pitch, radians, positive: nose down.
    pub pitch_rad: Uncertain,
    /// Roll, radians, positive: right side down.
    pub roll_rad: Uncertain,
}

/// How [`GroundFit`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundFitOptions {
    /// Random deviation of a pixel's depth, both parts not 0 together.
    pub pixel_noise: DepthNoise,
    /// Distance in pixels over which random errors are alike: a square of this
    /// side counts as one measurement.
    pub correlation_px: f64,
    /// Deviation of real floors from a plane, as an angle: how much the pitch and
    /// roll of the part that is seen differ from those under the wheels, radians.
    pub flatness_rad: f64,
    /// At most about this many pixels are read, on a regular grid.
    pub max_samples: usize,
    /// Fewer pixels on the ground are refused.
    pub min_pixels: usize,
    /// A smaller share of the pixels that could be ground is refused.
    pub min_share: f64,
    /// A larger standard deviation of the pitch is refused, radians.
    pub max_pitch_std_rad: f64,
}

impl Default for GroundFitOptions {
    fn default() -> Self {
        Self {
            pixel_noise: DepthNoise::new(0.005, 0.01),
            correlation_px: 4.0,
            flatness_rad: 0.003,
            max_samples: 4000,
            min_pixels: 80,
            min_share: 0.35,
            max_pitch_std_rad: 0.05,
        }
    }
}

/// Why there is no ground in a depth map.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum GroundFitError {
    /// Camera and map are not of one size.
    #[error("the camera has {camera_width}x{camera_height} pixels, the map {width}x{height}")]
    Size {
        /// Pixels a row of the camera.
        camera_width: u32,
        /// Rows of the camera.
        camera_height: u32,
        /// Pixels a row of the map.
        width: u32,
        /// Rows of the map.
        height: u32,
    },
    /// Too few pixels could be ground, by the prior.
    #[error("{found} depths could be ground, {needed} are needed")]
    TooFew {
        /// Pixels found.
        found: usize,
        /// Least number accepted.
        needed: usize,
    },
    /// Too few of them lie on one plane.
    #[error("{inliers} of {candidates} depths that could be ground lie on one plane")]
    NoPlane {
        /// Pixels on the plane.
        inliers: usize,
        /// Pixels that could be ground.
        candidates: usize,
    },
    /// The pixels do not lie on a plane, or `pixel_noise` is far too small.
    #[error("depths scatter by {scale:.1} times the pixel noise about the plane, limit {limit}")]
    Rough {
        /// Scale of the residuals in deviations of the pixel noise.
        scale: f64,
        /// Largest scale accepted.
        limit: f64,
    },
    /// The pixels lie too close together or are too noisy to define the plane.
    #[error("the pitch of the plane is uncertain by {std_rad} rad, at most {limit} is accepted")]
    TooUncertain {
        /// Standard deviation of the pitch, radians.
        std_rad: f64,
        /// Largest deviation accepted.
        limit: f64,
    },
    /// There is a plane, but not where the prior says.
    #[error("a plane with {name} {found}, where {expected} +- {std} was expected")]
    Contradiction {
        /// `height`, `pitch` or `roll`.
        name: &'static str,
        /// Of the plane, metres or radians.
        found: f64,
        /// Of the prior.
        expected: f64,
        /// Standard deviation of the difference.
        std: f64,
    },
    /// The camera has no ray for the horizon.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A number given does not fit.
    #[error(transparent)]
    Option(#[from] OptionError),
}

/// The ground in a depth map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundPlane {
    /// Pitch, radians, positive: nose down.
    pub pitch_rad: Uncertain,
    /// Roll, radians, positive: right side down.
    pub roll_rad: Uncertain,
    /// Height of the camera, metres. It takes over the depth source's scale.
    pub camera_height_m: Uncertain,
    /// Row of the horizon on the ray straight ahead, with its deviation, pixels.
    pub horizon_row: Uncertain,
    /// Pixels on the plane.
    pub inliers: usize,
    /// Pixels that could be ground, by the prior.
    pub candidates: usize,
    /// Scale of the inliers' residuals, as a share of `pixel_noise`.
    pub residual_scale: f64,
}

impl GroundPlane {
    /// Pitch and roll without their deviations.
    #[must_use]
    pub fn attitude(&self) -> Attitude {
        Attitude::new(self.pitch_rad.value, self.roll_rad.value)
    }

    /// The pitch, for a [`PitchFilter`](super::PitchFilter).
    #[must_use]
    pub fn measurement(&self) -> PitchMeasurement {
        let Uncertain { value, std } = self.pitch_rad;
        PitchMeasurement { source: PitchSource::GroundFit, pitch_rad: value, std_rad: std }
    }
}

/// A pixel: its ray, inverse depth, and the random deviation of that.
#[derive(Clone, Copy, Debug)]
struct Point {
    ray: Vector3<f64>,
    inverse: f64,
    std: f64,
    stripe: usize,
}

/// A refined plane.
struct Refined {
    /// `down / height`.
    theta: Vector3<f64>,
    /// Its covariance by the residuals, and the source's offset.
    formal: Matrix3<f64>,
    /// Its covariance by the jackknife, and the source's offset.
    jackknife: Matrix3<f64>,
    inliers: usize,
    scale: f64,
    /// Mean depth of the inliers (harmonic), metres.
    distance: f64,
    /// What the outliers may have shifted the plane by, in inverse depth.
    clutter: f64,
}

/// Fits the ground plane to the lower part of a depth map.
///
/// A plane `down . X = height` is linear in the *inverse* depth of a pixel:
/// `1 / Z = (down / height) . [x, y, 1]` (with a pinhole and no roll this is the
/// line in the v-disparity image of Labayrade et al., 2002). The prior says which
/// pixels could be ground; a search over its pitch, roll and height finds the
/// plane that most of them support, and Tukey's estimator refines it, with the
/// scale of the residuals from their median. No randomness is involved.
///
/// The deviations are the larger ones of two: from the residuals, and from a
/// jackknife over ten vertical stripes of the picture (the plane without each of
/// them), which also sees what is not independent from pixel to pixel: a foot of
/// some object taken for floor, a bump. To them come the floor's flatness, the
/// source's common offset, and for clutter the noise times the ratio of outliers
/// to inliers; a common scale changes the height only.
///
/// With a wide prior any large horizontal surface will do, a table as well as the
/// floor: give the prior of a known mount.
///
/// Owns its scratch: after the first map of a size nothing is allocated.
#[derive(Clone, Debug)]
pub struct GroundFit {
    options: GroundFitOptions,
    points: Vec<Point>,
    residuals: Vec<f64>,
}

impl GroundFit {
    /// # Errors
    /// [`OptionError`] when an option is out of its range.
    pub fn new(options: GroundFitOptions) -> Result<Self, OptionError> {
        let check = OptionError::check;
        let positive = |name, value: f64| check(name, value, value > 0.0, "greater than 0");
        let not_negative = |name, value: f64| check(name, value, value >= 0.0, "at least 0");
        options.pixel_noise.check()?;
        positive("pixel_noise at 1 m", options.pixel_noise.std_at(1.0))?;
        not_negative("correlation_px", options.correlation_px)?;
        not_negative("flatness_rad", options.flatness_rad)?;
        check("max_samples", options.max_samples as f64, options.max_samples >= 64, "at least 64")?;
        check("min_pixels", options.min_pixels as f64, options.min_pixels >= 8, "at least 8")?;
        check("min_share", options.min_share, (0.0..=1.0).contains(&options.min_share), "0 to 1")?;
        positive("max_pitch_std_rad", options.max_pitch_std_rad)?;
        // The grid gives about so many, by less than a quarter more.
        let room = options.max_samples.min(1 << 16) / 4 * 5;
        let (points, residuals) = (Vec::with_capacity(room), Vec::with_capacity(room));
        Ok(Self { options, points, residuals })
    }

    /// The ground in `map`, whose picture `camera` is. Pixels in one of the boxes
    /// `exclude` (targets) are not regarded. `source` is the error common to the
    /// map's depths.
    ///
    /// # Errors
    /// [`GroundFitError`] with the reason why there is none.
    pub fn fit(
        &mut self,
        map: &DepthMap,
        camera: &CameraModel,
        exclude: &[BoundingBox],
        prior: &GroundPrior,
        source: DepthNoise,
    ) -> Result<GroundPlane, GroundFitError> {
        let (width, height) = (map.width(), map.height());
        let (camera_width, camera_height) = (camera.width(), camera.height());
        if (width, height) != (camera_width, camera_height) {
            return Err(GroundFitError::Size { camera_width, camera_height, width, height });
        }
        prior.check()?;
        source.check()?;
        let step = self.read(map, camera, exclude, prior, source);
        let candidates = self.points.len();
        let needed = self.options.min_pixels;
        if candidates < needed {
            return Err(GroundFitError::TooFew { found: candidates, needed });
        }
        let (start, tolerance) = self.search(prior, source);
        let fit = self.refine(start, tolerance, source, step);
        let share = self.options.min_share * candidates as f64;
        let fit = match fit {
            Some(fit) if fit.inliers >= needed && fit.inliers as f64 >= share => fit,
            other => {
                let inliers = other.map_or(0, |fit| fit.inliers);
                return Err(GroundFitError::NoPlane { inliers, candidates });
            }
        };
        let (inliers, residual_scale) = (fit.inliers, fit.scale);
        if residual_scale > MAX_SCALE {
            return Err(GroundFitError::Rough { scale: residual_scale, limit: MAX_SCALE });
        }
        let (pitch_rad, roll_rad, camera_height_m) = self.plane_of(&fit, source);
        let limit = self.options.max_pitch_std_rad;
        if pitch_rad.std.is_nan() || pitch_rad.std > limit {
            return Err(GroundFitError::TooUncertain { std_rad: pitch_rad.std, limit });
        }
        for (name, found, expected) in [
            ("height", camera_height_m, prior.camera_height_m),
            ("pitch", pitch_rad, prior.pitch_rad),
            ("roll", roll_rad, prior.roll_rad),
        ] {
            let std = found.std.hypot(expected.std);
            if (found.value - expected.value).abs() > 3.0 * std {
                let (found, expected) = (found.value, expected.value);
                return Err(GroundFitError::Contradiction { name, found, expected, std });
            }
        }
        let row = |pitch: f64| Attitude::new(pitch, roll_rad.value).horizon_pixel(camera, 0.0);
        let small = 1e-4;
        let by_pitch = (row(pitch_rad.value + small)?[1] - row(pitch_rad.value - small)?[1]).abs()
            / (2.0 * small);
        let horizon_row = Uncertain::new(row(pitch_rad.value)?[1], by_pitch * pitch_rad.std);
        Ok(GroundPlane {
            pitch_rad,
            roll_rad,
            camera_height_m,
            horizon_row,
            inliers,
            candidates,
            residual_scale,
        })
    }

    /// Reads the pixels that could be ground; the step of the grid.
    fn read(
        &mut self,
        map: &DepthMap,
        camera: &CameraModel,
        exclude: &[BoundingBox],
        prior: &GroundPrior,
        source: DepthNoise,
    ) -> usize {
        self.points.clear();
        let area = map.width() as usize * map.height() as usize;
        let step = ((area as f64 / self.options.max_samples as f64).sqrt().ceil() as usize).max(1);
        let expected = prior.camera_height_m.value;
        let attitude = Attitude::new(prior.pitch_rad.value, prior.roll_rad.value);
        let down = attitude.down();
        let (sr, cr) = attitude.roll_rad.sin_cos();
        let (sp, cp) = attitude.pitch_rad.sin_cos();
        for y in (0..map.height()).skip(step / 2).step_by(step) {
            for (x, &depth) in map.row(y).iter().enumerate().skip(step / 2).step_by(step) {
                if !DepthMap::is_known(depth) {
                    continue;
                }
                let (u, v) = (x as f64, f64::from(y));
                let inside = |b: &BoundingBox| {
                    let (u, v) = (u + 0.5, v + 0.5);
                    u >= f64::from(b.x0)
                        && u < f64::from(b.x1)
                        && v >= f64::from(b.y0)
                        && v < f64::from(b.y1)
                };
                if exclude.iter().any(inside) {
                    continue;
                }
                // A pixel beyond the lens model has no ray and is no ground.
                let Ok([rx, ry]) = camera.unproject([u, v]) else { continue };
                let ray = Vector3::new(rx, ry, 1.0);
                let depth = f64::from(depth);
                let fall = down.dot(&ray);
                let noise = self.options.pixel_noise.std_at(depth);
                let height_std = (fall * noise.hypot(source.std_at(depth)))
                    .hypot(prior.camera_height_m.std)
                    .hypot(depth * (cp - sp * (sr * rx + cr * ry)) * prior.pitch_rad.std)
                    .hypot(depth * cp * (cr * rx - sr * ry) * prior.roll_rad.std);
                if (depth * fall - expected).abs() <= GATE_SIGMAS * height_std {
                    let inverse = 1.0 / depth;
                    let std = noise * inverse * inverse;
                    let stripe = x * STRIPES / map.width() as usize;
                    self.points.push(Point { ray, inverse, std, stripe });
                }
            }
        }
        step
    }

    /// The plane of the prior's range that most pixels support, as `down /
    /// height`, and the tolerance in inverse depth times height (radians) that
    /// the grid of the search asks for.
    fn search(&self, prior: &GroundPrior, source: DepthNoise) -> (Vector3<f64>, f64) {
        let every = self.points.len().div_ceil(SEARCH_SAMPLES);
        let height = prior.camera_height_m;
        // The height also takes over the source's scale.
        let height_std = height.std.hypot(source.relative * height.value);
        let spans = [
            (prior.pitch_rad.value, prior.pitch_rad.std),
            (prior.roll_rad.value, prior.roll_rad.std),
            (height.value, height_std),
        ];
        let mut grids = [(0.0, 0.0, 1); 3];
        for ((grid, (value, std)), steps) in grids.iter_mut().zip(spans).zip(SEARCH_STEPS) {
            *grid = if std > 0.0 {
                let first = value - 3.0 * std;
                (first, 6.0 * std / (steps - 1) as f64, steps)
            } else {
                (value, 0.0, 1)
            };
        }
        let at = |(first, width, _): (f64, f64, usize), index: usize| first + width * index as f64;
        let [pitches, rolls, heights] = grids;
        let mut best = (f64::NEG_INFINITY, Vector3::zeros());
        for pitch in 0..pitches.2 {
            for roll in 0..rolls.2 {
                let down = Attitude::new(at(pitches, pitch), at(rolls, roll)).down();
                for height in 0..heights.2 {
                    let height = at(heights, height);
                    if height <= 0.0 {
                        continue;
                    }
                    let mut score = 0.0;
                    for point in self.points.iter().step_by(every) {
                        let miss = down.dot(&point.ray) - height * point.inverse;
                        let x = rolls.1 * point.ray.x;
                        let w = heights.1 * point.inverse;
                        let grid = 0.25 * (pitches.1 * pitches.1 + x * x + w * w);
                        let noise = height * point.std;
                        let variance = grid + noise * noise;
                        // Quadratic up to 2 deviations, then flat.
                        score += (1.0 - 0.25 * miss * miss / variance).max(0.0);
                    }
                    if score > best.0 {
                        best = (score, down / height);
                    }
                }
            }
        }
        (best.1, 0.5 * pitches.1)
    }

    /// Tukey's estimate of the plane.
    fn refine(
        &mut self,
        start: Vector3<f64>,
        tolerance: f64,
        source: DepthNoise,
        step: usize,
    ) -> Option<Refined> {
        let mut theta = start;
        // In inverse depth; it is halved each round, so it is nothing at the end.
        let mut blur = tolerance * theta.norm();
        let mut scale = 1.0_f64;
        for _ in 0..ROUNDS {
            let mut normal = Matrix3::zeros();
            let mut right = Vector3::zeros();
            for point in &self.points {
                let expected = theta.dot(&point.ray);
                let std = (scale.min(MAX_SCALE) * self.noise_at(expected)).hypot(blur);
                let miss = point.inverse - expected;
                let weight = tukey_weight(miss / std) / (std * std);
                normal += weight * point.ray * point.ray.transpose();
                right += weight * point.inverse * point.ray;
            }
            theta = normal.try_inverse()? * right;
            blur *= 0.5;
            scale = self.scale(&theta, blur)?;
        }
        // Covariance of the estimate (Huber, "Robust Statistics", 1981, 7.6):
        // s^2 mean(psi^2) / mean(psi')^2 (A^T A)^-1, over the inliers.
        let (mut ata, mut shift) = (Matrix3::zeros(), Vector3::zeros());
        let (mut psi_squares, mut psi_slopes, mut inliers) = (0.0, 0.0, 0_usize);
        let (mut inverse, mut noise) = (0.0, 0.0);
        let mut stripes = [(Matrix3::zeros(), Vector3::zeros()); STRIPES];
        for point in &self.points {
            let expected = theta.dot(&point.ray);
            let std = scale * self.noise_at(expected);
            let r = (point.inverse - expected) / std;
            let weight = tukey_weight(r);
            if weight > 0.0 && std.is_finite() {
                inliers += 1;
                inverse += point.inverse;
                noise += std;
                let row = point.ray / std;
                ata += row * row.transpose();
                if let Some((normal, right)) = stripes.get_mut(point.stripe) {
                    *normal += weight * row * row.transpose();
                    *right += weight * r * row;
                }
                psi_squares += (weight * r).powi(2);
                let q = (r / TUKEY).powi(2);
                psi_slopes += (1.0 - q) * (1.0 - 5.0 * q);
                // What an offset of one metre of all depths does: -1 / Z^2.
                shift += weight / std * row * (point.inverse * point.inverse);
            }
        }
        if inliers <= 3 || psi_slopes <= 0.0 {
            return None;
        }
        let count = inliers as f64;
        let factor = psi_squares / (count - 3.0) / (psi_slopes / count).powi(2);
        let alike = (self.options.correlation_px / step as f64).powi(2).max(1.0);
        let weighted: Matrix3<f64> = stripes.iter().map(|(normal, _)| normal).sum();
        let by_offset = source.absolute_m * (weighted.try_inverse()? * shift);
        let offset = by_offset * by_offset.transpose();
        let formal = factor * alike * ata.try_inverse()? + offset;
        let jackknife = jackknife(&stripes)? + offset;
        let distance = count / inverse;
        // Outliers on one side shift an M-estimate by about the scale times their
        // number over that of the inliers.
        let clutter = noise / count * (self.points.len() as f64 - count) / count;
        Some(Refined { theta, formal, jackknife, inliers, scale, distance, clutter })
    }

    /// Pitch, roll and height with their deviations.
    fn plane_of(&self, fit: &Refined, source: DepthNoise) -> (Uncertain, Uncertain, Uncertain) {
        let theta = fit.theta;
        let norm = theta.norm();
        let (height, down) = (1.0 / norm, theta / norm);
        let pitch = down.z.clamp(-1.0, 1.0).asin();
        let level = theta.x * theta.x + theta.y * theta.y;
        let by_pitch = height * (Vector3::z() - down * down.z) / pitch.cos();
        let by_roll = Vector3::new(theta.y, -theta.x, 0.0) / level;
        let by_height = -height * height * down;
        let std = |gradient: &Vector3<f64>| {
            let formal = (fit.formal * gradient).dot(gradient);
            let jackknife = (fit.jackknife * gradient).dot(gradient);
            formal.max(jackknife).max(0.0).sqrt()
        };
        let flatness = self.options.flatness_rad.hypot(fit.clutter * height);
        (
            Uncertain::new(pitch, std(&by_pitch).hypot(flatness)),
            Uncertain::new(theta.x.atan2(theta.y), std(&by_roll).hypot(flatness)),
            Uncertain::new(
                height,
                std(&by_height).hypot(source.relative * height).hypot(flatness * fit.distance),
            ),
        )
    }

    /// Random deviation of an inverse depth that the plane expects. The measured
    /// one would give smaller weights to what is seen too near. Above the horizon
    /// it is infinite: nothing there is ground.
    fn noise_at(&self, inverse: f64) -> f64 {
        if inverse > 0.0 {
            self.options.pixel_noise.std_at(1.0 / inverse) * inverse * inverse
        } else {
            f64::INFINITY
        }
    }

    /// The scale of the residuals in deviations of the pixel noise: 1.4826 times
    /// their median size, over those within reach of the plane.
    fn scale(&mut self, theta: &Vector3<f64>, blur: f64) -> Option<f64> {
        self.residuals.clear();
        for point in &self.points {
            let expected = theta.dot(&point.ray);
            let std = self.noise_at(expected);
            let miss = (point.inverse - expected).abs();
            // Clutter must not widen the scale that decides what clutter is.
            if std.is_finite() && miss <= TUKEY * std.hypot(blur) {
                self.residuals.push(miss / std);
            }
        }
        let middle = self.residuals.len() / 2;
        if middle == 0 {
            return None;
        }
        let (_, median, _) = self.residuals.select_nth_unstable_by(middle, f64::total_cmp);
        Some((1.4826 * *median).max(0.05))
    }
}

impl GroundPrior {
    fn check(&self) -> Result<(), OptionError> {
        self.camera_height_m.check_positive("camera_height_m")?;
        self.pitch_rad.check_within("pitch_rad", MAX_ANGLE)?;
        self.roll_rad.check_within("roll_rad", MAX_ANGLE)
    }
}

/// `(1 - (r / c)^2)^2` inside `c`, 0 beyond.
fn tukey_weight(r: f64) -> f64 {
    let q = (r / TUKEY).powi(2);
    if q < 1.0 { (1.0 - q) * (1.0 - q) } else { 0.0 }
}

/// Covariance of a least squares estimate by the delete-one-group jackknife
/// (Efron, 1982): `(g - 1) / g` times the sum of the squares of its moves, about
/// their mean. A group is the normal matrix and the right side of its residuals.
fn jackknife(groups: &[(Matrix3<f64>, Vector3<f64>); STRIPES]) -> Option<Matrix3<f64>> {
    let normal: Matrix3<f64> = groups.iter().map(|(normal, _)| normal).sum();
    let right: Vector3<f64> = groups.iter().map(|(_, right)| right).sum();
    let mut moves = [Vector3::zeros(); STRIPES];
    let mut used = 0_usize;
    for (to, (part, part_right)) in moves.iter_mut().zip(groups) {
        if part.trace() > 0.0 {
            *to = (normal - part).try_inverse()? * (right - part_right);
            used += 1;
        }
    }
    if used < 2 {
        return None;
    }
    let mean = moves.iter().sum::<Vector3<f64>>() / used as f64;
    let mut sum = Matrix3::zeros();
    for (step, (part, _)) in moves.iter().zip(groups) {
        if part.trace() > 0.0 {
            sum += (step - mean) * (step - mean).transpose();
        }
    }
    Some(sum * ((used - 1) as f64 / used as f64))
}
