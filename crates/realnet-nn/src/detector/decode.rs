//! From a network's output to candidate boxes.
//!
//! YOLOv5 (Jocher et al., 2020) predicts, for each cell of a grid of `stride`
//! pixels and each anchor `(aw, ah)`, the logits `tx ty tw th to` and one for each
//! class. With `s` the logistic function and `(i, j)` the cell:
//!
//! ```text
//! cx = (2 s(tx) - 0.5 + i) stride     w = (2 s(tw))^2 aw
//! cy = (2 s(ty) - 0.5 + j) stride     h = (2 s(th))^2 ah
//! confidence of class k = s(to) s(tk)
//! ```

use crate::engine::TensorView;
use realnet_core::BoundingBox;
use thiserror::Error;

/// A box before suppression, in pixels of the network's input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Candidate {
    pub bbox: BoundingBox,
    pub confidence: f32,
    pub class_id: u32,
}

/// How a network writes its boxes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Layout {
    /// YOLOv5 before decoding: one `[1, anchors * (5 + C), h, w]` a level.
    Heads(Vec<Level>),
    /// YOLOv5 as exported: `[1, N, 5 + C]`, decoded.
    Rows,
    /// YOLOv8 and 11 as exported: `[1, 4 + C, N]`, decoded, without objectness.
    Columns,
}

/// One detection level of YOLOv5.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Level {
    pub stride: f32,
    /// Width and height of each anchor, in input pixels.
    pub anchors: Vec<[f32; 2]>,
}

/// An output that does not have the shape it must have.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "network output '{name}' must have shape {expected} for {classes} classes, found {found:?}"
)]
pub struct OutputShapeError {
    /// Name of the output.
    pub name: String,
    /// What is needed.
    pub expected: String,
    /// Number of classes.
    pub classes: usize,
    /// What came.
    pub found: Vec<usize>,
}

/// Turns outputs into candidates.
#[derive(Clone, Debug)]
pub(crate) struct Decoder {
    pub layout: Layout,
    pub classes: usize,
    /// Least confidence, 0 to 1.
    pub threshold: f32,
    /// Every class above the threshold gives a candidate, not only the best.
    pub multi_label: bool,
}

