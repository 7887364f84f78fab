//! What the integration tests share: running the program, the shared data, and
//! a network small enough to be built here.
#![allow(
    dead_code,
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

pub mod tiny;

use realnet::results::Record;
use std::{
    ffi::OsStr,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

/// A file of the shared data, or `None` after a message that the test is
/// skipped.
pub fn shared(relative: &str) -> Option<PathBuf> {
    let root = std::env::var_os("REALNET_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is missing", path.display());
    None
}

/// True when ffmpeg and ffprobe can be run; else after a message that the test
/// is skipped.
pub fn has_ffmpeg() -> bool {
    let found = ["ffmpeg", "ffprobe"]
        .iter()
        .all(|program| Command::new(program).arg("-version").output().is_ok());
    if !found {
        println!("skipped: ffmpeg is not installed");
    }
    found
}

/// Runs ffmpeg with these arguments to make a test file.
pub fn ffmpeg<S: AsRef<OsStr>>(args: &[S]) {
    let output =
        Command::new("ffmpeg").args(["-v", "error", "-nostdin", "-y"]).args(args).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// How many frames a video decodes to; panics when a decoder complains.
pub fn frames_in(video: &Path) -> u64 {
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-count_frames", "-select_streams", "v:0"])
        .args(["-show_entries", "stream=nb_read_frames", "-of", "csv=p=0"])
        .arg(video)
        .output()
        .unwrap();
    let complaints = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && complaints.is_empty(), "{}: {complaints}", video.display());
    String::from_utf8_lossy(&output.stdout).trim().trim_end_matches(',').parse().unwrap()
}

/// How a run ended and what it said.
#[derive(Clone, Debug)]
pub struct Run {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

/// The program, with no library of the environment in its way.
pub fn command() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_realnet"));
    command.env_remove("ORT_DYLIB_PATH").env_remove("RUST_BACKTRACE").stdin(Stdio::null());
    command
}

/// Runs a prepared command to its end.
pub fn finish(command: &mut Command) -> Run {
    let output = command.output().unwrap();
    Run {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).expect("standard output is UTF-8"),
        stderr: String::from_utf8(output.stderr).expect("standard error is UTF-8"),
    }
}

/// Runs the program to its end.
pub fn realnet<S: AsRef<OsStr>>(args: &[S]) -> Run {
    finish(command().args(args))
}

impl Run {
    /// Asserts exit code 0 and silence on standard error.
    #[track_caller]
    pub fn quiet(self) -> Self {
        assert!(self.code == Some(0) && self.stderr.is_empty(), "{self:#?}");
        self
    }

    /// The lines of `--json`.
    #[track_caller]
    pub fn records(&self) -> Vec<Record> {
        assert!(self.stdout.is_empty() || self.stdout.ends_with('\n'), "{self:#?}");
        let read = |line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"));
        self.stdout.lines().map(read).collect()
    }

    /// The single line of `--json` for one picture.
    #[track_caller]
    pub fn record(&self) -> Record {
        let mut records = self.records();
        assert_eq!(records.len(), 1, "{self:#?}");
        records.remove(0)
    }
}

/// Standard output without the times, which differ from run to run.
pub fn without_ms(stdout: &str) -> Vec<serde_json::Value> {
    let strip = |line| {
        let mut value: serde_json::Value = serde_json::from_str(line).unwrap();
        value.as_object_mut().unwrap().remove("ms").expect("a record has its times");
        value
    };
    stdout.lines().map(strip).collect()
}

/// Intersection over union of two boxes.
pub fn iou(a: [f64; 4], b: [f64; 4]) -> f64 {
    let side = |low: usize| (a[low + 2].min(b[low + 2]) - a[low].max(b[low])).max(0.0);
    let area = |c: [f64; 4]| (c[2] - c[0]) * (c[3] - c[1]);
    let both = side(0) * side(1);
    both / (area(a) + area(b) - both)
}

/// Names of the files in a folder, sorted.
pub fn listing(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}
