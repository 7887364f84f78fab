//! The confusion matrix as a picture.

use super::{Canvas, FINE, GRID, INK, PlotError, draw, fitted, font, px, width_of, write};
use crate::confusion::ConfusionMatrix;
use crate::report::name_of;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use realnet_core::Frame;
use std::collections::BTreeMap;

/// With more rows than this the cells show no numbers.
const NUMBERED: u32 = 26;
/// With more rows than this not every row has its name.
const ALL_NAMED: u32 = 120;

/// Measures of the picture, in pixels.
struct Layout {
    side: u32,
    cell: u32,
    text: u32,
    left: i32,
    top: i32,
    name_room: u32,
}

/// Shares of each true class that were predicted as each class, columns summing
/// to 1; rows are predicted, columns true classes, `background` last. RGB. Cells
/// have numbers up to 25 classes; up to 119 classes every row and column has its
/// name, beyond that only some.
///
/// # Errors
/// [`PlotError`] when drawing fails.
pub fn confusion_plot(
    matrix: &ConfusionMatrix,
    names: &BTreeMap<u32, String>,
) -> Result<Frame, PlotError> {
    let mut labels: Vec<String> = matrix.categories().iter().map(|&c| name_of(names, c)).collect();
    labels.push("background".to_owned());
    let side = u32::try_from(labels.len()).unwrap_or(u32::MAX);
    let cell = match side {
        0..=6 => 110,
        7..=12 => 76,
        13..=NUMBERED => 50,
        27..=100 => 16,
        _ => (1600 / side).max(2),
    };
    let text = if side <= 12 {
        22
    } else if side <= NUMBERED {
        19
    } else {
        15
    };
    // An empty picture makes the font known before texts are measured.
    draw(1, 1, |_| Ok(()))?;
    let longest = labels.iter().map(|l| width_of(l, text)).max().unwrap_or(0);
    let name_room = longest.clamp(40, 190);
    let (left, top) = (name_room as i32 + 74, 78);
    let layout = Layout { side, cell, text, left, top, name_room };
    let width = left as u32 + side * cell + 130;
    let height = top as u32 + side * cell + name_room + 74;
    draw(width.max(620), height, |canvas| {
        let centre = Pos::new(HPos::Left, VPos::Center);
        let style = font(30).color(&INK).pos(centre);
        write(canvas, "Confusion matrix, share of the true class", (px(24), px(36)), &style)?;
        layout.cells(canvas, matrix)?;
        layout.names(canvas, &labels)?;
        layout.scale(canvas)
    })
}

/// White over blue to dark blue.
fn shade(share: f64) -> RGBColor {
    const STOPS: [[f64; 3]; 5] = [
        [255.0, 255.0, 255.0],
        [198.0, 219.0, 239.0],
        [107.0, 174.0, 214.0],
        [33.0, 113.0, 181.0],
        [8.0, 48.0, 107.0],
    ];
    let place = share.clamp(0.0, 1.0) * 4.0;
    let lower = (place as usize).min(3);
    let part = place - lower as f64;
    let at = |i: usize, channel: usize| STOPS.get(i).and_then(|s| s.get(channel)).copied();
    let mix = |channel| {
        let (a, b) = (at(lower, channel).unwrap_or(0.0), at(lower + 1, channel).unwrap_or(0.0));
        (a + (b - a) * part).round() as u8
    };
    RGBColor(mix(0), mix(1), mix(2))
}

impl Layout {
    /// Left or top edge of a cell, counted from the matrix' own.
    fn edge(&self, position: u32) -> i32 {
        (position * self.cell) as i32
    }

    fn cells(&self, canvas: &Canvas<'_>, matrix: &ConfusionMatrix) -> Result<(), String> {
        let ends = (self.left + self.edge(self.side), self.top + self.edge(self.side));
        let size = match self.cell {
            100.. => 26,
            70.. => 21,
            _ => 17,
        };
        for row in 0..self.side {
            for column in 0..self.side {
                let (x, y) = (self.left + self.edge(column), self.top + self.edge(row));
                let Some(share) = matrix.share(row as usize, column as usize) else { continue };
                // A wrong one in a hundred must be seen in a matrix without numbers.
                let shown = if self.side > NUMBERED { share.sqrt() } else { share };
                let side = self.cell as i32;
                let area = Rectangle::new(
                    [(px(x), px(y)), (px(x + side), px(y + side))],
                    shade(shown).filled(),
                );
                canvas.draw(&area).map_err(|e| e.to_string())?;
                if self.side <= NUMBERED && share >= 0.005 {
                    let ink = if shown > 0.5 { WHITE } else { INK };
                    let middle = Pos::new(HPos::Center, VPos::Center);
                    let style = font(size).color(&ink).pos(middle);
                    let text = format!("{share:.2}");
                    write(canvas, &text, (px(x) + px(side) / 2, px(y) + px(side) / 2), &style)?;
                }
            }
        }
        // Between small cells lines would hide what is in them.
        let between = self.cell >= 8;
        for i in 0..=self.side {
            // The background's row and column are set apart.
            let edge = i == 0 || i + 1 >= self.side;
            if !edge && !between {
                continue;
            }
            let ink = if edge { INK.mix(0.6) } else { GRID.mix(1.0) };
            let (x, y) = (self.left + self.edge(i), self.top + self.edge(i));
            for ends in [[(x, self.top), (x, ends.1)], [(self.left, y), (ends.0, y)]] {
                canvas
                    .draw(&PathElement::new(
                        ends.map(|(x, y)| (px(x), px(y))).to_vec(),
                        ink.stroke_width(FINE),
                    ))
                    .map_err(|e| e.to_string())?;
            }
        }
        Ok(())
    }

