//! The run from above: both tracks with headings, bodies, where they end.

use super::chart::{LEFT, WIDTHS, trace};
use crate::cli::html::escape;
use crate::cli::ticks;
use realnet_core::Pose2;
use realnet_core::nalgebra::Vector2;
use realnet_sim::{FrameLog, RunLog, VehicleKind, VehicleSize};
use std::fmt::Write as _;

/// Room for the numbers below.
const BOTTOM: f64 = 38.0;
const MARGIN: f64 = 10.0;
/// The highest drawing, pixels.
const MOST: f64 = 560.0;
/// Room beside the outermost places, pixels.
const LABEL: f64 = 14.0;
/// Air around the tracks, metres.
const AIR: f64 = 0.4;

/// The view as HTML; nothing for a run without frames.
pub(super) fn html(log: &RunLog) -> String {
    let Some(view) = View::new(log) else { return String::new() };
    let mut html = String::from(
        "<figure><figcaption><h3>From above</h3><ul class=\"legend\">\
         <li><svg class=\"swatch own\" viewBox=\"0 0 22 12\"><path class=\"line\" d=\"M0 6H22\"/></svg>follower</li>",
    );
    if view.has_target {
        html.push_str(
            "<li><svg class=\"swatch target\" viewBox=\"0 0 22 12\"><path class=\"line\" d=\"M0 6H22\"/></svg>target</li>",
        );
    }
    if !log.bodies.is_empty() || !log.walls.is_empty() {
        html.push_str(
            "<li><svg class=\"swatch other\" viewBox=\"0 0 22 12\"><path class=\"body\" d=\"M4 1H18V11H4Z\"/></svg>all else</li>",
        );
    }
    html.push_str("</ul></figcaption>\n");
    for (width, class) in WIDTHS {
        view.draw(&mut html, width, class);
    }
    let _ = writeln!(
        html,
        "<p class=\"note\">An arrow every {} s, the seconds at some of them; rings where they \
         start, footprints where they end.</p></figure>",
        ticks::number(view.every, view.every)
    );
    html
}

struct View<'a> {
    log: &'a RunLog,
    has_target: bool,
    /// Seconds from arrow to arrow.
    every: f64,
    /// Corners of what is shown, metres.
    low: Vector2<f64>,
    high: Vector2<f64>,
    /// x goes up and y left instead of x right and y up.
    upright: bool,
}

/// Where places are on a drawing.
struct Map<'a> {
    view: &'a View<'a>,
    /// Pixels a metre.
    scale: f64,
    height: f64,
    width: f64,
    /// Corners of the drawing, metres.
    low: Vector2<f64>,
    high: Vector2<f64>,
}

impl<'a> View<'a> {
    fn new(log: &'a RunLog) -> Option<Self> {
        let (first, last) = (log.frames.first()?, log.frames.last()?);
        let has_target = log.frames.iter().any(|frame| frame.gap_m.is_finite());
        let target = log.frames.iter().filter(|_| has_target).map(|frame| &frame.target);
        let places = log.frames.iter().map(|frame| &frame.follower).chain(target);
        let moving = log.bodies.iter().filter(|b| b.poses.len() > 1).flat_map(|b| &b.poses);
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(-f64::INFINITY));
        for place in places.chain(moving).map(Pose2::position) {
            if place.iter().all(|v| v.is_finite()) {
                low = low.inf(&place);
                high = high.sup(&place);
            }
        }
        // What stands still is shown as far as it is near: a room may be large.
        let reach = Vector2::repeat(1.5);
        let (near_low, near_high) = (low - reach, high + reach);
        for body in log.bodies.iter().filter(|body| body.poses.len() == 1) {
            for corner in corners(&body.outline, body.poses.first()) {
                let corner = corner.sup(&near_low).inf(&near_high);
                low = low.inf(&corner);
                high = high.sup(&corner);
            }
        }
        for corner in &log.walls {
            let corner = corner.sup(&near_low).inf(&near_high);
            low = low.inf(&corner);
            high = high.sup(&corner);
        }
        let (low, high) = (low - Vector2::repeat(AIR), high + Vector2::repeat(AIR));
        let size = high - low;
        if !size.iter().all(|v| v.is_finite()) {
            return None;
        }
        let duration = last.time_s - first.time_s;
        let every = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 300.0];
        let every = every.into_iter().find(|s| duration / s <= 30.0).unwrap_or(3600.0);
        Some(Self { log, has_target, every, low, high, upright: size.y > 1.2 * size.x })
    }

    fn draw(&self, svg: &mut String, width: f64, class: &str) {
        let size = self.high - self.low;
        let (across, up) = if self.upright { (size.y, size.x) } else { (size.x, size.y) };
        let room = width - LEFT - MARGIN;
        // The numbers beside the tracks need some room, too.
        let scale = ((room - 2.0 * LABEL) / across).min(MOST / up);
        let tall = (up * scale).max(60.0) + 2.0 * LABEL;
        let height = tall + BOTTOM + MARGIN;
        // All the room is used.
        let (across, up) = (0.5 * (room / scale - across), 0.5 * (tall / scale - up));
        let more = if self.upright { Vector2::new(up, across) } else { Vector2::new(across, up) };
        let map =
            Map { view: self, scale, height, width, low: self.low - more, high: self.high + more };
        let _ = writeln!(
            svg,
            "<svg class=\"{class}\" viewBox=\"0 0 {width} {height:.0}\" role=\"img\" \
             aria-label=\"The run from above\">"
        );
        map.grid(svg);
        // Walls go on outside of what is shown.
        let clip = format!("view-{class}");
        let _ = writeln!(
            svg,
            "<clipPath id=\"{clip}\"><rect x=\"{LEFT}\" y=\"{MARGIN}\" width=\"{:.1}\" height=\"{:.1}\"/>\
             </clipPath><g clip-path=\"url(#{clip})\">",
            width - LEFT - MARGIN,
            height - BOTTOM - MARGIN
        );
        map.bodies(svg);
        let fallback = VehicleKind::TouringCar.size();
        if self.has_target {
            let size = self.log.target_size.unwrap_or(fallback);
            map.track(svg, "target", |frame| frame.target, &size);
        }
        map.track(svg, "own", |frame| frame.follower, &self.log.follower_size.unwrap_or(fallback));
        svg.push_str("</g></svg>\n");
    }
}

