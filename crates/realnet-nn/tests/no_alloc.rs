//! Around the engine, a depth network allocates nothing once it has seen a frame
//! of a size. Skipped where the shared files are missing.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

#[path = "../../realnet-core/tests/counting/mod.rs"]
mod counting;

use counting::count;
use realnet_core::{Frame, Stamp};
use realnet_nn::{
    depth::{DepthModel, DepthNet, DepthOptions, DepthSize},
    engine::{EngineChoice, Runtime, RuntimeOptions},
};
use std::path::PathBuf;

#[test]
fn depth_allocates_only_in_the_engine() {
    let root = std::env::var("REALNET_SHARED")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared").to_owned());
    let path = PathBuf::from(root).join("golden/vnl/mobilenetv2_random.safetensors");
    if !path.exists() {
        println!("skipped: {} is missing", path.display());
        return;
    }
    let runtime =
        Runtime::start(&RuntimeOptions { choice: EngineChoice::Rten, ..Default::default() });
    let output = DepthSize::Frame;
    let options = DepthOptions { size: Some((64, 64)), output, ..Default::default() };
    let mut net = DepthNet::new(&DepthModel::open(&path).unwrap(), &runtime, &options).unwrap();
    let frame = Frame::rgb8(Stamp::ZERO, 160, 90, vec![90; 160 * 90 * 3]).unwrap();
    let mut memory = net.depth(&frame, None).unwrap().into_data();
    for _ in 0..3 {
        let start = count();
        let mut marks = [0; 3];
        let mark = &mut |stage| marks[stage as usize] = count();
        let map = net.depth_marked(&frame, None, memory, mark).unwrap();
        assert_eq!(marks[0] - start, 0, "before the engine");
        assert!(marks[1] >= marks[0]);
        assert_eq!(count() - marks[1], 0, "after the engine");
        memory = map.into_data();
    }
    // The counter counts.
    let before = count();
    drop(std::hint::black_box(vec![1u8; 100]));
    assert_eq!(count() - before, 1);
}
