//! Networks, and the wires between them and the rest, with their faults.
//!
//! The simulator's truth plays them: true depth maps and true boxes go in, and what a
//! network would have said comes out, late, with a network's errors. Or networks look at
//! the rendered pictures themselves, see [`Perception`](crate::Perception).
//!
//! | type | plays |
//! |---|---|
//! | [`DepthNetwork`] | a depth network: rate, scale error of each map, slow drift, smeared edges, noise, holes |
//! | [`Detector`] | a detector: edges that jitter, misses in bursts, false positives, confidence |
//! | [`Channel`] | the way of messages: latency, loss, duplicates, messages that overtake others |
//!
//! Each model draws from a stream of random numbers of its own, see
//! [`random_stream`]; what is drawn for one frame depends on the seed and the frame's
//! stamp, so that a lost or an additional map changes nothing in the others.

mod channel;
mod depth_network;
mod detector;
mod random;
mod schedule;
mod window;

pub use channel::{Channel, ChannelFault, ChannelModel, Delivered, Latency};
pub use depth_network::{DepthFault, DepthNetwork, DepthNetworkModel};
pub use detector::{Detector, DetectorModel, VisibleObject};
pub use random::{Random, random_stream};
pub use window::Window;

#[cfg(test)]
mod tests;
