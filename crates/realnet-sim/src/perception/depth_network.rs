//! A depth network, played by the truth.

use super::channel::{Channel, ChannelModel, Delivered, Latency};
use super::random::{Random, SlowNoise, item_stream, normal, stream_number};
use super::schedule::Schedule;
use super::window::{Window, holding};
use realnet_core::{DepthMap, DepthMapError, Stamp};

const NAME: &str = "depth network";

/// What goes wrong with the network itself for a while; what goes wrong on the way
/// is a [`super::ChannelFault`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DepthFault {
    /// It takes frames at this rate instead, Hz.
    Rate(f64),
    /// Its depths are so many times as long: the wrong scale.
    Scale(f64),
    /// This share of the pixels is unknown in addition, in patches, 0 to 1.
    Holes(f64),
    /// It sees nothing and guesses: one depth everywhere.
    Blind,
}

/// What a network says that sees nothing, metres: about the mean of what it has seen.
const GUESS: f32 = 2.5;

/// How a depth network is wrong and late. Deviations are relative to the depth.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthNetworkModel {
    /// Frames that it takes in a second.
    pub rate_hz: f64,
    /// How its maps travel; the latency counts from the exposure of the frame to
    /// the arrival of the map, computation included.
    pub channel: ChannelModel,
    /// Rows of its maps, which are of the frame's shape; 0: as many as the frame.
    pub rows: u32,
    /// Deviation of the scale of a map as a whole: log-normal, with median 1, anew
    /// for each map.
    pub scale_noise: f64,
    /// Deviation of a scale that wanders from map to map.
    pub scale_drift: f64,
    /// How long that drift remembers, s.
    pub drift_s: f64,
    /// Deviation of errors that neighbouring pixels share.
    pub patch_noise: f64,
    /// Width of these patches as a share of the map's width, 0 to 1.
    pub patch_size: f64,
    /// Deviation of each pixel on its own.
    pub pixel_noise: f64,
    /// Over how many pixels of the map, either way, depths flow into each other:
    /// networks smear edges.
    pub smear: u32,
    /// Share of unknown pixels, in patches, 0 to 1.
    pub holes: f64,
    /// Depths from here on are unknown, metres.
    pub max_depth: f64,
    /// What else goes wrong, and when.
    pub faults: Vec<Window<DepthFault>>,
}

impl Default for DepthNetworkModel {
    /// A small network on a small computer: 3 Hz, 0.27 s late, 10 % of noise for
    /// each map as a whole.
    fn default() -> Self {
        Self {
            rate_hz: 3.0,
            channel: ChannelModel {
                latency: Latency { mean_s: 0.27, jitter_s: 0.01 },
                ..ChannelModel::default()
            },
            rows: 90,
            scale_noise: 0.10,
            scale_drift: 0.0,
            drift_s: 5.0,
            patch_noise: 0.02,
            patch_size: 0.2,
            pixel_noise: 0.01,
            smear: 1,
            holes: 0.0,
            max_depth: 12.0,
            faults: Vec::new(),
        }
    }
}

/// A depth network, played by the truth.
///
/// What it says about a frame depends on its model, the seed and the frame's stamp
/// and true depth, on nothing that was before.
#[derive(Clone, Debug)]
pub struct DepthNetwork {
    model: DepthNetworkModel,
    seed: u64,
    drift: SlowNoise,
    schedule: Schedule,
    channel: Channel<DepthMap>,
}

impl DepthNetwork {
    /// A network with the random numbers of a seed.
    #[must_use]
    pub fn new(model: DepthNetworkModel, seed: u64) -> Self {
        Self {
            seed,
            drift: SlowNoise::new(seed, "depth network: drift", 0, model.drift_s),
            schedule: Schedule::default(),
            channel: Channel::new(model.channel.clone(), seed, "depth network: channel"),
            model,
        }
    }

    /// Whether it takes a frame of this stamp when it is shown one.
    #[must_use]
    pub fn takes(&self, stamp: Stamp) -> bool {
        self.schedule.is_due(stamp)
    }

