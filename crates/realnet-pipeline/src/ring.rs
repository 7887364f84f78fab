//! The newest of what belongs to frames, found by their stamps.

use realnet_core::Stamp;

/// Something that belongs to a frame.
pub(crate) trait Stamped {
    /// Exposure time of that frame.
    fn stamp(&self) -> Stamp;
}

/// Keeps the newest `N`. All memory that an item holds is used again.
#[derive(Clone, Debug)]
pub(crate) struct Ring<T, const N: usize> {
    items: Vec<T>,
    /// Index of the oldest once all places are taken.
    oldest: usize,
}

impl<T: Stamped, const N: usize> Ring<T, N> {
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

    /// The item that the next one takes the place of; `None` while there is room.
    pub(crate) fn leaving(&self) -> Option<&T> {
        if self.items.len() < N { None } else { self.items.get(self.oldest) }
    }

    /// Makes the next item: of what stands in its place, or anew.
    pub(crate) fn put(&mut self, again: impl FnOnce(&mut T), anew: impl FnOnce() -> T) {
        if self.items.len() < N {
            self.items.push(anew());
        } else if let Some(item) = self.items.get_mut(self.oldest) {
            again(item);
            self.oldest = (self.oldest + 1) % N;
        }
    }

    /// Adds an item that holds no memory.
    pub(crate) fn push(&mut self, item: T)
    where
        T: Copy,
    {
        self.put(|place| *place = item, || item);
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
            assert_eq!(ring.leaving().copied(), (item >= 3).then_some(item - 3));
            ring.push(item);
            for old in 0..=item {
                let kept = (old > item - 3).then_some(old);
                assert_eq!(ring.get(Stamp::from_nanos(old)).copied(), kept);
            }
        }
    }
}
