//! Rewriting convolutions: batch normalisation folded in, Focus as a 6x6 kernel.

/// Batch normalisation at run time: `(x − mean) / sqrt(var + eps) · weight + bias`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BatchNorm<'a> {
    pub weight: &'a [f32],
    pub bias: &'a [f32],
    pub mean: &'a [f32],
    pub var: &'a [f32],
    pub eps: f64,
}

/// Folds a normalisation into the convolution before it, in double precision.
///
/// `weight` has as many rows as the normalisation has channels. Returns the new
/// weights and biases: with s = γ / sqrt(var + ε) they are W·s and (b − mean)·s + β.
pub(crate) fn fold(weight: &[f32], bias: Option<&[f32]>, bn: &BatchNorm) -> (Vec<f32>, Vec<f32>) {
    let channels = bn.weight.len();
    let row = weight.len() / channels.max(1);
    let mut folded = Vec::with_capacity(weight.len());
    let mut biases = Vec::with_capacity(channels);
    let parameters = bn.weight.iter().zip(bn.bias).zip(bn.mean.iter().zip(bn.var));
    for (channel, ((&gamma, &beta), (&mean, &var))) in parameters.enumerate() {
        let scale = f64::from(gamma) / (f64::from(var) + bn.eps).sqrt();
        let before = bias.and_then(|b| b.get(channel)).copied().unwrap_or(0.0);
        biases.push(((f64::from(before) - f64::from(mean)) * scale + f64::from(beta)) as f32);
        let weights = weight.iter().skip(channel * row).take(row);
        folded.extend(weights.map(|&w| (f64::from(w) * scale) as f32));
    }
    (folded, biases)
}

/// The kernel over the image that equals `kernel` over the output of Focus.
///
/// Focus stacks the four phases of 2x2 cells in the order (row, column) =
/// (0,0), (1,0), (0,1), (1,1). A `k`x`k` kernel of shape `[out, 4·channels, k, k]`
/// with padding p and stride 1 over that equals a `2k`x`2k` kernel of shape
/// `[out, channels, 2k, 2k]` with padding 2p and stride 2 over the image.
pub(crate) fn focus_kernel(kernel: &[f32], out: usize, channels: usize, k: usize) -> Vec<f32> {
    let mut wide = Vec::with_capacity(kernel.len());
    for o in 0..out {
        for c in 0..channels {
            for y in 0..2 * k {
                for x in 0..2 * k {
                    let phase = (y % 2) + 2 * (x % 2);
                    let channel = phase * channels + c;
                    let at = ((o * 4 * channels + channel) * k + y / 2) * k + x / 2;
                    wide.push(kernel.get(at).copied().unwrap_or(0.0));
                }
            }
        }
    }
    wide
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Plain convolution of a `c`x`h`x`w` picture, the reference.
    #[allow(clippy::too_many_arguments)]
    fn conv(
        x: &[f32],
        (c, h, w): (usize, usize, usize),
        kernel: &[f32],
        out: usize,
        k: usize,
        stride: usize,
        pad: usize,
    ) -> Vec<f64> {
        let (oh, ow) = ((h + 2 * pad - k) / stride + 1, (w + 2 * pad - k) / stride + 1);
        let mut y = vec![0.0; out * oh * ow];
        for o in 0..out {
            for oy in 0..oh {
                for ox in 0..ow {
                    let mut sum = 0.0;
                    for i in 0..c {
                        for ky in 0..k {
                            for kx in 0..k {
                                let (sy, sx) = (oy * stride + ky, ox * stride + kx);
                                if sy < pad || sx < pad || sy - pad >= h || sx - pad >= w {
                                    continue;
                                }
                                sum += f64::from(x[(i * h + sy - pad) * w + sx - pad])
                                    * f64::from(kernel[((o * c + i) * k + ky) * k + kx]);
                            }
                        }
                    }
                    y[(o * oh + oy) * ow + ox] = sum;
                }
            }
        }
        y
    }

    fn noise(n: usize, seed: u32) -> Vec<f32> {
        let mut state = seed;
        (0..n)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / (1 << 24) as f32 - 0.5
            })
            .collect()
    }

    #[test]
    fn folded_convolution_equals_convolution_and_normalisation() {
        let (c, out, k, size) = (3, 4, 3, (3, 7, 6));
        let x = noise(c * 7 * 6, 1);
        let kernel = noise(out * c * k * k, 2);
        let (gamma, beta, mean) = (noise(out, 3), noise(out, 4), noise(out, 5));
        let var: Vec<f32> = noise(out, 6).iter().map(|v| v + 0.6).collect();
        let before = noise(out, 7);
        let bn = BatchNorm { weight: &gamma, bias: &beta, mean: &mean, var: &var, eps: 1e-3 };
        for bias in [None, Some(before.as_slice())] {
            let (folded, biases) = fold(&kernel, bias, &bn);
            let plain = conv(&x, size, &kernel, out, k, 1, 1);
            let fused = conv(&x, size, &folded, out, k, 1, 1);
            let area = plain.len() / out;
            for (i, (a, b)) in plain.iter().zip(&fused).enumerate() {
                let o = i / area;
                let a = a + bias.map_or(0.0, |b| f64::from(b[o]));
                let a = (a - f64::from(mean[o])) / (f64::from(var[o]) + 1e-3).sqrt()
                    * f64::from(gamma[o])
                    + f64::from(beta[o]);
                assert!((a - (b + f64::from(biases[o]))).abs() < 1e-6, "{a} {b}");
            }
        }
    }

    #[test]
    fn focus_equals_the_wide_kernel() {
        let (c, h, w, out, k) = (3, 8, 6, 2, 3);
        let x = noise(c * h * w, 11);
        let kernel = noise(out * 4 * c * k * k, 12);
        let mut focused = Vec::new();
        for (dy, dx) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            for i in 0..c {
                for y in 0..h / 2 {
                    for xx in 0..w / 2 {
                        focused.push(x[(i * h + 2 * y + dy) * w + 2 * xx + dx]);
                    }
                }
            }
        }
        let reference = conv(&focused, (4 * c, h / 2, w / 2), &kernel, out, k, 1, 1);
        let wide = conv(&x, (c, h, w), &focus_kernel(&kernel, out, c, k), out, 2 * k, 2, 2);
        assert_eq!(reference.len(), wide.len());
        for (a, b) in reference.iter().zip(&wide) {
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
    }
}
