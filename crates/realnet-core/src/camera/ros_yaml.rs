//! The camera calibration file of ROS: what `camera_calibration` writes and
//! `camera_info_manager` reads (package `camera_calibration_parsers`).

use super::{CameraError, CameraModel, Distortion, Intrinsics};
use nalgebra::{Matrix3, Matrix3x4};
use serde::Deserialize;
use std::fmt::Write as _;
use thiserror::Error;

/// The distortion models that can be read, by their names in ROS.
const MODELS: &str = "plumb_bob, rational_polynomial, equidistant";

/// Why a text is not a camera calibration.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CalibrationError {
    /// Not YAML, or a key is missing or of the wrong type.
    #[error("camera calibration: {message}")]
    Yaml {
        /// What the YAML reader found, with line and column.
        message: String,
    },
    /// A matrix does not have the shape it must have.
    #[error(
        "camera calibration: {key} is {found_rows}x{found_cols}, expected {expected_rows}x{expected_cols}"
    )]
    Shape {
        /// Key in the file.
        key: &'static str,
        /// Rows it must have.
        expected_rows: u64,
        /// Columns it must have.
        expected_cols: u64,
        /// Rows it says it has.
        found_rows: u64,
        /// Columns it says it has.
        found_cols: u64,
    },
    /// The number of values does not fit the rows and columns.
    #[error("camera calibration: {key} has {found} values, expected {expected}")]
    Count {
        /// Key in the file.
        key: &'static str,
        /// Values needed.
        expected: String,
        /// Values there are.
        found: usize,
    },
    /// A value is infinite or not a number.
    #[error("camera calibration: value {index} of {key} is {value}, it must be finite")]
    NotFinite {
        /// Key in the file.
        key: &'static str,
        /// Place in the data, from 0.
        index: usize,
        /// What was found.
        value: f64,
    },
    /// An entry of the camera matrix that is fixed has another value.
    #[error(
        "camera calibration: entry {index} of camera_matrix is {found}, this camera model needs {expected}"
    )]
    MatrixEntry {
        /// Place in the data, row by row, from 0.
        index: usize,
        /// What it must be.
        expected: f64,
        /// What was found.
        found: f64,
    },
    /// The distortion model is not known.
    #[error("camera calibration: unknown distortion_model {name:?}, known are {MODELS}")]
    UnknownModel {
        /// Its name in the file.
        name: String,
    },
    /// The file has coefficients of effects that the model leaves out.
    #[error(
        "camera calibration: distortion coefficient {index} is {value}, but {model} has {count} coefficients"
    )]
    ExtraCoefficient {
        /// Name of the distortion model.
        model: &'static str,
        /// Coefficients it has.
        count: usize,
        /// Place of the coefficient, from 0.
        index: usize,
        /// What was found.
        value: f64,
    },
    /// The numbers are read, but are not a camera.
    #[error("camera calibration: {0}")]
    Camera(#[from] CameraError),
}

/// A calibrated camera with its name and, for stereo, its rectification: the
/// content of a ROS camera calibration file.
///
/// ```
/// use realnet_core::{CameraCalibration, CameraModel, Distortion, Intrinsics};
///
/// let intrinsics = Intrinsics { fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5 };
/// let lens = Distortion::PlumbBob([-0.3, 0.1, 0.0, 0.0, 0.0]);
/// let camera = CameraModel::new(640, 480, intrinsics, lens)?;
/// let calibration = CameraCalibration::new("front", camera);
/// let text = calibration.to_ros_yaml();
/// assert_eq!(CameraCalibration::from_ros_yaml(&text)?, calibration);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct CameraCalibration {
    name: String,
    camera: CameraModel,
    rectification: Matrix3<f64>,
    projection: Matrix3x4<f64>,
}

impl CameraCalibration {
    /// A single camera: the rectification is the identity, the projection is
    /// the camera matrix with a column of zeros.
    #[must_use]
    pub fn new(name: impl Into<String>, camera: CameraModel) -> Self {
        let projection = camera.matrix().insert_column(3, 0.0);
        Self { name: name.into(), camera, rectification: Matrix3::identity(), projection }
    }

    /// The same camera with the rectifying rotation `R` and the projection `P`
    /// of the rectified picture, as a stereo calibration gives them.
    ///
    /// # Errors
    /// [`CalibrationError::NotFinite`] when an entry is not finite.
    pub fn with_rectification(
        self,
        rectification: Matrix3<f64>,
        projection: Matrix3x4<f64>,
    ) -> Result<Self, CalibrationError> {
        check_finite("rectification_matrix", rectification.transpose().as_slice())?;
        check_finite("projection_matrix", projection.transpose().as_slice())?;
        Ok(Self { rectification, projection, ..self })
    }

    /// Name of the camera.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The camera.
    #[must_use]
    pub fn camera(&self) -> &CameraModel {
        &self.camera
    }

