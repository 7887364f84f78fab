//! Any bytes are either refused as weights or give tensors that keep their
//! promises; what is read is offered to the network builder too.
#![no_main]

use libfuzzer_sys::fuzz_target;
use realnet_nn::weights::{Checkpoint, pickle::Pickle};
use realnet_nn::yolov5::YoloV5;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(pickle) = Pickle::parse(bytes) {
        assert!(pickle.consumed() <= bytes.len());
    }
    if let Ok(checkpoint) = Checkpoint::from_bytes(bytes) {
        for tensor in checkpoint.tensors.values() {
            assert_eq!(tensor.shape().iter().product::<usize>(), tensor.data().len());
        }
        if let Ok(network) = YoloV5::from_checkpoint(&checkpoint) {
            assert_eq!(network.strides().len(), network.anchors().len());
        }
    }
});
