//! Options that do not fit.

use thiserror::Error;

/// A number given as an option that nobody can work with.
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
    /// For the checks of options.
    ///
    /// # Errors
    /// This error, unless `value` is finite and `ok`.
    pub fn check(name: &'static str, value: f64, ok: bool, rule: &'static str) -> Result<(), Self> {
        if ok && value.is_finite() { Ok(()) } else { Err(Self { name, value, rule }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_finite_never_fits() {
        assert_eq!(OptionError::check("gap_m", 1.0, true, "above 0"), Ok(()));
        let error = OptionError::check("gap_m", -1.0, false, "above 0").unwrap_err();
        assert_eq!(error.to_string(), "gap_m is -1, it must be above 0");
        assert!(OptionError::check("gap_m", f64::INFINITY, true, "above 0").is_err());
        assert!(OptionError::check("gap_m", f64::NAN, true, "above 0").is_err());
    }
}
