//! The renderer.

use super::bins::Bins;
use super::camera::SimCamera;
use super::canvas::{Canvas, Rays, Span2, TILE};
use super::edges::Blends;
use super::rendered::Rendered;
use super::sensor::{Development, Exposed};
use super::shade::{Sky, Stage, draw_tile};
use super::shadow::{Outline, Shadow};
use super::surface::{Surface, View};
use super::texture::Atlas;
use crate::scene::mesh::{Colour, srgb};
use crate::scene::vehicle::Shape;
use crate::scene::{Mesh, Scene};
use crate::{VehicleKind, VehicleState};
use realnet_core::nalgebra::{UnitQuaternion, Vector3};
use realnet_core::{DepthMap, Frame, Pose, Pose2, Stamp};
use realnet_vision::simd::Simd;

/// Instance of what moves by itself.
const MOVER: u8 = u8::MAX;
/// Most actors of a shot; further ones are not drawn.
const MAX_ACTORS: usize = 250;

/// A vehicle in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Actor {
    /// What it is.
    pub kind: VehicleKind,
    /// Seed of its colour.
    pub paint: u64,
    /// Where it is and what its wheels and lights do.
    pub state: VehicleState,
}

impl Actor {
    /// A vehicle.
    #[must_use]
    pub const fn new(kind: VehicleKind, paint: u64, state: VehicleState) -> Self {
        Self { kind, paint, state }
    }
}

/// What a picture is taken of, and when.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot<'a> {
    /// Time of the middle of the exposure, seconds: moves what moves by itself, and is
    /// the stamp of the picture.
    pub time_s: f64,
    /// The vehicle that carries the camera; it is not in the picture. Its speed and
    /// rate of turn blur the picture where the camera has [`MotionBlur`].
    ///
    /// [`MotionBlur`]: super::MotionBlur
    pub own: VehicleState,
    /// How its body leans: pitch, nose down, and roll, to the right, radians.
    pub lean: [f64; 2],
    /// The vehicles in the picture.
    pub actors: &'a [Actor],
    /// Seed of the noise: another for each frame.
    pub seed: u64,
}

impl Default for Shot<'_> {
    /// Time 0, at the origin, nobody there.
    fn default() -> Self {
        let own = VehicleState::default();
        Self { time_s: 0.0, own, lean: [0.0; 2], actors: &[], seed: 0 }
    }
}

/// Takes pictures. Holds all buffers: after the first pictures of a scene nothing is
/// allocated.
#[derive(Clone, Debug)]
pub struct Renderer {
    pub(super) camera: SimCamera,
    pub(super) simd: Simd,
    pub(super) rays: Rays,
    /// Bounds of all rays.
    picture: Span2,
    pub(super) canvas: Canvas,
    /// Light of several moments, for blur.
    sums: [Vec<f32>; 3],
    pub(super) surfaces: Vec<Surface>,
    /// Decals, until the solid surfaces are all there.
    decals: Vec<(Surface, Span2)>,
    pub(super) bins: Bins,
    shadows: Vec<Shadow>,
    shade_bins: Bins,
    outline: Outline,
    blends: Blends,
    development: Development,
    pub(super) shapes: Vec<(VehicleKind, u64, Shape)>,
    pub(super) scratch: Vec<f32>,
    /// Pixels of a tile that a silhouette covers.
    pub(super) hits: [u8; TILE],
}

impl Renderer {
    /// A renderer for a camera.
    #[must_use]
    pub fn new(camera: SimCamera) -> Self {
        let rays = Rays::new(&camera.model);
        let mut picture = Span2::EMPTY;
        for tile in &rays.tiles {
            picture.add(tile.x[0], tile.y[0]);
            picture.add(tile.x[1], tile.y[1]);
        }
        Self {
            development: Development::new(&camera.model, &rays, &camera.sensor),
            canvas: Canvas::new(rays.len()),
            sums: [Vec::new(), Vec::new(), Vec::new()],
            simd: Simd::best(),
            camera,
            picture,
            rays,
            surfaces: Vec::new(),
            decals: Vec::new(),
            bins: Bins::default(),
            shadows: Vec::new(),
            shade_bins: Bins::default(),
            outline: Outline::default(),
            blends: Blends::default(),
            shapes: Vec::new(),
            scratch: Vec::new(),
            hits: [0; TILE],
        }
    }

    /// The camera.
    #[must_use]
    pub fn camera(&self) -> &SimCamera {
        &self.camera
    }

