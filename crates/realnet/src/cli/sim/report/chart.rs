//! Charts as inline SVG: each twice, for a page and for a phone, so that letters
//! have the same size on both; colours are classes of the page's style sheet.

use crate::cli::html::escape;
use crate::cli::ticks;
use std::fmt::Write as _;

/// The two widths of every drawing, with the class that shows and hides it.
pub(super) const WIDTHS: [(f64, &str); 2] = [(960.0, "wide"), (400.0, "narrow")];

/// Room for the numbers at the left, for air at the other sides and for the numbers
/// below.
pub(super) const LEFT: f64 = 60.0;
pub(super) const RIGHT: f64 = 14.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 38.0;

/// The axis of charts over time.
pub(super) const TIME: &str = "time, s";

/// A line may be this far from where its points are, in pixels.
const SLACK: f64 = 0.25;

/// Values over a common axis.
pub(super) struct Chart {
    over_time: bool,
    title: &'static str,
    axes: [&'static str; 2],
    span: (f64, f64),
    height: f64,
    values: Vec<f64>,
    /// Values that the upright axis reaches if they are not far off.
    wishes: Vec<f64>,
    parts: Vec<Part>,
    shades: Vec<(f64, f64)>,
    note: Option<String>,
}

/// Something drawn on a chart and named in its legend.
struct Part {
    name: &'static str,
    /// What the style sheet calls its colour.
    color: &'static str,
    shape: Shape,
}

enum Shape {
    /// A line, broken where a value is missing.
    Line(&'static str, Vec<(f64, Option<f64>)>),
    /// An area between two values, broken as a line.
    Band(Vec<(f64, Option<(f64, f64)>)>),
    /// Rings.
    Rings(Vec<(f64, f64)>),
    /// Ticks on the lower axis.
    Ticks(Vec<f64>),
    /// Bars from 0: left, right, height.
    Bars(Vec<(f64, f64, f64)>),
}

impl Chart {
    /// A chart with the names of its two axes, values along the lower one from
    /// `span.0` to `span.1`.
    pub(super) fn new(title: &'static str, axes: [&'static str; 2], span: (f64, f64)) -> Self {
        let (low, high) = span;
        let span = if high > low { span } else { (low, low + 1.0) };
        let (parts, shades) = (Vec::new(), Vec::new());
        let over_time = axes[0] == TIME;
        let (values, wishes, note) = (Vec::new(), Vec::new(), None);
        Self { over_time, title, axes, span, height: 250.0, values, wishes, parts, shades, note }
    }

    /// Pixels from top to bottom.
    pub(super) fn height(mut self, height: f64) -> Self {
        self.height = height;
        self
    }

    /// The upright axis reaches this value.
    pub(super) fn reaching(mut self, value: f64) -> Self {
        self.values.extend(Some(value).filter(|value| value.is_finite()));
        self
    }

    /// A line in a colour and a `style`: `""`, `thin` or `dashed`. It is broken where a
    /// value is missing; without any value it is left out.
    pub(super) fn line(
        mut self,
        name: &'static str,
        color: &'static str,
        style: &'static str,
        points: impl Iterator<Item = (f64, Option<f64>)>,
    ) -> Self {
        let points: Vec<_> = points.map(|(x, y)| (x, y.filter(|y| y.is_finite()))).collect();
        if points.iter().any(|(_, y)| y.is_some()) {
            self.values.extend(points.iter().filter_map(|(_, y)| *y));
            self.parts.push(Part { name, color, shape: Shape::Line(style, points) });
        }
        self
    }

    /// An area between two values. The upright axis reaches it as far as the lines do not
    /// become flat by that.
    pub(super) fn band(
        mut self,
        name: &'static str,
        color: &'static str,
        points: impl Iterator<Item = (f64, Option<(f64, f64)>)>,
    ) -> Self {
        let finite = |(low, high): &(f64, f64)| low.is_finite() && high.is_finite();
        let points: Vec<_> = points.map(|(x, y)| (x, y.filter(finite))).collect();
        if points.iter().any(|(_, y)| y.is_some()) {
            self.wishes.extend(points.iter().filter_map(|(_, y)| *y).flat_map(|(a, b)| [a, b]));
            self.parts.push(Part { name, color, shape: Shape::Band(points) });
        }
        self
    }

