//! Pictures of the curves, of the confusion matrix and of a training, drawn into memory.

mod curves;
mod history;
mod matrix;

pub use curves::{f1_curve, pr_curve, precision_curve, recall_curve};
pub use history::{Panel, Series, history_plot};
pub use matrix::confusion_plot;

use plotters::prelude::*;
use plotters::style::register_font;
use realnet_core::{Frame, FrameError, Stamp};
use thiserror::Error;

/// Why a plot could not be drawn.
#[derive(Debug, Error)]
pub enum PlotError {
    /// The built-in font was refused.
    #[error("the built-in font for plots cannot be read")]
    Font,
    /// Drawing failed.
    #[error("a plot of {width}x{height} pixels cannot be drawn: {reason}")]
    Draw {
        /// Pixels a row.
        width: u32,
        /// Rows.
        height: u32,
        /// What the drawing library says.
        reason: String,
    },
    /// The picture makes no frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
}

const FONT: &str = "realnet-plots";
const INK: RGBColor = RGBColor(38, 43, 51);
const GRID: RGBColor = RGBColor(226, 229, 234);
const ACCENT: RGBColor = RGBColor(22, 74, 166);

/// Fine pixels a pixel and direction: pictures are drawn larger and averaged,
/// since thick lines are drawn without smooth edges and letters are placed on
/// whole pixels.
const FINE: u32 = 2;

/// Fine pixels of so many pixels.
const fn px(pixels: i32) -> i32 {
    pixels * FINE as i32
}

/// Draws a white picture of `width` x `height` pixels by `paint`, which sees
/// fine pixels.
fn draw<F>(width: u32, height: u32, paint: F) -> Result<Frame, PlotError>
where
    F: FnOnce(&Canvas<'_>) -> Result<(), String>,
{
    register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
        .map_err(|_| PlotError::Font)?;
    let (wide, high) = (width * FINE, height * FINE);
    let mut pixels = vec![255u8; wide as usize * high as usize * 3];
    let fail = |reason| PlotError::Draw { width, height, reason };
    {
        let canvas = BitMapBackend::with_buffer(&mut pixels, (wide, high)).into_drawing_area();
        paint(&canvas).map_err(fail)?;
        canvas.present().map_err(|e| fail(e.to_string()))?;
    }
    Ok(Frame::rgb8(Stamp::ZERO, width, height, averaged(&pixels, wide as usize))?)
}

/// The picture of the averages of each square of `FINE` x `FINE` fine pixels;
/// `wide` fine pixels make a row.
fn averaged(pixels: &[u8], wide: usize) -> Vec<u8> {
    let fine = FINE as usize;
    let mut averages = Vec::with_capacity(pixels.len() / (fine * fine));
    let mut sums = vec![0u32; wide / fine * 3];
    for rows in pixels.chunks_exact((wide * 3 * fine).max(1)) {
        sums.fill(0);
        for row in rows.chunks_exact(wide * 3) {
            for (square, sums) in row.chunks_exact(3 * fine).zip(sums.chunks_exact_mut(3)) {
                for pixel in square.chunks_exact(3) {
                    for (sum, &value) in sums.iter_mut().zip(pixel) {
                        *sum += u32::from(value);
                    }
                }
            }
        }
        let count = FINE * FINE;
        averages.extend(sums.iter().map(|sum| ((sum + count / 2) / count) as u8));
    }
    averages
}

type Canvas<'a> = DrawingArea<BitMapBackend<'a>, plotters::coord::Shift>;

/// A font of the plots; `size` in pixels, not fine ones.
fn font(size: u32) -> FontDesc<'static> {
    FontDesc::new(FontFamily::Name(FONT), f64::from(size * FINE), FontStyle::Normal)
}

/// Width of a text in pixels, rounded up.
fn width_of(text: &str, size: u32) -> u32 {
    font(size).box_size(text).map_or(0, |(width, _)| width.div_ceil(FINE))
}

/// The text, cut with an ellipsis to fit into `width` pixels; control
/// characters become spaces.
fn fitted(text: &str, size: u32, width: u32) -> String {
    let mut kept: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    if width_of(&kept, size) <= width {
        return kept;
    }
    while kept.pop().is_some() {
        let cut = format!("{}…", kept.trim_end());
        if width_of(&cut, size) <= width {
            return cut;
        }
    }
    String::new()
}

/// Text at a point, in fine pixels.
fn write(
    canvas: &Canvas<'_>,
    text: &str,
    at: (i32, i32),
    style: &TextStyle<'_>,
) -> Result<(), String> {
    canvas.draw(&Text::new(text.to_owned(), at, style.clone())).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_are_cut_to_the_width() {
        draw(10, 10, |_| Ok(())).unwrap();
        let name = "a very long class name that goes on";
        let cut = fitted(name, 20, 120);
        assert!(cut.ends_with('…') && width_of(&cut, 20) <= 120, "{cut}");
        assert_eq!(fitted(name, 20, 1000), name);
        assert_eq!(fitted(name, 20, 1), "");
        assert_eq!(fitted("a\nb", 20, 100), "a b");
    }

    #[test]
    fn squares_are_averaged() {
        // 4x2 fine pixels: black and white stripes, then grey.
        let row = [[0; 3], [255; 3], [10, 20, 30], [10, 20, 30]].concat();
        let pixels = [row.clone(), row].concat();
        assert_eq!(averaged(&pixels, 4), [128, 128, 128, 10, 20, 30]);
        assert!(averaged(&[], 0).is_empty());
    }

    #[test]
    fn failures_are_passed_on() {
        let error = draw(10, 10, |_| Err("no ink".to_owned())).unwrap_err();
        assert_eq!(error.to_string(), "a plot of 10x10 pixels cannot be drawn: no ink");
        assert!(matches!(draw(0, 10, |_| Ok(())), Err(PlotError::Frame(_))));
    }
}