impl Map<'_> {
    fn at(&self, place: &Vector2<f64>) -> (f64, f64) {
        let (across, up) = if self.view.upright {
            (self.high.y - place.y, place.x - self.low.x)
        } else {
            (place.x - self.low.x, place.y - self.low.y)
        };
        (LEFT + across * self.scale, self.height - BOTTOM - up * self.scale)
    }

    fn grid(&self, svg: &mut String) {
        let Self { low, high, view: View { upright, .. }, .. } = self;
        let (right, bottom) = (self.width - MARGIN, self.height - BOTTOM);
        // A step for both axes, of at least 45 pixels.
        let steps = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];
        let step = steps.into_iter().find(|step| step * self.scale >= 45.0).unwrap_or(200.0);
        let lines = |low: f64, high: f64| {
            let first = (low / step).ceil() as i64;
            (first..first + 60).map(move |i| i as f64 * step).take_while(move |v| *v <= high)
        };
        for x in lines(low.x, high.x) {
            let (px, py) = self.at(&Vector2::new(x, low.y));
            let text = ticks::number(x, step);
            let _ =
                if *upright { across(svg, py, right, &text) } else { up(svg, px, bottom, &text) };
        }
        for y in lines(low.y, high.y) {
            let (px, py) = self.at(&Vector2::new(low.x, y));
            let text = ticks::number(y, step);
            let _ =
                if *upright { up(svg, px, bottom, &text) } else { across(svg, py, right, &text) };
        }
        let (lower, left) = if *upright { ("y, m", "x, m") } else { ("x, m", "y, m") };
        let _ = writeln!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{lower}</text>\
             <text transform=\"translate(12 {:.1}) rotate(-90)\" text-anchor=\"middle\">{left}</text>",
            0.5 * (LEFT + right),
            bottom + 33.0,
            0.5 * (MARGIN + bottom)
        );
    }

    fn bodies(&self, svg: &mut String) {
        svg.push_str("<g class=\"other\">");
        if !self.view.log.walls.is_empty() {
            let walls = self.outline(self.view.log.walls.iter().copied());
            let _ = writeln!(svg, "<path class=\"wall\" d=\"{walls}\"><title>wall</title></path>");
        }
        for body in &self.view.log.bodies {
            let name = escape(&body.name);
            if body.poses.len() > 1 {
                let path = self.path(body.poses.iter());
                let _ = write!(
                    svg,
                    "<path class=\"line thin dashed\" d=\"{path}\"><title>{name}</title></path>"
                );
            }
            let outline = self.outline(corners(&body.outline, body.poses.last()));
            let _ =
                writeln!(svg, "<path class=\"body\" d=\"{outline}\"><title>{name}</title></path>");
        }
        svg.push_str("</g>\n");
    }

    fn track(
        &self,
        svg: &mut String,
        color: &str,
        pose: impl Fn(&FrameLog) -> Pose2,
        size: &VehicleSize,
    ) {
        let frames = &self.view.log.frames;
        let poses: Vec<Pose2> = frames.iter().map(&pose).collect();
        let _ = write!(
            svg,
            "<g class=\"{color}\"><path class=\"line\" d=\"{}\"/>",
            self.path(poses.iter())
        );
        if let Some(end) = poses.last() {
            let outline = self.outline(size.corners(end).into_iter());
            let _ = write!(svg, "<path class=\"body\" d=\"{outline}\"/>");
        }
        if let Some(start) = poses.first() {
            let (x, y) = self.at(&start.position());
            let _ = write!(svg, "<circle class=\"ring\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\"/>");
        }
        self.moment(svg, &poses);
        let (mut due, mut count) = (self.view.every, 0);
        let mut labelled: Option<(f64, f64)> = None;
        let mut last: Option<(f64, f64)> = None;
        for frame in frames {
            if frame.time_s + 1e-6 < due {
                continue;
            }
            due += self.view.every;
            count += 1;
            let pose = pose(frame);
            let (x, y) = self.at(&pose.position());
            let far = |from: Option<(f64, f64)>, least: f64| {
                from.is_none_or(|(fx, fy)| (x - fx).hypot(y - fy) > least)
            };
            // Where it stands, one arrow is enough.
            if !far(last, 7.0) {
                continue;
            }
            last = Some((x, y));
            let ahead = self.at(&(pose.position() + pose.direction()));
            let angle = (ahead.1 - y).atan2(ahead.0 - x).to_degrees();
            let _ = write!(
                svg,
                "<path class=\"arrow\" transform=\"translate({x:.1} {y:.1}) rotate({angle:.1})\" \
                 d=\"M7 0L-4 4.4L-1.8 0L-4 -4.4Z\"/>"
            );
            if count % 2 == 0 && far(labelled, 44.0) {
                labelled = Some((x, y));
                // Beside the track: left of the target's, right of the follower's.
                let side = if color == "own" { 1.0 } else { -1.0 };
                let turn = angle.to_radians();
                let (dx, dy) = (-side * turn.sin() * 13.0, side * turn.cos() * 13.0 + 4.0);
                let _ = write!(
                    svg,
                    "<text class=\"clock\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                    x + dx,
                    y + dy,
                    ticks::number(frame.time_s, 2.0 * self.view.every)
                );
            }
        }
        svg.push_str("</g>\n");
    }

    /// A dot for the cross hair of the charts: its places at equal times.
    fn moment(&self, svg: &mut String, poses: &[Pose2]) {
        let last = poses.len().saturating_sub(1);
        let samples = last.min(240);
        let places: Vec<String> = (0..=samples)
            .filter_map(|sample| poses.get(sample * last / samples.max(1)))
            .map(|pose| self.at(&pose.position()))
            .map(|(x, y)| format!("{x:.1},{y:.1}"))
            .collect();
        let _ = write!(svg, "<circle class=\"now\" r=\"6\" data-track=\"{}\"/>", places.join(" "));
    }

    /// A path through places, without those that are less than a pixel from the last.
    fn path<'p>(&self, poses: impl Iterator<Item = &'p Pose2>) -> String {
        let mut points: Vec<(f64, f64)> = Vec::new();
        let mut end = None;
        for place in poses.map(Pose2::position).filter(|p| p.iter().all(|v| v.is_finite())) {
            let (x, y) = self.at(&place);
            if points.last().is_none_or(|(lx, ly)| (x - lx).hypot(y - ly) >= 1.0) {
                points.push((x, y));
            }
            end = Some((x, y));
        }
        points.extend(end);
        let mut path = String::new();
        trace(&mut path, &points, 'M');
        path
    }

    fn outline(&self, corners: impl Iterator<Item = Vector2<f64>>) -> String {
        let mut path = String::new();
        trace(&mut path, &corners.map(|corner| self.at(&corner)).collect::<Vec<_>>(), 'M');
        path.push('Z');
        path
    }
}

/// A line of the grid from left to right with its number.
fn across(svg: &mut String, y: f64, right: f64, text: &str) -> std::fmt::Result {
    write!(
        svg,
        "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{right:.1}\"/>\
         <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{text}</text>",
        LEFT - 5.0,
        y + 4.0
    )
}

/// A line of the grid from bottom to top with its number.
fn up(svg: &mut String, x: f64, bottom: f64, text: &str) -> std::fmt::Result {
    write!(
        svg,
        "<path class=\"grid\" d=\"M{x:.1} {MARGIN}V{bottom:.1}\"/>\
         <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{text}</text>",
        bottom + 17.0
    )
}

/// The corners of a body where it is.
fn corners<'c>(
    outline: &'c [Vector2<f64>],
    pose: Option<&'c Pose2>,
) -> impl Iterator<Item = Vector2<f64>> + 'c {
    let pose = pose.copied().unwrap_or_default();
    outline.iter().map(move |corner| pose.transform_point(corner))
}
