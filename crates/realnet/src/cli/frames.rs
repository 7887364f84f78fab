//! `realnet frames`.

mod record;
mod review;
mod set;

use super::{
    failure::{OrBadInput, Outcome, bad_input, report, say},
    interrupt,
    model_args::{parse_box, parse_positive, parse_size},
    output::Output,
    progress,
    track::{
        number_of,
        target::{Finder, State, Status, Target},
    },
};
use anyhow::{Error, Result};
use clap::{Args, ValueEnum};
use realnet::{
    BoundingBox,
    datasets::TargetBoxes,
    source::{self, Source, SourceFrame, SourceKind, SourceOptions},
};
use realnet_vision::{FlowOptions, FlowTracker};
use record::{Entry, Kind, Recipe, Record};
use serde::Serialize;
use set::FrameSet;
use std::path::{Path, PathBuf};

/// A box of which less is left in the picture is lost.
const MIN_VISIBLE: f32 = 0.2;
/// Shortest side of a label, pixels.
const MIN_SIDE: f32 = 2.0;
/// The record is written this often, in frames of the set.
const SAVE_EVERY: usize = 200;

#[derive(Debug, Args)]
pub(crate) struct FramesArgs {
    /// A video, a folder or glob of pictures, a stream (rtsp://…) or a camera (/dev/video0).
    #[arg(long, value_name = "WHAT")]
    source: String,
    /// The data set's folder; further recordings can be added to it.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Write every N-th frame; a box is carried through all of them.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
    /// The target's box in the first frame, carried on by flow.
    #[arg(long = "box", value_name = "X0,Y0,X1,Y1", value_parser = parse_box, allow_hyphen_values = true, conflicts_with = "boxes")]
    bbox: Option<BoundingBox>,
    /// The target's box in some frames: a CSV file (frame,x0,y0,x1,y1) or a folder of YOLO labels.
    #[arg(long, value_name = "FILE|DIR")]
    boxes: Option<PathBuf>,
    /// The target's class.
    #[arg(long, value_name = "NAME", default_value = "target", value_parser = parse_class)]
    class: String,
    /// The part of the set; a recording for val should not be one of train.
    #[arg(long, value_enum, default_value_t = SplitFlag::Train)]
    split: SplitFlag,
    /// First part of the frames' names [default: the source's name].
    #[arg(long, value_name = "NAME", value_parser = parse_name)]
    name: Option<String>,
    /// Stop after so many frames of the source.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    limit: Option<u64>,
    /// One JSON object on standard output, and nothing else there.
    #[arg(long)]
    json: bool,
    /// Frames a second: stamps of pictures [default: 30], rate asked of a camera.
    #[arg(long, value_name = "RATE", value_parser = parse_positive)]
    fps: Option<f64>,
    /// Picture size asked of a camera.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<(u32, u32)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SplitFlag {
    Train,
    Val,
}

impl SplitFlag {
    fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
        }
    }
}

fn parse_class(text: &str) -> Result<String, String> {
    let plain = |c: char| c.is_alphanumeric() || " _-.".contains(c);
    let good = !text.trim().is_empty() && text.trim() == text && text.chars().all(plain);
    if good {
        return Ok(text.to_owned());
    }
    Err(format!("'{text}' is not a name of letters, digits, spaces and - _ ."))
}

fn parse_name(text: &str) -> Result<String, String> {
    let plain = |c: char| c.is_alphanumeric() || "_-.".contains(c);
    if !text.is_empty() && !text.starts_with('.') && text.chars().all(plain) {
        return Ok(text.to_owned());
    }
    Err(format!("'{text}' is not a name of letters, digits and - _ ."))
}

/// What `--json` prints.
#[derive(Debug, Default, Serialize)]
struct Summary {
    /// Frames of the source that were seen.
    frames: u64,
    /// Frames of the set, those of earlier runs of the same command included.
    pictures: usize,
    given: usize,
    carried: usize,
    lost: usize,
    waiting: usize,
}

/// Carries the box, if there is one.
struct Carrier {
    tracker: FlowTracker,
    target: Target,
    /// Variance of the centre since the last box that was given, as a share of the
    /// box's sides.
    variance: f64,
}

