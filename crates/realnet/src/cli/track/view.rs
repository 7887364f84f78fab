//! What the saved pictures show.

use super::{record::TrackRecord, target::Target};
use anyhow::Result;
use realnet::{
    BoundingBox, Frame,
    annotate::{Annotator, FlowMark, FlowSide, direction_color, side_by_side},
    source::SourceFrame,
};
use realnet_vision::Track;
use std::path::Path;

/// Corners that move with the target, and its box.
const TARGET: [u8; 3] = [240, 228, 66];
/// Corners in the target's box that do not move with it.
const STRAY: [u8; 3] = [213, 94, 0];
/// Corners of the rest of the picture, when there is a target.
const BACKGROUND: [u8; 3] = [236, 132, 196];
/// Corners that were lost, and those that rest.
const PALE: [u8; 3] = [225; 3];
/// Shorter flow has no direction worth a colour, in pixels.
const RESTING: f32 = 0.5;
/// A median flow from here on is motion worth showing, in pixels.
const MOVED: f32 = 1.0;

/// Draws corners, flow and box.
pub(super) struct View {
    annotator: Annotator,
    /// The frame whose pair is wanted; `None` for the first that moved.
    pair: Option<u64>,
    with_target: bool,
    marks: Vec<FlowMark>,
    /// The frame before, as it came, until its pair is drawn.
    before: Option<SourceFrame>,
    previous_box: Option<BoundingBox>,
    drawn: bool,
    /// Of pairs that hardly moved the one that moved most.
    best: Option<(f32, Frame)>,
}

impl View {
    pub(super) fn new(pair: Option<u64>, with_target: bool) -> Result<Self> {
        Ok(Self {
            annotator: Annotator::new(Vec::new())?,
            pair,
            with_target,
            marks: Vec::new(),
            before: None,
            previous_box: None,
            drawn: false,
            best: None,
        })
    }

    /// Takes the present frame's corners: coloured by direction, or, with a
    /// target, by what they belong to.
    pub(super) fn marks(&mut self, points: &[[f32; 2]], tracks: &[Track], target: &Target) {
        let with_target = self.with_target;
        let scene = points.iter().zip(tracks).map(|(&from, track)| {
            let flow = [track.point[0] - from[0], track.point[1] - from[1]];
            let color = match track.is_tracked() {
                false => PALE,
                true if with_target => BACKGROUND,
                true if flow[0].hypot(flow[1]) < RESTING => PALE,
                true => direction_color(flow),
            };
            FlowMark { from, to: track.is_tracked().then_some(track.point), color }
        });
        let carried = target.points().iter().map(|point| {
            let color = if point.inlier { TARGET } else { STRAY };
            FlowMark { from: point.from, to: Some(point.to), color }
        });
        self.marks.clear();
        self.marks.extend(scene.chain(carried));
    }

    /// Draws on the present frame.
    pub(super) fn draw(&self, frame: &mut Frame, record: &TrackRecord) {
        self.annotator.draw_flow(frame, &self.marks, FlowSide::After);
        if let Some(bbox) = record.bbox() {
            let text = record.target().unwrap_or_default();
            self.annotator.draw_box(frame, &bbox.into(), TARGET, &text);
        }
        let lost = record.target().filter(|_| record.bbox().is_none());
        let lost = lost.map_or(String::new(), |text| format!("; {text}"));
        let text = format!("#{} {}{lost}", record.index(), record.corners());
        self.annotator.draw_caption(frame, &text);
    }

    /// The frame before with its corners beside the present one with their flow,
    /// when this is the pair to be shown.
    pub(super) fn before_after(
        &mut self,
        shot: &SourceFrame,
        record: &TrackRecord,
    ) -> Result<Option<Frame>> {
        if self.drawn {
            return Ok(None);
        }
        let bbox = record.bbox().map(BoundingBox::from);
        let previous_box = std::mem::replace(&mut self.previous_box, bbox);
        let before = self.before.replace(shot.clone());
        // Without corners there is no pair.
        let (Some(before), Some(flow)) = (before, record.median_flow()) else { return Ok(None) };
        let is_wanted = match self.pair {
            Some(pair) => shot.index == pair,
            None => flow >= MOVED,
        };
        let is_better = |best: &(f32, Frame)| flow > best.0;
        if !is_wanted && (self.pair.is_some() || !self.best.as_ref().is_none_or(is_better)) {
            return Ok(None);
        }
        let (mut left, mut right) = (before.frame, shot.frame.clone());
        self.annotator.draw_flow(&mut left, &self.marks, FlowSide::Before);
        self.annotator.draw_flow(&mut right, &self.marks, FlowSide::After);
        for (frame, bbox) in [(&mut left, previous_box), (&mut right, bbox)] {
            if let Some(bbox) = bbox {
                self.annotator.draw_box(frame, &bbox, TARGET, "target");
            }
        }
        let text = format!("#{} {}: corners", before.index, file_name(&before.name));
        self.annotator.draw_caption(&mut left, &text);
        let text = format!("#{} {}: {}", shot.index, file_name(&shot.name), record.corners());
        self.annotator.draw_caption(&mut right, &text);
        let picture = side_by_side(&left, &right)?;
        if is_wanted {
            self.drawn = true;
            (self.before, self.best) = (None, None);
            return Ok(Some(picture));
        }
        self.best = Some((flow, picture));
        Ok(None)
    }

    /// Of pairs that hardly moved the one that moved most, when none was shown.
    pub(super) fn best_pair(&mut self) -> Option<Frame> {
        self.best.take().map(|(_, picture)| picture)
    }

    /// Whether the pair asked for never came.
    pub(super) fn lacks_pair(&self) -> bool {
        self.pair.is_some() && !self.drawn
    }
}

fn file_name(name: &str) -> String {
    Path::new(name).file_name().unwrap_or_default().to_string_lossy().into_owned()
}
