//! How a depth network's numbers are metres, and how its file says so.

use crate::onnx::OnnxModel;
use serde_json::{Value, json};
use thiserror::Error;

/// What a classifying depth network was trained with: the range of its bins, the
/// unit, the camera and the normalisation of its input.
///
/// The bins divide `log10(min)` to `log10(max)` evenly. From the weights `p` of
/// the bins after the softmax,
///
/// `depth = scale · 10^(Σ pᵢ · borderᵢ)`,
/// `borderᵢ = log10(min) + (i + 0.5) · log10(max / min) / bins`.
///
/// The default is what the authors of virtual normals trained with on NYU Depth V2:
/// 0.01 to 1.7, times 10 m, focal length 519 px, the normalisation of ImageNet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthCoding {
    /// Lower border of the first bin, in units of `scale`.
    pub min: f64,
    /// Upper border of the last bin, in units of `scale`.
    pub max: f64,
    /// Metres a unit.
    pub scale: f64,
    /// Focal length, in pixels of the network's input, that the depths are right
    /// for. A camera with `f` pixels sees everything at `f / focal` of the depth
    /// that the network tells: larger in the picture means nearer.
    pub focal: f64,
    /// Mean of red, green and blue, from 0 to 1, that is taken from the input.
    pub mean: [f32; 3],
    /// Deviation of red, green and blue that the rest is divided by.
    pub std: [f32; 3],
}

impl Default for DepthCoding {
    fn default() -> Self {
        Self {
            min: 0.01,
            max: 1.7,
            scale: 10.0,
            focal: 519.0,
            mean: [0.485, 0.456, 0.406],
            std: [0.229, 0.224, 0.225],
        }
    }
}

/// A number of a [`DepthCoding`] that is out of its range.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("depth coding: {name} is {value}, it must be {range}")]
pub struct CodingError {
    /// Name of the number.
    pub name: &'static str,
    /// What was given.
    pub value: f64,
    /// What is allowed.
    pub range: &'static str,
}

impl DepthCoding {
    /// Checks all numbers.
    ///
    /// # Errors
    /// [`CodingError`] for the first that is out of its range.
    pub fn check(&self) -> Result<(), CodingError> {
        let positive = |name, value: f64| {
            // Far inside what 32 bits hold, so that no depth overflows.
            let fits = (1e-6..=1e6).contains(&value);
            let range = "from 0.000001 to 1000000";
            if fits { Ok(()) } else { Err(CodingError { name, value, range }) }
        };
        positive("min", self.min)?;
        positive("max", self.max)?;
        positive("scale", self.scale)?;
        positive("focal", self.focal)?;
        if self.max <= self.min {
            return Err(CodingError { name: "max", value: self.max, range: "greater than min" });
        }
        for value in self.std.map(f64::from) {
            positive("std", value)?;
        }
        match self.mean.into_iter().find(|m| !(-1e3..=1e3).contains(m)) {
            Some(m) => {
                Err(CodingError { name: "mean", value: m.into(), range: "from -1000 to 1000" })
            }
            None => Ok(()),
        }
    }

    /// What the authors of virtual normals trained on KITTI with: 0.015 to 1, times 80 m,
    /// focal length 357.3 px, the normalisation of ImageNet.
    pub const KITTI: Self = Self {
        min: 0.015,
        max: 1.0,
        scale: 80.0,
        focal: 357.3,
        mean: [0.485, 0.456, 0.406],
        std: [0.229, 0.224, 0.225],
    };

    /// Key of [`DepthCoding::to_json`] in the metadata of ONNX and safetensors files.
    pub const KEY: &'static str = "realnet_depth";

    /// As an object: `{"min":0.01,"max":1.7,"scale":10.0,"focal":519.0,"mean":[r,g,b],"std":[r,g,b]}`.
    #[must_use]
    pub fn to_json(&self) -> String {
        let Self { min, max, scale, focal, mean, std } = *self;
        let coding = json!({
            "min": min, "max": max, "scale": scale, "focal": focal,
            "mean": shortest(mean), "std": shortest(std),
        });
        coding.to_string()
    }

