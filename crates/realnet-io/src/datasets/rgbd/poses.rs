//! Poses from text.

use super::{RgbdError, read_text};
use realnet_core::Pose;
use realnet_core::nalgebra::Matrix4;
use std::path::Path;

/// Exactly `N` numbers; or what is wrong with them.
pub(super) fn numbers<const N: usize>(
    words: impl Iterator<Item = impl AsRef<str>>,
) -> Result<[f64; N], String> {
    let mut values = [0.0; N];
    let mut found = 0;
    for word in words {
        let word = word.as_ref();
        let value = word.parse::<f64>().map_err(|_| {
            let text: String = word.chars().take(40).collect();
            format!("value {} is {text:?}, not a number", found + 1)
        })?;
        if let Some(slot) = values.get_mut(found) {
            *slot = value;
        }
        found += 1;
    }
    if found == N { Ok(values) } else { Err(format!("{found} numbers, a pose has {N}")) }
}

/// Reads a file with one 4x4 matrix, row by row.
pub(super) fn read_matrix(path: &Path) -> Result<Pose, RgbdError> {
    let text = read_text(path)?;
    let values: [f64; 16] = numbers(text.split_whitespace())
        .map_err(|message| RgbdError::Count { path: path.to_path_buf(), message })?;
    Pose::from_matrix(&Matrix4::from_row_slice(&values)).map_err(|reason| RgbdError::Pose {
        path: path.to_path_buf(),
        line: None,
        reason,
    })
}

/// Lines of a text file that are neither empty nor a `#` comment, with their
/// numbers from 1.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    text.lines()
        .enumerate()
        .map(|(index, line)| (index + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// One pose of a line `tx ty tz qx qy qz qw`.
pub(super) fn of_line<'a>(
    path: &Path,
    line: usize,
    words: impl Iterator<Item = &'a str>,
) -> Result<Pose, RgbdError> {
    let values: [f64; 7] = numbers(words).map_err(|message| RgbdError::Line {
        path: path.to_path_buf(),
        line,
        message,
    })?;
    Pose::from_tum(values).map_err(|reason| RgbdError::Pose {
        path: path.to_path_buf(),
        line: Some(line),
        reason,
    })
}

/// Reads a file with one pose a line, `tx ty tz qx qy qz qw`.
pub(super) fn read_list(path: &Path) -> Result<Vec<Pose>, RgbdError> {
    let text = read_text(path)?;
    lines(&text).map(|(line, row)| of_line(path, line, row.split_whitespace())).collect()
}
