//! From the samples that a network predicts to a map over the frame.

use super::Alignment;
use realnet_core::DepthMap;

/// One axis of the way from the network's samples to the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axis {
    /// Samples, and pixels of the network's input that they cover.
    pub samples: u32,
    pub input: u32,
    /// Where the picture lies on the input: first pixel and length.
    pub start: u32,
    pub length: u32,
    /// Pixels of the map, which covers the picture.
    pub target: u32,
}

/// Where one pixel lies between two samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Tap {
    first: usize,
    second: usize,
    /// Share of the second.
    share: f32,
}

impl Axis {
    /// Pixel i of the map lies at `start + (i + 0.5)·length / target − 0.5` on the
    /// input. Samples outside the picture, on the bars, are not used.
    fn taps(&self, alignment: Alignment, out: &mut Vec<Tap>) {
        let [samples, input, start, length, target] =
            [self.samples, self.input, self.start, self.length, self.target].map(f64::from);
        // Sample k lies at offset + k·pitch on the input.
        let (offset, pitch) = match alignment {
            Alignment::Corners if self.samples > 1 => (0.0, (input - 1.0) / (samples - 1.0)),
            Alignment::Corners | Alignment::Centres => {
                let pitch = input / samples;
                (pitch / 2.0 - 0.5, pitch)
            }
        };
        // An input of one pixel in corner alignment: all samples lie on it.
        let pitch = pitch.max(f64::MIN_POSITIVE);
        let inner = |at: f64| (at - offset) / pitch;
        // Positions are exact to far less than this; it keeps samples on the rim.
        let slack = 1e-6;
        let low = (inner(start) - slack).ceil().clamp(0.0, samples - 1.0);
        let high = (inner(start + length - 1.0) + slack).floor().clamp(0.0, samples - 1.0);
        // A picture between two samples has none of its own.
        let (low, high) = if low <= high { (low, high) } else { (high, low) };
        out.clear();
        out.extend((0..self.target).map(|i| {
            let position = start + (f64::from(i) + 0.5) * length / target - 0.5;
            let at = inner(position).clamp(low, high);
            let first = at.floor();
            let second = (first + 1.0).min(high);
            Tap { first: first as usize, second: second as usize, share: (at - first) as f32 }
        }));
    }
}

/// Bilinear in depth. Between a known and an unknown sample the nearer one counts.
#[derive(Clone, Debug, Default)]
pub(super) struct Resampler {
    key: Option<(Alignment, Axis, Axis)>,
    columns: Vec<Tap>,
    rows: Vec<Tap>,
    /// Two rows of samples, stretched to the map's width.
    cache: [Vec<f32>; 2],
    cached: [Option<usize>; 2],
}

impl Resampler {
    /// Fills `map`, `across.target` x `down.target` values, from `samples`,
    /// `across.samples` x `down.samples` values.
    pub(super) fn run(
        &mut self,
        alignment: Alignment,
        (across, down): (Axis, Axis),
        samples: &[f32],
        map: &mut [f32],
    ) {
        let width = across.target as usize;
        if self.key != Some((alignment, across, down)) {
            across.taps(alignment, &mut self.columns);
            down.taps(alignment, &mut self.rows);
            self.cache.iter_mut().for_each(|row| row.resize(width, 0.0));
            self.key = Some((alignment, across, down));
        }
        self.cached = [None; 2];
        let pitch = across.samples as usize;
        for (line, tap) in map.chunks_exact_mut(width).zip(&self.rows) {
            let wanted = [tap.first, tap.second];
            // A row that both neighbours need moves from the second slot to the first.
            if self.cached[0] != Some(wanted[0]) && self.cached[1] == Some(wanted[0]) {
                self.cache.swap(0, 1);
                self.cached.swap(0, 1);
            }
            for (slot, row) in wanted.into_iter().enumerate() {
                if self.cached[slot] != Some(row) {
                    let source = samples.get(row * pitch..(row + 1) * pitch).unwrap_or_default();
                    stretch(source, &self.columns, &mut self.cache[slot]);
                    self.cached[slot] = Some(row);
                }
            }
            let [upper, lower] = &self.cache;
            for ((out, &a), &b) in line.iter_mut().zip(upper).zip(lower) {
                *out = between(a, b, tap.share);
            }
        }
    }
}

fn stretch(row: &[f32], columns: &[Tap], out: &mut [f32]) {
    let at = |x: usize| row.get(x).copied().unwrap_or(DepthMap::UNKNOWN);
    for (out, tap) in out.iter_mut().zip(columns) {
        *out = between(at(tap.first), at(tap.second), tap.share);
    }
}

