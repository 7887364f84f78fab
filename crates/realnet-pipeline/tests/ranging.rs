//! Metres to the target: frames and signs against geometry, ranges against drawn pictures.
#![allow(missing_docs, clippy::unwrap_used)]

mod pictures;

use pictures::Pictures;
use realnet_core::nalgebra::Point3;
use realnet_core::{BoundingBox, CameraModel, Distortion, Intrinsics, Stamp};
use realnet_pipeline::{CameraMount, Ranging, RangingOptions, SightOptions, TargetBox};

fn at(index: u64) -> Stamp {
    Stamp::of_frame(index, 30.0)
}

fn camera() -> CameraModel {
    let intrinsics = Intrinsics { fx: 320.0, fy: 320.0, cx: 319.5, cy: 179.5 };
    CameraModel::new(640, 360, intrinsics, Distortion::None).unwrap()
}

const PITCHED: CameraMount =
    CameraMount { forward_m: 0.3, left_m: 0.0, height_m: 0.2, pitch_rad: 0.12 };

fn seen(bbox: BoundingBox) -> TargetBox {
    TargetBox::of_detection(Stamp::ZERO, bbox, &SightOptions::default())
}

/// The pixel of a point of the base frame, as box edges count.
fn pixel(camera: &CameraModel, mount: &CameraMount, point: [f64; 3]) -> [f32; 2] {
    let optical = mount.base_from_optical().inverse() * Point3::from(point);
    camera.project(&optical).unwrap().map(|p| p as f32 + 0.5)
}

#[test]
fn directions_are_in_the_plane_and_positive_to_the_left() {
    let camera = camera();
    let ranging = Ranging::new(&camera, &PITCHED, RangingOptions::default()).unwrap();
    for (ahead, left, up) in [(1.0, 0.0, 0.1), (1.5, 0.6, 0.1), (2.0, -1.0, 0.3)] {
        let [x, y] = pixel(&camera, &PITCHED, [PITCHED.forward_m + ahead, left, up]);
        let at = seen(BoundingBox::from_center(x, y, 60.0, 40.0));
        let (tangent, std) = ranging.direction(&at).unwrap();
        assert!((tangent - left / ahead).abs() < 1e-4, "{tangent} for {left} / {ahead}");
        assert!(std > 0.0);
        // along the optical axis
        let below = PITCHED.height_m - up;
        let depth = ahead * PITCHED.pitch_rad.cos() + below * PITCHED.pitch_rad.sin();
        let found = ranging.depth_of_forward(Some(&at)) * ahead;
        assert!((found - depth).abs() < 1e-4, "{found} {depth}");
    }
}

#[test]
fn the_foot_on_the_ground_is_a_range_of_the_surface_above_it() {
    let camera = camera();
    let options = RangingOptions::default();
    let ranging = Ranging::new(&camera, &PITCHED, options).unwrap();
    for ahead in [0.8, 1.5, 3.0] {
        // The wheels stand so far behind the bumper, which is what is ranged.
        let foot = PITCHED.forward_m + ahead + options.foot_behind_m;
        let [x, y] = pixel(&camera, &PITCHED, [foot, 0.0, 0.0]);
        let at = seen(BoundingBox::new(x - 40.0, y - 60.0, x + 40.0, y));
        let found = ranging.ground(&at, 0.0).unwrap();
        assert!((found.forward_m - ahead).abs() < 0.01, "{found:?} for {ahead}");
        // Turned aside by a right angle it is the near wheel that is seen.
        let turned = ranging.ground(&at, std::f64::consts::FRAC_PI_2).unwrap();
        let further = turned.forward_m - found.forward_m;
        let wanted = options.foot_behind_m + options.foot_aside_m;
        assert!((further - wanted).abs() < 0.01, "{further} {wanted}");
        assert!(turned.std_share > found.std_share);
    }
    let cut = seen(BoundingBox::new(300.0, 250.0, 380.0, 359.5));
    assert_eq!(ranging.ground(&cut, 0.0), None, "the foot is below the picture");
    let without = RangingOptions { ground_range: false, ..options };
    let ranging = Ranging::new(&camera, &PITCHED, without).unwrap();
    assert_eq!(ranging.ground(&seen(BoundingBox::new(300.0, 200.0, 380.0, 260.0)), 0.0), None);
}

