//! The deviations are honest and the errors small on simulated drives.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod common;

use common::{Setup, Truth, log};
use realnet_core::{Stamp, TrackStatus};
use realnet_fusion::{
    RangeSource, Reading, SharedError, TargetFilter, TargetMeasurement, TargetOptions,
};

#[derive(Default, Debug)]
struct Score {
    frames: usize,
    /// Within two deviations.
    inside: usize,
    /// Logarithmic errors of the range, fused and of the last network range held.
    bias: f64,
    absolute: f64,
    network_absolute: f64,
    /// Squares of their changes from frame to frame, metres.
    jitter: f64,
    network_jitter: f64,
    velocity_squared: f64,
}

impl Score {
    fn share(&self) -> f64 {
        self.inside as f64 / self.frames as f64
    }

    fn mean(&self, sum: f64) -> f64 {
        sum / self.frames as f64
    }
}

struct Run {
    setup: Setup,
    options: TargetOptions,
    seeds: std::ops::Range<u64>,
    /// Counted from this time on, and at this time after the frame.
    from_s: f64,
    ahead_s: f64,
    /// The own odometry takes its unit of length from the fused range.
    fed_back: bool,
}

impl Run {
    fn new(setup: Setup) -> Self {
        Self {
            setup,
            options: TargetOptions::default(),
            seeds: 0..40,
            from_s: 1.0,
            ahead_s: 0.0,
            fed_back: false,
        }
    }

    /// Asked at each frame with what has arrived by then.
    fn score(&self) -> Score {
        let mut score = Score::default();
        let ahead = (self.ahead_s * self.setup.fps).round() as usize;
        for seed in self.seeds.clone() {
            let mut log = log(seed, &self.setup);
            let mut filter = TargetFilter::new(self.options).unwrap();
            let mut next = log.arriving.iter().peekable();
            let mut held: Option<f64> = None;
            let mut last: Option<(f64, f64)> = None;
            for index in 0..log.truth.len() - ahead {
                if self.fed_back {
                    feed_back(&mut log.truth, index, &mut filter);
                }
                let (now, truth) = (log.truth[index], log.truth[index + ahead]);
                while let Some(arriving) = next.next_if(|a| a.arrival <= now.stamp) {
                    let mut measurement = arriving.measurement;
                    if self.fed_back {
                        let at = log.truth.partition_point(|t| t.stamp < measurement.stamp);
                        measurement.fixed_from_camera = log.truth[at].believed;
                    }
                    filter.push(measurement).unwrap();
                    held = network_range(&arriving.measurement).or(held);
                }
                let Some(network) = held.filter(|_| now.stamp.secs_f64() >= self.from_s) else {
                    continue;
                };
                let track = filter.track_at(truth.stamp).unwrap();
                let known = matches!(track.status, TrackStatus::Tracking | TrackStatus::Coasting);
                assert!(known, "seed {seed} at {}: {}", now.stamp, track.status);
                let range = track.range_from(&truth.believed).unwrap();
                let depth = truth.seen().0;
                let (error, network) = (range.depth_m - depth, network - depth);
                score.frames += 1;
                score.inside += usize::from(error.abs() <= 2.0 * range.std_m);
                score.bias += (range.depth_m / depth).ln();
                score.absolute += error.abs() / depth;
                score.network_absolute += network.abs() / depth;
                if let Some((last_error, last_network)) = last {
                    score.jitter += (error - last_error).powi(2);
                    score.network_jitter += (network - last_network).powi(2);
                }
                last = Some((error, network));
                let velocity = track.motion.unwrap().velocity;
                score.velocity_squared += (velocity - truth.velocity).norm_squared();
            }
        }
        println!("{:?}\n{score:?} inside {:.3}", self.setup, score.share());
        score
    }
}