    /// Rings around points.
    pub(super) fn rings(
        mut self,
        name: &'static str,
        color: &'static str,
        points: Vec<(f64, f64)>,
    ) -> Self {
        if !points.is_empty() {
            self.values.extend(points.iter().map(|(_, y)| *y).filter(|y| y.is_finite()));
            self.parts.push(Part { name, color, shape: Shape::Rings(points) });
        }
        self
    }

    /// Ticks on the lower axis.
    pub(super) fn ticks(
        mut self,
        name: &'static str,
        color: &'static str,
        places: Vec<f64>,
    ) -> Self {
        if !places.is_empty() {
            self.parts.push(Part { name, color, shape: Shape::Ticks(places) });
        }
        self
    }

    /// Bars from 0, each with its left and right edge and its height.
    pub(super) fn bars(
        mut self,
        name: &'static str,
        color: &'static str,
        bars: Vec<(f64, f64, f64)>,
    ) -> Self {
        if !bars.is_empty() {
            self.values.extend(bars.iter().map(|bar| bar.2).chain([0.0]));
            self.parts.push(Part { name, color, shape: Shape::Bars(bars) });
        }
        self
    }

    /// Grey backgrounds behind everything, from and to.
    pub(super) fn shaded(mut self, shades: &[(f64, f64)]) -> Self {
        self.shades = shades.to_vec();
        self
    }

    /// A sentence below the chart.
    pub(super) fn note(mut self, note: String) -> Self {
        self.note = Some(note);
        self
    }

    /// The chart as HTML; nothing, when it shows nothing.
    pub(super) fn html(&self) -> String {
        if self.parts.is_empty() {
            return String::new();
        }
        let mut html = format!("<figure><figcaption><h3>{}</h3>", escape(self.title));
        html.push_str("<ul class=\"legend\">");
        for part in &self.parts {
            let _ = write!(html, "<li>{}{}</li>", part.swatch(), escape(part.name));
        }
        html.push_str("</ul></figcaption>\n");
        for (width, class) in WIDTHS {
            self.draw(&mut html, width, class);
        }
        if let Some(note) = &self.note {
            let _ = writeln!(html, "<p class=\"note\">{}</p>", escape(note));
        }
        html.push_str("</figure>\n");
        html
    }

    fn draw(&self, svg: &mut String, width: f64, class: &str) {
        let (low, high) = self.reach();
        let plot = Plot {
            x: Scale { low: self.span.0, high: self.span.1, from: LEFT, to: width - RIGHT },
            y: Scale { low, high, from: self.height - BOTTOM, to: TOP },
        };
        let title = escape(self.title);
        let height = self.height;
        let _ = write!(
            svg,
            "<svg class=\"{class}\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
             aria-label=\"{title}\""
        );
        if self.over_time {
            let frame =
                Frame { left: LEFT, right: width - RIGHT, top: TOP, bottom: height - BOTTOM };
            svg.push_str(&frame.attributes(self.span, Some((low, high))));
        }
        svg.push_str(
            ">
",
        );
        for (from, to) in &self.shades {
            let (left, right) = (plot.x.at(*from), plot.x.at(*to));
            let _ = write!(
                svg,
                "<rect class=\"shade\" x=\"{left:.1}\" y=\"{TOP}\" width=\"{:.1}\" height=\"{:.1}\"/>",
                (right - left).max(1.0),
                height - TOP - BOTTOM
            );
        }
        plot.axes(svg, self.axes);
        for part in &self.parts {
            part.draw(svg, &plot);
        }
        svg.push_str("</svg>\n");
    }

