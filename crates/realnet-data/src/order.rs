//! The order of an epoch.

use crate::random::{Dice, Purpose};

/// The order in which the samples of an epoch are shown: a random permutation of
/// `0..count` that follows from `seed` and `epoch`, in which no two neighbours are
/// consecutive frames (numbers that differ by 1).
///
/// Consecutive frames of a video are nearly one picture; side by side in a batch they
/// would count twice. After a shuffle each pair of such neighbours is parted by a swap
/// with a random place that makes no new pair. Below 4 samples, where that cannot be,
/// it is a plain permutation.
#[must_use]
pub fn epoch_order(count: usize, seed: u64, epoch: u32) -> Vec<usize> {
    let mut dice = Dice::new(seed, Purpose::Order, epoch, 0);
    let mut order: Vec<usize> = (0..count).collect();
    dice.shuffle(&mut order);
    if count < 4 {
        return order;
    }
    // The random tries end early with near certainty; the search behind them is for
    // small sets.
    for _round in 0..8 {
        let mut parted = true;
        for at in 1..count {
            if !touches(&order, at) {
                continue;
            }
            parted = false;
            let start = dice.below(count);
            let free = (0..count).map(|step| (start + step) % count).find(|&other| {
                order.swap(at, other);
                let good = !touched(&order, at) && !touched(&order, other);
                if !good {
                    order.swap(at, other);
                }
                good
            });
            if free.is_none() {
                order.rotate_left(1);
            }
        }
        if parted {
            return order;
        }
    }
    // Four and a few more have so few good orders that swaps may miss them: all odd
    // numbers, then all even ones, is one.
    let mut order: Vec<usize> = (0..count).filter(|n| n % 2 == 1).collect();
    order.extend((0..count).filter(|n| n % 2 == 0));
    order
}

/// Whether the one at `at` and the one before it are consecutive.
fn touches(order: &[usize], at: usize) -> bool {
    match (at.checked_sub(1).and_then(|before| order.get(before)), order.get(at)) {
        (Some(a), Some(b)) => a.abs_diff(*b) == 1,
        _ => false,
    }
}

/// Whether the one at `at` touches a neighbour.
fn touched(order: &[usize], at: usize) -> bool {
    touches(order, at) || touches(order, at + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_sample_once_and_no_frame_beside_its_next(
            count in 0usize..300, seed: u64, epoch in 0u32..1000
        ) {
            let order = epoch_order(count, seed, epoch);
            let mut sorted = order.clone();
            sorted.sort_unstable();
            prop_assert_eq!(sorted, (0..count).collect::<Vec<_>>());
            if count >= 4 {
                prop_assert!(order.windows(2).all(|w| w[0].abs_diff(w[1]) != 1), "{:?}", order);
            }
            prop_assert_eq!(&order, &epoch_order(count, seed, epoch));
        }
    }

    #[test]
    fn epochs_and_seeds_differ_and_are_random() {
        let first = epoch_order(500, 1, 0);
        assert_ne!(first, epoch_order(500, 1, 1));
        assert_ne!(first, epoch_order(500, 2, 0));
        // The mean step of a random permutation of n is n / 3.
        let steps: usize = first.windows(2).map(|w| w[0].abs_diff(w[1])).sum();
        let mean = steps as f64 / 499.0;
        assert!((140.0..195.0).contains(&mean), "{mean}");
    }
}
