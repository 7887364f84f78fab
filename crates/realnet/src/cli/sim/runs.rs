//! Many runs at once, given out in the order they were asked for.

use super::json::RunResult;
use crate::cli::failure::is_broken_pipe;
use crate::cli::{interrupt, progress};
use anyhow::Result;
use realnet_sim::scenario::Scenario;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;

/// How a run ended. Interrupted: neither result nor error.
#[derive(Debug, Default)]
pub(super) struct Ended {
    /// What it came to.
    pub(super) result: Option<RunResult>,
    /// What went wrong: with the run, or only with its files if there is a result.
    pub(super) error: Option<anyhow::Error>,
    /// Whether its page was written.
    pub(super) has_page: bool,
}

/// Runs all that is wanted, `jobs` at a time. `run` makes one run, which it ends early
/// when its last argument says so. `take` is given each end, in the order of `wanted`,
/// as soon as those before it are known; where it fails, all runs end.
///
/// # Errors
/// That of `take`; a panic in a run, once all others are given out.
pub(super) fn run_all(
    wanted: &[(&Scenario, u64)],
    jobs: usize,
    run: impl Fn(&Scenario, u64, &dyn Fn() -> bool) -> Ended + Sync,
    mut take: impl FnMut(Ended) -> Result<()>,
) -> Result<()> {
    let bar = progress::bar(Some(wanted.len() as u64), "sim");
    let (next, given_up) = (AtomicUsize::new(0), AtomicBool::new(false));
    let ends_early = || interrupt::interrupted() || given_up.load(Ordering::Relaxed);
    let work = |ends: mpsc::Sender<(usize, Ended)>| {
        while !ends_early() {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(&(scenario, seed)) = wanted.get(index) else { return };
            bar.set_message(format!("{} {seed}", scenario.name()));
            let mut ended = run(scenario, seed, &ends_early);
            ended.error = ended.error.map(|error| {
                error.context(format!("scenario {} with seed {seed}", scenario.name()))
            });
            // Nobody listens once the output failed.
            if ends.send((index, ended)).is_err() {
                return;
            }
            bar.inc(1);
        }
    };
    let outcome = std::thread::scope(|scope| {
        let (sender, ends) = mpsc::channel();
        let threads: Vec<_> = (0..jobs.clamp(1, wanted.len().max(1)))
            .map(|_| {
                let (sender, work) = (sender.clone(), &work);
                scope.spawn(move || work(sender))
            })
            .collect();
        drop(sender);
        let mut in_order = InOrder::default();
        let mut taken = Ok(());
        for (index, ended) in ends {
            taken = in_order.push(index, ended).try_for_each(|ended| bar.suspend(|| take(ended)));
            if taken.is_err() {
                given_up.store(true, Ordering::Relaxed);
                break;
            }
        }
        let panics = threads.into_iter().map(|thread| thread.join().is_err());
        let panics = panics.filter(|panicked| *panicked).count();
        taken?;
        // Those after a run that was never heard of again.
        in_order.rest().try_for_each(take)?;
        anyhow::ensure!(panics == 0, "{panics} runs ended in a panic");
        Ok(())
    });
    bar.finish_and_clear();
    outcome
}

/// Whether whoever read the results went away, which ends all runs.
pub(super) fn reader_is_gone(outcome: &Result<()>) -> bool {
    outcome.as_ref().is_err_and(is_broken_pipe)
}

/// Items that come in any order, given out in the order of their indices.
#[derive(Debug)]
struct InOrder<T> {
    next: usize,
    early: BTreeMap<usize, T>,
}

impl<T> Default for InOrder<T> {
    fn default() -> Self {
        Self { next: 0, early: BTreeMap::new() }
    }
}