    /// The ends of the upright axis.
    fn reach(&self) -> (f64, f64) {
        let values = || self.values.iter().copied();
        match (values().reduce(f64::min), values().reduce(f64::max)) {
            (Some(low), Some(high)) if high - low > 1e-9 => {
                let air = 0.05 * (high - low);
                let most = 0.3 * (high - low);
                let wish = |from, better: fn(f64, f64) -> f64| {
                    self.wishes.iter().copied().fold(from, better)
                };
                let (low, high) =
                    (wish(low, f64::min).max(low - most), wish(high, f64::max).min(high + most));
                // Nothing is below a ground of 0.
                (if low == 0.0 { 0.0 } else { low - air }, high + air)
            }
            (Some(low), _) => (low - 0.5, low + 0.5),
            _ => (0.0, 1.0),
        }
    }
}

impl Part {
    /// What it looks like, for the legend.
    fn swatch(&self) -> String {
        let shape = match &self.shape {
            Shape::Line(style, _) => format!("<path class=\"line {style}\" d=\"M0 6H22\"/>"),
            Shape::Band(_) => "<rect class=\"band\" width=\"22\" height=\"12\"/>".to_owned(),
            Shape::Rings(_) => "<circle class=\"ring\" cx=\"11\" cy=\"6\" r=\"3.2\"/>".to_owned(),
            Shape::Ticks(_) => "<path class=\"tick\" d=\"M11 1V11\"/>".to_owned(),
            Shape::Bars(_) => "<rect class=\"bar\" width=\"22\" height=\"12\"/>".to_owned(),
        };
        let color = self.color;
        format!(
            "<svg class=\"swatch {color}\" viewBox=\"0 0 22 12\" aria-hidden=\"true\">{shape}</svg>"
        )
    }

    fn draw(&self, svg: &mut String, plot: &Plot) {
        let _ = write!(svg, "<g class=\"{}\">", self.color);
        match &self.shape {
            Shape::Line(style, points) => {
                let at = |(x, y): &(f64, Option<f64>)| Some((plot.x.at(*x), plot.y.at((*y)?)));
                let mut path = String::new();
                for run in points.chunk_by(|a, b| a.1.is_some() == b.1.is_some()) {
                    trace(&mut path, &thinned(&run.iter().filter_map(at).collect::<Vec<_>>()), 'M');
                }
                let name = escape(self.name);
                let _ =
                    write!(svg, "<path class=\"line {style}\" data-name=\"{name}\" d=\"{path}\"/>");
            }
            Shape::Band(points) => {
                let mut path = String::new();
                for run in points.chunk_by(|a, b| a.1.is_some() == b.1.is_some()) {
                    let edge = |side: fn((f64, f64)) -> f64| -> Vec<(f64, f64)> {
                        let at = |(x, y): &(f64, Option<(f64, f64)>)| {
                            Some((plot.x.at(*x), plot.y.at(side((*y)?))))
                        };
                        thinned(&run.iter().filter_map(at).collect::<Vec<_>>())
                    };
                    let (lower, mut upper) = (edge(|y| y.0), edge(|y| y.1));
                    upper.reverse();
                    if !lower.is_empty() {
                        trace(&mut path, &lower, 'M');
                        trace(&mut path, &upper, 'L');
                        path.push('Z');
                    }
                }
                let _ = write!(svg, "<path class=\"band\" d=\"{path}\"/>");
            }
            Shape::Rings(points) => {
                for (x, y) in points {
                    let (x, y) = (plot.x.at(*x), plot.y.at(*y));
                    let _ = write!(
                        svg,
                        "<circle class=\"ring\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.2\"/>"
                    );
                }
            }
            Shape::Ticks(places) => {
                let mut path = String::new();
                for x in places {
                    let _ = write!(path, "M{:.1} {:.1}v-8", plot.x.at(*x), plot.y.from);
                }
                let _ = write!(svg, "<path class=\"tick\" d=\"{path}\"/>");
            }
            Shape::Bars(bars) => {
                for (left, right, value) in bars {
                    let (left, right) = (plot.x.at(*left), plot.x.at(*right));
                    let (top, bottom) = (plot.y.at(*value), plot.y.at(0.0));
                    let _ = write!(
                        svg,
                        "<rect class=\"bar\" x=\"{left:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
                        (right - left - 1.0).max(0.8),
                        bottom - top
                    );
                }
            }
        }
        svg.push_str("</g>\n");
    }
}

/// The edges of a plot over time, for the cross hair.
pub(super) struct Frame {
    pub(super) left: f64,
    pub(super) right: f64,
    pub(super) top: f64,
    pub(super) bottom: f64,
}

impl Frame {
    /// Attributes of the drawing: its edges, and the times and values at them.
    pub(super) fn attributes(&self, time: (f64, f64), values: Option<(f64, f64)>) -> String {
        let Self { left, right, top, bottom } = self;
        let values = values.map(|(low, high)| format!(" data-values=\"{low:.6} {high:.6}\""));
        format!(
            " data-frame=\"{left} {right} {top} {bottom}\" data-time=\"{:.4} {:.4}\"{}",
            time.0,
            time.1,
            values.unwrap_or_default()
        )
    }
}

/// Where the values of an axis are.
pub(super) struct Scale {
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) from: f64,
    pub(super) to: f64,
}

