use super::*;
use proptest::prelude::*;
use realnet_core::Stamp;

fn map(width: u32, height: u32, data: Vec<f32>) -> DepthMap {
    DepthMap::new(Stamp::ZERO, width, height, data).unwrap()
}

fn metrics(protocol: DepthProtocol) -> DepthMetrics {
    DepthMetrics::new(protocol).unwrap()
}

fn close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() < 1e-9 * b.abs().max(1.0), "{i}: {a}, expected {b}");
    }
}

#[test]
fn by_hand() {
    // Factors of 2 (too far) and 1/2 (too near), and one that is right.
    let truth = map(3, 1, vec![1.0, 2.0, 4.0]);
    let produced = map(3, 1, vec![2.0, 1.0, 4.0]);
    let mut m = metrics(DepthProtocol::new("hand"));
    let image = m.add(&truth, &produced).unwrap();
    let ln2 = 2f64.ln();
    let expected = [
        (1.0 + 0.5) / 3.0,
        (1.0 + 0.5) / 3.0,
        (2f64 / 3.0).sqrt(),
        ln2 * (2f64 / 3.0).sqrt(),
        2.0 * 2f64.log10() / 3.0,
        // The logarithms are ln 2, -ln 2 and 0, their mean is 0.
        100.0 * ln2 * (2f64 / 3.0).sqrt(),
        1.0 / 3.0,
        1.0 / 3.0,
        1.0 / 3.0,
    ];
    close(&image.errors.unwrap().values(), &expected);
    close(&m.report().per_image.unwrap().values(), &expected);
    close(&m.report().pooled.unwrap().values(), &expected);
}

#[test]
fn the_two_means_differ_as_they_should() {
    let mut m = metrics(DepthProtocol::new("hand"));
    // One pixel 50 % off, then three pixels 10 % off.
    m.add(&map(3, 1, vec![2.0, 0.0, f32::NAN]), &map(3, 1, vec![3.0, 1.0, 1.0])).unwrap();
    m.add(&map(3, 1, vec![1.0; 3]), &map(3, 1, vec![1.125; 3])).unwrap();
    // Nothing to compare: counted, but in no mean.
    m.add(&map(3, 1, vec![1.0; 3]), &map(3, 1, vec![0.0, f32::NAN, f32::INFINITY])).unwrap();
    let report = m.report();
    close(&[report.per_image.unwrap().abs_rel], &[(0.5 + 0.125) / 2.0]);
    close(&[report.pooled.unwrap().abs_rel], &[(0.5 + 3.0 * 0.125) / 4.0]);
    assert_eq!((report.images, report.images_compared), (3, 2));
    assert_eq!((report.truth_pixels, report.pixels, report.known_share), (7, 4, Some(4.0 / 7.0)));
    assert_eq!(report.errors(), report.per_image);
    let pooled = DepthProtocol { pooling: Pooling::Pixels, ..DepthProtocol::new("hand") };
    let report = DepthReport { protocol: pooled, ..report };
    assert_eq!(report.errors(), report.pooled);
}

#[test]
fn the_range_leaves_truth_out_and_clamps_what_was_produced() {
    let protocol = DepthProtocol { min_depth: 1.0, max_depth: 10.0, ..DepthProtocol::new("x") };
    let mut m = metrics(protocol);
    let truth = map(5, 1, vec![1.0, 10.0, 8.0, 2.0, 5.0]);
    let produced = map(5, 1, vec![7.0, 7.0, 50.0, 0.1, 5.0]);
    let image = m.add(&truth, &produced).unwrap();
    // 1 and 10 are out; 50 counts as 10 and 0.1 as 1.
    assert_eq!(image.pixels, 3);
    close(&[image.errors.unwrap().abs_rel], &[(0.25 + 0.5) / 3.0]);
}

#[test]
fn scaling_to_the_median_takes_a_common_factor_away() {
    let truth = map(4, 1, vec![1.0, 2.0, 3.0, 4.0]);
    let produced = map(4, 1, vec![2.0, 4.0, 6.0, 8.0]);
    let mut m = metrics(DepthProtocol { median_scaling: true, ..DepthProtocol::new("x") });
    assert_eq!(m.add(&truth, &produced).unwrap().scale, Some(0.5));
    let report = m.report();
    close(&[report.per_image.unwrap().abs_rel, report.per_image.unwrap().d1], &[0.0, 1.0]);
    assert_eq!(report.scale, Some(ScaleSpread { median: 0.5, relative_std: 0.0 }));
    let mut plain = metrics(DepthProtocol::new("x"));
    assert_eq!(plain.add(&truth, &produced).unwrap().scale, None);
    close(&[plain.report().per_image.unwrap().abs_rel], &[1.0]);
    // Without the factor, the scale-invariant error is 0 either way.
    assert!(plain.report().pooled.unwrap().silog < 1e-6);
}

