//! What was found in one frame, and in all of them.

use super::target::{State, Status};
use realnet::source::SourceFrame;
use realnet_vision::{Track, TrackStatus};
use serde::{Serialize, Serializer};
use std::fmt::Write;

/// Milliseconds spent on one frame.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct TrackMs {
    /// The picture's pyramid.
    #[serde(serialize_with = "thousandths")]
    pub(super) pyramid: f64,
    /// Corners of the frame before, and where they are now.
    #[serde(serialize_with = "thousandths")]
    pub(super) flow: f64,
    /// Carrying the box.
    #[serde(serialize_with = "thousandths")]
    pub(super) carry: f64,
    /// Taking a new box: the network, mostly.
    #[serde(serialize_with = "thousandths")]
    pub(super) detect: f64,
}

/// Corners that were not found again, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Lost {
    /// They left the picture.
    pub(super) outside: usize,
    /// No texture around them.
    pub(super) flat: usize,
    /// Tracked back they end elsewhere.
    pub(super) round_trip: usize,
}

/// How the box was carried.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct CarriedRecord {
    /// Corners in the box.
    corners: usize,
    /// Those that were found again.
    tracked: usize,
    /// Those that move with the box.
    inliers: usize,
    /// Correlation of the box's content before and after.
    #[serde(serialize_with = "thousandths_f32")]
    similarity: f32,
}

/// One line of JSON, fields in this order.
#[derive(Clone, Debug, Serialize)]
pub(super) struct TrackRecord {
    frame: u64,
    source: String,
    stamp_ns: i64,
    width: u32,
    height: u32,
    /// Corners of the frame before, outside the target's box.
    corners: usize,
    /// Those found again in this one.
    tracked: usize,
    lost: Lost,
    /// Median length of their flow in pixels; null without any.
    #[serde(serialize_with = "thousandths_option")]
    median_flow_px: Option<f32>,
    /// Left, top, right, bottom in pixels; null without a box.
    #[serde(rename = "box", serialize_with = "edges")]
    bbox: Option<[f32; 4]>,
    /// Null when no target was asked for.
    box_status: Option<Status>,
    /// Why there is no box.
    reason: Option<String>,
    carried: Option<CarriedRecord>,
    /// Overlap with the box of the file of boxes.
    #[serde(serialize_with = "thousandths_option")]
    iou: Option<f32>,
    ms: TrackMs,
}

impl TrackRecord {
    pub(super) fn new(
        shot: &SourceFrame,
        points: &[[f32; 2]],
        tracks: &[Track],
        state: &State,
        ms: TrackMs,
    ) -> Self {
        let count = |status| tracks.iter().filter(|t| t.status == status).count();
        let SourceFrame { frame, index, name } = shot;
        Self {
            frame: *index,
            source: name.clone(),
            stamp_ns: frame.stamp().nanos(),
            width: frame.width(),
            height: frame.height(),
            corners: points.len(),
            tracked: count(TrackStatus::Tracked),
            lost: Lost {
                outside: count(TrackStatus::Outside),
                flat: count(TrackStatus::Flat),
                round_trip: count(TrackStatus::RoundTrip),
            },
            median_flow_px: median_flow(points, tracks),
            bbox: state.bbox.map(<[f32; 4]>::from),
            box_status: state.status,
            reason: state.reason.clone(),
            carried: state.carried.map(|c| CarriedRecord {
                corners: c.corners,
                tracked: c.tracked,
                inliers: c.inliers,
                similarity: c.similarity,
            }),
            iou: state.iou,
            ms,
        }
    }

    pub(super) fn index(&self) -> u64 {
        self.frame
    }

    pub(super) fn bbox(&self) -> Option<[f32; 4]> {
        self.bbox
    }

    pub(super) fn median_flow(&self) -> Option<f32> {
        self.median_flow_px
    }

    /// The corners, in a few words.
    pub(super) fn corners(&self) -> String {
        let mut text = format!("{} of {} corners", self.tracked, self.corners);
        if let Some(flow) = self.median_flow_px {
            // Writing to a string cannot fail.
            let _ = write!(text, ", median flow {flow:.1} px");
        }
        text
    }

