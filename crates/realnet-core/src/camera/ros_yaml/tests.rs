use super::*;
use proptest::prelude::*;

/// In the layout and number format of the Python calibration tool.
const PINHOLE_STEREO: &str = "\
image_width: 640
image_height: 480
camera_name: narrow_stereo/left
camera_matrix:
  rows: 3
  cols: 3
  data: [ 430.15433,   0.     , 311.71339,
            0.     , 430.60920, 221.06824,
            0.     ,   0.     ,   1.     ]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.337586, 0.111627, -0.000218, -0.000027, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [ 0.999980,  0.004571, -0.004410,
         -0.004594,  0.999975, -0.005268,
          0.004386,  0.005288,  0.999976]
projection_matrix:
  rows: 3
  cols: 4
  data: [ 355.64, 0., 320.37, -31.9,
          0., 417.7, 240.38, 0,
          0, 0, 1, 0]
";

fn with(key: &str, value: &str) -> Result<CameraCalibration, CalibrationError> {
    let text = format!(
        "image_width: 640\nimage_height: 480\n\
             camera_matrix: {{rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}}\n\
             {key}: {value}\n"
    );
    CameraCalibration::from_ros_yaml(&text)
}

fn lens(model: &str, data: &str) -> Result<Distortion, CalibrationError> {
    let count = data.split(',').filter(|v| !v.trim().is_empty()).count();
    let coefficients =
        format!("{model}\ndistortion_coefficients: {{rows: 1, cols: {count}, data: [{data}]}}");
    Ok(with("distortion_model", &coefficients)?.camera().distortion())
}

#[test]
fn reads_what_the_calibration_tool_writes() {
    let c = CameraCalibration::from_ros_yaml(PINHOLE_STEREO).unwrap();
    assert_eq!(c.name(), "narrow_stereo/left");
    assert_eq!((c.camera().width(), c.camera().height()), (640, 480));
    assert_eq!((c.camera().fx(), c.camera().cy()), (430.15433, 221.06824));
    let expected = Distortion::PlumbBob([-0.337586, 0.111627, -0.000218, -0.000027, 0.0]);
    assert_eq!(c.camera().distortion(), expected);
    assert_eq!(c.rectification()[(0, 2)], -0.004410);
    assert_eq!(c.projection()[(0, 3)], -31.9);
    assert_eq!(CameraCalibration::from_ros_yaml(&c.to_ros_yaml()).unwrap(), c);
}

#[test]
fn left_out_keys_have_the_values_of_a_single_camera() {
    let c = with("unknown_key", "[1, 2]").unwrap();
    assert_eq!(c, CameraCalibration::new("", *c.camera()));
    assert_eq!(c.camera().distortion(), Distortion::None);
    assert_eq!(c.projection()[(1, 2)], 240.0);
    assert_eq!(with("camera_name", "00815").unwrap().name(), "00815");
}

#[test]
fn coefficient_vectors_shorter_and_longer_than_the_model() {
    let plumb_bob = |c| Ok(Distortion::PlumbBob(c));
    assert_eq!(lens("plumb_bob", ""), Ok(Distortion::None));
    assert_eq!(lens("plumb_bob", "1, 2, 3, 4"), plumb_bob([1.0, 2.0, 3.0, 4.0, 0.0]));
    assert_eq!(lens("plumb_bob", "1, 2, 3, 4, 5, 0, 0, 0"), plumb_bob([1.0, 2.0, 3.0, 4.0, 5.0]));
    assert_eq!(
        lens("rational_polynomial", "1, 2, 3, 4, 5"),
        Ok(Distortion::RationalPolynomial([1.0, 2.0, 3.0, 4.0, 5.0, 0.0, 0.0, 0.0]))
    );
    assert_eq!(
        lens("equidistant", "1, 2, 3, 4"),
        Ok(Distortion::Equidistant([1.0, 2.0, 3.0, 4.0]))
    );
}