impl<T> InOrder<T> {
    /// Takes an item, and gives all whose turn it is.
    fn push(&mut self, index: usize, item: T) -> impl Iterator<Item = T> + '_ {
        self.early.insert(index, item);
        std::iter::from_fn(|| {
            let item = self.early.remove(&self.next)?;
            self.next += 1;
            Some(item)
        })
    }

    /// What still waits for others.
    fn rest(self) -> impl Iterator<Item = T> {
        self.early.into_values()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use std::time::Duration;

    #[test]
    fn items_wait_for_those_before_them() {
        let mut in_order = InOrder::default();
        let given: Vec<Vec<usize>> =
            [2, 0, 1, 5, 4].map(|index| in_order.push(index, index).collect()).to_vec();
        assert_eq!(given, [vec![], vec![0], vec![1, 2], vec![], vec![]]);
        assert_eq!(in_order.rest().collect::<Vec<_>>(), [4, 5]);
    }

    fn wanted(seeds: u64) -> Vec<(&'static Scenario, u64)> {
        let scenarios = Scenario::list().iter().take(2);
        scenarios.flat_map(|scenario| (0..seeds).map(move |seed| (scenario, seed))).collect()
    }

    fn result(scenario: &Scenario, seed: u64) -> RunResult {
        RunResult { scenario: scenario.name().to_owned(), seed, ..RunResult::default() }
    }

    #[test]
    fn one_error_leaves_the_others_and_the_order() {
        let wanted = wanted(4);
        for jobs in [1, 3, 20] {
            let mut taken = Vec::new();
            let run = |scenario: &Scenario, seed, _: &dyn Fn() -> bool| match seed {
                2 => Ended { error: Some(anyhow::anyhow!("no room")), ..Ended::default() },
                _ => {
                    // The first come last.
                    std::thread::sleep(Duration::from_millis(3 * (4 - seed)));
                    Ended { result: Some(result(scenario, seed)), ..Ended::default() }
                }
            };
            let take = |ended: Ended| {
                taken.push(match (ended.result, ended.error) {
                    (Some(run), None) => format!("{} {}", run.scenario, run.seed),
                    (None, Some(error)) => format!("{error:#}"),
                    other => panic!("{other:?}"),
                });
                Ok(())
            };
            run_all(&wanted, jobs, run, take).unwrap();
            let expected: Vec<String> = wanted
                .iter()
                .map(|(scenario, seed)| match seed {
                    2 => format!("scenario {} with seed 2: no room", scenario.name()),
                    _ => format!("{} {seed}", scenario.name()),
                })
                .collect();
            assert_eq!(taken, expected, "{jobs} jobs");
        }
    }

    #[test]
    fn when_the_output_fails_nothing_more_is_run() {
        let (wanted, ran) = (wanted(500), Mutex::new(0));
        let run = |scenario: &Scenario, seed, ends_early: &dyn Fn() -> bool| {
            *ran.lock().unwrap() += 1;
            // As long as a run lasts: until it is told to end, but for the first.
            while (scenario.name(), seed) != (wanted[0].0.name(), 0) && !ends_early() {
                std::thread::yield_now();
            }
            Ended { result: Some(result(scenario, seed)), ..Ended::default() }
        };
        let gone = || std::io::Error::from(std::io::ErrorKind::BrokenPipe);
        let outcome = run_all(&wanted, 2, run, |_| Err(gone().into()));
        assert!(reader_is_gone(&outcome));
        assert!(*ran.lock().unwrap() <= 3, "the first, and one a thread");
    }

    #[test]
    fn a_panic_is_told_after_all_others() {
        let wanted = wanted(2);
        let mut taken = Vec::new();
        let run = |scenario: &Scenario, seed, _: &dyn Fn() -> bool| {
            assert!((scenario.name(), seed) != (wanted[0].0.name(), 1), "as this test wants it");
            Ended { result: Some(result(scenario, seed)), ..Ended::default() }
        };
        let outcome = run_all(&wanted, 2, run, |ended| {
            taken.push(ended.result.map(|run| run.seed));
            Ok(())
        });
        assert!(outcome.unwrap_err().to_string().contains("panic"));
        assert_eq!(taken, [Some(0), Some(0), Some(1)]);
    }
}
