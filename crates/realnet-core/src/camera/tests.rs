//! Golden values by OpenCV 5.0.0 (opencv-python-headless) with
//! `K = [[458.654, 0, 367.215], [0, 457.296, 248.375], [0, 0, 1]]`:
//! `cv2.projectPoints` / `cv2.fisheye.projectPoints` without rotation and
//! translation, `cv2.undistortPoints` / `cv2.fisheye.undistortPoints` with
//! `criteria=(3, 2000, 1e-16)`, that is until OpenCV's iteration stands still.

use super::*;
use proptest::prelude::*;

const POINTS: [[f64; 3]; 5] =
    [[0.1, -0.2, 1.0], [-1.2, 0.7, 2.5], [0.9, 0.55, 1.4], [0.0, 0.0, 3.0], [-2.0, -1.5, 4.0]];
const PIXELS: [[f64; 2]; 4] = [[10.0, 20.0], [700.0, 400.0], [367.215, 248.375], [120.25, 333.5]];

const PLUMB_BOB: Distortion =
    Distortion::PlumbBob([-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.01]);
const RATIONAL: Distortion =
    Distortion::RationalPolynomial([12.1, 3.2, 0.0005, -0.0003, 0.11, 12.5, 8.4, 0.6]);
const EQUIDISTANT: Distortion =
    Distortion::Equidistant([-0.0034823, 0.0007150, -0.0020532, 0.00020293]);