    /// Moves the camera on its vehicle, as when it is knocked.
    pub fn set_mount(&mut self, base_from_camera: Pose) {
        self.camera.base_from_camera = base_from_camera;
    }

    /// Changes the sensor; the gain of the exposure so far is kept.
    pub fn set_sensor(&mut self, sensor: super::Sensor) {
        if sensor.vignetting != self.camera.sensor.vignetting {
            self.development = Development::new(&self.camera.model, &self.rays, &sensor);
        }
        self.camera.sensor = sensor;
    }

    /// Forgets the gain of the automatic exposure: the next picture is exposed right at
    /// once.
    pub fn reset_exposure(&mut self) {
        self.development.reset();
    }

    /// A black picture of the camera's size, to render into.
    #[must_use]
    #[expect(clippy::expect_used, reason = "a camera model has at least one pixel")]
    pub fn blank(&self) -> Rendered {
        let (width, height) = (self.camera.model.width(), self.camera.model.height());
        let pixels = width as usize * height as usize;
        let frame = Frame::rgb8(Stamp::ZERO, width, height, vec![0; 3 * pixels]);
        let depth = DepthMap::unknown(Stamp::ZERO, width, height);
        Rendered {
            frame: frame.expect("the buffer has the frame's size"),
            depth: depth.expect("the camera has pixels"),
            mask: vec![0; pixels],
            truths: Vec::new(),
            gain: 1.0,
        }
    }

