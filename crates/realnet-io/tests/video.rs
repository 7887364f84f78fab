//! Video in and out, through an installed ffmpeg.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod common;

use common::{ffmpeg, has_ffmpeg, shared};
use realnet_core::{Frame, Stamp};
use realnet_io::source::{Source, SourceError, SourceKind, SourceOptions, open};
use realnet_io::video::VideoWriter;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::time::Duration;

const SAMPLE: &str = "data/samples/carnd_highway.mp4";

fn start(path: &Path) -> Source {
    open(&path.display().to_string(), &SourceOptions::default()).unwrap()
}

fn stamps(source: Source) -> Vec<i64> {
    source.map(|item| item.unwrap().frame.stamp().nanos()).collect()
}

/// A video of a moving test pattern made by ffmpeg.
fn made(dir: &Path, name: &str, args: &[&str]) -> PathBuf {
    let path = dir.join(name);
    let text = path.display().to_string();
    let mut all = vec!["-f", "lavfi", "-i", "testsrc2=size=96x64:rate=10:duration=2"];
    all.extend(args);
    all.push(&text);
    ffmpeg(&all);
    path
}

#[test]
fn the_sample_has_38_frames_at_25_a_second() {
    let Some(path) = shared(SAMPLE).filter(|_| has_ffmpeg()) else { return };
    let source = start(&path);
    assert_eq!((source.kind(), source.is_live()), (SourceKind::Video, false));
    assert_eq!((source.len_hint(), source.fps()), (Some(38), Some(25.0)));
    let mut count = 0u64;
    for (wanted, item) in (0..).zip(source) {
        let item = item.unwrap();
        assert_eq!(item.index, wanted);
        assert_eq!(item.frame.stamp().nanos(), wanted as i64 * 40_000_000);
        assert_eq!((item.frame.width(), item.frame.height()), (1280, 720));
        let mean = item.frame.data().iter().map(|v| u64::from(*v)).sum::<u64>()
            / item.frame.data().len() as u64;
        assert!((30..220).contains(&mean), "frame {wanted} has mean {mean}");
        count += 1;
    }
    assert_eq!(count, 38);
}

#[test]
fn uneven_stamps_come_through_and_nothing_is_doubled_or_dropped() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    // Frame n is shown at n² tenths of a second: gaps that a constant rate would
    // fill with copies.
    let path = made(
        dir.path(),
        "uneven.mkv",
        &["-vf", "setpts=N*N/10/TB", "-fps_mode", "passthrough", "-frames:v", "8", "-c:v", "ffv1"],
    );
    let wanted: Vec<i64> = (0..8).map(|n| n * n * 100_000_000).collect();
    assert_eq!(stamps(start(&path)), wanted);
}

#[test]
fn a_late_start_begins_at_zero() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let path =
        made(dir.path(), "late.mkv", &["-vf", "setpts=PTS+7/TB", "-frames:v", "3", "-c:v", "ffv1"]);
    assert_eq!(stamps(start(&path)), [0, 100_000_000, 200_000_000]);
}

#[test]
fn rotation_is_applied() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let flat = made(dir.path(), "flat.mp4", &["-frames:v", "2", "-c:v", "mpeg4"]);
    let turned = dir.path().join("turned.mp4").display().to_string();
    let flat = flat.display().to_string();
    ffmpeg(&["-i", &flat, "-c", "copy", "-metadata:s:v:0", "rotate=90", &turned]);
    let first = start(Path::new(&turned)).next().unwrap().unwrap();
    if (first.frame.width(), first.frame.height()) == (96, 64) {
        println!("skipped: this ffmpeg writes no rotation by the `rotate` tag");
        return;
    }
    assert_eq!((first.frame.width(), first.frame.height()), (64, 96));
}

#[test]
fn truncated_videos_give_their_frames_and_then_an_error() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let whole =
        made(dir.path(), "whole.mp4", &["-c:v", "mpeg4", "-g", "1", "-movflags", "+faststart"]);
    let bytes = std::fs::read(&whole).unwrap();
    let path = dir.path().join("cut.mp4");
    std::fs::write(&path, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let items: Vec<_> = start(&path).collect();
    let (last, frames) = items.split_last().unwrap();
    assert!(frames.len() > 5 && frames.len() < 20 && frames.iter().all(Result::is_ok));
    let error = last.as_ref().unwrap_err();
    assert!(matches!(error, SourceError::Damaged { frames: n, .. } if *n == frames.len() as u64));
    assert!(error.to_string().contains("cut.mp4"), "{error}");
    // The index at the end of the file is gone: there is nothing to decode.
    let whole = made(dir.path(), "tail.mp4", &["-c:v", "mpeg4"]);
    let bytes = std::fs::read(&whole).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let error = open(&path.display().to_string(), &SourceOptions::default()).err().unwrap();
    assert!(error.to_string().contains("cut.mp4: "), "{error}");
}