    /// Reads what [`DepthCoding::to_json`] writes.
    ///
    /// # Errors
    /// [`DepthMetadataError`] when it is no such object, or a number is out of its range.
    pub fn from_json(text: &str) -> Result<Self, DepthMetadataError> {
        let coding = serde_json::from_str(text).ok().as_ref().and_then(read_coding);
        let coding = coding.ok_or_else(|| {
            let expected = "an object of min, max, scale, focal, mean and std";
            DepthMetadataError::entry(Self::KEY, expected, text)
        })?;
        coding.check()?;
        Ok(coding)
    }

    /// The natural logarithm of the middle of each bin, in units of `scale`.
    #[must_use]
    pub fn log_borders(&self, bins: usize) -> Vec<f64> {
        let step = self.log_step(bins);
        (0..bins).map(|i| self.min.ln() + (i as f64 + 0.5) * step).collect()
    }

    /// Width of a bin in natural logarithms.
    pub(super) fn log_step(&self, bins: usize) -> f64 {
        (self.max / self.min).ln() / bins.max(1) as f64
    }
}

/// Where the samples of a smaller map lie on the input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Alignment {
    /// The outer samples lie on the outer pixels (`align_corners`).
    Corners,
    /// The outer samples lie half their distance inside the edges.
    Centres,
}

impl Alignment {
    const ALL: [(Self, &'static str); 2] = [(Self::Corners, "corners"), (Self::Centres, "centres")];

    fn name(self) -> &'static str {
        Self::ALL.iter().find(|(a, _)| *a == self).map_or("", |(_, name)| name)
    }
}

/// Metadata that cannot be read.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum DepthMetadataError {
    /// An entry is missing.
    #[error("metadata '{key}' is missing")]
    Missing {
        /// Its key.
        key: &'static str,
    },
    /// An entry cannot be read.
    #[error("metadata '{key}' is not {expected}: {found}")]
    Entry {
        /// Its key.
        key: &'static str,
        /// What it should be.
        expected: &'static str,
        /// Its text, shortened.
        found: String,
    },
    /// A number is out of its range.
    #[error(transparent)]
    Coding(#[from] CodingError),
    /// None of the tensors that the metadata name is in the graph.
    #[error("the metadata name logits '{names}', of which the graph has none")]
    Logits {
        /// Their names.
        names: String,
    },
}

impl DepthMetadataError {
    fn entry(key: &'static str, expected: &'static str, found: &str) -> Self {
        Self::Entry { key, expected, found: found.chars().take(80).collect() }
    }
}

/// The metadata of a depth network's ONNX file, for other networks to be written
/// with:
///
/// | key | value |
/// |---|---|
/// | `realnet_depth` | `{"min":0.01,"max":1.7,"scale":10.0,"focal":519.0,"mean":[r,g,b],"std":[r,g,b]}`, see [`DepthCoding`] |
/// | `realnet_logits` | names of tensors `[1, bins, h, w]`, the finest first, separated by commas; those that the graph lacks do not count |
/// | `realnet_align` | `corners` or `centres`, see [`Alignment`] |
/// | `stride` | width and height of the input have to be multiples of this |
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMetadata {
    /// How the numbers are metres.
    pub coding: DepthCoding,
    /// Names of the tensors with logits in the graph, the finest first; at least one.
    pub logits: Vec<String>,
    /// Where the logits lie on the input.
    pub alignment: Alignment,
    /// Width and height of the input have to be multiples of this.
    pub stride: usize,
}

impl DepthMetadata {
    /// Reads the metadata of a model; `None` if it has none of a depth network.
    ///
    /// # Errors
    /// [`DepthMetadataError`] if they cannot be read or do not fit the graph.
    pub fn from_onnx(model: &OnnxModel) -> Result<Option<Self>, DepthMetadataError> {
        let metadata = model.metadata();
        let get = |key: &'static str| {
            metadata.get(key).map(String::as_str).ok_or(DepthMetadataError::Missing { key })
        };
        let entry = DepthMetadataError::entry;
        let Ok(text) = get(DepthCoding::KEY) else { return Ok(None) };
        let coding = DepthCoding::from_json(text)?;
        let names = get("realnet_logits")?;
        // A file that was cut to one of them has no others.
        let logits = names.split(',').map(str::trim).filter(|name| model.has_tensor(name));
        let logits: Vec<String> = logits.map(str::to_owned).collect();
        if logits.is_empty() {
            return Err(DepthMetadataError::Logits { names: names.to_owned() });
        }
        let text = get("realnet_align")?;
        let alignment = Alignment::ALL.into_iter().find(|(_, name)| *name == text);
        let (alignment, _) =
            alignment.ok_or_else(|| entry("realnet_align", "'corners' or 'centres'", text))?;
        let text = get("stride")?;
        let stride = text.parse().ok().filter(|n| (1..=65_536).contains(n));
        let stride = stride.ok_or_else(|| entry("stride", "a positive number", text))?;
        Ok(Some(Self { coding, logits, alignment, stride }))
    }

