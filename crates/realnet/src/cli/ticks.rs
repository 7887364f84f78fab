//! Round numbers for the axes of charts.

/// A round step that divides a range into four to ten.
pub(crate) fn step(range: f64) -> f64 {
    let decade = 10_f64.powf((range / 4.0).log10().floor());
    let steps = [5.0, 2.0, 1.0].map(|m| m * decade);
    steps.into_iter().find(|step| range / step >= 4.0).unwrap_or(decade)
}

/// The multiples of a step from `low` to `high`.
pub(crate) fn ticks(low: f64, high: f64, step: f64) -> impl Iterator<Item = f64> {
    let first = (low / step).ceil();
    // Counted: adding a step to a large number may not change it.
    (0..20).map(move |i| (first + f64::from(i)) * step).take_while(move |value| *value <= high)
}

/// A tick's value with the digits that its step needs.
pub(crate) fn number(value: f64, step: f64) -> String {
    let digits = (-step.log10().floor()).max(0.0) as usize;
    format!("{:.digits$}", if value == 0.0 { 0.0 } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_few() {
        let of = |low, high| ticks(low, high, step(high - low)).collect::<Vec<_>>();
        assert_eq!(of(0.0, 1.0), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert_eq!(of(103.0, 149.0), [110.0, 120.0, 130.0, 140.0]);
        assert_eq!(of(-0.5, 9.5).len(), 5);
        assert!(of(1e19, 1e19).len() <= 20, "frame numbers may be large");
    }

    #[test]
    fn numbers_have_the_digits_of_the_step() {
        let of = |low, high| -> Vec<String> {
            let step = step(high - low);
            ticks(low, high, step).map(|value| number(value, step)).collect()
        };
        assert_eq!(of(-0.02, 0.03), ["-0.02", "-0.01", "0.00", "0.01", "0.02", "0.03"]);
        assert_eq!(of(-30.0, 30.0), ["-30", "-20", "-10", "0", "10", "20", "30"]);
    }
}