impl Carrier {
    fn open(args: &FramesArgs) -> Result<Option<Self>> {
        let finder = match (&args.boxes, args.bbox) {
            (Some(path), _) => Finder::Boxes(TargetBoxes::read(path).or_bad_input()?),
            (None, Some(_)) => Finder::First,
            (None, None) => return Ok(None),
        };
        let tracker = FlowTracker::new(FlowOptions::default()).or_bad_input()?;
        Ok(Some(Self { tracker, target: Target::new(finder, 1, args.bbox)?, variance: 0.0 }))
    }

    fn follow(&mut self, shot: &SourceFrame, number: u64) -> Result<&State> {
        self.tracker.push(&shot.frame);
        self.target.carry(self.tracker.previous(), self.tracker.present());
        self.target.look(&shot.frame, number)?;
        let state = self.target.state();
        match (state.status, &state.carried) {
            (Some(Status::Given), _) => self.variance = 0.0,
            (_, Some(carried)) => {
                let sides = [carried.bbox.width(), carried.bbox.height()];
                let shares = carried.center_sd.iter().zip(sides).map(|(sd, side)| sd / side);
                self.variance += shares.map(|share| f64::from(share).powi(2)).sum::<f64>();
            }
            _ => {}
        }
        Ok(state)
    }
}

/// What a frame is in the set.
fn entry(index: u64, shot: &SourceFrame, state: Option<&State>, variance: f64) -> Entry {
    let mut entry = Entry { index, kind: Kind::Plain, reason: None, similarity: None, drift: None };
    let Some(state) = state else { return entry };
    let (width, height) = (shot.frame.width() as f32, shot.frame.height() as f32);
    match (state.status, state.bbox) {
        (Some(status), Some(bbox)) => {
            let inside = bbox.clipped(width, height);
            let share = inside.area() / bbox.area();
            if share < MIN_VISIBLE || inside.width().min(inside.height()) < MIN_SIDE {
                entry.kind = Kind::Lost;
                entry.reason = Some(format!("{:.0} % of the box is in the picture", 100.0 * share));
                return entry;
            }
            if status == Status::Given {
                entry.kind = Kind::Given;
                return entry;
            }
            entry.kind = Kind::Carried;
            entry.similarity = state.carried.map(|carried| carried.similarity);
            entry.drift = Some(variance.sqrt());
        }
        (Some(Status::Lost), _) => {
            entry.kind = Kind::Lost;
            entry.reason = state.reason.clone();
        }
        _ => entry.kind = Kind::Waiting,
    }
    entry
}

pub(crate) fn run(args: &FramesArgs) -> Result<Outcome> {
    let mut carrier = Carrier::open(args)?;
    let options = SourceOptions { fps: args.fps, size: args.size, ..Default::default() };
    let mut source = source::open(&args.source, &options).or_bad_input()?;
    if source.kind() == SourceKind::Picture && carrier.is_some() {
        say("one picture has no motion: its box is all that there will be");
    }
    let name = match &args.name {
        Some(name) => name.clone(),
        None => name_of(&source),
    };
    let set = FrameSet::open(&args.out, args.split.name(), &args.class, &name)?;
    let recipe = Recipe {
        source: args.source.clone(),
        every: args.every,
        bbox: args.bbox.map(<[f32; 4]>::from),
        boxes: args.boxes.as_ref().map(|path| path.display().to_string()),
        class: args.class.clone(),
        split: args.split.name().to_owned(),
    };
    let mut record = Record::open(&set.record(), recipe)?;
    if source.is_live() && record.next > 0 {
        return Err(bad_input(format!(
            "{} has frames called {name} of a live source, which cannot be gone on with: choose \
             another --name",
            args.out.display()
        )));
    }
    interrupt::stop_on_interrupt(&source);
    let mut outcome = Outcome::Done;
    let written = write_all(args, &mut source, &mut carrier, &set, &mut record, &mut outcome);
    // Whatever happened, what is said to be there is there.
    let closed = record.save(&set.record()).and_then(|()| review::write(&set));
    let seen = written?;
    closed?;

    let count = |kind| record.frames.iter().filter(|entry| entry.kind == kind).count();
    let summary = Summary {
        frames: seen,
        pictures: count(Kind::Plain) + count(Kind::Given) + count(Kind::Carried),
        given: count(Kind::Given),
        carried: count(Kind::Carried),
        lost: count(Kind::Lost),
        waiting: count(Kind::Waiting),
    };
    let mut output = Output::stdout();
    if args.json {
        output.json(&summary)?;
    } else {
        output.line(words(&summary, args, &set, carrier.is_some()))?;
    }
    if interrupt::interrupted() {
        say("the same command goes on with it");
        return Ok(Outcome::Interrupted);
    }
    if let Some(path) = args.boxes.as_ref().filter(|_| summary.given + summary.carried == 0) {
        say(format!(
            "{}: no box for any frame; a frame's number is that of its picture's name, or its \
             place in the source from 0",
            path.display()
        ));
    }
    Ok(outcome)
}

