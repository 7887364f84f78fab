//! Losses of depth networks that classify: weighted cross entropy over bins of log depth,
//! and virtual normals (Yin et al., "Enforcing geometric constraints of virtual normal for
//! depth prediction", 2019).

use burn::tensor::activation::{log_softmax, softmax};
use burn::tensor::{Device, Int, Tensor, TensorData};
use realnet_nn::depth::DepthCoding;

/// Into which bin a depth falls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Labels {
    /// The one around it. What it is read as is in the middle of the bin.
    #[default]
    Around,
    /// The released code's: the nearest lower border. What it is read as lies half a bin
    /// further.
    Nearest,
}

/// Which triplets of points have a virtual normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NormalRules {
    /// The paper's: every angle of the triangle within these, radians, every side longer
    /// than this, metres.
    Paper {
        /// Smallest angle.
        least_rad: f64,
        /// Largest angle.
        most_rad: f64,
        /// Shortest side.
        side_m: f64,
    },
    /// The released code's: no cosine between two sides larger than this; not so near to each
    /// other that some side is shorter than this along x, some along y and some along z.
    Released {
        /// Largest cosine.
        cosine: f64,
        /// Metres.
        near_m: f64,
    },
}

impl NormalRules {
    /// The paper's numbers: 30° to 120°, 0.6 m.
    pub const PAPER: Self = Self::Paper {
        least_rad: std::f64::consts::FRAC_PI_6,
        most_rad: 2.0 * std::f64::consts::FRAC_PI_3,
        side_m: 0.6,
    };
    /// The released code's numbers: 0.867, 5 mm.
    pub const RELEASED: Self = Self::Released { cosine: 0.867, near_m: 0.005 };

    /// Whether three points have one.
    #[must_use]
    pub fn allow(&self, points: &[[f64; 3]; 3]) -> bool {
        let [a, b, c] = points;
        let sides = [minus(b, a), minus(c, a), minus(c, b)];
        let cosine = |i: usize, j: usize| {
            dot(&sides[i], &sides[j]) / (norm(&sides[i]) * norm(&sides[j]) + 1e-8)
        };
        match *self {
            Self::Paper { least_rad, most_rad, side_m } => {
                // The angle at b is between b to a, which is minus a to b, and b to c.
                let angles = [cosine(0, 1), -cosine(0, 2), cosine(1, 2)].map(f64::acos);
                sides.iter().all(|side| norm(side) > side_m)
                    && angles.iter().all(|angle| (least_rad..=most_rad).contains(angle))
            }
            Self::Released { cosine: limit, near_m } => {
                let in_line =
                    [(0, 1), (0, 2), (1, 2)].iter().any(|&(i, j)| cosine(i, j).abs() > limit);
                let near = (0..3).all(|axis| sides.iter().any(|side| side[axis].abs() < near_m));
                !in_line && !near
            }
        }
    }
}

