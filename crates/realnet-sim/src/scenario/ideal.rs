//! Scenarios driven with perfect knowledge: the true target, predicted without error.
//! What fails here, no perception can make good.

use super::{Scenario, Setup};
use crate::dynamics::{Vehicle, clearance, gap_ahead};
use crate::{FrameLog, RunFigures, RunLog};
use realnet_control::{ControlInput, Controller};
use realnet_core::nalgebra::{Matrix2, Vector2};
use realnet_core::{Stamp, TargetEstimate, TargetState, TrackStatus};

/// How much of a target must be inside of the picture's border, radians.
const BORDER: f64 = 0.1;

fn driven(setup: &Setup) -> RunLog {
    let size = setup.follower.kind.size();
    let start = setup.follower.start;
    let mut vehicle =
        Vehicle::new(setup.follower.dynamics, size.wheel_radius, start, Stamp::ZERO).unwrap();
    let mut controller = Controller::new(setup.control).unwrap();
    let target = setup.target.as_ref().unwrap();
    let footprint = |time: f64| target.kind.size().corners(&target.state(time).world_from_base);
    let surface = |pose: &realnet_core::Pose2, time: f64| {
        let corners = footprint(time);
        let middle = corners.iter().sum::<Vector2<f64>>() / 4.0;
        let bumper = pose.transform_point(&Vector2::new(size.front(), 0.0));
        bumper + (middle - bumper).normalize() * gap_ahead(pose, &size, &corners)
    };
    let half_view = 0.5 * setup.camera.model.horizontal_fov().unwrap() - BORDER;
    let mut log = RunLog { desired_gap_m: setup.desired_gap_m(), ..RunLog::default() };
    let (mut seen, mut trail) = (None, Vec::new());
    for index in 0..setup.frames() {
        let stamp = Stamp::of_frame(index, setup.camera.rate_hz);
        let time = stamp.secs_f64();
        vehicle.advance_to(stamp);
        let state = vehicle.state();
        let pose = state.world_from_base;
        let view = pose.inverse().transform_point(&surface(&pose, time))
            - Vector2::new(setup.camera.mount.forward_m, 0.0);
        let visible = view.x > 0.05 && view.y.atan2(view.x).abs() < half_view;
        if visible {
            seen = Some(stamp);
        }
        if visible {
            trail.push(surface(&pose, time));
        }

        let now = Stamp::from_secs_f64(time + setup.camera.latency_s);
        let effect = controller.effect_time(now);
        let mut later = vehicle.clone();
        later.advance_to(effect);
        let base_from_world = later.state().world_from_base.inverse();
        let then = surface(&later.state().world_from_base, effect.secs_f64());
        let motion = target.state(effect.secs_f64());
        let velocity = motion.world_from_base.direction() * motion.speed;
        let estimate = TargetEstimate {
            position: base_from_world.transform_point(&then),
            velocity: base_from_world.transform_vector(&velocity),
            acceleration: Vector2::zeros(),
            position_covariance: Matrix2::identity() * 1e-4,
            velocity_covariance: Matrix2::identity() * 1e-3,
        };
        let fresh = seen.is_some_and(|seen| stamp.seconds_since(seen) < 1.0);
        let status = if visible {
            TrackStatus::Tracking
        } else if fresh {
            TrackStatus::Coasting
        } else {
            TrackStatus::Lost
        };
        let state_then = TargetState {
            stamp: effect,
            measured: seen,
            status,
            estimate: fresh.then_some(estimate),
        };
        let path: Vec<_> = trail
            .iter()
            .rev()
            .take(120)
            .rev()
            .map(|p| base_from_world.transform_point(p))
            .collect();
        let command = controller.step(&ControlInput {
            now,
            target: &state_then,
            trail: &path,
            own_speed: None,
        });
        vehicle.command(&command);

        let own = size.corners(&pose);
        let others = setup.others.iter().map(|other| {
            clearance(&own, &other.kind.size().corners(&other.state(time).world_from_base))
        });
        log.frames.push(FrameLog {
            time_s: time,
            range_true_m: visible.then_some(view.x),
            status,
            gap_m: gap_ahead(&pose, &size, &footprint(time)),
            clearance_m: others.fold(clearance(&own, &footprint(time)), f64::min),
            lateral_m: setup.lateral_m(time, &pose),
            speed_command: command.speed,
            steering_command: command.steering_angle,
            speed: state.speed,
            steering: state.steering_angle,
            target_speed: motion.speed,
            follower: pose,
            target: target.state(time).world_from_base,
            stop: command.stop,
            ..FrameLog::default()
        });
    }
    log
}

#[test]
fn perfect_knowledge_keeps_gap_and_path_without_collisions() {
    let mut failures = Vec::new();
    for scenario in Scenario::list() {
        let mut worst = [0.0_f64, 0.0, f64::INFINITY, 1.0, 0.0];
        for seed in 0..8 {
            let setup = scenario.instantiate(seed).unwrap();
            if setup.target.is_none() {
                continue;
            }
            let log = driven(&setup);
            let expect = &setup.expectations;
            let figures = RunFigures::from_log(&log, expect.settle_s);
            let last = log.frames.last().unwrap();
            let reached = [
                figures.gap_rmse_m.unwrap(),
                figures.lateral_rmse_m.unwrap(),
                figures.min_gap_m.unwrap(),
                figures.tracked_share.unwrap(),
                (last.gap_m - log.desired_gap_m).abs(),
            ];
            for (index, (worst, value)) in worst.iter_mut().zip(reached).enumerate() {
                *worst = if index == 2 || index == 3 { worst.min(value) } else { worst.max(value) };
            }
            let mut bounds = expect.clone();
            bounds.stops.clear();
            bounds.max_range_abs_rel = None;
            for failure in bounds.check(&figures, &log) {
                failures.push(format!("{} {seed}: {failure}", scenario.name()));
            }
        }
        let [gap, lateral, least, tracked, last] = worst;
        println!(
            "{:18} gap {gap:.3}  lateral {lateral:.3}  least {least:.3}  seen {tracked:.2}  \
             end {last:.3}",
            scenario.name()
        );
    }
    assert!(failures.is_empty(), "{failures:#?}");
}
