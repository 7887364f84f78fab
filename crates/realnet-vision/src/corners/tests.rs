use super::*;
use crate::Window;
use proptest::prelude::*;
use realnet_core::{Frame, Stamp};

fn noise(width: u32, height: u32, seed: u32) -> Frame {
    let mut state = seed | 1;
    let data = (0..width * height)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (state >> 8) as u8
        })
        .collect();
    Frame::grey8(Stamp::ZERO, width, height, data).unwrap()
}

fn pyramid(frame: &Frame) -> Pyramid {
    let mut pyramid = Pyramid::new(0, Window::default());
    pyramid.build(frame);
    pyramid
}

fn detect(options: CornerOptions, frame: &Frame, mask: Option<&CornerMask>) -> Vec<Corner> {
    let mut corners = Vec::new();
    CornerDetector::new(options).unwrap().detect(&pyramid(frame), mask, &mut corners).unwrap();
    corners
}

const ALL: CornerOptions =
    CornerOptions { max_corners: 0, quality_level: 0.0, min_distance: 0.0, cells: (1, 1) };

/// The response of one pixel in double precision, straight from the definition.
fn response_by_definition(frame: &Frame, x: isize, y: isize) -> f64 {
    use crate::pyramid::reflect;
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let at = |x: isize, y: isize| {
        f64::from(frame.data()[reflect(y, height) * width + reflect(x, width)]) / 255.0
    };
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for j in [y - 1, y, y + 1] {
        for i in [x - 1, x, x + 1] {
            let (i, j) = (reflect(i, width) as isize, reflect(j, height) as isize);
            let side = |d: isize| at(i + d, j - 1) + 2.0 * at(i + d, j) + at(i + d, j + 1);
            let edge = |d: isize| at(i - 1, j + d) + 2.0 * at(i, j + d) + at(i + 1, j + d);
            let (dx, dy) = ((side(1) - side(-1)) / 12.0, (edge(1) - edge(-1)) / 12.0);
            xx += dx * dx;
            xy += dx * dy;
            yy += dy * dy;
        }
    }
    (xx + yy) / 2.0 - (((xx - yy) / 2.0).powi(2) + xy * xy).sqrt()
}

#[test]
fn responses_follow_the_definition() {
    let frame = noise(40, 30, 5);
    let corners = detect(ALL, &frame, None);
    assert!(corners.len() > 40);
    for corner in corners {
        let [x, y] = corner.point.map(|v| v as isize);
        let expected = response_by_definition(&frame, x, y);
        assert!((f64::from(corner.response) - expected).abs() < 1e-6, "{corner:?}, {expected}");
        for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, 1), (-1, 1), (1, -1)] {
            assert!(response_by_definition(&frame, x + dx, y + dy) < expected + 1e-6);
        }
    }
}

#[test]
fn the_corners_of_a_square_are_found() {
    let mut data = vec![20; 64 * 48];
    for y in 16..32 {
        data[y * 64 + 20..y * 64 + 40].fill(220);
    }
    let frame = Frame::grey8(Stamp::ZERO, 64, 48, data).unwrap();
    let corners = detect(CornerOptions { max_corners: 4, ..Default::default() }, &frame, None);
    assert_eq!(corners.len(), 4);
    for expected in [[19.5, 15.5], [39.5, 15.5], [19.5, 31.5], [39.5, 31.5]] {
        let near = |c: &&Corner| {
            (c.point[0] - expected[0]).abs() <= 1.5 && (c.point[1] - expected[1]).abs() <= 1.5
        };
        assert_eq!(corners.iter().filter(near).count(), 1, "{expected:?} in {corners:?}");
    }
}

#[test]
fn degenerate_pictures_have_no_corners() {
    for (width, height) in [(1, 1), (1, 9), (9, 1), (2, 2), (3, 2), (40, 30)] {
        let flat = vec![99; width as usize * height as usize];
        let frame = Frame::grey8(Stamp::ZERO, width, height, flat).unwrap();
        assert_eq!(detect(ALL, &frame, None), []);
    }
    assert_eq!(detect(ALL, &noise(2, 50, 3), None), []);
    assert!(detect(ALL, &noise(3, 50, 3), None).iter().all(|c| c.point[0] == 1.0));
}

