//! Fusion and control over a simulated day, or so many hours:
//! `cargo run --release -p realnet-pipeline --example soak -- [HOURS [SEED]]`.
//!
//! Prints what came of it and ends with 1 if memory grew by more than 1 MB after the first
//! hour (a tenth of a run of less than two hours), a command left the limits, a covariance
//! was not positive definite, or a stamp went back.
#![allow(missing_docs, clippy::print_stdout, clippy::print_stderr)]

#[path = "../tests/drive/mod.rs"]
mod drive;

use drive::soak::Soak;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Growth that is still none, kilobytes.
const GROWTH_KB: u64 = 1000;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let hours = arguments.next().map_or(Ok(24.0), |hours| hours.parse::<f64>());
    let seed = arguments.next().map_or(Ok(1), |seed| seed.parse::<u64>());
    let (Ok(hours), Ok(seed)) = (hours, seed) else {
        eprintln!("usage: soak [HOURS [SEED]]");
        return ExitCode::from(2);
    };
    let frames = (hours.clamp(0.01, 1e4) * 3600.0 * drive::world::RATE_HZ) as u64;
    let settled = ((3600.0 * drive::world::RATE_HZ) as u64).min(frames / 10);
    let started = Instant::now();
    let mut soak = Soak::new(seed);
    let at_start = resident_kb();
    let mut after_settling = None;
    let mut busy = Duration::ZERO;
    for frame in 0..frames {
        soak.frame(|pilot, tick| {
            let started = Instant::now();
            let command = pilot.step(tick);
            busy += started.elapsed();
            command
        });
        if frame == settled {
            after_settling = resident_kb();
        }
    }
    let at_end = resident_kb();
    let found = &soak.findings;
    println!("seed {seed}: {} frames in {:.1} s", found.frames, started.elapsed().as_secs_f64());
    let micros = busy.as_secs_f64() * 1e6 / frames as f64;
    println!("fusion and control: {micros:.1} us a frame, mean");
    println!(
        "resident memory, kB: {} at the start, {} after {:.1} h, {} at the end",
        kilobytes(at_start),
        kilobytes(after_settling),
        settled as f64 / drive::world::RATE_HZ / 3600.0,
        kilobytes(at_end)
    );
    println!("faults: {}, measurements refused: {}", found.faults, soak.refused());
    println!("target given up: {}, found again: {}", found.given_up, found.found_again);
    let share = |count: u64| 100.0 * count as f64 / found.frames as f64;
    println!(
        "tracked {:.1} %, moving {:.1} % of frames",
        share(found.tracked),
        share(found.moving)
    );
    println!(
        "error of the position: {:.3} m at most while tracked; while nothing is wrong {:.3} m at most, {:.3} m RMS, {:.2} by its covariance (2 is right)",
        found.largest_error_m,
        found.largest_calm_error_m,
        found.calm_rms_m(),
        found.calm_distance()
    );
    println!(
        "commands out of limits: {}{}",
        found.commands_out_of_limits,
        found.first_out_of_limits.map(|what| format!(" ({what})")).unwrap_or_default()
    );
    println!("covariances not positive definite: {}", found.covariances_not_positive);
    println!("numbers not finite: {}", found.not_finite);
    println!("stamps going back: {}", found.stamps_going_back);
    let grown = at_end.zip(after_settling).map(|(end, settled)| end.saturating_sub(settled));
    if grown.is_some_and(|grown| grown > GROWTH_KB) || !found.is_sound() {
        eprintln!("failed");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}

/// Resident memory of this process, where the system tells.
fn resident_kb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix("kB")?.trim().parse().ok()
}

fn kilobytes(value: Option<u64>) -> String {
    value.map_or_else(|| "unknown".to_owned(), |value| value.to_string())
}
