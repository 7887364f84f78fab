use super::*;
use proptest::prelude::*;
use realnet_core::{Frame, Stamp};
use realnet_vision::Window;

/// Width and height of the target at scale 1.
pub(super) const TARGET: [f32; 2] = [80.0, 50.0];
const SIZE: (u32, u32) = (320, 240);

/// A textured target before a textured background.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scene {
    pub(super) center: [f32; 2],
    pub(super) scale: f32,
    /// Shift of the background.
    pub(super) background: [f32; 2],
    /// Which texture the target has; `None` is grey.
    pub(super) target: Option<u32>,
    /// The part of the target, from its left, that something else covers.
    pub(super) covered: f32,
    /// Length of the horizontal motion blur, in pixels.
    pub(super) blur: usize,
}

impl Default for Scene {
    fn default() -> Self {
        let (center, background) = ([150.0, 120.0], [0.0; 2]);
        Self { center, scale: 1.0, background, target: Some(1), covered: 0.0, blur: 1 }
    }
}

/// Value noise of three sizes, 0 to 1.
fn texture(seed: u32, x: f32, y: f32) -> f32 {
    let lattice = |octave: u32, i: i32, j: i32| {
        let mut h = seed.wrapping_mul(0x9E37_79B9) ^ octave.wrapping_mul(0x85EB_CA6B);
        for v in [i, j] {
            h = (h ^ v as u32).wrapping_mul(0xC2B2_AE35);
            h ^= h >> 15;
        }
        (h & 0xFFFF) as f32 / 65535.0
    };
    let noise = |octave: u32, cell: f32| {
        let (x, y) = (x / cell, y / cell);
        let (i, j) = (x.floor(), y.floor());
        let (u, v, i, j) = (x - i, y - j, i as i32, j as i32);
        let at = |di, dj| lattice(octave, i + di, j + dj);
        (at(0, 0) * (1.0 - u) + at(1, 0) * u) * (1.0 - v)
            + (at(0, 1) * (1.0 - u) + at(1, 1) * u) * v
    };
    0.35 * noise(0, 5.0) + 0.35 * noise(1, 14.0) + 0.3 * noise(2, 40.0)
}

impl Scene {
    fn frame(&self) -> Frame {
        let bbox = self.bbox();
        let edge = bbox.x0 + self.covered * bbox.width();
        let pixel = |x: u32, y: u32| {
            let (x, y) = (x as f32, y as f32);
            let inside =
                x + 0.5 > bbox.x0 && x + 0.5 < bbox.x1 && y + 0.5 > bbox.y0 && y + 0.5 < bbox.y1;
            let (u, v) = ((x - self.center[0]) / self.scale, (y - self.center[1]) / self.scale);
            let value = match self.target {
                _ if inside && x < edge => texture(77, x, y),
                Some(seed) if inside => texture(seed, u, v),
                None if inside => 0.5,
                _ => texture(1000, x - self.background[0], y - self.background[1]),
            };
            30.0 + 190.0 * value
        };
        let mut data = Vec::new();
        for y in 0..SIZE.1 {
            let row: Vec<f32> = (0..SIZE.0).map(|x| pixel(x, y)).collect();
            for x in 0..row.len() {
                let part = &row
                    [x.saturating_sub(self.blur / 2)..(x + self.blur.div_ceil(2)).min(row.len())];
                data.push((part.iter().sum::<f32>() / part.len() as f32) as u8);
            }
        }
        Frame::grey8(Stamp::ZERO, SIZE.0, SIZE.1, data).unwrap()
    }

    fn bbox(&self) -> BoundingBox {
        let [x, y] = self.center;
        BoundingBox::from_center(x + 0.5, y + 0.5, TARGET[0] * self.scale, TARGET[1] * self.scale)
    }

    pub(super) fn draw(&self) -> (Pyramid, BoundingBox) {
        (pyramid(&self.frame()), self.bbox())
    }

    fn at(x: f32, y: f32, scale: f32) -> Self {
        Self { center: [x, y], scale, ..Self::default() }
    }
}

