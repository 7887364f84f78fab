//! Shapes of the vehicles, in their base frame: x forward, y left, z up, the origin
//! on the ground under the middle of the rear axle.

use super::mesh::{Colour, Hexa, Mesh, Skin, p, scaled, srgb};
use crate::render::Texture;
use crate::{VehicleKind, VehicleSize, VehicleState};
use realnet_core::Pose;
use realnet_core::nalgebra::{Point3, UnitQuaternion, Vector3};

/// A wheel: where its middle is, whether it steers.
#[derive(Clone, Debug)]
struct Wheel {
    mesh: Mesh,
    middle: Vector3<f64>,
    steers: bool,
    radius: f64,
}

/// The shape of a vehicle of one colour.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shape {
    /// Body without wheels.
    pub(crate) body: Mesh,
    /// Faces of `body` that are brake lights.
    pub(crate) brake_lights: Vec<usize>,
    wheels: Vec<Wheel>,
    drive_radius: f64,
}

impl Shape {
    /// The shape of a kind in a colour, linear light.
    pub(crate) fn new(kind: VehicleKind, paint: Colour) -> Self {
        let mut builder = Builder::new(kind, paint);
        match kind {
            VehicleKind::TouringCar => builder.touring_car(),
            VehicleKind::Truck => builder.truck(),
            VehicleKind::Buggy => builder.buggy(),
            VehicleKind::Robot => builder.robot(),
        }
        builder.shape
    }

    /// Number of wheels.
    pub(crate) fn wheels(&self) -> usize {
        self.wheels.len()
    }

    /// The mesh of a wheel and its pose in the base frame.
    pub(crate) fn wheel(&self, index: usize, state: &VehicleState) -> Option<(&Mesh, Pose)> {
        let wheel = self.wheels.get(index)?;
        let steer = if wheel.steers { state.steering_angle } else { 0.0 };
        // Small wheels turn as much faster.
        let roll = state.wheel_angle * self.drive_radius / wheel.radius;
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), steer)
            * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), roll);
        Some((&wheel.mesh, Pose::new(turn, wheel.middle)))
    }
}

/// Corners of a box-like body: at the lower and the upper rim, rear and front x and
/// half width.
struct Loft {
    z: [f64; 2],
    lower: [f64; 2],
    upper: [f64; 2],
    half: [f64; 2],
    /// Half width at the front as a share of that at the rear.
    taper: f64,
}

impl Loft {
    fn corners(&self) -> [Point3<f64>; 8] {
        let ring = |x: [f64; 2], half: f64, z: f64| {
            let front = half * self.taper;
            [p(x[0], -half, z), p(x[1], -front, z), p(x[1], front, z), p(x[0], half, z)]
        };
        let [a, b, c, d] = ring(self.lower, self.half[0], self.z[0]);
        let [e, f, g, h] = ring(self.upper, self.half[1], self.z[1]);
        [a, b, c, d, e, f, g, h]
    }
}

struct Builder {
    shape: Shape,
    size: VehicleSize,
    paint: Skin,
    trim: Skin,
    dark: Skin,
    glass: Skin,
}

const LAMP_RED: Colour = [0.45, 0.012, 0.012];

impl Builder {
    fn new(kind: VehicleKind, paint: Colour) -> Self {
        let size = kind.size();
        let density = 1100.0;
        let dark_paint = scaled(paint, 0.25);
        let light_paint = scaled(paint, 1.25);
        let paint = Skin::new(Texture::Paint, dark_paint, light_paint, density);
        let dark = Skin::new(Texture::Plain, srgb(0x0c0c0d), srgb(0x3c3c40), density);
        let trim = Skin::new(Texture::Asphalt, srgb(0x141416), srgb(0x6a6a70), density);
        let glass = Skin::new(Texture::Concrete, srgb(0x0d1418), srgb(0x5d7480), 900.0);
        let shape = Shape {
            body: Mesh::default(),
            brake_lights: Vec::new(),
            wheels: Vec::new(),
            drive_radius: size.wheel_radius,
        };
        Self { shape, size, paint, trim, dark, glass }
    }

