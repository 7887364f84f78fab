//! Flags about the network, shared by the commands that run a detector.

use super::failure::{OrBadInput, bad_input};
use anyhow::Result;
use realnet::{DetectError, Detector, DetectorModel, DetectorOptions, Runtime};
use std::path::Path;

/// `640` or `640x384` (width x height) as (width, height).
pub(crate) fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let side = |part: &str| {
        part.parse::<u32>()
            .ok()
            .filter(|side| (1..=16_384).contains(side))
            .ok_or_else(|| format!("'{part}' is not a number of pixels from 1 to 16384"))
    };
    match text.split_once(['x', 'X']) {
        Some((width, height)) => Ok((side(width)?, side(height)?)),
        None => side(text).map(|side| (side, side)),
    }
}

/// A number from 0 to 1.
pub(crate) fn parse_share(text: &str) -> Result<f32, String> {
    text.parse::<f32>()
        .ok()
        .filter(|share| (0.0..=1.0).contains(share))
        .ok_or_else(|| format!("'{text}' is not a number from 0 to 1"))
}

/// A number above 0.
pub(crate) fn parse_positive(text: &str) -> Result<f64, String> {
    text.parse::<f64>()
        .ok()
        .filter(|value| value.is_finite() && *value > 0.0)
        .ok_or_else(|| format!("'{text}' is not a number above 0"))
}

/// A length in pixels, 0 or more.
pub(crate) fn parse_side(text: &str) -> Result<f32, String> {
    text.parse::<f32>()
        .ok()
        .filter(|side| side.is_finite() && *side >= 0.0)
        .ok_or_else(|| format!("'{text}' is not a number of pixels, 0 or more"))
}

/// How a frame is fitted into the network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum FilterFlag {
    /// A triangle as wide as the reduction: no aliasing.
    Triangle,
    /// Two neighbours, as OpenCV and Ultralytics' programs do.
    Linear,
}

impl From<FilterFlag> for realnet::Filter {
    fn from(flag: FilterFlag) -> Self {
        match flag {
            FilterFlag::Triangle => Self::Triangle,
            FilterFlag::Linear => Self::Linear,
        }
    }
}

/// `x0,y0,x1,y1` in pixels.
pub(crate) fn parse_box(text: &str) -> Result<realnet::BoundingBox, String> {
    let edges: Vec<f32> = text.split(',').map_while(|part| part.trim().parse().ok()).collect();
    let count = text.split(',').count();
    match <[f32; 4]>::try_from(edges) {
        Ok(edges) if count == 4 && realnet::BoundingBox::from(edges).is_proper() => {
            Ok(edges.into())
        }
        _ => Err(format!("'{text}' is not x0,y0,x1,y1 in pixels with x0 < x1 and y0 < y1")),
    }
}

/// Reads a model file.
pub(crate) fn open_model(path: &Path) -> Result<DetectorModel> {
    DetectorModel::open(path).or_bad_input()
}

/// Brings a model, read from `path`, to an engine.
pub(crate) fn start_detector(
    path: &Path,
    model: DetectorModel,
    runtime: &Runtime,
    options: DetectorOptions,
) -> Result<Detector> {
    Detector::new(model, runtime, options).map_err(|error| match error {
        // An engine does not know from which file its network came.
        DetectError::Engine(reason) => bad_input(format!("{}: {reason}", path.display())),
        error => bad_input(error),
    })
}

/// Class ids from a list of names or numbers.
pub(crate) fn parse_classes(wanted: &[String], names: &[String]) -> Result<Vec<u32>> {
    wanted
        .iter()
        .map(|class| {
            let by_name = names.iter().position(|name| name == class);
            let by_number = || class.parse().ok().filter(|id| *id < names.len());
            by_name.or_else(by_number).map(|id| id as u32).ok_or_else(|| {
                let known = match names {
                    [.., last] if names.len() > 8 => {
                        format!("{}, …, {last}", names[..7].join(", "))
                    }
                    _ => names.join(", "),
                };
                bad_input(format!("the model has no class '{class}'; it has {known}"))
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!(parse_size("320"), Ok((320, 320)));
        assert_eq!(parse_size("640x384"), Ok((640, 384)));
        for bad in ["", "0", "x", "320x", "-1", "99999", "3.5", "1x2x3"] {
            assert!(parse_size(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn shares_and_boxes() {
        assert!(parse_share("0.25").is_ok());
        for bad in ["-0.1", "1.5", "nan", "inf", "x"] {
            assert!(parse_share(bad).is_err(), "{bad}");
        }
        for bad in ["-1", "nan", "inf", "x"] {
            assert!(parse_side(bad).is_err(), "{bad}");
        }
        assert!(parse_box("1,2,3.5,4").is_ok());
        for bad in ["1,2,3", "1,2,3,4,5", "3,2,1,4", "1,2,x,4", "nan,0,1,1"] {
            assert!(parse_box(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn classes_by_name_and_number() {
        let names = ["person".to_owned(), "car".to_owned()];
        let wanted = ["car".to_owned(), "0".to_owned()];
        assert_eq!(parse_classes(&wanted, &names).unwrap(), [1, 0]);
        let error = parse_classes(&["cat".to_owned()], &names).unwrap_err();
        assert_eq!(error.to_string(), "the model has no class 'cat'; it has person, car");
    }
}
