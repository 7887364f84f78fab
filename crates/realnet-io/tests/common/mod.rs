//! What the integration tests share.
#![allow(dead_code, clippy::unwrap_used, clippy::print_stdout)]

use std::path::PathBuf;
use std::process::Command;

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

/// True when ffmpeg can be run; else after a message that the test is skipped.
pub fn has_ffmpeg() -> bool {
    let found = Command::new("ffmpeg").arg("-version").output().is_ok();
    if !found {
        println!("skipped: ffmpeg is not installed");
    }
    found
}

/// Runs ffmpeg with these arguments to make a test file.
pub fn ffmpeg(args: &[&str]) {
    let output =
        Command::new("ffmpeg").args(["-v", "error", "-nostdin", "-y"]).args(args).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