    fn body(&mut self) -> &mut Mesh {
        &mut self.shape.body
    }

    fn loft(&mut self, loft: &Loft, skins: Hexa) {
        self.body().hexahedron(loft.corners(), &skins);
    }

    /// A patch on a face of a loft: `side` as in [`Mesh::hexahedron`] (0 right, 1
    /// front, 2 left, 3 rear); `u` and `v` run from 0 to 1 to the right and down as
    /// seen from outside.
    fn patch(&mut self, loft: &Loft, side: usize, u: [f64; 2], v: [f64; 2], skin: Skin) -> usize {
        let c = loft.corners();
        let (i, j) = (side, (side + 1) % 4);
        // Seen from outside, corner i is at the left.
        let at = |u: f64, v: f64| {
            let top = c[4 + i].coords.lerp(&c[4 + j].coords, u);
            let bottom = c[i].coords.lerp(&c[j].coords, u);
            Point3::from(top.lerp(&bottom, v))
        };
        let corners = [at(u[0], v[0]), at(u[1], v[0]), at(u[1], v[1]), at(u[0], v[1])];
        let face = self.body().filled(corners, skin);
        face.decal = true;
        self.body().faces.len() - 1
    }

    /// Like [`Self::patch`], its texture at the density of the skin.
    fn panel(&mut self, loft: &Loft, side: usize, u: [f64; 2], v: [f64; 2], skin: Skin) {
        let at = self.patch(loft, side, u, v, skin);
        let face = &mut self.body().faces[at];
        for map in [&mut face.s, &mut face.t] {
            let by = skin.density / map.0.norm();
            *map = (map.0 * by, map.1 * by);
        }
    }

    /// Two brake lights and a number plate on the rear of a loft.
    fn rear(&mut self, loft: &Loft, lights: [f64; 2], light_v: [f64; 2], plate_v: [f64; 2]) {
        let red = Skin::new(Texture::Plain, scaled(LAMP_RED, 0.7), LAMP_RED, 2000.0);
        for u in [[lights[0], lights[1]], [1.0 - lights[1], 1.0 - lights[0]]] {
            let rim = [u[0] - 0.015, u[1] + 0.015];
            let tall = 0.12 * (light_v[1] - light_v[0]);
            self.panel(loft, 3, rim, [light_v[0] - tall, light_v[1] + tall], self.dark);
            let light = self.patch(loft, 3, u, light_v, red);
            self.shape.brake_lights.push(light);
        }
        let plate = Skin::new(Texture::Plate, srgb(0x101010), srgb(0xf4e9b0), 1.0);
        self.patch(loft, 3, [0.33, 0.67], plate_v, plate);
    }

    fn head_lights(&mut self, loft: &Loft, v: [f64; 2]) {
        let white = Skin::plain(srgb(0xf8f4e0)).glowing(0.8);
        for u in [[0.06, 0.26], [0.74, 0.94]] {
            self.patch(loft, 1, u, v, white);
        }
    }

    /// A wheel at each side of an axle at `x`; `width` is over the wheels.
    fn axle(&mut self, x: f64, radius: f64, thick: f64, width: f64, steers: bool) {
        let tyre = Skin::new(Texture::Asphalt, srgb(0x0a0a0a), srgb(0x4a4a4a), 1500.0);
        let rim = Skin::new(Texture::Wheel, srgb(0x08080a), srgb(0xe8e8ec), 1.0);
        for side in [1.0, -1.0] {
            let mut mesh = Mesh::default();
            mesh.wheel(radius, thick, side, tyre, rim);
            let middle = Vector3::new(x, side * 0.5 * (width - thick), radius);
            self.shape.wheels.push(Wheel { mesh, middle, steers, radius });
        }
    }

