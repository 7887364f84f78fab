//! Changes of colour, on planes of red, green and blue.

use crate::random::Dice;
use realnet_core::{Frame, OptionError, Stamp};
use realnet_io::picture::{self, Encoding, Limits};
use realnet_vision::simd::{Simd, multiversion};
use serde::{Deserialize, Serialize};

/// How much colours, light and sharpness may change. 0 switches a change off.
///
/// They come in the order in which light becomes a file: grey, light
/// ([`exposure`](Self::exposure), [`gamma`](Self::gamma), [`contrast`](Self::contrast),
/// [`brightness`](Self::brightness)), hue and saturation, blur, noise, JPEG.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ColorAugment {
    /// The hue is multiplied by up to `1 ± hsv_h` (on a circle of 180 steps that begins
    /// at red, as OpenCV's and YOLOv5's).
    pub hsv_h: f64,
    /// The saturation is multiplied by up to `1 ± hsv_s`.
    pub hsv_s: f64,
    /// The value (the largest of the three colours) is multiplied by up to `1 ± hsv_v`.
    pub hsv_v: f64,
    /// Up to this is added, as a share of white.
    pub brightness: f64,
    /// The distance from mid-grey is multiplied by up to `1 ± contrast`.
    pub contrast: f64,
    /// Values from 0 to 1 are raised to a power of up to `(1 + gamma)^±1`.
    pub gamma: f64,
    /// Light is multiplied by up to `2^±exposure` (stops), taking values as squares of
    /// what the file has (a gamma of 2); what becomes brighter than white is clipped.
    pub exposure: f64,
    /// Share of the pictures that become grey.
    pub grey: f64,
    /// Share of the pictures that are blurred, half of them evenly (Gaussian), half of
    /// them along a line, as by motion.
    pub blur: f64,
    /// Largest blur: deviation of the Gaussian, and a quarter of the line's length, in
    /// pixels of the network's input.
    pub blur_px: f64,
    /// Share of the pictures with noise.
    pub noise: f64,
    /// Largest deviation of the noise, as a share of white.
    pub noise_level: f64,
    /// Share of the pictures that go through JPEG.
    pub jpeg: f64,
    /// Lowest JPEG quality, 1 to 95; the highest is 95.
    pub jpeg_quality: u8,
}

impl Default for ColorAugment {
    fn default() -> Self {
        Self::NONE
    }
}

impl ColorAugment {
    /// No change.
    pub const NONE: Self = Self {
        hsv_h: 0.0,
        hsv_s: 0.0,
        hsv_v: 0.0,
        brightness: 0.0,
        contrast: 0.0,
        gamma: 0.0,
        exposure: 0.0,
        grey: 0.0,
        blur: 0.0,
        blur_px: 1.5,
        noise: 0.0,
        noise_level: 0.04,
        jpeg: 0.0,
        jpeg_quality: 40,
    };

    /// Refuses what cannot be.
    ///
    /// # Errors
    /// [`OptionError`] with the first option that is out of its range.
    pub fn check(&self) -> Result<(), OptionError> {
        let share = |name, value: f64| {
            OptionError::check(name, value, (0.0..=1.0).contains(&value), "from 0 to 1")
        };
        let level = |name, value: f64, most: f64, rule| {
            OptionError::check(name, value, (0.0..=most).contains(&value), rule)
        };
        share("hsv_h", self.hsv_h)?;
        share("hsv_s", self.hsv_s)?;
        share("hsv_v", self.hsv_v)?;
        share("brightness", self.brightness)?;
        share("contrast", self.contrast)?;
        level("gamma", self.gamma, 4.0, "from 0 to 4")?;
        level("exposure", self.exposure, 4.0, "from 0 to 4 stops")?;
        share("grey", self.grey)?;
        share("blur", self.blur)?;
        level("blur_px", self.blur_px, 20.0, "from 0 to 20 pixels")?;
        share("noise", self.noise)?;
        share("noise_level", self.noise_level)?;
        share("jpeg", self.jpeg)?;
        let quality = f64::from(self.jpeg_quality);
        OptionError::check("jpeg_quality", quality, (1.0..=95.0).contains(&quality), "from 1 to 95")
    }

