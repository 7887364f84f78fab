//! An installed ffmpeg as a child process.
//!
//! The child lives in a process group of its own, so that Ctrl-C in the
//! terminal reaches only this program, which then ends its children in order.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use thiserror::Error;

/// Why ffmpeg did not do its work.
#[derive(Debug, Error)]
pub enum FfmpegError {
    /// The program is not there.
    #[error(
        "`{}` was not found; video and streams need the package ffmpeg \
         (Debian and Ubuntu: apt install ffmpeg)", program.display()
    )]
    Missing {
        /// The program that was looked for.
        program: PathBuf,
    },
    /// The program is there but does not start.
    #[error("cannot start `{}`: {reason}", program.display())]
    Start {
        /// The program.
        program: PathBuf,
        /// What the operating system said.
        reason: io::Error,
    },
    /// The program ended with an error or said that the data are damaged.
    #[error("{subject}: ffmpeg says: {message}")]
    Failed {
        /// The file or address.
        subject: String,
        /// The last words of the program.
        message: String,
    },
}

/// Locks, also after a panic of another holder: the data are plain values.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A command in its own process group, without standard input.
pub(crate) fn command(program: &Path) -> Command {
    let mut command = Command::new(program);
    command.stdin(Stdio::null());
    #[cfg(unix)]
    {
        use std::os::unix::process::CommandExt;
        command.process_group(0);
    }
    #[cfg(windows)]
    {
        use std::os::windows::process::CommandExt;
        const CREATE_NEW_PROCESS_GROUP: u32 = 0x0000_0200;
        command.creation_flags(CREATE_NEW_PROCESS_GROUP);
    }
    command
}

/// The error of a command that did not start.
pub(crate) fn start_error(program: &Path, reason: io::Error) -> FfmpegError {
    let program = program.to_path_buf();
    match reason.kind() {
        io::ErrorKind::NotFound => FfmpegError::Missing { program },
        _ => FfmpegError::Start { program, reason },
    }
}

/// A local path as ffmpeg must hear it: neither an option (`-x.mp4`) nor an
/// address (`a:b.mp4`).
pub(crate) fn file_url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

/// A running child that can be killed from another thread. Killed and reaped on
/// drop.
#[derive(Debug)]
pub(crate) struct Running(Mutex<Child>);

impl Running {
    pub(crate) fn new(child: Child) -> Self {
        Self(Mutex::new(child))
    }

    /// Ends the child at once; nothing happens when it has ended already.
    pub(crate) fn kill(&self) {
        // Failure means that it has ended.
        let _ = lock(&self.0).kill();
    }

    /// Waits for the end; a child that needs longer than `patience` is killed.
    pub(crate) fn wait(&self, patience: Duration) -> io::Result<ExitStatus> {
        let start = Instant::now();
        let mut pause = Duration::from_millis(1);
        loop {
            // The lock is not held while waiting: `kill` must get through.
            if let Some(status) = lock(&self.0).try_wait()? {
                return Ok(status);
            }
            if start.elapsed() > patience {
                self.kill();
                return lock(&self.0).wait();
            }
            std::thread::sleep(pause);
            pause = (pause * 2).min(Duration::from_millis(50));
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let child = self.0.get_mut().unwrap_or_else(PoisonError::into_inner);
        let _ = child.kill();
        let _ = child.wait();
    }
}

/// What a child says on standard error, read by a thread to its end: the last
/// lines are kept, `[error]` and `[fatal]` ones first of all.
#[derive(Debug)]
pub(crate) struct Log {
    lines: Arc<Mutex<Lines>>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Lines {
    errors: VecDeque<String>,
    others: VecDeque<String>,
}

const KEPT: usize = 6;
const LONGEST_LINE: u64 = 8192;

impl Log {
    /// Reads `stderr`; every line also goes to `watch`.
    pub(crate) fn follow(
        stderr: impl Read + Send + 'static,
        mut watch: impl FnMut(&str) + Send + 'static,
    ) -> Self {
        let lines = Arc::new(Mutex::new(Lines::default()));
        let shared = Arc::clone(&lines);
        let thread = std::thread::spawn(move || {
            let mut reader = BufReader::new(stderr);
            let mut raw = Vec::new();
            loop {
                raw.clear();
                match (&mut reader).take(LONGEST_LINE).read_until(b'\n', &mut raw) {
                    Ok(0) | Err(_) => break,
                    Ok(_) => {}
                }
                let text = String::from_utf8_lossy(&raw);
                let line = text.trim_end();
                watch(line);
                let mut kept = lock(&shared);
                let serious = line.contains("[error]") || line.contains("[fatal]");
                let list = if serious { &mut kept.errors } else { &mut kept.others };
                let line = plain(line);
                if !line.is_empty() && list.back() != Some(&line) {
                    if list.len() == KEPT {
                        list.pop_front();
                    }
                    list.push_back(line);
                }
            }
        });
        Self { lines, thread: Some(thread) }
    }

