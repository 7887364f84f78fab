//! Time of what RealNet does itself for a depth map, one thread:
//! `cargo bench -p realnet-nn --bench depth`.
#![allow(missing_docs)]

use divan::{Bencher, black_box};
use realnet_nn::depth::{DepthCoding, SoftSum};

fn main() {
    divan::main();
}

/// Softmax and weighted sum over 60 bins, for a square of so many pixels a side.
#[divan::bench(args = [64, 128, 256])]
fn soft_sum(bencher: Bencher<'_, '_>, side: usize) {
    let logits: Vec<f32> = (0..60 * side * side).map(|i| (i as f32 * 0.37).sin() * 8.0).collect();
    let mut depths = vec![0.0; side * side];
    let mut sum = SoftSum::new(&DepthCoding::default(), 60);
    bencher.bench_local(|| sum.run(black_box(&logits), 1.0, black_box(&mut depths)));
}
