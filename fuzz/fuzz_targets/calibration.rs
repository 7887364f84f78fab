//! Any text is either refused as a ROS camera calibration, or is a camera that
//! can be written, read back unchanged and asked for rays without a wrong one.
#![no_main]

use libfuzzer_sys::fuzz_target;
use realnet_core::CameraCalibration;

fuzz_target!(|text: &str| {
    let Ok(calibration) = CameraCalibration::from_ros_yaml(text) else { return };
    let written = calibration.to_ros_yaml();
    let again = match CameraCalibration::from_ros_yaml(&written) {
        Ok(again) => again,
        Err(error) => panic!("what was written is not read: {error}\n{written}"),
    };
    assert_eq!(again, calibration);
    assert_eq!(again.to_ros_yaml(), written);

    let camera = calibration.camera();
    let (width, height) = (f64::from(camera.width()), f64::from(camera.height()));
    for pixel in [[0.0, 0.0], [width / 2.0, height / 2.0], [width - 1.0, height / 3.0]] {
        let Ok(ray) = camera.unproject(pixel) else { continue };
        assert!(ray[0].hypot(ray[1]) <= camera.valid_radius(), "{ray:?}");
        let seen = match camera.project_ray(ray) {
            Ok(seen) => seen,
            Err(error) => panic!("the ray {ray:?} of {pixel:?} is refused: {error}"),
        };
        // The inverse is accurate on the unit plane; focal lengths far from
        // any camera's turn that into any number of pixels.
        let bent = [(pixel[0] - camera.cx()) / camera.fx(), (pixel[1] - camera.cy()) / camera.fy()];
        let scale = bent[0].hypot(bent[1]).max(1.0);
        let tolerance = |offset: f64, focal: f64| {
            1e-12 * scale * focal
                + 4.0 * f64::EPSILON * (offset.abs() + seen[0].abs() + seen[1].abs())
        };
        assert!(
            (seen[0] - pixel[0]).abs() <= tolerance(camera.cx(), camera.fx()),
            "{pixel:?} {seen:?}"
        );
        assert!(
            (seen[1] - pixel[1]).abs() <= tolerance(camera.cy(), camera.fy()),
            "{pixel:?} {seen:?}"
        );
    }
});