impl Scale {
    /// The place of a value; what is beyond an end is at the end.
    pub(super) fn at(&self, value: f64) -> f64 {
        let share = ((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0);
        self.from + share * (self.to - self.from)
    }
}

struct Plot {
    x: Scale,
    y: Scale,
}

impl Plot {
    /// Grid, numbers and names of the axes.
    fn axes(&self, svg: &mut String, [across, up]: [&str; 2]) {
        let Self { x, y } = self;
        let step = ticks::step(y.high - y.low);
        for value in ticks::ticks(y.low, y.high, step) {
            let at = y.at(value);
            let zero = if value.abs() < 1e-9 { " zero" } else { "" };
            let _ = write!(
                svg,
                "<path class=\"grid{zero}\" d=\"M{:.1} {at:.1}H{:.1}\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                x.from,
                x.to,
                x.from - 7.0,
                at + 4.0,
                ticks::number(value, step)
            );
        }
        time_axis(svg, x, y.from, across);
        let middle = 0.5 * (y.from + y.to);
        let _ = writeln!(
            svg,
            "<text transform=\"translate(11 {middle:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            escape(up)
        );
    }
}

/// The lower axis with its numbers and name.
pub(super) fn time_axis(svg: &mut String, x: &Scale, bottom: f64, name: &str) {
    let step = ticks::step(x.high - x.low);
    let _ = write!(svg, "<path class=\"axis\" d=\"M{:.1} {bottom:.1}H{:.1}\"/>", x.from, x.to);
    for value in ticks::ticks(x.low, x.high, step) {
        let at = x.at(value);
        let _ = write!(
            svg,
            "<path class=\"axis\" d=\"M{at:.1} {bottom:.1}v4\"/>\
             <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            bottom + 17.0,
            ticks::number(value, step)
        );
    }
    let _ = writeln!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
        0.5 * (x.from + x.to),
        bottom + 33.0,
        escape(name)
    );
}

/// Appends points to a path; the pen goes to the first by `pen`.
pub(super) fn trace(path: &mut String, points: &[(f64, f64)], pen: char) {
    let mut pen = pen;
    for (x, y) in points {
        let _ = write!(path, "{pen}{} {}", short(*x), short(*y));
        pen = 'L';
    }
}

/// A tenth of a pixel, without a needless zero.
fn short(value: f64) -> String {
    let text = format!("{value:.1}");
    text.strip_suffix(".0").map_or_else(|| text.clone(), str::to_owned)
}

