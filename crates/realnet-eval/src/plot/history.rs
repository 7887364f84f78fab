//! How a training went: lines over its epochs, in panels side by side.

use super::curves::hue;
use super::{ACCENT, Canvas, FINE, GRID, INK, PlotError, draw, fitted, font, px, width_of, write};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use realnet_core::Frame;

const WIDTH: u32 = 1440;
/// Height of a row of panels.
const ROW: u32 = 420;
/// Panels side by side.
const COLUMNS: usize = 3;
/// Height of a panel's title.
const TITLE: i32 = 46;
const TEXT: u32 = 18;
const NAME: u32 = 22;

/// A line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Its name.
    pub name: String,
    /// Its points, from left to right. What is not finite leaves a gap.
    pub points: Vec<(f64, f64)>,
}

/// Lines with one scale.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    /// What they are.
    pub title: String,
    /// The lines. Several ones are told apart by colour, and named.
    pub series: Vec<Series>,
}

/// Panels side by side, three in a row, each with a scale of its own and the last value of
/// each line; 1440 pixels wide, 420 high for each row, RGB. `x` is the name of the axis that
/// they share.
///
/// # Errors
/// [`PlotError`] when drawing fails.
pub fn history_plot(x: &str, panels: &[Panel]) -> Result<Frame, PlotError> {
    let rows = panels.len().div_ceil(COLUMNS).max(1);
    draw(WIDTH, ROW * rows as u32, |canvas| {
        for (area, panel) in canvas.split_evenly((rows, COLUMNS)).iter().zip(panels) {
            let (title, chart) = area.split_vertically(px(TITLE));
            panel.title(&title)?;
            panel.lines(&chart, x).map_err(|e| e.to_string())?;
        }
        Ok(())
    })
}

/// Least and largest of the finite values, apart from each other.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let finite = values.filter(|value| value.is_finite());
    let (least, most) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| {
        (least.min(value), most.max(value))
    });
    match most - least {
        apart if apart > 0.0 && apart.is_finite() => (least, most),
        _ if least.is_finite() && most.is_finite() && least != 0.0 => {
            let half = 0.5 * least.abs();
            (least - half, least + half)
        }
        _ => (0.0, 1.0),
    }
}

/// A number of an axis whose numbers lie `step` apart.
fn number(value: f64, step: f64) -> String {
    // What is left of 0 after additions.
    let value = if value.abs() < 1e-6 * step { 0.0 } else { value };
    let decimals = (-step.log10()).ceil().max(0.0);
    if decimals > 4.0 || value.abs() >= 1e6 {
        let digits = (value.abs().log10().floor() - step.log10().floor()).clamp(0.0, 8.0);
        return if value == 0.0 {
            "0".to_owned()
        } else {
            format!("{value:.0$e}", digits as usize)
        };
    }
    format!("{value:.0$}", decimals as usize)
}

/// A figure beside a name.
fn figure(value: f64) -> String {
    let small = value != 0.0 && value.abs() < 1e-3;
    if small || value.abs() >= 1e4 { format!("{value:.2e}") } else { format!("{value:.4}") }
}

impl Panel {
    fn color(&self, index: usize) -> RGBColor {
        if self.series.len() == 1 { ACCENT } else { hue(index) }
    }

    /// The title, and to its right each line's name and last value.
    fn title(&self, canvas: &Canvas<'_>) -> Result<(), String> {
        let middle = px(TITLE / 2 + 4);
        let start = font(NAME).color(&INK).pos(Pos::new(HPos::Left, VPos::Center));
        let end = Pos::new(HPos::Right, VPos::Center);
        let mut right = (WIDTH as usize / COLUMNS) as i32 - 22;
        let left = 30;
        let title = fitted(&self.title, NAME, (right - left) as u32 / 2);
        let least = left + width_of(&title, NAME) as i32 + 12;
        write(canvas, &title, (px(left), middle), &start)?;
        for (index, series) in self.series.iter().enumerate().rev() {
            let Some((_, value)) = series.points.last() else { continue };
            let name = if self.series.len() == 1 { "" } else { series.name.as_str() };
            let text = format!("{name} {}", figure(*value));
            let text = fitted(text.trim(), TEXT, (right - least).max(0) as u32);
            let style = font(TEXT).color(&self.color(index)).pos(end);
            write(canvas, &text, (px(right), middle), &style)?;
            right -= width_of(&text, TEXT) as i32 + 16;
        }
        Ok(())
    }

