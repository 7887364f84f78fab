//! Times of the control: `cargo bench -p realnet-control --bench control`.
#![allow(missing_docs, clippy::unwrap_used)]

use divan::{Bencher, black_box};
use realnet_control::{ControlInput, ControlOptions, Controller};
use realnet_core::nalgebra::{Matrix2, Vector2};
use realnet_core::{Pose2, Stamp, TargetEstimate, TargetState, TrackStatus};

fn main() {
    divan::main();
}

/// A controller on its way, with its next frame.
struct Run {
    controller: Controller,
    trail: Vec<Vector2<f64>>,
    frame: u64,
}

impl Run {
    fn new(points: usize) -> Self {
        let controller = Controller::new(ControlOptions::default()).unwrap();
        let end = 1.3;
        let point = |i: usize| Vector2::new(end - 0.05 * (points - i) as f64, 0.1);
        let mut run = Self { controller, trail: (0..points).map(point).collect(), frame: 0 };
        for _ in 0..300 {
            run.step();
        }
        run
    }

    fn step(&mut self) {
        let now = Stamp::of_frame(self.frame, 30.0);
        self.frame += 1;
        let target = TargetState {
            stamp: self.controller.effect_time(now),
            measured: Some(now),
            status: TrackStatus::Tracking,
            estimate: Some(TargetEstimate {
                position: Vector2::new(1.34, 0.1),
                velocity: Vector2::new(0.5, 0.0),
                acceleration: Vector2::zeros(),
                position_covariance: Matrix2::identity() * 4e-4,
                velocity_covariance: Matrix2::identity() * 1e-2,
            }),
        };
        let mut input = ControlInput::new(now, &target);
        input.trail = &self.trail;
        black_box(self.controller.step(black_box(&input)));
    }
}

/// A step, by the number of points of the trail.
#[divan::bench(args = [0, 20, 180])]
fn step(bencher: Bencher<'_, '_>, points: usize) {
    let mut run = Run::new(points);
    bencher.bench_local(|| run.step());
}

/// A timer's call without a new input.
#[divan::bench]
fn idle(bencher: Bencher<'_, '_>) {
    let mut run = Run::new(20);
    bencher.bench_local(|| {
        run.frame += 1;
        black_box(run.controller.idle(Stamp::of_frame(run.frame, 30.0)))
    });
}

/// The own pose 0.18 s ahead: 50 ms of latency, dead time and half the lag.
#[divan::bench]
fn advance(bencher: Bencher<'_, '_>) {
    let run = Run::new(20);
    let from = Stamp::of_frame(run.frame, 30.0);
    let to = Stamp::from_nanos(from.nanos() + 180_000_000);
    let predictor = run.controller.predictor();
    bencher.bench_local(|| predictor.advance(black_box(Pose2::IDENTITY), from, black_box(to)));
}

/// A measured speed and rate of turn of half a second ago, the commands since replayed.
#[divan::bench]
fn correct(bencher: Bencher<'_, '_>) {
    let mut run = Run::new(20);
    let stamp = Stamp::from_nanos(Stamp::of_frame(run.frame, 30.0).nanos() - 510_000_000);
    let predictor = run.controller.predictor_mut();
    bencher.bench_local(|| predictor.correct(black_box(stamp), Some(0.5), Some(0.05)));
}
