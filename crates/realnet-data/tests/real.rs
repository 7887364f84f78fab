//! The whole way on real data, where they are at hand.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout, clippy::panic)]

use realnet_data::{
    CanonicalFocal, DepthAugment, DepthBatch, DepthPart, DepthSamples, DepthSet, DepthSetOptions,
    DepthSource, DetectionAugment, DetectionBatch, DetectionSamples, DetectionSet, HoldOut, Loader,
    LoaderOptions, Normalization, SetOptions, SourceCamera, SourceList,
};
use std::path::PathBuf;
use std::sync::Arc;

fn shared(relative: &str) -> Option<PathBuf> {
    let root = std::env::var_os("REALNET_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is missing", path.display());
    None
}

/// An epoch of mosaics is the same for any number of threads, with and without the cache.
#[test]
fn an_epoch_of_rc_cars_is_the_same_however_it_is_made() {
    let Some(file) = shared("data/rc-car/data.yaml") else { return };
    let epoch = |threads, cache_bytes| -> Vec<DetectionBatch> {
        let options = SetOptions { threads, cache_bytes, ..SetOptions::default() };
        let set = DetectionSet::open(&file, "val", 96, &options).unwrap();
        let report = set.report();
        assert_eq!((report.pictures, report.usable, report.backgrounds), (100, 100, 0));
        assert_eq!(report.classes, [("rc_car".to_owned(), 100)]);
        assert!(report.findings.is_empty(), "{report}");
        let samples =
            DetectionSamples::training(Arc::new(set), DetectionAugment::default(), 5).unwrap();
        let options =
            LoaderOptions { batch: 8, threads, shuffle: Some(5), ..LoaderOptions::default() };
        let loader = Loader::new(Arc::new(samples), options).unwrap();
        let batches = loader.epoch(3).take(5).map(|b| DetectionBatch::collate(&b.unwrap()));
        let batches = batches.collect();
        assert!(loader.failures().is_empty());
        batches
    };
    let one = epoch(1, 2 << 30);
    assert_eq!(one.len(), 5);
    // A third of a megabyte: most pictures are decoded again.
    assert!(one == epoch(3, 300_000));
    for batch in &one {
        assert_eq!((batch.count, batch.images.len()), (8, 8 * 3 * 96 * 96));
        assert!(batch.images.iter().all(|value| (0.0..=1.0).contains(value)));
        for [place, class, cx, cy, w, h] in &batch.targets {
            assert!(*place < 8.0 && *class == 0.0);
            assert!(*w > 0.0 && *h > 0.0 && cx - w / 2.0 > -1e-5 && cy + h / 2.0 < 1.0 + 1e-5);
        }
    }
}

#[test]
fn nyu_is_divided_by_blocks_and_keeps_its_metres() {
    let Some(path) = shared("data/nyu-depth-v2/train") else { return };
    let camera = SourceCamera {
        fx: 518.9,
        fy: 519.5,
        cx: 325.6,
        cy: 253.7,
        width: Some(640),
        height: Some(480),
    };
    let source = DepthSource {
        depth_scale: Some(1000.0),
        camera: Some(camera),
        hold_out: Some(HoldOut { block: 40, every: 5, gap: 0 }),
        ..DepthSource::new(path)
    };
    let list = SourceList { sources: vec![source] };
    let set =
        DepthSet::open(&list, DepthPart::Val, &DepthSetOptions::validation((128, 96))).unwrap();
    let report = set.report().clone();
    // Of the 795 pictures, blocks 4, 9 and 14 of 40 each, and the 35 of block 19.
    assert_eq!((report.pictures, report.usable), (155, 155), "{report}");
    let set = Arc::new(set);
    let canonical = CanonicalFocal::new(128.0).unwrap();
    let plain =
        DepthSamples::validation(Arc::clone(&set), canonical, Normalization::IMAGENET).unwrap();
    let rough =
        DepthSamples::training(set, DepthAugment::default(), canonical, Normalization::IMAGENET, 1)
            .unwrap();
    let batch = |samples: DepthSamples| {
        let options = LoaderOptions { batch: 16, ..LoaderOptions::default() };
        let loader = Loader::new(Arc::new(samples), options).unwrap();
        DepthBatch::collate(&loader.epoch(0).next().unwrap().unwrap())
    };
    let (plain, rough) = (batch(plain), batch(rough));
    let median = |batch: &DepthBatch, place: usize| {
        let depths = batch.depths.chunks_exact(128 * 96).nth(place).unwrap();
        let factor = batch.metres_per_unit[place];
        let mut known: Vec<f32> = depths.iter().filter(|d| **d > 0.0).map(|d| d * factor).collect();
        assert!(known.len() > 128 * 96 / 3, "{place}: {}", known.len());
        known.sort_by(f32::total_cmp);
        known[known.len() / 2]
    };
    for place in 0..16 {
        let (before, after) = (median(&plain, place), median(&rough, place));
        assert!((0.5..10.0).contains(&before), "{place}: {before} m");
        // Another part of the picture, but the same room.
        assert!((0.5..2.0).contains(&(after / before)), "{place}: {before} {after} m");
        let fx = plain.cameras[place].fx;
        assert!((fx - 518.9 / 5.0).abs() < 1e-6, "{fx}");
        let zoom = rough.cameras[place].fx / fx;
        assert!((0.8..=1.25).contains(&zoom), "{zoom}");
    }
}