#[test]
fn cells_share_the_corners() {
    // Strong texture on the left, weak on the right.
    let mut frame = noise(160, 80, 11);
    for row in frame.data_mut().chunks_exact_mut(160) {
        row[80..].iter_mut().for_each(|v| *v = 120 + *v / 16);
    }
    let options =
        |cells| CornerOptions { max_corners: 40, quality_level: 0.0001, min_distance: 4.0, cells };
    let right = |c: &Corner| c.point[0] >= 84.0;
    let plain = detect(options((1, 1)), &frame, None);
    let spread = detect(options((2, 1)), &frame, None);
    assert_eq!(plain.iter().filter(|c| right(c)).count(), 0);
    assert_eq!(spread.len(), 40);
    assert!(spread.iter().filter(|c| right(c)).count() >= 18, "{spread:?}");
    assert!(spread.is_sorted_by(|a, b| a.response >= b.response));
    // What a poor cell cannot give goes to the others.
    let mut mask = CornerMask::new(160, 80, true);
    mask.set(Region { x: 80, y: 0, width: 80, height: u32::MAX }, false);
    let filled = detect(options((2, 1)), &frame, Some(&mask));
    assert_eq!(filled, plain);
}

#[test]
fn wrong_use_is_refused() {
    let refused = |options: CornerOptions| CornerDetector::new(options).unwrap_err().to_string();
    assert_eq!(
        refused(CornerOptions { quality_level: 1.5, ..ALL }),
        "quality_level is 1.5, allowed is 0 to 1"
    );
    assert!(refused(CornerOptions { quality_level: f32::NAN, ..ALL }).contains("NaN"));
    assert!(refused(CornerOptions { min_distance: -1.0, ..ALL }).contains("min_distance"));
    assert!(refused(CornerOptions { cells: (0, 1), ..ALL }).contains("0x1"));
    let mut detector = CornerDetector::new(ALL).unwrap();
    let empty = Pyramid::new(0, Window::default());
    assert_eq!(detector.detect(&empty, None, &mut vec![]), Err(FlowError::NoPicture));
    let mask = CornerMask::new(4, 5, true);
    let error = detector.detect(&pyramid(&noise(5, 4, 1)), Some(&mask), &mut vec![]);
    assert_eq!(error, Err(FlowError::MaskSize { mask: (4, 5), width: 5, height: 4 }));
    assert!(matches!(
        CornerMask::from_bytes(4, 5, vec![1; 19]),
        Err(FlowError::MaskLength { expected: 20, found: 19, .. })
    ));
}

proptest! {
    #[test]
    fn all_paths_agree(
        (width, height) in (1u32..100, 1u32..50), seed in any::<u32>(), distance in 0.0f32..12.0,
        hidden in 0u32..40,
    ) {
        let frame = noise(width, height, seed);
        let pyramid = pyramid(&frame);
        let mut mask = CornerMask::new(width, height, true);
        mask.set(Region { x: hidden, y: hidden / 2, width: 20, height: 20 }, false);
        let mut detector =
            CornerDetector::new(CornerOptions { min_distance: distance, ..ALL }).unwrap();
        let mut expected = None;
        for &simd in Simd::found() {
            detector.simd = simd;
            let mut corners = Vec::new();
            detector.detect(&pyramid, Some(&mask), &mut corners).unwrap();
            for (i, a) in corners.iter().enumerate() {
                let [x, y] = a.point.map(|v| v as usize);
                prop_assert!(mask.row(y)[x] != 0);
                for b in &corners[..i] {
                    let (dx, dy) = (a.point[0] - b.point[0], a.point[1] - b.point[1]);
                    prop_assert!(distance < 1.0 || dx.hypot(dy) >= distance);
                    prop_assert!(b.response >= a.response);
                }
            }
            match &expected {
                None => expected = Some(corners),
                Some(expected) => prop_assert_eq!(expected, &corners, "{:?}", simd),
            }
        }
    }

    /// A detector that has seen pictures of other sizes finds the same.
    #[test]
    fn memory_of_other_sizes_does_no_harm(
        (w1, h1) in (1u32..80, 1u32..40), (w2, h2) in (1u32..80, 1u32..40), seed in any::<u32>(),
    ) {
        let mut detector = CornerDetector::new(ALL).unwrap();
        let mut corners = Vec::new();
        detector.detect(&pyramid(&noise(w1, h1, seed)), None, &mut corners).unwrap();
        let second = noise(w2, h2, !seed);
        detector.detect(&pyramid(&second), None, &mut corners).unwrap();
        prop_assert_eq!(corners, detect(ALL, &second, None));
    }
}