#[test]
fn crops_are_the_published_ones() {
    assert_eq!(DepthCrop::Full.window(640, 480), (0..480, 0..640));
    // KITTI's usual size; rows and columns as in evaluate_kitti.py.
    assert_eq!(DepthCrop::Garg.window(1242, 375), (153..371, 44..1197));
    assert_eq!(DepthCrop::Eigen.window(1242, 375), (124..342, 44..1197));
    assert_eq!(DepthCrop::Nyu.window(640, 480), (45..471, 41..601));
    assert_eq!(DepthCrop::Nyu.window(320, 240), (22..235, 20..300));
    let (rows, columns) = DepthCrop::Garg.window(1, 1);
    assert!(rows.is_empty() && columns.is_empty());
}

#[test]
fn only_the_pixels_asked_for() {
    let truth = map(3, 2, vec![1.0; 6]);
    let produced = map(3, 2, vec![1.5, 1.0, 0.0, 1.0, 1.0, 3.0]);
    let mut m = metrics(DepthProtocol::new("x"));
    let image = m.add_where(&truth, &produced, |x, y| x == 2 || (x, y) == (0, 0)).unwrap();
    assert_eq!((image.truth_pixels, image.pixels), (3, 2));
    close(&[image.errors.unwrap().abs_rel], &[(0.5 + 2.0) / 2.0]);
}

#[test]
fn nothing_is_null_and_mistakes_are_named() {
    let mut m = metrics(DepthProtocol::new("x"));
    let report = m.report();
    assert_eq!((report.known_share, report.per_image, report.pooled), (None, None, None));
    assert!(report.table().lines().last().unwrap().ends_with(" -"));
    m.add(&map(1, 1, vec![1.0]), &map(1, 1, vec![1.0])).unwrap();
    let error = m.add(&map(2, 1, vec![1.0; 2]), &map(1, 2, vec![1.0; 2])).unwrap_err();
    assert_eq!(error.to_string(), "image 1: the true depth map is 2x1, the produced one 1x2");
    assert_eq!(m.report().images, 1);
    for (min, max) in
        [(0.0, 1.0), (2.0, 1.0), (f64::NAN, 1.0), (1.0, f64::NAN), (1.0, f64::INFINITY)]
    {
        let protocol = DepthProtocol { min_depth: min, max_depth: max, ..DepthProtocol::new("x") };
        assert!(matches!(DepthMetrics::new(protocol), Err(DepthEvalError::Range { .. })));
    }
}

#[test]
fn a_report_says_how_it_was_measured() {
    let mut m = metrics(DepthProtocol::nyu("Kinect, filled"));
    m.add(&map(64, 48, vec![1.0; 64 * 48]), &map(64, 48, vec![1.5; 64 * 48])).unwrap();
    let report = m.report();
    let table = report.table();
    let first = "truth: Kinect, filled; crop: Eigen for NYU; depths: 0.001 to 10 m; \
                 median scaling: no; figures: mean of images";
    assert_eq!(table.lines().next(), Some(first));
    let rows: Vec<&str> = table.lines().skip(2).collect();
    assert!(rows.windows(2).all(|w| w[0].len() == w[1].len()), "{table}");
    assert!(rows[1].starts_with("mean of images") && rows[2].starts_with("all pixels pooled"));
    assert!(rows[1].contains("0.5000"), "{table}");
    let json = serde_json::to_string(&report).unwrap();
    assert!(json.starts_with(
        r#"{"protocol":{"truth":"Kinect, filled","crop":"nyu","min_depth":0.001,"max_depth":10.0,"median_scaling":false,"pooling":"per_image"},"images":1"#
    ), "{json}");
    assert_eq!(serde_json::from_str::<DepthReport>(&json).unwrap(), report);
}

/// A pair of maps by a rule that is easy to repeat elsewhere.
fn made_up(width: u32, height: u32, k: u32) -> (DepthMap, DepthMap) {
    let pixels = u64::from(width * height);
    let k = u64::from(k);
    let mut truth = Vec::new();
    let mut produced = Vec::new();
    for i in 0..pixels {
        let g = (0.2 + ((i * 7919 + k * 31) % 1201) as f64 / 100.0) as f32;
        let p = g * (0.5 + ((i * 104_729 + k * 17) % 997) as f64 / 800.0) as f32;
        truth.push(if i % 11 == k { 0.0 } else { g });
        produced.push(if i % 7 == 0 { 0.0 } else { p });
    }
    (map(width, height, truth), map(width, height, produced))
}

