//! Pure pursuit, speed control, limits and a governor that stops.
