//! What no command may do, whatever went in.

use realnet_control::{Drive, Limiter, VehicleOptions};
use realnet_core::{DriveCommand, Stamp};

/// Looks at each command and the one before.
pub struct Limits {
    vehicle: VehicleOptions,
    last: Option<DriveCommand>,
}

impl Limits {
    pub fn new(vehicle: VehicleOptions) -> Self {
        Self { vehicle, last: None }
    }

    /// What is wrong with a command that was sent at `now`.
    pub fn check(&mut self, now: Stamp, sent: &DriveCommand) -> Result<(), &'static str> {
        let last = self.last.replace(*sent);
        if sent.stamp != now {
            return Err("another stamp than that of the step");
        }
        if [sent.speed, sent.steering_angle, sent.yaw_rate].iter().any(|v| !v.is_finite()) {
            return Err("a number that is not finite");
        }
        self.bounds(sent)?;
        if sent.stop.is_some() && sent.speed.abs() > last.map_or(0.0, |last| last.speed.abs()) {
            return Err("faster although it stops");
        }
        self.rates(last, sent)
    }

    fn bounds(&self, sent: &DriveCommand) -> Result<(), &'static str> {
        let vehicle = &self.vehicle;
        let least = vehicle.dead_band.min_speed_m_s;
        if sent.speed > vehicle.max_speed_m_s || sent.speed < -vehicle.max_reverse_speed_m_s {
            return Err("too fast");
        }
        if sent.speed != 0.0 && sent.speed.abs() < least {
            return Err("in the dead band");
        }
        match vehicle.drive {
            Drive::Ackermann { max_steering_rad, .. } => {
                let turned = sent.steering_angle.abs() > max_steering_rad;
                if turned { Err("too great a steering angle") } else { Ok(()) }
            }
            Drive::Differential { track_m, max_wheel_speed_m_s, max_yaw_rate_rad_s, .. } => {
                let wheel = sent.speed.abs() + 0.5 * track_m * sent.yaw_rate.abs();
                let fast = wheel > max_wheel_speed_m_s + 1e-12;
                if fast || sent.yaw_rate.abs() > max_yaw_rate_rad_s || sent.steering_angle != 0.0 {
                    Err("wheels or turn too fast")
                } else {
                    Ok(())
                }
            }
        }
    }

    fn rates(&self, last: Option<DriveCommand>, sent: &DriveCommand) -> Result<(), &'static str> {
        let vehicle = &self.vehicle;
        // It stands before the first one, wheels straight.
        let last = last.unwrap_or(DriveCommand { stamp: sent.stamp, ..DriveCommand::default() });
        let real = sent.stamp.seconds_since(last.stamp).max(0.0);
        let seconds = real.min(Limiter::LONGEST_STEP_S);
        let slack = 1e-9;
        let faster = sent.speed.abs() - last.speed.abs();
        if sent.speed * last.speed < 0.0 {
            return Err("the other way without a stop");
        }
        // Over the dead band in one step.
        let start = if last.speed == 0.0 { vehicle.dead_band.min_speed_m_s } else { 0.0 };
        if faster > (vehicle.max_acceleration_m_s2 * seconds).max(start) + slack {
            return Err("too great an acceleration");
        }
        let standstill = last.speed.abs()
            <= vehicle.dead_band.min_speed_m_s + vehicle.max_deceleration_m_s2 * seconds + slack;
        let stops = sent.speed == 0.0 && (sent.stop.is_some() || standstill);
        if !stops && -faster > vehicle.max_deceleration_m_s2 * real + slack {
            return Err("too great a deceleration");
        }
        match vehicle.drive {
            Drive::Ackermann { max_steering_rate_rad_s, .. } => {
                let step = (sent.steering_angle - last.steering_angle).abs();
                let quick = step > max_steering_rate_rad_s * seconds + slack;
                if quick { Err("steers too quickly") } else { Ok(()) }
            }
            Drive::Differential { .. } => Ok(()),
        }
    }
}
