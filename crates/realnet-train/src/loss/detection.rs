//! YOLOv5's loss: boxes, objectness and classes on three scales.

use super::boxes::{BoxLoss, box_loss, iou};
use crate::nets::yolov5::{ANCHORS, STRIDES, YoloV5Config};
use burn::tensor::activation::{log_sigmoid, sigmoid};
use burn::tensor::{Device, Int, Tensor, TensorData};

/// An object in a picture of a batch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Index of the picture in the batch.
    pub image: usize,
    /// Its class.
    pub class: usize,
    /// Middle, width and height as shares of the picture's sides.
    pub bbox: [f32; 4],
}

/// What [`DetectionLoss`] weighs. The names are the reference implementation's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectionLossOptions {
    /// Which loss of boxes.
    pub boxes: BoxLoss,
    /// Weight of the boxes.
    pub box_gain: f32,
    /// Weight of the objectness, for an input of 640 pixels: it goes with the square of the
    /// input.
    pub obj_gain: f32,
    /// Weight of the classes, for 80 of them: it goes with their number.
    pub cls_gain: f32,
    /// A target belongs to an anchor when their sides differ by less than this factor.
    pub anchor_t: f32,
    /// Share of certainty that is taken from classes, 0 to 1 (Szegedy et al., 2016).
    pub label_smoothing: f32,
    /// Weight of an object against the many places without one.
    pub obj_positive: f32,
    /// Weight of a class against the many others.
    pub cls_positive: f32,
    /// Weight of the objectness on the scales of strides 8, 16 and 32.
    pub balance: [f32; 3],
}

impl Default for DetectionLossOptions {
    fn default() -> Self {
        Self {
            boxes: BoxLoss::Giou,
            box_gain: 0.05,
            obj_gain: 1.0,
            cls_gain: 0.5,
            anchor_t: 4.0,
            label_smoothing: 0.0,
            obj_positive: 1.0,
            cls_positive: 1.0,
            balance: [4.0, 1.0, 0.4],
        }
    }
}

/// One target at one anchor of one cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Picture of the batch.
    pub image: usize,
    /// Anchor of the scale.
    pub anchor: usize,
    /// Row of the cell.
    pub row: usize,
    /// Column of the cell.
    pub column: usize,
    /// Class.
    pub class: usize,
    /// Middle from the cell's corner, width and height, in cells.
    pub bbox: [f32; 4],
}

/// Which cells and anchors of a scale are to find which targets: those whose sides fit the
/// anchor's by less than a factor of `anchor_t`, in the cell of the target's middle and in the
/// two neighbours that the middle is nearest to.
///
/// `anchors` are in cells, of which the scale has `cells` columns and rows. In the order of
/// the reference implementation: by cell (own, left, upper, right, lower), then anchor, then
/// target; where two meet in one place the later one counts for the objectness. A middle on
/// the border of two cells is found from both sides and counts twice, as it does there.
#[must_use]
pub fn matches(
    targets: &[Target],
    anchors: &[[f32; 2]; ANCHORS],
    cells: [usize; 2],
    anchor_t: f32,
) -> Vec<Match> {
    let [columns, rows] = cells.map(|count| count.max(1));
    let size = [columns as f32, rows as f32];
    let fits = |target: &Target, anchor: &[f32; 2]| {
        (0..2).all(|side| {
            let ratio = target.bbox[2 + side] * size[side] / anchor[side];
            ratio.max(ratio.recip()) < anchor_t
        })
    };
    let fitting: Vec<(usize, &Target)> = anchors
        .iter()
        .enumerate()
        .flat_map(|(index, anchor)| {
            targets.iter().filter(move |t| fits(t, anchor)).map(move |t| (index, t))
        })
        .collect();
    // Own cell, then the neighbours to the left, above, to the right, below.
    let steps = [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [-0.5, 0.0], [0.0, -0.5]];
    let mut found = Vec::with_capacity(3 * fitting.len());
    for (which, step) in steps.into_iter().enumerate() {
        for &(anchor, target) in &fitting {
            let [x, y, w, h] = target.bbox;
            let at = [x * size[0], y * size[1]];
            let back = [size[0] - at[0], size[1] - at[1]];
            let near = |place: f32| place.rem_euclid(1.0) < 0.5 && place > 1.0;
            let taken = match which {
                0 => true,
                1 => near(at[0]),
                2 => near(at[1]),
                3 => near(back[0]),
                _ => near(back[1]),
            };
            if !taken {
                continue;
            }
            // On the right and lower edges there is no cell: it is the last one's.
            let cell = |place: f32, count: usize| (place.max(0.0) as usize).min(count - 1);
            let (column, row) = (cell(at[0] - step[0], columns), cell(at[1] - step[1], rows));
            found.push(Match {
                image: target.image,
                anchor,
                row,
                column,
                class: target.class,
                bbox: [at[0] - column as f32, at[1] - row as f32, w * size[0], h * size[1]],
            });
        }
    }
    found
}

/// The parts of a loss, each with its weight and multiplied by the batch.
#[derive(Clone, Debug)]
pub struct Parts {
    /// Of the boxes, `[1]`.
    pub boxes: Tensor<1>,
    /// Of the objectness.
    pub objectness: Tensor<1>,
    /// Of the classes.
    pub classes: Tensor<1>,
}

impl Parts {
    /// Their sum.
    #[must_use]
    pub fn total(&self) -> Tensor<1> {
        self.boxes.clone() + self.objectness.clone() + self.classes.clone()
    }
}