#[inline(always)]
fn between(a: f32, b: f32, share: f32) -> f32 {
    let blend = a + (b - a) * share;
    let nearer = if share < 0.5 { a } else { b };
    // Depths are positive, unknown is 0.
    if a > 0.0 && b > 0.0 { blend } else { nearer }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(alignment: Alignment, across: Axis, down: Axis, samples: &[f32]) -> Vec<f32> {
        let mut map = vec![-1.0; (across.target * down.target) as usize];
        Resampler::default().run(alignment, (across, down), samples, &mut map);
        map
    }

    fn whole(samples: u32, input: u32, target: u32) -> Axis {
        Axis { samples, input, start: 0, length: input, target }
    }

    #[test]
    fn samples_on_every_pixel_stay_as_they_are() {
        let samples: Vec<f32> = (0..7 * 5).map(|i| 1.0 + i as f32 * 0.37).collect();
        for alignment in [Alignment::Corners, Alignment::Centres] {
            assert_eq!(run(alignment, whole(7, 7, 7), whole(5, 5, 5), &samples), samples);
        }
    }

    #[test]
    fn a_plane_stays_a_plane() {
        // Depth 2 + 0.01 x + 0.03 y on the input, told by fewer samples.
        let depth = |x: f64, y: f64| 2.0 + 0.01 * x + 0.03 * y;
        let (input, pixels) = ((64u32, 48u32), (160u32, 90u32));
        for (alignment, samples) in
            [(Alignment::Corners, (32u32, 24u32)), (Alignment::Centres, (16, 12))]
        {
            let at = |k: u32, samples: u32, input: u32| match alignment {
                Alignment::Corners => f64::from(k) * f64::from(input - 1) / f64::from(samples - 1),
                Alignment::Centres => {
                    (f64::from(k) + 0.5) * f64::from(input) / f64::from(samples) - 0.5
                }
            };
            let values: Vec<f32> = (0..samples.1)
                .flat_map(|y| (0..samples.0).map(move |x| (x, y)))
                .map(|(x, y)| depth(at(x, samples.0, input.0), at(y, samples.1, input.1)) as f32)
                .collect();
            // The picture lies on rows 6 to 41.
            let across = whole(samples.0, input.0, pixels.0);
            let down =
                Axis { samples: samples.1, input: input.1, start: 6, length: 36, target: pixels.1 };
            let map = run(alignment, across, down, &values);
            let margin = 10;
            for y in margin..pixels.1 - margin {
                for x in margin..pixels.0 - margin {
                    let u = (f64::from(x) + 0.5) * 64.0 / 160.0 - 0.5;
                    let v = 6.0 + (f64::from(y) + 0.5) * 36.0 / 90.0 - 0.5;
                    let found = map[(y * pixels.0 + x) as usize];
                    let error = (f64::from(found) - depth(u, v)).abs();
                    assert!(error < 1e-5, "{alignment:?} {x} {y}: {found}");
                }
            }
        }
    }

    #[test]
    fn bars_and_unknown_samples_do_not_mix_in() {
        // Rows 0, 1, 6 and 7 of the input are bars, told by samples of 100 m.
        let samples: Vec<f32> =
            (0..8 * 8).map(|i| if (2..6).contains(&(i / 8)) { 3.0 } else { 100.0 }).collect();
        let down = Axis { samples: 8, input: 8, start: 2, length: 4, target: 11 };
        let map = run(Alignment::Corners, whole(8, 8, 9), down, &samples);
        assert!(map.iter().all(|d| (d - 3.0).abs() < 1e-6), "{map:?}");

        let samples = [2.0, 0.0, 2.0, 2.0];
        let map = run(Alignment::Centres, whole(2, 2, 8), whole(2, 2, 8), &samples);
        assert!(map.iter().all(|&d| d == 0.0 || (d - 2.0).abs() < 1e-6), "{map:?}");
        assert!(map.contains(&0.0) && map.iter().filter(|d| **d > 0.0).count() >= 32);
    }

    #[test]
    fn tiny_pictures_do_not_panic() {
        for alignment in [Alignment::Corners, Alignment::Centres] {
            let thin = Axis { samples: 4, input: 8, start: 3, length: 1, target: 5 };
            let one = whole(1, 1, 3);
            let map = run(alignment, thin, one, &[1.0, 2.0, 3.0, 4.0]);
            assert!(map.iter().all(|d| (1.0..=4.0).contains(d)), "{map:?}");
        }
    }
}