    /// `R`: the rotation that aligns the camera with its stereo pair.
    #[must_use]
    pub fn rectification(&self) -> &Matrix3<f64> {
        &self.rectification
    }

    /// `P`: projection of points in the rectified frame to the rectified
    /// picture.
    #[must_use]
    pub fn projection(&self) -> &Matrix3x4<f64> {
        &self.projection
    }

    /// Reads a ROS camera calibration file.
    ///
    /// `image_width`, `image_height` and `camera_matrix` must be there. Missing
    /// `camera_name` is empty, missing `distortion_model` is `plumb_bob` as in
    /// ROS, missing `rectification_matrix` and `projection_matrix` are those of
    /// [`CameraCalibration::new`]; other keys are ignored. Missing or empty
    /// `distortion_coefficients` of the two polynomial models mean a pinhole;
    /// their vectors may have 4, 5 or 8 values as OpenCV's (those left out are
    /// 0), or more when those are 0 that the model does not have.
    ///
    /// # Errors
    /// [`CalibrationError`], see its variants.
    pub fn from_ros_yaml(text: &str) -> Result<Self, CalibrationError> {
        let raw: RawCalibration = serde_saphyr::from_str(text)
            .map_err(|error| CalibrationError::Yaml { message: error.to_string() })?;
        let k = raw.camera_matrix.values::<9>("camera_matrix", 3, 3)?;
        let [fx, _, cx, _, fy, cy, ..] = k;
        for (index, expected) in [(1, 0.0), (3, 0.0), (6, 0.0), (7, 0.0), (8, 1.0)] {
            if k[index] != expected {
                return Err(CalibrationError::MatrixEntry { index, expected, found: k[index] });
            }
        }
        let coefficients = raw.distortion_coefficients.map_or(Ok(Vec::new()), RawMatrix::vector)?;
        let distortion = distortion(raw.distortion_model.as_deref(), &coefficients)?;
        let intrinsics = Intrinsics { fx, fy, cx, cy };
        let camera = CameraModel::new(raw.image_width, raw.image_height, intrinsics, distortion)?;
        let plain = Self::new(raw.camera_name.unwrap_or_default(), camera);
        let rectification = match raw.rectification_matrix {
            Some(r) => Matrix3::from_row_slice(&r.values::<9>("rectification_matrix", 3, 3)?),
            None => plain.rectification,
        };
        let projection = match raw.projection_matrix {
            Some(p) => Matrix3x4::from_row_slice(&p.values::<12>("projection_matrix", 3, 4)?),
            None => plain.projection,
        };
        plain.with_rectification(rectification, projection)
    }

    /// Writes a ROS camera calibration file. Reading it gives the same values
    /// to the last bit. A pinhole is written as `plumb_bob` without
    /// coefficients.
    #[must_use]
    pub fn to_ros_yaml(&self) -> String {
        let camera = &self.camera;
        let model = match camera.distortion() {
            Distortion::None | Distortion::PlumbBob(_) => "plumb_bob",
            Distortion::RationalPolynomial(_) => "rational_polynomial",
            Distortion::Equidistant(_) => "equidistant",
        };
        let mut text = String::new();
        // Writing to a String does not fail.
        let _ = writeln!(text, "image_width: {}", camera.width());
        let _ = writeln!(text, "image_height: {}", camera.height());
        let _ = writeln!(text, "camera_name: {}", quoted(&self.name));
        write_matrix(&mut text, "camera_matrix", 3, camera.matrix().transpose().as_slice());
        let _ = writeln!(text, "distortion_model: {model}");
        write_matrix(&mut text, "distortion_coefficients", 1, camera.distortion().coefficients());
        let by_rows = self.rectification.transpose();
        write_matrix(&mut text, "rectification_matrix", 3, by_rows.as_slice());
        write_matrix(&mut text, "projection_matrix", 3, self.projection.transpose().as_slice());
        text
    }
}

#[derive(Deserialize)]
struct RawCalibration {
    image_width: u32,
    image_height: u32,
    camera_name: Option<String>,
    camera_matrix: RawMatrix,
    distortion_model: Option<String>,
    distortion_coefficients: Option<RawMatrix>,
    rectification_matrix: Option<RawMatrix>,
    projection_matrix: Option<RawMatrix>,
}

#[derive(Deserialize)]
struct RawMatrix {
    rows: u64,
    cols: u64,
    data: Vec<f64>,
}

impl RawMatrix {
    /// The `N = rows * cols` finite values of a matrix of fixed shape.
    fn values<const N: usize>(
        self,
        key: &'static str,
        expected_rows: u64,
        expected_cols: u64,
    ) -> Result<[f64; N], CalibrationError> {
        let (found_rows, found_cols) = (self.rows, self.cols);
        if (found_rows, found_cols) != (expected_rows, expected_cols) {
            return Err(CalibrationError::Shape {
                key,
                expected_rows,
                expected_cols,
                found_rows,
                found_cols,
            });
        }
        check_finite(key, &self.data)?;
        <[f64; N]>::try_from(self.data).map_err(|data| CalibrationError::Count {
            key,
            expected: N.to_string(),
            found: data.len(),
        })
    }

