//! Vehicles as bodies: kinds, sizes, where one stands.

use realnet_core::Pose2;
use realnet_core::nalgebra::Vector2;

/// The kinds of vehicles that there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VehicleKind {
    /// A 1:10 touring car, 0.42 m long.
    TouringCar,
    /// A 1:10 truck with a box body, 0.46 m long.
    Truck,
    /// A 1:16 buggy with open wheels, 0.28 m long.
    Buggy,
    /// A robot on two driven wheels and a castor, 0.30 m long.
    Robot,
}

impl VehicleKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::TouringCar, Self::Truck, Self::Buggy, Self::Robot];

    /// Name in files and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::TouringCar => "touring-car",
            Self::Truck => "truck",
            Self::Buggy => "buggy",
            Self::Robot => "robot",
        }
    }

    /// Its dimensions.
    #[must_use]
    pub const fn size(self) -> VehicleSize {
        let new = VehicleSize::new;
        match self {
            Self::TouringCar => new(0.42, 0.19, 0.13, 0.26, 0.08, 0.032),
            Self::Truck => new(0.46, 0.20, 0.22, 0.28, 0.09, 0.040),
            Self::Buggy => new(0.28, 0.18, 0.12, 0.18, 0.05, 0.035),
            Self::Robot => new(0.30, 0.24, 0.16, 0.18, 0.08, 0.045),
        }
    }
}

/// Dimensions of a vehicle, metres. The base frame's origin is on the ground under
/// the middle of the rear axle (of the driven wheels).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VehicleSize {
    /// From bumper to bumper.
    pub length: f64,
    /// Over the wheels.
    pub width: f64,
    /// From the ground to the roof.
    pub height: f64,
    /// From axle to axle (from the driven wheels to the castor).
    pub wheelbase: f64,
    /// From the rear axle to the rear bumper.
    pub rear_overhang: f64,
    /// Of the wheels.
    pub wheel_radius: f64,
}

impl VehicleSize {
    const fn new(
        length: f64,
        width: f64,
        height: f64,
        wheelbase: f64,
        rear_overhang: f64,
        wheel_radius: f64,
    ) -> Self {
        Self { length, width, height, wheelbase, rear_overhang, wheel_radius }
    }

    /// From the base frame's origin to the front bumper, metres.
    #[must_use]
    pub fn front(&self) -> f64 {
        self.length - self.rear_overhang
    }

    /// Corners of the footprint in the world, counter-clockwise from rear right.
    #[must_use]
    pub fn corners(&self, world_from_base: &Pose2) -> [Vector2<f64>; 4] {
        let (rear, front, side) = (-self.rear_overhang, self.front(), 0.5 * self.width);
        [[rear, -side], [front, -side], [front, side], [rear, side]]
            .map(|[x, y]| world_from_base.transform_point(&Vector2::new(x, y)))
    }
}

/// Where a vehicle is and what it does, for its dynamics and for its picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VehicleState {
    /// Where it stands: base frame, see [`VehicleSize`].
    pub world_from_base: Pose2,
    /// Speed of the base frame's origin along x, m/s.
    pub speed: f64,
    /// Rate of turn, rad/s, positive to the left.
    pub yaw_rate: f64,
    /// Angle of the virtual front wheel, radians, positive to the left.
    pub steering_angle: f64,
    /// How far the wheels have rolled, radians.
    pub wheel_angle: f64,
    /// Whether the brake lights shine.
    pub braking: bool,
}