    fn names(&self, canvas: &Canvas<'_>, labels: &[String]) -> Result<(), String> {
        let style = font(self.text).color(&INK);
        let beside = style.pos(Pos::new(HPos::Right, VPos::Center));
        let below =
            style.transform(FontTransform::Rotate270).pos(Pos::new(HPos::Right, VPos::Center));
        let every = if self.side > ALL_NAMED { self.side.div_ceil(60) } else { 1 };
        let bottom = self.top + self.edge(self.side);
        for (i, label) in (0u32..).zip(labels).filter(|(i, _)| i % every == 0) {
            let middle = self.edge(i) + self.cell as i32 / 2;
            let name = fitted(label, self.text, self.name_room);
            write(canvas, &name, (px(self.left - 10), px(self.top + middle)), &beside)?;
            write(canvas, &name, (px(self.left + middle), px(bottom + 10)), &below)?;
        }
        let centre = self.edge(self.side) / 2;
        let middle = font(24).color(&INK).pos(Pos::new(HPos::Center, VPos::Center));
        let low = bottom + self.name_room as i32 + 44;
        write(canvas, "true", (px(self.left + centre), px(low)), &middle)?;
        let turned = middle.transform(FontTransform::Rotate270);
        write(canvas, "predicted", (px(28), px(self.top + centre)), &turned)
    }

    /// The meaning of the colours, to the right.
    fn scale(&self, canvas: &Canvas<'_>) -> Result<(), String> {
        let left = self.left + self.edge(self.side) + 28;
        let height = self.edge(self.side).min(420);
        for y in 0..height {
            let share = 1.0 - f64::from(y) / f64::from(height);
            let shown = if self.side > NUMBERED { share.sqrt() } else { share };
            let line = [(px(left), px(self.top + y)), (px(left + 22), px(self.top + y))];
            let path = PathElement::new(line.to_vec(), shade(shown).stroke_width(FINE));
            canvas.draw(&path).map_err(|e| e.to_string())?;
        }
        let frame = Rectangle::new(
            [(px(left), px(self.top)), (px(left + 22), px(self.top + height))],
            INK.mix(0.6).stroke_width(FINE),
        );
        canvas.draw(&frame).map_err(|e| e.to_string())?;
        let style = font(18).color(&INK).pos(Pos::new(HPos::Left, VPos::Center));
        for tick in 0..=4 {
            let y = self.top + height - height * tick / 4;
            let text = format!("{:.2}", f64::from(tick) / 4.0);
            write(canvas, &text, (px(left + 30), px(y)), &style)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ConfusionOptions, GroundTruth, Prediction, confusion_matrix};
    use realnet_core::BoundingBox;

    #[test]
    fn shades_darken() {
        let sum = |s| u32::from(shade(s).0) + u32::from(shade(s).1) + u32::from(shade(s).2);
        let sums: Vec<_> = (0..=20).map(|i| sum(f64::from(i) / 20.0)).collect();
        assert!(sums.windows(2).all(|w| w[0] > w[1]));
        assert_eq!(shade(-1.0), WHITE);
        assert_eq!(shade(2.0), shade(1.0));
    }

    #[test]
    fn any_number_of_classes_is_drawn() {
        let bbox = BoundingBox::new(0.0, 0.0, 10.0, 10.0);
        for classes in [0u32, 1, 12, 80, 400] {
            let categories: Vec<u32> = (0..classes).collect();
            let truth: Vec<_> =
                (0..classes).map(|c| GroundTruth::new(u64::from(c), c, bbox)).collect();
            let found: Vec<_> = truth
                .iter()
                .map(|g| Prediction {
                    image_id: g.image_id,
                    category: g.category,
                    bbox,
                    confidence: 0.9,
                })
                .collect();
            let options = ConfusionOptions::default();
            let matrix = confusion_matrix(&truth, &found, &categories, options).unwrap();
            let frame = confusion_plot(&matrix, &BTreeMap::new()).unwrap();
            assert!(frame.width() <= 2400 && frame.height() <= 2400);
            // The diagonal is as dark as it can be.
            let dark = shade(1.0);
            let dark = [dark.0, dark.1, dark.2];
            let count = frame.data().chunks_exact(3).filter(|p| *p == dark).count();
            assert!(classes == 0 || count as u32 > classes, "{classes}: {count}");
        }
    }
}
