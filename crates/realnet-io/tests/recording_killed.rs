//! A recording whose process is killed in the middle.
#![cfg(unix)]
#![allow(clippy::unwrap_used, clippy::print_stdout)]

mod run;

use realnet_io::recording::{CHUNK_SECONDS, ReadError, RunReader, RunWriter};
use run::{Step, info};
use std::env;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const RECORDING: &str = "REALNET_TEST_RECORDING";

/// The child: records without end and says the number of each frame when it is
/// recorded. As a test of its own it does nothing.
#[test]
fn records_until_killed() {
    let Some(path) = env::var_os(RECORDING).map(PathBuf::from) else { return };
    let mut run = RunWriter::create(&path, &info(), run::STATE).unwrap();
    let mut out = std::io::stdout().lock();
    for index in 0.. {
        Step::new(index).write(&mut run).unwrap();
        writeln!(out, "recorded {index}").unwrap();
        out.flush().unwrap();
    }
}

/// Kills a child after it said that it recorded frame `after`. The number of the
/// last frame that it said.
fn record_and_kill(path: &Path, after: u64) -> u64 {
    let mut child = Command::new(env::current_exe().unwrap())
        .args(["--exact", "records_until_killed", "--nocapture", "--test-threads", "1"])
        .env(RECORDING, path)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut last = 0;
    for line in BufReader::new(child.stdout.take().unwrap()).lines() {
        // The test runner talks too, in the same lines.
        if let Some((_, number)) = line.unwrap().split_once("recorded ") {
            // A killed child may leave half a number, which is a smaller one.
            last = last.max(number.parse().unwrap_or(0));
        }
        if last == after {
            child.kill().unwrap();
        }
    }
    assert_eq!(child.wait().unwrap().signal(), Some(9));
    last
}

#[test]
fn a_killed_recording_is_readable_to_its_last_second() {
    let folder = tempfile::tempdir().unwrap();
    for after in [3, 95, 250] {
        let path = folder.path().join(format!("killed_{after}.mcap"));
        let said = record_and_kill(&path, after);
        assert!(said >= after);
        let mut run = RunReader::open(&path).unwrap();
        assert_eq!(run.info(), &info());
        let mut read = Vec::new();
        let error = loop {
            match run.next().unwrap() {
                Ok(recorded) => read.push(recorded),
                Err(error) => break error,
            }
        };
        let length = std::fs::metadata(&path).unwrap().len();
        assert!(matches!(error, ReadError::BreaksOff { at, .. } if at == length), "{error}");
        assert!(run.next().is_none());

        // The first messages without a gap, and all but the last second of them.
        let given: Vec<_> = (0..=said + 40).flat_map(|index| Step::new(index).expected()).collect();
        assert_eq!(read, given[..read.len()]);
        let last = read.last().map(|recorded| recorded.times.arrival);
        let kept = last.unwrap_or(Step::new(0).times.arrival);
        let lost = Step::new(said).times.arrival.seconds_since(kept);
        assert!(lost <= CHUNK_SECONDS, "{lost} s of {after} frames are lost");
        println!("killed after {said} frames: {} messages read, {lost} s lost", read.len());
    }
}