    fn touring_car(&mut self) {
        let size = self.size;
        let (rear, front, half) = (-size.rear_overhang, size.front(), 0.5 * size.width - 0.004);
        let (paint, dark, glass, trim) = (self.paint, self.dark, self.glass, self.trim);
        let low = Loft {
            z: [0.016, 0.046],
            lower: [rear + 0.004, front - 0.006],
            upper: [rear, front],
            half: [half - 0.026, half - 0.024],
            taper: 0.97,
        };
        self.loft(&low, Hexa::all(dark));
        let body = Loft {
            z: [0.040, 0.080],
            lower: [rear, front],
            upper: [rear + 0.006, front - 0.03],
            half: [half, half - 0.008],
            taper: 0.92,
        };
        self.loft(&body, Hexa::all(paint));
        let cabin = Loft {
            z: [0.079, size.height],
            lower: [rear + 0.035, front - 0.10],
            upper: [rear + 0.085, front - 0.17],
            half: [half - 0.012, half - 0.026],
            taper: 0.96,
        };
        self.loft(&cabin, Hexa::all(paint));
        self.panel(&cabin, 3, [0.08, 0.92], [0.12, 0.92], glass);
        self.panel(&cabin, 1, [0.07, 0.93], [0.10, 0.94], glass);
        for side in [0, 2] {
            self.panel(&cabin, side, [0.12, 0.50], [0.14, 0.88], glass);
            self.panel(&cabin, side, [0.54, 0.88], [0.14, 0.88], glass);
        }
        self.rear(&body, [0.04, 0.24], [0.12, 0.50], [0.30, 0.78]);
        self.panel(&body, 3, [0.0, 1.0], [0.86, 1.0], trim);
        self.head_lights(&body, [0.25, 0.6]);
        // The wing on its two struts.
        let wing = [rear + 0.002, rear + 0.040];
        for y in [-0.05, 0.05] {
            let (middle, half) = ([rear + 0.02, y], [0.010, 0.002]);
            self.body().block(middle, half, [0.078, 0.113], 0.0, &Hexa::all(dark));
        }
        let middle = [0.5 * (wing[0] + wing[1]), 0.0];
        let half_wing = [0.5 * (wing[1] - wing[0]), half - 0.006];
        self.body().block(middle, half_wing, [0.112, 0.118], 0.0, &Hexa::all(paint).topped(trim));
        self.arches(&body, rear, front);
        self.axle(0.0, size.wheel_radius, 0.026, size.width, false);
        self.axle(size.wheelbase, size.wheel_radius, 0.026, size.width, true);
    }

    /// Dark wheel arches on both sides of a body.
    fn arches(&mut self, body: &Loft, rear: f64, front: f64) {
        let (size, dark) = (self.size, self.dark);
        let reach = 1.25 * size.wheel_radius;
        for axle in [0.0, size.wheelbase] {
            let share = |x: f64| ((x - rear) / (front - rear)).clamp(0.0, 1.0);
            let (a, b) = (share(axle - reach), share(axle + reach));
            let v =
                [((body.z[1] - 2.15 * size.wheel_radius) / (body.z[1] - body.z[0])).max(0.05), 1.0];
            self.panel(body, 0, [a, b], v, dark);
            self.panel(body, 2, [1.0 - b, 1.0 - a], v, dark);
        }
    }

