use crate::random::{Rng, assert_consistent, camera};
use proptest::prelude::*;
use realnet_core::nalgebra::Point3;
use realnet_core::{BoundingBox, CameraModel};
use realnet_range::cues::{Attitude, Dimension, SizeRange, SizeRangeError, Uncertain};

/// The box of an upright rectangle whose middle lies at `center` in the optical
/// frame: its edges are those of its vertical and its horizontal middle line.
fn seen(
    camera: &CameraModel,
    pitch: f64,
    center: Point3<f64>,
    [width, height]: [f64; 2],
) -> Option<BoundingBox> {
    let up = -0.5 * height * Attitude::new(pitch, 0.0).down();
    let right = realnet_core::nalgebra::Vector3::new(0.5 * width, 0.0, 0.0);
    let top = camera.project(&(center + up)).ok()?;
    let bottom = camera.project(&(center - up)).ok()?;
    let left = camera.project(&(center - right)).ok()?;
    let right = camera.project(&(center + right)).ok()?;
    let edges = [left[0], top[1], right[0], bottom[1]].map(|edge| (edge + 0.5) as f32);
    let bbox = BoundingBox::from(edges);
    let inside = bbox.x0 > 4.0 && bbox.y0 > 4.0 && bbox.x1 < 636.0 && bbox.y1 < 476.0;
    inside.then_some(bbox)
}

proptest! {
    #[test]
    fn exact_boxes_give_the_exact_range(
        height in 0.1..2.0f64, width in 0.1..2.0f64, far in 2.0..15.0f64,
        slope in prop::array::uniform2(-0.3..0.3f64), pitch in -0.3..0.3f64
    ) {
        let camera = camera(false);
        let z = far * height.max(width);
        let center = Point3::new(slope[0] * z, slope[1] * z, z);
        let bbox = seen(&camera, pitch, center, [width, height]);
        prop_assume!(bbox.is_some());
        let bbox = bbox.unwrap();
        let tall = SizeRange { edge_std_px: 0.0, pitch_rad: pitch, ..SizeRange::from_height(Uncertain::exact(height)) };
        let range = tall.measure(&camera, bbox).unwrap();
        let tolerance = |pixels: f32| 1e-4 * z / f64::from(pixels) + 1e-9;
        prop_assert!((range.depth_m - z).abs() < tolerance(bbox.height()), "{} {z}", range.depth_m);
        prop_assert_eq!((range.std_m, range.dimension), (0.0, Dimension::Height));
        let wide = SizeRange { edge_std_px: 0.0, ..SizeRange::from_width(Uncertain::exact(width)) };
        let range = wide.measure(&camera, bbox).unwrap();
        prop_assert!((range.depth_m - z).abs() < tolerance(bbox.width()), "{} {z}", range.depth_m);
    }

    #[test]
    fn the_lens_is_taken_out(x in -0.55..0.55f64, z in 1.0..5.0f64) {
        // In the row and column of the axis, where a straight line stays straight
        // but for the small tangential part.
        let camera = camera(true);
        let width = 0.2 * z;
        let bbox = seen(&camera, 0.0, Point3::new(x * z, 0.0, z), [width, 0.2 * z]);
        prop_assume!(bbox.is_some());
        let wide = SizeRange::from_width(Uncertain::exact(width));
        let range = wide.measure(&camera, bbox.unwrap()).unwrap();
        prop_assert!((range.depth_m / z - 1.0).abs() < 2e-3, "{} {z}", range.depth_m);
    }
}