    /// Changes planes of `width` x `height` bytes. Takes the same random numbers whatever
    /// the picture is.
    pub(crate) fn apply(
        &self,
        dice: &mut Dice,
        simd: Simd,
        (width, height): (u32, u32),
        planes: &mut [u8],
    ) {
        let plane = width as usize * height as usize;
        if planes.len() != 3 * plane || plane == 0 {
            return;
        }
        if dice.chance(self.grey) {
            to_grey(planes, plane);
        }
        if let Some(table) = self.light(dice) {
            planes.iter_mut().for_each(|value| *value = table[usize::from(*value)]);
        }
        let gains = [self.hsv_h, self.hsv_s, self.hsv_v].map(|most| 1.0 + dice.around_zero(most));
        if gains != [1.0; 3] {
            let (red, rest) = planes.split_at_mut(plane);
            let (green, blue) = rest.split_at_mut(plane);
            shift_hsv(simd, red, green, blue, gains.map(|gain| gain as f32));
        }
        if dice.chance(self.blur) {
            let strength = dice.between(0.3, 1.0) * self.blur_px;
            let (even, angle) = (dice.chance(0.5), dice.between(0.0, std::f64::consts::PI));
            let taps = if even { gaussian(strength) } else { line(4.0 * strength, angle) };
            for plane in planes.chunks_exact_mut(plane) {
                if even {
                    filter(plane, width, height, &taps);
                    let turned: Vec<Tap> =
                        taps.iter().map(|t| Tap { x: t.y, y: t.x, ..*t }).collect();
                    filter(plane, width, height, &turned);
                } else {
                    filter(plane, width, height, &taps);
                }
            }
        }
        if dice.chance(self.noise) {
            let level = (255.0 * self.noise_level * dice.between(0.1, 1.0)) as f32;
            for value in planes.iter_mut() {
                // A cast keeps to 0 and 255.
                *value = (f32::from(*value) + level * dice.normal() + 0.5) as u8;
            }
        }
        if dice.chance(self.jpeg) {
            let quality = dice.between(f64::from(self.jpeg_quality), 95.0).round() as u8;
            through_jpeg(planes, width, height, quality);
        }
    }

    /// What becomes of each value by light alone; `None` when nothing changes.
    fn light(&self, dice: &mut Dice) -> Option<[u8; 256]> {
        let stops = dice.around_zero(self.exposure);
        let power = (1.0 + self.gamma).powf(dice.around_zero(1.0));
        let contrast = 1.0 + dice.around_zero(self.contrast);
        let offset = dice.around_zero(self.brightness);
        if stops == 0.0 && power == 1.0 && contrast == 1.0 && offset == 0.0 {
            return None;
        }
        let gain = (stops / 2.0).exp2();
        Some(std::array::from_fn(|value| {
            let value = (value as f64 / 255.0 * gain).clamp(0.0, 1.0).powf(power);
            let value = (value - 0.5) * contrast + 0.5 + offset;
            (255.0 * value + 0.5) as u8
        }))
    }
}

/// By the luma weights of ITU-R BT.601, as `Frame::to_grey`.
fn to_grey(planes: &mut [u8], plane: usize) {
    let (red, rest) = planes.split_at_mut(plane);
    let (green, blue) = rest.split_at_mut(plane);
    for ((r, g), b) in red.iter_mut().zip(green).zip(blue) {
        let sum = u32::from(*r) * 4899 + u32::from(*g) * 9617 + u32::from(*b) * 1868;
        let grey = ((sum + (1 << 13)) >> 14) as u8;
        (*r, *g, *b) = (grey, grey, grey);
    }
}

multiversion! {
/// Multiplies hue, saturation and value by `gains`.
///
/// With the hue in sixths of the circle a colour is
/// `V - V S max(0, min(k, 4 - k, 1))`, `k = (n + H) mod 6`, n = 5, 3, 1 for red, green
/// and blue.
fn shift_hsv(red: &mut [u8], green: &mut [u8], blue: &mut [u8], gains: [f32; 3]) {
    let [gain_h, gain_s, gain_v] = gains;
    for ((red, green), blue) in red.iter_mut().zip(green.iter_mut()).zip(blue.iter_mut()) {
        let (r, g, b) = (f32::from(*red), f32::from(*green), f32::from(*blue));
        let most = r.max(g).max(b);
        let least = r.min(g).min(b);
        let spread = most - least;
        let inverse = 1.0 / spread.max(1e-3);
        // Written as choices, so that it is compiled without branches.
        let of_red = (g - b) * inverse;
        let of_green = (b - r) * inverse + 2.0;
        let of_blue = (r - g) * inverse + 4.0;
        let hue = if most == r { of_red } else if most == g { of_green } else { of_blue };
        let hue = if hue < 0.0 { hue + 6.0 } else { hue } * gain_h;
        let hue = if hue >= 6.0 { hue - 6.0 } else { hue };
        let value = (most * gain_v).min(255.0);
        let saturation = (spread / most.max(1e-3) * gain_s).min(1.0);
        let depth = value * saturation;
        let channel = |n: f32| {
            let k = n + hue;
            let k = if k >= 6.0 { k - 6.0 } else { k };
            let share = k.min(4.0 - k).clamp(0.0, 1.0);
            (value - depth * share + 0.5) as i32 as u8
        };
        *red = channel(5.0);
        *green = channel(3.0);
        *blue = channel(1.0);
    }
}
}

