//! Which frames of a camera a slower stage takes.

use realnet_core::Stamp;

/// Takes frames at a rate, the first one at once.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Schedule {
    due: Option<Stamp>,
}

impl Schedule {
    /// Frames may be a microsecond early: their stamps are rounded.
    const EARLY_NANOS: i64 = 1000;

    /// Whether a frame of this stamp is taken.
    pub(super) fn is_due(&self, stamp: Stamp) -> bool {
        self.due.is_none_or(|due| stamp.nanos() >= due.nanos().saturating_sub(Self::EARLY_NANOS))
    }

    /// Whether this frame is taken; the next one is a period later. In the mean the
    /// rate is kept, also where it does not divide the camera's.
    pub(super) fn take(&mut self, stamp: Stamp, rate_hz: f64) -> bool {
        if !self.is_due(stamp) {
            return false;
        }
        let period = 1.0 / rate_hz;
        let kept = self.due.map_or(stamp, |due| due.seconds_later(period));
        // One that is late by more than a period does not catch up.
        let next =
            if self.due.is_some() && kept > stamp { kept } else { stamp.seconds_later(period) };
        self.due = Some(next);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(camera_hz: f64, rate_hz: f64, seconds: f64) -> Vec<u64> {
        let mut schedule = Schedule::default();
        let frames = 0..(camera_hz * seconds) as u64;
        frames.filter(|i| schedule.take(Stamp::of_frame(*i, camera_hz), rate_hz)).collect()
    }

    #[test]
    fn keeps_the_rate() {
        assert_eq!(taken(30.0, 3.0, 2.0), [0, 10, 20, 30, 40, 50]);
        assert_eq!(taken(30.0, 1.0, 3.0), [0, 30, 60]);
        assert_eq!(taken(30.0, 30.0, 10.0).len(), 300);
        assert_eq!(taken(30.0, 60.0, 10.0).len(), 300);
        let uneven = taken(30.0, 7.0, 10.0);
        assert!((69..=71).contains(&uneven.len()), "{}", uneven.len());
    }
}
