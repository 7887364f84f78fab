use super::*;
use realnet_core::nalgebra::Vector2;
use realnet_core::{Pose2, StopReason, TrackStatus};
use realnet_sim::{BodyLog, DepthMapLog, DetectionLog, FrameLog, RunFigures, StopLog, VehicleKind};
use std::path::Path;

/// Small differences that look like chance and are the same each time, -1 to 1.
fn noise(index: usize) -> f64 {
    let mut bits = (index as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    bits ^= bits >> 29;
    bits = bits.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits ^= bits >> 32;
    (bits % 2001) as f64 / 1000.0 - 1.0
}

/// A run of 20 s at 30 Hz that looks as one does: into a curve, a hard braking at
/// 7 s, a standstill, off again, behind an obstacle from 14 to 15.2 s.
pub(in crate::cli::sim) fn plausible() -> RunLog {
    let (dt, count) = (1.0 / 30.0, 600);
    let mut log = RunLog {
        scenario: "brake-and-hide".into(),
        description: "The target brakes hard in a curve, stands, goes on and passes behind a box."
            .into(),
        seed: 7,
        desired_gap_m: 1.0,
        follower_size: Some(VehicleKind::TouringCar.size()),
        target_size: Some(VehicleKind::Truck.size()),
        ..RunLog::default()
    };
    let mut target = Pose2::new(2.0, 0.0, 0.0);
    let mut follower = Pose2::IDENTITY;
    let (mut speed, mut command) = (0.0f64, 0.0f64);
    let (mut held, mut held_from) = (None, 0.0);
    let mut walker = Vec::new();
    for index in 0..count {
        let time = index as f64 * dt;
        let target_speed = match time {
            t if t < 1.0 => 0.8 * t,
            t if t < 7.0 => 0.8,
            t if t < 7.4 => 0.8 - 2.0 * (t - 7.0),
            t if t < 9.5 => 0.0,
            t => (t - 9.5).min(0.9),
        };
        target = target.driven(target_speed, target_speed * 0.45 * (0.35 * time).sin(), dt);
        let offset = follower.inverse().transform_point(&target.position());
        let range = offset.norm();
        let gap = range - 0.43;
        let hidden = (14.0..15.2).contains(&time);
        let status = match time {
            t if t < 0.4 => TrackStatus::Searching,
            t if (14.2..14.9).contains(&t) => TrackStatus::Coasting,
            t if (14.9..15.5).contains(&t) => TrackStatus::Lost,
            _ => TrackStatus::Tracking,
        };
        // A map every third of a second, 0.27 s late, its scale off by up to a tenth.
        if index % 10 == 8 && index > 8 {
            let exposed = time - 0.27;
            let then = log.frames.iter().rev().find(|frame| frame.time_s <= exposed);
            let range_m = then.and_then(|f| f.range_true_m).map(|r| r * (1.0 + 0.1 * noise(index)));
            held = range_m.or(held);
            held_from = range_m.map_or(held_from, |_| exposed);
            log.depth_maps.push(DepthMapLog { time_s: exposed, arrived_s: time, range_m });
        }
        let late = 0.05 + 0.012 * noise(index + 5000);
        let found = !hidden;
        log.detections.push(DetectionLog { time_s: time, arrived_s: time + late, found });
        let drift = 0.012 * (1.3 * time).sin() + 0.004 * noise(index / 12);
        let std = 0.02 + if status == TrackStatus::Tracking { 0.0 } else { (time - 14.0) * 0.25 };
        let fused = (time > 0.4).then_some(range + drift);
        let stop = match time {
            t if t < 0.4 => Some(StopReason::NoTarget),
            t if (14.9..15.5).contains(&t) => Some(StopReason::TargetLost),
            _ => None,
        };
        let wanted =
            if stop.is_some() { 0.0 } else { (1.6 * (gap - 1.0) + target_speed).clamp(0.0, 1.2) };
        command += (wanted - command).clamp(-0.12, 0.06);
        speed += (command - speed) * 0.25;
        let steering = (2.0 * 0.26 * offset.y / (range * range)).atan().clamp(-0.45, 0.45);
        walker.push(Pose2::new(4.0 + 0.12 * time, -1.6 + 0.1 * time, 0.7));
        log.frames.push(FrameLog {
            range_ground_m: None,
            pitch_rad: 0.0,
            time_s: time,
            range_true_m: (!hidden).then_some(range),
            range_network_m: held,
            network_age_s: held.map(|_| time - held_from),
            range_fast_m: held
                .filter(|_| !hidden)
                .map(|_| range * (1.0 + 0.05 * noise(index / 10))),
            range_fused_m: fused,
            range_fused_std_m: fused.map(|_| std),
            status,
            gap_m: gap,
            clearance_m: gap - 0.05 * (0.8 * time).sin().abs(),
            lateral_m: 0.03 * (0.7 * time).sin() + 0.002 * noise(index),
            speed_command: command,
            speed_limit: Some(1.2 - steering.abs()),
            limited_by: (steering.abs() > 0.12).then_some("curve"),
            steering_command: steering + 0.01 * noise(index / 2),
            speed,
            steering,
            target_speed,
            follower,
            target,
            stop,
        });
        follower = follower.driven(speed, speed * steering.tan() / 0.26, dt);
    }
    log.stops = vec![
        StopLog { from_s: 0.0, until_s: Some(0.4), reason: StopReason::NoTarget },
        StopLog { from_s: 14.9, until_s: Some(15.5), reason: StopReason::TargetLost },
    ];
    let outline = |half_x: f64, half_y: f64| {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, y)| Vector2::new(x * half_x, y * half_y))
            .to_vec()
    };
    log.bodies = vec![
        BodyLog {
            name: "box".into(),
            outline: outline(0.3, 0.2),
            poses: vec![Pose2::new(5.0, 3.2, 0.4)],
        },
        BodyLog { name: "buggy".into(), outline: outline(0.14, 0.09), poses: walker },
    ];
    log.walls = [(-1.5, -2.4), (12.5, -2.4), (12.5, 8.0), (-1.5, 8.0)]
        .map(|(x, y)| Vector2::new(x, y))
        .to_vec();
    log
}