/// A pixel that counts, from the one in the middle.
#[derive(Clone, Copy, Debug)]
struct Tap {
    x: i64,
    y: i64,
    weight: f32,
}

/// One row of a Gaussian.
fn gaussian(deviation: f64) -> Vec<Tap> {
    let reach = (3.0 * deviation).ceil().max(1.0) as i64;
    let weight = |x: i64| (-0.5 * (x as f64 / deviation.max(0.05)).powi(2)).exp();
    let sum: f64 = (-reach..=reach).map(weight).sum();
    (-reach..=reach).map(|x| Tap { x, y: 0, weight: (weight(x) / sum) as f32 }).collect()
}

/// A line through the middle.
fn line(length: f64, angle: f64) -> Vec<Tap> {
    let count = (2.0 * length).ceil().max(2.0) as usize;
    let along = |k: usize| length * (k as f64 / (count - 1) as f64 - 0.5);
    let tap = |k| {
        let (sin, cos) = angle.sin_cos();
        let (x, y) = ((along(k) * cos).round() as i64, (along(k) * sin).round() as i64);
        Tap { x, y, weight: 1.0 / count as f32 }
    };
    (0..count).map(tap).collect()
}

/// A plane filtered by taps; beyond its edge it goes on as it is there.
fn filter(plane: &mut [u8], width: u32, height: u32, taps: &[Tap]) {
    let (columns, rows) = (i64::from(width), i64::from(height));
    let source = plane.to_vec();
    let mut sums = vec![0.0f32; width as usize];
    for (y, row) in (0i64..).zip(plane.chunks_exact_mut(width as usize)) {
        sums.fill(0.5);
        for tap in taps {
            let from = (y + tap.y).clamp(0, rows - 1) * columns;
            let Some(from) = source.get(from as usize..(from + columns) as usize) else { continue };
            let (Some(first), Some(last)) = (from.first(), from.last()) else { continue };
            let (left, right) = ((-tap.x).clamp(0, columns), (columns - tap.x).clamp(0, columns));
            for (x, sum) in (0i64..).zip(sums.iter_mut()) {
                let value = match x {
                    x if x < left => first,
                    x if x >= right => last,
                    x => from.get((x + tap.x) as usize).unwrap_or(last),
                };
                *sum += tap.weight * f32::from(*value);
            }
        }
        row.iter_mut().zip(&sums).for_each(|(value, sum)| *value = *sum as u8);
    }
}

/// Compressed and decompressed again; left as it is should the encoder fail.
fn through_jpeg(planes: &mut [u8], width: u32, height: u32, quality: u8) {
    let plane = planes.len() / 3;
    let mut pixels = vec![0; planes.len()];
    for (from, offset) in planes.chunks_exact(plane).zip(0..) {
        pixels.iter_mut().skip(offset).step_by(3).zip(from).for_each(|(to, v)| *to = *v);
    }
    let Ok(frame) = Frame::rgb8(Stamp::ZERO, width, height, pixels) else { return };
    let Ok(bytes) = picture::encode(&frame, Encoding::Jpeg { quality }) else { return };
    let Ok(back) = picture::decode(&bytes, &Limits::default(), frame.into_data()) else { return };
    planar(&back, planes);
}