/// The step to a frame, as long as the fused range makes it.
fn feed_back(truth: &mut [Truth], index: usize, filter: &mut TargetFilter) {
    let Some(before) = index.checked_sub(1).map(|before| truth[before]) else { return };
    let range = filter.track_at(before.stamp).unwrap().range_from(&before.believed);
    let scale = range.map_or(1.0, |range| range.depth_m / before.seen().0);
    let mut step = before.camera.inverse() * truth[index].camera;
    step.x *= scale;
    step.y *= scale;
    truth[index].believed = before.believed * step;
}

/// The range of a map in the frame that it was computed from.
fn network_range(measurement: &TargetMeasurement) -> Option<f64> {
    match measurement.reading {
        Reading::Range { depth_m, source: RangeSource::Network { map }, .. } => {
            (map == measurement.stamp).then_some(depth_m)
        }
        _ => None,
    }
}

/// The network alone, its common error as the options expect it.
fn network_alone() -> Setup {
    Setup { network_scale_std: 0.04, ..Setup::default() }
}

fn honest(score: &Score) {
    assert!((0.90..=0.99).contains(&score.share()), "inside {:.3}", score.share());
}

#[test]
fn the_network_alone() {
    let score = Run::new(network_alone()).score();
    honest(&score);
    assert!(score.mean(score.bias).abs() < 0.04);
}

/// What the paper claims: maps without a common error.
#[test]
fn half_the_error_and_a_fifth_of_the_jitter_of_the_network() {
    let mut run = Run::new(Setup::default());
    run.options.network_error = SharedError { std: 0.002, time_s: 60.0 };
    let score = run.score();
    honest(&score);
    assert!(score.absolute < 0.5 * score.network_absolute, "{score:?}");
    assert!(score.jitter.sqrt() < 0.2 * score.network_jitter.sqrt(), "{score:?}");
}

#[test]
fn with_ranges_from_the_ground_and_from_the_size() {
    let ground = Run::new(Setup { ground: Some((0.05, 0.04)), ..network_alone() }).score();
    honest(&ground);
    let both = Setup { ground: Some((0.05, 0.04)), size: Some((0.05, 0.1)), ..network_alone() };
    let both = Run::new(both).score();
    honest(&both);
    let alone = Run::new(network_alone()).score();
    assert!(ground.absolute < 0.8 * alone.absolute, "{ground:?} {alone:?}");
    assert!(both.absolute < ground.absolute, "{both:?} {ground:?}");
}

#[test]
fn losses_and_late_directions() {
    let setup = Setup { lost: 0.4, direction_late_s: 0.05, ..network_alone() };
    honest(&Run::new(setup).score());
}

#[test]
fn a_target_that_stands() {
    honest(&Run::new(Setup { moving: false, ..network_alone() }).score());
}

#[test]
fn the_first_second() {
    let mut run = Run::new(Setup { seconds: 1.3, ..network_alone() });
    run.seeds = 0..200;
    run.from_s = 0.34;
    honest(&run.score());
}

#[test]
fn a_tenth_of_a_second_ahead() {
    let setup = Setup { ground: Some((0.05, 0.04)), ..network_alone() };
    let mut run = Run::new(setup);
    run.ahead_s = 0.1;
    honest(&run.score());
}

/// The motion must not be taken for knowledge of the scale: a follower whose motion
/// answers that of the target would come to believe a range that is ever longer.
#[test]
fn no_drift_of_the_scale_in_minutes() {
    for (moving, ground) in [(true, None), (false, None), (true, Some((0.05, 1e-3)))] {
        let mut run = Run::new(Setup { seconds: 150.0, moving, ground, ..Setup::default() });
        run.seeds = 0..12;
        run.from_s = 100.0;
        let score = run.score();
        let bias = score.mean(score.bias);
        assert!(bias.abs() < 0.05, "moving {moving}, ground {ground:?}: {bias}");
    }
}

