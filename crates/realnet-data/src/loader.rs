//! Batches, made by several threads, in order.

use crate::cache::guarded;
use crate::order::epoch_order;
use crate::{DataError, SampleError};
use realnet_core::OptionError;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

/// Samples that can be made one by one, in any order, from several threads.
pub trait Samples: Send + Sync + 'static {
    /// One of them.
    type Sample: Send + 'static;

    /// How many there are in an epoch.
    fn len(&self) -> usize;

    /// True when there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Sample `index` (below [`Samples::len`]) of an epoch. The same `epoch` and `index`
    /// must give the same sample.
    ///
    /// # Errors
    /// [`SampleError`] when it cannot be made.
    fn sample(&self, epoch: u32, index: usize) -> Result<Self::Sample, SampleError>;
}

/// How samples become batches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoaderOptions {
    /// Samples in a batch, at least 1; default 16.
    pub batch: usize,
    /// Threads that make samples; 0 (the default) takes as many as there are processors.
    pub threads: usize,
    /// Batches that may be ready before they are asked for, at least 1; default 2.
    pub ahead: usize,
    /// With a seed in the order of [`epoch_order`], else (the default) in that of the set.
    pub shuffle: Option<u64>,
    /// Whether a last batch that is not full is left out.
    pub drop_last: bool,
    /// Samples that may stand in for one that cannot be made, the next ones of the order;
    /// default 15: more broken files in a row are not an accident. With 0 the epoch ends with
    /// an error: figures of a validation are to be of the pictures that they name.
    pub replacements: usize,
}

impl Default for LoaderOptions {
    fn default() -> Self {
        Self { batch: 16, threads: 0, ahead: 2, shuffle: None, drop_last: false, replacements: 15 }
    }
}

/// A sample that could not be made in training, and how often.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// The last error.
    pub error: SampleError,
    /// How often it failed.
    pub count: usize,
}

type Failures = Arc<Mutex<BTreeMap<usize, Failure>>>;

/// Makes the batches of one epoch after the other.
///
/// A sample that cannot be made is replaced by the next one of the epoch and counted; so
/// is one whose maker panics. Batches are the same for any number of threads.
#[derive(Debug)]
pub struct Loader<S> {
    samples: Arc<S>,
    options: LoaderOptions,
    failures: Failures,
}

impl<S: Samples> Loader<S> {
    /// A loader for these samples.
    ///
    /// # Errors
    /// [`DataError::Option`] when there are no samples, or `batch` or `ahead` is 0.
    pub fn new(samples: Arc<S>, options: LoaderOptions) -> Result<Self, DataError> {
        let positive =
            |name, value: usize| OptionError::check(name, value as f64, value > 0, "1 or more");
        positive("samples", samples.len())?;
        positive("batch", options.batch)?;
        positive("ahead", options.ahead)?;
        Ok(Self { samples, options, failures: Failures::default() })
    }

    /// Batches of an epoch.
    #[must_use]
    pub fn batches(&self) -> usize {
        let (count, batch) = (self.samples.len(), self.options.batch);
        if self.options.drop_last { count / batch } else { count.div_ceil(batch) }
    }

    /// Starts the threads of an epoch and gives its batches. What is dropped early stops
    /// early.
    #[must_use]
    pub fn epoch(&self, epoch: u32) -> Epoch<S> {
        self.epoch_from(epoch, 0)
    }

