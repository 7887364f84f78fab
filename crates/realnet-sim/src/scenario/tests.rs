use super::*;
use crate::VehicleState;
use crate::dynamics::clearance;
use crate::traffic::ScriptedVehicle;
use realnet_core::Pose2;

fn each() -> impl Iterator<Item = Setup> {
    Scenario::list()
        .iter()
        .flat_map(|scenario| (0..20).map(|seed| scenario.instantiate(seed).unwrap()))
}

/// Moments of a run, every 0.05 s.
fn moments(setup: &Setup) -> impl Iterator<Item = f64> + use<> {
    let count = (setup.duration_s / 0.05) as u32;
    (0..=count).map(|index| f64::from(index) * 0.05)
}

fn corners(vehicle: &ScriptedVehicle, time_s: f64) -> [realnet_core::nalgebra::Vector2<f64>; 4] {
    vehicle.kind.size().corners(&vehicle.state(time_s).world_from_base)
}

#[test]
fn names_are_unique_and_all_is_short() {
    let list = Scenario::list();
    let mut names: Vec<_> = list.iter().map(Scenario::name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), list.len());
    assert!(list.len() >= 22);
    for scenario in list {
        assert_eq!(Scenario::named(scenario.name()).unwrap().name(), scenario.name());
        assert!((5.0..=20.0).contains(&scenario.duration_s()));
        assert!(scenario.description().ends_with('.'));
    }
    let total: f64 = list.iter().map(Scenario::duration_s).sum();
    assert!(total <= 300.0, "{total}");
    assert!(Scenario::named("nothing").is_none());
}

#[test]
fn the_same_seed_is_the_same_run_and_another_one_is_not() {
    for scenario in Scenario::list() {
        let follower = |seed| scenario.instantiate(seed).unwrap().follower;
        assert_eq!(scenario.instantiate(3), scenario.instantiate(3));
        assert_ne!(follower(3), follower(4));
    }
}

#[test]
fn scripts_are_drivable() {
    for setup in each() {
        setup.follower.dynamics.check().unwrap();
        setup.control.check().unwrap();
        for vehicle in setup.target.iter().chain(&setup.others) {
            let sharpest = match vehicle.kind {
                crate::VehicleKind::Buggy => 3.03,
                crate::VehicleKind::TouringCar => 1.85,
                crate::VehicleKind::Truck => 1.59,
                crate::VehicleKind::Robot => f64::INFINITY,
            };
            for time in moments(&setup) {
                let VehicleState { speed, yaw_rate, .. } = vehicle.state(time);
                let name = setup.name;
                assert!(speed.abs() <= 1.5, "{name}: {speed} m/s");
                assert!((speed * yaw_rate).abs() <= 3.0, "{name}: {speed} m/s, {yaw_rate} rad/s");
                assert!(vehicle.profile.acceleration(time).abs() <= 4.5, "{name}");
                let curvature = vehicle.route.curvature(vehicle.place(time)).abs();
                assert!(curvature <= sharpest, "{name}: {curvature} /m");
            }
        }
    }
}

#[test]
fn scripted_vehicles_keep_away_from_each_other() {
    for setup in each() {
        let all: Vec<_> = setup.target.iter().chain(&setup.others).collect();
        for time in moments(&setup) {
            for (index, one) in all.iter().enumerate() {
                for other in &all[index + 1..] {
                    let free = clearance(&corners(one, time), &corners(other, time));
                    assert!(free > 0.1, "{} {}: {free} m at {time} s", setup.name, setup.seed);
                }
            }
        }
    }
}

#[test]
fn the_target_is_in_view_at_the_start() {
    for setup in each() {
        let Some(target) = &setup.target else { continue };
        let base_from_world = setup.follower.start.world_from_base.inverse();
        let seen = base_from_world * target.state(0.0).world_from_base;
        let ahead = seen.x - setup.camera.mount.forward_m;
        assert!(ahead > 0.4 && (seen.y / ahead).abs() < 0.3, "{} {seen:?}", setup.name);
    }
}

#[test]
fn the_way_of_all_is_kept_free() {
    for setup in each() {
        let free = |pose: &Pose2| {
            let nearest = setup.scene.keep_free.iter().map(|[x, y]| (pose.x - x).hypot(pose.y - y));
            nearest.fold(f64::INFINITY, f64::min)
        };
        assert!(free(&setup.follower.start.world_from_base) < 0.3, "{}", setup.name);
        for vehicle in setup.target.iter().chain(&setup.others) {
            for time in moments(&setup) {
                let place = vehicle.state(time).world_from_base;
                assert!(free(&place) < 0.2, "{} {place:?}", setup.name);
            }
        }
    }
}