/// Goes through the source and writes the frames that are not there yet; returns
/// how many it saw.
fn write_all(
    args: &FramesArgs,
    source: &mut Source,
    carrier: &mut Option<Carrier>,
    set: &FrameSet,
    record: &mut Record,
    outcome: &mut Outcome,
) -> Result<u64> {
    let length = source.len_hint().map(|n| args.limit.map_or(n, |limit| n.min(limit)));
    let bar = progress::bar(length.filter(|n| *n > 1), "frames");
    let mut seen = 0;
    while args.limit.is_none_or(|limit| seen < limit) {
        let Some(item) = source.next() else { break };
        if interrupt::interrupted() {
            break;
        }
        seen += 1;
        bar.inc(1);
        let shot = match item {
            Ok(shot) => shot,
            Err(error) => {
                bar.suspend(|| report(&Error::new(error)));
                *outcome = Outcome::BadInputs;
                continue;
            }
        };
        let number = number_of(&shot, source.kind());
        let (state, variance) = match carrier {
            Some(carrier) => {
                let state = carrier.follow(&shot, number)?.clone();
                (Some(state), carrier.variance)
            }
            None => (None, 0.0),
        };
        if shot.index >= record.next {
            if shot.index.is_multiple_of(args.every) {
                let entry = entry(shot.index, &shot, state.as_ref(), variance);
                let bbox = state.as_ref().and_then(|state| state.bbox);
                set.write(&entry, bbox, &shot, source.kind())?;
                record.frames.push(entry);
                if record.frames.len().is_multiple_of(SAVE_EVERY) {
                    record.next = shot.index + 1;
                    record.save(&set.record())?;
                }
            }
            record.next = shot.index + 1;
        }
        source.recycle(shot.frame);
    }
    bar.finish_and_clear();
    Ok(seen)
}

/// What was done, for people.
fn words(summary: &Summary, args: &FramesArgs, set: &FrameSet, with_box: bool) -> String {
    let Summary { frames, pictures, given, carried, lost, waiting } = summary;
    let folder = args.out.display();
    let mut text = format!("{frames} frames seen, {pictures} pictures in {folder}");
    if with_box {
        text += &format!(
            ": {given} boxes given, {carried} carried; {lost} frames lost the box and {waiting} \
             had none yet: they are outside the set, listed in {}\nlook at {} before you train",
            set.lost_list().display(),
            set.page().display()
        );
    } else {
        text += ", without labels: label them before you train";
    }
    text
}

/// The source's name for its frames.
fn name_of(source: &Source) -> String {
    let text = match source.kind() {
        SourceKind::Stream => "stream".to_owned(),
        SourceKind::Camera => "camera".to_owned(),
        SourceKind::Picture | SourceKind::Video => stem(Path::new(source.name())),
        SourceKind::Pictures => {
            // The folder's, or that of the first picture of a glob.
            let path = Path::new(source.name());
            let folder = path.canonicalize().ok().filter(|path| path.is_dir());
            let first = source.files().first().and_then(|path| path.canonicalize().ok());
            let folder = folder.or_else(|| first?.parent().map(Path::to_owned));
            let folder = folder.unwrap_or_else(|| path.to_owned());
            // `images` is what every set calls them.
            let parent = folder.parent().filter(|_| folder.ends_with("images"));
            stem(parent.unwrap_or(&folder))
        }
    };
    let plain = |c: char| if c.is_alphanumeric() || "_-.".contains(c) { c } else { '_' };
    let name: String = text.chars().map(plain).collect();
    let name = name.trim_start_matches('.');
    if name.is_empty() { "frames".to_owned() } else { name.to_owned() }
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or("frames".as_ref()).to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_classes_cannot_leave_the_folder_or_the_yaml() {
        for bad in ["", "../x", "a/b", ".hidden", "a b"] {
            assert!(parse_name(bad).is_err(), "{bad}");
        }
        for bad in ["", " car", "a: b", "#x", "a\nb", "'x'"] {
            assert!(parse_class(bad).is_err(), "{bad}");
        }
        assert!(parse_name("seq-1.b").is_ok() && parse_class("RC car").is_ok());
    }
}
