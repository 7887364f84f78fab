//! Networks at run time.
//!
//! | module | what |
//! |---|---|
//! | [`weights`] | PyTorch and safetensors checkpoints, read without running anything in them |
//! | [`yolov5`] | the YOLOv5 architectures, recognised by the shapes of their weights, as ONNX graphs |
//! | [`vnl`] | the authors' virtual-normal depth network, recognised likewise |
//! | [`vnl_lite`] | a depth network for small computers, recognised likewise |
//! | [`onnx`] | reading, cutting and writing ONNX files |
//! | [`engine`] | rten (embedded) and ONNX Runtime (when found) behind one trait |
//! | [`detector`] | letterbox, network, decoding and suppression: a frame in, boxes out |
//! | [`depth`] | letterbox, network, soft-weighted sum and resizing: a frame in, metres out |
//!
//! Nothing here starts a thread of its own, reads a clock or the environment, or
//! prints. The only file that is opened is the one the caller names.

mod class_names;
pub mod depth;
pub mod detector;
pub mod engine;
mod fold;
mod layer;
pub mod onnx;
mod reader;
pub mod vnl;
pub mod vnl_lite;
pub mod weights;
pub mod yolov5;
