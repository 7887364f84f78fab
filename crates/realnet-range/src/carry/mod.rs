//! The box of a target, carried from frame to frame by the flow of its corners.