    /// As [`Loader::epoch`], from batch `first` on: to go on with an epoch that was
    /// interrupted.
    #[must_use]
    pub fn epoch_from(&self, epoch: u32, first: usize) -> Epoch<S> {
        let count = self.samples.len();
        let mut order = match self.options.shuffle {
            Some(seed) => epoch_order(count, seed, epoch),
            None => (0..count).collect(),
        };
        let end = (self.batches().saturating_mul(self.options.batch)).min(count);
        let start = first.saturating_mul(self.options.batch).min(end);
        let room = self.options.ahead.saturating_add(1).saturating_mul(self.options.batch);
        // The replacements of the last ones are the first ones.
        order.rotate_left(start % count.max(1));
        let shared = Arc::new(Shared {
            state: Mutex::new(State { room, ..State::default() }),
            ready: Condvar::new(),
            wanted: Condvar::new(),
            wanted_total: end - start,
            order,
            tries: self.options.replacements.saturating_add(1),
            epoch,
        });
        let threads = crate::threads(self.options.threads).min((end - start).max(1));
        let spawn = |_| {
            let (shared, samples) = (Arc::clone(&shared), Arc::clone(&self.samples));
            let failures = Arc::clone(&self.failures);
            std::thread::spawn(move || work(&shared, &*samples, &failures))
        };
        let threads = (0..threads).map(spawn).collect();
        let (batch, drop_last) = (self.options.batch, self.options.drop_last);
        Epoch { shared, threads, batch, drop_last, samples: std::marker::PhantomData }
    }

    /// What could not be made so far, by index: to be shown as a warning.
    #[must_use]
    pub fn failures(&self) -> Vec<Failure> {
        let failures = self.failures.lock().unwrap_or_else(PoisonError::into_inner);
        failures.values().cloned().collect()
    }
}

/// What the threads of an epoch share.
#[derive(Debug)]
struct Shared<T> {
    state: Mutex<State<T>>,
    /// A sample was put into `done`.
    ready: Condvar,
    /// A sample was taken from it.
    wanted: Condvar,
    /// Samples of the epoch.
    wanted_total: usize,
    /// Indices, the first one first.
    order: Vec<usize>,
    /// How many of them are tried for one sample.
    tries: usize,
    epoch: u32,
}

#[derive(Debug)]
struct State<T> {
    /// Places in the order: the next to be made, the next to be taken.
    next: usize,
    taken: usize,
    /// How far `next` may be before `taken`.
    room: usize,
    done: BTreeMap<usize, Result<T, (usize, SampleError)>>,
    stopped: bool,
}

impl<T> Default for State<T> {
    fn default() -> Self {
        Self { next: 0, taken: 0, room: 0, done: BTreeMap::new(), stopped: false }
    }
}

