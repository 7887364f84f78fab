//! Hands frames from the thread that makes them to the thread that uses them.

use super::{SourceError, SourceFrame};
use crate::ffmpeg::lock;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

type Item = Result<SourceFrame, SourceError>;

/// What the taker gets.
pub(super) enum Taken {
    /// The next frame or error.
    Item(Item),
    /// Nothing came in time.
    Late,
    /// Nothing will come any more.
    End,
    /// The making thread panicked.
    Panicked,
}

#[derive(Default)]
struct State {
    items: VecDeque<Item>,
    spare: Vec<Vec<u8>>,
    dropped: u64,
    fps: Option<f64>,
    finished: bool,
    panicked: bool,
    stopped: bool,
}

/// A bounded queue. Lossless: the maker waits for room. Newest-only: a frame
/// not yet taken is replaced by the next one and counted as dropped; errors are
/// never dropped.
pub(super) struct Queue {
    capacity: usize,
    newest_only: bool,
    state: Mutex<State>,
    changed: Condvar,
}

impl Queue {
    pub(super) fn new(capacity: usize, newest_only: bool) -> Self {
        Self {
            capacity: capacity.max(1),
            newest_only,
            state: Mutex::default(),
            changed: Condvar::new(),
        }
    }

    /// Gives an item to the taker; false when nobody wants it any more.
    pub(super) fn push(&self, item: Item) -> bool {
        let mut state = lock(&self.state);
        if self.newest_only {
            if item.is_ok() && matches!(state.items.back(), Some(Ok(_))) {
                state.dropped += 1;
                if let Some(Ok(stale)) = state.items.pop_back() {
                    state.keep(stale.frame.into_data());
                }
            }
        } else {
            while state.items.len() >= self.capacity && !state.stopped {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        }
        if state.stopped {
            return false;
        }
        state.items.push_back(item);
        self.changed.notify_all();
        true
    }

    /// Waits for the next item, at most until `deadline` has passed.
    pub(super) fn take(&self, patience: Option<Duration>) -> Taken {
        let start = Instant::now();
        let mut state = lock(&self.state);
        loop {
            if state.stopped {
                return Taken::End;
            }
            if let Some(item) = state.items.pop_front() {
                self.changed.notify_all();
                return Taken::Item(item);
            }
            if state.panicked {
                state.panicked = false;
                return Taken::Panicked;
            }
            if state.finished {
                return Taken::End;
            }
            state = match patience {
                None => self.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
                Some(patience) => {
                    let Some(left) = patience.checked_sub(start.elapsed()) else {
                        return Taken::Late;
                    };
                    let (state, _) = self
                        .changed
                        .wait_timeout(state, left)
                        .unwrap_or_else(PoisonError::into_inner);
                    state
                }
            };
        }
    }

    /// Nothing will be pushed any more.
    pub(super) fn finish(&self, panicked: bool) {
        let mut state = lock(&self.state);
        state.finished = true;
        state.panicked = panicked;
        self.changed.notify_all();
    }

    /// Nothing is wanted any more.
    pub(super) fn stop(&self) {
        lock(&self.state).stopped = true;
        self.changed.notify_all();
    }

    pub(super) fn is_stopped(&self) -> bool {
        lock(&self.state).stopped
    }

    /// A used buffer, or a new one without memory.
    pub(super) fn spare(&self) -> Vec<u8> {
        lock(&self.state).spare.pop().unwrap_or_default()
    }

    /// Gives a buffer back for the frames to come.
    pub(super) fn recycle(&self, buffer: Vec<u8>) {
        lock(&self.state).keep(buffer);
    }

    pub(super) fn dropped(&self) -> u64 {
        lock(&self.state).dropped
    }

    pub(super) fn fps(&self) -> Option<f64> {
        lock(&self.state).fps
    }

    pub(super) fn set_fps(&self, fps: Option<f64>) {
        if let Some(fps) = fps.filter(|f| f.is_finite() && *f > 0.0) {
            lock(&self.state).fps = Some(fps);
        }
    }
}

impl State {
    /// Keeps a few buffers, no more than are ever under way.
    fn keep(&mut self, buffer: Vec<u8>) {
        if self.spare.len() < 4 && buffer.capacity() > 0 {
            self.spare.push(buffer);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::{Frame, Stamp};
    use std::sync::Arc;

    fn frame(index: u64) -> Item {
        let frame = Frame::rgb8(Stamp::ZERO, 1, 1, vec![0; 3]).unwrap();
        Ok(SourceFrame { frame, index, name: "x".into() })
    }

    fn index(taken: Taken) -> Option<u64> {
        match taken {
            Taken::Item(Ok(f)) => Some(f.index),
            _ => None,
        }
    }

    #[test]
    fn newest_only_replaces_and_counts_but_keeps_errors() {
        let queue = Queue::new(1, true);
        for i in 0..5 {
            assert!(queue.push(frame(i)));
        }
        assert_eq!(queue.dropped(), 4);
        assert_eq!(index(queue.take(None)), Some(4));
        queue.push(frame(5));
        queue.push(Err(SourceError::Stalled { name: "x".into(), seconds: 1.0 }));
        queue.finish(false);
        assert_eq!(index(queue.take(None)), Some(5));
        assert!(matches!(queue.take(None), Taken::Item(Err(_))));
        assert!(matches!(queue.take(None), Taken::End));
        assert_eq!(queue.spare().capacity(), 3);
    }

    #[test]
    fn lossless_delivers_everything_in_order() {
        let queue = Arc::new(Queue::new(2, false));
        let maker = Arc::clone(&queue);
        let thread = std::thread::spawn(move || {
            for i in 0..100 {
                assert!(maker.push(frame(i)));
            }
            maker.finish(false);
        });
        for i in 0..100 {
            assert_eq!(index(queue.take(None)), Some(i));
        }
        assert!(matches!(queue.take(None), Taken::End));
        thread.join().unwrap();
        assert_eq!(queue.dropped(), 0);
    }

    #[test]
    fn stopping_frees_both_sides() {
        let queue = Arc::new(Queue::new(1, false));
        assert!(queue.push(frame(0)));
        let maker = Arc::clone(&queue);
        let thread = std::thread::spawn(move || maker.push(frame(1)));
        queue.stop();
        assert!(!thread.join().unwrap());
        assert!(matches!(queue.take(None), Taken::End));
    }

    #[test]
    fn silence_and_panics_are_told() {
        let queue = Queue::new(1, true);
        assert!(matches!(queue.take(Some(Duration::ZERO)), Taken::Late));
        queue.finish(true);
        assert!(matches!(queue.take(None), Taken::Panicked));
        assert!(matches!(queue.take(None), Taken::End));
    }
}
