//! Augmentation from a file and from `--augment key=value`.

use crate::cli::failure::{OrBadInput, bad_input};
use anyhow::Result;
use serde::{Serialize, de::DeserializeOwned};
use toml::{Table, Value};

/// The default with the changes of the file's table and then those of the command line,
/// `key=value` each. Ranges are checked by whoever takes it.
pub(super) fn changed<A: Default + Serialize + DeserializeOwned>(
    file: Option<&Table>,
    pairs: &[String],
) -> Result<A> {
    let mut table = Table::try_from(A::default())?;
    let known: Vec<String> = table.keys().cloned().collect();
    let mut set = |key: &str, value: Value| match table.get_mut(key) {
        Some(place) => {
            *place = value;
            Ok(())
        }
        None => {
            Err(bad_input(format!("augment: there is no '{key}'; there are {}", known.join(", "))))
        }
    };
    for (key, value) in file.into_iter().flatten() {
        set(key, value.clone())?;
    }
    for pair in pairs {
        let (key, text) = pair
            .split_once('=')
            .ok_or_else(|| bad_input(format!("--augment {pair}: wanted is KEY=VALUE")))?;
        let value = text.trim().parse().map_err(|_| {
            bad_input(format!("--augment {pair}: '{text}' is neither a number nor [a, b]"))
        })?;
        set(key.trim(), value)?;
    }
    // Each key by itself, so that the error has its name.
    for (key, value) in &table {
        let mut one = Table::try_from(A::default())?;
        one.insert(key.clone(), value.clone());
        if one.try_into::<A>().is_err() {
            return Err(bad_input(format!("augment: {key} cannot be {value}")));
        }
    }
    table.try_into().or_bad_input()
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_data::{DepthAugment, DetectionAugment};

    #[test]
    fn the_command_line_wins_over_the_file_and_the_file_over_the_default() {
        let file: Table = "mosaic = 0\nhsv_h = 0.1\n".parse().unwrap();
        let pairs = ["hsv_h=0.2".to_owned(), "jpeg_quality=50".to_owned()];
        let changed: DetectionAugment = changed(Some(&file), &pairs).unwrap();
        let mut expected = DetectionAugment { mosaic: 0.0, ..DetectionAugment::default() };
        expected.color.hsv_h = 0.2;
        expected.color.jpeg_quality = 50;
        assert_eq!(changed, expected);
    }

    #[test]
    fn pairs_are_numbers_too() {
        let pairs = ["zoom=[1, 2.5]".to_owned()];
        let changed: DepthAugment = changed(None, &pairs).unwrap();
        assert_eq!(changed.zoom, [1.0, 2.5]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (pair, words) in [
            ("mosaik=1", "there is no 'mosaik'; there are blur, "),
            ("mosaic", "wanted is KEY=VALUE"),
            ("mosaic=much", "'much' is neither a number"),
            ("mosaic='1'", "mosaic cannot be"),
            ("jpeg_quality=1000", "jpeg_quality cannot be 1000"),
        ] {
            let error = changed::<DetectionAugment>(None, &[pair.to_owned()]).unwrap_err();
            assert!(error.to_string().contains(words), "{pair}: {error}");
        }
    }
}