#[test]
fn errors_name_what_is_wrong() {
    let message = |result: Result<Distortion, CalibrationError>| result.unwrap_err().to_string();
    assert_eq!(
        message(lens("plumb_bob", "1, 2")),
        "camera calibration: distortion_coefficients has 2 values, expected 0, 4 or 5 (plumb_bob)"
    );
    assert_eq!(
        message(lens("plumb_bob", "1, 2, 3, 4, 5, 6, 7, 8")),
        "camera calibration: distortion coefficient 5 is 6, but plumb_bob has 5 coefficients"
    );
    assert_eq!(
        message(lens("equidistant", "")),
        "camera calibration: distortion_coefficients has 0 values, expected 4 (equidistant)"
    );
    assert_eq!(
        message(lens("mei", "1, 2, 3, 4")),
        "camera calibration: unknown distortion_model \"mei\", known are plumb_bob, \
             rational_polynomial, equidistant"
    );
    assert_eq!(
        message(lens("plumb_bob", "0, .nan, 0, 0, 0")),
        "camera calibration: value 1 of distortion_coefficients is NaN, it must be finite"
    );
    assert_eq!(
        message(lens("plumb_bob", "0, 0, 0, 0, -1e7")),
        "camera calibration: distortion coefficient 4 is -10000000, its magnitude must be at \
             most 1000000"
    );
    let message = |text: &str| CameraCalibration::from_ros_yaml(text).unwrap_err().to_string();
    let change = |from: &str, to: &str| {
        assert!(PINHOLE_STEREO.contains(from));
        message(&PINHOLE_STEREO.replacen(from, to, 1))
    };
    assert_eq!(
        change("  rows: 3", "  rows: 4"),
        "camera calibration: camera_matrix is 4x3, expected 3x3"
    );
    assert_eq!(
        change(", 0,\n          0, 0, 1, 0]", "]"),
        "camera calibration: projection_matrix has 7 values, expected 12"
    );
    assert_eq!(
        change("430.15433,   0. ", "430.15433,   0.5"),
        "camera calibration: entry 1 of camera_matrix is 0.5, this camera model needs 0"
    );
    assert_eq!(
        change("430.15433", "-1"),
        "camera calibration: focal length fx is -1, it must be finite and greater than 0"
    );
    assert_eq!(
        change("image_width: 640", "image_width: 0"),
        "camera calibration: a camera of 0x480 pixels has no picture"
    );
    assert!(change("image_height: 480\n", "").contains("image_height"));
    assert!(change("image_height: 480", "image_height: tall").contains("2"), "names the line");
    assert!(message("").starts_with("camera calibration: "));
    assert!(message("[[[[").starts_with("camera calibration: "));
    assert!(message(&"[".repeat(100_000)).starts_with("camera calibration: "));
}

#[test]
fn the_layout_is_that_of_ros() {
    let intrinsics = Intrinsics { fx: 1e-7, fy: 2.5e20, cx: 3.0, cy: -0.5 };
    let lens = Distortion::PlumbBob([-0.3, 0.0, 0.0, 1e-5, 0.0]);
    let camera = CameraModel::new(64, 48, intrinsics, lens).unwrap();
    let text = CameraCalibration::new("a b", camera).to_ros_yaml();
    assert_eq!(
        text,
        "\
image_width: 64
image_height: 48
camera_name: \"a b\"
camera_matrix:
  rows: 3
  cols: 3
  data: [1.0e-7, 0.0, 3.0,
         0.0, 2.5e+20, -0.5,
         0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.3, 0.0, 0.0, 1.0e-5, 0.0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0,
         0.0, 1.0, 0.0,
         0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [1.0e-7, 0.0, 3.0, 0.0,
         0.0, 2.5e+20, -0.5, 0.0,
         0.0, 0.0, 1.0, 0.0]
"
    );
}

#[test]
fn names_that_look_like_other_types_stay_strings() {
    let camera = *with("x", "1").unwrap().camera();
    for name in
        ["", "null", "True", "NO", "~", "12", "1e3", ".nan", "a: b", "# c", "-", "\u{feff}é\u{85}"]
    {
        let calibration = CameraCalibration::new(name, camera);
        let text = calibration.to_ros_yaml();
        assert_eq!(CameraCalibration::from_ros_yaml(&text).unwrap().name(), name, "{text}");
    }
}

fn any_lens() -> impl Strategy<Value = Distortion> {
    let k = || -1e6..1e6f64;
    prop_oneof![
        Just(Distortion::None),
        prop::array::uniform5(k()).prop_map(Distortion::PlumbBob),
        prop::array::uniform8(k()).prop_map(Distortion::RationalPolynomial),
        prop::array::uniform4(k()).prop_map(Distortion::Equidistant),
    ]
}

proptest! {
    #[test]
    fn writing_and_reading_gives_the_same_bits(
        name in any::<String>(),
        size in (1..=u32::MAX, 1..=u32::MAX),
        focal in prop::array::uniform2(prop::num::f64::POSITIVE),
        centre in prop::array::uniform2(prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL),
        distortion in any_lens(),
        matrices in prop::collection::vec(prop::num::f64::NORMAL | prop::num::f64::ZERO, 21),
    ) {
        prop_assume!(focal[0] > 0.0 && focal[0].is_finite());
        prop_assume!(focal[1] > 0.0 && focal[1].is_finite());
        let [fx, fy] = focal;
        let [cx, cy] = centre;
        let camera =
            CameraModel::new(size.0, size.1, Intrinsics { fx, fy, cx, cy }, distortion).unwrap();
        let calibration = CameraCalibration::new(name, camera)
            .with_rectification(
                Matrix3::from_row_slice(&matrices[..9]),
                Matrix3x4::from_row_slice(&matrices[9..]),
            )
            .unwrap();
        let text = calibration.to_ros_yaml();
        let again = CameraCalibration::from_ros_yaml(&text).unwrap();
        prop_assert_eq!(&again, &calibration);
        // Equal numbers with equal signs of zero print the same text.
        prop_assert_eq!(again.to_ros_yaml(), text);
    }
}
