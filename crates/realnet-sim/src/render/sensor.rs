//! From linear light to bytes: gain, vignetting, noise, transfer curve.

use super::camera::{Exposure, Sensor};
use super::canvas::Rays;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use realnet_core::CameraModel;
use realnet_vision::simd::multiversion;

/// Normal deviates that are kept; rows of a picture start at random places of it.
const NOISE: usize = 1 << 16;
/// Units of a kept deviate.
const UNIT: f32 = 1.0 / 31.0;

/// What fell on the sensor, and how it is read out.
pub(super) struct Exposed<'a> {
    pub(super) light: &'a [Vec<f32>; 3],
    pub(super) gain: f64,
    /// Applied to the light first.
    pub(super) scale: f32,
    /// Of the noise.
    pub(super) seed: u64,
}

/// Makes bytes of light.
#[derive(Clone, Debug)]
pub(super) struct Development {
    /// What the lens lets through, for each pixel.
    vignette: Vec<f32>,
    noise: Vec<i8>,
    gain: Option<f64>,
    last_time: f64,
}

impl Development {
    pub(super) fn new(model: &CameraModel, rays: &Rays, sensor: &Sensor) -> Self {
        let (cx, cy) = (0.5 * f64::from(model.width() - 1), 0.5 * f64::from(model.height() - 1));
        let corner = (cx * cx + cy * cy).max(1.0);
        let through = |i: usize| {
            let (x, y) = ((i % rays.stride) as f64 - cx, (i / rays.stride) as f64 - cy);
            (1.0 - sensor.vignetting * (x * x + y * y) / corner).max(0.0) as f32
        };
        let mut rng = Pcg64Mcg::seed_from_u64(0x5eed_4015);
        let room = NOISE + 3 * rays.stride;
        let deviate = |_| {
            let value: f32 = rng.sample(StandardNormal);
            (value / UNIT).round().clamp(-127.0, 127.0) as i8
        };
        Self {
            vignette: (0..rays.len()).map(through).collect(),
            noise: (0..room).map(deviate).collect(),
            gain: None,
            last_time: 0.0,
        }
    }

    /// Forgets the gain so far.
    pub(super) fn reset(&mut self) {
        self.gain = None;
    }

    /// The gain for a picture of this mean light. Automatic exposure knows the light of
    /// the frame before only through the gain it has.
    pub(super) fn gain(&mut self, sensor: &Sensor, time: f64, mean: f64) -> f64 {
        match sensor.exposure {
            Exposure::Fixed { gain } => gain,
            Exposure::Auto { lag_s, target, max_gain } => {
                let wanted = (target / mean.max(1e-6)).clamp(1e-3, max_gain);
                let gain = match self.gain {
                    None => wanted,
                    Some(gain) => {
                        let elapsed = (time - self.last_time).max(0.0);
                        let share = 1.0 - (-elapsed / lag_s.max(1e-6)).exp();
                        gain * (wanted / gain).powf(share)
                    }
                };
                self.gain = Some(gain);
                self.last_time = time;
                gain
            }
        }
    }

    /// Mean light of a picture, of a grid of its pixels.
    pub(super) fn mean(rays: &Rays, light: &[Vec<f32>; 3]) -> f64 {
        let (mut sum, mut count) = (0.0, 0u32);
        for y in (0..rays.height).step_by(8) {
            for x in (0..rays.width).step_by(8) {
                let i = y * rays.stride + x;
                // A white lamp counts as white.
                sum += light.iter().map(|plane| f64::from(plane[i].min(2.0))).sum::<f64>() / 3.0;
                count += 1;
            }
        }
        sum / f64::from(count.max(1))
    }

    /// Writes the bytes of a picture.
    pub(super) fn develop(
        &self,
        simd: realnet_vision::simd::Simd,
        sensor: &Sensor,
        rays: &Rays,
        exposed: &Exposed<'_>,
        bytes: &mut [u8],
    ) {
        let Exposed { light, gain, scale, seed } = *exposed;
        let Rays { width, stride, .. } = *rays;
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let noise = [
            (sensor.shot_noise * sensor.shot_noise) as f32,
            (sensor.read_noise * sensor.read_noise) as f32,
        ];
        for (y, row) in bytes.chunks_exact_mut(3 * width).enumerate() {
            let from = y * stride;
            let place = (rng.random::<u32>() as usize) % NOISE;
            let planes = [0, 1, 2].map(|c: usize| &light[c][from..from + stride]);
            let vignette = &self.vignette[from..from + stride];
            let deviates = &self.noise[place..place + 3 * stride];
            develop_row(simd, planes, vignette, deviates, noise, gain as f32, scale, row);
        }
    }
}

multiversion! {
fn develop_row(
    light: [&[f32]; 3],
    vignette: &[f32],
    deviates: &[i8],
    noise: [f32; 2],
    gain: f32,
    scale: f32,
    row: &mut [u8],
) {
    const CHUNK: usize = 16;
    let [shot, read] = noise;
    let mut out = [0u8; 3 * CHUNK];
    let chunks = row.len().div_ceil(3 * CHUNK);
    for chunk in 0..chunks {
        let at = chunk * CHUNK;
        let mut values = [[0u8; CHUNK]; 3];
        for c in 0..3 {
            let (Some(light), Some(vignette), Some(deviates)) = (
                light[c].get(at..).and_then(|rest| rest.first_chunk::<CHUNK>()),
                vignette.get(at..).and_then(|rest| rest.first_chunk::<CHUNK>()),
                deviates.get(3 * at + c * CHUNK..).and_then(|rest| rest.first_chunk::<CHUNK>()),
            ) else { continue };
            for i in 0..CHUNK {
                let falling = light[i] * (vignette[i] * scale);
                let deviation = (shot * falling + read).sqrt() * UNIT;
                let value = gain * (falling + deviation * f32::from(deviates[i]));
                // Not a number, where the lens sees nothing, becomes black.
                let value = if value > 0.0 { value } else { 0.0 };
                let value = if value < 1.0 { value } else { 1.0 };
                values[c][i] = (value.sqrt() * 255.0 + 0.5) as i32 as u8;
            }
        }
        for i in 0..CHUNK {
            out[3 * i] = values[0][i];
            out[3 * i + 1] = values[1][i];
            out[3 * i + 2] = values[2][i];
        }
        let row = &mut row[3 * at..];
        let count = row.len().min(3 * CHUNK);
        row[..count].copy_from_slice(&out[..count]);
    }
}
}