    /// The box, in a few words; nothing without a target.
    pub(super) fn target(&self) -> Option<String> {
        Some(match (self.box_status?, &self.carried, &self.reason) {
            (Status::Waiting, ..) => "no box yet".to_owned(),
            (Status::Given, ..) => "box given".to_owned(),
            (Status::Detected, ..) => "box detected".to_owned(),
            (Status::Carried, Some(c), _) => {
                format!("box carried by {} of {} corners", c.inliers, c.corners)
            }
            (Status::Carried, None, _) => "box carried".to_owned(),
            (Status::Lost, _, Some(reason)) => format!("box lost: {reason}"),
            (Status::Lost, _, None) => "box lost".to_owned(),
        })
    }

    /// One line for a person:
    /// `drive.mp4 #12 1280x720: 183 of 200 corners, median flow 3.2 px (0.4 + 2.1 ms)`.
    pub(super) fn line(&self) -> String {
        let TrackMs { pyramid, flow, carry, detect } = self.ms;
        let mut line = format!("{} #{} {}x{}: ", self.source, self.frame, self.width, self.height);
        line.push_str(&self.corners());
        let _ = match self.target() {
            None => write!(line, " ({pyramid:.1} + {flow:.1} ms)"),
            Some(target) => {
                write!(line, "; {target} ({pyramid:.1} + {flow:.1} + {carry:.1} + {detect:.1} ms)")
            }
        };
        line
    }
}

/// Median length of the flow of the points found again; of an even number the
/// longer of the middle two.
fn median_flow(points: &[[f32; 2]], tracks: &[Track]) -> Option<f32> {
    let found = points.iter().zip(tracks).filter(|(_, track)| track.is_tracked());
    let length = |(a, t): (&[f32; 2], &Track)| (t.point[0] - a[0]).hypot(t.point[1] - a[1]);
    let mut lengths: Vec<f32> = found.map(length).collect();
    lengths.sort_by(f32::total_cmp);
    lengths.get(lengths.len() / 2).copied()
}

/// Counts over all frames.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Summary {
    frames: usize,
    corners: usize,
    tracked: usize,
    target: bool,
    carried: usize,
    lost: usize,
    compared: usize,
    overlapping: usize,
}

impl Summary {
    pub(super) fn add(&mut self, record: &TrackRecord) {
        self.frames += 1;
        self.corners += record.corners;
        self.tracked += record.tracked;
        self.target |= record.box_status.is_some();
        self.carried += usize::from(record.box_status == Some(Status::Carried));
        self.lost += usize::from(record.box_status == Some(Status::Lost));
        self.compared += usize::from(record.iou.is_some());
        self.overlapping += usize::from(record.iou.is_some_and(|iou| iou >= 0.5));
    }

    /// One line for a person.
    pub(super) fn line(&self) -> String {
        let Self { frames, corners, tracked, carried, lost, compared, overlapping, .. } = self;
        let mut line = format!("{frames} frames: {tracked} of {corners} corners found again");
        if self.target {
            let _ = write!(line, "; box carried in {carried} frames, lost in {lost}");
        }
        if *compared > 0 {
            let _ =
                write!(line, "; IoU at least 0.5 in {overlapping} of {compared} frames followed");
        }
        line
    }
}

fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

fn thousandths<S: Serializer>(value: &f64, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_f64(rounded(*value))
}

fn thousandths_f32<S: Serializer>(value: &f32, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_f64(rounded(f64::from(*value)))
}

fn thousandths_option<S: Serializer>(value: &Option<f32>, s: S) -> Result<S::Ok, S::Error> {
    value.map(|v| rounded(f64::from(v))).serialize(s)
}

fn edges<S: Serializer>(value: &Option<[f32; 4]>, s: S) -> Result<S::Ok, S::Error> {
    value.map(|edges| edges.map(|v| rounded(f64::from(v)))).serialize(s)
}
