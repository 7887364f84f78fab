//! Files and devices: where frames come from and where results go.
//!
//! | module | what |
//! |---|---|
//! | [`picture`] | JPEG and PNG files to [`Frame`](realnet_core::Frame) and back |
//! | [`depth`] | grey PNG and PGM files to [`DepthMap`](realnet_core::DepthMap) |
//! | [`source`] | one iterator over pictures, folders, globs, video, streams and cameras |
//! | [`video`] | annotated video through an installed ffmpeg |
//! | [`actuator`] | commands to motors: JSON datagrams, VESC |
//! | [`annotate`] | boxes, labels and flow drawn on a frame |
//! | [`recording`] | runs as MCAP files, written and read |
//! | [`datasets`] | YOLO `data.yaml`, COCO json, RGB-D sequences, boxes of a target |
//! | [`results`] | JSON lines, YOLO text and COCO results of a run |
//! | [`atomic`] | files that are whole or not there |
//! | [`yuv`] | packed YUV of cameras to RGB |
//!
//! This crate may read clocks, start threads and start processes; it never
//! prints. Each error names the file, the place in it and the value.

pub mod actuator;
pub mod annotate;
pub mod atomic;
pub mod datasets;
pub mod depth;
mod ffmpeg;
pub mod picture;
pub mod recording;
pub mod results;
pub mod source;
pub mod video;
pub mod yuv;
