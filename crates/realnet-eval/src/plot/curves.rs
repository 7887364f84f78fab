//! Curves: precision, recall and F1 against confidence, precision against recall.

use super::{ACCENT, Canvas, FINE, GRID, INK, PlotError, draw, fitted, font, px, width_of, write};
use crate::coco::{AreaRange, CocoSummary};
use crate::curves::{ClassCurves, ConfidenceCurves};
use crate::report::name_of;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use realnet_core::Frame;
use std::collections::BTreeMap;

const WIDTH: u32 = 1280;
const HEIGHT: u32 = 860;
/// Height of the title.
const TITLE: i32 = 64;
/// Width of the legend.
const LEGEND: i32 = 330;
const TEXT: u32 = 22;
/// With more classes than this the single ones are grey and without a name.
const NAMED: usize = 20;

/// Ten hues that stay apart for most kinds of colour vision, then the same darker.
const HUES: [RGBColor; 10] = [
    RGBColor(230, 97, 1),
    RGBColor(0, 158, 115),
    RGBColor(204, 60, 140),
    RGBColor(86, 180, 233),
    RGBColor(214, 158, 0),
    RGBColor(120, 84, 200),
    RGBColor(140, 86, 75),
    RGBColor(120, 170, 40),
    RGBColor(214, 39, 40),
    RGBColor(110, 120, 130),
];

pub(super) fn hue(position: usize) -> RGBColor {
    let base = HUES.get(position % HUES.len()).copied().unwrap_or(INK);
    if position < HUES.len() {
        return base;
    }
    let dark = |v: u8| (f32::from(v) * 0.55) as u8;
    RGBColor(dark(base.0), dark(base.1), dark(base.2))
}

/// One line of a plot.
struct Line {
    /// Name and, apart from it so that it is never cut, a figure.
    name: String,
    figure: String,
    points: Vec<(f64, f64)>,
}

struct Plot<'a> {
    title: &'a str,
    x: &'a str,
    y: &'a str,
    classes: Vec<Line>,
    mean: Option<Line>,
    /// A point of the mean to be marked.
    mark: Option<(f64, f64)>,
}