fn pyramid(frame: &Frame) -> Pyramid {
    let mut pyramid = Pyramid::new(3, Window::default());
    pyramid.build(frame);
    pyramid
}

fn carrier(options: CarryOptions) -> BoxCarrier {
    BoxCarrier::new(options).unwrap()
}

/// Carries the default scene's box to another scene; also that scene's box.
fn carry(to: Scene) -> (Result<Carried, CarryError>, BoundingBox) {
    let (from, bbox) = Scene::default().draw();
    let (to, truth) = to.draw();
    (carrier(CarryOptions::default()).carry(&from, &to, &bbox, BoxMotion::NONE), truth)
}

#[test]
fn small_steps_are_exact_and_need_no_search() {
    let scene = Scene { background: [-3.0, 1.0], ..Scene::at(157.3, 116.4, 1.06) };
    let (carried, truth) = carry(scene);
    let carried = carried.unwrap();
    assert!(carried.bbox.iou(&truth) > 0.97, "{carried:?}");
    assert!(!carried.searched && carried.inliers * 2 > carried.corners, "{carried:?}");
    assert!((carried.motion.scale - 1.06).abs() < 0.01, "{carried:?}");
    let ((x, y), (tx, ty)) = (carried.bbox.center(), truth.center());
    assert!((x - tx).abs() < 3.0 * carried.center_sd[0], "{carried:?}");
    assert!((y - ty).abs() < 3.0 * carried.center_sd[1], "{carried:?}");
    assert!(carried.center_sd[0] < 3.0 && carried.size_sd < 0.04, "{carried:?}");
}

#[test]
fn steps_larger_than_the_box_are_found_by_search_or_prediction() {
    let (from, bbox) = Scene::default().draw();
    let (to, truth) = Scene::at(245.0, 75.0, 1.25).draw();
    let mut with = carrier(CarryOptions::default());
    let carried = with.carry(&from, &to, &bbox, BoxMotion::NONE).unwrap();
    assert!(carried.searched && carried.bbox.iou(&truth) > 0.95, "{carried:?}");

    let mut without = carrier(CarryOptions { search: None, ..CarryOptions::default() });
    let refused = without.carry(&from, &to, &bbox, BoxMotion::NONE).unwrap_err();
    assert!(without.points().is_empty(), "{refused}");
    let prediction = BoxMotion { shift: [88.0, -40.0], scale: 1.2 };
    let carried = without.carry(&from, &to, &bbox, prediction).unwrap();
    assert!(!carried.searched && carried.bbox.iou(&truth) > 0.95, "{carried:?}");
}

#[test]
fn a_target_that_is_gone_is_refused() {
    for scene in [
        Scene { target: Some(2), ..Scene::at(160.0, 118.0, 1.0) },
        Scene { target: None, ..Scene::default() },
        Scene { covered: 1.0, ..Scene::default() },
        Scene::at(-60.0, 120.0, 1.0),
    ] {
        let (carried, _) = carry(scene);
        let error = carried.unwrap_err();
        let reasons = matches!(
            error,
            CarryError::Lost { .. } | CarryError::NoConsensus { .. } | CarryError::Unlike { .. }
        );
        assert!(reasons, "{scene:?}: {error:?}");
    }
}

#[test]
fn half_covered_is_enough_and_the_cover_is_told_apart() {
    let (from, bbox) = Scene::default().draw();
    let (to, truth) = Scene { covered: 0.3, ..Scene::at(162.0, 125.0, 1.0) }.draw();
    let mut carrier = carrier(CarryOptions::default());
    let carried = carrier.carry(&from, &to, &bbox, BoxMotion::NONE).unwrap();
    assert!(carried.bbox.iou(&truth) > 0.95, "{carried:?}");
    let edge = truth.x0 + 0.3 * truth.width();
    let inliers: Vec<_> = carrier.points().iter().filter(|point| point.inlier).collect();
    assert_eq!(inliers.len(), carried.inliers);
    assert!(inliers.iter().all(|point| point.to[0] > edge - 4.0), "{inliers:?}");
}

