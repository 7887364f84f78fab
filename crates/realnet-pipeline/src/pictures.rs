//! The pictures that an answer of the detector may still come for.

use realnet_core::Stamp;
use realnet_vision::Pyramid;

/// How long every picture is kept while nobody says which ones the detector was given,
/// seconds.
const ALL_FOR_S: f64 = 1.5;
/// How long one that the detector was given is kept for its answer, seconds.
const AWAITED_FOR_S: f64 = 4.0;
/// Most pictures that are kept: `ALL_FOR_S` at 60 a second, and those that are in use.
const MOST: usize = 96;

/// Keeps pictures for so long that late detections find theirs, whatever the rate of the
/// frames, in as many places as that takes: memory is used again, and taken only while the
/// rate rises. Beyond [`MOST`] the oldest are let go.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pictures {
    places: Vec<Place>,
    newest: Option<Stamp>,
    /// Somebody says which pictures the detector is given; the others need not be kept.
    chosen: bool,
}

#[derive(Clone, Debug)]
struct Place {
    picture: Pyramid,
    /// The detector has it, and did not answer.
    awaited: bool,
}

impl Pictures {
    pub(crate) fn get(&self, stamp: Stamp) -> Option<&Pyramid> {
        self.places.iter().map(|place| &place.picture).find(|picture| picture.stamp() == stamp)
    }

    /// Adds the present picture. Those `in_use` stay.
    pub(crate) fn put(&mut self, picture: &Pyramid, in_use: impl Fn(Stamp) -> bool) {
        let now = picture.stamp();
        self.newest = Some(now);
        let chosen = self.chosen;
        let is_expected = |place: &Place| {
            let age_s = now.seconds_since(place.picture.stamp());
            if chosen { place.awaited && age_s <= AWAITED_FOR_S } else { age_s <= ALL_FOR_S }
        };
        let is_full = self.places.len() >= MOST;
        let places = self.places.iter_mut().filter(|place| !in_use(place.picture.stamp()));
        let free = places.filter(|place| is_full || !is_expected(place));
        // Those that nobody expects first; none of them is left if it is full of others.
        match free.min_by_key(|place| (is_expected(place), place.picture.stamp())) {
            Some(place) => place.take(picture),
            None => self.places.push(Place { picture: picture.clone(), awaited: false }),
        }
    }

    /// The detector is given the present picture, and will not be given those of which this
    /// is not said.
    pub(crate) fn await_newest(&mut self) {
        self.chosen = true;
        self.mark(self.newest, true);
    }

    /// The detector's answer for a picture came.
    pub(crate) fn answered(&mut self, stamp: Stamp) {
        self.mark(Some(stamp), false);
    }

    fn mark(&mut self, stamp: Option<Stamp>, awaited: bool) {
        let mut places = self.places.iter_mut();
        if let Some(place) = places.find(|place| Some(place.picture.stamp()) == stamp) {
            place.awaited = awaited;
        }
    }

    /// Forgets all pictures, not whether they are chosen.
    pub(crate) fn restart(&mut self) {
        self.places.clear();
        self.newest = None;
    }
}

impl Place {
    fn take(&mut self, picture: &Pyramid) {
        self.picture.copy_from(picture);
        self.awaited = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::Frame;
    use realnet_vision::Window;

    struct Film {
        pictures: Pictures,
        picture: Pyramid,
        rate_hz: f64,
        next: u64,
    }

    impl Film {
        fn new(rate_hz: f64) -> Self {
            let picture = Pyramid::new(1, Window::new(5, 5).unwrap());
            Self { pictures: Pictures::default(), picture, rate_hz, next: 0 }
        }

        fn at(&self, index: u64) -> Stamp {
            Stamp::of_frame(index, self.rate_hz)
        }

        fn show(&mut self, in_use: impl Fn(Stamp) -> bool) {
            let frame = Frame::grey8(self.at(self.next), 16, 16, vec![7; 256]).unwrap();
            self.picture.build(&frame);
            self.pictures.put(&self.picture, in_use);
            self.next += 1;
        }

        fn kept(&self) -> Vec<u64> {
            (0..self.next).filter(|i| self.pictures.get(self.at(*i)).is_some()).collect()
        }
    }

    #[test]
    fn all_pictures_of_a_second_and_a_half_are_kept_at_any_rate() {
        for rate_hz in [0.5, 5.0, 15.0, 30.0, 60.0] {
            let mut film = Film::new(rate_hz);
            for _ in 0..300 {
                film.show(|_| false);
                let last = film.next - 1;
                let first = last.saturating_sub((ALL_FOR_S * rate_hz) as u64);
                let kept = film.kept();
                assert!((first..=last).all(|index| kept.contains(&index)), "{rate_hz} {kept:?}");
            }
            let needed = (ALL_FOR_S * rate_hz) as usize + 2;
            let places = film.pictures.places.len();
            assert!(places <= needed, "{places} places at {rate_hz} a second");
        }
        // Faster than that it is less time, in bounded memory.
        let mut film = Film::new(240.0);
        (0..500).for_each(|_| film.show(|_| false));
        assert_eq!(film.kept(), (500 - MOST as u64..500).collect::<Vec<_>>());
    }

    #[test]
    fn those_that_the_detector_was_given_wait_for_its_answer() {
        let mut film = Film::new(60.0);
        for index in 0..400 {
            film.show(|_| false);
            // Every half second, and each answer comes two seconds late.
            if index % 30 == 0 {
                film.pictures.await_newest();
            }
            if let Some(of) = u64::checked_sub(index, 120).filter(|of| of % 30 == 0) {
                assert!(film.pictures.get(film.at(of)).is_some(), "{of} at {index}");
                film.pictures.answered(film.at(of));
            }
        }
        assert!(film.pictures.places.len() < 10, "{} places", film.pictures.places.len());
        // An answer that never comes is not awaited for ever.
        film.pictures.await_newest();
        let given = film.next - 1;
        while film.at(film.next).seconds_since(film.at(given)) <= AWAITED_FOR_S {
            film.show(|_| false);
            assert!(film.pictures.get(film.at(given)).is_some());
        }
        (0..10).for_each(|_| film.show(|_| false));
        assert!(film.pictures.get(film.at(given)).is_none());
    }

    #[test]
    fn what_is_in_use_stays() {
        let mut film = Film::new(240.0);
        let first = film.at(0);
        (0..1000).for_each(|_| film.show(|stamp| stamp == first));
        assert!(film.pictures.get(first).is_some());
        assert_eq!(film.kept().len(), MOST);
        film.pictures.restart();
        assert!(film.kept().is_empty());
    }
}
