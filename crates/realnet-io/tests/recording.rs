//! Recordings as files and streams: exact values, order, memory, broken files.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod run;

use mcap::records::MessageHeader;
use proptest::prelude::*;
use realnet_core::{DriveCommand, Frame, Stamp};
use realnet_io::picture::{self, Encoding};
use realnet_io::recording::{
    CHUNK_BYTES, CHUNK_SECONDS, Content, ReadError, RecordError, Recorded, RunInfo, RunReader,
    RunWriter, StateSchema, Times, contents,
};
use run::{Step, frames, info, read_all, write_run};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::{self, Cursor, Write};
use std::rc::Rc;

/// All messages before the first error that ends the recording, and that error.
fn read_until_broken(bytes: &[u8]) -> (Vec<Recorded>, Option<ReadError>) {
    let mut messages = Vec::new();
    for recorded in RunReader::new(bytes, "test").unwrap() {
        match recorded {
            Ok(recorded) => messages.push(recorded),
            Err(ReadError::Message { .. }) => {}
            Err(error) => return (messages, Some(error)),
        }
    }
    (messages, None)
}

#[test]
fn everything_comes_back_as_it_was_given() {
    let (bytes, given) = write_run(5);
    let run = RunReader::new(bytes.as_slice(), "test").unwrap();
    assert_eq!(run.info(), &info());
    assert_eq!(read_all(&bytes), given);
}

#[test]
fn a_frame_comes_back_exactly_as_png_and_nearly_as_jpeg() {
    let frame = frames(Stamp::from_nanos(40), 0);
    for (encoding, tolerance) in [(Encoding::Png, 0), (Encoding::Jpeg { quality: 95 }, 12)] {
        let mut run = RunWriter::new(Vec::new(), "test", &RunInfo::default(), run::STATE).unwrap();
        run.frame(Stamp::from_nanos(50), &frame, encoding).unwrap();
        let bytes = run.finish().unwrap();
        let Recorded { times, content } = read_all(&bytes).remove(0);
        let Content::Image(picture) = content else { panic!("{content:?}") };
        assert_eq!(times, Times { arrival: Stamp::from_nanos(50), stamp: frame.stamp() });
        let read: Frame =
            picture::decode(&picture, &picture::Limits::default(), Vec::new()).unwrap();
        let far = read.data().iter().zip(frame.data()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(far.unwrap() <= tolerance, "{encoding:?} {far:?}");
    }
}

#[test]
fn the_crate_that_writes_reads_the_same_messages() {
    let (bytes, _) = write_run(40);
    let theirs: Vec<_> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap)
        .filter(|message| !message.channel.topic.ends_with("annotations"))
        .map(|message| (message.log_time, message.publish_time))
        .collect();
    let ours: Vec<_> = read_all(&bytes)
        .iter()
        .map(|m| (m.times.arrival.nanos() as u64, m.times.stamp.nanos() as u64))
        .collect();
    assert_eq!(ours, theirs);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count as usize, ours.len() + 40);
    assert!(summary.chunk_indexes.len() > 1);
}

#[test]
fn contents_name_the_topics_of_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let (bytes, given) = write_run(4);
    std::fs::write(&path, &bytes).unwrap();
    let found = contents(&path).unwrap();
    assert!(found.broken.is_none(), "{:?}", found.broken);
    assert_eq!(found.info, info());
    let counts: Vec<_> = found.topics.iter().map(|t| (t.topic.as_str(), t.messages)).collect();
    let expected = [
        ("/camera/image", 4),
        ("/camera/calibration", 1),
        ("/detections", 4),
        ("/detections/annotations", 4),
        ("/depth", 4),
        ("/target", 4),
        ("/command", 4),
    ];
    assert_eq!(counts, expected);
    assert_eq!(found.topics[4].schema, "foxglove.RawImage");
    assert_eq!(found.topics[5].encoding, "json");
    let arrivals = given.iter().map(|m| m.times.arrival);
    assert_eq!(found.arrivals, arrivals.clone().min().zip(arrivals.max()));

    std::fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let found = contents(&path).unwrap();
    assert!(matches!(found.broken, Some(ReadError::BreaksOff { .. })), "{:?}", found.broken);
    assert!(found.topics[0].messages > 0);
}

#[test]
fn an_existing_file_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    std::fs::write(&path, "precious").unwrap();
    let error = RunWriter::create(&path, &info(), run::STATE).err().unwrap();
    assert!(error.to_string().contains("run.mcap"), "{error}");
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "precious");
    let error = RunReader::open(&path).err().unwrap();
    assert!(matches!(error, ReadError::NotMcap { .. }), "{error}");
    let error = RunReader::open(&folder.path().join("none.mcap")).err().unwrap();
    assert!(matches!(error, ReadError::Open { .. }), "{error}");
}