    /// The finite values of the distortion coefficients, a row or a column.
    fn vector(self) -> Result<Vec<f64>, CalibrationError> {
        let key = "distortion_coefficients";
        let count = self.rows.saturating_mul(self.cols);
        if count > 0 && self.rows != 1 && self.cols != 1 {
            return Err(CalibrationError::Shape {
                key,
                expected_rows: 1,
                expected_cols: count,
                found_rows: self.rows,
                found_cols: self.cols,
            });
        }
        if self.data.len() as u64 != count {
            let (expected, found) = (count.to_string(), self.data.len());
            return Err(CalibrationError::Count { key, expected, found });
        }
        check_finite(key, &self.data)?;
        Ok(self.data)
    }
}

fn distortion(model: Option<&str>, given: &[f64]) -> Result<Distortion, CalibrationError> {
    match model.unwrap_or("plumb_bob") {
        "plumb_bob" | "rational_polynomial" if given.is_empty() => Ok(Distortion::None),
        "plumb_bob" => {
            Ok(Distortion::PlumbBob(coefficients("plumb_bob", given, &[4, 5], "0, 4 or 5")?))
        }
        "rational_polynomial" => Ok(Distortion::RationalPolynomial(coefficients(
            "rational_polynomial",
            given,
            &[4, 5, 8],
            "0, 4, 5 or 8",
        )?)),
        "equidistant" => {
            Ok(Distortion::Equidistant(coefficients("equidistant", given, &[4], "4")?))
        }
        name => Err(CalibrationError::UnknownModel { name: name.to_owned() }),
    }
}

/// The `N` coefficients of a model from one of the `counts` it may be given
/// with, or from more when the others are 0.
fn coefficients<const N: usize>(
    model: &'static str,
    given: &[f64],
    counts: &[usize],
    expected: &str,
) -> Result<[f64; N], CalibrationError> {
    if let Some((index, &value)) = given.iter().enumerate().skip(N).find(|&(_, &v)| v != 0.0) {
        return Err(CalibrationError::ExtraCoefficient { model, count: N, index, value });
    }
    if given.len() < N && !counts.contains(&given.len()) {
        let expected = format!("{expected} ({model})");
        let (key, found) = ("distortion_coefficients", given.len());
        return Err(CalibrationError::Count { key, expected, found });
    }
    let mut all = [0.0; N];
    for (slot, value) in all.iter_mut().zip(given) {
        *slot = *value;
    }
    Ok(all)
}

fn check_finite(key: &'static str, values: &[f64]) -> Result<(), CalibrationError> {
    match values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
        Some((index, &value)) => Err(CalibrationError::NotFinite { key, index, value }),
        None => Ok(()),
    }
}

fn write_matrix(text: &mut String, key: &str, rows: usize, by_rows: &[f64]) {
    let cols = by_rows.len() / rows;
    let _ = write!(text, "{key}:\n  rows: {rows}\n  cols: {cols}\n  data: [");
    for (index, value) in by_rows.iter().enumerate() {
        let separator = match index {
            0 => "",
            _ if index % cols == 0 => ",\n         ",
            _ => ", ",
        };
        let _ = write!(text, "{separator}{}", number(*value));
    }
    text.push_str("]\n");
}

/// The shortest decimal that reads back as the same number, spelled so that
/// YAML 1.1 readers (PyYAML, yaml-cpp) take it for a float too: these need a
/// point in the mantissa and a sign in the exponent.
fn number(value: f64) -> String {
    let shortest = format!("{value:?}");
    let Some((mantissa, exponent)) = shortest.split_once('e') else { return shortest };
    let point = if mantissa.contains('.') { "" } else { ".0" };
    let sign = if exponent.starts_with('-') { "" } else { "+" };
    format!("{mantissa}{point}e{sign}{exponent}")
}

/// A name as a YAML scalar: plain when that can only be a string, otherwise in
/// double quotes.
fn quoted(name: &str) -> String {
    let word = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let plain = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.chars().all(word)
        && !["null", "true", "false", "yes", "no", "on", "off", "y", "n"]
            .contains(&name.to_ascii_lowercase().as_str());
    if plain {
        return name.to_owned();
    }
    let mut text = String::from('"');
    for c in name.chars() {
        match c {
            '"' | '\\' => text.extend(['\\', c]),
            ' '..='~' => text.push(c),
            _ => {
                let _ = match u32::from(c) {
                    code @ 0..=0xff => write!(text, "\\x{code:02x}"),
                    code @ 0x100..=0xffff => write!(text, "\\u{code:04x}"),
                    code => write!(text, "\\U{code:08x}"),
                };
            }
        }
    }
    text.push('"');
    text
}

#[cfg(test)]
mod tests;
