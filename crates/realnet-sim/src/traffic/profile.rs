//! Speeds over time.

/// A speed over time: straight lines between moments, so that the way is exact.
///
/// Built up from its start; a call that makes no sense (a time below 0, an
/// acceleration of 0 or not a number) adds nothing.
///
/// ```
/// use realnet_sim::traffic::SpeedProfile;
///
/// // 2 s at 1 m/s, then braking at 4 m/s^2 to standstill
/// let profile = SpeedProfile::constant(1.0).hold(2.0).change(0.0, 4.0);
/// assert_eq!(profile.speed(1.0), 1.0);
/// assert_eq!(profile.way(10.0), 2.0 + 1.0 / 8.0);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedProfile {
    /// Time in seconds, speed in m/s, and way until then in metres.
    moments: Vec<[f64; 3]>,
}

impl SpeedProfile {
    /// One speed for ever, m/s: backwards if negative.
    #[must_use]
    pub fn constant(speed: f64) -> Self {
        Self { moments: vec![[0.0, speed, 0.0]] }
    }

    fn last(&self) -> [f64; 3] {
        self.moments.last().copied().unwrap_or_default()
    }

    /// Keeps the last speed for so many seconds more.
    #[must_use]
    pub fn hold(mut self, seconds: f64) -> Self {
        let [time, speed, way] = self.last();
        if seconds > 0.0 {
            self.moments.push([time + seconds, speed, way + speed * seconds]);
        }
        self
    }

    /// Goes on to another speed, m/s, at an acceleration or deceleration of so many
    /// m/s^2, and keeps it for ever if nothing follows.
    #[must_use]
    pub fn change(mut self, speed: f64, acceleration: f64) -> Self {
        let [time, before, way] = self.last();
        let seconds = (speed - before).abs() / acceleration.abs();
        if seconds > 0.0 && seconds < f64::INFINITY {
            self.moments.push([time + seconds, speed, way + 0.5 * (before + speed) * seconds]);
        }
        self
    }

    /// The same with all speeds multiplied; the times stay.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        for [_, speed, way] in &mut self.moments {
            (*speed, *way) = (*speed * factor, *way * factor);
        }
        self
    }

    /// Time of the last change of speed, s.
    #[must_use]
    pub fn changes_until(&self) -> f64 {
        self.last()[0]
    }

    /// The moments around a time: the last one before it and the next one.
    fn around(&self, time_s: f64) -> ([f64; 3], Option<[f64; 3]>) {
        let next = self.moments.partition_point(|[time, ..]| *time <= time_s);
        let before = self.moments.get(next.saturating_sub(1)).copied().unwrap_or_default();
        (before, if next == 0 { None } else { self.moments.get(next).copied() })
    }

    /// Acceleration, m/s^2.
    #[must_use]
    pub fn acceleration(&self, time_s: f64) -> f64 {
        match self.around(time_s) {
            ([time, speed, _], Some([later, then, _])) => (then - speed) / (later - time),
            (_, None) => 0.0,
        }
    }

    /// Speed, m/s; before the start the one at the start.
    #[must_use]
    pub fn speed(&self, time_s: f64) -> f64 {
        let ([time, speed, _], _) = self.around(time_s);
        speed + self.acceleration(time_s) * (time_s - time)
    }

    /// Way since time 0, metres; backwards counts less than 0.
    #[must_use]
    pub fn way(&self, time_s: f64) -> f64 {
        let ([time, speed, way], _) = self.around(time_s);
        let since = time_s - time;
        way + speed * since + 0.5 * self.acceleration(time_s) * since * since
    }

    /// Least and most way until a time, metres.
    #[must_use]
    pub fn reach(&self, until_s: f64) -> (f64, f64) {
        // The way turns where the speed changes its sign, or at the end.
        let turns = self.moments.windows(2).filter_map(|pair| {
            let &[[time, speed, _], [later, then, _]] = pair else { return None };
            let crossing = time + (later - time) * speed / (speed - then);
            (speed * then <= 0.0 && speed != then).then_some(crossing)
        });
        turns
            .filter(|time| *time < until_s)
            .chain([0.0, until_s])
            .map(|t| self.way(t))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), way| {
                (least.min(way), most.max(way))
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn there_and_back() {
        let profile = SpeedProfile::constant(0.0).change(1.0, 2.0).hold(1.0).change(-1.0, 4.0);
        // 0.5 s of gaining, 1 s, then turning 0.25 s later
        assert_eq!(profile.way(1.5), 0.25 + 1.0);
        assert_eq!(profile.speed(1.75), 0.0);
        let (least, most) = profile.reach(4.0);
        assert!((most - 1.375).abs() < 1e-12, "{most}");
        assert!((least - (1.375 - 0.125 - 2.0)).abs() < 1e-12, "{least}");
        assert_eq!(profile.acceleration(1.6), -4.0);
        assert_eq!(profile.acceleration(9.0), 0.0);
        assert_eq!((profile.speed(-1.0), profile.way(-1.0)), (0.0, 0.0));
        assert_eq!(profile.clone().hold(f64::NAN).change(1.0, 0.0), profile);
    }

    proptest! {
        #[test]
        fn the_way_is_the_integral_of_the_speed(
            parts in prop::collection::vec((0.0..1.0f64, -2.0..2.0f64, 0.5..5.0f64), 1..6),
            from in 0.0..4.0f64, length in 0.01..4.0f64,
        ) {
            let profile = parts.iter().fold(SpeedProfile::constant(0.5), |profile, part| {
                profile.hold(part.0).change(part.1, part.2)
            });
            let steps = 4000;
            let step = length / f64::from(steps);
            let sum: f64 = (0..steps)
                .map(|i| profile.speed(from + step * (f64::from(i) + 0.5)) * step)
                .sum();
            let way = profile.way(from + length) - profile.way(from);
            prop_assert!((sum - way).abs() < 1e-4, "{sum} {way}");
        }
    }
}