#[test]
fn background_inside_the_box_is_not_the_target() {
    // The box is a third wider and higher than the target; only the target moves.
    let (from, _) = Scene::default().draw();
    let loose = |scene: Scene| {
        let (x, y) = scene.bbox().center();
        BoundingBox::from_center(x, y, TARGET[0] * 1.33, TARGET[1] * 1.33)
    };
    let moved = Scene::at(160.0, 113.0, 1.0);
    let (to, _) = moved.draw();
    let mut carrier = carrier(CarryOptions::default());
    let bbox = loose(Scene::default());
    let carried = carrier.carry(&from, &to, &bbox, BoxMotion::NONE).unwrap();
    assert!(carried.bbox.iou(&loose(moved)) > 0.9, "{carried:?}");
    // Some of the background's texture is found again by chance, but little of it.
    let target = Scene::default().bbox();
    let outside = |p: &&CarriedPoint| {
        let [x, y] = p.from;
        let inside = |v: f32, low: f32, high: f32| v > low - 3.0 && v < high + 3.0;
        !inside(x, target.x0, target.x1) || !inside(y, target.y0, target.y1)
    };
    let strays = carrier.points().iter().filter(|point| point.inlier).filter(outside).count();
    assert!(strays * 10 <= carried.inliers, "{strays} {carried:?}");
}

#[test]
fn blur_is_survived() {
    let (carried, truth) = carry(Scene { blur: 9, ..Scene::at(168.0, 121.0, 1.0) });
    assert!(carried.as_ref().unwrap().bbox.iou(&truth) > 0.85, "{carried:?}");
}

#[test]
fn a_box_cut_off_by_the_picture_is_carried_whole() {
    let (from, bbox) = Scene::at(20.0, 120.0, 1.0).draw();
    let (to, truth) = Scene::at(12.0, 124.0, 1.0).draw();
    let mut carrier = carrier(CarryOptions::default());
    let carried = carrier.carry(&from, &to, &bbox, BoxMotion::NONE).unwrap();
    assert!(carried.bbox.x0 < 0.0 && carried.bbox.iou(&truth) > 0.9, "{carried:?}");
    assert!(carrier.points().iter().all(|p| p.from[0] >= 0.0 && p.to[0] >= 0.0));
}

#[test]
fn what_is_no_target_is_refused_with_the_reason() {
    let (flat, bbox) = Scene { target: None, ..Scene::default() }.draw();
    let (textured, _) = Scene::default().draw();
    let mut carrier = carrier(CarryOptions::default());
    let inner = BoundingBox::from_center(150.0, 120.0, 60.0, 30.0);
    let error = carrier.carry(&flat, &textured, &inner, BoxMotion::NONE).unwrap_err();
    assert!(matches!(error, CarryError::NoTexture { corners: 0, needed: 6 }), "{error:?}");

    let mut error = |bbox: [f32; 4], prediction| {
        carrier.carry(&textured, &flat, &bbox.into(), prediction).unwrap_err()
    };
    for bbox in [
        [-50.0, 10.0, -5.0, 40.0],
        [310.0, 10.0, 400.0, 100.0],
        [100.0, 235.0, 180.0, 300.0],
        [100.0, 100.0, 105.0, 150.0],
        [-1e5, -1e5, 1e5, 1e5],
    ] {
        let error = error(bbox, BoxMotion::NONE);
        assert!(matches!(error, CarryError::OutOfSight { .. }), "{error:?}");
    }
    let proper = <[f32; 4]>::from(bbox);
    let nan = BoxMotion { shift: [f32::NAN, 0.0], scale: 1.0 };
    for (bbox, prediction) in [
        ([f32::NAN, 0.0, 10.0, 10.0], BoxMotion::NONE),
        ([0.0, 0.0, f32::INFINITY, 10.0], BoxMotion::NONE),
        ([50.0, 0.0, 10.0, 10.0], BoxMotion::NONE),
        ([0.0, 0.0, 1e30, 1e30], BoxMotion::NONE),
        (proper, nan),
        (proper, BoxMotion { scale: 0.0, ..BoxMotion::NONE }),
        (proper, BoxMotion { scale: -1.0, ..BoxMotion::NONE }),
        (proper, BoxMotion { scale: f32::MAX, ..BoxMotion::NONE }),
    ] {
        let error = error(bbox, prediction);
        assert!(matches!(error, CarryError::Improper { .. }), "{error:?}");
    }
    let far = BoxMotion { shift: [1e9, -1e9], scale: 1.0 };
    assert!(matches!(error(proper, far), CarryError::Improper { .. } | CarryError::Lost { .. }));
}