/// Both vehicles speed up and brake all the time, the own odometry errs by a tenth of the
/// way, and the ground ranges by 6 % for seconds, as expected: the motion must not be taken for a view of
/// the distance, nor may the ground lose its hold by the range going up and down.
#[test]
fn lively_driving_with_a_wrong_odometry() {
    let lively = Setup {
        seconds: 120.0,
        lively: true,
        odometry: Some((0.07, 4.0)),
        ground: Some((0.02, 0.02)),
        ground_wanders: Some((0.06, 4.0)),
        ..Setup::default()
    };
    let cases =
        [(None, false), (Some((0.07, 4.0)), false), (Some((0.07, 1e3)), false), (None, true)];
    for (odometry, fed_back) in cases {
        let mut run = Run::new(Setup { odometry, ..lively });
        run.options.ground_error.std = 0.06;
        run.seeds = 0..10;
        run.fed_back = fed_back;
        let score = run.score();
        honest(&score);
        let bias = score.mean(score.bias);
        assert!(bias.abs() < 0.03, "{odometry:?}: {bias}");
        assert!(score.absolute < 0.33 * score.network_absolute, "{score:?}");
    }
}

/// Without another source of ranges nothing tells of the error that all maps share, however
/// the vehicles move: whether the maps and with them the ranges are all too long or too
/// short, the filter believes the same of them, and does not become surer.
#[test]
fn motion_tells_nothing_of_the_scale() {
    let error = SharedError { std: 0.3, time_s: 1e4 };
    let options = TargetOptions { network_error: error, ..TargetOptions::default() };
    for seed in 0..10 {
        let scale_found = |scale: f64| {
            let network_scale = scale.ln();
            let setup = Setup { seconds: 60.0, lively: true, network_scale, ..Setup::default() };
            let mut filter = TargetFilter::new(options).unwrap();
            for arriving in &log(seed, &setup).arriving {
                filter.push(arriving.measurement).unwrap();
            }
            filter.network_scale_at(Stamp::from_secs_f64(59.9)).unwrap()
        };
        let (right, std) = scale_found(1.0);
        println!("seed {seed}: {right} {std}");
        assert!((0.28..0.32).contains(&std), "{std}");
        for scale in [0.75, 1.3] {
            let (found, std) = scale_found(scale);
            println!("seed {seed}: maps times {scale}: {found} {std}");
            assert!((found / right).ln().abs() < 0.02, "{found} instead of {right}");
            assert!((0.28..0.32).contains(&std), "{std}");
        }
    }
}

#[test]
fn a_network_with_a_wrong_scale_is_found_out() {
    let setup = Setup { network_scale: 1.3_f64.ln(), ..Setup::default() };
    let error = SharedError { std: 0.15, time_s: 60.0 };
    let options = TargetOptions { network_error: error, ..TargetOptions::default() };
    let with_options = |setup| Run { options, ..Run::new(setup) };
    let alone = with_options(setup).score();
    assert!(alone.mean(alone.absolute) > 0.2, "nothing else tells of it: {alone:?}");
    let both = Setup { ground: Some((0.05, 0.02)), size: Some((0.05, 0.05)), ..setup };
    let both = with_options(both).score();
    assert!(both.mean(both.absolute) < 0.06, "{both:?}");
    let log = log(3, &Setup { ground: Some((0.05, 0.02)), size: Some((0.05, 0.05)), ..setup });
    let mut filter = TargetFilter::new(options).unwrap();
    for arriving in &log.arriving {
        filter.push(arriving.measurement).unwrap();
    }
    let (scale, std) = filter.network_scale_at(Stamp::from_secs_f64(19.9)).unwrap();
    assert!((scale - 1.3).abs() < 0.15 && std < 0.06, "{scale} {std}");
}

/// A network beyond what is expected of it: its error is opened, the ground has it.
#[test]
fn network_and_ground_that_disagree_are_not_averaged() {
    for scale in [0.7_f64, 1.4] {
        let ground = Some((0.02, 0.03));
        let mut run = Run::new(Setup { network_scale: scale.ln(), ground, ..Setup::default() });
        run.from_s = 5.0;
        let settled = run.score();
        assert!(settled.mean(settled.absolute) < 0.04, "{scale}: {settled:?}");
        run.options.disagreement_deviations = f64::INFINITY;
        let averaged = run.score();
        assert!(averaged.mean(averaged.absolute) > 0.08, "{scale}: {averaged:?}");
    }
}
