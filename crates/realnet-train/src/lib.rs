//! Learning: YOLOv5 detectors and monocular depth networks, trained with burn.
//!
//! | module | what |
//! |---|---|
//! | [`nets`] | YOLOv5 n, s, m, l, x, the authors' VNL and `vnl-lite`, in burn |
//! | [`names`] | their weights by PyTorch's names, in and out |
//! | [`anchors`] | the sizes of boxes that a detector begins with, fitted to a data set |
//! | [`loss`] | boxes, objectness and classes; classes of depth and virtual normals |
//! | [`optim`] | SGD and AdamW with groups, schedules, clipping, moving average |
//! | [`export`] | safetensors and ONNX files |
//! | [`tasks`] | detection from YOLO data sets, depth from pictures with depth maps |
//! | [`trainer`] | epochs, steps, validation, checkpoints that go on to the same result |
//!
//! A network in training and the same network at run time meet in the names of their
//! weights: [`names::tensors`] gives what `realnet-nn` builds its ONNX graphs from, and takes
//! what it reads from `.pt` and safetensors files.

pub mod anchors;
pub mod export;
pub mod loss;
pub mod names;
pub mod nets;
pub mod optim;
pub mod tasks;
pub mod trainer;