/// The points, by rising x, without those that a straight line passes by less than
/// [`SLACK`]: each kept point opens a sleeve that the following ones narrow, until one
/// is outside of it.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let Some(&first) = points.first() else { return Vec::new() };
    let mut kept = vec![first];
    let (mut from, mut last) = (first, first);
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for &point in points.iter().skip(1) {
        let slope = |y: f64| (y - from.1) / (point.0 - from.0).max(1e-9);
        let own = slope(point.1);
        if own < low || own > high {
            kept.push(last);
            from = last;
            (low, high) = (f64::NEG_INFINITY, f64::INFINITY);
        }
        let slope = |y: f64| (y - from.1) / (point.0 - from.0).max(1e-9);
        low = low.max(slope(point.1 - SLACK));
        high = high.min(slope(point.1 + SLACK));
        last = point;
    }
    if points.len() > 1 {
        kept.push(last);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paths(html: &str) -> Vec<&str> {
        let lines = html.split("<path class=\"line ").skip(1);
        lines.filter_map(|p| p.split(" d=\"").nth(1)?.split('"').next()).collect()
    }

    #[test]
    fn a_line_is_broken_where_a_value_is_missing() {
        let points = [Some(2.0), None, Some(1.0), Some(f64::NAN), Some(3.0), Some(1.0)];
        let points = (0..).map(f64::from).zip(points);
        let html = Chart::new("t", ["s", "m"], (0.0, 5.0)).line("a", "truth", "", points).html();
        let paths = paths(&html);
        // the legend's, the wide and the narrow one
        assert_eq!(paths.len(), 3, "{html}");
        let pens = |path: &str| path.matches(['M', 'L']).collect::<String>();
        assert_eq!([pens(paths[1]), pens(paths[2])], ["MMML", "MMML"]);
    }

    #[test]
    fn what_is_not_finite_is_not_drawn() {
        let chart = Chart::new("a < b", ["s", "m"], (0.0, 0.0))
            .line("a", "truth", "", [(0.0, Some(f64::INFINITY)), (1.0, None)].into_iter())
            .band("b", "fused", [(0.0, Some((f64::NAN, 1.0)))].into_iter())
            .rings("c", "fast", Vec::new())
            .reaching(f64::NAN);
        assert_eq!(chart.html(), "");
        let html = chart.ticks("c < d", "fast", vec![0.5]).html();
        assert!(!html.contains("NaN") && !html.contains("inf"), "{html}");
        assert!(html.contains("a &lt; b") && html.matches("<li>").count() == 1, "{html}");
    }

    #[test]
    fn thinning_keeps_the_shape() {
        let points: Vec<(f64, f64)> =
            (0..2000).map(|i| 0.4 * f64::from(i)).map(|x| (x, 100.0 * (x / 60.0).sin())).collect();
        let kept = thinned(&points);
        assert!(kept.len() < 300, "{} of {}", kept.len(), points.len());
        assert_eq!((kept.first(), kept.last()), (points.first(), points.last()));
        for (x, y) in &points {
            let after = kept.iter().position(|k| k.0 >= *x).unwrap().max(1);
            let (a, b) = (kept[after - 1], kept[after]);
            let line = a.1 + (b.1 - a.1) * (x - a.0) / (b.0 - a.0);
            assert!((line - y).abs() < SLACK + 1e-9, "{x}: {line} for {y}");
        }
        // A step stays upright.
        let step: Vec<_> =
            (0..40).map(|i| (f64::from(i), if i < 20 { 0.0 } else { 50.0 })).collect();
        assert_eq!(thinned(&step), [(0.0, 0.0), (19.0, 0.0), (20.0, 50.0), (39.0, 50.0)]);
        assert_eq!(thinned(&points[..1]), points[..1]);
    }

    #[test]
    fn the_upright_axis_holds_all_lines_and_a_band_that_is_not_far_off() {
        let chart = Chart::new("t", ["s", "m"], (0.0, 1.0))
            .line("a", "fused", "", [(0.0, Some(1.0)), (1.0, Some(3.0))].into_iter())
            .band("b", "fused", [(0.0, Some((-50.0, 50.0)))].into_iter());
        let (low, high) = chart.reach();
        assert!((low - 0.3).abs() < 1e-12 && (high - 3.7).abs() < 1e-12, "{low} {high}");
        let chart = Chart::new("t", ["s", "m"], (0.0, 1.0))
            .line("a", "fused", "", [(0.0, Some(0.0)), (1.0, Some(3.0))].into_iter())
            .band("b", "fused", [(0.0, Some((0.5, 3.2)))].into_iter());
        let (low, high) = chart.reach();
        assert!(low == 0.0 && (high - 3.35).abs() < 1e-12, "{low} {high}");
    }
}
