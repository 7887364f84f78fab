//! A detector, played by the truth.

use super::channel::{Channel, ChannelModel, Delivered, Latency};
use super::random::{Random, SlowNoise, item_stream, normal, stream_number};
use super::schedule::Schedule;
use rand::RngExt;
use realnet_core::{BoundingBox, Detection, Stamp};

const NAME: &str = "detector";

/// What there is to be detected in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibleObject {
    /// Which object it is, the same from frame to frame.
    pub id: u32,
    /// Its class.
    pub class_id: u32,
    /// Smallest box around what is seen of it, pixels.
    pub bbox: BoundingBox,
    /// Share of it that is seen: neither hidden by others nor outside of the
    /// picture, 0 to 1.
    pub visible_share: f64,
    /// How far its picture moves during the exposure, or is out of focus, pixels.
    pub blur_px: f64,
}

/// How a detector is wrong and late.
#[derive(Clone, Debug, PartialEq)]
pub struct DetectorModel {
    /// Frames that it takes in a second.
    pub rate_hz: f64,
    /// How its answers travel; the latency counts from the exposure of the frame.
    pub channel: ChannelModel,
    /// Deviation of each edge of a box, as a share of the box's size across it...
    pub edge_noise: f64,
    /// ... and in pixels, for small boxes.
    pub edge_noise_px: f64,
    /// Share of the variance of the edges that wanders instead of jittering, 0 to 1.
    pub edge_drift: f64,
    /// Share of good views that are missed, 0 to 1.
    pub miss: f64,
    /// Shorter side of a box that is found in half of the frames, pixels.
    pub half_size_px: f64,
    /// Visible share at which an object is found in half of the frames.
    pub half_visible: f64,
    /// Light, see [`Detector::show`], at which objects are found in half of the frames:
    /// below it there is more noise than picture.
    pub half_light: f64,
    /// Blur over the box's shorter side at which an object is found in half of the
    /// frames.
    pub half_blur: f64,
    /// How long a miss lasts, s: misses come in bursts.
    pub burst_s: f64,
    /// False positives in a frame, in the mean; at most one comes.
    pub false_positives: f64,
    /// Class of the false positives.
    pub false_class_id: u32,
}

impl Default for DetectorModel {
    /// A small YOLO on a small computer: each frame of 30 Hz, 50 ms late.
    fn default() -> Self {
        Self {
            rate_hz: 30.0,
            channel: ChannelModel {
                latency: Latency { mean_s: 0.05, jitter_s: 0.005 },
                ..ChannelModel::default()
            },
            edge_noise: 0.012,
            edge_noise_px: 0.5,
            edge_drift: 0.4,
            miss: 0.02,
            half_size_px: 9.0,
            half_visible: 0.3,
            half_light: 0.004,
            half_blur: 0.5,
            burst_s: 0.1,
            false_positives: 0.01,
            false_class_id: 0,
        }
    }
}

/// A detector, played by the truth.
///
/// What it says about a frame depends on its model, the seed, the frame's stamp and
/// what is seen, on nothing that was before.
#[derive(Clone, Debug)]
pub struct Detector {
    model: DetectorModel,
    seed: u64,
    schedule: Schedule,
    channel: Channel<Vec<Detection>>,
}

impl Detector {
    /// A detector with the random numbers of a seed.
    #[must_use]
    pub fn new(model: DetectorModel, seed: u64) -> Self {
        let channel = Channel::new(model.channel.clone(), seed, "detector: channel");
        Self { model, seed, schedule: Schedule::default(), channel }
    }

    /// Shows it a frame of `width` x `height` pixels by what is to be seen in it.
    /// `light` is the mean light on the sensor, before any amplification: 1 for a white
    /// picture in a well-lit room. Whether it took it.
    pub fn show(
        &mut self,
        stamp: Stamp,
        (width, height): (u32, u32),
        light: f64,
        objects: &[VisibleObject],
    ) -> bool {
        let taken = self.take(stamp);
        if taken {
            let found = self.infer(stamp, (width, height), light, objects);
            self.answer(stamp, found);
        }
        taken
    }

    /// Whether it takes a frame of this stamp, which then counts as taken.
    pub fn take(&mut self, stamp: Stamp) -> bool {
        self.schedule.take(stamp, self.model.rate_hz)
    }

    /// Another detector's answer to a frame that was taken: it goes the same way.
    pub fn answer(&mut self, stamp: Stamp, found: Vec<Detection>) {
        self.channel.send(stamp, found);
    }

