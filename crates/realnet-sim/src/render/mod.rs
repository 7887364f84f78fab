//! Pictures of a [`Scene`](crate::scene::Scene) by a camera on a vehicle, with their
//! truth.
//!
//! Everything is made of convex flat faces. A face is covered, and its depth found, on
//! the *rays* of the pixels: on a ray `(x, y, 1)` of the optical frame, inverse depth
//! and the sides of a face's edges are linear functions of `x` and `y`, so one table
//! of rays makes any lens exact, for the picture and for the depth alike. The picture
//! is worked through in tiles of 16 x 8 pixels, each with the list of the faces that
//! touch it.
//!
//! Textures are filtered over the footprint of a pixel, edges of faces are blended by
//! the share of the pixel they cover: points of the picture move as those of a real
//! picture do, which optical flow relies on.
//!
//! ```
//! use realnet_core::{CameraModel, Distortion, Intrinsics, Pose2};
//! use realnet_sim::render::{Actor, Renderer, Shot, SimCamera};
//! use realnet_sim::scene::{Scene, SceneSpec};
//! use realnet_sim::{VehicleKind, VehicleState};
//!
//! let intrinsics = Intrinsics { fx: 160.0, fy: 160.0, cx: 79.5, cy: 44.5 };
//! let model = CameraModel::new(160, 90, intrinsics, Distortion::None)?;
//! let mut renderer = Renderer::new(SimCamera::new(model));
//! let scene = Scene::build(&SceneSpec::default(), 1);
//! let target = VehicleState { world_from_base: Pose2::new(1.2, 0.0, 0.0), ..Default::default() };
//! let actors = [Actor::new(VehicleKind::Truck, 5, target)];
//! let mut picture = renderer.blank();
//! renderer.render(&scene, &Shot { actors: &actors, ..Shot::default() }, &mut picture);
//! let truth = picture.truth(0).expect("the truck is in view");
//! assert!((truth.depth_median_m - 0.9).abs() < 0.1, "{truth:?}");
//! # Ok::<(), realnet_core::CameraError>(())
//! ```

mod bins;
mod camera;
mod canvas;
mod edges;
mod rendered;
mod renderer;
mod sensor;
mod shade;
mod shadow;
mod surface;
mod texture;
mod truth;

pub use camera::{Exposure, MotionBlur, Sensor, SimCamera, base_from_mount};
pub use rendered::{Rendered, Truth};
pub use renderer::{Actor, Renderer, Shot};

pub(crate) use texture::{SIDE as TEXTURE_SIDE, Texture};

#[cfg(test)]
mod tests;
