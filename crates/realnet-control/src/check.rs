//! Options that do not fit, numbers that nobody can drive by.

use realnet_core::OptionError;
use realnet_core::nalgebra::Vector2;

/// The largest number that is taken for a measurement or an option, in whatever unit:
/// a thousand kilometres. What is larger counts as not finite, so that products of
/// such numbers stay finite.
pub(crate) const LARGEST: f64 = 1e6;

/// Whether a number can be computed with; false for not-a-number.
pub(crate) fn usable(value: f64) -> bool {
    value.abs() <= LARGEST
}

/// Whether both coordinates can be computed with.
pub(crate) fn usable_point(point: &Vector2<f64>) -> bool {
    usable(point.x) && usable(point.y)
}

pub(crate) fn positive(name: &'static str, value: f64) -> Result<(), OptionError> {
    OptionError::check(name, value, value > 0.0 && value <= LARGEST, "above 0")
}

pub(crate) fn not_negative(name: &'static str, value: f64) -> Result<(), OptionError> {
    OptionError::check(name, value, (0.0..=LARGEST).contains(&value), "at least 0")
}

pub(crate) fn share(name: &'static str, value: f64) -> Result<(), OptionError> {
    OptionError::check(name, value, value > 0.0 && value <= 1.0, "above 0, at most 1")
}