impl Plot<'_> {
    fn draw(&self) -> Result<Frame, PlotError> {
        draw(WIDTH, HEIGHT, |canvas| {
            let (title, rest) = canvas.split_vertically(px(TITLE));
            let (chart, legend) = rest.split_horizontally(px(WIDTH as i32 - LEGEND));
            let centre = Pos::new(HPos::Left, VPos::Center);
            let style = font(32).color(&INK).pos(centre);
            write(&title, self.title, (px(92), px(TITLE / 2 + 2)), &style)?;
            self.lines(&chart).map_err(|e| e.to_string())?;
            self.legend(&legend)
        })
    }

    fn lines(&self, canvas: &Canvas<'_>) -> Result<(), Box<dyn std::error::Error>> {
        let mut chart = ChartBuilder::on(canvas)
            .margin_top(px(10))
            .margin_right(px(24))
            .margin_bottom(px(14))
            .margin_left(px(10))
            .x_label_area_size(px(64))
            .y_label_area_size(px(82))
            .build_cartesian_2d(0.0..1.0f64, 0.0..1.0f64)?;
        chart
            .configure_mesh()
            .x_labels(11)
            .y_labels(11)
            .x_label_formatter(&|v| format!("{v:.1}"))
            .y_label_formatter(&|v| format!("{v:.1}"))
            .set_all_tick_mark_size(px(6))
            .x_desc(self.x)
            .y_desc(self.y)
            .label_style(font(TEXT).color(&INK))
            .axis_desc_style(font(26).color(&INK))
            .axis_style(INK.stroke_width(FINE))
            .bold_line_style(GRID.stroke_width(FINE))
            .light_line_style(WHITE)
            .max_light_lines(1)
            .draw()?;
        let many = self.classes.len() > NAMED;
        for (i, line) in self.classes.iter().enumerate() {
            let style = if many {
                RGBColor(150, 158, 170).mix(0.45).stroke_width(FINE)
            } else {
                hue(i).stroke_width(2 * FINE)
            };
            chart.draw_series(LineSeries::new(line.points.iter().copied(), style))?;
        }
        if let Some(mean) = &self.mean {
            let style = ACCENT.stroke_width(4 * FINE);
            chart.draw_series(LineSeries::new(mean.points.iter().copied(), style))?;
        }
        if let Some(point) = self.mark {
            chart.draw_series([Circle::new(point, px(9), WHITE.filled())])?;
            chart.draw_series([Circle::new(point, px(7), ACCENT.filled())])?;
        }
        Ok(())
    }

    fn legend(&self, canvas: &Canvas<'_>) -> Result<(), String> {
        let many = self.classes.len() > NAMED;
        let rows = self.mean.iter().map(|line| (line, ACCENT, 4)).chain(
            self.classes
                .iter()
                .take(if many { 0 } else { NAMED })
                .enumerate()
                .map(|(i, line)| (line, hue(i), 3)),
        );
        let (left, right) = (58, LEGEND - 18);
        let mut y = 28;
        let style = font(TEXT).color(&INK);
        let start = style.pos(Pos::new(HPos::Left, VPos::Center));
        let end = style.pos(Pos::new(HPos::Right, VPos::Center));
        for (line, color, stroke) in rows {
            let path = PathElement::new(
                vec![(px(12), px(y)), (px(44), px(y))],
                color.stroke_width(stroke * FINE),
            );
            canvas.draw(&path).map_err(|e| e.to_string())?;
            let room = (right - left) as u32;
            let room = room.saturating_sub(width_of(&line.figure, TEXT) + 14);
            write(canvas, &fitted(&line.name, TEXT, room), (px(left), px(y)), &start)?;
            write(canvas, &line.figure, (px(right), px(y)), &end)?;
            y += 34;
        }
        if many {
            let color = RGBColor(150, 158, 170);
            let path =
                PathElement::new(vec![(px(12), px(y)), (px(44), px(y))], color.stroke_width(FINE));
            canvas.draw(&path).map_err(|e| e.to_string())?;
            write(canvas, &format!("{} classes", self.classes.len()), (px(left), px(y)), &start)?;
        }
        Ok(())
    }
}

fn against_confidence(
    curves: &ConfidenceCurves,
    names: &BTreeMap<u32, String>,
    (title, y): (&str, &str),
    of_class: fn(&ClassCurves) -> &[f64],
    mean: &[f64],
    mark: bool,
) -> Result<Frame, PlotError> {
    let join = |values: &[f64]| -> Vec<(f64, f64)> {
        curves.confidences.iter().copied().zip(values.iter().copied()).collect()
    };
    let at_best =
        |values: &[f64]| values.get(curves.best).map_or_else(String::new, |v| format!("{v:.3}"));
    let line =
        |name: String, values: &[f64]| Line { name, figure: at_best(values), points: join(values) };
    let classes =
        curves.classes.iter().map(|c| line(name_of(names, c.category), of_class(c))).collect();
    let best = curves.confidences.get(curves.best).copied().zip(mean.get(curves.best).copied());
    let at = best.map_or_else(String::new, |(c, _)| format!(" (figures at {c:.3})"));
    Plot {
        title: &format!("{title}, IoU {}{at}", curves.iou_threshold),
        x: "confidence",
        y,
        classes,
        mean: (!mean.is_empty()).then(|| line("all classes".to_owned(), mean)),
        mark: best.filter(|_| mark),
    }
    .draw()
}

/// Precision against confidence, a line a class and a bold one for the mean;
/// 1280x860, RGB. The figures beside the names are those at the operating
/// point. With more than 20 classes the single ones are grey and unnamed.
///
/// # Errors
/// [`PlotError`] when drawing fails.
pub fn precision_curve(
    curves: &ConfidenceCurves,
    names: &BTreeMap<u32, String>,
) -> Result<Frame, PlotError> {
    let labels = ("Precision by confidence", "precision");
    against_confidence(curves, names, labels, |c| &c.precision, &curves.mean_precision, true)
}

/// Recall against confidence, otherwise as [`precision_curve`].
///
/// # Errors
/// [`PlotError`] when drawing fails.
pub fn recall_curve(
    curves: &ConfidenceCurves,
    names: &BTreeMap<u32, String>,
) -> Result<Frame, PlotError> {
    let labels = ("Recall by confidence", "recall");
    against_confidence(curves, names, labels, |c| &c.recall, &curves.mean_recall, true)
}