#[test]
fn pictures_that_do_not_suit_are_refused() {
    let (from, bbox) = Scene::default().draw();
    let mut carrier = carrier(CarryOptions::default());
    let empty = Pyramid::new(3, Window::default());
    let error = carrier.carry(&from, &empty, &bbox, BoxMotion::NONE).unwrap_err();
    assert_eq!(error, CarryError::Picture(FlowError::NoPicture));
    let small = pyramid(&Frame::grey8(Stamp::ZERO, 100, 90, vec![0; 9000]).unwrap());
    let error = carrier.carry(&from, &small, &bbox, BoxMotion::NONE).unwrap_err();
    assert!(error.to_string().contains("320x240 to one of 100x90"), "{error}");
}

#[test]
fn options_out_of_range_are_refused() {
    let base = CarryOptions::default();
    let search = SearchOptions::default();
    let with = |search| CarryOptions { search: Some(search), ..base };
    for (options, name) in [
        (CarryOptions { max_points: 7, ..base }, "max_points"),
        (CarryOptions { min_inliers: 2, ..base }, "min_inliers"),
        (CarryOptions { min_inliers: 61, ..base }, "min_inliers"),
        (CarryOptions { min_share: 1.1, ..base }, "min_share"),
        (CarryOptions { tolerance: 0.0, ..base }, "tolerance"),
        (CarryOptions { min_similarity: f32::NAN, ..base }, "min_similarity"),
        (CarryOptions { sure_similarity: 2.0, ..base }, "sure_similarity"),
        (with(SearchOptions { radius: 5.0, ..search }), "search.radius"),
        (with(SearchOptions { scales: (0.1, 2.0), ..search }), "search.scales"),
        (with(SearchOptions { scales: (0.5, 0.9), ..search }), "search.scales"),
        (with(SearchOptions { steps: 0, ..search }), "search.steps"),
    ] {
        match BoxCarrier::new(options) {
            Err(CarryError::Option { option, .. }) => assert_eq!(option, name),
            other => panic!("{name}: {other:?}"),
        }
    }
    assert_eq!(carrier(base).options(), base);
}

#[test]
fn the_answer_does_not_depend_on_what_was_carried_before() {
    let (from, bbox) = Scene::default().draw();
    let (to, _) = Scene::at(210.0, 100.0, 1.1).draw();
    let mut fresh = carrier(CarryOptions::default());
    let first = fresh.carry(&from, &to, &bbox, BoxMotion::NONE);
    let points = fresh.points().to_vec();
    let other = BoundingBox::new(5.0, 60.0, 95.0, 200.0);
    let _ = fresh.carry(&to, &from, &other, BoxMotion { shift: [9.0, 9.0], scale: 1.3 });
    assert_eq!(fresh.carry(&from, &to, &bbox, BoxMotion::NONE), first);
    assert_eq!(fresh.points(), points);
    assert!(first.is_ok());
}

#[test]
fn the_ladder_is_even_and_spans_the_scales() {
    let search = SearchOptions { scales: (0.25, 4.0), steps: 5, radius: 1.0 };
    let ladder: Vec<_> = search.ladder().collect();
    assert_eq!(ladder.len(), 5);
    for (found, expected) in ladder.iter().zip([0.25, 0.5, 1.0, 2.0, 4.0]) {
        assert!((found - expected).abs() < 1e-3, "{ladder:?}");
    }
    let one: Vec<_> = SearchOptions { steps: 1, ..search }.ladder().collect();
    assert_eq!(one, [1.0]);
}

