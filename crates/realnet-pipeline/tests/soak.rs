//! Ten simulated minutes of fusion and control with everything that goes wrong; the
//! example `soak` drives for a day.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;
mod drive;

use counting::count;
use drive::soak::Soak;

#[test]
fn ten_minutes_of_trouble_are_survived_in_the_same_memory() {
    let mut soak = Soak::new(1);
    let mut allocations = 0;
    for _ in 0..10 * 60 * 30 {
        soak.frame(|pilot, tick| {
            let before = count();
            let command = pilot.step(tick);
            allocations += count() - before;
            command
        });
    }
    let findings = &soak.findings;
    assert!(findings.is_sound(), "{findings:?}");
    assert_eq!(allocations, 0);
    // It was a drive, with trouble, and the target was lost and found.
    assert!(findings.faults > 30 && soak.refused() > 100, "{findings:?}");
    assert!(findings.given_up > 5 && findings.found_again > 5, "{findings:?}");
    assert!(findings.moving > findings.frames / 3, "{findings:?}");
    assert!(findings.calm > findings.frames / 4, "{findings:?}");
    assert!(findings.calm_rms_m() < 0.1, "{} m", findings.calm_rms_m());
}
