//! The motion of camera and target since the last depth map, and the depth now.
