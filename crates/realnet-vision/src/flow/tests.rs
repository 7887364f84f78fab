use super::*;
use realnet_core::Stamp;

fn frame(width: u32, height: u32, pixel: impl Fn(f32, f32) -> f32) -> Frame {
    let data = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x as f32, y as f32)))
        .map(|(x, y)| pixel(x, y).round() as u8)
        .collect();
    Frame::grey8(Stamp::ZERO, width, height, data).unwrap()
}

/// Smooth texture without repetition inside a picture.
fn texture(x: f32, y: f32) -> f32 {
    let waves = (0.31 * x + 0.17 * y).sin() * (0.23 * y - 0.11 * x).cos()
        + (0.071 * x + 0.4).sin() * (0.053 * y).sin()
        + (9.0 * (0.013 * x).sin() + 7.0 * (0.017 * y).cos()).sin();
    127.0 + 40.0 * waves
}

fn track(
    options: FlowOptions,
    frames: [&Frame; 2],
    points: &[[f32; 2]],
    initial: Option<&[[f32; 2]]>,
) -> Vec<Track> {
    let mut tracker = FlowTracker::new(options).unwrap();
    frames.into_iter().for_each(|frame| tracker.push(frame));
    let mut tracks = Vec::new();
    tracker.track(points, initial, &mut tracks).unwrap();
    tracks
}

fn grid(width: u32, height: u32, margin: u32) -> Vec<[f32; 2]> {
    (margin..height - margin)
        .step_by(17)
        .flat_map(|y| (margin..width - margin).step_by(19).map(move |x| [x as f32, y as f32]))
        .collect()
}

#[test]
fn flat_pictures_are_flat() {
    let flat = frame(80, 60, |_, _| 90.0);
    let stripes = frame(80, 60, |x, _| 90.0 + 40.0 * (0.5 * x).sin());
    for picture in [flat, stripes] {
        for track in track(FlowOptions::default(), [&picture; 2], &grid(80, 60, 12), None) {
            assert_eq!(track.status, TrackStatus::Flat);
            assert!(track.error.is_nan() && track.round_trip.is_nan());
        }
    }
}

#[test]
fn tiny_pictures_do_no_harm() {
    for (width, height) in [(1, 1), (1, 40), (40, 1), (2, 2), (20, 20), (21, 22)] {
        let picture = frame(width, height, texture);
        let points = [[0.0, 0.0], [0.5, 0.5], [-3.0, 7.0], [1e9, -1e9], [f32::MAX, f32::MIN]];
        for track in track(FlowOptions::default(), [&picture; 2], &points, None) {
            assert!(track.status != TrackStatus::NotFinite);
            assert!(!track.is_tracked() || track.round_trip <= 0.5);
        }
    }
}

#[test]
fn numbers_that_are_none_are_named() {
    let picture = frame(80, 60, texture);
    let points = [[f32::NAN, 3.0], [30.0, f32::INFINITY], [30.0, 30.0], [40.0, 30.0]];
    let initial = [[20.0, 20.0], [20.0, 20.0], [f32::NAN, 30.0], [40.0, 30.0]];
    let tracks = track(FlowOptions::default(), [&picture; 2], &points, Some(&initial));
    for track in &tracks[..3] {
        assert_eq!(track.status, TrackStatus::NotFinite);
    }
    assert_eq!(tracks[3].status, TrackStatus::Tracked);
    assert_eq!((tracks[3].point, tracks[3].error), ([40.0, 30.0], 0.0));
}

#[test]
fn what_leaves_the_picture_is_outside() {
    let first = frame(120, 90, texture);
    let second = frame(120, 90, |x, y| texture(x + 30.0, y));
    let points = [[-12.0, 40.0], [140.0, 40.0], [60.0, 40.0], [15.0, 40.0]];
    let initial = points.map(|[x, y]| [x - 30.0, y]);
    let tracks = track(FlowOptions::default(), [&first, &second], &points, Some(&initial));
    assert_eq!(tracks[0].status, TrackStatus::Outside);
    assert_eq!(tracks[1].status, TrackStatus::Outside);
    assert_eq!(tracks[2].status, TrackStatus::Tracked);
    assert!(!tracks[3].is_tracked());
}

#[test]
fn other_pictures_fail_the_way_back() {
    let first = frame(160, 120, texture);
    let second = frame(160, 120, |x, y| texture(y * 1.7 + 400.0, x * 1.3 - 900.0));
    let points = grid(160, 120, 14);
    let one_way = FlowOptions { max_round_trip: None, ..Default::default() };
    let tracked = |options| {
        let tracks = track(options, [&first, &second], &points, None);
        tracks.iter().filter(|t| t.is_tracked()).count()
    };
    let (one_way, both_ways) = (tracked(one_way), tracked(FlowOptions::default()));
    assert!(one_way > points.len() / 2, "{one_way} of {}", points.len());
    assert!(both_ways < one_way / 4, "{both_ways} of {one_way}");
    let tracks = track(FlowOptions::default(), [&first, &second], &points, None);
    assert!(tracks.iter().any(|t| t.status == TrackStatus::RoundTrip));
}