    /// Shows it a frame by its true depth. Whether it took it: its map will come,
    /// unless it is lost on the way.
    ///
    /// # Errors
    /// [`DepthMapError`] when the size of its maps cannot be made.
    pub fn show(&mut self, truth: &DepthMap) -> Result<bool, DepthMapError> {
        if !self.take(truth.stamp()) {
            return Ok(false);
        }
        let map = self.infer(truth)?;
        self.channel.send(truth.stamp(), map);
        Ok(true)
    }

    /// Whether it takes a frame of this stamp, which then counts as taken.
    pub fn take(&mut self, stamp: Stamp) -> bool {
        let rate = holding(&self.model.faults, stamp).fold(self.model.rate_hz, |rate, fault| {
            if let DepthFault::Rate(hz) = fault { *hz } else { rate }
        });
        self.schedule.take(stamp, rate)
    }

    /// Another network's map of a frame that was taken: it goes the same way, with the
    /// faults that hold and without the model's own errors.
    ///
    /// # Errors
    /// [`DepthMapError`] when the size of its maps cannot be made.
    pub fn answer(&mut self, map: &DepthMap) -> Result<(), DepthMapError> {
        let faultless = DepthNetworkModel {
            rows: 0,
            scale_noise: 0.0,
            scale_drift: 0.0,
            patch_noise: 0.0,
            pixel_noise: 0.0,
            smear: 0,
            holes: 0.0,
            max_depth: f64::INFINITY,
            ..self.model.clone()
        };
        let map = self.infer_by(&faultless, map)?;
        self.channel.send(map.stamp(), map);
        Ok(())
    }

    /// Takes the maps that have arrived by `now`, in the order of their arrival.
    pub fn receive(&mut self, now: Stamp) -> impl Iterator<Item = Delivered<DepthMap>> + '_ {
        self.channel.receive(now)
    }

    /// What it says about a frame.
    ///
    /// # Errors
    /// [`DepthMapError`] when the size of its maps cannot be made.
    pub fn infer(&self, truth: &DepthMap) -> Result<DepthMap, DepthMapError> {
        self.infer_by(&self.model, truth)
    }

    fn infer_by(
        &self,
        model: &DepthNetworkModel,
        truth: &DepthMap,
    ) -> Result<DepthMap, DepthMapError> {
        let stamp = truth.stamp();
        let mut random = item_stream(self.seed, stream_number(NAME), stamp.nanos());
        let mut log_scale = model.scale_noise * normal(&mut random)
            + model.scale_drift * self.drift.at(stamp.secs_f64());
        let (mut known, mut blind) = (1.0 - model.holes, false);
        for fault in holding(&model.faults, stamp) {
            match fault {
                DepthFault::Scale(factor) => log_scale += factor.ln(),
                DepthFault::Holes(share) => known *= 1.0 - share,
                DepthFault::Blind => blind = true,
                DepthFault::Rate(_) => {}
            }
        }
        let mut map = reduced(truth, model.rows)?;
        if blind {
            map.data_mut().fill(GUESS);
        }
        smear(&mut map, model.smear);
        let (width, height) = (map.width(), map.height());
        let errors = Patches::new(&mut random, width, height, model.patch_size);
        let holes = Patches::new(&mut random, width, height, 0.5 * model.patch_size);
        // Patches are normal, so the logistic curve tells (to 0.01) where the share
        // that is to be known ends.
        let last_known =
            if known >= 1.0 { f64::INFINITY } else { (known / (1.0 - known)).ln() / 1.702 };
        for (index, depth) in map.data_mut().iter_mut().enumerate() {
            let (x, y) = (index as u32 % width, index as u32 / width);
            let own = model.pixel_noise * normal(&mut random);
            if !DepthMap::is_known(*depth) {
                continue;
            }
            let error = log_scale + model.patch_noise * errors.at(x, y) + own;
            let wrong = f64::from(*depth) * error.exp();
            let is_known = holes.at(x, y) < last_known && wrong < model.max_depth;
            *depth = if is_known { wrong as f32 } else { DepthMap::UNKNOWN };
        }
        Ok(map)
    }
}

