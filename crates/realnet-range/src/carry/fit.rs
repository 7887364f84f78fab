//! The motion that most points agree on.

/// Enlargement by `scale` about the origin, then `shift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Similarity {
    pub(super) scale: f32,
    pub(super) shift: [f32; 2],
}

impl Similarity {
    /// Distance between where it takes `from` and `to`, squared.
    fn residual(&self, pair: &Pair) -> f32 {
        let [dx, dy] = [0, 1].map(|i| self.scale * pair.from[i] + self.shift[i] - pair.to[i]);
        dx * dx + dy * dy
    }
}

/// A point before and after.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pair {
    pub(super) from: [f32; 2],
    pub(super) to: [f32; 2],
}

/// A fit and how sure it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    pub(super) similarity: Similarity,
    /// Points within the tolerance.
    pub(super) inliers: usize,
    /// Standard deviation of the shift at the origin, in x and y.
    pub(super) shift_sd: [f32; 2],
    /// Standard deviation of the scale.
    pub(super) scale_sd: f32,
}

/// Pairs of points tried, at most.
const TRIALS: usize = 600;

/// The similarity with most of `pairs` within `tolerance`, then least squares over
/// those. Each model tried is that of two points at least `baseline` apart with a
/// scale inside `scales`; all such pairs, or an evenly spread choice of
/// about [`TRIALS`]: the same every time, without a random number. `None` when no
/// two points qualify.
pub(super) fn fit(
    pairs: &[Pair],
    tolerance: f32,
    baseline: f32,
    scales: (f32, f32),
) -> Option<Fit> {
    let square = tolerance * tolerance;
    // Truncated squares: among models with as many points, the closer one wins.
    let cost = |model: &Similarity| -> f32 {
        pairs.iter().map(|pair| model.residual(pair).min(square)).sum()
    };
    let n = pairs.len();
    let stride = (n * n.saturating_sub(1) / 2).div_ceil(TRIALS).max(1);
    let mut best: Option<(f32, Similarity)> = None;
    // By distance of the two in the list, so that a stride meets every point.
    let all = (1..n).flat_map(|gap| (0..n - gap).map(move |i| (i, i + gap)));
    for (i, j) in all.step_by(stride) {
        let (Some(a), Some(b)) = (pairs.get(i), pairs.get(j)) else { continue };
        let Some(model) = of_two(a, b, baseline, scales) else { continue };
        let cost = cost(&model);
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, model));
        }
    }
    let mut fit =
        Fit { similarity: best?.1, inliers: 0, shift_sd: [f32::NAN; 2], scale_sd: f32::NAN };
    for _ in 0..3 {
        fit = least_squares(pairs, fit.similarity, square)?;
    }
    (fit.similarity.scale >= scales.0 && fit.similarity.scale <= scales.1).then_some(fit)
}

fn of_two(a: &Pair, b: &Pair, baseline: f32, scales: (f32, f32)) -> Option<Similarity> {
    let before = [0, 1].map(|i| b.from[i] - a.from[i]);
    let after = [0, 1].map(|i| b.to[i] - a.to[i]);
    let length = before[0] * before[0] + before[1] * before[1];
    if length < baseline * baseline {
        return None;
    }
    let scale = (before[0] * after[0] + before[1] * after[1]) / length;
    let shift = [0, 1].map(|i| 0.5 * (a.to[i] + b.to[i] - scale * (a.from[i] + b.from[i])));
    (scale >= scales.0 && scale <= scales.1).then_some(Similarity { scale, shift })
}

/// Over the points within the squared tolerance of `model`.
fn least_squares(pairs: &[Pair], model: Similarity, square: f32) -> Option<Fit> {
    let inliers = || pairs.iter().filter(|pair| model.residual(pair) <= square);
    let count = inliers().count();
    if count < 2 {
        return None;
    }
    let n = count as f32;
    let mean = |of: fn(&Pair) -> [f32; 2]| {
        [0, 1].map(|i| inliers().map(|pair| of(pair)[i]).sum::<f32>() / n)
    };
    let (from, to) = (mean(|pair| pair.from), mean(|pair| pair.to));
    let (mut spread, mut product) = (0.0, 0.0);
    for pair in inliers() {
        for i in [0, 1] {
            let d = pair.from[i] - from[i];
            spread += d * d;
            product += d * (pair.to[i] - to[i]);
        }
    }
    if spread <= f32::EPSILON {
        return None;
    }
    let scale = product / spread;
    let similarity = Similarity { scale, shift: [0, 1].map(|i| to[i] - scale * from[i]) };
    let squares = [0, 1].map(|i| {
        let residual = |pair: &Pair| scale * pair.from[i] + similarity.shift[i] - pair.to[i];
        inliers().map(|pair| residual(pair).powi(2)).sum::<f32>()
    });
    // Two coordinates a point, three parameters; half of the scale's for each axis.
    let variance = squares.map(|sum| sum / (n - 1.5).max(0.5));
    // Points of a box err together: what a turn of the target or its parallax does to
    // one point it does to the neighbours. So the mean is no surer than one point.
    // Mean squared distance from the middle of the points. At the origin the error
    // of the scale adds to that of the middle.
    let reach = spread / n;
    let scale_variance = (variance[0] + variance[1]) / (2.0 * reach);
    let shift_sd =
        [0, 1].map(|i| (variance[i] + from[i] * from[i] * scale_variance).sqrt());
    Some(Fit { similarity, inliers: count, shift_sd, scale_sd: scale_variance.sqrt() })
}

impl Fit {
    /// Whether a point moves with it.
    pub(super) fn holds(&self, pair: &Pair, tolerance: f32) -> bool {
        self.similarity.residual(pair) <= tolerance * tolerance
    }
}