#[test]
fn what_cannot_be_recorded_is_refused_and_the_rest_goes_on() {
    let mut run = RunWriter::new(Vec::new(), "test", &info(), run::STATE).unwrap();
    let good = Times { arrival: Stamp::from_nanos(2), stamp: Stamp::from_nanos(1) };
    for stamp in [Stamp::from_nanos(-1), Stamp::from_nanos(4_294_967_296_000_000_000)] {
        for times in [Times { arrival: stamp, ..good }, Times { stamp, ..good }] {
            let error = run.state(times, &0).unwrap_err();
            assert!(matches!(error, RecordError::Time { topic: "/target", .. }), "{error}");
        }
    }
    let error = run.image(good, b"GIF89a").unwrap_err();
    assert!(error.to_string().contains("neither JPEG nor PNG"), "{error}");
    let error = run.state(good, &BTreeMap::from([([1, 2], 3)])).unwrap_err();
    assert!(matches!(error, RecordError::Json { .. }), "{error}");
    let command = DriveCommand { stamp: good.stamp, speed: 1.0, ..DriveCommand::default() };
    run.command(good.arrival, &command).unwrap();
    let messages = read_all(&run.finish().unwrap());
    assert_eq!(messages, [Recorded { times: good, content: Content::Command(command) }]);

    for json in ["", "[]", r#"{"type": "number"}"#] {
        let state = StateSchema { name: "wrong", json };
        let error = RunWriter::new(Vec::new(), "test", &info(), state).err().unwrap();
        assert!(matches!(error, RecordError::Schema { .. }), "{error}");
    }
}