/// F1 against confidence, otherwise as [`precision_curve`].
///
/// # Errors
/// [`PlotError`] when drawing fails.
pub fn f1_curve(
    curves: &ConfidenceCurves,
    names: &BTreeMap<u32, String>,
) -> Result<Frame, PlotError> {
    let labels = ("F1 by confidence", "F1");
    against_confidence(curves, names, labels, |c| &c.f1, &curves.mean_f1, true)
}

/// Interpolated precision against recall at IoU 0.5 with the average precision
/// of each class, otherwise as [`precision_curve`]. Without the threshold 0.5 in
/// the options of `summary` it is drawn at the lowest there is.
///
/// # Errors
/// [`PlotError`] when drawing fails.
pub fn pr_curve(summary: &CocoSummary, names: &BTreeMap<u32, String>) -> Result<Frame, PlotError> {
    let options = summary.options();
    let threshold = summary.threshold_index(0.5).unwrap_or(0);
    let iou = options.iou_thresholds.get(threshold).copied().unwrap_or(0.5);
    let line = |name: String, precision: &[f64]| Line {
        name,
        figure: crate::coco::mean(precision.iter().copied())
            .map_or_else(String::new, |ap| format!("{ap:.3}")),
        points: options.recall_points.iter().copied().zip(precision.iter().copied()).collect(),
    };
    let curves: Vec<(u32, &[f64])> = summary
        .per_class
        .iter()
        .enumerate()
        .filter_map(|(k, c)| {
            Some((c.category, summary.precision(k, AreaRange::All, 2, threshold)?))
        })
        .collect();
    let mean: Vec<f64> = (0..options.recall_points.len())
        .filter_map(|i| crate::coco::mean(curves.iter().filter_map(|(_, c)| c.get(i).copied())))
        .collect();
    Plot {
        title: &format!("Precision and recall, IoU {iou:.2} (figures: average precision)"),
        x: "recall",
        y: "precision",
        classes: curves.iter().map(|(c, curve)| line(name_of(names, *c), curve)).collect(),
        mean: (!mean.is_empty()).then(|| line("all classes".to_owned(), &mean)),
        mark: None,
    }
    .draw()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CocoOptions, GroundTruth, Prediction, confidence_curves, evaluate};
    use realnet_core::BoundingBox;

    fn has(frame: &Frame, color: RGBColor) -> usize {
        frame.data().chunks_exact(3).filter(|p| *p == [color.0, color.1, color.2]).count()
    }

    #[test]
    fn plots_show_a_line_a_class_and_the_mean() {
        let names = BTreeMap::from([(0, "person".to_owned())]);
        let bbox = BoundingBox::new(0.0, 0.0, 10.0, 10.0);
        for classes in [0u32, 1, 3, 25] {
            let truth: Vec<_> = (0..classes).map(|c| GroundTruth::new(1, c, bbox)).collect();
            let found: Vec<_> = (0..classes)
                .map(|category| Prediction {
                    image_id: 1,
                    category,
                    bbox,
                    confidence: 0.3 + 0.02 * category as f32,
                })
                .collect();
            let summary = evaluate(&truth, &found, &CocoOptions::default()).unwrap();
            let curves = confidence_curves(&truth, &found, 0.5).unwrap();
            for frame in [
                precision_curve(&curves, &names).unwrap(),
                recall_curve(&curves, &names).unwrap(),
                f1_curve(&curves, &names).unwrap(),
                pr_curve(&summary, &names).unwrap(),
            ] {
                assert_eq!((frame.width(), frame.height()), (WIDTH, HEIGHT));
                assert_eq!(has(&frame, ACCENT) > 500, classes > 0);
                // The second class has a line in the legend unless there are too many.
                assert_eq!(has(&frame, hue(1)) > 30, classes == 3);
            }
        }
    }

    #[test]
    fn hues_differ() {
        let mut all: Vec<_> = (0..NAMED).map(|i| (hue(i).0, hue(i).1, hue(i).2)).collect();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), NAMED);
    }
}
