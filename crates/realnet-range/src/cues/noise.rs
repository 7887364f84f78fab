//! What is known about the error of a depth source.

use realnet_core::OptionError;

/// Standard deviation of the error that a depth source makes on a whole object:
/// scale, offset, the network's taste. It is common to the pixels of one map, so
/// it does not shrink when many of them are averaged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthNoise {
    /// The part that does not depend on the depth, metres.
    pub absolute_m: f64,
    /// The part that grows with the depth, as a share of it.
    pub relative: f64,
}

impl DepthNoise {
    /// A source without a common error (a simulator's, a test's).
    pub const NONE: Self = Self { absolute_m: 0.0, relative: 0.0 };

    /// From both parts, which are independent: metres, and a share of the depth.
    #[must_use]
    pub const fn new(absolute_m: f64, relative: f64) -> Self {
        Self { absolute_m, relative }
    }

    /// Standard deviation at a depth, both in metres:
    /// `sqrt(absolute^2 + (relative depth)^2)`.
    #[must_use]
    pub fn std_at(&self, depth_m: f64) -> f64 {
        self.absolute_m.hypot(self.relative * depth_m)
    }

    pub(crate) fn check(&self) -> Result<(), OptionError> {
        let rule = "at least 0";
        OptionError::check("absolute depth noise", self.absolute_m, self.absolute_m >= 0.0, rule)?;
        OptionError::check("relative depth noise", self.relative, self.relative >= 0.0, rule)
    }
}