    /// Takes the answers that have arrived by `now`, in the order of their arrival.
    /// Each is a frame's detections, the most confident first.
    pub fn receive(&mut self, now: Stamp) -> impl Iterator<Item = Delivered<Vec<Detection>>> + '_ {
        self.channel.receive(now)
    }

    /// What it says about a frame, see [`Detector::show`].
    #[must_use]
    pub fn infer(
        &self,
        stamp: Stamp,
        (width, height): (u32, u32),
        light: f64,
        objects: &[VisibleObject],
    ) -> Vec<Detection> {
        let size = (width as f32, height as f32);
        let mut found: Vec<Detection> =
            objects.iter().filter_map(|object| self.look(stamp, size, light, object)).collect();
        let mut random = item_stream(self.seed, stream_number(NAME), stamp.nanos());
        if random.random::<f64>() < self.model.false_positives {
            found.push(phantom(&mut random, size, self.model.false_class_id));
        }
        found.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
        found
    }

    /// One object: found or missed.
    fn look(
        &self,
        stamp: Stamp,
        (width, height): (f32, f32),
        light: f64,
        object: &VisibleObject,
    ) -> Option<Detection> {
        let (model, bbox) = (&self.model, object.bbox.clipped(width, height));
        if !bbox.is_proper() || object.visible_share <= 0.0 {
            return None;
        }
        let id = u64::from(object.id);
        let name = stream_number("detector: object").wrapping_add(id);
        let mut random = item_stream(self.seed, name, stamp.nanos());
        let time = stamp.secs_f64();
        let wandering = |what: u64, seconds: f64| {
            SlowNoise::new(self.seed, "detector: wandering", 8 * id + what, seconds).at(time)
        };

        let quality = self.quality(light, object, &bbox);
        let chance = quality * (1.0 - model.miss);
        // Half of the lot is drawn anew for each frame, half lasts: misses in bursts.
        let lot = (wandering(4, model.burst_s) + normal(&mut random)) * 0.5_f64.sqrt();
        // The logistic curve stands for the normal distribution here, to 0.01.
        if 1.0 / (1.0 + (-1.702 * lot).exp()) >= chance {
            return None;
        }

        let mut edge = |what: u64, place: f32, side: f32, border: f32| {
            let jitter = (1.0 - model.edge_drift).max(0.0).sqrt() * normal(&mut random);
            let drift = model.edge_drift.max(0.0).sqrt() * wandering(what, 0.5);
            let deviation = model.edge_noise_px.max(model.edge_noise * f64::from(side));
            // Where the picture ends, so do boxes.
            let is_cut = place <= 0.0 || place >= border;
            if is_cut { place } else { place + (deviation * (jitter + drift)) as f32 }
        };
        let (across, down) = (bbox.width(), bbox.height());
        let seen = BoundingBox::new(
            edge(0, bbox.x0, across, width),
            edge(1, bbox.y0, down, height),
            edge(2, bbox.x1, across, width),
            edge(3, bbox.y1, down, height),
        )
        .clipped(width, height);
        let confidence = 0.3 + 0.62 * quality + 0.03 * normal(&mut random);
        seen.is_proper().then_some(Detection {
            class_id: object.class_id,
            confidence: confidence.clamp(0.05, 0.99) as f32,
            bbox: seen,
        })
    }

    /// How well an object is seen, 0 to 1: a product of logistic curves, each 1/2
    /// where the model says so.
    fn quality(&self, light: f64, object: &VisibleObject, bbox: &BoundingBox) -> f64 {
        let side = f64::from(bbox.width().min(bbox.height()));
        // Of the logarithm of how many times better than half-way it is.
        let curve = |times: f64, softness: f64| 1.0 / (1.0 + times.max(1e-9).powf(-1.0 / softness));
        let blur = object.blur_px / side;
        curve(side / self.model.half_size_px, 0.2)
            * curve(object.visible_share / self.model.half_visible, 0.15)
            * curve(light / self.model.half_light, 0.2)
            * if blur > 0.0 { curve(self.model.half_blur / blur, 0.25) } else { 1.0 }
    }
}

/// A detection of nothing.
fn phantom(random: &mut Random, (width, height): (f32, f32), class_id: u32) -> Detection {
    let mut between = |from: f32, to: f32| from + (to - from) * random.random::<f32>();
    let (w, h) = (between(0.03, 0.2) * width, between(0.05, 0.25) * height);
    let bbox =
        BoundingBox::from_corner(between(0.0, width - w), between(0.2 * height, height - h), w, h);
    Detection { class_id, confidence: between(0.2, 0.55), bbox }
}
