//! When a fault holds.

use realnet_core::Stamp;

/// Something that holds for a while: times are seconds since the start of the run,
/// which is stamp 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window<T> {
    /// From when on.
    pub from_s: f64,
    /// Until when, itself not included; infinite: until the end.
    pub until_s: f64,
    /// What.
    pub what: T,
}

impl<T> Window<T> {
    /// What holds from one time until another.
    pub const fn new(from_s: f64, until_s: f64, what: T) -> Self {
        Self { from_s, until_s, what }
    }

    /// What holds for the whole run.
    pub const fn always(what: T) -> Self {
        Self { from_s: f64::NEG_INFINITY, until_s: f64::INFINITY, what }
    }

    /// Whether it holds at a time.
    #[must_use]
    pub fn holds(&self, time: Stamp) -> bool {
        (self.from_s..self.until_s).contains(&time.secs_f64())
    }
}

/// What holds at a time, of several windows.
pub(super) fn holding<T>(windows: &[Window<T>], time: Stamp) -> impl Iterator<Item = &T> {
    windows.iter().filter(move |window| window.holds(time)).map(|window| &window.what)
}
