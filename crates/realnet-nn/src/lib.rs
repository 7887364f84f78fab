//! Networks at run time.
//!
//! | module | what |
//! |---|---|
//! | [`weights`] | PyTorch and safetensors checkpoints, read without running anything in them |
//! | [`yolov5`] | the YOLOv5 architectures, recognised by the shapes of their weights, as ONNX graphs |
//! | [`onnx`] | reading, cutting and writing ONNX files |
//! | [`engine`] | rten (embedded) and ONNX Runtime (when found) behind one trait |
//! | [`detector`] | letterbox, network, decoding and suppression: a frame in, boxes out |
//!
//! Nothing here starts a thread of its own, reads a clock or the environment, or
//! prints. The only file that is opened is the one the caller names.

mod class_names;
pub mod detector;
pub mod engine;
pub mod onnx;
pub mod weights;
pub mod yolov5;
