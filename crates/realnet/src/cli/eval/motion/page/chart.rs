//! Charts as SVG.

use crate::cli::ticks::{number, step, ticks};
use realnet::cues::{DepthHistogram, ForegroundGate};
use std::fmt::Write as _;

/// Size of a chart, and the room around its plot.
const SIZE: (f64, f64) = (900.0, 230.0);
const LEFT: f64 = 52.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 34.0;

/// Lines over a common axis.
pub(super) struct Chart {
    title: &'static str,
    axis: &'static str,
    lines: Vec<Line>,
    marks: Option<(&'static str, &'static str, Vec<f64>)>,
    top: Option<f64>,
}

/// A line of a chart.
struct Line {
    name: &'static str,
    color: &'static str,
    points: Vec<(f64, Option<f64>)>,
}

impl Chart {
    pub(super) fn new(title: &'static str, axis: &'static str) -> Self {
        Self { title, axis, lines: Vec::new(), marks: None, top: None }
    }

    /// A line; it is broken where a value is missing.
    pub(super) fn line(
        mut self,
        name: &'static str,
        color: &'static str,
        points: Vec<(f64, Option<f64>)>,
    ) -> Self {
        self.lines.push(Line { name, color, points });
        self
    }

    /// Ticks on the axis.
    pub(super) fn marks(
        mut self,
        name: &'static str,
        color: &'static str,
        places: Vec<f64>,
    ) -> Self {
        self.marks = (!places.is_empty()).then_some((name, color, places));
        self
    }

    /// The upper end of the values.
    pub(super) fn top(mut self, top: f64) -> Self {
        self.top = Some(top);
        self
    }

    pub(super) fn svg(&self) -> String {
        let points = || self.lines.iter().flat_map(|line| &line.points);
        let xs = points().map(|p| p.0);
        let (low, high) =
            xs.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        let most = points().filter_map(|p| p.1).fold(0.0, f64::max);
        let top = self.top.unwrap_or(if most > 0.0 { most * 1.05 } else { 1.0 });
        let plot = Plot { low, high: if high > low { high } else { low + 1.0 }, top };
        let mut svg = plot.frame(self.title, self.axis);
        let mut legend = SIZE.0 - RIGHT;
        for Line { name, color, points } in self.lines.iter().rev() {
            let mut path = String::new();
            let mut pen = 'M';
            for (x, y) in points {
                match y {
                    Some(y) => {
                        let _ = write!(path, "{pen}{:.1} {:.1}", plot.x(*x), plot.y(*y));
                        pen = 'L';
                    }
                    None => pen = 'M',
                }
            }
            let _ = writeln!(
                svg,
                "<path d=\"{path}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.6\" stroke-linejoin=\"round\"/>"
            );
            legend = label(&mut svg, legend, name, color);
        }
        if let Some((name, color, places)) = &self.marks {
            for x in places {
                let x = plot.x(*x);
                let y = SIZE.1 - BOTTOM;
                let _ = writeln!(
                    svg,
                    "<path d=\"M{x:.1} {y}v-9\" stroke=\"{color}\" stroke-width=\"2\"/>"
                );
            }
            label(&mut svg, legend, name, color);
        }
        svg.push_str("</svg>\n");
        svg
    }
}