    /// The pose of the optical frame in the world for a shot.
    #[must_use]
    pub fn world_from_camera(&self, own: &Pose2, [pitch, roll]: [f64; 2]) -> Pose {
        let lean = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), roll);
        crate::scene::pose3(own) * Pose::from_rotation(lean) * self.camera.base_from_camera
    }

    /// Takes a picture. `out` comes from [`Renderer::blank`]; one of another size is
    /// replaced.
    ///
    /// The same calls in the same order give the same bytes.
    pub fn render(&mut self, scene: &Scene, shot: &Shot<'_>, out: &mut Rendered) {
        let model = &self.camera.model;
        if (out.frame.width(), out.frame.height()) != (model.width(), model.height()) {
            *out = self.blank();
        }
        let samples = self.samples(scene, shot);
        if samples > 1 {
            self.blurred(scene, shot, samples);
        }
        // The middle of the exposure last: its surfaces are the truth.
        self.moment(scene, shot, 0.0);
        let light = if samples > 1 {
            for (sum, plane) in self.sums.iter_mut().zip(&self.canvas.light) {
                for (sum, value) in sum.iter_mut().zip(plane) {
                    *sum += value;
                }
            }
            &self.sums
        } else {
            &self.canvas.light
        };
        let scale = 1.0 / samples as f32;
        let mean = Development::mean(&self.rays, light) * f64::from(scale);
        let sensor = &self.camera.sensor;
        out.gain = self.development.gain(sensor, shot.time_s, mean);
        let stamp = Stamp::from_secs_f64(shot.time_s);
        let bytes = out.frame.data_mut();
        let (rays, gain) = (&self.rays, out.gain);
        let exposed = Exposed { light, gain, scale, seed: shot.seed };
        self.development.develop(self.simd, sensor, rays, &exposed, bytes);
        out.frame.set_stamp(stamp);
        out.depth.set_stamp(stamp);
        self.write_truth(shot, out);
    }

    /// Moments that an exposure is averaged over: an odd number.
    fn samples(&self, scene: &Scene, shot: &Shot<'_>) -> usize {
        let Some(blur) = self.camera.sensor.blur else { return 1 };
        // The fastest motion in the picture, roughly: turning, and passing at 0.5 m.
        let fastest = shot.actors.iter().map(|actor| actor.state.speed.abs());
        let passing = fastest.fold(shot.own.speed.abs(), f64::max);
        let passing = if scene.movers.is_empty() { passing } else { passing.max(1.0) };
        let pixels =
            self.camera.model.fx() * blur.shutter_s * (shot.own.yaw_rate.abs() + passing / 0.5);
        let wanted = (pixels / 1.5).ceil().clamp(1.0, blur.max_samples.max(1) as f64) as usize;
        if wanted <= 1 { 1 } else { (wanted / 2 * 2 + 1).max(3) }
    }

    /// Sums the light of all moments but the middle one.
    fn blurred(&mut self, scene: &Scene, shot: &Shot<'_>, samples: usize) {
        let shutter = self.camera.sensor.blur.map_or(0.0, |blur| blur.shutter_s);
        for sum in &mut self.sums {
            sum.clear();
            sum.resize(self.rays.len(), 0.0);
        }
        for sample in (0..samples).filter(|&sample| sample != samples / 2) {
            let share = (sample as f64 + 0.5) / samples as f64 - 0.5;
            self.moment(scene, shot, share * shutter);
            for (sum, plane) in self.sums.iter_mut().zip(&self.canvas.light) {
                for (sum, value) in sum.iter_mut().zip(plane) {
                    *sum += value;
                }
            }
        }
    }

    /// Draws what is seen at the shot's time plus `after` seconds.
    fn moment(&mut self, scene: &Scene, shot: &Shot<'_>, after: f64) {
        let own = moved(&shot.own, after);
        let time = shot.time_s + after;
        let camera_from_world = self.world_from_camera(&own.world_from_base, shot.lean).inverse();
        self.begin();
        self.add_scene(scene, time, &camera_from_world);
        for (index, actor) in shot.actors.iter().take(MAX_ACTORS).enumerate() {
            let state = moved(&actor.state, after);
            let actor = Actor { state, ..*actor };
            self.add_actor(scene, &actor, index as u8 + 1, time, &camera_from_world);
        }
        self.finish();
        let up = camera_from_world.transform_vector(&Vector3::z());
        let brightness = scene.brightness(time) as f32;
        let sky = scene.light.sky.map(|[horizon, top]| Sky {
            up: [up.x as f32, up.y as f32, up.z as f32],
            horizon: horizon.map(|c| c * brightness * 1.4),
            top: top.map(|c| c * brightness * 1.4),
        });
        let stage = Stage {
            rays: &self.rays,
            surfaces: &self.surfaces,
            shadows: &self.shadows,
            atlas: Atlas::shared(),
            sky,
        };
        for tile in 0..self.rays.tiles.len() {
            let (entries, shades) = (self.bins.of(tile), self.shade_bins.of(tile));
            draw_tile(self.simd, &stage, tile, entries, shades, &mut self.canvas);
        }
        self.blends.run(&self.rays, &self.surfaces, &mut self.canvas);
    }

    fn begin(&mut self) {
        self.surfaces.clear();
        self.decals.clear();
        self.bins.clear();
        self.shadows.clear();
        self.shade_bins.clear();
        // Index 0 stands for nothing.
        self.surfaces.push(Surface::NOTHING);
    }

    fn finish(&mut self) {
        for (surface, bounds) in self.decals.drain(..) {
            push(&mut self.surfaces, &mut self.bins, &self.rays, surface, &bounds);
        }
        self.bins.sort(self.rays.tiles.len());
        self.shade_bins.sort(self.rays.tiles.len());
    }

    /// Adds the faces of a mesh that can be seen. `glow` gives faces more light.
    fn add_mesh(&mut self, view: &View<'_>, mesh: &Mesh, glow: impl Fn(usize) -> f32) {
        for (index, face) in mesh.faces.iter().enumerate() {
            let Some((surface, bounds)) = view.surface(mesh, face, &self.picture, glow(index))
            else {
                continue;
            };
            if surface.decal {
                self.decals.push((surface, bounds));
            } else {
                push(&mut self.surfaces, &mut self.bins, &self.rays, surface, &bounds);
            }
        }
    }

    fn add_scene(&mut self, scene: &Scene, time: f64, camera_from_world: &Pose) {
        let lamp = camera_from_world.transform_point(&scene.light.lamp);
        let brightness = scene.brightness(time) as f32;
        let view = |camera_from_body: Pose, instance: u8| View {
            camera_from_body,
            camera_from_world,
            light: &scene.light,
            lamp,
            brightness,
            instance,
        };
        self.add_mesh(&view(*camera_from_world, 0), &scene.solid, |_| 0.0);
        self.add_shadows(scene, &scene.solid, &Pose::identity(), camera_from_world);
        for mover in &scene.movers {
            for (index, part) in mover.parts.iter().enumerate() {
                let pose = mover.pose(index, time);
                self.add_mesh(&view(*camera_from_world * pose, MOVER), part, |_| 0.0);
                self.add_shadows(scene, part, &pose, camera_from_world);
            }
        }
        for obstacle in &scene.obstacles {
            let corners = obstacle.footprint(time);
            self.add_contact(corners, camera_from_world, 0.05);
        }
    }

    fn add_shadows(
        &mut self,
        scene: &Scene,
        mesh: &Mesh,
        world_from_body: &Pose,
        camera_from_world: &Pose,
    ) {
        for hull in &mesh.hulls {
            let corners = hull.iter().map(|corner| world_from_body.transform_point(corner));
            let shadow = self.outline.cast(&scene.light, corners, camera_from_world);
            self.push_shadow(shadow);
        }
    }

    fn add_contact(
        &mut self,
        corners: impl Iterator<Item = realnet_core::nalgebra::Vector2<f64>>,
        camera_from_world: &Pose,
        softness: f64,
    ) {
        let shadow = self.outline.contact(corners, camera_from_world, softness);
        self.push_shadow(shadow);
    }

    fn push_shadow(&mut self, shadow: Option<(Shadow, Span2)>) {
        let Some((shadow, bounds)) = shadow else { return };
        let Ok(index) = u16::try_from(self.shadows.len()) else { return };
        if bounds.meets(&self.picture) {
            self.shade_bins.add(&self.rays, index, &bounds, |_| Some(0));
            self.shadows.push(shadow);
        }
    }

    /// Makes the shape of an actor if it is new, and says where it is kept.
    pub(super) fn shape(&mut self, actor: &Actor) -> usize {
        let known = self
            .shapes
            .iter()
            .position(|(kind, paint, _)| *kind == actor.kind && *paint == actor.paint);
        known.unwrap_or_else(|| {
            let shape = Shape::new(actor.kind, paint(actor.paint));
            self.shapes.push((actor.kind, actor.paint, shape));
            self.shapes.len() - 1
        })
    }

    fn add_actor(
        &mut self,
        scene: &Scene,
        actor: &Actor,
        instance: u8,
        time: f64,
        camera_from_world: &Pose,
    ) {
        let index = self.shape(actor);
        // Taken out while its faces are added.
        let Some((_, _, shape)) = self.shapes.get_mut(index) else { return };
        let shape = std::mem::take(shape);
        let world_from_base = crate::scene::pose3(&actor.state.world_from_base);
        let view = View {
            camera_from_body: *camera_from_world * world_from_base,
            camera_from_world,
            light: &scene.light,
            lamp: camera_from_world.transform_point(&scene.light.lamp),
            brightness: scene.brightness(time) as f32,
            instance,
        };
        let braking = if actor.state.braking { 3.0 } else { 0.35 };
        let glow = |face: usize| if shape.brake_lights.contains(&face) { braking } else { 0.0 };
        self.add_mesh(&view, &shape.body, glow);
        self.add_shadows(scene, &shape.body, &world_from_base, camera_from_world);
        for wheel in 0..shape.wheels() {
            let Some((mesh, base_from_wheel)) = shape.wheel(wheel, &actor.state) else { continue };
            let camera_from_body = view.camera_from_body * base_from_wheel;
            self.add_mesh(&View { camera_from_body, ..view }, mesh, |_| 0.0);
        }
        let corners = actor.kind.size().corners(&actor.state.world_from_base);
        self.add_contact(corners.into_iter(), camera_from_world, 0.05);
        if let Some((_, _, place)) = self.shapes.get_mut(index) {
            *place = shape;
        }
    }
}

/// Adds a surface to the list and to the tiles it may be seen on.
fn push(
    surfaces: &mut Vec<Surface>,
    bins: &mut Bins,
    rays: &Rays,
    surface: Surface,
    bounds: &Span2,
) {
    if let Ok(index) = u16::try_from(surfaces.len()) {
        bins.add_surface(rays, index, &surface, bounds);
        surfaces.push(surface);
    }
}

/// A vehicle `after` seconds later, at constant speed and turn.
fn moved(state: &VehicleState, after: f64) -> VehicleState {
    VehicleState {
        world_from_base: state.world_from_base.driven(state.speed, state.yaw_rate, after),
        ..*state
    }
}

/// A vehicle's colour by its seed.
fn paint(seed: u64) -> Colour {
    const COLOURS: [u32; 12] = [
        0x2a62c8, 0xd02a24, 0x2f9a48, 0xe8a818, 0xf0f0ee, 0x2c2e33, 0xd86a1c, 0x7a3fa8, 0x20a0b0,
        0x9aa0a8, 0xb8c83a, 0xd84a8a,
    ];
    srgb(COLOURS[(seed % COLOURS.len() as u64) as usize])
}