/// YOLOv5's loss for networks of one configuration.
#[derive(Clone, Debug)]
pub struct DetectionLoss {
    options: DetectionLossOptions,
    classes: usize,
    /// In pixels.
    anchors: [[[f32; 2]; ANCHORS]; 3],
}

impl DetectionLoss {
    /// For the heads of networks of `config`.
    #[must_use]
    pub const fn new(config: &YoloV5Config, options: DetectionLossOptions) -> Self {
        Self { options, classes: config.classes, anchors: config.anchors }
    }

    /// The loss of heads as [`YoloV5::forward`](crate::nets::YoloV5::forward) gives them.
    /// Targets of pictures or classes that there are not are left out.
    #[must_use]
    pub fn of(&self, heads: [Tensor<4>; 3], targets: &[Target]) -> Parts {
        let options = &self.options;
        let device = heads[0].device();
        let [batch, _, rows, columns] = heads[0].dims();
        // The first scale's cells tell the size of the input.
        let input = (rows.max(columns) * STRIDES[0]) as f32;
        let known = |t: &&Target| t.image < batch && t.class < self.classes;
        let targets: Vec<Target> = targets.iter().filter(known).copied().collect();
        let zero = || Tensor::<1>::zeros([1], &device);
        let (mut boxes, mut objectness, mut classes) = (zero(), zero(), zero());
        for (((head, stride), anchors), balance) in
            heads.into_iter().zip(STRIDES).zip(&self.anchors).zip(options.balance)
        {
            let scale = self.scale(head, stride, anchors, &targets, &device);
            boxes = boxes + scale.boxes;
            objectness = objectness + scale.objectness * balance;
            classes = classes + scale.classes;
        }
        let batch = batch as f32;
        let obj_gain = options.obj_gain * (input / 640.0).powi(2);
        let cls_gain = options.cls_gain * self.classes as f32 / 80.0;
        Parts {
            boxes: boxes * (options.box_gain * batch),
            objectness: objectness * (obj_gain * batch),
            classes: classes * (cls_gain * batch),
        }
    }

    fn scale(
        &self,
        head: Tensor<4>,
        stride: usize,
        anchors: &[[f32; 2]; ANCHORS],
        targets: &[Target],
        device: &Device,
    ) -> Parts {
        let options = &self.options;
        let outputs = 5 + self.classes;
        let [batch, _, rows, columns] = head.dims();
        let places = batch * ANCHORS * rows * columns;
        let anchors = anchors.map(|anchor| anchor.map(|side| side / stride as f32));
        let found = matches(targets, &anchors, [columns, rows], options.anchor_t);
        let by_place = head
            .reshape([batch, ANCHORS, outputs, rows, columns])
            .permute([0, 1, 3, 4, 2])
            .reshape([places, outputs]);
        let zero = || Tensor::<1>::zeros([1], device);
        let (mut boxes, mut classes) = (zero(), zero());
        let mut wanted = vec![0.0_f32; places];
        if !found.is_empty() {
            let place =
                |m: &Match| ((m.image * ANCHORS + m.anchor) * rows + m.row) * columns + m.column;
            let count = found.len();
            let indices: Vec<i64> = found.iter().map(|m| place(m) as i64).collect();
            let indices = Tensor::<1, Int>::from_data(TensorData::new(indices, [count]), device);
            let at = by_place.clone().select(0, indices);
            let floats = |values: Vec<f32>, width: usize| {
                Tensor::<2>::from_data(TensorData::new(values, [count, width]), device)
            };
            let truth = floats(found.iter().flat_map(|m| m.bbox).collect(), 4);
            let sides = floats(found.iter().flat_map(|m| anchors[m.anchor]).collect(), 2);
            let middle = sigmoid(at.clone().narrow(1, 0, 2)) * 2.0 - 0.5;
            let size = (sigmoid(at.clone().narrow(1, 2, 2)) * 2.0).square() * sides;
            let bbox = Tensor::cat(vec![middle, size], 1);
            boxes = box_loss(&bbox, &truth, options.boxes, [columns, rows]).mean();
            // Objectness is to say how good the box is. The squared error has no such figure.
            let overlap = iou(&bbox.detach(), &truth, options.boxes).clamp_min(0.0);
            let overlap = overlap.into_data().try_to_vec::<f32>().unwrap_or_default();
            for (m, overlap) in found.iter().zip(overlap) {
                if let Some(slot) = wanted.get_mut(place(m)) {
                    *slot = overlap;
                }
            }
            if self.classes > 1 {
                let (on, off) =
                    (1.0 - 0.5 * options.label_smoothing, 0.5 * options.label_smoothing);
                let wanted = found.iter().flat_map(|m| {
                    (0..self.classes).map(move |class| if class == m.class { on } else { off })
                });
                let wanted = floats(wanted.collect(), self.classes);
                let logits = at.narrow(1, 5, self.classes);
                classes = binary_cross_entropy(logits, wanted, options.cls_positive);
            }
        }
        let wanted = Tensor::<2>::from_data(TensorData::new(wanted, [places, 1]), device);
        let logits = by_place.narrow(1, 4, 1);
        let objectness = binary_cross_entropy(logits, wanted, options.obj_positive);
        Parts { boxes, objectness, classes }
    }
}

/// Mean of `-(p t log s + (1 - t) log (1 - s))` with `s = sigmoid(logits)` and the weight `p`.
fn binary_cross_entropy(logits: Tensor<2>, wanted: Tensor<2>, positive: f32) -> Tensor<1> {
    let no = (-wanted.clone() + 1.0) * log_sigmoid(-logits.clone());
    let yes = wanted * log_sigmoid(logits) * positive;
    -(yes + no).mean()
}
