//! The newest of what belongs to frames, found by their stamps.

use realnet_core::Stamp;

/// Items that are kept of small things: four seconds at 120 frames a second, the latest
/// that an answer of a network may come, and more at fewer frames.
pub(crate) const KEPT: usize = 480;

/// Something that belongs to a frame.
pub(crate) trait Stamped {
    /// Exposure time of that frame.
    fn stamp(&self) -> Stamp;
}

/// Keeps the newest `N`, in memory that is taken once.
#[derive(Clone, Debug)]
pub(crate) struct Ring<T, const N: usize> {
    items: Vec<T>,
    /// Index of the oldest once all places are taken.
    oldest: usize,
}

impl<T: Stamped + Copy, const N: usize> Ring<T, N> {
    pub(crate) fn new() -> Self {
        Self { items: Vec::with_capacity(N), oldest: 0 }
    }

    /// The item of a frame.
    pub(crate) fn get(&self, stamp: Stamp) -> Option<&T> {
        self.items.iter().find(|item| item.stamp() == stamp)
    }

    /// The same, to be changed.
    pub(crate) fn get_mut(&mut self, stamp: Stamp) -> Option<&mut T> {
        self.items.iter_mut().find(|item| item.stamp() == stamp)
    }

    /// Adds an item; the oldest leaves when all places are taken.
    pub(crate) fn push(&mut self, item: T) {
        if self.items.len() < N {
            self.items.push(item);
        } else if let Some(place) = self.items.get_mut(self.oldest) {
            *place = item;
            self.oldest = (self.oldest + 1) % N;
        }
    }

    /// Forgets all items.
    pub(crate) fn clear(&mut self) {
        self.items.clear();
        self.oldest = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Stamped for i64 {
        fn stamp(&self) -> Stamp {
            Stamp::from_nanos(*self)
        }
    }

    #[test]
    fn the_newest_are_kept_in_turn() {
        let mut ring = Ring::<i64, 3>::new();
        for item in 0..7 {
            ring.push(item);
            for old in 0..=item {
                let kept = (old > item - 3).then_some(old);
                assert_eq!(ring.get(Stamp::from_nanos(old)).copied(), kept);
            }
        }
        ring.clear();
        assert!((0..7).all(|old| ring.get(Stamp::from_nanos(old)).is_none()));
        (10..14).for_each(|item| ring.push(item));
        assert_eq!(ring.items, [13, 11, 12]);
    }
}