    /// Waits until the child has closed its standard error.
    pub(crate) fn finish(&mut self) {
        if let Some(thread) = self.thread.take() {
            // The reading thread holds no data of ours that a panic could spoil.
            let _ = thread.join();
        }
    }

    /// The last errors in one line, or `None` when there was none.
    pub(crate) fn errors(&self) -> Option<String> {
        let kept = lock(&self.lines);
        (!kept.errors.is_empty())
            .then(|| kept.errors.iter().map(String::as_str).collect::<Vec<_>>().join("; "))
    }

    /// The last errors, or failing them the last words of any kind.
    pub(crate) fn last_words(&self) -> String {
        self.errors().unwrap_or_else(|| {
            lock(&self.lines).others.back().cloned().unwrap_or_else(|| "no message".into())
        })
    }
}

/// A log line without `[h264 @ 0x55…] [error]` in front.
fn plain(line: &str) -> String {
    let mut rest = line.trim();
    while let Some(inner) = rest.strip_prefix('[')
        && let Some((_, after)) = inner.split_once(']')
    {
        rest = after.trim_start();
    }
    rest.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_log_keeps_errors_without_addresses() {
        let text = "[info] hello\n[mov,mp4 @ 0x55] [error] moov atom not found\n\
                    [mov,mp4 @ 0x55] [error] moov atom not found\n[fatal] bad\n[info] bye\n";
        let mut log = Log::follow(text.as_bytes(), |_| {});
        log.finish();
        assert_eq!(log.errors().unwrap(), "moov atom not found; bad");
        let mut quiet = Log::follow("[info] a\n[warning] b\n".as_bytes(), |_| {});
        quiet.finish();
        assert_eq!(quiet.errors(), None);
        assert_eq!(quiet.last_words(), "b");
    }

    #[test]
    fn a_missing_program_names_the_package() {
        let program = Path::new("no-such-ffmpeg");
        let reason = command(program).spawn().unwrap_err();
        let text = start_error(program, reason).to_string();
        assert!(text.contains("no-such-ffmpeg") && text.contains("apt install ffmpeg"), "{text}");
    }

    #[cfg(unix)]
    #[test]
    fn a_child_that_does_not_end_is_killed() {
        let running = Running::new(command(Path::new("sleep")).arg("1000").spawn().unwrap());
        assert!(!running.wait(Duration::from_millis(5)).unwrap().success());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_child_leads_its_own_process_group() {
        let child = command(Path::new("sleep")).arg("1000").spawn().unwrap();
        let pid = child.id().to_string();
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
        drop(Running::new(child));
        // After the name in brackets: state, parent, process group.
        let (_, rest) = stat.rsplit_once(") ").unwrap();
        assert_eq!(rest.split(' ').nth(2), Some(pid.as_str()), "{stat}");
        assert!(!Path::new(&format!("/proc/{pid}")).exists(), "the child was not reaped");
    }
}
