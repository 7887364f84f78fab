//! Time of exposure.

use std::fmt;

/// The exposure time of a frame, in nanoseconds since an epoch that the source
/// chooses (the Unix epoch for cameras, the first frame for files).
///
/// A stamp says when the light fell on the sensor, never when the picture
/// arrived. Two stamps of one source can be compared and subtracted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Stamp(i64);

impl Stamp {
    /// The epoch itself.
    pub const ZERO: Self = Self(0);

    /// A stamp of so many nanoseconds after the epoch.
    #[must_use]
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// A stamp of so many seconds after the epoch, rounded to the nanosecond.
    /// Not-a-number becomes the epoch; what lies outside 64 bits saturates.
    #[must_use]
    pub fn from_secs_f64(seconds: f64) -> Self {
        // `as` saturates and maps NaN to zero, which is what is promised above.
        Self((seconds * 1e9).round() as i64)
    }

    /// The stamp of frame number `index` of a sequence at `fps` frames a second
    /// that starts at the epoch, without accumulating rounding errors.
    #[must_use]
    pub fn of_frame(index: u64, fps: f64) -> Self {
        Self::from_secs_f64(index as f64 / fps)
    }

    /// Nanoseconds since the epoch.
    #[must_use]
    pub const fn nanos(self) -> i64 {
        self.0
    }

    /// Seconds since the epoch.
    #[must_use]
    pub fn secs_f64(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// So many seconds after this stamp, before it for a negative number; rounded and
    /// saturating as [`Stamp::from_secs_f64`].
    #[must_use]
    pub fn seconds_later(self, seconds: f64) -> Self {
        Self(self.0.saturating_add(Self::from_secs_f64(seconds).0))
    }

    /// Seconds from `earlier` to `self`; negative when `self` is the earlier one.
    #[must_use]
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (self.0 as i128 - earlier.0 as i128) as f64 * 1e-9
    }
}

impl fmt::Display for Stamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let nanos = self.0.unsigned_abs();
        write!(f, "{sign}{}.{:09} s", nanos / 1_000_000_000, nanos % 1_000_000_000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_stamps_do_not_drift() {
        assert_eq!(Stamp::of_frame(3, 30.0).nanos(), 100_000_000);
        assert_eq!(Stamp::of_frame(30 * 86_400, 30.0).nanos(), 86_400_000_000_000);
    }

    #[test]
    fn differences_never_overflow() {
        let first = Stamp::from_nanos(i64::MIN);
        let last = Stamp::from_nanos(i64::MAX);
        assert!((last.seconds_since(first) - 18_446_744_073.709_55).abs() < 1e-3);
        assert_eq!(Stamp::from_secs_f64(f64::NAN), Stamp::ZERO);
        assert_eq!(Stamp::from_secs_f64(f64::INFINITY), last);
    }

    #[test]
    fn later_stamps_are_exact_and_saturate() {
        let now = Stamp::from_nanos(1_800_000_000_123_456_789);
        assert_eq!(now.seconds_later(0.02).nanos(), 1_800_000_000_143_456_789);
        assert_eq!(now.seconds_later(-6.0).nanos(), 1_799_999_994_123_456_789);
        assert_eq!(now.seconds_later(f64::INFINITY).nanos(), i64::MAX);
        assert_eq!(now.seconds_later(f64::NAN), now);
    }

    #[test]
    fn display_has_nanoseconds() {
        assert_eq!(Stamp::from_nanos(1_500_000_001).to_string(), "1.500000001 s");
        assert_eq!(Stamp::from_nanos(-5).to_string(), "-0.000000005 s");
    }
}