    /// The entries to write into a file.
    #[must_use]
    pub fn entries(&self) -> Vec<(&'static str, String)> {
        vec![
            (DepthCoding::KEY, self.coding.to_json()),
            ("realnet_logits", self.logits.join(",")),
            ("realnet_align", self.alignment.name().to_owned()),
            ("stride", self.stride.to_string()),
        ]
    }
}

/// The doubles that read like the given floats: 0.485, not 0.48500001430511475.
fn shortest(values: [f32; 3]) -> [f64; 3] {
    values.map(|v| v.to_string().parse().unwrap_or_else(|_| f64::from(v)))
}

fn read_coding(value: &Value) -> Option<DepthCoding> {
    let number = |key: &str| value.get(key)?.as_f64();
    let triple = |key: &str| -> Option<[f32; 3]> {
        let list = value.get(key)?.as_array()?.iter();
        let list: Vec<f32> = list.map(|v| v.as_f64().map(|v| v as f32)).collect::<Option<_>>()?;
        list.try_into().ok()
    };
    Some(DepthCoding {
        min: number("min")?,
        max: number("max")?,
        scale: number("scale")?,
        focal: number("focal")?,
        mean: triple("mean")?,
        std: triple("std")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_are_those_of_the_paper() {
        let coding = DepthCoding::default();
        let borders = coding.log_borders(60);
        let step = (1.7f64.log10() - 0.01f64.log10()) / 60.0;
        for (i, border) in borders.iter().enumerate() {
            let expected = 0.01f64.log10() + step * (i as f64 + 0.5);
            assert!((border / 10f64.ln() - expected).abs() < 1e-12);
        }
        assert_eq!(borders.len(), 60);
    }

    #[test]
    fn text_comes_back_to_the_bit() {
        let third = DepthCoding { min: 1.0 / 3.0, focal: 207.6 / 0.7, ..DepthCoding::KITTI };
        let narrow = DepthCoding { mean: [0.1, 1.0 / 3.0, 0.7], ..third };
        for coding in [DepthCoding::default(), DepthCoding::KITTI, third, narrow] {
            assert_eq!(DepthCoding::from_json(&coding.to_json()), Ok(coding));
        }
        assert!(DepthCoding::default().to_json().contains("[0.485,0.456,0.406]"));
    }

    #[test]
    fn absurd_numbers_are_named() {
        let good = DepthCoding::default();
        assert_eq!(good.check(), Ok(()));
        assert_eq!(DepthCoding::KITTI.check(), Ok(()));
        for (bad, name) in [
            (DepthCoding { min: 0.0, ..good }, "min"),
            (DepthCoding { max: 0.005, ..good }, "max"),
            (DepthCoding { max: f64::INFINITY, ..good }, "max"),
            (DepthCoding { scale: -1.0, ..good }, "scale"),
            (DepthCoding { focal: f64::NAN, ..good }, "focal"),
            (DepthCoding { std: [0.2, 0.0, 0.2], ..good }, "std"),
            (DepthCoding { mean: [f32::NAN, 0.0, 0.2], ..good }, "mean"),
        ] {
            let error = bad.check().unwrap_err();
            assert_eq!(error.name, name);
            assert!(error.to_string().contains("must be"), "{error}");
        }
    }
}
