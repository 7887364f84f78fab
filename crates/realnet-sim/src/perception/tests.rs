use super::*;
use realnet_core::{BoundingBox, DepthMap, Stamp};

fn flat(stamp: Stamp, depth: f32) -> DepthMap {
    DepthMap::new(stamp, 64, 36, vec![depth; 64 * 36]).unwrap()
}

/// A depth network without any error.
fn exact() -> DepthNetworkModel {
    DepthNetworkModel {
        rows: 0,
        scale_noise: 0.0,
        patch_noise: 0.0,
        pixel_noise: 0.0,
        smear: 0,
        ..DepthNetworkModel::default()
    }
}

fn frame(index: u64) -> Stamp {
    Stamp::of_frame(index, 30.0)
}

/// Mean and standard deviation.
fn spread(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count).sqrt())
}

/// Logarithm of what a network says over the truth, in a pixel of many frames.
fn errors(model: DepthNetworkModel, pixel: (u32, u32)) -> Vec<f64> {
    let network = DepthNetwork::new(model, 11);
    let truth = |index| DepthMap::new(frame(index), 16, 9, vec![2.0; 16 * 9]).unwrap();
    let of = |index| network.infer(&truth(index)).unwrap();
    (0..3000).map(|index| f64::from(of(index).at(pixel.0, pixel.1).unwrap() / 2.0).ln()).collect()
}

#[test]
fn an_exact_network_says_the_truth() {
    let network = DepthNetwork::new(exact(), 1);
    let mut truth = flat(frame(3), 2.0);
    truth.data_mut()[70] = DepthMap::UNKNOWN;
    assert_eq!(network.infer(&truth).unwrap(), truth);
}

#[test]
fn each_error_has_the_deviation_it_is_told_to_have() {
    let scale = errors(DepthNetworkModel { scale_noise: 0.1, ..exact() }, (5, 5));
    let (mean, deviation) = spread(&scale);
    assert!(mean.abs() < 0.006 && (deviation - 0.1).abs() < 0.006, "{mean} {deviation}");
    // the next map knows nothing of this one
    let products: f64 = scale.windows(2).map(|pair| pair[0] * pair[1]).sum();
    assert!((products / 3000.0 / 0.01).abs() < 0.06);
    for pixel in [(0, 0), (3, 5), (15, 8)] {
        let (_, deviation) =
            spread(&errors(DepthNetworkModel { patch_noise: 0.05, ..exact() }, pixel));
        assert!((deviation - 0.05).abs() < 0.004, "{pixel:?} {deviation}");
        let (_, deviation) =
            spread(&errors(DepthNetworkModel { pixel_noise: 0.03, ..exact() }, pixel));
        assert!((deviation - 0.03).abs() < 0.002, "{pixel:?} {deviation}");
    }
    let wanders = errors(DepthNetworkModel { scale_drift: 0.1, drift_s: 3.0, ..exact() }, (0, 0));
    let (_, deviation) = spread(&wanders);
    assert!((deviation - 0.1).abs() < 0.03, "{deviation}");
    let steepest = wanders.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
    assert!(steepest < 0.01, "{steepest}");
}

#[test]
fn neighbours_share_a_patch_of_error_and_the_other_end_does_not() {
    let network = DepthNetwork::new(DepthNetworkModel { patch_noise: 0.05, ..exact() }, 5);
    let (mut near, mut far) = (0.0, 0.0);
    for index in 0..1000 {
        let map = network.infer(&flat(frame(index), 1.0)).unwrap();
        let error = |x, y| f64::from(map.at(x, y).unwrap()).ln() / 0.05;
        near += error(10, 10) * error(11, 10) / 1000.0;
        far += error(10, 10) * error(50, 30) / 1000.0;
    }
    assert!(near > 0.9 && far.abs() < 0.12, "{near} {far}");
}

#[test]
fn maps_are_reduced_smeared_cut_off_and_have_holes() {
    // left half near, right half far, one column unknown
    let mut truth = flat(frame(0), 1.0);
    for (index, depth) in truth.data_mut().iter_mut().enumerate() {
        match index % 64 {
            0..4 => *depth = DepthMap::UNKNOWN,
            34.. => *depth = 4.0,
            _ => {}
        }
    }
    let infer = |model| DepthNetwork::new(model, 3).infer(&truth).unwrap();
    let small = infer(DepthNetworkModel { rows: 9, ..exact() });
    assert_eq!((small.width(), small.height()), (16, 9));
    assert_eq!(small.stamp(), truth.stamp());
    assert_eq!((small.at(0, 4), small.at(1, 4), small.at(15, 4)), (None, Some(1.0), Some(4.0)));
    // 32 to 35: two columns near, two far
    assert_eq!(small.at(8, 4), Some(2.5));
    let smeared = infer(DepthNetworkModel { smear: 1, ..exact() });
    assert_eq!((smeared.at(33, 9), smeared.at(34, 9)), (Some(2.0), Some(3.0)));
    assert_eq!((smeared.at(3, 9), smeared.at(4, 9)), (None, Some(1.0)));
    let near = infer(DepthNetworkModel { max_depth: 3.0, ..exact() });
    assert_eq!((near.at(33, 0), near.at(34, 0)), (Some(1.0), None));

    let network = DepthNetwork::new(DepthNetworkModel { holes: 0.2, ..exact() }, 3);
    let known: Vec<f64> =
        (0..400).map(|i| network.infer(&flat(frame(i), 2.0)).unwrap().known_share()).collect();
    assert!((spread(&known).0 - 0.8).abs() < 0.02, "{:?}", spread(&known));
}