/// The density of the depths in a box: its peak, the interval around it, and what
/// the sigma rule makes of it.
pub(super) fn density(histogram: &DepthHistogram, gate: &ForegroundGate) -> String {
    let bins = histogram.bins();
    let (low, high) = (histogram.edge(0), histogram.edge(bins));
    // The density is one per metre: as a share of a bin it fits the bars.
    let smooth = || histogram.density().iter().map(|density| density * histogram.bin_width());
    let most = histogram.shares().iter().copied().chain(smooth()).fold(0.0, f64::max);
    let plot = Plot { low, high, top: 100.0 * most * 1.05 };
    let mut svg =
        plot.frame("depth density in the box, % of its known pixels in each bin", "depth, m");
    let interval = histogram.interval();
    for (near, far, color) in [
        (f64::from(gate.near), f64::from(gate.far), "#fdebd0"),
        (interval.near, interval.far, "#f8c471"),
    ] {
        let (near, far) = (plot.x(near.clamp(low, high)), plot.x(far.clamp(low, high)));
        let _ = writeln!(
            svg,
            "<rect x=\"{near:.1}\" y=\"{TOP}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{color}\"/>",
            far - near,
            SIZE.1 - TOP - BOTTOM
        );
    }
    for (index, share) in histogram.shares().iter().enumerate() {
        let (left, right) = (plot.x(histogram.edge(index)), plot.x(histogram.edge(index + 1)));
        let y = plot.y(100.0 * share);
        let _ = writeln!(
            svg,
            "<rect x=\"{left:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"#85929e\"/>",
            (right - left - 1.0).max(0.5),
            SIZE.1 - BOTTOM - y
        );
    }
    let line: Vec<String> = (0..bins)
        .zip(smooth())
        .map(|(i, v)| format!("{:.1},{:.1}", plot.x(histogram.center(i)), plot.y(100.0 * v)))
        .collect();
    let _ = writeln!(
        svg,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"#2471a3\" stroke-width=\"1.6\"/>",
        line.join(" ")
    );
    let peak = plot.x(histogram.center(histogram.peak()));
    let _ = writeln!(
        svg,
        "<path d=\"M{peak:.1} {TOP}V{:.1}\" stroke=\"#c0392b\" stroke-width=\"1.6\" stroke-dasharray=\"5 3\"/>",
        SIZE.1 - BOTTOM
    );
    let mut legend = SIZE.0 - RIGHT;
    for (name, color) in [
        ("sigma rule", "#f5cba7"),
        ("interval", "#f39c12"),
        ("smoothed", "#2471a3"),
        ("peak", "#c0392b"),
    ] {
        legend = label(&mut svg, legend, name, color);
    }
    svg.push_str("</svg>\n");
    svg
}

/// Writes a name at the upper right, left of `right`; gives the room left over.
fn label(svg: &mut String, right: f64, name: &str, color: &str) -> f64 {
    let _ = writeln!(
        svg,
        "<text x=\"{right:.1}\" y=\"18\" text-anchor=\"end\" font-size=\"14\" font-weight=\"600\" \
         fill=\"{color}\">{name}</text>"
    );
    right - 8.8 * name.len() as f64 - 18.0
}

/// Where values are on a chart.
struct Plot {
    low: f64,
    high: f64,
    top: f64,
}

impl Plot {
    fn x(&self, value: f64) -> f64 {
        LEFT + (value - self.low) / (self.high - self.low) * (SIZE.0 - LEFT - RIGHT)
    }

    fn y(&self, value: f64) -> f64 {
        let share = (value / self.top).clamp(0.0, 1.0);
        SIZE.1 - BOTTOM - share * (SIZE.1 - TOP - BOTTOM)
    }

    /// Title, axes and ticks.
    fn frame(&self, title: &str, axis: &str) -> String {
        let (width, height) = SIZE;
        let mut svg = format!(
            "<svg viewBox=\"0 0 {width} {height}\" font-family=\"system-ui, sans-serif\">\
             <text x=\"{LEFT}\" y=\"18\" font-size=\"15\">{title}</text>\n"
        );
        let up = step(self.top);
        for value in ticks(0.0, self.top * 1.0001, up) {
            let y = self.y(value);
            let _ = writeln!(
                svg,
                "<path d=\"M{LEFT} {y:.1}H{:.1}\" stroke=\"#e3e3e0\"/><text x=\"{:.1}\" y=\"{:.1}\" \
                 text-anchor=\"end\" font-size=\"12\" fill=\"#555\">{}</text>",
                width - RIGHT,
                LEFT - 6.0,
                y + 4.0,
                number(value, up)
            );
        }
        let across = step(self.high - self.low);
        for value in ticks(self.low, self.high, across) {
            let x = self.x(value);
            let _ = writeln!(
                svg,
                "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-size=\"12\" fill=\"#555\">{}</text>",
                height - BOTTOM + 16.0,
                number(value, across)
            );
        }
        let _ = writeln!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" font-size=\"12\" fill=\"#555\">{axis}</text>",
            width - RIGHT,
            height - 3.0
        );
        svg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_broken_where_a_value_is_missing() {
        let points = vec![(1.0, Some(2.0)), (2.0, None), (3.0, Some(1.0)), (4.0, Some(1.5))];
        let svg = Chart::new("title", "frame").line("name", "red", points).svg();
        let path = svg.split("<path d=\"").find(|p| p.contains("stroke=\"red\"")).unwrap();
        assert_eq!(path.split('"').next().unwrap().matches(['M', 'L']).collect::<String>(), "MML");
        assert!(!Chart::new("title", "frame").svg().contains("NaN"), "no points at all");
    }
}