/// The channels of an RGB frame one after the other.
pub(crate) fn planar(frame: &Frame, planes: &mut [u8]) {
    let plane = (planes.len() / 3).max(1);
    for (to, offset) in planes.chunks_exact_mut(plane).zip(0..) {
        to.iter_mut().zip(frame.data().iter().skip(offset).step_by(3)).for_each(|(to, v)| *to = *v);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Purpose;
    use proptest::prelude::*;

    fn dice(index: usize) -> Dice {
        Dice::new(1, Purpose::Detection, 0, index)
    }

    /// Saturation and value are those asked for, and a gain of 1 changes nothing.
    #[test]
    fn hsv_is_the_textbook_one() {
        let colors = [
            [200u8, 50, 50],
            [50, 200, 80],
            [10, 20, 30],
            [0, 0, 0],
            [255, 255, 255],
            [90, 90, 200],
            [120, 7, 119],
        ];
        for color in colors {
            let shifted = |gains| {
                let [mut r, mut g, mut b] = color.map(|v| [v]);
                shift_hsv(Simd::best(), &mut r, &mut g, &mut b, gains);
                [r[0], g[0], b[0]]
            };
            assert_eq!(shifted([1.0; 3]), color);
            let most = f32::from(*color.iter().max().unwrap());
            let least = f32::from(*color.iter().min().unwrap());
            let pale = shifted([1.0, 0.5, 1.0]);
            assert_eq!(f32::from(*pale.iter().max().unwrap()), most);
            let wanted = most - 0.5 * (most - least);
            assert!((f32::from(*pale.iter().min().unwrap()) - wanted).abs() <= 1.0, "{pale:?}");
            let dark = shifted([1.0, 1.0, 0.5]);
            for (dark, bright) in dark.into_iter().zip(color) {
                assert!((f32::from(dark) - 0.5 * f32::from(bright)).abs() <= 1.0, "{dark:?}");
            }
        }
        // Green (hue 2 of 6) times 1.5 is cyan-blue (3 of 6): equal green and blue.
        let (mut r, mut g, mut b) = ([0], [200], [0]);
        shift_hsv(Simd::best(), &mut r, &mut g, &mut b, [1.5, 1.0, 1.0]);
        assert_eq!([r[0], g[0], b[0]], [0, 200, 200]);
    }

    #[test]
    fn each_change_does_what_its_name_says() {
        let start: Vec<u8> = (0..3 * 32 * 32).map(|i| (i * 53 % 200 + 20) as u8).collect();
        let changed = |options: ColorAugment| {
            options.check().unwrap();
            (0..8)
                .map(|index| {
                    let mut planes = start.clone();
                    options.apply(&mut dice(index), Simd::best(), (32, 32), &mut planes);
                    planes
                })
                .collect::<Vec<_>>()
        };
        let none = ColorAugment::NONE;
        assert!(changed(none).iter().all(|planes| *planes == start));
        let rough = |p: &[u8]| p.windows(2).map(|w| u64::from(w[0].abs_diff(w[1]))).sum::<u64>();
        for grey in changed(ColorAugment { grey: 1.0, ..none }) {
            assert!(grey[..1024] == grey[1024..2048] && grey[..1024] == grey[2048..]);
        }
        for blurred in changed(ColorAugment { blur: 1.0, ..none }) {
            assert!(rough(&blurred) < rough(&start));
            let mean = |p: &[u8]| p.iter().map(|v| f64::from(*v)).sum::<f64>() / p.len() as f64;
            assert!((mean(&blurred) - mean(&start)).abs() < 2.0);
        }
        for (index, jpeg) in changed(ColorAugment { jpeg: 1.0, ..none }).iter().enumerate() {
            assert!(*jpeg != start, "{index}");
        }
        for options in [
            ColorAugment { noise: 1.0, ..none },
            ColorAugment { exposure: 1.0, ..none },
            ColorAugment { gamma: 0.5, ..none },
            ColorAugment { contrast: 0.5, ..none },
            ColorAugment { brightness: 0.3, ..none },
        ] {
            let all = changed(options);
            assert!(all.iter().all(|planes| *planes != start), "{options:?}");
            assert!(all[0] != all[1], "{options:?}");
        }
    }

    proptest! {
        #[test]
        fn every_instruction_set_gives_the_same_bytes(
            bytes in proptest::collection::vec(any::<u8>(), 0..200),
            gains in proptest::array::uniform3(0.0f32..2.0),
        ) {
            let plane = bytes.len() / 3;
            let mut all = Vec::new();
            for &simd in Simd::found() {
                let mut planes = bytes[..3 * plane].to_vec();
                let (red, rest) = planes.split_at_mut(plane);
                let (green, blue) = rest.split_at_mut(plane);
                shift_hsv(simd, red, green, blue, gains);
                all.push(planes);
            }
            prop_assert!(all.iter().all(|planes| *planes == all[0]));
        }
    }

    #[test]
    fn what_cannot_be_is_refused() {
        for bad in [
            ColorAugment { hsv_s: 1.5, ..ColorAugment::NONE },
            ColorAugment { grey: -0.1, ..ColorAugment::NONE },
            ColorAugment { blur_px: f64::NAN, ..ColorAugment::NONE },
            ColorAugment { jpeg_quality: 0, ..ColorAugment::NONE },
        ] {
            assert!(bad.check().is_err(), "{bad:?}");
        }
    }
}
