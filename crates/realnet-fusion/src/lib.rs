//! A Kalman filter with late measurements, and the target's state in time.
