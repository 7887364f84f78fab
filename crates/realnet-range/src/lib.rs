//! Metres to the target between two depth maps, and from cues other than depth.
//!
//! | for | module |
//! |---|---|
//! | the box of the last detection in the present frame, by flow alone | [`carry`] |
//! | range and its deviation: depth in the box, ground plane, known size | [`cues`] |
//! | motion of camera and target since the last depth map, and the depth now | [`motion`] |
//!
//! A range is a depth: the coordinate along the optical axis, in metres. Every
//! estimate carries a standard deviation or is an error that says why there is
//! none. No clock, no thread, no hidden randomness; scratch is kept from frame to
//! frame.

pub mod carry;
pub mod cues;
pub mod motion;
