//! Options that do not fit, numbers that nobody can drive by.

use realnet_core::nalgebra::Vector2;
use thiserror::Error;

/// An option that cannot be worked with.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("{name} is {value}, it must be {rule}")]
pub struct OptionError {
    /// Name of the option, as the path of its fields.
    pub name: &'static str,
    /// What was given.
    pub value: f64,
    /// What is accepted, in words.
    pub rule: &'static str,
}

impl OptionError {
    /// Nothing when `value` is finite and `ok`, otherwise the error.
    pub(crate) fn check(
        name: &'static str,
        value: f64,
        ok: bool,
        rule: &'static str,
    ) -> Result<(), Self> {
        if ok && value.is_finite() { Ok(()) } else { Err(Self { name, value, rule }) }
    }

    pub(crate) fn positive(name: &'static str, value: f64) -> Result<(), Self> {
        Self::check(name, value, value > 0.0 && value <= LARGEST, "above 0")
    }

    pub(crate) fn not_negative(name: &'static str, value: f64) -> Result<(), Self> {
        Self::check(name, value, (0.0..=LARGEST).contains(&value), "at least 0")
    }

    pub(crate) fn share(name: &'static str, value: f64) -> Result<(), Self> {
        Self::check(name, value, value > 0.0 && value <= 1.0, "above 0, at most 1")
    }
}

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