#[test]
fn files_without_video_are_named() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let sound = dir.path().join("sound.wav").display().to_string();
    ffmpeg(&["-f", "lavfi", "-i", "sine=duration=0.1", &sound]);
    let error = open(&sound, &SourceOptions::default()).err().unwrap().to_string();
    assert!(error.contains("sound.wav: no video stream"), "{error}");
    // Without ffprobe the same is found out at the first frame.
    let options = SourceOptions { ffprobe: "no-ffprobe".into(), ..SourceOptions::default() };
    let items: Vec<_> = open(&sound, &options).unwrap().collect();
    assert!(matches!(items[..], [Err(SourceError::NoVideo { .. })]), "{items:?}");
    let text = dir.path().join("notes.mp4");
    std::fs::write(&text, "this is no video at all, not even a little").unwrap();
    let text = text.display().to_string();
    for options in [SourceOptions::default(), options] {
        let error = match open(&text, &options) {
            Err(error) => error,
            Ok(mut source) => source.next().unwrap().unwrap_err(),
        };
        assert!(error.to_string().contains("notes.mp4"), "{error}");
    }
}

#[test]
fn without_ffmpeg_the_package_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mp4");
    std::fs::write(&path, "x").unwrap();
    let options = SourceOptions {
        ffmpeg: "no-such-ffmpeg".into(),
        ffprobe: "no-such-ffprobe".into(),
        ..SourceOptions::default()
    };
    for spec in [path.display().to_string(), "rtsp://127.0.0.1:9/x".into()] {
        let error = open(&spec, &options).err().unwrap().to_string();
        assert!(error.contains("`no-such-ffmpeg`"), "{error}");
        assert!(error.contains("apt install ffmpeg"), "{error}");
    }
    let out = dir.path().join("out.mp4");
    let error = VideoWriter::create_with(Path::new("no-such-ffmpeg"), &out, 8, 8, 25.0);
    assert!(error.unwrap_err().to_string().contains("apt install ffmpeg"));
    assert!(!out.exists());
}

#[test]
fn a_stream_that_nobody_sends_is_an_error() {
    if !has_ffmpeg() {
        return;
    }
    // Port 9 of the own machine: refused at once.
    let mut source = open("http://127.0.0.1:9/live", &SourceOptions::default()).unwrap();
    assert_eq!((source.kind(), source.is_live()), (SourceKind::Stream, true));
    let error = source.next().unwrap().unwrap_err().to_string();
    assert!(error.contains("http://127.0.0.1:9/live: "), "{error}");
    assert!(source.next().is_none());
}

/// The address of a server that gives `body` to one visitor, as a live HTTP
/// stream.
fn serve(body: Vec<u8>) -> String {
    let server = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/live", server.local_addr().unwrap());
    std::thread::spawn(move || {
        let (mut visitor, _) = server.accept().unwrap();
        let mut request = [0; 4096];
        let _ = visitor.read(&mut request).unwrap();
        let length = body.len();
        write!(visitor, "HTTP/1.0 200 OK\r\nContent-Length: {length}\r\n\r\n").unwrap();
        visitor.write_all(&body).unwrap();
    });
    address
}

#[test]
fn a_stream_is_live_unless_asked_otherwise() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let file = made(dir.path(), "a.ts", &["-c:v", "mpeg2video", "-g", "1", "-r", "25"]);
    let body = std::fs::read(&file).unwrap();
    let wanted = stamps(start(&file));
    assert_eq!(wanted.len(), 20);
    let options = SourceOptions { live: Some(false), ..SourceOptions::default() };
    let source = open(&serve(body.clone()), &options).unwrap();
    assert_eq!(stamps(source), wanted);
    // As live, every frame is either taken or counted as dropped.
    let mut source = open(&serve(body), &SourceOptions::default()).unwrap();
    let taken: Vec<_> = source.by_ref().map(Result::unwrap).collect();
    assert!(!taken.is_empty());
    assert_eq!(taken.len() as u64 + source.dropped(), 20);
    assert!(taken.windows(2).all(|w| w[0].frame.stamp() < w[1].frame.stamp()));
}

#[test]
fn a_silent_stream_is_an_error_and_its_child_ends() {
    if !has_ffmpeg() {
        return;
    }
    // Takes connections into its backlog and never answers.
    let server = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/live", server.local_addr().unwrap());
    let patience = Some(Duration::from_millis(200));
    let options = SourceOptions { patience, ..SourceOptions::default() };
    let mut source = open(&address, &options).unwrap();
    let error = source.next().unwrap().unwrap_err();
    assert!(matches!(error, SourceError::Stalled { .. }), "{error}");
    assert!(source.next().is_none());
    let stopper = source.stopper();
    drop(source);
    stopper.stop();
}

