//! The layout of the TUM RGB-D benchmark (Sturm et al., 2012).

use super::{RawFrame, RgbdError, RgbdLayout, entries, poses, read_text};
use crate::picture;
use realnet_core::{Pose, Stamp};
use std::path::{Path, PathBuf};

/// A picture with its stamp.
type Stamped = (Stamp, PathBuf);

/// A decimal number of seconds, to the nanosecond: floating point would lose
/// some hundred of them in a Unix time. Digits beyond the ninth are cut off.
fn stamp(text: &str) -> Option<Stamp> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, text),
    };
    let (whole, part) = digits.split_once('.').unwrap_or((digits, ""));
    if whole.is_empty() || !whole.bytes().chain(part.bytes()).all(|b| b.is_ascii_digit()) {
        return None;
    }
    let nine: String = part.chars().chain("000000000".chars()).take(9).collect();
    let seconds = whole.parse::<i64>().ok()?;
    let nanos = seconds.checked_mul(1_000_000_000)?.checked_add(nine.parse().ok()?)?;
    Some(Stamp::from_nanos(if negative { -nanos } else { nanos }))
}

/// The stamp that a picture has as its name: digits, a point, digits.
fn stamp_of_name(path: &Path) -> Option<Stamp> {
    let stem = path.file_stem()?.to_str()?;
    if stem.contains('.') { stamp(stem) } else { None }
}

/// True when there is `rgb.txt`, or `rgb/` with stamps as names.
pub(super) fn is_here(folder: &Path) -> Result<bool, RgbdError> {
    if folder.join("rgb.txt").is_file() {
        return Ok(true);
    }
    let pictures = folder.join("rgb");
    Ok(pictures.is_dir() && !named(&pictures)?.is_empty())
}

/// Pictures of a folder that have stamps as names.
fn named(folder: &Path) -> Result<Vec<Stamped>, RgbdError> {
    let pictures = entries(folder)?.into_iter().filter(|e| picture::has_picture_extension(&e.path));
    Ok(pictures.filter_map(|e| Some((stamp_of_name(&e.path)?, e.path))).collect())
}

/// The pictures of `name.txt`, or else of the folder `name`, by stamp.
fn pictures(folder: &Path, name: &str) -> Result<Vec<Stamped>, RgbdError> {
    let list = folder.join(format!("{name}.txt"));
    let mut found = if list.is_file() {
        listed(folder, &list)?
    } else {
        let pictures = folder.join(name);
        if pictures.is_dir() { named(&pictures)? } else { Vec::new() }
    };
    found.sort();
    Ok(found)
}

fn listed(folder: &Path, list: &Path) -> Result<Vec<Stamped>, RgbdError> {
    let text = read_text(list)?;
    let row = |(line, row): (usize, &str)| {
        let bad = |message| RgbdError::Line { path: list.to_path_buf(), line, message };
        let Some((time, file)) = row.split_once(char::is_whitespace) else {
            return Err(bad(format!("{row:?} is not a stamp and a file name")));
        };
        let stamp =
            stamp(time).ok_or_else(|| bad(format!("{time:?} is not a stamp in seconds")))?;
        let path = folder.join(file.trim());
        if path.is_file() {
            Ok((stamp, path))
        } else {
            Err(bad(format!("{} does not exist", path.display())))
        }
    };
    poses::lines(&text).map(row).collect()
}

/// `groundtruth.txt`: `stamp tx ty tz qx qy qz qw` a line, by stamp.
fn trajectory(path: &Path) -> Result<Vec<(Stamp, Pose)>, RgbdError> {
    let text = read_text(path)?;
    let row = |(line, row): (usize, &str)| {
        let mut words = row.split_whitespace();
        let time = words.next().unwrap_or_default();
        let stamp = stamp(time).ok_or_else(|| RgbdError::Line {
            path: path.to_path_buf(),
            line,
            message: format!("{time:?} is not a stamp in seconds"),
        })?;
        Ok((stamp, poses::of_line(path, line, words)?))
    };
    let mut found: Vec<_> = poses::lines(&text).map(row).collect::<Result<_, RgbdError>>()?;
    found.sort_by_key(|(stamp, _)| *stamp);
    Ok(found)
}

/// The frames by stamp.
pub(super) fn list(folder: &Path, max_difference: f64) -> Result<Vec<RawFrame>, RgbdError> {
    let color = pictures(folder, "rgb")?;
    if color.is_empty() {
        return Err(RgbdError::NoFrames {
            path: folder.to_path_buf(),
            layout: RgbdLayout::Tum,
            wanted: "rgb.txt with stamps and file names, or rgb/ with stamps as names",
        });
    }
    let depth = pictures(folder, "depth")?;
    let truth = folder.join("groundtruth.txt");
    let truth = if truth.is_file() { trajectory(&truth)? } else { Vec::new() };
    let partner = associate(&color, &depth, max_difference);
    let frame = |((number, (stamp, color)), partner): ((u64, Stamped), Option<usize>)| {
        let depth = partner.and_then(|i| depth.get(i)).cloned();
        RawFrame {
            camera_file: None,
            number,
            stamp: Some(stamp),
            color,
            depth_stamp: depth.as_ref().map(|(stamp, _)| *stamp),
            depth: depth.map(|(_, path)| path),
            pose: pose_at(&truth, stamp, max_difference),
        }
    };
    Ok((0..).zip(color).zip(partner).map(frame).collect())
}

