//! Decoded pictures in memory, and work for several threads.

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Keeps what it is given until a number of bytes is reached, then nothing more. An
/// epoch asks for everything once, in any order: to drop the oldest for the newest would
/// only move the misses.
#[derive(Debug)]
pub(crate) struct Cache<T> {
    limit: usize,
    state: Mutex<(HashMap<usize, Arc<T>>, usize)>,
}

impl<T> Cache<T> {
    pub(crate) fn new(limit: usize) -> Self {
        Self { limit, state: Mutex::new((HashMap::new(), 0)) }
    }

    pub(crate) fn get(&self, key: usize) -> Option<Arc<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).0.get(&key).cloned()
    }

    /// Keeps a value of `bytes`, if it fits.
    pub(crate) fn offer(&self, key: usize, value: &Arc<T>, bytes: usize) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let (kept, used) = &mut *state;
        if used.saturating_add(bytes) <= self.limit && !kept.contains_key(&key) {
            kept.insert(key, Arc::clone(value));
            *used += bytes;
        }
    }

    /// What is kept by `key`, or else what `load` makes, kept if it fits.
    pub(crate) fn get_or<E>(
        &self,
        key: usize,
        bytes: impl FnOnce(&T) -> usize,
        load: impl FnOnce() -> Result<T, E>,
    ) -> Result<Arc<T>, E> {
        if let Some(kept) = self.get(key) {
            return Ok(kept);
        }
        let value = Arc::new(load()?);
        self.offer(key, &value, bytes(&value));
        Ok(value)
    }

    /// Entries and bytes that are kept.
    pub(crate) fn used(&self) -> (usize, usize) {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        (state.0.len(), state.1)
    }
}

/// `work(0)`, …, `work(count - 1)` by several threads, the results in order; a panic in
/// one of them is an error with its message.
pub(crate) fn in_parallel<T: Send>(
    count: usize,
    threads: usize,
    work: impl Fn(usize) -> T + Sync,
) -> Vec<Result<T, String>> {
    let next = AtomicUsize::new(0);
    let run = || {
        let mut done = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= count {
                return done;
            }
            done.push((index, guarded(|| work(index))));
        }
    };
    let mut all: Vec<(usize, Result<T, String>)> = std::thread::scope(|scope| {
        let extra = threads.min(count).saturating_sub(1);
        let threads: Vec<_> = (0..extra).map(|_| scope.spawn(run)).collect();
        let mut all = run();
        // What a thread ran is guarded; none ends in a panic.
        all.extend(threads.into_iter().filter_map(|thread| thread.join().ok()).flatten());
        all
    });
    all.sort_by_key(|(index, _)| *index);
    all.into_iter().map(|(_, result)| result).collect()
}

/// Runs `work`; a panic becomes its message.
pub(crate) fn guarded<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| {
        let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
        format!("ended in a panic: {}", text.as_deref().unwrap_or("no message"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cache_ends_at_its_limit() {
        let cache = Cache::new(100);
        for key in 0..10 {
            let value = cache.get_or(key, |_| 30, || Ok::<_, ()>(key * 2)).unwrap();
            assert_eq!(*value, key * 2);
        }
        assert_eq!(cache.used(), (3, 90));
        assert_eq!(cache.get(2).as_deref(), Some(&4));
        assert_eq!(cache.get(3), None);
        // A smaller one still fits; a known one is not loaded again.
        cache.get_or(20, |_| 10, || Ok::<_, ()>(0)).unwrap();
        assert_eq!(cache.used(), (4, 100));
        assert_eq!(*cache.get_or(0, |_| 1, || Err("loaded again")).unwrap(), 0);
        assert_eq!(cache.get_or(5, |_| 1, || Err("broken")).unwrap_err(), "broken");
    }

    #[test]
    fn parallel_results_are_in_order_and_panics_are_errors() {
        for threads in [0, 1, 3, 50] {
            let results = in_parallel(20, threads, |i| {
                assert!(i != 7, "seven");
                i * i
            });
            assert_eq!(results.len(), 20);
            for (i, result) in results.into_iter().enumerate() {
                match result {
                    Ok(square) => assert_eq!(square, i * i),
                    Err(message) => assert!(i == 7 && message.ends_with("panic: seven")),
                }
            }
        }
    }
}
