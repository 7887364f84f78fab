//! What held when: a lane for each state of the track, each reason to stop and each
//! bound of the speed that occurred.

use super::chart::{Frame, LEFT, RIGHT, Scale, TIME, WIDTHS, time_axis};
use super::plots::{periods, span};
use crate::cli::html::escape;
use realnet_core::{StopReason, TrackStatus};
use realnet_sim::RunLog;
use std::fmt::Write as _;

const STATUSES: [(TrackStatus, &str); 4] = [
    (TrackStatus::Tracking, "good"),
    (TrackStatus::Coasting, "fair"),
    (TrackStatus::Lost, "bad"),
    (TrackStatus::Searching, "other"),
];

/// Pixels of a lane, and of the name above it.
const LANE: f64 = 12.0;
const NAME: f64 = 17.0;
const AIR: f64 = 7.0;

struct Lane {
    name: String,
    color: &'static str,
    periods: Vec<(f64, f64)>,
}

/// The time line of a run.
pub(super) fn html(log: &RunLog) -> String {
    let lanes = lanes(log);
    let mut html = String::from("<figure><figcaption><h3>Status and stops</h3></figcaption>\n");
    for (width, class) in WIDTHS {
        draw(&mut html, &lanes, span(log), width, class);
    }
    html.push_str("</figure>\n");
    html
}

fn lanes(log: &RunLog) -> Vec<Lane> {
    let (_, end) = span(log);
    let mut lanes = Vec::new();
    let mut lane = |kind: &str, name: &str, color, periods: Vec<(f64, f64)>| {
        if !periods.is_empty() {
            let seconds: f64 = periods.iter().map(|(from, to)| to - from).sum();
            let name = format!("{kind}{name}, {seconds:.1} s");
            lanes.push(Lane { name, color, periods });
        }
    };
    let statuses = periods(log, |frame| Some(frame.status));
    for (status, color) in STATUSES {
        let own = statuses.iter().filter(|period| period.2 == status);
        lane("", status.name(), color, own.map(|period| (period.0, period.1)).collect());
    }
    for reason in StopReason::ALL {
        let own = log.stops.iter().filter(|stop| stop.reason == reason);
        let own = own.map(|stop| (stop.from_s, stop.until_s.unwrap_or(end))).collect();
        lane("stop: ", reason.name(), "bad", own);
    }
    let bounds = periods(log, |frame| frame.limited_by);
    let mut names: Vec<&str> = bounds.iter().map(|period| period.2).collect();
    names.sort_unstable();
    names.dedup();
    for name in names {
        let own = bounds.iter().filter(|period| period.2 == name);
        lane("speed limited: ", name, "own", own.map(|period| (period.0, period.1)).collect());
    }
    lanes
}

fn draw(svg: &mut String, lanes: &[Lane], time: (f64, f64), width: f64, class: &str) {
    let each = NAME + LANE + AIR;
    let bottom = 4.0 + each * lanes.len() as f64;
    let height = bottom + 38.0;
    let high = if time.1 > time.0 { time.1 } else { time.0 + 1.0 };
    let x = Scale { low: time.0, high, from: LEFT, to: width - RIGHT };
    let frame = Frame { left: LEFT, right: x.to, top: 4.0, bottom };
    let _ = writeln!(
        svg,
        "<svg class=\"{class}\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
         aria-label=\"Status and stops over time\"{}>",
        frame.attributes((time.0, high), None)
    );
    for (index, Lane { name, color, periods }) in lanes.iter().enumerate() {
        let top = 4.0 + each * index as f64;
        let _ = write!(
            svg,
            "<text class=\"name\" x=\"{LEFT}\" y=\"{:.1}\">{}</text>\
             <rect class=\"lane\" x=\"{LEFT}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{LANE}\"/>\
             <g class=\"{color}\">",
            top + 12.5,
            escape(name),
            top + NAME,
            x.to - x.from,
        );
        for (from, to) in periods {
            let (left, right) = (x.at(*from), x.at(*to));
            let _ = write!(
                svg,
                "<rect class=\"period\" x=\"{left:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{LANE}\">\
                 <title>{}: {from:.2} to {to:.2} s</title></rect>",
                top + NAME,
                (right - left).max(1.5),
                escape(name)
            );
        }
        svg.push_str("</g>\n");
    }
    time_axis(svg, &x, bottom, TIME);
    svg.push_str("</svg>\n");
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_sim::{FrameLog, StopLog};

    #[test]
    fn there_is_a_lane_for_all_that_occurred_and_no_other() {
        let frames = (0..=4).map(|i| FrameLog {
            time_s: f64::from(i),
            status: if i < 3 { TrackStatus::Tracking } else { TrackStatus::Lost },
            limited_by: (i == 1).then_some("curve"),
            ..FrameLog::default()
        });
        let stop = StopLog { from_s: 3.5, until_s: None, reason: StopReason::TargetLost };
        let log = RunLog { frames: frames.collect(), stops: vec![stop], ..RunLog::default() };
        let lanes = lanes(&log);
        let names: Vec<&str> = lanes.iter().map(|lane| lane.name.as_str()).collect();
        let expected = [
            "tracking, 3.0 s",
            "lost, 1.0 s",
            "stop: target-lost, 0.5 s",
            "speed limited: curve, 1.0 s",
        ];
        assert_eq!(names, expected);
        assert_eq!(lanes[2].periods, [(3.5, 4.0)]);
    }
}