fn camera(distortion: Distortion) -> CameraModel {
    let intrinsics = Intrinsics { fx: 458.654, fy: 457.296, cx: 367.215, cy: 248.375 };
    CameraModel::new(752, 480, intrinsics, distortion).unwrap()
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn check_projected(lens: Distortion, expected: [[f64; 2]; 5]) {
    let camera = camera(lens);
    for (point, pixel) in POINTS.into_iter().zip(expected) {
        let found = camera.project(&Point3::from(point)).unwrap();
        assert!(distance(found, pixel) < 1e-10, "{found:?}, OpenCV {pixel:?}");
    }
}

fn check_undistorted(lens: Distortion, expected: [[f64; 2]; 4]) {
    let camera = camera(lens);
    for (ray, expected) in camera.undistort_points(&PIXELS).zip(expected) {
        let ray = ray.unwrap();
        assert!(distance(ray, expected) < 1e-12, "{ray:?}, OpenCV {expected:?}");
    }
}

#[test]
fn plumb_bob_is_opencvs() {
    check_projected(
        PLUMB_BOB,
        [
            [412.4360204505109, 158.2059753858615],
            [164.69304261928409, 366.1918103627773],
            [622.2545188413586, 403.81846897337823],
            [367.215, 248.375],
            [160.59173163687947, 93.89860296561739],
        ],
    );
    check_undistorted(
        PLUMB_BOB,
        [
            [-1.0050191945501359, -0.6447731924860323],
            [0.9048342565198184, 0.41325997381371404],
            [0.0, 0.0],
            [-0.5991063952538395, 0.2070266413704575],
        ],
    );
}

#[test]
fn rational_polynomial_is_opencvs() {
    check_projected(
        RATIONAL,
        [
            [412.1403932627887, 158.7879605798742],
            [171.46534904059502, 362.2701005810822],
            [608.1595798766402, 395.3603120867813],
            [367.215, 248.375],
            [169.02943372835688, 100.3054294070295],
        ],
    );
    check_undistorted(
        RATIONAL,
        [
            [-1.4909727062833302, -0.9602142160744902],
            [1.0941014497914532, 0.4985917978396964],
            [0.0, 0.0],
            [-0.6349559835558872, 0.2192984668138845],
        ],
    );
}

#[test]
fn equidistant_is_opencvs_fisheye() {
    check_projected(
        EQUIDISTANT,
        [
            [412.3305816840232, 158.4109964514555],
            [166.4492262560868, 365.14161435598794],
            [619.5334744952077, 402.1130780671227],
            [367.215, 248.375],
            [162.47278544075374, 95.27299541306999],
        ],
    );
    check_undistorted(
        EQUIDISTANT,
        [
            [-1.1254805528717664, -0.7216799689829204],
            [0.935904887570705, 0.4276875118635961],
            [0.0, 0.0],
            [-0.6062787838541602, 0.20959545906923735],
        ],
    );
}

#[test]
fn a_folding_barrel_is_refused_beyond_its_fold() {
    // f(r) = r - r^3 / 2 turns at r = sqrt(2/3), where it reaches 0.5443.
    let camera = camera(Distortion::PlumbBob([-0.5, 0.0, 0.0, 0.0, 0.0]));
    let fold = (2.0f64 / 3.0).sqrt();
    assert!((camera.valid_radius() - fold).abs() < 1e-12);
    assert!(camera.project_ray([fold - 1e-6, 0.0]).is_ok());
    let error = camera.project_ray([0.0, 1.0]).unwrap_err();
    assert_eq!(error, CameraError::OutsideLens { radius: 1.0, limit: camera.valid_radius() });
    let highest = fold * (1.0 - fold * fold / 2.0);
    let pixel = |bent: f64| [camera.cx() + bent * camera.fx(), camera.cy()];
    let edge = camera.unproject(pixel(highest - 1e-9)).unwrap();
    assert!(edge[0] < fold && edge[0] > fold - 1e-3, "{edge:?}");
    match camera.unproject(pixel(highest + 0.01)) {
        Err(CameraError::NoInverse { residual, .. }) => assert!((residual - 0.01).abs() < 1e-4),
        other => panic!("{other:?}"),
    }
    assert!(camera.horizontal_fov().is_err());
}

#[test]
fn a_folding_fisheye_is_refused_beyond_its_fold() {
    // t - t^3 / 3 turns at 1 rad, where it reaches 2/3.
    let camera = camera(Distortion::Equidistant([-1.0 / 3.0, 0.0, 0.0, 0.0]));
    assert!((camera.valid_radius() - 1f64.tan()).abs() < 1e-12);
    assert!(camera.project_ray([2.0, 0.0]).is_err());
    assert!(camera.unproject([camera.cx(), camera.cy() + 0.66 * camera.fy()]).is_ok());
    assert!(camera.unproject([camera.cx(), camera.cy() + 0.67 * camera.fy()]).is_err());
}

#[test]
fn a_pole_of_the_rational_model_ends_it() {
    // 1 / (1 - r^2 / 4) has its pole at r = 2 and no fold before it.
    let pole = Distortion::RationalPolynomial([0.0, 0.0, 0.0, 0.0, 0.0, -0.25, 0.0, 0.0]);
    let camera = camera(pole);
    assert!((camera.valid_radius() - 2.0).abs() < 1e-12);
    assert!(camera.project_ray([1.9, 0.0]).is_ok());
    assert!(camera.project_ray([2.1, 0.0]).is_err());
}

#[test]
fn points_that_are_not_in_front_are_refused() {
    for lens in [Distortion::None, PLUMB_BOB, RATIONAL, EQUIDISTANT] {
        let camera = camera(lens);
        let behind = camera.project(&Point3::new(0.1, 0.1, -1.0));
        assert_eq!(behind, Err(CameraError::Behind { z: -1.0 }));
        assert_eq!(camera.project(&Point3::origin()), Err(CameraError::Behind { z: 0.0 }));
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(camera.project(&Point3::new(0.0, 0.0, bad)).is_err());
            assert!(camera.project(&Point3::new(bad, 0.0, 1.0)).is_err());
            assert!(camera.unproject([bad, 0.0]).is_err());
            assert!(camera.unproject_at_depth([9.0, 9.0], bad).is_err());
        }
        assert!(camera.unproject_at_depth([9.0, 9.0], 0.0).is_err());
    }
}