/// The map in `rows` rows, of the same shape: means over areas, unknown where less
/// than half is known.
fn reduced(truth: &DepthMap, rows: u32) -> Result<DepthMap, DepthMapError> {
    let (width, height) = (truth.width(), truth.height());
    if rows == 0 || rows >= height {
        return Ok(truth.clone());
    }
    let columns = (f64::from(width) * f64::from(rows) / f64::from(height)).round().max(1.0) as u32;
    let span = |index: u32, parts: u32, size: u32| {
        let edge = |index| (u64::from(index) * u64::from(size) / u64::from(parts)) as usize;
        edge(index)..edge(index + 1)
    };
    let mut data = Vec::with_capacity((rows * columns) as usize);
    for y in 0..rows {
        for x in 0..columns {
            let (mut sum, mut known, mut all) = (0.0_f32, 0_u32, 0_u32);
            for row in span(y, rows, height) {
                let part = truth.row(row as u32).get(span(x, columns, width)).unwrap_or(&[]);
                for depth in part {
                    all += 1;
                    if DepthMap::is_known(*depth) {
                        (sum, known) = (sum + depth, known + 1);
                    }
                }
            }
            data.push(if 2 * known > all { sum / known as f32 } else { DepthMap::UNKNOWN });
        }
    }
    DepthMap::new(truth.stamp(), columns, rows, data)
}

/// Means of the known depths over `reach` pixels either way, along rows and then
/// along columns; unknown pixels stay unknown.
fn smear(map: &mut DepthMap, reach: u32) {
    if reach == 0 {
        return;
    }
    let (width, height, reach) = (map.width() as usize, map.height() as usize, reach as usize);
    let mut line = Vec::new();
    for y in 0..height {
        smear_line(map.data_mut(), y * width, 1, width, reach, &mut line);
    }
    for x in 0..width {
        smear_line(map.data_mut(), x, width, height, reach, &mut line);
    }
}

fn smear_line(
    data: &mut [f32],
    start: usize,
    stride: usize,
    count: usize,
    reach: usize,
    line: &mut Vec<f32>,
) {
    line.clear();
    line.extend(data.iter().skip(start).step_by(stride).take(count));
    for (index, depth) in data.iter_mut().skip(start).step_by(stride).take(count).enumerate() {
        if !DepthMap::is_known(*depth) {
            continue;
        }
        let around = index.saturating_sub(reach)..(index + reach + 1).min(count);
        let known = line.get(around).unwrap_or(&[]).iter().filter(|d| DepthMap::is_known(**d));
        let (sum, number) = known.fold((0.0, 0.0), |(sum, number), d| (sum + d, number + 1.0));
        *depth = sum / number;
    }
}

/// Smooth noise over a map: normal with mean 0 and deviation 1 at each pixel.
struct Patches {
    columns: usize,
    spacing: f64,
    values: Vec<f64>,
}

impl Patches {
    fn new(random: &mut Random, width: u32, height: u32, size: f64) -> Self {
        let spacing = (size * f64::from(width)).max(1.0);
        let count = |side: u32| (f64::from(side) / spacing).ceil() as usize + 1;
        let (columns, rows) = (count(width), count(height));
        let values = (0..columns * rows).map(|_| normal(random)).collect();
        Self { columns, spacing, values }
    }

    /// Between the four values around; weights whose squares add up to 1 keep the
    /// deviation the same everywhere.
    fn at(&self, x: u32, y: u32) -> f64 {
        let split = |place: u32| {
            let place = f64::from(place) / self.spacing;
            let index = place.floor();
            let (sin, cos) = ((place - index) * std::f64::consts::FRAC_PI_2).sin_cos();
            (index as usize, [cos, sin])
        };
        let ((column, along), (row, down)) = (split(x), split(y));
        let value = |i: usize, j: usize| {
            self.values.get((row + j) * self.columns + column + i).copied().unwrap_or(0.0)
        };
        let rows = [0, 1].map(|j| along[0] * value(0, j) + along[1] * value(1, j));
        down[0] * rows[0] + down[1] * rows[1]
    }
}