fn minus(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn norm(a: &[f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

fn cross(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// What [`DepthLoss`] weighs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthLossOptions {
    /// How bins are depths.
    pub coding: DepthCoding,
    /// Number of bins.
    pub bins: usize,
    /// Into which bin a depth falls.
    pub labels: Labels,
    /// How fast the weight of a bin falls with its distance from the right one.
    pub sharpness: f64,
    /// Weight of the virtual normals against the cross entropy; 0 for none.
    pub normal_gain: f32,
    /// Triplets of known depths that are drawn for a picture.
    pub normal_triplets: usize,
    /// Which of them count.
    pub normal_rules: NormalRules,
    /// Share of these, those of the smallest losses, that is left out.
    pub normal_dropped: f64,
}

impl Default for DepthLossOptions {
    fn default() -> Self {
        Self {
            coding: DepthCoding::default(),
            bins: 80,
            labels: Labels::Around,
            sharpness: 0.2,
            normal_gain: 5.0,
            normal_triplets: 4000,
            normal_rules: NormalRules::PAPER,
            normal_dropped: 0.25,
        }
    }
}

/// True depths of a batch, and the rays of its pixels: `x` and `y` at a depth of 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthTruth {
    /// Pictures in the batch.
    pub images: usize,
    /// Rows and columns of a picture.
    pub size: [usize; 2],
    /// Metres for the coding's focal length, row by row, picture by picture; 0 for unknown.
    pub depths: Vec<f32>,
    /// Rays of the pixels of all pictures.
    pub rays: Vec<[f32; 2]>,
    /// What depths of each picture are to be multiplied by to be metres of its own camera;
    /// 1 where there is none. It scales the points of a picture together, which turns no
    /// normal, but decides which triangles are large enough to have one.
    pub metres_per_unit: Vec<f32>,
}

impl DepthTruth {
    /// The point of a place in metres of its camera; `None` where the depth is unknown.
    fn point(&self, place: usize) -> Option<[f64; 3]> {
        let pixels = (self.size[0] * self.size[1]).max(1);
        let scale = self.metres_per_unit.get(place / pixels).map_or(1.0, |x| f64::from(*x));
        let z = f64::from(*self.depths.get(place)?) * scale;
        let [x, y] = self.rays.get(place)?.map(f64::from);
        (z > 1e-4 && z.is_finite()).then_some([x * z, y * z, z])
    }
}

/// Loss of networks that give logits of bins.
#[derive(Clone, Debug)]
pub struct DepthLoss {
    options: DepthLossOptions,
    /// Natural logarithms, in units of the scale.
    borders: Vec<f64>,
    /// Weights of all bins for each right one, rows of 1.
    weights: Vec<f32>,
}

impl DepthLoss {
    /// With tables of the options.
    #[must_use]
    pub fn new(options: DepthLossOptions) -> Self {
        let bins = options.bins;
        let weight = |i: usize, j: usize| {
            let apart = i as f64 - j as f64;
            (-options.sharpness * apart * apart).exp()
        };
        let rows = (0..bins).flat_map(|i| {
            let sum: f64 = (0..bins).map(|j| weight(i, j)).sum();
            (0..bins).map(move |j| (weight(i, j) / sum) as f32)
        });
        Self { borders: options.coding.log_borders(bins), weights: rows.collect(), options }
    }

    /// The options.
    #[must_use]
    pub const fn options(&self) -> &DepthLossOptions {
        &self.options
    }

    /// The bin of a depth in metres; `None` for an unknown one and beyond the bins.
    #[must_use]
    pub fn label(&self, depth: f32) -> Option<usize> {
        let DepthLossOptions { coding, bins, labels, .. } = &self.options;
        if !(depth > 0.0 && depth.is_finite()) {
            return None;
        }
        let step = (coding.max / coding.min).ln() / *bins as f64;
        let place = ((f64::from(depth) / coding.scale).ln() - coding.min.ln()) / step;
        let index = match labels {
            Labels::Around => place.floor(),
            Labels::Nearest => place.round(),
        };
        (index >= 0.0 && index < *bins as f64).then_some(index as usize)
    }

    /// Depths of logits `[batch, bins, rows, columns]`: `[batch, 1, rows, columns]`, metres.
    #[must_use]
    pub fn depth(&self, logits: Tensor<4>) -> Tensor<4> {
        let device = logits.device();
        let borders: Vec<f32> = self.borders.iter().map(|b| *b as f32).collect();
        let count = borders.len();
        let borders = Tensor::<1>::from_data(TensorData::new(borders, [count]), &device);
        let sum = (softmax(logits, 1) * borders.reshape([1, count, 1, 1])).sum_dim(1);
        sum.exp() * self.options.coding.scale
    }

    /// Cross entropy against bins weighted by their distance from the right one, mean over
    /// the known pixels. `logits`: `[batch, bins, rows, columns]`.
    #[must_use]
    pub fn cross_entropy(&self, logits: Tensor<4>, truth: &DepthTruth) -> Tensor<1> {
        let device = logits.device();
        let bins = self.options.bins;
        let [batch, _, rows, columns] = logits.dims();
        let labelled = truth.depths.iter().enumerate();
        let (places, labels): (Vec<i64>, Vec<i64>) = labelled
            .filter_map(|(place, depth)| Some((place as i64, self.label(*depth)? as i64)))
            .unzip();
        if places.is_empty() {
            return logits.sum() * 0.0;
        }
        let by_pixel = logits.permute([0, 2, 3, 1]).reshape([batch * rows * columns, bins]);
        let by_pixel = by_pixel.select(0, indices(places, &device));
        let table = TensorData::new(self.weights.clone(), [bins, bins]);
        let wanted = Tensor::<2>::from_data(table, &device).select(0, indices(labels, &device));
        -(wanted * log_softmax(by_pixel, 1)).sum_dim(1).mean()
    }

    /// Virtual normals of predicted depths `[batch, 1, rows, columns]` against the true ones:
    /// for each triplet the sum of the differences of the normal's parts, mean over those
    /// that are kept. `triplets` are places in the batch, three of one picture each.
    #[must_use]
    pub fn virtual_normals(
        &self,
        depth: Tensor<4>,
        truth: &DepthTruth,
        triplets: &[[usize; 3]],
    ) -> Tensor<1> {
        let device = depth.device();
        let rules = &self.options.normal_rules;
        let mut chosen: Vec<[usize; 3]> = Vec::new();
        let mut normals: Vec<f32> = Vec::new();
        for triplet in triplets {
            let [Some(a), Some(b), Some(c)] = triplet.map(|place| truth.point(place)) else {
                continue;
            };
            if rules.allow(&[a, b, c]) {
                let normal = cross(&minus(&b, &a), &minus(&c, &a));
                let length = norm(&normal);
                normals.extend(normal.map(|part| (part / length) as f32));
                chosen.push(*triplet);
            }
        }
        let count = chosen.len();
        if count == 0 {
            return depth.sum() * 0.0;
        }
        let [batch, _, rows, columns] = depth.dims();
        let depths = depth.reshape([batch * rows * columns]);
        let point = |which: usize| -> Tensor<2> {
            let places: Vec<i64> = chosen.iter().map(|t| t[which] as i64).collect();
            let rays = chosen.iter().flat_map(|t| {
                let [x, y] = truth.rays.get(t[which]).copied().unwrap_or_default();
                [x, y, 1.0]
            });
            let rays = TensorData::new(rays.collect::<Vec<f32>>(), [count, 3]);
            let z = depths.clone().select(0, indices(places, &device));
            Tensor::<2>::from_data(rays, &device) * z.reshape([count, 1])
        };
        let first = point(0);
        let (a, b) = (point(1) - first.clone(), point(2) - first);
        let part = |tensor: &Tensor<2>, axis: usize| tensor.clone().narrow(1, axis, 1);
        let along = |i: usize, j: usize| part(&a, i) * part(&b, j) - part(&a, j) * part(&b, i);
        let normal = Tensor::cat(vec![along(1, 2), along(2, 0), along(0, 1)], 1);
        // A root has no slope at 0.
        let length = normal.clone().square().sum_dim(1).clamp_min(1e-16).sqrt();
        let wanted = Tensor::<2>::from_data(TensorData::new(normals, [count, 3]), &device);
        let losses = (normal / length - wanted).abs().sum_dim(1).reshape([count]);
        let dropped = (self.options.normal_dropped * count as f64) as usize;
        if dropped == 0 || dropped >= count {
            return losses.mean();
        }
        let values = losses.clone().into_data().try_to_vec::<f32>().unwrap_or_default();
        let mut order: Vec<usize> = (0..values.len()).collect();
        order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
        let kept = order.into_iter().skip(dropped).map(|i| i as i64).collect();
        losses.select(0, indices(kept, &device)).mean()
    }

    /// Both, weighted; and the two parts.
    #[must_use]
    pub fn of(
        &self,
        logits: Tensor<4>,
        truth: &DepthTruth,
        triplets: &[[usize; 3]],
    ) -> (Tensor<1>, [Tensor<1>; 2]) {
        let entropy = self.cross_entropy(logits.clone(), truth);
        if self.options.normal_gain == 0.0 {
            let none = Tensor::zeros([1], &logits.device());
            return (entropy.clone(), [entropy, none]);
        }
        let normals = self.virtual_normals(self.depth(logits), truth, triplets);
        let total = entropy.clone() + normals.clone() * self.options.normal_gain;
        (total, [entropy, normals])
    }

    /// Triplets for a batch: for each picture as many as the options say, each of three places
    /// with a depth that the bins can say, which `below` draws from so many. None for a picture
    /// with fewer than three.
    pub fn draw(
        &self,
        truth: &DepthTruth,
        mut below: impl FnMut(usize) -> usize,
    ) -> Vec<[usize; 3]> {
        let pixels = (truth.size[0] * truth.size[1]).max(1);
        let count = self.options.normal_triplets;
        let mut triplets = Vec::with_capacity(truth.images * count);
        for (image, depths) in truth.depths.chunks(pixels).enumerate() {
            let known: Vec<usize> = (image * pixels..)
                .zip(depths)
                .filter_map(|(place, depth)| self.label(*depth).map(|_| place))
                .collect();
            if known.len() < 3 {
                continue;
            }
            let mut one = || known.get(below(known.len())).copied().unwrap_or_default();
            triplets.extend((0..count).map(|_| [one(), one(), one()]));
        }
        triplets
    }
}

fn indices(places: Vec<i64>, device: &Device) -> Tensor<1, Int> {
    let count = places.len();
    Tensor::from_data(TensorData::new(places, [count]), device)
}