fn judged(log: &RunLog, failures: &[&str]) -> RunResult {
    RunResult {
        scenario: log.scenario.clone(),
        seed: log.seed,
        figures: RunFigures::from_log(log, 3.0),
        failures: failures.iter().map(|f| (*f).to_owned()).collect(),
    }
}

/// Fails unless every tag that is opened is closed, in the right order.
#[track_caller]
fn well_formed(html: &str) {
    let mut open: Vec<&str> = Vec::new();
    let style = html.find("</style>").unwrap();
    let script = html.find("<script>").unwrap()..html.find("</script>").unwrap();
    let tags = format!("{}{}", &html[style + 8..script.start], &html[script.end + 9..]);
    for tag in tags.split('<').skip(1) {
        let tag = tag.split('>').next().unwrap();
        let name = tag.trim_start_matches('/').split([' ', '\n']).next().unwrap();
        if let Some(closed) = tag.strip_prefix('/') {
            if !matches!(closed, "head" | "html") {
                let opened = open.pop();
                assert_eq!(opened, Some(closed), "closed <{closed}>, inside {open:?}");
            }
        } else if !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
    for nonsense in ["NaN", "inf\"", "inf ", "-0.0\"", "http:", "https:", "src="] {
        assert!(!html.contains(nonsense), "the page says {nonsense}");
    }
}

#[test]
fn the_page_of_a_run_is_whole() {
    let log = plausible();
    let run = judged(&log, &["least gap 0.3 m, 0.5 m asked", "range < truth & worse"]);
    let options = PageOptions {
        command: "realnet sim --scenario 'a b' --seed 7",
        video: Some("a.mp4"),
        index: Some("index.html"),
    };
    let html = page(&run, &log, &options);
    well_formed(&html);
    for words in [
        "brake-and-hide",
        "✗ failed",
        "least gap 0.3 m",
        "range &lt; truth &amp; worse",
        "two deviations",
        "network, held",
        "map arrives",
        "Steering",
        "From above",
        "target-lost",
        "searching, 0.4 s",
        "speed limited: curve",
        "Depth maps: 59 arrived, 270 to 270 ms",
        "href=\"a.mp4\"",
        "&#39;a b&#39;",
    ] {
        assert!(html.contains(words), "the page lacks {words}");
    }
    assert!(html.len() < 500_000, "{} bytes", html.len());
    assert_eq!(html, page(&run, &log, &options), "the same run is the same page");
    assert_eq!(page_name(&run), "brake-and-hide-7.html");
    keep("run.html", |path| std::fs::write(path, &html).unwrap());
}

#[test]
fn pages_of_runs_with_little_in_them_are_whole() {
    let empty = RunLog::default();
    let html = page(&judged(&empty, &[]), &empty, &PageOptions::default());
    well_formed(&html);
    assert!(html.contains("✓ passed") && html.contains("no frames"), "{html}");

    // No target: nothing about it is a number.
    let mut log = plausible();
    log.target_size = None;
    (log.depth_maps, log.detections, log.bodies) = Default::default();
    for frame in &mut log.frames {
        (frame.range_true_m, frame.range_network_m, frame.range_fast_m) = (None, None, None);
        (frame.range_fused_m, frame.range_fused_std_m) = (None, None);
        (frame.gap_m, frame.clearance_m, frame.lateral_m) = (f64::NAN, f64::INFINITY, f64::NAN);
        frame.target = Pose2::new(f64::NAN, f64::NAN, f64::NAN);
        frame.status = TrackStatus::Searching;
    }
    let html = page(&judged(&log, &[]), &log, &PageOptions::default());
    well_formed(&html);
    assert!(
        html.contains("No depth map and no detection arrived.") && !html.contains(">target<"),
        "{html}"
    );

    assert!(!html.contains("Error against the truth"), "no chart without anything on it");

    let one = RunLog { frames: plausible().frames[..1].to_vec(), ..RunLog::default() };
    well_formed(&page(&judged(&one, &[]), &one, &PageOptions::default()));
}

#[test]
fn the_index_links_what_is_there() {
    let log = plausible();
    let mut runs: Vec<RunResult> =
        (0..20).map(|seed| RunResult { seed, ..judged(&log, &[]) }).collect();
    runs[3].failures = vec!["1 collision".into()];
    for scenario in ["steady-following", "no-target", "depth-network-at-1-hz"] {
        runs.extend((0..20).map(|seed| {
            let mut run = RunResult { seed, scenario: scenario.into(), ..judged(&log, &[]) };
            let scale = 1.0 + 0.3 * noise(seed as usize);
            run.figures.gap_rmse_m = run.figures.gap_rmse_m.map(|v| v * scale);
            if scenario == "no-target" {
                run.figures = RunFigures::default();
            }
            run
        }));
    }
    let html = index(
        &runs,
        |run| run.seed < 5,
        &["scenario <a> with seed 9: no room".to_owned()],
        "realnet sim --all --seeds 20 --report out",
    );
    well_formed(&html);
    // Five squares, and the name leads to the first of them.
    assert_eq!(html.matches("href=\"steady-following-").count(), 6);
    assert!(html.contains("<a href=\"steady-following-0.html\">steady-following</a>"), "{html}");
    assert!(html.contains("79 of 80 runs of 4 scenarios passed"), "{html}");
    assert!(html.contains("<a href=\"brake-and-hide-3.html\">seed 3</a>: 1 collision"), "{html}");
    assert_eq!(html.matches("class=\"failed\"").count(), 1);
    keep("index.html", |path| std::fs::write(path, &html).unwrap());
    assert!(html.contains("<li>scenario &lt;a&gt; with seed 9: no room</li>"), "{html}");
    well_formed(&index(&[], |_| true, &[], ""));
}

/// What `write` makes, in the folder that `REALNET_KEEP_PAGES` names: to look at it.
pub(in crate::cli::sim) fn keep(name: &str, write: impl FnOnce(&Path)) {
    if let Some(folder) = std::env::var_os("REALNET_KEEP_PAGES") {
        write(&Path::new(&folder).join(name));
    }
}
