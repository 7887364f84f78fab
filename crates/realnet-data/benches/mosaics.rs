//! Samples a second. The target: 150 mosaics a second at 320 on two cores.
#![allow(missing_docs, clippy::unwrap_used)]

use divan::Bencher;
use divan::counter::ItemsCount;
use realnet_core::{Frame, Stamp};
use realnet_data::{
    DetectionAugment, DetectionSamples, DetectionSet, Loader, LoaderOptions, SetOptions, Target,
};
use std::path::PathBuf;
use std::sync::Arc;

fn main() {
    divan::main();
}

const NONE: DetectionAugment = DetectionAugment::NONE;

/// The frames of the RC car where they are, or else 64 drawn ones of the same size.
fn set(cache_bytes: usize) -> Arc<DetectionSet> {
    let shared = std::env::var_os("REALNET_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let options = SetOptions { cache_bytes, ..SetOptions::default() };
    let file = shared.join("data/rc-car/data.yaml");
    Arc::new(DetectionSet::open(&file, "train", 320, &options).unwrap_or_else(|_| drawn()))
}

fn drawn() -> DetectionSet {
    let picture = |i: u32| {
        let value = |at: u32| ((at / 3 % 1280 * (i + 1) + at / 3840 * 3) % 251) as u8;
        let frame = Frame::rgb8(Stamp::ZERO, 1280, 720, (0..1280 * 720 * 3).map(value).collect());
        let target = Target { class_id: 0, cx: 0.5, cy: 0.5, w: 0.3, h: 0.3 };
        (frame.unwrap(), vec![target])
    };
    let pictures = (0..64).map(picture).collect();
    DetectionSet::from_memory(vec!["box".to_owned()], pictures, 320).unwrap()
}

fn load(bencher: Bencher, augment: DetectionAugment, cache_bytes: usize, threads: usize) {
    let set = set(cache_bytes);
    let samples = Arc::new(DetectionSamples::training(set, augment, 1).unwrap());
    let options = LoaderOptions { batch: 16, threads, shuffle: Some(1), ..Default::default() };
    let loader = Loader::new(samples, options).unwrap();
    let mut epochs = 0..;
    let mut epoch = loader.epoch(0);
    bencher.counter(ItemsCount::new(16usize)).bench_local(|| {
        loop {
            if let Some(batch) = epoch.next() {
                return batch.unwrap();
            }
            epoch = loader.epoch(epochs.next().unwrap());
        }
    });
}

/// With the default augmentation, pictures in memory.
#[divan::bench(args = [1, 2], sample_count = 60)]
fn mosaics(bencher: Bencher, threads: usize) {
    load(bencher, DetectionAugment::default(), 2 << 30, threads);
}

/// The geometry alone.
#[divan::bench(args = [2], sample_count = 60)]
fn mosaics_without_color(bencher: Bencher, threads: usize) {
    let augment = DetectionAugment { color: NONE.color, ..DetectionAugment::default() };
    load(bencher, augment, 2 << 30, threads);
}

/// Single pictures.
#[divan::bench(args = [2], sample_count = 60)]
fn without_mosaic(bencher: Bencher, threads: usize) {
    load(
        bencher,
        DetectionAugment { mosaic: 0.0, ..DetectionAugment::default() },
        2 << 30,
        threads,
    );
}

/// Pictures decoded each time: what a set larger than memory gives.
#[divan::bench(args = [2], sample_count = 12)]
fn mosaics_without_cache(bencher: Bencher, threads: usize) {
    load(bencher, DetectionAugment::default(), 0, threads);
}