#[test]
fn deviations_are_consistent() {
    let mut rng = Rng(41);
    let mut squares = Vec::new();
    while squares.len() < 2000 {
        let camera = camera(false);
        let (height, z) = (rng.uniform(0.2, 1.0), rng.uniform(1.0, 8.0));
        let pitch = rng.uniform(-0.2, 0.3);
        let center = Point3::new(rng.uniform(-0.3, 0.3) * z, rng.uniform(-0.2, 0.3) * z, z);
        let Some(bbox) = seen(&camera, pitch, center, [height; 2]) else { continue };
        let (size_std, edge_std) = (0.04 * height, 1.0);
        let mut edge = |at: f32| at + (edge_std * rng.normal()) as f32;
        let bbox = BoundingBox::new(edge(bbox.x0), edge(bbox.y0), edge(bbox.x1), edge(bbox.y1));
        let size = Uncertain::new(height + size_std * rng.normal(), size_std);
        let by_width = squares.len() % 2 == 0;
        let cue = if by_width { SizeRange::from_width(size) } else { SizeRange::from_height(size) };
        let cue = SizeRange { edge_std_px: edge_std, pitch_rad: pitch, ..cue };
        // The range by a box of few pixels is skewed.
        let Some(range) = cue.measure(&camera, bbox).ok().filter(|r| r.std_m < 0.1 * r.depth_m)
        else {
            continue;
        };
        squares.push(((range.depth_m - z) / range.std_m).powi(2));
    }
    assert_consistent(&squares);
}

#[test]
fn boxes_at_the_border_are_refused_only_where_it_matters() {
    let camera = camera(false);
    let tall = SizeRange::from_height(Uncertain::new(0.5, 0.02));
    let wide = SizeRange::from_width(Uncertain::new(0.5, 0.02));
    let left = BoundingBox::new(0.0, 100.0, 80.0, 180.0);
    assert!(tall.measure(&camera, left).is_ok());
    match wide.measure(&camera, left).unwrap_err() {
        SizeRangeError::Cut { dimension: Dimension::Width, size: 640, .. } => {}
        other => panic!("{other}"),
    }
    let low = BoundingBox::new(100.0, 400.0, 180.0, 479.0);
    assert!(wide.measure(&camera, low).is_ok());
    let error = tall.measure(&camera, low).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the box spans 400 to 479 of 480 pixels: part of the target's height may be cut off"
    );
    let both = SizeRange { width_m: wide.width_m, ..tall };
    assert_eq!(both.measure(&camera, low).unwrap().dimension, Dimension::Width);
    assert_eq!(both.measure(&camera, left).unwrap().dimension, Dimension::Height);
    let corner = BoundingBox::new(0.0, 400.0, 80.0, 480.0);
    assert!(matches!(both.measure(&camera, corner), Err(SizeRangeError::Cut { .. })));
}

#[test]
fn of_two_dimensions_the_surer_one_is_taken() {
    let camera = camera(false);
    let bbox = BoundingBox::new(200.0, 200.0, 300.0, 240.0);
    let mut cue = SizeRange::from_height(Uncertain::new(0.2, 0.002));
    cue.width_m = Some(Uncertain::new(0.5, 0.005));
    assert_eq!(cue.measure(&camera, bbox).unwrap().dimension, Dimension::Width);
    cue.width_m = Some(Uncertain::new(0.5, 0.1));
    assert_eq!(cue.measure(&camera, bbox).unwrap().dimension, Dimension::Height);
}

#[test]
fn without_size_or_box_there_is_no_range() {
    let camera = camera(false);
    let cue = SizeRange::from_height(Uncertain::new(0.2, 0.01));
    let nothing = SizeRange { height_m: None, ..cue };
    let bbox = BoundingBox::new(200.0, 200.0, 300.0, 240.0);
    assert_eq!(nothing.measure(&camera, bbox), Err(SizeRangeError::UnknownSize));
    let swapped = BoundingBox::new(200.0, 240.0, 300.0, 200.0);
    assert!(matches!(cue.measure(&camera, swapped), Err(SizeRangeError::ImproperBox { .. })));
    let tiny = BoundingBox::new(200.0, 200.0, 202.0, 202.0);
    assert!(matches!(cue.measure(&camera, tiny), Err(SizeRangeError::TooUncertain { .. })));
    let negative = SizeRange::from_height(Uncertain::new(-0.2, 0.01));
    assert!(matches!(negative.measure(&camera, bbox), Err(SizeRangeError::Option(_))));
}