#[test]
fn another_thread_can_end_a_waiting_source() {
    if !has_ffmpeg() {
        return;
    }
    let server = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/live", server.local_addr().unwrap());
    let options = SourceOptions { patience: None, ..SourceOptions::default() };
    let mut source = open(&address, &options).unwrap();
    let stopper = source.stopper();
    let thread = std::thread::spawn(move || {
        // Once the visitor is there, the source is waiting for data.
        let visitor = server.accept().unwrap();
        stopper.stop();
        visitor
    });
    assert!(source.next().is_none());
    drop(thread.join().unwrap());
}

#[cfg(unix)]
#[test]
fn an_ffmpeg_before_5_1_is_asked_in_its_own_words() {
    use std::os::unix::fs::PermissionsExt;
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let video = made(dir.path(), "a.mkv", &["-frames:v", "4", "-c:v", "ffv1"]);
    let old = dir.path().join("old-ffmpeg");
    let script = "#!/bin/sh\ncase \"$*\" in *-fps_mode*)\n\
                  echo \"[error] Unrecognized option 'fps_mode'.\" >&2; exit 1;; esac\n\
                  exec ffmpeg \"$@\"\n";
    std::fs::write(&old, script).unwrap();
    std::fs::set_permissions(&old, std::fs::Permissions::from_mode(0o755)).unwrap();
    let options = SourceOptions { ffmpeg: old, ..SourceOptions::default() };
    let source = open(&video.display().to_string(), &options).unwrap();
    assert_eq!(stamps(source), [0, 100_000_000, 200_000_000, 300_000_000]);
}

#[test]
fn a_file_played_as_live_has_rising_clock_stamps() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let video = made(dir.path(), "a.mkv", &["-frames:v", "4", "-c:v", "ffv1"]);
    let options = SourceOptions { live: Some(true), ..SourceOptions::default() };
    let mut source = open(&video.display().to_string(), &options).unwrap();
    assert!(source.is_live());
    let mut seen = Vec::new();
    for item in source.by_ref() {
        let item = item.unwrap();
        seen.push((item.index, item.frame.stamp()));
    }
    assert!(seen.windows(2).all(|w| w[0].0 < w[1].0 && w[0].1 < w[1].1), "{seen:?}");
    assert!(seen[0].1.secs_f64() > 1.6e9);
    assert_eq!(seen.len() as u64 + source.dropped(), 4);
}

#[test]
fn dropping_a_source_midway_ends_its_child() {
    let Some(path) = shared(SAMPLE).filter(|_| has_ffmpeg()) else { return };
    let mut source = start(&path);
    assert!(source.next().unwrap().is_ok());
    // Returns only when the thread has ended and the child is reaped.
    drop(source);
}

fn plain(width: u32, height: u32, value: u8) -> Frame {
    let data = vec![value; (width * height * 3) as usize];
    Frame::rgb8(Stamp::ZERO, width, height, data).unwrap()
}

#[test]
fn what_is_written_reads_back_with_odd_sides_padded() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("out.mp4");
    let mut writer = VideoWriter::create(&path, 63, 41, 12.5).unwrap();
    for value in [0, 60, 120, 180, 240] {
        writer.write(&plain(63, 41, value)).unwrap();
    }
    let error = writer.write(&plain(64, 41, 0)).unwrap_err().to_string();
    assert!(error.contains("out.mp4") && error.contains("64x41"), "{error}");
    assert!(!path.exists(), "half a video has the name of a whole one");
    writer.finish().unwrap();
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    let source = start(&path);
    assert_eq!((source.len_hint(), source.fps()), (Some(5), Some(12.5)));
    for (item, value) in source.zip([0u8, 60, 120, 180, 240]) {
        let frame = item.unwrap().frame;
        assert_eq!((frame.width(), frame.height()), (64, 42));
        let middle = frame.data()[(20 * 64 + 30) * 3];
        assert!(middle.abs_diff(value) < 8, "{middle} for {value}");
    }
}

#[test]
fn a_writer_that_is_dropped_leaves_a_whole_file() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("out.mp4");
    let mut writer = VideoWriter::create(&path, 32, 32, 25.0).unwrap();
    writer.write(&plain(32, 32, 9)).unwrap();
    drop(writer);
    assert_eq!(stamps(start(&path)).len(), 1);
}

#[test]
fn videos_that_cannot_be_written_are_named() {
    if !has_ffmpeg() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let error = VideoWriter::create(&dir.path().join("no/out.mp4"), 8, 8, 25.0).unwrap_err();
    assert!(error.to_string().contains("no/out.mp4"), "{error}");
    assert!(VideoWriter::create(&dir.path().join("a.mp4"), 8, 8, 0.0).is_err());
    let empty = dir.path().join("empty.mp4");
    let error = VideoWriter::create(&empty, 8, 8, 25.0).unwrap().finish().unwrap_err().to_string();
    assert!(error.contains("empty.mp4"), "{error}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "rubbish was left");
}