#[test]
fn a_blind_network_guesses_the_same_everywhere() {
    let faults = vec![Window::new(1.0, 2.0, DepthFault::Blind)];
    let network = DepthNetwork::new(DepthNetworkModel { faults, ..exact() }, 3);
    let at = |seconds| network.infer(&flat(Stamp::from_secs_f64(seconds), 0.7)).unwrap();
    assert!(at(0.9).data().iter().all(|depth| *depth == 0.7));
    assert!(at(1.5).data().iter().all(|depth| (*depth - 2.5).abs() < 1e-6));
}

#[test]
fn a_network_is_slow_late_and_fails_when_told_to() {
    let run = |faults| {
        let mut model = DepthNetworkModel::default();
        model.channel.latency = Latency { mean_s: 0.27, jitter_s: 0.0 };
        let mut network = DepthNetwork::new(DepthNetworkModel { faults, ..model }, 9);
        let mut maps = Vec::new();
        for index in 0..300 {
            let now = frame(index);
            assert_eq!(network.takes(now), network.show(&flat(now, 2.0)).unwrap());
            maps.extend(network.receive(now));
        }
        maps
    };
    let calm = run(Vec::new());
    // taken at 0, 1/3 s, ...; seen at the first frame 0.27 s later
    assert_eq!(calm.len(), 30);
    for (index, map) in calm.iter().enumerate() {
        assert_eq!(map.value.stamp(), map.stamp);
        assert!((map.stamp.secs_f64() - index as f64 / 3.0).abs() < 1e-8);
        assert!((map.arrived.seconds_since(map.stamp) - 0.27).abs() < 1e-9);
    }
    let faulty = run(vec![
        Window::new(3.0, 6.0, DepthFault::Rate(1.0)),
        Window::new(8.0, 9.0, DepthFault::Scale(1.5)),
    ]);
    let times: Vec<f64> = faulty.iter().map(|map| map.stamp.secs_f64()).collect();
    let within = |from: f64, until: f64| {
        times.iter().filter(|t| (from - 1e-6..until - 1e-6).contains(*t)).count()
    };
    assert_eq!((within(0.0, 3.0), within(3.0, 6.0), within(6.0, 9.0)), (9, 3, 9));
    // The maps of frames that both took are the same but for the scale.
    for map in &faulty {
        let Some(same) = calm.iter().find(|other| other.stamp == map.stamp) else { continue };
        let factor = if Window::new(8.0, 9.0, ()).holds(map.stamp) { 1.5 } else { 1.0 };
        for (a, b) in map.value.data().iter().zip(same.value.data()) {
            assert!((a / b - factor).abs() < 1e-5, "{a} {b}");
        }
    }
}

const PICTURE: (u32, u32) = (640, 360);

fn object(bbox: BoundingBox) -> VisibleObject {
    VisibleObject { id: 1, class_id: 7, bbox, visible_share: 1.0, blur_px: 0.0 }
}

fn silent() -> DetectorModel {
    DetectorModel { false_positives: 0.0, ..DetectorModel::default() }
}

/// Share of frames in which an object is found.
fn found(object: VisibleObject, light: f64) -> f64 {
    let detector = Detector::new(DetectorModel { miss: 0.0, ..silent() }, 21);
    let count = (0..6000)
        .filter(|i| !detector.infer(frame(*i), PICTURE, light, &[object]).is_empty())
        .count();
    count as f64 / 6000.0
}

