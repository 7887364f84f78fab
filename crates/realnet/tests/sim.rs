//! `realnet sim` as a user runs it: the list, a run with all that it writes, and what
//! is wrong with bad input.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

mod common;

use common::{Run, finish, frames_in, has_ffmpeg, listing, realnet};
use serde_json::Value;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use tempfile::tempdir;

/// The keys that every reader may count on, in their order.
const KEYS: [&str; 13] = [
    "scenario",
    "seed",
    "gap_rmse_m",
    "lateral_rmse_m",
    "range_abs_rel",
    "range_abs_rel_network_only",
    "range_jitter_m",
    "range_jitter_network_only_m",
    "min_gap_m",
    "collisions",
    "tracked_share",
    "stops",
    "pass",
];

/// The shortest scenario.
const SHORT: &str = "no-target";

fn lines(run: &Run) -> Vec<Value> {
    run.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The lines of runs; the exit code says whether all of them passed.
#[track_caller]
fn judged(run: &Run) -> Vec<Value> {
    let values = lines(run);
    let passed = values.iter().all(|value| value["pass"].as_bool().unwrap());
    assert_eq!(run.code, Some(i32::from(!passed)), "{run:#?}");
    values
}

/// Runs the program in a folder.
fn sim_in(folder: &Path, args: &[&str]) -> Run {
    finish(common::command().arg("sim").args(args).current_dir(folder))
}

#[test]
fn the_list_names_at_least_twenty_scenarios() {
    let table = realnet(&["sim", "--list"]).quiet();
    let json = realnet(&["sim", "--list", "--json"]).quiet();
    let rows = lines(&json);
    let names: BTreeSet<&str> = rows.iter().map(|row| row["scenario"].as_str().unwrap()).collect();
    assert!(names.len() >= 20 && names.len() == rows.len(), "{names:?}");
    for row in &rows {
        let name = row["scenario"].as_str().unwrap();
        assert!(table.stdout.lines().any(|line| line.starts_with(name)), "{name}");
        assert!(row["seconds"].as_f64().unwrap() > 0.0, "{row}");
        assert!(!row["description"].as_str().unwrap().is_empty(), "{row}");
    }
    assert!(table.stdout.lines().all(|line| line.chars().count() <= 100), "{}", table.stdout);
}

#[test]
fn a_run_says_the_same_each_time_and_writes_what_it_should() {
    let folder = tempdir().unwrap();
    let with_video = has_ffmpeg();
    let mut args =
        vec!["--scenario", SHORT, "--seed", "3", "--json", "--report", "out", "--log", "log"];
    if with_video {
        args.extend(["--video", "out/run.mp4"]);
    }
    let first = sim_in(folder.path(), &args);
    let values = judged(&first);
    let [value] = values.as_slice() else { panic!("{first:#?}") };
    let keys: Vec<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(keys[..KEYS.len()], KEYS);
    assert_eq!((value["scenario"].as_str(), value["seed"].as_u64()), (Some(SHORT), Some(3)));
    // Nobody is there: nothing to range, and the follower stands for that reason.
    assert!(value["range_abs_rel"].is_null() && value["gap_rmse_m"].is_null(), "{value}");
    assert_eq!(value["stops"][0]["reason"], "no-target");

    let out = folder.path().join("out");
    let page_name = format!("{SHORT}-3.html");
    let names = [page_name.as_str(), "run.mp4"];
    assert_eq!(listing(&out), names[..1 + usize::from(with_video)]);
    let page = std::fs::read_to_string(out.join(&page_name)).unwrap();
    for outside in ["http:", "https:", "src=", "@import", "url(//"] {
        assert!(!page.contains(outside), "the page needs {outside}");
    }
    assert!(page.contains("realnet sim --scenario no-target --seed 3"), "how it was called");
    assert!(!page.contains("NaN"), "only numbers are drawn");
    assert_eq!(page.contains("href=\"run.mp4\""), with_video, "the video lies beside the page");

    let log_name = format!("{SHORT}-3.csv");
    let log = std::fs::read_to_string(folder.path().join("log").join(&log_name)).unwrap();
    let columns: Vec<usize> = log.lines().map(|line| line.split(',').count()).collect();
    assert!(columns.iter().all(|count| *count == columns[0]), "{columns:?}");
    let last = log.lines().last().unwrap().split(',').collect::<Vec<_>>();
    let target = log.lines().next().unwrap().split(',').position(|name| name == "target_x");
    assert_eq!(last[target.unwrap()], "", "a target that is not there is nowhere");
    let frames = value["frames"].as_u64().unwrap();
    assert_eq!(columns.len() as u64, frames + 1);
    if with_video {
        assert_eq!(frames_in(&out.join("run.mp4")), frames);
    }

    let second = sim_in(folder.path(), &args);
    assert_eq!(second.stdout, first.stdout);
    assert_eq!(std::fs::read_to_string(out.join(&page_name)).unwrap(), page);
    assert_eq!(std::fs::read_to_string(folder.path().join("log").join(&log_name)).unwrap(), log);
}

#[test]
fn several_seeds_are_in_order_with_a_page_over_all() {
    let folder = tempdir().unwrap();
    let args = ["--scenario", SHORT, "--seeds", "2", "--seed", "5", "--report", "out", "--json"];
    let run = sim_in(folder.path(), &args);
    let values = judged(&run);
    let seeds: Vec<u64> = values.iter().map(|value| value["seed"].as_u64().unwrap()).collect();
    assert_eq!(seeds, [5, 6]);
    let out = folder.path().join("out");
    let names = [format!("{SHORT}-5.html"), format!("{SHORT}-6.html")];
    assert_eq!(listing(&out), ["index.html", &names[0], &names[1]]);
    let index = std::fs::read_to_string(out.join("index.html")).unwrap();
    for name in names {
        assert!(index.contains(&format!("href=\"{name}\"")), "{name}");
        let page = std::fs::read_to_string(out.join(&name)).unwrap();
        assert!(page.contains("href=\"index.html\""), "{name}");
    }
}

#[test]
fn any_number_of_jobs_prints_the_same_bytes() {
    let folder = tempdir().unwrap();
    let args = ["--scenario", SHORT, "--seeds", "4", "--json", "--jobs"];
    let one = sim_in(folder.path(), &[&args[..], &["1"]].concat());
    let many = sim_in(folder.path(), &[&args[..], &["4"]].concat());
    assert_eq!(judged(&one).len(), 4);
    assert_eq!((one.code, one.stdout), (many.code, many.stdout));
}

#[test]
fn what_goes_wrong_with_one_run_leaves_the_others() {
    let folder = tempdir().unwrap();
    // A folder lies where the page of seed 1 is to be.
    let out = folder.path().join("out");
    let page = |seed: u32| format!("{SHORT}-{seed}.html");
    std::fs::create_dir_all(out.join(page(1)).join("in the way")).unwrap();
    let args = ["--scenario", SHORT, "--seeds", "3", "--json", "--report", "out", "--jobs", "2"];
    let run = sim_in(folder.path(), &args);
    assert_eq!(run.code, Some(1), "{run:#?}");
    let values = lines(&run);
    let seeds: Vec<u64> = values.iter().map(|value| value["seed"].as_u64().unwrap()).collect();
    assert_eq!(seeds, [0, 1, 2], "what is wrong with a file is not wrong with the figures");
    let told: Vec<&str> =
        run.stderr.lines().filter(|line| line.contains("scenario no-target with seed")).collect();
    assert!(matches!(told[..], [line] if line.contains("seed 1: ") && line.contains(&page(1))));
    let index = std::fs::read_to_string(out.join("index.html")).unwrap();
    for seed in 0..3 {
        assert_eq!(index.contains(&format!("href=\"{}\"", page(seed))), seed != 1, "{seed}");
    }
    assert!(index.contains("scenario no-target with seed 1: "), "the page over all says so too");
    // Alone it is the outcome.
    let alone = ["--scenario", SHORT, "--seed", "1", "--json", "--report", "out"];
    let alone = sim_in(folder.path(), &alone);
    assert_eq!((alone.code, lines(&alone)), (Some(1), vec![values[1].clone()]), "{alone:#?}");
    assert!(alone.stderr.contains("seed 1: "), "{alone:#?}");
}

/// The runs cannot all end before the signal, which is sent at the first line.
#[cfg(unix)]
#[test]
fn what_was_done_before_an_interruption_is_whole() {
    let folder = tempdir().unwrap();
    let args = ["--scenario", SHORT, "--seeds", "100000", "--json", "--report", "out"];
    let mut child = common::command()
        .args(["sim", "--jobs", "2"])
        .args(args)
        .current_dir(folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut reader = BufReader::new(child.stdout.take().unwrap());
    let mut stdout = String::new();
    reader.read_line(&mut stdout).unwrap();
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    reader.read_to_string(&mut stdout).unwrap();
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    let run = Run { code: output.status.code(), stdout, stderr };
    assert_eq!(run.code, Some(130), "{run:#?}");
    let values = lines(&run);
    assert!((1..1000).contains(&values.len()) && run.stdout.ends_with('\n'), "{}", values.len());
    let out = folder.path().join("out");
    let mut names = vec!["index.html".to_owned()];
    names.extend(values.iter().map(|value| format!("{SHORT}-{}.html", value["seed"])));
    names.sort();
    assert_eq!(listing(&out), names, "a page for each line, and no more");
    for name in names {
        let page = std::fs::read_to_string(out.join(&name)).unwrap();
        assert!(page.ends_with("</html>\n"), "{name}");
    }
}

#[test]
fn the_largest_seed_is_one_too() {
    let folder = tempdir().unwrap();
    let largest = u64::MAX.to_string();
    let run = sim_in(folder.path(), &["--scenario", SHORT, "--seed", &largest, "--json"]);
    assert_eq!(judged(&run)[0]["seed"].as_u64(), Some(u64::MAX));
}

#[test]
fn bad_input_is_named() {
    let folder = tempdir().unwrap();
    for (args, words) in [
        (&["--scenario", "no-such"][..], "there is no scenario 'no-such'"),
        (&["--scenario", SHORT, "--seeds", "2", "--video", "a.mp4"], "--video is for one run"),
        (&[], "required"),
        (&["--list", "--all"], "cannot be used with"),
        (&["--all", "--seeds", "0"], "0 is not in"),
        // What would be passed over in silence.
        (&["--list", "--report", "out"], "cannot be used with"),
        (&["--dataset", "set", "--seeds", "2"], "cannot be used with"),
        (&["--dataset", "set", "--json"], "cannot be used with"),
        (&["--scenario", SHORT, "--frames", "5"], "cannot be used with"),
    ] {
        let run = sim_in(folder.path(), args);
        assert!(run.code == Some(2) && run.stderr.contains(words), "{args:?}: {run:#?}");
        assert!(run.stdout.is_empty(), "{run:#?}");
    }
    assert!(listing(folder.path()).is_empty(), "nothing is left behind");
}

/// Networks see what is drawn, the program's own where none is named.
#[test]
fn networks_see_for_the_follower() {
    let args = ["--scenario", "slalom", "--seed", "1", "--json", "--engine", "rten"];
    let sim = |more: &[&str]| realnet(&[&["sim"], args.as_slice(), more].concat());
    let run = sim(&["--perception", "networks"]);
    let found = &judged(&run)[0];
    assert!(found["tracked_share"].as_f64().unwrap() > 0.9, "{found}");
    assert!(found["range_abs_rel"].as_f64().unwrap() < 0.15, "{found}");
    assert_eq!(found["collisions"], 0);
    let truth = sim(&[]);
    assert_ne!(judged(&truth)[0]["range_abs_rel"], found["range_abs_rel"]);
    for (more, said) in [
        (["--depth", "none"].as_slice(), "--perception networks"),
        (&["--perception", "networks", "--detector", "nowhere.onnx"], "nowhere.onnx"),
    ] {
        let run = sim(more);
        assert!(run.code == Some(2) && run.stderr.contains(said), "{run:#?}");
    }
}