#[test]
fn cameras_that_cannot_be_are_refused() {
    let good = Intrinsics { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0 };
    let build = |intrinsics| CameraModel::new(4, 4, intrinsics, Distortion::None);
    assert!(build(good).is_ok());
    assert!(CameraModel::new(0, 4, good, Distortion::None).is_err());
    assert!(build(Intrinsics { fx: 0.0, ..good }).is_err());
    assert!(build(Intrinsics { fy: f64::NAN, ..good }).is_err());
    let error = build(Intrinsics { cy: f64::INFINITY, ..good }).unwrap_err();
    assert_eq!(error.to_string(), "principal point cy is inf, it must be finite");
    let bad = Distortion::Equidistant([0.0, f64::NAN, 0.0, 0.0]);
    let error = CameraModel::new(4, 4, good, bad).unwrap_err();
    assert!(matches!(error, CameraError::Coefficient { index: 1, .. }));
}

#[test]
fn fields_of_view() {
    let f = 320.0;
    let intrinsics = Intrinsics { fx: f, fy: f, cx: 319.5, cy: 239.5 };
    let pinhole = CameraModel::new(640, 480, intrinsics, Distortion::None).unwrap();
    assert!((pinhole.horizontal_fov().unwrap().to_degrees() - 90.0).abs() < 1e-12);
    assert!((pinhole.vertical_fov().unwrap() - 2.0 * 0.75f64.atan()).abs() < 1e-15);
    // An ideal fisheye: the angle grows with the pixel.
    let lens = Distortion::Equidistant([0.0; 4]);
    let fisheye = CameraModel::new(640, 480, intrinsics, lens).unwrap();
    assert!((fisheye.horizontal_fov().unwrap() - 2.0).abs() < 1e-12);
}

#[test]
fn resizing_and_cropping_move_pixels_as_pictures_do() {
    let full = camera(PLUMB_BOB);
    let half = full.scaled(376, 240).unwrap();
    let crop = full.cropped(100, 50, 400, 300).unwrap();
    assert_eq!((crop.width(), crop.height()), (400, 300));
    for point in POINTS.map(Point3::from) {
        let [u, v] = full.project(&point).unwrap();
        let expected = [(u + 0.5) * 0.5 - 0.5, (v + 0.5) * 0.5 - 0.5];
        assert!(distance(half.project(&point).unwrap(), expected) < 1e-12);
        assert!(distance(crop.project(&point).unwrap(), [u - 100.0, v - 50.0]) < 1e-12);
    }
    let fov = |camera: &CameraModel| camera.horizontal_fov().unwrap();
    assert!((fov(&half) - fov(&full)).abs() < 1e-12);
    assert_eq!(full.cropped(0, 0, 752, 480).unwrap(), full);
    let error = full.cropped(700, 0, 100, 10).unwrap_err().to_string();
    assert_eq!(error, "a crop of 100x10 at (700, 0) reaches beyond the picture of 752x480 pixels");
    assert!(full.cropped(u32::MAX, 0, 2, 2).is_err());
    assert!(full.cropped(0, 0, 0, 2).is_err());
    assert!(full.scaled(0, 10).is_err());
}

#[test]
fn pixels_move_between_cameras() {
    let bent = camera(PLUMB_BOB);
    let straight = bent.without_distortion();
    for point in POINTS.map(Point3::from) {
        let pixels = [bent.project(&point).unwrap()];
        let moved = bent.reproject_points(&pixels, &straight).next().unwrap().unwrap();
        assert!(distance(moved, straight.project(&point).unwrap()) < 1e-9);
    }
    assert!(straight.contains([-0.5, 479.5]) && !straight.contains([-0.6, 0.0]));
}

