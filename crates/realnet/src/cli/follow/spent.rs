//! Where the time goes.

use super::record::Clock;
use hdrhistogram::Histogram;
use realnet::pipeline::Work;
use std::fmt;

/// Times of a kind of work over a run.
struct Times(Histogram<u64>);

impl Times {
    /// Up to a minute, to a thousandth.
    fn new() -> Self {
        const HIGHEST_US: u64 = 60_000_000;
        #[expect(clippy::expect_used, reason = "both numbers are within what it accepts")]
        Self(Histogram::new_with_max(HIGHEST_US, 3).expect("a range of microseconds"))
    }

    fn add(&mut self, ms: f64) {
        self.0.saturating_record((ms * 1e3).round().max(0.0) as u64);
    }
}

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |share: f64| self.0.value_at_quantile(share) as f64 / 1e3;
        write!(f, "p50 {:.1}, p90 {:.1}, p99 {:.1} ms", ms(0.5), ms(0.9), ms(0.99))
    }
}

/// Where the time went in a run.
pub(super) struct Spent {
    work: [(Work, Times); Work::ALL.len()],
    /// From a frame's coming to its command.
    to_command: Times,
}

impl Spent {
    pub(super) fn new() -> Self {
        Self { work: Work::ALL.map(|work| (work, Times::new())), to_command: Times::new() }
    }

    /// A frame was done with, `to_command_ms` after it came.
    pub(super) fn add(&mut self, clock: &Clock, to_command_ms: f64) {
        self.to_command.add(to_command_ms);
        for (work, ms) in clock.spent() {
            if let Some((_, times)) = self.work.iter_mut().find(|(own, _)| *own == work) {
                times.add(ms);
            }
        }
    }
}

impl fmt::Display for Spent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "frame to command: {}", self.to_command)?;
        for (work, times) in self.work.iter().filter(|(_, times)| !times.0.is_empty()) {
            write!(f, "\n{}: {times}", work.name())?;
        }
        Ok(())
    }
}