#[test]
fn topics_of_other_programs_are_passed_over_and_bad_messages_named() {
    let mut file = Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new().create(&mut file).unwrap();
    let schema = writer.add_schema("any.State", "jsonschema", br#"{"type":"object"}"#).unwrap();
    let ros = writer.add_schema("sensor_msgs/msg/Image", "ros2msg", b"").unwrap();
    let nothing = BTreeMap::new();
    let channels = [
        writer.add_channel(0, "/tf", "cdr", &nothing).unwrap(),
        writer.add_channel(ros, "/camera/image", "cdr", &nothing).unwrap(),
        writer.add_channel(schema, "/target", "json", &nothing).unwrap(),
        writer.add_channel(schema, "/target", "json", &[("a".into(), "b".into())].into()).unwrap(),
    ];
    let texts: [&[u8]; 4] = [b"\x00", b"\x01", b"{broken", br#"{"range_m":1.5}"#];
    for (channel_id, text) in channels.into_iter().zip(texts) {
        let header = MessageHeader { channel_id, sequence: 0, log_time: 5, publish_time: 3 };
        writer.write_to_known_channel(&header, text).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    let bytes = file.into_inner();

    let mut run = RunReader::new(bytes.as_slice(), "other").unwrap();
    assert_eq!(run.info(), &RunInfo::default());
    let error = run.next().unwrap().unwrap_err();
    assert!(matches!(error, ReadError::Message { topic: "/target", .. }), "{error}");
    let recorded = run.next().unwrap().unwrap();
    assert_eq!(recorded.content, Content::State(serde_json::json!({"range_m": 1.5})));
    assert!(run.next().is_none());
}

/// What is handed to the operating system: its bytes, and how many at each write.
#[derive(Clone, Default)]
struct Disk(Rc<RefCell<DiskState>>);

#[derive(Default)]
struct DiskState {
    bytes: Vec<u8>,
    largest_write: usize,
    flushes: usize,
    room: Option<usize>,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut disk = self.0.borrow_mut();
        let room = disk.room.map_or(usize::MAX, |room| room - disk.bytes.len());
        if room == 0 {
            return Err(io::Error::from(io::ErrorKind::StorageFull));
        }
        let count = bytes.len().min(room);
        disk.bytes.extend_from_slice(&bytes[..count]);
        disk.largest_write = disk.largest_write.max(count);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.borrow_mut().flushes += 1;
        Ok(())
    }
}

/// Ten minutes at 30 frames a second: after each frame all but the last second
/// is with the operating system, and memory held a second at most.
#[test]
fn never_more_than_a_second_is_held_back() {
    let disk = Disk::default();
    let mut run = RunWriter::new(disk.clone(), "test", &info(), run::STATE).unwrap();
    let picture = Step::new(0).picture;
    for index in 0..18_000 {
        let step = Step { picture: picture.clone(), ..Step::new(index) };
        run.image(step.times, &step.picture).unwrap();
        run.state(step.times, &step.state).unwrap();
        // Reading all of it each time would take hours.
        if index % 3_001 == 3_000 {
            let (read, _) = read_until_broken(&disk.0.borrow().bytes);
            let last = read.last().unwrap().times.arrival;
            assert!(step.times.arrival.seconds_since(last) < CHUNK_SECONDS, "{index}");
        }
    }
    // The schemas stand before the first second.
    let second = 31 * (picture.len() + 200) + (32 << 10);
    let disk = disk.0.borrow();
    assert!(disk.largest_write < second, "{} {second}", disk.largest_write);
    assert!((600..610).contains(&disk.flushes), "{}", disk.flushes);
}

#[test]
fn large_messages_do_not_wait_for_the_second() {
    let disk = Disk::default();
    let mut run = RunWriter::new(disk.clone(), "test", &info(), run::STATE).unwrap();
    let mut picture = Step::new(0).picture;
    picture.resize(1 << 20, 0);
    for index in 0..64 {
        run.image(Step::new(index).times, &picture).unwrap();
        assert!(disk.0.borrow().largest_write < CHUNK_BYTES + picture.len());
    }
    assert!(disk.0.borrow().bytes.len() >= 60 << 20);
}

#[test]
fn a_clock_that_is_set_back_holds_nothing_back() {
    let disk = Disk::default();
    let mut run = RunWriter::new(disk.clone(), "test", &info(), run::STATE).unwrap();
    for index in [10_000, 10_001, 0, 1] {
        let step = Step::new(index);
        run.state(step.times, &step.state).unwrap();
    }
    let (read, _) = read_until_broken(&disk.0.borrow().bytes);
    assert_eq!(read.len(), 3);
}

#[test]
fn a_full_disk_is_said_and_what_was_written_is_readable() {
    let (whole, given) = write_run(90);
    for room in [whole.len() / 2, whole.len() * 3 / 4, whole.len() * 9 / 10] {
        let disk = Disk::default();
        disk.0.borrow_mut().room = Some(room);
        let mut run = RunWriter::new(disk.clone(), "/robot/run.mcap", &info(), run::STATE).unwrap();
        let failed = (0..200).find_map(|index| Step::new(index).write(&mut run).err()).unwrap();
        let text = failed.to_string();
        assert!(text.starts_with("cannot write the recording /robot/run.mcap: "), "{text}");
        let RecordError::Write { kept: Some(kept), .. } = failed else { panic!("{failed:?}") };
        assert!(text.ends_with(&format!("what arrived until {kept} stays readable")), "{text}");

        let again = Step::new(200).write(&mut run).unwrap_err();
        assert!(matches!(again, RecordError::Ended { .. }), "{again}");
        disk.0.borrow_mut().room = None;
        assert!(matches!(run.finish(), Err(RecordError::Ended { .. })));

        let (read, error) = read_until_broken(&disk.0.borrow().bytes);
        assert!(error.is_some());
        assert_eq!(read, given[..read.len()]);
        assert!(read.last().unwrap().times.arrival >= kept, "{room}");
    }
    let disk = Disk::default();
    disk.0.borrow_mut().room = Some(20);
    let error = RunWriter::new(disk, "full", &info(), run::STATE).err().unwrap();
    assert!(error.to_string().ends_with("no message is in it"), "{error}");
}

#[test]
fn a_file_cut_anywhere_gives_what_stands_before() {
    let (bytes, given) = write_run(2);
    let mut most = 0;
    for length in 0..bytes.len() {
        let cut = &bytes[..length];
        if length < mcap::MAGIC.len() {
            let error = RunReader::new(cut, "test").err().unwrap();
            assert!(matches!(error, ReadError::NotMcap { .. }), "{error}");
            continue;
        }
        let (read, error) = read_until_broken(cut);
        match error {
            Some(ReadError::BreaksOff { at, .. }) => assert_eq!(at, length as u64),
            other => panic!("{length}: {other:?}"),
        }
        assert_eq!(read, given[..read.len()], "{length}");
        assert!(read.len() >= most, "{length}");
        most = read.len();
    }
    assert_eq!(most, given.len());
}

#[test]
fn a_compressed_file_says_what_to_do() {
    let (mut bytes, _) = write_run(1);
    // The chunk's fields: two times, size, checksum, length of the compression's name.
    let chunk = chunk_start(&bytes);
    bytes[chunk + 9 + 28] = 3;
    let error = read_until_broken(&bytes).1.unwrap();
    assert!(matches!(error, ReadError::Compressed { at, .. } if at == chunk as u64), "{error}");
    assert!(error.to_string().contains("mcap decompress"), "{error}");
}

#[test]
fn a_changed_bit_is_found_by_the_checksum() {
    let (mut bytes, _) = write_run(1);
    let chunk = chunk_start(&bytes);
    let at = bytes.windows(6).position(|w| w == b"rc_car").unwrap();
    bytes[at] ^= 1;
    let error = read_until_broken(&bytes).1.unwrap();
    assert!(error.to_string().contains("checksum"), "{error}");
    assert!(matches!(error, ReadError::Damaged { at, .. } if at == chunk as u64), "{error}");
}

/// Where the first chunk starts.
fn chunk_start(bytes: &[u8]) -> usize {
    let mut at = mcap::MAGIC.len();
    while bytes[at] != mcap::records::op::CHUNK {
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    at
}

proptest! {
    #[test]
    fn no_damage_makes_the_reader_panic(
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)
    ) {
        thread_local!(static RUN: Vec<u8> = write_run(2).0);
        let mut bytes = RUN.with(Clone::clone);
        for (at, value) in damage {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(run) = RunReader::new(bytes.as_slice(), "damaged") {
            prop_assert!(run.count() < 100);
        }
    }
}