    fn truck(&mut self) {
        let size = self.size;
        let (rear, front, half) = (-size.rear_overhang, size.front(), 0.5 * size.width);
        let (paint, dark, glass, trim) = (self.paint, self.dark, self.glass, self.trim);
        let frame = Loft {
            z: [0.035, 0.066],
            lower: [rear, front - 0.01],
            upper: [rear, front - 0.01],
            half: [half - 0.045, half - 0.045],
            taper: 1.0,
        };
        self.loft(&frame, Hexa::all(dark));
        let cargo = Loft {
            z: [0.072, size.height],
            lower: [rear, front - 0.145],
            upper: [rear, front - 0.145],
            half: [half, half],
            taper: 1.0,
        };
        let canvas = Skin::new(Texture::Paint, srgb(0x9a9a96), srgb(0xf0f0ea), 700.0);
        self.loft(&cargo, Hexa::all(canvas));
        // Doors with a gap, hinges, bars, and a stripe in the vehicle's colour.
        self.panel(&cargo, 3, [0.04, 0.49], [0.04, 0.84], canvas.flattened(0.9));
        self.panel(&cargo, 3, [0.51, 0.96], [0.04, 0.84], canvas.flattened(0.9));
        self.panel(&cargo, 3, [0.0, 1.0], [0.50, 0.66], paint);
        self.panel(&cargo, 3, [0.494, 0.506], [0.03, 0.88], dark);
        for u in [0.30, 0.68] {
            self.panel(&cargo, 3, [u, u + 0.02], [0.05, 0.85], trim);
        }
        for side in [0, 2] {
            self.panel(&cargo, side, [0.0, 1.0], [0.50, 0.66], paint);
            self.panel(&cargo, side, [0.25, 0.6], [0.14, 0.40], trim);
        }
        self.panel(&cargo, 3, [0.0, 1.0], [0.86, 1.0], trim);
        let cab = Loft {
            z: [0.040, size.height - 0.03],
            lower: [front - 0.135, front],
            upper: [front - 0.135, front - 0.025],
            half: [half - 0.004, half - 0.012],
            taper: 0.97,
        };
        self.loft(&cab, Hexa::all(paint));
        self.panel(&cab, 1, [0.06, 0.94], [0.08, 0.48], glass);
        self.panel(&cab, 0, [0.35, 0.9], [0.10, 0.46], glass);
        self.panel(&cab, 2, [0.10, 0.65], [0.10, 0.46], glass);
        self.head_lights(&cab, [0.70, 0.84]);
        // The bumper with the lights, below the cargo box.
        let bumper = Loft {
            z: [0.040, 0.071],
            lower: [rear, rear + 0.012],
            upper: [rear, rear + 0.012],
            half: [half - 0.006, half - 0.006],
            taper: 1.0,
        };
        self.loft(&bumper, Hexa::all(trim));
        self.rear(&bumper, [0.03, 0.22], [0.15, 0.75], [0.08, 0.88]);
        self.axle(0.0, size.wheel_radius, 0.034, size.width - 0.002, false);
        self.axle(size.wheelbase, size.wheel_radius, 0.030, size.width - 0.002, true);
    }