#[test]
fn objects_are_found_by_size_share_light_and_blur() {
    let good = object(BoundingBox::from_center(300.0, 200.0, 80.0, 60.0));
    assert!(found(good, 0.4) > 0.995);
    let model = silent();
    let small = model.half_size_px as f32;
    let half = [
        (object(BoundingBox::from_center(300.0, 200.0, 3.0 * small, small)), 0.4),
        (VisibleObject { visible_share: model.half_visible, ..good }, 0.4),
        (good, model.half_light),
        (VisibleObject { blur_px: 60.0 * model.half_blur, ..good }, 0.4),
    ];
    for (object, light) in half {
        let share = found(object, light);
        assert!((share - 0.5).abs() < 0.05, "{share} of {object:?}");
    }
    for hopeless in [
        (VisibleObject { visible_share: 0.0, ..good }, 0.4),
        (good, 0.0),
        (object(BoundingBox::new(10.0, 10.0, 10.0, 30.0)), 0.4),
        (object(BoundingBox::new(700.0, 10.0, 800.0, 90.0)), 0.4),
    ] {
        assert_eq!(found(hopeless.0, hopeless.1), 0.0, "{hopeless:?}");
    }
}

#[test]
fn edges_jitter_by_the_size_and_end_where_the_picture_does() {
    let detector = Detector::new(silent(), 4);
    let truth = BoundingBox::new(-40.0, 100.0, 160.0, 140.0);
    let seen: Vec<_> = (0..6000)
        .filter_map(|i| detector.infer(frame(i), PICTURE, 0.4, &[object(truth)]).pop())
        .collect();
    assert!(seen.iter().all(|d| d.class_id == 7 && d.bbox.x0 == 0.0));
    let right: Vec<f64> = seen.iter().map(|d| f64::from(d.bbox.x1 - truth.x1)).collect();
    let top: Vec<f64> = seen.iter().map(|d| f64::from(d.bbox.y0 - truth.y0)).collect();
    let model = silent();
    let ((mean, across), (_, down)) = (spread(&right), spread(&top));
    // 160 px of the box are in the picture
    let expected = 160.0 * model.edge_noise;
    assert!(mean.abs() < 0.3 && (across / expected - 1.0).abs() < 0.12, "{mean} {across}");
    assert!((down / model.edge_noise_px - 1.0).abs() < 0.12, "{down}");
    // a part of it wanders slowly
    let lagged: f64 = right.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / 6000.0;
    assert!((lagged / (across * across) - model.edge_drift).abs() < 0.1, "{lagged}");
}

#[test]
fn misses_come_in_bursts_and_phantoms_as_often_as_told() {
    let detector = Detector::new(DetectorModel { miss: 0.2, ..silent() }, 8);
    let good = object(BoundingBox::from_center(300.0, 200.0, 80.0, 60.0));
    let missed: Vec<bool> =
        (0..20_000).map(|i| detector.infer(frame(i), PICTURE, 0.4, &[good]).is_empty()).collect();
    let share = missed.iter().filter(|m| **m).count() as f64 / 20_000.0;
    assert!((share - 0.2).abs() < 0.02, "{share}");
    let again = missed.windows(2).filter(|pair| pair[0] && pair[1]).count() as f64;
    assert!(again / (20_000.0 * share) > 1.5 * share, "{again}");

    let model = DetectorModel { false_positives: 0.1, false_class_id: 3, ..silent() };
    let detector = Detector::new(model, 8);
    let phantoms: Vec<_> =
        (0..20_000).flat_map(|i| detector.infer(frame(i), PICTURE, 0.4, &[])).collect();
    assert!((phantoms.len() as f64 / 20_000.0 - 0.1).abs() < 0.01, "{}", phantoms.len());
    for phantom in phantoms {
        assert!(phantom.bbox.is_proper() && phantom.class_id == 3 && phantom.confidence < 0.6);
        assert_eq!(phantom.bbox, phantom.bbox.clipped(640.0, 360.0));
    }
}

#[test]
fn what_is_said_of_a_frame_does_not_depend_on_others() {
    let near = object(BoundingBox::from_center(300.0, 200.0, 120.0, 90.0));
    let far = VisibleObject { id: 2, ..object(BoundingBox::from_center(100.0, 150.0, 26.0, 20.0)) };
    let show = |objects: &[VisibleObject], seed, first: u64| {
        let mut detector = Detector::new(DetectorModel::default(), seed);
        let mut answers = Vec::new();
        for index in first..90 {
            assert!(detector.show(frame(index), PICTURE, 0.4, objects));
            answers.extend(detector.receive(frame(index)).map(|a| (a.stamp, a.value)));
        }
        answers
    };
    let (all, late) = (show(&[near, far], 6, 0), show(&[near, far], 6, 50));
    assert_eq!(all, show(&[near, far], 6, 0));
    assert_ne!(all, show(&[near, far], 7, 0));
    assert!(late.iter().all(|answer| all.contains(answer)) && late.len() > 30);
    // The near one is found the same without the far one.
    for ((stamp, both), (_, alone)) in all.iter().zip(show(&[near], 6, 0)) {
        assert!(both.is_sorted_by(|a, b| a.confidence >= b.confidence));
        assert!(alone.iter().all(|detection| both.contains(detection)), "{stamp}");
    }
}