/// Lenses from mild to wild: most of these fold inside the picture.
fn any_lens() -> impl Strategy<Value = Distortion> {
    let k = || -0.6..0.6f64;
    let p = || -0.02..0.02f64;
    prop_oneof![
        Just(Distortion::None),
        (k(), k(), p(), p(), k()).prop_map(|k| Distortion::PlumbBob(k.into())),
        (k(), k(), p(), p(), k(), k(), k(), k())
            .prop_map(|k| Distortion::RationalPolynomial(k.into())),
        prop::array::uniform4(k()).prop_map(Distortion::Equidistant),
    ]
}

fn any_camera() -> impl Strategy<Value = CameraModel> {
    (100.0..1000.0f64, 0.5..2.0f64, 200.0..400.0f64, 100.0..300.0f64, any_lens()).prop_map(
        |(fx, aspect, cx, cy, lens)| {
            let intrinsics = Intrinsics { fx, fy: fx * aspect, cx, cy };
            CameraModel::new(640, 480, intrinsics, lens).unwrap()
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4096))]

    #[test]
    fn projecting_undoes_unprojecting(
        camera in any_camera(), share in 0.0..1.0f64, angle in 0.0..6.3f64, depth in 0.1..100.0f64
    ) {
        // A ray inside the lens model, however small that is.
        let r = share * camera.valid_radius().min(3.0);
        let ray = [r * angle.cos(), r * angle.sin()];
        let pixel = camera.project_ray(ray).unwrap();
        // Towards a pole the picture grows without bound, and with it the pixel
        // that one rounding of the ray is worth.
        prop_assume!(distance(pixel, [320.0, 240.0]) < 5000.0);
        let found = camera.unproject(pixel).unwrap();
        prop_assert!(found[0].hypot(found[1]) <= camera.valid_radius());
        let again = camera.project_ray(found).unwrap();
        prop_assert!(distance(again, pixel) < 1e-9, "{:e} px", distance(again, pixel));
        if share < 0.9 {
            // One to one: the ray itself comes back, not another with this pixel.
            prop_assert!(distance(found, ray) < 1e-9 * (1.0 + r), "{:e}", distance(found, ray));
        }
        let point = camera.unproject_at_depth(pixel, depth).unwrap();
        prop_assert_eq!(point.z, depth);
        prop_assert!(distance(camera.project(&point).unwrap(), pixel) < 1e-9);
    }

    #[test]
    fn any_pixel_has_a_true_ray_or_none(
        camera in any_camera(), u in -100.0..740.0f64, v in -100.0..580.0f64
    ) {
        match camera.unproject([u, v]) {
            Ok(ray) => {
                let again = camera.project_ray(ray).unwrap();
                prop_assert!(distance(again, [u, v]) < 1e-9, "{:e}", distance(again, [u, v]));
            }
            Err(CameraError::NoInverse { residual, .. }) => prop_assert!(residual > 0.0),
            Err(other) => prop_assert!(false, "{}", other),
        }
    }

    #[test]
    fn the_model_is_one_to_one_where_it_is_said_to_be(
        camera in any_camera(),
        shares in prop::array::uniform2(0.0..1.0f64),
        angles in prop::array::uniform2(0.0..6.3f64),
    ) {
        let limit = camera.valid_radius().min(10.0);
        let ray = |i: usize| {
            let (sin, cos) = f64::sin_cos(angles[i]);
            [shares[i] * limit * cos, shares[i] * limit * sin]
        };
        let (a, b) = (ray(0), ray(1));
        let image = |ray| camera.without_focal().project_ray(ray).unwrap();
        let (fa, fb) = (image(a), image(b));
        // The gradient of a strictly convex potential is strictly monotone.
        let inner = (fa[0] - fb[0]) * (a[0] - b[0]) + (fa[1] - fb[1]) * (a[1] - b[1]);
        prop_assert!(inner > 0.0 || distance(a, b) < 1e-9, "{inner}");
    }
}

impl CameraModel {
    /// The lens alone: its pixels are the bent rays.
    fn without_focal(&self) -> Self {
        let intrinsics = Intrinsics { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0 };
        Self { intrinsics, ..*self }
    }
}
