//! A table of command lines with what must come of them.

use crate::common::{Run, command, finish, tiny};
use std::{
    ffi::OsString,
    path::{Path, PathBuf},
};
use tempfile::TempDir;

/// One command line and its end.
pub struct Case {
    what: String,
    args: Vec<OsString>,
    code: i32,
    says: Vec<String>,
    path: Option<PathBuf>,
}

impl Case {
    /// A run with these arguments that must end with `code` and say all of `says`.
    pub fn new<S: Into<OsString>>(
        what: &str,
        args: impl IntoIterator<Item = S>,
        code: i32,
        says: &[&str],
    ) -> Self {
        Self {
            what: what.to_owned(),
            args: args.into_iter().map(Into::into).collect(),
            code,
            says: says.iter().map(|&part| part.to_owned()).collect(),
            path: None,
        }
    }

    /// The same with another `PATH`.
    pub fn with_path(mut self, path: &Path) -> Self {
        self.path = Some(path.to_owned());
        self
    }

    /// What is wrong with how the run ended.
    fn faults(&self, run: &Run) -> Vec<String> {
        let mut faults = Vec::new();
        if run.code != Some(self.code) {
            faults.push(format!("exit code {:?}, not {}", run.code, self.code));
        }
        if !run.stdout.is_empty() {
            faults.push(format!("standard output: {}", run.stdout));
        }
        let missing = self.says.iter().filter(|part| !run.stderr.contains(*part));
        faults.extend(missing.map(|part| format!("does not say '{part}'")));
        faults.extend(unfit(&run.stderr));
        faults
    }
}

/// What no message may look like.
pub fn unfit(stderr: &str) -> Vec<String> {
    let mut faults = Vec::new();
    for word in ["panicked", "BACKTRACE", "backtrace", ".rs:", "Err(", "Error {"] {
        if stderr.contains(word) {
            faults.push(format!("the message holds '{word}'"));
        }
    }
    if !(stderr.starts_with("realnet: ") || stderr.starts_with("error: ")) {
        faults.push("the message starts with neither 'realnet: ' nor 'error: '".to_owned());
    }
    // The parsers of the command line and of YAML show the place; all else is one line.
    let lines = stderr.lines().count();
    if stderr.starts_with("realnet: ") && lines != 1 && !stderr.contains("\n --> ") {
        faults.push(format!("{lines} lines"));
    }
    if stderr.len() > 2000 {
        faults.push(format!("a message of {} bytes", stderr.len()));
    }
    faults
}

/// Runs all cases and reports every one that fails.
pub fn run(cases: Vec<Case>) {
    assert!(!cases.is_empty());
    let count = cases.len();
    let mut report = String::new();
    for case in cases {
        let mut command = command();
        command.args(&case.args);
        if let Some(path) = &case.path {
            command.env("PATH", path);
        }
        let run = finish(&mut command);
        println!("{}: {}", case.what, run.stderr.trim_end());
        let faults = case.faults(&run);
        if !faults.is_empty() {
            let (what, args) = (&case.what, &case.args);
            report += &format!("{what}\n  {args:?}\n  said: {}\n", run.stderr.trim_end());
            faults.iter().for_each(|fault| report += &format!("  - {fault}\n"));
        }
    }
    assert!(report.is_empty(), "of {count} cases these failed:\n{report}");
}

/// A folder with a working model and a working picture.
pub struct Bench {
    folder: TempDir,
}

impl Bench {
    pub fn new() -> Self {
        let bench = Self { folder: tempfile::tempdir().unwrap() };
        bench.write("good.onnx", tiny::bytes());
        tiny::picture(&bench.path("good.png"), 64, 64, 200);
        bench
    }

    /// The path of a file in the folder, there or not.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// As [`Bench::path`], as text.
    pub fn text(&self, name: &str) -> String {
        self.path(name).into_os_string().into_string().unwrap()
    }

    /// Writes a file, with its folders, and gives its path as text.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> String {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        self.text(name)
    }

    /// `realnet detect` on the embedded engine.
    pub fn detect(&self, model: &str, source: &str, more: &[&str]) -> Vec<String> {
        let base = ["detect", "--engine", "rten", "--json", "--model", model, "--source", source];
        [&base[..], more].concat().into_iter().map(str::to_owned).collect()
    }

    /// `realnet val detect` on the embedded engine.
    pub fn val(&self, data: &str, more: &[&str]) -> Vec<String> {
        let model = self.text("good.onnx");
        let base =
            ["val", "detect", "--engine", "rten", "--json", "--model", &model, "--data", data];
        [&base[..], more].concat().into_iter().map(str::to_owned).collect()
    }
}