    fn lines(&self, canvas: &Canvas<'_>, x: &str) -> Result<(), Box<dyn std::error::Error>> {
        let points = || self.series.iter().flat_map(|series| &series.points);
        let across = range(points().map(|point| point.0));
        let (low, high) = range(points().map(|point| point.1));
        let margin = 0.04 * (high - low);
        let mut chart = ChartBuilder::on(canvas)
            .margin_top(px(4))
            .margin_right(px(22))
            .margin_bottom(px(8))
            .margin_left(px(8))
            .x_label_area_size(px(52))
            .y_label_area_size(px(72))
            .build_cartesian_2d(across.0..across.1, low - margin..high + margin)?;
        let step = (high - low) / 10.0;
        chart
            .configure_mesh()
            .x_labels(6)
            .y_labels(6)
            // Between two epochs is none.
            .x_label_formatter(&|v| {
                if (v - v.round()).abs() < 1e-6 { format!("{v:.0}") } else { String::new() }
            })
            .y_label_formatter(&|v| number(*v, step))
            .set_all_tick_mark_size(px(5))
            .x_desc(x)
            .label_style(font(TEXT).color(&INK))
            .axis_desc_style(font(TEXT).color(&INK))
            .axis_style(INK.stroke_width(FINE))
            .bold_line_style(GRID.stroke_width(FINE))
            .light_line_style(WHITE)
            .max_light_lines(1)
            .draw()?;
        for (index, series) in self.series.iter().enumerate() {
            let color = self.color(index);
            for run in series.points.split(|point| !(point.0.is_finite() && point.1.is_finite())) {
                match run {
                    // A line needs two.
                    [point] => {
                        chart.draw_series([Circle::new(*point, px(5), color.filled())])?;
                    }
                    run => {
                        let style = color.stroke_width(3 * FINE);
                        chart.draw_series(LineSeries::new(run.iter().copied(), style))?;
                    }
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(names: &[&str], points: &[(f64, f64)]) -> Panel {
        let series = names
            .iter()
            .enumerate()
            .map(|(up, name)| Series {
                name: (*name).to_owned(),
                points: points.iter().map(|(x, y)| (*x, y + up as f64)).collect(),
            })
            .collect();
        Panel { title: "a title".to_owned(), series }
    }

    fn count(frame: &Frame, color: RGBColor) -> usize {
        frame.data().chunks_exact(3).filter(|p| *p == [color.0, color.1, color.2]).count()
    }

    #[test]
    fn lines_are_drawn_in_their_colours() {
        let points: Vec<_> = (1..=20).map(|i| (f64::from(i), 1.0 / f64::from(i))).collect();
        let one = history_plot("epoch", &[panel(&["a"], &points)]).unwrap();
        assert_eq!((one.width(), one.height()), (WIDTH, ROW));
        assert!(count(&one, ACCENT) > 500 && count(&one, hue(0)) == 0);
        let two = history_plot("epoch", &vec![panel(&["a", "b"], &points); 4]).unwrap();
        assert_eq!((two.width(), two.height()), (WIDTH, 2 * ROW));
        assert!(count(&two, hue(0)) > 500 && count(&two, hue(1)) > 500);
        assert_eq!(count(&two, ACCENT), 0);
    }

    #[test]
    fn whatever_the_numbers_are_there_is_a_picture() {
        let nan = f64::NAN;
        for points in [
            vec![],
            vec![(1.0, 0.5)],
            vec![(1.0, 0.0)],
            vec![(1.0, nan)],
            vec![(1.0, 2.0), (2.0, nan), (3.0, 4.0), (4.0, 5.0)],
            vec![(1.0, 2.0), (2.0, f64::INFINITY)],
            vec![(1.0, -1e300), (2.0, 1e300)],
            vec![(1.0, 1e-12), (2.0, 2e-12)],
        ] {
            history_plot("epoch", &[panel(&["a", "b"], &points)]).unwrap();
        }
        // A single point is seen.
        let dot = history_plot("epoch", &[panel(&["a"], &[(1.0, 0.5)])]).unwrap();
        assert!(count(&dot, ACCENT) > 50);
        history_plot("epoch", &[]).unwrap();
    }

    #[test]
    fn numbers_have_the_decimals_of_their_axis() {
        assert_eq!(number(0.25, 0.05), "0.25");
        assert_eq!(number(10.0, 5.0), "10");
        assert_eq!(number(0.001, 0.0002), "0.0010");
        assert_eq!(number(0.0, 1e-6), "0");
        assert_eq!(number(1e-25, 1e-6), "0");
        assert_eq!(number(2e-5, 1e-6), "2.0e-5");
        assert_eq!(number(8.25e-4, 1e-6), "8.25e-4");
        assert_eq!(figure(0.5), "0.5000");
        assert_eq!(figure(1e-5), "1.00e-5");
    }
}