#[test]
fn boxes_that_the_picture_cuts_are_completed() {
    let ranging =
        Ranging::new(&camera(), &CameraMount::default(), RangingOptions::default()).unwrap();
    let whole = seen(BoundingBox::new(100.0, 100.0, 200.0, 180.0));
    assert_eq!(ranging.completed(&whole, Some(2.0)), Some(whole));
    assert_eq!(ranging.completed(&whole, None), Some(whole));
    // 100 x 80 pixels, of which half is beyond an edge
    for (cut, full) in [
        (BoundingBox::new(0.0, 100.0, 50.0, 180.0), BoundingBox::new(-50.0, 100.0, 50.0, 180.0)),
        (
            BoundingBox::new(590.0, 100.0, 640.0, 180.0),
            BoundingBox::new(590.0, 100.0, 690.0, 180.0),
        ),
    ] {
        let cut = seen(cut);
        let found = ranging.completed(&cut, Some(1.25)).unwrap();
        assert_eq!(found.bbox, full);
        assert!(found.center_std[0] > 10.0 && found.center_std[1] == cut.center_std[1]);
        assert_eq!(ranging.completed(&cut, None), None, "of unknown shape");
        // It is not made narrower than it was seen.
        assert_eq!(ranging.completed(&cut, Some(0.1)).unwrap().bbox, cut.bbox);
    }
    let across = seen(BoundingBox::new(0.0, 100.0, 640.0, 300.0));
    assert_eq!(ranging.completed(&across, Some(4.0)), None);
}

#[test]
fn a_map_of_wrong_scale_is_moved_on_in_its_own_metres() {
    let pictures = Pictures::new((240, 180), 24);
    let mut ranging =
        Ranging::new(&pictures.camera, &CameraMount::default(), RangingOptions::default()).unwrap();
    let truth = |index: u64| {
        let (_, depth, bbox) = pictures.at(index);
        let (x, y) = bbox.center();
        f64::from(depth.data()[y as usize * depth.width() as usize + x as usize])
    };
    let target = |index: u64| TargetBox { stamp: at(index), ..seen(pictures.at(index).2) };
    let map = |index: u64| {
        let mut map = pictures.at(index).1.clone().with_stamp(at(index));
        map.data_mut().iter_mut().for_each(|depth| *depth *= 1.2);
        map
    };
    for index in 0..20 {
        ranging.frame(&pictures.at(index).0.clone().with_stamp(at(index))).unwrap();
        if index == 2 {
            ranging.keep();
        }
        if index < 8 {
            assert_eq!(ranging.fast(Some(&target(index))), None, "there is no map yet");
        }
        if index == 7 {
            let (found, kept) = ranging.depth(&map(2), Some(target(2)), None);
            kept.unwrap();
            let found = found.unwrap();
            assert_eq!(found.stamp, at(2));
            assert!((found.depth_m / truth(2) - 1.2).abs() < 0.02, "{found:?}");
            let (other, refused) = ranging.depth(&map(4), Some(target(4)), None);
            assert!(
                refused.is_err(),
                "of another frame than the one kept: no start of fast ranges"
            );
            assert!((other.unwrap().depth_m / truth(4) - 1.2).abs() < 0.02, "a range all the same");
        }
        if index > 8 {
            let (fast, from) = ranging.fast(Some(&target(index))).unwrap();
            assert_eq!((fast.stamp, from), (at(index), at(2)));
            let ratio = fast.depth_m / truth(index);
            assert!((ratio - 1.2).abs() < 0.03, "{ratio} at {index}");
        }
    }
}