fn logistic(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

impl Decoder {
    /// Appends the candidates in `outputs` to `found`.
    pub fn decode(
        &self,
        outputs: &[TensorView<'_>],
        found: &mut Vec<Candidate>,
    ) -> Result<(), OutputShapeError> {
        match &self.layout {
            Layout::Heads(levels) => {
                for (level, output) in levels.iter().zip(outputs) {
                    self.decode_head(level, output, found)?;
                }
                match outputs.get(levels.len()..) {
                    Some([]) => Ok(()),
                    _ => Err(self.wrong(outputs.first(), format!("of {} heads", levels.len()))),
                }
            }
            Layout::Rows => self.decode_rows(outputs.first(), found),
            Layout::Columns => self.decode_columns(outputs.first(), found),
        }
    }

    fn wrong(&self, output: Option<&TensorView<'_>>, expected: String) -> OutputShapeError {
        OutputShapeError {
            name: output.map(|o| o.name.to_owned()).unwrap_or_default(),
            expected,
            classes: self.classes,
            found: output.map(|o| o.shape.to_vec()).unwrap_or_default(),
        }
    }

    fn decode_head(
        &self,
        level: &Level,
        output: &TensorView<'_>,
        found: &mut Vec<Candidate>,
    ) -> Result<(), OutputShapeError> {
        let values = 5 + self.classes;
        let channels = level.anchors.len() * values;
        let (rows, columns) = match *output.shape {
            [1, c, rows, columns] if c == channels && output.data.len() == c * rows * columns => {
                (rows, columns)
            }
            _ => return Err(self.wrong(Some(output), format!("[1, {channels}, h, w]"))),
        };
        let plane = rows * columns;
        if plane == 0 {
            return Ok(());
        }
        // Compared as logits, most cells cost one comparison and no exponential.
        let least = (self.threshold / (1.0 - self.threshold)).ln();
        for (anchor, block) in level.anchors.iter().zip(output.data.chunks_exact(values * plane)) {
            let objectness = &block[4 * plane..5 * plane];
            for (cell, &logit) in objectness.iter().enumerate() {
                // Also false for not-a-number, which is no candidate.
                let passes = logit > least;
                if !passes {
                    continue;
                }
                let at = |value: usize| block[value * plane + cell];
                let center =
                    |t: f32, index: usize| (2.0 * logistic(t) - 0.5 + index as f32) * level.stride;
                let side = |t: f32, anchor: f32| (2.0 * logistic(t)).powi(2) * anchor;
                let bbox = BoundingBox::from_center(
                    center(at(0), cell % columns),
                    center(at(1), cell / columns),
                    side(at(2), anchor[0]),
                    side(at(3), anchor[1]),
                );
                let objectness = logistic(logit);
                self.push(bbox, |class| at(5 + class), |t| objectness * logistic(t), found);
            }
        }
        Ok(())
    }

    fn decode_rows(
        &self,
        output: Option<&TensorView<'_>>,
        found: &mut Vec<Candidate>,
    ) -> Result<(), OutputShapeError> {
        let values = 5 + self.classes;
        let wrong = || self.wrong(output, format!("[1, N, {values}]"));
        let output = output.ok_or_else(wrong)?;
        match *output.shape {
            [1, n, v] if v == values && output.data.len() == n * v => {}
            _ => return Err(wrong()),
        }
        for row in output.data.chunks_exact(values) {
            let objectness = row[4];
            if objectness > self.threshold {
                let bbox = BoundingBox::from_center(row[0], row[1], row[2], row[3]);
                self.push(bbox, |class| row[5 + class], |p| objectness * p, found);
            }
        }
        Ok(())
    }

    fn decode_columns(
        &self,
        output: Option<&TensorView<'_>>,
        found: &mut Vec<Candidate>,
    ) -> Result<(), OutputShapeError> {
        let values = 4 + self.classes;
        let wrong = || self.wrong(output, format!("[1, {values}, N]"));
        let output = output.ok_or_else(wrong)?;
        let n = match *output.shape {
            [1, v, n] if v == values && output.data.len() == v * n => n,
            _ => return Err(wrong()),
        };
        for box_index in 0..n {
            let at = |value: usize| output.data[value * n + box_index];
            // The best class first: only then the box is worth computing.
            let best = (0..self.classes).map(|class| at(4 + class)).fold(0.0, f32::max);
            if best > self.threshold {
                let bbox = BoundingBox::from_center(at(0), at(1), at(2), at(3));
                self.push(bbox, |class| at(4 + class), |p| p, found);
            }
        }
        Ok(())
    }

    /// Appends the best class of one box, or all that pass. `score` gives what a
    /// class is compared by, `confidence` is monotonic in it.
    fn push(
        &self,
        bbox: BoundingBox,
        score: impl Fn(usize) -> f32,
        confidence: impl Fn(f32) -> f32,
        found: &mut Vec<Candidate>,
    ) {
        let mut add = |class: usize, score: f32| {
            let confidence = confidence(score);
            if confidence > self.threshold {
                found.push(Candidate { bbox, confidence, class_id: class as u32 });
            }
        };
        if self.multi_label {
            (0..self.classes).for_each(|class| add(class, score(class)));
            return;
        }
        let mut best: Option<(usize, f32)> = None;
        for class in 0..self.classes {
            let value = score(class);
            if best.is_none_or(|(_, top)| value > top) {
                best = Some((class, value));
            }
        }
        if let Some((class, score)) = best {
            add(class, score);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoder(layout: Layout) -> Decoder {
        Decoder { layout, classes: 2, threshold: 0.25, multi_label: false }
    }

    #[test]
    fn head_rows_and_columns_agree() {
        // One anchor, a 2x3 grid, one confident cell at column 2, row 1.
        let (columns, plane, cell) = (3, 6, 5);
        let logits = [0.3, -0.2, 0.1, 0.6, 2.0, -1.0, 3.0];
        let mut data = vec![-20.0; 7 * plane];
        for (value, logit) in logits.iter().enumerate() {
            data[value * plane + cell] = *logit;
        }
        let level = Level { stride: 8.0, anchors: vec![[10.0, 13.0]] };
        let mut from_head = Vec::new();
        let head = TensorView { name: "head0", shape: &[1, 7, 2, columns], data: &data };
        decoder(Layout::Heads(vec![level])).decode(&[head], &mut from_head).unwrap();

        let s = |x: f32| 1.0 / (1.0 + (-x).exp());
        let row = [
            (2.0 * s(0.3) - 0.5 + 2.0) * 8.0,
            (2.0 * s(-0.2) - 0.5 + 1.0) * 8.0,
            (2.0 * s(0.1)).powi(2) * 10.0,
            (2.0 * s(0.6)).powi(2) * 13.0,
            s(2.0),
            s(-1.0),
            s(3.0),
        ];
        let mut from_rows = Vec::new();
        let rows = TensorView { name: "output0", shape: &[1, 1, 7], data: &row };
        decoder(Layout::Rows).decode(&[rows], &mut from_rows).unwrap();
        assert_eq!(from_head.len(), 1);
        assert_eq!(from_head[0].class_id, 1);
        let gap = |a: &Candidate, b: &Candidate| {
            let (p, q) = (<[f32; 4]>::from(a.bbox), <[f32; 4]>::from(b.bbox));
            p.iter().zip(q).map(|(p, q)| (p - q).abs()).fold(0.0, f32::max)
        };
        assert!(gap(&from_head[0], &from_rows[0]) < 1e-4);
        assert!((from_head[0].confidence - s(2.0) * s(3.0)).abs() < 1e-6);

        let column = [row[0], row[1], row[2], row[3], row[4] * row[5], row[4] * row[6]];
        let mut from_columns = Vec::new();
        let columns = TensorView { name: "output0", shape: &[1, 6, 1], data: &column };
        decoder(Layout::Columns).decode(&[columns], &mut from_columns).unwrap();
        assert_eq!(from_columns, from_rows);
    }

    #[test]
    fn all_labels_when_asked() {
        let row = [5.0, 5.0, 2.0, 2.0, 0.9, 0.5, 0.6];
        let rows = TensorView { name: "o", shape: &[1, 1, 7], data: &row };
        let mut found = Vec::new();
        let mut decoder = decoder(Layout::Rows);
        decoder.multi_label = true;
        decoder.decode(&[rows], &mut found).unwrap();
        assert_eq!(found.iter().map(|c| c.class_id).collect::<Vec<_>>(), [0, 1]);
    }

    #[test]
    fn nothing_is_found_in_not_a_number() {
        let data = [f32::NAN; 7];
        let mut found = Vec::new();
        let rows = TensorView { name: "o", shape: &[1, 1, 7], data: &data };
        decoder(Layout::Rows).decode(&[rows], &mut found).unwrap();
        let level = Level { stride: 8.0, anchors: vec![[10.0, 13.0]] };
        let head = TensorView { name: "h", shape: &[1, 7, 1, 1], data: &data };
        decoder(Layout::Heads(vec![level])).decode(&[head], &mut found).unwrap();
        let columns = TensorView { name: "o", shape: &[1, 6, 1], data: &data[..6] };
        decoder(Layout::Columns).decode(&[columns], &mut found).unwrap();
        assert!(found.is_empty());
    }

    #[test]
    fn wrong_shapes_name_both() {
        let data = [0.0; 116];
        let view = TensorView { name: "output0", shape: &[1, 116, 1], data: &data };
        let error = decoder(Layout::Columns).decode(&[view], &mut Vec::new()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "network output 'output0' must have shape [1, 6, N] for 2 classes, found [1, 116, 1]"
        );
        assert!(decoder(Layout::Rows).decode(&[], &mut Vec::new()).is_err());
        let levels = vec![Level { stride: 8.0, anchors: vec![[1.0, 1.0]] }; 2];
        let head = TensorView { name: "h", shape: &[1, 7, 1, 1], data: &data[..7] };
        assert!(decoder(Layout::Heads(levels)).decode(&[head], &mut Vec::new()).is_err());
    }
}
