//! Frames as they come, the newest first.

use realnet::Stamp;
use realnet::source::{Source, SourceError, SourceFrame};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// The time on the clock of the frames' stamps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    origin: Instant,
    stamp: Stamp,
}

impl Clock {
    /// Live sources stamp their frames by Unix time.
    fn of_system() -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let nanos = i64::try_from(unix.as_nanos()).unwrap_or(i64::MAX);
        Self { origin: Instant::now(), stamp: Stamp::from_nanos(nanos) }
    }

    pub(super) fn now(&self) -> Stamp {
        self.stamp.seconds_later(self.origin.elapsed().as_secs_f64())
    }

    /// When a stamp will have come.
    fn until(&self, stamp: Stamp) -> Duration {
        let left_s = stamp.seconds_since(self.now());
        Duration::try_from_secs_f64(left_s).unwrap_or_default()
    }
}

/// A frame and when it came.
pub(super) struct Shot {
    pub(super) shot: SourceFrame,
    pub(super) arrived: Instant,
}

/// What there is at the end of a wait.
pub(super) enum Next {
    Shot(Result<Shot, SourceError>),
    /// Nothing came in time.
    Nothing,
    /// Nothing will come.
    End,
}

#[derive(Default)]
struct Slot {
    next: Option<Result<Shot, SourceError>>,
    clock: Option<Clock>,
    /// Frames that the source dropped, and those that were replaced here.
    dropped: [u64; 2],
    ended: bool,
}

/// Frames from a thread: those that nobody took in time make room for newer ones.
#[derive(Clone, Default)]
pub(super) struct Feed {
    inner: Arc<(Mutex<Slot>, Condvar)>,
}

impl Feed {
    /// Takes frames from a source as they come; from a recording as they came, by their
    /// stamps.
    pub(super) fn start(mut source: Source) -> std::io::Result<Self> {
        let feed = Self::default();
        let fed = feed.clone();
        std::thread::Builder::new().name("frames".to_owned()).spawn(move || {
            let mut clock = None;
            while let Some(item) = source.next() {
                let own = || match &item {
                    Ok(shot) if !source.is_live() => {
                        Clock { origin: Instant::now(), stamp: shot.frame.stamp() }
                    }
                    _ => Clock::of_system(),
                };
                let clock = *clock.get_or_insert_with(own);
                if let (Ok(shot), false) = (&item, source.is_live()) {
                    std::thread::sleep(clock.until(shot.frame.stamp()));
                }
                let item = item.map(|shot| Shot { shot, arrived: Instant::now() });
                fed.put(item, clock, source.dropped());
            }
            fed.change(|slot| slot.ended = true);
        })?;
        Ok(feed)
    }

    fn change(&self, change: impl FnOnce(&mut Slot)) {
        let (slot, changed) = &*self.inner;
        change(&mut slot.lock().unwrap_or_else(PoisonError::into_inner));
        changed.notify_all();
    }

    fn put(&self, item: Result<Shot, SourceError>, clock: Clock, dropped_by_source: u64) {
        self.change(|slot| {
            slot.clock = Some(clock);
            let replaced = matches!(slot.next.replace(item), Some(Ok(_)));
            slot.dropped = [dropped_by_source, slot.dropped[1] + u64::from(replaced)];
        });
    }

    /// Waits for the next frame.
    pub(super) fn next(&self, patience: Duration) -> Next {
        let (slot, changed) = &*self.inner;
        let slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
        let waits = |slot: &mut Slot| slot.next.is_none() && !slot.ended;
        let (mut slot, _) = changed
            .wait_timeout_while(slot, patience, waits)
            .unwrap_or_else(PoisonError::into_inner);
        match slot.next.take() {
            Some(item) => Next::Shot(item),
            None if slot.ended => Next::End,
            None => Next::Nothing,
        }
    }

    /// The time, once there was a frame.
    pub(super) fn now(&self) -> Option<Stamp> {
        let (slot, _) = &*self.inner;
        slot.lock().unwrap_or_else(PoisonError::into_inner).clock.map(|clock| clock.now())
    }

    /// Frames that nobody took in time.
    pub(super) fn dropped(&self) -> u64 {
        let (slot, _) = &*self.inner;
        slot.lock().unwrap_or_else(PoisonError::into_inner).dropped.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::{Frame, PixelFormat};

    const NOT_AT_ALL: Duration = Duration::ZERO;

    fn shot(index: u64) -> Result<Shot, SourceError> {
        let frame = Frame::new(Stamp::ZERO, 1, 1, PixelFormat::Grey8, vec![0]).unwrap();
        let shot = SourceFrame { frame, index, name: String::new() };
        Ok(Shot { shot, arrived: Instant::now() })
    }

    fn taken(feed: &Feed) -> Option<u64> {
        match feed.next(NOT_AT_ALL) {
            Next::Shot(shot) => Some(shot.unwrap().shot.index),
            Next::Nothing | Next::End => None,
        }
    }

    #[test]
    fn the_newest_frame_is_there_and_the_others_are_counted() {
        let (feed, clock) = (Feed::default(), Clock::of_system());
        assert!(feed.now().is_none() && taken(&feed).is_none());
        feed.put(shot(0), clock, 0);
        assert_eq!((taken(&feed), taken(&feed), feed.dropped()), (Some(0), None, 0));
        // Two that nobody took, and three that the source had dropped by then.
        for index in 1..4 {
            feed.put(shot(index), clock, index);
        }
        assert_eq!((taken(&feed), feed.dropped()), (Some(3), 5));
        feed.put(shot(4), clock, 3);
        feed.change(|slot| slot.ended = true);
        assert_eq!(taken(&feed), Some(4), "the last one is not lost");
        assert!(matches!(feed.next(NOT_AT_ALL), Next::End));
    }
}