#[test]
fn nearly_all_steps_within_reach_are_carried() {
    let mut carrier = carrier(CarryOptions::default());
    let mut carried = 0;
    for i in 0..60_u32 {
        let at =
            |step: u32, low: f32, high: f32| low + (high - low) * ((i * step) % 61) as f32 / 60.0;
        let first = Scene { target: Some(i + 1), ..Scene::default() };
        let (from, bbox) = first.draw();
        let center = [150.0 + at(17, -100.0, 120.0), 120.0 + at(23, -80.0, 80.0)];
        let background = [at(7, -20.0, 20.0), at(11, -20.0, 20.0)];
        let (to, truth) = Scene { center, scale: at(29, 0.75, 1.35), background, ..first }.draw();
        let outcome = carrier.carry(&from, &to, &bbox, BoxMotion::NONE);
        carried += usize::from(outcome.is_ok_and(|c| c.bbox.iou(&truth) > 0.85));
    }
    assert!(carried >= 57, "{carried} of 60");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Whatever the step, the size and the background: carried well or refused.
    #[test]
    fn an_accepted_box_is_right(
        (dx, dy) in (-150.0f32..170.0, -120.0f32..120.0), scale in 0.6f32..1.6,
        background in (-40.0f32..40.0, -40.0f32..40.0), covered in 0.0f32..1.0,
        blur in 1usize..20, seed in 1u32..900,
    ) {
        let first = Scene { target: Some(seed), ..Scene::default() };
        let background = [background.0, background.1];
        let center = [150.0 + dx, 120.0 + dy];
        let (from, bbox) = first.draw();
        let (to, truth) = Scene { center, scale, background, covered, blur, ..first }.draw();
        let carried = carrier(CarryOptions::default()).carry(&from, &to, &bbox, BoxMotion::NONE);
        if let Ok(carried) = carried {
            prop_assert!(carried.bbox.iou(&truth) > 0.6, "{carried:?}");
        }
    }

    /// No numbers make it panic, and what is refused leaves no points behind.
    #[test]
    fn any_numbers_are_answered(
        edges in proptest::array::uniform4(prop_oneof![any::<f32>(), -400.0f32..800.0]),
        shift in proptest::array::uniform2(prop_oneof![any::<f32>(), -400.0f32..400.0]),
        scale in prop_oneof![any::<f32>(), 0.01f32..100.0], radius in 0.1f32..4.0,
        scales in (0.25f32..1.0, 1.0f32..4.0),
    ) {
        let (from, _) = Scene::default().draw();
        let search = SearchOptions { radius, scales, steps: 2 };
        let mut carrier = carrier(CarryOptions { search: Some(search), ..CarryOptions::default() });
        let [x0, y0, x1, y1] = edges;
        let sorted = BoundingBox::new(x0.min(x1), y0.min(y1), x0.max(x1), y0.max(y1));
        for bbox in [edges.into(), sorted] {
            for prediction in [BoxMotion { shift, scale }, BoxMotion { shift, scale: 1.0 }, BoxMotion::NONE] {
                let carried = carrier.carry(&from, &from, &bbox, prediction);
                prop_assert_eq!(carried.is_err(), carrier.points().is_empty());
                if let Ok(carried) = carried {
                    prop_assert!(carried.bbox.iou(&bbox) > 0.5, "{carried:?}");
                    prop_assert!(carried.center_sd.iter().all(|sd| *sd > 0.0), "{carried:?}");
                }
            }
        }
    }

    /// A target that was replaced by another is never carried.
    #[test]
    fn strangers_are_refused(
        (dx, dy) in (-60.0f32..60.0, -60.0f32..60.0), scale in 0.8f32..1.25, seed in 1u32..900,
    ) {
        let (from, bbox) = Scene { target: Some(seed), ..Scene::default() }.draw();
        let center = [150.0 + dx, 120.0 + dy];
        // The background moves far, or the corners of the box's edges would hold.
        let stranger = Scene { center, scale, background: [331.0, 57.0], target: Some(seed + 3000), ..Scene::default() };
        let (to, _) = stranger.draw();
        let carried = carrier(CarryOptions::default()).carry(&from, &to, &bbox, BoxMotion::NONE);
        prop_assert!(carried.is_err(), "{carried:?}");
    }
}