/// What numpy makes of the same maps: crop, scaling, largest depth, pixels with
/// truth, pixels compared, mean of images, pooled, spread of the scales.
type Case = (DepthCrop, bool, f64, u64, u64, [f64; 9], [f64; 9], Option<[f64; 2]>);

#[rustfmt::skip]
const NUMPY: [Case; 4] = [
    (DepthCrop::Full, false, 10.0, 2734, 2338,
     [0.2764098060311841, 0.4774691661433561, 1.6327755789298803, 0.3221616255497083,
      0.11667114029743397, 32.09140176260801, 0.4584334054980493, 0.7977442042712491,
      0.991013604176533],
     [0.2764047358721361, 0.4775195144294416, 1.6328488803256518, 0.32216367036996824,
      0.11666864314318975, 32.09209236363665, 0.4585115483319076, 0.7976903336184773,
      0.9910179640718563], None),
    (DepthCrop::Garg, true, 80.0, 1760, 1520,
     [0.325215554285137, 0.938808121051896, 2.783991516593495, 0.35331826536460165,
      0.13277770481512133, 34.75491569515608, 0.3616941694169417, 0.7352901820794324,
      0.990869535933185],
     [0.32506852657005914, 0.937996064344483, 2.7832883581530785, 0.3532663614300229,
      0.13274590779216838, 34.77190199071434, 0.3618421052631579, 0.7355263157894737,
      0.9907894736842106], Some([0.999271837434216, 0.006760906188449992])),
    (DepthCrop::Eigen, false, 5.0, 745, 641,
     [0.2713533855437016, 0.2417742034902989, 0.8452855082814926, 0.31760251373534576,
      0.11502178620660379, 31.61159908434236, 0.4617866840849057, 0.8145128028164964,
      0.9890431471142825],
     [0.2713190831168477, 0.24181146695635608, 0.8455325493882221, 0.31765599444251574,
      0.11501648081546206, 31.620227475338265, 0.46177847113884557, 0.8143525741029641,
      0.9890795631825273], None),
    (DepthCrop::Nyu, true, 10.0, 2158, 1854,
     [0.2782577003241033, 0.48630504043338224, 1.6441928087871556, 0.3230750956067437,
      0.11709030809715616, 32.13754851817277, 0.46057186399792566, 0.794602049695771,
      0.9908280467266897],
     [0.27824224764108635, 0.48636569227627285, 1.6442114858136072, 0.32309192111396423,
      0.11709048590616997, 32.14713173214479, 0.46062567421790723, 0.7944983818770227,
      0.9908306364617044], Some([0.9940104494602926, 0.010041469234153987])),
];

#[test]
fn equal_to_numpy() {
    for (crop, median_scaling, max_depth, truth_pixels, pixels, per_image, pooled, scale) in NUMPY {
        let base = DepthProtocol::new("made up");
        let mut m = metrics(DepthProtocol { crop, median_scaling, max_depth, ..base });
        for k in 0..3 {
            let (truth, produced) = made_up(40 + k, 30, k);
            m.add(&truth, &produced).unwrap();
        }
        let report = m.report();
        assert_eq!((report.truth_pixels, report.pixels), (truth_pixels, pixels), "{crop}");
        close(&report.per_image.unwrap().values(), &per_image);
        close(&report.pooled.unwrap().values(), &pooled);
        assert_eq!(report.scale.is_some(), scale.is_some());
        if let (Some(found), Some(expected)) = (report.scale, scale) {
            close(&[found.median, found.relative_std], &expected);
        }
    }
}

proptest! {
    #[test]
    fn the_median_is_the_middle(mut values in prop::collection::vec(-1e3..1e3f64, 0..40)) {
        let found = median(&mut values.clone());
        values.sort_by(f64::total_cmp);
        let n = values.len();
        let wanted = (n > 0).then(|| (values[(n - 1) / 2] + values[n / 2]) / 2.0);
        prop_assert_eq!(found, wanted);
    }

    #[test]
    fn any_maps_give_finite_figures(
        truth in prop::collection::vec(any::<f32>(), 12),
        produced in prop::collection::vec(any::<f32>(), 12),
        median_scaling: bool,
    ) {
        let mut m = metrics(DepthProtocol { median_scaling, ..DepthProtocol::new("any") });
        let image = m.add(&map(4, 3, truth), &map(4, 3, produced)).unwrap();
        if let Some(errors) = image.errors {
            prop_assert!(errors.values().iter().all(|v| v.is_finite() && *v >= 0.0));
            prop_assert!(errors.d1 <= errors.d2 && errors.d2 <= errors.d3 && errors.d3 <= 1.0);
        }
    }
}