/// Gives each colour picture at most one depth map and the other way round,
/// closest pairs first. Both lists are sorted by stamp.
fn associate(color: &[Stamped], depth: &[Stamped], max_difference: f64) -> Vec<Option<usize>> {
    let mut pairs = Vec::new();
    for (c, (stamp, _)) in color.iter().enumerate() {
        let start = depth.partition_point(|(d, _)| stamp.seconds_since(*d) > max_difference);
        for (d, (other, _)) in depth.iter().enumerate().skip(start) {
            if other.seconds_since(*stamp) > max_difference {
                break;
            }
            pairs.push((stamp.seconds_since(*other).abs(), c, d));
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut partner = vec![None; color.len()];
    let mut taken = vec![false; depth.len()];
    for (_, c, d) in pairs {
        if let (Some(slot @ None), Some(taken @ false)) = (partner.get_mut(c), taken.get_mut(d)) {
            *slot = Some(d);
            *taken = true;
        }
    }
    partner
}

/// The pose at a time: between the samples before and after when both are near
/// enough (rotation along the great circle, translation along the line), or the
/// one that is.
fn pose_at(truth: &[(Stamp, Pose)], at: Stamp, max_difference: f64) -> Option<Pose> {
    let next = truth.partition_point(|(stamp, _)| *stamp < at);
    let near = |index: Option<usize>| {
        let sample = truth.get(index?)?;
        (at.seconds_since(sample.0).abs() <= max_difference).then_some(sample)
    };
    match (near(next.checked_sub(1)), near(Some(next))) {
        (Some((t0, a)), Some((t1, b))) => {
            // The first is before `at`, the second is not, so they differ.
            let share = at.seconds_since(*t0) / t1.seconds_since(*t0);
            let rotation = a
                .rotation()
                .try_slerp(&b.rotation(), share, 1e-9)
                .unwrap_or_else(|| if share < 0.5 { a.rotation() } else { b.rotation() });
            Some(Pose::new(rotation, a.translation().lerp(&b.translation(), share)))
        }
        (Some((_, pose)), None) | (None, Some((_, pose))) => Some(*pose),
        (None, None) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realnet_core::nalgebra::{UnitQuaternion, Vector3};

    fn at(seconds: f64) -> Stamp {
        Stamp::from_secs_f64(seconds)
    }

    fn pictures(stamps: &[f64]) -> Vec<Stamped> {
        stamps.iter().map(|s| (at(*s), PathBuf::new())).collect()
    }

    #[test]
    fn stamps_keep_their_nanoseconds() {
        let nanos = |text| stamp(text).map(Stamp::nanos);
        assert_eq!(nanos("1305031102.175304"), Some(1_305_031_102_175_304_000));
        assert_eq!(nanos("1305031102.1753041239"), Some(1_305_031_102_175_304_123));
        assert_eq!(nanos("-1.5"), Some(-1_500_000_000));
        assert_eq!(nanos("12"), Some(12_000_000_000));
        for bad in [
            "",
            ".",
            ".5",
            "1e9",
            "nan",
            "1.5.2",
            "--1",
            "1,5",
            "99999999999999999999",
            "9999999999999",
        ] {
            assert_eq!(nanos(bad), None, "{bad}");
        }
    }

    #[test]
    fn the_closest_pairs_come_first_and_each_depth_once() {
        let color = pictures(&[0.0, 0.010, 0.5, 1.0]);
        let depth = pictures(&[0.008, 0.979, 0.9799, 1.015]);
        // 0.008 is nearer to 0.010; nothing is left for 0.0 and nothing near 0.5;
        // 1.015 is nearer to 1.0 than 0.9799 is, and 0.979 is too far.
        assert_eq!(associate(&color, &depth, 0.0201), [None, Some(0), None, Some(3)]);
        assert_eq!(associate(&color, &depth, 0.001), [None; 4]);
        assert_eq!(associate(&color, &[], 0.02), [None; 4]);
    }

    #[test]
    fn poses_are_interpolated_only_between_near_samples() {
        let pose = |x: f64, angle: f64| {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, angle, 0.0));
            Pose::new(turn, Vector3::new(x, 0.0, 0.0))
        };
        let truth =
            [(at(1.0), pose(0.0, 0.0)), (at(1.02), pose(1.0, 0.4)), (at(2.0), pose(5.0, 0.0))];
        let found = pose_at(&truth, at(1.005), 0.02).unwrap();
        assert!((found.translation().x - 0.25).abs() < 1e-9);
        assert!((found.rotation_angle() - 0.1).abs() < 1e-9);
        // Exactly on a sample; only one near; none near.
        assert!((pose_at(&truth, at(1.02), 0.02).unwrap().translation().x - 1.0).abs() < 1e-12);
        assert!((pose_at(&truth, at(1.03), 0.02).unwrap().translation().x - 1.0).abs() < 1e-12);
        assert!((pose_at(&truth, at(0.99), 0.02).unwrap().translation().x).abs() < 1e-12);
        assert_eq!(pose_at(&truth, at(1.5), 0.02), None);
        assert_eq!(pose_at(&[], at(1.5), 0.02), None);
    }
}
