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
    for _ in 0..5 {
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

/// Over the points within the squared tolerance of `model`, those further from it
/// with less weight (Tukey's biweight): what is there by chance hardly counts.
fn least_squares(pairs: &[Pair], model: Similarity, square: f32) -> Option<Fit> {
    let weighted = || {
        pairs.iter().filter_map(|pair| {
            let share = 1.0 - model.residual(pair) / square;
            (share >= 0.0).then_some((pair, share * share))
        })
    };
    let inliers = weighted().count();
    let n: f32 = weighted().map(|(_, weight)| weight).sum();
    if inliers < 2 || n <= f32::EPSILON {
        return None;
    }
    let mean = |of: fn(&Pair) -> [f32; 2]| {
        [0, 1].map(|i| weighted().map(|(pair, weight)| weight * of(pair)[i]).sum::<f32>() / n)
    };
    let (from, to) = (mean(|pair| pair.from), mean(|pair| pair.to));
    let (mut spread, mut product) = (0.0, 0.0);
    for (pair, weight) in weighted() {
        for i in [0, 1] {
            let d = pair.from[i] - from[i];
            spread += weight * d * d;
            product += weight * d * (pair.to[i] - to[i]);
        }
    }
    if spread <= f32::EPSILON {
        return None;
    }
    let scale = product / spread;
    let similarity = Similarity { scale, shift: [0, 1].map(|i| to[i] - scale * from[i]) };
    // Points of a box err together: what a turn of the target or its parallax does to
    // one point it does to the neighbours. So the mean is no surer than one point.
    let variance = [0, 1].map(|i| {
        let residual = |pair: &Pair| scale * pair.from[i] + similarity.shift[i] - pair.to[i];
        weighted().map(|(pair, weight)| weight * residual(pair).powi(2)).sum::<f32>() / n
    });
    // Mean squared distance from the middle of the points. At the origin the error
    // of the scale adds to that of the middle.
    let reach = spread / n;
    let scale_variance = (variance[0] + variance[1]) / (2.0 * reach);
    let shift_sd = [0, 1].map(|i| (variance[i] + from[i] * from[i] * scale_variance).sqrt());
    Some(Fit { similarity, inliers, shift_sd, scale_sd: scale_variance.sqrt() })
}

impl Fit {
    /// Whether a point moves with it.
    pub(super) fn holds(&self, pair: &Pair, tolerance: f32) -> bool {
        self.similarity.residual(pair) <= tolerance * tolerance
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCALES: (f32, f32) = (0.5, 2.0);

    fn pairs(n: usize, scale: f32, shift: [f32; 2]) -> Vec<Pair> {
        (0..n)
            .map(|i| [(i * 37 % 101) as f32 - 50.0, (i * 53 % 79) as f32 - 40.0])
            .map(|from| Pair { from, to: [0, 1].map(|k| scale * from[k] + shift[k]) })
            .collect()
    }

    #[test]
    fn recovers_the_motion_of_the_majority() {
        let mut pairs = pairs(50, 1.2, [7.0, -3.0]);
        // Two fifths stand still or go astray.
        for (i, pair) in pairs.iter_mut().enumerate().take(20) {
            let astray = [pair.from[0] + (i * 31 % 23) as f32, pair.from[1] - (i * 17 % 29) as f32];
            pair.to = if i % 2 == 0 { pair.from } else { astray };
        }
        let truth = Similarity { scale: 1.2, shift: [7.0, -3.0] };
        let near = pairs.iter().filter(|pair| truth.residual(pair) <= 4.0).count();
        let fit = fit(&pairs, 2.0, 10.0, SCALES).unwrap();
        assert!((fit.similarity.scale - 1.2).abs() < 0.02, "{fit:?}");
        let shift = fit.similarity.shift;
        assert!((shift[0] - 7.0).abs() < 0.5 && (shift[1] + 3.0).abs() < 0.5, "{fit:?}");
        assert!((30..=near + 2).contains(&fit.inliers), "{near} {fit:?}");
        assert!(fit.holds(&pairs[40], 2.0) && !fit.holds(&pairs[2], 2.0));
    }

    #[test]
    fn deviations_are_those_of_one_point() {
        let mut pairs = pairs(60, 1.0, [0.0; 2]);
        let exact = fit(&pairs, 2.0, 10.0, SCALES).unwrap();
        assert!(exact.shift_sd.iter().all(|sd| *sd < 1e-3) && exact.scale_sd < 1e-4, "{exact:?}");
        for (i, pair) in pairs.iter_mut().enumerate() {
            pair.to[0] += if i % 2 == 0 { 1.0 } else { -1.0 };
        }
        let noisy = fit(&pairs, 2.0, 10.0, SCALES).unwrap();
        assert!((noisy.shift_sd[0] - 1.0).abs() < 0.1 && noisy.shift_sd[1] < 0.3, "{noisy:?}");
        assert!((0.01..0.04).contains(&noisy.scale_sd), "{noisy:?}");
    }

    #[test]
    fn refuses_what_gives_no_scale() {
        let near = pairs(50, 1.0, [0.0; 2]);
        assert_eq!(fit(&near, 2.0, 500.0, SCALES), None);
        assert_eq!(fit(&near[..1], 2.0, 1.0, SCALES), None);
        assert_eq!(fit(&[], 2.0, 1.0, SCALES), None);
        assert_eq!(fit(&pairs(50, 2.5, [0.0; 2]), 2.0, 10.0, SCALES), None);
        let same = [Pair { from: [1.0; 2], to: [2.0; 2] }; 5];
        assert_eq!(fit(&same, 2.0, 0.0, SCALES), None);
    }
}