#[test]
fn translations_are_found_to_a_fiftieth_of_a_pixel() {
    let first = frame(200, 150, texture);
    for (dx, dy) in [(0.25, -0.5), (1.7, 2.3), (-4.9, 3.1), (9.0, -6.5)] {
        let second = frame(200, 150, |x, y| texture(x - dx, y - dy));
        let points = grid(200, 150, 40);
        let tracks = track(FlowOptions::default(), [&first, &second], &points, None);
        for (point, track) in points.iter().zip(tracks) {
            assert!(track.is_tracked(), "{point:?}: {track:?}");
            let error = [track.point[0] - point[0] - dx, track.point[1] - point[1] - dy];
            assert!(error[0].hypot(error[1]) < 0.02, "{point:?}: {track:?}");
        }
    }
}

#[test]
fn affine_warps_are_found() {
    let (sin, cos) = 0.02_f32.sin_cos();
    // From the second picture to the first, about the centre.
    let back = |x: f32, y: f32| {
        let (x, y) = (x - 100.0, y - 75.0);
        (1.02 * (cos * x - sin * y) + 101.5, 1.02 * (sin * x + cos * y) + 73.8)
    };
    let first = frame(200, 150, texture);
    let second = frame(200, 150, |x, y| {
        let (x, y) = back(x, y);
        texture(x, y)
    });
    let points = grid(200, 150, 40);
    let tracks = track(FlowOptions::default(), [&first, &second], &points, None);
    // The window moves without being warped: what its texture weighs more on one
    // side than on the other becomes an error.
    let mut errors: Vec<f32> = (points.iter().zip(tracks))
        .map(|(point, track)| {
            assert!(track.is_tracked(), "{point:?}: {track:?}");
            let (x, y) = back(track.point[0], track.point[1]);
            (x - point[0]).hypot(y - point[1])
        })
        .collect();
    errors.sort_by(f32::total_cmp);
    assert!(errors[errors.len() / 2] < 0.05 && errors[errors.len() - 1] < 0.2, "{errors:?}");
}

/// A step too large for the pyramid is found from a predicted start.
#[test]
fn initial_flow_bridges_large_steps() {
    let first = frame(400, 120, texture);
    let second = frame(400, 120, |x, y| texture(x - 150.0, y));
    let points = [[80.0, 60.0], [120.0, 40.0], [160.0, 70.0]];
    let right = |track: &Track, point: &[f32; 2]| {
        track.is_tracked()
            && (track.point[0] - point[0] - 150.0).hypot(track.point[1] - point[1]) < 0.1
    };
    let options = FlowOptions::default();
    let blind = track(options, [&first, &second], &points, None);
    assert!(!blind.iter().zip(&points).any(|(t, p)| right(t, p)));
    let guess = points.map(|[x, y]| [x + 145.0, y + 3.0]);
    let led = track(options, [&first, &second], &points, Some(&guess));
    assert!(led.iter().zip(&points).all(|(t, p)| right(t, p)), "{led:?}");
}

#[test]
fn wrong_use_is_refused() {
    let refused = |options: FlowOptions| FlowTracker::new(options).unwrap_err().to_string();
    let good = FlowOptions::default();
    assert!(refused(FlowOptions { max_level: 16, ..good }).contains("max_level is 16"));
    assert!(refused(FlowOptions { max_iterations: 0, ..good }).contains("max_iterations is 0"));
    assert!(refused(FlowOptions { epsilon: f32::NAN, ..good }).contains("epsilon is NaN"));
    assert!(refused(FlowOptions { min_eigenvalue: -1.0, ..good }).contains("min_eigenvalue"));
    assert!(refused(FlowOptions { max_round_trip: Some(-0.1), ..good }).contains("round_trip"));
    assert_eq!(
        Window::new(2, 21).unwrap_err().to_string(),
        "a window of 2x21 pixels; sides are 3 to 255"
    );
    assert!(Window::new(21, 256).is_err());

    let mut tracker = FlowTracker::new(good).unwrap();
    let mut tracks = Vec::new();
    assert_eq!(tracker.track(&[], None, &mut tracks), Err(FlowError::NoPicture));
    tracker.push(&frame(30, 40, texture));
    assert_eq!(tracker.track(&[], None, &mut tracks), Err(FlowError::NoPicture));
    tracker.push(&frame(30, 41, texture));
    let error = tracker.track(&[], None, &mut tracks).unwrap_err();
    assert_eq!(error.to_string(), "from a picture of 30x40 to one of 30x41 pixels");
    tracker.push(&frame(30, 41, texture));
    let error = tracker.track(&[[1.0, 1.0]], Some(&[]), &mut tracks).unwrap_err();
    assert_eq!(error.to_string(), "1 points, but 0 initial positions");
    let mut other = Pyramid::new(3, Window::new(9, 9).unwrap());
    other.build(&frame(30, 41, texture));
    let mut method = LucasKanade::new(good).unwrap();
    let error = method.track(&other, tracker.present(), &[], None, &mut tracks).unwrap_err();
    assert_eq!(
        error.to_string(),
        "a pyramid for windows of up to 9x9 pixels where the window is 21x21"
    );
}