impl<T> Shared<T> {
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Makes samples until the epoch ends or is dropped.
fn work<S: Samples>(
    shared: &Shared<S::Sample>,
    samples: &S,
    failures: &Mutex<BTreeMap<usize, Failure>>,
) {
    loop {
        let place = {
            let mut state = shared.lock();
            while !state.stopped && state.next >= state.taken.saturating_add(state.room) {
                state = shared.wanted.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
            if state.stopped || state.next >= shared.wanted_total {
                return;
            }
            state.next += 1;
            state.next - 1
        };
        let made = make(shared, samples, failures, place);
        shared.lock().done.insert(place, made);
        shared.ready.notify_one();
    }
}

/// The sample of a place, or the next one that can be made.
fn make<S: Samples>(
    shared: &Shared<S::Sample>,
    samples: &S,
    failures: &Mutex<BTreeMap<usize, Failure>>,
    place: usize,
) -> Result<S::Sample, (usize, SampleError)> {
    let mut last = SampleError { index: 0, path: PathBuf::new(), reason: "no samples".to_owned() };
    let tries = shared.tries.min(shared.order.len());
    for index in shared.order.iter().cycle().skip(place).take(tries) {
        let made = guarded(|| samples.sample(shared.epoch, *index));
        let panic = |reason| SampleError { index: *index, path: PathBuf::new(), reason };
        match made.map_err(panic).and_then(|made| made) {
            Ok(sample) => return Ok(sample),
            Err(error) => {
                let mut all = failures.lock().unwrap_or_else(PoisonError::into_inner);
                let known =
                    all.entry(*index).or_insert_with(|| Failure { error: error.clone(), count: 0 });
                known.count += 1;
                known.error = error.clone();
                last = error;
            }
        }
    }
    Err((tries, last))
}

/// The batches of an epoch, in order. Dropping it stops its threads.
#[derive(Debug)]
pub struct Epoch<S: Samples> {
    shared: Arc<Shared<S::Sample>>,
    threads: Vec<JoinHandle<()>>,
    batch: usize,
    drop_last: bool,
    samples: std::marker::PhantomData<S>,
}

impl<S: Samples> Iterator for Epoch<S> {
    type Item = Result<Vec<S::Sample>, DataError>;

    /// The next batch; waits until it is ready. After an error there is no more.
    fn next(&mut self) -> Option<Self::Item> {
        let mut batch = Vec::with_capacity(self.batch);
        let mut state = self.shared.lock();
        while batch.len() < self.batch && !state.stopped {
            let place = state.taken;
            if place >= self.shared.wanted_total {
                break;
            }
            match state.done.remove(&place) {
                Some(Ok(sample)) => {
                    batch.push(sample);
                    state.taken += 1;
                    self.shared.wanted.notify_all();
                }
                Some(Err((tried, last))) => {
                    state.stopped = true;
                    self.shared.wanted.notify_all();
                    return Some(Err(match tried {
                        1 => DataError::Sample(last),
                        _ => DataError::TooManyFailures { tried, last },
                    }));
                }
                None => {
                    state = self.shared.ready.wait(state).unwrap_or_else(PoisonError::into_inner);
                }
            }
        }
        let short = batch.is_empty() || (self.drop_last && batch.len() < self.batch);
        if short { None } else { Some(Ok(batch)) }
    }
}

impl<S: Samples> Drop for Epoch<S> {
    fn drop(&mut self) {
        self.shared.lock().stopped = true;
        self.shared.wanted.notify_all();
        for thread in self.threads.drain(..) {
            // What a thread makes is guarded; there is no panic to pass on.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Numbers; some of them broken, some of them panicking.
    #[derive(Debug, Default)]
    struct Numbers {
        count: usize,
        broken: Vec<usize>,
        panicking: Vec<usize>,
        made: AtomicUsize,
    }

    impl Samples for Numbers {
        type Sample = (u32, usize);

        fn len(&self) -> usize {
            self.count
        }

        fn sample(&self, epoch: u32, index: usize) -> Result<(u32, usize), SampleError> {
            self.made.fetch_add(1, Ordering::Relaxed);
            assert!(!self.panicking.contains(&index), "this one panics");
            // Uneven work, so that threads overtake each other.
            let spin = (index * 7919 % 13) * 2000;
            let waste: usize = (0..spin).fold(0, |a, b| std::hint::black_box(a ^ b));
            std::hint::black_box(waste);
            match self.broken.contains(&index) {
                true => {
                    Err(SampleError { index, path: "x.jpg".into(), reason: "broken".to_owned() })
                }
                false => Ok((epoch, index)),
            }
        }
    }

    fn batches(loader: &Loader<Numbers>, epoch: u32) -> Vec<Vec<(u32, usize)>> {
        loader.epoch(epoch).map(Result::unwrap).collect()
    }

    #[test]
    fn batches_are_in_order_for_any_number_of_threads() {
        let of = |threads, shuffle| {
            let samples = Arc::new(Numbers { count: 103, ..Numbers::default() });
            let options = LoaderOptions { batch: 10, threads, shuffle, ..Default::default() };
            batches(&Loader::new(samples, options).unwrap(), 3)
        };
        let plain = of(1, None);
        assert_eq!(plain.len(), 11);
        assert_eq!(plain[10], [(3, 100), (3, 101), (3, 102)]);
        assert_eq!(plain.concat(), (0..103).map(|i| (3, i)).collect::<Vec<_>>());
        let shuffled: Vec<_> = epoch_order(103, 5, 3).into_iter().map(|i| (3, i)).collect();
        for threads in [1, 2, 3, 8, 200] {
            assert_eq!(of(threads, None), plain);
            assert_eq!(of(threads, Some(5)).concat(), shuffled);
        }
    }

    #[test]
    fn an_epoch_can_be_gone_on_with() {
        let samples = Arc::new(Numbers { count: 50, ..Numbers::default() });
        let options =
            LoaderOptions { batch: 8, shuffle: Some(1), drop_last: true, ..Default::default() };
        let loader = Loader::new(samples, options).unwrap();
        let whole = batches(&loader, 1);
        assert_eq!((whole.len(), loader.batches()), (6, 6));
        let rest: Vec<_> = loader.epoch_from(1, 4).map(Result::unwrap).collect();
        assert_eq!(rest, whole[4..]);
        assert_eq!(loader.epoch_from(1, 6).count(), 0);
        assert_eq!(loader.epoch_from(1, usize::MAX).count(), 0);
    }

    #[test]
    fn what_fails_is_replaced_by_the_next_and_counted() {
        for threads in [1, 4] {
            let samples =
                Numbers { count: 10, broken: vec![3, 4], panicking: vec![9], ..Numbers::default() };
            let options = LoaderOptions { batch: 5, threads, ..Default::default() };
            let loader = Loader::new(Arc::new(samples), options).unwrap();
            let indices = |epoch| -> Vec<usize> {
                batches(&loader, epoch).concat().into_iter().map(|(_, index)| index).collect()
            };
            // 3 and 4 become 5; 9 becomes 0, the first of the epoch.
            assert_eq!(indices(0), [0, 1, 2, 5, 5, 5, 6, 7, 8, 0]);
            indices(1);
            let failures = loader.failures();
            let counts: Vec<_> = failures.iter().map(|f| (f.error.index, f.count)).collect();
            assert_eq!(counts, [(3, 2), (4, 4), (9, 2)]);
            assert_eq!(failures[0].error.to_string(), "sample 3, x.jpg: broken");
            assert!(failures[2].error.reason.contains("panic: this one panics"));
        }
    }

    #[test]
    fn a_set_in_which_nothing_works_is_an_error_not_a_hang() {
        let samples = Numbers { count: 30, broken: (0..30).collect(), ..Numbers::default() };
        let loader = Loader::new(Arc::new(samples), LoaderOptions::default()).unwrap();
        let mut epoch = loader.epoch(0);
        let error = epoch.next().unwrap().unwrap_err().to_string();
        assert!(error.starts_with("16 samples in a row could not be made"), "{error}");
        assert!(epoch.next().is_none());
    }

    #[test]
    fn without_replacements_what_fails_is_an_error() {
        let samples = Numbers { count: 10, broken: vec![7], ..Numbers::default() };
        let options = LoaderOptions { batch: 5, replacements: 0, ..Default::default() };
        let loader = Loader::new(Arc::new(samples), options).unwrap();
        let mut epoch = loader.epoch(0);
        assert_eq!(epoch.next().unwrap().unwrap().len(), 5);
        let error = epoch.next().unwrap().unwrap_err().to_string();
        assert_eq!(error, "sample 7, x.jpg: broken");
        assert!(epoch.next().is_none());
    }

    #[test]
    fn the_queue_is_bounded_and_dropping_stops_it() {
        let samples = Arc::new(Numbers { count: 10_000, ..Numbers::default() });
        let options = LoaderOptions { batch: 4, threads: 3, ahead: 2, ..Default::default() };
        let loader = Loader::new(Arc::clone(&samples), options).unwrap();
        let mut epoch = loader.epoch(0);
        assert_eq!(epoch.next().unwrap().unwrap().len(), 4);
        drop(epoch);
        // Four were taken, and never more than three batches of four were ahead.
        let made = samples.made.load(Ordering::Relaxed);
        assert!((4..=16).contains(&made), "{made}");
        // All threads are gone: nobody else holds the samples.
        assert_eq!(Arc::strong_count(&samples), 2);
    }

    #[test]
    fn options_that_cannot_be_are_refused() {
        let new = |count, options| {
            Loader::new(Arc::new(Numbers { count, ..Numbers::default() }), options).map(|_| ())
        };
        let error = new(0, LoaderOptions::default()).unwrap_err().to_string();
        assert_eq!(error, "samples is 0, it must be 1 or more");
        assert!(new(1, LoaderOptions { batch: 0, ..Default::default() }).is_err());
        assert!(new(1, LoaderOptions { ahead: 0, ..Default::default() }).is_err());
    }
}
