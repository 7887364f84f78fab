//! Settings of the target filter.

use realnet_core::OptionError;

/// An error that measurements of one source share and that changes slowly: normally
/// distributed, remembered for `time_s` (a first-order Gauss-Markov process).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SharedError {
    /// Standard deviation.
    pub std: f64,
    /// After this time it has forgotten all but 1/e of itself, seconds; infinite for
    /// a constant.
    pub time_s: f64,
}

/// The times of the status, in seconds: how old the newest accepted measurement may be.
/// The older one of range and direction counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatusTimes {
    /// From then on it is coasting.
    pub coast_after_s: f64,
    /// From then on it is lost.
    pub lost_after_s: f64,
    /// From then on it is forgotten: searching.
    pub forget_after_s: f64,
}

impl Default for StatusTimes {
    fn default() -> Self {
        Self { coast_after_s: 0.3, lost_after_s: 1.5, forget_after_s: 5.0 }
    }
}

/// Settings of a [`TargetFilter`](crate::TargetFilter). The defaults are for cars at
/// 1:10 (up to 2 m/s, brakes up to 4 m/s²) seen by a 30 Hz camera with a depth network
/// at a few hertz.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetOptions {
    /// How late a measurement may come, seconds behind the newest one.
    pub horizon_s: f64,
    /// Most measurements kept for replay.
    pub capacity: usize,
    /// Most points of the target's path kept beyond the horizon.
    pub trail_capacity: usize,
    /// A measurement this far ahead of the newest known time is refused, seconds.
    pub max_ahead_s: f64,

    /// Spectral density of the jerk along each axis, m²/s⁵: after the time t the
    /// acceleration has wandered by sqrt(density t).
    pub jerk_density: f64,
    /// Acceleration decays with this time, seconds (Singer's model): in the long run its
    /// deviation is sqrt(jerk_density time / 2), and a prediction over seconds does not
    /// run away. Infinite for white jerk alone, whose mean path is a cubic without third
    /// power.
    pub acceleration_time_s: f64,
    /// Standard deviation of a new target's speed over ground, per axis, m/s.
    pub start_speed_std: f64,
    /// Standard deviation of a new target's acceleration, per axis, m/s².
    pub start_acceleration_std: f64,

    /// Standard deviation of the scale error that each depth map has for itself, in the
    /// logarithm (0.1 is 10 %).
    pub map_scale_std: f64,
    /// How far the ranges moved by flow from one map wander from it together, in the
    /// logarithm per square root of a second.
    pub map_drift: f64,
    /// Scale error common to all depth maps, in the logarithm. Without ranges of another
    /// source nothing tells of it: the range is then never surer than this. The default is
    /// for a network that was trained for the camera; one that was not may err by 20 %.
    /// Where the ground shows an error beyond `disagreement_deviations` of what is expected
    /// of both, the network's is opened.
    pub network_error: SharedError,
    /// Error of the ground ranges. Beyond 1 m in the logarithm per metre of range, that is,
    /// the error of the pitch in radians over the height of the camera in metres (half a
    /// degree at 0.2 m is 0.044). Nearer it is the same number in metres, as what is taken
    /// for the target's foot changes with its aspect: in the logarithm over the range.
    pub ground_error: SharedError,
    /// Error of the size ranges, in the logarithm.
    pub size_error: SharedError,

    /// A residual longer than this many standard deviations is not used.
    pub gate_deviations: f64,
    /// Refusals in a row for so long, seconds, ...
    pub reset_after_s: f64,
    /// ... and at least this many, are no outliers: the source's shared error is opened
    /// if another source of ranges agrees with the estimate, otherwise the track begins
    /// anew from the measurements.
    pub reset_count: u32,
    /// Network and ground disagree when the difference of their shared errors is larger
    /// than so many of its expected deviations, and known well. Then the ground is
    /// believed, which has been measured, and the network's common error is opened.
    pub disagreement_deviations: f64,
    /// Standard deviation to which a shared error is opened.
    pub reopened_std: f64,
    /// A first range and a first direction begin a track if they are not further apart
    /// than this, seconds.
    pub begin_within_s: f64,

    /// The times of the status.
    pub times: StatusTimes,
    /// An estimate whose distance has a standard deviation above this share of it is an
    /// explicit unknown.
    pub unknown_above: f64,
}

impl Default for TargetOptions {
    fn default() -> Self {
        Self {
            horizon_s: 1.5,
            capacity: 384,
            trail_capacity: 512,
            max_ahead_s: 10.0,
            jerk_density: 10.0,
            acceleration_time_s: 0.5,
            start_speed_std: 1.0,
            start_acceleration_std: 1.5,
            map_scale_std: 0.1,
            map_drift: 0.01,
            network_error: SharedError { std: 0.04, time_s: 60.0 },
            ground_error: SharedError { std: 0.04, time_s: 10.0 },
            size_error: SharedError { std: 0.1, time_s: 300.0 },
            gate_deviations: 4.0,
            reset_after_s: 0.3,
            reset_count: 5,
            disagreement_deviations: 2.5,
            reopened_std: 0.5,
            begin_within_s: 0.3,
            times: StatusTimes::default(),
            unknown_above: 0.5,
        }
    }
}

impl TargetOptions {
    /// # Errors
    ///
    /// [`OptionError`] names the first field that makes no sense.
    pub fn check(&self) -> Result<(), OptionError> {
        let positive = |name, value: f64| {
            let rule = "positive";
            if value > 0.0 { Ok(()) } else { Err(OptionError { name, value, rule }) }
        };
        // Deviations within 1e-4 to 1e3, so that the factors stay well scaled.
        let deviation = |name, value: f64| {
            OptionError::check(name, value, (1e-4..=1e3).contains(&value), "from 1e-4 to 1e3")
        };
        deviation("jerk_density", self.jerk_density)?;
        positive("acceleration_time_s", self.acceleration_time_s)?;
        deviation("start_speed_std", self.start_speed_std)?;
        deviation("start_acceleration_std", self.start_acceleration_std)?;
        deviation("map_scale_std", self.map_scale_std)?;
        deviation("map_drift", self.map_drift)?;
        deviation("network_error.std", self.network_error.std)?;
        positive("network_error.time_s", self.network_error.time_s)?;
        deviation("ground_error.std", self.ground_error.std)?;
        positive("ground_error.time_s", self.ground_error.time_s)?;
        deviation("size_error.std", self.size_error.std)?;
        positive("size_error.time_s", self.size_error.time_s)?;
        positive("gate_deviations", self.gate_deviations)?;
        positive("reset_after_s", self.reset_after_s)?;
        positive("disagreement_deviations", self.disagreement_deviations)?;
        deviation("reopened_std", self.reopened_std)?;
        positive("begin_within_s", self.begin_within_s)?;
        positive("unknown_above", self.unknown_above)?;
        let StatusTimes { coast_after_s, lost_after_s, forget_after_s } = self.times;
        positive("times.coast_after_s", coast_after_s)?;
        let rule = "not before the time of the status before it";
        if lost_after_s.is_nan() || lost_after_s < coast_after_s {
            return Err(OptionError { name: "times.lost_after_s", value: lost_after_s, rule });
        }
        if forget_after_s.is_nan() || forget_after_s < lost_after_s {
            return Err(OptionError { name: "times.forget_after_s", value: forget_after_s, rule });
        }
        Ok(())
    }
}