/// A pyramid for larger windows serves smaller ones, with the same answers.
#[test]
fn pyramids_serve_smaller_windows() {
    let frames = [frame(120, 100, texture), frame(120, 100, |x, y| texture(x - 2.3, y + 1.6))];
    let small = FlowOptions { window: Window::SMALL, max_level: 2, ..FlowOptions::default() };
    let mut method = LucasKanade::new(small).unwrap();
    let mut tracks = |window: Window| {
        let [mut from, mut to] = [Pyramid::new(2, window), Pyramid::new(2, window)];
        from.build(&frames[0]);
        to.build(&frames[1]);
        let mut tracks = Vec::new();
        // Up to the edge, where windows reach into the border.
        method.track(&from, &to, &grid(120, 100, 1), None, &mut tracks).unwrap();
        tracks
    };
    let (own, larger) = (tracks(Window::SMALL), tracks(Window::default()));
    assert!(own.iter().filter(|track| track.is_tracked()).count() > 20);
    for (own, larger) in own.iter().zip(&larger) {
        assert_eq!((own.point, own.status), (larger.point, larger.status));
    }
}

mod properties {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Moving the second picture moves the tracks with it. At level 0 and by
        /// whole pixels this holds bit by bit away from the border, apart from
        /// the rounding of the positions themselves.
        #[test]
        fn tracks_move_with_the_picture(dx in -6i32..7, dy in -6i32..7, fx in -0.9f32..0.9, fy in -0.9f32..0.9) {
            let first = frame(120, 100, texture);
            let still = frame(120, 100, |x, y| texture(x - fx, y - fy));
            let (mx, my) = (dx as f32, dy as f32);
            let moved = frame(120, 100, |x, y| texture((x - mx) - fx, (y - my) - fy));
            let points = grid(120, 100, 30);
            let start: Vec<_> = points.iter().map(|[x, y]| [x + mx, y + my]).collect();
            let options = FlowOptions { max_level: 0, ..Default::default() };
            let a = track(options, [&first, &still], &points, None);
            let b = track(options, [&first, &moved], &points, Some(&start));
            for (a, b) in a.iter().zip(&b) {
                prop_assert!(a.is_tracked() && b.is_tracked());
                let difference = [b.point[0] - a.point[0] - mx, b.point[1] - a.point[1] - my];
                prop_assert!(difference[0].hypot(difference[1]) < 1e-3, "{a:?}, {b:?}");
            }
        }

        /// All instruction sets give the same tracks, bit by bit, and none panics,
        /// whatever the points.
        #[test]
        fn all_paths_agree(
            points in prop::collection::vec((-60.0f32..160.0, -60.0f32..140.0), 1..30),
            (window_width, window_height) in (3u32..45, 3u32..45),
            (dx, dy) in (-9.0f32..9.0, -9.0f32..9.0),
        ) {
            let options = FlowOptions {
                window: Window::new(window_width, window_height).unwrap(),
                ..Default::default()
            };
            let points: Vec<_> = points.into_iter().map(|(x, y)| [x, y]).collect();
            let frames = [frame(100, 80, texture), frame(100, 80, |x, y| texture(x - dx, y - dy))];
            let mut method = LucasKanade::new(options).unwrap();
            let mut expected: Option<Vec<_>> = None;
            for &simd in Simd::found() {
                method.simd = simd;
                let [from, to] = frames.each_ref().map(|frame| {
                    let mut pyramid = method.pyramid();
                    pyramid.simd = simd;
                    pyramid.build(frame);
                    pyramid
                });
                let mut tracks = Vec::new();
                method.track(&from, &to, &points, None, &mut tracks).unwrap();
                let bits = |v: &Track| {
                    let [x, y] = v.point.map(f32::to_bits);
                    (x, y, v.status, v.error.to_bits(), v.round_trip.to_bits())
                };
                let found: Vec<_> = tracks.iter().map(bits).collect();
                match &expected {
                    None => expected = Some(found),
                    Some(expected) => prop_assert_eq!(expected, &found, "{:?}", simd),
                }
            }
        }
    }
}