    fn buggy(&mut self) {
        let size = self.size;
        let (rear, front) = (-size.rear_overhang, size.front());
        let (paint, dark, trim) = (self.paint, self.dark, self.trim);
        let floor = Loft {
            z: [0.020, 0.045],
            lower: [rear + 0.005, front - 0.03],
            upper: [rear + 0.005, front],
            half: [0.045, 0.048],
            taper: 0.55,
        };
        self.loft(&floor, Hexa::all(dark));
        let tub = Loft {
            z: [0.045, 0.078],
            lower: [rear + 0.010, front - 0.01],
            upper: [rear + 0.015, front - 0.07],
            half: [0.055, 0.044],
            taper: 0.5,
        };
        self.loft(&tub, Hexa::all(paint));
        let cockpit = Loft {
            z: [0.078, 0.106],
            lower: [rear + 0.04, front - 0.09],
            upper: [rear + 0.07, front - 0.14],
            half: [0.040, 0.030],
            taper: 0.7,
        };
        self.loft(&cockpit, Hexa::all(paint));
        let glass = self.glass;
        for side in 0..4 {
            self.panel(&cockpit, side, [0.1, 0.9], [0.15, 0.85], glass);
        }
        self.rear(&tub, [0.02, 0.26], [0.10, 0.55], [0.25, 0.9]);
        self.head_lights(&floor, [0.2, 0.7]);
        // Shock towers, rear axle, wing.
        for x in [0.0, size.wheelbase] {
            let half = [0.007, 0.5 * size.width - 0.03];
            self.body().block([x, 0.0], half, [0.030, 0.040], 0.0, &Hexa::all(trim));
            for y in [-0.05, 0.05] {
                let strut = Hexa::all(Skin::plain(srgb(0xc8a020)));
                self.body().block([x, y], [0.006, 0.006], [0.036, 0.075], 0.0, &strut);
            }
        }
        for y in [-0.03, 0.03] {
            let middle = [rear + 0.022, y];
            self.body().block(middle, [0.008, 0.002], [0.070, 0.112], 0.0, &Hexa::all(dark));
        }
        let skins = Hexa::all(paint).topped(trim);
        self.body().block([rear + 0.022, 0.0], [0.022, 0.075], [0.112, size.height], 0.0, &skins);
        self.axle(0.0, size.wheel_radius, 0.036, size.width, false);
        self.axle(size.wheelbase, size.wheel_radius * 0.92, 0.028, size.width, true);
    }

    fn robot(&mut self) {
        let size = self.size;
        let (rear, front, half) = (-size.rear_overhang, size.front(), 0.5 * size.width);
        let (paint, dark, trim) = (self.paint, self.dark, self.trim);
        let hull = Loft {
            z: [0.022, 0.085],
            lower: [rear, front - 0.02],
            upper: [rear, front],
            half: [half - 0.034, half - 0.034],
            taper: 0.9,
        };
        self.loft(&hull, Hexa::all(paint));
        self.panel(&hull, 3, [0.0, 1.0], [0.82, 1.0], dark);
        let marker = Skin::new(Texture::Checker, srgb(0x101010), srgb(0xf4f4f4), 1.0);
        let deck = Loft {
            z: [0.100, 0.106],
            lower: [rear, front - 0.01],
            upper: [rear, front - 0.01],
            half: [half - 0.03, half - 0.03],
            taper: 0.9,
        };
        self.loft(&deck, Hexa::all(trim));
        for x in [rear + 0.02, front - 0.04] {
            for y in [-0.07, 0.07] {
                let post = Hexa::all(Skin::plain(srgb(0xb0b0b4)));
                self.body().block([x, y], [0.005, 0.005], [0.084, 0.101], 0.0, &post);
            }
        }
        let tower = Loft {
            z: [0.106, 0.140],
            lower: [rear + 0.01, rear + 0.05],
            upper: [rear + 0.01, rear + 0.05],
            half: [0.06, 0.055],
            taper: 1.0,
        };
        self.loft(&tower, Hexa::all(dark));
        self.patch(&tower, 3, [0.32, 0.68], [0.05, 0.95], marker);
        let lidar = Skin::plain(srgb(0x2a2a30));
        let middle = [0.5 * (rear + front) + 0.03, 0.0];
        self.body().frustum(middle, [0.035, 0.035], [0.106, size.height], 12, lidar, lidar);
        self.rear(&hull, [0.05, 0.22], [0.12, 0.42], [0.20, 0.72]);
        self.head_lights(&hull, [0.25, 0.5]);
        self.axle(0.0, size.wheel_radius, 0.030, size.width, false);
        // The castor, in the middle of the front.
        let radius = 0.020;
        let tyre = Skin::new(Texture::Asphalt, srgb(0x0a0a0a), srgb(0x4a4a4a), 1500.0);
        let mut mesh = Mesh::default();
        mesh.wheel(radius, 0.018, 1.0, tyre, tyre);
        let middle = Vector3::new(size.wheelbase, 0.0, radius);
        self.shape.wheels.push(Wheel { mesh, middle, steers: false, radius });
    }
}
